//! Notes on too few observations, large errors, and the basis of the uncertainties.

use std::fmt::Write;

use volcomp_identify::IdentifyError;

use crate::lab::{Lab, Noise, csv, value};

const MACHINE: &str = "structure = \"w b X Y t\"
axes.X.travel = [0.0, 500.0]
axes.Y.travel = [0.0, 400.0]
";

/// Points on a plate with this squareness error, µrad.
fn points(count: usize, squareness_urad: f64, noise_um: f64) -> String {
    let mut noise = Noise::new(31);
    let rows = (0..count).map(|k| {
        let (x, y) = ((k * 37 % 11) as f64 * 45.0, (k * 17 % 9) as f64 * 48.0);
        let mut n = || noise.normal(1e-3 * noise_um);
        let seen = x - 1e-6 * squareness_urad * y + n();
        [x, y, seen, y + n(), n()]
    });
    csv("X,Y,x,y,z", rows)
}

fn observed(head: &str, files: &[&str]) -> String {
    let each = |file: &&str| format!("[[observation]]\nkind = \"points\"\nfile = \"{file}\"\n");
    let all: String = files.iter().map(each).collect();
    format!("{head}\n{all}")
}

fn words(lab: &Lab, observed: &str) -> String {
    crate::lab::words(&lab.identify(observed).expect("found"))
}

#[test]
fn too_few_numbers_are_noted() {
    let lab = Lab::new(MACHINE);
    lab.write("t.csv", &points(30, 0.0, 1.0));
    let square = observed("unknown = [\"EC0Y\"]", &["t.csv"]);
    assert_eq!(words(&lab, &square), "");
    // Nine readings for six unknowns of the frame and the squareness, in ten folds.
    lab.write("t.csv", &points(3, 0.0, 1.0));
    let few = words(&lab, &square);
    assert!(few.contains("9 numbers in 3 poses for 7 unknowns"), "{few}");
    assert!(few.contains("no cross-validation: 3 poses cannot be split into 10 parts"), "{few}");
    // A second tracker with one point does not determine its own frame, although the total number of readings would
    // suffice.
    lab.write("t.csv", &points(30, 0.0, 1.0));
    lab.write("u.csv", "X,Y,x,y,z\n0,0,0,0,0\n");
    let thin = lab.identify(&observed("folds = 0\nunknown = [\"EC0Y\"]", &["t.csv", "u.csv"]));
    let thin = thin.expect_err("one point makes no frame");
    assert!(matches!(thin, IdentifyError::Frame { .. }), "{thin}");
}

/// A curve fitted to lines that is also an unknown here is dropped with a note.
#[test]
fn a_curve_that_is_dropped_is_noted() {
    let lab = Lab::new(&format!("{MACHINE}\n[errors]\nEXX = {{ poly = [0.0, 0.01] }}\n"));
    lab.write("t.csv", &points(30, 0.0, 1.0));
    let is_noted = |unknown: &str| {
        words(&lab, &observed(unknown, &["t.csv"]))
            .contains("the curve of EXX in the machine file is dropped")
    };
    assert!(is_noted("unknown = [\"EC0Y\", { error = \"EXX\", legendre = 2 }]"));
    assert!(!is_noted("unknown = [\"EC0Y\"]"));
}

#[test]
fn implausibly_large_errors_are_noted() {
    let lab = Lab::new(MACHINE);
    let square = observed("folds = 0\nunknown = [\"EC0Y\"]", &["t.csv"]);
    lab.write("t.csv", &points(30, 900.0, 1.0));
    assert_eq!(words(&lab, &square), "");
    lab.write("t.csv", &points(30, 2500.0, 1.0));
    let large = words(&lab, &square);
    assert!(large.contains("EC0Y was identified as 2.5 mrad"), "{large}");
}

