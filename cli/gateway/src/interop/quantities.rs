//! The table of the gateway's quantities, and the active alarms by place, level and code.
//!
//! Prometheus, MTConnect and OPC UA are generated from the table, so a new quantity needs one row.

use std::collections::BTreeSet;

use volcomp_guard::Reasons;
use volcomp_vocabulary::{AxisKind, AxisName};

use crate::documents::{
    ByAxis, PathState, ProvenName, SchemeName, SensorState, StateName, Status, round,
};

/// The parts of a gateway that determine its quantities; constant while it runs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Shape {
    pub machine: String,
    /// Axis letters in the order X Y Z A B C U V W.
    pub axes: Vec<AxisName>,
    /// Sensor names in the order of the configuration.
    pub sensors: Vec<String>,
    pub controllers: usize,
}

/// The part of the gateway to which a quantity belongs. Numbers are indices into the tables of the configuration, from
/// 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// The gateway itself.
    Gateway,
    Axis(AxisName),
    Tool,
    Sensor(usize),
    Controller(usize),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    Mm,
    Deg,
    Um,
    Urad,
    Degc,
    Ms,
}

impl Unit {
    /// Unit symbol for display.
    pub fn symbol(self) -> &'static str {
        match self {
            Self::Mm => "mm",
            Self::Deg => "deg",
            Self::Um => "µm",
            Self::Urad => "µrad",
            Self::Degc => "°C",
            Self::Ms => "ms",
        }
    }

    /// Returns the unit for an axis of this kind; `self` is the unit for linear axes, as in the table.
    fn on(self, kind: AxisKind) -> Self {
        match (kind, self) {
            (AxisKind::Rotary, Self::Mm) => Self::Deg,
            (AxisKind::Rotary, Self::Um) => Self::Urad,
            _ => self,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A number in a unit.
    Number(Unit),
    /// An unsigned integer.
    Whole,
    /// An unsigned integer that never decreases while the gateway runs.
    Count,
    /// A boolean.
    Truth,
    /// A string.
    Text,
}

#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// A finite number in the unit of the quantity.
    Number(f64),
    /// An unsigned integer or a count.
    Whole(u64),
    Truth(bool),
    Text(String),
}

/// Reliability of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Quality {
    /// The value is current.
    Good,
    /// The value is current and in use, but with a warning.
    Doubtful,
    /// The value is an earlier one; the current value is unknown.
    Stale,
    /// No value is known.
    Unknown,
}

/// The value of a quantity at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct Reading {
    /// The value; `None` exactly if `quality` is [`Quality::Unknown`].
    pub value: Option<Value>,
    pub quality: Quality,
    /// Age of the value, ms.
    pub age_ms: f64,
}

/// A quantity: its names, its description, and the function that reads it from a state.
pub struct Quantity {
    pub part: Part,
    /// Name of the quantity within its part: lower-case letters and `_`.
    pub row: &'static str,
    /// Name of the quantity, unique in the gateway: lower-case letters, digits and `_`, starting with a letter.
    pub key: String,
    /// Name of the axis, sensor or controller; empty for other parts.
    pub of: String,
    pub kind: Kind,
    /// Description in English.
    pub help: &'static str,
    read: Box<dyn Fn(&Status) -> Reading + Send + Sync>,
}

/// A row of the table for one kind of part: name within the part, data type (for linear axes), help text and read
/// function. `P` identifies the part among those of its kind.
pub struct Row<P>(pub &'static str, pub Kind, pub &'static str, pub fn(&Status, P) -> Reading);

const UM: Kind = Kind::Number(Unit::Um);
const URAD: Kind = Kind::Number(Unit::Urad);
const MS: Kind = Kind::Number(Unit::Ms);

// Values that are constant while the gateway runs are always known. Other values are known only while cycles run.
#[rustfmt::skip]
const OF_GATEWAY: &[Row<()>] = &[
    Row("state", Kind::Text, "State of the gateway in one word",
        |s, ()| known(s, Value::Text(s.state.name().to_owned()))),
    Row("reasons", Kind::Text, "Reasons of the state and warnings, separated by semicolons",
        |s, ()| known(s, Value::Text(reasons(s).join("; ")))),
    Row("armed", Kind::Truth, "Whether it corrects, or will resume automatically",
        |s, ()| while_cycling(s, Some(Value::Truth(s.armed)))),
    Row("correction_known", Kind::Truth, "Whether the correction that the control applies was confirmed in time",
        |s, ()| known(s, Value::Truth(s.correction_known))),
    Row("age", MS, "Age of this state",
        |s, ()| good(s, number(Some(s.age_ms)))),
    Row("active_controller", Kind::Whole, "Place of the controller that corrects, from 0",
        |s, ()| while_cycling(s, s.controller.as_ref().map(|active| Value::Whole(active.number as u64)))),
    Row("faults", Kind::Count, "Failed exchanges with controllers since the start",
        |s, ()| while_cycling(s, Some(Value::Whole(s.faults)))),
    Row("overruns", Kind::Count, "Missed periods since the start",
        |s, ()| while_cycling(s, Some(Value::Whole(s.cycle.overruns)))),
    Row("held_back", Kind::Count, "Cycles since the start in which slew or acceleration limits held the correction back",
        |s, ()| while_cycling(s, Some(Value::Whole(s.held_back)))),
    Row("simulated", Kind::Truth, "Whether the machine is the built-in simulation",
        |s, ()| known(s, Value::Truth(s.simulated))),
    Row("machine", Kind::Text, "Name of the machine in its machine file",
        |s, ()| known(s, Value::Text(s.machine.name.clone()))),
    Row("machine_file", Kind::Text, "Checksum of the machine file in use",
        |s, ()| known(s, Value::Text(s.machine.hash.clone()))),
];

