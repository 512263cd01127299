//! The quantities that other systems are told: one list for all of them, made for a machine once and read from its state at
//! any time.

use volcomp_guard::Reasons;
use volcomp_vocabulary::{AxisKind, AxisName};

use crate::documents::{ByAxis, PathState, SchemeName, SensorState, StateName, Status, round};

/// The parts of a gateway that decide which quantities there are. They stay the same while it runs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Shape {
    /// The name of the machine.
    pub machine: String,
    /// The letters of its axes in the order X Y Z A B C U V W.
    pub axes: Vec<AxisName>,
    /// The names of its temperatures in the order of the configuration.
    pub sensors: Vec<String>,
    /// The number of its controllers.
    pub controllers: usize,
}

/// What a quantity tells. Numbers are places in the order of the configuration, from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum What {
    /// The state of the gateway in one word.
    State,
    /// Its reasons, one after the other.
    Reasons,
    /// Whether it corrects, or will again by itself.
    Armed,
    /// Whether the machine is the built-in simulation.
    Simulated,
    /// The age of what is told.
    Age,
    /// The controller that corrects.
    ActiveController,
    /// Whether the correction that the control applies is known.
    CorrectionKnown,
    /// Exchanges with controllers that failed so far.
    Faults,
    /// Periods that were missed so far.
    Overruns,
    /// The name of the machine.
    Machine,
    /// The checksum of the machine file.
    MachineFile,
    /// The position of an axis without the correction.
    Position(AxisName),
    /// The correction that the control applies.
    Correction(AxisName),
    /// The correction that the model asks for.
    Wanted(AxisName),
    /// The correction that was sent last.
    Sent(AxisName),
    /// The length of the position error of the tool without correction.
    Error,
    /// The length of the position error that the correction leaves.
    Residual,
    /// The length of the direction error of the tool axis without correction.
    AxisError,
    /// The length of the direction error that the correction leaves.
    AxisResidual,
    /// A temperature.
    Temperature(usize),
    /// The time since a controller answered last.
    Answered(usize),
    /// The age of the positions of a controller.
    PositionsAge(usize),
    /// The time since the correction of a controller was confirmed last.
    Confirmed(usize),
    /// Whether a controller applies a correction other than zero.
    HoldsCorrection(usize),
    /// Whether a barrier in the control takes the correction.
    Barrier(usize),
}

/// The unit of a quantity that is a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// Millimetres.
    Mm,
    /// Degrees.
    Deg,
    /// Micrometres.
    Um,
    /// Microradians.
    Urad,
    /// Degrees Celsius.
    Degc,
    /// Milliseconds.
    Ms,
}

impl Unit {
    /// The unit as people read it.
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
}

/// The type of the value of a quantity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A number in a unit.
    Number(Unit),
    /// A whole number.
    Whole,
    /// Yes or no.
    Truth,
    /// A text.
    Text,
}

/// The value of a quantity.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// A finite number in the unit of the quantity.
    Number(f64),
    /// A whole number.
    Whole(u64),
    /// Yes or no.
    Truth(bool),
    /// A text.
    Text(String),
}

/// What a value is worth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Quality {
    /// It is so.
    Good,
    /// It is used, and something speaks against it.
    Doubtful,
    /// It was so; what is so now is not known.
    Stale,
    /// Nothing is known.
    Unknown,
}

/// One quantity at one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct Reading {
    /// The value; `None` exactly where nothing is known.
    pub value: Option<Value>,
    /// What it is worth.
    pub quality: Quality,
    /// How old it is, ms.
    pub age_ms: f64,
}

/// A quantity: what it is called and what it means.
#[derive(Clone, Debug, PartialEq)]
pub struct Quantity {
    /// What it tells.
    pub what: What,
    /// A name of small letters, digits and `_` that begins with a letter; no two quantities have the same.
    pub key: String,
    /// Where it stands for people: folders from the outermost on.
    pub folder: Vec<String>,
    /// Its name in its folder.
    pub name: &'static str,
    /// The type of its values.
    pub kind: Kind,
    /// Its meaning in words.
    pub help: &'static str,
}

