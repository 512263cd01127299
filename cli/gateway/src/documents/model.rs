//! The models of a machine: which one corrects, which ones there were, and the one that somebody is making from measurements.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Where a model comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ModelSource {
    /// The machine file that the configuration names.
    #[default]
    File,
    /// A machine file, or measurement files, that a person has uploaded.
    Upload,
    /// The centre of the fleet.
    Centre,
}

/// What became of a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ModelOutcome {
    /// It was put in force.
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

/// The file `models/standing.json` beside the audit log: the model that a person has put in force, and the history.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModelsKept {
    /// The model that a person has put in force; null: the configured machine file corrects, or that of the centre.
    pub in_force: Option<ModelInForce>,
    /// What became of each model, the oldest first.
    pub history: Vec<ModelEntry>,
}

/// The model that a person has put in force.
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
    /// Who put it in force and when, where a person has.
    pub put_in_force: Option<ModelInForce>,
    /// The machine file of the configuration.
    pub configured: ConfiguredModel,
    /// The model that somebody is making; null: nobody is.
    pub candidate: Option<CandidateBrief>,
    /// What became of each model, the newest first.
    pub history: Vec<ModelEntry>,
    /// The hashes of the models that are kept and can be gone back to.
    pub kept: Vec<String>,
    /// The largest file that can be uploaded, bytes.
    pub largest_file_bytes: u64,
    /// The largest sum of all files of one upload, bytes.
    pub largest_upload_bytes: u64,
    /// The largest number of files of one upload.
    pub most_files: usize,
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

/// The model that somebody is making, in short.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct CandidateBrief {
    /// The name by which requests name it.
    pub id: String,
    /// The name of the token of whoever is making it.
    pub who: String,
    /// When it was begun, ISO 8601 in UTC.
    pub since: String,
    /// How far it is.
    pub step: CandidateStep,
}

/// How far a candidate is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum CandidateStep {
    /// Files are being uploaded.
    Uploading,
    /// The files are looked through, or the calibration is made.
    Working,
    /// Questions are open.
    Asking,
    /// There is a machine file, which can be put in force.
    Ready,
}

/// The answer to `GET /api/model/candidate`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Candidate {
    /// Name, maker and step.
    #[serde(flatten)]
    pub brief: CandidateBrief,
    /// The hash of the model in force when it was begun: what is not measured is taken from that one.
    pub based_on: String,
    /// The files that were uploaded.
    pub files: Vec<UploadedFile>,
    /// What went wrong last, in words; null: nothing.
    pub error: Option<String>,
    /// The calibration file that was drafted from measurement files, and its questions.
    pub draft: Option<CandidateDraft>,
    /// The machine file that came of it.
    pub result: Option<CandidateResult>,
}

/// A file that was uploaded.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct UploadedFile {
    /// Its name in the folder of uploads.
    pub name: String,
    /// Its size.
    pub bytes: u64,
}

/// A drafted calibration file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CandidateDraft {
    /// Its text, with the answers so far.
    pub text: String,
    /// The measurements that it proposes, in the order by which answers name them.
    pub measurements: Vec<DraftedMeasurement>,
    /// What nobody but the one who measured can say.
    pub questions: Vec<DraftQuestion>,
    /// The answers so far, as they were typed, those that were refused included.
    pub answers: Vec<DraftAnswer>,
    /// Files that were given the same place, or hold the same readings.
    pub conflicts: Vec<String>,
    /// Files that are not used, each with the reason.
    pub left_over: Vec<String>,
    /// What is odd about the files that are used.
    pub notes: Vec<String>,
}

/// A measurement of a draft.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DraftedMeasurement {
    /// The files; several where one must be chosen.
    pub files: Vec<String>,
    /// The error that they measure; null: asked for.
    pub error: Option<String>,
    /// What the files say of themselves.
    pub said: Vec<String>,
}

