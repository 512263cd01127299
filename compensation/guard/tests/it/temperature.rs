use std::time::Duration;

use proptest::prelude::*;
use volcomp_guard::{
    SensorCheck, SensorFlaw, SensorLimits, SensorReading, SensorReport, judge_temperatures,
};

use SensorFlaw::{Broken, Jumped, OutOfRange, Stale};

/// The sensors of a machine, read every `pause` seconds.
struct Machine {
    limits: SensorLimits,
    checks: Vec<SensorCheck>,
    now: f64,
    pause: f64,
}

impl Machine {
    fn new(sensors: usize, limits: SensorLimits) -> Self {
        Self { limits, checks: vec![SensorCheck::default(); sensors], now: 0.0, pause: 1.0 }
    }

    /// Checks a round of readings measured now.
    fn hears(&mut self, readings: &[SensorReading]) -> Vec<SensorReport> {
        self.now += self.pause;
        let now = Duration::from_secs_f64(self.now);
        let mut reported = vec![SensorReport::default(); readings.len()];
        judge_temperatures(&mut self.checks, readings, now, &self.limits, &mut reported);
        reported
    }

    fn reads(&mut self, degc: &[f64]) -> Vec<Option<SensorFlaw>> {
        let taken = Duration::from_secs_f64(self.now + self.pause);
        let readings: Vec<SensorReading> =
            degc.iter().map(|degc| SensorReading::Temperature { degc: *degc, taken }).collect();
        let reported = self.hears(&readings);
        for (reported, degc) in reported.iter().zip(degc) {
            let used = reported.flaw.is_none_or(SensorFlaw::is_used);
            assert_eq!(reported.degc, used.then_some(*degc));
        }
        reported.iter().map(|reported| reported.flaw).collect()
    }

    /// Reads the same temperatures for this time; returns when the first sensor was accepted, s.
    fn used_after(&mut self, degc: &[f64], seconds: f64) -> Option<f64> {
        let start = self.now;
        while self.now - start < seconds {
            if self.reads(degc)[0].is_none_or(SensorFlaw::is_used) {
                return Some(self.now - start);
            }
        }
        None
    }

    fn acknowledge(&mut self) {
        self.checks.iter_mut().for_each(SensorCheck::acknowledge);
    }
}

const DAY: f64 = 86_400.0;

#[test]
fn every_flaw() {
    let limits = SensorLimits::default();
    let check = |checks: &mut [SensorCheck], now: u64, degc: f64, taken: u64| {
        let readings = SensorReading::Temperature { degc, taken: Duration::from_secs(taken) };
        let mut reported = [SensorReport::default()];
        judge_temperatures(checks, &[readings], Duration::from_secs(now), &limits, &mut reported);
        (reported[0].degc, reported[0].flaw)
    };
    let mut one = [SensorCheck::default()];
    assert_eq!(check(&mut one, 1, 21.0, 1), (Some(21.0), None));
    let out = |flaw| (None, Some(flaw));
    assert_eq!(check(&mut one, 3, f64::NAN, 3), out(SensorFlaw::OutOfRange));
    assert_eq!(check(&mut one, 4, 850.0, 4), out(SensorFlaw::OutOfRange));
    assert_eq!(check(&mut one, 40, 21.0, 5), out(SensorFlaw::Stale));
    // The permitted change is 2.5 K, for 30 s, the maximum time credited after a fault.
    assert_eq!(check(&mut one, 65, 23.9, 65), (Some(23.9), None));
    assert_eq!(check(&mut one, 66, 23.9, 65), (Some(23.9), None));
    assert_eq!(check(&mut one, 67, 25.0, 67), out(SensorFlaw::Jumped));
    for readings in [SensorReading::Silence, SensorReading::Fault] {
        let mut reported = [SensorReport::default()];
        let mut new = [SensorCheck::default()];
        judge_temperatures(&mut new, &[readings], Duration::ZERO, &limits, &mut reported);
        assert_eq!((reported[0].degc, reported[0].flaw), out(SensorFlaw::Broken));
    }
}

