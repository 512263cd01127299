//! Single rules of the barrier, with one mailbox and with several: frames, reports, words on digital lines.
//!
//! Random worlds and an exhaustive search are in the submodules.

mod explored;
mod random;
mod simulated;
mod text;

use std::time::Duration;

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_guard::{
    BarrierLink, CorrectionReport, Limits, ReadBack,
    barrier::{
        Barrier, DigitalLines, FRAME_WORDS, Frame, REPORT_WORDS, Report, Settings, SettingsError,
    },
    protocol::{
        Checksum, Counts, Head, Layout, LayoutError, Refusal, ReportStatus, Session, checksum,
    },
    vocabulary::{AxisName, PerChannel},
};

use crate::world::SCAN;

pub(super) fn layout(axes: usize) -> Layout {
    Layout::of(AxisName::ALL[..axes].iter().copied()).expect("each once")
}

/// A barrier with a limit of 20 counts and a rate of 2 counts per scan.
pub(super) fn settings(axes: usize) -> Settings {
    Settings {
        axes: layout(axes),
        machine: 4711,
        limit: PerChannel::from_fn(|_| 20),
        rate: PerChannel::from_fn(|_| 2),
        step_scans: 1,
        hold_scans: 5,
        time_out_scans: 12,
    }
}

pub(super) fn at_zero(settings: Settings) -> Barrier {
    Barrier::start(settings, 6, 1000, &Counts::default()).expect("valid")
}

pub(super) fn words(settings: &Settings, frame: &Frame) -> Vec<u16> {
    let mut words = [0; FRAME_WORDS];
    let count = frame.encode(settings, &mut words);
    words[..count].to_vec()
}

fn values(values: &[i16]) -> Counts {
    PerChannel::from_fn(|axis| values.get(axis).copied().unwrap_or(0))
}

/// A barrier that has accepted one frame of owner 7, the session of its sender, and the next report.
fn held(settings: Settings) -> (Barrier, Session, Report) {
    let mut barrier = at_zero(settings);
    let mut sender = Session::new(7);
    let report = barrier.scan(&[], false);
    assert_eq!(
        sender.read(report.head()),
        ReportStatus::Confirmed { landed: false, epoch_began: true }
    );
    let frame = sender.frame(&Counts::default()).expect("a report was read");
    let report = barrier.scan(&[&words(&settings, &frame)], false);
    assert_eq!(report.owner, 7);
    (barrier, sender, report)
}

#[test]
fn each_wrong_frame_is_refused_with_its_reason() {
    type Case = (fn(&mut Frame), Refusal);
    let settings = settings(3);
    let (barrier, _, report) = held(settings);
    let good = Frame {
        head: Head { sequence: report.sequence.wrapping_add(1), owner: 7, ..report.head() },
        values: [0; 9],
    };
    let cases: [Case; 11] = [
        (|_| {}, Refusal::None),
        (|frame| add(&mut frame.head.epoch, -1), Refusal::Epoch),
        (|frame| frame.head.owner = 8, Refusal::Owner),
        (|frame| frame.head.owner = 0, Refusal::Owner),
        // The barrier checks the frame one scan after the report.
        (|frame| add(&mut frame.head.tick, -4), Refusal::None),
        (|frame| add(&mut frame.head.tick, -5), Refusal::Tick),
        (|frame| add(&mut frame.head.tick, 2), Refusal::Tick),
        // Sequences are relative to the next sequence number.
        (|frame| add(&mut frame.head.sequence, -2), Refusal::Sequence),
        (|frame| add(&mut frame.head.sequence, i16::MAX - 1), Refusal::None),
        (|frame| add(&mut frame.head.sequence, i16::MAX), Refusal::Sequence),
        (|frame| frame.values[2] = -21, Refusal::Value),
    ];
    for (change, expected) in cases {
        let (mut barrier, mut frame) = (barrier, good);
        change(&mut frame);
        let after = barrier.scan(&[&words(&settings, &frame)], false);
        assert_eq!(after.refusal, expected, "{frame:?}");
        let taken = barrier.memory().link.silent == 0;
        assert_eq!(taken, expected == Refusal::None, "{frame:?}");
    }
}

fn add(counter: &mut u16, by: i16) {
    *counter = counter.wrapping_add_signed(by);
}

