//! Last positions of each controller, and the machine position combined from them.

use std::time::Duration;

use volcomp_vocabulary::{MAX_AXES, PerAxis, PerChannel};

/// Axes reported by a controller, in channel order, and their last positions.
///
/// Invariants:
/// - Once `taken` is set, all `positions` are finite and were valid at this time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReportedPositions {
    /// Machine index of each axis; the axes that the controller writes come first.
    pub(crate) machine_axis: PerChannel<usize>,
    count: usize,
    /// Travel after which the direction of each axis counts as reversed, mm or rad.
    pub(crate) reversal: PerChannel<f64>,
    /// Positions without correction, mm or rad, valid at `taken`.
    positions: PerChannel<f64>,
    pub(crate) taken: Option<Duration>,
}

impl ReportedPositions {
    pub(crate) fn without_positions(
        machine_axis: PerChannel<usize>,
        count: usize,
        reversal: PerChannel<f64>,
    ) -> Self {
        Self { machine_axis, count, reversal, positions: PerChannel::ZERO, taken: None }
    }

    /// Stores positions that were valid at `taken`; if one of them is NaN, none is stored.
    pub(crate) fn store(&mut self, positions: &PerChannel<f64>, taken: Duration) {
        if positions.iter().take(self.count).all(|q| q.is_finite()) {
            (self.positions, self.taken) = (*positions, Some(taken));
        }
    }

    /// Last position of a machine axis (mm or rad) and the time at which it was valid; `None` if none was reported.
    pub(crate) fn position_of(&self, machine_axis: usize) -> Option<(f64, Duration)> {
        Some((self.positions[self.place_of(machine_axis)?], self.taken?))
    }

    /// Travel after which the direction of a machine axis counts as reversed, mm or rad; `None` if the controller does not report the axis.
    pub(crate) fn reversal_of(&self, machine_axis: usize) -> Option<f64> {
        Some(self.reversal[self.place_of(machine_axis)?])
    }

    fn place_of(&self, machine_axis: usize) -> Option<usize> {
        (0..self.count).find(|&place| self.machine_axis[place] == machine_axis)
    }
}

#[derive(Default)]
pub(crate) struct MachinePosition {
    /// Positions without correction, mm and rad.
    pub(crate) positions: PerAxis<f64>,
    /// Time at which each position was valid; zero for a configured fixed position.
    pub(crate) taken: PerAxis<Duration>,
    /// Bit mask of the known positions: bit 0 is the first axis.
    pub(crate) known: u16,
    /// Time at which the oldest reported position was valid; `None`: none was reported.
    pub(crate) oldest: Option<Duration>,
    /// Time at which the oldest position from another controller was valid; `None`: the path itself reports all known ones.
    pub(crate) oldest_of_others: Option<Duration>,
}

impl MachinePosition {
    pub(crate) fn is_complete(&self, axes: usize) -> bool {
        self.known == u16::MAX >> (16 - axes.min(MAX_AXES))
    }
}
