//! Frames to a barrier in the simulated control, and the reports of that barrier. The driver interprets neither. The
//! applied shifts are read from the simulator.

use std::{
    thread::sleep,
    time::{Duration, Instant},
};

use volcomp_focas::{
    BarrierArea, FocasConfig, FocasController, FocasError, PmcAddress, PmcArea,
    simulator::{BarrierLadder, Ladder, Options, Simulator, World},
};
use volcomp_guard::{
    barrier::{FRAME_WORDS, Program, Protection, Report, Settings},
    protocol::{Counts, Refusal, ReportStatus, Session},
};
use volcomp_port::{Controller, Fault, Heartbeat, Words};
use volcomp_vocabulary::{AxisName, PerChannel};

use crate::{
    TIMEOUT, at, config,
    controller::{connected, soon},
    until,
};

const AXES: [AxisName; 3] = [AxisName::X, AxisName::Y, AxisName::Z];

fn r(at: u16) -> PmcAddress {
    crate::at(PmcArea::R, at)
}

pub(crate) fn area() -> BarrierArea {
    BarrierArea { frame: r(200), report: r(240) }
}

/// The time-out is so long that the barrier of a busy test still holds its correction.
fn settings(axes: usize) -> Settings {
    let protection = Protection {
        time_out: Duration::from_secs(3),
        ..volcomp_test_support::barrier::protection()
    };
    protection.settings(&volcomp_test_support::barrier::axes(&AXES[..axes])).unwrap()
}

pub(crate) fn simulated(options: Options) -> Simulator {
    let program = Program::new(settings(3)).unwrap();
    let mut world = World::new(&['X', 'Y', 'Z', 'C']);
    world.ladder = Some(Ladder::Barrier(BarrierLadder::new(Box::new(program), 3)));
    Simulator::start("127.0.0.1:0", options, world).unwrap()
}

fn barrier_config(simulator: &Simulator) -> FocasConfig {
    FocasConfig { barrier: Some(area()), ..config(simulator, &AXES) }
}

/// A minimal gateway that only speaks the barrier protocol.
struct Sender {
    session: Session,
    settings: Settings,
    last: Option<Report>,
    torn: u32,
}

impl Sender {
    fn new(owner: u16) -> Self {
        Self { session: Session::new(owner), settings: settings(3), last: None, torn: 0 }
    }

    fn read(&mut self, controller: &mut FocasController) -> Option<ReportStatus> {
        let snapshot = controller.read(soon()).unwrap();
        assert_eq!(snapshot.applied, None);
        let words = snapshot.report.expect("a barrier reports");
        let Some(report) = Report::decode(4711, settings(3).axes, words.as_slice()) else {
            self.torn += 1;
            return None;
        };
        self.last = Some(report);
        Some(self.session.read(report.head()))
    }

    fn frame(&mut self, um: [i16; 3]) -> Option<Words> {
        let frame = self.session.frame(&PerChannel::leading(um))?;
        let mut words = [0; FRAME_WORDS];
        let length = frame.encode(&self.settings, &mut words);
        Words::new(&words[..length])
    }

    /// Runs cycles until the barrier applies these corrections, in counts.
    fn drive(&mut self, controller: &mut FocasController, um: [i16; 3]) {
        let end = Instant::now() + TIMEOUT;
        loop {
            self.read(controller);
            let wanted: Counts = PerChannel::leading(um);
            if self.last.is_some_and(|report| report.applied == wanted) {
                return;
            }
            assert!(Instant::now() < end, "{:?}", self.last);
            if let Some(frame) = self.frame(um) {
                controller.post(&frame, soon()).unwrap();
            }
            sleep(Duration::from_millis(2));
        }
    }
}

#[test]
fn the_barrier_receives_frames_and_reports() {
    for options in [
        Options::default(),
        Options { version: 4, refuses_mix: true, fragment: 11, ..Options::default() },
        // Single points only: one command per word, all in one request.
        Options { version: 2, slots: 8, one_point: true, ..Options::default() },
    ] {
        let simulator = simulated(options);
        let mut controller = connected(barrier_config(&simulator));
        let description = controller.description();
        assert!(description.barrier && description.sees_other_gateways);
        assert_eq!(description.heartbeat, Heartbeat::Watched);
        simulator.world().reset_largest_steps();
        let mut sender = Sender::new(77);
        sender.drive(&mut controller, [40, -100, 7]);
        let shifts = simulator.world().shifts();
        assert_eq!(shifts, [0.040, -0.100, 0.007, 0.0]);
        sender.drive(&mut controller, [0, 0, 0]);
        // The barrier moves at its own rate, although the frame requests 100 counts at once.
        let steps = simulator.world().largest_steps().to_vec();
        assert_eq!(steps[1], 2, "{steps:?}");
        assert!(steps.iter().all(|step| *step <= 2), "{steps:?}");
        let report = sender.last.unwrap();
        assert_eq!((report.owner, report.refusal), (77, Refusal::None));
    }
}

