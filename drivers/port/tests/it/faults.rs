//! Random faults are seeded. Each injected fault has its effect for the requested duration and no effect afterwards.

use std::{
    sync::{Arc, Mutex, atomic::Ordering},
    time::{Duration, Instant},
};

use volcomp_port::{
    Clock, ControlProgram, Controller, DigitalIo, Fault, InputLevels, MockController,
    MockDigitalIo, Quality, Snapshot, Thermometer, Words, contract,
    inject::{Faults, Faulty, Injection, Lie},
    simulated::{Controls, SimulatedController},
};
use volcomp_vocabulary::PerChannel;

use crate::{machine, place};

fn soon() -> Instant {
    Instant::now() + Duration::from_millis(20)
}

#[test]
fn without_faults_the_device_is_unchanged() {
    let (controller, thermometer, _) = machine(Clock::system()).start();
    contract::controller(&mut Faulty::new(controller, Faults::default(), 1));
    contract::thermometer(&mut Faulty::new(thermometer, Faults::default(), 1));
}

/// Equal seeds give equal faults, different seeds different ones. Their number is about as requested.
#[test]
fn faults_are_seeded() {
    let faults =
        Faults { drop: 0.1, corrupt: 0.1, disconnect: 0.02, calls: 3, ..Faults::default() };
    let run = |seed| {
        let (controller, _, _) = machine(Clock::manual()).start();
        let mut faulty = Faulty::new(controller, faults, seed);
        let outcome = |_| match faulty.read(soon()) {
            Ok(snapshot) if snapshot.positions == PerChannel::ZERO => 'o',
            Ok(_) => 'c',
            Err(Fault::TimedOut) => 't',
            Err(Fault::NotConnected) => 'd',
            Err(other) => panic!("{other}"),
        };
        (0..2000).map(outcome).collect::<String>()
    };
    let first = run(7);
    assert_eq!(first, run(7));
    assert_ne!(first, run(8));
    let count = |what| first.matches(what).count();
    assert!((140..260).contains(&count('t')), "{}", count('t'));
    assert!((110..260).contains(&count('c')), "{}", count('c'));
    assert!((60..180).contains(&count('d')), "{}", count('d'));
}

#[test]
fn frozen_responses_repeat_the_last_one() {
    let clock = Clock::manual();
    let (controller, _, _) = machine(clock.clone()).start();
    let mut faulty = Faulty::new(controller, Faults::default(), 1);
    let first = faulty.read(soon()).unwrap();
    faulty.faults.freeze = 1.0;
    faulty.faults.calls = 5;
    clock.advance(Duration::from_millis(300));
    for _ in 0..5 {
        assert_eq!(faulty.read(soon()).unwrap().positions, first.positions);
    }
    faulty.faults.freeze = 0.0;
    assert_ne!(faulty.read(soon()).unwrap().positions, first.positions);
}

#[test]
fn a_delay_ends_at_the_deadline() {
    let (controller, _, _) = machine(Clock::manual()).start();
    let faults = Faults { delay: Duration::from_secs(3600), ..Faults::default() };
    let mut faulty = Faulty::new(controller, faults, 1);
    assert_eq!(faulty.read(soon()), Err(Fault::TimedOut));
    faulty.faults.delay = Duration::from_millis(1);
    assert!(faulty.read(soon()).is_ok());
}

#[test]
fn one_bit_of_a_mocked_device_is_flipped() {
    let mut port = MockDigitalIo::new();
    port.expect_inputs().return_const(8_u32);
    port.expect_read().returning(|_| Ok(InputLevels::now(0b1010_0101)));
    let faults = Faults { corrupt: 1.0, ..Faults::default() };
    let mut faulty = Faulty::new(port, faults, 3);
    for _ in 0..50 {
        let levels = faulty.read(soon()).unwrap().levels;
        assert_eq!((levels ^ 0b1010_0101).count_ones(), 1);
    }
    let mut controller = MockController::new();
    controller.expect_apply().returning(|_, _| Err(Fault::Disconnected));
    assert_eq!(controller.apply(&PerChannel::ZERO, soon()), Err(Fault::Disconnected));
}

