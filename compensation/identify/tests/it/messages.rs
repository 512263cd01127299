//! Wording of rejections and notes: too few observations, large errors, and the basis of the uncertainties.

use std::fmt::Write as _;

use volcomp_identify::{Follower, IdentifyError, RowReading, identify, identify_followed};
use volcomp_model::Machine;
use volcomp_test_support::cases;
use volcomp_vocabulary::AxisName::{X, Y};

use crate::lab::{Lab, Noise, csv, tip, value};

const MACHINE: &str = "structure = \"w b X Y t\"
[axes.X]
travel = [0.0, 500.0]
[axes.Y]
travel = [0.0, 400.0]
[tools.T1]
tip = [0.0, 0.0, -100.0]
";

fn points(extra: &str) -> String {
    format!(
        "folds = 0\nunknown = [\"EC0Y\"]\n[[observation]]\nkind = \"points\"\nfile = \"t.csv\"\n{extra}\n"
    )
}

fn rows(places: &[(f64, f64)], noise_um: f64) -> String {
    let machine = Machine::parse(MACHINE, "m").expect("a machine");
    let mut noise = Noise::new(1);
    let rows = places.iter().map(|&(x, y)| {
        let at = tip(&machine, &[(X, x), (Y, y)], [0.0; 3]);
        let [a, b, c] = [at.x, at.y, at.z].map(|p| p + noise.normal(noise_um * 1e-3));
        [x, y, a, b, c]
    });
    csv("X,Y,x,y,z", rows)
}

const SQUARE: [(f64, f64); 6] =
    [(0.0, 0.0), (500.0, 0.0), (500.0, 400.0), (0.0, 400.0), (250.0, 200.0), (100.0, 300.0)];

#[test]
fn wrong_rows_are_refused_with_their_place() {
    let lab = Lab::new(MACHINE);
    for [table, extra, expected] in &cases(
        r"
X,Y,x,y,z\n1,2,3,nan,5\n |  | t.csv:2: y: found `nan`, expected a finite number
X,Y,x,y\n1,2,3,4\n |  | expected a column `z`
Z,x,y,z\n1,2,3,4\n |  | found a column `Z`, the structure `w b X Y t` has no axis Z
x,y,z\n2,3,4\n |  | expected the letters of the machine axes: X, Y
X,Y,x,y,z\n5000,2,3,4,5\n |  | t.csv:2: X: found 5000 mm, expected a position within the travel of X, 0 to 500 mm: is it another unit
X,Y,x,y,z,tool\n1,2,3,4,5,T9\n |  | t.csv:2: tool: machine `` has no tool `T9`, expected one of: T1
X,Y,x,y,z,order\n1,2,3,4,5,7\n1,2,3,4,5,6\n |  | t.csv:3: order: found 6 after 7, expected increasing numbers
X,Y,x,y,z\n |  | found no rows
X,Y,x,y,z\n1,2,3,4,5\n | judge = true | expected a fitted observation of this kind with the same frame
X,Y,x,y,z\n1,2,3,4,5\n | offset = 3 | unknown key
",
    ) {
        lab.write("t.csv", table);
        let message = lab.refused(&points(extra));
        assert!(message.contains(expected), "{table}\n{message}\n{expected}");
    }
}

/// A row file in two observations is rejected with both positions, because its rows would count twice or validate their
/// own fit. One bar may have several positions.
#[test]
fn a_row_file_of_two_observations_is_refused_with_both_places() {
    let lab = Lab::new(MACHINE);
    lab.write("t.csv", &rows(&SQUARE, 1.0));
    for (again, extra) in [("t.csv", ""), ("./t.csv", ""), ("t.csv", "judge = true")] {
        let second = format!("[[observation]]\nkind = \"points\"\nfile = \"{again}\"\n{extra}\n");
        let message = lab.refused(&(points("") + &second));
        let (o, expected) = (lab.path("o.toml"), "expected another file");
        assert!(
            message.starts_with(&format!("{o}:10: observation[1].file: found {again:?}"))
                && message.contains(&format!(
                    "which is also the file of the observation at {o}:6, {expected}"
                )),
            "{message}"
        );
    }
    lab.write("balls.csv", "ball,distance_mm,uncertainty_um\n0,0,0\n1,100,1\n2,200,1\n3,300,1\n");
    let mut text = String::from("folds = 0\nunknown = [{ error = \"EXX\", legendre = 1 }]\n");
    for y in [0, 300] {
        let file = format!("bar{y}.csv");
        let mut readings = String::from("X,Y,ball,along_um\n");
        for k in 0..4 {
            let _ = writeln!(readings, "{},{y},{k},0", 100 * k);
        }
        lab.write(&file, &readings);
        let _ = write!(
            text,
            "[[observation]]\nkind = \"ball-row\"\nrow = \"balls.csv\"\nfile = \"{file}\"\n"
        );
    }
    lab.identify(&text).expect("the same balls in two places");
}

