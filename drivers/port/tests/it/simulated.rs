use std::{
    sync::atomic::Ordering,
    time::{Duration, Instant},
};

use volcomp_port::{Clock, ControlProgram, Controller, Fault, Thermometer, Words, contract};
use volcomp_vocabulary::PerChannel;

use crate::{machine, place};

fn soon() -> Instant {
    Instant::now() + Duration::from_secs(1)
}

#[test]
fn controller_and_thermometer_contracts() {
    let (mut controller, mut thermometer, _) = machine(Clock::system()).start();
    contract::controller(&mut controller);
    contract::thermometer(&mut thermometer);
}

#[test]
fn moves_respect_feed_and_acceleration() {
    let clock = Clock::manual();
    let (mut controller, _, _) = machine(clock.clone()).start();
    let step = Duration::from_millis(1);
    let mut places = Vec::new();
    // Two repetitions of the program of 1.7 + 2.2 + 0.1 + 2.7 s.
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
    assert!(places[6700].iter().all(|x| x.abs() < 1e-9), "{:?}", places[6700]);
}

#[test]
fn the_true_error_depends_on_position_and_temperature() {
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
    // The correction is rounded to 1 µm, so that at most half of it remains.
    assert!(residual[0].abs() < 0.000_51, "{residual:?}");
}

#[test]
fn reported_positions_include_the_correction_as_described() {
    let (mut controller, _, controls) = machine(Clock::manual()).start();
    controller.apply(&place(0.005, 0.007), soon()).unwrap();
    let snapshot = controller.read(soon()).unwrap();
    assert_eq!(snapshot.positions[..2], [0.0, 0.007]);
    assert_eq!(snapshot.applied.unwrap()[..2], [0.005, 0.007]);
    controls.clear_applied.store(true, Ordering::Relaxed);
    assert_eq!(controller.read(soon()).unwrap().applied, Some(PerChannel::ZERO));
    assert_eq!(controls.heartbeat.load(Ordering::Relaxed), 1);
}

#[test]
fn changes_by_a_test_take_effect() {
    let clock = Clock::manual();
    let (mut controller, _, controls) = machine(clock.clone()).start();
    controls.alarm.store(true, Ordering::Relaxed);
    controls.emergency_stop.store(true, Ordering::Relaxed);
    controls.unreferenced.store(true, Ordering::Relaxed);
    let state = controller.read(soon()).unwrap().state;
    assert!(state.alarm && state.emergency_stop && !state.referenced);
    for switch in [&controls.alarm, &controls.emergency_stop, &controls.unreferenced] {
        switch.store(false, Ordering::Relaxed);
    }
    controls.frozen.store(true, Ordering::Relaxed);
    clock.advance(Duration::from_millis(500));
    let first = controller.read(soon()).unwrap().positions;
    clock.advance(Duration::from_millis(500));
    assert_eq!(controller.read(soon()).unwrap().positions, first);
    controls.frozen.store(false, Ordering::Relaxed);
    assert_ne!(controller.read(soon()).unwrap().positions, first);
    controls.disconnected.store(true, Ordering::Relaxed);
    assert_eq!(controller.read(soon()), Err(Fault::NotConnected));
    assert_eq!(controller.apply(&PerChannel::ZERO, soon()), Err(Fault::NotConnected));
}

#[test]
fn it_stops_while_motion_is_forbidden_and_continues_from_there() {
    let clock = Clock::manual();
    let (mut controller, _, controls) = machine(clock.clone()).start();
    let half = Duration::from_millis(500);
    clock.advance(half);
    for switch in
        [&controls.emergency_stop, &controls.alarm, &controls.unreferenced, &controls.feed_hold]
    {
        let before = controller.read(soon()).unwrap().positions;
        switch.store(true, Ordering::Relaxed);
        for _ in 0..10 {
            clock.advance(half);
            assert_eq!(controller.read(soon()).unwrap().positions, before);
            assert_eq!(controller.commanded(), before);
        }
        switch.store(false, Ordering::Relaxed);
        clock.advance(Duration::from_millis(1));
        let after = controller.read(soon()).unwrap().positions;
        let way = (after[0] - before[0]).hypot(after[1] - before[1]);
        assert!(way > 0.0 && way <= 0.2001, "{way} mm in 1 ms at 200 mm/s");
    }
}

/// A control program that moves the correction by one count per scan towards the first value of the last frame, and
/// stops while axes are held.
#[derive(Default)]
struct OneCount {
    at: i16,
    scans: u16,
    restarts: u16,
}

