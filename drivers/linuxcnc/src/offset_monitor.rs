//! Detects axes whose actual offset differs from the value that the bridge reports as applied.
//!
//! The bridge makes the same check and holds the correction. This second check covers a faulty bridge. Each state
//! contains both the value that the barrier applies and the offset that the control's planner has reached.

use std::time::Duration;

use volcomp_vocabulary::MAX_AXES;

use crate::{Flags, State};

/// Tolerance of an offset, counts. The total tolerance also includes `TOLERANCE_NANO` (nm or millionths of a degree),
/// within which the planner stops, and the recent movement of the applied value. The tolerance is small, so that even a
/// small missing correction is detected.
const TOLERANCE_COUNTS: f64 = 3.0;
const TOLERANCE_NANO: f64 = 10.0;
/// Maximum lag of the control's planner. Recent movement decays with this time constant.
const MAX_PLANNER_LAG: Duration = Duration::from_millis(250);
/// Time for which the offset must be out of tolerance to count as lost.
const LOST_AFTER: Duration = Duration::from_millis(500);
/// Number of words in a report before the words of the axes.
const HEADER_WORDS: usize = 8;
/// Number of words per axis in a report.
const WORDS_PER_AXIS: usize = 3;

#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct OffsetMonitor {
    last: Option<Duration>,
    applied: [f64; MAX_AXES],
    /// Recent movement of the applied value of each axis, nm or millionths of a degree. It decays with
    /// `MAX_PLANNER_LAG`.
    moved: [f64; MAX_AXES],
    /// Time on the bridge's clock since when an axis has been out of tolerance; `None` if all axes are within it.
    since: Option<Duration>,
    is_lost: bool,
}

impl OffsetMonitor {
    /// Whether an axis has been out of tolerance for `LOST_AFTER`.
    pub(crate) fn is_lost(&self) -> bool {
        self.is_lost
    }

    /// Processes a state of the same run as the previous state. Its first `axes` axes are the corrected axes.
    pub(crate) fn process(&mut self, state: &State, axes: usize) {
        let words = state.report.as_slice();
        let applies = state.flags.has(Flags::ENABLED) && state.flags.has(Flags::HOMED);
        if words.len() < HEADER_WORDS + WORDS_PER_AXIS * axes || !applies {
            // The state has no report, or the machine is off or not homed.
            *self = Self::default();
            return;
        }
        let passed = self.last.map(|last| state.time.saturating_sub(last).as_secs_f64());
        let kept = passed.map_or(0.0, |passed| (-passed / MAX_PLANNER_LAG.as_secs_f64()).exp());
        let mut far = false;
        for (index, axis) in state.axes().take(axes).enumerate() {
            let counts = words[HEADER_WORDS + WORDS_PER_AXIS * index].cast_signed();
            let applied = f64::from(counts) * f64::from(axis.step);
            let step = if passed.is_some() { (applied - self.applied[index]).abs() } else { 0.0 };
            self.moved[index] = self.moved[index] * kept + step;
            self.applied[index] = applied;
            #[expect(clippy::cast_precision_loss, reason = "9e15 nm are far beyond any limit")]
            let offset = axis.offset as f64;
            let most = TOLERANCE_NANO + TOLERANCE_COUNTS * f64::from(axis.step) + self.moved[index];
            far |= (offset - applied).abs() > most;
        }
        self.last = Some(state.time);
        self.since = far.then(|| self.since.unwrap_or(state.time));
        let off_for = |since| state.time.saturating_sub(since);
        self.is_lost = self.since.is_some_and(|since| off_for(since) >= LOST_AFTER);
    }
}

#[cfg(test)]
mod tests {
    use volcomp_port::Words;
    use volcomp_vocabulary::AxisName;

    use super::*;
    use crate::AxisState;

    const MS: Duration = Duration::from_millis(1);

    fn state(ms: u32, step: u32, applied: i16, offset: i64) -> State {
        let axis = AxisState { name: AxisName::X, step, position: 0.0, velocity: 0.0, offset };
        let mut state = State::of(&[axis]).expect("one");
        let mut words = [0; 13];
        words[HEADER_WORDS] = applied.cast_unsigned();
        state.report = Words::new(&words).expect("room");
        state.flags = Flags(Flags::ENABLED | Flags::HOMED);
        state.time = MS * ms;
        state
    }

    fn lost(of: impl Fn(u32) -> (i16, i64)) -> Option<u32> {
        let mut offset_monitor = OffsetMonitor::default();
        (1..20_000).find(|ms| {
            let (applied, offset) = of(*ms);
            offset_monitor.process(&state(*ms, 1, applied, offset), 1);
            offset_monitor.is_lost()
        })
    }

    #[test]
    fn a_constant_difference_is_lost_after_half_a_second() {
        assert_eq!(lost(|_| (13, 0)), None);
        assert_eq!(lost(|_| (-14, 0)), Some(501));
        assert_eq!(lost(|_| (10_000, 20_000)), Some(501));
        // An offset that lacks four counts of 10 nm is within the tolerance.
        let mut offset_monitor = OffsetMonitor::default();
        for ms in 1..2000 {
            offset_monitor.process(&state(ms, 10, 4, 0), 1);
            assert!(!offset_monitor.is_lost());
        }
        let mut offset_monitor = OffsetMonitor::default();
        for ms in 1..=501 {
            assert!(!offset_monitor.is_lost());
            offset_monitor.process(&state(ms, 10, 5, 0), 1);
        }
        assert!(offset_monitor.is_lost());
        offset_monitor.process(&state(502, 10, 5, 30), 1);
        assert!(!offset_monitor.is_lost(), "the offset arrived");
    }

    /// The offset follows a correction that moves up and down at 500 µm/s, with a delay of 100 ms.
    #[test]
    fn an_offset_that_follows_in_time_is_not_lost() {
        #[expect(clippy::cast_possible_truncation, reason = "30 um in nm")]
        let at = |ms: u32| {
            let phase = f64::from(ms % 240) / 240.0;
            (60_000.0 * ((2.0 * phase - 1.0).abs() - 0.5)) as i16
        };
        assert_eq!(lost(|ms| (at(ms), at(ms.saturating_sub(100)).into())), None);
        // The correction ramps to 30 µm at 500 µm/s, but the planner moves at 5 µm/s.
        #[expect(clippy::cast_possible_truncation, reason = "30 um in nm")]
        let ramp = |ms: u32| (ms.min(60) * 500) as i16;
        let found = lost(|ms| (ramp(ms), i64::from(ms) * 5)).expect("lost");
        assert!((501..1500).contains(&found), "{found} ms");
    }

    /// The correction moves away from a stopped planner by less than one count per cycle.
    #[test]
    fn a_creeping_difference_is_lost() {
        #[expect(clippy::cast_possible_truncation, reason = "2 um in nm")]
        let creeps = |ms: u32| (ms / 100) as i16;
        let found = lost(|ms| (creeps(ms), 0)).expect("lost");
        assert!((1800..2500).contains(&found), "{found} ms");
        assert_eq!(lost(|ms| (creeps(ms), creeps(ms.saturating_sub(200)).into())), None);
    }

    #[test]
    fn offsets_are_ignored_while_the_machine_is_off() {
        let mut offset_monitor = OffsetMonitor::default();
        for ms in 1..2000 {
            let mut state = state(ms, 1, 10_000, 0);
            state.flags = Flags(Flags::HOMED);
            offset_monitor.process(&state, 1);
            assert!(!offset_monitor.is_lost());
        }
    }
}
