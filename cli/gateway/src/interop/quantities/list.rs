//! Which quantities a machine has: their names, their places and what they tell.

use volcomp_vocabulary::{AxisKind, AxisName};

use super::{Kind, Quantity, Shape, Unit, What};

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
pub(in crate::interop) fn key_of(name: &str) -> String {
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
