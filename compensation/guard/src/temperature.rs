//! Plausibility of the temperatures of a machine. All decisions are made here; drivers only report values and times.

use core::time::Duration;

/// Maximum number of temperatures of one machine.
pub const MAX_SENSORS: usize = 64;

/// The limits for accepting the temperatures of a machine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorLimits {
    /// Lowest and highest possible temperature on this machine, °C.
    pub range_degc: [f64; 2],
    /// Largest accepted rate of change of a temperature, K/min. A step of up to half a kelvin is the resolution or noise of a module, not a change.
    pub max_degc_per_min: f64,
    /// Age beyond which a temperature is stale and not used.
    pub stale: Duration,
    /// A sensor with the same digits for this long is reported as stuck, but still used; `None`: never.
    pub stuck_after: Option<Duration>,
    /// A sensor whose temperature differs by more than this from the median of the other sensors, K, is reported as
    /// disagreeing, but still used; `None`: not compared.
    pub neighbours_k: Option<f64>,
}

impl Default for SensorLimits {
    /// −20 to 120 °C, 5 K/min, 30 s, six hours of the same digits, not compared with the other sensors.
    fn default() -> Self {
        Self {
            range_degc: [-20.0, 120.0],
            max_degc_per_min: 5.0,
            stale: Duration::from_secs(30),
            stuck_after: Some(Duration::from_secs(6 * 3600)),
            neighbours_k: None,
        }
    }
}

/// The answer of a device for one of its sensors, as received by its driver.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum SensorReading {
    /// The device does not answer, or has not answered yet.
    #[default]
    Silence,
    /// The device answers, and reports a fault of this sensor: open circuit, short circuit, over-range.
    Fault,
    /// The device answers with a temperature and reports no fault.
    Temperature {
        /// The temperature as reported by the device, °C.
        degc: f64,
        /// When the temperature was measured, on the clock passed to the check.
        taken: Duration,
    },
}

/// Why a temperature is rejected, or accepted with a reservation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SensorFlaw {
    /// The device reports a fault of the sensor, or does not answer: the temperature is not used.
    #[error("broken or silent")]
    Broken,
    /// The temperature is older than [`SensorLimits::stale`]: it is not used.
    #[error("stale")]
    Stale,
    /// The temperature is not a number or outside [`SensorLimits::range_degc`]: it is not used.
    #[error("out of range")]
    OutOfRange,
    /// The temperature changed faster than [`SensorLimits::max_degc_per_min`], and the sensor was not readmitted since:
    /// it is not used.
    #[error("jumped")]
    Jumped,
    /// The reading did not change in any digit for [`SensorLimits::stuck_after`]; it is still used.
    #[error("stuck at one value")]
    Stuck,
    /// The temperature differs from the median of the other sensors by more than [`SensorLimits::neighbours_k`]; it is
    /// still used.
    #[error("disagrees with its neighbours")]
    Disagrees,
}

impl SensorFlaw {
    /// Whether a temperature with this flaw is still used.
    pub fn is_used(self) -> bool {
        matches!(self, Self::Stuck | Self::Disagrees)
    }
}

/// A checked temperature.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SensorReport {
    /// The temperature, °C; `None` if it is not used.
    pub degc: Option<f64>,
    /// Flaw; `None` for a good temperature, and before the first check.
    pub flaw: Option<SensorFlaw>,
    /// Whether the sensor has jumped and was not readmitted since. Also set while `flaw` reports another cause: broken,
    /// stale or out of range.
    pub jumped: bool,
}

