//! Meshes of heights, compared with the machine on which they would be probed.

use std::fmt::Write;

use volcomp_kinematics::Form;
use volcomp_tables::axis_table::{ReadTables, curves, read_mesh, to_toml};
use volcomp_tables::model::{Machine, Temperatures};
use volcomp_tables::vocabulary::AxisName::{X, Y};

use super::{close, file};

const XS: [f64; 4] = [10.0, 90.0, 170.0, 290.0];
const YS: [f64; 3] = [20.0, 150.0, 280.0];

fn machine(errors: &str) -> Machine {
    let text = format!(
        "structure = \"w Y' b X Z t\"\n[axes]\nX.travel = [0.0, 300.0]\nY.travel = [0.0, 300.0]\nZ.travel = [0.0, 300.0]\n{errors}"
    );
    Machine::parse(&text, "m.toml").expect("a machine")
}

/// Z of the tool at Z = 0, mm.
fn height_of_tool(machine: &Machine, x: f64, y: f64) -> f64 {
    let state = machine.state(&[(X, x), (Y, y)]).expect("a state");
    let error = machine.error_at(&state, Form::Exact, &Temperatures::new());
    error.position_mm.z
}

fn mesh(height: impl Fn(f64, f64) -> f64) -> String {
    let head: Vec<String> = XS.iter().map(f64::to_string).collect();
    let mut text = format!("# bed\nmm,{}\n", head.join(","));
    for y in YS {
        let row: Vec<String> = XS.iter().map(|x| format!("{:.9}", height(*x, y))).collect();
        writeln!(text, "{y},{}", row.join(",")).expect("writing to a string");
    }
    text
}

fn read(text: &str) -> ReadTables {
    read_mesh(&file("bed.csv", text)).unwrap_or_else(|error| panic!("{error}"))
}

/// A probe touches the plate at the Z that compensates its own error. The curves of the mesh are the errors of the
/// machine except for the mean.
#[test]
fn the_curves_of_a_probed_mesh_are_the_errors_of_the_machine() {
    let machine_of =
        "[errors]\nEZX = { poly = [0.0, 0.4, -1.0e-3] }\nEZY = { poly = [5.0, -0.2, 2.0e-3] }\n";
    let probed = machine(machine_of);
    let found = read(&mesh(|x, y| -height_of_tool(&probed, x, y)));
    let again = machine(&to_toml(&curves(&found.content).expect("curves")));
    let differences: Vec<f64> = XS
        .iter()
        .flat_map(|x| YS.iter().map(move |y| (*x, *y)))
        .map(|(x, y)| height_of_tool(&again, x, y) - height_of_tool(&probed, x, y))
        .collect();
    for difference in &differences {
        close(*difference, differences[0], 1e-7);
    }
    let warnings: Vec<String> = found.warnings.iter().map(ToString::to_string).collect();
    assert!(warnings[1].contains("leave up to 0 um"), "{warnings:?}");
}

/// Without the means a twist c·x·y is c·(x − mean)·(y − mean), and all of it remains.
#[test]
fn a_twist_is_left() {
    let found = read(&mesh(|x, y| 1e-5 * (x - 140.0) * (y - 150.0) + 0.25));
    let warnings: Vec<String> = found.warnings.iter().map(ToString::to_string).collect();
    assert!(warnings[0].contains("mean height of 250 um"), "{warnings:?}");
    // 1e-5 × 150 × 130 mm = 195 µm at X = 290.
    assert!(warnings[1].contains("leave up to 195 um (X=290 Y="), "{warnings:?}");
    let none = found.content.listed();
    assert!(none.iter().flat_map(|table| &table.forward).all(|um| um.abs() < 1e-3));
}

#[test]
fn what_is_no_mesh() {
    let refused = |text: &str| {
        let error = read_mesh(&file("bed.csv", text)).expect_err("refused");
        error.to_string()
    };
    assert_eq!(
        refused(""),
        "bed.csv: found nothing, expected `mm` and at least two positions of X: mm,10,110,210"
    );
    assert!(
        refused("x,1,2\n1,0,0\n2,0,0\n").starts_with("bed.csv:1: found `x,1,2`, expected `mm`")
    );
    assert_eq!(
        refused("mm,1,2\n1,0,0\n2,0\n"),
        "bed.csv:3: found `2,0`, expected a position of Y and 2 heights in mm"
    );
    assert_eq!(
        refused("mm,2,1\n"),
        "bed.csv:1: found X=1 after X=2, expected increasing positions"
    );
    assert_eq!(
        refused("mm,1,2\n4,0,0\n4,0,0\n"),
        "bed.csv:3: found Y=4 after Y=4, expected increasing positions"
    );
    assert_eq!(refused("mm,1,2\n4,0,0\n"), "bed.csv: found 1 rows of heights, expected at least 2");
    // Heights in µm instead of mm are rejected.
    assert!(
        refused("mm,1,2\n4,0,50\n5,0,0\n").contains("expected at most 2000"),
        "{}",
        refused("mm,1,2\n4,0,50\n5,0,0\n")
    );
}