/// With penalties the covariance follows from the residuals: readings that scatter three times as much as stated make
/// the uncertainties three times as large, and no message asks to multiply them again.
#[test]
fn uncertainties_with_penalties_are_not_multiplied_twice() {
    let lab = Lab::new(MACHINE);
    let mut found = Vec::new();
    for noise_um in [1.0, 6.0] {
        lab.write("t.csv", &points(60, 0.0, noise_um));
        for penalty in ["none", "auto"] {
            let observed = observed(
                &format!(
                    "folds = 0\npenalty = \"{penalty}\"\nunknown = [\"EC0Y\", {{ error = \"EYX\", legendre = 4 }}]"
                ),
                &["t.csv"],
            );
            let of = lab.identify(&observed).expect("found");
            let words = crate::lab::words(&of);
            assert_eq!(
                words.contains("multiply them by"),
                noise_um > 5.0 && penalty == "none",
                "{words}"
            );
            assert_eq!(
                words.contains("follow from the residuals and include this already"),
                noise_um > 5.0 && penalty == "auto",
                "{words}"
            );
            found.push(value(&of, "EC0Y").1);
        }
    }
    let [plain, with, plain_of_six, with_of_six] = found[..] else {
        panic!("{found:?}");
    };
    assert!((plain_of_six / plain - 1.0).abs() < 1e-4, "{found:?}");
    assert!((with_of_six / with - 6.0).abs() < 1.5, "{found:?}");
}

#[test]
fn a_machine_file_is_validated_with_an_identified_set_up() {
    let lab = Lab::new(MACHINE);
    lab.write("t.csv", &points(30, 40.0, 1.0));
    let judge = observed("folds = 0\nunknown = []", &["t.csv"]);
    let found = lab.identify(&judge).expect("found");
    assert!(found.parameters.iter().all(|p| p.name.starts_with("t.csv:frame")));
    assert!(found.residual.rms_um > 3.0, "{:?}", found.residual);
    assert_eq!(found.next, None);
    lab.write("machine.toml", &format!("{MACHINE}[errors]\nEC0Y = 40.0\n"));
    let found = lab.identify(&judge).expect("found");
    assert!(found.residual.rms_um < 2.0, "{:?}", found.residual);
}

/// A predicted file that deviates as a whole gives a note; its rows are not outliers within the file.
#[test]
fn a_judged_file_that_is_far_off_is_noted() {
    let lab = Lab::new(MACHINE);
    lab.write("t.csv", &points(30, 0.0, 1.0));
    let observed = format!(
        "{}[[observation]]\nkind = \"points\"\nfile = \"j.csv\"\njudge = true\n",
        observed("folds = 0\nunknown = [\"EC0Y\"]", &["t.csv"])
    );
    // The fitted rows deviate by 1.7 µm RMS; 1 µrad moves the predicted rows by about 0.2 µm.
    for (urad, is_far) in [(300.0, true), (50.0, true), (5.0, false)] {
        lab.write("j.csv", &points(12, urad, 1.0));
        let noted = words(&lab, &observed);
        assert_eq!(noted.contains("j.csv: its judged rows are "), is_far, "{urad}: {noted}");
    }
}

#[test]
fn a_ballbar_in_another_unit_is_refused_and_a_long_gauge_is_not() {
    let lab = Lab::new(MACHINE);
    let bar = (0..12).map(|k| {
        let (sin, cos) = (f64::from(k) * 0.5).sin_cos();
        let length = 150_000.0 + f64::from(k % 3);
        [200.0 + 150.0 * cos, 200.0 + 150.0 * sin, length]
    });
    lab.write("b.csv", &csv("X,Y,length_mm", bar));
    let message = lab.refused(
        "unknown = [\"EC0Y\"]\n[[observation]]\nkind = \"distance\"\nfile = \"b.csv\"\npoint = \"unknown\"\ndead_length = \"unknown\"\n",
    );
    assert!(
        message.contains("found a length of 150000 mm") && message.contains("is it another unit?"),
        "{message}"
    );
    // 6 mm on 10 m is within the limit: it can be a cold machine.
    let long = Lab::new("structure = \"w b X t\"\naxes = { X = { travel = [0, 12000] } }\n");
    let mut gauge = String::from("pose,X,from,to,length_mm\n");
    for x in [0, 5000, 10000] {
        let _ = writeln!(gauge, "p{x},{x},,,");
    }
    gauge.push_str(",,p0,p5000,5003\n,,p0,p10000,10006\n,,p5000,p10000,5003\n");
    long.write("g.csv", &gauge);
    long.identify("folds = 0\nunknown = [{ error = \"EXX\", legendre = 1 }]\n[[observation]]\nkind = \"distance\"\nfile = \"g.csv\"\n")
        .expect("found");
}

