//! The output of `check`, `status` and `tls-init`.
//!
//! `check` prints effective values instead of the configured ones, and on request compares them with the control.

use std::{
    path::Path,
    process::Command,
    time::{Duration, Instant},
};

use serde_json::Value;
use volcomp_gateway::{check, client, config::Config, documents::Status, plan::Plan};
use volcomp_test_support::{Running, free_port, rows};

use crate::{
    manual::{control, controlled_configuration, served_configuration},
    program::{change, path},
};

fn plan(text: &str) -> Plan {
    plan_of(crate::program::MACHINE, text)
}

fn plan_of(machine: &str, text: &str) -> Plan {
    let dir = tempfile::tempdir().expect("writable");
    std::fs::write(dir.path().join("machine.toml"), machine).expect("writable");
    let config = Config::parse(text, "G.toml", dir.path()).unwrap_or_else(|e| panic!("{e}"));
    Plan::new(config).unwrap_or_else(|e| panic!("{e}"))
}

const TEXT: &str = r#"machine = "machine.toml"
cycle_ms = 40.0
[guard]
limit_um = 100.5
limit_without_barrier_um = 150.0
slew_um_per_s = 500.0
hold_ms = 50
zero_after_ms = 500
ramp_s = 0.05
[[controller]]
url = "focas://192.0.2.10:8193"
axes = ["X", "Y", "Z"]
resolution_um = 2.0
heartbeat = { pmc = "R", at = 120 }
"#;

#[test]
fn the_plan_shows_effective_and_configured_values() {
    let plan = plan(TEXT);
    let document = plan.document().expect("a plan");
    let axis = &document.controllers[0].axes[0];
    assert_eq!(axis.limit, 100.0);
    // Four steps of 2 µm exceed the default of 5 µm.
    assert_eq!(axis.test_shift, 8.0);
    // The guard gets the same limits.
    let limits = plan.limits()[0];
    assert_eq!(limits.ramp_taken(), Duration::from_millis(800));
    assert!((limits.axes[0].reachable() - 0.100).abs() < 1e-12);
    let text = check::text(&document, &plan.config);
    for part in [
        "limit_um = 100.5\n",
        "warn_um = 100.5                                 # default\n",
        "ramp_s = 0.05\n",
        "stop_s = 5.0                                    # default\n",
        "ramp_s: 0.05 s are configured, and a ramp takes 0.8 s: at least 20 cycles",
        "the limit 100.5 µm is not a multiple of the step 2 µm: corrections go up to 100 µm",
        "the test shift is 8 µm instead of 5 µm",
    ] {
        let joined = text.replace("\n#      ", "");
        assert!(joined.contains(part), "{part}: {text}");
    }
    let notes = text.split("# note").skip(1).flat_map(str::lines);
    assert!(notes.clone().all(|line| line.chars().count() <= 80), "{text}");
    assert!(notes.count() > 4, "{text}");
}

