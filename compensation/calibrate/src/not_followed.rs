//! Curves of the automatic choice that do not follow their readings.

use volcomp_vocabulary::{ErrorName, Um, Urad};

use crate::fitted_curve::FittedCurve;

/// A warning for each error whose chosen curve leaves more of the readings than these scatter.
pub(crate) fn not_followed(curves: &[FittedCurve]) -> Vec<String> {
    let mut told: Vec<ErrorName> = Vec::new();
    let mut warnings = Vec::new();
    for curve in curves {
        let unit = if curve.error.component.is_angular() {
            Urad::SYMBOL
        } else {
            Um::SYMBOL
        };
        let choice = curve.choice.as_ref();
        if let Some(said) = choice.and_then(|choice| choice.not_followed(unit))
            && !told.contains(&curve.error)
        {
            told.push(curve.error);
            warnings.push(format!("{}: {said}", curve.error));
        }
    }
    warnings
}
