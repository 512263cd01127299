//! The JSON output of each command, compared with closed forms and published values.

use serde_json::json;

use crate::{Folder, close, contains, float, json, text, volcomp};

const GANTRY: &str = "examples/gantry.toml";
const POSITIONING: &str = "fitting/metrology/tests/data/iso230-2-axis.csv";

#[test]
fn error_at_one_point_has_exactly_its_numbers() {
    let answer = json(&["error", "-m", GANTRY, "--at", "X=1000", "--model", "twist"]);
    close(&answer["position_um"][0], 0.0073 * 1000.0 - 2.1e-7 * 1e6, 1e-9);
    // Chebyshev coefficients 0, -4, 6 at t = 2*1000/8000 - 1 = -0.75.
    close(&answer["position_um"][1], -4.0 * -0.75 + 6.0 * (2.0 * 0.5625 - 1.0), 1e-9);
    assert_eq!(answer["rotation_urad"].as_array().map(Vec::len), Some(3));
    assert_eq!(answer["outside_range"], json!([]));
}

#[test]
fn what_is_outside_its_range_is_named() {
    let answer = json(&["error", "-m", GANTRY, "--at", "X=9000,Z=-1"]);
    assert_eq!(answer["outside_range"], json!(["EXX", "EYX", "EZY", "EZZ"]));
    assert_eq!(answer["outside_travel"], json!(["X", "Z"]));
}

#[test]
fn approach_and_temperature_reach_the_model() {
    let z = |approach: &str| {
        json(&format!("error -m {GANTRY} --at Z=100 --approach {approach}"))["position_um"][2]
            .clone()
    };
    close(&z("Z=+"), 1.2, 1e-3);
    close(&z("Z=-"), 3.7, 1e-3);
    let warm = json("error -m examples/gantry.toml --at X=1000 --temperature scale_x=22");
    close(&warm["position_um"][0], 7.3 - 0.21 + 23.0, 1e-6);
}

#[test]
fn many_points_come_in_the_order_of_the_rows() {
    let dir = Folder::new();
    let path = &dir.write("points.csv", "X, Y\n0,0\n1000,0\n");
    let answer = json(&["error", "-m", GANTRY, "--points", path]);
    assert_eq!(answer["points"].as_array().map(Vec::len), Some(2));
    close(&answer["points"][1]["position_um"][0], 7.09, 1e-3);
    let answer = json(&["correct", "-m", GANTRY, "--points", path]);
    close(&answer["points"][1]["correction"]["X"], -7.09, 1e-2);
}

#[test]
fn correction_has_every_axis_and_leaves_nothing() {
    let answer = json("correct -m examples/five-axis.toml --at X=100,Y=50,B=30,C=45");
    let correction = answer["correction"].as_object().expect("an object");
    assert_eq!(correction.keys().collect::<Vec<_>>(), ["X", "Y", "Z", "B", "C"]);
    // Corrected position = command + correction.
    for (axis, per_unit) in [("X", 1e3), ("B", 1e6 * std::f64::consts::PI / 180.0)] {
        let number = |key: &str| float(&answer[key][axis]);
        let difference = (number("corrected") - number("command")) * per_unit;
        close(&answer["correction"][axis], difference, 1e-6);
    }
    for axis in 0..3 {
        close(&answer["residual_um"][axis], 0.0, 1e-3);
        close(&answer["residual_axis_urad"][axis], 0.0, 1e-3);
    }
    assert_eq!(answer["singular"], json!(false));
    assert!(answer["iterations"].as_u64().is_some_and(|n| (1..=4).contains(&n)));
    let three_axes = json(&["correct", "-m", GANTRY, "--at", "X=100"]);
    assert_eq!(
        three_axes["singular"],
        json!(true),
        "no rotary axis: the tool axis is not correctable"
    );
}

/// The list of targets begins in the middle of the travel, then follows each diagonal from end to end. The other axes
/// are at `--at`.
#[test]
fn diagonals_are_written_as_a_program() {
    let folder = Folder::new();
    let file = folder.file("diagonals.csv");
    let machine = "examples/five-axis.toml";
    let options = ["--points", "3", "--at", "C=90", "--targets", &file, "--feed", "6000"];
    json(&[&["diagonals", "-m", machine], &options[..]].concat());
    let text = std::fs::read_to_string(&file).expect("written");
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines.len(), 14);
    let begin = [
        "line,X,Y,Z,B,C,feed",
        ",400,300,-250,0,90,6000",
        "PPP,0,0,-500,0,90,6000",
        "PPP,400,300,-250,0,90,6000",
        "PPP,800,600,0,0,90,6000",
        "NPP,800,0,-500,0,90,6000",
    ];
    assert_eq!(lines[..6], begin);
    assert_eq!(lines[13], "PPN,800,600,-500,0,90,6000");
}

