//! Where the errors of a machine come from, and whether the files named there are still the same.

use std::path::Path;

use volcomp_model::{Machine, Origin, Source, sha256_of};

use crate::{
    answers::check::{Origin as OriginAnswer, Provenance, SourceFile},
    table::{HEAD, fixed, folded, table, table_text, to_the_left},
};

/// What the machine file tells, with the state of each file as it is found from `folder`; none where it tells nothing.
pub(super) fn provenance(machine: &Machine, folder: &Path) -> Option<Provenance> {
    let told = machine.provenance();
    (!told.is_empty()).then(|| Provenance {
        version: told.version.clone(),
        serial: told.serial.clone(),
        date: told.date.clone(),
        errors: told.errors.iter().map(|of| origin(of, folder)).collect(),
    })
}

fn origin(of: &Origin, folder: &Path) -> OriginAnswer {
    let is_angular = of.error.component.is_angular();
    let um = |value: Option<f64>| value.filter(|_| !is_angular);
    let urad = |value: Option<f64>| value.filter(|_| is_angular);
    OriginAnswer {
        error: of.error,
        method: of.method.clone(),
        rule: of.rule.clone(),
        residual_um: um(of.residual),
        residual_urad: urad(of.residual),
        leave_one_out_um: um(of.leave_one_out),
        leave_one_out_urad: urad(of.leave_one_out),
        files: of.sources.iter().map(|file| source(file, folder)).collect(),
    }
}

fn source(of: &Source, folder: &Path) -> SourceFile {
    let path = folder.join(&of.file);
    // A pipe of that name would be waited for.
    let hash = path.is_file().then(|| sha256_of(&path));
    SourceFile {
        file: of.file.clone(),
        sha256: of.sha256.clone(),
        state: match hash {
            Some(Ok(hash)) if hash == of.sha256 => "same",
            Some(Ok(_)) => "different",
            Some(Err(_)) | None => "not at hand",
        },
        runs: of.runs,
        targets: of.targets,
        at: (of.at.iter())
            .map(|(axis, place)| (axis.to_string(), *place))
            .collect(),
        date: of.date.clone(),
    }
}

/// A note for each file that is not the one which the errors were found from.
pub(super) fn notes(provenance: &Provenance) -> Vec<String> {
    let mut told: Vec<(&str, Vec<String>)> = Vec::new();
    for of in &provenance.errors {
        for file in of.files.iter().filter(|file| file.state == "different") {
            match told.iter_mut().find(|(name, _)| *name == file.file) {
                Some((_, errors)) => errors.push(of.error.to_string()),
                None => told.push((&file.file, vec![of.error.to_string()])),
            }
        }
    }
    let note = |(file, errors): (&str, Vec<String>)| {
        format!(
            "{file}: not the file that {} was found from: its SHA-256 is another than the machine file names. It has changed since, or is another test",
            errors.join(" ")
        )
    };
    told.into_iter().map(note).collect()
}

/// The provenance for people.
pub(super) fn text(provenance: &Provenance) -> String {
    let mut said = Vec::new();
    said.extend(provenance.version.as_ref().map(|v| format!("volcomp {v}")));
    said.extend(
        provenance
            .serial
            .as_ref()
            .map(|s| format!("serial number {s}")),
    );
    said.extend(provenance.date.clone());
    let mut text = format!("\n{HEAD}Where the errors come from{HEAD:#}\n");
    if !said.is_empty() {
        text += &folded(&said.join(", "), " ");
    }
    let mut rows = table(&["error", "residual", "", "found by"]);
    to_the_left(&mut rows, &[2, 3]);
    for of in &provenance.errors {
        let residual = of.residual_um.or(of.residual_urad);
        rows.add_row([
            of.error.to_string(),
            residual.map_or(String::new(), |residual| fixed(residual, 2)),
            residual
                .map_or("", |_| of.error.component.symbol())
                .to_owned(),
            of.method.clone(),
        ]);
    }
    text += &table_text(&rows);
    let files = provenance.errors.iter().flat_map(|of| &of.files);
    let mut names: Vec<(&str, &str)> = files.map(|file| (file.state, &*file.file)).collect();
    names.sort_unstable();
    names.dedup();
    let with = |state: &str| names.iter().filter(|(own, _)| *own == state).count();
    if !names.is_empty() {
        text += &folded(
            &format!(
                "{} measurement files: {} unchanged, {} changed, {} not at hand (--files DIR)",
                names.len(),
                with("same"),
                with("different"),
                with("not at hand")
            ),
            " ",
        );
    }
    text
}
