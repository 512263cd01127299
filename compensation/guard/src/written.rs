//! The corrections that were written in the last cycles.

use volcomp_vocabulary::PerChannel;

use crate::{Limits, limits::MOST_READ_BACK_CYCLES};

/// The last outputs, for a read-back that is behind.
#[derive(Clone, Debug)]
pub(crate) struct Written {
    ring: [PerChannel<f64>; MOST_READ_BACK_CYCLES],
    next: usize,
}

impl Written {
    pub(crate) fn fill(values: &PerChannel<f64>) -> Self {
        Self {
            ring: [*values; MOST_READ_BACK_CYCLES],
            next: 0,
        }
    }

    pub(crate) fn push(&mut self, values: &PerChannel<f64>) {
        self.ring[self.next] = *values;
        self.next = (self.next + 1) % MOST_READ_BACK_CYCLES;
    }

    /// Whether one of the last so many writes is within half a step on every axis.
    pub(crate) fn holds(&self, applied: &PerChannel<f64>, last: usize, limits: &Limits) -> bool {
        (0..limits.count).all(|axis| {
            (1..=last.min(MOST_READ_BACK_CYCLES)).any(|back| {
                let place = (self.next + MOST_READ_BACK_CYCLES - back) % MOST_READ_BACK_CYCLES;
                (applied[axis] - self.ring[place][axis]).abs()
                    <= 0.51 * limits.axes[axis].resolution
            })
        })
    }
}