#[test]
fn the_map_is_written_whole() {
    let dir = Folder::new();
    for name in ["map.csv", "map.vti", "map.vtr"] {
        let path = dir.path().join(name);
        let answer =
            json(&["map", "-m", GANTRY, "--grid", "5x4x3", "-o", path.to_str().expect("UTF-8")]);
        assert_eq!(answer["counts"], json!([5, 4, 3]));
        assert_eq!(answer["nodes"], json!(60));
        let field = std::fs::read_to_string(&path).expect("the file is there");
        let rows = field.lines().count();
        assert_eq!(
            rows,
            match name {
                "map.csv" => 61,
                "map.vti" => 6 + 60 + 2 + 60 + 5,
                _ => 11 + 60 + 2 + 60 + 5,
            },
            "{name}"
        );
    }
    assert_eq!(std::fs::read_dir(dir.path()).expect("a folder").count(), 3, "nothing else is left");
}

#[test]
fn iso230_gives_the_published_values() {
    let answer = json(&["iso230", POSITIONING]);
    for (name, published_mm, tolerance) in [
        ("B_um", 0.04346, 0.011),
        ("R_forward_um", 0.0183, 0.05),
        ("R_backward_um", 0.20475, 0.011),
        ("E_forward_um", 0.07477, 0.011),
        ("E_backward_um", 0.04612, 0.011),
        ("M_um", 0.04809, 0.011),
        ("A_forward_um", 0.08927, 0.011),
        ("A_backward_um", 0.20475, 0.011),
        ("A_um", 0.20475, 0.011),
    ] {
        close(&answer[name], published_mm * 1e3, tolerance);
    }
    assert_eq!(answer["unit"], json!("um"));
    assert_eq!(answer["targets"].as_array().map(Vec::len), Some(5));
    assert_eq!(answer["hints"][0]["run"], json!(1));
    assert_eq!(answer["hints"][0]["direction"], json!("-"));
}

#[test]
fn one_short_run_is_null_where_it_cannot_be_evaluated() {
    let dir = Folder::new();
    let path = dir.path().join("short.csv");
    std::fs::write(&path, "target,deviation\n-10,1\n0,2\n10,4\n").expect("written");
    let answer = json(&["iso230", path.to_str().expect("UTF-8")]);
    close(&answer["E_forward_um"], 3.0, 1e-12);
    for name in ["A_um", "A_forward_um", "R_um", "B_um", "M_um", "E_backward_um"] {
        assert_eq!(answer[name], json!(null), "{name}");
    }
}

#[test]
fn fit_gives_a_curve_of_the_machine_file() {
    let dir = Folder::new();
    let rows: String = (0..21).fold("target,deviation\n".to_owned(), |rows, i| {
        rows + &format!("{},{}\n", i * 100, 0.5 + 0.01 * f64::from(i * 100))
    });
    let path = &dir.write("line.csv", rows);
    for method in ["poly", "chebyshev", "mls", "bspline"] {
        // A B-spline has a fixed order.
        let order = ["--order", "2"].into_iter().filter(|_| method != "bspline");
        let call = ["fit", path, "--method", method, "--at", "50,1234"];
        let answer = json(&call.into_iter().chain(order).collect::<Vec<_>>());
        close(&answer["values"][0]["value_um"], 1.0, 1e-6);
        close(&answer["values"][1]["value_um"], 12.84, 1e-6);
        close(&answer["residual_um"]["rms"], 0.0, 1e-6);
        close(&answer["leave_one_out_um"], 0.0, 1e-6);
        assert!(answer["curve"].get(method).is_some(), "{method}");
    }
    let auto = json(&format!("fit {path} --method mls --auto --residual 0.1"));
    assert_eq!(auto["meets_required"], json!(true));
    // A required residual that no candidate meets is a stated tolerance.
    let rough: Vec<String> = (0..=12).map(|i| format!("{},{}", i * 100, i * i % 5)).collect();
    let rough = dir.write("rough.csv", format!("target,deviation\n{}\n", rough.join("\n")));
    let call = ["fit", &rough, "--method", "mls", "--auto", "--residual", "0.001", "--json"];
    let missed = volcomp(&call);
    assert_eq!(missed.status.code(), Some(3), "{missed:?}");
    let answer: serde_json::Value = serde_json::from_slice(&missed.stdout).expect("JSON");
    assert_eq!(answer["meets_required"], json!(false));
}

/// Outside the measured range a curve keeps its end values, and `fit` marks these positions.
#[test]
fn fit_says_where_it_is_asked_outside_the_measured_range() {
    let dir = Folder::new();
    let path = &dir.write("line.csv", "target,deviation\n0,0\n250,1\n500,2\n");
    let call = |at| ["fit", path, "--method", "poly", "--order", "1", "--at", at];
    let beyond = json(&call("-100,0,500,900"));
    let outside: Vec<&serde_json::Value> =
        (0..4).map(|i| &beyond["values"][i]["outside_range"]).collect();
    assert_eq!(outside, [true, false, false, true]);
    close(&beyond["values"][3]["value_um"], 2.0, 1e-9);
    let told = |at| {
        let output = volcomp(&call(at));
        String::from_utf8(output.stderr).expect("UTF-8").replace('\n', " ")
    };
    let note = told("-100,0,500,900");
    contains(&note, "-100,900: outside the measured range, 0 to 500");
    assert!(!told("0,500").contains("outside"));
}

