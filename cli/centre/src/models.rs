//! Models: made from a calibration, or a machine file that was there; checked before anything is stored; compared.

use std::path::{Path, PathBuf};

use volcomp_calibrate::{CalibrateError, CalibrationFile, calibrate};
use volcomp_fleet::ModelRef;
use volcomp_model::{Machine as ModelMachine, ModelError};

use crate::{
    clock::now_s,
    records::{Machine, Model, Origin},
};

/// Why there is no model.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NoModel {
    /// The machine file is wrong.
    #[error(transparent)]
    Machine(#[from] ModelError),
    /// The calibration makes no machine file.
    #[error(transparent)]
    Calibration(Box<CalibrateError>),
    /// The file cannot be read.
    #[error(transparent)]
    Read(#[from] volcomp_document::ReadError),
    /// The model is for another kind of machine.
    #[error("the model {model} has {what} {found}, {machine} has {expected}")]
    Other {
        /// The name in the model.
        model: String,
        /// The machine.
        machine: String,
        /// What differs.
        what: &'static str,
        /// What the model has.
        found: String,
        /// What the machine has.
        expected: String,
    },
}

impl From<CalibrateError> for NoModel {
    fn from(error: CalibrateError) -> Self {
        Self::Calibration(Box::new(error))
    }
}

/// A model and its text, to be stored.
#[derive(Clone, Debug, PartialEq)]
pub struct NewModel {
    /// What is known of it.
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
        let notes = machine.notes();
        Ok(Self::new(&machine, text, origin, by, notes))
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

    /// Makes a machine file from a calibration file and the measurements that it names; or from the folder that holds a
    /// `calibration.toml`.
    ///
    /// # Errors
    /// The measurements make no machine file.
    pub fn of_calibration(path: &Path, by: &str) -> Result<Self, NoModel> {
        let path: PathBuf = if path.is_dir() {
            path.join("calibration.toml")
        } else {
            path.to_owned()
        };
        let calibration = calibrate(&CalibrationFile::read(&path)?, |_, _| {})?;
        let origin = Origin::Calibration {
            path: path.display().to_string(),
        };
        let text = calibration.machine.to_toml();
        Ok(Self::new(
            &calibration.machine,
            text,
            origin,
            by,
            calibration.warnings,
        ))
    }

    fn new(
        machine: &ModelMachine,
        text: String,
        origin: Origin,
        by: &str,
        notes: Vec<String>,
    ) -> Self {
        let reference = ModelRef::of(text.as_bytes());
        Self {
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
                notes,
            },
            text,
        }
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
