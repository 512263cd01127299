//! What both bridges do by one rule, each beside a LinuxCNC of the test's: `scans.c` and `stand_in.py`.

use crate::c_bridge::{GOOD, Given, Run};

/// Each bridge: that in the servo thread where there is a compiler, that in user space where there is Python.
fn both() -> impl Iterator<Item = Run> {
    [Run::set(), Run::user()].into_iter().flatten()
}

/// A small correction that never comes is seen as well as a large one, once what moved is forgotten; one that came is not lost.
#[test]
fn a_small_correction_that_does_not_come_is_lost() {
    for mut run in both() {
        assert!(!run.correct(GOOD, 0, 30).lost());
        let still = Given { does: 2, ..GOOD };
        let lost_after = (0..4000)
            .find(|_| run.correct(still, 300, 0).lost() || run.correct(still, 300, 1).lost());
        // Three scans in each pass; what moved is forgotten by 23 to 1 in some times of the way.
        let ms = 3 * lost_after.expect("lost");
        assert!((500..2000).contains(&ms), "{ms} ms");
        let said = run.correct(GOOD, 300, 20);
        assert!(!said.lost());
        assert_eq!(said.applied(), 300);
    }
}

/// A disk that hangs: after as many time-outs as a start goes on by, no frame is taken, and that is told. Otherwise one of
/// before could pass after a restart.
#[test]
fn frames_are_refused_while_the_epoch_cannot_be_written() {
    for mut run in both() {
        let mut said = run.correct(GOOD, 100, 30);
        let (epoch, refusal) = (0, 4);
        let begun = said.state.report.as_slice()[epoch];
        assert_eq!(said.applied(), 100);
        run.ask("disk 0");
        let mut taken = 0;
        for _ in 0..20 {
            // The gateway is gone for longer than the time-out, and comes back.
            for _ in 0..310 {
                said = run.scan(GOOD, &[]);
            }
            assert_eq!(said.applied(), 0);
            said = run.correct(GOOD, 100, 5);
            if said.applied() == 0 {
                break;
            }
            assert_eq!(said.state.report.as_slice()[refusal], 0);
            taken += 1;
        }
        assert_eq!(taken, 15);
        let words = said.state.report.as_slice();
        assert_eq!(words[epoch].wrapping_sub(begun), 16);
        assert_eq!(words[refusal], 2, "it is told");
        run.ask("disk 1");
        let said = run.correct(GOOD, 100, 5);
        assert_eq!(
            (said.applied(), said.state.report.as_slice()[refusal]),
            (100, 0)
        );
    }
}

/// A mixture of two cycles is no reading: nothing is told, so that the gateway sees a state missing, and whoever watches the
/// bridge does not hear that it lives.
#[test]
fn a_mixture_of_two_cycles_is_no_reading() {
    let Some(mut run) = Run::user() else {
        return;
    };
    let before = run.correct(GOOD, 20_000, 100);
    assert_eq!(before.applied(), 20_000);
    let (_, alive) = run.look(GOOD, &[]);
    // One try that is whole suffices.
    run.ask("torn 9");
    let (said, told) = run.look(GOOD, &[]);
    let last = said.expect("the tenth was whole").state;
    assert_ne!(told, alive, "it lives");
    assert!(told.ends_with(" 0"), "{told}");
    for missed in 1..=3 {
        run.ask("torn 10");
        let (said, now) = run.look(GOOD, &[]);
        assert!(said.is_none(), "a mixture was told");
        assert_eq!(now, format!("{} {missed}", &told[..1]));
    }
    let (said, now) = run.look(GOOD, &[]);
    let said = said.expect("a state");
    assert_ne!(now[..1], told[..1], "it lives");
    assert_eq!(said.state.sequence, last.sequence + 4, "three are missing");
    // The cycles that went by count for the barrier.
    let tick = |state: &volcomp_linuxcnc::State| state.report.as_slice()[1];
    assert_eq!(tick(&said.state), tick(&last) + 4);
    assert_eq!(said.applied(), 20_000);
}