#[test]
fn a_frame_for_another_machine_or_other_axes_is_rejected() {
    let three = settings(3);
    let (mut barrier, mut sender, _) = held(three);
    let report = barrier.report();
    sender.read(barrier.scan(&[], false).head());
    let frame = sender.frame(&values(&[1, 2, 3])).expect("a report was read");
    let of = |axes| Settings { axes: Layout::of(axes).expect("each once"), ..three };
    for other in [
        Settings { machine: 4712, ..three },
        settings(2),
        settings(4),
        // Frames for Y X Z or X Y A have as many words as frames for X Y Z, but would move other axes.
        of([AxisName::Y, AxisName::X, AxisName::Z]),
        of([AxisName::X, AxisName::Y, AxisName::A]),
    ] {
        let after = barrier.scan(&[&words(&other, &frame)], false);
        assert_eq!(after.refusal, Refusal::Checksum);
        let mut words = [0; REPORT_WORDS];
        let length = after.encode(&mut words);
        assert!(Report::decode(three.machine, three.axes, &words[..length]).is_some());
        assert_eq!(Report::decode(other.machine, other.axes, &words[..length]), None);
    }
    assert_eq!(barrier.report().sequence, report.sequence);
}

#[test]
fn all_axes_move_on_one_line_at_the_rate_of_the_slowest() {
    let settings = settings(3);
    let (mut barrier, mut sender, _) = held(settings);
    sender.read(barrier.scan(&[], false).head());
    let goal = [20, -10, 3];
    let frame = sender.frame(&values(&goal)).expect("a report was read");
    let words = words(&settings, &frame);
    for scan in 1..=10_i16 {
        // The words of the same frame stay in the mailbox.
        let applied = barrier.scan(&[&words], false).applied;
        for (axis, goal) in goal.iter().enumerate() {
            let line = f64::from(*goal) * f64::from(scan) / 10.0;
            assert!(
                (f64::from(applied[axis]) - line).abs() < 1.0,
                "axis {axis}, scan {scan}: {applied:?}"
            );
        }
    }
    assert_eq!(barrier.report().applied, values(&goal));
}

#[test]
fn without_frames_it_goes_to_zero_and_rejects_earlier_frames() {
    let settings = settings(2);
    let (mut barrier, mut sender, _) = held(settings);
    let mut last = Vec::new();
    for _ in 0..20 {
        let seen = sender.read(barrier.scan(&[&last], false).head());
        assert!(matches!(seen, ReportStatus::Confirmed { .. }));
        last = words(&settings, &sender.frame(&values(&[20, -8])).expect("a report was read"));
    }
    let before = barrier.report();
    assert_eq!(before.applied, values(&[20, -8]));
    // The last frame stays in the mailbox, and no other frame follows.
    let begun = barrier.scan(&[&last], false);
    let mut scans = 0;
    while barrier.report().applied != Counts::default() {
        barrier.scan(&[&last], false);
        scans += 1;
    }
    let bound = settings.time_out_scans + 20 / 2;
    assert!(scans <= bound, "{scans} scans");
    let after = barrier.report();
    assert_eq!((after.epoch, after.owner), (begun.epoch.wrapping_add(1), 0));
    // A frame is checked once in each mailbox.
    assert_eq!(after.refusal, Refusal::None);
    let after = barrier.scan(&[&last, &last], false);
    assert_eq!((after.refusal, after.owner), (Refusal::Epoch, 0));
}

#[test]
fn an_interlock_holds_and_does_not_stop_the_time_out() {
    let settings = settings(1);
    let (mut barrier, mut sender, _) = held(settings);
    sender.read(barrier.scan(&[], false).head());
    let frame = words(&settings, &sender.frame(&values(&[20])).expect("a report was read"));
    barrier.scan(&[&frame], false);
    let stood = barrier.report().applied;
    for _ in 0..100 {
        assert_eq!(barrier.scan(&[&frame], true).applied, stood);
    }
    assert_eq!(barrier.report().owner, 0, "timed out under the interlock");
    let mut before = stood[0];
    for _ in 0..100 {
        let now = barrier.scan(&[&frame], false).applied[0];
        assert!((0..=2).contains(&(before - now)));
        before = now;
    }
    assert_eq!(before, 0);
}

#[test]
fn invalid_axis_words_at_the_start_ramp_to_zero() {
    let mut barrier = Barrier::start(settings(2), 3, 0, &values(&[i16::MIN, 5000])).expect("valid");
    let mut before = barrier.report().applied;
    assert_eq!(before, values(&[i16::MIN, 5000]));
    for _ in 0..20_000 {
        let now = barrier.scan(&[&[0; 20]], false).applied;
        for axis in 0..2 {
            assert!((i32::from(now[axis]) - i32::from(before[axis])).abs() <= 2);
        }
        before = now;
    }
    assert_eq!(before, Counts::default());
}

