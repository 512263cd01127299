//! What is odd about a line that is not refused, and about values that are stated.

use volcomp_metrology::{
    Measurement, MotionKind, ODD_ABOVE, ReferenceLine, SMALL_BELOW, errors_named,
};
use volcomp_model::{Axis, Machine};
use volcomp_vocabulary::{Component, Displacement, ErrorName, Um, Urad};

use crate::{
    calibration_file::{CalibrationFile, Line, SquarenessSource},
    same_machine::other_machine,
};

/// A line over a smaller share of the travel is noted.
const SHORT_BELOW: f64 = 0.5;
/// A target so much of the travel beyond its end is noted: targets may stand a little beyond for the overrun.
const BEYOND_ABOVE: f64 = 0.02;

/// The smallest and the largest target.
pub(crate) fn ends(readings: &Measurement) -> Option<[f64; 2]> {
    let targets = readings.readings.iter().map(|reading| reading.target);
    targets.fold(None, |ends, target| {
        let [first, last] = ends.unwrap_or([target; 2]);
        Some([target.min(first), target.max(last)])
    })
}

/// Notes on location and squareness errors that are stated and odd, or stated with an odd uncertainty.
pub(crate) fn odd_values(file: &CalibrationFile) -> Vec<String> {
    let locations = file.locations.iter();
    let locations = locations.map(|location| ("location", location.error, location.value));
    let squares = file.squareness.iter().filter_map(|entry| {
        let SquarenessSource::Value(value) = entry.source else {
            return None;
        };
        Some(("squareness", entry.error, value.0))
    });
    let odd = locations
        .chain(squares)
        .filter(|(_, _, value)| value.abs() > ODD_ABOVE);
    let sized = |error: ErrorName, micro| Displacement::from_micro(error.component.kind(), micro);
    let mut notes: Vec<String> = odd
        .map(|(table, error, value)| {
            let size = sized(error, value);
            format!("{error} in [[{table}]]: {size:.0} is large for a machine tool: check its unit")
        })
        .collect();
    let unsure = file
        .locations
        .iter()
        .filter(|of| of.uncertainty > ODD_ABOVE);
    notes.extend(unsure.map(|of| {
        let size = sized(of.error, of.uncertainty);
        format!(
            "{} in [[location]]: a standard uncertainty of {size:.0} is large for a machine tool, and says that hardly anything is known of the error: check its unit",
            of.error
        )
    }));
    notes
}

/// What is said of targets that go beyond the travel of their axis.
pub(crate) fn beyond_travel(readings: &Measurement, axis: &Axis) -> Option<String> {
    let [first, last] = ends(readings)?;
    let [low, high] = axis.travel;
    let beyond = (low - first).max(last - high);
    let unit = axis.name.kind().coordinate_unit();
    (axis.modulo.is_none() && beyond > BEYOND_ABOVE * (high - low)).then(|| {
        format!(
            "targets from {first} to {last} {unit} go beyond the travel of {}, {low} to {high} {unit}: is it the right axis and machine?",
            axis.name
        )
    })
}

/// What is said of a straightness that is large also without the line along which the optics were set up, and of tilts of a bridge that
/// are large without their mean.
fn large_without_line(line: &Line) -> Option<String> {
    let points = line.readings.mean_curve();
    let (left, what, unit) = if line.setup.reads_angles() {
        let mean = points.iter().map(|p| p.1).sum::<f64>() / points.len() as f64;
        let left = points.iter().map(|p| p.1 - mean).collect::<Vec<f64>>();
        (left, "a tilt that differs from the mean by", Urad::SYMBOL)
    } else {
        let reference = ReferenceLine::least_squares(&points).ok()?;
        let left = reference.removed_from(&points);
        let left = left.iter().map(|p| p.1).collect();
        (left, "a deviation from the straight line of", Um::SYMBOL)
    };
    let largest = left
        .iter()
        .fold(0.0_f64, |largest, of| largest.max(of.abs()));
    let state = if line.readings.unit.is_none() {
        ", or state `unit`"
    } else {
        ""
    };
    (largest > ODD_ABOVE).then(|| {
        format!(
            "{what} {largest:.0} {unit} is large for a machine tool: check the unit of the file{state}"
        )
    })
}

