//! Proposes a measurement for one file of a folder, from its header, extension and name. The placeholder of a value
//! that remains open is `"?"`.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use volcomp_document::{InputError, Section, Value};
use volcomp_metrology::{
    DeviationUnit, FileFormat, Measurement, Metadata, MotionKind, Quantity, axis_named,
    errors_named,
};
use volcomp_model::{Axis, Machine};
use volcomp_vocabulary::{AxisName, Component, ErrorName};

use crate::checks::{beyond_travel, other_machine};

/// Placeholder of a value that the user has to state.
pub const OPEN: &str = "?";

/// Tables in which values may be open.
const TABLES: [&str; 2] = ["measurement", "squareness"];
/// Tables within a `[[measurement]]` whose values may be open individually.
const INNER: [&str; 3] = ["at", "columns", "channels"];

/// Question for an open value. `key` is a key of a `[[measurement]]` or a `[[squareness]]`; `inner` is a key of a table
/// that is the value of `key`.
pub(crate) fn question(key: &str, inner: Option<&str>) -> String {
    match (key, inner) {
        ("at", Some(axis)) => {
            // The decoder rejects a key that is not an axis.
            let unit = axis
                .parse::<AxisName>()
                .map_or("mm or deg", |axis| axis.kind().coordinate_unit());
            return format!(
                "where did axis {axis} stand during this test, {unit}? Default: at 0."
            );
        }
        ("channels", Some("target")) => "which channel is the position of the axis?",
        ("channels", Some("reading")) => "which channel is the instrument?",
        ("channels", Some("reading_is")) => {
            "does the instrument's channel hold a \"position\" or a \"deviation\"?"
        }
        ("channels", Some("unit")) | ("unit", None) => {
            "in which unit are the readings? An angle for a level or an autocollimator on a bridge, also where the error is a straightness."
        }
        ("error", None) => "which error does this file measure?",
        ("file", None) => "which of these files is the right one?",
        ("at", None) => "where did the other axes stand during this test?",
        ("point", None) => {
            "where was the measured point, [x, y, z] in mm of the machine, with the measured axis at 0? It gives the levers of the tilts. Default: the point of the axis in the machine file."
        }
        ("rides", None) => {
            "on which side of the joint was the measured point? \"carriage\": on the part that this axis moves, as a reflector on its slide is. \"other\": on the part along which it moves, so that the way travelled is a lever as well. Default: \"carriage\"."
        }
        ("sign", None) => {
            "whose motion did the instrument show, and with which sign: 1 or -1? 1 where a positive reading means that the tool went to plus seen from the workpiece; -1 where it means that the table or the guideway did, or where the instrument counts the other way round. Default: 1."
        }
        ("bridge_mm", None) => "how far apart were the feet of the bridge, mm?",
        ("reading", None) => "how is the sign of a tilt meant, \"right-hand\" or \"slope\"?",
        ("holds_location", None) => {
            "were the readings taken against the commanded pose (true) or against the axis itself (false)?"
        }
        ("reference_angle_urad", None) => {
            "by how much is the angle between the plus directions of the two references, the sides of the square or the two beams, more than 90°, µrad? 0 for a perfect square, else the value in its certificate; or state `value_urad`, the squareness itself, in its place."
        }
        _ => "which value is it?",
    }
    .to_owned()
}

/// Rejects a file with open values; the message states the first question and the number of further questions.
pub(crate) fn refuse_open(root: &Section<'_>) -> Result<(), InputError> {
    let mut open = Vec::new();
    for key in TABLES {
        let Some(value) = root.get(key) else { continue };
        for item in value.items()? {
            // The decoder reports items that are not a table.
            if let Ok(section) = item.section() {
                collect(&section, &mut open);
            }
        }
    }
    open.sort_by_key(|error: &InputError| error.line);
    let more = open.len().saturating_sub(1);
    let Some(mut first) = open.into_iter().next() else {
        return Ok(());
    };
    match more {
        0 => {}
        1 => first.message += " (and one more open question below)",
        // Writing to a String cannot fail.
        _ => drop(write!(first.message, " (and {more} more open questions below)")),
    }
    Err(first)
}

