//! Models: machine files that are checked before anything is stored, described and compared.

use std::path::Path;

use serde::Serialize;
use volcomp_fleet::ModelRef;
use volcomp_model::{Machine as ModelMachine, ModelError};
use volcomp_sensitivity::{Expression, terms};
use volcomp_vocabulary::Mm;

use crate::{
    clock::{date_s, now_s},
    map::{ErrorMap, error_map},
    records::{Machine, Model, Origin},
};

/// Why there is no model.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NoModel {
    /// The machine file is wrong.
    #[error(transparent)]
    Machine(#[from] ModelError),
    /// The day of the measurements is none.
    #[error("measured: found {found:?}, expected a day such as 2026-11-25")]
    Day { found: String },
    /// The file cannot be read.
    #[error(transparent)]
    Read(#[from] volcomp_document::ReadError),
    /// The model is for another kind of machine.
    #[error("the model {model} has {what} {found}, {machine} has {expected}")]
    Other {
        /// The name in the model.
        model: String,
        machine: String,
        /// What differs.
        what: &'static str,
        /// What the model has.
        found: String,
        /// What the machine has.
        expected: String,
    },
}

/// A model and its text, to be stored.
#[derive(Clone, Debug, PartialEq)]
pub struct NewModel {
    pub model: Model,
    /// The text of the machine file.
    pub text: String,
}

impl NewModel {
    /// Takes the text of a machine file. `file` names it in messages.
    ///
    /// # Errors
    /// It is no machine file.
    pub fn of_text(text: String, file: &str, origin: Origin, by: &str) -> Result<Self, NoModel> {
        let machine = ModelMachine::parse(&text, file)?;
        let reference = ModelRef::of(text.as_bytes());
        Ok(Self {
            model: Model {
                sha256: reference.sha256,
                bytes: reference.bytes,
                checksum: machine.checksum(),
                name: machine.name.clone(),
                structure: machine.chain().structure().to_string(),
                axes: machine.axes().iter().map(|axis| axis.name).collect(),
                origin,
                measured: String::new(),
                added_s: now_s(),
                by: by.to_owned(),
                notes: machine.notes(),
            },
            text,
        })
    }

    /// Takes a machine file.
    ///
    /// # Errors
    /// It cannot be read, or is no machine file.
    pub fn of_file(path: &Path, by: &str) -> Result<Self, NoModel> {
        let text = volcomp_document::read_text(path)?;
        let name = path.display().to_string();
        let origin = Origin::File { name: name.clone() };
        Self::of_text(text, &name, origin, by)
    }

    /// States the day of the measurements, and adds a note where the error is larger than any guard corrects.
    ///
    /// # Errors
    /// `measured` is neither empty nor a day.
    pub fn with_day_and_note(mut self, measured: &str) -> Result<Self, NoModel> {
        if !measured.is_empty() && date_s(measured).is_none() {
            return Err(NoModel::Day {
                found: measured.to_owned(),
            });
        }
        measured.clone_into(&mut self.model.measured);
        let machine = ModelMachine::parse(&self.text, "the machine file")?;
        self.model
            .notes
            .extend(beyond_every_guard(&error_map(&machine)?));
        Ok(self)
    }
}

/// Whether a model may go to a machine: it must have its structure and its axes.
///
/// # Errors
/// What differs.
pub fn fits(model: &Model, machine: &Machine) -> Result<(), NoModel> {
    let other = |what, found: String, expected: String| {
        Err(NoModel::Other {
            model: model.name.clone(),
            machine: machine.identity.machine.to_string(),
            what,
            found,
            expected,
        })
    };
    let words = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    if words(&model.structure) != words(&machine.structure) {
        return other(
            "the structure",
            model.structure.clone(),
            machine.structure.clone(),
        );
    }
    if model.axes != machine.axes {
        let letters = |axes: &[volcomp_vocabulary::AxisName]| {
            let letters: Vec<String> = axes.iter().map(ToString::to_string).collect();
            letters.join(" ")
        };
        return other("the axes", letters(&model.axes), letters(&machine.axes));
    }
    Ok(())
}

/// A line of a comparison of two machine files.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Line {
    /// In both.
    Same(String),
    /// Only in the first.
    Out(String),
    /// Only in the second.
    In(String),
}

/// Compares two machine files line by line, as they are written canonically: comments, blanks and the order of keys do not
/// count.
///
/// # Errors
/// One of them is no machine file.
pub fn compare(one: &str, other: &str) -> Result<Vec<Line>, NoModel> {
    let one = ModelMachine::parse(one, "first model")?.to_toml();
    let other = ModelMachine::parse(other, "second model")?.to_toml();
    let difference = similar::TextDiff::from_lines(&one, &other);
    let lines = difference.iter_all_changes().map(|change| {
        let text = change.value().trim_end().to_owned();
        match change.tag() {
            similar::ChangeTag::Equal => Line::Same(text),
            similar::ChangeTag::Delete => Line::Out(text),
            similar::ChangeTag::Insert => Line::In(text),
        }
    });
    Ok(lines.collect())
}

/// What a machine file states.
#[derive(Clone, Debug, Serialize)]
pub struct Described {
    /// The machine file.
    pub text: String,
    /// The structure code.
    pub structure: String,
    /// The type numbers, linear and rotary; `None`: none of the sixteen types.
    pub type_numbers: Option<[u8; 2]>,
    /// The first-order volumetric error as a formula: displacement along X, Y, Z, rotation about them (mm, rad).
    pub formula: Vec<String>,
    /// The coordinates of the tool tip in the formula, mm.
    pub tool_mm: [f64; 3],
}

impl Described {
    /// Describes a machine, whose file has this text.
    pub fn new(machine: &ModelMachine, text: &str) -> Self {
        let stated: Vec<_> = machine.locations().keys().copied().collect();
        let expression = Expression::of(machine.chain(), &terms(machine.chain(), false, &stated));
        let structure = machine.chain().structure();
        Self {
            text: text.to_owned(),
            structure: structure.to_string(),
            type_numbers: structure
                .type_numbers()
                .map(|numbers| [numbers.translational, numbers.rotary]),
            formula: expression.text().to_vec(),
            tool_mm: expression.tool_tip_mm(),
        }
    }
}

/// A note on a machine whose error is larger than any guard corrects: a unit is wrong, or a comma.
pub fn beyond_every_guard(map: &ErrorMap) -> Option<String> {
    let largest_mm = map.largest_um[0] / 1000.0;
    let Mm(most_mm) = volcomp_guard::ceiling::LIMIT;
    (largest_mm > most_mm).then(|| {
        format!(
            "The error is up to {largest_mm:.1} mm in the work space. No guard corrects an axis by more than {most_mm} mm, and machines have some hundredths: check the numbers and their units."
        )
    })
}
