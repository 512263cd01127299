//! Encoding of frames and reports. A session must attribute a reported frame to another sender exactly if it has not sent that frame.

use proptest::prelude::*;
use volcomp_guard::{
    barrier::{Barrier, Frame, REPORT_WORDS, Report},
    protocol::{Checksum, Counts, Head, Layout, ReportStatus, Session, checksum},
    vocabulary::{AxisName, PerChannel},
};

use super::{at_zero, layout, settings, words};

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