/// If every word needs its own request, a scan sees most frames and reports half-written. Both ends reject them by the
/// checksum, and the axes keep their rate.
#[test]
fn torn_frames_and_reports_are_rejected() {
    let simulator = simulated(Options {
        one_point: true,
        one_axis: true,
        one_command: true,
        latency: Duration::from_micros(300),
        ..Options::default()
    });
    let mut controller = connected(barrier_config(&simulator));
    simulator.world().reset_largest_steps();
    let mut sender = Sender::new(78);
    for cycle in 0..40 {
        sender.read(&mut controller);
        if let Some(frame) = sender.frame([cycle, -cycle, 0]) {
            controller.post(&frame, soon()).unwrap();
        }
    }
    assert!(sender.torn > 0, "no report was torn: the test proves nothing");
    let steps = simulator.world().largest_steps().to_vec();
    assert!(steps.iter().all(|step| *step <= 2), "{steps:?}");
    // The simulator tears a frame: it writes one half now and the other half two scans later.
    let simulator = simulated(Options::default());
    let mut controller = connected(barrier_config(&simulator));
    let mut sender = Sender::new(79);
    sender.drive(&mut controller, [5, 5, 5]);
    let mut refused = 0;
    let end = Instant::now() + TIMEOUT;
    // A busy computer may miss the scans with the first half alone: then again.
    for bytes in (2..18).step_by(2).cycle() {
        if bytes == 2 && refused > 0 {
            break;
        }
        assert!(Instant::now() < end, "no half of a frame was refused");
        sender.read(&mut controller);
        simulator.world().tear_next_write(bytes);
        // The first half alone is visible only at the next scan.
        let frame = sender.frame([-5, 60, 0]).unwrap();
        controller.post(&frame, soon()).unwrap();
        sleep(Duration::from_millis(3));
        sender.read(&mut controller);
        refused += u32::from(sender.last.unwrap().refusal == Refusal::Checksum);
        sleep(Duration::from_millis(8));
    }
    let steps = simulator.world().largest_steps().to_vec();
    assert!(steps.iter().all(|step| *step <= 2), "{steps:?}");
}

#[test]
fn silence_ramps_to_zero_and_an_old_frame_is_rejected() {
    let simulator = simulated(Options::default());
    let mut controller = connected(barrier_config(&simulator));
    let mut sender = Sender::new(80);
    sender.drive(&mut controller, [90, 0, -90]);
    sender.read(&mut controller);
    let old = sender.frame([90, 0, -90]).unwrap();
    until("it is ramped to zero", || simulator.world().shifts()[..3] == [0.0; 3]);
    controller.post(&old, soon()).unwrap();
    let end = Instant::now() + TIMEOUT;
    while sender.last.unwrap().refusal != Refusal::Epoch {
        assert!(Instant::now() < end, "{:?}", sender.last);
        sender.read(&mut controller);
    }
    assert_eq!(simulator.world().shifts()[..3], [0.0; 3]);
    assert!(simulator.world().largest_steps().iter().all(|s| *s <= 2));
}

#[test]
fn garbage_in_memory_causes_no_step() {
    let program = Program::new(settings(3)).unwrap();
    let mut world = World::new(&['X', 'Y', 'Z']).with_barrier(Box::new(program));
    world.set_words(r(100), &[120, 0, 0]);
    world.set_words(r(200), &[0xa5a5; 9]);
    world.set_words(r(240), &[0x5a5a; 19]);
    let simulator = Simulator::start("127.0.0.1:0", Options::default(), world).unwrap();
    let mut controller = connected(barrier_config(&simulator));
    let mut sender = Sender::new(81);
    sender.drive(&mut controller, [110, 10, 0]);
    // Another writer changes the axis words: the next scan restores the applied correction.
    simulator.world().set_words(r(100), &[5000, 0, 0]);
    until("it is restored", || simulator.world().shifts() == [0.110, 0.010, 0.0]);
}