/// The printed configuration states all defaults and is equivalent to the original.
#[test]
fn what_check_prints_is_a_configuration() {
    let barrier = "barrier = { machine = 7, scan_ms = 8.0, frame = { pmc = \"R\", at = 300 }, report = { pmc = \"R\", at = 400 } }";
    let heartbeat = "heartbeat = { pmc = \"R\", at = 120 }";
    let more = "referenced = false\nfixed = { B = 1.5 }\n[controller.digital]";
    let lines = "[[controller]]\nurl = \"gpio://?position=a:0-14&correction=b:0-7\"\naxes = []\nreads = [\"X\"]\nunseen = [\"referenced\", \"emergency_stop\"]\n[controller.digital]\nposition_code = \"gray\"\n";
    let sinumerik = "[[controller]]\nurl = \"opc.tcp://192.0.2.20:4840\"\naxes = [\"X\"]\nterms = [\"thermal\"]\nhold_ms = 1500\nunwatched = true\n[controller.sinumerik]\nuser = \"anna\"\npassword_file = \"secret\"\n";
    let thermometer = "[[thermometer]]\nurl = \"opc.tcp://192.0.2.20:4840\"\nnames = [\"shop\"]\nnodes = [\"/Plc/DB5.DBD0:REAL\"]\n[thermometer.sinumerik]\nuser = \"anna\"\npassword_file = \"secret\"\n[dashboard]\nhosts = [\"a \\\"quoted\\\" name\"]\n[shdr]\n[opc_ua]\nlisten = \"127.0.0.1:4841\"\n[realtime]\npriority = 0\n";
    let rotary = "limit_urad = 50\nslew_urad_per_s = 20\nhold_ms";
    for text in [
        TEXT.to_owned(),
        TEXT.replace(heartbeat, barrier).replace("hold_ms", rotary),
        TEXT.replace(heartbeat, &more.replace("[controller.digital]", heartbeat)),
        format!("{TEXT}{lines}{sinumerik}{thermometer}"),
    ] {
        let parse = |text: &str| Config::parse(text, "shop/G.toml", Path::new("shop"));
        let config = parse(&text).unwrap_or_else(|e| panic!("{e}\n{text}"));
        let printed = config.effective_toml();
        // Paths are relative to the folder of the file, wherever `check` is called. A machine name that equals the
        // folder's name is not changed as if it were a path.
        assert!(!printed.contains("shop/"), "{printed}");
        let again = parse(&printed);
        let again = again.unwrap_or_else(|e| panic!("{e}\n{printed}"));
        assert_eq!(again, config, "{printed}");
        assert_eq!(again.defaults(), [""; 0], "{printed}");
        assert!(config.defaults().len() > 10, "{printed}");
    }
}

#[test]
fn a_skipped_test_shift_is_noted() {
    let coarse = TEXT
        .replace("resolution_um = 2.0", "resolution_um = 50.0")
        .replace("limit_um = 100.5", "limit_um = 100.0");
    let document = plan(&coarse).document().expect("a plan");
    assert_eq!(document.controllers[0].axes[0].test_shift, 0.0);
    let reported = |note: &&String| note.contains("axes X, Y, Z: no test shift");
    assert!(document.notes.iter().any(|note| reported(&note)), "{document:?}");
}

#[test]
fn a_note_for_several_axes_appears_once() {
    let document = plan(TEXT).document().expect("a plan");
    let of_limit = document.notes.iter();
    let of_limit: Vec<_> = of_limit.filter(|n| n.contains("not a multiple")).collect();
    assert_eq!(of_limit.len(), 1, "{of_limit:?}");
    assert!(of_limit[0].contains("axes X, Y, Z: "), "{of_limit:?}");
}

/// Rotary axes of the control that the machine file does not correct need no limit. `check` lists them as held.
#[test]
fn uncorrected_axes_are_listed_as_held() {
    let dir = tempfile::tempdir().expect("writable");
    let machine = include_str!("../../../../examples/five-axis.toml");
    let text = TEXT.replace("\"Z\"]", "\"Z\", \"C\", \"B\"]");
    let of = |machine: &str| {
        std::fs::write(dir.path().join("machine.toml"), machine).expect("writable");
        let config = Config::parse(&text, "G.toml", dir.path()).unwrap_or_else(|e| panic!("{e}"));
        Plan::new(config)
    };
    let refused = of(machine).err().expect("no limits of rotary axes");
    assert!(refused.to_string().contains("limit_urad"), "{refused}");
    let plan = of(&format!("correct = [\"X\", \"Y\", \"Z\"]\n{machine}"));
    let plan = plan.unwrap_or_else(|e| panic!("{e}"));
    let document = plan.document().expect("a plan");
    let controller = &document.controllers[0];
    let letters = |names: &[volcomp_vocabulary::AxisName]| -> String {
        names.iter().map(|name| name.letter()).collect()
    };
    assert_eq!(letters(&controller.held), "BC");
    let axes: Vec<_> = controller.axes.iter().map(|axis| axis.name).collect();
    assert_eq!(letters(&axes), "XYZ");
    let shifts = plan.limits()[0].test_shift;
    assert!(shifts[2] > 0.0 && shifts[3] == 0.0 && shifts[4] == 0.0);
    // `check` warns of a travel in radians, as `volcomp` does.
    let radians = machine.replace("travel = [-110.0, 110.0]", "travel = [-1.571, 1.571]");
    let plan = of(&format!("correct = [\"X\", \"Y\", \"Z\"]\n{radians}"));
    let notes = plan.unwrap_or_else(|e| panic!("{e}")).document().expect("a plan").notes;
    let asks = notes.iter().any(|note| note.contains("is it stated in radians?"));
    assert!(asks, "{notes:?}");
}

