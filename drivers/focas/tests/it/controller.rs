//! Compares positions, states and corrections of the controller with the simulator. A cycle does not
//! allocate or free memory, even when the connection is lost.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use assert_no_alloc::assert_no_alloc;
use volcomp_focas::{
    FocasConfig, FocasController, PmcArea,
    simulator::{Options, Simulator},
};
use volcomp_port::{Controller, Fault, Words};
use volcomp_vocabulary::{AxisName, Mm, PerChannel};

use crate::{TIMEOUT, at, barrier, config, simulator};

pub(crate) fn soon() -> Instant {
    Instant::now() + TIMEOUT
}

pub(crate) fn connected(config: FocasConfig) -> FocasController {
    let mut controller = FocasController::new(config).unwrap();
    controller.wait(TIMEOUT).unwrap();
    controller
}

/// Corrections in mm for the first three axes, from µm.
pub(crate) fn um(x: f64, y: f64, z: f64) -> PerChannel<f64> {
    PerChannel::leading([x * 1e-3, y * 1e-3, z * 1e-3])
}

#[test]
fn shifts_reach_the_named_axes() {
    let simulator = simulator(Options::default());
    simulator.world().shift.in_positions = true;
    simulator.world().motion = Arc::new(|_| vec![10.0, 20.0, 30.0, 90.0]);
    // The configuration has another order of axes than the control, and omits one.
    let mut controller = connected(config(&simulator, &[AxisName::Z, AxisName::X]));
    controller.apply(&um(5.0, -12.0, 0.0), soon()).unwrap();
    assert_eq!(simulator.world().shifts(), [-0.012, 0.0, 0.005, 0.0]);
    let snapshot = controller.read(soon()).unwrap();
    assert!((snapshot.positions[0] - 30.005).abs() < 1e-12);
    assert!((snapshot.positions[1] - 9.988).abs() < 1e-12);
    assert_eq!(snapshot.positions[2..], [0.0; 7]);
    let applied = snapshot.applied.unwrap();
    assert!((applied[0] - 0.005).abs() < 1e-12 && (applied[1] + 0.012).abs() < 1e-12);
    assert!(snapshot.uncertainty < Duration::from_millis(500));
}

