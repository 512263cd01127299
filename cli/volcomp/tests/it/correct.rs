//! Positions on the command line and in CSV files, and their corrections.
//!
//! The cases are headers with units, copied columns, typing errors, corrected positions, positions outside the range,
//! and another machine as truth.

use std::fs;

use serde_json::{Value, json};

use crate::{Folder, cases, contains, float, json, notes, refused, refuses, root, text};

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
    let machine = fs::read_to_string(root().join(GANTRY)).expect("read");
    let other = machine.replace("EXX = { poly = [0.0, 0.0073,", "EXX = { poly = [0.0, 0.00855,");
    assert_ne!(other, machine);
    let truth = folder.write("truth.toml", other);
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

const FIVE_AXES: &str = "examples/five-axis.toml";

fn first(machine: &str, points: &str) -> Value {
    json(&["error", "-m", machine, "--points", points])["points"][0].clone()
}

#[test]
fn a_head_may_name_its_unit() {
    let folder = Folder::new();
    let expected = json(&["error", "-m", FIVE_AXES, "--at", "X=700,Y=0,Z=0,B=0,C=30"]);
    for header in ["X,Y,C", "x,y,c", "X mm,Y_mm,C deg", "X [mm],Y (mm),C_deg", "X (MM),Y/mm,C [°]"]
    {
        let points = folder.write("p.csv", format!("{header}\n700,0,30\n"));
        assert_eq!(first(FIVE_AXES, &points), expected, "{header}");
    }
    // A column with another unit is an error.
    let wrong = "
X in,Y,C => found column `X in` with the unit `in`, expected positions of X in mm: X or X_mm
X,Y,C [rad] => found column `C [rad]` with the unit `rad`, expected positions of C in deg: C or C_deg
X,X mm,C => found columns `X` and `X mm`, expected one with positions of X
X,Y,A mm => found column `A mm` with the unit `mm`
X,Y,A deg => has no axis A
Xposition,Yposition,remark => found no axis letter
X,Y_inches,C => found column `Y_inches`, expected positions of Y in mm: Y or Y_mm
X,Y,C: => expected positions of C in deg: C or C_deg
";
    for (header, expected) in cases(wrong) {
        let points = folder.write("p.csv", format!("{header}\n700,0,30\n"));
        let message = refused(&["error", "-m", FIVE_AXES, "--points", &points]);
        assert!(message.contains(expected), "{header}: {message}");
        contains(&message, "p.csv:1: header: ");
    }
    // Lower-case columns next to upper-case ones are targets in another frame.
    let points = folder.write("p.csv", "x,X,Y,C,y\n9,700,0,30,8\n");
    assert_eq!(first(FIVE_AXES, &points), expected);
    // Next to a column of positions, another column with that letter is copied.
    for header in ["X,X_um,Y,C", "X,X remark,Y,C", "X,A:remark,Y,C"] {
        let points = folder.write("p.csv", format!("{header}\n700,1,0,30\n"));
        assert_eq!(first(FIVE_AXES, &points), expected, "{header}");
    }
}

#[test]
fn axes_that_nothing_names_are_told() {
    let folder = Folder::new();
    let said = notes(&["error", "-m", FIVE_AXES, "--at", "X=1,B=2"]);
    contains(&said, "note: at 0, as --at does not name them: Y, Z, C");
    let said = notes(&["correct", "-m", FIVE_AXES, "--at", "X=1,Y=1,Z=1,B=2,C=0"]);
    assert!(!said.contains("at 0"), "{said}");
    let points = folder.write("p.csv", "X,Y,Z\n");
    let said = notes(&["error", "-m", "examples/first.toml", "--points", &points]);
    assert_eq!(said, "note: --points has no row under its header");
    let points = folder.write("p.csv", "X,Yposition\n1,2\n");
    let said = notes(&["error", "-m", "examples/first.toml", "--points", &points]);
    assert_eq!(said, "note: at 0, as no column is headed by their letters: Y, Z");
}