#[test]
fn rates_below_one_count_per_scan() {
    let slow = Settings { step_scans: 7, rate: PerChannel::from_fn(|_| 1), ..settings(1) };
    let mut barrier = at_zero(slow);
    let mut sender = Session::new(1);
    let (mut frame, mut applied) = (Vec::new(), Vec::new());
    for scan in 0..70 {
        let report = barrier.scan(&[&frame], false);
        applied.push(report.applied[0]);
        sender.read(report.head());
        // The goal changes in every scan: the line restarts each time and still progresses.
        let goal = 15 + scan % 2;
        frame = words(&slow, &sender.frame(&values(&[goal])).expect("a report was read"));
    }
    assert_eq!(applied[69], 10, "{applied:?}");
    for window in applied.windows(7) {
        assert!(window[6] - window[0] <= 1);
    }
}

#[test]
fn a_sender_waits_for_another_and_for_its_own_previous_run() {
    let settings = settings(1);
    let (mut barrier, mut first, _) = held(settings);
    let mut second = Session::new(8);
    let report = barrier.scan(&[], false);
    assert_eq!(second.read(report.head()), ReportStatus::Held { owner: 7 });
    assert_eq!(second.frame(&values(&[1])), None);
    assert_eq!(
        first.read(report.head()),
        ReportStatus::Confirmed { landed: true, epoch_began: false }
    );
    assert_eq!(first.read(report.head()), ReportStatus::Old);
    // The first sender has stopped, and the second waits for the timeout.
    let mut waited = 0;
    loop {
        let report = barrier.scan(&[], false);
        waited += 1;
        if let ReportStatus::Confirmed { epoch_began, landed } = second.read(report.head()) {
            assert!(epoch_began && !landed);
            break;
        }
    }
    assert!(waited <= settings.time_out_scans);
    assert!(second.frame(&values(&[1])).is_some());
}

#[test]
fn invalid_settings_are_refused() {
    type Case = (fn(&mut Settings), SettingsError);
    assert_eq!(Layout::of([]), Err(LayoutError::NoAxes));
    let twice = [AxisName::X, AxisName::Y, AxisName::X];
    let axis = AxisName::X;
    assert_eq!(Layout::of(twice), Err(LayoutError::Twice { axis }));
    let time_out = |hold, time_out| SettingsError::TimeOut { hold, time_out };
    let counts = |axis, found| SettingsError::Counts { axis, found };
    let cases: [Case; 7] = [
        // The checksum cannot distinguish this machine number from 0.
        (|s| s.machine = 65_535, SettingsError::Machine { found: 65_535 }),
        (|s| s.rate[1] = 0, counts(1, 0)),
        (|s| s.limit[2] = -1, counts(2, -1)),
        (|s| s.step_scans = 0, SettingsError::StepScans),
        (|s| s.time_out_scans = 9, time_out(5, 9)),
        (|s| s.hold_scans = 0, time_out(0, 12)),
        (|s| s.time_out_scans = 1 << 15, time_out(5, 1 << 15)),
    ];
    for (change, expected) in cases {
        let mut settings = settings(3);
        change(&mut settings);
        let refused = Barrier::start(settings, 0, 0, &Counts::default());
        assert_eq!(refused, Err(expected));
    }
}

/// Reports that are older than the last one are ignored, also across a wrap of the tick.
#[test]
fn a_report_older_than_the_last_one_is_ignored() {
    let (_, mut sender, report) = held(settings(1));
    let mut seen = |ticks: u16| {
        let tick = report.tick.wrapping_add(ticks);
        sender.read((Report { tick, ..report }).head())
    };
    assert_ne!(seen(30_000), ReportStatus::Old);
    assert_eq!(seen(29_999), ReportStatus::Old);
    assert_eq!(seen(0), ReportStatus::Old);
    // The tick wraps.
    assert_ne!(seen(60_000), ReportStatus::Old);
    assert_ne!(seen(65_535), ReportStatus::Old);
    assert_ne!(seen(5), ReportStatus::Old);
    assert_eq!(seen(65_535), ReportStatus::Old);
    let next = Report { epoch: report.epoch.wrapping_add(1), ..report };
    assert_ne!(sender.read(next.head()), ReportStatus::Old, "another epoch");
    sender.forget();
    assert_ne!(sender.read(next.head()), ReportStatus::Old, "after a long silence");
}

