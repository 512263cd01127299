//! Location and squareness errors whose stated value the observations contradict, and would not with another sign, in another unit, halved
//! or doubled.

use volcomp_identify::{IdentifyError, Observations, Parameter, identify};
use volcomp_vocabulary::{Displacement, ErrorName, Urad};

use crate::{
    calibration_file::{CalibrationFile, Location, SquarenessSource},
    error::CalibrateError,
    identified::CHANGE,
    lines_share::LinesShare,
    locations::located,
    stages::Stages,
};

/// The observations contradict a value where they want another by so many of their and its standard uncertainties together.
const CONTRADICTED: f64 = 4.0;
/// The opposite sign fits where the observations want it but for so much of the value.
const SIGN_FITS: f64 = 0.5;
/// Another size fits where the observations want it but for so much of it.
const SIZE_FITS: f64 = 0.1;

/// What may have been done to a value: the factor that undoes it, its words, and what to look at.
const FACTORS: [(f64, &str, &str); 5] = [
    (
        -1.0,
        "the opposite sign",
        "does the instrument count the other way? `sign` in its table turns it",
    ),
    (1e3, "1000 times the value", "is it in mm or mrad?"),
    (1e-3, "a thousandth of the value", "is it in nm or nrad?"),
    (
        0.5,
        "half the value",
        "an indicator that is turned by 180° with the axis shows twice the error: was it halved?",
    ),
    (2.0, "twice the value", "was it halved twice?"),
];

/// A value that a calibration file states.
struct Stated {
    /// Where it stands: a location, or a squareness, of the file.
    place: Place,
    error: ErrorName,
    /// µm or µrad, and its standard uncertainty.
    value: f64,
    uncertainty: f64,
}

#[derive(Clone, Copy)]
enum Place {
    Location(usize),
    Squareness(usize),
}

impl Stated {
    /// All values of a file.
    fn all(file: &CalibrationFile) -> Vec<Self> {
        let locations = file.locations.iter().enumerate();
        let locations = locations.map(|(place, of)| Self {
            place: Place::Location(place),
            error: of.error,
            value: of.value,
            uncertainty: of.uncertainty,
        });
        let squareness = file.squareness.iter().enumerate();
        let squareness = squareness.filter_map(|(place, of)| match of.source {
            SquarenessSource::Value(value) => Some(Self {
                place: Place::Squareness(place),
                error: of.error,
                value: value.0,
                uncertainty: file.uncertainty.square_urad,
            }),
            SquarenessSource::Slopes { .. } | SquarenessSource::Diagonals => None,
        });
        locations.chain(squareness).collect()
    }

    /// The file with another value in its place.
    fn with(&self, file: &CalibrationFile, value: f64) -> CalibrationFile {
        let mut other = file.clone();
        match self.place {
            Place::Location(place) => other.locations[place].value = value,
            Place::Squareness(place) => {
                other.squareness[place].source = SquarenessSource::Value(Urad(value));
            }
        }
        other
    }

    fn table(&self) -> &'static str {
        match self.place {
            Place::Location(_) => "[[location]]",
            Place::Squareness(_) => "[[squareness]]",
        }
    }
}

/// Notes on the values of a file that the observations contradict, and would not with another sign or size.
pub(crate) fn other_values(lines: &LinesShare<'_>) -> Result<Vec<String>, CalibrateError> {
    // The way to the opposite, and more from a value that is much smaller than what may be wanted of it.
    let step = |value: f64| {
        if 2.0 * value.abs() > CHANGE {
            -2.0 * value
        } else {
            CHANGE
        }
    };
    let all = Stated::all(lines.file);
    let mut changed = Vec::new();
    for stated in &all {
        let file = stated.with(lines.file, stated.value + step(stated.value));
        changed.push(lines.fitted(&file)?.machine);
    }
    let wanted = lines.response.wanted(&changed)?;
    let mut notes = Vec::new();
    for (stated, wanted) in all.iter().zip(wanted) {
        let value = stated.value;
        let Some(wanted) = wanted.filter(|_| value != 0.0) else {
            continue;
        };
        // How many times the value is wanted.
        let one = (step(value) / value).abs();
        let times = 1.0 + wanted.share * step(value) / value;
        let uncertainty = (one * wanted.uncertainty).hypot(stated.uncertainty / value.abs());
        if (times - 1.0).abs() <= CONTRADICTED * uncertainty {
            continue;
        }
        let fits = |factor: f64| {
            let near = if factor < 0.0 {
                SIGN_FITS
            } else {
                SIZE_FITS * factor
            };
            // Nothing of the value is not a thousandth of it.
            (times - factor).abs() < near && times.abs() > one * wanted.uncertainty
        };
        let fitting = FACTORS.iter().find(|(factor, ..)| fits(*factor));
        notes.extend(fitting.map(|factor| contradicted(stated, *factor)));
    }
    Ok(notes)
}

