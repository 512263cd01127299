//! Printers and routers: squareness from the lengths of a square, settings of firmware, meshes.

use std::fs;

use serde_json::Value;

use crate::{Folder, contains, json, list, refused};

const TRAVELS: &str =
    "[axes]\nX.travel = [0.0, 220.0]\nY.travel = [0.0, 220.0]\nZ.travel = [0.0, 220.0]\n";

/// Tool tip positions with the axes at these positions, mm.
fn tips(machine: &str, folder: &Folder, places: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let rows = places.iter().map(|[x, y, z]| format!("{x},{y},{z}\n"));
    let points = folder.write("points.csv", format!("X,Y,Z\n{}", rows.collect::<String>()));
    let answer = json(&["error", "-m", machine, "--points", &points]);
    let errors = list(&answer["points"]).iter();
    errors
        .zip(places)
        .map(|(point, place)| {
            core::array::from_fn(|at| {
                let um = point["position_um"][at].as_f64().expect("a number");
                place[at] + um * 1e-3
            })
        })
        .collect()
}

fn length(a: [f64; 3], b: [f64; 3]) -> f64 {
    let squares = (0..3).map(|at| (a[at] - b[at]) * (a[at] - b[at]));
    squares.sum::<f64>().sqrt()
}

/// A machine with a known squareness error draws a rectangle in each plane. The lengths of the rectangle give the
/// squareness error back, whether the machine's axes carry the bed or the tool.
#[test]
fn the_lengths_of_a_drawn_square_are_its_squareness() {
    let folder = Folder::new();
    for structure in ["w Y' b X Z t", "w b X Y Z t", "w X' Y' Z' b t"] {
        for (error, along, up) in [("EC0Y", 0, 1), ("EB0Z", 0, 2), ("EA0Z", 1, 2)] {
            let text =
                format!("structure = \"{structure}\"\n{TRAVELS}[errors]\n{error} = 1500.0\n");
            let machine = folder.write("m.toml", &text);
            let corner = |first: f64, second: f64| {
                let mut at = [20.0; 3];
                at[along] += first;
                at[up] += second;
                at
            };
            let corners =
                [corner(0.0, 0.0), corner(0.0, 160.0), corner(180.0, 160.0), corner(180.0, 0.0)];
            let [a, b, c, d] = tips(&machine, &folder, &corners)[..] else {
                panic!("four corners")
            };
            // The side AD may lie along the first axis or along the second. The corner A is the same.
            for side in [length(a, d), length(a, b)] {
                let lengths = format!("{},{},{side}", length(a, c), length(b, d));
                let found = json(&["squareness", "--lengths", &lengths, "--error", error]);
                let urad = found["squareness_urad"].as_f64().expect("a number");
                assert!((urad - 1500.0).abs() < 0.01, "{structure} {error}: {urad}");
            }
        }
    }
}

#[test]
fn lengths_with_a_limit_and_wrong_lengths() {
    // AC² − BD² = 4·100²·cos α, so that 0.07 mm make 495 µrad.
    let output = crate::volcomp(&[
        "--json",
        "squareness",
        "--lengths",
        "141.46,141.39,100",
        "--error",
        "EC0Y",
        "--tolerance",
        "squareness=400",
    ]);
    assert_eq!(output.status.code(), Some(3));
    let found: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let urad = found["squareness_urad"].as_f64().expect("a number");
    assert!((urad + 495.0).abs() < 1.0, "{urad}");
    let per = found["per_hundredth_mm_urad"].as_f64().expect("a number");
    assert!((per + 70.7).abs() < 0.5, "{per}");
    let wrong = |lengths: &str| refused(&["squareness", "--error", "EC0Y", "--lengths", lengths]);
    contains(&wrong("141.4,141.5"), "--lengths: found `141.4,141.5`, expected three");
    contains(
        &wrong("100,141.5,141.4"),
        "lengths AC, BD, AD: found `100, 141.5, 141.4`, expected both diagonals",
    );
    contains(&wrong("141.4,-141.5,100"), "expected both diagonals and one side of a square in mm");
    let neither = refused(&["squareness", "--error", "EC0Y"]);
    contains(&neither, "required arguments");
}

/// The arguments of an export of the printer's settings to the folder `out`, followed by the arguments `more`.
fn exporting_to<'a>(out: &'a str) -> impl Fn(&[&'a str]) -> Vec<&'a str> {
    move |more| [&["export", "-m", "examples/printer.toml", "-o", out][..], more].concat()
}

#[test]
fn settings_of_firmware() {
    let folder = Folder::new();
    let out = folder.file("skew");
    let export = exporting_to(&out);
    let answer = json(&export(&["--format", "marlin", "--steps", "X=80,Y=80,Z=400"]));
    let text = fs::read_to_string(format!("{out}/volcomp-marlin.gcode")).expect("written");
    contains(&text, "\nM852 I0.000495 J0.00015 K0\n");
    // 80 steps/mm divided by 1.0002. The factor has seven decimals.
    contains(&text, "\nM92 X79.984008 ; instead of 80\n");
    let steps = answer["settings"]["steps"][0].as_f64().expect("a number");
    assert!((steps - 1.0 / 1.0002).abs() < 1e-7, "{steps}");
    assert!(list(&answer["tables"]).is_empty());
    let said = crate::text(&export(&["--format", "grbl"]).join(" "));
    contains(&said, "left out, because GRBL has no skew: XY 495 urad");
    contains(&said, "squareness");
    let wrong = refused(&export(&["--format", "csv", "--steps", "X=80"]));
    contains(&wrong, "--steps: found X=80 for the format csv, expected it for klipper");
    contains(&refused(&export(&["--format", "grbl", "--steps", "A=80"])), "--steps: found axis A");
    contains(&refused(&export(&["--format", "mach3"])), "fanuc, klipper, marlin, grbl");
}

/// The bed is 0.1 mm high in the middle of X, so the tool goes up by 0.1 mm there.
#[test]
fn a_mesh_lifts_the_tool_where_the_bed_is_high() {
    let folder = Folder::new();
    let mesh = folder.write("mesh.csv", "mm,0,110,220\n0,0,0.1,0\n220,0,0.1,0\n");
    let curves = folder.file("curves.toml");
    let answer = json(&["import", &mesh, "--format", "mesh", "-o", &curves]);
    assert_eq!(answer["format"], "mesh");
    contains(&answer["warnings"].to_string(), "leave up to 0 um");
    let part = fs::read_to_string(&curves).expect("written");
    let machine = folder.write("m.toml", format!("structure = \"w Y' b X Z t\"\n{TRAVELS}{part}"));
    let lift = |at: &str| {
        let answer = json(&["correct", "-m", &machine, "--at", at]);
        answer["correction"]["Z"].as_f64().expect("a number")
    };
    let up = lift("X=110,Y=30") - lift("X=0,Y=30");
    assert!((up - 100.0).abs() < 0.01, "{up}");
    contains(
        &refused(&["import", &mesh, &mesh, "--format", "mesh"]),
        "found 2 files, expected one",
    );
    contains(&refused(&["import", &mesh, "--format", "bed"]), "isg-csv, fanuc, mesh");
}

/// Lengths have no lines to draw, so `--plot` is refused.
#[test]
fn lengths_are_not_drawn() {
    let folder = Folder::new();
    let plot = folder.file("square.svg");
    let call = ["squareness", "--error", "EC0Y", "--lengths", "141.46,141.39,100", "--plot", &plot];
    contains(&refused(&call), "cannot be used with '--plot <FILE>'");
    assert!(!fs::exists(&plot).expect("a folder"));
}