/// A repeated report does not refresh the confirmation. After 5 s of silence any tick is accepted, since the tick may have wrapped.
#[test]
fn a_repeated_report_confirms_nothing() {
    let settings = settings(1);
    let link = BarrierLink::new(7, settings.machine, settings.axes, SCAN);
    let mut read_back = ReadBack::barrier(link);
    let (limits, requested) = (one_axis(), PerChannel::from_fn(|_| 0.015));
    let mut hear = |at: Duration, report: &Report| {
        let mut words = [0; REPORT_WORDS];
        let length = report.encode(&mut words);
        read_back.receive(at, at, &CorrectionReport::Barrier(&words[..length]), &limits);
        let confirmed = read_back.status().confirmed.expect("a report");
        let mut frame = [0; FRAME_WORDS];
        let length = read_back.frame(&requested, &limits, &mut frame);
        (confirmed.values[0], frame[..length.unwrap_or(0)].to_vec())
    };
    let mut barrier = at_zero(settings);
    let (mut mailbox, mut reports) = (Vec::new(), Vec::new());
    for cycle in 0..10 {
        let report = barrier.scan(&[&mailbox], false);
        (_, mailbox) = hear(SCAN * cycle, &report);
        reports.push(report);
    }
    let [confirmed, again] = [9, 3].map(|place| hear(SCAN * 10, &reports[place]).0);
    assert!((confirmed - 0.015).abs() < 1e-9 && again == confirmed);
    let late = hear(SCAN * 10 + Duration::from_secs(6), &reports[3]).0;
    assert!(late < 0.01, "{late}");
}

fn one_axis() -> Limits {
    Limits { count: 1, ..crate::world::limits() }
}

/// Answers the current report with a frame: `output` moves to the requested value at half the barrier's rate.
fn answer(barrier: &Barrier, sender: &mut Session, requested: i16, output: &mut i16) -> Vec<u16> {
    let report = barrier.report();
    if let ReportStatus::Confirmed { epoch_began: true, .. } = sender.read(report.head()) {
        *output = report.applied[0];
    }
    *output += (requested - *output).signum();
    let frame = sender.frame(&PerChannel::leading([*output]));
    words(&report.settings, &frame.expect("the control is free"))
}

/// A gateway changes paths, and its last frame stays in the first mailbox. That frame is not accepted again when tick
/// and sequence wrap, about every minute.
#[test]
fn an_old_frame_in_an_unused_mailbox_is_never_accepted_again() {
    // Scans between two frames: tick and sequence wrap at different times.
    for every in [1, 2, 3, 7] {
        let settings = Settings { rate: PerChannel::leading([20]), ..settings(1) };
        let mut barrier = at_zero(settings);
        let mut sender = Session::new(7);
        let (mut first, mut second) = (Vec::new(), Vec::new());
        let mut output = 0;
        barrier.scan(&[], false);
        for scan in 0..200_u32 {
            if scan % every == 0 {
                first = answer(&barrier, &mut sender, 20, &mut output);
            }
            barrier.scan(&[&first, &second], false);
        }
        assert_eq!(barrier.report().applied[0], 20);
        for scan in 0..5 * 65_536_u32 {
            if scan % every == 0 {
                second = answer(&barrier, &mut sender, -20, &mut output);
            }
            let applied = barrier.scan(&[&first, &second], false).applied[0];
            assert!(scan < 300 || applied == -20, "{applied} in scan {scan}");
        }
    }
}

/// A gateway changes paths at random; frames on both paths are lost, late or duplicated. The axis never exceeds its
/// rate, and reaches the requested value.
#[test]
fn one_gateway_alternates_between_two_mailboxes() {
    for seed in 0..200 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let settings = settings(1);
        let mut barrier = at_zero(settings);
        let mut sender = Session::new(7);
        let mut boxes = [Vec::new(), Vec::new()];
        let mut in_transit: Vec<(u32, usize, Vec<u16>)> = Vec::new();
        let (mut output, mut way, mut requested) = (0, 0, 20);
        barrier.scan(&[], false);
        for scan in 0..3000_u32 {
            let calm = scan >= 2500;
            if rng.random_bool(0.02) {
                way = 1 - way;
            }
            if !calm && rng.random_bool(0.01) {
                requested = rng.random_range(-20..=20);
            }
            let frame = answer(&barrier, &mut sender, requested, &mut output);
            if calm || rng.random_bool(0.8) {
                let late = rng.random_bool(if calm { 0.0 } else { 0.1 });
                let late = if late { rng.random_range(0..400) } else { 0 };
                in_transit.push((scan + late, way, frame.clone()));
                if rng.random_bool(0.05) {
                    in_transit.push((scan + rng.random_range(0..400), 1 - way, frame));
                }
            }
            in_transit.retain(|(at, way, frame)| {
                let arrives = *at <= scan;
                if arrives {
                    boxes[*way].clone_from(frame);
                }
                !arrives
            });
            let before = barrier.memory().applied;
            let report = barrier.scan(&[&boxes[0], &boxes[1]], false);
            assert!((report.applied[0] - before[0]).abs() <= settings.rate[0]);
            assert!(report.owner == 7 || report.owner == 0);
        }
        assert_eq!(barrier.report().applied[0], requested, "seed {seed}");
        assert_eq!(barrier.report().applied[1..], Counts::default()[1..]);
    }
}