fn collect(section: &Section<'_>, open: &mut Vec<InputError>) {
    let is_open = |value: &Value<'_>| value.text().is_ok_and(|text| text == OPEN);
    let mut ask = |value: &Value<'_>, key: &str, inner: Option<&str>| {
        let question = question(key, inner);
        open.push(
            value.error(format!("open question: {question} State it in place of \"{OPEN}\"")),
        );
    };
    for (key, value) in section.values() {
        if is_open(&value) {
            ask(&value, key, None);
        } else if INNER.contains(&key)
            && let Ok(inner) = value.section()
        {
            for (name, value) in inner.values().filter(|(_, value)| is_open(value)) {
                ask(&value, key, Some(name));
            }
        }
    }
}

/// One `[[measurement]]` of a draft.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Proposed {
    /// Paths of the files; several if they are measurements of the same error at the same place.
    pub files: Vec<String>,
    /// The error, if known.
    pub error: Option<ErrorName>,
    /// Positions of the other axes during the test; `None` if unknown.
    #[cfg_attr(feature = "serde", serde(serialize_with = "as_map"))]
    #[cfg_attr(
        feature = "schema",
        schemars(with = "std::collections::BTreeMap<AxisName, Option<f64>>")
    )]
    pub at: Vec<(AxisName, Option<f64>)>,
    /// Keys with their values in the file; `"?"` for an open one.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub keys: Vec<(&'static str, String)>,
    /// Comments written above the table.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub said: Vec<String>,
    /// Facts of the file that determine its keys in addition to the error.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub(crate) facts: FileFacts,
}

#[cfg(feature = "serde")]
fn as_map<S: serde::Serializer>(
    at: &[(AxisName, Option<f64>)],
    serializer: S,
) -> Result<S::Ok, S::Error> {
    serializer.collect_map(at.iter().map(|(axis, place)| (axis, place)))
}

/// An unknown value that the user must state.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Question {
    /// Path of the measurement file or files, or name of the squareness.
    pub of: String,
    /// The key of the calibration file: `point`, `at.Y`.
    pub key: String,
    /// Text of the question.
    pub question: String,
}

impl Proposed {
    /// Open questions about the measurement, in the order of its keys.
    pub fn questions(&self) -> Vec<Question> {
        let of = self.files.join(", ");
        let mut questions = Vec::new();
        let mut ask = |key: String, question: String| {
            questions.push(Question { of: of.clone(), key, question });
        };
        if self.error.is_none() {
            ask("error".to_owned(), question("error", None));
        }
        if self.files.len() > 1 {
            ask("file".to_owned(), question("file", None));
        }
        for (axis, _) in self.at.iter().filter(|(_, place)| place.is_none()) {
            ask(format!("at.{axis}"), question("at", Some(&axis.to_string())));
        }
        for (key, value) in &self.keys {
            if *key == "channels" {
                let is_open = |inner: &&str| value.contains(&format!("{inner} = {}", open()));
                for inner in CHANNEL_KEYS.into_iter().filter(is_open) {
                    ask(format!("channels.{inner}"), question("channels", Some(inner)));
                }
            } else if *value == open() {
                ask((*key).to_owned(), question(key, None));
            }
        }
        questions
    }
}

/// Keys of `channels` without a default.
pub(crate) const CHANNEL_KEYS: [&str; 4] = ["target", "reading", "reading_is", "unit"];

pub(crate) fn open() -> String {
    format!("\"{OPEN}\"")
}

#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct FileFacts {
    /// Every axis of the machine, with its position if the file name or the header (title, location) states the
    /// position.
    pub(crate) places: Vec<(AxisName, Option<f64>)>,
    /// Axis that moved during the test; used if the error is not known.
    pub(crate) axis: Option<AxisName>,
    pub(crate) quantity: Option<Quantity>,
    pub(crate) format: Option<FileFormat>,
    pub(crate) unit: Option<DeviationUnit>,
    asks_unit: bool,
    /// Whether the file is a log whose channels are not yet assigned.
    is_log: bool,
    /// Whether the position of the line has no effect, because no tilt is known or can be computed from the lines.
    pub(crate) without_levers: bool,
}

