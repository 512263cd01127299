//! Unknowns that the observations do not determine.
//!
//! These are combinations without effect, unknowns below the noise, and unknowns along a line of sight. Only some
//! positions of spheres on a table separate its once-per-turn run-out from the sphere positions.

use std::fmt::Write as _;

use volcomp_identify::{Identification, Observations, machine_with};
use volcomp_kinematics::Form;
use volcomp_kinematics::nalgebra::Vector3;
use volcomp_model::Temperatures;
use volcomp_vocabulary::AxisName::{X, Y, Z};

use crate::lab::{Lab, Noise, csv, tip, value};

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

const MACHINE: &str = "structure = \"w X' Y' b Z t\"
axes.X.travel = [0.0, 600.0]
axes.Y.travel = [0.0, 400.0]
axes.Z.travel = [-500.0, 0.0]
tool.gauge = [0.0, 0.0, 0.0]
tool.length = 120.0
";

/// Readings of 10 µm and 20 µm/m from the set-up or from the machine: every reading contains the offset and the slope.
#[test]
fn readings_contain_offset_and_slope() {
    let lab = Lab::new(MACHINE);
    let rows = (0..=20).map(|k| {
        let x = 30.0 * f64::from(k);
        [x, 100.0, -200.0, 10.0 + 0.02 * x]
    });
    lab.write("l.csv", &csv("X,Y,Z,deviation_um", rows));
    let found = |more: &str, unknown: &str| {
        lab.identify(&format!(
            "folds = 0\nunknown = [{unknown}]\n[[observation]]\nkind = \"line\"\nfile = \"l.csv\"\ndirection = [1, 0, 0]\n{more}"
        ))
        .expect("identified")
    };
    let exx = "{ error = \"EXX\", legendre = 2 }";
    for (more, constant, slope) in [
        ("", 16.0, 6.0),
        ("offset = 10.0\n", 6.0, 6.0),
        ("slope = 20.0\n", 10.0, 0.0),
        ("offset = 10.0\nslope = 20.0\n", 0.0, 0.0),
    ] {
        let found = found(more, exx);
        for (name, expected) in [("EXX constant", constant), ("EXX legendre 1", slope)] {
            let (value, _) = value(&found, name);
            assert!((value - expected).abs() < 1e-3, "{more}{name}: {value}");
        }
    }
    let unknown = found("offset = \"unknown\"\nslope = \"unknown\"\n", "\"EC0Y\"");
    for (name, expected) in [("l.csv:offset", 10.0), ("l.csv:slope", 20.0)] {
        let (value, _) = value(&unknown, name);
        assert!((value - expected).abs() < 1e-3, "{name}: {value}");
    }
}

/// Readings along a line of sight do not determine a rotation of the workpiece about it, also with coordinates rounded
/// to 10 µm.
#[test]
fn rounded_coordinates_determine_nothing() {
    let truth = "[errors]\nEC0Y = 30.0\nEXX = { poly = [0.0, 0.02] }\nEYX = { poly = [9.0, -0.06, 0.0001] }\nEBZ = { poly = [0.0, 0.05] }\n";
    let truth =
        volcomp_model::Machine::parse(&format!("{MACHINE}{truth}"), "truth").expect("a machine");
    let ideal = volcomp_model::Machine::parse(MACHINE, "ideal").expect("a machine");
    let lab = Lab::new(MACHINE);
    let places = |at: [f64; 3]| {
        use volcomp_vocabulary::AxisName::{X, Y, Z};
        [(X, at[0]), (Y, at[1]), (Z, at[2])]
    };
    let mut random = Noise::new(5);
    let tracker = (0..80).map(|_| {
        let at =
            [random.between(0.0, 600.0), random.between(0.0, 400.0), random.between(-500.0, 0.0)];
        let seen = tip(&truth, &places(at), [0.0; 3]);
        let [x, y, z] = [seen.x, seen.y, seen.z].map(|q| q + random.normal(0.003));
        [at[0], at[1], at[2], x, y, z]
    });
    lab.write("tracker.csv", &csv("X,Y,Z,x,y,z", tracker));
    let names = [
        "EXX", "EYX", "EZX", "EAX", "EBX", "ECX", "EXY", "EYY", "EZY", "EAY", "EBY", "ECY", "EXZ",
        "EYZ", "EZZ", "EAZ", "EBZ", "ECZ",
    ];
    let curves: Vec<String> =
        names.map(|name| format!("{{ error = \"{name}\", legendre = 2 }}")).to_vec();
    let ranks: Vec<(usize, (f64, f64))> = [20, 19]
        .into_iter()
        .map(|steps| {
            let direction = unit([600.0, 400.0, 500.0]);
            let line = (0..=steps).map(|k| {
                let share = f64::from(k) / f64::from(steps);
                let rounded = |q: f64| (q * 100.0).round() / 100.0;
                let at = [600.0 * share, 400.0 * share, 500.0 * share - 500.0].map(rounded);
                let off = tip(&truth, &places(at), [0.0; 3]) - tip(&ideal, &places(at), [0.0; 3]);
                let along = direction[0] * off.x + direction[1] * off.y + direction[2] * off.z;
                [at[0], at[1], at[2], 1e3 * along]
            });
            lab.write("line.csv", &csv("X,Y,Z,deviation_um", line));
            let found = lab
                .identify(&format!(
                    "folds = 0\nunknown = [\"EC0Y\", \"EA0Z\", \"EB0Z\", {}]\n[[observation]]\nkind = \"points\"\nfile = \"tracker.csv\"\nframe = \"unknown\"\nuncertainty_um = 3.0\n[[observation]]\nkind = \"line\"\nfile = \"line.csv\"\nuncertainty_um = 0.5\ndirection = [6, 4, 5]\noffset = \"unknown\"\n",
                    curves.join(", ")
                ))
                .expect("identified");
            (found.rank, value(&found, "EC0Y"))
        })
        .collect();
    // With 21 targets all coordinates are exact, with 20 targets all are rounded.
    let [(exact, (ec0y, uncertainty)), (rounded, (same, _))] = ranks[..] else {
        panic!("{ranks:?}")
    };
    assert_eq!(exact, rounded);
    assert!(uncertainty < 40.0, "{ranks:?}");
    assert!((ec0y - 30.0).abs() < 3.0 * uncertainty && (ec0y - same).abs() < 1.0, "{ranks:?}");
}