/// Fletcher's sums by their definition: the second sum weights each word by its distance from the end.
#[test]
fn the_checksum_matches_its_definition() {
    let some = [1_u16, 65535, 40000, 0, 7, 65534, 3];
    let n = some.len() as u64;
    // The layout number of W C V A X B needs more than one word.
    let axes = [AxisName::W, AxisName::C, AxisName::V, AxisName::A, AxisName::X, AxisName::B];
    let machine = 60000 + 968_415_u64 / 65535;
    let layout = 968_415_u64 % 65535;
    let sum = machine + some.iter().map(|w| u64::from(*w)).sum::<u64>();
    let of_sums = layout
        + n * machine
        + some.iter().zip(0..).map(|(w, at)| (n - at) * u64::from(*w)).sum::<u64>();
    let expected = Checksum { sum: (sum % 65535) as u16, of_sums: (of_sums % 65535) as u16 };
    let axes = Layout::of(axes).expect("each once");
    assert_eq!(axes.number(), 968_415);
    assert_eq!(checksum(60000, axes, &some), expected);
}

fn frames() -> impl Strategy<Value = Frame> {
    (any::<[u16; 4]>(), any::<[i16; 9]>())
        .prop_map(|(head, values)| Frame { head: Head::of(head), values })
}

proptest! {
    #[test]
    fn frames_round_trip(axes in 1_usize..=9, frame in frames()) {
        let settings = settings(axes);
        let mut expected = frame;
        expected.values[axes..].fill(0);
        prop_assert_eq!(Frame::decode(&settings, &words(&settings, &frame)), Some(expected));
    }

    #[test]
    fn reports_round_trip(axes in 1_usize..=9, epoch: u16, tick: u16, applied: [i16; 9]) {
        let mut barrier = Barrier::start(settings(axes), epoch, tick, &PerChannel(applied)).expect("valid");
        let report = barrier.scan(&[&[1, 2, 3]], false);
        let mut out = [0; REPORT_WORDS];
        let count = report.encode(&mut out);
        prop_assert_eq!(count, Report::length(layout(axes)));
        prop_assert_eq!(Report::decode(4711, layout(axes), &out[..count]), Some(report));
        prop_assert_eq!(Report::decode(4712, layout(axes), &out[..count]), None);
    }

    #[test]
    fn decoding_arbitrary_words_does_not_panic(axes in 1_usize..=9, some: Vec<u16>) {
        let _ = Frame::decode(&settings(axes), &some);
        let _ = Report::decode(4711, layout(axes), &some);
    }

    /// A frame that is composed of the first words of one frame and the last words of another decodes as one of these
    /// frames, or is rejected.
    #[test]
    fn a_torn_frame_is_one_of_the_two_or_refused(
        one in frames(),
        steps: [i8; 9],
        apart in 1_u16..50,
        torn_at in 1_usize..15,
    ) {
        let settings = settings(9);
        let two = Frame {
            head: Head {
                sequence: one.head.sequence.wrapping_add(apart),
                tick: one.head.tick.wrapping_add(apart),
                ..one.head
            },
            values: core::array::from_fn(|i| one.values[i].wrapping_add(i16::from(steps[i]))),
        };
        let (first, last) = (words(&settings, &one), words(&settings, &two));
        for (a, b) in [(&first, &last), (&last, &first)] {
            let torn: Vec<u16> = a[..torn_at].iter().chain(&b[torn_at..]).copied().collect();
            if let Some(seen) = Frame::decode(&settings, &torn) {
                let near = |whole: &Frame| {
                    // The checksum cannot distinguish the words 0 and -1.
                    seen.values.iter().zip(&whole.values).all(|(s, w)| s.abs_diff(*w) <= 1)
                };
                prop_assert!(near(&one) || near(&two), "{one:?} {two:?} {seen:?}");
            }
        }
    }
}

