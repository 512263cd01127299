//! The audit log on disk when it is damaged, and when it cannot be written.

use std::time::Duration;

use serde_json::{Value, json};
use volcomp_gateway::{audit::AuditLog, request::Ask};
use volcomp_vocabulary::PerChannel;

use crate::{
    manual::{Gateway, configuration},
    standing::SmallDisk,
};

/// What the last record of a start says of the log that was found.
fn found(log: &str) -> Value {
    let line = log.lines().rfind(|line| line.contains("\"started\""));
    let (_, record) = line.and_then(|line| line.split_once(' ')).expect("a start");
    let record: Value = serde_json::from_str(record).expect("JSON");
    record["details"]["what"].clone()
}

#[test]
fn a_torn_log_is_cut_and_a_forged_one_put_aside() {
    let dir = tempfile::tempdir().expect("writable");
    let config = configuration(dir.path(), "auto_arm = true");
    let log = dir.path().join("audit/audit.log");
    let mut gateway = Gateway::start(&config);
    gateway.wait_for("compensating");
    let rig = gateway.stop();
    let whole = std::fs::read_to_string(&log).expect("a log");
    let torn = &whole[..whole.len() - 40];
    std::fs::write(&log, torn).expect("writable");
    let gateway = Gateway::again(rig, &config);
    let again = gateway.audit();
    let kept = &whole[..=torn.rfind('\n').expect("lines")];
    assert!(again.starts_with(kept) && again.len() > kept.len());
    assert_eq!(found(&again)["cut_bytes"], torn.len() - kept.len());
    let rig = gateway.stop();
    // Somebody changes a record.
    let text = std::fs::read_to_string(&log).expect("a log");
    let forged = text.replacen("\"who\":\"auto_arm\"", "\"who\":\"nobody\"", 1);
    assert_ne!(forged, text);
    std::fs::write(&log, forged).expect("writable");
    let gateway = Gateway::again(rig, &config);
    let aside = dir.path().join("audit/audit.broken-1.log");
    assert!(aside.exists());
    let broken = found(&gateway.audit())["broken"].clone();
    assert_eq!(broken["aside"], json!(aside.display().to_string()));
    assert!(broken["line"].as_u64() > Some(0), "{broken}");
}

#[test]
fn a_full_disk_forbids_arming_but_not_correcting_nor_disarming() {
    let dir = tempfile::tempdir().expect("writable");
    let Some(disk) = SmallDisk::at(dir.path().join("audit")) else {
        return;
    };
    let config = configuration(dir.path(), "auto_arm = true");
    let mut gateway = Gateway::start(&config);
    gateway.wait_for("compensating");
    disk.fill(0);
    gateway.run(Duration::from_secs(30));
    assert_eq!(gateway.state()["state"], "compensating");
    // Records find room until the last block is full.
    let mut refused = None;
    for _ in 0..50 {
        assert_eq!(gateway.ask(Ask::Disarm).0, 200);
        gateway.wait_for("disarmed");
        assert_eq!(gateway.shifts(), PerChannel::ZERO);
        let (status, answer) = gateway.ask(Ask::Arm(None));
        if status != 200 {
            refused = Some((status, answer));
            break;
        }
    }
    let (status, answer) = refused.expect("the log is full by now");
    assert_eq!(status, 409, "{answer}");
    let words = "audit log cannot be written";
    assert!(answer.to_string().contains(words), "{answer}");
    assert_eq!(gateway.state()["state"], "disarmed");
    // What is in the log is whole.
    drop(gateway);
    let (_, found) = AuditLog::open(&disk.0).expect("readable");
    assert_eq!((found.cut_bytes, found.broken), (0, None));
}
