//! Corrections as plain values in the signals `X_CORR`, in messages with a counter and a checksum.

use std::time::Instant;

use volcomp_port::{Fault, Heartbeat};
use volcomp_vocabulary::{AxisName, PerChannel};

use crate::{
    barrier::{Count, send},
    frame::{CanPort, Frame},
    quantity::to_internal,
    signals::{Message, Signal, SignalTable},
};

struct AxisSignal {
    /// Index of the signal's message in `sent`.
    sent: usize,
    signal: Signal,
    to_internal: f64,
}

pub(crate) struct PlainCorrections {
    axes: Vec<AxisSignal>,
    sent: Vec<(Message, Frame)>,
    counter: u64,
    saturated: u64,
}

impl PlainCorrections {
    /// Finds the correction signals for these axes. Also returns the size of a count of each axis.
    ///
    /// Errors: an axis without a correction signal, a unit that does not match its axis.
    pub(crate) fn of(
        table: &SignalTable,
        names: &[AxisName],
    ) -> Result<(Self, Vec<Count>), String> {
        let (mut axes, mut sent, mut counts) = (Vec::new(), Vec::new(), Vec::new());
        for name in names {
            let (message, place) = required_signal(table, *name, "CORR")?;
            let message = &table.messages[message];
            let signal = message.signals[place].clone();
            let to_internal = to_internal(&signal.name, &signal.unit)
                .map_err(|unit| format!("signal {}: {unit}", signal.name))?;
            counts.push(Count {
                step: signal.step() * to_internal,
                largest: signal.largest() * to_internal,
            });
            axes.push(AxisSignal {
                sent: outgoing_index(&mut sent, message).ok_or_else(|| {
                    format!("{} cannot represent a correction of 0 for every axis", message.name)
                })?,
                signal,
                to_internal,
            });
        }
        let plain = Self { axes, sent, counter: 0, saturated: 0 };
        Ok((plain, counts))
    }

    /// [`Heartbeat::Watched`] if every message has a counter, because the control can detect a stopped sender by the
    /// counter.
    pub(crate) fn heartbeat(&self) -> Heartbeat {
        let counted = |(message, frame): &(Message, Frame)| message.counter(frame.data()).is_some();
        if self.sent.iter().all(counted) { Heartbeat::Watched } else { Heartbeat::Unwatched }
    }

    pub(crate) fn saturated(&self) -> u64 {
        self.saturated
    }

    pub(crate) fn apply(
        &mut self,
        port: &mut impl CanPort,
        corrections: &PerChannel<f64>,
        deadline: Instant,
    ) -> Result<(), Fault> {
        for (axis, correction) in self.axes.iter().zip(corrections) {
            let (_, frame) = &mut self.sent[axis.sent];
            let within = axis.signal.put(frame.data_mut(), correction / axis.to_internal);
            self.saturated += u64::from(!within);
        }
        self.counter = (self.counter + 1) % 16;
        for (message, frame) in &mut self.sent {
            message.seal(frame.data_mut(), self.counter);
            send(port, frame, deadline)?;
        }
        Ok(())
    }
}

/// Index of a message in `sent`; adds the message if necessary. `None` if the message cannot represent a correction
/// of 0.
fn outgoing_index(sent: &mut Vec<(Message, Frame)>, message: &Message) -> Option<usize> {
    let known = sent.iter().position(|(other, _)| other.name == message.name);
    if known.is_some() {
        return known;
    }
    let mut frame = message.frame()?;
    for signal in &message.signals {
        // Corrections of uncorrected axes in this message are 0, whose raw value may differ from 0.
        if signal.name.ends_with("_CORR") && !signal.put(frame.data_mut(), 0.0) {
            return None;
        }
    }
    sent.push((message.clone(), frame));
    Some(sent.len() - 1)
}

/// Indexes of the message and of the signal with this suffix of an axis. Errors: the table lacks the signal.
pub(crate) fn required_signal(
    table: &SignalTable,
    name: AxisName,
    suffix: &str,
) -> Result<(usize, usize), String> {
    let signal = format!("{name}_{suffix}");
    table.find(&signal).ok_or_else(|| format!("there is no signal {signal}"))
}
