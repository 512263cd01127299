//! What `check` prints is what holds, not what was asked for.

use std::time::Duration;

use volcomp_gateway::{config::Config, plan::Plan};

fn plan(text: &str) -> Plan {
    let dir = tempfile::tempdir().expect("writable");
    std::fs::write(dir.path().join("machine.toml"), crate::program::MACHINE).expect("writable");
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
fn the_plan_tells_what_holds_and_what_was_asked() {
    let plan = plan(TEXT);
    let document = plan.document().expect("a plan");
    let guard = document.guard.as_ref().expect("limits");
    // 20 cycles of 40 ms.
    assert_eq!((guard.ramp_s.value, guard.ramp_s.asked), (0.8, Some(0.05)));
    let axis = &document.controllers[0].axes[0];
    assert_eq!((axis.limit.value, axis.limit.asked), (100.0, Some(100.5)));
    assert_eq!(axis.slew_per_s.asked, None);
    // Four steps of 2 µm are more than the 5 µm of the default.
    assert_eq!(axis.test_shift, 8.0);
    // The guard says the same.
    let limits = plan.limits()[0];
    assert_eq!(limits.ramp_taken(), Duration::from_millis(800));
    assert!((limits.axes[0].reachable() - 0.100).abs() < 1e-12);
    let text = plan.text().expect("a plan");
    for part in [
        "0.8 s                         G.toml (0.05 s asked)",
        "100 µm                        G.toml (100.5 µm asked)",
        "at least 20 cycles",
        "the limit 100.5 µm is no whole number of steps of 2 µm",
        "the test shift is 8 µm instead of 5 µm",
    ] {
        let joined = text.replace("\n     ", "");
        assert!(joined.contains(part), "{part}: {text}");
    }
    assert!(
        text.lines().all(|line| line.chars().count() <= 80),
        "{text}"
    );
}

#[test]
fn a_test_shift_that_is_not_made_is_told() {
    let coarse = TEXT
        .replace("resolution_um = 2.0", "resolution_um = 50.0")
        .replace("limit_um = 100.5", "limit_um = 100.0");
    let document = plan(&coarse).document().expect("a plan");
    assert_eq!(document.controllers[0].axes[0].test_shift, 0.0);
    let told = |note: &&String| note.contains("axes X, Y, Z: the test shift is not made");
    assert!(
        document.notes.iter().any(|note| told(&note)),
        "{document:?}"
    );
}

/// A note that holds for several axes stands once and names them; no warning lies above what is written.
#[test]
fn a_note_of_several_axes_stands_once() {
    let document = plan(TEXT).document().expect("a plan");
    let of_limit = document.notes.iter();
    let of_limit: Vec<_> = of_limit.filter(|n| n.contains("whole number")).collect();
    assert_eq!(of_limit.len(), 1, "{of_limit:?}");
    assert!(of_limit[0].contains("axes X, Y, Z: "), "{of_limit:?}");
    let axis = &document.controllers[0].axes[0];
    assert_eq!((axis.warn.value, axis.limit.value), (100.0, 100.0));
}

/// Rotary axes of the control that the machine file does not let correct need no limits, and `check` says that they are
/// held.
#[test]
fn axes_that_do_not_correct_are_told_as_held() {
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
    let line = "  axes B C            held, not corrected";
    assert!(
        plan.text().expect("a plan").contains(line),
        "{}",
        plan.text().expect("a plan")
    );
    // Whoever writes radians into a machine file is asked here, too, not by `volcomp` alone.
    let radians = machine.replace("travel = [-110.0, 110.0]", "travel = [-1.571, 1.571]");
    let plan = of(&format!("correct = [\"X\", \"Y\", \"Z\"]\n{radians}"));
    let notes = plan
        .unwrap_or_else(|e| panic!("{e}"))
        .document()
        .expect("a plan")
        .notes;
    let asks = notes
        .iter()
        .any(|note| note.contains("is it stated in radians?"));
    assert!(asks, "{notes:?}");
}

/// What arms itself and has no token can be disarmed at its own computer only.
#[test]
fn arming_itself_without_a_token_is_a_warning() {
    let document = plan(&format!("auto_arm = true\n{TEXT}"))
        .document()
        .expect("a plan");
    let told = document
        .notes
        .iter()
        .any(|note| note.contains("only this computer can disarm it"));
    assert!(told, "{:?}", document.notes);
}

#[test]
fn what_holds_as_it_is_asked_is_not_told_twice() {
    let fitting = TEXT
        .replace("cycle_ms = 40.0", "cycle_ms = 4.0")
        .replace("ramp_s = 0.05", "ramp_s = 0.5")
        .replace("limit_um = 100.5", "limit_um = 100.0")
        .replace("resolution_um = 2.0", "resolution_um = 1.0");
    let plan = plan(&fitting);
    assert_eq!(
        plan.document().expect("a plan").notes,
        [
            "no token: nobody can arm over HTTP: state [dashboard] token_file, start with --token-file FILE, or state auto_arm = true above the first table"
        ]
    );
    assert!(
        !plan.text().expect("a plan").contains("asked"),
        "{}",
        plan.text().expect("a plan")
    );
}

/// A path without a barrier is limited to 30 µm unless the configuration says otherwise in so many words.
#[test]
fn without_a_barrier_a_smaller_limit_holds() {
    let plan = plan(&TEXT.replace("limit_without_barrier_um = 150.0\n", ""));
    assert!((plan.limits()[0].axes[0].limit - 0.030).abs() < 1e-12);
    let document = plan.document().expect("a plan");
    let told = |note: &String| {
        note.contains("corrections go up to 30 µm, not 100.5 µm")
            && note.contains("limit_without_barrier_um")
    };
    assert!(document.notes.iter().any(told), "{:?}", document.notes);
}