#[test]
fn wrong_unknowns_are_refused() {
    let lab = Lab::new(MACHINE);
    lab.write("t.csv", &rows(&SQUARE, 1.0));
    for [unknown, expected] in &cases(
        r#"
"EXZ" | has no axis Z
"EX0X" | has no effect; put a zero offset into the constant of EXX
"EC0Y", "EC0Y" | EC0Y is listed twice
{ error = "EC0Y", legendre = 2 } | a location error is one number, never a curve
{ error = "EXX", fourier = 2 } | expected `legendre` or `bspline`: X is a linear axis
{ error = "EXX", legendre = 2, bspline = 5 } | found two kinds of curve
{ error = "EXX", bspline = 3 } | a whole number from 4 to
{ error = "EXX", second = { axis = "X", legendre = 2 } } | found "X", expected the second axis that EXX depends on, one of Y
{ error = "EXX", second = { axis = "Q", legendre = 2 } } | found "Q", expected the second axis that EXX depends on, one of Y
{ error = "EXX", second = { axis = "Y", fourier = 2 } } | found a Fourier series along Y, expected `legendre`: it is a linear axis
{ error = "EXX", second = { axis = "Y" } } | found no kind of curve along the second axis, expected one of legendre, bspline, fourier
{ error = "EXX", second = { axis = "Y", legendre = 0 } } | a whole number from 1 to 8
{ error = "EC0Y", second = { axis = "X", legendre = 2 } } | a location error is one number, never a curve
"#,
    ) {
        let text = points("").replace("\"EC0Y\"", unknown);
        let message = lab.refused(&text);
        assert!(message.contains(expected), "{unknown}\n{message}");
    }
}

#[test]
fn uninformative_poses_are_refused() {
    let lab = Lab::new(MACHINE);
    lab.write("t.csv", &rows(&[(100.0, 100.0); 5], 1.0));
    let message = lab.refused(&points(""));
    assert!(message.contains("found 5 rows that all have the same pose"), "{message}");
    lab.write("t.csv", &rows(&[(0.0, 0.0), (250.0, 200.0), (500.0, 400.0)], 1.0));
    let message = lab.refused(&points(""));
    assert!(message.contains("t.csv:frame: the frame cannot be determined"), "{message}");
    lab.write("t.csv", &rows(&SQUARE[..3], 1.0));
    let many = points("").replace(
        "[\"EC0Y\"]",
        "[\"EC0Y\", { error = \"EXX\", legendre = 5 }, { error = \"EYY\", legendre = 5 }]",
    );
    let message = lab.refused(&many);
    assert!(
        message.contains("found 9 numbers in 3 poses for 19 unknowns")
            && message.contains("determine at most 9"),
        "{message}"
    );
}

#[test]
fn poses_outside_travel_and_unused_columns_are_noted() {
    let lab = Lab::new(MACHINE);
    let text = rows(&SQUARE, 1.0).replace("X,Y,x,y,z", "X,Y,x,y,z,operator");
    let text: Vec<String> = text
        .lines()
        .enumerate()
        .map(|(k, l)| if k == 0 { l.to_owned() } else { format!("{l},me") })
        .collect();
    lab.write("t.csv", &text.join("\n").replace("\n500.0,400.0,", "\n500.2,400.0,"));
    let found = lab.identify(&points("")).expect("found");
    let words = crate::lab::words(&found);
    assert!(
        words.contains("line 4: X: found 500.2 mm, expected a position within the travel of X"),
        "{words}"
    );
    assert!(words.contains("columns that are not used: operator"), "{words}");
}