#[rustfmt::skip]
const OF_AXIS: &[Row<AxisName>] = &[
    Row("position", Kind::Number(Unit::Mm), "Position without the correction", position),
    Row("correction", UM, "Correction that the control was last confirmed to apply", correction),
    Row("wanted", UM, "Correction that the model asks for, before limits and ramps", wanted),
    Row("sent", UM, "Correction that was sent last without a failure",
        |s, axis| good(s, number(by_kind(axis, &s.sent_um, &s.sent_urad)))),
    Row("proven", Kind::Truth, "Whether a test shift showed if the position contains the correction",
        |s, axis| good(s, s.proven.get(&axis).map(|proven| Value::Truth(*proven != ProvenName::NotProven)))),
];

/// Quantities in µrad exist only for machines with rotary axes.
#[rustfmt::skip]
const OF_TOOL: &[Row<()>] = &[
    Row("error", UM, "Length of the model's position error of the tool tip without correction",
        |s, ()| of_tool(s, s.error_um)),
    Row("residual", UM, "Length of the position error that the applied correction leaves by the model",
        |s, ()| of_tool(s, s.residual_um)),
    Row("axis_error", URAD, "Length of the model's direction error of the tool axis without correction",
        |s, ()| of_tool(s, s.error_axis_urad)),
    Row("axis_residual", URAD, "Length of the direction error that the applied correction leaves by the model",
        |s, ()| of_tool(s, s.residual_axis_urad)),
];

#[rustfmt::skip]
const OF_SENSOR: &[Row<usize>] = &[
    Row("temperature", Kind::Number(Unit::Degc), "Temperature of a sensor",
        |s, place| temperature(s, s.temperatures.get(place))),
];

#[rustfmt::skip]
const OF_CONTROLLER: &[Row<usize>] = &[
    Row("answered", MS, "Time since the controller answered last",
        |s, place| of_path(s, place, |path| number(path.answered_ms))),
    Row("positions_age", MS, "Age of the positions of the controller",
        |s, place| of_path(s, place, |path| number(path.positions_ms))),
    Row("confirmed", MS, "Time since the correction of the controller was confirmed last",
        |s, place| of_path(s, place, |path| number(path.confirmed_ms))),
    Row("holds_correction", Kind::Truth, "Whether the controller applies a correction other than zero",
        |s, place| of_path(s, place, |path| path.holds_correction.map(Value::Truth))),
    Row("barrier", Kind::Truth, "Whether a barrier in the control takes the correction",
        |s, place| of_path(s, place, |path| Some(Value::Truth(path.scheme == SchemeName::Barrier)))),
];

/// The quantities of a gateway, in table order.
pub fn quantities(shape: &Shape) -> Vec<Quantity> {
    let mut list = Vec::new();
    for row in OF_GATEWAY {
        list.push(row.quantity(Part::Gateway, "", ()));
    }
    for &axis in &shape.axes {
        for row in OF_AXIS {
            list.push(row.quantity(Part::Axis(axis), &axis.to_string(), axis));
        }
    }
    let has_rotary = shape.axes.iter().any(|axis| axis.is_rotary());
    for row in OF_TOOL.iter().filter(|row| row.1 == UM || has_rotary) {
        list.push(row.quantity(Part::Tool, "", ()));
    }
    for (place, sensor) in shape.sensors.iter().enumerate() {
        for row in OF_SENSOR {
            list.push(row.quantity(Part::Sensor(place), sensor, place));
        }
    }
    for place in 0..shape.controllers {
        for row in OF_CONTROLLER {
            list.push(row.quantity(Part::Controller(place), &place.to_string(), place));
        }
    }
    number_twins(&mut list);
    list
}