/// A question of a draft.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DraftQuestion {
    /// The number of the measurement, or the name of a squareness: `of` of the answer.
    pub of: String,
    /// The file or files, or the squareness, in words.
    pub about: String,
    /// The key of the calibration file: `point`, `at.Y`.
    pub key: String,
    /// What is asked.
    pub question: String,
    /// The answers that there are; empty: a number or a text.
    pub choices: Vec<String>,
}

/// An answer to a question of a draft.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DraftAnswer {
    /// As in the question.
    pub of: String,
    /// As in the question, or `leave_out`.
    pub key: String,
    /// What was typed; for `leave_out` `true`.
    pub value: String,
}

/// The machine file that came of an upload.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CandidateResult {
    /// Its hash.
    pub hash: String,
    /// The name that it states.
    pub name: String,
    /// Its structure code.
    pub structure: String,
    /// Why it cannot be put in force, in words; null: it can.
    #[serde(default)]
    pub refusal: Option<String>,
    /// Messages that a person should read first; where it may be of another machine (name, structure, travels), that comes first.
    pub warnings: Vec<String>,
    /// The measurement files that it was made of; empty where a machine file was uploaded.
    #[serde(default)]
    pub used: Vec<String>,
    /// Every fitted curve, angular errors first; empty where a machine file was uploaded.
    pub fits: Vec<ModelFit>,
    /// Every squareness that was found, by its error name, µrad.
    pub squareness_urad: BTreeMap<String, f64>,
    /// The diagonals of the work space, by the model in force and by this one.
    pub diagonals: Vec<ModelDiagonal>,
}

/// A fitted curve as plain data, to be drawn.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModelFit {
    /// The error: `EXX`.
    pub error: String,
    /// `forward` or `backward`; null: one curve for both directions.
    pub direction: Option<String>,
    /// The kind of curve, as the machine file names it.
    pub curve: String,
    /// The unit of the coordinate: `mm` or `deg`.
    pub along: String,
    /// The unit of the error: `um` or `urad`.
    pub unit: String,
    /// The smallest residual, reading minus curve.
    pub residual_min: f64,
    /// The largest residual.
    pub residual_max: f64,
    /// Root mean square of the residuals.
    pub residual_rms: f64,
    /// Root mean square of the leave-one-out errors; null where a reading cannot be predicted from the others.
    pub leave_one_out: Option<f64>,
    /// Mean readings as they were fitted: coordinate, reading.
    pub readings: Vec<[f64; 2]>,
    /// Coordinate and residual of each of them.
    pub residuals: Vec<[f64; 2]>,
    /// The curve: coordinate, value.
    pub fit: Vec<[f64; 2]>,
    /// The same error in the model in force, mean of both directions where this is one of two: coordinate, value.
    pub before: Vec<[f64; 2]>,
    /// Where the uncertainty is known: coordinate, lower and upper end of the band (k = 2); null where it is not.
    pub band: Option<Vec<[f64; 3]>>,
}

/// The displacement error along a diagonal of the work space.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModelDiagonal {
    /// The signs in which X, Y and Z move, as ISO 230-6 names it: `PPN`; `0` of an axis that stands.
    pub name: String,
    /// Distance from its beginning, error by the model in force and by the new one: mm, µm, µm.
    pub points: Vec<[f64; 3]>,
}

/// The body of `POST /api/model/answers`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ModelAnswers {
    /// The candidate.
    pub candidate: String,
    /// All answers, those that were given before included.
    pub answers: Vec<DraftAnswer>,
}

/// The body of `POST /api/model/draft` and `discard`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ModelRequest {
    /// The candidate.
    pub candidate: String,
}

/// The body of `POST /api/model/take-off`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ModelTakeOff {
    /// The candidate.
    pub candidate: String,
    /// The name of the file, as `files` of the candidate has it.
    pub name: String,
}

/// The body of `POST /api/model/activate`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ModelActivate {
    /// The candidate.
    pub candidate: String,
    /// The hash of the result that a person has seen: no other one is put in force.
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
