//! Corrections: corrected positions, CSV files, positions outside the range, and another machine as truth.

use std::fs;

use serde_json::json;

use crate::{Folder, contains, float, json, notes, refused, refuses, root, text};

const GANTRY: &str = "examples/gantry.toml";

#[test]
fn a_point_beyond_travel_or_range_is_told() {
    let answer = json(&["correct", "-m", GANTRY, "--at", "X=9000,Z=-1"]);
    assert_eq!(answer["outside_travel"], json!(["X", "Z"]));
    assert_eq!(answer["outside_range"], json!(["EXX", "EYX", "EZY", "EZZ"]));
    let inside = json(&["correct", "-m", GANTRY, "--at", "X=100"]);
    assert_eq!((&inside["outside_travel"], &inside["outside_range"]), (&json!([]), &json!([])));
    for command in ["error", "correct"] {
        let shown = text(&[command, "-m", GANTRY, "--at", "X=9000,Z=-1"]);
        contains(&shown, "travel X Z, range EXX EYX EZY EZZ");
        contains(
            &notes(&[command, "-m", GANTRY, "--at", "X=9000,Z=-1"]),
            "one position lies beyond",
        );
    }
}

/// With three linear axes the text does not mention `singular`, since linear axes cannot correct the tool axis. The
/// JSON contains the key.
#[test]
fn singular_is_spoken_of_only_where_rotary_axes_could_correct() {
    let points = "X,Y\n0,0\n100,0\n";
    let folder = Folder::new();
    let path = folder.write("points.csv", points);
    let shown = text(&["correct", "-m", GANTRY, "--points", &path]);
    assert!(!shown.contains("correctable") && !shown.contains("singular"), "{shown}");
    assert_eq!(json(&["correct", "-m", GANTRY, "--at", "X=1"])["singular"], json!(true));
    // At B = 0 the tool axis is parallel to C, so C cannot turn it.
    let shown = text(&["correct", "-m", "examples/five-axis.toml", "--at", "X=1"]);
    contains(&shown, "singular");
    let shown = text("correct -m examples/five-axis.toml --at X=1,B=30");
    assert!(!shown.contains("singular"), "{shown}");
}

#[test]
fn chosen_axes_alone_move() {
    let answer = json("correct -m examples/gantry.toml --at X=1000,Y=500 --axes X,Y");
    assert_eq!(answer["correction"]["Z"], json!(0.0));
    assert_ne!(answer["correction"]["X"], json!(0.0));
    // `--correct` is the former name of `--axes`.
    let before = json("correct -m examples/gantry.toml --at X=1000,Y=500 --correct X,Y");
    assert_eq!(before, answer);
    let small = json(&["correct", "-m", GANTRY, "--at", "x=1000 y=500", "--axes", "x,y"]);
    assert_eq!(small, answer);
    for wrong in ["X,X", "Q", "XY", "A"] {
        refused(&["correct", "-m", GANTRY, "--at", "X=1", "--axes", wrong]);
    }
}

#[test]
fn other_columns_and_decimal_commas_pass_through_to_the_file() {
    let folder = Folder::new();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (points, out) = (path("points.csv"), path("out.csv"));
    fs::write(&points, "N;X;Y;remark\r\n10;1000,0;0;\"drill; first\"\r\n20;0;500,5;\r\n")
        .expect("written");
    let answer = json(&["correct", "-m", GANTRY, "--points", &points, "-o", &out]);
    let written = fs::read_to_string(&out).expect("written");
    let lines: Vec<&str> = written.lines().collect();
    assert_eq!(lines.len(), 3);
    assert!(
        lines[0].starts_with(
            "N;X;Y;remark;X_corrected_mm;Y_corrected_mm;Z_corrected_mm;X_correction_um;"
        ),
        "{written}"
    );
    assert!(lines[1].starts_with("10;1000,0;0;\"drill; first\";"), "{written}");
    let corrected: f64 =
        lines[2].split(';').nth(5).expect("a cell").replace(',', ".").parse().expect("a number");
    let expected = float(&answer["points"][1]["corrected"]["Y"]);
    assert!((corrected - expected).abs() < 1e-9, "{corrected} {expected}");
    // A file with decimal points and commas between its columns, and a single position from the command line.
    fs::write(&points, "remark,X\na,1\n").expect("written");
    json(&["correct", "-m", GANTRY, "--points", &points, "-o", &out]);
    assert!(fs::read_to_string(&out).expect("written").starts_with("remark,X,X_corrected_mm"));
    json(&format!("correct -m examples/five-axis.toml --at X=1,C=9 -o {out}"));
    let written = fs::read_to_string(&out).expect("written");
    assert!(written.starts_with("X_mm,Y_mm,Z_mm,B_deg,C_deg,X_corrected_mm,Y_corrected_mm,Z_corrected_mm,B_corrected_deg,C_corrected_deg,"), "{written}");
    assert!(
        refused("correct -m examples/gantry.toml --at X=1 -o nowhere/o.csv")
            .contains("cannot be written")
    );
}

