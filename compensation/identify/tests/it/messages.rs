//! Wording of rejections and notes.

use std::fmt::Write as _;

use volcomp_identify::{Follower, IdentifyError, RowReading, identify, identify_followed};
use volcomp_model::Machine;
use volcomp_test_support::cases;
use volcomp_vocabulary::AxisName::{X, Y};

use crate::lab::{Lab, Noise, csv, tip};

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
