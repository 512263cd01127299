//! What a calibration file makes of a measurement file where it is certainly wrong: refused.

use volcomp_document::{InputError, Value};
use volcomp_kinematics::MotionFrame;
use volcomp_metrology::{Measurement, Reading, axis_named};
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisKind, Direction, ErrorName};

use crate::{
    calibration_file::Line,
    odd::ends,
    setup::{Method, Setup},
};

/// No machine tool is wrong by more: 100 mm and 100 mrad, in µm and µrad.
pub(crate) const NEVER_ABOVE: f64 = 1e5;
/// No angle of a machine tool varies by more along or about an axis: 5 mrad, in µrad. Arc seconds that are read as mrad do.
const ANGLE_NEVER_VARIES: f64 = 5e3;
/// Refuses a line of an error motion that turns with its axis: an instrument that does not turn sees two of them mixed. Only
/// those along and about the axis itself are the same in both frames. `name` is the value that names the error.
pub(crate) fn refuse_turning(
    name: &Value<'_>,
    error: ErrorName,
    machine: &Machine,
) -> Result<(), InputError> {
    let turns = machine
        .axis(error.axis)
        .is_some_and(|axis| axis.motion_frame == MotionFrame::Turning);
    let is_along = error.component.mcs_index() == error.axis.mcs_index();
    if !turns || is_along {
        return Ok(());
    }
    Err(name.error(format!(
        "found {error}, and `motion_frame = \"turning\"` of {} in the machine file: instruments show error motions in the frame that does not turn, expected `motion_frame = \"fixed\"`",
        error.axis
    )))
}

/// Refuses the file of another error, read in the same way: the readings of one are not those of the other. Angles of a bridge may
/// give the angular error itself and, summed up, a straightness.
pub(crate) fn refuse_file_of_another(
    before: &[Line],
    line: &Line,
    file: &Value<'_>,
) -> Result<(), InputError> {
    let is_direct = |line: &Line| line.setup.method == Method::Direct;
    let same = before.iter().find(|other| {
        other.file == line.file
            && other.setup.error != line.setup.error
            && is_direct(other) == is_direct(line)
    });
    same.map_or(Ok(()), |other| {
        Err(file.error(format!(
            "found {:?}, which is the file of {} at {}, expected that of {}",
            line.file
                .file_name()
                .unwrap_or_default()
                .display()
                .to_string(),
            other.setup.error,
            other.place,
            line.setup.error
        )))
    })
}

/// Refuses a file that another line of the same error names already: its readings would count twice. `file` is the value that
/// names the file.
pub(crate) fn refuse_file_twice(
    before: &[Line],
    line: &Line,
    file: &Value<'_>,
) -> Result<(), InputError> {
    // Both were read; one that is no longer there is compared as it is named.
    let place = |line: &Line| line.file.canonicalize().unwrap_or(line.file.clone());
    let same = |other: &&Line| other.setup.error == line.setup.error && place(other) == place(line);
    before.iter().find(same).map_or(Ok(()), |other| {
        Err(file.error(format!(
            "found {}, which {} names for {} already, expected each file once for an error: its readings would count twice",
            volcomp_document::quoted(file.text()?),
            other.place,
            line.setup.error
        )))
    })
}

/// Refuses a second file of one error along one line, over the same targets in the same direction: which of them holds is for a person
/// to say, and the mean of both would be none of them. Files that go on where another ends, or hold the other direction, are
/// one test.
pub(crate) fn refuse_line_twice(
    before: &[Line],
    line: &Line,
    file: &Value<'_>,
) -> Result<(), InputError> {
    let is_one_line = |other: &&Line| {
        (other.setup.error, &other.setup.at, other.setup.point_mcs)
            == (line.setup.error, &line.setup.at, line.setup.point_mcs)
            && other.setup.method == line.setup.method
            && (covers(&other.readings, &line.readings) || covers(&line.readings, &other.readings))
    };
    before.iter().find(is_one_line).map_or(Ok(()), |other| {
        Err(file.error(format!(
            "found {}, and {:?} ({}) measures {} along the same line already, with the same `at` and `point`: the mean of two tests is none of them, expected one of the files, or other places",
            volcomp_document::quoted(file.text()?),
            other.file.file_name().unwrap_or_default().display().to_string(),
            other.place,
            line.setup.error
        )))
    })
}

