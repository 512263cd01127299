//! Straightness lines on both sides of `b`, on a machine whose file keeps a constant rotation of a rotary axis. The
//! readings are computed with homogeneous matrices in this file.

use std::fmt::Write as _;

use crate::lab::Lab;

type M = [[f64; 4]; 4];

/// The constant of ECC that the machine file keeps, rad.
const TURN: f64 = 100e-6;
/// The squareness error EC0Y, rad.
const SQUARE: f64 = 22e-6;
/// A point on the table, mm in table axes.
const ON_TABLE: [f64; 4] = [250.0, 120.0, 40.0, 1.0];
/// A point on the tool, mm in tool axes.
const ON_TOOL: [f64; 4] = [30.0, -20.0, 60.0, 1.0];

fn product(a: &M, b: &M) -> M {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..4).map(|k| a[i][k] * b[k][j]).sum()))
}

fn image(m: &M, p: [f64; 4]) -> [f64; 4] {
    std::array::from_fn(|i| (0..4).map(|k| m[i][k] * p[k]).sum())
}

fn shift(x: f64, y: f64) -> M {
    [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, y], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
}

fn about_z(angle: f64) -> M {
    let (s, c) = angle.sin_cos();
    [[c, -s, 0.0, 0.0], [s, c, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
}

/// Pose of the tool in workpiece axes of `w X' b Y Z C B t`. Y is out of square by `SQUARE` towards −X. C is at 0 and
/// has its constant rotation.
fn tool(x: f64, y: f64) -> M {
    let slide = shift(-SQUARE.sin() * y, SQUARE.cos() * y);
    product(&product(&shift(x, 0.0), &slide), &about_z(TURN))
}

/// Pose of the workpiece in tool axes: the inverse of [`tool`].
fn table(x: f64, y: f64) -> M {
    let slide = shift(SQUARE.sin() * y, -SQUARE.cos() * y);
    product(&product(&about_z(-TURN), &slide), &shift(-x, 0.0))
}

/// EYX, µm: a point of the table passes a straightedge in the spindle, which is aligned to the workpiece's X. Positive if the point is displaced
/// towards −Y.
fn eyx(x: f64) -> f64 {
    let aligned = about_z(TURN);
    let across = |x: f64| image(&aligned, image(&table(x, 0.0), ON_TABLE))[1];
    (across(0.0) - across(x)) * 1e3
}

/// EXY, µm: a point of the tool moves along a straightedge on the table.
fn exy(y: f64) -> f64 {
    (image(&tool(0.0, y), ON_TOOL)[0] - image(&tool(0.0, 0.0), ON_TOOL)[0]) * 1e3
}

#[test]
fn a_kept_turn_of_the_tool_is_not_squareness() {
    let file = |lab: &Lab, name: &str, reading: fn(f64) -> f64| {
        let mut csv = String::from("target,deviation\n");
        for step in 0..=5 {
            let target = 100.0 * f64::from(step);
            writeln!(csv, "{target},{:.9}", reading(target)).expect("a String");
        }
        lab.write(name, &csv);
    };
    let geometry = "structure = \"w X' b Y Z C B t\"\n[axes]\nX.travel = [0, 500]\nY.travel = [0, 500]\nZ.travel = [0, 500]\nC.travel = [-90, 90]\nB.travel = [-90, 90]\n";
    let lines = "[[measurement]]\nerror = \"EYX\"\nfile = \"eyx.csv\"\nunit = \"um\"\n[[measurement]]\nerror = \"EXY\"\nfile = \"exy.csv\"\nunit = \"um\"\n[[squareness]]\nerror = \"EC0Y\"\nreference_angle_urad = 0.0\n";
    for kept in ["", "[errors]\nECC = 100.0\n"] {
        let lab = Lab::new(&format!("{geometry}{kept}"));
        file(&lab, "eyx.csv", eyx);
        file(&lab, "exy.csv", exy);
        let found = lab.calibrated(lines);
        let (_, value) = found.squareness[0];
        assert!((value.0 - SQUARE * 1e6).abs() < 0.01, "{kept}: {value}");
    }
}
