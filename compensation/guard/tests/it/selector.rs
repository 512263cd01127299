use std::time::Duration;

use volcomp_guard::{Choice, PathHealth, Selector};

const UP: PathHealth = PathHealth { usable: true, ready: true };
const DOWN: PathHealth = PathHealth { usable: false, ready: false };
/// The path responds, but the correction left by the previous path is unknown.
const UNKNOWN: PathHealth = PathHealth { usable: true, ready: false };

/// Time (s), health of both paths, and the choice: active, preferred, switched, blocked.
type Step = (u64, [PathHealth; 2], (usize, usize, bool, bool));

#[test]
fn the_next_path_takes_over_and_hands_back_with_hysteresis() {
    let goes_down: [Step; 9] = [
        (1, [UP, UP], (0, 0, false, false)),
        (2, [DOWN, UP], (1, 1, true, false)),
        (3, [DOWN, UP], (1, 1, false, false)),
        // One second of usability is too short.
        (4, [UP, UP], (1, 1, false, false)),
        (5, [UP, UP], (1, 1, false, false)),
        // A dropout restarts the hand-back time.
        (5, [DOWN, UP], (1, 1, false, false)),
        (6, [UP, UP], (1, 1, false, false)),
        (8, [UP, UP], (0, 0, true, false)),
        (9, [UP, UP], (0, 0, false, false)),
    ];
    let is_unknown: [Step; 2] =
        [(1, [DOWN, UNKNOWN], (0, 1, false, true)), (2, [DOWN, UP], (1, 1, true, false))];
    let all_down: [Step; 1] = [(1, [DOWN, DOWN], (0, 0, false, false))];
    for steps in [&goes_down[..], &is_unknown, &all_down] {
        let mut selector = Selector::new(Duration::from_secs(2));
        for (second, health, (active, preferred, switched, blocked)) in steps {
            let expected = Choice {
                active: *active,
                preferred: *preferred,
                switched: *switched,
                blocked: *blocked,
            };
            let found = selector.choose(Duration::from_secs(*second), health);
            assert_eq!(found, expected, "second {second} of {steps:?}");
        }
    }
}
