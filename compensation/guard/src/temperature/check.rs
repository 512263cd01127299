//! One sensor over time.

use core::time::Duration;

use super::{
    readmission::{BeforeJump, Readmission},
    types::{Heard, MAX_SENSORS, SensorFlaw, SensorLimits},
};

/// The largest difference between two readings that is taken for a step or the noise of a module, and not for a jump,
/// K. The billionth allows for the rounding of decimal fractions.
const STEP_K: f64 = 0.5 + 1e-9;
/// How far the temperature of a sensor that was silent for longer than a reading may be old is believed to have moved
/// in that time, K: within minutes, and from half an hour on by so much in a minute (20 K in an hour), up to what a machine
/// cools by overnight.
const UNSEEN_MINUTES_K: f64 = 10.0;
const UNSEEN_K_PER_MIN: f64 = 20.0 / 60.0;
const UNSEEN_NIGHT_K: f64 = 20.0;

/// A temperature that was believed.
#[derive(Clone, Copy, Debug)]
struct Believed {
    degc: f64,
    taken: Duration,
    /// A temperature that follows the readings no faster than a temperature may change, °C: a reading farther than a
    /// step from it has jumped.
    followed: f64,
    /// Since when the digits are the same.
    same_since: Duration,
    /// The temperatures of all sensors that were believed together with this one, °C; `None` until the cycle ends in
    /// which it was read.
    neighbours: Option<[f64; MAX_SENSORS]>,
}

/// The memory of one sensor: what was believed last, and whether it jumped since.
#[derive(Clone, Copy, Debug, Default)]
pub struct SensorCheck {
    /// The last reading and what was found: a reading that is told again is not judged again.
    last: Option<(Duration, f64, Option<SensorFlaw>)>,
    believed: Option<Believed>,
    /// The device reported a fault, or the reading was out of range, since it was believed last.
    was_faulty: bool,
    jumped: Option<Readmission>,
    used: bool,
}

impl SensorCheck {
    /// A person confirms that the sensor is right: after a jump its next reading is believed as the first one was.
    pub fn acknowledge(&mut self) {
        if self.jumped.is_some() {
            *self = Self::default();
        }
    }

    /// The temperature that is believed now, °C; NaN where there is none.
    pub(super) fn believed(&self) -> f64 {
        self.believed
            .filter(|_| self.used)
            .map_or(f64::NAN, |believed| believed.degc)
    }

    /// Keeps the temperatures of all sensors at the end of the cycle in which a new reading of this one was believed,
    /// °C: after a jump, its usual difference from its neighbours is that of one and the same moment.
    pub(super) fn remember(&mut self, all: &[f64; MAX_SENSORS]) {
        if let Some(believed) = &mut self.believed
            && self.used
        {
            believed.neighbours.get_or_insert(*all);
        }
    }

    /// Judges what was heard of the sensor at `own` among all. `others` are the temperatures that are believed of all
    /// sensors, °C.
    pub(super) fn check(
        &mut self,
        now: Duration,
        heard: Heard,
        own: usize,
        others: &[f64; MAX_SENSORS],
        limits: &SensorLimits,
    ) -> Option<SensorFlaw> {
        let flaw = self.flaw(now, heard, own, others, limits);
        self.used = flaw.is_none_or(SensorFlaw::is_used);
        flaw
    }

    fn flaw(
        &mut self,
        now: Duration,
        heard: Heard,
        own: usize,
        others: &[f64; MAX_SENSORS],
        limits: &SensorLimits,
    ) -> Option<SensorFlaw> {
        let Heard::Temperature { degc, taken } = heard else {
            self.was_faulty |= heard == Heard::Fault;
            self.interrupt();
            return Some(SensorFlaw::Broken);
        };
        if now.saturating_sub(taken) > limits.stale {
            return Some(SensorFlaw::Stale);
        }
        let [low, high] = limits.range_degc;
        if !(low..=high).contains(&degc) {
            self.was_faulty = true;
            self.interrupt();
            return Some(SensorFlaw::OutOfRange);
        }
        if let Some((when, same, flaw)) = self.last
            && when == taken
            && same.to_bits() == degc.to_bits()
        {
            return flaw;
        }
        let flaw = self.change(degc, taken, own, others, limits);
        self.last = Some((taken, degc, flaw));
        flaw
    }

    /// Judges a reading by those before it.
    fn change(
        &mut self,
        degc: f64,
        taken: Duration,
        own: usize,
        others: &[f64; MAX_SENSORS],
        limits: &SensorLimits,
    ) -> Option<SensorFlaw> {
        let first = Believed {
            degc,
            taken,
            followed: degc,
            same_since: taken,
            neighbours: None,
        };
        let Some(before) = self.believed else {
            self.believed = Some(first);
            return None;
        };
        if let Some(jumped) = &mut self.jumped {
            if !jumped.sees(degc, taken, others, limits.stale) {
                return Some(SensorFlaw::Jumped);
            }
            (self.jumped, self.was_faulty) = (None, false);
            self.believed = Some(first);
            return None;
        }
        let since = taken.saturating_sub(before.taken);
        let allowed = self.allowed_k(since, limits);
        let at_jump = BeforeJump {
            own,
            degc: before.degc,
            taken: before.taken,
            neighbours: before.neighbours.unwrap_or([f64::NAN; MAX_SENSORS]),
        };
        // What a sensor told before it was faulty for long says little: its neighbours know what has happened since.
        let contradicted = self.was_faulty
            && since > limits.stale
            && (at_jump.change(others))
                .is_some_and(|change| (degc - before.degc - change).abs() > allowed + STEP_K);
        let followed = before.followed + (degc - before.followed).max(-allowed).min(allowed);
        if (degc - followed).abs() > STEP_K || contradicted {
            self.jumped = Some(Readmission::new(&at_jump));
            return Some(SensorFlaw::Jumped);
        }
        let same_since = if degc.to_bits() == before.degc.to_bits() {
            before.same_since
        } else {
            taken
        };
        self.was_faulty = false;
        self.believed = Some(Believed {
            followed,
            same_since,
            ..first
        });
        let stands = taken.saturating_sub(same_since);
        let stuck = limits.stuck_after.is_some_and(|after| stands >= after);
        stuck.then_some(SensorFlaw::Stuck)
    }

    /// How far the temperature may have moved in the time since it was believed, K. The time in which a sensor was
    /// faulty speaks for no change: it counts for no more than a stale reading.
    fn allowed_k(&self, since: Duration, limits: &SensorLimits) -> f64 {
        let moved = |rate: f64, time: Duration| rate * time.as_secs_f64() / 60.0;
        let most = limits.max_degc_per_min;
        let seen = since.min(limits.stale);
        let silent = since.saturating_sub(seen);
        let unseen = if self.was_faulty {
            0.0
        } else {
            let cooled = moved(UNSEEN_K_PER_MIN, silent).max(UNSEEN_MINUTES_K);
            moved(most, silent).min(cooled.min(UNSEEN_NIGHT_K))
        };
        moved(most, seen) + unseen
    }

    fn interrupt(&mut self) {
        if let Some(jumped) = &mut self.jumped {
            jumped.interrupt();
        }
    }
}
