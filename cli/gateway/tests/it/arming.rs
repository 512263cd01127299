//! What keeps a gateway from arming, or from arming by itself.

use std::time::Duration;

use volcomp_gateway::request::Ask;
use volcomp_vocabulary::PerChannel;

use crate::{
    manual::{Gateway, configuration},
    program::change,
};

/// Axes that move keep the test shift waiting; a person who disarms then is not overruled by auto_arm.
#[test]
fn auto_arm_does_not_overrule_a_person() {
    let dir = tempfile::tempdir().expect("writable");
    let config = configuration(dir.path(), "auto_arm = true");
    change(&config, "test_shift_um = 0", "test_shift_um = 5");
    let mut gateway = Gateway::start(&config);
    let state = gateway.wait_until_says("waiting for standstill");
    assert_eq!(state["state"], "arming");
    assert_eq!(gateway.ask(Ask::Disarm).0, 200);
    gateway.wait_for("disarmed");
    gateway.run(Duration::from_secs(10));
    assert_eq!(gateway.state()["state"], "disarmed");
    assert_eq!(gateway.shifts(), PerChannel::ZERO);
}

/// Without [guard] it runs and shows, and does not arm.
#[test]
fn without_limits_it_does_not_arm() {
    let dir = tempfile::tempdir().expect("writable");
    let config = configuration(dir.path(), "auto_arm = true");
    let text = std::fs::read_to_string(&config).expect("readable");
    let (before, rest) = text.split_once("[guard]").expect("there");
    let (_, after) = rest.split_once("[[controller]]").expect("there");
    std::fs::write(&config, format!("{before}[[controller]]{after}")).expect("writable");
    let mut gateway = Gateway::start(&config);
    gateway.wait("shown", |state| state["positions_mm"]["Y"].is_number());
    let (status, refused) = gateway.ask(Ask::Arm(None));
    assert_eq!(status, 409);
    let words = refused.to_string();
    assert!(words.contains("limits are not configured"), "{words}");
    gateway.run(Duration::from_secs(5));
    assert_eq!(gateway.state()["state"], "disarmed");
}