/// A misspelt sensor is missing under its right name and unused under the wrong one.
#[test]
fn a_sensor_that_is_missing_or_unused_gets_a_note() {
    let drift = |weight: f64| {
        format!(
            "[[thermal.drift]]\nerror = \"EZZ\"\nsensors = {{ bed = -1.0, column = {weight:?} }}\num_per_k = 1.0\n"
        )
    };
    let machine = format!(
        "{}[thermal]\nreference = 20.0\n{}{}",
        crate::program::MACHINE,
        drift(1.0),
        drift(0.5)
    );
    let thermometer = "[[thermometer]]\nurl = \"modbus://192.0.2.20?profile=PTA8C04\"\nnames = [\"bed\", \"colum\"]\n";
    let notes =
        plan_of(&machine, &format!("{TEXT}{thermometer}")).document().expect("a plan").notes;
    let of_sensors: Vec<&String> = notes.iter().filter(|note| note.contains("sensor")).collect();
    assert_eq!(
        of_sensors,
        [
            "sensor colum is used by no thermal term of the machine",
            "no thermometer has the sensor column: its thermal terms (drift EZZ) are left out",
        ]
    );
}

/// With auto-arm and no token `check` warns that the gateway can only be disarmed at its own computer.
#[test]
fn auto_arm_without_a_token_is_a_warning() {
    let document = plan(&format!("auto_arm = true\n{TEXT}")).document().expect("a plan");
    let reported = document.notes.iter().any(|note| note.contains("only this computer can disarm"));
    assert!(reported, "{:?}", document.notes);
}

#[test]
fn unchanged_values_produce_no_note() {
    let fitting = TEXT
        .replace("cycle_ms = 40.0", "cycle_ms = 4.0")
        .replace("ramp_s = 0.05", "ramp_s = 0.5")
        .replace("limit_um = 100.5", "limit_um = 100.0")
        .replace("resolution_um = 2.0", "resolution_um = 1.0");
    let plan = plan(&fitting);
    assert_eq!(
        plan.document().expect("a plan").notes,
        [
            "the configuration has no token: to arm over HTTP state [dashboard] token_file or start with --token-file FILE; or state auto_arm = true above the first table"
        ]
    );
}

/// A path without a barrier is limited to 30 µm unless the configuration states another limit.
#[test]
fn without_a_barrier_a_smaller_limit_holds() {
    let plan = plan(&TEXT.replace("limit_without_barrier_um = 150.0\n", ""));
    assert!((plan.limits()[0].axes[0].limit - 0.030).abs() < 1e-12);
    let document = plan.document().expect("a plan");
    let reported = |note: &String| {
        note.contains("corrections go up to 30 µm, not 100.5 µm")
            && note.contains("limit_without_barrier_um")
    };
    assert!(document.notes.iter().any(reported), "{:?}", document.notes);
}

