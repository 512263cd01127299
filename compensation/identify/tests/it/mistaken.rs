//! Files in which one thing is another than stated: the sign of readings, columns, tools, units, the hand of a frame. The truth
//! is a machine with errors that another crate moves; each mistake is made in the file, and must be named.

use std::fmt::Write;

use volcomp_identify::{Cause, Identification, IdentifyError};
use volcomp_model::Machine;
use volcomp_vocabulary::AxisName::{self, A, C, X, Y, Z};

use crate::lab::{Lab, Noise, tip};

const MACHINE: &str = "structure = \"w C' b X Y Z A t\"
axes.X.travel = [-600.0, 600.0]
axes.Y.travel = [-600.0, 600.0]
axes.Z.travel = [-600.0, 600.0]
axes.C.travel = [-360.0, 360.0]
axes.A.travel = [-100.0, 100.0]
tool = { tip = [0.0, 0.0, -150.0] }
";
const TOOLS: &str = "tools.short = { tip = [0.0, 0.0, -148.0] }
tools.long = { tip = [0.0, 0.0, -153.0] }
tools.stylus = { tip = [0.0, 0.0, -290.0] }
";
const ERRORS: &str = "[errors]
EC0Y = 40.0
EA0Z = -25.0
EX0C = 20.0
EY0C = -15.0
EXX = { poly = [0.0, 0.02] }
";

/// What is noted but for constants, which are a matter of convention.
fn notes(found: &Identification) -> Vec<&String> {
    let is_constant = |note: &&String| !note.contains("cannot be told apart");
    found.warnings.iter().filter(is_constant).collect()
}

fn truth() -> Machine {
    Machine::parse(&format!("{MACHINE}{ERRORS}"), "truth").expect("a machine")
}

/// Readings of a line of sight along `direction` about the middle of the travels, µm.
fn line(seed: u64, direction: [f64; 3], sign: f64) -> String {
    let (truth, nominal) = (
        truth(),
        Machine::parse(MACHINE, "nominal").expect("a machine"),
    );
    let mut noise = Noise::new(seed);
    let mut text = String::from("X,Y,Z,deviation_um\n");
    let length = direction.iter().map(|d| d * d).sum::<f64>().sqrt();
    for k in 0..21 {
        let s = f64::from(k) * 40.0 - 400.0;
        let [x, y, z] = direction.map(|d| s * d);
        let at = [(X, x), (Y, y), (Z, z)];
        let moved = tip(&truth, &at, [0.0; 3]) - tip(&nominal, &at, [0.0; 3]);
        let along: f64 = (0..3).map(|k| moved[k] * direction[k] / length).sum();
        let read = sign * (1e3 * along + noise.normal(1.0));
        let _ = writeln!(text, "{x},{y},{z},{read:?}");
    }
    text
}

const DIRECTIONS: [[f64; 3]; 6] = [
    [1.0, 1.0, 0.0],
    [1.0, -1.0, 0.0],
    [1.0, 0.0, 0.0],
    [0.0, 1.0, 1.0],
    [0.0, 1.0, -1.0],
    [1.0, 1.0, 1.0],
];

fn lines_observed() -> String {
    let mut text = String::from(
        "folds = 0\nunknown = [\"EC0Y\", \"EA0Z\", { error = \"EXX\", legendre = 1 }]\n",
    );
    for (k, direction) in DIRECTIONS.iter().enumerate() {
        let _ = writeln!(
            text,
            "[[observation]]\nkind = \"line\"\nfile = \"l{k}.csv\"\ndirection = {direction:?}\noffset = \"unknown\""
        );
    }
    text
}

/// Diagonals of which one or two were read the other way: named are those, and nothing where none was.
#[test]
fn diagonals_with_the_opposite_sign_are_named() {
    for seed in 0..4 {
        for wrong in [&[][..], &[0], &[2], &[4], &[0, 4]] {
            let lab = Lab::new(MACHINE);
            for (k, direction) in DIRECTIONS.iter().enumerate() {
                let sign = if wrong.contains(&k) { -1.0 } else { 1.0 };
                lab.write(
                    &format!("l{k}.csv"),
                    &line(10 * seed + k as u64, *direction, sign),
                );
            }
            let found = lab.identify(&lines_observed()).expect("found");
            let told = found.warnings.join("\n");
            if wrong.is_empty() {
                assert_eq!(notes(&found), [""; 0]);
                continue;
            }
            assert!(
                told.contains("with the opposite sign of its readings"),
                "{wrong:?}: {told}"
            );
            let note = found
                .warnings
                .iter()
                .find(|w| w.contains("opposite sign"))
                .expect("told");
            for k in 0..DIRECTIONS.len() {
                assert_eq!(
                    note.contains(&format!("l{k}.csv")),
                    wrong.contains(&k),
                    "{wrong:?}: {note}"
                );
            }
        }
    }
}