#[test]
fn corrupted_temperatures() {
    let (_, thermometer, _) = machine(Clock::manual()).start();
    let faults = Faults { corrupt: 1.0, ..Faults::default() };
    let mut faulty = Faulty::new(thermometer, faults, 3);
    let mut seen_nan = false;
    for _ in 0..50 {
        let found = faulty.latest()[0];
        assert_eq!(found.quality, Quality::Good);
        assert_ne!(found.degc, Some(20.0));
        seen_nan |= found.degc.is_some_and(f64::is_nan);
    }
    assert!(seen_nan);
}

/// Stored settings without the keys of read-back faults are read with the default values of these keys.
#[test]
fn old_documents_are_accepted() {
    let old = r#"{"delay":{"secs":0,"nanos":3000000},"jitter":false,"drop":0.25,"corrupt":0.0,"freeze":0.0,"disconnect":0.0,"calls":0}"#;
    let read: Faults = serde_json::from_str(old).unwrap();
    assert_eq!((read.drop, read.lie, read.lag), (0.25, 0.0, 0));
}

const PERIOD: Duration = Duration::from_millis(4);

struct Rig {
    faulty: Faulty<SimulatedController>,
    clock: Clock,
    controls: Arc<Controls>,
}

impl Rig {
    fn new(faults: Faults) -> Self {
        let clock = Clock::manual();
        let (controller, _, controls) = machine(clock.clone()).start();
        Self {
            faulty: Faulty::new(controller, faults, 11).with_clock(clock.clone()),
            clock,
            controls,
        }
    }

    fn soon(&self) -> Instant {
        self.clock.now() + PERIOD
    }

    fn read(&mut self) -> Snapshot {
        self.clock.advance(PERIOD);
        let soon = self.soon();
        self.faulty.read(soon).unwrap()
    }

    fn apply(&mut self, x_mm: f64) -> Result<(), Fault> {
        let soon = self.soon();
        self.faulty.apply(&place(x_mm, -x_mm), soon)
    }

    fn truth(&self) -> [f64; 2] {
        let applied = self.controls.axes.applied();
        [applied[0], applied[1]]
    }
}

#[test]
fn a_false_read_back_lasts_as_requested() {
    for lie in Lie::ALL {
        let mut rig = Rig::new(Faults::default());
        rig.apply(0.020).unwrap();
        rig.read();
        rig.apply(0.040).unwrap();
        let truth = place(0.040, -0.040);
        rig.faulty.inject(Injection::Lie { lie, readings: 3 });
        let mut lies = 0;
        for reading in 0..6 {
            let reported = rig.read().applied.unwrap();
            // A torn read-back differs from the true one only if a value has changed.
            lies += u32::from(reported != truth);
            assert!(reading < 3 || reported == truth, "{lie:?} in reading {reading}");
        }
        let most = if lie == Lie::Torn { 1 } else { 3 };
        assert_eq!(lies, most, "{lie:?}");
        assert_eq!(rig.truth(), [0.040, -0.040], "it is the answer that lies");
    }
}

#[test]
fn a_constant_read_back_hides_changes() {
    let mut rig = Rig::new(Faults::default());
    rig.apply(0.010).unwrap();
    rig.faulty.inject(Injection::Constant { readings: 5 });
    for reading in 0..5 {
        assert_eq!(rig.read().applied.unwrap()[0], 0.010);
        rig.apply(0.020 + 0.001 * f64::from(reading)).unwrap();
    }
    assert!((rig.read().applied.unwrap()[0] - 0.024).abs() < 1e-12);
}

/// A write from before an outage arrives after the outage, when the axis is at another position. This has happened on a
/// real machine.
#[test]
fn a_late_write_arrives_after_the_requested_calls_and_survives_an_outage() {
    let mut rig = Rig::new(Faults::default());
    rig.faulty.inject(Injection::LateWrite { calls: 3 });
    rig.apply(0.050).unwrap();
    assert_eq!(rig.truth(), [0.0, 0.0], "reported as written, but not applied");
    rig.faulty.inject(Injection::Disconnect { calls: 100 });
    for _ in 0..100 {
        let soon = rig.soon();
        assert_eq!(rig.faulty.read(soon), Err(Fault::NotConnected));
    }
    rig.read();
    rig.apply(0.001).unwrap();
    assert_eq!(rig.truth(), [0.001, -0.001]);
    rig.read();
    assert_eq!(rig.truth(), [0.050, -0.050], "the third call");
    rig.read();
    rig.apply(0.002).unwrap();
    assert_eq!(rig.truth(), [0.002, -0.002], "only once");
}

