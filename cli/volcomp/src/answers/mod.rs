//! JSON documents that join or convert several results of the libraries, and `ALL`: every document of the program, whose
//! JSON Schemas `volcomp schema FOLDER` writes.

pub(crate) mod axes;
pub(crate) mod check;
pub(crate) mod export;
pub(crate) mod failure;
pub(crate) mod fit;
pub(crate) mod form;
pub(crate) mod import;
pub(crate) mod map_table;
pub(crate) mod nc;
pub(crate) mod program;
pub(crate) mod report;
pub(crate) mod sensitivity;
pub(crate) mod simulate;

use schemars::{JsonSchema, Schema, generate::SchemaSettings};

use crate::commands::{
    calibrate::Calibrate,
    calibrate_draft::Drafted,
    correct::CorrectionAt,
    diagonals::Diagonals,
    error::ErrorAt,
    fit_thermal::document::FitThermal,
    identify::Identified,
    inspect::Contents,
    iso230::{circle::CircularTest, diagonals::MeasuredDiagonals, positioning::PositioningTest},
    map::Map,
    several::Files,
    squareness::SquarenessTest,
    straightness::StraightnessTest,
};
use crate::points::OneOrMany;

/// The name of a command and the schema of its document.
type Named = (&'static str, fn() -> Schema);

/// The documents by the name of their command, `probe-list` for `probe --list`, `nc-average` for `nc --average`, `calibrate-draft` for `calibrate --draft`, `iso230-circle` and `iso230-diagonals` for its parts 4 and 6: `volcomp-NAME.json` is the file of the schema.
pub(crate) const ALL: &[Named] = &[
    ("check", schema::<check::Check>),
    ("compile", schema::<program::Compile>),
    ("completions", schema::<program::Completions>),
    ("error", schema::<OneOrMany<ErrorAt>>),
    ("correct", schema::<OneOrMany<CorrectionAt>>),
    ("diagonals", schema::<Diagonals>),
    ("map", schema::<Map>),
    ("map-table", schema::<map_table::MapTable>),
    ("export", schema::<export::Export>),
    ("import", schema::<import::Import>),
    ("axes", schema::<axes::Axes>),
    ("dh", schema::<axes::Dh>),
    ("sensitivity", schema::<sensitivity::Sensitivity>),
    ("expression", schema::<sensitivity::Expression>),
    ("fit", schema::<fit::Fit>),
    ("fit-thermal", schema::<FitThermal>),
    ("calibrate", schema::<Calibrate>),
    ("calibrate-draft", schema::<Drafted>),
    ("report", schema::<report::Report>),
    ("identify", schema::<Identified>),
    ("iso230", schema::<Files<PositioningTest>>),
    ("iso230-circle", schema::<Files<CircularTest>>),
    ("iso230-diagonals", schema::<MeasuredDiagonals>),
    ("straightness", schema::<Files<StraightnessTest>>),
    ("squareness", schema::<SquarenessTest>),
    ("form", schema::<form::Form>),
    ("inspect", schema::<Files<Contents>>),
    ("simulate", schema::<simulate::Simulate>),
    ("age", schema::<simulate::Age>),
    ("demo", schema::<simulate::Demo>),
    ("probe", schema::<volcomp_devices::Probe>),
    ("probe-list", schema::<volcomp_devices::LocalDevices>),
    ("nc", schema::<nc::Nc>),
    ("nc-average", schema::<nc::NcAverage>),
    ("failure", schema::<failure::Document>),
];

/// The JSON Schema (draft 2020-12) of a document.
fn schema<T: JsonSchema>() -> Schema {
    let settings = SchemaSettings::draft2020_12().for_serialize();
    settings.into_generator().into_root_schema_for::<T>()
}
