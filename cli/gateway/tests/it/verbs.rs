//! Every request in every state gets status 200 if it took effect, otherwise 409 with the reason. Disarming and
//! stopping work in every state.

use std::{path::Path, sync::atomic::Ordering, time::Duration};

use volcomp_gateway::request::Operation;
use volcomp_vocabulary::PerChannel;

use crate::{
    manual::{Gateway, configuration},
    program::change,
};

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

use Setting::{
    Arming, Compensating, Disarmed, Faulted, HoldingInAnAlarm, RampingOut, RampingOutInAnAlarm,
};

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