#[test]
fn writes_are_doubled_torn_and_reordered() {
    let mut rig = Rig::new(Faults::default());
    rig.faulty.inject(Injection::DoubleWrite { calls: 2 });
    rig.apply(0.010).unwrap();
    rig.apply(0.020).unwrap();
    assert_eq!(rig.truth(), [0.020, -0.020]);
    rig.read();
    assert_eq!(rig.truth(), [0.010, -0.010], "the second time");
    rig.faulty.inject(Injection::TornWrite);
    rig.apply(0.030).unwrap();
    // At least the first axis has its new correction, but not all axes have.
    assert_eq!(rig.truth()[0], 0.030);
    rig.read();
    assert_eq!(rig.truth(), [0.030, -0.030], "the rest came with the next call");
    rig.faulty.inject(Injection::ReorderedWrite);
    rig.apply(0.040).unwrap();
    assert_eq!(rig.truth(), [0.030, -0.030]);
    rig.read();
    rig.apply(0.050).unwrap();
    assert_eq!(rig.truth(), [0.040, -0.040], "the first one arrived last");
    rig.faulty.inject(Injection::LateWrite { calls: 1000 });
    rig.apply(0.060).unwrap();
    rig.faulty.inject(Injection::Release);
    rig.read();
    assert_eq!(rig.truth(), [0.060, -0.060]);
}

/// The program pauses between read and write. Time passes, and a write after its deadline is not sent.
#[test]
fn the_program_stops_between_reading_and_writing() {
    let mut rig = Rig::new(Faults::default());
    let stop = Duration::from_secs(2);
    rig.faulty.inject(Injection::StopAfterRead(stop));
    let snapshot = rig.read();
    assert_eq!(rig.clock.now() - snapshot.taken, stop, "its age is seen");
    rig.faulty.inject(Injection::StopBeforeWrite(stop));
    let before = rig.clock.elapsed();
    assert_eq!(rig.apply(0.040), Err(Fault::TimedOut));
    assert_eq!(rig.clock.elapsed(), before + stop);
    assert_eq!(rig.truth(), [0.0, 0.0]);
    rig.faulty.inject(Injection::StopBeforeWrite(Duration::from_millis(1)));
    rig.apply(0.040).unwrap();
    assert_eq!(rig.truth(), [0.040, -0.040]);
    // The pause calls a function instead of advancing the clock.
    let stood = Arc::new(Mutex::new(Vec::new()));
    let kept = Arc::clone(&stood);
    let (controller, _, _) = machine(Clock::manual()).start();
    let mut faulty = Faulty::new(controller, Faults::default(), 1)
        .with_pause(move |time| kept.lock().unwrap().push(time));
    faulty.inject(Injection::StopAfterRead(stop));
    faulty.read(Instant::now() + PERIOD).unwrap();
    assert_eq!(*stood.lock().unwrap(), [stop]);
}

#[test]
fn a_late_response_meets_the_deadline_and_states_its_age() {
    let mut rig = Rig::new(Faults::default());
    rig.faulty.inject(Injection::LateAnswer(Duration::from_secs(10)));
    rig.clock.advance(PERIOD);
    let (requested, deadline) = (rig.clock.now(), rig.soon());
    let snapshot = rig.faulty.read(deadline).unwrap();
    assert!(rig.clock.now() < deadline && rig.clock.now() > requested + PERIOD / 2);
    assert!(snapshot.taken <= requested + snapshot.uncertainty);
    assert_eq!(rig.read().uncertainty, Duration::ZERO);
}

