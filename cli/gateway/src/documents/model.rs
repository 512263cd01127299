//! The models of a machine: the active one, earlier ones, and an uploaded machine file.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::audit::utc_now;

/// Where a model comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ModelSource {
    /// The machine file named in the configuration.
    #[default]
    File,
    /// A machine file uploaded by an engineer.
    Upload,
    /// A machine file sent by the centre of the fleet.
    Centre,
}

/// Outcome of a request to activate a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ModelOutcome {
    /// The model was activated.
    InForce,
    /// The model was refused; nothing changed.
    Refused,
    /// The model must be confirmed first; nothing changed.
    MustBeConfirmed,
}

/// One line of the history of models.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModelEntry {
    /// Time of the outcome, ISO 8601 in UTC.
    pub time: String,
    /// Who requested it: the name of a token, `signal`, `centre` with the beginning of its key, or
    /// `gateway` for the model found at start-up.
    pub who: String,
    /// Hash of the machine file.
    pub hash: String,
    /// Name of the machine in the file.
    pub name: String,
    /// How the model reached the gateway.
    pub from: ModelSource,
    /// Description of the source: a file path, or the upload.
    pub file: String,
    /// Whether the model was activated, refused or must be confirmed.
    pub outcome: ModelOutcome,
    /// Why the model was refused; missing if it was not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
    /// Largest change of the correction of a linear axis in the work space against the previous
    /// model, µm; null: unknown.
    pub worst_um: Option<f64>,
    /// Largest change of the correction of a rotary axis in the work space against the previous
    /// model, µrad; null: unknown, or no rotary axis is corrected.
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
    /// The model that an operator activated; null if the configured machine file or that of the
    /// centre is active.
    pub in_force: Option<ModelInForce>,
    /// The history of models, oldest first.
    pub history: Vec<ModelEntry>,
}

/// The model that an operator activated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModelInForce {
    /// Hash of the machine file.
    pub hash: String,
    /// Token name of the operator.
    pub who: String,
    /// Time of activation, ISO 8601 in UTC.
    pub time: String,
    /// Description of the source: a file path, or the upload.
    pub file: String,
}

/// The answer to `GET /api/model`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModelState {
    /// Hash of the active machine file.
    pub hash: String,
    /// Name of the machine in the active machine file.
    pub name: String,
    /// Source of the active model.
    pub from: ModelSource,
    /// Activation by an operator; null if the configuration or the centre activated the model.
    pub put_in_force: Option<ModelInForce>,
    /// The machine file named in the configuration.
    pub configured: ConfiguredModel,
    /// The uploaded machine file that is not active; null: none.
    pub candidate: Option<CandidateBrief>,
    /// The history of models, newest first.
    pub history: Vec<ModelEntry>,
    /// Hashes of the stored models, which can be activated again.
    pub kept: Vec<String>,
    /// Maximum size of an uploaded machine file, bytes.
    pub largest_file_bytes: u64,
    /// Why uploads are refused; null: uploads are accepted.
    #[serde(default)]
    pub no_files: Option<String>,
    /// Description of models that could not be stored, or are damaged on disk.
    pub trouble: Option<String>,
}

/// The machine file that the configuration names.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ConfiguredModel {
    /// Path of the configured machine file.
    pub file: String,
    /// Hash of the file on disk now; null while it cannot be read.
    pub hash: Option<String>,
    /// Why the file cannot be read.
    pub error: Option<String>,
    /// Whether the file differs from the active model.
    pub differs: bool,
}

/// Summary of the uploaded machine file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct CandidateBrief {
    /// Identifier that requests use for this upload.
    pub id: String,
    /// Name of the token that uploaded the file.
    pub who: String,
    /// Time of the upload, ISO 8601 in UTC.
    pub since: String,
    /// Progress of the comparison.
    pub step: CandidateStep,
}

/// Progress of a candidate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum CandidateStep {
    /// The candidate is being compared with the active model.
    Working,
    /// The comparison is complete; the candidate can be activated if `refusal` is null.
    Ready,
    /// The file is not a valid machine file.
    Refused,
}

/// The answer to `GET /api/model/candidate`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Candidate {
    /// Identifier, uploader and progress.
    #[serde(flatten)]
    pub brief: CandidateBrief,
    /// Name and size of the upload.
    pub file: UploadedFile,
    /// Why the file is not a valid machine file; null: it is valid, or not parsed yet.
    pub error: Option<String>,
    /// Comparison with the active model; null until it is complete.
    pub result: Option<CandidateResult>,
}

/// A file that was received.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct UploadedFile {
    /// File name given at the upload.
    pub name: String,
    /// Size of the file.
    pub bytes: u64,
}

/// The comparison of an uploaded machine file with the active model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CandidateResult {
    /// Hash of the uploaded file.
    pub hash: String,
    /// Name of the machine in the uploaded file.
    pub name: String,
    /// Structure code of the uploaded machine.
    pub structure: String,
    /// Why the model cannot be activated; null: it can be.
    #[serde(default)]
    pub refusal: Option<String>,
    /// Warnings to be read before the activation; signs that the file belongs to another machine
    /// (name, structure, travels) come first.
    pub warnings: Vec<String>,
    /// Errors along the diagonals of the work space, by the active and by the new model.
    pub diagonals: Vec<ModelDiagonal>,
}

/// The displacement error along a diagonal of the work space.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModelDiagonal {
    /// Direction of motion of X, Y and Z, in the notation of ISO 230-6, such as `PPN`; `0` for an
    /// axis that does not move.
    pub name: String,
    /// Distance from the start of the diagonal, mm; error by the active model, µm; error by the new
    /// model, µm.
    pub points: Vec<[f64; 3]>,
}

/// The body of `POST /api/model/discard`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ModelRequest {
    /// Identifier of the candidate.
    pub candidate: String,
}

/// The body of `POST /api/model/activate`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ModelActivate {
    /// Identifier of the candidate.
    pub candidate: String,
    /// Hash in the displayed result; a candidate with another hash is refused.
    pub hash: String,
    /// Hash that the operator confirms.
    #[serde(default)]
    pub confirm: Option<String>,
}

/// The body of `POST /api/model/back`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ModelBack {
    /// Hash of the model; null: the configured machine file as it is on disk now.
    pub hash: Option<String>,
    /// Hash that the operator confirms.
    #[serde(default)]
    pub confirm: Option<String>,
}
