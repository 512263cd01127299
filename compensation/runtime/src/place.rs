//! Where the axes of each controller were last, and where the machine is by all of them.

use std::time::Duration;

use volcomp_vocabulary::{MAX_AXES, PerAxis, PerChannel};

/// The axes that a controller shows, in its order, and where they were last.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    /// The place of each axis in the machine: those that the controller writes come first.
    pub(crate) machine_axis: PerChannel<usize>,
    count: usize,
    /// Travel after which a direction counts as turned, mm or rad.
    pub(crate) reversal: PerChannel<f64>,
    /// Positions without correction, mm or rad, as they held at `taken`.
    positions: PerChannel<f64>,
    pub(crate) taken: Option<Duration>,
}

impl Seen {
    /// Axes that were not seen yet.
    pub(crate) fn none_of(
        machine_axis: PerChannel<usize>,
        count: usize,
        reversal: PerChannel<f64>,
    ) -> Self {
        Self {
            machine_axis,
            count,
            reversal,
            positions: PerChannel::ZERO,
            taken: None,
        }
    }

    /// Takes positions that held at `taken`. What is no number is no position: then all stays as it was.
    pub(crate) fn take(&mut self, positions: &PerChannel<f64>, taken: Duration) {
        if positions.iter().take(self.count).all(|q| q.is_finite()) {
            (self.positions, self.taken) = (*positions, Some(taken));
        }
    }

    /// Where a machine axis was last, and when.
    pub(crate) fn position_of(&self, machine_axis: usize) -> Option<(f64, Duration)> {
        Some((self.positions[self.place_of(machine_axis)?], self.taken?))
    }

    /// The travel after which a machine axis counts as turned, mm or rad.
    pub(crate) fn reversal_of(&self, machine_axis: usize) -> Option<f64> {
        Some(self.reversal[self.place_of(machine_axis)?])
    }

    fn place_of(&self, machine_axis: usize) -> Option<usize> {
        (0..self.count).find(|&place| self.machine_axis[place] == machine_axis)
    }
}

/// Positions of the machine as one path may use them.
#[derive(Default)]
pub(crate) struct Place {
    /// Positions without correction, mm and rad.
    pub(crate) positions: PerAxis<f64>,
    /// When each position held; zero where it is stated as fixed.
    pub(crate) taken: PerAxis<Duration>,
    /// Which positions are known, as bits: bit 0 is the first axis.
    pub(crate) known: u16,
    /// When the oldest position that was shown held; `None`: none was shown.
    pub(crate) oldest: Option<Duration>,
    /// When the oldest of those held that the path does not show itself; `None`: it shows all that are known.
    pub(crate) oldest_of_others: Option<Duration>,
}

impl Place {
    /// Whether the position of each of so many axes is known.
    pub(crate) fn is_complete(&self, axes: usize) -> bool {
        self.known == u16::MAX >> (16 - axes.min(MAX_AXES))
    }
}
