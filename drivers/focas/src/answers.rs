//! Decodes the control's responses about its type, state, alarms and positions.

use crate::frame::{FrameError, number};

pub(crate) mod function {
    pub(crate) const SYSTEM: u16 = 0x18;
    pub(crate) const STATUS: u16 = 0x19;
    pub(crate) const ALARMS: u16 = 0x23;
    pub(crate) const POSITIONS: u16 = 0x26;
    pub(crate) const AXIS_NAMES: u16 = 0x89;
    pub(crate) const READ_PARAMETER: u16 = 0x8d;
    pub(crate) const READ_MACRO: u16 = 0xa7;
    pub(crate) const WRITE_MACRO: u16 = 0xa8;
    pub(crate) const READ_OFFSET: u16 = 0x0b;
    pub(crate) const WRITE_OFFSET: u16 = 0x0c;
    pub(crate) const READ_PMC: u16 = 0x8001;
    pub(crate) const WRITE_PMC: u16 = 0x8002;
}

/// Coordinate system in which positions are read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum PositionKind {
    /// Machine coordinates, relative to the machine's zero point.
    #[default]
    Machine,
    /// Absolute coordinates, relative to the workpiece zero point.
    Absolute,
}

impl PositionKind {
    pub(crate) fn code(self) -> i32 {
        match self {
            Self::Machine => 1,
            Self::Absolute => 4,
        }
    }
}

/// Type, software and number of axes that a control reports.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SystemInfo {
    /// Number of axis slots in a response about all axes, including unused slots.
    pub max_axes: u16,
    /// Type of the control, such as ` 0` or `31`.
    pub cnc_type: String,
    /// ` M` for milling, ` T` for turning.
    pub machine_type: String,
    pub series: String,
    pub version: String,
    /// Number of axes of the path, as two digits.
    pub axes: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct StatusInfo {
    /// Mode: 0 MDI, 1 memory, 3 edit, 4 handle, 5 jog, 9 reference, 10 remote.
    pub mode: u16,
    /// Program state: 0 reset, 1 stop, 2 hold, 3 running.
    pub run: u16,
    /// Nonzero while axes move.
    pub motion: u16,
    /// Nonzero while the emergency stop is pressed.
    pub emergency: u16,
    /// Nonzero while an alarm is active.
    pub alarm: u16,
}

#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Alarm {
    pub number: i32,
    /// Alarm type, a number defined by the manufacturer.
    pub kind: i32,
    /// Number of the axis that raised the alarm, from 1; 0 if no axis did.
    pub axis: i32,
    pub text: String,
}

/// Decodes the number in the eight-byte slot with this index, mm or deg. Errors: the data end before the slot, or the
/// slot contains no number.
pub(crate) fn slot(data: &[u8], index: usize) -> Result<f64, FrameError> {
    let bytes = data.get(8 * index..).and_then(|rest| rest.first_chunk::<8>());
    let bytes = bytes.ok_or(FrameError("fewer axes than requested"))?;
    number(*bytes).ok_or(FrameError("a position that is not a number"))
}

/// Decodes the state of the control from its fourteen bytes.
pub(crate) fn status(data: &[u8]) -> Result<StatusInfo, FrameError> {
    let data = data.first_chunk::<14>().ok_or(FrameError("a truncated status"))?;
    let word = |k: usize| u16::from_be_bytes([data[2 * k], data[2 * k + 1]]);
    Ok(StatusInfo {
        mode: word(0),
        run: word(1),
        motion: word(2),
        emergency: word(4),
        alarm: word(5),
    })
}