#[test]
fn an_empty_mailbox_is_no_frame() {
    for axes in 1..=9 {
        for machine in [0, 1, 4711, 65535] {
            let settings = volcomp_guard::barrier::Settings { machine, ..settings(axes) };
            assert_eq!(Frame::decode(&settings, &[0; 15]), None);
            assert_eq!(Frame::decode(&settings, &[]), None);
            assert_eq!(Report::decode(machine, layout(axes), &[0; REPORT_WORDS]), None);
        }
    }
    let mut barrier = Barrier::start(settings(2), 0, 0, &Counts::default()).expect("valid");
    assert_eq!(barrier.scan(&[&[0; 8]], false).owner, 0);
}

const OWNER: u16 = 9;

fn report(epoch: u16, owner: u16, sequence: u16) -> Report {
    Report { epoch, owner, sequence, ..at_zero(settings(1)).report() }
}

#[test]
fn a_report_of_an_unsent_frame_belongs_to_another_sender() {
    // Sent frames (epoch and sequence), the reported frame, and whether the reported frame may be the sender's own.
    type Numbers = (u16, u16);
    let table: [(&[Numbers], Numbers, bool); 17] = [
        (&[], (7, 0), false),
        (&[(7, 1)], (7, 1), true),
        (&[(7, 1)], (7, 2), false),
        // Frames that were lost or are not reported yet.
        (&[(7, 1), (7, 2), (7, 3)], (7, 1), true),
        (&[(7, 1), (7, 2), (7, 3)], (7, 3), true),
        (&[(7, 1), (7, 2), (7, 3)], (7, 4), false),
        // Frames reordered by two paths.
        (&[(7, 3), (7, 2)], (7, 3), true),
        // The sequence number wraps.
        (&[(7, 65_535), (7, 0)], (7, 65_534), true),
        (&[(7, 65_535), (7, 0)], (7, 0), true),
        (&[(7, 65_535), (7, 0)], (7, 1), false),
        (&[(7, 65_535)], (7, 0), false),
        // A new epoch without sent frames, one with sent frames, and a late report of the previous epoch.
        (&[(7, 5)], (8, 5), false),
        (&[(7, 5), (8, 6)], (8, 6), true),
        (&[(7, 5), (8, 6)], (7, 5), true),
        (&[(7, 5), (8, 6)], (7, 6), false),
        // The epoch wraps.
        (&[(65_535, 5), (0, 6)], (1, 6), false),
        // A frame that answers a late report of an old epoch does not displace newer entries.
        (&[(9, 5), (5, 1), (4, 1), (3, 1), (2, 1), (1, 1)], (9, 5), true),
    ];
    for (sent, (epoch, sequence), is_own) in table {
        let mut session = Session::new(OWNER);
        for (epoch, sequence) in sent {
            session.sends(*epoch, *sequence);
        }
        let seen = session.read(report(epoch, OWNER, sequence).head());
        let held = ReportStatus::Held { owner: OWNER };
        assert_eq!(seen != held, is_own, "{sent:?} {epoch} {sequence}: {seen:?}");
        if !is_own {
            assert_eq!(session.frame(&Counts::default()), None);
        }
        // Without an owner, or with another owner, the numbers have no effect.
        let free = session.read(report(epoch.wrapping_add(1), 0, sequence).head());
        assert!(matches!(free, ReportStatus::Confirmed { .. }), "{free:?}");
        let other = session.read(report(epoch.wrapping_add(2), 3, sequence).head());
        assert_eq!(other, ReportStatus::Held { owner: 3 });
    }
}

#[derive(Clone, Copy, Debug)]
enum Step {
    /// The control scans. If given, the sent frame at this index arrives before.
    Scan(Option<prop::sample::Index>),
    /// This path reads the current report or an earlier one.
    Read(usize, Option<prop::sample::Index>),
    Send(usize),
    PowerUp(u16),
}

