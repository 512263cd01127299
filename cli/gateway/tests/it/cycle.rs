//! The cycle of a gateway: arming, following and fallback, and the effect of single faults on the correction.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, atomic::Ordering},
    time::Duration,
};

use volcomp_gateway::simulate::{self, Simulation};
use volcomp_guard::{Reasons, Request, SensorFlaw};
use volcomp_port::{
    Clock, Controller, Fault, Reason, Temperature, Thermometer,
    inject::{Faults, Faulty},
};
use volcomp_runtime::{BarrierSettings, Cycle, Model, PathSettings, PlanError, Sensors};
use volcomp_vocabulary::{AxisName, Displacement, Mm, PerAxis, PerChannel};

use crate::bench::{Bench, PERIOD, Seen, Watched, cycle, path, unproven};

const SECOND: Duration = Duration::from_secs(1);

#[test]
fn temperatures_reach_the_correction() {
    let mut bench = Bench::compensating();
    let report = bench.run(PERIOD);
    let (place, cold) = (report.positions, report.wanted);
    // The machine is warm after an hour. Run the program once more to the same position.
    let mut report = bench.run(3600 * SECOND);
    for _ in 0..200_000 {
        if report.positions == place {
            break;
        }
        report = bench.run(PERIOD);
    }
    assert_eq!(report.positions, place, "it stands where it stood");
    assert!(report.sensors[2].degc.is_some_and(|degc| degc > 28.0));
    assert!((report.wanted[2] - cold[2]).abs() > 0.01, "{cold:?} {report:?}");
}

/// A machine with two controllers.
struct Two {
    bench: Bench,
    second: Arc<Mutex<Seen>>,
}

/// Compensates over the first controller. The second controller holds the correction `left`, mm.
fn two(left: &PerChannel<f64>) -> Two {
    let clock = Clock::manual();
    let guard = simulate::guard();
    let [first, mut second] = [(); 2].map(|()| Simulation::new(clock.clone()).expect("built in"));
    let soon = clock.now() + SECOND;
    second.controller.apply(left, soon).expect("no barrier");
    let model = Model::new(&first.model, guard.fading).expect("built in");
    let mut seen = Vec::new();
    let mut paths = Vec::new();
    for (index, controller) in [first.controller, second.controller].into_iter().enumerate() {
        seen.push(Arc::new(Mutex::new(Seen::default())));
        let controller = Watched::new(controller, &seen[index]);
        paths.push(path(controller, &model, &guard, &unproven()));
    }
    let bench = Bench {
        cycle: cycle(model, paths, &guard, Box::new(first.thermometer), &clock),
        clock,
        controls: first.controls,
        truth: first.truth,
        seen: seen.remove(0),
        forbids: Reasons::NONE,
    };
    let mut two = Two { bench, second: seen.remove(0) };
    // Three consistent readings confirm the applied correction.
    two.bench.run(SECOND / 2);
    two.bench.request(Request::Arm);
    assert_eq!(two.bench.run(SECOND).state.name(), "compensating");
    two
}

#[test]
fn the_fallback_takes_over_and_hands_back() {
    let Two { mut bench, second } = two(&PerChannel::ZERO);
    bench.seen.lock().unwrap().fault = Some(Fault::TimedOut);
    let report = bench.run(2 * SECOND);
    assert_eq!((report.state.name(), report.active), ("compensating", 1));
    assert!(report.reasons.contains(Reasons::FALLBACK));
    assert!((second.lock().unwrap().applied[0] - report.wanted[0]).abs() < 0.002);
    bench.seen.lock().unwrap().fault = None;
    assert_eq!(bench.run(SECOND).active, 1, "not yet");
    let report = bench.run(5 * SECOND);
    assert_eq!((report.state.name(), report.active), ("compensating", 0));
    let left = second.lock().unwrap().applied;
    bench.run(SECOND);
    assert_eq!(second.lock().unwrap().applied, left, "only one path writes");
}

#[test]
fn a_correction_left_on_a_standby_path_is_reported() {
    let mut bench = two(&PerChannel::leading([0.0, 0.077])).bench;
    let reasons = bench.run(2 * SECOND).reasons;
    assert!(reasons.contains(Reasons::STANDBY_HOLDS), "{reasons:?}");
}

/// Two paths to channels whose corrections would add up are rejected, because only one path writes at a time.
#[test]
fn channels_that_would_add_are_refused() {
    let guard = simulate::guard();
    let made = [(); 2].map(|()| Simulation::new(Clock::manual()).expect("built in"));
    let model = Model::new(&made[0].model, guard.fading).expect("built in");
    let seen = Arc::new(Mutex::new(Seen::default()));
    let paths = made.map(|made| made.controller).into_iter().enumerate();
    let paths = paths.map(|(index, controller)| {
        let controller = Watched::new(controller, &seen).on(&format!("channel {index}"));
        path(controller, &model, &guard, &unproven())
    });
    let paths = paths.collect();
    let sensors = Sensors::new(Vec::new(), guard.temperatures);
    let refused = Cycle::new(Box::new(model), paths, guard.hand_back, sensors, PERIOD);
    assert!(matches!(refused.err(), Some(PlanError::Channels { .. })));
}

