//! Positions of spheres on a table that separate the once-per-turn run-out and tilt of its axis from the sphere
//! positions themselves.

use std::fmt::Write;

use crate::lab::Lab;

const MACHINE: &str = "structure = \"w C b X Y Z t\"
axes.X.travel = [-500.0, 500.0]
axes.Y.travel = [-500.0, 500.0]
axes.Z.travel = [-500.0, 500.0]
axes.C = { travel = [0.0, 360.0], modulo = 360 }
";

/// Number of unknowns fixed at zero, by the first letters of their names.
fn left(spheres: &[[f64; 3]], unknown: &[(&str, usize)]) -> Vec<(String, usize)> {
    let lab = Lab::new(MACHINE);
    let mut text = String::from("X,Y,Z,C,sphere,dx_um,dy_um,dz_um\n");
    for (place, [x, y, z]) in spheres.iter().enumerate() {
        for k in 0..12 {
            let c = 30.0 * f64::from(k);
            let (sin, cos) = c.to_radians().sin_cos();
            let _ = writeln!(
                text,
                "{:?},{:?},{z:?},{c},s{place},1,-1,0.5",
                cos * x + sin * y,
                cos * y - sin * x
            );
        }
    }
    lab.write("s.csv", &text);
    let items: Vec<String> = unknown
        .iter()
        .map(|(error, harmonics)| format!("{{ error = \"{error}\", fourier = {harmonics} }}"))
        .collect();
    let found = lab
        .identify(&format!(
            "folds = 0\nunknown = [{}]\n[[observation]]\nkind = \"sphere\"\nfile = \"s.csv\"\n",
            items.join(", ")
        ))
        .expect("found");
    unknown
        .iter()
        .map(|(error, _)| {
            let is_left = |p: &&volcomp_identify::Parameter| {
                p.name.starts_with(error) && !p.name.ends_with("constant") && !p.determined
            };
            let count = found.parameters.iter().filter(is_left).count();
            ((*error).to_owned(), count)
        })
        .collect()
}

#[test]
fn sphere_heights_do_not_separate_tilts_from_sphere_positions() {
    let errors = [("EXC", 1), ("EYC", 1), ("EZC", 2), ("EAC", 1), ("EBC", 1)];
    for (what, spheres) in [
        ("one", vec![[100.0, 0.0, 50.0]]),
        ("heights", vec![[100.0, 0.0, 50.0], [100.0, 0.0, 250.0]]),
        ("heights and sides", vec![[100.0, 0.0, 50.0], [-100.0, 0.0, 250.0]]),
        ("radii", vec![[100.0, 0.0, 50.0], [200.0, 0.0, 50.0]]),
        ("radii and heights", vec![[100.0, 0.0, 50.0], [200.0, 0.0, 250.0]]),
        ("axis", vec![[0.0, 0.0, 50.0], [0.0, 0.0, 250.0]]),
        ("three", vec![[100.0, 0.0, 50.0], [0.0, 150.0, 250.0], [-120.0, -80.0, 120.0]]),
    ] {
        let left: Vec<usize> = left(&spheres, &errors).iter().map(|(_, count)| *count).collect();
        let [exc, eyc, ezc, eac, ebc] = left[..] else {
            panic!("{left:?}");
        };
        // Half of each first harmonic is undetermined for any sphere positions, because each position is unknown.
        assert_eq!([exc + eyc, eac + ebc], [2, 2], "{what}");
        // One sphere at one height does not separate axial motion from tilt; two spheres do.
        assert_eq!(ezc > 0, spheres.len() == 1, "{what}");
    }
}

/// C with a `modulo`, observed over half a turn: the curve closes, and has the observed values within 0.1 µrad.
#[test]
fn a_series_from_half_a_turn_closes() {
    let lab = Lab::new(MACHINE);
    let mut text = String::from("X,Y,Z,C,sphere,dx_um,dy_um,dz_um\n");
    for (place, [x, y, z]) in [[200.0, 0.0, 50.0], [-50.0, 150.0, 50.0]].into_iter().enumerate() {
        for k in 0..13 {
            let c = 15.0 * f64::from(k);
            let (sin, cos) = c.to_radians().sin_cos();
            // Rotation of the tip about C, µrad.
            let turn = 25.0 * cos - 12.0 * (2.0 * c.to_radians()).sin();
            let _ = writeln!(
                text,
                "{:?},{:?},{z:?},{c},s{place},{:?},{:?},0",
                cos * x + sin * y,
                cos * y - sin * x,
                -1e-3 * turn * y,
                1e-3 * turn * x
            );
        }
    }
    lab.write("s.csv", &text);
    let found = lab
        .identify("folds = 0\nunknown = [{ error = \"ECC\", fourier = 2 }]\n[[observation]]\nkind = \"sphere\"\nfile = \"s.csv\"\n")
        .expect("a curve that closes");
    assert!(found.residual.max_um < 0.1, "{:?}", found.residual);
    let at = |c: f64| {
        let state = found.machine.state(&[(volcomp_vocabulary::AxisName::C, c)]).expect("a state");
        let none = volcomp_model::Temperatures::default();
        let error = found.machine.error_at(&state, volcomp_kinematics::Form::Exact, &none);
        error.rotation_rad.z * 1e6
    };
    // Equal values at 0° and 360°, and the observed difference between 0° and 180°.
    assert!((at(0.0) - at(360.0)).abs() < 1e-9);
    let difference = at(0.0) - at(180.0);
    assert!((difference.abs() - 50.0).abs() < 0.1, "{difference}");
    let said = crate::lab::words(&found);
    let note = said.lines().find(|note| note.contains("undetermined there"));
    let note = note.expect("a note on what was not observed");
    assert!(note.ends_with("observe it over the full turn, or use fewer harmonics"), "{note}");
}
