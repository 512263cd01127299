//! What a barrier is set to.

use volcomp_vocabulary::PerChannel;

use crate::protocol::{Counts, Layout, LayoutError};

/// The largest number of a machine. The checksum counts modulo 65535, so a machine 65535 would be the machine 0.
pub const LARGEST_MACHINE: u16 = 65_534;

/// The settings of a barrier: they belong to the machine and are made by its builder, not by the gateway.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Settings {
    /// The axes that are corrected, in the order of the words.
    pub axes: Layout,
    /// A number that tells this machine from others, at most [`LARGEST_MACHINE`]; it starts the checksum.
    pub machine: u16,
    /// The largest correction of each axis in either direction, counts.
    pub limit: Counts,
    /// The largest movement of each axis in one step, counts.
    pub rate: Counts,
    /// The number of scans from one step to the next, for axes whose rate is below one count in a scan.
    pub step_scans: u16,
    /// The largest age of the tick that a frame carries, scans.
    pub hold_scans: u16,
    /// The number of scans without an accepted frame after which the correction goes to zero.
    pub time_out_scans: u16,
}

/// A setting that makes no sense.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SettingsError {
    /// The axes.
    #[error(transparent)]
    Layout(#[from] LayoutError),
    /// The number of the machine is beyond the largest.
    #[error("number of the machine: found {found}, expected 0 to {LARGEST_MACHINE}")]
    Machine {
        /// The number that was found.
        found: u16,
    },
    /// The limit or the rate of one axis.
    #[error("axis {axis} (counted from 0): found {found} counts, expected at least 1")]
    Counts {
        /// The place of the axis in the channel, from 0.
        axis: usize,
        /// The number that was found, counts.
        found: i16,
    },
    /// The number of scans between two steps.
    #[error("scans from step to step: found 0, expected at least 1")]
    StepScans,
    /// The age of a frame against the time-out.
    #[error(
        "time-out: found {time_out} scans, expected at least twice the age of a frame, which is {hold} scans, and less than 32768"
    )]
    TimeOut {
        /// The largest age of a frame, scans.
        hold: u16,
        /// The time-out that was found, scans.
        time_out: u16,
    },
}

impl Settings {
    /// Checks every setting.
    ///
    /// # Errors
    /// The first setting that makes no sense.
    pub fn check(&self) -> Result<(), SettingsError> {
        if self.machine > LARGEST_MACHINE {
            let found = self.machine;
            return Err(SettingsError::Machine { found });
        }
        for axis in 0..self.axes.count() {
            for found in [self.limit[axis], self.rate[axis]] {
                if found < 1 {
                    return Err(SettingsError::Counts { axis, found });
                }
            }
        }
        if self.step_scans == 0 {
            return Err(SettingsError::StepScans);
        }
        let (hold, time_out) = (self.hold_scans, self.time_out_scans);
        if hold == 0 || u32::from(time_out) < 2 * u32::from(hold) || time_out >= 1 << 15 {
            return Err(SettingsError::TimeOut { hold, time_out });
        }
        Ok(())
    }

    /// The same settings with zero for axes that there are not.
    pub(super) fn of_axes(self) -> Self {
        Self {
            limit: self.present(&self.limit),
            rate: self.present(&self.rate),
            ..self
        }
    }

    /// The values of the axes that there are; the others are zero.
    pub(super) fn present(&self, values: &Counts) -> Counts {
        let count = self.axes.count();
        PerChannel::from_fn(|axis| if axis < count { values[axis] } else { 0 })
    }
}
