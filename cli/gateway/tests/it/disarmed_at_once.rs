//! A person disarms while an order to arm, given just before, is about to be answered.

use std::time::Duration;

use volcomp_gateway::request::Ask;

use crate::{
    manual::{Gateway, configuration},
    standing::kept,
};

/// The cycle has armed when a person disarms: the service still sees the state of before, took the arming as done, and forgot
/// who disarmed it after that.
#[test]
fn a_persons_disarming_right_after_arming_outlives_a_restart() {
    let dir = tempfile::tempdir().expect("writable");
    let config = configuration(dir.path(), "auto_arm = true");
    let standing = dir.path().join("audit/standing.slots");
    let mut gateway = Gateway::start(&config);
    gateway.wait_for("compensating");
    let mut armed = 0;
    for cycles in 0..12 {
        assert_eq!(gateway.ask(Ask::Disarm).0, 200);
        gateway.wait_for("disarmed");
        let mut arms = gateway.begin(Ask::Arm(None));
        for _ in 0..cycles {
            gateway.step();
        }
        gateway.cycle_alone();
        let mut disarms = gateway.begin(Ask::Disarm);
        gateway.run(Duration::from_secs(1));
        armed += u32::from(arms.try_recv().expect("answered").status == 200);
        assert_eq!(disarms.try_recv().expect("answered").status, 200);
        let text = kept(&standing);
        assert!(
            text.contains("\"disarmed_by\":\"anna\""),
            "{cycles}: {text}"
        );
        assert_eq!(gateway.state()["state"], "disarmed", "{cycles}");
    }
    assert!((1..12).contains(&armed), "{armed} of 12 were armed first");
    let mut gateway = gateway.killed_and_started(&config);
    gateway.run(Duration::from_secs(10));
    assert_eq!(gateway.state()["state"], "disarmed");
}