fn steps() -> impl Strategy<Value = Step> {
    let index = any::<prop::sample::Index>;
    prop_oneof![
        6 => prop::option::weighted(0.7, index()).prop_map(Step::Scan),
        6 => (0..2_usize, prop::option::weighted(0.2, index())).prop_map(|(way, late)| Step::Read(way, late)),
        6 => (0..2_usize).prop_map(Step::Send),
        1 => any::<u16>().prop_map(Step::PowerUp),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 500, ..ProptestConfig::default() })]

    /// On two paths frames and reports are lost, late, duplicated and reordered, and counters wrap: a session never attributes its own
    /// frame to another sender.
    #[test]
    fn own_frames_are_never_attributed_to_another_sender(
        epoch in prop_oneof![Just(u16::MAX), any::<u16>()],
        sequence in prop_oneof![65_530..=u16::MAX, any::<u16>()],
        steps in prop::collection::vec(steps(), 1..300),
    ) {
        let settings = settings(1);
        let mut start = at_zero(settings).memory();
        (start.link.epoch, start.link.sequence) = (epoch, sequence);
        let mut barrier = Barrier::resume(settings, start).expect("valid");
        let mut ways = [Session::new(OWNER); 2];
        let (mut frames, mut reports) = (Vec::<Vec<u16>>::new(), vec![barrier.report()]);
        for step in steps {
            match step {
                Step::Scan(frame) => {
                    // One of the last frames is delivered, so that some are recent enough to be accepted.
                    let young = &frames[frames.len().saturating_sub(8)..];
                    let frame: &[u16] = match frame {
                        Some(index) if !young.is_empty() => index.get(young).as_slice(),
                        _ => &[],
                    };
                    reports.push(barrier.scan(&[frame], false));
                }
                Step::Read(way, late) => {
                    let report = late.map_or_else(|| barrier.report(), |late| *late.get(&reports));
                    let seen = ways[way].read(report.head());
                    prop_assert!(!matches!(seen, ReportStatus::Held { .. }), "{:?} {:?}", ways[way], report);
                }
                Step::Send(way) => {
                    if let Some(frame) = ways[way].frame(&PerChannel::leading([1])) {
                        frames.push(words(&settings, &frame));
                        for way in &mut ways {
                            way.sends(frame.head.epoch, frame.head.sequence);
                        }
                    }
                }
                Step::PowerUp(tick) => {
                    let before = barrier.memory();
                    barrier = Barrier::start(settings, before.link.epoch, tick, &before.applied).expect("valid");
                    reports.push(barrier.report());
                }
            }
        }
    }
}

/// A barrier with digital lines and their levels. Rate: 2 counts per scan; maximum age of a frame: 5 scans; timeout: 12 scans.
struct Rig {
    barrier: Barrier,
    lines: DigitalLines,
    frame: Vec<u16>,
}

impl Rig {
    fn new() -> Self {
        let mut rig = Self {
            barrier: at_zero(settings(2)),
            lines: DigitalLines::default(),
            frame: Vec::new(),
        };
        rig.scans(20);
        rig
    }

    /// Runs scans, and checks that the applied correction changes by at most the rate in each.
    fn scans(&mut self, count: u16) -> Refusal {
        for _ in 0..count {
            let before = self.barrier.memory().applied;
            let report = self.barrier.scan_with(&[&self.frame], Some(&self.lines), false);
            for axis in 0..2 {
                assert!((report.applied[axis] - before[axis]).abs() <= 2);
            }
        }
        self.barrier.report().refusal
    }

    /// Sets another word, and toggles the latch one scan later, when the word has settled.
    fn word(&mut self, axis: usize, value: i16) -> Refusal {
        (self.lines.axis, self.lines.value) = (axis, value);
        self.scans(1);
        self.lines.latch ^= true;
        self.scans(1)
    }

    fn applied(&self) -> [i16; 2] {
        let applied = self.barrier.memory().applied;
        [applied[0], applied[1]]
    }

    fn sends(&mut self, sender: &mut Session, requested: Counts) {
        let report = self.barrier.report();
        let seen = sender.read(report.head());
        assert!(!matches!(seen, ReportStatus::Held { .. }), "lines hold nothing");
        if let Some(frame) = sender.frame(&requested) {
            self.frame = words(&report.settings, &frame);
        }
    }
}

#[test]
fn a_word_is_accepted_only_at_an_edge() {
    let mut rig = Rig::new();
    rig.lines.value = 3;
    rig.scans(30);
    assert_eq!(rig.applied(), [0, 0], "no edge");
    for (axis, value) in [(0, 2), (0, 4), (1, -3), (0, 6)] {
        assert_eq!(rig.word(axis, value), Refusal::None);
    }
    rig.scans(3);
    assert_eq!(rig.applied(), [6, -3], "one axis after the other");
    // Without further edges the correction ramps to zero, and the constant levels are not accepted.
    rig.scans(12 + 4);
    assert_eq!(rig.applied(), [0, 0]);
    assert_eq!(rig.barrier.report().owner, 0);
    rig.scans(100);
    assert_eq!(rig.applied(), [0, 0]);
}

