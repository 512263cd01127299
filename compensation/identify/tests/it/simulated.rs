//! Observations of simulated machines, whose errors the identification must find.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::process::Command;

use volcomp_identify::{Observations, identify};
use volcomp_model::Machine;
use volcomp_test_support::root;
use volcomp_vocabulary::AxisName::{B, C, X, Y, Z};

use crate::lab::{Lab, Noise, csv, tip, value, worn};

const MACHINE: &str = "structure = \"w C' X' b Y Z B t\"
[axes.X]
travel = [-300.0, 300.0]
[axes.Y]
travel = [-200.0, 200.0]
[axes.Z]
travel = [0.0, 400.0]
[axes.C]
travel = [-360.0, 360.0]
[axes.B]
travel = [-100.0, 100.0]
point = [0.0, 0.0, 300.0]
[tool]
tip = [0.0, 0.0, 100.0]
";

/// Rows of a tracker in another frame, with a target away from the tip.
fn tracker(truth: &Machine, poses: usize, noise_um: f64) -> String {
    let mut noise = Noise::new(11);
    let rows = (0..poses).map(|_| {
        let at = [
            (X, noise.between(-300.0, 300.0)),
            (Y, noise.between(-200.0, 200.0)),
            (Z, noise.between(0.0, 400.0)),
            (C, noise.between(-360.0, 360.0)),
            (B, noise.between(-100.0, 100.0)),
        ];
        let seen = tip(truth, &at, [3.0, -2.0, 5.0]);
        let [x, y, z] = [seen.x, seen.y, seen.z].map(|x| x + noise.normal(noise_um * 1e-3));
        let [q_x, q_y, q_z, q_c, q_b] = at.map(|(_, q)| q);
        // Rotated by +90° about Z and shifted: workpiece = (−y', x', z') + (1000, 0, −50).
        [q_x, q_y, q_z, q_c, q_b, y, 1000.0 - x, z + 50.0]
    });
    csv("X,Y,Z,C,B,x,y,z", rows)
}

