//! Checks that stop a wrong number: refusals of lines that cannot be what the calibration file says, and notes on results that could
//! mislead.

use volcomp_document::Note;
use volcomp_vocabulary::{Displacement, ErrorName, Urad};

use crate::{
    calibration_file::{CalibrationFile, SquarenessSource},
    error::CalibrateError,
    identified::CHANGE,
    lines_share::LinesShare,
};

/// A location or squareness error that a calibration file states, µm or µrad, with its standard uncertainty.
struct Stated {
    table: &'static str,
    place: usize,
    error: ErrorName,
    value: f64,
    uncertainty: f64,
}

impl Stated {
    fn all(file: &CalibrationFile) -> Vec<Self> {
        let locations = file.locations.iter().enumerate();
        let locations = locations.map(|(place, of)| Self {
            table: "location",
            place,
            error: of.error,
            value: of.value,
            uncertainty: of.uncertainty,
        });
        let squareness = file.squareness.iter().enumerate();
        let squareness = squareness.filter_map(|(place, of)| match of.source {
            SquarenessSource::Value(value) => Some(Self {
                table: "squareness",
                place,
                error: of.error,
                value: value.0,
                uncertainty: file.uncertainty.square_urad,
            }),
            SquarenessSource::Slopes { .. } | SquarenessSource::Diagonals => None,
        });
        locations.chain(squareness).collect()
    }

    /// The file with the value changed by `step`.
    fn changed(&self, file: &CalibrationFile, step: f64) -> CalibrationFile {
        let mut other = file.clone();
        if self.table == "location" {
            other.locations[self.place].value += step;
        } else {
            let value = SquarenessSource::Value(Urad(self.value + step));
            other.squareness[self.place].source = value;
        }
        other
    }
}

/// Stated values that the observations contradict: with another sign, in another unit, halved or doubled.
pub(crate) fn contradicted_values(lines: &LinesShare<'_>) -> Result<Vec<Note>, CalibrateError> {
    /// A contradiction in units of both standard uncertainties together, and as a share of the value.
    const UNCERTAINTIES: f64 = 4.0;
    const SHARE: f64 = 0.4;
    let all = Stated::all(lines.file);
    // To the opposite value, and further from one that is much smaller than what may be wanted of it.
    let step = |of: &Stated| {
        if 2.0 * of.value.abs() > CHANGE {
            -2.0 * of.value
        } else {
            CHANGE
        }
    };
    let machines = all.iter().map(|of| {
        let file = of.changed(lines.file, step(of));
        lines.fitted(&file).map(|stages| stages.machine)
    });
    let machines: Vec<_> = machines.collect::<Result<_, _>>()?;
    let mut notes = Vec::new();
    for (of, wanted) in all.iter().zip(lines.response.wanted(&machines)?) {
        let Some(wanted) = wanted else { continue };
        let change = wanted.share * step(of);
        let own = (wanted.uncertainty * step(of)).abs();
        if change.abs() > UNCERTAINTIES * own.hypot(of.uncertainty)
            && change.abs() > SHARE * of.value.abs()
        {
            let [stated, fits] = [of.value, of.value + change]
                .map(|micro| Displacement::from_micro(of.error.component.kind(), micro));
            let digits = if of.value.abs() < 1.0 { 4 } else { 1 };
            let what = format!(
                "the observations contradict its {stated:.digits$} and fit with {fits:.1}, standard uncertainty {own:.1}"
            );
            let place = format!("{} in [[{}]]", of.error, of.table);
            notes.push(Note::warning(place, what).hint("check its sign and unit"));
        }
    }
    Ok(notes)
}
