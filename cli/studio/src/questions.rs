//! The drafted calibration of a folder for the web page: measurements, questions with choices and defaults, answers.

use serde::{Deserialize, Serialize};
use volcomp_calibrate::{Answer, AnswerError, Draft, LEAVE_OUT, Proposed, Question, Subject, Turn};
use volcomp_model::Machine;
use volcomp_vocabulary::ErrorName;

/// An answer of the user, as typed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TypedAnswer {
    /// The measurement file or files, or the squareness, as in [`DraftQuestion::of`].
    pub of: String,
    /// The key, as in [`DraftQuestion::key`], or `leave_out`.
    pub key: String,
    /// The typed value; `true` for `leave_out`.
    pub value: String,
}

/// A question about a value that the files do not state.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct DraftQuestion {
    /// The measurement file or files, or the squareness.
    pub of: String,
    /// The key of the calibration file: `point`, `at.Y`.
    pub key: String,
    pub question: String,
    /// Possible answers; empty: any number or text.
    pub choices: Vec<String>,
    /// The value used if the calibration file does not state the key.
    pub default: Option<String>,
}

/// A drafted calibration.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct DraftState {
    /// Every question, including the answered ones.
    pub questions: Vec<DraftQuestion>,
    pub answers: Vec<TypedAnswer>,
    /// Number of questions without an answer.
    pub open: usize,
    /// Files for the same error and position, or with the same readings.
    pub conflicts: Vec<String>,
    /// Notes from the checks of the measurement files in use.
    pub notes: Vec<String>,
    /// The calibration file with these answers.
    pub text: String,
}

pub(crate) struct AnsweredDraft {
    /// The draft with only the answers that determine further questions: errors and units.
    pub(crate) decided: Draft,
    pub(crate) whole: Draft,
}

/// Applies answers in three passes: errors, units, and all others. Each pass determines the questions of the next one.
/// Ignores answers to questions that no longer exist because their file or its error has changed.
pub(crate) fn with_answers(
    draft: &Draft,
    given: &[TypedAnswer],
) -> Result<AnsweredDraft, AnswerError> {
    let is_asked = |draft: &Draft, answer: &Answer| match &answer.of {
        Subject::Measurement(place) => {
            let mut asked = draft.proposed[*place].questions().into_iter();
            answer.key == LEAVE_OUT || asked.any(|question| question.key == answer.key)
        }
        Subject::Squareness(error) => {
            let name = error.to_string();
            let mut asked = draft.questions.iter();
            asked.any(|q| q.of == name && (answer.key == LEAVE_OUT || q.key == answer.key))
        }
    };
    let all: Vec<Answer> = given.iter().filter_map(|of| answer(draft, of)).collect();
    let mut decided = draft.clone();
    for turn in [Turn::Error, Turn::Unit] {
        let now = all.iter().filter(|answer| Turn::of(&answer.key) == turn);
        let now: Vec<Answer> = now.filter(|of| is_asked(&decided, of)).cloned().collect();
        decided = decided.answered(&now)?;
    }
    let rest = all.iter().filter(|of| Turn::of(&of.key) == Turn::Other);
    let rest: Vec<Answer> = rest.filter(|of| is_asked(&decided, of)).cloned().collect();
    let whole = decided.answered(&rest)?;
    Ok(AnsweredDraft { decided, whole })
}

/// File names of a measurement, comma-separated. They identify the measurement in questions and answers.
pub(crate) fn name_of(proposed: &Proposed) -> String {
    proposed.files.join(", ")
}

/// Converts a typed answer; `None` if the folder no longer has the measurement of the answer.
fn answer(draft: &Draft, given: &TypedAnswer) -> Option<Answer> {
    let mut proposed = draft.proposed.iter();
    let of = match proposed.position(|of| name_of(of) == given.of) {
        Some(place) => Subject::Measurement(place),
        None => Subject::Squareness(given.of.parse::<ErrorName>().ok()?),
    };
    Some(Answer { of, key: given.key.clone(), value: given.value.clone() })
}

/// Every question of a draft, including the answered ones, so that answers can be changed.
pub(crate) fn questions(draft: &Draft, decided: &Draft, machine: &Machine) -> Vec<DraftQuestion> {
    let mut asked = Vec::new();
    let mut of_measurements = 0;
    for (first, now) in draft.proposed.iter().zip(&decided.proposed) {
        let open = now.questions();
        of_measurements += open.len();
        // An answered question about an error or a unit is no longer open.
        let mut all = first.questions();
        all.retain(|of| {
            Turn::of(&of.key) != Turn::Other && open.iter().all(|open| open.key != of.key)
        });
        all.extend(open);
        asked.extend(all.into_iter().map(|question| DraftQuestion {
            of: name_of(first),
            choices: choices(&question, &first.files),
            default: default_of(&question.key, now.error, machine),
            key: question.key,
            question: question.question,
        }));
    }
    let squares = decided.questions.iter().skip(of_measurements);
    asked.extend(squares.map(|question| DraftQuestion {
        of: question.of.clone(),
        key: question.key.clone(),
        question: question.question.clone(),
        choices: Vec::new(),
        default: None,
    }));
    asked
}

fn choices(question: &Question, files: &[String]) -> Vec<String> {
    match question.key.as_str() {
        "file" => files.to_vec(),
        _ => question.choices().iter().map(|word| (*word).to_owned()).collect(),
    }
}

fn default_of(key: &str, error: Option<ErrorName>, machine: &Machine) -> Option<String> {
    let text = match key {
        "rides" => "carriage".to_owned(),
        "sign" => "1".to_owned(),
        "point" => {
            let [x, y, z] = machine.axis(error?.axis)?.point_mm.unwrap_or_default();
            format!("{x}, {y}, {z}")
        }
        _ if key.starts_with("at.") => "0".to_owned(),
        _ => return None,
    };
    Some(text)
}