#[test]
fn positions_freeze_with_fresh_times_flicker_and_lag() {
    let mut rig = Rig::new(Faults::default());
    rig.read();
    rig.faulty.inject(Injection::FrozenPositions { readings: 4 });
    let first = rig.read();
    for _ in 0..3 {
        let again = rig.read();
        assert_eq!(again.positions, first.positions);
        assert_eq!(again.taken, rig.clock.now(), "the time is fresh");
    }
    assert_ne!(rig.read().positions, first.positions);
    rig.controls.feed_hold.store(true, Ordering::Relaxed);
    let stood = rig.read().positions;
    rig.faulty.inject(Injection::Flicker { axis: 1 });
    let flickered = rig.read().positions;
    assert!((flickered[1] - stood[1] - 0.001).abs() < 1e-12 && flickered[0] == stood[0]);
    assert_eq!(rig.read().positions, stood);
    // The position of Y includes a correction only from the fourth reading on.
    rig.faulty.inject(Injection::Lag(3));
    rig.apply(0.010).unwrap();
    let shown: Vec<bool> =
        (0..5).map(|_| (rig.read().positions[1] - stood[1] + 0.010).abs() < 1e-12).collect();
    assert_eq!(shown, [false, false, false, true, true]);
}

#[test]
fn a_dropped_flag_hides_an_interlock() {
    let mut rig = Rig::new(Faults::default());
    rig.controls.emergency_stop.store(true, Ordering::Relaxed);
    rig.faulty.inject(Injection::DroppedFlag { readings: 2 });
    let shown: Vec<bool> = (0..4).map(|_| rig.read().state.emergency_stop).collect();
    assert_eq!(shown, [false, false, true, true]);
}

/// Faults can be requested while another thread owns the device, as the control thread does. At most 64 requests are
/// queued.
#[test]
fn faults_can_be_requested_remotely() {
    let mut rig = Rig::new(Faults::default());
    let remote = rig.faulty.remote();
    std::thread::spawn(move || {
        assert!(remote.inject(Injection::Faults(Faults { drop: 1.0, ..Faults::default() })));
        for _ in 0..63 {
            assert!(remote.inject(Injection::TornWrite));
        }
        assert!(!remote.inject(Injection::TornWrite), "at most 64 are queued");
    })
    .join()
    .unwrap();
    let soon = rig.soon();
    assert_eq!(rig.faulty.read(soon), Err(Fault::TimedOut));
}

/// A control program that reports the number of its scans and a sum of the words received.
#[derive(Default)]
struct Counting(u16);

impl ControlProgram for Counting {
    fn scan(&mut self, mailboxes: &[&[u16]], _: bool) -> Words {
        self.0 += 1;
        let first = mailboxes[0].first().copied().unwrap_or(0);
        let last = mailboxes[0].last().copied().unwrap_or(0);
        Words::new(&[self.0, first, last, 0xabcd]).unwrap()
    }

    fn applied(&self) -> PerChannel<i16> {
        PerChannel::default()
    }

    fn restart(&mut self, _: &PerChannel<i16>) {}
}

#[test]
fn reports_and_frames_are_falsified_by_word() {
    let clock = Clock::manual();
    let scan = Duration::from_millis(2);
    let (controller, _, _) = machine(clock.clone()).start_with(Box::<Counting>::default(), scan);
    let mut faulty = Faulty::new(controller, Faults::default(), 3).with_clock(clock.clone());
    let read = |faulty: &mut Faulty<SimulatedController>| {
        clock.advance(scan * 2);
        let snapshot = faulty.read(clock.now() + PERIOD).unwrap();
        assert_eq!(snapshot.applied, None);
        snapshot.report.unwrap()
    };
    let soon = Instant::now() + PERIOD;
    let frame = |word: u16| Words::new(&[word; 6]).unwrap();
    faulty.post(&frame(1), soon).unwrap();
    for lie in Lie::ALL {
        let before = read(&mut faulty);
        faulty.inject(Injection::Lie { lie, readings: 1 });
        let reported = read(&mut faulty);
        let after = read(&mut faulty);
        assert_eq!(after.as_slice()[0], before.as_slice()[0] + 4);
        let truth = [before.as_slice()[0] + 2, 1, 1, 0xabcd];
        // A torn report equals the true report if only the scan number has changed.
        assert!(reported.as_slice() != truth || lie == Lie::Torn, "{lie:?}");
    }
    faulty.inject(Injection::Constant { readings: 3 });
    let first = read(&mut faulty);
    assert_eq!([read(&mut faulty), read(&mut faulty)], [first, first]);
    faulty.inject(Injection::TornWrite);
    faulty.post(&frame(2), soon).unwrap();
    clock.advance(scan);
    let seen = faulty.device.read(soon).unwrap().report.unwrap();
    assert_eq!(seen.as_slice()[1..3], [2, 1], "new words, then old ones");
    assert_eq!(read(&mut faulty).as_slice()[1..3], [2, 1], "the rest is just arriving");
    assert_eq!(read(&mut faulty).as_slice()[1..3], [2, 2]);
}

