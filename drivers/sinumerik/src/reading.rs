//! Names the nodes that are read in every period, and converts their values. This module performs no I/O.

use std::time::{Duration, Instant};

use volcomp_port::{ControllerState, Snapshot};
use volcomp_vocabulary::{AxisName, Deg, PerChannel};

use crate::{
    config::{Sign, SinumerikConfig},
    error::SinumerikError,
    nodes::Nodes,
};

/// Value of a node in a response.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Value {
    /// Value as a number, with 1 for true; `None` if the value is missing or its status is not good.
    pub number: Option<f64>,
    /// Time from sampling to the response, on the server's clock; `None` if the server does not report it.
    pub age: Option<Duration>,
}

/// The nodes that are read in every period, and the conversion of their values to a [`Snapshot`].
#[derive(Clone, Debug)]
#[expect(clippy::struct_excessive_bools, reason = "which of the optional nodes there are")]
pub struct Reading {
    nodes: Vec<String>,
    /// All axes: corrected axes, then read-only axes.
    axes: Vec<AxisName>,
    written: usize,
    sign: Sign,
    source_timestamps: bool,
    referenced: bool,
    emergency_stop: bool,
    alarm: bool,
}

impl Reading {
    /// Determines the nodes to read for a configuration.
    pub fn new(config: &SinumerikConfig) -> Self {
        let nodes = &config.nodes;
        let axes: Vec<(AxisName, u16)> = config.numbered().collect();
        let written = config.axes.len();
        let mut ids = Vec::new();
        let mut of = |pattern: &str, axes: &[(AxisName, u16)]| {
            ids.extend(axes.iter().map(|(_, number)| Nodes::of_axis(pattern, *number)));
        };
        of(&nodes.position, &axes);
        of(&nodes.setting, &axes[..written]);
        of(&nodes.kind, &axes[..written]);
        if let Some(referenced) = &nodes.referenced {
            of(referenced, &axes);
        }
        ids.extend(nodes.emergency_stop.iter().chain(&nodes.alarm).cloned());
        Self {
            nodes: ids,
            axes: axes.into_iter().map(|(name, _)| name).collect(),
            written,
            sign: config.sign,
            source_timestamps: config.server.source_timestamps,
            referenced: nodes.referenced.is_some(),
            emergency_stop: nodes.emergency_stop.is_some(),
            alarm: nodes.alarm.is_some(),
        }
    }

    /// Ids of the nodes to read. The values passed to [`snapshot`](Self::snapshot) must have the same order.
    pub fn nodes(&self) -> &[String] {
        &self.nodes
    }

    /// Ids of the setting data, in the order of the corrected axes.
    pub fn settings(&self) -> &[String] {
        &self.nodes[self.axes.len()..self.axes.len() + self.written]
    }