#[test]
fn a_word_that_changes_faster_than_the_axis_is_rejected() {
    let mut rig = Rig::new();
    rig.word(0, 2);
    rig.word(0, 4);
    // Two scans between the edges permit 2 counts each, plus one step.
    assert_eq!(rig.word(0, 4 + 7), Refusal::Lines);
    assert_eq!(rig.applied(), [4, 0]);
    assert_eq!(rig.word(0, 4 + 6), Refusal::None);
    // After any silence the word may change by at most the motion of the axis during the maximum age of a frame.
    let mut rig = Rig::new();
    assert_eq!(rig.word(0, 13), Refusal::Lines);
    rig.scans(100);
    assert_eq!(rig.word(0, 12), Refusal::None);
    // A word for a missing axis, and a word above the limit.
    let mut rig = Rig::new();
    assert_eq!(rig.word(2, 0), Refusal::Lines);
    for value in [4, 10, 14, 20] {
        rig.word(0, value);
        rig.scans(2);
    }
    assert_eq!(rig.applied(), [20, 0]);
    assert_eq!(rig.word(0, 21), Refusal::Lines);
}

#[test]
fn a_sender_of_frames_has_priority() {
    let mut rig = Rig::new();
    rig.word(0, 2);
    rig.word(0, 4);
    // The first frame is accepted although the lines are in use.
    let mut sender = Session::new(7);
    for _ in 0..10 {
        rig.sends(&mut sender, PerChannel::leading([10, 4]));
        rig.scans(1);
    }
    assert_eq!(rig.applied(), [10, 4]);
    // Words on lines are rejected as long as the sender owns the control or its correction is applied.
    rig.sends(&mut sender, PerChannel::leading([10, 4]));
    assert_eq!(rig.word(0, 10), Refusal::Lines);
    rig.scans(12);
    assert_eq!(rig.barrier.report().owner, 0, "it sends nothing any more");
    assert_ne!(rig.applied(), [0, 0]);
    assert_eq!(rig.word(0, rig.applied()[0]), Refusal::Lines);
    rig.scans(10);
    assert_eq!(rig.applied(), [0, 0]);
    assert_eq!(rig.word(0, 1), Refusal::None);
}

#[test]
fn the_initial_latch_level_is_no_edge() {
    for latch in [false, true] {
        let mut barrier = at_zero(settings(2));
        let lines = DigitalLines { latch, axis: 0, value: 2 };
        for _ in 0..30 {
            barrier.scan_with(&[], Some(&lines), false);
        }
        assert_eq!(barrier.report().applied, Counts::default());
    }
}

/// One gateway alternates between frames and lines. Frames are lost, late or torn, bits are wrong, edges are missing or
/// extra. No axis exceeds its rate or limit, and the lines start to move an axis only from zero.
#[test]
fn alternating_frames_and_lines_with_faults() {
    let (mut by_lines, mut by_frames) = (0, 0);
    for seed in 0..500 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut rig = Rig::new();
        let mut sender = Session::new(7);
        let mut late = Vec::new();
        let mut output = [0_i16; 2];
        for scan in 0..1500_u32 {
            let memory = rig.barrier.memory();
            let uses_lines = (scan / 300) % 2 == 1;
            let requested = [12, -6];
            if uses_lines && scan % 2 == 0 {
                // The word stays zero until no correction can remain: timeout + maximum age of a frame + ramp.
                let axis = usize::from(scan % 4 == 0);
                let waits = scan % 300 < 12 + 5 + 10;
                output[axis] += (requested[axis] - output[axis]).signum();
                if waits {
                    output = [0; 2];
                } else {
                    (rig.lines.axis, rig.lines.value) = (axis, output[axis]);
                    if rng.random_bool(0.02) {
                        rig.lines.value ^= 1 << rng.random_range(0..8);
                    }
                }
            } else if uses_lines && !rng.random_bool(0.05) {
                rig.lines.latch ^= true;
            } else if !uses_lines {
                rig.sends(&mut sender, PerChannel::leading(requested));
                output = [0; 2];
                if rng.random_bool(0.05) {
                    late.push(std::mem::take(&mut rig.frame));
                }
                if rng.random_bool(0.05) {
                    let at = rng.random_range(0..8);
                    if let Some(word) = rig.frame.get_mut(at) {
                        *word = rng.random();
                    }
                }
            }
            if rng.random_bool(0.01)
                && let Some(old) = late.pop()
            {
                rig.frame = old;
            }
            rig.scans(1);
            let after = rig.barrier.memory();
            for axis in 0..2 {
                assert!(after.applied[axis].abs() <= 20);
            }
            if after.by_lines && !memory.by_lines {
                assert_eq!(memory.applied, Counts::default(), "seed {seed}");
            }
            by_lines += u32::from(after.by_lines && after.applied[0] == 12);
            by_frames += u32::from(!after.by_lines && after.applied[0] == 12);
        }
    }
    assert!(by_lines > 20_000 && by_frames > 20_000, "{by_lines} {by_frames}");
}
