//! Where the axes that a controller shows were seen last. Plain data.

use std::time::Duration;

use volcomp_vocabulary::PerChannel;

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
    /// So many axes that were not seen yet.
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