#[test]
fn nothing_is_written_as_minus_zero() {
    let folder = Folder::new();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (machine, out) = (path("m.toml"), path("out.csv"));
    let axes = volcomp_test_support::machines::gantry([[0.0, 1000.0]; 3]);
    let errors = "[errors]\nEXX = { poly = [1e-12] }\nEYY = { poly = [-1e-12] }\n";
    fs::write(&machine, format!("{axes}{errors}")).expect("written");
    json(&["correct", "-m", &machine, "--at", "X=0,Y=0,Z=7", "-o", &out]);
    let written = fs::read_to_string(&out).expect("written");
    let row = written.lines().nth(1).expect("a row");
    assert!(row.starts_with("0,0,7,0,0,7,0,0,0,0,"), "{written}");
}

/// A model compared with itself leaves zero, and the output states that this proves nothing. A model compared with
/// another machine leaves the difference of the two, here 10 µm over the travel of X.
#[test]
fn a_model_against_itself_is_called_so_and_another_truth_shows() {
    let shown = text(&["diagonals", "-m", GANTRY, "--compensated"]);
    contains(&shown, "the model against itself");
    assert!(!text(&["diagonals", "-m", GANTRY]).contains("against itself"));
    let folder = Folder::new();
    let truth = folder.file("truth.toml");
    let machine = fs::read_to_string(root().join(GANTRY)).expect("read");
    let other = machine.replace("EXX = { poly = [0.0, 0.0073,", "EXX = { poly = [0.0, 0.00855,");
    assert_ne!(other, machine);
    fs::write(&truth, other).expect("written");
    let answer = json(&["diagonals", "-m", GANTRY, "--truth", &truth]);
    // Direction cosine of X in the diagonal: 8000 mm of √(8000² + 4000² + 2500²) mm.
    let share = 8000.0 / (8000.0_f64.powi(2) + 4000.0_f64.powi(2) + 2500.0_f64.powi(2)).sqrt();
    for name in ["PPP", "NPP", "PNP", "PPN"] {
        let range = float(&answer[name]["range_um"]);
        assert!((range - 10.0 * share).abs() < 0.01, "{name}: {range}");
    }
    assert_eq!(answer["compensated"]["truth"], json!(truth));
    let shown = text(&["diagonals", "-m", GANTRY, "--truth", &truth]);
    assert!(!shown.contains("against itself"), "{shown}");
    let map = json(&["map", "-m", GANTRY, "--grid", "5x3x3", "--truth", &truth]);
    let largest = float(&map["largest_um"]);
    assert!((largest - 10.0).abs() < 0.01, "{largest}");
    assert_eq!(map["at"]["X"], json!(8000.0));
    let itself = text(&["map", "-m", GANTRY, "--grid", "5x3x3", "--compensated"]);
    contains(&itself, "the model against itself");
    let rounded = json(&["map", "-m", GANTRY, "--grid", "9x9x9", "--resolution", "2"]);
    let largest = float(&rounded["largest_um"]);
    // Rounding to the output step leaves at most half a step on each of three axes.
    assert!((0.9..=3.0_f64.sqrt() + 0.01).contains(&largest), "{largest}");
    for (arguments, expected) in [
        (["--resolution", "0"], "above 0"),
        (["--truth", "examples/mill.toml"], "structure is"),
        (["--truth", "nowhere.toml"], "nowhere.toml: cannot be read"),
    ] {
        for command in [&["diagonals", "-m", GANTRY][..], &["map", "-m", GANTRY, "--grid", "2x2x2"]]
        {
            refuses(&[command, &arguments].concat(), expected);
        }
    }
    refuses(
        "map -m examples/gantry.toml --grid 2x2x2 --compensated --model twist",
        "expected exact",
    );
}
