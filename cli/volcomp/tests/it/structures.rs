//! The commands about the structure of a machine: sensitivity, expression, axes, dh.

use std::fs;

use serde_json::Value;

use crate::{
    Folder, close, contains, float, json, list, notes, one_line, refuses, root, text, words,
};

const BLADE: &str = "examples/blade-mill.toml";

fn names(list: &Value) -> Vec<&str> {
    let list = list.as_array().expect("a list");
    list.iter().map(|name| name.as_str().expect("a name")).collect()
}

#[test]
fn sixty_errors_are_twenty_motions() {
    let found = json(&["sensitivity", "-m", BLADE, "--assembly", "--grid", "3"]);
    let errors = list(&found["errors"]);
    assert_eq!((errors.len(), &found["positions"]), (60, &243.into()));
    assert_eq!(errors[6]["name"], "SXX");
    let groups = list(&found["groups"]);
    assert_eq!((groups.len(), &found["rank"]), (20, &20.into()));
    assert_eq!(found["motions"][3]["terms"], groups[3]);
    assert_eq!(names(&groups[3]), ["EAX", "SAX", "SAY"]);
    let share: f64 = errors.iter().filter_map(|e| e["share"].as_f64()).sum();
    assert!((share - 1.0).abs() < 1e-12);
    let null = list(&found["indistinguishable"]);
    assert_eq!(null.len(), 40);
    let half = 0.5_f64.sqrt();
    for (name, weight) in [("EXX constant", half), ("SXX", -half)] {
        let found = float(&null[0][name]);
        assert!((found - weight).abs() < 1e-9, "{}", null[0]);
    }
    // Without --assembly: six error motions per axis, and the location errors that have an effect.
    let found = json(&["sensitivity", "-m", BLADE, "--grid", "2"]);
    assert_eq!(found["errors"].as_array().map(Vec::len), Some(44));
    let shown = text(&["sensitivity", "-m", BLADE, "--assembly", "--grid", "3"]);
    contains(&shown, "20 distinct motions");
    contains(&shown, "rotation about X, line carried by Z: EAZ EAA SAA SAB");
}

#[test]
fn positions_of_a_file_are_judged() {
    let folder = Folder::new();
    let points = folder.write("p.csv", "X,Y\n0,0\n100,0\n");
    let found = json(&format!("sensitivity -m examples/first.toml --points {points}"));
    assert_eq!(found["positions"], 2);
    // ECX of w X' b Y Z t with the tip at the origin: the table rotates under a tool that is 0 and 100 mm away from the
    // table's axis.
    let errors = list(&found["errors"]);
    let ecx = errors.iter().find(|e| e["name"] == "ECX").expect("ECX");
    close(&ecx["position_max_um"], 0.1, 1e-12);
    close(&ecx["orientation_rms_urad"], 1.0, 1e-12);
    fs::write(&points, "X,Y\n").expect("written");
    refuses(&format!("sensitivity -m examples/first.toml --points {points}"), "found 0 poses");
}

#[test]
fn the_published_formulas_are_printed() {
    let call = ["expression", "-m", "examples/two-axes.toml", "--assembly"];
    let shown = text(&call);
    assert!(
        shown.starts_with("dX = EXX + SXX + EXY + SXY - (y + Yt)*(ECX + SCX + SCY) - Yt*ECY\n"),
        "{shown}"
    );
    contains(&shown, "Xt = 120, Yt = 80.");
    let found = json(&call);
    assert_eq!(found["formulas"][5]["name"], "dC");
    assert_eq!(found["formulas"][0]["terms"][1]["lever"], "y + Yt");
    assert_eq!(names(&found["formulas"][0]["terms"][1]["errors"]), ["-ECX", "-SCX", "-SCY"]);
    assert_eq!(found["tool_mm"]["Yt"], 80.0);
    let latex = text(&[&call[..], &["--latex"]].concat());
    assert!(latex.starts_with("\\begin{align}\n\\Delta x &= E_{XX}"));
    assert!(latex.ends_with("\\end{align}\n"), "{latex}");
}

