//! Answers to the open questions of a draft, as typed by the user. Each answer is checked, and the text of the calibration file is generated from
//! them.

use volcomp_document::toml_string;
use volcomp_metrology::ReadingUnit;
use volcomp_vocabulary::ErrorName;

use crate::{
    draft::{Draft, LeftOver, Square, conflicts_of, squares_of, text_of},
    proposal::{CHANNEL_KEYS, DEFAULT, Proposed, Question, ask_for_levers, open},
};

/// Key of an answer that removes a measurement or a squareness from the draft.
pub const LEAVE_OUT: &str = "leave_out";
/// Answer that keeps the default of a key.
pub const KEEP_DEFAULT: &str = "default";
/// Keys that state where a line was measured. They matter only on a machine with tilts.
pub const LEVER_KEYS: [&str; 2] = ["point", "rides"];
/// Keys that have a default, in addition to the positions in `at`.
const DEFAULTED: [&str; 4] = ["point", "rides", "sign", "holds_location"];

const UNITS: [&str; 8] = ["mm", "um", "nm", "urad", "mrad", "rad", "arcsec", "deg"];

/// What a question refers to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Subject {
    /// A measurement, by its index in [`Draft::proposed`].
    Measurement(usize),
    /// A squareness: `EC0Y`, `EA0Z` or `EB0Z`.
    Squareness(ErrorName),
}

/// An answer as typed by the user.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Answer {
    /// The measurement or squareness to which the answer belongs.
    pub of: Subject,
    /// Key of the question: `error`, `file`, `at.Y`, `point`; or `leave_out`, with `true`, which removes the measurement or squareness.
    pub key: String,
    /// The value: numbers separated by commas, or words without quotation marks; [`KEEP_DEFAULT`] for a key that has a default.
    pub value: String,
}

/// Reason why an answer is rejected.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum AnswerError {
    #[error("{subject}: the draft has no such measurement")]
    Subject { subject: String },
    #[error("{subject}: {key} is not an open question")]
    Key { subject: String, key: String },
    #[error("{subject}: {key}: found {found:?}, expected {expected}")]
    Value { subject: String, key: String, found: String, expected: String },
}

/// Order in which answers are applied. The error of a measurement determines all its other keys; the unit determines
/// some.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Turn {
    /// Answers that state the error of a measurement; applied first, because they determine its
    /// other keys.
    Error,
    /// Answers that state the unit of the readings; applied second, because an angular unit adds
    /// keys.
    Unit,
    /// All other answers; no key depends on them.
    Other,
}

impl Turn {
    /// All turns, in the order in which answers are applied.
    pub const ALL: [Self; 3] = [Self::Error, Self::Unit, Self::Other];

    /// The turn in which an answer to this key is applied.
    pub fn of(key: &str) -> Self {
        match key {
            "error" => Self::Error,
            "unit" | "channels.unit" => Self::Unit,
            _ => Self::Other,
        }
    }
}

impl Question {
    /// Valid answers; empty for a number or a text. The files to choose from are listed in `of`.
    pub fn choices(&self) -> &'static [&'static str] {
        match self.key.as_str() {
            "rides" => &["carriage", "other"],
            "reading" => &["right-hand", "slope"],
            "sign" => &["1", "-1"],
            "holds_location" => &["true", "false"],
            "channels.reading_is" => &["position", "deviation"],
            "unit" | "channels.unit" => &UNITS,
            _ => &[],
        }
    }
}

