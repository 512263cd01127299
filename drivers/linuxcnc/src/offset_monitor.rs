//! Detects axes whose offset differs from what the bridge reports.
//!
//! The bridge checks this itself, and holds. This second check, by the same rule, covers a faulty bridge: each state contains both the value that
//! the barrier applies and the offset that the control's planner has reached.

use std::time::Duration;

use volcomp_vocabulary::MAX_AXES;

use crate::{Flags, State};

/// Tolerance of an offset in addition to the movement of its value within `WAY`: some counts, and the distance at which the planner stops (nm or
/// millionths of a degree). So a small correction that never arrives is detected as well as a large one.
const OFF_BY_COUNTS: f64 = 3.0;
const OFF_BY: f64 = 10.0;
/// Maximum lag of the control's planner.
const WAY: Duration = Duration::from_millis(250);
/// How long an offset must be out of tolerance.
const FOR: Duration = Duration::from_millis(500);
/// Number of report words before those of the axes, and number of words per axis.
const HEAD: usize = 8;
const OF_AXIS: usize = 3;

/// The value applied last, and its recent movement.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Adrift {
    last: Option<Duration>,
    applied: [f64; MAX_AXES],
    /// Recent movement, which expires after `WAY`.
    moved: [f64; MAX_AXES],
    /// Since when an axis is out of tolerance.
    since: Option<Duration>,
    is_lost: bool,
}

impl Adrift {
    /// Whether an axis has been out of tolerance for `FOR`.
    pub(crate) fn is_lost(&self) -> bool {
        self.is_lost
    }

    /// Processes a state of the same run as the previous one, with `axes` corrected axes.
    pub(crate) fn hear(&mut self, state: &State, axes: usize) {
        let words = state.report.as_slice();
        let applies = state.flags.has(Flags::ENABLED) && state.flags.has(Flags::HOMED);
        if words.len() < HEAD + OF_AXIS * axes || !applies {
            // The state has no report, or the machine is off.
            *self = Self::default();
            return;
        }
        let passed = self
            .last
            .map(|last| state.time.saturating_sub(last).as_secs_f64());
        let kept = passed.map_or(0.0, |passed| (-passed / WAY.as_secs_f64()).exp());
        let mut far = false;
        for (index, axis) in state.axes().take(axes).enumerate() {
            let counts = words[HEAD + OF_AXIS * index].cast_signed();
            let applied = f64::from(counts) * f64::from(axis.step);
            let step = if passed.is_some() {
                (applied - self.applied[index]).abs()
            } else {
                0.0
            };
            self.moved[index] = self.moved[index] * kept + step;
            self.applied[index] = applied;
            #[expect(
                clippy::cast_precision_loss,
                reason = "9e15 nm are far beyond any limit"
            )]
            let offset = axis.offset as f64;
            let most = OFF_BY + OFF_BY_COUNTS * f64::from(axis.step) + self.moved[index];
            far |= (offset - applied).abs() > most;
        }
        self.last = Some(state.time);
        self.since = far.then(|| self.since.unwrap_or(state.time));
        let off_for = |since| state.time.saturating_sub(since);
        self.is_lost = self.since.is_some_and(|since| off_for(since) >= FOR);
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
        let axis = AxisState {
            name: AxisName::X,
            step,
            position: 0.0,
            velocity: 0.0,
            offset,
        };
        let mut state = State::of(&[axis]).expect("one");
        let mut words = [0; 13];
        words[HEAD] = applied.cast_unsigned();
        state.report = Words::new(&words).expect("room");
        state.flags = Flags(Flags::ENABLED | Flags::HOMED);
        state.time = MS * ms;
        state
    }

    /// When it is lost, ms.
    fn lost(of: impl Fn(u32) -> (i16, i64)) -> Option<u32> {
        let mut adrift = Adrift::default();
        (1..20_000).find(|ms| {
            let (applied, offset) = of(*ms);
            adrift.hear(&state(*ms, 1, applied, offset), 1);
            adrift.is_lost()
        })
    }

    #[test]
    fn what_stands_away_is_lost_after_half_a_second() {
        assert_eq!(lost(|_| (13, 0)), None);
        assert_eq!(lost(|_| (-14, 0)), Some(501));
        assert_eq!(lost(|_| (10_000, 20_000)), Some(501));
        // Of counts of 10 nm, four are as many as may be off.
        let mut adrift = Adrift::default();
        for ms in 1..2000 {
            adrift.hear(&state(ms, 10, 4, 0), 1);
            assert!(!adrift.is_lost());
        }
        let mut adrift = Adrift::default();
        for ms in 1..=501 {
            assert!(!adrift.is_lost());
            adrift.hear(&state(ms, 10, 5, 0), 1);
        }
        assert!(adrift.is_lost());
        adrift.hear(&state(502, 10, 5, 30), 1);
        assert!(!adrift.is_lost(), "it has come");
    }

    /// A correction that goes up and down by 500 um/s, and offsets that come late, or not.
    #[test]
    fn what_follows_in_time_is_not_lost() {
        #[expect(clippy::cast_possible_truncation, reason = "30 um in nm")]
        let at = |ms: u32| {
            let phase = f64::from(ms % 240) / 240.0;
            (60_000.0 * ((2.0 * phase - 1.0).abs() - 0.5)) as i16
        };
        assert_eq!(lost(|ms| (at(ms), at(ms.saturating_sub(100)).into())), None);
        // A planner of 5 um/s behind a ramp of 500 um/s to 30 um.
        #[expect(clippy::cast_possible_truncation, reason = "30 um in nm")]
        let ramp = |ms: u32| (ms.min(60) * 500) as i16;
        let found = lost(|ms| (ramp(ms), i64::from(ms) * 5)).expect("lost");
        assert!((501..1500).contains(&found), "{found} ms");
    }

    /// One that creeps away, slower than a count in a cycle, from a planner that stands.
    #[test]
    fn what_creeps_away_is_lost() {
        #[expect(clippy::cast_possible_truncation, reason = "2 um in nm")]
        let creeps = |ms: u32| (ms / 100) as i16;
        let found = lost(|ms| (creeps(ms), 0)).expect("lost");
        assert!((1800..2500).contains(&found), "{found} ms");
        assert_eq!(
            lost(|ms| (creeps(ms), creeps(ms.saturating_sub(200)).into())),
            None
        );
    }

    /// While the machine is off its offsets are what they like.
    #[test]
    fn a_machine_that_is_off_has_none() {
        let mut adrift = Adrift::default();
        for ms in 1..2000 {
            let mut state = state(ms, 1, 10_000, 0);
            state.flags = Flags(Flags::HOMED);
            adrift.hear(&state, 1);
            assert!(!adrift.is_lost());
        }
    }
}