impl ControlProgram for OneCount {
    fn scan(&mut self, mailboxes: &[&[u16]], holds: bool) -> Words {
        self.scans += 1;
        let goal = mailboxes.iter().find_map(|words| words.first());
        if let (Some(goal), false) = (goal, holds) {
            self.at += (goal.cast_signed() - self.at).signum();
        }
        Words::new(&[self.scans, self.at.cast_unsigned(), self.restarts]).unwrap()
    }

    fn applied(&self) -> PerChannel<i16> {
        PerChannel::leading([self.at, -self.at])
    }

    fn restart(&mut self, applied: &PerChannel<i16>) {
        (self.at, self.restarts) = (applied[0], self.restarts + 1);
    }
}

const SCAN: Duration = Duration::from_millis(2);

#[test]
fn controller_contract_with_a_barrier() {
    let program = Box::<OneCount>::default();
    let (mut controller, _, _) = machine(Clock::system()).start_with(program, SCAN);
    contract::controller(&mut controller);
}

#[test]
fn the_machine_clock_scans_the_program_of_the_control() {
    let clock = Clock::manual();
    let (mut controller, _, controls) =
        machine(clock.clone()).start_with(Box::<OneCount>::default(), SCAN);
    assert!(controller.description().barrier);
    assert_eq!(controller.read(soon()).unwrap().report, None);
    controller.post(&Words::new(&[50]).unwrap(), soon()).unwrap();
    controls.axes.record(100);
    // Time for ten and a half scans: the eleventh is not due yet.
    clock.advance(SCAN * 10 + SCAN / 2);
    let snapshot = controller.read(soon()).unwrap();
    assert_eq!(snapshot.applied, None);
    assert_eq!(snapshot.report.unwrap().as_slice(), [10, 10, 0]);
    // The positions of Y include the correction.
    assert!((snapshot.positions[1] + 0.010).abs() < 1e-12);
    assert_eq!(controls.axes.scans(), 10);
    assert_eq!(controls.axes.applied()[..2], [0.010, -0.010]);
    // The clock advances without calls; the next call executes all scans that are due.
    clock.advance(SCAN / 2 + SCAN * 29);
    assert_eq!(controller.plant().applied()[..2], [0.040, -0.040]);
    controls.emergency_stop.store(true, Ordering::Relaxed);
    clock.advance(SCAN * 5);
    controller.plant().pass();
    let recorded = controls.axes.recorded();
    assert_eq!(recorded.len(), 45);
    for (index, given) in recorded.iter().enumerate() {
        assert_eq!(given.at, SCAN * u32::try_from(index + 1).unwrap());
        assert_eq!(given.held, index >= 40);
    }
    let changes = controls.axes.largest_change();
    assert!(changes[..2].iter().all(|change| (change - 0.001).abs() < 1e-12));
    assert!((controls.axes.furthest()[1] - 0.040).abs() < 1e-12);
    assert_eq!(controls.axes.changes_while_held(), 0);
}

#[test]
fn a_restart_keeps_the_correction_and_a_reboot_clears_it() {
    let clock = Clock::manual();
    let (mut controller, _, controls) =
        machine(clock.clone()).start_with(Box::<OneCount>::default(), SCAN);
    controller.post(&Words::new(&[5]).unwrap(), soon()).unwrap();
    clock.advance(SCAN * 8);
    controls.restart.store(true, Ordering::Relaxed);
    let report = controller.read(soon()).unwrap().report.unwrap();
    assert_eq!(report.as_slice(), [8, 5, 1]);
    controls.clear_applied.store(true, Ordering::Relaxed);
    clock.advance(SCAN);
    let report = controller.read(soon()).unwrap().report.unwrap();
    assert_eq!(report.as_slice(), [9, 1, 2]);
    // Clearing the correction is not counted as a step, because the axes were without power.
    assert!((controls.axes.largest_change()[0] - 0.001).abs() < 1e-12);
}

#[test]
fn several_controllers_use_one_machine() {
    let clock = Clock::manual();
    let (mut first, _, controls) =
        machine(clock.clone()).start_with(Box::<OneCount>::default(), SCAN);
    let mut second = first.another().unwrap();
    second.post(&Words::new(&[3]).unwrap(), soon()).unwrap();
    clock.advance(SCAN * 4);
    first.plant().pass();
    assert_eq!(controls.axes.applied()[0], 0.003);
    // The control program uses the first mailbox that is not empty.
    first.post(&Words::new(&[1]).unwrap(), soon()).unwrap();
    clock.advance(SCAN * 4);
    assert_eq!(second.plant().applied()[0], 0.001);
    drop(first);
    assert!(second.another().is_some() && second.another().is_some());
    assert!(second.another().is_none(), "at most four");
    assert!(
        matches!(second.apply(&PerChannel::ZERO, soon()), Err(Fault::Unsupported(_))),
        "a plain value would go past the barrier"
    );
}
