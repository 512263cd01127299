//! The other commands: `status`, `check`, `tls-init`; and the shipped configuration.

use std::{
    path::Path,
    process::Command,
    time::{Duration, Instant},
};

use serde_json::Value;
use volcomp_test_support::{Running, free_port, rows};

use crate::{
    manual::served_configuration,
    online::check,
    program::{change, path},
};

#[test]
fn check_names_the_wrong_key() {
    let dir = tempfile::tempdir().expect("writable");
    let config = served_configuration(dir.path(), "");
    let (text, message, status) = check(&config, &[]);
    assert_eq!(status, 0, "{message}");
    assert!(text.contains("axes = [\"X\", \"Y\", \"Z\"]"), "{text}");
    for [from, to, expected] in rows(
        r#"
limit_um = 150.0 | limit_um = "much" | guard.limit_um
slew_um_per_s = 500.0 |  | slew_um_per_s
hold_ms = 200 | hold_ms = 200\nhold_s = 1 | hold_s
axes = ["X", "Y", "Z"] | axes = ["X", "W"] | axis W
heartbeat = { pmc = "R", at = 120 } |  | heartbeat
machine = "machine.toml" | machine = "missing.toml" | missing.toml
[dashboard] | [dashboard]\nlisten = "0.0.0.0:0" | tls_certificate
token_file = "tokens" | token_file = "G.toml" | mode
"#,
    ) {
        let text = std::fs::read_to_string(&config).expect("readable");
        assert!(text.contains(from), "{from}");
        let wrong = dir.path().join("wrong.toml");
        std::fs::write(&wrong, text.replacen(from, to, 1)).expect("writable");
        let (_, message, status) = check(&wrong, &[]);
        assert_eq!(status, 2, "{to}: {message}");
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn the_documented_configuration_is_right() {
    let dir = tempfile::tempdir().expect("writable");
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    std::fs::copy(root.join("../../examples/gantry.toml"), dir.path().join("machine.toml"))
        .expect("there");
    let text = std::fs::read_to_string(root.join("debian/gateway.toml")).expect("there");
    let config = dir.path().join("G.toml");
    std::fs::write(&config, text).expect("writable");
    crate::program::token_file(dir.path());
    let config = volcomp_gateway::config::Config::read(&config).unwrap_or_else(|e| panic!("{e}"));
    let plan = volcomp_gateway::plan::Plan::new(config).unwrap_or_else(|e| panic!("{e}"));
    let text = volcomp_gateway::check::text(&plan.document().expect("a plan"), &plan.config);
    assert!(text.contains("focas://192.0.2.10:8193"), "{text}");
    assert!(text.contains("axes = [\"X\", \"Y\", \"Z\"]"), "{text}");
}

#[test]
fn elsewhere_only_with_tls_and_a_token() {
    let dir = tempfile::tempdir().expect("writable");
    let call = |arguments: &[&str]| {
        Command::new(env!("CARGO_BIN_EXE_volcomp-gateway")).args(arguments).output().expect("built")
    };
    let refused = call(&["--simulate", "--listen", "0.0.0.0:0"]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("tls-init"));
    let made = call(&["tls-init", "localhost", "127.0.0.1", "-o", path(dir.path())]);
    assert_eq!(made.status.code(), Some(0));
    let again = call(&["tls-init", "localhost", "-o", path(dir.path())]);
    assert_eq!(again.status.code(), Some(2), "keys are not overwritten");
    assert!(String::from_utf8_lossy(&again.stderr).contains("exists and is not replaced"));
    let config = served_configuration(dir.path(), "");
    let free = free_port();
    let tls = "tls_certificate = \"certificate.pem\"\ntls_key = \"key.pem\"";
    let dashboard = format!("[dashboard]\nlisten = \"0.0.0.0:{free}\"\n{tls}");
    change(&config, "[dashboard]", &dashboard);
    let log_path = dir.path().join("log");
    let log = std::fs::File::create(&log_path).expect("writable");
    let _gateway = Running::start(
        Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"))
            .args(["--config", path(&config)])
            .stdout(std::process::Stdio::null())
            .stderr(log),
    );
    let end = Instant::now() + Duration::from_secs(60);
    let without = loop {
        let output = call(&["status", "--config", path(&config)]);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        if message.contains("401") || Instant::now() > end {
            break message;
        }
        std::thread::sleep(Duration::from_millis(50));
    };
    let log = std::fs::read_to_string(&log_path).expect("readable");
    assert!(without.contains("answers 401"), "{without}\n{log}");
    let viewer = viewer(dir.path());
    let with_token = ["status", "--config", path(&config), "--token-file", path(&viewer)];
    // The page may respond before the first cycle.
    let end = Instant::now() + Duration::from_secs(60);
    loop {
        let with = call(&with_token);
        let message = String::from_utf8_lossy(&with.stderr).into_owned();
        assert_eq!(with.status.code(), Some(0), "{message}");
        let reported = String::from_utf8_lossy(&with.stdout).into_owned();
        if reported.contains("disarmed") {
            break;
        }
        assert!(Instant::now() < end, "{reported}");
        std::thread::sleep(Duration::from_millis(50));
    }
    let json = call(&[&with_token[..], &["--json"]].concat());
    let state: Value = serde_json::from_slice(&json.stdout).expect("JSON");
    assert_eq!(state["state"], "disarmed");
    let nobody = call(&["status", "--listen", "127.0.0.1:1"]);
    assert_eq!(nobody.status.code(), Some(1));
    // `status` finds the address although another key is invalid: the file may be edited at this time.
    change(&config, "slew_um_per_s = 500.0", "slew_um_per_s = \"fast\"");
    let changed = call(&with_token);
    assert_eq!(changed.status.code(), Some(0), "{changed:?}");
    // A file that is not TOML gives no address. The message states how to reach the gateway without the file.
    change(&config, "slew_um_per_s = \"fast\"", "slew_um_per_s");
    let broken = call(&["status", "--config", path(&config)]);
    assert_eq!(broken.status.code(), Some(2), "{broken:?}");
    let message = String::from_utf8_lossy(&broken.stderr).into_owned();
    assert!(message.contains(path(&config)), "{message}");
    let remedy = "reached without this file: --listen ADDRESS";
    assert!(message.contains(remedy), "{message}");
}

fn viewer(dir: &Path) -> std::path::PathBuf {
    let file = dir.join("viewer");
    std::fs::write(&file, crate::program::VIEW).expect("writable");
    file
}