/// With a `modulo` C at 0°, 360° and −720° is one pose; so are angles that differ by rounding.
#[test]
fn a_turn_of_a_modulo_is_the_same_pose() {
    for (modulo, is_one) in [(", modulo = 360", true), ("", false)] {
        let lab = Lab::new(&format!(
            "structure = \"w C b X Y Z t\"\naxes = {{ X = {{ travel = [-300, 300] }}, Y = {{ travel = [-300, 300] }}, Z = {{ travel = [-300, 300] }}, C = {{ travel = [-720, 720]{modulo} }} }}\n",
        ));
        let mut text = String::from("X,Y,Z,C,sphere,dx_um,dy_um,dz_um\n");
        for c in ["0", "360", "-720", "0.0000001", "359.9999999"] {
            let _ = writeln!(text, "100,0,0,{c},one,1,2,3");
        }
        lab.write("s.csv", &text);
        let found = lab.identify(
            "folds = 0\nunknown = [\"EX0C\"]\n[[observation]]\nkind = \"sphere\"\nfile = \"s.csv\"\n",
        );
        let is_refused =
            matches!(found, Err(volcomp_identify::IdentifyError::AllAlike { rows: 5 }));
        assert_eq!(is_refused, is_one, "{found:?}");
    }
}

/// A file with the same rows under another name is noted, because its rows count twice.
#[test]
fn one_test_under_two_names_is_noted() {
    let lab = Lab::new(MACHINE);
    let head = "folds = 0\nunknown = [\"EC0Y\"]";
    lab.write("t.csv", &points(30, 20.0, 1.0));
    lab.write("u.csv", &points(30, 20.0, 1.0));
    let twice = words(&lab, &observed(head, &["t.csv", "u.csv"]));
    assert!(twice.contains("u.csv has the same content as t.csv"), "{twice}");
    lab.write("u.csv", &points(29, 20.0, 1.0));
    let twin = words(&lab, &observed(head, &["t.csv", "u.csv"]));
    assert!(!twin.contains("the same content"), "{twin}");
}

/// An absurd number is rejected at its cell, instead of a message about outliers in other rows. A time may have any
/// value.
#[test]
fn an_absurd_number_is_refused_at_its_cell() {
    let lab = Lab::new(MACHINE);
    let head = "folds = 0\nunknown = [\"EC0Y\"]";
    let whole = points(30, 20.0, 1.0);
    let with = |row: usize, column: usize, cell: &str| {
        let mut rows: Vec<Vec<&str>> = whole.lines().map(|row| row.split(',').collect()).collect();
        rows[row][column] = cell;
        let rows: Vec<String> = rows.iter().map(|cells| cells.join(",")).collect();
        rows.join("\n")
    };
    for (row, column, name) in [(7, 2, "x"), (12, 4, "z")] {
        for cell in ["1e308", "-1e12"] {
            lab.write("t.csv", &with(row, column, cell));
            let why = lab.refused(&observed(head, &["t.csv"]));
            let place = format!("t.csv:{}: {name}: found", row + 1);
            assert!(why.contains(&place), "{why}");
        }
    }
    let timed = whole.replacen("X,Y", "order,X,Y", 1);
    let timed: Vec<String> = (timed.lines().enumerate())
        .map(|(row, text)| {
            if row == 0 {
                text.to_owned()
            } else {
                format!("{},{text}", 1_700_000_000_000_u64 + row as u64)
            }
        })
        .collect();
    lab.write("t.csv", &timed.join("\n"));
    assert_eq!(words(&lab, &observed(head, &["t.csv"])), "");
}

/// Lengths that share a pose give a note, because both may depend on the same reading at that pose.
#[test]
fn lengths_that_share_a_pose_are_noted() {
    let lab = Lab::new(MACHINE);
    let said = |pairs: &[(&str, &str, f64)]| {
        let mut text = String::from("pose,X,Y,from,to,length_mm\n");
        for (pose, x, y) in [("a", 0, 0), ("b", 300, 0), ("c", 0, 400), ("d", 300, 400)] {
            let _ = writeln!(text, "{pose},{x},{y},,,");
        }
        for (from, to, length) in pairs {
            let _ = writeln!(text, ",,,{from},{to},{length:?}");
        }
        lab.write("t.csv", &text);
        words(
            &lab,
            "folds = 0\nunknown = [\"EC0Y\"]\n[[observation]]\nkind = \"distance\"\nfile = \"t.csv\"\ndead_length = \"known\"\n",
        )
    };
    let apart = said(&[("a", "d", 500.0), ("b", "c", 500.0)]);
    assert!(!apart.contains("share a pose"), "{apart}");
    let common = said(&[("a", "b", 300.0), ("c", "d", 300.0), ("a", "d", 500.0)]);
    assert!(
        common.contains("t.csv: several lengths share a pose, first those of lines 6 and 8: they count as independent"),
        "{common}"
    );
}