/// Ball rows across the table, read along and to the sides; one of three files with the indicators the other way.
#[test]
fn ball_rows_with_the_opposite_sign_are_named() {
    let (truth, nominal) = (
        truth(),
        Machine::parse(MACHINE, "nominal").expect("a machine"),
    );
    let directions = [
        [1.0, 1.0, 0.0],
        [1.0, -1.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
    ];
    for wrong in [None, Some(0), Some(1), Some(2)] {
        let lab = Lab::new(MACHINE);
        lab.write(
            "row.csv",
            "ball,distance_mm,uncertainty_um\nA,0,0\nB,100,0\nC,200,0\nD,300,0\nE,400,0\nF,500,0\n",
        );
        let mut observed =
            String::from("folds = 0\nunknown = [\"EC0Y\", { error = \"EXX\", legendre = 1 }]\n");
        for (k, [dx, dy, _]) in directions.into_iter().enumerate() {
            let mut noise = Noise::new(70 + k as u64);
            let sign = if wrong == Some(k) { -1.0 } else { 1.0 };
            let mut text = String::from("X,Y,Z,ball,along_um,side1_um,side2_um\n");
            let length = f64::hypot(dx, dy);
            let (u, v) = (dx / length, dy / length);
            for (ball, s) in ["A", "B", "C", "D", "E", "F"]
                .into_iter()
                .zip([-250.0, -150.0, -50.0, 50.0, 150.0, 250.0])
            {
                let (x, y) = (s * u, s * v);
                let at = [(X, x), (Y, y)];
                let off = tip(&truth, &at, [0.0; 3]) - tip(&nominal, &at, [0.0; 3]);
                // Along the row, to the left of it, and up.
                let read = [off.x * u + off.y * v, -off.x * v + off.y * u, off.z];
                let [a, b, c] = read.map(|mm| sign * (1e3 * mm + noise.normal(0.5)));
                let _ = writeln!(text, "{x:?},{y:?},0,{ball},{a:?},{b:?},{c:?}");
            }
            lab.write(&format!("b{k}.csv"), &text);
            let _ = writeln!(
                observed,
                "[[observation]]\nkind = \"ball-row\"\nfile = \"b{k}.csv\"\nrow = \"row.csv\"\nuncertainty_um = 0.5\nside1 = [{:?}, {u:?}, 0.0]",
                -v
            );
        }
        let found = lab.identify(&observed).expect("found");
        let told = found.warnings.join("\n");
        match wrong {
            None => assert!(!told.contains("opposite sign"), "{told}"),
            Some(k) => assert!(
                told.contains(&format!("b{k}.csv: with the opposite sign")),
                "{k}: {told}"
            ),
        }
    }
}

/// What a tracker on the table sees of the tip, with the tool of each row.
fn tracker(
    seed: u64,
    tool: impl Fn(usize) -> (&'static str, f64),
    change: impl Fn(&mut [(AxisName, f64); 5], &mut [f64; 3]),
) -> String {
    let truth = truth();
    let mut noise = Noise::new(seed);
    let mut text = String::from("X,Y,Z,C,A,tool,x,y,z\n");
    for k in 0..40 {
        let mut at = [(X, 0.0), (Y, 0.0), (Z, 0.0), (C, 0.0), (A, 0.0)];
        for (axis, q) in &mut at {
            *q = match axis {
                C => noise.between(-170.0, 170.0),
                A => noise.between(-80.0, 80.0),
                _ => noise.between(-500.0, 500.0),
            };
        }
        let (name, length) = tool(k);
        let seen = tip(&truth, &at, [0.0, 0.0, 150.0 - length]);
        let mut read = [seen.x, seen.y, seen.z].map(|x| x + noise.normal(0.001));
        change(&mut at, &mut read);
        for (_, q) in at {
            let _ = write!(text, "{q:?},");
        }
        let [x, y, z] = read;
        let _ = writeln!(text, "{name},{x:?},{y:?},{z:?}");
    }
    text
}

const POINTS: &str = "folds = 0
unknown = [\"EC0Y\", \"EA0Z\", \"EX0C\", \"EY0C\", { error = \"EXX\", legendre = 1 }]
[[observation]]
kind = \"points\"
file = \"t.csv\"
";

fn far(text: &str) -> Vec<Cause> {
    let lab = Lab::new(&format!("{MACHINE}{TOOLS}"));
    lab.write("t.csv", text);
    match lab.identify(POINTS) {
        Err(IdentifyError::FarRows { files }) => files[0].causes.clone(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn exchanged_columns_and_a_left_handed_frame_are_named() {
    for seed in 0..3 {
        let one = |_: usize| ("", 150.0);
        let exchanged = tracker(seed, one, |at, _| {
            let x = at[0].1;
            at[0].1 = at[1].1;
            at[1].1 = x;
        });
        assert_eq!(far(&exchanged), [Cause::Exchanged(X, Y)]);
        for k in 0..3 {
            let mirrored = tracker(seed, one, |_, read| read[k] = -read[k]);
            assert_eq!(far(&mirrored), [Cause::Mirrored]);
        }
        let mirrored = tracker(seed, one, |_, read| read.swap(0, 2));
        assert_eq!(far(&mirrored), [Cause::Mirrored]);
    }
}

/// Tools that differ much are far off; those that differ by some millimetres contradict the rest.
#[test]
fn exchanged_tools_are_named() {
    let exchanged = |k: usize, names: [&'static str; 2], lengths: [f64; 2]| {
        let place = usize::from(k.is_multiple_of(3));
        (names[1 - place], lengths[place])
    };
    for seed in 0..3 {
        let much = tracker(
            seed,
            |k| exchanged(k, ["short", "stylus"], [148.0, 290.0]),
            |_, _| (),
        );
        assert_eq!(
            far(&much),
            [Cause::ToolsExchanged(
                "short".to_owned(),
                "stylus".to_owned()
            )]
        );
        let lab = Lab::new(&format!("{MACHINE}{TOOLS}"));
        lab.write(
            "t.csv",
            &tracker(
                seed,
                |k| exchanged(k, ["short", "long"], [148.0, 153.0]),
                |_, _| (),
            ),
        );
        let told = lab.identify(POINTS).expect("found").warnings;
        let note =
            "t.csv: the rows do not fit; they fit if the tools `long` and `short` are exchanged";
        assert!(told[0].starts_with(note), "{told:?}");
        // Another tool by five millimetres, with all rows of one tool: the frame takes none of it up, since A tilts it.
        lab.write("t.csv", &tracker(seed, |_| ("short", 153.0), |_, _| ()));
        let told = lab.identify(POINTS).expect("found").warnings;
        assert!(
            told[0].contains("they fit with the tool `long`"),
            "{told:?}"
        );
        // And as it should be.
        lab.write(
            "t.csv",
            &tracker(
                seed,
                |k| {
                    if k % 3 == 0 {
                        ("short", 148.0)
                    } else {
                        ("long", 153.0)
                    }
                },
                |_, _| (),
            ),
        );
        assert_eq!(notes(&lab.identify(POINTS).expect("found")), [""; 0]);
    }
}

/// A ballbar or a tracer in inches, with a dead length that is known or not.
#[test]
fn lengths_in_inches_are_named() {
    let truth = truth();
    let unknown = "folds = 0\nunknown = [\"EC0Y\", \"EA0Z\", { error = \"EXX\", legendre = 1 }]\n[[observation]]\nkind = \"distance\"\nfile = \"b.csv\"\npoint = \"unknown\"\n";
    for seed in 0..3 {
        for (reach, dead) in [(0.0, ""), (0.0, "unknown"), (200.0, ""), (200.0, "unknown")] {
            for unit in [1.0, 25.4] {
                let mut noise = Noise::new(seed);
                let mut text = String::from("X,Y,Z,length_mm\n");
                for k in 0..40 {
                    let angle = f64::from(k) * 0.3;
                    let r = 150.0 + reach * f64::from(k % 5) / 4.0;
                    let rise = noise.between(-0.7, 0.7);
                    let at = [
                        (X, 20.0 + r * rise.cos() * angle.cos()),
                        (Y, -30.0 + r * rise.cos() * angle.sin()),
                        (Z, 10.0 + r * rise.sin()),
                    ];
                    // The point is where the tip would be at the middle.
                    let from = tip(&truth, &at, [0.0; 3])
                        - volcomp_kinematics::nalgebra::Vector3::new(20.0, -30.0, 10.0 - 150.0);
                    let length = from.norm() + noise.normal(0.001);
                    let [x, y, z] = at.map(|(_, q)| q);
                    let _ = writeln!(text, "{x:?},{y:?},{z:?},{:?}", length / unit);
                }
                let lab = Lab::new(MACHINE);
                lab.write("b.csv", &text);
                let dead = if dead.is_empty() {
                    String::new()
                } else {
                    format!("dead_length = \"{dead}\"\n")
                };
                let observed = format!("{unknown}{dead}");
                let what = format!("{seed} {reach} {dead} {unit}");
                match (unit > 1.0, lab.identify(&observed)) {
                    (false, found) => assert_eq!(notes(&found.expect("found")), [""; 0], "{what}"),
                    (true, Err(IdentifyError::FarRows { files })) => {
                        assert_eq!(files[0].causes, [Cause::LengthsInInches], "{what}");
                    }
                    (true, found) => {
                        let told = found.expect("found").warnings.join("\n");
                        assert!(told.contains("is `length_mm` inches?"), "{what}: {told}");
                    }
                }
            }
        }
    }
}