/// The second path writes one axis over digital lines, as in the published scheme. It takes over only if the positions
/// of the other axes are known: fixed, or from another controller. It then corrects its axis within 2 µm.
#[test]
fn a_path_with_fewer_axes_stands_in_only_where_the_others_are_known() {
    for (fixed, stands_in) in [(Some(1000.0), true), (None, false)] {
        let guard = simulate::guard();
        let second = Arc::new(Mutex::new(Seen::default()));
        let others = fixed.map_or(BTreeMap::new(), |at| {
            let named = [(AxisName::Y, at), (AxisName::Z, 500.0)];
            named.map(|(name, at)| (name, Displacement::Length(Mm(at)))).into()
        });
        let settings = PathSettings { fixed: others, ..unproven() };
        // Only a barrier removes the correction of the other axes when the first path stops responding.
        let protection = simulate::protection();
        let barrier = PathSettings {
            barrier: Some(BarrierSettings { machine: protection.machine, scan: protection.scan }),
            ..unproven()
        };
        let mut bench = Bench::through(&guard, |parts| {
            let guarded = Simulation::with_barrier(parts.clock.clone()).expect("built in");
            let lines = volcomp_port::simulated::Machine {
                axes: parts.controller.description().axes[..1].to_vec(),
                program: Vec::new(),
                acceleration_per_s2: 1.0,
                sensors: Vec::new(),
                truth: Arc::new(|_, _| PerChannel::ZERO),
                clock: parts.clock.clone(),
            };
            let (lines, _, _) = lines.start();
            let first = Watched::new(guarded.controller, parts.seen);
            vec![
                path(first, parts.model, &guard, &barrier),
                path(Watched::new(lines, &second), parts.model, &guard, &settings),
            ]
        });
        bench.run(2 * SECOND);
        bench.request(Request::Arm);
        bench.run(SECOND);
        bench.seen.lock().unwrap().fault = Some(Fault::Disconnected);
        let report = bench.run(4 * SECOND);
        assert_eq!(report.active, usize::from(stands_in), "{report:?}");
        let applied = second.lock().unwrap().applied;
        if stands_in {
            assert_eq!(report.state.name(), "compensating");
            assert!(
                (applied[0] - report.wanted[0]).abs() < 0.002 && report.wanted[0].abs() > 0.002
            );
        } else {
            assert_eq!(applied, PerChannel::ZERO);
        }
    }
}

/// The same machine file is reloaded while the machine warms up. The thermal lags continue, and the correction of Z
/// changes by less than 1.5 µm.
#[test]
fn a_reload_keeps_the_lags() {
    let mut bench = Bench::compensating();
    let before = bench.run(Duration::from_secs(240)).wanted;
    let fading = simulate::guard().fading;
    let simulation = simulate::Simulation::new(volcomp_port::Clock::manual()).expect("built in");
    let names = volcomp_port::Thermometer::names(&simulation.thermometer).to_vec();
    let model = volcomp_runtime::Model::new(&simulation.model, fading).expect("built in");
    let mut replacement = volcomp_runtime::Replacement::new(Box::new(model), &names);
    let taken = assert_no_alloc::assert_no_alloc(|| bench.cycle.swap_model(&mut replacement));
    assert_eq!(taken, Ok(()));
    let after = bench.step(PERIOD, None).wanted;
    for (before, after) in before.iter().zip(&after) {
        // The limit includes the effect of the motion of 4 mm in between.
        assert!((after - before).abs() < 0.0015, "{before} to {after} mm");
    }
}

/// RMS of the true error over the volume while the machine moves and warms up. The correction removes more than 95 % of
/// it. The residual includes one cycle of delay, because the machine moves before each exchange.
#[test]
fn the_error_goes_over_the_whole_volume_moving_and_warming_up() {
    let mut bench = Bench::compensating();
    // Run well into the warm-up, then through the whole program.
    bench.run(Duration::from_secs(5));
    let (mut before, mut after) = (Vec::new(), Vec::new());
    let mut above_floor = 0.0_f64;
    let (mut squares_before, mut squares_after) = (0.0, 0.0);
    for cycle in 0..(600_000 / 4) {
        // The first three channels and the first three axes of the chain are X, Y, Z.
        let applied = PerAxis(bench.applied().0);
        let report = bench.step(PERIOD, None);
        assert_eq!(report.state.name(), "compensating");
        if cycle % 50 != 0 {
            continue;
        }
        let degc: Vec<f64> = report.sensors.iter().map_while(|sensor| sensor.degc).collect();
        let positions = report.positions;
        // The correction applied when the machine arrived at this position.
        let b = bench.truth.error(&positions, &degc).norm() * 1e3;
        let a = bench.truth.residual(&positions, &applied, &degc).norm() * 1e3;
        // The lower bound of the residual: the same model at this position, rounded to output steps of 1 µm.
        let rounded = report.wanted.map(|mm| (mm * 1e3).round() * 1e-3);
        let floor = bench.truth.residual(&positions, &rounded, &degc).norm() * 1e3;
        above_floor = above_floor.max(a - floor);
        (squares_before, squares_after) = (squares_before + b * b, squares_after + a * a);
        before.push(b);
        after.push(a);
    }
    let count = before.len() as f64;
    let rms = [(squares_before / count).sqrt(), (squares_after / count).sqrt()];
    let largest = |v: &[f64]| v.iter().copied().fold(0.0, f64::max);
    println!(
        "before: rms {:.1} um, largest {:.1}; after: rms {:.2}, largest {:.2}; {:.1} %; at most {above_floor:.2} um above the floor",
        rms[0],
        largest(&before),
        rms[1],
        largest(&after),
        100.0 * (rms[1] / rms[0] - 1.0)
    );
    assert!(rms[1] < 0.05 * rms[0], "{rms:?}");
    assert!(above_floor < 2.0, "{above_floor}");
}

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
