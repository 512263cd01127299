//! Active alarms, by place, level and code.

use volcomp_guard::Reasons;

use super::quantities::{Shape, key_of, reasons};
use crate::documents::{StateName, Status};

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
