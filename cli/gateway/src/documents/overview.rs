//! The machines of one process at a glance: what `GET /api/machines` of the overview answers, and what `status` prints of
//! several machines.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::state::{ByAxis, StateName};

/// The machines of one process, in the order of their file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Overview {
    /// One for each `[[machine]]`.
    pub machines: Vec<Glance>,
}

/// How far a machine is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PhaseName {
    /// Its files are read and its devices opened.
    Starting,
    /// It runs; the state says what it does.
    Running,
    /// It does not run.
    Failed,
    /// It was told to stop, and has.
    Ended,
}

/// One machine at a glance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Glance {
    /// The name of the machine in this process.
    pub name: String,
    /// How far it is.
    pub phase: PhaseName,
    /// Why it does not run; null while it does.
    pub trouble: Option<String>,
    /// Whether a machine that does not run is started again by itself; otherwise with the next reload.
    pub starts_again: bool,
    /// The URL of its own dashboard; null while it does not run. An unspecified address, such as 0.0.0.0, stands for every
    /// address of the computer.
    pub dashboard: Option<String>,
    /// The state of its guard; `unknown` while it does not run.
    pub state: StateName,
    /// Why it is in this state, in the order of importance.
    pub reasons: Vec<String>,
    /// The name in its machine file; null while it does not run.
    pub machine: Option<String>,
    /// Whether the machine is simulated.
    pub simulated: bool,
    /// Age of what is told, ms; null while it does not run.
    pub age_ms: Option<f64>,
    /// Whether it is known what is applied.
    pub correction_known: bool,
    /// The correction of each linear axis that was confirmed last, µm.
    #[schemars(with = "BTreeMap<String, f64>")]
    pub correction_um: ByAxis,
    /// The correction of each rotary axis that was confirmed last, µrad.
    #[schemars(with = "BTreeMap<String, f64>")]
    pub correction_urad: ByAxis,
}