impl<P: Copy + Send + Sync + 'static> Row<P> {
    /// Creates the quantity for one part; `of` is the name of its axis, sensor or controller.
    pub fn quantity(&self, part: Part, of: &str, id: P) -> Quantity {
        let Self(row, kind, help, read) = *self;
        let kind = match (kind, part) {
            (Kind::Number(unit), Part::Axis(axis)) => Kind::Number(unit.on(axis.kind())),
            _ => kind,
        };
        let key = match part {
            Part::Gateway => row.to_owned(),
            Part::Axis(_) => format!("{}_{row}", key_of(of)),
            Part::Tool => format!("tool_{row}"),
            Part::Sensor(_) => format!("{row}_{}", key_of(of)),
            Part::Controller(place) => format!("path_{place}_{row}"),
        };
        Quantity {
            part,
            row,
            key,
            of: of.to_owned(),
            kind,
            help,
            read: Box::new(move |status| read(status, id)),
        }
    }
}

impl Quantity {
    /// Reads the quantity from a state.
    pub fn read(&self, status: &Status) -> Reading {
        (self.read)(status)
    }

    /// Display path: folder names, outermost first.
    pub fn folder(&self) -> Vec<&str> {
        match self.part {
            Part::Gateway => vec!["Gateway"],
            Part::Axis(_) => vec!["Axes", &self.of],
            Part::Tool => vec!["Tool"],
            Part::Sensor(_) => vec!["Temperatures", &self.of],
            Part::Controller(_) => vec!["Controllers", &self.of],
        }
    }

    /// Name of the quantity within its folder, in CamelCase, such as `PositionsAge`.
    pub fn name(&self) -> String {
        let words = self.row.split('_').map(|word| {
            let (first, rest) = word.split_at(1);
            first.to_ascii_uppercase() + rest
        });
        words.collect()
    }
}

/// Converts a name to a key: letters and digits in lower case, other characters as `_`.
pub(super) fn key_of(name: &str) -> String {
    let key = |c: char| match c {
        c if c.is_ascii_alphanumeric() => c.to_ascii_lowercase(),
        _ => '_',
    };
    name.chars().map(key).collect()
}

/// Key of the alarms that belong to the quantity with the key `key`.
pub(super) fn condition_key(key: &str) -> String {
    format!("{key}_condition")
}

/// Makes the keys unique by appending a number to a key that equals an earlier key or the alarm key of one. Equal keys
/// occur because a key replaces all special characters of a name by `_`.
fn number_twins(list: &mut [Quantity]) {
    let mut taken = BTreeSet::new();
    for quantity in list {
        let first = quantity.key.clone();
        for number in 2_usize.. {
            let keys = [quantity.key.clone(), condition_key(&quantity.key)];
            if keys.iter().all(|key| !taken.contains(key)) {
                taken.extend(keys);
                break;
            }
            quantity.key = format!("{first}_{number}");
        }
    }
}

impl Reading {
    fn new(value: Option<Value>, quality: Quality, age_ms: f64) -> Self {
        let quality = match value {
            Some(_) => quality,
            None => Quality::Unknown,
        };
        Self { value, quality, age_ms }
    }

    /// The value if it is [`Good`](Quality::Good) or [`Doubtful`](Quality::Doubtful).
    pub fn current(&self) -> Option<&Value> {
        let is_current = self.quality <= Quality::Doubtful;
        self.value.as_ref().filter(|_| is_current)
    }
}

fn good(status: &Status, value: Option<Value>) -> Reading {
    Reading::new(value, Quality::Good, status.age_ms)
}

fn known(status: &Status, value: Value) -> Reading {
    good(status, Some(value))
}

fn while_cycling(status: &Status, value: Option<Value>) -> Reading {
    good(status, value.filter(|_| status.state != StateName::Unknown))
}

/// Number as a value; `None` if it is not finite.
fn number(value: Option<f64>) -> Option<Value> {
    value.filter(|value| value.is_finite()).map(Value::Number)
}

fn by_kind(axis: AxisName, linear: &ByAxis, rotary: &ByAxis) -> Option<f64> {
    let values = match axis.kind() {
        AxisKind::Linear => linear,
        AxisKind::Rotary => rotary,
    };
    values.get(&axis).copied()
}

fn of_path(status: &Status, place: usize, value: impl Fn(&PathState) -> Option<Value>) -> Reading {
    good(status, status.controllers.get(place).and_then(value))
}

fn active(status: &Status) -> Option<&PathState> {
    status.controllers.iter().find(|path| path.active)
}

/// Reading of a value that depends on the positions, and therefore has their quality and age.
fn by_position(status: &Status, value: Option<f64>) -> Reading {
    let old = Reasons::POSITIONS_STALE | Reasons::POSITIONS_LOST;
    let is_old = (old.texts()).any(|old| status.reasons.iter().any(|reason| reason == old));
    let quality = if is_old { Quality::Stale } else { Quality::Good };
    let age_ms = active(status).and_then(|path| path.positions_ms);
    Reading::new(number(value), quality, age_ms.unwrap_or(status.age_ms))
}

