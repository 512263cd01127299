//! A quantity read from the state of a gateway: its value, how good it is, and how old.

use volcomp_guard::Reasons;
use volcomp_vocabulary::{AxisKind, AxisName};

use super::{Quality, Reading, Value, What};
use crate::documents::{ByAxis, PathState, SchemeName, SensorState, StateName, Status, round};

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
    // The time of a silence, the position that is not believed.
    reasons
        .map(|reason| {
            let known = Reasons::with_text(reason).and_then(|reason| reason.texts().next());
            known.unwrap_or_else(|| {
                reason
                    .strip_suffix(" ms")
                    .map_or(reason.as_str(), |_| "no cycle")
            })
        })
        .collect()
}
