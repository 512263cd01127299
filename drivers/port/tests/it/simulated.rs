use std::{
    sync::atomic::Ordering,
    time::{Duration, Instant},
};

use volcomp_port::{Clock, Controller, Fault, Thermometer, contract};
use volcomp_vocabulary::PerChannel;

use crate::{machine, place};

fn soon() -> Instant {
    Instant::now() + Duration::from_secs(1)
}

#[test]
fn the_contract_of_controllers_and_thermometers() {
    let (mut controller, mut thermometer, _) = machine(Clock::system()).start();
    contract::controller(&mut controller);
    contract::thermometer(&mut thermometer);
}

/// Never faster than the feed, never harder than the acceleration, through every corner.
#[test]
fn moves_keep_their_limits() {
    let clock = Clock::manual();
    let (mut controller, _, _) = machine(clock.clone()).start();
    let step = Duration::from_millis(1);
    let mut places = Vec::new();
    // 1.7 + 2.2 + 0.1 + 2.7 s and round again.
    for _ in 0..14_000 {
        places.push(controller.read(soon()).unwrap().positions);
        clock.advance(step);
    }
    let dt = step.as_secs_f64();
    let speed = |i: usize| {
        let away = |k: usize| (places[i + 1][k] - places[i][k]) / dt;
        [away(0), away(1)]
    };
    let mut fastest = 0.0_f64;
    for i in 0..places.len() - 2 {
        let ([x, y], [later_x, later_y]) = (speed(i), speed(i + 1));
        fastest = fastest.max(x.hypot(y));
        let pull = (later_x - x).hypot(later_y - y) / dt;
        assert!(pull < 1001.0, "{pull} mm/s2 at {i}");
    }
    assert!((199.0..200.001).contains(&fastest), "{fastest}");
    assert!((places[1700][0] - 300.0).abs() < 1e-9);
    assert!((places[3900][1] - 400.0).abs() < 1e-9 && places[3950][1] == places[3999][1]);
    assert!(
        places[6700].iter().all(|x| x.abs() < 1e-9),
        "{:?}",
        places[6700]
    );
}

#[test]
fn the_hidden_error_goes_with_position_and_heat() {
    let clock = Clock::manual();
    let (mut controller, mut thermometer, _) = machine(clock.clone()).start();
    clock.advance(Duration::from_secs_f64(1.7));
    let [residual, error] = controller.residual_and_error();
    let degc = thermometer.latest()[0].degc.unwrap();
    assert!((degc - (20.0 + 5.0 * (1.0 - (-0.017_f64).exp()))).abs() < 1e-12);
    let expected = 2e-5 * 300.0 + 0.001 * (degc - 20.0);
    assert!((error[0] - expected).abs() < 1e-12 && residual == error);
    controller.apply(&place(-expected, 0.0), soon()).unwrap();
    let [residual, _] = controller.residual_and_error();
    // Rounded to a micrometre.
    assert!(residual[0].abs() < 0.000_51, "{residual:?}");
}

#[test]
fn reported_positions_contain_the_correction_where_they_say_so() {
    let (mut controller, _, controls) = machine(Clock::manual()).start();
    controller.apply(&place(0.005, 0.007), soon()).unwrap();
    let snapshot = controller.read(soon()).unwrap();
    assert_eq!(snapshot.positions[..2], [0.0, 0.007]);
    assert_eq!(snapshot.applied.unwrap()[..2], [0.005, 0.007]);
    controls.clear_applied.store(true, Ordering::Relaxed);
    assert_eq!(
        controller.read(soon()).unwrap().applied,
        Some(PerChannel::ZERO)
    );
    assert_eq!(controls.heartbeat.load(Ordering::Relaxed), 1);
}

#[test]
fn what_a_test_does_is_seen() {
    let clock = Clock::manual();
    let (mut controller, _, controls) = machine(clock.clone()).start();
    controls.alarm.store(true, Ordering::Relaxed);
    controls.emergency_stop.store(true, Ordering::Relaxed);
    controls.unreferenced.store(true, Ordering::Relaxed);
    let state = controller.read(soon()).unwrap().state;
    assert!(state.alarm && state.emergency_stop && !state.referenced);
    controls.frozen.store(true, Ordering::Relaxed);
    clock.advance(Duration::from_millis(500));
    let first = controller.read(soon()).unwrap().positions;
    clock.advance(Duration::from_millis(500));
    assert_eq!(controller.read(soon()).unwrap().positions, first);
    controls.frozen.store(false, Ordering::Relaxed);
    assert_ne!(controller.read(soon()).unwrap().positions, first);
    controls.disconnected.store(true, Ordering::Relaxed);
    assert_eq!(controller.read(soon()), Err(Fault::NotConnected));
    assert_eq!(
        controller.apply(&PerChannel::ZERO, soon()),
        Err(Fault::NotConnected)
    );
}