#[test]
fn readings_in_another_unit_are_refused() {
    let lab = Lab::new(MACHINE);
    // A tracker in metres.
    let metres: Vec<String> = rows(&SQUARE, 0.0)
        .lines()
        .enumerate()
        .map(|(line, text)| {
            let cells: Vec<&str> = text.split(',').collect();
            let scaled = cells[2..].iter().map(|cell| {
                let number: Result<f64, _> = cell.parse();
                number.map_or((*cell).to_owned(), |mm| format!("{:?}", mm * 1e-3))
            });
            assert!(line == 0 || cells.len() == 5);
            [cells[..2].join(","), scaled.collect::<Vec<_>>().join(",")].join(",")
        })
        .collect();
    lab.write("t.csv", &metres.join("\n"));
    let message = lab.refused(&points(""));
    assert!(
        message.starts_with(&*lab.path("t.csv")) && message.contains("are they in another unit?"),
        "{message}"
    );
    // A step gauge in inches.
    lab.write("t.csv", "pose,X,from,to,length_mm\na,0,,,\nb,254,,,\n,,a,b,10\n");
    let message = lab
        .refused("unknown = [\"EXX\"]\n[[observation]]\nkind = \"distance\"\nfile = \"t.csv\"\n");
    assert!(
        message.contains(
            "t.csv:4: row: found a length of 10 mm between poses that are nominally 254.000 mm apart"
        ),
        "{message}"
    );
}

#[test]
fn contradictory_observations_are_named() {
    let lab = Lab::new(MACHINE);
    // One gauge shows X 20 µm/m too long, the other 20 µm/m too short.
    for (file, sign) in [("long.csv", -1.0), ("short.csv", 1.0), ("y.csv", 0.0)] {
        let letter = if file == "y.csv" { "Y" } else { "X" };
        let mut text = format!("pose,{letter},from,to,length_mm\n");
        for x in [0, 100, 200, 300, 400] {
            let _ = writeln!(text, "p{x},{x},,,");
        }
        for x in [100, 200, 300, 400] {
            let x = f64::from(x);
            let _ = writeln!(text, ",,p0,p{x},{:?}", x + sign * 0.02e-3 * x);
        }
        lab.write(file, &text);
    }
    let observation =
        |file: &str| format!("[[observation]]\nkind = \"distance\"\nfile = \"{file}\"\n");
    let files = ["long.csv", "short.csv", "y.csv"].map(observation).concat();
    let text = format!(
        "folds = 0\nunknown = [{{ error = \"EXX\", legendre = 1 }}, {{ error = \"EYY\", legendre = 1 }}]\n{files}"
    );
    let found = lab.identify(&text).expect("found");
    let words = crate::lab::words(&found);
    // 20 µm/m on 100, 200, 300, 400 mm: 5.5 µm RMS in each.
    assert!(
        words.contains("(long.csv 5.5 times, short.csv 5.5 times, y.csv 0.0 times)")
            || words.contains("(short.csv 5.5 times, long.csv 5.5 times, y.csv 0.0 times)"),
        "{words}"
    );
}

/// Observations built by a program that refer to a missing part of the set-up are rejected with file and line.
#[test]
fn references_outside_the_set_up_are_refused() {
    let lab = Lab::new(MACHINE);
    lab.write("t.csv", &rows(&SQUARE, 1.0));
    let mut observations = lab.read(&points("")).expect("read");
    if let RowReading::Point { frame, .. } = &mut observations.observations[0].rows[1].reading {
        *frame = 7;
    }
    let error = identify(&observations, |_, _| {}).expect_err("there is one frame");
    assert_eq!(
        error.to_string(),
        "t.csv: line 3: found number 7 of the set-up's frames, expected less than 1"
    );
    observations.setup.frames.clear();
    assert!(identify(&observations, |_, _| {}).is_err());
}

