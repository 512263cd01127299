//! Undetermined unknowns: combinations without effect, and unknowns below the noise.

use std::fmt::Write as _;

use volcomp_identify::{Identification, Observations, machine_with};
use volcomp_kinematics::{Form, nalgebra::Vector3};
use volcomp_model::Temperatures;
use volcomp_vocabulary::AxisName::{X, Y, Z};

use crate::lab::{Lab, Noise};

/// Targets on two tools whose distances from the Z line differ by `differ_mm`; all other parts of the set-up are known.
fn lab(differ_mm: f64, noise_mm: f64) -> Lab {
    let machine = format!(
        "structure = \"w b X Y Z t\"
axes.X.travel = [0.0, 400.0]
axes.Y.travel = [0.0, 300.0]
axes.Z.travel = [0.0, 200.0]
[tool]
tip = [50.0, 0.0, -100.0]
[tools.near]
tip = [50.0, 0.0, -100.0]
[tools.far]
tip = [{:?}, 0.0, -100.0]
",
        50.0 + differ_mm
    );
    let lab = Lab::new(&machine);
    let mut noise = Noise::new(8);
    let mut text = String::from("X,Y,Z,tool,x,y,z\n");
    for k in 0..40 {
        let at = [400.0, 300.0, 200.0].map(|size| noise.between(0.0, size));
        let (tool, out) = [("near", 50.0), ("far", 50.0 + differ_mm)][k % 2];
        let ideal = [at[0] + out, at[1], at[2] - 100.0];
        let seen = ideal.map(|along| along + noise.normal(noise_mm));
        let _ = writeln!(
            text,
            "{:?},{:?},{:?},{tool},{:?},{:?},{:?}",
            at[0], at[1], at[2], seen[0], seen[1], seen[2]
        );
    }
    lab.write("t.csv", &text);
    lab
}

fn identified(lab: &Lab, noise_um: f64) -> (Observations, Identification) {
    let text = format!(
        "folds = 0
unknown = [{{ error = \"EYZ\", legendre = 2 }}, {{ error = \"ECZ\", legendre = 2 }}]
[[observation]]
kind = \"points\"
file = \"t.csv\"
uncertainty_um = {noise_um:?}
frame = [0, 0, 0, 0, 0, 0]
"
    );
    (lab.read(&text).expect("read"), lab.identify(&text).expect("found"))
}

/// With a target 50 mm off the Z line a yaw of 1 µrad equals a straightness of −0.05 µm: both are undetermined, and the
/// combination states the lever of the target. On a tool at 150 mm the yaw acts with the difference of the levers, 100
/// mm.
#[test]
fn undetermined_combinations_state_their_lever() {
    let lab = lab(0.0, 1e-3);
    let (observations, found) = identified(&lab, 1.0);
    let names: Vec<&str> = found.undetermined.iter().map(|of| of.name.as_str()).collect();
    assert_eq!(names, ["ECZ legendre 1", "ECZ legendre 2"]);
    let none = Temperatures::default();
    for open in &found.undetermined {
        assert_eq!(open.unit, "urad");
        let of = |name: &str| {
            let moves = open.moves.iter().find(|(moved, _)| moved == name);
            moves.map_or(0.0, |(_, by)| *by)
        };
        assert_eq!(of(&open.name), 1.0);
        let beside = of(&open.name.replace("ECZ", "EYZ"));
        assert!((beside + 0.05).abs() < 1e-6, "{open:?}");
        let machine = |size: f64| {
            let values = found.parameters.iter().map(|of| {
                let moves = open.moves.iter().find(|(moved, _)| *moved == of.name);
                (of.name.clone(), of.value + size * moves.map_or(0.0, |(_, by)| *by))
            });
            machine_with(&observations, &values.collect::<Vec<_>>()).expect("a machine")
        };
        let [without, with] = [0.0, 10.0].map(machine);
        let state = without.state(&[(X, 100.0), (Y, 200.0), (Z, 200.0)]).expect("a state");
        // Every Legendre polynomial is 1 at the end of the travel.
        for (out_mm, expected_um) in [(50.0, 0.0), (150.0, 1.0)] {
            let at = |machine: &volcomp_model::Machine| {
                let pose = volcomp_kinematics::actual_pose(
                    machine.chain(),
                    &machine.source(&none),
                    &state,
                );
                pose.transform_point(&Vector3::new(out_mm, 0.0, -100.0))
            };
            let moved_um = 1e3 * (at(&with) - at(&without)).norm();
            assert!((moved_um - expected_um).abs() < 1e-5, "{out_mm}: {moved_um}");
        }
        let seen = with.error_at(&state, Form::Exact, &none).position_mm
            - without.error_at(&state, Form::Exact, &none).position_mm;
        assert!(seen.norm() < 1e-8, "{seen}");
    }
}

/// Two targets 0.05 mm apart distinguish yaw from straightness, but with noise of 5 µm only to about 0.1 rad/√n: both
/// are undetermined, and the message states this uncertainty. With targets 100 mm apart, or without noise, both are
/// determined.
#[test]
fn unknowns_below_the_noise_are_undetermined() {
    let is_determined = |found: &Identification| {
        let own = found.parameters.iter().filter(|of| of.name.starts_with("ECZ legendre"));
        own.map(|of| of.determined).collect::<Vec<_>>()
    };
    let (_, close) = identified(&lab(0.05, 5e-3), 5.0);
    assert_eq!(is_determined(&close), [false; 2]);
    let said = crate::lab::words(&close);
    for order in [1, 2] {
        let start = format!(
            "ECZ legendre {order} is not determined: with the stated noise its standard uncertainty would be "
        );
        let figure = said.split_once(&start).expect(&said).1;
        let figure: f64 = figure.split(' ').next().and_then(|n| n.parse().ok()).expect(&said);
        // Slopes of 20 readings at each of two tools: σ/0.05 mm · √(2/20 · 3), within a factor that depends on the positions and the
        // unknowns fixed before.
        let expected = 5.0 / 0.05 * 1e3 * (2.0_f64 / 20.0 * (2.0 * f64::from(order) + 1.0)).sqrt();
        assert!((0.6..1.6).contains(&(figure / expected)), "{figure} {expected}");
    }
    assert!(close.undetermined.iter().any(|of| of.name == "ECZ legendre 2"));
    for (differ_mm, noise_mm, uncertainty_um) in [(100.0, 5e-3, 5.0), (0.05, 1e-7, 1e-4)] {
        let (_, found) = identified(&lab(differ_mm, noise_mm), uncertainty_um);
        assert_eq!(is_determined(&found), [true; 2], "{differ_mm}");
    }
}
