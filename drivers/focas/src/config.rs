//! How a control is reached and corrected.

use std::time::Duration;

use volcomp_port::{Axis, Backoff, Description, Heartbeat, ShownStates};
use volcomp_vocabulary::{AxisKind, AxisName, Deg, Displacement, Mm, Rad};

use crate::{
    answers::PositionKind,
    error::FocasError,
    pmc::{PmcAddress, PmcArea, Width},
};

/// Where the machine zero point shift of each axis is written.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Shift {
    /// Where the number of the control's first axis stands; those of its other axes follow.
    pub first: PmcAddress,
    /// The number of bytes of each number.
    pub width: Width,
    /// How far one count moves a linear axis.
    pub count_linear: Mm,
    /// How far one count moves a rotary axis.
    pub count_rotary: Rad,
}

impl Shift {
    /// How far one count moves an axis of this kind.
    pub fn count(&self, kind: AxisKind) -> Displacement {
        match kind {
            AxisKind::Linear => Displacement::Length(self.count_linear),
            AxisKind::Rotary => Displacement::Angle(self.count_rotary),
        }
    }

    /// The largest shift of an axis of this kind, in either direction, that the width can hold.
    pub fn largest(&self, kind: AxisKind) -> Displacement {
        let count = self.count(kind).mm_or_rad();
        Displacement::new(kind, count * f64::from(self.width.largest()))
    }
}

/// How a control is reached and corrected.
#[derive(Clone, Debug, PartialEq)]
pub struct FocasConfig {
    /// The name or address of the control.
    pub host: String,
    /// The port of the control, 8193 as delivered.
    pub port: u16,
    /// The path of the control whose axes are corrected, from 1.
    pub path: u16,
    /// The name of the channel by which corrections get in.
    pub channel: String,
    /// The axes to correct, in channel order.
    pub axes: Vec<AxisName>,
    /// Where corrections are written.
    pub shift: Shift,
    /// The byte that every correction moves on, for the ladder to watch; `None` where nobody watches.
    pub heartbeat: Option<PmcAddress>,
    /// The byte that is written last in every correction and counts up: where a ladder copies the shifts on, it
    /// does so when this byte has changed, and so takes all axes together.
    pub sequence: Option<PmcAddress>,
    /// In which coordinates positions are read.
    pub positions: PositionKind,
    /// Whether the positions that the control tells contain the shift.
    pub includes_correction: bool,
    /// The byte whose bits say which axes are referenced, the control's first axis lowest; `None` where
    /// they are taken to be referenced.
    pub referenced: Option<PmcAddress>,
    /// The longest time for making a connection, and for each question before the first cycle.
    pub at_most: Duration,
    /// The time between two tries to connect.
    pub backoff: Backoff,
}

impl FocasConfig {
    /// Shifts in words of 1 µm and 0.001 deg from R100 on, a heartbeat at R120, referenced axes in F120.
    ///
    /// The addresses are examples; that a shift from R memory is enabled (parameters 1203#0 and 1280) and
    /// that F120 tells the referenced axes is not proven: read the control's manual.
    pub fn new(host: impl Into<String>, axes: &[AxisName]) -> Self {
        let address = |area, at| PmcAddress { area, at };
        Self {
            host: host.into(),
            port: 8193,
            path: 1,
            channel: "emzps".to_owned(),
            axes: axes.to_vec(),
            shift: Shift {
                first: address(PmcArea::R, 100),
                width: Width::Word,
                count_linear: Mm(0.001),
                count_rotary: Deg(0.001).to_rad(),
            },
            heartbeat: Some(address(PmcArea::R, 120)),
            sequence: None,
            positions: PositionKind::Machine,
            includes_correction: false,
            referenced: Some(address(PmcArea::F, 120)),
            at_most: Duration::from_secs(2),
            backoff: Backoff::default(),
        }
    }

    /// The device as messages name it.
    pub fn device(&self) -> String {
        format!("focas://{}:{}", self.host, self.port)
    }

    /// The description of the controller that this configuration makes, without connecting.
    ///
    /// # Errors
    /// No axis, an axis that stands twice, a count that moves an axis by no positive distance; bytes that cannot be
    /// written, lie beyond the end of the PMC's memory, or within the words of the shifts.
    pub fn describe(&self) -> Result<Description, FocasError> {
        let axis = |&name: &AxisName| Axis {
            name,
            includes_correction: self.includes_correction,
            resolution: self.shift.count(name.kind()),
            largest: Some(self.shift.largest(name.kind())),
        };
        let description = Description {
            device: self.device(),
            channel: self.channel.clone(),
            axes: self.axes.iter().map(axis).collect(),
            heartbeat: match self.heartbeat {
                Some(_) => Heartbeat::Watched,
                None => Heartbeat::Unwatched,
            },
            barrier: false,
            tells_applied: true,
            shown: ShownStates {
                referenced: self.referenced.is_some(),
                ..ShownStates::ALL
            },
            sees_other_gateways: self.heartbeat.is_some(),
            shortest_cycle: Duration::from_millis(1),
        };
        description.check()?;
        self.check_addresses(self.axes.len())?;
        Ok(description)
    }

    /// The first byte that this and another configuration both write in the memory of the same control; `None` where
    /// they share none, or are of different controls.
    pub fn shared_byte(&self, other: &Self) -> Option<PmcAddress> {
        let is_same = self.host.eq_ignore_ascii_case(&other.host) && self.port == other.port;
        let mut bytes = self.written();
        bytes.find(|byte| is_same && other.written().any(|others| others == *byte))
    }

    /// The bytes that are written: the shifts of as many axes as are corrected, heartbeat and sequence.
    fn written(&self) -> impl Iterator<Item = PmcAddress> + '_ {
        let first = self.shift.first;
        let bytes = self.axes.len() * usize::from(self.shift.width.bytes());
        (first.at..=u16::MAX)
            .take(bytes)
            .map(move |at| PmcAddress { at, ..first })
            .chain(self.heartbeat)
            .chain(self.sequence)
    }

    /// Checks the words of a control's first `slots` axes and the bytes with a meaning of their own: what is written may
    /// be written and exists, and none lies within the others.
    pub(crate) fn check_addresses(&self, slots: usize) -> Result<(), FocasError> {
        let first = self.shift.first;
        let written = [
            ("area.first", Some(first)),
            ("heartbeat", self.heartbeat),
            ("sequence", self.sequence),
        ];
        for (key, at) in written {
            if let Some(at) = at.filter(|at| !at.area.is_writable()) {
                return Err(FocasError::NotWritable { key, at });
            }
        }
        let bytes = u16::try_from(slots)
            .unwrap_or(u16::MAX)
            .saturating_mul(self.shift.width.bytes());
        let at = first.at.checked_add(bytes.saturating_sub(1));
        let last = at
            .map(|at| PmcAddress { at, ..first })
            .ok_or(FocasError::BeyondEnd {
                first,
                slots,
                bytes: self.shift.width.bytes(),
            })?;
        let named = [
            ("the heartbeat", self.heartbeat),
            ("the sequence byte", self.sequence),
            ("the byte of the referenced axes", self.referenced),
        ];
        for (byte, at) in named {
            if let Some(at) = at
                && at.area == first.area
                && (first.at..=last.at).contains(&at.at)
            {
                return Err(FocasError::Overlap {
                    byte,
                    at,
                    first,
                    last,
                });
            }
        }
        Ok(())
    }
}