impl Draft {
    /// Applies these answers to the draft; questions without an answer stay open. Indices of measurements are those of
    /// this draft.
    ///
    /// # Errors
    /// The first answer that is rejected.
    pub fn answered(&self, answers: &[Answer]) -> Result<Self, AnswerError> {
        let mut proposed: Vec<Option<Proposed>> = self.proposed.iter().cloned().map(Some).collect();
        let mut squares = self.squares.clone();
        let mut left_over = self.left_over.clone();
        let mut notes = self.notes.clone();
        let mut in_order: Vec<&Answer> = answers.iter().collect();
        in_order.sort_by_key(|answer| Turn::of(&answer.key));
        let first_other = in_order.partition_point(|answer| Turn::of(&answer.key) != Turn::Other);
        let (errors, others) = in_order.split_at(first_other);
        for step in errors.iter().map(Some).chain([None]).chain(others.iter().map(Some)) {
            let Some(answer) = step else {
                // All errors are applied, so it is known now whether lever arms matter.
                levers(&mut proposed, self.machine_has_tilts);
                continue;
            };
            match &answer.of {
                Subject::Measurement(place) => {
                    let Some(slot) = proposed.get_mut(*place) else {
                        let subject = format!("measurement {}", place + 1);
                        return Err(AnswerError::Subject { subject });
                    };
                    if answer.key == LEAVE_OUT {
                        if truth(answer, &place.to_string())?
                            && let Some(of) = slot.take()
                        {
                            left_over.extend(of.files.into_iter().map(|file| LeftOver {
                                file,
                                reason: "left out by a person".to_owned(),
                                error: of.error,
                            }));
                        }
                    } else if let Some(of) = slot {
                        let is_lever = LEVER_KEYS.contains(&answer.key.as_str());
                        let may_lose = self.proposed[*place].may_lose_keys()
                            || (is_lever && of.facts.without_levers);
                        if may_lose && of.has_lost(&answer.key) {
                            notes.push(not_used(of, answer));
                        } else {
                            answer_measurement(of, answer)?;
                        }
                    }
                }
                Subject::Squareness(error) => {
                    let Some(at) = squares.iter().position(|square| square.error == *error) else {
                        // The squareness was removed with one of its straightness errors, or
                        // omitted before.
                        if self.squares.iter().any(|square| square.error == *error) {
                            continue;
                        }
                        let subject = error.to_string();
                        return Err(AnswerError::Subject { subject });
                    };
                    if answer.key == LEAVE_OUT {
                        if truth(answer, &error.to_string())? {
                            squares.remove(at);
                        }
                    } else {
                        answer_square(&mut squares[at], answer)?;
                    }
                }
            }
        }
        let proposed: Vec<Proposed> = proposed.into_iter().flatten().collect();
        let possible = squares_of(&proposed);
        squares.retain(|square| possible.iter().any(|of| of.error == square.error));
        // A newly answered error may complete a squareness.
        let new = |of: &Square| self.squares.iter().all(|known| known.error != of.error);
        squares.extend(possible.into_iter().filter(new));
        let mut conflicts = self.conflicts.clone();
        conflicts.extend(conflicts_of(&proposed));
        let mut questions: Vec<Question> = proposed.iter().flat_map(Proposed::questions).collect();
        let is_open = |square: &&Square| square.reference_angle_urad.is_none();
        questions.extend(squares.iter().filter(is_open).map(Square::question));
        Ok(Self {
            scanned: self.scanned.clone(),
            text: text_of(&self.machine_file, &proposed, &squares, &conflicts, &left_over),
            proposed,
            questions,
            conflicts,
            left_over,
            notes,
            machine_file: self.machine_file.clone(),
            machine_has_tilts: self.machine_has_tilts,
            squares,
        })
    }
}

impl Draft {
    /// Answers to every open question of a key, each in the form accepted by [`Draft::answered`]. With `of`, only the
    /// questions of measurements and squarenesses whose error or axis is `of` (`EYX`, `Y`) are answered. Empty if there
    /// is no such question.
    pub fn for_all(&self, of: Option<&str>, key: &str, value: &str) -> Vec<Answer> {
        let is_meant = |error: Option<ErrorName>| {
            of.is_none_or(|of| {
                error.is_some_and(|error| error.to_string() == of || error.axis.to_string() == of)
            })
        };
        let answer = |of: Subject| Answer { of, key: key.to_owned(), value: value.to_owned() };
        let measurements = self.proposed.iter().enumerate();
        let measurements = measurements.filter(|(_, proposed)| {
            let mut asked = proposed.questions().into_iter();
            is_meant(proposed.error) && asked.any(|asked| asked.key == key)
        });
        let squares = self.squares.iter().filter(|square| {
            let is_open = square.reference_angle_urad.is_none();
            is_open && is_meant(Some(square.error)) && square.question().key == key
        });
        let measurements = measurements.map(|(place, _)| answer(Subject::Measurement(place)));
        let squares = squares.map(|square| answer(Subject::Squareness(square.error)));
        measurements.chain(squares).collect()
    }
}

/// Opens the questions for positions of lines, if lever arms have an effect with the answered errors.
fn levers(proposed: &mut [Option<Proposed>], machine_has_tilts: bool) {
    let mut known: Vec<Proposed> = proposed.iter().flatten().cloned().collect();
    ask_for_levers(&mut known, machine_has_tilts);
    for (slot, of) in proposed.iter_mut().flatten().zip(known) {
        *slot = of;
    }
}

fn not_used(of: &Proposed, answer: &Answer) -> String {
    let error =
        of.error.map_or_else(|| "a measurement like this".to_owned(), |error| error.to_string());
    format!(
        "{}: {} is no question for {error}: the answer {} is not used",
        of.files.join(", "),
        answer.key,
        answer.value.trim()
    )
}