#[test]
fn a_jump_of_forty_kelvin_is_never_accepted() {
    let mut alone = Machine::new(1, SensorLimits::default());
    assert_eq!(alone.reads(&[20.0]), [None]);
    assert_eq!(alone.used_after(&[60.0], DAY), None);
    let mut among = Machine::new(4, SensorLimits::default());
    assert_eq!(among.reads(&[20.0, 21.0, 25.0, 22.0]), [None; 4]);
    assert_eq!(among.used_after(&[60.0, 21.0, 25.0, 22.0], 5.0 * 3600.0), None);
    assert_eq!(among.reads(&[60.0, 21.0, 25.0, 22.0])[1..], [None; 3]);
}

/// A jump after a fault, a break or a pause is still a jump: the sensor is rejected for the whole day of the test.
#[test]
fn a_jump_after_a_gap_is_a_jump() {
    for gap in [SensorReading::Fault, SensorReading::Silence] {
        let mut machine = Machine::new(1, SensorLimits::default());
        assert_eq!(machine.reads(&[20.0]), [None]);
        for _ in 0..3600 {
            assert_eq!(machine.hears(&[gap])[0].flaw, Some(SensorFlaw::Broken));
        }
        assert_eq!(machine.used_after(&[60.0], DAY), None, "{gap:?}");
    }
}

/// A repeated reading is checked once; another value at the same time is a new reading.
#[test]
fn another_value_at_the_same_time_is_judged_anew() {
    let mut machine = Machine::new(1, SensorLimits::default());
    let at_one = |degc: f64| SensorReading::Temperature { degc, taken: Duration::from_secs(1) };
    for (degc, flaw) in [(20.0, None), (20.0, None), (60.0, Some(Jumped)), (20.0, Some(Jumped))] {
        assert_eq!(machine.hears(&[at_one(degc)])[0].flaw, flaw, "{degc}");
    }
}

/// A jump is reported together with any later fault of the sensor, until the sensor is readmitted or acknowledged.
#[test]
fn a_jump_is_reported_beside_every_later_flaw() {
    let mut machine = Machine::new(1, SensorLimits::default());
    let at = |degc: f64, seconds: u64| SensorReading::Temperature {
        degc,
        taken: Duration::from_secs(seconds),
    };
    let mut found = |reading: SensorReading| {
        let reported = machine.hears(&[reading])[0];
        (reported.flaw, reported.jumped)
    };
    assert_eq!(found(at(20.0, 1)), (None, false));
    assert_eq!(found(SensorReading::Silence), (Some(Broken), false));
    assert_eq!(found(at(60.0, 3)), (Some(Jumped), true));
    for (reading, flaw) in [
        (SensorReading::Silence, Broken),
        (SensorReading::Fault, Broken),
        (at(f64::NAN, 6), OutOfRange),
        (at(-400.0, 7), OutOfRange),
    ] {
        assert_eq!(found(reading), (Some(flaw), true), "{reading:?}");
    }
    machine.now = 100.0;
    let reported = machine.hears(&[at(60.0, 8)])[0];
    assert_eq!((reported.flaw, reported.jumped), (Some(Stale), true));
    machine.acknowledge();
    let reported = machine.hears(&[at(60.0, 102)])[0];
    assert_eq!((reported.flaw, reported.jumped), (None, false));
}

#[test]
fn a_jump_that_was_a_disturbance_ends_after_ten_minutes() {
    let mut machine = Machine::new(1, SensorLimits::default());
    machine.reads(&[20.0]);
    assert_eq!(machine.reads(&[60.0]), [Some(SensorFlaw::Jumped)]);
    assert_eq!(machine.used_after(&[20.8], 3600.0), Some(601.0));
    // A deviating reading restarts the ten minutes.
    machine.reads(&[60.0]);
    assert_eq!(machine.used_after(&[20.8], 500.0), None);
    machine.reads(&[22.5]);
    assert_eq!(machine.used_after(&[20.8], 3600.0), Some(601.0));
    // A fault restarts the ten minutes too.
    machine.reads(&[60.0]);
    assert_eq!(machine.used_after(&[20.8], 500.0), None);
    machine.hears(&[SensorReading::Fault]);
    assert_eq!(machine.used_after(&[20.8], 3600.0), Some(601.0));
}