#[test]
fn calibrate_writes_a_machine_file_that_error_reads() {
    let dir = Folder::new();
    let write = |name: &str, text: &str| {
        let path = dir.path().join(name);
        std::fs::write(&path, text).expect("written");
        path.to_str().expect("UTF-8").to_owned()
    };
    write(
        "shop.toml",
        "structure = \"w X' b Y t\"\n[axes]\nX.travel = [0, 100]\nY.travel = [0, 100]\n",
    );
    write("exx.csv", "target,deviation\n0,1\n50,2\n100,3\n");
    let calibration = write(
        "calibration.toml",
        "machine = \"shop.toml\"\n[[measurement]]\nerror = \"EXX\"\nfile = \"exx.csv\"\n",
    );
    let machine = dir.path().join("machine.toml");
    let machine = machine.to_str().expect("UTF-8");
    let answer = json(&["calibrate", &calibration, "-o", machine]);
    assert_eq!(answer["curves"][0]["error"], json!("EXX"));
    assert!(answer["warnings"].to_string().contains("EYX"), "{answer}");
    let error = json(&["error", "-m", machine, "--at", "X=100"]);
    close(&error["position_um"][0], 2.0, 1e-9);
    let table = text(&["calibrate", &calibration, "-o", machine]);
    contains(&table, "EXX");
}

#[test]
fn form_of_points_in_a_file() {
    let folder = Folder::new();
    // Corners and side middles of a square. Two of the four side middles are 20 µm nearer to the centre.
    let points = "name;x mm;y mm;z mm\na;10;0;5\nb;0;9,98;5\nc;-10;0;5\n\nd;0;-9,98;5\n";
    let path = folder.write("points.csv", points);
    let call = ["form", &path, "--feature", "circle", "--plane", "xy"];
    let answer = json(&[&call[..], &["--datum", "0.3,0.4,0,0,0,-2"]].concat());
    for (k, expected) in [0.0, 0.0, 5.0].into_iter().enumerate() {
        close(&answer["position_mm"][k], expected, 1e-12);
    }
    close(&answer["radius_mm"], 9.99, 1e-12);
    close(&answer["deviation_um"]["least_squares"], 20.0, 1e-9);
    close(&answer["deviation_um"]["minimum_zone"], 20.0, 1e-9);
    close(&answer["deviation_um"]["rms"], 10.0, 1e-9);
    close(&answer["coaxiality_um"], 1000.0, 1e-9);
    let lines = &answer["minimum_zone"]["contact_lines"];
    assert_eq!(lines.to_string(), "[2,3,4,6]");
    assert_eq!(answer["notes"][0], "columns that are not read: name");
}

/// Points that alternate between two circles, and points in µm instead of mm, are evaluated with a note.
#[test]
fn points_that_are_no_feature_are_noted() {
    let folder = Folder::new();
    let ring = |name: &str, radius: &dyn Fn(u32) -> f64| {
        let path = folder.path().join(name).display().to_string();
        let mut text = "x,y,z\n".to_owned();
        for place in 0..12 {
            let (sin, cos) = (f64::from(place) * std::f64::consts::PI / 6.0).sin_cos();
            let radius = radius(place);
            let point = format!("{},{},0\n", radius * cos, radius * sin);
            text.push_str(&point);
        }
        std::fs::write(&path, text).expect("written");
        let answer = json(&["form", &path, "--feature", "circle", "--plane", "xy"]);
        answer["notes"].to_string()
    };
    let two = ring("two.csv", &|place| if place % 2 == 0 { 50.0 } else { 60.0 });
    contains(&two, "10.000 mm is large against the 158");
    let um = ring("um.csv", &|_| 50e3);
    contains(&um, "are the coordinates in µm?");
    let round = ring("round.csv", &|place| {
        if place % 2 == 0 { 50.0 } else { 50.09 }
    });
    assert_eq!(round, "[]");
}

#[test]
fn tables_for_people() {
    insta::assert_snapshot!("error", text(&["error", "-m", GANTRY, "--at", "X=1000,Y=500,Z=9000"]));
    insta::assert_snapshot!(
        "correct",
        text("correct -m examples/five-axis.toml --at X=100,B=30,C=45")
    );
    insta::assert_snapshot!("diagonals", text(&["diagonals", "-m", GANTRY]));
    insta::assert_snapshot!("map", text(&["map", "-m", GANTRY, "--grid", "3x3x3"]));
    insta::assert_snapshot!("iso230", text(&["iso230", POSITIONING]));
}