#[test]
fn status_fits_a_small_terminal() {
    let state = serde_json::json!({
        "state": "compensating",
        "reasons": ["degraded", "rate limited"],
        "armed": true,
        "auto_arm": false,
        "simulated": false,
        "machine": { "name": "five-axis", "hash": "sha256:00", "axes": ["X", "Y", "Z", "B", "C"] },
        "controller": { "device": "focas://192.0.2.10:8193", "channel": "emzps", "number": 0 },
        "controllers": [
            {
                "device": "focas://192.0.2.10:8193", "number": 0, "active": true, "scheme": "barrier",
                "answered_ms": 1.2, "positions_ms": 3.4, "confirmed_ms": 3.4, "holds_correction": true, "reasons": [],
            },
            {
                "device": "can://can0", "number": 1, "active": false, "scheme": "plain", "answered_ms": null,
                "positions_ms": null, "confirmed_ms": null, "holds_correction": null, "reasons": ["no barrier"],
            },
        ],
        "correction_known": true,
        "proven": { "X": "contained", "Y": "contained", "Z": "not-contained", "B": "not-proven", "C": "not-proven" },
        "positions_mm": { "X": 123.456, "Y": -4.5, "Z": 0.0 },
        "positions_deg": { "B": 30.0, "C": -45.25 },
        "correction_um": { "X": -12.0, "Y": 3.0, "Z": 0.0 },
        "correction_urad": { "B": 4.0, "C": 0.0 },
        "wanted_um": { "X": -12.2, "Y": 3.1, "Z": 0.0 },
        "wanted_urad": { "B": 4.4, "C": 0.1 },
        "error_um": [12.0, -3.0, 4.0],
        "error_urad": [1.0, -4.0, 0.0],
        "error_axis_urad": [-4.0, -1.0, 0.0],
        "residual_um": [0.2, 0.1, 0.0],
        "residual_axis_urad": [0.4, 1.0, 0.0],
        "temperatures": [
            { "name": "bed", "degc": 21.46, "quality": "good", "reason": null },
            { "name": "spindle", "degc": null, "quality": "bad", "reason": "jumped" },
        ],
        "held_back": 0,
        "faults": 0,
        "uptime_s": 4.9,
        "age_ms": 1.0,
        "cycle": {
            "count": 1234, "period_us": 4000.0, "p50_us": 38.1, "p99_us": 92.4, "max_us": 120.0, "overruns": 2,
            "own": { "p50_us": 2.0, "p99_us": 3.0, "max_us": 4.0 },
            "wake": { "p50_us": 2.0, "p99_us": 3.0, "max_us": 4.0 },
            "exchange": { "p50_us": 2.0, "p99_us": 3.0, "max_us": 4.0 },
            "histogram_us": [[64.0, 1200], [128.0, 34]],
        },
    });
    let mut status: Status = serde_json::from_value(state).expect("a state");
    let text = client::status_text(&status);
    assert!(text.lines().all(|line| line.chars().count() <= 80), "{text}");
    insta::assert_snapshot!(text);
    // A name neither acts on the terminal nor begins a line.
    status.machine.name = "mill\u{1b}[2J\nstate             disarmed".to_owned();
    let hostile = client::status_text(&status);
    assert_eq!(hostile.lines().count(), text.lines().count(), "{hostile}");
    assert!(!hostile.contains('\u{1b}'), "{hostile:?}");
}

#[test]
fn check_says_what_would_be_corrected() {
    let dir = tempfile::tempdir().expect("writable");
    std::fs::write(dir.path().join("machine.toml"), crate::program::MACHINE).expect("writable");
    let config = dir.path().join("G.toml");
    let text = r#"machine = "machine.toml"
[guard]
limit_um = 150.0
limit_without_barrier_um = 150.0
slew_um_per_s = 500.0
hold_ms = 50
zero_after_ms = 500
[[controller]]
url = "can://can0"
axes = ["X"]
fixed = { Y = 50.0, Z = 0.0 }
[[thermometer]]
url = "modbus://192.0.2.20:502?unit=1&profile=PTA8C04"
names = ["bed", "spindle"]
"#;
    std::fs::write(&config, text).expect("writable");
    let config = Config::read(&config).unwrap_or_else(|e| panic!("{e}"));
    let plan = Plan::new(config).unwrap_or_else(|e| panic!("{e}"));
    let folder = dir.path().display().to_string();
    let text = check::text(&plan.document().expect("a plan"), &plan.config);
    let text = text.replace(&folder, "FOLDER");
    insta::assert_snapshot!(text);
}

/// Output, standard error and exit status of `check`.
pub(crate) fn check(config: &Path, options: &[&str]) -> (String, String, u8) {
    let has = |option| options.contains(&option);
    match check::check(config, has("--online"), has("--json")) {
        Ok(text) => (text, String::new(), 0),
        Err(error) => (String::new(), error.to_string(), error.status()),
    }
}