impl Proposed {
    /// Adds the positions and keys that the current facts require. Keys that are already stated or answered keep their
    /// values.
    pub(crate) fn follow(&mut self) {
        let own = self.error.map(|error| error.axis).or(self.facts.axis);
        let held = self.facts.places.iter().filter(|(axis, _)| Some(*axis) != own);
        let known = |axis: AxisName| {
            let mut at = self.at.iter();
            at.find(|(of, _)| *of == axis).and_then(|(_, place)| *place)
        };
        self.at = held.map(|(axis, hinted)| (*axis, known(*axis).or(*hinted))).collect();
        let mut keys = keys(self.error, &self.facts);
        for (key, value) in &mut keys {
            if let Some((_, stated)) = self.keys.iter().find(|(of, _)| of == key) {
                value.clone_from(stated);
            }
        }
        self.keys = keys;
    }

    /// Whether a fact that determines the required keys (the error, the unit or another) is still
    /// open.
    pub(crate) fn may_lose_keys(&self) -> bool {
        self.error.is_none() || self.facts.asks_unit || self.facts.is_log
    }

    /// True for a key that is invalid for this measurement because it applies only to other errors
    /// or units.
    pub(crate) fn has_lost(&self, key: &str) -> bool {
        if let Some(letter) = key.strip_prefix("at.") {
            let is_it = |(axis, _): &(AxisName, Option<f64>)| axis.to_string() == letter;
            return self.facts.places.iter().any(is_it) && !self.at.iter().any(is_it);
        }
        FOLLOWING.contains(&key) && !self.keys.iter().any(|(of, _)| *of == key)
    }
}

/// Value of a key that keeps its default and is not written.
pub(crate) const DEFAULT: &str = "";

/// Asks for the positions of the lines if their lever arms have an effect: if a tilt is measured, is in the machine
/// file, or can be computed from two lines of one error.
pub(crate) fn ask_for_levers(proposed: &mut [Proposed], machine_has_tilts: bool) {
    let mut errors: Vec<ErrorName> = proposed.iter().filter_map(|of| of.error).collect();
    errors.sort_unstable();
    errors.dedup();
    // A file whose error is open may measure a tilt, or the same error as another file.
    let have_levers = machine_has_tilts
        || errors.len() < proposed.len()
        || errors.iter().any(|error| error.component.is_angular());
    for of in proposed {
        of.facts.without_levers = !have_levers;
        of.follow();
    }
}

const FOLLOWING: [&str; 6] = ["point", "rides", "holds_location", "sign", "bridge_mm", "reading"];

fn keys(error: Option<ErrorName>, facts: &FileFacts) -> Vec<(&'static str, String)> {
    let mut keys = Vec::new();
    if facts.is_log {
        let channels = CHANNEL_KEYS.map(|key| format!("{key} = {}", open()));
        keys.push(("channels", format!("{{ {} }}", channels.join(", "))));
    }
    let has_lever = !facts.without_levers || error.is_none_or(|error| error.axis.is_rotary());
    if has_lever && error.is_none_or(|error| !error.component.is_angular()) {
        keys.push(("point", open()));
        keys.push(("rides", open()));
    }
    if error.is_some_and(|error| error.axis.is_rotary()) {
        keys.push(("holds_location", open()));
    }
    if facts.asks_unit {
        keys.push(("unit", open()));
    }
    // For positioning, the sign does not depend on whether the table or the tool moved.
    let is_positioning = match error {
        Some(error) => MotionKind::of(error) == MotionKind::Positioning,
        None => facts.quantity.is_none_or(|q| q == Quantity::Positioning),
    };
    if !is_positioning || facts.format == Some(FileFormat::RenishawExport) {
        keys.push(("sign", open()));
    }
    // A straightness with readings in angles was measured by a level on a bridge, or by an angular interferometer.
    let is_straightness = error.is_some_and(|error| {
        MotionKind::of(error) == MotionKind::Straightness && !error.axis.is_rotary()
    });
    let reads_angles = match facts.unit {
        Some(unit) => unit == DeviationUnit::Urad,
        None => facts.quantity == Some(Quantity::Angle),
    };
    if is_straightness && reads_angles {
        keys.push(("method", "\"angular\"".to_owned()));
        keys.push(("bridge_mm", open()));
        keys.push(("reading", open()));
    }
    keys
}

