//! The age of a state, by the clock of the bridge.

use std::time::{Duration, Instant};

/// Time after which an earlier comparison of the clocks expires: they may diverge by 100 us within it (10 ppm).
const WINDOW: Duration = Duration::from_secs(10);

/// The difference between the bridge's clock and ours, from the fastest datagrams. A datagram that was delayed on the network, or queued here,
/// shows a larger difference and is older by the excess.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Clocks {
    /// The smallest difference, ours minus the bridge's, in this window and in the previous one.
    least: [Option<Instant>; 2],
    begun: Option<Instant>,
}

impl Clocks {
    /// Forgets all comparisons: the bridge restarted, or moved to another computer.
    pub(crate) fn forget(&mut self) {
        *self = Self::default();
    }

    /// Converts `time` of the bridge's clock to our clock, as well as the datagrams so far allow. `arrived` is when this one was read; the result
    /// is never later.
    pub(crate) fn held(&mut self, time: Duration, arrived: Instant) -> Instant {
        // Our time at which the bridge's clock was zero; `None` if `Instant` cannot represent it.
        let Some(zero) = arrived.checked_sub(time) else {
            return arrived;
        };
        let begun = *self.begun.get_or_insert(arrived);
        if arrived.saturating_duration_since(begun) > WINDOW {
            self.begun = Some(arrived);
            self.least = [None, self.least[0]];
        }
        let least = self.least[0].map_or(zero, |least| least.min(zero));
        self.least[0] = Some(least);
        let least = self.least[1].map_or(least, |before| before.min(least));
        least
            .checked_add(time)
            .map_or(arrived, |held| held.min(arrived))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: Duration = Duration::from_millis(1);

    #[test]
    fn what_waited_is_as_much_older() {
        let start = Instant::now();
        let mut clocks = Clocks::default();
        let far = 5000 * MS;
        assert_eq!(clocks.held(1000 * MS, start + far), start + far);
        // Sent 10 ms later, and read 25 ms later.
        let held = clocks.held(1010 * MS, start + far + 25 * MS);
        assert_eq!(held, start + far + 10 * MS);
        // One that came faster than the first shows that the first had waited.
        let held = clocks.held(1020 * MS, start + far + 18 * MS);
        assert_eq!(held, start + far + 18 * MS);
        let held = clocks.held(1030 * MS, start + far + 30 * MS);
        assert_eq!(held, start + far + 28 * MS);
    }

    #[test]
    fn clocks_that_go_apart_are_compared_anew() {
        let start = Instant::now();
        let mut clocks = Clocks::default();
        // Ours goes 0.1 % faster: after a minute that is 60 ms, of which two windows are not known yet.
        let mut oldest = Duration::ZERO;
        for ms in 1000..61_000 {
            let arrived = start + MS * ms + Duration::from_micros(ms.into());
            let held = clocks.held(MS * ms, arrived);
            oldest = oldest.max(arrived - held);
        }
        assert!(oldest <= 2 * WINDOW / 1000 + MS, "{oldest:?}");
    }
}
