//! Interlocks of several paths: what one of them says holds all.

use volcomp_guard::{Interlock, Interlocks, Reasons};

const CLEAR: Option<Interlock> = Some(Interlock {
    unreferenced: false,
    alarm: false,
    emergency_stop: false,
});
const STOP: Option<Interlock> = Some(Interlock {
    unreferenced: false,
    alarm: false,
    emergency_stop: true,
});

#[test]
fn what_one_path_says_holds_all_until_the_same_path_clears_it() {
    let mut interlocks = Interlocks::default();
    interlocks.see(0, CLEAR);
    interlocks.see(1, STOP);
    assert_eq!(interlocks.reasons(), Reasons::EMERGENCY_STOP);
    // Another path that sees nothing of it lifts nothing, and neither does silence.
    interlocks.see(0, CLEAR);
    interlocks.see(1, None);
    let told = interlocks.reasons();
    assert_eq!(told, Reasons::EMERGENCY_STOP | Reasons::INTERLOCK_UNSEEN);
    interlocks.see(1, CLEAR);
    assert_eq!(interlocks.reasons(), Reasons::NONE);
}

#[test]
fn a_person_lifts_what_a_silent_path_said_last_and_nothing_else() {
    let mut interlocks = Interlocks::default();
    interlocks.see(0, STOP);
    interlocks.acknowledge();
    assert_eq!(
        interlocks.reasons(),
        Reasons::EMERGENCY_STOP,
        "it still says so"
    );
    interlocks.see(0, None);
    interlocks.acknowledge();
    assert_eq!(interlocks.reasons(), Reasons::NONE);
}
