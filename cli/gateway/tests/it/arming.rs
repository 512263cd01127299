//! Conditions that prevent manual or automatic arming, and requests while the control thread hangs.

use std::time::Duration;

use serde_json::{Value, json};
use tokio::sync::oneshot;
use volcomp_gateway::{
    interop::quantities::quantities,
    metrics,
    request::{Operation, ServiceRequest},
};
use volcomp_vocabulary::PerChannel;

use crate::{
    manual::{Gateway, configuration, machine, started},
    program::change,
    standing::standing_text,
};

/// An operator disarms while moving axes delay the test shift. The gateway stays disarmed in spite of auto-arm.
#[test]
fn auto_arm_does_not_overrule_a_person() {
    let dir = tempfile::tempdir().expect("writable");
    let config = configuration(dir.path(), "auto_arm = true");
    change(&config, "test_shift_um = 0", "test_shift_um = 5");
    let mut gateway = Gateway::start(&config);
    let state = gateway.wait_until_says("waiting for standstill");
    assert_eq!(state["state"], "arming");
    assert_eq!(gateway.ask(Operation::Disarm).0, 200);
    gateway.wait_for("disarmed");
    gateway.run(Duration::from_secs(10));
    assert_eq!(gateway.state()["state"], "disarmed");
    assert_eq!(gateway.shifts(), PerChannel::ZERO);
}

/// An operator disarms at each stage of an automatic arming: before its request, while the request waits, is compared
/// and recorded, and while its order is executed. The request to disarm arrives immediately, or after a pause, as if
/// its thread stopped between the order and the queue. No automatic arming follows.
#[test]
fn auto_arm_follows_no_disarm_at_any_stage() {
    const RECORDED: &str = "\"who\":\"auto_arm\",\"what\":\"arm\"";
    let started = || {
        let dir = tempfile::tempdir().expect("writable");
        let gateway = Gateway::start(&configuration(dir.path(), "auto_arm = true"));
        (dir, gateway)
    };
    let (_dir, mut gateway) = started();
    let mut steps = 0;
    while !gateway.audit().contains(RECORDED) {
        gateway.step();
        steps += 1;
    }
    let mut recorded_before = 0;
    let stages = steps - 4..=steps + 5;
    for (stage, pause) in stages.flat_map(|stage| [(stage, 0), (stage, 20)]) {
        let (dir, mut gateway) = started();
        for _ in 0..stage {
            gateway.step();
        }
        recorded_before += u32::from(gateway.audit().contains(RECORDED));
        let (answer, mut disarms) = oneshot::channel();
        let switch = &gateway.parts.switch;
        let disarm = ServiceRequest::new(Operation::Disarm, "anna", Some(answer), switch);
        for _ in 0..pause {
            gateway.step();
        }
        assert!(gateway.parts.requests.try_send(disarm).is_ok());
        gateway.run(Duration::from_secs(3));
        let case = format!("{stage} of {steps} steps, then {pause}");
        assert_eq!(disarms.try_recv().expect("answered").status, 200, "{case}");
        assert_eq!(gateway.state()["state"], "disarmed", "{case}");
        assert_eq!(gateway.shifts(), PerChannel::ZERO, "{case}");
        let text = standing_text(&dir.path().join("audit/standing.slots"));
        assert!(text.contains("\"disarmed_by\":\"anna\""), "{case}: {text}");
    }
    let cases = "of 20: before and after the record";
    assert!((1..20).contains(&recorded_before), "{recorded_before} {cases}");
}

/// Without `[guard]` the gateway runs and reports its state, but a request to arm gets status 409, because no limits
/// are configured.
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
    let (status, refused) = gateway.ask(Operation::Arm(None));
    assert_eq!(status, 409);
    let words = refused.to_string();
    assert!(words.contains("limits are not configured"), "{words}");
    gateway.run(Duration::from_secs(5));
    assert_eq!(gateway.state()["state"], "disarmed");
}

/// While the control thread hangs, the state becomes `unknown`. A request to arm made meanwhile expires, and is not
/// executed when the controller responds again.
#[test]
fn a_hanging_control_thread_is_reported_and_requests_expire() {
    let (_dir, config, mut gateway) = started("");
    gateway.watch();
    gateway.hang(Duration::from_millis(90));
    assert_eq!(gateway.state()["state"], "disarmed", "late, and no reason to doubt");
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
    for line in ["volcomp_state{state=\"unknown\"} 1", "volcomp_reason{reason=\"no cycle\"} 1"] {
        assert!(text.contains(line), "{text}");
    }
    // This request expires while the thread hangs, so it must not be executed later.
    let mut arms = gateway.begin(Operation::Arm(None));
    gateway.hang(Duration::from_secs(1));
    let armed = arms.try_recv().expect("answered");
    assert_eq!(armed.status, 503);
    assert!(format!("{armed:?}").contains("expired"), "{armed:?}");
    gateway.wait_for("disarmed");
    gateway.run(Duration::from_secs(5));
    assert_eq!(gateway.state()["state"], "disarmed");
    // A disarm request does not expire: the thread executes it in its next cycle.
    gateway.must_arm();
    gateway.wait_for("compensating");
    gateway.hang(Duration::from_millis(200));
    let mut disarms = gateway.begin(Operation::Disarm);
    gateway.hang(Duration::from_secs(1));
    let disarmed = disarms.try_recv().expect("answered");
    assert_eq!(disarmed.status, 503);
    let words = "it disarms with its next cycle";
    assert!(format!("{disarmed:?}").contains(words), "{disarmed:?}");
    gateway.cycle_alone();
    assert_eq!(gateway.state()["armed"], true, "of the last look");
    gateway.wait_for("disarmed");
}

/// With 64 requests in the queue a disarm is still executed, recorded, and stored for the next start.
#[test]
fn a_disarm_is_recorded_with_a_full_queue() {
    let (dir, _, mut gateway) = started("auto_arm = true");
    gateway.wait_for("compensating");
    let (requests, switch) = (gateway.parts.requests.clone(), gateway.parts.switch.clone());
    let acknowledge = || ServiceRequest::new(Operation::Acknowledge, "bert", None, &switch);
    let waiting = (0..256).take_while(|_| requests.try_send(acknowledge()).is_ok());
    assert_eq!(waiting.count(), 64);
    let mut disarms = gateway.begin(Operation::Disarm);
    gateway.run(Duration::from_secs(1));
    assert_eq!(disarms.try_recv().expect("answered").status, 200);
    assert_eq!(gateway.state()["state"], "disarmed");
    let text = standing_text(&dir.path().join("audit/standing.slots"));
    assert!(text.contains("\"disarmed_by\":\"anna\""), "{text}");
}
