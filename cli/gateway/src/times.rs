//! Cycle times: histograms over the last interval, and counts.

use hdrhistogram::Histogram;

use volcomp_runtime::Timing;

/// Number of cycles per interval; the last complete one and the current one are kept.
const STRETCH: u64 = 4096;

/// Histogram of one quantity over the current and the previous interval.
pub(crate) struct Stretch {
    current: Histogram<u64>,
    before: Histogram<u64>,
}

impl Default for Stretch {
    fn default() -> Self {
        // 100 ns to 100 s with 2 significant digits, within the bounds of the histogram.
        let empty = || Histogram::new_with_bounds(100, 100_000_000_000, 2).expect("valid bounds");
        Self {
            current: empty(),
            before: empty(),
        }
    }
}

impl Stretch {
    fn add(&mut self, ns: u64) {
        self.current.saturating_record(ns);
    }

    fn turn(&mut self) {
        std::mem::swap(&mut self.current, &mut self.before);
        self.current.reset();
    }

    /// The last complete interval, or the current one if there is none.
    fn latest(&self) -> &Histogram<u64> {
        if self.before.is_empty() {
            &self.current
        } else {
            &self.before
        }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.latest().is_empty()
    }

    /// A quantile of the last interval, µs.
    pub(crate) fn quantile_us(&self, quantile: f64) -> f64 {
        self.latest().value_at_quantile(quantile) as f64 * 1e-3
    }

    /// Counts in bins that double in width: upper edge (µs) and count.
    pub(crate) fn bins_us(&self) -> Vec<(f64, u64)> {
        let edges = (0..20).map(|power| 500_u64 << power);
        edges
            .map(|low| {
                (
                    (2 * low) as f64 * 1e-3,
                    self.latest().count_between(low, 2 * low - 1),
                )
            })
            .collect()
    }
}

/// Times of complete cycles and of their parts.
#[derive(Default)]
pub(crate) struct Times {
    /// The complete cycle, from wake-up to completion.
    pub whole: Stretch,
    /// Compute time of the gateway, by the CPU clock.
    pub own: Stretch,
    /// Time of the reference computation, by the same clock; empty if it is not made.
    pub reference: Stretch,
    /// Wake-up latency after the deadline.
    pub wake: Stretch,
    /// Time of the exchanges with controllers.
    pub exchange: Stretch,
    /// Number of cycles.
    pub count: u64,
    /// Number of missed periods.
    pub overruns: u64,
}

impl Times {
    /// Adds the times of one cycle.
    pub(crate) fn add(&mut self, timing: &Timing) {
        self.whole.add(timing.whole_ns);
        self.own.add(timing.own_ns);
        if timing.reference_ns > 0 {
            self.reference.add(timing.reference_ns);
        }
        self.wake.add(timing.wake_ns);
        self.exchange.add(timing.exchange_ns);
        self.count += 1;
        self.overruns += u64::from(timing.missed);
        if self.count.is_multiple_of(STRETCH) {
            for stretch in [
                &mut self.whole,
                &mut self.own,
                &mut self.reference,
                &mut self.wake,
                &mut self.exchange,
            ] {
                stretch.turn();
            }
        }
    }
}