fn answer_measurement(of: &mut Proposed, answer: &Answer) -> Result<(), AnswerError> {
    let subject = of.files.join(", ");
    let wrong = |expected: &str| value_error(answer, &subject, expected);
    let value = answer.value.trim();
    match answer.key.as_str() {
        "error" => {
            let error: ErrorName =
                value.parse().map_err(|_| wrong("the name of an error, such as EYX"))?;
            of.error = Some(error);
            of.follow();
            return Ok(());
        }
        "file" => {
            if !of.files.iter().any(|file| file == value) {
                return Err(wrong(&format!("one of {subject}")));
            }
            of.files = vec![value.to_owned()];
            return Ok(());
        }
        _ => {}
    }
    if let Some(letter) = answer.key.strip_prefix("at.") {
        let mut places = of.at.iter_mut();
        let place = places.find(|(axis, _)| axis.to_string() == letter);
        let Some((axis, place)) = place else {
            return Err(key_error(answer, &subject));
        };
        let (axis, unit) = (*axis, axis.kind().coordinate_unit());
        if value == KEEP_DEFAULT {
            of.at.retain(|(other, _)| *other != axis);
            return Ok(());
        }
        *place = Some(number(value).ok_or_else(|| wrong(&format!("a number of {unit}")))?);
        return Ok(());
    }
    if let Some(inner) = answer.key.strip_prefix("channels.") {
        let channels = of.keys.iter_mut().find(|(key, _)| *key == "channels");
        let Some((_, channels)) = channels.filter(|_| CHANNEL_KEYS.contains(&inner)) else {
            return Err(key_error(answer, &subject));
        };
        let asked = format!("{inner} = {}", open());
        *channels = channels.replace(&asked, &format!("{inner} = {}", toml_string(value)));
        if inner == "unit" {
            set_unit(of, value);
        }
        return Ok(());
    }
    let Some((key, held)) = of.keys.iter_mut().find(|(key, _)| *key == answer.key) else {
        return Err(key_error(answer, &subject));
    };
    if value == KEEP_DEFAULT && DEFAULTED.contains(key) {
        DEFAULT.clone_into(held);
        return Ok(());
    }
    *held = encoded(key, value).map_err(|expected| value_error(answer, &subject, expected))?;
    if answer.key == "unit" {
        set_unit(of, value);
    }
    Ok(())
}

fn set_unit(of: &mut Proposed, unit: &str) {
    of.facts.unit = ReadingUnit::named(unit).map(ReadingUnit::deviation_unit);
    of.follow();
}

/// Formats a value for the calibration file; `Err` describes the expected value.
fn encoded(key: &str, value: &str) -> Result<String, &'static str> {
    let word = |known: &[&str], expected| {
        if known.contains(&value) { Ok(toml_string(value)) } else { Err(expected) }
    };
    match key {
        "point" => {
            let list = value.trim_start_matches('[').trim_end_matches(']');
            let numbers: Option<Vec<f64>> = list.split(',').map(number).collect();
            match numbers.as_deref() {
                Some([x, y, z]) => Ok(format!("[{x:?}, {y:?}, {z:?}]")),
                _ => Err("three numbers x, y, z in mm, separated by commas"),
            }
        }
        "bridge_mm" => match number(value) {
            Some(length) if length > 0.0 => Ok(format!("{length:?}")),
            _ => Err("a length in mm above 0"),
        },
        "sign" => match value {
            "1" | "+1" => Ok("1".to_owned()),
            "-1" | "−1" => Ok("-1".to_owned()),
            _ => Err("1 or -1"),
        },
        "holds_location" => match value {
            "true" | "false" => Ok(value.to_owned()),
            _ => Err("true or false"),
        },
        "unit" => word(&UNITS, "one of mm, um, nm, urad, mrad, rad, arcsec, deg"),
        "rides" => word(&["carriage", "other"], "carriage or other"),
        "reading" => word(&["right-hand", "slope"], "right-hand or slope"),
        _ => Ok(toml_string(value)),
    }
}

fn answer_square(square: &mut Square, answer: &Answer) -> Result<(), AnswerError> {
    let subject = square.error.to_string();
    if answer.key != "reference_angle_urad" {
        return Err(key_error(answer, &subject));
    }
    let angle = number(answer.value.trim());
    let angle = angle.ok_or_else(|| value_error(answer, &subject, "a number of µrad"))?;
    square.reference_angle_urad = Some(angle);
    Ok(())
}

fn number(text: &str) -> Option<f64> {
    let number: f64 = text.trim().replace('−', "-").parse().ok()?;
    number.is_finite().then_some(number)
}

fn truth(answer: &Answer, subject: &str) -> Result<bool, AnswerError> {
    match answer.value.trim() {
        "true" => Ok(true),
        "false" => Ok(false),
        _ => Err(value_error(answer, subject, "true or false")),
    }
}

fn key_error(answer: &Answer, subject: &str) -> AnswerError {
    AnswerError::Key { subject: subject.to_owned(), key: answer.key.clone() }
}

fn value_error(answer: &Answer, subject: &str, expected: &str) -> AnswerError {
    AnswerError::Value {
        subject: subject.to_owned(),
        key: answer.key.clone(),
        found: answer.value.clone(),
        expected: expected.to_owned(),
    }
}