#[test]
fn every_column_passes_through_and_an_answer_is_read_again() {
    let folder = Folder::new();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (once, twice) = (path("once.csv"), path("twice.csv"));
    let points = folder
        .write("p.csv", "N,X mm,,Y,remark,\n1,1000,lost,500,\"a \"\"b\"\", c\",end\n2,0,,0,,\n");
    let correct =
        |from: &str, to: &str| json(&["correct", "-m", GANTRY, "--points", from, "-o", to]);
    let answer = correct(&points, &once);
    let file = fs::read_to_string(&once).expect("written");
    let lines: Vec<&str> = file.lines().collect();
    assert!(lines[0].starts_with("N,X mm,,Y,remark,,X_corrected_mm,"), "{file}");
    assert!(lines[1].starts_with("1,1000,lost,500,\"a \"\"b\"\", c\",end,999.99"), "{file}");
    assert!(lines[2].starts_with("2,0,,0,,,"), "{file}");

    // The output is itself a table of positions, with the same numbers and without repeated columns.
    assert_eq!(correct(&once, &twice), answer);
    assert_eq!(fs::read_to_string(&twice).expect("written"), file);
    let said = notes(&["correct", "-m", GANTRY, "--points", &once, "-o", &twice]);
    contains(&said, "computed anew: X_corrected_mm, Y_corrected_mm,");
    let errors = json(&["error", "-m", GANTRY, "--points", &once]);
    assert_eq!(errors, json(&["error", "-m", GANTRY, "--points", &points]));

    // The output for a single position and the file of a map are tables of positions as well.
    json(&format!("correct -m {FIVE_AXES} --at X=700,B=10,C=30 -o {once}"));
    let one = json(&["correct", "-m", FIVE_AXES, "--at", "X=700,B=10,C=30"]);
    let again = json(&["correct", "-m", FIVE_AXES, "--points", &once]);
    assert_eq!(again, json!({ "points": [one] }));
    let map = path("map.csv");
    json(&["map", "-m", GANTRY, "--grid", "2x2x2", "-o", &map]);
    let read = json(&["error", "-m", GANTRY, "--points", &map]);
    assert_eq!(read["points"].as_array().map(Vec::len), Some(8));
    let last = json!({ "X": 8000.0, "Y": 4000.0, "Z": 2500.0 });
    assert_eq!(read["points"][7]["at"], last);
    // Columns named `x_um` and `a_urad` may be positions in other units.
    let old = fs::read_to_string(&map).expect("written");
    fs::write(&map, old.replace("error_", "")).expect("written");
    refuses(&["error", "-m", GANTRY, "--points", &map], "found column `a_urad`");
}

#[test]
fn slips_of_the_hand_are_told_with_what_was_meant() {
    let at = |text: &str| refused(&["error", "-m", GANTRY, "--at", text]);
    for (text, expected) in [
        ("X=1,5", "--at: found `X=1,5`, expected a decimal point: X=1.5"),
        ("X=1,5,Y=2,5", "expected a decimal point: X=1.5"),
        ("X=1mm", "--at: found `X=1mm`, expected a finite number of mm, without the unit"),
        ("1,2,3", "--at: found `1`, expected X=100"),
        ("", "--at: found no axis, expected X=100"),
        (" , ", "--at: found no axis, expected X=100"),
    ] {
        let message = at(text);
        assert!(message.contains(expected), "{text}: {message}");
    }
    let expected = json(&["error", "-m", GANTRY, "--at", "X=1,Y=2"]);
    for text in ["x=1,y=2", "X = 1, Y = 2", "X=1 Y=2", "X= 1\tY =2;"] {
        assert_eq!(json(&["error", "-m", GANTRY, "--at", text]), expected, "{text}");
    }
    refuses(
        "error -m examples/gantry.toml --at X=1 --temperature scale_x=20,5",
        "expected a decimal point: scale_x=20.5",
    );
}

/// 9000 rows exceed the number of rows that are computed at a time. The rows are numbered consecutively and evaluated
/// independently. An error in a late row is found before any output is printed.
#[test]
fn any_number_of_rows_is_one_list() {
    let folder = Folder::new();
    let place = |row: usize| (row * 37 % 9001, row % 4000);
    let rows = (1..=9000).map(|row| (place(row).0, place(row).1));
    let table: Vec<String> = rows.map(|(x, y)| format!("{x};{y},5;n{x}\n")).collect();
    let points = folder.write("p.csv", format!("X;Y;note\n{}", table.concat()));
    let output = folder.path().join("o.csv").display().to_string();
    let errors = json(&["error", "-m", GANTRY, "--points", &points]);
    let corrections = json(&["correct", "-m", GANTRY, "--points", &points, "-o", &output]);
    let file = fs::read_to_string(&output).expect("written");
    let lines: Vec<&str> = file.lines().collect();
    assert_eq!(lines.len(), 9001);
    let shown = crate::text(&["error", "-m", GANTRY, "--points", &points]);
    let shown: Vec<&str> = shown.lines().collect();
    for row in [1, 255, 256, 257, 4096, 4097, 8192, 8193, 9000] {
        let (x, y) = place(row);
        let at = format!("X={x},Y={y}.5");
        let alone = json(&["error", "-m", GANTRY, "--at", &at]);
        assert_eq!(errors["points"][row - 1], alone, "{row}");
        let cells: Vec<&str> = shown[row].split_whitespace().collect();
        assert_eq!(cells[0], row.to_string());
        assert_eq!(cells[1], format!("{:.3}", alone["position_um"][0].as_f64().expect("a number")));
        let alone = json(&["correct", "-m", GANTRY, "--at", &at]);
        assert_eq!(corrections["points"][row - 1], alone, "{row}");
        assert!(lines[row].starts_with(&format!("{x};{y},5;n{x};")), "{}", lines[row]);
    }
    // X is beyond its travel of 8 m.
    let said = notes(&["error", "-m", GANTRY, "--points", &points]);
    let beyond = (1..=9000).filter(|row| place(*row).0 > 8000).count();
    contains(&said, &format!("note: {beyond} positions lie beyond"));
    for (row, expected) in [("5;x;6", ":8001: Y: found `x`"), ("5;6", ":8001: found 2 columns")] {
        let mut wrong = table.clone();
        wrong[7999] = format!("{row}\n");
        let points = folder.write("wrong.csv", format!("X;Y;note\n{}", wrong.concat()));
        let message = refused(&["error", "-m", GANTRY, "--points", &points]);
        assert!(message.contains(expected), "{message}");
    }
}