pub(crate) fn of_log(name: String, path: &Path, machine: &Machine, channels: &str) -> Proposed {
    let hints = FileHints::of(path, &Metadata::default(), machine);
    let facts = FileFacts { is_log: true, ..facts_of_names(&hints, machine) };
    let mut found = proposed(name, hints.only_error(), facts);
    found.said.push(format!("a log of the channels {channels}"));
    found.said.extend(hints.contradictions);
    found
}

pub(crate) fn of_measurement(
    name: &str,
    path: &Path,
    measurement: &Measurement,
    machine: &Machine,
) -> Result<Proposed, String> {
    let hints = FileHints::of(path, &measurement.metadata, machine);
    let stated = measurement.metadata.axis.as_deref().and_then(axis_named);
    if let Some(axis) = stated.filter(|axis| machine.axis(*axis).is_none()) {
        return Err(format!("it states axis {axis}, which the machine does not have"));
    }
    let axis = stated.or(hints.axis);
    let mut said = vec![summary(measurement)];
    let mut candidates = match axis {
        Some(axis) => candidates(axis, measurement.quantity),
        None => Vec::new(),
    };
    let error = match hints.only_error() {
        Some(hinted) if stated.is_some_and(|axis| axis != hinted.axis) => {
            said.push(format!(
                "CONTRADICTION: the file states axis {}, its name or title says {hinted}",
                stated.map_or(String::new(), |axis| axis.to_string())
            ));
            None
        }
        Some(hinted) => {
            let fits = self::candidates(hinted.axis, measurement.quantity);
            let is_angular_method = measurement.quantity == Some(Quantity::Angle)
                && !hinted.component.is_angular()
                && !hinted.axis.is_rotary()
                && hinted.component.mcs_index() != hinted.axis.mcs_index();
            // A length under the name of a straightness is accepted: some programs also write straightness as .rtl.
            let is_length = measurement.quantity == Some(Quantity::Positioning)
                && !hinted.component.is_angular();
            if fits.contains(&hinted) || is_angular_method || is_length {
                Some(hinted)
            } else {
                candidates = fits;
                said.push(format!(
                    "CONTRADICTION: the name or title says {hinted}, the kind of file does not measure it"
                ));
                None
            }
        }
        None if hints.errors.len() > 1 => {
            let names: Vec<String> = hints.errors.iter().map(ToString::to_string).collect();
            said.push(format!("CONTRADICTION: name and title say {}", names.join(" and ")));
            None
        }
        None => match candidates[..] {
            [only] => Some(only),
            _ => None,
        },
    };
    check_targets(measurement, error.map(|error| error.axis).or(axis), machine)?;
    if error.is_none() && !candidates.is_empty() {
        let names: Vec<String> = candidates.iter().map(ToString::to_string).collect();
        said.push(format!("error: one of {}", names.join(", ")));
    } else if error.is_none() {
        let fits = axes_that_reach(measurement, machine);
        said.push(format!("the targets are within the travel of {fits}"));
    }
    said.extend(hints.contradictions.iter().cloned());
    let facts = FileFacts {
        axis,
        quantity: measurement.quantity,
        format: measurement.format,
        unit: measurement.unit,
        asks_unit: measurement.unit.is_none(),
        ..facts_of_names(&hints, machine)
    };
    let mut found = proposed(name.to_owned(), error, facts);
    found.said = said;
    Ok(found)
}

/// Messages on a file whose axis or machine differs from that of the measurement.
pub(crate) fn out_of_place(
    of: &Proposed,
    measurement: &Measurement,
    machine: &Machine,
) -> Vec<String> {
    let axis = of.error.and_then(|error| machine.axis(error.axis));
    let beyond = axis.and_then(|axis| beyond_travel(measurement, axis));
    let said = [beyond, other_machine(measurement, machine)];
    said.into_iter().flatten().collect()
}

