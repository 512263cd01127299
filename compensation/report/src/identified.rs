//! Results of an identification from observations of the whole machine.

use volcomp_identify::{Identification, Observations, unit_symbol};

use crate::report::{Identified, Left, Parameter, SourceFile, Weighted};

pub(crate) fn identified(found: &Identification) -> Identified {
    let parameters = found.parameters.iter().map(|parameter| Parameter {
        name: parameter.name.clone(),
        value: parameter.value,
        uncertainty: parameter.uncertainty,
        unit: unit_symbol(parameter.unit).to_owned(),
        given_zero: parameter.given_zero.clone(),
    });
    let left = |of: volcomp_identify::Figures| Left {
        rms_um: of.rms_um,
        max_um: of.max_um,
        rows: of.rows,
    };
    let weighted =
        |(name, weight): &(String, f64)| Weighted { name: name.clone(), weight: *weight };
    let null = found.null.iter();
    let next = found.next.as_ref().map(|next| {
        let pose = next.pose.iter().map(|(axis, at)| format!("{axis} = {at:.1}"));
        let mut with: Vec<String> = pose.collect();
        with.extend(next.target.clone());
        with.extend(next.tool.as_ref().map(|tool| format!("tool {tool}")));
        format!("{} ({}): {}", with.join(", "), next.file, next.parameter)
    });
    Identified {
        parameters: parameters.collect(),
        rank: found.rank,
        of: found.parameters.len().saturating_sub(found.redundant.len()),
        score: found.score_of_determined,
        excess: found.excess,
        residual: left(found.residual),
        left_out: found.left_out.map(|of| left(of.figures)),
        judged: found.judged.map(left),
        null_space: null.map(|of| of.iter().map(weighted).collect()).collect(),
        redundant: found.redundant.clone(),
        next,
    }
}

/// Note on the unknowns that the observations do not determine, which leave their errors undecided; `None` without any.
pub(crate) fn left_open(found: &Identified) -> Option<String> {
    let open: Vec<&str> = found.left_open().collect();
    (!open.is_empty())
        .then(|| format!("not determined by the observations, taken as 0: {}", open.join(", ")))
}

pub(crate) fn files(observations: &Observations) -> impl Iterator<Item = SourceFile> {
    observations.observations.iter().map(|of| SourceFile {
        file: of.file.clone(),
        measures: of.kind.name().to_owned(),
        targets: of.rows.len(),
        runs: None,
        date: None,
    })
}
