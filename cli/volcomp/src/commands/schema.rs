//! The hidden command `schema`: JSON Schemas of the documents of this program.

use std::path::PathBuf;

use schemars::{JsonSchema, Schema, generate::SchemaSettings};
use serde_json::json;

use super::{
    Answer, age, axes,
    calibrate::{Calibrate, Drafted},
    check, compile, completions,
    correct::CorrectionAt,
    demo, dh,
    diagonals::Diagonals,
    error::ErrorAt,
    evaluation::Files,
    export, expression, fit,
    fit_thermal::FitThermal,
    form,
    identify::Identified,
    import,
    inspect::Contents,
    iso230::{circle::CircularTest, diagonals::MeasuredDiagonals, positioning::PositioningTest},
    map::Map,
    map_table, nc, report, sensitivity, simulate,
    squareness::{SquareTest, SquarenessTest},
    straightness::StraightnessTest,
    write_file,
};
use crate::{
    arguments::OneOrMany,
    failure::{Failure, FailureDocument},
};

/// Write the JSON Schemas of all documents of --json
#[derive(clap::Args)]
pub(crate) struct SchemaArguments {
    /// Folder for the files
    folder: PathBuf,
}

pub(crate) fn run(arguments: &SchemaArguments) -> Result<Answer, Failure> {
    let folder = &arguments.folder;
    let mut files = Vec::new();
    for (name, schema) in ALL {
        let text = serde_json::to_string_pretty(&schema())
            .map_err(|e| Failure::Work(format!("the schema of {name}: {e}")))?;
        files.push((format!("volcomp-{name}.json"), text + "\n"));
    }
    std::fs::create_dir_all(folder)
        .map_err(|e| Failure::in_file(folder, format_args!("cannot be made a folder: {e}")))?;
    for (name, text) in &files {
        write_file(&folder.join(name), text)?;
    }
    let names: Vec<&str> = files.iter().map(|(name, _)| name.as_str()).collect();
    let document = json!({ "folder": folder.display().to_string(), "files": names });
    let text = format!("{} files in {}\n", names.len(), folder.display());
    Answer::new(&document, text, Vec::new())
}

/// Name of a command, and the function that builds the schema of its document.
type Named = (&'static str, fn() -> Schema);

/// The documents by command name. The file of a schema is `volcomp-NAME.json`. Variants of a command have separate
/// names: `probe-list` for `probe --list`, `nc-average` for `nc --average`, `calibrate-draft` for `calibrate --draft`,
/// `iso230-circle` and `iso230-diagonals` for parts 4 and 6, `squareness-lengths` for `squareness --lengths`.
const ALL: &[Named] = &[
    ("check", schema::<check::Check>),
    ("compile", schema::<compile::Compile>),
    ("completions", schema::<completions::Completions>),
    ("error", schema::<OneOrMany<ErrorAt>>),
    ("correct", schema::<OneOrMany<CorrectionAt>>),
    ("diagonals", schema::<Diagonals>),
    ("map", schema::<Map>),
    ("map-table", schema::<map_table::MapTable>),
    ("export", schema::<export::Export>),
    ("import", schema::<import::Import>),
    ("axes", schema::<axes::Axes>),
    ("dh", schema::<dh::Dh>),
    ("sensitivity", schema::<sensitivity::Effects>),
    ("expression", schema::<expression::Formulas>),
    ("fit", schema::<fit::FittedCurve>),
    ("fit-thermal", schema::<FitThermal<'_>>),
    ("calibrate", schema::<Calibrate>),
    ("calibrate-draft", schema::<Drafted>),
    ("report", schema::<report::WrittenReport>),
    ("identify", schema::<Identified>),
    ("iso230", schema::<Files<PositioningTest>>),
    ("iso230-circle", schema::<Files<CircularTest>>),
    ("iso230-diagonals", schema::<MeasuredDiagonals>),
    ("straightness", schema::<Files<StraightnessTest>>),
    ("squareness", schema::<SquarenessTest>),
    ("squareness-lengths", schema::<SquareTest>),
    ("form", schema::<form::EvaluatedForm>),
    ("inspect", schema::<Files<Contents>>),
    ("simulate", schema::<simulate::Simulate>),
    ("age", schema::<age::Age>),
    ("demo", schema::<demo::Demo>),
    ("probe", schema::<volcomp_devices::Probe>),
    ("probe-list", schema::<volcomp_devices::LocalDevices>),
    ("nc", schema::<nc::Nc>),
    ("nc-average", schema::<nc::NcAverage>),
    ("failure", schema::<FailureDocument>),
];

/// The JSON Schema (draft 2020-12) of a document.
fn schema<T: JsonSchema>() -> Schema {
    let settings = SchemaSettings::draft2020_12().for_serialize();
    settings.into_generator().into_root_schema_for::<T>()
}
