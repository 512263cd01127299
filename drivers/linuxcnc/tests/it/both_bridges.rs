//! What both bridges do by one rule, each beside a LinuxCNC of the test's: `scans.c` and `stand_in.py`.

use crate::c_bridge::{GOOD, Run};

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