fn position(status: &Status, axis: AxisName) -> Reading {
    let position = by_kind(axis, &status.positions_mm, &status.positions_deg);
    by_position(status, position)
}

fn wanted(status: &Status, axis: AxisName) -> Reading {
    let is_known = position(status, axis).value.is_some();
    let wanted = by_kind(axis, &status.wanted_um, &status.wanted_urad);
    by_position(status, wanted.filter(|_| is_known))
}

fn of_tool(status: &Status, error: Option<[f64; 3]>) -> Reading {
    by_position(status, error.map(|error| round(length(error))))
}

fn correction(status: &Status, axis: AxisName) -> Reading {
    let correction = by_kind(axis, &status.correction_um, &status.correction_urad);
    let quality = if status.correction_known { Quality::Good } else { Quality::Stale };
    let confirmed = active(status).and_then(|path| path.confirmed_ms);
    Reading::new(number(correction), quality, confirmed.unwrap_or(status.age_ms))
}

fn temperature(status: &Status, sensor: Option<&SensorState>) -> Reading {
    let degc = sensor.and_then(|sensor| sensor.degc);
    let is_doubtful = sensor.is_some_and(|sensor| sensor.reason.is_some());
    let quality = if is_doubtful { Quality::Doubtful } else { Quality::Good };
    Reading::new(number(degc), quality, status.age_ms)
}

/// Euclidean length of an error vector, in the unit of its components.
pub(crate) fn length(error: [f64; 3]) -> f64 {
    error.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// The reasons of a state without their variable numbers, so that the text of each reason is constant.
pub(crate) fn reasons(status: &Status) -> Vec<&str> {
    let reasons = status.reasons.iter();
    // Some reasons contain values or names, such as the duration of a silence or a sensor.
    reasons
        .map(|reason| {
            let known = Reasons::with_text(reason).and_then(|reason| reason.texts().next());
            known.unwrap_or_else(|| {
                reason.strip_suffix(" ms").map_or(reason.as_str(), |_| "no cycle")
            })
        })
        .collect()
}

/// The source of an alarm. Numbers are indices into the tables of the configuration, from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// The guard, which limits the correction of the axes.
    Guard,
    Sensor(usize),
    Controller(usize),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// For information only.
    Warning,
    /// Requires action by an operator.
    Fault,
}

/// Time without a response after which a controller counts as silent, ms. The dashboard uses the same time.
const SILENT_MS: f64 = 2000.0;

/// An alarm that is active now.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Alarm {
    pub level: Level,
    /// Stable identifier of the alarm's cause: lower-case letters, digits and `_`.
    pub code: String,
    /// Text of the reason, in English.
    pub text: String,
}

/// The places of a gateway: the guard, the sensors, the controllers.
pub fn places(shape: &Shape) -> Vec<Place> {
    let sensors = (0..shape.sensors.len()).map(Place::Sensor);
    let controllers = (0..shape.controllers).map(Place::Controller);
    [Place::Guard].into_iter().chain(sensors).chain(controllers).collect()
}

impl Place {
    /// Active alarms of this place; `None` if the state of the gateway is unknown.
    pub fn alarms(self, status: &Status) -> Option<Vec<Alarm>> {
        if status.state == StateName::Unknown {
            return None;
        }
        match self {
            Self::Guard => {
                let is_faulted = status.state == StateName::Faulted;
                let level = |reason: &str| {
                    let forbids = Reasons::with_text(reason)
                        .is_none_or(|reason| !Reasons::DOES_NOT_FORBID.contains(reason));
                    if is_faulted && forbids { Level::Fault } else { Level::Warning }
                };
                let reasons = reasons(status).into_iter();
                Some(reasons.map(|reason| alarm(level(reason), reason)).collect())
            }
            Self::Sensor(place) => {
                let sensor = status.temperatures.get(place)?;
                let level = match sensor.degc {
                    Some(_) => Level::Warning,
                    None => Level::Fault,
                };
                let reason = sensor.reason.iter();
                Some(reason.map(|reason| alarm(level, reason)).collect())
            }
            Self::Controller(place) => {
                let path = status.controllers.get(place)?;
                let is_silent = path.answered_ms.is_none_or(|ms| ms > SILENT_MS);
                let silent = is_silent.then(|| alarm(Level::Fault, "controller does not answer"));
                let reasons = path.reasons.iter().map(|reason| alarm(Level::Warning, reason));
                Some(silent.into_iter().chain(reasons).collect())
            }
        }
    }
}

fn alarm(level: Level, text: &str) -> Alarm {
    Alarm { level, code: key_of(text), text: text.to_owned() }
}
