//! The control thread alone stands still: whoever reads the state hears that it is unknown, and what is asked meanwhile expires.

use std::time::Duration;

use serde_json::{Value, json};
use volcomp_gateway::{
    interop::quantities::quantities,
    metrics,
    request::{Ask, Asked},
};

use crate::{
    manual::{Gateway, configuration, machine},
    standing::kept,
};

/// Before, it went on saying what the last cycle had said, and armed when the controller came back.
#[test]
fn a_silent_control_thread_is_told_and_what_was_asked_meanwhile_expires() {
    let dir = tempfile::tempdir().expect("writable");
    let config = configuration(dir.path(), "");
    let mut gateway = Gateway::start(&config);
    gateway.watch();
    gateway.hang(Duration::from_millis(90));
    assert_eq!(
        gateway.state()["state"],
        "disarmed",
        "late, and no reason to doubt"
    );
    gateway.hang(Duration::from_millis(20));
    let state = gateway.state();
    assert_eq!(state["state"], "unknown");
    assert_eq!(state["reasons"], json!(["no cycle for 112 ms"]));
    assert!(state["age_ms"].as_f64() > Some(100.0), "{state}");
    for key in ["positions_mm", "correction_um", "proven"] {
        assert_eq!(state[key], json!({}), "nothing is known: {state}");
    }
    assert_eq!(state["error_um"], Value::Null);
    assert_eq!(state["correction_known"], false);
    let path = &state["controllers"][0];
    assert_eq!(path["holds_correction"], Value::Null, "nothing is known");
    assert!(path["answered_ms"].as_f64() > Some(12.0), "it ages: {path}");
    let shape = machine(&config).plan().expect("right").shape();
    let text = metrics::text(&gateway.parts.published.latest(), &quantities(&shape));
    for line in [
        "volcomp_state{state=\"unknown\"} 1",
        "volcomp_reason{reason=\"no cycle\"} 1",
    ] {
        assert!(text.contains(line), "{text}");
    }
    // Asked now it is not done later.
    let mut arms = gateway.begin(Ask::Arm(None));
    gateway.hang(Duration::from_secs(1));
    let armed = arms.try_recv().expect("answered");
    assert_eq!(armed.status, 503);
    assert!(format!("{armed:?}").contains("expired"), "{armed:?}");
    gateway.wait_for("disarmed");
    gateway.run(Duration::from_secs(5));
    assert_eq!(gateway.state()["state"], "disarmed");
    // Disarming waits for the thread, and is done with its next cycle.
    gateway.must_arm();
    gateway.wait_for("compensating");
    gateway.hang(Duration::from_millis(200));
    let mut disarms = gateway.begin(Ask::Disarm);
    gateway.hang(Duration::from_secs(1));
    let disarmed = disarms.try_recv().expect("answered");
    assert_eq!(disarmed.status, 503);
    let words = "it disarms with its next cycle";
    assert!(format!("{disarmed:?}").contains(words), "{disarmed:?}");
    gateway.cycle_alone();
    assert_eq!(gateway.state()["armed"], true, "of the last look");
    gateway.wait_for("disarmed");
}

/// Sixty-four requests that wait for the service: a disarming was carried out, but neither written down nor remembered, so
/// that the gateway armed by itself after a restart.
#[test]
fn disarming_is_written_down_whatever_waits() {
    let dir = tempfile::tempdir().expect("writable");
    let config = configuration(dir.path(), "auto_arm = true");
    let mut gateway = Gateway::start(&config);
    gateway.wait_for("compensating");
    let (asks, switch) = (gateway.parts.asks.clone(), gateway.parts.switch.clone());
    let acknowledge = || Asked::new(Ask::Acknowledge, "bert", None, &switch);
    let waiting = (0..256).take_while(|_| asks.try_send(acknowledge()).is_ok());
    assert_eq!(waiting.count(), 64);
    let mut disarms = gateway.begin(Ask::Disarm);
    gateway.run(Duration::from_secs(1));
    assert_eq!(disarms.try_recv().expect("answered").status, 200);
    assert_eq!(gateway.state()["state"], "disarmed");
    let text = kept(&dir.path().join("audit/standing.slots"));
    assert!(text.contains("\"disarmed_by\":\"anna\""), "{text}");
}
