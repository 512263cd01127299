//! How a control is reached and corrected.

use std::time::Duration;

use volcomp_port::{Axis, Backoff, Description, Heartbeat, ShownStates};
use volcomp_vocabulary::{AxisKind, AxisName, Deg, Displacement, Mm, Rad};

use crate::{
    answers::PositionKind,
    areas::{self, BarrierArea, Block},
    error::FocasError,
    pmc::{PmcAddress, PmcArea, Width},
};

/// Positions have so many mm or deg in their last digit at least.
const THIRD_DECIMAL: f64 = 0.001;

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

    /// The same shifts in words of two bytes, as frames to a barrier have them.
    pub(crate) fn in_words(self) -> Self {
        Self {
            width: Width::Word,
            ..self
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
    /// Axes of which only the positions are read. Without `axes` nothing of the PMC is used but `referenced`.
    pub reads: Vec<AxisName>,
    /// Where corrections are written.
    pub shift: Shift,
    /// The byte that every correction moves on, for the ladder to watch; `None` where nobody watches.
    pub heartbeat: Option<PmcAddress>,
    /// The byte that is written last in every correction and counts up: where a ladder copies the shifts on, it
    /// does so when this byte has changed, and so takes all axes together.
    pub sequence: Option<PmcAddress>,
    /// Where frames go to a barrier in the ladder and its reports come from. Corrections are then handed over by
    /// `post` and not by `apply`; heartbeat and sequence byte are not used, and the words of `shift` belong to the
    /// ladder: the driver never writes them.
    pub barrier: Option<BarrierArea>,
    /// Whether a ladder copies the words of `shift` on to others, from which the control takes the shift; otherwise the
    /// control takes it from those words themselves, and its parameters must say so.
    pub copied: bool,
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
            reads: Vec::new(),
            shift: Shift {
                first: address(PmcArea::R, 100),
                width: Width::Word,
                count_linear: Mm(0.001),
                count_rotary: Deg(0.001).to_rad(),
            },
            heartbeat: Some(address(PmcArea::R, 120)),
            sequence: None,
            barrier: None,
            copied: false,
            positions: PositionKind::Machine,
            includes_correction: false,
            referenced: Some(address(PmcArea::F, 120)),
            at_most: Duration::from_secs(2),
            backoff: Backoff::default(),
        }
    }

    /// The smallest step of the positions that the control tells of an axis: the third decimal of mm and deg, or the count
    /// of its corrections, where that is coarser.
    pub fn position_step(&self, name: AxisName) -> Displacement {
        let decimal = match name.kind() {
            AxisKind::Linear => THIRD_DECIMAL,
            AxisKind::Rotary => Deg(THIRD_DECIMAL).to_rad().0,
        };
        let count = self.shift.count(name.kind()).mm_or_rad();
        Displacement::new(name.kind(), decimal.max(count))
    }

    /// The device as messages name it.
    pub fn device(&self) -> String {
        format!("focas://{}:{}", self.host, self.port)
    }

    /// The description of the controller that this configuration makes, without connecting.
    ///
    /// # Errors
    /// No axis, an axis that stands twice, a count that moves an axis by no positive distance; bytes that cannot be
    /// written, lie beyond the end of the PMC's memory, or within one another.
    pub fn describe(&self) -> Result<Description, FocasError> {
        let axis = |&name: &AxisName| Axis {
            name,
            includes_correction: self.includes_correction,
            resolution: self.shift.count(name.kind()),
            largest: Some(match self.barrier {
                None => self.shift.largest(name.kind()),
                Some(_) => self.shift.in_words().largest(name.kind()),
            }),
        };
        let description = Description {
            device: self.device(),
            channel: self.channel.clone(),
            axes: self.axes.iter().map(axis).collect(),
            reads: self.reads.clone(),
            heartbeat: if self.barrier.is_some() || self.heartbeat.is_some() {
                Heartbeat::Watched
            } else {
                Heartbeat::Unwatched
            },
            barrier: self.barrier.is_some(),
            tells_applied: !self.axes.is_empty(),
            shown: ShownStates {
                referenced: self.referenced.is_some(),
                ..ShownStates::ALL
            },
            sees_other_gateways: self.barrier.is_some() || self.heartbeat.is_some(),
            shortest_cycle: Duration::from_millis(1),
        };
        description.check()?;
        let is_direct = self.barrier.is_none() && !self.copied;
        if is_direct && self.shift.width != Width::Word {
            return Err(FocasError::Width(self.shift.width));
        }
        areas::check(self, self.axes.len())?;
        Ok(description)
    }

    /// Two blocks of the control's memory that this configuration uses and that share a byte; `None` where all lie apart, or
    /// the configuration is wrong otherwise.
    pub fn overlap(&self) -> Option<[Block; 2]> {
        areas::overlap_within(self)
    }

    /// A block of this configuration and one of another for the same control that share a byte which one of them writes;
    /// `None` where they leave each other's bytes alone, or are of different controls.
    pub fn overlap_with(&self, other: &Self) -> Option<[Block; 2]> {
        let is_same = self.host.eq_ignore_ascii_case(&other.host) && self.port == other.port;
        is_same
            .then(|| areas::overlap_between(self, other))
            .flatten()
    }
}