/// The machine cooled by 6 K while a sensor was out: the sensor is accepted 601 s after it agrees with the change of its neighbours.
#[test]
fn agreement_with_neighbours_readmits_a_sensor() {
    let mut machine = Machine::new(3, SensorLimits::default());
    assert_eq!(machine.reads(&[30.0, 22.0, 41.0]), [None; 3]);
    machine.reads(&[70.0, 22.0, 41.0]);
    for step in 0_u32..600 {
        let cooled = f64::from(step) * 0.01;
        let flaws = machine.reads(&[70.0, 22.0 - cooled, 41.0 - cooled]);
        assert_eq!(flaws, [Some(SensorFlaw::Jumped), None, None]);
    }
    assert_eq!(machine.used_after(&[24.5, 16.0, 35.0], 3600.0), Some(601.0));
    // Of two sensors, either may be right.
    let mut two = Machine::new(2, SensorLimits::default());
    two.reads(&[30.0, 22.0]);
    two.reads(&[70.0, 22.0]);
    for step in 0_u32..600 {
        two.reads(&[70.0, 22.0 - f64::from(step) * 0.01]);
    }
    assert_eq!(two.used_after(&[24.0, 16.0], DAY), None);
}

/// Three sensors at 40 °C. The first is broken for two hours, in which the machine cools to 25 °C.
fn cooled_while_the_first_was_broken() -> Machine {
    let mut machine = Machine::new(3, SensorLimits::default());
    for _ in 0..600 {
        machine.reads(&[40.0; 3]);
    }
    for second in 0..7200 {
        let degc = 40.0 - 15.0 * f64::from(second) / 7200.0;
        let taken = Duration::from_secs_f64(machine.now + machine.pause);
        let other = SensorReading::Temperature { degc, taken };
        machine.hears(&[SensorReading::Fault, other, other]);
    }
    machine
}

/// A repaired sensor is accepted 601 s after it agrees with its neighbours. Their usual differences are those at the
/// time of its last accepted reading.
#[test]
fn a_repaired_sensor_that_agrees_with_its_neighbours_is_readmitted() {
    let mut machine = cooled_while_the_first_was_broken();
    assert_eq!(machine.reads(&[25.0; 3])[0], Some(SensorFlaw::Jumped));
    assert_eq!(machine.used_after(&[25.0; 3], 4.0 * 3600.0), Some(601.0));
}

/// A sensor that returns with its temperature of two hours ago, although its neighbours have changed, is rejected: with
/// or without a jump at its return, and also if the neighbours become silent.
#[test]
fn an_old_temperature_does_not_outweigh_the_neighbours() {
    for first in [60.0, 40.0] {
        let mut machine = cooled_while_the_first_was_broken();
        machine.reads(&[first, 25.0, 25.0]);
        assert_eq!(machine.used_after(&[40.0, 25.0, 25.0], 3600.0), None);
        for _ in 0..3600 {
            let taken = Duration::from_secs_f64(machine.now + machine.pause);
            let wrong = SensorReading::Temperature { degc: 40.0, taken };
            let reported = machine.hears(&[wrong, SensorReading::Silence, SensorReading::Silence]);
            assert_eq!(reported[0].flaw, Some(SensorFlaw::Jumped));
        }
        machine.acknowledge();
        assert_eq!(machine.reads(&[40.0, 25.0, 25.0])[0], None);
    }
}

