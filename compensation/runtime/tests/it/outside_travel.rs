//! Positions that are not those of the machine: farther outside the travel than an axis can be.

use volcomp_runtime::guard::{Hold, Reasons, Request, State};
use volcomp_vocabulary::AxisName;

use crate::rig::{Injected, Rig, machine};

/// Z from −500 to 0, B, X, C, Y.
const PLACE: [f64; 5] = [-100.0, 20.0, 300.0, 40.0, 200.0];

#[test]
fn a_position_far_outside_the_travel_holds_and_comes_back() {
    let control = Injected::default();
    let mut rig = Rig::injected(PLACE, &control);
    rig.run(20);
    rig.step(Some(Request::Arm));
    let armed = rig.run(5000);
    assert_eq!(armed.state, State::Compensating, "{armed:?}");
    assert_eq!(armed.outside_travel, 0);
    let applied = armed.sent.unwrap();
    let z = machine().index_of(AxisName::Z).unwrap();
    assert!(applied[z] != 0.0);
    // An end switch is within 5 mm.
    control.displace(104.9);
    let report = rig.run(10);
    assert_eq!(report.state, State::Compensating);
    assert_eq!(report.outside_travel, 0);
    control.displace(0.0);
    let applied = rig.run(2000).sent.unwrap();
    for displaced in [105.1, 4000.0, -405.1] {
        control.displace(displaced);
        let report = rig.step(None);
        assert!(
            report.reasons.contains(Reasons::OUTSIDE_TRAVEL),
            "{report:?}"
        );
        assert_eq!(report.outside_travel, 1 << z);
        assert_eq!(report.error, None);
        // Held, in the end taken out.
        let held = rig.run(10);
        assert!(
            (held.sent.unwrap()[z] - applied[z]).abs() < 1e-9,
            "{held:?}"
        );
        let lost = rig.run(5000);
        assert_eq!(lost.state, State::Holding(Hold::Lost), "{lost:?}");
        assert_eq!(lost.sent.unwrap()[z], 0.0);
        control.displace(0.0);
        let report = rig.run(5000);
        assert_eq!(report.state, State::Compensating, "{report:?}");
        assert!(!report.reasons.contains(Reasons::OUTSIDE_TRAVEL));
        assert!(
            (report.sent.unwrap()[z] - applied[z]).abs() < 1e-6,
            "{report:?}"
        );
    }
}

/// An axis with `modulo` has no ends.
#[test]
fn a_table_that_turns_on_is_nowhere_outside() {
    let place = [-100.0, 20.0, 300.0, 36_040.0, 200.0];
    let report = Rig::at(place).run(20);
    assert_eq!(report.outside_travel, 0, "{report:?}");
    assert!(!report.reasons.contains(Reasons::OUTSIDE_TRAVEL));
    assert!(report.error.is_some());
    // It does not arm where it is not believed.
    let mut rig = Rig::at([-100.0, 116.0, 300.0, 40.0, 200.0]);
    rig.run(20);
    rig.step(Some(Request::Arm));
    let report = rig.run(5000);
    assert_eq!(report.state, State::Disarmed, "{report:?}");
    assert!(report.reasons.contains(Reasons::OUTSIDE_TRAVEL));
}