/// Invalid followers are rejected when they are created, or with observations that lack the unknown.
#[test]
fn invalid_followers_are_refused() {
    let lab = Lab::new(MACHINE);
    lab.write("t.csv", &rows(&[(0.0, 0.0), (400.0, 10.0), (30.0, 300.0), (350.0, 380.0)], 1.0));
    let text = points("frame = \"unknown\"");
    let observations = lab.read(&text).expect("read");
    let parameters = identify(&observations, |_, _| {}).expect("found").parameters;
    let own = parameters.iter().find(|p| p.name == "EC0Y").expect("an unknown");
    let set_up = parameters.iter().find(|p| p.error.is_none()).expect("a set-up");
    let machine = || Machine::parse(MACHINE, "m").expect("a machine");
    let other = || Machine::parse(&MACHINE.replace("w b X Y t", "w X b Y t"), "m").expect("one");
    for (parameter, second, by, expected) in [
        (set_up, machine(), 10.0, "it is a number of a set-up"),
        (own, machine(), 0.0, "a number and not 0"),
        (own, machine(), f64::NAN, "a number and not 0"),
        (own, other(), 10.0, "two machines of one structure"),
    ] {
        let refused = Follower::new(parameter, [machine(), second], by).expect_err(expected);
        assert!(refused.to_string().contains(expected), "{refused}");
    }
    let refused = |followers: &[Follower], text: &str| {
        let observations = lab.read(text).expect("read");
        match identify_followed(&observations, followers, |_, _| {}) {
            Err(error @ IdentifyError::NotFollowing { .. }) => error.to_string(),
            Err(error) => panic!("{error}"),
            Ok(_) => panic!("found something"),
        }
    };
    let foreign = Follower::new(own, [other(), other()], 10.0).expect("one structure");
    let words = refused(&[foreign], &text);
    assert!(words.contains("another structure than that of the observations"), "{words}");
    let fitting = Follower::new(own, [machine(), machine()], 10.0).expect("right");
    let words = refused(&[fitting], &text.replace("EC0Y", "EXX"));
    assert!(words.contains("it is not an unknown"), "{words}");
}

const NOTED_MACHINE: &str = "structure = \"w b X Y t\"
axes.X.travel = [0.0, 500.0]
axes.Y.travel = [0.0, 400.0]
";

/// Points on a plate with this squareness error, µrad.
fn noted_points(count: usize, squareness_urad: f64, noise_um: f64) -> String {
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
    let lab = Lab::new(NOTED_MACHINE);
    lab.write("t.csv", &noted_points(30, 0.0, 1.0));
    let square = observed("unknown = [\"EC0Y\"]", &["t.csv"]);
    assert_eq!(words(&lab, &square), "");
    // Nine readings for six unknowns of the frame and the squareness, in ten folds.
    lab.write("t.csv", &noted_points(3, 0.0, 1.0));
    let few = words(&lab, &square);
    assert!(few.contains("9 numbers in 3 poses for 7 unknowns"), "{few}");
    assert!(few.contains("no cross-validation: 3 poses cannot be split into 10 parts"), "{few}");
    // A second tracker with one point does not determine its own frame, although the total number of readings would
    // suffice.
    lab.write("t.csv", &noted_points(30, 0.0, 1.0));
    lab.write("u.csv", "X,Y,x,y,z\n0,0,0,0,0\n");
    let thin = lab.identify(&observed("folds = 0\nunknown = [\"EC0Y\"]", &["t.csv", "u.csv"]));
    let thin = thin.expect_err("one point makes no frame");
    assert!(matches!(thin, IdentifyError::Frame { .. }), "{thin}");
}

/// A curve fitted to lines that is also an unknown here is dropped with a note.
#[test]
fn a_curve_that_is_dropped_is_noted() {
    let lab = Lab::new(&format!("{NOTED_MACHINE}\n[errors]\nEXX = {{ poly = [0.0, 0.01] }}\n"));
    lab.write("t.csv", &noted_points(30, 0.0, 1.0));
    let is_noted = |unknown: &str| {
        words(&lab, &observed(unknown, &["t.csv"]))
            .contains("the curve of EXX in the machine file is dropped")
    };
    assert!(is_noted("unknown = [\"EC0Y\", { error = \"EXX\", legendre = 2 }]"));
    assert!(!is_noted("unknown = [\"EC0Y\"]"));
}

