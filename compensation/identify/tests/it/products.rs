//! Errors that depend on a second axis are identified if the observations determine them.

use volcomp_model::Machine;
use volcomp_vocabulary::AxisName::{X, Y, Z};

use crate::lab::{Lab, Noise, csv, tip, value, worn};

const MACHINE: &str = "structure = \"w X' b Y Z t\"
[axes.X]
travel = [0.0, 1000.0]
[axes.Y]
travel = [0.0, 800.0]
[axes.Z]
travel = [-400.0, 0.0]
";
/// A cross-beam that sags under the ram, more if the ram is extended: 24 µm in the middle of the beam with the ram at
/// its lower end. The sag is linear between nodes 50 mm apart.
fn truth() -> Machine {
    let ys: Vec<f64> = (0..=16).map(|k| 50.0 * f64::from(k)).collect();
    let row = |y: &f64| {
        let sag = -24.0 * (y / 800.0) * (1.0 - y / 800.0) * 4.0;
        format!("[{sag:?}, {:?}]", 0.25 * sag)
    };
    let rows: Vec<String> = ys.iter().map(row).collect();
    let text = format!(
        "{MACHINE}[errors]\nEYY = {{ poly = [0.0, 0.01] }}
EZY = {{ grid = {{ axes = [\"Y\", \"Z\"], nodes = [{ys:?}, [-400.0, 0.0]], values = [{}] }} }}\n",
        rows.join(", ")
    );
    Machine::parse(&text, "truth").expect("a machine")
}

fn tracker(machine: &Machine, poses: usize, noise_um: f64) -> String {
    let mut noise = Noise::new(23);
    let rows = (0..poses).map(|_| {
        let [x, y, z] = [[0.0, 1000.0], [0.0, 800.0], [-400.0, 0.0]]
            .map(|[low, high]| noise.between(low, high));
        let at = tip(machine, &[(X, x), (Y, y), (Z, z)], [0.0; 3]);
        let [a, b, c] = [at.x, at.y, at.z].map(|p| p + noise.normal(noise_um * 1e-3));
        [x, y, z, a, b, c]
    });
    csv("X,Y,Z,x,y,z", rows)
}

fn text(second: &str) -> String {
    format!(
        "penalty = \"auto\"
folds = 10
unknown = [
    {{ error = \"EYY\", legendre = 3 }},
    {{ error = \"EZY\", legendre = 4{second} }},
    {{ error = \"EZX\", legendre = 3{} }},
]
[[observation]]
kind = \"points\"
file = \"t.csv\"
uncertainty_um = 0.5
",
        if second.is_empty() { "" } else { ", second = { axis = \"Y\", legendre = 2 }" }
    )
}

const SECOND: &str = ", second = { axis = \"Z\", legendre = 2 }";

#[test]
fn a_sag_over_a_second_axis_is_found() {
    let truth = truth();
    let lab = Lab::new(MACHINE);
    lab.write("t.csv", &tracker(&truth, 150, 0.5));
    let plain = lab.identify(&text("")).expect("found");
    let found = lab.identify(&text(SECOND)).expect("found");
    // Noise of 0.5 µm in three directions is 0.87 µm in space; the fit with single-axis curves has an additional error.
    let [before, after] =
        [&plain, &found].map(|found| found.left_out.expect("judged").figures.rms_um);
    assert!(before > 2.0 && after < 1.0, "{before} {after}");
    // After best-fit rigid-body alignment, the identified machine also agrees with the truth at poses without
    // observations.
    let error = |machine: &Machine, y: f64, z: f64| {
        let at = [(X, 500.0), (Y, y), (Z, z)];
        1e3 * tip(machine, &at, [0.0; 3]).z - 1e3 * z
    };
    // Sag of the middle relative to the ends, at both ends of the ram.
    for (z, expected) in [(-400.0, -24.0), (0.0, -6.0)] {
        let sag = |machine: &Machine| {
            error(machine, 400.0, z) - 0.5 * (error(machine, 0.0, z) + error(machine, 800.0, z))
        };
        assert!((sag(&truth) - expected).abs() < 1e-6);
        let sag = sag(&found.machine);
        assert!((sag - expected).abs() < 1.0, "at {z}: {sag}");
    }
    let curve = found.machine.error("EZY".parse().expect("a name"));
    assert!(
        matches!(curve, Some(volcomp_curve::ErrorCurve::Single(volcomp_curve::Field::Grid(_)))),
        "{curve:?}"
    );
    // Products without a true effect are almost zero.
    let second: f64 = found
        .parameters
        .iter()
        .filter(|p| p.name.starts_with("EZX") && p.name.contains(" × Y"))
        .map(|p| p.value.abs())
        .sum();
    assert!(second < 0.4, "{second}");
    let written = Machine::parse(&found.machine.to_toml(), "written").expect("a machine");
    for (y, z) in [(70.0, -310.0), (430.0, -20.0)] {
        let difference = error(&written, y, z) - error(&found.machine, y, z);
        assert!(difference.abs() < 1e-9, "{difference}");
    }
}

/// EZX = 9 µm·t·s with t and s from −1 to 1 over the observed range is identified as one product of Legendre polynomials.
#[test]
fn a_twist_without_noise_is_one_product() {
    let truth = worn(
        MACHINE,
        "EZX = { grid = { axes = [\"X\", \"Y\"], nodes = [[0.0, 1000.0], [0.0, 800.0]], values = [[9.0, -9.0], [-9.0, 9.0]] } }\n",
    );
    let lab = Lab::new(MACHINE);
    let rows = (0..25).map(|k| {
        let (x, y) = (f64::from(k % 5) * 250.0, f64::from(k / 5) * 200.0);
        let at = tip(&truth, &[(X, x), (Y, y)], [0.0; 3]);
        [x, y, at.x, at.y, at.z]
    });
    lab.write("t.csv", &csv("X,Y,x,y,z", rows));
    let found = lab
        .identify(
            "folds = 5
unknown = [{ error = \"EZX\", legendre = 2, second = { axis = \"Y\", legendre = 2 } }]
[[observation]]
kind = \"points\"
file = \"t.csv\"
",
        )
        .expect("found");
    assert!(found.residual.max_um < 1e-6, "{:?}", found.residual);
    let (twist, _) = value(&found, "EZX legendre 1 × Y legendre 1");
    assert!((twist - 9.0).abs() < 1e-6, "{twist}");
    let (other, _) = value(&found, "EZX legendre 2 × Y legendre 2");
    assert!(other.abs() < 1e-6, "{other}");
    // A rotation of the frame and a slope over Y are indistinguishable.
    let named = crate::lab::words(&found);
    assert!(named.contains("× Y legendre 1 cannot be distinguished"), "{named}");
}