/// Solutions equal closed forms; singular and unreachable poses are named.
#[test]
fn axes_are_found_and_a_singular_pose_is_named() {
    let trunnion = "examples/trunnion.toml";
    let found = json(&format!("axes -m {trunnion} --tip 0,0,-50 --tool-axis 0,0.6,0.8"));
    let solutions = list(&found["solutions"]);
    assert_eq!(solutions.len(), 3);
    assert_eq!(found["singular"], false);
    let tilt = -(0.6_f64.asin().to_degrees());
    for (solution, c) in solutions.iter().zip([0.0, -360.0, 360.0]) {
        let number = |axis: &str| float(&solution[axis]);
        assert!((number("A") - tilt).abs() < 1e-9 && (number("C") - c).abs() < 1e-9);
        // The tip is at the intersection of the centre lines of A and C, where only linear axes move it.
        for (axis, mm) in [("X", 300.0), ("Y", 250.0), ("Z", -300.0)] {
            assert!((number(axis) - mm).abs() < 1e-9, "{solution}");
        }
    }
    let found = json(&["axes", "-m", trunnion, "--tip", "10,20,-50"]);
    assert_eq!((&found["singular"], names(&found["free"])), (&true.into(), vec!["C"]));
    let shown = text(&["axes", "-m", trunnion, "--tip", "10,20,-50"]);
    contains(&shown, "Singular pose: C does not turn");
    let shown = text(&["axes", "-m", trunnion, "--tip", "10,20,5000"]);
    contains(&shown, "beyond the travel of Z");
    // A rotary axis between Z and X can make Z and X parallel.
    let folder = Folder::new();
    let machine = "structure = \"w Z' B' b X Y t\"\n[axes]\nZ.travel = [-500, 500]\nB.travel = [-180, 180]\nX.travel = [-500, 500]\nY.travel = [-500, 500]\n";
    let path = &folder.write("machine.toml", machine);
    let call = format!("axes -m {path} --tip 0,2,30 --tool-axis 1,0,0");
    let found = json(&call);
    assert_eq!((&found["singular"], names(&found["free"])), (&true.into(), vec!["Z", "X"]));
    let moves = &found["dependent_moves"][0];
    assert_eq!(moves.as_object().map(serde_json::Map::len), Some(2));
    assert!(text(&call).contains("the linear axes X, Z are dependent here"));
    let found = json("axes -m examples/first.toml --tip 1,2,3 --tool-axis 1,0,0");
    assert_eq!(found["solutions"].as_array().map(Vec::len), Some(0));
    assert!(
        found["unreachable"].as_str().is_some_and(|why| why.contains("90.000000 deg")),
        "{found}"
    );
    for (option, value, expected) in [
        ("--tip", "1,2", "--tip: found `1,2`, expected three finite numbers"),
        ("--tip", "1,2,nan", "expected three finite numbers"),
        ("--tip", "1e10,0,0", "tool tip is [10000000000, 0, 0]"),
    ] {
        refuses(&["axes", "-m", trunnion, option, value], expected);
    }
    refuses(
        &format!("axes -m {trunnion} --tip 0,0,0 --tool-axis 0,0,0"),
        "--tool-axis: found `0,0,0`",
    );
}

/// A machine file with the output of `dh` has the same axes.
#[test]
fn a_printed_table_makes_the_same_machine() {
    let folder = Folder::new();
    for machine in ["trunnion", "five-axis", "gantry", "poe-mill-table", "blade-mill"] {
        let file = format!("examples/{machine}.toml");
        let at = ["--at", "X=100,Y=50,Z=-20", "--model", "exact"];
        let expected = json(&[&["error", "-m", &file], &at[..]].concat());
        for convention in ["distal", "proximal"] {
            let dh = json(&["dh", "-m", &file, "--convention", convention]);
            let vector = |v: &Value| v.to_string();
            let row = |row: &Value| {
                format!(
                    "{{ axis = {}, theta = {}, d = {}, a = {}, alpha = {} }}",
                    row["axis"], row["theta_deg"], row["d_mm"], row["a_mm"], row["alpha_deg"]
                )
            };
            let rows: Vec<String> = list(&dh["rows"]).iter().map(row).collect();
            let base = &dh["base"];
            let text = fs::read_to_string(root().join(&file)).expect("the machine file");
            let table = format!(
                "{}\n[dh]\nconvention = \"{convention}\"\nbase = {{ point = {}, x = {}, z = {} }}\nrows = [{}]\n",
                text,
                vector(&base["point_mm"]),
                vector(&base["x"]),
                vector(&base["z"]),
                rows.join(", ")
            );
            let copy = folder.write("m.toml", table);
            let found = json(&[&["error", "-m", &copy], &at[..]].concat());
            for key in ["position_um", "rotation_urad"] {
                for k in 0..3 {
                    let number = |document: &Value| float(&document[key][k]);
                    let off = (number(&found) - number(&expected)).abs();
                    assert!(off < 1e-9, "{machine} {convention} {key}: {found} {expected}");
                }
            }
        }
    }
}

#[test]
fn a_turning_frame_is_told() {
    let shown = text(&["check", BLADE]);
    contains(&shown, "its error motions turn");
    let found = json(&["check", BLADE]);
    assert_eq!(found["axes"][3]["motion_frame"], "turning");
    assert_eq!(found["axes"][0]["motion_frame"], Value::Null);
}

