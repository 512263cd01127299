//! `volcomp fit --method auto`: chosen curve, candidates, and confidence band.

use std::{f64::consts::TAU, fmt::Write as _, fs};

use crate::{Draw, Folder, contains, float, json, list, text, volcomp};

/// Writes three bidirectional runs over 21 targets: `f` in µm, a reversal of 2 µm, and noise of standard deviation
/// `scatter`, µm.
fn file(scatter: f64, f: impl Fn(f64) -> f64) -> (Folder, String) {
    headed("target,run,direction,deviation_um", 50.0, scatter, f)
}

/// Like [`file`], with another header and distance of targets.
fn headed(head: &str, distance: f64, scatter: f64, f: impl Fn(f64) -> f64) -> (Folder, String) {
    let mut text = format!("{head}\n");
    let mut draw = Draw(20_261_126);
    for run in 1..=3 {
        for (sign, half) in [("+", 1.0), ("-", -1.0)] {
            for step in 0..=20 {
                let x = distance * f64::from(step);
                let read = f(x) + half + draw.noise(scatter);
                let _ = writeln!(text, "{x},{run},{sign},{read}");
            }
        }
    }
    let folder = Folder::new();
    let path = folder.path().join("x.csv");
    fs::write(&path, text).expect("written");
    (folder, path.display().to_string())
}

fn chosen(choice: &serde_json::Value) -> &serde_json::Value {
    let scores = list(&choice["scores"]);
    let mut chosen = scores.iter().filter(|score| score["method"] == choice["method"]);
    chosen.next().expect("one of them")
}

fn kind(score: &serde_json::Value) -> String {
    match &score["method"] {
        serde_json::Value::String(kind) => kind.clone(),
        method => method.as_object().and_then(|of| of.keys().next()).expect("a kind").clone(),
    }
}

/// A parabola with little noise is found, and its band contains the truth at 19 or more of 21 targets.
#[test]
fn a_parabola_is_chosen_with_its_reason_and_its_band() {
    let truth = |x: f64| 1e-5 * x * x - 0.004 * x;
    let (_folder, path) = file(0.2, truth);
    let at: Vec<String> = (0..=20).map(|step| (50 * step).to_string()).collect();
    let answer = json(&["fit", &path, "--method", "auto", "--at", &at.join(",")]);
    let choice = &answer["choice"];
    let quadratic = serde_json::json!({"polynomial": {"order": 2}});
    assert_eq!(choice["method"], quadratic, "{choice}");
    assert_eq!(chosen(choice)["follows"], true);
    assert_eq!(answer["band"]["from"], "runs");
    let halves = list(&answer["band"]["half_widths"]);
    let values = list(&answer["values"]);
    // The band is computed at seven positions between neighbouring targets as well.
    assert_eq!((halves.len(), values.len()), (161, 21));
    let number = |of: &serde_json::Value| of.as_f64().expect("a number");
    let mut held = 0;
    for (half, value) in halves.iter().step_by(8).zip(values) {
        let x = number(&half["at"]);
        assert_eq!(half["at"], value["at"]);
        let (half, miss) = (number(&half["half_width"]), number(&value["value_um"]) - truth(x));
        assert!(half > 0.0 && half < 0.5, "{x}: {half}");
        held += usize::from(miss.abs() <= half);
    }
    // The confidence level of 95 % applies to each target separately.
    assert!(held >= 19, "{held} of 21");
    // The same polynomial, requested by options, gives the same curve.
    let stated = json(&["fit", &path, "--method", "polynomial", "--order", "2"]);
    assert_eq!(stated["curve"], answer["curve"]);
    assert!(stated.get("choice").is_none() && stated.get("band").is_none());
    let shown = text(&["fit", &path, "--method", "auto"]);
    contains(&shown, "chosen: polynomial of order 2 (");
    contains(&shown, "95 % band: ±");
}

/// The deviation is a wave, which a table interpolates badly between its targets, and a zigzag (15 times the scatter of
/// the runs), which only a table follows. No kind of curve follows both, and a note states this.
#[test]
fn a_curve_that_does_not_follow_is_warned_of() {
    let (_folder, path) = file(0.02, |x| {
        let zigzag = if (x / 50.0).round() % 2.0 == 0.0 { 0.3 } else { -0.3 };
        50.0 * (TAU * x / 1000.0).sin() + zigzag
    });
    let output = volcomp(&["--json", "fit", &path, "--method", "auto"]);
    let notes = String::from_utf8_lossy(&output.stderr).replace("\n  ", " ");
    contains(&notes, "does not follow the readings");
    let answer: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(chosen(&answer["choice"])["follows"], false);
}