    /// Converts the values of a response. `begun` is the time of the request, and `ended` the time at which the
    /// response was complete.
    ///
    /// If the server's source timestamps are used, positions and states were valid at the middle of the exchange minus
    /// their age. Otherwise they were valid at the middle. The age of a setting is the time since its last write, so a
    /// setting was valid at the middle of the exchange.
    ///
    /// # Errors
    /// The number of values differs from the number of nodes; a position, setting or machine datum is not a number;
    /// [`SinumerikError::SwitchedOff`].
    pub fn snapshot(
        &self,
        values: &[Value],
        begun: Instant,
        ended: Instant,
    ) -> Result<Snapshot, SinumerikError> {
        if values.len() != self.nodes.len() {
            return Err(SinumerikError::Answer("another number of values than of nodes"));
        }
        let half = ended.saturating_duration_since(begun) / 2;
        let middle = begun + half;
        let (positions, rest) = values.split_at(self.axes.len());
        let (settings, rest) = rest.split_at(self.written);
        let (kinds, states) = rest.split_at(self.written);
        for (place, kind) in kinds.iter().enumerate() {
            let found = self.number(kind, self.axes.len() + self.written + place)?;
            is_switched_on(self.axes[place], found)?;
        }
        let mut at = PerChannel::ZERO;
        for (place, value) in positions.iter().enumerate() {
            at[place] = from_control(self.axes[place], self.number(value, place)?);
        }
        let mut applied = PerChannel::ZERO;
        for (place, value) in settings.iter().enumerate() {
            let setting = self.number(value, self.axes.len() + place)?;
            applied[place] = self.sign.factor() * from_control(self.axes[place], setting);
        }
        let held = |values: &[Value]| {
            let ages = values.iter().filter_map(|value| value.age);
            let oldest = ages.filter(|_| self.source_timestamps).max();
            // `Instant` cannot represent times before its origin.
            middle.checked_sub(oldest.unwrap_or_default()).unwrap_or(begun)
        };
        Ok(Snapshot {
            positions: at,
            taken: held(positions),
            uncertainty: half,
            state: self.state(states),
            state_taken: held(states),
            applied: (self.written > 0).then_some(applied),
            report: None,
            correction_taken: middle,
        })
    }

    fn number(&self, value: &Value, place: usize) -> Result<f64, SinumerikError> {
        let number = value.number.filter(|number| number.is_finite());
        number.ok_or_else(|| SinumerikError::Node {
            node: self.nodes[place].clone(),
            found: "no good number".to_owned(),
        })
    }

    /// The operating state. A state whose value is missing has its safe value. A state without a configured node counts
    /// as good, and the description declares that it is not reported.
    fn state(&self, values: &[Value]) -> ControllerState {
        let (referenced, rest) = values.split_at(if self.referenced { self.axes.len() } else { 0 });
        let is_on = |value: &Value| value.number.map(|number| number != 0.0);
        let mut rest = rest.iter();
        let mut flag = |is_shown: bool| {
            let value = if is_shown { rest.next() } else { None };
            is_shown && value.and_then(is_on).unwrap_or(true)
        };
        let emergency_stop = flag(self.emergency_stop);
        let alarm = flag(self.alarm);
        ControllerState {
            referenced: referenced.iter().all(|value| is_on(value) == Some(true)),
            alarm,
            emergency_stop,
        }
    }

    /// Converts corrections (mm and rad) to the values to write (mm and deg, with the configured sign), rounded to the
    /// steps of `config`. The values are in the order of [`Reading::settings`].
    pub fn values(
        &self,
        config: &SinumerikConfig,
        corrections: &PerChannel<f64>,
    ) -> PerChannel<f64> {
        PerChannel::from_fn(|place| {
            let Some(&name) = self.axes.get(place).filter(|_| place < self.written) else {
                return 0.0;
            };
            let step = config.step(name).mm_or_rad();
            let rounded = (corrections[place] / step).round() * step;
            self.sign.factor() * to_control(name, rounded)
        })
    }
}

/// Checks that bit 0 of MD32750 is set, so that the temperature compensation of the axis is switched on.
///
/// # Errors
/// [`SinumerikError::SwitchedOff`] if bit 0 is not set.
pub fn is_switched_on(axis: AxisName, md32750: f64) -> Result<(), SinumerikError> {
    // Any value except a number from 0 to 65535 counts as 0.
    let whole = if (0.0..=f64::from(u16::MAX)).contains(&md32750) {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "between 0 and 65535"
        )]
        let whole = md32750 as u32;
        whole
    } else {
        0
    };
    if whole & 1 == 1 {
        return Ok(());
    }
    Err(SinumerikError::SwitchedOff { axis, found: whole })
}

fn from_control(axis: AxisName, value: f64) -> f64 {
    if axis.is_rotary() { Deg(value).to_rad().0 } else { value }
}

fn to_control(axis: AxisName, value: f64) -> f64 {
    if axis.is_rotary() { value.to_degrees() } else { value }
}