fn facts_of_names(hints: &FileHints, machine: &Machine) -> FileFacts {
    let place = |axis: &Axis| {
        let place = hints.places.get(&axis.name).copied();
        // A position that the axis cannot reach is ignored.
        let place = place.filter(|place| axis.check_coordinate(*place).is_ok());
        (axis.name, place)
    };
    FileFacts { places: machine.axes().iter().map(place).collect(), ..FileFacts::default() }
}

fn proposed(file: String, error: Option<ErrorName>, facts: FileFacts) -> Proposed {
    let mut found = Proposed {
        files: vec![file],
        error,
        at: Vec::new(),
        keys: Vec::new(),
        said: Vec::new(),
        facts,
    };
    found.follow();
    found
}

fn candidates(axis: AxisName, quantity: Option<Quantity>) -> Vec<ErrorName> {
    let errors = Component::ALL.map(|component| ErrorName::motion(component, axis));
    let is_own = |error: &ErrorName| error.component.mcs_index() == axis.mcs_index();
    let fits = |error: &ErrorName| match quantity {
        None => true,
        Some(Quantity::Angle) => error.component.is_angular(),
        Some(Quantity::Straightness) => !error.component.is_angular() && !is_own(error),
        Some(Quantity::Positioning) => {
            is_own(error) && error.component.is_angular() == axis.is_rotary()
        }
    };
    errors.into_iter().filter(fits).collect()
}

fn check_targets(
    measurement: &Measurement,
    axis: Option<AxisName>,
    machine: &Machine,
) -> Result<(), String> {
    let Some(axis) = axis.and_then(|name| machine.axis(name)) else {
        return match axis {
            Some(axis) => Err(format!("it measures axis {axis}, which the machine does not have")),
            None => Ok(()),
        };
    };
    let targets = measurement.targets();
    let (Some(first), Some(last)) = (targets.first(), targets.last()) else {
        return Err("it holds no targets".to_owned());
    };
    if targets.iter().any(|target| axis.may_stand_at(*target)) {
        return Ok(());
    }
    let [low, high] = axis.travel;
    let unit = axis.name.kind().coordinate_unit();
    Err(format!(
        "its targets from {first} to {last} {unit} are not within the travel of {}, {low} to {high} {unit}",
        axis.name
    ))
}

fn axes_that_reach(measurement: &Measurement, machine: &Machine) -> String {
    let targets = measurement.targets();
    let reach = machine
        .axes()
        .iter()
        .filter(|axis| targets.iter().all(|target| axis.may_stand_at(*target)));
    let names: Vec<String> = reach.map(|axis| axis.name.to_string()).collect();
    if names.is_empty() { "no axis".to_owned() } else { names.join(", ") }
}

fn summary(measurement: &Measurement) -> String {
    let mut facts = Vec::new();
    facts.extend(measurement.format.map(|format| format.instrument().to_owned()));
    let meta = &measurement.metadata;
    for (key, text) in [
        ("machine", &meta.machine),
        ("axis", &meta.axis),
        ("date", &meta.date),
        ("location", &meta.location),
        ("title", &meta.title),
    ] {
        facts.extend(text.as_ref().map(|text| format!("{key} {text}")));
    }
    let targets = measurement.targets();
    if let [first, .., last] = targets[..] {
        facts.push(format!("{} targets from {first} to {last}", targets.len()));
    }
    facts.join("; ")
}

/// Error motions, axis and positions stated by the name of a file and by the title and location in its header.
#[derive(Debug, Default)]
pub(crate) struct FileHints {
    pub(crate) errors: Vec<ErrorName>,
    /// The only axis letter that is a separate word of the file name.
    pub(crate) axis: Option<AxisName>,
    /// Positions of axes: `y-z1050`, `X at Y = 0`.
    pub(crate) places: BTreeMap<AxisName, f64>,
    pub(crate) contradictions: Vec<String>,
}

