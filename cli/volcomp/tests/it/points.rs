//! Positions on the command line and in CSV files: headers with units, copied columns, typing errors.

use std::fs;

use serde_json::{Value, json};

use crate::{Folder, cases, contains, json, notes, refused, refuses};

const GANTRY: &str = "examples/gantry.toml";
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
