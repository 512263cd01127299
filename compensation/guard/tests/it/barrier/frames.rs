//! Frames and reports as words.

use proptest::prelude::*;
use volcomp_guard::{
    barrier::{Barrier, Frame, REPORT_WORDS, Report},
    protocol::{Checksum, Counts, Head, Layout, checksum},
    vocabulary::{AxisName, PerChannel},
};

use super::{layout, settings, words};

/// Fletcher's sums as they are defined: the second one weighs each word by its distance from the end.
#[test]
fn the_checksum_is_the_one_of_its_definition() {
    let some = [1_u16, 65535, 40000, 0, 7, 65534, 3];
    let n = some.len() as u64;
    // The axes W C V A X B: their number is more than a word holds.
    let axes = [
        AxisName::W,
        AxisName::C,
        AxisName::V,
        AxisName::A,
        AxisName::X,
        AxisName::B,
    ];
    let machine = 60000 + 968_415_u64 / 65535;
    let layout = 968_415_u64 % 65535;
    let sum = machine + some.iter().map(|w| u64::from(*w)).sum::<u64>();
    let of_sums = layout
        + n * machine
        + some
            .iter()
            .zip(0..)
            .map(|(w, at)| (n - at) * u64::from(*w))
            .sum::<u64>();
    let expected = Checksum {
        sum: (sum % 65535) as u16,
        of_sums: (of_sums % 65535) as u16,
    };
    let axes = Layout::of(axes).expect("each once");
    assert_eq!(axes.number(), 968_415);
    assert_eq!(checksum(60000, axes, &some), expected);
}

fn frames() -> impl Strategy<Value = Frame> {
    (any::<[u16; 4]>(), any::<[i16; 9]>()).prop_map(|(head, values)| Frame {
        head: Head::of(head),
        values,
    })
}

proptest! {
    #[test]
    fn a_frame_comes_back_as_it_went(axes in 1_usize..=9, frame in frames()) {
        let settings = settings(axes);
        let mut expected = frame;
        expected.values[axes..].fill(0);
        prop_assert_eq!(Frame::decode(&settings, &words(&settings, &frame)), Some(expected));
    }

    #[test]
    fn a_report_comes_back_as_it_went(axes in 1_usize..=9, epoch: u16, tick: u16, applied: [i16; 9]) {
        let mut barrier = Barrier::start(settings(axes), epoch, tick, &PerChannel(applied)).expect("sensible");
        let report = barrier.scan(&[&[1, 2, 3]], false);
        let mut out = [0; REPORT_WORDS];
        let count = report.encode(&mut out);
        prop_assert_eq!(count, Report::length(layout(axes)));
        prop_assert_eq!(Report::decode(4711, layout(axes), &out[..count]), Some(report));
        prop_assert_eq!(Report::decode(4712, layout(axes), &out[..count]), None);
    }

    #[test]
    fn words_of_any_kind_are_read_without_a_panic(axes in 1_usize..=9, some: Vec<u16>) {
        let _ = Frame::decode(&settings(axes), &some);
        let _ = Report::decode(4711, layout(axes), &some);
    }

    /// Two frames of which the control sees the first words of one and the last words of the other.
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
                    // The words 0 and -1 weigh the same.
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
            let settings = volcomp_guard::barrier::Settings {
                machine,
                ..settings(axes)
            };
            assert_eq!(Frame::decode(&settings, &[0; 15]), None);
            assert_eq!(Frame::decode(&settings, &[]), None);
            assert_eq!(
                Report::decode(machine, layout(axes), &[0; REPORT_WORDS]),
                None
            );
        }
    }
    let mut barrier = Barrier::start(settings(2), 0, 0, &Counts::default()).expect("sensible");
    assert_eq!(barrier.scan(&[&[0; 8]], false).owner, 0);
}
