//! A cycle allocates nothing, in whatever state it is.

use assert_no_alloc::assert_no_alloc;
use volcomp_runtime::{Replacement, guard::Request};

use crate::rig::{Rig, guard, machine};

#[test]
fn a_cycle_allocates_nothing() {
    let mut rig = Rig::at([-100.0, 40.0, 200.0, 50.0, 300.0]);
    let model = volcomp_runtime::Model::new(&machine(), guard().fading).expect("shipped");
    let mut replacement = Replacement::new(Box::new(model), &[]);
    assert_no_alloc(|| {
        rig.run(20);
        rig.step(Some(Request::Arm));
        rig.run(300);
        rig.cycle
            .swap_model(&mut replacement)
            .expect("the same axes");
        rig.step(Some(Request::Switched));
        rig.run(300);
        rig.step(Some(Request::Disarm));
        rig.run(300);
    });
    assert_eq!(rig.cycle.report().state.name(), "disarmed");
}
