//! `check` prints effective values, not the configured ones.

use std::{path::Path, time::Duration};

use volcomp_gateway::{check, config::Config, plan::Plan};

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
