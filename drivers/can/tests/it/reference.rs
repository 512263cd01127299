//! Words of the shipped file with the reference barrier: a scanning control, a gateway, and a bus that loses messages.

use std::time::{Duration, Instant};

use volcomp_can::{BARRIER_DBC, CanController, SignalTable};
use volcomp_guard::{
    barrier::{Barrier, FRAME_WORDS, REPORT_WORDS, Report, Settings},
    protocol::{Counts, Layout, Refusal, ReportStatus, Session},
};
use volcomp_port::{Controller, Words};
use volcomp_vocabulary::{AxisName, PerChannel};

use crate::{Bus, barrier::report_of, config, frame_of, soon};

const AXES: [AxisName; 3] = [AxisName::X, AxisName::Y, AxisName::Z];
const MACHINE: u16 = 4711;
const RATE: i16 = 3;

fn layout() -> Layout {
    Layout::of(AXES).unwrap()
}

/// A control on the bus: its mailbox, its barrier and its published reports.
struct Control {
    table: SignalTable,
    bus: Bus,
    barrier: Barrier,
    settings: Settings,
    mailbox: [u16; 9],
    /// Last received counter of each of the three messages of a frame.
    counters: [Option<u64>; 3],
    /// Content of the mailbox when the three counters were last equal.
    copied: [u16; 9],
    published: Vec<Report>,
    counter: u64,
}

impl Control {
    fn new(bus: &Bus) -> Self {
        let settings = Settings {
            axes: layout(),
            machine: MACHINE,
            limit: PerChannel::from_fn(|_| 150),
            rate: PerChannel::from_fn(|_| RATE),
            step_scans: 1,
            hold_scans: 5,
            time_out_scans: 12,
        };
        Self {
            table: SignalTable::parse(BARRIER_DBC).unwrap(),
            bus: bus.clone(),
            barrier: Barrier::start(settings, 6, 0, &Counts::default()).unwrap(),
            settings,
            mailbox: [0; 9],
            counters: [None; 3],
            copied: [0; 9],
            published: Vec::new(),
            counter: 0,
        }
    }

    /// Receives messages, runs one scan, and sends positions and report. `is_lost` selects the lost messages.
    fn scan(&mut self, mut is_lost: impl FnMut() -> bool) {
        for frame in self.bus.sent() {
            if is_lost() {
                continue;
            }
            let message = &self.table.messages[self.table.message_of(&frame).unwrap()];
            assert!(message.is_whole(frame.data()));
            for signal in &message.signals {
                if let Some(number) = signal.name.strip_prefix("FRAME_") {
                    let word = u16::try_from(signal.raw(frame.data())).unwrap();
                    self.mailbox[number.parse::<usize>().unwrap()] = word;
                }
            }
            let part = usize::try_from(frame.id - 272).unwrap();
            self.counters[part] = message.counter(frame.data());
            if self.counters == [self.counters[0]; 3] {
                self.copied = self.mailbox;
            }
        }
        let before = self.barrier.report().applied;
        let report = self.barrier.scan(&[&self.copied], false);
        for axis in 0..3 {
            let moved = report.applied[axis] - before[axis];
            assert!(moved.abs() <= RATE, "axis {axis} made a step of {moved}");
        }
        self.published.push(report);
        self.counter += 1;
        let counter = self.counter % 16;
        let mut frames = vec![
            frame_of(&self.table, "POSITION_XY", &[("X_POS", 1.0)], counter),
            frame_of(&self.table, "POSITION_Z", &[], counter),
            frame_of(&self.table, "STATE", &[("REFERENCED", 1.0)], counter),
        ];
        let mut words = [0; REPORT_WORDS];
        let count = report.encode(&mut words);
        frames.extend(report_of(&self.table, &words[..count], counter));
        for frame in frames {
            if !is_lost() {
                self.bus.deliver(frame);
            }
        }
    }
}

fn late() -> Instant {
    Instant::now() + Duration::from_secs(5)
}

/// A gateway that answers each new complete report with a frame.
struct Gateway {
    controller: CanController<Bus>,
    session: Session,
    landed: u32,
}

impl Gateway {
    fn new(bus: &Bus) -> Self {
        let config = config(BARRIER_DBC, &AXES);
        Self {
            controller: CanController::new(bus.clone(), &config).unwrap(),
            session: Session::new(0x5a5a),
            landed: 0,
        }
    }

    /// Answers a new complete report with a frame of these counts. Returns the report.
    fn answers(&mut self, settings: &Settings, values: [i16; 3]) -> Option<Report> {
        let snapshot = self.controller.read(soon()).ok()?;
        let report = Report::decode(MACHINE, layout(), snapshot.report?.as_slice())?;
        let ReportStatus::Confirmed { landed, .. } = self.session.read(report.head()) else {
            return None;
        };
        self.landed += u32::from(landed);
        let frame = self.session.frame(&PerChannel::leading(values))?;
        let mut words = [0; FRAME_WORDS];
        let count = frame.encode(settings, &mut words);
        let words = Words::new(&words[..count]).unwrap();
        self.controller.post(&words, late()).unwrap();
        Some(report)
    }
}

#[test]
fn frames_arrive_and_silence_ramps_to_zero() {
    let bus = Bus::default();
    let (mut control, mut gateway) = (Control::new(&bus), Gateway::new(&bus));
    let wanted = [40, -150, 7];
    for _ in 0..80 {
        control.scan(|| false);
        let accepted = gateway.answers(&control.settings, wanted).unwrap();
        assert_eq!(Some(&accepted), control.published.last());
    }
    let report = control.barrier.report();
    assert_eq!(report.applied[..3], wanted);
    assert_eq!((report.refusal, report.owner), (Refusal::None, 0x5a5a));
    assert!(gateway.landed >= 78, "{}", gateway.landed);
    // Without frames all axes are at zero after the timeout and 150/3 steps of the ramp.
    for _ in 0..63 {
        control.scan(|| false);
    }
    assert_eq!(control.barrier.report().applied, Counts::default());
}

/// Messages are lost at random, which tears frames and reports. Every accepted report equals a published one, and the
/// axes keep the barrier's rate and limit. Without message counters the checksum of the words would accept some torn
/// reports.
#[test]
fn torn_words_are_rejected() {
    for (percent, kept) in [(1, 0.99), (10, 0.9), (40, 0.6)] {
        let bus = Bus::default();
        let (mut control, mut gateway) = (Control::new(&bus), Gateway::new(&bus));
        let mut seed = 0x9e37_79b9_7f4a_7c15_u64 + percent;
        let mut random = || {
            seed ^= seed << 13;
            seed ^= seed >> 7;
            seed ^= seed << 17;
            seed >> 33
        };
        let mut accepted = 0;
        for round in 0..3000_i16 {
            control.scan(|| random() % 100 < percent);
            let away = if round / 100 % 2 == 0 { 100 } else { -100 };
            let values = [away, round % 150, -(round % 90)];
            if let Some(report) = gateway.answers(&control.settings, values) {
                assert!(control.published.contains(&report), "this report was never published");
                accepted += 1;
            }
        }
        // All seven messages of a report arrive in (1 − p)⁷ of the scans. The test requires two thirds of that share.
        let least = 0.67 * 3000.0 * f64::powi(kept, 7);
        assert!(f64::from(accepted) >= least, "{accepted} at {percent} % lost, expected {least}");
        assert!(percent > 10 || gateway.landed > 300, "{}", gateway.landed);
    }
}
