//! Single faults injected into the cycle, and their effect on the correction.

use std::{sync::atomic::Ordering, time::Duration};

use volcomp_gateway::simulate;
use volcomp_guard::{Reasons, Request, SensorFlaw};
use volcomp_port::{
    Fault, Reason, Temperature, Thermometer,
    inject::{Faults, Faulty},
};

use crate::bench::{Bench, PERIOD, Watched, path, unproven};

const SECOND: Duration = Duration::from_secs(1);
/// Maximum change in one cycle, mm: a slew rate of 500 µm/s for 4 ms, plus one output step.
const ONE_CYCLE_MM: f64 = 0.003 + 1e-9;

#[test]
fn a_silent_controller_is_held_then_ramped_in_from_what_it_has() {
    let mut bench = Bench::compensating();
    for fault in
        [Fault::TimedOut, Fault::NotConnected, Fault::Disconnected, Fault::Protocol("garbage")]
    {
        bench.seen.lock().unwrap().fault = Some(fault);
        let report = bench.run(SECOND / 10);
        assert_eq!(report.state.name(), "holding");
        assert!(report.reasons.contains(Reasons::NO_CONTROLLER | Reasons::POSITIONS_STALE));
        let writes = bench.seen.lock().unwrap().writes;
        assert!(bench.run(SECOND).reasons.contains(Reasons::POSITIONS_LOST));
        assert_eq!(bench.seen.lock().unwrap().writes, writes, "nothing is written blindly");
        bench.seen.lock().unwrap().fault = None;
        assert!(bench.largest_step(2 * SECOND) <= ONE_CYCLE_MM);
        assert_eq!(bench.run(PERIOD).state.name(), "compensating");
    }
}

#[test]
fn a_rebooted_controller_with_its_shift_cleared_is_ramped_in_from_zero() {
    let mut bench = Bench::compensating();
    bench.seen.lock().unwrap().fault = Some(Fault::NotConnected);
    bench.run(3 * SECOND);
    bench.controls.clear_applied.store(true, Ordering::Relaxed);
    bench.seen.lock().unwrap().fault = None;
    // Three readings confirm the applied value.
    let report = bench.run(3 * PERIOD);
    assert_eq!(report.state.name(), "arming");
    assert!(bench.applied().iter().all(|x| x.abs() <= ONE_CYCLE_MM), "{:?}", bench.applied());
    assert!(bench.largest_step(2 * SECOND) <= ONE_CYCLE_MM);
    assert_eq!(bench.run(PERIOD).state.name(), "compensating");
}

#[test]
fn a_frozen_position_keeps_its_correction() {
    let mut bench = Bench::compensating();
    bench.run(2 * SECOND);
    bench.controls.frozen.store(true, Ordering::Relaxed);
    bench.run(2 * SECOND);
    let held = bench.applied();
    bench.run(3 * SECOND);
    // The machine continues to warm up, so one step is allowed.
    let now = bench.applied();
    let moved = now.iter().zip(&held).map(|(a, b)| (a - b).abs());
    assert!(moved.fold(0.0, f64::max) <= 0.001 + 1e-9, "{now:?} {held:?}");
    bench.controls.frozen.store(false, Ordering::Relaxed);
    assert!(bench.largest_step(2 * SECOND) <= ONE_CYCLE_MM, "no jump when it goes on");
}

#[test]
fn a_write_that_does_not_stick_is_a_fault_until_acknowledged() {
    let mut bench = Bench::compensating();
    bench.seen.lock().unwrap().deaf = true;
    let report = bench.run(10 * SECOND);
    assert_eq!(report.state.name(), "faulted");
    assert!(report.reasons.contains(Reasons::DOES_NOT_STICK));
    assert_eq!(
        bench.request(Request::Acknowledge).state.name(),
        "faulted",
        "the cause is still there"
    );
    bench.seen.lock().unwrap().deaf = false;
    bench.run(2 * SECOND);
    assert_eq!(bench.request(Request::Acknowledge).state.name(), "disarmed");
}

#[test]
fn a_second_gateway_keeps_this_one_from_arming() {
    let mut bench = Bench::new();
    bench.run(SECOND);
    bench.seen.lock().unwrap().fault = Some(Fault::OtherGateway);
    bench.step(PERIOD, None);
    bench.seen.lock().unwrap().fault = None;
    bench.run(SECOND / 10);
    let report = bench.request(Request::Arm);
    assert_eq!(report.state.name(), "disarmed");
    assert!(report.reasons.contains(Reasons::OTHER_GATEWAY));
    bench.run(6 * SECOND);
    assert_eq!(bench.request(Request::Arm).state.name(), "arming", "it is gone");
}

#[test]
fn a_starved_processor_makes_no_step() {
    let mut bench = Bench::compensating();
    for gap_ms in [7, 40, 300, 2000, 60_000] {
        let before = bench.applied();
        bench.step(Duration::from_millis(gap_ms), None);
        let after = bench.applied();
        // A slew rate of 0.5 mm/s in five cycles of 4 ms, plus one output step.
        let allowed = 0.5 * 0.020 + 0.001 + 1e-9;
        assert!(before.iter().zip(&after).all(|(a, b)| (a - b).abs() <= allowed), "{gap_ms} ms");
        assert!(bench.largest_step(2 * SECOND) <= ONE_CYCLE_MM);
        assert_eq!(bench.run(PERIOD).state.name(), "compensating");
    }
}

