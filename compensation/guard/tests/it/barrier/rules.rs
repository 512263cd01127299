//! Single rules of the barrier, with one mailbox and with several.

use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_guard::{
    BarrierLink, CorrectionReport, Limits, ReadBack,
    barrier::{Barrier, FRAME_WORDS, Frame, REPORT_WORDS, Report, Settings, SettingsError},
    protocol::{Counts, Head, Layout, LayoutError, Refusal, ReportStatus, Session},
    vocabulary::{AxisName, PerChannel},
};

use super::{at_zero, settings, words};
use crate::world::SCAN;

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
