use std::time::Duration;

use volcomp_guard::{Choice, PathHealth, Selector};

const SECOND: Duration = Duration::from_secs(1);

fn path(usable: bool, ready: bool) -> PathHealth {
    PathHealth { usable, ready }
}

#[test]
fn the_next_path_takes_over_and_hands_back_with_hysteresis() {
    let mut selector = Selector::new(2 * SECOND);
    let both = [path(true, true), path(true, true)];
    let second = [path(false, false), path(true, true)];
    assert_eq!(selector.choose(SECOND, &both).active, 0);
    assert_eq!(
        selector.choose(2 * SECOND, &second),
        Choice {
            active: 1,
            wanted: 1,
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
            wanted: 0,
            switched: true,
            blocked: false
        }
    );
}

#[test]
fn what_the_path_before_has_left_must_be_known() {
    let mut selector = Selector::new(SECOND);
    let unknown = [path(false, false), path(true, false)];
    assert_eq!(
        selector.choose(SECOND, &unknown),
        Choice {
            active: 0,
            wanted: 1,
            switched: false,
            blocked: true
        }
    );
    let known = [path(false, false), path(true, true)];
    assert_eq!(
        selector.choose(SECOND, &known),
        Choice {
            active: 1,
            wanted: 1,
            switched: true,
            blocked: false
        }
    );
}

#[test]
fn without_any_path_the_last_one_stays() {
    let mut selector = Selector::new(SECOND);
    let none = [path(false, false), path(false, false)];
    assert_eq!(
        selector.choose(SECOND, &none),
        Choice {
            active: 0,
            wanted: 0,
            switched: false,
            blocked: false
        }
    );
}