#[test]
fn the_shift_words_of_the_control_are_compared() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = controlled_configuration(dir.path(), &control, "");
    let (text, errors, status) = check(&config, &["--online"]);
    assert_eq!(status, 0, "{errors}");
    assert!(text.contains("# shift_words = 100"), "{text}");
    let (json, ..) = check(&config, &["--online", "--json"]);
    let document: Value = serde_json::from_str(&json).expect("JSON");
    crate::interop::validate("gateway-check.json", &document);
    assert_eq!(document["online"][0]["shift_words"], 100, "{json}");
    // The control reads its shifts from other words. The configuration is rejected with the number of the parameter.
    control.world().parameters.insert((1280, 0), 300.0);
    let (_, errors, status) = check(&config, &["--online"]);
    assert_eq!(status, 1, "{errors}");
    assert!(
        errors.contains("parameter 1280 of the control")
            && errors.contains("found 300, expected 100"),
        "{errors}"
    );
    // If a control does not report the parameter, a note says so.
    control.world().parameters.clear();
    control.world().reports_shift_source = false;
    let (text, errors, status) = check(&config, &["--online"]);
    assert_eq!(status, 0, "{errors}");
    assert!(text.contains("the control does not report parameters 1203"), "{text}");
    // Offline no request is sent, so the control may be missing.
    let asked = control.requests();
    let (json, _, status) = check(&config, &["--json"]);
    assert_eq!(status, 0);
    assert!(!json.contains("\"online\""), "{json}");
    assert_eq!(control.requests(), asked);
    drop(control);
    assert_eq!(check(&config, &[]).2, 0);
    assert_eq!(check(&config, &["--online"]).2, 1);
}

/// `check --online` applies the guard's rule for the settings of a barrier. The barrier here has limits of 150 µm, 1
/// mm/s and 450 ms, and a scan of 2 ms.
#[test]
fn a_barrier_that_would_not_arm_is_found_before_the_start() {
    let dir = tempfile::tempdir().expect("writable");
    let control = crate::edges::start(crate::edges::world());
    let config = crate::edges::guarded(dir.path(), &control);
    // On a busy computer the simulated control may count too few scans.
    let fits = |more: &[&str]| {
        let asked = [&["--online"], more].concat();
        let mut answers = (0..20).map(|_| check(&config, &asked));
        let (text, errors, status) =
            answers.find(|(_, errors, _)| !errors.contains("scan_ms")).expect("scans of 2 ms");
        assert_eq!(status, 0, "{errors}");
        text
    };
    let text = fits(&[]);
    for expected in [
        "[controller.barrier]\nmachine = 4711\nscan_ms = 2.0",
        "# barrier = { machine = 4711, layout = 123, axes = [\"X\", \"Y\", \"Z\"], scan_ms = 2.0 }",
        "# owner = 0\n",
        "#   { name = \"X\", unit = \"µm\", limit = 150.0, rate_per_s = 1000.0 },",
        "# time_out_ms = 450.0",
    ] {
        assert!(text.contains(expected), "{expected}\n{text}");
    }
    let json = fits(&["--json"]);
    let document: Value = serde_json::from_str(&json).expect("JSON");
    crate::interop::validate("gateway-check.json", &document);
    assert_eq!(document["controllers"][0]["barrier"]["layout"], 123);
    assert_eq!(document["online"][0]["barrier"]["time_out_ms"], 450.0);
    let counted = document["online"][0]["barrier"]["scan_ms"].as_f64();
    assert!(counted.is_some_and(|ms| (1.6..2.5).contains(&ms)), "{json}");
    for (from, to, expected) in [
        (
            "limit_um = 150.0",
            "limit_um = 200.0",
            "axis X: guard.limit_um is 200 µm, and the barrier permits 150 µm",
        ),
        (
            "slew_um_per_s = 500.0",
            "slew_um_per_s = 600.0",
            "guard.slew_um_per_s needs a barrier rate of at least 1200 µm/s, twice the slew, and it is 1000 µm/s",
        ),
        (
            "zero_after_ms = 3000",
            "zero_after_ms = 400",
            "guard.zero_after_ms: found 400 ms, and the barrier releases the correction after 450 ms",
        ),
        ("scan_ms = 2.0", "scan_ms = 8.0", "barrier.scan_ms: found 8 ms, and the control counted"),
    ] {
        change(&config, from, to);
        let mut answers = (0..20).map(|_| check(&config, &["--online"]));
        let found = answers.find(|(_, errors, _)| errors.contains(expected));
        let (_, errors, status) = found.unwrap_or_else(|| panic!("{to}: expected {expected}"));
        assert_eq!(status, 1, "{to}: {errors}");
        change(&config, to, from);
    }
    fits(&[]);
}

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
