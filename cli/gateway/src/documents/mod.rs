//! The JSON documents of the gateway, as plain structs: the state, responses to requests, records of the audit log, the
//! plan printed by `check --json`, and the history and error map of the dashboard.
//!
//! These structs alone define the shape of the documents. `volcomp-gateway schema FOLDER` writes their JSON Schemas.

mod answer;
mod model;
mod plan;
mod record;
mod rehearsal;
mod state;

pub use answer::{Answer, Confirmation, Question, Refusal, Reloaded, Settled};
pub use model::{
    Candidate, CandidateBrief, CandidateResult, CandidateStep, ConfiguredModel, ModelActivate,
    ModelBack, ModelDiagonal, ModelEntry, ModelInForce, ModelOutcome, ModelRequest, ModelSource,
    ModelState, ModelsKept, UploadedFile,
};
pub use plan::{
    AxisPlan, BarrierPlan, ControllerPlan, FleetPlan, MachinePlan, OnlineBarrier,
    OnlineBarrierAxis, OnlinePlan, PlanDocument, SensorPlan, TokenPlan,
};
pub use record::{
    Broken, ConfirmedLimits, Details, Event, LastOutput, LimitChanges, Record, Standing, Start,
    StateChange, Stop,
};
pub use rehearsal::{
    AxisBounds, Excursion, RehearsalDocument, RehearsedAxis, RehearsedBarrier, RehearsedFault,
    RehearsedLimits, RehearsedPath,
};
pub use state::{
    ByAxis, ControllerState, CycleTimes, ErrorMap, FleetState, History, HistoryPoint, MachineState,
    MapAxis, PathState, ProvenName, SchemeName, SensorState, StateName, Status, StretchTimes,
    round,
};

use schemars::{Schema, schema_for};

/// The file name and the JSON Schema of every document.
pub fn schemas() -> Vec<(&'static str, Schema)> {
    vec![
        ("gateway-answer.json", schema_for!(Answer)),
        ("gateway-audit-record.json", schema_for!(Record)),
        ("gateway-check.json", schema_for!(PlanDocument)),
        ("gateway-confirmation.json", schema_for!(Confirmation)),
        ("gateway-error.json", schema_for!(crate::error::Failure)),
        ("gateway-history.json", schema_for!(History)),
        ("gateway-last-output.json", schema_for!(LastOutput)),
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
