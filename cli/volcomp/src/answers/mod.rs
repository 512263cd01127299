//! Every JSON document that the program writes, as a struct with its JSON Schema. One file for each command; `ALL`
//! lists them, and `volcomp schema FOLDER` writes their schemas.

pub(crate) mod axes;
pub(crate) mod calibrate;
pub(crate) mod calibrate_draft;
pub(crate) mod check;
pub(crate) mod diagonals;
pub(crate) mod export;
pub(crate) mod failure;
pub(crate) mod fit;
pub(crate) mod fit_thermal;
pub(crate) mod form;
pub(crate) mod identify;
pub(crate) mod import;
pub(crate) mod inspect;
pub(crate) mod iso230;
pub(crate) mod iso230_parts;
pub(crate) mod map;
pub(crate) mod map_table;
pub(crate) mod nc;
pub(crate) mod position;
pub(crate) mod probe;
pub(crate) mod program;
pub(crate) mod quantity;
pub(crate) mod report;
pub(crate) mod sensitivity;
pub(crate) mod simulate;
pub(crate) mod straight;

use std::collections::BTreeMap;

use schemars::{JsonSchema, Schema, generate::SchemaSettings};
use serde::Serialize;
use volcomp_vocabulary::AxisName;

/// The name of a command and the schema of its document.
type Named = (&'static str, fn() -> Schema);

/// The documents by the name of their command, `probe-list` for `probe --list`, `nc-average` for `nc --average`, `calibrate-draft` for `calibrate --draft`, `iso230-circle` and `iso230-diagonals` for its parts 4 and 6: `volcomp-NAME.json` is the file of the schema.
pub(crate) const ALL: &[Named] = &[
    ("check", schema::<check::Check>),
    ("compile", schema::<program::Compile>),
    ("completions", schema::<program::Completions>),
    ("error", schema::<position::Error>),
    ("correct", schema::<position::Correct>),
    ("diagonals", schema::<diagonals::Diagonals>),
    ("map", schema::<map::Map>),
    ("map-table", schema::<map_table::MapTable>),
    ("export", schema::<export::Export>),
    ("import", schema::<import::Import>),
    ("axes", schema::<axes::Axes>),
    ("dh", schema::<axes::Dh>),
    ("sensitivity", schema::<sensitivity::Sensitivity>),
    ("expression", schema::<sensitivity::Expression>),
    ("fit", schema::<fit::Fit>),
    ("fit-thermal", schema::<fit_thermal::FitThermal>),
    ("calibrate", schema::<calibrate::Calibrate>),
    ("calibrate-draft", schema::<calibrate_draft::CalibrateDraft>),
    ("report", schema::<report::Report>),
    ("identify", schema::<identify::Identify>),
    ("iso230", schema::<iso230::Iso230>),
    ("iso230-circle", schema::<iso230_parts::CircularTests>),
    (
        "iso230-diagonals",
        schema::<iso230_parts::MeasuredDiagonals>,
    ),
    ("straightness", schema::<straight::StraightnessDocument>),
    ("squareness", schema::<straight::Squareness>),
    ("form", schema::<form::Form>),
    ("inspect", schema::<inspect::Inspect>),
    ("simulate", schema::<simulate::Simulate>),
    ("age", schema::<simulate::Age>),
    ("demo", schema::<simulate::Demo>),
    ("probe", schema::<probe::Probe>),
    ("probe-list", schema::<probe::ProbeList>),
    ("nc", schema::<nc::Nc>),
    ("nc-average", schema::<nc::NcAverage>),
    ("failure", schema::<failure::Document>),
];

/// The JSON Schema (draft 2020-12) of a document.
fn schema<T: JsonSchema>() -> Schema {
    let settings = SchemaSettings::draft2020_12().for_serialize();
    settings.into_generator().into_root_schema_for::<T>()
}

/// An error that the measurements of an uncertainty do not determine, and that the uncertainty does not count: what a plausible
/// size of it would move the tool by, unseen by the measurements.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub(crate) struct NotCounted {
    /// The name among the unknowns: `ECZ legendre 1`.
    pub(crate) unknown: String,
    /// The size that is told of.
    pub(crate) size: f64,
    /// The unit of the size: `um` or `urad`.
    pub(crate) unit: &'static str,
    /// How far this size moves the tool, µm; of a map the most over its nodes.
    pub(crate) moves_um: f64,
    /// By how much it turns the tool, µrad; of a map the most over its nodes.
    pub(crate) turns_urad: f64,
}

/// Values by axis letter, in the order X Y Z A B C U V W.
#[derive(Clone, Debug, Default, Serialize, JsonSchema)]
#[serde(transparent)]
pub(crate) struct ByAxis(
    #[schemars(with = "BTreeMap<String, f64>")] pub(crate) BTreeMap<AxisName, f64>,
);

impl FromIterator<(AxisName, f64)> for ByAxis {
    fn from_iter<I: IntoIterator<Item = (AxisName, f64)>>(values: I) -> Self {
        Self(values.into_iter().collect())
    }
}

/// One position asked for with `--at`, or many with `--points`.
#[derive(Debug, Serialize, JsonSchema)]
#[serde(untagged)]
pub(crate) enum OneOrMany<T> {
    /// The answer at the one position.
    One(T),
    /// The answers in the order of the rows.
    Many {
        /// One answer for each row.
        points: Vec<T>,
    },
}