impl FileHints {
    pub(crate) fn of(path: &Path, texts: &Metadata, machine: &Machine) -> Self {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let mut hints = Self::default();
        let texts = [texts.title.as_deref(), texts.location.as_deref()];
        let has = |error: &ErrorName| !error.location && machine.axis(error.axis).is_some();
        let all = [Some(stem.as_str())].into_iter().chain(texts).flatten();
        for error in all.flat_map(errors_named).filter(has) {
            if !hints.errors.contains(&error) {
                hints.errors.push(error);
            }
        }
        let words: Vec<&str> =
            stem.split(|c: char| !(c.is_ascii_alphanumeric() || c == '.')).collect();
        let mut alone = words
            .iter()
            .filter_map(|word| letter(word, machine).filter(|(_, rest)| rest.is_empty()));
        hints.axis = match (alone.next(), alone.next()) {
            (Some((axis, _)), None) => Some(axis),
            _ => None,
        };
        // A minus in a file name may be a dash, so only numbers without sign directly after their letter count.
        let in_name = words.iter().filter_map(|word| {
            let (axis, number) = letter(word, machine)?;
            let plain = number.bytes().all(|b| b.is_ascii_digit() || b == b'.');
            Some((axis, number.parse::<f64>().ok().filter(|_| plain)?))
        });
        let in_texts = texts.iter().flatten().flat_map(|text| stated_places(text));
        let mut contradicted = Vec::new();
        for (axis, place) in in_name.chain(in_texts) {
            match hints.places.get(&axis) {
                Some(other) if *other != place => {
                    contradicted.push(axis);
                    hints.contradictions.push(format!(
                        "CONTRADICTION: name, title and location say {axis} = {other} and {axis} = {place}"
                    ));
                }
                _ => {
                    hints.places.insert(axis, place);
                }
            }
        }
        // Contradictory positions are not used.
        hints.places.retain(|axis, _| !contradicted.contains(axis));
        hints
    }

    /// The error, if exactly one is named.
    pub(crate) fn only_error(&self) -> Option<ErrorName> {
        match self.errors[..] {
            [only] => Some(only),
            _ => None,
        }
    }
}

/// Splits a word that begins with the letter of an axis of the machine into the axis and the rest of the word.
fn letter<'w>(word: &'w str, machine: &Machine) -> Option<(AxisName, &'w str)> {
    let mut letters = word.chars();
    let first = letters.next()?.to_ascii_uppercase();
    let axis = AxisName::from_letter(first).filter(|axis| machine.axis(*axis).is_some())?;
    Some((axis, letters.as_str()))
}

/// Every position like `Y = 12.5` in a text.
fn stated_places(text: &str) -> Vec<(AxisName, f64)> {
    let mut places = Vec::new();
    let parts: Vec<&str> = text.split('=').collect();
    for pair in parts.windows(2) {
        let before = pair[0].trim_end();
        let mut letters = before.chars().rev();
        let axis = letters.next().and_then(|c| AxisName::from_letter(c.to_ascii_uppercase()));
        let stands_alone = letters.next().is_none_or(|c| !c.is_alphanumeric());
        let number = pair[1].trim_start();
        let end = number.find(|c: char| !(c.is_ascii_digit() || "+-.".contains(c)));
        let number = number[..end.unwrap_or(number.len())].parse::<f64>().ok();
        if let (Some(axis), true, Some(number)) = (axis, stands_alone, number) {
            places.push((axis, number));
        }
    }
    places
}

/// Sorts by error, axis first, with unknown errors last; measurements of one error by file.
pub(crate) fn sort(proposed: &mut [Proposed]) {
    let key = |of: &Proposed| {
        let error = of.error.map(|error| (error.axis.index(), error.component.index()));
        (error.is_none(), error, of.files.clone())
    };
    proposed.sort_by_key(key);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_question_for_a_position_has_the_unit_of_its_axis() {
        let asked = |axis| question("at", Some(axis));
        assert_eq!(asked("X"), "where did axis X stand during this test, mm? Default: at 0.");
        assert!(asked("C").contains("this test, deg?"), "{}", asked("C"));
    }

    #[test]
    fn places_stand_behind_their_letter() {
        assert_eq!(
            stated_places("X at Y = 0, Z=-1050.5 mm"),
            [(AxisName::Y, 0.0), (AxisName::Z, -1050.5)]
        );
        assert_eq!(stated_places("FLY = 3; Y ="), []);
        assert_eq!(stated_places("= = ="), []);
    }
}
