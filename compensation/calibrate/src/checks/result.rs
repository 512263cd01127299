//! Checks of the result: curves that the readings do not support, and stated values that observations contradict.

use volcomp_document::Note;
use volcomp_vocabulary::{Displacement, ErrorName, Um, Urad};

use crate::{
    branches::FittedCurve,
    checks::lines::Stated,
    error::CalibrateError,
    fitted::FittedLine,
    line_contribution::{CHANGE, LineContribution},
};

/// Warning for each error whose chosen curve leaves residuals larger than the scatter of the readings, whose targets
/// are too sparse, or whose curve oscillates between them.
pub(crate) fn not_followed(curves: &[FittedCurve], lines: &[FittedLine]) -> Vec<String> {
    let mut warnings = Vec::new();
    let mut rest = curves;
    // The branches of an error are adjacent and have the same choice of method.
    while let Some(curve) = rest.first() {
        let error = curve.error;
        let (branches, others) =
            rest.split_at(rest.iter().take_while(|branch| branch.error == error).count());
        rest = others;
        let unit = if error.component.is_angular() { Urad::SYMBOL } else { Um::SYMBOL };
        let choice = curve.choice.as_ref();
        let of_curves = || {
            let mut said = branches.iter().map(|branch| &branch.between);
            said.find_map(|between| between.not_followed(unit))
        };
        let said = choice.and_then(|choice| choice.not_followed(unit));
        if let Some(said) = said.or_else(of_curves) {
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

/// Files of an error as a prefix: `a.csv, b.csv: `.
fn files(lines: &[FittedLine], error: ErrorName) -> String {
    let of_error = lines.iter().filter(|line| line.error == error);
    let mut files: Vec<&str> =
        of_error.flat_map(|line| &line.sources).map(|source| source.file.as_str()).collect();
    files.dedup();
    if files.is_empty() { String::new() } else { files.join(", ") + ": " }
}

/// Stated values that contradict the observations by more than their uncertainties, such as values with wrong sign or unit, halved or doubled.
pub(crate) fn contradicted_values(
    lines: &LineContribution<'_>,
) -> Result<Vec<(ErrorName, Note)>, CalibrateError> {
    /// Minimum contradiction as a multiple of the combined standard uncertainty.
    const UNCERTAINTIES: f64 = 4.0;
    /// Minimum contradiction as a fraction of the value.
    const SHARE: f64 = 0.4;
    let all = Stated::all(lines.file);
    // The change to the opposite value; for a value below half of `CHANGE`, the change `CHANGE`.
    let step = |of: &Stated| {
        if 2.0 * of.value.abs() > CHANGE { -2.0 * of.value } else { CHANGE }
    };
    let machines = all.iter().map(|of| {
        let file = of.changed(lines.file, step(of));
        lines.fitted(&file).map(|stages| stages.machine)
    });
    let machines: Vec<_> = machines.collect::<Result<_, _>>()?;
    let mut notes = Vec::new();
    for (of, wanted) in all.iter().zip(lines.response.supported_shares(&machines)?) {
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
            let note = Note::warning(place, what).hint("check its sign and unit");
            notes.push((of.error, note));
        }
    }
    Ok(notes)
}
