//! The stated uncertainty is the one that occurs.

use std::fmt::Write as _;

use volcomp_model::Machine;
use volcomp_vocabulary::AxisName::{X, Y};

use crate::lab::{Lab, Noise, tip, value};

const MACHINE: &str = "structure = \"w b X Y t\"
[axes.X]
travel = [0.0, 500.0]
[axes.Y]
travel = [0.0, 400.0]
";
const RUNS: u32 = 500;

/// 95 % bands hold the truth in 93 to 97 % of 500 runs.
#[test]
fn bands_of_95_percent_hold_the_truth_as_often() {
    let truth = Machine::parse(
        &format!("{MACHINE}[errors]\nEC0Y = 20.0\nEXX = {{ poly = [-5.0, 0.02] }}\n"),
        "truth",
    )
    .expect("a machine");
    let lab = Lab::new(MACHINE);
    let mut noise = Noise::new(5);
    let mut inside = [0_u32; 2];
    for _ in 0..RUNS {
        let mut text = String::from("X,Y,x,y,z\n");
        for k in 0..12 {
            let (x, y) = (f64::from(k % 4) * 160.0, f64::from(k / 4) * 190.0);
            let at = tip(&truth, &[(X, x), (Y, y)], [0.0; 3]);
            let [px, py, pz] = [at.x, at.y, at.z].map(|p| p + noise.normal(0.003));
            let _ = writeln!(text, "{x},{y},{px:?},{py:?},{pz:?}");
        }
        lab.write("t.csv", &text);
        let found = lab
            .identify(
                "folds = 0\nunknown = [\"EC0Y\", { error = \"EXX\", legendre = 1 }]
[[observation]]
kind = \"points\"
file = \"t.csv\"
uncertainty_um = 3.0
",
            )
            .expect("found");
        for (count, (name, expected)) in inside
            .iter_mut()
            .zip([("EC0Y", 20.0), ("EXX legendre 1", 4.8)])
        {
            let (value, uncertainty) = value(&found, name);
            *count += u32::from((value - expected).abs() < 1.959_964 * uncertainty);
        }
    }
    for count in inside {
        let share = f64::from(count) / f64::from(RUNS);
        assert!((0.93..=0.97).contains(&share), "{inside:?} of {RUNS}");
    }
}

/// The same of a robust fit where one number in twelve scatters ten times as much as stated.
#[test]
fn robust_bands_hold_the_truth_as_often() {
    let truth = Machine::parse(
        &format!("{MACHINE}[errors]\nEC0Y = 20.0\nEXX = {{ poly = [-5.0, 0.02] }}\n"),
        "truth",
    )
    .expect("a machine");
    let lab = Lab::new(MACHINE);
    let mut noise = Noise::new(6);
    let mut inside = [0_u32; 2];
    for _ in 0..RUNS {
        let mut text = String::from("X,Y,x,y,z\n");
        for k in 0..24 {
            let (x, y) = (f64::from(k % 6) * 100.0, f64::from(k / 6) * 125.0);
            let at = tip(&truth, &[(X, x), (Y, y)], [0.0; 3]);
            let [px, py, pz] = [at.x, at.y, at.z].map(|p| {
                let is_slip = noise.between(0.0, 1.0) < 0.08;
                p + noise.normal(if is_slip { 0.03 } else { 0.003 })
            });
            let _ = writeln!(text, "{x},{y},{px:?},{py:?},{pz:?}");
        }
        lab.write("t.csv", &text);
        let found = lab
            .identify(
                "folds = 0\nrobust = true\nunknown = [\"EC0Y\", { error = \"EXX\", legendre = 1 }]
[[observation]]
kind = \"points\"
file = \"t.csv\"
uncertainty_um = 3.0
",
            )
            .expect("found");
        // 0.02 µm/mm over half of 500 mm.
        for (count, (name, expected)) in inside
            .iter_mut()
            .zip([("EC0Y", 20.0), ("EXX legendre 1", 5.0)])
        {
            let (value, uncertainty) = value(&found, name);
            *count += u32::from((value - expected).abs() < 1.959_964 * uncertainty);
        }
    }
    println!("{inside:?} of {RUNS}");
    for count in inside {
        let share = f64::from(count) / f64::from(RUNS);
        assert!((0.93..=0.97).contains(&share), "{inside:?} of {RUNS}");
    }
}