#[test]
fn errors_without_noise_are_found_to_the_last_digit() {
    let errors = "EC0Y = 30.0\nEA0B = -40.0\nEC0B = 12.0\nEX0C = 15.0\nEY0C = -9.0\nEA0C = 25.0\nEB0C = -14.0
EXX = { poly = [0.0, 0.02] }\nEYZ = { poly = [0.0, 0.0, 0.0001] }\nEBY = { poly = [0.0, 0.1] }
ECC = { fourier = [0.0, 5.0, -3.0], period = 360.0 }\n";
    let truth = worn(MACHINE, errors);
    let lab = Lab::new(MACHINE);
    lab.write("t.csv", &tracker(&truth, 60, 0.0));
    let found = lab
        .identify(
            "folds = 5
unknown = [\"EC0Y\", \"EA0B\", \"EC0B\", \"EX0C\", \"EY0C\", \"EA0C\", \"EB0C\",
{ error = \"EXX\", legendre = 1 }, { error = \"EYZ\", legendre = 2 }, { error = \"EBY\", legendre = 1 }, { error = \"ECC\", fourier = 1 }]
[[observation]]
kind = \"points\"
file = \"t.csv\"
target = \"unknown\"
",
        )
        .expect("found");
    // Fixing unknowns at zero is exact only to first order: products of errors of 30 µrad remain in the residuals.
    assert!(found.residual.max_um < 1e-3, "{:?}", found.residual);
    let left = found.left_out.expect("judged").figures;
    assert!(left.max_um < 1e-2, "{left:?}");
    // Single parameters depend on which unknowns are fixed at zero; volumetric errors do not, after best-fit rigid-body
    // alignment.
    let (frame_c, _) = value(&found, "t.csv:frame.c");
    assert!((frame_c - 90.0).abs() < 0.01, "{frame_c}");
    let others = [(X, 100.0), (Y, 50.0), (Z, 200.0), (C, 30.0), (B, 20.0)];
    let machine = &found.machine;
    assert!((tip(machine, &others, [0.0; 3]) - tip(&truth, &others, [0.0; 3])).norm() < 0.2);
}

/// Error motions that rotate with their axis, on the workpiece and on the tool side, are identified within 0.01 µm or
/// µrad. The readings come from the exact kinematics, which use the motion frame independently.
#[test]
fn error_motions_that_turn_with_their_axis_are_found() {
    for (c, b) in [("turning", "fixed"), ("fixed", "turning"), ("turning", "turning")] {
        let machine = MACHINE
            .replace("[axes.C]\n", &format!("[axes.C]\nmotion_frame = \"{c}\"\n"))
            .replace("[axes.B]\n", &format!("[axes.B]\nmotion_frame = \"{b}\"\n"));
        let errors = "EXC = { fourier = [0.0, 0.0, 0.0, 20.0, -9.0], period = 360.0 }
EAC = { fourier = [0.0, 0.0, 0.0, 5.0, 7.0], period = 360.0 }
EXB = { poly = [0.0, 0.0, 0.002] }\nECB = { poly = [0.0, 0.0, 0.003] }\n";
        let truth = worn(&machine, errors);
        let lab = Lab::new(&machine);
        lab.write("t.csv", &tracker(&truth, 60, 0.0));
        let found = lab
            .identify(
                "folds = 0
unknown = [{ error = \"EXC\", fourier = 2 }, { error = \"EAC\", fourier = 2 },
{ error = \"EXB\", legendre = 2 }, { error = \"ECB\", legendre = 2 }]
[[observation]]
kind = \"points\"
file = \"t.csv\"
target = \"unknown\"
",
            )
            .expect("found");
        assert!(found.residual.max_um < 1e-3, "C {c}, B {b}: {:?}", found.residual);
        for (name, expected) in
            [("EXC cos 2", 20.0), ("EXC sin 2", -9.0), ("EAC cos 2", 5.0), ("EAC sin 2", 7.0)]
        {
            let (found, _) = value(&found, name);
            assert!((found - expected).abs() < 0.01, "C {c}, B {b}: {name} {found}");
        }
    }
}

#[test]
fn indistinguishable_unknowns_are_named_and_left_at_zero() {
    let truth = Machine::parse(MACHINE, "truth").expect("a machine");
    let lab = Lab::new(MACHINE);
    lab.write("t.csv", &tracker(&truth, 30, 1.0));
    let found = lab
        .identify(
            "folds = 0
unknown = [\"EXX\", \"EX0C\", \"EC0Y\"]
[[observation]]
kind = \"points\"
file = \"t.csv\"
target = \"unknown\"
",
        )
        .expect("found");
    assert!(found.left_out.is_none());
    // C is between the frame and X: a displacement of X rotates with C, and so does a displacement of the axis of C.
    let null: Vec<&(String, f64)> = found.null.iter().flatten().collect();
    assert_eq!(found.null.len(), 1, "{null:?}");
    let names: Vec<&str> = null.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names[0], "EXX constant");
    assert!(names.contains(&"EX0C"), "{names:?}");
    assert_eq!(found.rank, found.parameters.len() - 1);
    assert_eq!(found.score, 0.0);
    // Only the constant of EXX is redundant.
    assert_eq!(found.redundant, ["EXX constant"]);
    assert!(found.score_of_determined > 1e-4 && found.score_of_determined < 1.0);
    let left = found.parameters.iter().find(|p| p.name == "EXX constant").expect("there");
    assert!(!left.determined && left.value == 0.0 && left.uncertainty.is_none());
    let mixed = found.parameters.iter().find(|p| p.name == "EX0C").expect("there");
    assert!(mixed.determined);
    assert_eq!(mixed.given_zero, ["EXX constant"]);
    let words = crate::lab::words(&found);
    assert!(
        words.contains("EXX constant cannot be distinguished from") && words.contains("EX0C"),
        "{words}"
    );
}

#[test]
fn a_reversal_value_is_found_from_the_order_of_the_rows() {
    let truth = worn(MACHINE, "EXX = { mean = 0.0, reversal = 8.0 }\n");
    let lab = Lab::new(MACHINE);
    let mut text = String::from("X,deviation_um\n");
    let mut before: Option<f64> = None;
    for x in [-300.0, -100.0, 0.0, 100.0, 300.0, 100.0, 0.0, -100.0, -200.0, 50.0] {
        let mut state = truth.state(&[(X, x)]).expect("a state");
        let index = truth.index_of(X).expect("X");
        state.approach[index] = before.and_then(|b| volcomp_vocabulary::Direction::of(x - b));
        before = Some(x);
        let error = truth.error_at(
            &state,
            volcomp_kinematics::Form::Exact,
            &volcomp_model::Temperatures::default(),
        );
        let _ = writeln!(text, "{x:?},{:?}", error.position_mm.x * 1e3);
    }
    lab.write("l.csv", &text);
    let found = lab
        .identify(
            "unknown = [{ error = \"EXX\", reversal = true }]
[[observation]]
kind = \"line\"
file = \"l.csv\"
direction = [2, 0, 0]
offset = \"unknown\"
",
        )
        .expect("found");
    let (reversal, _) = value(&found, "EXX reversal");
    assert!((reversal - 8.0).abs() < 1e-9, "{reversal}");
    let curve = found.machine.error("EXX".parse().expect("a name"));
    assert!(
        matches!(curve, Some(volcomp_curve::ErrorCurve::Reversal { reversal: b, .. }) if *b == reversal),
        "{curve:?}"
    );
}

#[test]
fn distances_between_poses_and_from_a_point() {
    // X is 10 µm too long on 600 mm, as a step gauge along X and a ballbar about a point show.
    let truth = worn(
        MACHINE,
        "EXX = { poly = [0.0, 0.0166666666666667] }\nEYY = { poly = [0.0, -0.02] }\n",
    );
    let lab = Lab::new(MACHINE);
    let at = |x: f64, y: f64| tip(&truth, &[(X, x), (Y, y)], [0.0; 3]);
    let mut gauge = String::from("pose,X,Y,from,to,length_mm\n");
    for x in [-300, -100, 100, 300] {
        let _ = writeln!(gauge, "p{x},{x},0,,,");
    }
    for x in [-100, 100, 300] {
        let length = (at(f64::from(x), 0.0) - at(-300.0, 0.0)).norm();
        let _ = writeln!(gauge, ",,,p-300,p{x},{length:?}");
    }
    lab.write("gauge.csv", &gauge);
    let centre = volcomp_kinematics::nalgebra::Vector3::new(20.0, 10.0, 100.0);
    let bar = (0..36).map(|step| {
        let angle = f64::from(step) / 18.0 * core::f64::consts::PI;
        let (x, y) = (20.0 + 150.0 * angle.cos(), 10.0 + 150.0 * angle.sin());
        [x, y, 0.0, (at(x, y) - centre).norm() - 150.0]
    });
    lab.write("bar.csv", &csv("X,Y,Z,length_mm", bar));
    let found = lab
        .identify(
            "unknown = [{ error = \"EXX\", legendre = 1 }, { error = \"EYY\", legendre = 1 }, \"EC0Y\"]
[[observation]]
kind = \"distance\"
file = \"gauge.csv\"
[[observation]]
kind = \"distance\"
file = \"bar.csv\"
point = \"unknown\"
dead_length = \"unknown\"
",
        )
        .expect("found");
    assert!(found.residual.max_um < 1e-6, "{:?}", found.residual);
    assert!((value(&found, "EXX legendre 1").0 - 5.0).abs() < 1e-3);
    assert!((value(&found, "bar.csv:point.x").0 - 20.0).abs() < 0.01);
    assert!(value(&found, "EC0Y").0.abs() < 1e-3);
    let slope = |machine: &Machine| {
        let curve = machine.error("EYY".parse().expect("a name")).expect("a curve");
        let index = machine.index_of(Y).expect("Y");
        let mut at = [0.0; 9];
        at[index] = 100.0;
        let high = curve.value(index, &at, None);
        at[index] = -100.0;
        high - curve.value(index, &at, None)
    };
    let [ours, expected] = [&found.machine, &truth].map(slope);
    assert!((ours - expected).abs() < 1e-3, "{ours} {expected} {:#?}", found.parameters);
}

#[test]
fn a_judged_file_uses_the_set_up_of_the_fitted_one() {
    let truth = worn(MACHINE, "EC0Y = 30.0\n");
    let lab = Lab::new(MACHINE);
    let rows = tracker(&truth, 40, 0.0);
    let lines: Vec<&str> = rows.lines().collect();
    lab.write("fit.csv", &lines[..31].join("\n"));
    lab.write("judge.csv", &[&lines[..1], &lines[31..]].concat().join("\n"));
    let text = |unknown: &str| {
        format!(
            "folds = 0\nunknown = [{unknown}]
[[observation]]
kind = \"points\"
file = \"judge.csv\"
target = \"unknown\"
judge = true
[[observation]]
kind = \"points\"
file = \"fit.csv\"
target = \"unknown\"
"
        )
    };
    let judged = lab.identify(&text("\"EC0Y\"")).expect("found").judged.expect("judged");
    assert_eq!(judged.rows, 10);
    assert!(judged.max_um < 1e-6, "{judged:?}");
    // With the wrong unknown a residual remains.
    let judged = lab.identify(&text("\"EA0Z\"")).expect("found").judged.expect("judged");
    assert!(judged.rms_um > 0.5, "{judged:?}");
}

/// A Fourier series identified over part of a turn keeps its end values beyond, and a note says that it does not close.
#[test]
fn a_series_over_a_part_of_a_turn_stays_within_it() {
    let truth = worn(MACHINE, "ECC = { fourier = [0.0, 5.0, -3.0], period = 360.0 }\n");
    let found = |last: f64| {
        let lab = Lab::new(MACHINE);
        let mut noise = Noise::new(3);
        let rows = (0..60).map(|k| {
            let at = [
                (X, noise.between(-300.0, 300.0)),
                (Y, noise.between(-200.0, 200.0)),
                (Z, noise.between(0.0, 400.0)),
                (C, last * f64::from(k) / 59.0),
                (B, noise.between(-100.0, 100.0)),
            ];
            let seen = tip(&truth, &at, [0.0; 3]);
            let [x, y, z, c, b] = at.map(|(_, q)| q);
            [x, y, z, c, b, seen.x, seen.y, seen.z]
        });
        lab.write("t.csv", &csv("X,Y,Z,C,B,x,y,z", rows));
        lab.identify("folds = 0\nunknown = [{ error = \"ECC\", fourier = 1 }]\n[[observation]]\nkind = \"points\"\nfile = \"t.csv\"\n")
            .expect("identified")
    };
    let ecc = "ECC".parse().expect("a name");
    for (last, goes_round) in [(40.0, false), (200.0, false), (355.0, true)] {
        let found = found(last);
        let own = found.machine.index_of(C).expect("C");
        let mut at = [0.0; 9];
        at[own] = 300.0;
        let curve = found.machine.error(ecc).expect("it was found");
        assert_eq!(curve.contains(own, &at), goes_round, "{last}");
        let mut end = at;
        end[own] = last;
        let (there, expected) = (curve.value(own, &at, None), curve.value(own, &end, None));
        assert!(goes_round || (there - expected).abs() < 1e-9, "{there} {expected}");
        let said = crate::lab::words(&found).lines().any(|note| note.contains("of a turn"));
        assert_eq!(said, !goes_round, "{:?}", found.warnings);
    }
}

/// Reversal values are identified from lengths between poses: the machine moves to the poses in the order of the file,
/// in whatever order the lengths between them are listed.
#[test]
fn reversal_values_are_found_from_lengths_between_poses() {
    let lab = Lab::new(MACHINE);
    let places = [
        ("A", 0.0, 0.0),
        ("B", 150.0, 0.0),
        ("C", 300.0, 0.0),
        ("D", 150.0, 0.0),
        ("E", 50.0, 150.0),
        ("F", 50.0, 0.0),
        ("G", 80.0, 70.0),
    ];
    // X is 20 µm/m too long and lags by 6 µm at reversals; for Y the values are 10 µm/m and −8 µm. The file does not
    // state the first approach directions.
    let mut text = String::from("pose,X,Y,from,to,length_mm\n");
    let mut before: Option<[f64; 2]> = None;
    let mut sides = [-1.0, 1.0];
    let mut tips = std::collections::BTreeMap::new();
    for (name, x, y) in places {
        let at = [x, y];
        for axis in 0..2 {
            let moved = before.map_or(0.0, |before| at[axis] - before[axis]);
            if moved != 0.0 {
                sides[axis] = moved.signum();
            }
        }
        before = Some(at);
        let tip = [x + 1e-3 * (0.02 * x + 3.0 * sides[0]), y + 1e-3 * (0.01 * y - 4.0 * sides[1])];
        tips.insert(name, tip);
        let _ = writeln!(text, "{name},{x:?},{y:?},,,");
    }
    for (from, to) in
        ["BC", "CD", "BE", "EF", "DF", "CE", "BF", "EG", "FG"].map(|pair| pair.split_at(1))
    {
        let [a, b] = [tips[from], tips[to]];
        let _ = writeln!(text, ",,,{from},{to},{:?}", (b[0] - a[0]).hypot(b[1] - a[1]));
    }
    lab.write("pairs.csv", &text);
    let found = lab
        .identify(
            "unknown = [{ error = \"EXX\", legendre = 1, reversal = true }, { error = \"EYY\", legendre = 1, reversal = true }]
folds = 0
[[observation]]
kind = \"distance\"
file = \"pairs.csv\"
uncertainty_um = 0.001
",
        )
        .expect("found");
    // 4 µm across a length of 150 mm add 4²/(2·150) nm, which linear equations do not contain.
    assert!(found.residual.max_um < 1e-4, "{:?}", found.residual);
    for (name, expected) in [("EXX reversal", 6.0), ("EYY reversal", -8.0)] {
        let (reversal, _) = value(&found, name);
        assert!((reversal - expected).abs() < 1e-4, "{name} {reversal}");
    }
}

/// Names of the unknowns in `tests/reference/exact.py`.
const NAMES: [&str; 13] = [
    "EC0Y",
    "EA0Z",
    "EB0Z",
    "EA0C",
    "EB0C",
    "EXX legendre 1",
    "EYY legendre 1",
    "EZZ legendre 1",
    "EYX legendre 2",
    "EYX legendre 3",
    "ECC constant",
    "ECC cos 1",
    "ECC sin 1",
];

#[test]
fn values_and_covariance_are_those_of_scipy() {
    let Some(python) = volcomp_test_support::peers::python() else {
        return;
    };
    let script = root().join("compensation/identify/tests/reference/exact.py");
    let data = root().join("examples/identification");
    let output =
        Command::new(python).arg(script).arg("fit").arg(&data).output().expect("Python is there");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).expect("UTF-8");
    let lines: Vec<Vec<f64>> = text
        .lines()
        .map(|line| line.split_whitespace().map(|n| n.parse().expect("a number")).collect())
        .collect();
    let (values, rows) = lines.split_first().expect("values and covariance");

    let folder = tempfile::tempdir().expect("a folder");
    for name in ["machine.toml", "tracker.csv"] {
        std::fs::copy(data.join(name), folder.path().join(name)).expect("copied");
    }
    let path = folder.path().join("o.toml");
    std::fs::write(
        &path,
        "machine = \"machine.toml\"\nfolds = 0
unknown = [\"EC0Y\", \"EA0Z\", \"EB0Z\", \"EA0C\", \"EB0C\",
{ error = \"EXX\", legendre = 1 }, { error = \"EYY\", legendre = 1 }, { error = \"EZZ\", legendre = 1 },
{ error = \"EYX\", legendre = 3 }, { error = \"ECC\", fourier = 1 }]
[[observation]]
kind = \"points\"
file = \"tracker.csv\"
target = { long = \"unknown\" }
uncertainty_um = 5.0
",
    )
    .expect("written");
    let found = identify(&Observations::read(&path).expect("read"), |_, _| {}).expect("found");
    let determined: Vec<&str> =
        found.parameters.iter().filter(|p| p.determined).map(|p| p.name.as_str()).collect();
    let place: BTreeMap<&str, usize> =
        determined.iter().enumerate().map(|(k, n)| (*n, k)).collect();
    let mut largest = [0.0_f64; 2];
    for (k, name) in NAMES.iter().enumerate() {
        let parameter = found.parameters.iter().find(|p| p.name == *name).expect("an unknown");
        let sigma = parameter.uncertainty.expect("determined");
        let difference = (parameter.value - values[k]).abs();
        largest[0] = largest[0].max(difference / sigma);
        assert!(difference < 1e-6 * sigma, "{name}: {} {} ± {sigma}", parameter.value, values[k]);
        for (j, other) in NAMES.iter().enumerate() {
            let ours = found.covariance[(place[name], place[other])];
            let size = (rows[k][k] * rows[j][j]).sqrt();
            largest[1] = largest[1].max((ours - rows[k][j]).abs() / size);
            assert!(
                (ours - rows[k][j]).abs() < 1e-3 * size,
                "{name} {other}: {ours} {}",
                rows[k][j]
            );
        }
    }
    println!(
        "largest differences: values {:.1e} of their uncertainty, covariance {:.1e}",
        largest[0], largest[1]
    );
}