/// For ten minutes, random faults: lost responses, invalid numbers, frozen positions, broken connections. Every change
/// and value stays within its limit, and the correction resumes after each fault.
#[test]
fn random_faults_of_the_wire_never_make_a_step() {
    for seed in 0..4 {
        let guard = simulate::guard();
        let wire = Faults {
            drop: 0.01,
            corrupt: 0.005,
            freeze: 0.0001,
            disconnect: 0.0003,
            calls: 200,
            ..Faults::default()
        };
        let mut bench = Bench::through(&guard, |parts| {
            let faulty = Faulty::new(parts.controller, wire, seed);
            let controller = Watched::new(faulty, parts.seen);
            vec![path(controller, parts.model, &guard, &unproven())]
        });
        let mut compensated = 0;
        let mut before = bench.applied();
        for number in 0..150_000 {
            // Arm or acknowledge occasionally, in any state.
            let request = match number % 1000 {
                0 => Some(Request::Arm),
                500 => Some(Request::Acknowledge),
                _ => None,
            };
            let report = bench.step(PERIOD, request);
            compensated += u32::from(report.state.name() == "compensating");
            let now = bench.applied();
            for (a, b) in now.iter().zip(&before) {
                assert!(
                    (a - b).abs() <= ONE_CYCLE_MM && a.abs() <= 0.250 + 1e-9,
                    "{b} to {a} at {number}, seed {seed}"
                );
            }
            before = now;
        }
        assert!(compensated > 10_000, "{compensated}");
    }
}

type Spoil = fn(&Temperature) -> Temperature;

/// Temperature readings of one sensor or of all sensors that become faulty after one minute.
struct Spoiled {
    inner: Box<dyn Thermometer>,
    sensor: Option<usize>,
    spoil: Spoil,
    start: std::time::Instant,
    latest: Vec<Temperature>,
}

impl Thermometer for Spoiled {
    fn device(&self) -> &str {
        self.inner.device()
    }

    fn names(&self) -> &[String] {
        self.inner.names()
    }

    fn latest(&mut self) -> &[Temperature] {
        self.latest.clear();
        self.latest.extend_from_slice(self.inner.latest());
        for (index, temperature) in self.latest.iter_mut().enumerate() {
            let age = temperature.taken.map(|taken| taken.saturating_duration_since(self.start));
            if age > Some(60 * SECOND) && self.sensor.is_none_or(|sensor| sensor == index) {
                *temperature = (self.spoil)(temperature);
            }
        }
        &self.latest
    }
}

fn spoiled(sensor: Option<usize>, spoil: Spoil) -> Bench {
    let mut bench = Bench::with(&simulate::guard(), |inner| {
        let latest = Vec::with_capacity(inner.names().len());
        let start = std::time::Instant::now();
        Box::new(Spoiled { inner, sensor, spoil, start, latest })
    });
    bench.run(SECOND / 2);
    bench.request(Request::Arm);
    assert!(!bench.run(50 * SECOND).reasons.contains(Reasons::DEGRADED));
    bench
}

fn bad(t: &Temperature, reason: Reason) -> Temperature {
    Temperature::bad(reason, t.taken.expect("it was read"))
}

fn with(t: &Temperature, degc: f64) -> Temperature {
    Temperature { degc: Some(degc), ..*t }
}

/// The correction changes by at most one slew step per cycle. The state stays `compensating` with the reason
/// `degraded`, and the other sensors still count.
#[test]
fn bad_temperatures_are_excluded_and_reported() {
    let spindle = Some(2);
    let broken: [(&str, Option<usize>, Spoil); 6] = [
        ("NaN", spindle, |t| with(t, f64::NAN)),
        ("break", spindle, |t| bad(t, Reason::Open)),
        ("short", spindle, |t| bad(t, Reason::Short)),
        ("jump", spindle, |t| with(t, 60.0)),
        ("850 degC", spindle, |t| with(t, 850.0)),
        ("all lost", None, |t| bad(t, Reason::NoAnswer)),
    ];
    for (name, sensor, spoil) in broken {
        let mut bench = spoiled(sensor, spoil);
        assert!(bench.largest_step(20 * SECOND) <= ONE_CYCLE_MM, "{name}");
        let report = bench.run(PERIOD);
        assert_eq!(report.state.name(), "compensating", "{name}");
        assert!(report.reasons.contains(Reasons::DEGRADED), "{name}");
        assert!(report.sensors[2].degc.is_none() && report.sensors[2].flaw.is_some(), "{name}");
        assert_eq!(report.sensors[0].degc.is_none(), sensor.is_none(), "{name}");
        // The last values are held for five minutes and fade within ten more.
        assert!(bench.largest_step(900 * SECOND) <= ONE_CYCLE_MM, "{name}");
    }
}

/// A sensor whose temperature jumped stays excluded until an operator acknowledges the jump. Then its correction ramps
/// in.
#[test]
fn an_acknowledged_jump_is_accepted() {
    let mut bench = spoiled(Some(2), |t| with(t, 60.0));
    bench.run(20 * SECOND);
    let report = bench.run(PERIOD);
    assert_eq!(report.sensors[2].flaw, Some(SensorFlaw::Jumped));
    assert!(report.reasons.contains(Reasons::DEGRADED));
    bench.request(Request::Acknowledge);
    assert!(bench.largest_step(60 * SECOND) <= ONE_CYCLE_MM);
    let report = bench.run(PERIOD);
    assert_eq!(report.sensors[2].degc, Some(60.0));
    assert!(!report.reasons.contains(Reasons::DEGRADED));
    assert_eq!(report.state.name(), "compensating");
}
