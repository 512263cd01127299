//! `check --online` reads the control and compares its settings. Without the option no device is opened.

use std::path::Path;

use serde_json::Value;
use volcomp_gateway::check;

use crate::{
    controlled::{configuration, control},
    program::change,
};

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
    let config = configuration(dir.path(), &control, "");
    let (text, errors, status) = check(&config, &["--online"]);
    assert_eq!(status, 0, "{errors}");
    assert!(text.contains("# shift_words = 100"), "{text}");
    let (json, ..) = check(&config, &["--online", "--json"]);
    let document: Value = serde_json::from_str(&json).expect("JSON");
    crate::documents::validate("gateway-check.json", &document);
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
    crate::documents::validate("gateway-check.json", &document);
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
        let (_, errors, status) = check(&config, &["--online"]);
        assert_eq!(status, 1, "{to}: {errors}");
        assert!(errors.contains(expected), "{to}: {errors}");
        change(&config, to, from);
    }
    fits(&[]);
}
