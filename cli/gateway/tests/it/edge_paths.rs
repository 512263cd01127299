//! Two paths to one machine, and the state stored by the previous run. An axis must not step when a path stops
//! responding, reports less than the other, or was changed in between. The test checks the axis itself, with and
//! without a barrier.

use std::{
    sync::{Arc, Mutex},
    time::Duration,
};

use volcomp_gateway::simulate::{self, Simulation, protection};
use volcomp_guard::{Reasons, Request};
use volcomp_port::{
    Clock, Fault,
    inject::{Faults, Faulty, Injection},
};
use volcomp_runtime::{BarrierSettings, Model, PathSettings};
use volcomp_vocabulary::PerAxis;

use crate::bench::{Bench, Seen, Watched, cycle, path, unproven};

const SECOND: Duration = Duration::from_secs(1);
/// Maximum change per cycle, mm: the guard's slew, or the barrier's rate per scan, with rounding.
const MOST: f64 = 0.002 + 1e-9;

/// Two paths to one machine. If `blind` is set, the second path never reports an interlock.
fn two_ways(barrier: bool, blind: bool) -> Bench {
    let clock = Clock::manual();
    let guard = simulate::guard();
    let simulation = if barrier {
        Simulation::with_barrier(clock.clone())
    } else {
        Simulation::new(clock.clone())
    };
    let simulation = simulation.expect("built in");
    let protection = protection();
    let settings = PathSettings {
        barrier: barrier
            .then_some(BarrierSettings { machine: protection.machine, scan: protection.scan }),
        ..unproven()
    };
    let model = Model::new(&simulation.model, guard.fading).expect("built in");
    let another = simulation.controller.another().expect("few ways");
    let mut another = Faulty::new(another, Faults::default(), 1);
    if blind {
        another.inject(Injection::DroppedFlag { readings: u32::MAX });
    }
    let seen = Arc::new(Mutex::new(Seen::default()));
    let first = Watched::new(simulation.controller, &seen);
    let paths =
        vec![path(first, &model, &guard, &settings), path(another, &model, &guard, &settings)];
    let thermometer = Box::new(simulation.thermometer);
    let mut bench = Bench {
        cycle: cycle(model, paths, &guard, thermometer, &clock),
        clock,
        controls: simulation.controls,
        truth: simulation.truth,
        seen,
        forbids: Reasons::NONE,
    };
    // A barrier needs a second for counting its scans; plain values need three readings.
    bench.run(2 * SECOND);
    bench
}

fn armed(mut bench: Bench) -> Bench {
    bench.request(Request::Arm);
    let report = bench.run(2 * SECOND);
    assert_eq!(report.state.name(), "compensating", "{:?}", report.reasons);
    bench
}

fn largest_change(bench: &Bench) -> f64 {
    let changes = bench.controls.axes.largest_change();
    changes.iter().copied().fold(0.0, f64::max)
}

fn silence_first(bench: &Bench, fault: Option<Fault>) {
    bench.seen.lock().expect("no panic").fault = fault;
}

/// The stored correction is 40 µm, but the control reports 0. The gateway shows 0 as applied, and its first write makes
/// no step.
#[test]
fn the_reported_correction_replaces_the_remembered_one() {
    for barrier in [false, true] {
        let mut bench = two_ways(barrier, false);
        let remembered = PerAxis::from_fn(|axis| if axis == 1 { -0.040 } else { 0.0 });
        bench.cycle.restore(&remembered, Duration::ZERO);
        let report = bench.run(SECOND);
        assert_eq!(report.correction[1].abs(), 0.0, "barrier: {barrier}");
        let bench = armed(bench);
        assert!(largest_change(&bench) <= MOST, "{}", largest_change(&bench));
    }
}

/// The first path reports an emergency stop and then stops responding. The second path cannot read the stop, so it must
/// not take over. No axis moves.
#[test]
fn an_emergency_stop_causes_no_change_of_path() {
    use std::sync::atomic::Ordering;
    for barrier in [false, true] {
        let mut bench = armed(two_ways(barrier, true));
        bench.controls.emergency_stop.store(true, Ordering::Relaxed);
        bench.run(SECOND);
        silence_first(&bench, Some(Fault::NotConnected));
        let report = bench.run(3 * SECOND);
        assert!(
            report.reasons.contains(Reasons::EMERGENCY_STOP | Reasons::INTERLOCK_UNSEEN),
            "{:?}",
            report.reasons
        );
        silence_first(&bench, None);
        bench.run(6 * SECOND);
        assert_eq!(bench.controls.axes.changes_while_held(), 0, "barrier {barrier}");
        bench.controls.emergency_stop.store(false, Ordering::Relaxed);
        let report = bench.run(4 * SECOND);
        assert_eq!(report.state.name(), "compensating", "{:?}", report.reasons);
        assert!(largest_change(&bench) <= MOST, "{}", largest_change(&bench));
    }
}