/// The effects of a machine file's values, largest first, equal the effects computed from its curves at the nodes.
#[test]
fn effects_of_the_values_of_the_machine_file() {
    let call = ["sensitivity", "-m", "examples/gantry.toml", "--values"];
    let found = json(&call);
    assert_eq!(found["values"], true);
    let errors = list(&found["errors"]);
    let number = |effect: &Value, key: &str| float(&effect[key]);
    let sizes: Vec<f64> = errors.iter().map(|e| number(e, "position_rms_um")).collect();
    assert!(sizes.windows(2).all(|pair| pair[0] >= pair[1]), "{sizes:?}");
    let of = |name: &str| errors.iter().find(|e| e["name"] == name).expect("there");
    // EXX at 0, 2000 … 8000 mm is the displacement of the tool.
    let exx = [0.0, 2000.0, 4000.0, 6000.0, 8000.0].map(|x: f64| 0.0073 * x - 2.1e-7 * x * x);
    let rms = (exx.iter().map(|um| um * um).sum::<f64>() / 5.0).sqrt();
    assert!((number(of("EXX"), "position_rms_um") - rms).abs() < 1e-9);
    assert_eq!(number(of("EBX"), "share"), 0.0);
    let printed = text(&call);
    contains(&printed, "Zero or not stated: EZX");
    let printed = text(&call[..3]);
    let printed = one_line(&printed);
    contains(
        &printed,
        "Of these 17 motions of 24 errors, each taken as constant, position and orientation of the tool distinguish 12 combinations. Against X and Y as reference axes EB0X EC0X EA0Y are zero by definition, which leaves 21 errors.",
    );
}

/// ECC = 12 µrad · sin C on an axis of ±360°. Over evenly spaced positions of a turn the mean square is 144/2 µrad² for
/// any number of nodes.
#[test]
fn a_run_out_shows_whatever_the_number_of_nodes() {
    let call = |grid: &str| {
        let arguments = words("sensitivity -m examples/trunnion.toml --values --grid");
        json(&[&arguments[..], &[grid]].concat())
    };
    for grid in ["3", "4", "5", "8"] {
        let found = call(grid);
        let errors = list(&found["errors"]);
        let of = errors.iter().find(|error| error["name"] == "ECC").expect("ECC");
        let rms = float(&of["orientation_rms_urad"]);
        assert!((rms - 12.0 / 2.0_f64.sqrt()).abs() < 1e-6, "{grid}: {rms}");
    }
    // Some controls state a full turn as 0° to 359.999°.
    let folder = Folder::new();
    let text = std::fs::read_to_string(root().join("examples/trunnion.toml")).expect("read");
    let text = text.replace("travel = [-360.0, 360.0]", "travel = [0.0, 359.999]");
    let nearly = folder.write("nearly.toml", text);
    let found = json(&["sensitivity", "-m", &nearly, "--grid", "3", "--values"]);
    let errors = list(&found["errors"]);
    let of = errors.iter().find(|error| error["name"] == "ECC").expect("ECC");
    let rms = float(&of["orientation_rms_urad"]);
    assert!((rms - 12.0 / 2.0_f64.sqrt()).abs() < 1e-2, "{rms}");
    contains(
        &notes(&["sensitivity", "-m", "examples/trunnion.toml", "--grid", "2"]),
        "--grid 2: C turns all the way round",
    );
}

#[test]
fn one_node_of_a_turn_is_the_middle() {
    let folder = Folder::new();
    let text = "structure = \"w C' b X t\"\n[axes]\nC.travel = [0, 360]\nX.travel = [0, 400]\n[errors]\nECC = { poly = [0.0, 1.0] }\nEXX = { poly = [0.0, 0.1] }\n";
    let machine = folder.write("turning.toml", text);
    let found = json(&["sensitivity", "-m", &machine, "--grid", "1", "--values"]);
    assert_eq!(found["positions"], 1);
    let errors = list(&found["errors"]);
    let of = |name: &str, key: &str| {
        let error = errors.iter().find(|error| error["name"] == name);
        error.expect("there")[key].as_f64().expect("a number")
    };
    assert!((of("ECC", "orientation_rms_urad") - 180.0).abs() < 1e-6);
    assert!((of("EXX", "position_rms_um") - 20.0).abs() < 1e-6);
}

/// An axis 0.02 mm off the origin gives a weight of 0.00001. The text omits the weight with a note, and the JSON
/// contains it.
#[test]
fn weights_that_would_print_as_zero_are_left_out_and_said() {
    let folder = Folder::new();
    let path = folder.file("m.toml");
    let machine = |offset_mm: f64| {
        let text = format!(
            "structure = \"w C' b X Y Z t\"\n[axes]\nX.travel = [-200, 200]\nY.travel = [-200, 200]\nZ.travel = [-300, 0]\n\
             C = {{ travel = [-90, 90], point = [{offset_mm:?}, 0.0, 0.0] }}\n"
        );
        std::fs::write(&path, text).expect("written");
        crate::text(&["sensitivity", "-m", &path])
    };
    let said = "Terms with a weight below 0.00005 are left out.";
    let near = machine(0.02);
    let (_, sums) = near.split_once("move it nowhere:").expect("sums");
    assert!(sums.contains(said) && !sums.contains("0.0000 "), "{near}");
    let document = json(&["sensitivity", "-m", &path]);
    let weights = list(&document["indistinguishable"]);
    let mut weights = weights.iter().filter_map(|null| null.as_object()).flatten();
    let is_small = |weight: &Value| weight.as_f64().is_some_and(|w| w.abs() < 5e-5);
    assert!(weights.any(|(_, weight)| is_small(weight)), "{document}");
    assert!(!machine(0.0).contains(said));
}
