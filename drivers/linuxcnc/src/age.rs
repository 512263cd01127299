//! Converts times on the bridge's clock to the gateway's clock, so that the age of a state is known.

use std::time::{Duration, Instant};

/// Time for which a comparison of the clocks is valid. The clocks may drift by 100 µs within this time (10 ppm).
const COMPARISON_WINDOW: Duration = Duration::from_secs(10);

/// Offset between the gateway's clock and the bridge's clock, from the datagrams with the least delay. If a datagram
/// has a larger offset, the excess is its delay on the network or in the queue of the socket, and adds to its age.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Clocks {
    /// Smallest offset in the current window, then smallest offset in the previous window. An offset is the time on the
    /// gateway's clock at which the bridge's clock was zero.
    least: [Option<Instant>; 2],
    begun: Option<Instant>,
}

impl Clocks {
    /// Discards all comparisons. Call this after the bridge has restarted or has moved to another computer.
    pub(crate) fn reset(&mut self) {
        *self = Self::default();
    }

    /// Converts `time` on the bridge's clock to the gateway's clock, by the datagram with the least delay in the last
    /// two windows. `arrived` is the time at which the datagram was read. The result is never later than `arrived`.
    pub(crate) fn local_time(&mut self, time: Duration, arrived: Instant) -> Instant {
        // Time on the gateway's clock at which the bridge's clock was zero; `None` if `Instant` cannot represent this
        // time.
        let Some(zero) = arrived.checked_sub(time) else {
            return arrived;
        };
        let begun = *self.begun.get_or_insert(arrived);
        if arrived.saturating_duration_since(begun) > COMPARISON_WINDOW {
            self.begun = Some(arrived);
            self.least = [None, self.least[0]];
        }
        let least = self.least[0].map_or(zero, |least| least.min(zero));
        self.least[0] = Some(least);
        let least = self.least[1].map_or(least, |before| before.min(least));
        least.checked_add(time).map_or(arrived, |local_time| local_time.min(arrived))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn a_queued_datagram_is_older_by_its_wait() {
        let start = Instant::now();
        let mut clocks = Clocks::default();
        let far = 5000 * MS;
        assert_eq!(clocks.local_time(1000 * MS, start + far), start + far);
        // This datagram was sent 10 ms after the first one, but read 25 ms after it.
        let local_time = clocks.local_time(1010 * MS, start + far + 25 * MS);
        assert_eq!(local_time, start + far + 10 * MS);
        // A faster datagram shows that the first one was delayed.
        let local_time = clocks.local_time(1020 * MS, start + far + 18 * MS);
        assert_eq!(local_time, start + far + 18 * MS);
        let local_time = clocks.local_time(1030 * MS, start + far + 30 * MS);
        assert_eq!(local_time, start + far + 28 * MS);
    }

    #[test]
    fn diverging_clocks_are_compared_again() {
        let start = Instant::now();
        let mut clocks = Clocks::default();
        // The gateway's clock runs 0.1 % faster, which is 60 ms per minute. The drift within the last two windows is
        // not corrected.
        let mut oldest = Duration::ZERO;
        for ms in 1000..61_000 {
            let arrived = start + MS * ms + Duration::from_micros(ms.into());
            let local_time = clocks.local_time(MS * ms, arrived);
            oldest = oldest.max(arrived - local_time);
        }
        assert!(oldest <= 2 * COMPARISON_WINDOW / 1000 + MS, "{oldest:?}");
    }
}
