//! For an invalid configuration `check` and the gateway report the same message and exit with status 2.

use std::process::Command;

use volcomp_gateway::check;

use crate::{
    manual::machine,
    program::{MACHINE, path, token_file},
    wrong_configurations::{FOCAS, RIGHT, cases},
};

/// A DBC file without counter signals. A variant of it has an angle for X.
const BARE: &str = "VERSION \"\"\nNS_ :\nBS_:\nBU_: CNC\nBO_ 256 POSITION: 8 CNC\n SG_ X_POS : 0|32@1- (0.0001,0) [0|0] \"mm\" CNC\nBO_ 257 CORRECTION: 8 CNC\n SG_ X_CORR : 0|16@1- (1,0) [0|0] \"um\" CNC\n";

fn folder() -> tempfile::TempDir {
    use std::os::unix::fs::PermissionsExt;
    let dir = tempfile::tempdir().expect("writable");
    let write = |name: &str, text: &str, mode: u32| {
        let file = dir.path().join(name);
        std::fs::write(&file, text).expect("writable");
        std::fs::set_permissions(&file, std::fs::Permissions::from_mode(mode)).expect("ours");
    };
    token_file(dir.path());
    write("open", "anna operate 0123456789abcdef0123456789abcdef\n", 0o644);
    write("short", "anna operate 0123\n", 0o600);
    write("bare.dbc", BARE, 0o644);
    write("barrier.dbc", volcomp_can::BARRIER_DBC, 0o644);
    write("deg.dbc", &BARE.replace("\"um\"", "\"deg\""), 0o644);
    // A dangling link, and a folder in place of the log.
    std::os::unix::fs::symlink("missing", dir.path().join("nowhere")).expect("writable");
    std::fs::create_dir_all(dir.path().join("odd/audit.log")).expect("writable");
    volcomp_gateway::http::tls::make(dir.path(), &["localhost".to_owned()]).expect("a pair");
    dir
}

#[test]
fn check_and_the_daemon_refuse_alike() {
    let dir = folder();
    let config = dir.path().join("G.toml");
    for case in cases() {
        std::fs::write(dir.path().join("machine.toml"), case.machine).expect("writable");
        // Files in URLs are relative to the working directory.
        let text = (case.text).replace("dbc=", &format!("dbc={}/", path(dir.path())));
        std::fs::write(&config, &text).expect("writable");
        let check = check::check(&config, false, false).expect_err(&text);
        let daemon = machine(&config).plan().err().expect(&text);
        let said = check.to_string();
        assert_eq!(said, daemon.to_string(), "{text}");
        assert!(said.contains(case.says), "{said} for {} in {text}", case.says);
        assert_eq!([check.status(), daemon.status()], [2; 2], "{said}");
    }
}

/// `check` and the gateway as programs report the same message as the library. `--json` prints the message as one
/// object.
#[test]
fn a_wrong_configuration_ends_the_programs() {
    let dir = folder();
    let config = dir.path().join("G.toml");
    std::fs::write(dir.path().join("machine.toml"), MACHINE).expect("writable");
    let unwatched = RIGHT.replace("heartbeat = { pmc = \"R\", at = 120 }", "");
    std::fs::write(&config, unwatched).expect("writable");
    let call = |arguments: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"))
            .args(arguments)
            .output()
            .expect("it was built for this test");
        assert_eq!(output.status.code(), Some(2), "{output:?}");
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    let check = call(&["check", path(&config)]);
    assert_eq!(check, call(&["--config", path(&config)]));
    assert!(check.starts_with("error: ") && check.contains("unwatched = true"));
    let reported = call(&["check", path(&config), "--json"]);
    let error: serde_json::Value = serde_json::from_str(&reported).expect("one object");
    assert_eq!(error["status"], 2);
    let reported = error["error"].as_str();
    assert!(reported.is_some_and(|text| text.contains("unwatched = true")));
}

#[test]
fn a_plan_describes_what_is_opened() {
    use volcomp_gateway::{config::Config, plan::Plan};
    let dir = folder();
    let lines = "url = \"modbus://127.0.0.1:1?profile=ADAM-6050\"\naxes = [\"X\"]\nfixed = { Y = 0.0, Z = 0.0 }\nunwatched = true\nunseen = [\"referenced\", \"alarm\", \"emergency_stop\"]\n[controller.digital]\nposition_bits = 8\nposition_mm_per_count = 10.0\ncorrection_bits = 6";
    let slow = RIGHT.replace("cycle_ms = 4.0", "cycle_ms = 20.0");
    // Six correction bits including the sign hold at most 31 µm.
    let lines = slow.replace(FOCAS, lines).replace("limit_um = 150.0", "limit_um = 31.0");
    for text in [slow, lines] {
        std::fs::write(dir.path().join("machine.toml"), MACHINE).expect("writable");
        let config = Config::parse(&text, "G.toml", dir.path()).unwrap_or_else(|e| panic!("{e}"));
        let plan = Plan::new(config).unwrap_or_else(|e| panic!("{e}"));
        let opened = plan.open().unwrap_or_else(|e| panic!("{e}"));
        let described: Vec<_> = opened.controllers.iter().collect();
        assert_eq!(opened.cycle.descriptions().collect::<Vec<_>>(), described);
    }
}
