//! Responses to the requests to arm, disarm, acknowledge and reload.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{LimitChanges, StateName};

/// The body of a request that confirms a model; requests without a body confirm none.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Confirmation {
    /// The hash of the model that a person confirms, as it stood in [`Question::model`].
    #[serde(default)]
    pub confirm: Option<String>,
}

/// The answer to one request.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Answer {
    /// The model must be confirmed first (status 409).
    Question(Box<Question>),
    /// The state after the request: it took effect (200) or not (409).
    Settled(Settled),
    /// The configuration was read again (200).
    Reloaded(Reloaded),
    /// The request was refused (400 to 503).
    Refusal(Refusal),
}

/// A change of model or limits that a person must confirm by repeating the request with its hash.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Question {
    /// The hash to be confirmed: of the new model, and where limits change of the new limits besides.
    pub model: String,
    /// How far the correction of a linear axis moves at the worst point of the work space, µm; null for a machine
    /// with other axes.
    pub worst_corner_um: Option<f64>,
    /// How far the correction of a rotary axis moves at the worst point, µrad; null for a machine with other axes, and
    /// where no rotary axis is corrected.
    pub worst_corner_urad: Option<f64>,
    /// Moves up to this need no confirmation, µm.
    pub confirm_um: f64,
    /// Moves up to this need no confirmation, µrad; null where no rotary axis has limits.
    pub confirm_urad: Option<f64>,
    /// The limits, rates and accelerations that change, by the key of the configuration: the old and the new value;
    /// null where there is none.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub limits: LimitChanges,
    /// Where the model may be one of another machine: what differs (name, structure, travels), each in a sentence. It must be
    /// confirmed however little the correction moves.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub differences: Vec<String>,
}

/// The state after a request.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Settled {
    /// The state after the request.
    pub state: StateName,
    /// Why it is what it is.
    pub reasons: Vec<String>,
    /// Why the request did not take effect, in words; only where it did not (409).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
}

/// The model after a reload.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Reloaded {
    /// The hash of the model that corrects now.
    pub model: String,
    /// Whether the files say what they said before: nothing was taken, and the correction goes on without a ramp.
    #[serde(default)]
    pub unchanged: bool,
    /// What whoever asked should know besides.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
}

/// Why a request was refused.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Refusal {
    /// The reason, in words.
    pub error: String,
}

impl Refusal {
    /// Creates a refusal with this reason.
    pub fn new(error: impl Into<String>) -> Self {
        Self {
            error: error.into(),
        }
    }
}
