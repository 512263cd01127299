//! Models: validation, description and comparison of machine files, and when the next calibration is due.

use std::{
    collections::BTreeMap,
    fmt::{self, Write},
    path::Path,
};

use serde::Serialize;
use volcomp_fleet::ModelRef;
use volcomp_model::Machine as ModelMachine;
use volcomp_sensitivity::{Expression, terms};
use volcomp_vocabulary::{ErrorName, Mm};

use crate::{
    Error,
    clock::{date_s, now_s},
    map::{ErrorMap, error_map},
    records::{Machine, Model, Origin, letters},
};

#[derive(Clone, Debug, PartialEq)]
pub struct NewModel {
    pub model: Model,
    pub text: String,
}

impl NewModel {
    /// Parses the text of a machine file. `file` is its name in messages.
    pub fn of_text(text: String, file: &str, origin: Origin, by: &str) -> Result<Self, Error> {
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

    pub fn of_file(path: &Path, by: &str) -> Result<Self, Error> {
        let text = volcomp_document::read_text(path)?;
        let name = path.display().to_string();
        let origin = Origin::File { name: name.clone() };
        Self::of_text(text, &name, origin, by)
    }

    /// Sets the day of the measurements, and adds a note if the error exceeds the largest correction that a guard
    /// permits.
    pub fn with_day_and_note(mut self, measured: &str) -> Result<Self, Error> {
        if !measured.is_empty() && date_s(measured).is_none() {
            return Err(Error::Wrong(format!(
                "measured: found {measured:?}, expected a day such as 2026-11-25"
            )));
        }
        measured.clone_into(&mut self.model.measured);
        let machine = ModelMachine::parse(&self.text, "the machine file")?;
        self.model.notes.extend(beyond_every_guard(&error_map(&machine)?));
        Ok(self)
    }
}

pub fn fits(model: &Model, machine: &Machine) -> Result<(), Error> {
    let misfit = |what: &str, found: &str, expected: &str| {
        let (model, machine) = (&model.name, &machine.identity.machine);
        Err(Error::Misfit(format!(
            "the model {model} has {what} {found}, {machine} has {expected}"
        )))
    };
    let words = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    if words(&model.structure) != words(&machine.structure) {
        return misfit("the structure", &model.structure, &machine.structure);
    }
    if model.axes != machine.axes {
        return misfit("the axes", &letters(&model.axes), &letters(&machine.axes));
    }
    Ok(())
}

/// Line differences of two machine files in canonical form, prefixed with `-` or `+`: comments, whitespace and the order of keys are ignored.
pub fn compare(one: &str, other: &str) -> Result<String, Error> {
    let one = ModelMachine::parse(one, "first model")?.to_toml();
    let other = ModelMachine::parse(other, "second model")?.to_toml();
    let mut text = String::new();
    for change in similar::TextDiff::from_lines(&one, &other).iter_all_changes() {
        if change.tag() != similar::ChangeTag::Equal {
            // Writing to a string never fails.
            let _ = writeln!(text, "{} {}", change.tag(), change.value().trim_end());
        }
    }
    Ok(text)
}

#[derive(Clone, Debug, Serialize)]
pub struct ModelDescription {
    pub text: String,
    pub structure: String,
    /// Type numbers of the linear and the rotary axes; `None` if the structure has none of the sixteen types.
    pub type_numbers: Option<[u8; 2]>,
    /// First-order volumetric error as formulas: displacement along X, Y, Z and rotation about them (mm, rad).
    pub formula: Vec<String>,
    /// Coordinates of the tool tip in the formula, mm.
    pub tool_mm: [f64; 3],
}

impl ModelDescription {
    /// Describes a machine; `text` is its machine file.
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

/// Note for a machine whose error exceeds the largest correction that a guard permits, probably because of a wrong unit
/// or decimal point.
pub fn beyond_every_guard(map: &ErrorMap) -> Option<String> {
    let largest_mm = map.largest_um[0] / 1000.0;
    let Mm(most_mm) = volcomp_guard::ceiling::LIMIT;
    (largest_mm > most_mm).then(|| {
        format!(
            "The error is up to {largest_mm:.1} mm in the work space. No guard corrects an axis by more than {most_mm} mm, and typical errors are some hundredths: check the numbers and their units."
        )
    })
}

/// Number of steps over the travel in which an error motion is sampled.
const STEPS: u32 = 100;
const DAY_S: f64 = 86_400.0;

/// An error parameter of a machine: a location error, or the range of an error motion over the travel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Parameter {
    /// A location error, µm or µrad.
    Location(ErrorName),
    /// Range (maximum minus minimum) of an error motion over the travel, µm or µrad.
    Range(ErrorName),
}

impl fmt::Display for Parameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (name, what) = match self {
            Self::Location(name) => (name, ""),
            Self::Range(name) => (name, "range of "),
        };
        write!(f, "{what}{name}, {}", name.component.unit())
    }
}

/// A model in the history of a machine: its checksum and its parameters, µm or µrad.
#[derive(Clone, Debug, PartialEq)]
pub struct Stage {
    pub sha256: String,
    pub parameters: BTreeMap<Parameter, f64>,
}

/// The parameters of a machine file, µm or µrad.
pub fn parameters(text: &str) -> Result<BTreeMap<Parameter, f64>, Error> {
    let machine = ModelMachine::parse(text, "model")?;
    let mut found = BTreeMap::new();
    for (name, value) in machine.locations() {
        found.insert(Parameter::Location(*name), *value);
    }
    for (name, curve) in machine.errors() {
        let place = machine.index_of(name.axis)?;
        let [low, high] = machine.axes()[place].travel;
        let mut coordinates = vec![0.0; machine.axes().len()];
        let (mut lowest, mut highest) = (f64::INFINITY, f64::NEG_INFINITY);
        for step in 0..=STEPS {
            coordinates[place] = low + (high - low) * f64::from(step) / f64::from(STEPS);
            let value = curve.value(place, &coordinates, None);
            lowest = lowest.min(value);
            highest = highest.max(value);
        }
        found.insert(Parameter::Range(name), highest - lowest);
    }
    Ok(found)
}

/// Days since the calibration became due; negative before that; `None` if the machine has no calibration interval.
///
/// The age of a calibration counts from its measurements if their date is known, otherwise from the date on which its
/// model was added.
pub fn due_days(machine: &Machine, model: &Model, now_s: f64) -> Option<f64> {
    let interval = f64::from(machine.due_days?);
    let measured_s = date_s(&model.measured).unwrap_or(model.added_s);
    Some((now_s - measured_s) / DAY_S - interval)
}