/// Checks the received temperatures of a machine at the time `now`. `checks` are the histories of the sensors, `reports` receives the accepted
/// temperatures, all in the same order; sensors beyond [`MAX_SENSORS`] are omitted.
pub fn judge_temperatures(
    checks: &mut [SensorCheck],
    readings: &[SensorReading],
    now: Duration,
    limits: &SensorLimits,
    reports: &mut [SensorReport],
) {
    // Values before this cycle, so that a sensor is not compared with a sensor that jumps together with it.
    let accepted = accepted_temperatures(checks);
    let sensors = checks.iter_mut().zip(readings).zip(reports.iter_mut());
    let mut count = 0;
    for (own, ((check, reading), report)) in sensors.take(MAX_SENSORS).enumerate() {
        let flaw = check.check(now, *reading, own, &accepted, limits);
        let degc = match reading {
            SensorReading::Temperature { degc, .. } => Some(*degc),
            SensorReading::Silence | SensorReading::Fault => None,
        };
        *report = SensorReport {
            degc: degc.filter(|_| flaw.is_none_or(SensorFlaw::is_used)),
            flaw,
            jumped: check.jumped.is_some(),
        };
        count = own + 1;
    }
    let accepted = accepted_temperatures(checks);
    for check in checks.iter_mut().take(count) {
        check.remember(&accepted);
    }
    if let Some(allowed_k) = limits.neighbours_k {
        mark_disagreeing(&mut reports[..count], allowed_k);
    }
}

/// Accepted temperatures of all sensors, °C; NaN for a sensor without an accepted temperature or currently not used.
fn accepted_temperatures(checks: &[SensorCheck]) -> [f64; MAX_SENSORS] {
    let mut accepted = [f64::NAN; MAX_SENSORS];
    for (degc, check) in accepted.iter_mut().zip(checks) {
        *degc = check.accepted();
    }
    accepted
}

/// Largest difference between two readings that is treated as the resolution or noise of a module, not as a jump, K. The billionth covers the
/// rounding of decimal fractions.
const STEP_K: f64 = 0.5 + 1e-9;
/// Largest change of a temperature, K, while its sensor was silent beyond the maximum age for less
/// than half an hour.
const UNSEEN_MINUTES_K: f64 = 10.0;
/// Largest change of a temperature per minute while its sensor was silent for longer: 20 K in an
/// hour.
const UNSEEN_K_PER_MIN: f64 = 20.0 / 60.0;
/// Largest change of a temperature during any silence of its sensor, K: the overnight cooling of a
/// machine.
const UNSEEN_NIGHT_K: f64 = 20.0;

#[derive(Clone, Copy, Debug)]
struct AcceptedTemperature {
    degc: f64,
    taken: Duration,
    /// A temperature that follows the readings no faster than the allowed rate, °C: a reading that differs by more than
    /// one step from it has jumped.
    followed: f64,
    /// Time since which the digits are unchanged.
    same_since: Duration,
    /// The temperatures of all sensors accepted at the same time, °C; `None` until the end of the cycle in which this
    /// temperature was accepted.
    neighbours: Option<[f64; MAX_SENSORS]>,
}

/// The history of one sensor: the last accepted temperature, and whether it has jumped since.
///
/// Invariants:
/// - `jumped` is set only with an accepted temperature, which does not change until the sensor is readmitted or acknowledged.
/// - `used` is the result of the last check.
#[derive(Clone, Copy, Debug, Default)]
pub struct SensorCheck {
    /// The last reading and its flaw: a repeated reading is not checked again.
    last: Option<(Duration, f64, Option<SensorFlaw>)>,
    accepted: Option<AcceptedTemperature>,
    /// Whether, since the last accepted temperature, the device has reported a fault or a reading
    /// out of range.
    was_faulty: bool,
    jumped: Option<Readmission>,
    used: bool,
}

impl SensorCheck {
    /// The operator confirms the sensor: after a jump its next reading is accepted like a first reading.
    pub fn acknowledge(&mut self) {
        if self.jumped.is_some() {
            *self = Self::default();
        }
    }

    /// Accepted temperature, °C; NaN if missing or if the sensor is currently not used.
    fn accepted(&self) -> f64 {
        self.accepted.filter(|_| self.used).map_or(f64::NAN, |accepted| accepted.degc)
    }

    /// Stores the temperatures of all sensors, °C, at the end of the cycle in which a new reading of this sensor was
    /// accepted. The usual differences from its neighbours then refer to a single time.
    fn remember(&mut self, all: &[f64; MAX_SENSORS]) {
        if let Some(accepted) = &mut self.accepted
            && self.used
        {
            accepted.neighbours.get_or_insert(*all);
        }
    }

