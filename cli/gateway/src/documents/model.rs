//! The models of a machine: the active one, earlier ones, and an uploaded machine file.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::audit::utc_now;

/// Where a model comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ModelSource {
    /// The machine file that the configuration names.
    #[default]
    File,
    /// A machine file that an engineer has sent.
    Upload,
    /// The centre of the fleet.
    Centre,
}

/// What became of a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ModelOutcome {
    /// It was activated.
    InForce,
    /// It was refused; nothing changed.
    Refused,
    /// It must be confirmed first; nothing changed.
    MustBeConfirmed,
}

/// One line of the history of models.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModelEntry {
    /// When, ISO 8601 in UTC.
    pub time: String,
    /// Who: the name of a token, `signal`, `centre` with the beginning of its key, or `gateway` for what was found at the start.
    pub who: String,
    /// The hash of the machine file.
    pub hash: String,
    /// The name that the machine file states.
    pub name: String,
    /// Where it comes from.
    pub from: ModelSource,
    /// The file, or what was uploaded, in words.
    pub file: String,
    /// What became of it.
    pub outcome: ModelOutcome,
    /// Why it was refused, in words.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
    /// How far it moves the correction of a linear axis at the worst point of the work space against the model before, µm; null:
    /// not known.
    pub worst_um: Option<f64>,
    /// The same of rotary axes, µrad; null where none is corrected, too.
    pub worst_urad: Option<f64>,
}

impl ModelEntry {
    pub(crate) fn refused(
        who: &str,
        hash: String,
        from: ModelSource,
        file: String,
        why: String,
    ) -> Self {
        Self {
            time: utc_now(),
            who: who.to_owned(),
            hash,
            name: String::new(),
            from,
            file,
            outcome: ModelOutcome::Refused,
            why: Some(why),
            worst_um: None,
            worst_urad: None,
        }
    }
}

/// The file `models/standing.json` in the folder of the audit log: the model that an operator activated, and the history.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModelsKept {
    /// The model that an operator activated; null: the configured machine file is active, or that of the centre.
    pub in_force: Option<ModelInForce>,
    /// What became of each model, the oldest first.
    pub history: Vec<ModelEntry>,
}

/// The model that an operator activated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModelInForce {
    /// The hash of its machine file.
    pub hash: String,
    /// The name of the token of the person.
    pub who: String,
    /// When, ISO 8601 in UTC.
    pub time: String,
    /// Where it comes from, in words.
    pub file: String,
}

/// The answer to `GET /api/model`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModelState {
    /// The hash of the machine file that corrects now.
    pub hash: String,
    /// The name that it states.
    pub name: String,
    /// Where it comes from.
    pub from: ModelSource,
    /// The operator who activated this model, the time and the source; null if the configuration or the centre did.
    pub put_in_force: Option<ModelInForce>,
    /// The machine file of the configuration.
    pub configured: ConfiguredModel,
    /// The machine file that an engineer has sent and that is not active; null: none.
    pub candidate: Option<CandidateBrief>,
    /// What became of each model, the newest first.
    pub history: Vec<ModelEntry>,
    /// The hashes of the models that are kept and can be gone back to.
    pub kept: Vec<String>,
    /// The largest machine file that is taken, bytes.
    pub largest_file_bytes: u64,
    /// Why no file is taken, in words; null: files are taken.
    #[serde(default)]
    pub no_files: Option<String>,
    /// What could not be kept on disk, or is damaged there, in words.
    pub trouble: Option<String>,
}

/// The machine file that the configuration names.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ConfiguredModel {
    /// Its path.
    pub file: String,
    /// Its hash as it is on disk now; null while it cannot be read.
    pub hash: Option<String>,
    /// Why it cannot be read.
    pub error: Option<String>,
    /// Whether it is another one than the model that corrects.
    pub differs: bool,
}

/// The machine file that an engineer has sent, in short.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct CandidateBrief {
    /// The name by which requests name it.
    pub id: String,
    /// The name of the token that sent it.
    pub who: String,
    /// When it was received, ISO 8601 in UTC.
    pub since: String,
    /// How far it is.
    pub step: CandidateStep,
}

/// How far a candidate is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum CandidateStep {
    /// It is being compared with the active model.
    Working,
    /// It can be activated if `refusal` of its result is null.
    Ready,
    /// It is no valid machine file.
    Refused,
}

/// The answer to `GET /api/model/candidate`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Candidate {
    /// Name, maker and step.
    #[serde(flatten)]
    pub brief: CandidateBrief,
    /// The file.
    pub file: UploadedFile,
    /// Why it is no valid machine file; null: it is, or is not compared yet.
    pub error: Option<String>,
    /// Its comparison with the active model.
    pub result: Option<CandidateResult>,
}

/// A file that was received.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct UploadedFile {
    /// Its name.
    pub name: String,
    /// Its size.
    pub bytes: u64,
}

/// A machine file, compared with the active model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CandidateResult {
    /// Its hash.
    pub hash: String,
    /// The name that it states.
    pub name: String,
    /// Its structure code.
    pub structure: String,
    /// Why it cannot be activated; null: it can.
    #[serde(default)]
    pub refusal: Option<String>,
    /// Messages that a person should read first; where it may be of another machine (name, structure, travels), that comes first.
    pub warnings: Vec<String>,
    /// The diagonals of the work space, by the active model and by this one.
    pub diagonals: Vec<ModelDiagonal>,
}

/// The displacement error along a diagonal of the work space.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModelDiagonal {
    /// The signs in which X, Y and Z move, as ISO 230-6 names it: `PPN`; `0` of an axis that stands.
    pub name: String,
    /// Distance from its start, error by the active and by the new model: mm, µm, µm.
    pub points: Vec<[f64; 3]>,
}

/// The body of `POST /api/model/discard`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ModelRequest {
    /// The candidate.
    pub candidate: String,
}

/// The body of `POST /api/model/activate`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ModelActivate {
    /// The candidate.
    pub candidate: String,
    /// The hash of the displayed result: no other model is activated.
    pub hash: String,
    /// The hash that a person confirms.
    #[serde(default)]
    pub confirm: Option<String>,
}

/// The body of `POST /api/model/back`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ModelBack {
    /// The hash of the model; null: the machine file of the configuration, as it is on disk now.
    pub hash: Option<String>,
    /// The hash that a person confirms.
    #[serde(default)]
    pub confirm: Option<String>,
}
