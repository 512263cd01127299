//! Where the errors of a machine come from, and whether the files named there are still the same.

use std::path::Path;

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_model::{Machine, Source, sha256_of};

use crate::table::{HEAD, fixed, folded, table, table_text, to_the_left};

/// Where the errors of the machine come from; residuals are in µm, those of angular errors in µrad.
#[derive(Debug, Serialize, JsonSchema)]
pub(super) struct Provenance {
    #[serde(flatten)]
    stated: volcomp_model::Provenance,
    /// Every file that errors were found from, once, and what it is now.
    files: Vec<FileState>,
}

/// A file that errors were found from.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, JsonSchema)]
struct FileState {
    /// Its name, as the calibration file had it.
    file: String,
    /// The SHA-256 that it had.
    sha256: String,
    /// What it is now: `same`, `different` or `not at hand`.
    state: &'static str,
}

impl FileState {
    fn of(source: &Source, folder: &Path) -> Self {
        let path = folder.join(&source.file);
        // A pipe of that name would be waited for.
        let hash = path.is_file().then(|| sha256_of(&path));
        Self {
            file: source.file.clone(),
            sha256: source.sha256.clone(),
            state: match hash {
                Some(Ok(hash)) if hash == source.sha256 => "same",
                Some(Ok(_)) => "different",
                Some(Err(_)) | None => "not at hand",
            },
        }
    }

    fn is(&self, source: &Source) -> bool {
        self.file == source.file && self.sha256 == source.sha256
    }
}

impl Provenance {
    /// The provenance that the machine file states, with the state of each file below `folder`; `None` where it states nothing.
    pub(super) fn of(machine: &Machine, folder: &Path) -> Option<Self> {
        let stated = machine.provenance();
        let mut files: Vec<FileState> = Vec::new();
        for source in stated.errors.iter().flat_map(|of| &of.sources) {
            if !files.iter().any(|file| file.is(source)) {
                files.push(FileState::of(source, folder));
            }
        }
        files.sort_unstable();
        (!stated.is_empty()).then(|| Self {
            stated: stated.clone(),
            files,
        })
    }

    /// A note for each file that is not the one which the errors were found from.
    pub(super) fn notes(&self) -> Vec<String> {
        let changed = self.files.iter().filter(|file| file.state == "different");
        let note = |file: &FileState| {
            let of_it = (self.stated.errors.iter())
                .filter(|of| of.sources.iter().any(|source| file.is(source)));
            let errors: Vec<String> = of_it.map(|of| of.error.to_string()).collect();
            format!(
                "{}: not the file that {} was found from: its SHA-256 is another than the machine file names. It has changed since, or is another test",
                file.file,
                errors.join(" ")
            )
        };
        changed.map(note).collect()
    }

    /// The provenance for people.
    pub(super) fn text(&self) -> String {
        let stated = &self.stated;
        let mut said = Vec::new();
        said.extend(stated.version.as_ref().map(|v| format!("volcomp {v}")));
        said.extend(stated.serial.as_ref().map(|s| format!("serial number {s}")));
        said.extend(stated.date.clone());
        let mut text = format!("\n{HEAD}Where the errors come from{HEAD:#}\n");
        if !said.is_empty() {
            text += &folded(&said.join(", "), " ");
        }
        let mut rows = table(&["error", "residual", "", "found by"]);
        to_the_left(&mut rows, &[2, 3]);
        for of in &stated.errors {
            let residual = of.residual;
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
        let files = &self.files;
        let with = |state: &str| files.iter().filter(|file| file.state == state).count();
        if !files.is_empty() {
            text += &folded(
                &format!(
                    "{} measurement files: {} unchanged, {} changed, {} not at hand (--files DIR)",
                    files.len(),
                    with("same"),
                    with("different"),
                    with("not at hand")
                ),
                " ",
            );
        }
        text
    }
}
