use std::time::Duration;

use volcomp_guard::{Choice, PathHealth, Selector};

const SECOND: Duration = Duration::from_secs(1);

fn path(usable: bool, channel: u32, held_is_known: bool) -> PathHealth {
    PathHealth {
        usable,
        channel,
        held_is_known,
    }
}

#[test]
fn the_next_path_takes_over_and_hands_back_with_hysteresis() {
    let mut selector = Selector::new(2 * SECOND);
    let both = [path(true, 0, true), path(true, 0, true)];
    let second = [path(false, 0, false), path(true, 0, true)];
    assert_eq!(selector.choose(SECOND, &both).active, 0);
    assert_eq!(
        selector.choose(2 * SECOND, &second),
        Choice {
            active: 1,
            switched: true,
            blocked: false
        }
    );
    assert!(!selector.choose(3 * SECOND, &second).switched);
    // Back for a second: not yet.
    assert_eq!(selector.choose(4 * SECOND, &both).active, 1);
    assert_eq!(selector.choose(5 * SECOND, &both).active, 1);
    // A dropout begins the time again.
    selector.choose(5 * SECOND, &second);
    assert_eq!(selector.choose(6 * SECOND, &both).active, 1);
    assert_eq!(
        selector.choose(8 * SECOND, &both),
        Choice {
            active: 0,
            switched: true,
            blocked: false
        }
    );
}

#[test]
fn what_another_channel_holds_must_be_known() {
    let mut selector = Selector::new(SECOND);
    let unknown = [path(false, 0, false), path(true, 1, true)];
    assert_eq!(
        selector.choose(SECOND, &unknown),
        Choice {
            active: 0,
            switched: false,
            blocked: true
        }
    );
    let known = [path(false, 0, true), path(true, 1, true)];
    assert_eq!(
        selector.choose(SECOND, &known),
        Choice {
            active: 1,
            switched: true,
            blocked: false
        }
    );
}

#[test]
fn without_any_path_the_last_one_stays() {
    let mut selector = Selector::new(SECOND);
    let none = [path(false, 0, false), path(false, 0, false)];
    assert_eq!(
        selector.choose(SECOND, &none),
        Choice {
            active: 0,
            switched: false,
            blocked: false
        }
    );
}
