//! What is wrong, for systems that keep alarms: by place, level and code.

use volcomp_guard::Reasons;

use super::quantities::{Shape, key_of, reasons};
use crate::documents::{StateName, Status};

/// Where something can be wrong. Numbers are places in the order of the configuration, from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// The guard: what may reach the axes.
    Guard,
    /// A temperature.
    Sensor(usize),
    /// A controller.
    Controller(usize),
}

/// How bad it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// To be known.
    Warning,
    /// A person has to look at it.
    Fault,
}

/// One thing that is wrong.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Alarm {
    /// How bad it is.
    pub level: Level,
    /// A name of small letters, digits and `_`, the same for the same thing.
    pub code: String,
    /// What is wrong, in words.
    pub text: String,
}

/// The places of a gateway, in order.
pub fn places(shape: &Shape) -> Vec<Place> {
    let sensors = (0..shape.sensors.len()).map(Place::Sensor);
    let controllers = (0..shape.controllers).map(Place::Controller);
    [Place::Guard]
        .into_iter()
        .chain(sensors)
        .chain(controllers)
        .collect()
}

impl Place {
    /// What is wrong there now; `None` where that is not known.
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
                    if is_faulted && forbids {
                        Level::Fault
                    } else {
                        Level::Warning
                    }
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
                let reasons = status.controllers.get(place)?.reasons.iter();
                Some(
                    reasons
                        .map(|reason| alarm(Level::Warning, reason))
                        .collect(),
                )
            }
        }
    }
}

fn alarm(level: Level, text: &str) -> Alarm {
    Alarm {
        level,
        code: key_of(text),
        text: text.to_owned(),
    }
}