/// While the control holds its axes, the correction does not change. After a power-up it is zero, with a new epoch.
#[test]
fn emergency_stop_holds_and_power_up_starts_a_new_epoch() {
    let simulator = simulated(Options::default());
    let mut controller = connected(barrier_config(&simulator));
    let mut sender = Sender::new(82);
    sender.drive(&mut controller, [50, 0, 0]);
    simulator.world().set_emergency_stop(true);
    let end = Instant::now() + Duration::from_millis(150);
    while Instant::now() < end {
        sender.read(&mut controller);
        if let Some(frame) = sender.frame([-50, 0, 0]) {
            controller.post(&frame, soon()).unwrap();
        }
    }
    assert_eq!(simulator.world().shifts()[0], 0.050);
    let before = sender.last.unwrap().epoch;
    simulator.power_up();
    assert_eq!(simulator.world().shifts()[0], 0.0);
    assert_eq!(controller.read(soon()), Err(Fault::Disconnected));
    controller.wait(TIMEOUT).unwrap();
    // The memory has no report until the control's next scan.
    let end = Instant::now() + TIMEOUT;
    while sender.read(&mut controller).is_none() {
        assert!(Instant::now() < end, "no report");
    }
    assert_ne!(sender.last.unwrap().epoch, before);
}

#[test]
fn a_barrier_accepts_only_frames_of_its_axes() {
    let simulator = simulated(Options::default());
    let mut controller = connected(barrier_config(&simulator));
    let plain = controller.apply(&PerChannel::ZERO, soon());
    assert!(matches!(plain, Err(Fault::Unsupported(_))), "{plain:?}");
    let long = controller.post(&Words::new(&[0; 10]).unwrap(), soon());
    assert!(matches!(long, Err(Fault::Unsupported(_))), "{long:?}");
    assert!(controller.read(soon()).is_ok(), "the session lives on");
    let mut controller = connected(config(&simulator, &AXES));
    let frame = controller.post(&Words::new(&[0; 9]).unwrap(), soon());
    assert!(matches!(frame, Err(Fault::Unsupported(_))), "{frame:?}");
}

#[test]
fn words_change_byte_order_between_wire_and_memory() {
    let simulator =
        Simulator::start("127.0.0.1:0", Options::default(), World::new(&['X', 'Y', 'Z'])).unwrap();
    let mut controller = connected(barrier_config(&simulator));
    let words: Vec<u16> = (0..9).map(|word| 0x0102 + word * 0x0202).collect();
    controller.post(&Words::new(&words).unwrap(), soon()).unwrap();
    let bytes = simulator.world().read(PmcArea::R, 200, 19).unwrap();
    let expected = [2, 1, 4, 3, 6, 5, 8, 7, 10, 9, 12, 11, 14, 13, 16, 15, 18, 17, 0];
    assert_eq!(bytes, expected);
    simulator.world().set(PmcArea::R, 240, &[0x34, 0x12]);
    simulator.world().set(PmcArea::R, 276, &[0x78, 0x56]);
    let report = controller.read(soon()).unwrap().report.unwrap();
    assert_eq!(report.as_slice().len(), 19);
    assert_eq!((report.as_slice()[0], report.as_slice()[18]), (0x1234, 0x5678));
}

#[test]
fn overlapping_words_are_rejected() {
    let overlap = |change: &dyn Fn(&mut FocasConfig)| {
        let mut config = FocasConfig::new("192.0.2.10", &AXES);
        config.barrier = Some(area());
        change(&mut config);
        match config.describe() {
            Ok(_) => None,
            Err(FocasError::Overlap { one, other }) => Some(format!("{one} / {other}")),
            Err(error) => Some(error.to_string()),
        }
    };
    let barrier = |frame, report| BarrierArea { frame: r(frame), report: r(report) };
    assert_eq!(overlap(&|_| {}), None);
    // 9 words of the frame, 19 of the report, 3 of the shifts.
    for (frame, report, expected) in [
        (
            200,
            217,
            Some("the words of the frame R200 to R217 / the words of the report R217 to R254"),
        ),
        (200, 218, None),
        (
            237,
            200,
            Some("the words of the frame R237 to R254 / the words of the report R200 to R237"),
        ),
        (238, 200, None),
        (
            83,
            240,
            Some("the words of the frame R83 to R100 / the words of the shifts R100 to R105"),
        ),
        (106, 240, None),
        (
            200,
            63,
            Some("the words of the report R63 to R100 / the words of the shifts R100 to R105"),
        ),
        (
            65_519,
            240,
            Some(
                "barrier.frame: found R65519 for 9 words of 2 bytes each, expected words that end at byte 65535 at the latest",
            ),
        ),
        (65_518, 240, None),
    ] {
        let found = overlap(&|config| config.barrier = Some(barrier(frame, report)));
        assert_eq!(found.as_deref(), expected);
    }
    let referenced = overlap(&|config| config.referenced = Some(r(241)));
    assert!(referenced.unwrap().contains("the byte of the referenced axes R241"));
    // With a barrier the heartbeat is unused, so it overlaps nothing.
    assert_eq!(overlap(&|config| config.heartbeat = Some(r(200))), None);
    let fixed = overlap(&|config| {
        config.barrier = Some(BarrierArea { frame: at(PmcArea::F, 0), report: r(240) });
    });
    assert!(fixed.unwrap().contains("barrier.frame: found F0"));
}

