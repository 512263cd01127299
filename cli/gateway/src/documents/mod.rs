//! The JSON documents of the gateway, as plain structs.
//!
//! They are the state, the responses to requests, the records of the audit log, the plan printed by `check --json`, and
//! the history and error map of the dashboard.
//!
//! These structs alone define the shape of the documents. `volcomp-gateway schema FOLDER` writes their JSON Schemas.

use std::collections::BTreeMap;

use schemars::{JsonSchema, Schema, schema_for};
use serde::{Deserialize, Serialize};

mod model;
mod plan;
mod record;
mod state;

pub use model::{
    Candidate, CandidateBrief, CandidateResult, CandidateStep, ConfiguredModel, ModelActivate,
    ModelBack, ModelDiagonal, ModelEntry, ModelInForce, ModelOutcome, ModelRequest, ModelSource,
    ModelState, ModelsKept, UploadedFile,
};
pub use plan::{
    AxisBounds, AxisPlan, BarrierPlan, ControllerPlan, Excursion, FleetPlan, MachinePlan,
    OnlineBarrier, OnlineBarrierAxis, OnlinePlan, PlanDocument, RehearsalDocument, RehearsedAxis,
    RehearsedBarrier, RehearsedFault, RehearsedLimits, RehearsedPath, SensorPlan, TokenPlan,
};
pub use record::{
    Broken, ConfirmedLimits, Details, Event, EventKind, EventLog, LastOutput, LimitChanges,
    LogEvent, Record, Standing, Start, StateChange, Stop,
};
pub use state::{
    ByAxis, ControllerState, CorrectionLimits, CycleTimes, DemoState, DisturbRequest, Disturbance,
    ErrorMap, FleetState, History, HistoryPoint, MachineState, MapAxis, PathState, ProvenName,
    SchemeName, SensorState, StateName, Status, StretchTimes, round,
};

/// The file name and the JSON Schema of every document.
pub fn schemas() -> Vec<(&'static str, Schema)> {
    vec![
        ("gateway-answer.json", schema_for!(Answer)),
        ("gateway-audit-record.json", schema_for!(Record)),
        ("gateway-check.json", schema_for!(PlanDocument)),
        ("gateway-confirmation.json", schema_for!(Confirmation)),
        ("gateway-disturb.json", schema_for!(DisturbRequest)),
        ("gateway-error.json", schema_for!(crate::error::Failure)),
        ("gateway-history.json", schema_for!(History)),
        ("gateway-last-output.json", schema_for!(LastOutput)),
        ("gateway-log.json", schema_for!(EventLog)),
        ("gateway-map.json", schema_for!(ErrorMap)),
        ("gateway-model.json", schema_for!(ModelState)),
        ("gateway-model-activate.json", schema_for!(ModelActivate)),
        ("gateway-model-back.json", schema_for!(ModelBack)),
        ("gateway-model-candidate.json", schema_for!(Candidate)),
        ("gateway-model-request.json", schema_for!(ModelRequest)),
        ("gateway-models-kept.json", schema_for!(ModelsKept)),
        ("gateway-rehearsal.json", schema_for!(RehearsalDocument)),
        ("gateway-standing.json", schema_for!(Standing)),
        ("gateway-state.json", schema_for!(Status)),
    ]
}

/// The body of a request that confirms a model; requests without a body confirm none.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Confirmation {
    /// Hash of the model that the operator confirms, copied from [`Question::model`].
    #[serde(default)]
    pub confirm: Option<String>,
}

/// Body of the response to a request that arms, disarms, acknowledges, reloads or changes the
/// model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Answer {
    /// The model must be confirmed first (status 409).
    Question(Box<Question>),
    /// The state after the request: status 200 if it took effect, 409 if not.
    Settled(Settled),
    /// The configuration was reloaded (status 200).
    Reloaded(Reloaded),
    /// The request was refused (status 400 to 503).
    Refusal(Refusal),
}

/// A change of model or limits that the operator must confirm by repeating the request with `model`
/// as its hash.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Question {
    /// Hash to be confirmed: that of the new model; if limits change, of the model and the new
    /// limits.
    pub model: String,
    /// Largest change of the correction of a linear axis in the work space, µm; null if the new
    /// model has other axes.
    pub worst_corner_um: Option<f64>,
    /// Largest change of the correction of a rotary axis in the work space, µrad; null if the new
    /// model has other axes, or if no rotary axis is corrected.
    pub worst_corner_urad: Option<f64>,
    /// Largest change of a linear axis that needs no confirmation, µm.
    pub confirm_um: f64,
    /// Largest change of a rotary axis that needs no confirmation, µrad; null if no rotary axis has
    /// limits.
    pub confirm_urad: Option<f64>,
    /// Changed limits, rates, accelerations, controllers and thermometers by configuration key: old and new value; null if
    /// missing. A value that is not a number is part of its key, which has the value 1.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub limits: LimitChanges,
    /// Signs that the model belongs to another machine (name, structure, travels), one sentence
    /// each. They must be confirmed even if the correction hardly changes.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub differences: Vec<String>,
}

/// The state after a request.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Settled {
    /// The state after the request.
    pub state: StateName,
    /// Reasons for the state, causes first.
    pub reasons: Vec<String>,
    /// Why the request did not take effect; only with status 409.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
}

/// The model after a reload.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Reloaded {
    /// Hash of the active model.
    pub model: String,
    /// Whether the files are unchanged: nothing was applied, and the correction continues without a
    /// ramp.
    #[serde(default)]
    pub unchanged: bool,
    /// Additional remark for the client.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
}

/// Why a request was refused.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Refusal {
    /// Reason of the refusal, one or more sentences.
    pub error: String,
}

impl Refusal {
    /// Creates a refusal with this reason.
    pub fn new(error: impl Into<String>) -> Self {
        Self { error: error.into() }
    }
}
