//! The audit log on disk when it is damaged, and when it cannot be written.

use std::process::Command;

use crate::{
    controlled::{configuration, control},
    program::{Program, path},
};

#[test]
fn a_torn_log_is_cut_and_a_forged_one_put_aside() {
    let dir = tempfile::tempdir().expect("writable");
    let log = dir.path().join("audit/audit.log");
    let whole = {
        let mut program = Program::simulated(dir.path());
        program.wait_for("compensating");
        program.signal("INT");
        assert_eq!(program.end(), Some(0));
        std::fs::read_to_string(&log).expect("a log")
    };
    std::fs::write(&log, &whole[..whole.len() - 40]).expect("writable");
    let restarted = Program::simulated(dir.path());
    assert!(restarted.log().contains("torn tail"), "{}", restarted.log());
    drop(restarted);
    let again = std::fs::read_to_string(&log).expect("a log");
    let last_line = whole[..whole.len() - 40].rfind('\n').expect("lines");
    let kept = &whole[..=last_line];
    assert!(again.starts_with(kept) && again.len() > kept.len());
    // Somebody changes a record.
    std::fs::write(
        &log,
        again.replacen("\"who\":\"auto_arm\"", "\"who\":\"nobody\"", 1),
    )
    .expect("writable");
    let restarted = Program::simulated(dir.path());
    assert!(
        restarted.log().contains("does not belong to the chain"),
        "{}",
        restarted.log()
    );
    assert!(dir.path().join("audit/audit.broken-1.log").exists());
}

/// A file that may not grow stands for a disk that is full.
#[test]
fn a_full_disk_forbids_arming_but_not_correcting_nor_disarming() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    let audit = dir.path().join("audit");
    let mut shell = Command::new("bash");
    // 40 blocks of a KiB, of which what outlives a restart takes 32; without the signal a write fails instead.
    let limited = "trap '' XFSZ; ulimit -f 40; exec \"$0\" \"$@\"";
    shell.args(["-c", limited, env!("CARGO_BIN_EXE_volcomp-gateway")]);
    let mut program = Program::spawn(shell, dir.path(), &["--config", path(&config)]);
    program.wait_for("compensating");
    let mut refused = None;
    for _ in 0..200 {
        // Busy, it may say that a cycle or the disk is late, or refuse for as long as it does not know what positions contain:
        // it disarms all the same, and may be asked to arm again.
        let disarmed = program.post("/api/disarm", "");
        assert!([200, 503].contains(&disarmed.status), "{}", disarmed.body);
        program.wait_for("disarmed");
        let armed = program.post("/api/arm", "");
        assert!([200, 503, 409].contains(&armed.status), "{}", armed.body);
        if armed.body.contains("audit log cannot be written") {
            refused = Some(armed);
            break;
        }
    }
    let refused = refused.expect("the log is full by now");
    assert_eq!(refused.status, 409, "{}", refused.body);
    let state = program
        .wait(|state| state["reasons"].to_string().contains("audit log"))
        .expect("it says so");
    assert_eq!(state["state"], "disarmed");
    // What is in the log is whole. While the program runs it tries again now and then, and a record is torn in the middle
    // of being written.
    program.signal("TERM");
    assert!(program.end().is_some(), "it ends");
    let (_, found) = volcomp_gateway::audit::AuditLog::open(&audit).expect("readable");
    assert_eq!((found.cut_bytes, found.broken), (0, None));
}