/// Two harmonics over a turn are found with their coefficients, with or without a target at 360°, and the curve is
/// periodic. The same readings in mm, or over less than a turn, have no harmonics as candidates.
#[test]
fn a_turn_is_a_fourier_series_and_nothing_else_is() {
    const DEG: &str = "target_deg,run,direction,deviation_urad";
    let truth = |deg: f64| {
        let angle = deg.to_radians();
        30.0 * angle.sin() + 12.0 * (2.0 * angle).cos()
    };
    let of = |head: &str, distance: f64| {
        let (folder, path) = headed(head, distance, 0.3, truth);
        let answer = json(&["fit", &path, "--method", "auto", "--at", "0,90,200,360"]);
        drop(folder);
        answer
    };
    let kinds = |answer: &serde_json::Value| -> Vec<String> {
        let scores = list(&answer["choice"]["scores"]);
        scores.iter().map(kind).collect()
    };
    for distance in [18.0, 360.0 / 21.0] {
        let answer = of(DEG, distance);
        let choice = &answer["choice"];
        assert!(choice["method"].get("fourier").is_some(), "{choice}");
        assert_eq!(chosen(choice)["follows"], true, "{choice}");
        let found = list(&answer["curve"]["fourier"]);
        assert!(found.len() >= 5, "{found:?}");
        let wanted = [0.0, 0.0, 30.0, 12.0, 0.0].into_iter();
        // Coefficients beyond the second harmonic are noise.
        for (found, wanted) in found.iter().zip(wanted.chain(std::iter::repeat(0.0))) {
            let found = found.as_f64().expect("a number");
            assert!((found - wanted).abs() < 0.3, "{found} {wanted}");
        }
        assert_eq!(answer["curve"]["period"], 360.0);
        // The only candidate besides the harmonics is the constant, since no other kind of curve is periodic.
        for score in list(&choice["scores"]) {
            let coefficients = float(&score["coefficients"]);
            assert!(kind(score) == "fourier" || coefficients < 1.5, "{score}");
        }
        assert_eq!(answer["band"]["from"], "runs");
    }
    for (head, distance) in
        [("target_mm,run,direction,deviation_um", 18.0), (DEG, 9.0), (DEG, 16.0)]
    {
        let answer = of(head, distance);
        assert!(
            !kinds(&answer).contains(&"fourier".to_owned()),
            "{head} {distance}: {:?}",
            kinds(&answer)
        );
    }
}

/// Three runs have very different zeros, and the second run stops half-way. The curve has no step there, and its band
/// is that of complete runs.
#[test]
fn a_run_that_stops_changes_neither_curve_nor_band() {
    let fitted = |stops: bool| {
        let mut text = "target,run,direction,deviation_um\n".to_owned();
        for (run, zero) in [(1, 0.0), (2, 40.0), (3, -8.0)] {
            for step in (0..=20).filter(|step| run != 2 || !stops || *step <= 10) {
                let x = 50.0 * f64::from(step);
                let _ = writeln!(text, "{x},{run},+,{}", 1e-5 * x * x - 0.004 * x + zero);
            }
        }
        let folder = Folder::new();
        let path = folder.path().join("x.csv");
        fs::write(&path, text).expect("written");
        json(&[
            "fit",
            &path.display().to_string(),
            "--method",
            "auto",
            "--at",
            "0,450,500,550,600,1000",
        ])
    };
    let [complete, stopped] = [false, true].map(fitted);
    assert_eq!(stopped["choice"]["method"], complete["choice"]["method"]);
    let number = |of: &serde_json::Value| of.as_f64().expect("a number");
    let rows = |of: &serde_json::Value, key: &str| -> Vec<f64> {
        list(of).iter().map(|row| number(&row[key])).collect()
    };
    let [a, b] = [&complete, &stopped].map(|of| rows(&of["values"], "value_um"));
    assert!(
        a.len() == b.len() && a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-6),
        "{a:?} {b:?}"
    );
    // Student's t of two degrees of freedom times s/√3 of the zeros. The resampling of complete runs adds its own
    // random deviation.
    let expected = 4.302_653 * (1_322.667_f64 / 2.0 / 3.0).sqrt();
    for (answer, within) in [(&complete, 0.02), (&stopped, 1e-5)] {
        let halves = rows(&answer["band"]["half_widths"], "half_width");
        let is_near = |half: &f64| (half / expected - 1.0).abs() < within;
        assert!(!halves.is_empty() && halves.iter().all(is_near), "{expected} {halves:?}");
    }
}