fn contradicted(of: &Stated, (factor, words, why): (f64, &str, &str)) -> String {
    let error = of.error;
    let [stated, other] = [of.value, factor * of.value]
        .map(|micro| Displacement::from_micro(error.component.kind(), micro));
    let digits = if of.value.abs() < 1.0 { 4 } else { 1 };
    let table = of.table();
    format!(
        "{error} in {table}: the observations contradict its {stated:.digits$} and fit with {words}, {other:.1}: {why}"
    )
}

/// The reason why observations are refused: a stated location error where another sign or size of it lets them be, else the rows.
pub(crate) fn refused(
    file: &CalibrationFile,
    observations: &Observations,
    rows: IdentifyError,
) -> CalibrateError {
    use IdentifyError::{FarRow, FarRows, Jump, MovedSphere};
    if !matches!(
        rows,
        FarRow { .. } | FarRows { .. } | Jump { .. } | MovedSphere { .. }
    ) {
        return rows.into();
    }
    let mut best: Option<(f64, String)> = None;
    for stated in Stated::all(file) {
        for factor in FACTORS {
            let other = stated.with(file, factor.0 * stated.value);
            let Some(left) = left_with(&other, observations) else {
                continue;
            };
            if best.as_ref().is_none_or(|(least, _)| left < *least) {
                best = Some((left, contradicted(&stated, factor)));
            }
        }
    }
    match best {
        Some((_, stated)) => CalibrateError::Stated {
            stated,
            rows: Box::new(rows),
        },
        None => rows.into(),
    }
}

/// What is left of the rows with the values of this file, root mean square; `None` where they are refused.
fn left_with(file: &CalibrationFile, observations: &Observations) -> Option<f64> {
    let known = located(file).ok()?;
    let mut observations = observations.clone();
    observations.machine = Stages::of(file, &known, || ()).ok()?.machine;
    observations.folds = 0;
    let found = identify(&observations, |_, _| {}).ok()?;
    Some(found.residual.rms_um)
}

/// Notes on constants of error motions that were found with about the size of the stated location error of their axis and direction, and
/// take it away.
pub(crate) fn cancelled(locations: &[Location], found: &[Parameter]) -> Vec<String> {
    /// A constant is found where it is so many times its standard uncertainty.
    const FOUND: f64 = 4.0;
    /// It takes a value away that it is so many times as large as: half of one that is twice too large, twice one with the wrong sign.
    const PARTS: [f64; 2] = [0.4, 2.5];
    let mut notes = Vec::new();
    for location in locations {
        let error = location.error;
        let motion = ErrorName::motion(error.component, error.axis);
        let name = format!("{motion} constant");
        let Some(constant) = found.iter().find(|parameter| parameter.name == name) else {
            continue;
        };
        // The sign depends on which side of the machine the axis is.
        let part = (constant.value / location.value).abs();
        let known = constant.uncertainty.unwrap_or(f64::INFINITY);
        if (PARTS[0]..=PARTS[1]).contains(&part) && constant.value.abs() > FOUND * known {
            let [value, stated] = [constant.value, location.value]
                .map(|micro| Displacement::from_micro(error.component.kind(), micro));
            notes.push(format!(
                "{name}, found as {value:.1}, takes away much of {error} in [[location]], stated as {stated:.1}: is the stated value right in sign and unit, and was the reading of an indicator that turned by 180° halved?"
            ));
        }
    }
    notes
}
