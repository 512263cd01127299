//! The JSON document of `volcomp calibrate --draft`.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_calibrate::Draft;

/// The document of `volcomp calibrate --draft`.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct CalibrateDraft {
    /// The calibration file that was written.
    pub(crate) file: String,
    /// What it proposes for each measurement file.
    pub(crate) measurements: Vec<Proposed>,
    /// What only the one who measured can say; empty: the file is complete.
    pub(crate) questions: Vec<Question>,
    /// Files in one place, or with the same readings.
    pub(crate) conflicts: Vec<String>,
    /// Files that fit nothing.
    pub(crate) left_over: Vec<LeftOver>,
    /// What is odd about the files that are used.
    pub(crate) warnings: Vec<String>,
}

/// One measurement of the draft.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Proposed {
    /// The measurement files; several where one has to be chosen.
    pub(crate) files: Vec<String>,
    /// The error; null: not known.
    pub(crate) error: Option<String>,
    /// Where the other axes stood, mm or deg; null: not known.
    pub(crate) at: BTreeMap<String, Option<f64>>,
}

/// A value that is not known.
#[derive(Debug, Serialize, JsonSchema)]
#[expect(
    clippy::struct_field_names,
    reason = "the key of the document is the word for it"
)]
pub(crate) struct Question {
    /// The measurement files, or the squareness.
    pub(crate) of: String,
    /// The key of the calibration file: `point`, `at.Y`.
    pub(crate) key: String,
    /// What is asked.
    pub(crate) question: String,
}

/// A file that fits nothing.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct LeftOver {
    /// The file.
    pub(crate) file: String,
    /// Why it is not used.
    pub(crate) reason: String,
}

impl CalibrateDraft {
    /// The document of a draft that was written to `file`.
    pub(crate) fn new(file: String, draft: &Draft) -> Self {
        let proposed = |of: &volcomp_calibrate::Proposed| Proposed {
            files: of.files.clone(),
            error: of.error.map(|error| error.to_string()),
            at: of
                .at
                .iter()
                .map(|(axis, place)| (axis.to_string(), *place))
                .collect(),
        };
        let question = |of: &volcomp_calibrate::Question| Question {
            of: of.of.clone(),
            key: of.key.clone(),
            question: of.question.clone(),
        };
        let left_over = |of: &volcomp_calibrate::LeftOver| LeftOver {
            file: of.file.clone(),
            reason: of.reason.clone(),
        };
        Self {
            file,
            measurements: draft.proposed.iter().map(proposed).collect(),
            questions: draft.questions.iter().map(question).collect(),
            conflicts: draft.conflicts.clone(),
            left_over: draft.left_over.iter().map(left_over).collect(),
            warnings: draft.notes.clone(),
        }
    }
}
