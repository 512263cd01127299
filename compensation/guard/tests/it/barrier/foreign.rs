//! What a barrier reports that this sender has not sent is another's; what it has sent never is.

use proptest::prelude::*;
use volcomp_guard::{
    barrier::{Barrier, Report},
    protocol::{Counts, Seen, Session},
    vocabulary::PerChannel,
};

use super::{at_zero, settings, words};

const OWNER: u16 = 9;

fn report(epoch: u16, owner: u16, sequence: u16) -> Report {
    Report {
        epoch,
        owner,
        sequence,
        ..at_zero(settings(1)).report()
    }
}

#[test]
fn a_report_of_what_was_not_sent_is_anothers() {
    // Frames that were sent (epoch and sequence), what is reported, and whether it may be of these.
    type Numbers = (u16, u16);
    let table: [(&[Numbers], Numbers, bool); 17] = [
        (&[], (7, 0), false),
        (&[(7, 1)], (7, 1), true),
        (&[(7, 1)], (7, 2), false),
        // Lost, or not reported yet.
        (&[(7, 1), (7, 2), (7, 3)], (7, 1), true),
        (&[(7, 1), (7, 2), (7, 3)], (7, 3), true),
        (&[(7, 1), (7, 2), (7, 3)], (7, 4), false),
        // In another order, by two paths.
        (&[(7, 3), (7, 2)], (7, 3), true),
        // The sequence goes round.
        (&[(7, 65_535), (7, 0)], (7, 65_534), true),
        (&[(7, 65_535), (7, 0)], (7, 0), true),
        (&[(7, 65_535), (7, 0)], (7, 1), false),
        (&[(7, 65_535)], (7, 0), false),
        // A new epoch, in which nothing was sent; one in which something was; a late report of the one before.
        (&[(7, 5)], (8, 5), false),
        (&[(7, 5), (8, 6)], (8, 6), true),
        (&[(7, 5), (8, 6)], (7, 5), true),
        (&[(7, 5), (8, 6)], (7, 6), false),
        // The epoch goes round.
        (&[(65_535, 5), (0, 6)], (1, 6), false),
        // A frame that answers a late report of an old epoch does not push out what is newer.
        (
            &[(9, 5), (5, 1), (4, 1), (3, 1), (2, 1), (1, 1)],
            (9, 5),
            true,
        ),
    ];
    for (sent, (epoch, sequence), is_own) in table {
        let mut session = Session::new(OWNER);
        for (epoch, sequence) in sent {
            session.sends(*epoch, *sequence);
        }
        let seen = session.read(report(epoch, OWNER, sequence).head());
        let held = Seen::Held { owner: OWNER };
        assert_eq!(
            seen != held,
            is_own,
            "{sent:?} {epoch} {sequence}: {seen:?}"
        );
        if !is_own {
            assert_eq!(session.frame(&Counts::default()), None);
        }
        // Free, or another's: the numbers do not matter.
        let free = session.read(report(epoch.wrapping_add(1), 0, sequence).head());
        assert!(matches!(free, Seen::Confirmed { .. }), "{free:?}");
        let other = session.read(report(epoch.wrapping_add(2), 3, sequence).head());
        assert_eq!(other, Seen::Held { owner: 3 });
    }
}

/// What happens between a gateway with two paths and a barrier.
#[derive(Clone, Copy, Debug)]
enum Step {
    /// The control scans, with the frame at this place of all that were sent, if there is one.
    Scan(Option<prop::sample::Index>),
    /// A path reads what the control publishes now, or what it published at an earlier time.
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

    /// Frames and reports may be lost, late, doubled and overtaken, on two paths, with counters that go round.
    #[test]
    fn no_frame_of_its_own_is_taken_for_anothers(
        epoch in prop_oneof![Just(u16::MAX), any::<u16>()],
        sequence in prop_oneof![65_530..=u16::MAX, any::<u16>()],
        steps in prop::collection::vec(steps(), 1..300),
    ) {
        let settings = settings(1);
        let mut start = at_zero(settings).memory();
        (start.link.epoch, start.link.sequence) = (epoch, sequence);
        let mut barrier = Barrier::resume(settings, start).expect("good settings");
        let mut ways = [Session::new(OWNER); 2];
        let (mut frames, mut reports) = (Vec::<Vec<u16>>::new(), vec![barrier.report()]);
        for step in steps {
            match step {
                Step::Scan(frame) => {
                    // Of the last ones, so that some are young enough.
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
                    prop_assert!(!matches!(seen, Seen::Held { .. }), "{:?} {:?}", ways[way], report);
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
                    barrier = Barrier::start(settings, before.link.epoch, tick, &before.applied).expect("good settings");
                    reports.push(barrier.report());
                }
            }
        }
    }
}
