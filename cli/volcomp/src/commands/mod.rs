//! One module per command, with its arguments and its result as a JSON document and as text.

pub(crate) mod age;
pub(crate) mod axes;
pub(crate) mod calibrate;
pub(crate) mod check;
pub(crate) mod compile;
pub(crate) mod completions;
pub(crate) mod correct;
pub(crate) mod demo;
pub(crate) mod dh;
pub(crate) mod diagonals;
pub(crate) mod error;
pub(crate) mod evaluation;
pub(crate) mod export;
pub(crate) mod expression;
pub(crate) mod fit;
pub(crate) mod fit_thermal;
pub(crate) mod form;
pub(crate) mod identify;
pub(crate) mod import;
pub(crate) mod inspect;
pub(crate) mod iso230;
pub(crate) mod map;
pub(crate) mod map_table;
pub(crate) mod nc;
pub(crate) mod probe;
pub(crate) mod report;
pub(crate) mod schema;
pub(crate) mod sensitivity;
pub(crate) mod simulate;
pub(crate) mod squareness;
pub(crate) mod straightness;
pub(crate) mod studio;
mod uncertainty;

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use serde::Serialize;
use serde_json::Value;
use volcomp_kinematics::nalgebra::Vector3;
use volcomp_metrology::Decision;
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::{AxisKind, AxisName, Displacement};

use crate::{
    failure::Failure,
    listing::Listing,
    output::{OutputFile, first_not_finite, not_finite},
};

pub(crate) use crate::table::{fixed, table, table_text};

/// Values by axis letter, in the order X Y Z A B C U V W.
pub(crate) type ByAxis = BTreeMap<AxisName, f64>;

pub(crate) struct Answer {
    pub(crate) json: Value,
    pub(crate) text: String,
    /// The rows of a result for many positions. They are printed instead of the document, or before the text.
    pub(crate) listing: Option<Listing>,
    pub(crate) notes: Vec<String>,
    pub(crate) failed: Option<Failure>,
    /// True if all tolerances are met; otherwise the exit status is 3.
    pub(crate) tolerances_met: bool,
}

impl Answer {
    pub(crate) fn new(
        document: &impl Serialize,
        text: String,
        notes: Vec<String>,
    ) -> Result<Self, Failure> {
        if let Some(key) = first_not_finite(document) {
            return Err(not_finite(&key));
        }
        Ok(Self {
            json: serde_json::to_value(document)
                .map_err(|e| Failure::Work(format!("the JSON document: {e}")))?,
            ..Self::of_text(text, notes)
        })
    }

    /// An answer without a document.
    pub(crate) fn of_text(text: String, notes: Vec<String>) -> Self {
        Self { json: Value::Null, text, listing: None, notes, failed: None, tolerances_met: true }
    }

    /// An answer with the rows of `listing` as a table, followed by `text`.
    pub(crate) fn listed(listing: Listing, text: String, notes: Vec<String>) -> Self {
        Self { listing: Some(listing), ..Self::of_text(text, notes) }
    }

    pub(crate) fn decided(self, decision: Option<Decision>) -> Self {
        let met = decision.is_none_or(|decision| decision.pass);
        Self { tolerances_met: self.tolerances_met && met, ..self }
    }
}

/// Writes a whole file atomically, by rename.
fn write_file(path: &Path, text: &str) -> Result<(), Failure> {
    let file = OutputFile::open(path)?;
    file.write_whole(text)
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Rejects an output that would overwrite an input, because a second run would start from the result of the first.
fn refuse_overwriting(files: &[PathBuf], output: &Path, what: &str) -> Result<(), Failure> {
    match same_file(files, output) {
        Some(path) => Err(Failure::Input(format!(
            "--output {}: is {}, which this {what} reads; expected another file",
            output.display(),
            path.display()
        ))),
        None => Ok(()),
    }
}

/// The entry of `files` that is the same file as `output`, under whatever path; `None` if all entries are other files,
/// or `output` does not exist.
fn same_file<'a>(files: &'a [PathBuf], output: &Path) -> Option<&'a PathBuf> {
    let there = output.canonicalize().ok()?;
    let same = |path: &&PathBuf| path.canonicalize().is_ok_and(|path| path == there);
    files.iter().find(same)
}

/// Maximum minus minimum; −∞ if there are no values.
fn range(values: impl IntoIterator<Item = f64>) -> f64 {
    let ends = [f64::INFINITY, f64::NEG_INFINITY];
    let [low, high] =
        values.into_iter().fold(ends, |[low, high], value| [low.min(value), high.max(value)]);
    high - low
}

fn micrometres(v: &Vector3<f64>) -> [f64; 3] {
    (v * 1e3).into()
}

fn microradians(v: &Vector3<f64>) -> [f64; 3] {
    (v * 1e6).into()
}

/// Converts a coordinate in mm or rad to µm or µrad.
fn micro(kind: AxisKind, value: f64) -> f64 {
    Displacement::new(kind, value).um_or_urad()
}

/// Converts a coordinate in mm or rad to mm or deg.
fn in_degrees(kind: AxisKind, value: f64) -> f64 {
    Displacement::new(kind, value).mm_or_deg()
}

fn machine_notes(machine: &Machine, temperatures: &Temperatures) -> Vec<String> {
    let thermal = [thermal_note(machine, temperatures), seen_note(machine, temperatures)];
    let mut notes = machine.notes();
    notes.extend(thermal.into_iter().flatten());
    notes
}

/// Note on the errors that a value over X, Y and Z with fixed rotary axes does not cover; `None` without rotary axes.
fn rotary_note(machine: &Machine) -> Option<String> {
    let rotary = machine.axes().iter().filter(|axis| axis.name.is_rotary());
    let names: Vec<String> = rotary.map(|axis| axis.name.to_string()).collect();
    (!names.is_empty()).then(|| {
        format!(
            "{} do not move here: their location errors move the workpiece as a rigid body and do not show; `volcomp map` gives the error over poses of all axes",
            names.join(", ")
        )
    })
}

fn seen_note(machine: &Machine, temperatures: &Temperatures) -> Option<String> {
    let beyond = machine.thermal().beyond_seen(temperatures);
    let said = |seen: &&volcomp_model::Seen| {
        let [low, high] = seen.degc;
        format!("{} for {} ({low} to {high} °C)", seen.sensor, seen.error)
    };
    let said: Vec<String> = beyond.iter().map(said).collect();
    (!said.is_empty()).then(|| {
        format!(
            "outside what the thermal terms have seen: {}; beyond it they hold and fade, to zero at {} K",
            said.join(", "),
            machine.thermal().margin_k
        )
    })
}

pub(crate) fn thermal_note(machine: &Machine, temperatures: &Temperatures) -> Option<String> {
    let mut missing = machine.thermal().sensors();
    missing.retain(|name| !temperatures.contains_key(*name));
    (!missing.is_empty()).then(|| {
        let names = missing.join(", ");
        format!("no temperature given for {names}: thermal terms with them are left out (--temperature NAME=°C)")
    })
}
