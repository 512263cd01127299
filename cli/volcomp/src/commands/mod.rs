//! One module for each command: arguments, the JSON document, the text for people.

pub(crate) mod calibrate;
pub(crate) mod correct;
pub(crate) mod demo;
pub(crate) mod diagonals;
pub(crate) mod error;
pub(crate) mod fit;
pub(crate) mod fit_thermal;
pub(crate) mod inspect;
pub(crate) mod iso230;
pub(crate) mod map;
pub(crate) mod probe;
pub(crate) mod simulate;

use std::path::Path;

use comfy_table::{CellAlignment, Table, presets};
use serde_json::Value;
use volcomp_kinematics::nalgebra::Vector3;
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::AxisKind;

use crate::{failure::Failure, output::OutputFile};

/// What a command found.
pub(crate) struct Answer {
    /// The document of `--json`.
    pub(crate) json: Value,
    /// The same for people.
    pub(crate) text: String,
    /// What a person should know besides.
    pub(crate) notes: Vec<String>,
}

/// A table of numbers: first column left, the others right.
fn table(header: &[&str]) -> Table {
    let mut table = Table::new();
    table.load_style(presets::NOTHING);
    table.set_header(header.to_vec());
    for column in table.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table
}

/// A table as text, without blanks at the ends of lines.
fn table_text(table: &Table) -> String {
    table
        .lines()
        .fold(String::new(), |text, line| text + line.trim_end() + "\n")
}

/// Writes a whole file; it appears by rename.
fn write_file(path: &Path, text: &str) -> Result<(), Failure> {
    let mut file = OutputFile::open(path)?;
    file.append(text.as_bytes())?;
    file.finish()
}

fn micrometres(v: &Vector3<f64>) -> [f64; 3] {
    (v * 1e3).into()
}

fn microradians(v: &Vector3<f64>) -> [f64; 3] {
    (v * 1e6).into()
}

/// mm or rad of a joint in µm or µrad.
fn micro(kind: AxisKind, value: f64) -> f64 {
    match kind {
        AxisKind::Linear => value * 1e3,
        AxisKind::Rotary => value * 1e6,
    }
}

/// Names the sensors whose thermal terms are left out.
fn thermal_note(machine: &Machine, temperatures: &Temperatures) -> Option<String> {
    let mut missing = machine.thermal().sensors();
    missing.retain(|name| !temperatures.contains_key(*name));
    (!missing.is_empty()).then(|| {
        let names = missing.join(", ");
        format!("no temperature given for {names}: thermal terms with them are left out")
    })
}