/// A sensor that does not follow its warming neighbours is readmitted after a short disturbance, once it has agreed
/// with its own last accepted temperature for ten minutes.
#[test]
fn a_short_disturbance_of_a_slow_sensor_ends() {
    let mut machine = Machine::new(3, SensorLimits::default());
    machine.reads(&[20.0, 22.0, 22.0]);
    machine.reads(&[60.0, 22.0, 22.0]);
    let back = (0_u32..3600).find(|second| {
        let others = 22.0 + f64::from(*second) * 0.005;
        machine.reads(&[20.0, others, others])[0].is_none()
    });
    assert_eq!(back, Some(600));
}

/// All sensors of a module that lost its reference jump together: they do not confirm one another, and stay out for a day.
#[test]
fn sensors_that_jump_together_stay_out() {
    let mut machine = Machine::new(4, SensorLimits::default());
    machine.reads(&[20.0, 21.0, 22.0, 23.0]);
    assert_eq!(machine.used_after(&[60.0, 61.0, 62.0, 63.0], DAY), None, "a common fault");
}

#[test]
fn an_acknowledged_jump_is_accepted() {
    let mut machine = Machine::new(2, SensorLimits::default());
    machine.reads(&[20.0, 20.0]);
    assert_eq!(machine.used_after(&[60.0, 20.0], 3600.0), None);
    machine.acknowledge();
    assert_eq!(machine.reads(&[60.0, 20.0]), [None; 2]);
    // The acknowledgement applies only to sensors that have jumped.
    machine.acknowledge();
    assert_eq!(machine.reads(&[60.0, 60.0])[1], Some(SensorFlaw::Jumped));
}

/// The thermometer was silent overnight without a fault: temperatures that are lower in the morning are accepted.
#[test]
fn a_cold_morning_is_accepted() {
    let mut machine = Machine::new(2, SensorLimits::default());
    machine.reads(&[31.0, 24.0]);
    for _ in 0..8 * 3600 {
        machine.hears(&[SensorReading::Silence; 2]);
    }
    assert_eq!(machine.reads(&[16.0, 15.0]), [None; 2]);
}

/// After minutes of silence a sensor that is 22 K off, such as a replaced or reconfigured sensor, is rejected.
#[test]
fn a_sensor_far_off_after_minutes_of_silence_is_rejected() {
    let mut machine = Machine::new(1, SensorLimits::default());
    machine.reads(&[22.0]);
    for _ in 0..300 {
        machine.hears(&[SensorReading::Silence]);
    }
    assert_eq!(machine.reads(&[44.0]), [Some(SensorFlaw::Jumped)]);
}

/// Small steps that add up to 24 K in a minute are a jump.
#[test]
fn creeping_is_jumping() {
    let mut machine = Machine::new(1, SensorLimits::default());
    let out = (0_u32..10).find(|step| machine.reads(&[20.0 + 0.4 * f64::from(*step)])[0].is_some());
    assert!(out.is_some(), "24 K in a minute");
}

#[test]
fn unchanged_digits_are_reported_as_stuck() {
    let limits =
        SensorLimits { stuck_after: Some(Duration::from_secs(60)), ..SensorLimits::default() };
    let mut machine = Machine::new(1, limits);
    for _ in 0..60 {
        assert_eq!(machine.reads(&[20.1]), [None]);
    }
    assert_eq!(machine.reads(&[20.1]), [Some(SensorFlaw::Stuck)]);
    assert_eq!(machine.reads(&[20.2]), [None]);
    let mut never = Machine::new(1, SensorLimits { stuck_after: None, ..limits });
    assert!((0..86_400).all(|_| never.reads(&[20.1]) == [None]));
}