/// Positions of read-only axes follow those of corrected axes, and nothing is written for them. A read-only controller
/// does not report a writer as another gateway.
#[test]
fn read_only_axes_are_read_and_not_written() {
    let simulator = simulator(Options::default());
    simulator.world().motion = Arc::new(|_| vec![10.0, 20.0, 30.0, 90.0]);
    let mut with_others = config(&simulator, &[AxisName::Z, AxisName::X]);
    with_others.reads = vec![AxisName::C, AxisName::Y];
    let mut controller = connected(with_others);
    let only_reads = FocasConfig { reads: vec![AxisName::C], ..config(&simulator, &[]) };
    assert!(!only_reads.describe().unwrap().tells_applied);
    let mut reader = connected(only_reads);
    for step in 1..5 {
        let mut wanted = um(5.0, -12.0, f64::from(step));
        wanted[3] = 1.0;
        controller.apply(&wanted, soon()).unwrap();
        assert_eq!(simulator.world().shifts(), [-0.012, 0.0, 0.005, 0.0]);
        let positions = controller.read(soon()).unwrap().positions;
        assert_eq!(positions[..2], [30.0, 10.0]);
        assert!((positions[2] - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        assert_eq!(positions[3..], [20.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let read = reader.read(soon()).unwrap();
        assert!((read.positions[0] - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
        assert_eq!(read.positions[1..], [0.0; 8]);
    }
    assert!(matches!(reader.apply(&um(1.0, 1.0, 1.0), soon()), Err(Fault::Unsupported(_))));
    assert_eq!(simulator.world().shifts(), [-0.012, 0.0, 0.005, 0.0]);
    // Read-only axes must be referenced too, because the corrections of the other axes depend on their positions.
    let is_referenced =
        |reader: &mut FocasController| reader.read(soon()).unwrap().state.referenced;
    assert!(is_referenced(&mut reader));
    simulator.world().set(PmcArea::F, 120, &[0b0111]);
    assert!(!is_referenced(&mut reader) && !is_referenced(&mut controller));
}

#[test]
fn shifts_saturate_at_the_word_range() {
    let simulator = simulator(Options::default());
    let mut controller = connected(config(&simulator, &[AxisName::X, AxisName::Y, AxisName::Z]));
    let wild = PerChannel::leading([f64::INFINITY, -1e9, f64::NAN]);
    controller.apply(&wild, soon()).unwrap();
    assert_eq!(simulator.world().shifts(), [32.767, -32.768, 0.0, 0.0]);
}

#[test]
fn rotary_axes_are_in_radians() {
    let simulator = simulator(Options::default());
    simulator.world().motion = Arc::new(|_| vec![1.0, 2.0, 3.0, 180.0]);
    let mut config = config(&simulator, &[AxisName::X]);
    config.axes = vec![AxisName::C, AxisName::X];
    let mut controller = connected(config);
    let snapshot = controller.read(soon()).unwrap();
    assert!((snapshot.positions[0] - std::f64::consts::PI).abs() < 1e-12);
    assert!((snapshot.positions[1] - 1.0).abs() < 1e-12);
    let mut corrections = PerChannel::ZERO;
    corrections[0] = 0.004_f64.to_radians();
    controller.apply(&corrections, soon()).unwrap();
    assert_eq!(simulator.world().shifts()[3], 0.004);
}

#[test]
fn states_are_reported() {
    let simulator = simulator(Options::default());
    let mut controller = connected(config(&simulator, &[AxisName::X, AxisName::Y, AxisName::Z]));
    let state = |controller: &mut FocasController| controller.read(soon()).unwrap().state;
    assert!(state(&mut controller).referenced && !state(&mut controller).alarm);
    simulator.world().write(PmcArea::F, 120, &[0b1011]);
    assert!(!state(&mut controller).referenced);
    simulator.world().set_emergency_stop(true);
    simulator.world().alarms.push((1, String::new()));
    let found = state(&mut controller);
    assert!(found.alarm && found.emergency_stop);
}

#[test]
fn the_heartbeat_counts_corrections_and_reveals_another_gateway() {
    let simulator = simulator(Options::default());
    let mut controller = connected(config(&simulator, &[AxisName::X]));
    let beat = |simulator: &Simulator| simulator.world().read(PmcArea::R, 120, 1).unwrap()[0];
    for expected in 1..=3 {
        controller.read(soon()).unwrap();
        controller.apply(&um(1.0, 0.0, 0.0), soon()).unwrap();
        assert_eq!(beat(&simulator), expected);
    }
    controller.read(soon()).unwrap();
    simulator.world().write(PmcArea::R, 120, &[77]);
    assert_eq!(controller.read(soon()), Err(Fault::OtherGateway));
    assert!(controller.read(soon()).is_ok(), "reported once for each change");
}

#[test]
fn the_sequence_byte_counts_corrections() {
    let simulator = simulator(Options::default());
    let mut config = config(&simulator, &[AxisName::X, AxisName::Z]);
    config.sequence = Some(at(PmcArea::D, 7));
    for (heartbeat, beats) in [(config.heartbeat, 3), (None, 0)] {
        simulator.world().write(PmcArea::R, 120, &[0]);
        simulator.world().write(PmcArea::D, 7, &[0]);
        config.heartbeat = heartbeat;
        let mut controller = connected(config.clone());
        for expected in 1..=3 {
            controller.apply(&um(f64::from(expected), 0.0, 0.0), soon()).unwrap();
            let mut world = simulator.world();
            assert_eq!(world.read(PmcArea::D, 7, 1), Some(vec![expected]));
            assert_eq!(world.shifts()[0], f64::from(expected) * 0.001);
        }
        assert_eq!(simulator.world().read(PmcArea::R, 120, 1), Some(vec![beats]));
    }
    // The sequence number continues after a reconnect, so that the ladder detects the first correction.
    let mut controller = connected(config);
    controller.apply(&um(1.0, 0.0, 0.0), soon()).unwrap();
    let number = simulator.world().read(PmcArea::D, 7, 1);
    assert_eq!(number, Some(vec![4]));
}

#[test]
fn memory_addresses_are_configurable() {
    let simulator = simulator(Options::default());
    {
        let mut world = simulator.world();
        world.shift.area = PmcArea::D;
        world.shift.first = 1000;
        world.shift.width = volcomp_focas::Width::Long;
        world.shift.count = 0.0001;
    }
    let mut config = config(&simulator, &[AxisName::Y, AxisName::Z]);
    config.shift.first = at(PmcArea::D, 1000);
    config.shift.width = volcomp_focas::Width::Long;
    config.copied = true;
    config.shift.count_linear = Mm(0.0001);
    let mut controller = connected(config);
    controller.apply(&um(123.4, -5.55, 0.0), soon()).unwrap();
    let shifts = simulator.world().shifts();
    assert!((shifts[1] - 0.1234).abs() < 1e-12 && (shifts[2] + 0.0056).abs() < 1e-12, "{shifts:?}");
}

/// A heartbeat within the shift words is rejected, because it would shift an axis by 0 to 255 counts.
#[test]
fn a_heartbeat_within_the_shift_words_is_rejected() {
    let config = |heartbeat: u16| {
        let mut config = FocasConfig::new("127.0.0.1", &[AxisName::X]);
        config.heartbeat = Some(at(PmcArea::R, heartbeat));
        config
    };
    for (heartbeat, refused) in [(99, false), (100, true), (101, true), (102, false)] {
        assert_eq!(config(heartbeat).describe().is_err(), refused, "R{heartbeat}");
    }
}

const AXES: [AxisName; 3] = [AxisName::X, AxisName::Y, AxisName::Z];

/// Runs cycles while the connection is open, lost, missing and restored. `silence` makes the control silent for some time from now on.
fn cycles(controller: &mut FocasController, silence: impl Fn(Duration), frame: Option<&Words>) {
    let cycle = |controller: &mut FocasController, deadline: Instant| {
        assert_no_alloc(|| {
            let read = controller.read(deadline).map(drop);
            let written = match frame {
                Some(frame) => controller.post(frame, deadline),
                None => controller.apply(&PerChannel::ZERO, deadline),
            };
            (read, written)
        })
    };
    for _ in 0..20 {
        assert_eq!(cycle(controller, soon()), (Ok(()), Ok(())));
    }
    silence(TIMEOUT);
    let (read, written) = cycle(controller, Instant::now() + Duration::from_millis(5));
    assert_eq!(read, Err(Fault::TimedOut));
    assert_eq!(written, Err(Fault::NotConnected));
    silence(Duration::ZERO);
    controller.wait(TIMEOUT).unwrap();
    assert_eq!(cycle(controller, soon()), (Ok(()), Ok(())));
}

#[test]
fn cycles_do_not_allocate() {
    let simulator = barrier::simulated(Options::default());
    let silence = |time| simulator.world().pause(time);
    cycles(&mut connected(config(&simulator, &AXES)), silence, None);
    let with_barrier = FocasConfig { barrier: Some(barrier::area()), ..config(&simulator, &AXES) };
    let frame = Words::new(&[0; 9]).unwrap();
    cycles(&mut connected(with_barrier), silence, Some(&frame));
}