fn unit(of: [f64; 3]) -> [f64; 3] {
    let length = of.iter().map(|x| x * x).sum::<f64>().sqrt();
    of.map(|x| x / length)
}

/// A laser along or across its rows measures positioning or straightness. A laser along another diagonal than its rows
/// is a mistake and gives a note with the angle.
#[test]
fn a_line_of_sight_that_is_oblique_to_its_rows_is_noted() {
    let lab = Lab::new(MACHINE);
    let text = csv(
        "X,Y,Z,deviation_um",
        (0..=10).map(|k| {
            let share = f64::from(k) / 10.0;
            [600.0 * share, 400.0 * share, -200.0, share]
        }),
    );
    lab.write("l.csv", &text);
    let notes = |direction: &str| {
        let file = format!(
            "folds = 0\nunknown = [\"EC0Y\"]\n[[observation]]\nkind = \"line\"\nfile = \"l.csv\"\ndirection = {direction}\n"
        );
        let notes = lab.read(&file).expect("read").notes;
        notes.into_iter().filter(|note| note.contains("the rows run along")).collect::<Vec<_>>()
    };
    for fine in ["[3, 2, 0]", "[-3, -2, 0]", "[3, 2.05, 0]", "[-2, 3, 0]", "[0, 0, 1]"] {
        assert!(notes(fine).is_empty(), "{fine}");
    }
    // The angle between the rows and X is atan(2/3) = 33.7°. The angle to the other diagonal is twice as large.
    for (direction, angle) in [("[1, 0, 0]", "33.7"), ("[3, -2, 0]", "67.4"), ("[1, 1, 0]", "11.3")]
    {
        let found = notes(direction);
        let expected = format!(
            "o.toml:7: observation[0].direction: the rows run along [0.832, 0.555, 0.000] in workpiece axes, {angle} deg from this direction"
        );
        assert!(found.len() == 1 && found[0].contains(&expected), "{found:?}");
    }
    // Rows that are not on a line are not checked.
    lab.write("l.csv", &(text + "300,0,-200,1\n"));
    assert!(notes("[1, 0, 0]").is_empty());
}

const TABLE_MACHINE: &str = "structure = \"w C b X Y Z t\"
axes.X.travel = [-500.0, 500.0]
axes.Y.travel = [-500.0, 500.0]
axes.Z.travel = [-500.0, 500.0]
axes.C = { travel = [0.0, 360.0], modulo = 360 }
";

/// Number of unknowns fixed at zero, by the first letters of their names.
fn left(spheres: &[[f64; 3]], unknown: &[(&str, usize)]) -> Vec<(String, usize)> {
    let lab = Lab::new(TABLE_MACHINE);
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
    let lab = Lab::new(TABLE_MACHINE);
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
