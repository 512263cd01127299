//! Arming: the conditions that prevent it, manual or automatic, and every request in every state.
//!
//! A request gets status 200 if it took effect, otherwise 409 with the reason. Disarming and stopping work in every
//! state, also while the control thread hangs.

use std::{path::Path, sync::atomic::Ordering, time::Duration};

use Setting::{
    Arming, Compensating, Disarmed, Faulted, HoldingInAnAlarm, RampingOut, RampingOutInAnAlarm,
};
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

#[derive(Clone, Copy, Debug, PartialEq)]
enum Setting {
    Disarmed,
    Arming,
    Compensating,
    HoldingInAnAlarm,
    RampingOut,
    RampingOutInAnAlarm,
    Faulted,
}

/// Each setting with the statuses of arm, disarm and acknowledge. Acknowledge gets 409 if there is nothing to
/// acknowledge.
const TABLE: [(Setting, [u16; 3]); 7] = [
    (Disarmed, [200, 200, 409]),
    (Arming, [200, 200, 409]),
    (Compensating, [200, 200, 409]),
    // The gateway stays armed and resumes automatically; an alarm is cleared at the control.
    (HoldingInAnAlarm, [200, 200, 409]),
    (RampingOut, [200, 200, 409]),
    (RampingOutInAnAlarm, [409, 200, 409]),
    (Faulted, [409, 200, 200]),
];

fn gateway(setting: Setting, dir: &Path) -> Gateway {
    let config = configuration(dir, "");
    change(&config, "[guard]", "[guard]\nstop_s = 1");
    match setting {
        // The test shift waits while axes move.
        Arming => change(&config, "test_shift_um = 0", "test_shift_um = 5"),
        RampingOut | RampingOutInAnAlarm => change(&config, "ramp_s = 0.1", "ramp_s = 20"),
        Disarmed | Compensating | HoldingInAnAlarm | Faulted => {}
    }
    let mut gateway = Gateway::start(&config);
    gateway.watch();
    if setting == Disarmed {
        return gateway;
    }
    gateway.must_arm();
    let alarm = |gateway: &Gateway| gateway.rig.controls.alarm.store(true, Ordering::Relaxed);
    match setting {
        Disarmed | Arming => {}
        Compensating => drop(gateway.wait_for("compensating")),
        HoldingInAnAlarm => {
            gateway.wait_for("compensating");
            alarm(&gateway);
            gateway.wait_for("holding");
        }
        RampingOut | RampingOutInAnAlarm => {
            gateway.wait("ramping in", |state| {
                let um = state["correction_um"]["Y"].as_f64();
                um.is_some_and(|um| um < -1.0)
            });
            assert_eq!(gateway.ask(Operation::Disarm).0, 200);
            if setting == RampingOutInAnAlarm {
                alarm(&gateway);
                gateway.wait_until_says("alarm");
            }
            gateway.wait_for("ramping-out");
        }
        Faulted => {
            gateway.wait_for("compensating");
            gateway.fault();
            let is_out = |state: &serde_json::Value| state["correction_um"]["Y"] == 0.0;
            gateway.wait("ramped out", is_out);
        }
    }
    gateway
}

fn judge(setting: Setting, ask: &Operation, expected: u16) {
    let dir = tempfile::tempdir().expect("writable");
    let mut gateway = gateway(setting, dir.path());
    let (status, reported) = gateway.ask(ask.clone());
    let what = format!("{ask:?} in {setting:?}: {reported}");
    assert_eq!(status, expected, "{what}");
    assert_eq!(reported["error"].is_string(), expected == 409, "{what}");
    let is_armed = matches!(setting, Arming | Compensating | HoldingInAnAlarm);
    let state = gateway.state();
    let is_so = match (ask, expected) {
        (Operation::Arm(_), 200) => state["armed"] == true,
        (Operation::Arm(_) | Operation::Disarm, _) => state["armed"] == false,
        (_, 409) => state["armed"] == is_armed,
        _ => state["state"] != "faulted",
    };
    assert!(is_so, "{what}: {state}");
    if expected == 409 {
        let reasons = reported["reasons"].as_array().expect("a list");
        assert!(!reasons.is_empty(), "{what}");
    }
}

/// Checks that the gateway ends properly, and leaves no correction if the control accepts writes.
fn ends(setting: Setting) {
    let dir = tempfile::tempdir().expect("writable");
    let rig = gateway(setting, dir.path()).stop();
    if matches!(setting, Disarmed | Arming | Compensating | Faulted) {
        // The last write takes effect one scan later.
        rig.clock().advance(Duration::from_millis(20));
        let applied = rig.controls.axes.applied();
        assert_eq!(applied, PerChannel::ZERO, "{setting:?}");
    }
}

#[test]
fn every_request_in_every_state() {
    for (setting, [arm, disarm, acknowledge]) in TABLE {
        judge(setting, &Operation::Arm(None), arm);
        judge(setting, &Operation::Disarm, disarm);
        judge(setting, &Operation::Acknowledge, acknowledge);
        ends(setting);
    }
}