/// Whether more than half of the readings of `other` are at places that `one` went over in the same direction.
fn covers(one: &Measurement, other: &Measurement) -> bool {
    let span = |direction| {
        let readings = one.readings.iter().filter(|of| of.direction == direction);
        readings.fold(None, |span: Option<[f64; 2]>, of| {
            let [low, high] = span.unwrap_or([of.target; 2]);
            Some([low.min(of.target), high.max(of.target)])
        })
    };
    let spans = Direction::BOTH.map(|direction| (direction, span(direction)));
    let is_covered = |of: &&Reading| {
        spans.iter().any(|(direction, span)| {
            *direction == of.direction
                && span.is_some_and(|[low, high]| (low..=high).contains(&of.target))
        })
    };
    let covered = other.readings.iter().filter(is_covered).count();
    2 * covered > other.readings.len()
}

/// Refuses readings (µm or µrad) that cannot be those of this line: of another axis that the machine has, none of them
/// within the travel, or of a size that only a wrong unit gives. `file` is the value that names the file.
pub(crate) fn refuse(
    file: &Value<'_>,
    setup: &Setup,
    readings: &Measurement,
    machine: &Machine,
) -> Result<(), InputError> {
    let error = setup.error;
    let stated = readings.metadata.axis.as_deref().and_then(axis_named);
    if let Some(other) = stated.filter(|axis| *axis != error.axis && machine.axis(*axis).is_some())
    {
        return Err(file.error(format!(
            "the file states that axis {other} was measured, expected {}, the axis of {error}",
            error.axis
        )));
    }
    let sizes = readings.readings.iter().map(|reading| reading.deviation);
    let largest = sizes.fold(0.0_f64, |largest, size| largest.max(size.abs()));
    if largest > NEVER_ABOVE {
        let unit = if setup.reads_angles() { "mrad" } else { "mm" };
        return Err(file.error(format!(
            "found a deviation of {:.0} {unit}, expected less than 100 {unit}: check the unit of the file, or state `unit`",
            largest * 1e-3
        )));
    }
    if error.component.is_angular() {
        let angles = || readings.readings.iter().map(|reading| reading.deviation);
        let highest = angles().fold(f64::NEG_INFINITY, f64::max);
        let varies = highest - angles().fold(f64::INFINITY, f64::min);
        if varies > ANGLE_NEVER_VARIES {
            return Err(file.error(format!(
                "found angles that vary by {:.1} mrad, expected less than {:.0} mrad: are they in another unit? arcsec, urad, mrad and deg are read; state `unit`, or write it into the header of the file",
                varies * 1e-3,
                ANGLE_NEVER_VARIES * 1e-3
            )));
        }
    }
    let Some(axis) = machine.axis(error.axis) else {
        return Ok(());
    };
    let [low, high] = axis.travel;
    let mut targets = readings.readings.iter().map(|reading| reading.target);
    if let Some([first, last]) = ends(readings)
        && !targets.any(|target| axis.may_stand_at(target))
    {
        let unit = error.axis.kind().coordinate_unit();
        return Err(file.error(format!(
            "found targets from {first} to {last} {unit}, expected some within the travel of {}, {low} to {high} {unit}",
            error.axis
        )));
    }
    Ok(())
}

/// Refuses a stated value (µm or µrad) of a size that only a wrong unit gives.
pub(crate) fn refuse_value(
    value: &Value<'_>,
    kind: AxisKind,
    micro: f64,
) -> Result<(), InputError> {
    if micro.abs() <= NEVER_ABOVE {
        return Ok(());
    }
    let unit = match kind {
        AxisKind::Linear => "mm",
        AxisKind::Rotary => "mrad",
    };
    Err(value.error(format!(
        "found {:.0} {unit}, expected less than 100 {unit}: check its unit",
        micro * 1e-3
    )))
}
