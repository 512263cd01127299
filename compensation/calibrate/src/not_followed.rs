//! Curves of the automatic choice that do not follow their readings.

use volcomp_fit::Score;
use volcomp_vocabulary::{Displacement, ErrorName};

use crate::fitted_curve::FittedCurve;

/// A warning for each error whose chosen curve leaves more of the readings than these scatter.
pub(crate) fn not_followed(curves: &[FittedCurve]) -> Vec<String> {
    let mut told: Vec<ErrorName> = Vec::new();
    let mut warnings = Vec::new();
    for curve in curves {
        let score = curve.choice.as_ref().and_then(|choice| choice.chosen());
        let Some(score) = score.filter(|score| !score.follows) else {
            continue;
        };
        if !told.contains(&curve.error) {
            told.push(curve.error);
            warnings.push(warning(curve.error, score));
        }
    }
    warnings
}

fn warning(error: ErrorName, score: &Score) -> String {
    let largest = Displacement::from_micro(error.component.kind(), score.largest_residual);
    format!(
        "{error}: the curve chosen, {}, does not follow the readings: it leaves up to {largest:.1} of them, more than the runs scatter, and a curve that follows them predicts targets left out far worse. Look at the readings for an error with a period shorter than the spacing of the targets or for single targets that are wrong; measure more densely, or state `curve`",
        score.method
    )
}