#[test]
fn all_faults_together_are_seeded() {
    let often = 0.05;
    let faults = Faults {
        drop: often,
        corrupt: often,
        freeze: often,
        disconnect: often,
        calls: 5,
        lie: often,
        constant: often,
        late_write: often,
        double_write: often,
        torn_write: often,
        reordered_write: often,
        late_answer: often,
        frozen_positions: often,
        stop_after_read: often,
        stop_before_write: often,
        stop: Duration::from_millis(500),
        dropped_flag: often,
        flicker: often,
        lag: 2,
        ..Faults::default()
    };
    let run = |seed: u64| {
        let mut rig = Rig::new(faults);
        rig.faulty = Faulty::new(machine(rig.clock.clone()).start().0, faults, seed)
            .with_clock(rig.clock.clone());
        let mut seen = Vec::new();
        for cycle in 0..3000 {
            rig.clock.advance(PERIOD);
            let soon = rig.soon();
            let read = rig.faulty.read(soon);
            let wrote = rig.apply(0.001 * f64::from(cycle % 100));
            let reported =
                read.map(|s| (s.positions[0].to_bits(), s.applied.map(|a| a[0].to_bits())));
            seen.push((reported, wrote, rig.clock.elapsed()));
        }
        seen
    };
    let first = run(7);
    assert!(first == run(7) && first != run(8));
    let answered = first.iter().filter(|(read, ..)| read.is_ok()).count();
    assert!((1500..2900).contains(&answered), "{answered}");
}

/// Injected faults of digital lines: part of a write arrives first, and a write arrives late.
#[test]
fn lines_are_written_torn_and_late() {
    struct Port(u64);
    impl DigitalIo for Port {
        fn device(&self) -> &'static str {
            "port"
        }
        fn inputs(&self) -> u32 {
            8
        }
        fn outputs(&self) -> u32 {
            8
        }
        fn shortest_cycle(&self) -> Duration {
            Duration::ZERO
        }
        fn read(&mut self, _: Instant) -> Result<InputLevels, Fault> {
            Ok(InputLevels::now(self.0))
        }
        fn write(&mut self, levels: u64, _: Instant) -> Result<(), Fault> {
            self.0 = levels;
            Ok(())
        }
        fn confirmed(&self) -> Option<u64> {
            Some(self.0)
        }
    }
    let soon = Instant::now() + Duration::from_secs(1);
    let mut faulty = Faulty::new(Port(0), Faults::default(), 5);
    faulty.write(0xff, soon).unwrap();
    faulty.inject(Injection::LateWrite { calls: 2 });
    faulty.write(0x00, soon).unwrap();
    assert_eq!(faulty.read(soon).unwrap().levels, 0xff);
    assert_eq!(faulty.read(soon).unwrap().levels, 0x00);
    let mut mixed = 0;
    for _ in 0..50 {
        faulty.write(0x00, soon).unwrap();
        faulty.inject(Injection::TornWrite);
        faulty.write(0xff, soon).unwrap();
        mixed += u32::from(faulty.device.0 != 0xff);
        assert_eq!(faulty.read(soon).unwrap().levels, 0xff);
    }
    assert!(mixed > 10, "{mixed}");
}

#[test]
fn a_sensor_jump_persists() {
    let (_, thermometer, _) = machine(Clock::manual()).start();
    let mut faulty = Faulty::new(thermometer, Faults::default(), 1);
    faulty.inject(Injection::Jump { sensor: 0, kelvin: 40.0 });
    assert_eq!(faulty.latest()[0].degc, Some(60.0));
    assert_eq!(faulty.latest()[0].degc, Some(60.0));
    faulty.inject(Injection::Jump { sensor: 0, kelvin: 0.0 });
    assert_eq!(faulty.latest()[0].degc, Some(20.0));
}
