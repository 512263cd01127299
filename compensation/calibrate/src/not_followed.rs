//! Curves that do not follow their readings, or that these do not bear out between targets.

use volcomp_vocabulary::{ErrorName, Um, Urad};

use crate::{fitted_curve::FittedCurve, fitted_line::FittedLine};

/// A warning for each error whose chosen curve leaves more of the readings than these scatter, whose targets are too sparse, or whose curve swings
/// between them.
pub(crate) fn not_followed(curves: &[FittedCurve], lines: &[FittedLine]) -> Vec<String> {
    let mut warnings = Vec::new();
    let mut rest = curves;
    // The branches of an error stand one after the other; one of them speaks for both.
    while let Some(curve) = rest.first() {
        let error = curve.error;
        let (branches, others) = rest.split_at(
            rest.iter()
                .take_while(|branch| branch.error == error)
                .count(),
        );
        rest = others;
        let unit = if error.component.is_angular() {
            Urad::SYMBOL
        } else {
            Um::SYMBOL
        };
        let choice = curve.choice.as_ref();
        if let Some(said) = choice.and_then(|choice| choice.not_followed(unit)) {
            warnings.push(format!("{error}: {said}"));
        }
        let along = error.axis.kind().coordinate_unit();
        let said = branches
            .iter()
            .map(|branch| branch.between.warnings(unit, along))
            .find(|said| !said.is_empty());
        for said in said.into_iter().flatten() {
            let files = files(lines, error);
            warnings.push(format!("{files}{error}, axis {}: {said}", error.axis));
        }
    }
    warnings
}

/// `a.csv, b.csv: `, the files of an error.
fn files(lines: &[FittedLine], error: ErrorName) -> String {
    let of_error = lines.iter().filter(|line| line.error == error);
    let mut files: Vec<&str> = of_error
        .flat_map(|line| &line.sources)
        .map(|source| source.file.as_str())
        .collect();
    files.dedup();
    if files.is_empty() {
        String::new()
    } else {
        files.join(", ") + ": "
    }
}