/// The quantities of a gateway, in order.
pub fn quantities(shape: &Shape) -> Vec<Quantity> {
    let mut list = Vec::new();
    let gateway = || vec!["Gateway".to_owned()];
    for (what, key, name, kind, help) in OF_THE_GATEWAY {
        list.push(quantity(*what, *key, gateway(), name, *kind, help));
    }
    for &axis in &shape.axes {
        list.extend(of_axis(axis));
    }
    let tool = || vec!["Tool".to_owned()];
    let has_rotary = shape.axes.iter().any(|axis| axis.is_rotary());
    for (what, key, name, kind, help) in OF_THE_TOOL {
        if *kind == Kind::Number(Unit::Um) || has_rotary {
            list.push(quantity(*what, *key, tool(), name, *kind, help));
        }
    }
    for (place, sensor) in shape.sensors.iter().enumerate() {
        list.push(quantity(
            What::Temperature(place),
            format!("temperature_{}", key_of(sensor)),
            vec!["Temperatures".to_owned(), sensor.clone()],
            "Temperature",
            Kind::Number(Unit::Degc),
            "Temperature of a sensor",
        ));
    }
    for place in 0..shape.controllers {
        list.extend(of_controller(place));
    }
    tell_apart(&mut list);
    list
}

type Row = (What, &'static str, &'static str, Kind, &'static str);

const OF_THE_GATEWAY: &[Row] = &[
    (
        What::State,
        "state",
        "State",
        Kind::Text,
        "State of the gateway in one word",
    ),
    (
        What::Reasons,
        "reasons",
        "Reasons",
        Kind::Text,
        "Why the state is what it is, and what else is to be known; between them a semicolon",
    ),
    (
        What::Armed,
        "armed",
        "Armed",
        Kind::Truth,
        "Whether it corrects, or will again by itself",
    ),
    (
        What::CorrectionKnown,
        "correction_known",
        "CorrectionKnown",
        Kind::Truth,
        "Whether the correction that the control applies was confirmed in time",
    ),
    (
        What::Age,
        "age",
        "Age",
        Kind::Number(Unit::Ms),
        "Age of what is told",
    ),
    (
        What::ActiveController,
        "active_controller",
        "ActiveController",
        Kind::Whole,
        "Place of the controller that corrects, from 0",
    ),
    (
        What::Faults,
        "faults",
        "Faults",
        Kind::Whole,
        "Exchanges with controllers that failed since the start",
    ),
    (
        What::Overruns,
        "overruns",
        "Overruns",
        Kind::Whole,
        "Periods that were missed since the start",
    ),
    (
        What::Simulated,
        "simulated",
        "Simulated",
        Kind::Truth,
        "Whether the machine is the built-in simulation",
    ),
    (
        What::Machine,
        "machine",
        "Machine",
        Kind::Text,
        "Name of the machine in its machine file",
    ),
    (
        What::MachineFile,
        "machine_file",
        "MachineFile",
        Kind::Text,
        "Checksum of the machine file that corrects",
    ),
];

const OF_THE_TOOL: &[Row] = &[
    (
        What::Error,
        "tool_error",
        "Error",
        Kind::Number(Unit::Um),
        "Length of the model's position error of the tool tip without correction",
    ),
    (
        What::Residual,
        "tool_residual",
        "Residual",
        Kind::Number(Unit::Um),
        "Length of the position error that the applied correction leaves by the model",
    ),
    (
        What::AxisError,
        "tool_axis_error",
        "AxisError",
        Kind::Number(Unit::Urad),
        "Length of the model's direction error of the tool axis without correction",
    ),
    (
        What::AxisResidual,
        "tool_axis_residual",
        "AxisResidual",
        Kind::Number(Unit::Urad),
        "Length of the direction error that the applied correction leaves by the model",
    ),
];

fn of_axis(axis: AxisName) -> [Quantity; 4] {
    let (coordinate, correction) = match axis.kind() {
        AxisKind::Linear => (Unit::Mm, Unit::Um),
        AxisKind::Rotary => (Unit::Deg, Unit::Urad),
    };
    let of = |what, key: &str, name, unit, help| {
        let letter = axis.to_string();
        let key = format!("{}_{key}", letter.to_lowercase());
        let folder = vec!["Axes".to_owned(), letter];
        quantity(what, key, folder, name, Kind::Number(unit), help)
    };
    [
        of(
            What::Position(axis),
            "position",
            "Position",
            coordinate,
            "Position without the correction",
        ),
        of(
            What::Correction(axis),
            "correction",
            "Correction",
            correction,
            "Correction that the control was last confirmed to apply",
        ),
        of(
            What::Wanted(axis),
            "wanted",
            "Wanted",
            correction,
            "Correction that the model asks for, before limits and ramps",
        ),
        of(
            What::Sent(axis),
            "sent",
            "Sent",
            correction,
            "Correction that was sent last without a failure",
        ),
    ]
}

fn of_controller(place: usize) -> [Quantity; 5] {
    let of = |what, key: &str, name, kind, help| {
        let folder = vec!["Controllers".to_owned(), place.to_string()];
        quantity(
            what,
            format!("path_{place}_{key}"),
            folder,
            name,
            kind,
            help,
        )
    };
    let ms = Kind::Number(Unit::Ms);
    [
        of(
            What::Answered(place),
            "answered",
            "Answered",
            ms,
            "Time since the controller answered last",
        ),
        of(
            What::PositionsAge(place),
            "positions_age",
            "PositionsAge",
            ms,
            "Age of the positions of the controller",
        ),
        of(
            What::Confirmed(place),
            "confirmed",
            "Confirmed",
            ms,
            "Time since the correction of the controller was confirmed last",
        ),
        of(
            What::HoldsCorrection(place),
            "holds_correction",
            "HoldsCorrection",
            Kind::Truth,
            "Whether the controller applies a correction other than zero",
        ),
        of(
            What::Barrier(place),
            "barrier",
            "Barrier",
            Kind::Truth,
            "Whether a barrier in the control takes the correction",
        ),
    ]
}

fn quantity(
    what: What,
    key: impl Into<String>,
    folder: Vec<String>,
    name: &'static str,
    kind: Kind,
    help: &'static str,
) -> Quantity {
    Quantity {
        what,
        key: key.into(),
        folder,
        name,
        kind,
        help,
    }
}

/// The letters and digits of a name, others as `_`.
pub(super) fn key_of(name: &str) -> String {
    let key = |c: char| match c {
        c if c.is_ascii_alphanumeric() => c.to_ascii_lowercase(),
        _ => '_',
    };
    name.chars().map(key).collect()
}

/// Gives those whose names differ in other signs only a number behind them.
fn tell_apart(list: &mut [Quantity]) {
    let mut taken = std::collections::BTreeSet::new();
    for quantity in list {
        let first = quantity.key.clone();
        for number in 2_usize.. {
            if taken.insert(quantity.key.clone()) {
                break;
            }
            quantity.key = format!("{first}_{number}");
        }
    }
}

impl What {
    /// The quantity in a state.
    pub fn of(self, status: &Status) -> Reading {
        let is_silent = status.state == StateName::Unknown;
        let known = |value: Option<Value>| Reading::good(value, status.age_ms);
        let now = |value: Value| known(Some(value).filter(|_| !is_silent));
        let path = |place: usize| status.controllers.get(place);
        match self {
            // What does not change while the gateway runs, and that nothing is known, is known all the time.
            Self::State => known(Some(Value::Text(status.state.name().to_owned()))),
            Self::Reasons => known(Some(Value::Text(reasons(status).join("; ")))),
            Self::Age => known(number(Some(status.age_ms))),
            Self::Simulated => known(Some(Value::Truth(status.simulated))),
            Self::Machine => known(Some(Value::Text(status.machine.name.clone()))),
            Self::MachineFile => known(Some(Value::Text(status.machine.hash.clone()))),
            Self::Barrier(place) => {
                known(path(place).map(|path| Value::Truth(path.scheme == SchemeName::Barrier)))
            }
            Self::Armed => now(Value::Truth(status.armed)),
            Self::CorrectionKnown => known(Some(Value::Truth(status.correction_known))),
            Self::Faults => now(Value::Whole(status.faults)),
            Self::Overruns => now(Value::Whole(status.cycle.overruns)),
            Self::ActiveController => {
                let active = status.controller.as_ref().filter(|_| !is_silent);
                known(active.map(|controller| Value::Whole(controller.number as u64)))
            }
            Self::Position(axis) => position(status, axis),
            Self::Correction(axis) => correction(status, axis),
            Self::Wanted(axis) => {
                let wanted = by_kind(axis, &status.wanted_um, &status.wanted_urad);
                // It is computed from the positions.
                let position = position(status, axis);
                Reading::of(number(wanted), position.quality, position.age_ms)
            }
            Self::Sent(axis) => known(number(by_kind(axis, &status.sent_um, &status.sent_urad))),
            Self::Error => of_tool(status, status.error_um),
            Self::Residual => of_tool(status, status.residual_um),
            Self::AxisError => of_tool(status, status.error_axis_urad),
            Self::AxisResidual => of_tool(status, status.residual_axis_urad),
            Self::Temperature(place) => temperature(status, status.temperatures.get(place)),
            Self::Answered(place) => known(age(path(place), |path| path.answered_ms)),
            Self::PositionsAge(place) => known(age(path(place), |path| path.positions_ms)),
            Self::Confirmed(place) => known(age(path(place), |path| path.confirmed_ms)),
            Self::HoldsCorrection(place) => {
                known(path(place).and_then(|path| path.holds_correction.map(Value::Truth)))
            }
        }
    }
}

impl Reading {
    fn of(value: Option<Value>, quality: Quality, age_ms: f64) -> Self {
        Self {
            quality: if value.is_some() {
                quality
            } else {
                Quality::Unknown
            },
            value,
            age_ms,
        }
    }

    fn good(value: Option<Value>, age_ms: f64) -> Self {
        Self::of(value, Quality::Good, age_ms)
    }

    /// Whether the value may be taken for what is so now.
    pub fn is_current(&self) -> bool {
        self.quality <= Quality::Doubtful
    }
}

/// Numbers that are none are not known.
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

fn age(path: Option<&PathState>, ms: impl Fn(&PathState) -> Option<f64>) -> Option<Value> {
    number(path.and_then(ms))
}

/// The path that corrects.
fn active(status: &Status) -> Option<&PathState> {
    status.controllers.iter().find(|path| path.active)
}

/// What the guard says of the age of the positions: the same for those of every axis.
fn quality_of_positions(status: &Status) -> Quality {
    let old = Reasons::POSITIONS_STALE | Reasons::POSITIONS_LOST;
    let is_old = old
        .texts()
        .any(|old| status.reasons.iter().any(|told| told == old));
    if is_old {
        Quality::Stale
    } else {
        Quality::Good
    }
}

fn age_of_positions(status: &Status) -> f64 {
    let told = active(status).and_then(|path| path.positions_ms);
    told.unwrap_or(status.age_ms)
}

fn position(status: &Status, axis: AxisName) -> Reading {
    let position = by_kind(axis, &status.positions_mm, &status.positions_deg);
    Reading::of(
        number(position),
        quality_of_positions(status),
        age_of_positions(status),
    )
}

/// The lengths of errors are computed from the positions.
fn of_tool(status: &Status, error: Option<[f64; 3]>) -> Reading {
    Reading::of(
        number(error.map(|error| round(length(error)))),
        quality_of_positions(status),
        age_of_positions(status),
    )
}

fn correction(status: &Status, axis: AxisName) -> Reading {
    let correction = by_kind(axis, &status.correction_um, &status.correction_urad);
    let quality = if status.correction_known {
        Quality::Good
    } else {
        Quality::Stale
    };
    let confirmed = active(status).and_then(|path| path.confirmed_ms);
    Reading::of(
        number(correction),
        quality,
        confirmed.unwrap_or(status.age_ms),
    )
}

fn temperature(status: &Status, sensor: Option<&SensorState>) -> Reading {
    let degc = sensor.and_then(|sensor| sensor.degc);
    let doubtful = sensor.is_some_and(|sensor| sensor.reason.is_some());
    let quality = if doubtful {
        Quality::Doubtful
    } else {
        Quality::Good
    };
    Reading::of(number(degc), quality, status.age_ms)
}

/// The length of an error.
pub(crate) fn length(error: [f64; 3]) -> f64 {
    error.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// The reasons of a state, without numbers that would make a new text each time.
pub(crate) fn reasons(status: &Status) -> Vec<&str> {
    let reasons = status.reasons.iter();
    // The time of a silence.
    reasons
        .map(|reason| {
            reason
                .strip_suffix(" ms")
                .map_or(reason.as_str(), |_| "no cycle")
        })
        .collect()
}
