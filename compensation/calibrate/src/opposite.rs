//! Location errors whose sign the observations beside them contradict.

use volcomp_vocabulary::Displacement;

use crate::{calibration_file::Location, error::CalibrateError, lines_share::LinesShare};

/// The observations contradict a value where they want another by so many of their and its standard uncertainties together.
const CONTRADICTED: f64 = 4.0;
/// The opposite sign fits where the observations want so much of the way to it, to both sides.
const FITS: f64 = 0.25;

/// Notes on the location errors of a file that the observations contradict, and would not with the opposite sign.
pub(crate) fn opposite(lines: &LinesShare<'_>) -> Result<Vec<String>, CalibrateError> {
    let mut turned = Vec::new();
    for place in 0..lines.file.locations.len() {
        let mut file = lines.file.clone();
        file.locations[place].value *= -1.0;
        turned.push(lines.fitted(&file)?.machine);
    }
    let wanted = lines.response.wanted(&turned)?;
    let mut notes = Vec::new();
    for (location, wanted) in lines.file.locations.iter().zip(wanted) {
        let Location {
            error,
            value,
            uncertainty,
        } = *location;
        let Some(wanted) = wanted else { continue };
        // Of the way from the value to its opposite.
        let known = (wanted.uncertainty).hypot(uncertainty / (2.0 * value.abs()));
        if wanted.share > CONTRADICTED * known && (wanted.share - 1.0).abs() < FITS {
            let [stated, other] = [value, -value]
                .map(|micro| Displacement::from_micro(error.component.kind(), micro));
            notes.push(format!(
                "{error} in [[location]]: the observations contradict its {stated:.1} and fit with the opposite sign, {other:.1}: does the instrument count the other way? `sign` in its table turns it"
            ));
        }
    }
    Ok(notes)
}
