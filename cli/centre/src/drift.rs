//! How a machine has changed from calibration to calibration, and when the next calibration is due.

use std::{collections::BTreeMap, fmt};

use volcomp_fleet::{MachineId, Outcome};
use volcomp_model::Machine as ModelMachine;
use volcomp_vocabulary::ErrorName;

use crate::{
    clock::date_s,
    models::NoModel,
    records::{Live, Machine, Model, Version},
    store::{Store, StoreError},
};

/// An error motion is looked at in so many steps over the travel.
const STEPS: u32 = 100;
/// A day, s.
const DAY_S: f64 = 86_400.0;

/// A parameter of a machine: a location error, or the range of an error motion over the travel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Parameter {
    /// A location error, µm or µrad.
    Location(ErrorName),
    /// From the lowest to the highest value of an error motion over the travel, µm or µrad.
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

/// A model in the life of a machine: its checksum and its parameters, µm or µrad.
#[derive(Clone, Debug, PartialEq)]
pub struct Stage {
    pub sha256: String,
    pub parameters: BTreeMap<Parameter, f64>,
}

/// The parameters of a machine file, µm or µrad.
///
/// # Errors
/// It is no machine file.
pub fn parameters(text: &str) -> Result<BTreeMap<Parameter, f64>, NoModel> {
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

/// For how many days a calibration has been due; negative: it is due in so many days; `None`: never.
///
/// A calibration is as old as its measurements, where that is known, else as its model.
pub fn due_days(machine: &Machine, model: &Model, now_s: f64) -> Option<f64> {
    let interval = f64::from(machine.due_days?);
    let measured_s = date_s(&model.measured).unwrap_or(model.added_s);
    Some((now_s - measured_s) / DAY_S - interval)
}

/// Whether a machine may correct by the model of this version: it has neither refused it, nor does it wait for a person, nor was
/// it taken back.
pub(crate) fn may_be_in_force(version: &Version) -> bool {
    !version.withdrawn
        && !matches!(
            version.outcome,
            Some(Outcome::Refused { .. } | Outcome::NeedsConfirmation { .. })
        )
}

/// The version by whose model a machine corrects, by [`in_force`], of a machine whose `newest` version is known: where it tells
/// that one, no other is read.
pub(crate) fn version_in_force(
    store: &Store,
    machine: &MachineId,
    newest: Option<&Version>,
    live: Option<&Live>,
) -> Result<Option<Version>, StoreError> {
    let told = live.map_or(0, |live| live.version);
    match newest {
        Some(newest) if newest.version == told => Ok(Some(newest.clone())),
        None if told == 0 => Ok(None),
        _ => Ok(in_force(&store.versions(machine)?, live).cloned()),
    }
}

/// The version by whose model a machine corrects: the one that it tells; where none is known of what it tells, or it has answered
/// since that a newer one is in force, the newest that it has put in force and that was not taken back. `versions` begins with
/// the newest.
pub fn in_force<'a>(versions: &'a [Version], live: Option<&Live>) -> Option<&'a Version> {
    let told = live.and_then(|live| {
        let mut each = versions.iter();
        each.find(|version| version.version == live.version)
    });
    let told_s = live.and_then(Live::made).map(|made| made.at_s);
    let is_active = |version: &&Version| {
        let is_newer = told.is_none_or(|told| {
            // Conditions may be rarer than answers.
            let is_later = version
                .answered_s
                .zip(told_s)
                .is_some_and(|(at, told)| at > told);
            version.version > told.version && is_later
        });
        is_newer && !version.withdrawn && version.outcome == Some(Outcome::Activated)
    };
    versions.iter().find(is_active).or(told)
}

/// The checksum of that model, where the newest version is known; older ones are read where they are needed. Where nothing tells
/// what is in force it is the newest that may be.
///
/// # Errors
/// The older ones cannot be read.
pub fn model_in_force(
    store: &Store,
    newest: &Version,
    live: Option<&Live>,
) -> Result<Option<String>, StoreError> {
    if live.is_some_and(|live| live.version == newest.version) {
        return Ok(Some(newest.model.clone()));
    }
    let versions = store.versions(&newest.machine)?;
    let may_be = || versions.iter().find(|version| may_be_in_force(version));
    let version = in_force(&versions, live).or_else(may_be);
    Ok(version.map(|version| version.model.clone()))
}