#[test]
fn a_sensor_that_disagrees_is_reported() {
    let disagrees = |degc: &[f64]| {
        let limits = SensorLimits { neighbours_k: Some(3.0), ..SensorLimits::default() };
        let flaws = Machine::new(degc.len(), limits).reads(degc);
        let one = |flaw: &Option<SensorFlaw>| *flaw == Some(SensorFlaw::Disagrees);
        flaws.iter().map(one).collect::<Vec<_>>()
    };
    assert_eq!(disagrees(&[20.0, 21.0, 22.0, 22.9]), [false; 4]);
    assert_eq!(disagrees(&[20.0, 21.0, 27.0, 22.0]), [false, false, true, false]);
    assert_eq!(disagrees(&[20.0, 40.0]), [false; 2], "of two, either may be wrong");
    let many: Vec<f64> = (0..80).map(|k| if k == 5 { 30.0 } else { 20.0 }).collect();
    let limits = SensorLimits { neighbours_k: Some(3.0), ..SensorLimits::default() };
    let reported = Machine::new(80, limits).hears(
        &many
            .iter()
            .map(|degc| SensorReading::Temperature { degc: *degc, taken: Duration::ZERO })
            .collect::<Vec<_>>(),
    );
    assert_eq!(reported[5].flaw, Some(SensorFlaw::Disagrees));
    assert_eq!(reported[79], SensorReport::default(), "beyond the largest number");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn a_slow_warm_up_is_accepted(
        k_per_min in -4.0..4.0_f64,
        resolution in prop::sample::select(vec![0.001, 0.01, 0.1, 0.25]),
        pause in prop::sample::select(vec![0.05, 1.0, 7.0, 29.0]),
        noise in prop::collection::vec(-0.1..0.1_f64, 1..40),
        silent in 0_usize..400,
    ) {
        let mut machine = Machine::new(1, SensorLimits::default());
        machine.pause = pause;
        for round in 0..400 {
            if (silent..silent + 5).contains(&round) {
                machine.hears(&[SensorReading::Silence]);
                continue;
            }
            // The temperature changes within the machine's range and then stays constant.
            let true_degc = (50.0 + k_per_min * machine.now / 60.0).clamp(-15.0, 110.0);
            let read = ((true_degc + noise[round % noise.len()]) / resolution).round() * resolution;
            prop_assert_eq!(machine.reads(&[read]), vec![None], "round {} at {}", round, read);
        }
    }

    /// A sensor that jumped and is off by more than the tolerance is never accepted again, for any behaviour of the
    /// machine, with any gaps, alone or among other sensors.
    #[test]
    fn a_constantly_wrong_sensor_stays_out(
        wrong in prop_oneof![-25.0..-6.0_f64, 6.0..60.0_f64],
        drift in -4.0..4.0_f64,
        sensors in 1_usize..6,
        gaps in prop::collection::vec((1_usize..4000, prop::bool::ANY, 1_usize..200), 0..6),
        hides_in_a_gap: bool,
        pause in prop::sample::select(vec![1.0, 10.0]),
    ) {
        let mut machine = Machine::new(sensors, SensorLimits::default());
        machine.pause = pause;
        let usual: Vec<f64> = (0_u32..6).map(|k| 30.0 + 1.5 * f64::from(k)).collect();
        for _ in 0..30 {
            machine.reads(&usual[..sensors]);
        }
        if hides_in_a_gap {
            let mut readings = vec![SensorReading::Silence; sensors];
            readings[0] = SensorReading::Fault;
            machine.hears(&readings);
        }
        for round in 0_u32..4000 {
            // The machine drifts by up to 4 K and back.
            let now = drift * (f64::from(round) / 500.0).sin();
            let mut degc: Vec<f64> = usual[..sensors].iter().map(|usual| usual + now).collect();
            degc[0] += wrong;
            let place = round as usize;
            let gap = gaps.iter().find(|(from, _, long)| (*from..from + long).contains(&place));
            let flaw = match gap {
                Some((_, is_fault, _)) => {
                    let taken = Duration::from_secs_f64(machine.now + pause);
                    let mut readings: Vec<SensorReading> = degc.iter().map(|degc| SensorReading::Temperature { degc: *degc, taken }).collect();
                    readings[0] = if *is_fault { SensorReading::Fault } else { SensorReading::Silence };
                    machine.hears(&readings)[0].flaw
                }
                None => machine.reads(&degc)[0],
            };
            prop_assert!(!flaw.is_none_or(SensorFlaw::is_used), "round {}: {:?}", round, degc);
        }
    }
}