/// Notes on what is odd about a line that is not refused.
pub(crate) fn odd(line: &Line, machine: &Machine) -> Vec<String> {
    let error = line.setup.error;
    let mut notes = Vec::new();
    let mut note = |text: String| {
        notes.push(format!("{} ({}): {text}", line.file.display(), line.place));
    };
    let (Some([first, last]), Some(axis)) = (ends(&line.readings), machine.axis(error.axis)) else {
        return notes;
    };
    let [low, high] = axis.travel;
    let unit = error.axis.kind().coordinate_unit();
    let travel = high - low;
    if let Some(said) = beyond_travel(&line.readings, axis) {
        note(said);
    }
    if last - first < SHORT_BELOW * travel {
        note(format!(
            "targets from {first} to {last} {unit} cover {:.0} % of the travel of {}: beyond them {error} keeps its end values",
            100.0 * (last - first) / travel,
            error.axis
        ));
    }
    // The slope of the instrument's own line makes straightness readings large, and bridge readings are summed up.
    let is_direct = MotionKind::of(error) != MotionKind::Straightness;
    let sizes = line.readings.readings.iter().map(|r| r.deviation.abs());
    let largest = sizes.fold(0.0, f64::max);
    if is_direct && largest > ODD_ABOVE {
        let largest_size = Displacement::from_micro(error.component.kind(), largest);
        let state = if line.readings.unit.is_none() {
            ", or state `unit`"
        } else {
            ""
        };
        note(format!(
            "a deviation of {largest_size:.0} is large for a machine tool: check the unit of the file{state}"
        ));
    }
    if !is_direct && let Some(said) = large_without_line(line) {
        note(said);
    }
    if let Some(said) = other_machine(&line.readings, machine) {
        note(said);
    }
    if let Some(other) = named_in_title(line) {
        note(format!(
            "the title of the file names {other}, expected {error}: is it the right file?"
        ));
    }
    if line.readings.unit.is_none() && largest > 0.0 && largest < SMALL_BELOW {
        let (taken, perhaps) = if line.setup.reads_angles() {
            ("µrad", "mrad")
        } else {
            ("µm", "mm")
        };
        note(format!(
            "the unit of the deviations is not stated, taken as {taken}; all are below {SMALL_BELOW} {taken}: are they {perhaps}? State `unit`"
        ));
    }
    notes
}

/// An error that the title of the file names where it does not name the error of the line.
fn named_in_title(line: &Line) -> Option<ErrorName> {
    let title = line.readings.metadata.title.as_deref()?;
    let names = errors_named(title);
    let other = *names.first()?;
    (!names.contains(&line.setup.error)).then_some(other)
}

/// A note that names the lines which state no `point` though tilts of their axis are known: the lever may have been
/// forgotten.
pub(crate) fn without_point(lines: &[Line], tilted: &Machine) -> Option<String> {
    let named = |line: &Line| {
        let error = line.setup.error;
        if error.component.is_angular() || line.setup.point_mcs.is_some() {
            return None;
        }
        let angular = Component::ALL.into_iter().filter(|c| c.is_angular());
        let tilts = angular.map(|component| ErrorName::motion(component, error.axis));
        let tilts: Vec<String> = tilts
            .filter(|tilt| tilted.error(*tilt).is_some())
            .map(|tilt| tilt.to_string())
            .collect();
        (!tilts.is_empty()).then(|| {
            format!(
                "{} ({}): {error} with {}",
                line.file.display(),
                line.place,
                tilts.join(" ")
            )
        })
    };
    let lines: Vec<String> = lines.iter().filter_map(named).collect();
    (!lines.is_empty()).then(|| {
        format!(
            "no `point` is stated for the lines below, so each error is taken as measured at the point of its axis, and the levers of the tilts named beside it are taken from there; state `point` where a line ran elsewhere: {}",
            lines.join("; ")
        )
    })
}
