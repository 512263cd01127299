//! Curves of the machine file that were measured before, with a wrong sign or in another unit.

use std::fmt::Write;

use volcomp_model::Machine;
use volcomp_vocabulary::AxisName::{X, Y, Z};

use crate::lab::{Lab, Noise, tip};

const MACHINE: &str = "structure = \"w b X Y Z t\"
axes.X.travel = [-500.0, 500.0]
axes.Y.travel = [-500.0, 500.0]
axes.Z.travel = [-500.0, 500.0]
tool = { tip = [0.0, 0.0, -200.0] }
[errors]
";
const UNKNOWN: &str = "folds = 0
unknown = [\"EC0Y\", \"EA0Z\", \"EB0Z\"]
[[observation]]
kind = \"points\"
file = \"t.csv\"
";

/// The curves of the truth with factors: positioning of X, straightness of Y, pitch of X, straightness of X.
fn errors(factors: [f64; 4]) -> String {
    let [a, b, c, d] = factors;
    format!(
        "EXX = {{ poly = [0.0, {:?}, {:?}] }}\nEXY = {{ poly = [0.0, {:?}, {:?}] }}\nEBX = {{ poly = [0.0, {:?}, {:?}] }}\nEZX = {{ poly = [0.0, 0.0, {:?}] }}\n",
        0.02 * a,
        1e-5 * a,
        0.01 * b,
        4e-5 * b,
        0.03 * c,
        6e-5 * c,
        3e-5 * d
    )
}

fn told(seed: u64, factors: [f64; 4]) -> Vec<String> {
    let truth = Machine::parse(
        &format!("{MACHINE}{}EC0Y = 30.0\nEA0Z = -20.0\n", errors([1.0; 4])),
        "truth",
    )
    .expect("a machine");
    let mut noise = Noise::new(seed);
    let mut text = String::from("X,Y,Z,x,y,z\n");
    for _ in 0..50 {
        let at = [X, Y, Z].map(|axis| (axis, noise.between(-480.0, 480.0)));
        let seen = tip(&truth, &at, [0.0; 3]);
        let [x, y, z] = [seen.x, seen.y, seen.z].map(|x| x + noise.normal(0.001));
        let [a, b, c] = at.map(|(_, q)| q);
        let _ = writeln!(text, "{a:?},{b:?},{c:?},{x:?},{y:?},{z:?}");
    }
    let lab = Lab::new(&format!("{MACHINE}{}", errors(factors)));
    lab.write("t.csv", &text);
    lab.identify(UNKNOWN).expect("found").warnings
}

#[test]
fn a_curve_with_another_sign_or_unit_is_named() {
    for seed in 0..3 {
        assert_eq!(told(seed, [1.0; 4]), [""; 0]);
        for (factors, expected) in [
            ([-1.0, 1.0, 1.0, 1.0], "EXX: with the opposite sign"),
            ([1.0, -1.0, 1.0, 1.0], "EXY: with the opposite sign"),
            ([1.0, 1.0, -1.0, 1.0], "EBX: with the opposite sign"),
            ([1e-3, 1.0, 1.0, 1.0], "EXX: times 1000"),
            ([1.0, 1.0, 1.0, 1e3], "EZX: divided by 1000"),
            ([1.0, 1.0, 1.0 / 4.848, 1.0], "EBX: times 4.848"),
        ] {
            let told = told(seed, factors);
            assert!(told[0].starts_with(expected), "{expected}: {told:?}");
            let curves = told
                .iter()
                .filter(|note| note.contains("the curve of the machine file"));
            assert_eq!(curves.count(), 1, "{told:?}");
        }
    }
}