    /// Checks the answer for the sensor with index `own`; `None` if the answer has no flaw. `others` is the result of
    /// `accepted_temperatures` before this cycle, °C.
    fn check(
        &mut self,
        now: Duration,
        reading: SensorReading,
        own: usize,
        others: &[f64; MAX_SENSORS],
        limits: &SensorLimits,
    ) -> Option<SensorFlaw> {
        let flaw = self.flaw(now, reading, own, others, limits);
        self.used = flaw.is_none_or(SensorFlaw::is_used);
        flaw
    }

    fn flaw(
        &mut self,
        now: Duration,
        reading: SensorReading,
        own: usize,
        others: &[f64; MAX_SENSORS],
        limits: &SensorLimits,
    ) -> Option<SensorFlaw> {
        let SensorReading::Temperature { degc, taken } = reading else {
            self.was_faulty |= reading == SensorReading::Fault;
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

    fn change(
        &mut self,
        degc: f64,
        taken: Duration,
        own: usize,
        others: &[f64; MAX_SENSORS],
        limits: &SensorLimits,
    ) -> Option<SensorFlaw> {
        let first = AcceptedTemperature {
            degc,
            taken,
            followed: degc,
            same_since: taken,
            neighbours: None,
        };
        let Some(before) = self.accepted else {
            self.accepted = Some(first);
            return None;
        };
        if let Some(jumped) = &mut self.jumped {
            if !jumped.process(degc, taken, others, limits.stale) {
                return Some(SensorFlaw::Jumped);
            }
            (self.jumped, self.was_faulty) = (None, false);
            self.accepted = Some(first);
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
        // A temperature from before a long fault is unreliable: the neighbouring sensors show the change since.
        let contradicted = self.was_faulty
            && since > limits.stale
            && (at_jump.change(others))
                .is_some_and(|change| (degc - before.degc - change).abs() > allowed + STEP_K);
        let followed = before.followed + (degc - before.followed).max(-allowed).min(allowed);
        if (degc - followed).abs() > STEP_K || contradicted {
            self.jumped = Some(Readmission::new(&at_jump));
            return Some(SensorFlaw::Jumped);
        }
        let same_since =
            if degc.to_bits() == before.degc.to_bits() { before.same_since } else { taken };
        self.was_faulty = false;
        self.accepted = Some(AcceptedTemperature { followed, same_since, ..first });
        let stands = taken.saturating_sub(same_since);
        let stuck = limits.stuck_after.is_some_and(|after| stands >= after);
        stuck.then_some(SensorFlaw::Stuck)
    }

    /// Largest allowed change of the temperature since it was accepted, K. Time with a fault counts only up to the
    /// maximum age of a reading.
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

/// Time for which a sensor that jumped must agree before it is accepted again.
const AGREES_FOR: Duration = Duration::from_secs(600);
const AGREES_WITHIN_K: f64 = 1.0;

/// Data of a sensor at the time of its last accepted temperature.
#[derive(Clone, Copy, Debug)]
struct BeforeJump {
    /// Index of the sensor.
    pub own: usize,
    pub degc: f64,
    pub taken: Duration,
    /// Temperatures of all sensors at the time of the measurement, °C; NaN for rejected ones.
    pub neighbours: [f64; MAX_SENSORS],
}

impl BeforeJump {
    /// Change of the other sensors since the last accepted temperature, K; `None` if fewer than two were accepted at both times.
    fn change(&self, accepted: &[f64; MAX_SENSORS]) -> Option<f64> {
        common_change(&self.neighbours, accepted, self.own)
    }
}

/// The readmission of a sensor that jumped, by agreement with predictions. The passing of time does not readmit a
/// sensor.
#[derive(Clone, Copy, Debug)]
struct Readmission {
    before: BeforeJump,
    /// Last known change of the other sensors since the sensor was accepted, K; 0 if it was never known.
    change: f64,
    seen: Option<Duration>,
    /// Time since which the readings agree with the sensor's own temperature from before the jump.
    with_own: Option<Duration>,
    /// Time since which the readings agree with the sensor's own temperature from before the jump plus the change of
    /// the other sensors.
    with_predicted: Option<Duration>,
}

impl Readmission {
    fn new(before: &BeforeJump) -> Self {
        Self { before: *before, change: 0.0, seen: None, with_own: None, with_predicted: None }
    }

    /// Processes a reading, and returns whether the sensor is accepted again. A gap longer than `stale` restarts the
    /// ten minutes. If the sensor's temperature from before the jump is older than `stale` when the ten minutes begin,
    /// it is not used as a prediction: the machine has changed since, and only the other sensors show this change.
    fn process(
        &mut self,
        degc: f64,
        taken: Duration,
        accepted: &[f64; MAX_SENSORS],
        stale: Duration,
    ) -> bool {
        if (self.seen).is_some_and(|seen| taken.saturating_sub(seen) > stale) {
            self.interrupt();
        }
        self.seen = Some(taken);
        self.change = self.before.change(accepted).unwrap_or(self.change);
        let close = |expected: f64| (degc - expected).abs() <= AGREES_WITHIN_K;
        let began = self.with_own.unwrap_or(taken);
        let is_fresh = began.saturating_sub(self.before.taken) <= stale;
        let own = lasts(&mut self.with_own, is_fresh && close(self.before.degc), taken);
        let predicted =
            lasts(&mut self.with_predicted, close(self.before.degc + self.change), taken);
        own || predicted
    }

    fn interrupt(&mut self) {
        self.with_own = None;
        self.with_predicted = None;
    }
}

/// Whether an agreement has lasted for [`AGREES_FOR`]; `since` is its start.
fn lasts(since: &mut Option<Duration>, agrees: bool, taken: Duration) -> bool {
    *since = agrees.then(|| since.unwrap_or(taken));
    since.is_some_and(|since| taken.saturating_sub(since) >= AGREES_FOR)
}

/// Minimum number of other sensors with which a wrong sensor can be identified: of two sensors, either may be wrong.
const FEWEST: usize = 2;

/// Median change of the other sensors between two times, K; `None` if fewer than two were accepted at both.
fn common_change(before: &[f64; MAX_SENSORS], now: &[f64; MAX_SENSORS], own: usize) -> Option<f64> {
    let mut changes = [0.0; MAX_SENSORS];
    let mut count = 0;
    for (other, (before, now)) in before.iter().zip(now).enumerate() {
        let change = now - before;
        if other != own && change.is_finite() {
            changes[count] = change;
            count += 1;
        }
    }
    let changes = &mut changes[..count];
    changes.sort_unstable_by(f64::total_cmp);
    (count >= FEWEST).then(|| middle(count, |place| changes[place]))
}

/// Marks the good temperatures that differ by more than `allowed_k` from the median of the other good temperatures.
fn mark_disagreeing(reports: &mut [SensorReport], allowed_k: f64) {
    let mut sorted = [0.0; MAX_SENSORS];
    let mut count = 0;
    let good = |report: &SensorReport| report.degc.filter(|_| report.flaw.is_none());
    for (place, degc) in sorted.iter_mut().zip(reports.iter().filter_map(good)) {
        *place = degc;
        count += 1;
    }
    let sorted = &mut sorted[..count];
    sorted.sort_unstable_by(f64::total_cmp);
    if count <= FEWEST {
        return;
    }
    for report in reports {
        let Some(degc) = good(report) else { continue };
        let own = sorted.partition_point(|other| *other < degc);
        let others = |place: usize| sorted[place + usize::from(place >= own)];
        if (degc - middle(count - 1, others)).abs() > allowed_k {
            report.flaw = Some(SensorFlaw::Disagrees);
        }
    }
}

/// Median of `count` sorted values; `count` must be at least 1.
fn middle(count: usize, sorted: impl Fn(usize) -> f64) -> f64 {
    0.5 * (sorted((count - 1) / 2) + sorted(count / 2))
}