#[test]
fn controllers_of_one_control_need_disjoint_words() {
    let config = |frame: Option<u16>, first: u16| {
        let mut config = FocasConfig::new("cnc", &AXES);
        config.barrier = frame.map(|frame| BarrierArea { frame: r(frame), report: r(240) });
        config.shift.first = r(first);
        config.heartbeat = Some(r(first + 1000));
        config
    };
    let barrier = config(Some(200), 100);
    let shared = |other: &FocasConfig| {
        let found = barrier.overlap_with(other);
        let turned = other.overlap_with(&barrier);
        let turned = turned.map(|[one, other]| [other, one]);
        assert_eq!(found, turned, "symmetric");
        let [one, other] = found?;
        let byte = one.shared(&other).map(|byte| byte.to_string());
        Some([byte?, one.key.to_owned(), other.key.to_owned()])
    };
    let found = |byte: &str, keys: [&str; 2]| Some([byte, keys[0], keys[1]].map(str::to_owned));
    let (frame, report, area) = ("barrier.frame", "barrier.report", "area.first");
    assert_eq!(shared(&config(Some(218), 100)), None);
    assert_eq!(shared(&config(Some(217), 100)), found("R217", [frame, frame]));
    // A controller without a barrier writes axis words that overlap axis words, report or frame of the other
    // controller.
    assert_eq!(shared(&config(None, 100)), found("R100", [area, area]));
    assert_eq!(shared(&config(None, 241)), found("R241", [report, area]));
    assert_eq!(shared(&config(None, 300)), None);
    let mut elsewhere = config(Some(200), 100);
    elsewhere.host = "another".to_owned();
    assert_eq!(shared(&elsewhere), None);
}

fn two_mailboxes() -> (Simulator, [FocasController; 2]) {
    let program = Program::new(settings(3)).unwrap();
    let mut ladder = BarrierLadder::new(Box::new(program), 3);
    let second = BarrierArea { frame: r(300), ..area() };
    ladder.frames.push(second.frame);
    let mut world = World::new(&['X', 'Y', 'Z', 'C']);
    world.ladder = Some(Ladder::Barrier(ladder));
    let simulator = Simulator::start("127.0.0.1:0", Options::default(), world).unwrap();
    let controllers = [area(), second].map(|barrier| {
        connected(FocasConfig { barrier: Some(barrier), ..config(&simulator, &AXES) })
    });
    simulator.world().reset_largest_steps();
    (simulator, controllers)
}

/// One gateway switches between the connections while a correction is applied. No step exceeds 2 counts, although the
/// mailbox of the other connection has an old frame, complete or torn.
#[test]
fn a_gateway_switches_connections_without_a_step() {
    let (simulator, mut controllers) = two_mailboxes();
    let mut sender = Sender::new(77);
    for turn in 0..8_i16 {
        let index = usize::from(turn % 2 == 1);
        let goal = [40 - 10 * turn, -60 + 12 * turn, turn];
        sender.drive(&mut controllers[index], goal);
        if turn % 3 == 0 {
            // Tear the last frame of this connection: its last words are overwritten.
            let at = [area().frame.at, 300][index];
            simulator.world().set(PmcArea::R, usize::from(at) + 10, &[9, 9, 9]);
        }
        assert_eq!(sender.last.unwrap().owner, 77);
        let shifts = simulator.world().shift_counts();
        assert_eq!(shifts[..3], goal.map(i64::from));
    }
    let steps = simulator.world().largest_steps().to_vec();
    assert!(steps.iter().all(|step| *step <= 2), "{steps:?}");
}

/// A second gateway is rejected in either mailbox, and reads the owner's number.
#[test]
fn a_second_gateway_in_the_other_mailbox_is_rejected() {
    let (simulator, [mut first, mut second]) = two_mailboxes();
    let (mut ours, mut other) = (Sender::new(77), Sender::new(78));
    // The second gateway reads before the control has an owner, and sends afterwards. It repeats the read if a report
    // is torn.
    while other.read(&mut second).is_none() {}
    let late = other.frame([100, 100, 100]).expect("a report was read");
    ours.drive(&mut first, [20, -20, 5]);
    second.post(&late, soon()).unwrap();
    for _ in 0..20 {
        ours.drive(&mut first, [20, -20, 5]);
        let seen = other.read(&mut second);
        assert!(
            matches!(seen, None | Some(ReportStatus::Old | ReportStatus::Held { owner: 77 })),
            "{seen:?}"
        );
    }
    assert_eq!(simulator.world().shift_counts()[..3], [20, -20, 5]);
    let steps = simulator.world().largest_steps().to_vec();
    assert!(steps.iter().all(|step| *step <= 2), "{steps:?}");
}
