//! The words of the shipped file against the reference of the barrier: a control that scans, a gateway that answers, and a
//! bus that loses messages.

use std::time::{Duration, Instant};

use volcomp_can::{BARRIER_DBC, BridgeConfig, CanController, SignalTable};
use volcomp_guard::{
    barrier::{Barrier, FRAME_WORDS, REPORT_WORDS, Report, Settings},
    protocol::{Counts, Layout, Refusal, ReportStatus, Session},
};
use volcomp_port::{Controller, Words};
use volcomp_vocabulary::{AxisName, PerChannel};

use crate::{Bus, barrier::report_of, frame_of, soon};

const MACHINE: u16 = 4711;
const RATE: i16 = 3;

fn layout() -> Layout {
    Layout::of([AxisName::X, AxisName::Y, AxisName::Z]).unwrap()
}

/// A control on the bus: its mailbox, its barrier, and the reports that it has published.
struct Control {
    table: SignalTable,
    bus: Bus,
    barrier: Barrier,
    settings: Settings,
    mailbox: [u16; 9],
    /// The counters of the three messages of a frame that came last.
    counters: [Option<u64>; 3],
    /// What lay in the mailbox when all three had come with the same counter.
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

    /// Takes the messages that came, scans once, and sends positions and report, without those that are lost.
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
                self.bus.comes(frame);
            }
        }
    }
}

/// What is only sent waits for nothing but a processor.
fn late() -> Instant {
    Instant::now() + Duration::from_secs(5)
}

/// A gateway that reads, and answers a new whole report with these counts.
struct Gateway {
    controller: CanController<Bus>,
    session: Session,
    landed: u32,
}

impl Gateway {
    fn new(bus: &Bus) -> Self {
        let config = BridgeConfig {
            table: SignalTable::parse(BARRIER_DBC).unwrap(),
            channel: "bridge".to_owned(),
            axes: vec![AxisName::X, AxisName::Y, AxisName::Z],
            reads: Vec::new(),
            includes_correction: false,
        };
        Self {
            controller: CanController::new(bus.clone(), &config).unwrap(),
            session: Session::new(0x5a5a),
            landed: 0,
        }
    }

    /// What the last whole report says, when it was new.
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
fn frames_land_and_a_silent_gateway_ends_at_zero() {
    let bus = Bus::default();
    let (mut control, mut gateway) = (Control::new(&bus), Gateway::new(&bus));
    let wanted = [40, -150, 7];
    for _ in 0..80 {
        control.scan(|| false);
        let told = gateway.answers(&control.settings, wanted).unwrap();
        assert_eq!(Some(&told), control.published.last());
    }
    let report = control.barrier.report();
    assert_eq!(report.applied[..3], wanted);
    assert_eq!((report.refusal, report.owner), (Refusal::None, 0x5a5a));
    assert!(gateway.landed >= 78, "{}", gateway.landed);
    // Nobody answers any more: after the time-out and 150/3 steps all axes are at zero.
    for _ in 0..63 {
        control.scan(|| false);
    }
    assert_eq!(control.barrier.report().applied, Counts::default());
}

/// Messages are lost at random, so frames and reports are torn: no report is believed that the control did not publish, and
/// the axes stay within rate and limit. The checksum in the words alone, without the counters of the messages, lets some pass.
#[test]
fn torn_words_are_believed_by_nobody() {
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
        let mut told = 0;
        for round in 0..3000_i16 {
            control.scan(|| random() % 100 < percent);
            let away = if round / 100 % 2 == 0 { 100 } else { -100 };
            let values = [away, round % 150, -(round % 90)];
            if let Some(report) = gateway.answers(&control.settings, values) {
                assert!(
                    control.published.contains(&report),
                    "it was never published"
                );
                told += 1;
            }
        }
        // All seven messages of a report have come in (1 − p)⁷ of all scans; a third less is asked for.
        let least = 0.67 * 3000.0 * f64::powi(kept, 7);
        assert!(
            f64::from(told) >= least,
            "{told} at {percent} % lost, expected {least}"
        );
        assert!(percent > 10 || gateway.landed > 300, "{}", gateway.landed);
    }
}