#[test]
fn implausibly_large_errors_are_noted() {
    let lab = Lab::new(NOTED_MACHINE);
    let square = observed("folds = 0\nunknown = [\"EC0Y\"]", &["t.csv"]);
    lab.write("t.csv", &noted_points(30, 900.0, 1.0));
    assert_eq!(words(&lab, &square), "");
    lab.write("t.csv", &noted_points(30, 2500.0, 1.0));
    let large = words(&lab, &square);
    assert!(large.contains("EC0Y was identified as 2.5 mrad"), "{large}");
}

/// With penalties the covariance follows from the residuals: readings that scatter three times as much as stated make
/// the uncertainties three times as large, and no message asks to multiply them again.
#[test]
fn uncertainties_with_penalties_are_not_multiplied_twice() {
    let lab = Lab::new(NOTED_MACHINE);
    let mut found = Vec::new();
    for noise_um in [1.0, 6.0] {
        lab.write("t.csv", &noted_points(60, 0.0, noise_um));
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
    let lab = Lab::new(NOTED_MACHINE);
    lab.write("t.csv", &noted_points(30, 40.0, 1.0));
    let judge = observed("folds = 0\nunknown = []", &["t.csv"]);
    let found = lab.identify(&judge).expect("found");
    assert!(found.parameters.iter().all(|p| p.name.starts_with("t.csv:frame")));
    assert!(found.residual.rms_um > 3.0, "{:?}", found.residual);
    assert_eq!(found.next, None);
    lab.write("machine.toml", &format!("{NOTED_MACHINE}[errors]\nEC0Y = 40.0\n"));
    let found = lab.identify(&judge).expect("found");
    assert!(found.residual.rms_um < 2.0, "{:?}", found.residual);
}

/// A predicted file that deviates as a whole gives a note; its rows are not outliers within the file.
#[test]
fn a_judged_file_that_is_far_off_is_noted() {
    let lab = Lab::new(NOTED_MACHINE);
    lab.write("t.csv", &noted_points(30, 0.0, 1.0));
    let observed = format!(
        "{}[[observation]]\nkind = \"points\"\nfile = \"j.csv\"\njudge = true\n",
        observed("folds = 0\nunknown = [\"EC0Y\"]", &["t.csv"])
    );
    // The fitted rows deviate by 1.7 µm RMS; 1 µrad moves the predicted rows by about 0.2 µm.
    for (urad, is_far) in [(300.0, true), (50.0, true), (5.0, false)] {
        lab.write("j.csv", &noted_points(12, urad, 1.0));
        let noted = words(&lab, &observed);
        assert_eq!(noted.contains("j.csv: its judged rows are "), is_far, "{urad}: {noted}");
    }
}

#[test]
fn a_ballbar_in_another_unit_is_refused_and_a_long_gauge_is_not() {
    let lab = Lab::new(NOTED_MACHINE);
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
    let lab = Lab::new(NOTED_MACHINE);
    let head = "folds = 0\nunknown = [\"EC0Y\"]";
    lab.write("t.csv", &noted_points(30, 20.0, 1.0));
    lab.write("u.csv", &noted_points(30, 20.0, 1.0));
    let twice = words(&lab, &observed(head, &["t.csv", "u.csv"]));
    assert!(twice.contains("u.csv has the same content as t.csv"), "{twice}");
    lab.write("u.csv", &noted_points(29, 20.0, 1.0));
    let twin = words(&lab, &observed(head, &["t.csv", "u.csv"]));
    assert!(!twin.contains("the same content"), "{twin}");
}

/// An absurd number is rejected at its cell, instead of a message about outliers in other rows. A time may have any
/// value.
#[test]
fn an_absurd_number_is_refused_at_its_cell() {
    let lab = Lab::new(NOTED_MACHINE);
    let head = "folds = 0\nunknown = [\"EC0Y\"]";
    let whole = noted_points(30, 20.0, 1.0);
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
    let lab = Lab::new(NOTED_MACHINE);
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
