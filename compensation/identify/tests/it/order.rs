//! What is left of rows follows their order: something was shifted between two rows, or drifted. The machines have errors, and
//! the shop that shifts is another program than the one that finds it.

use std::fmt::Write;

use volcomp_identify::IdentifyError;
use volcomp_model::Machine;
use volcomp_vocabulary::AxisName::{self, A, B, C, X, Y, Z};

use crate::lab::{Lab, Noise, tip};

const TABLE: &str = "structure = \"w C' b X Y Z B t\"";
const HEAD: &str = "structure = \"w b X Y Z C A t\"";
const TRUNNION: &str = "structure = \"w C' A' b X Y Z t\"";

fn machine(structure: &str, errors: &str) -> String {
    let tilting = if structure.contains('B') { B } else { A };
    format!(
        "{structure}
axes.X.travel = [-600.0, 600.0]
axes.Y.travel = [-600.0, 600.0]
axes.Z.travel = [-600.0, 600.0]
axes.C.travel = [-360.0, 360.0]
axes.{tilting}.travel = [-100.0, 100.0]
tool = {{ tip = [0.0, 0.0, -150.0] }}
[errors]
{errors}
"
    )
}

const ERRORS: &str = "EC0Y = 30.0\nEX0C = 20.0\nEY0C = -15.0\nEXX = { poly = [0.0, 0.02] }\n";
const UNKNOWN: &str =
    "folds = 0\nunknown = [\"EC0Y\", \"EX0C\", \"EY0C\", { error = \"EXX\", legendre = 1 }]\n";

/// What a shop does to a row: its number, the coordinates that are written, what is read.
type Change<'c> = &'c dyn Fn(usize, &mut [(AxisName, f64)], &mut [f64; 3]);

/// R-test at two spheres: the ideal machine stands on the sphere, the reading says by how much the real one is beside it, µm.
fn r_test(structure: &str, seed: u64, count: usize, change: Change<'_>) -> String {
    let nominal = Machine::parse(&machine(structure, ""), "nominal").expect("a machine");
    let truth = Machine::parse(&machine(structure, ERRORS), "truth").expect("a machine");
    let tilting = if structure.contains('B') { B } else { A };
    let mut noise = Noise::new(seed);
    let mut text = format!("X,Y,Z,C,{tilting},sphere,dx_um,dy_um,dz_um\n");
    for k in 0..count {
        let (c, tilt) = (noise.between(-170.0, 170.0), noise.between(-80.0, 80.0));
        let (centre, name) = match k % 2 {
            0 => ([120.0, 40.0, -300.0], "one"),
            _ => ([-150.0, 60.0, -220.0], "two"),
        };
        // The linear axes bring the ideal tip to the centre: on every chain they move it along fixed directions.
        let mut at = [(X, 0.0), (Y, 0.0), (Z, 0.0), (C, c), (tilting, tilt)];
        for _ in 0..3 {
            let here = tip(&nominal, &at, [0.0; 3]);
            let mut columns = [[0.0; 3]; 3];
            for axis in 0..3 {
                let mut moved = at;
                moved[axis].1 += 1.0;
                let by = tip(&nominal, &moved, [0.0; 3]) - here;
                columns[axis] = [by.x, by.y, by.z];
            }
            // The directions are normal to each other.
            for axis in 0..3 {
                let [x, y, z] = columns[axis];
                let to = [centre[0] - here.x, centre[1] - here.y, centre[2] - here.z];
                at[axis].1 += x * to[0] + y * to[1] + z * to[2];
            }
        }
        let off = tip(&truth, &at, [0.0; 3]) - tip(&nominal, &at, [0.0; 3]);
        let mut read = [off.x, off.y, off.z].map(|off| 1e3 * off + noise.normal(1.0));
        change(k, &mut at, &mut read);
        for (_, q) in at {
            let _ = write!(text, "{q:?},");
        }
        let [x, y, z] = read;
        let _ = writeln!(text, "{name},{x:?},{y:?},{z:?}");
    }
    text
}

const SPHERES: &str = "[[observation]]\nkind = \"sphere\"\nfile = \"s.csv\"\n";

/// A tracker on the table that sees the tip, mm.
fn tracker(structure: &str, seed: u64, count: usize, change: Change<'_>) -> String {
    let truth = Machine::parse(&machine(structure, ERRORS), "truth").expect("a machine");
    let tilting = if structure.contains('B') { B } else { A };
    let mut noise = Noise::new(seed);
    let mut text = format!("X,Y,Z,C,{tilting},x,y,z\n");
    for k in 0..count {
        let mut at = [X, Y, Z]
            .map(|axis| (axis, noise.between(-500.0, 500.0)))
            .to_vec();
        at.push((C, noise.between(-170.0, 170.0)));
        at.push((tilting, noise.between(-80.0, 80.0)));
        let seen = tip(&truth, &at, [0.0; 3]);
        let mut read = [seen.x, seen.y, seen.z].map(|x| x + noise.normal(0.001));
        change(k, &mut at, &mut read);
        for (_, q) in at {
            let _ = write!(text, "{q:?},");
        }
        let [x, y, z] = read;
        let _ = writeln!(text, "{x:?},{y:?},{z:?}");
    }
    text
}

const POINTS: &str = "[[observation]]\nkind = \"points\"\nfile = \"s.csv\"\n";

fn words(structure: &str, text: &str, observed: &str) -> String {
    let lab = Lab::new(&machine(structure, ""));
    lab.write("s.csv", text);
    let found = lab.identify(&format!("{UNKNOWN}{observed}"));
    found.expect("found").warnings.join("\n")
}

/// The line and the words of the jump that is refused.
fn refused(structure: &str, text: &str, observed: &str) -> (usize, f64, String) {
    let lab = Lab::new(&machine(structure, ""));
    lab.write("s.csv", text);
    match lab.identify(&format!("{UNKNOWN}{observed}")) {
        Err(IdentifyError::Jump {
            line,
            found_mm,
            why,
            ..
        }) => (line, found_mm, why),
        other => panic!("{other:?}"),
    }
}

const STRUCTURES: [&str; 3] = [TABLE, HEAD, TRUNNION];

fn is_told(words: &str) -> bool {
    words.contains("jumps") || words.contains("follows the order")
}

/// Machines with errors and instruments with noise, in any order of the rows: nothing is said of their order.
#[test]
fn clean_rows_are_in_no_order() {
    for structure in STRUCTURES {
        for seed in 0..12 {
            let clean = r_test(structure, seed, 40, &|_, _, _| ());
            let told = words(structure, &clean, SPHERES);
            assert!(!is_told(&told), "{structure} {seed}: {told}");
            let clean = tracker(structure, seed, 40, &|_, _, _| ());
            let told = words(structure, &clean, POINTS);
            assert!(!is_told(&told), "{structure} {seed}: {told}");
        }
    }
}

/// One slip, or a few, are no jump.
#[test]
fn slips_are_no_jump() {
    for seed in 0..6 {
        for slips in [&[37_usize][..], &[5], &[38, 39], &[3, 21, 33]] {
            let text = r_test(TABLE, seed, 40, &|k, _, read| {
                if slips.contains(&k) {
                    read[0] += 400.0;
                }
            });
            let told = words(TABLE, &text, SPHERES);
            assert!(!is_told(&told), "{seed} {slips:?}: {told}");
            assert!(told.contains("is it a slip?"), "{told}");
        }
    }
}

#[test]
fn the_zero_of_an_axis_that_shifts_by_millimetres_is_refused() {
    for structure in STRUCTURES {
        for (seed, shift) in [(1, 8.0), (2, -1.5), (3, 40.0)] {
            for first in [20, 33] {
                let shifted = |k: usize, at: &mut [(AxisName, f64)], _: &mut [f64; 3]| {
                    if k >= first {
                        at[0].1 += shift;
                    }
                };
                for (text, observed) in [
                    (r_test(structure, seed, 40, &shifted), SPHERES),
                    (tracker(structure, seed, 40, &shifted), POINTS),
                ] {
                    let (line, found_mm, why) = refused(structure, &text, observed);
                    assert_eq!(line, first + 2, "{structure} {shift} {why}");
                    assert!((found_mm - f64::abs(shift)).abs() < 0.05 * f64::abs(shift));
                    // What is written is too large by the shift: the rows fit with as much less.
                    let told = format!("the zero of X is shifted by {:.1}", -shift);
                    assert!(why.contains(&told) || why.contains("moved by"), "{why}");
                    if structure != HEAD {
                        assert!(why.contains(&told[..told.len() - 1]), "{told}: {why}");
                    }
                }
            }
        }
    }
}

#[test]
fn a_sphere_that_is_pushed_by_millimetres_is_refused() {
    for structure in STRUCTURES {
        let text = r_test(structure, 7, 60, &|k, _, read| {
            if k >= 30 && k % 2 == 0 {
                read[0] += 2000.0;
                read[1] -= 1000.0;
            }
        });
        let (line, _, why) = refused(structure, &text, SPHERES);
        assert_eq!(line, 32);
        assert!(why.starts_with("sphere one has moved by [-2.0"), "{why}");
    }
}

#[test]
fn a_small_shift_is_noted_with_its_row_and_size() {
    for structure in STRUCTURES {
        for seed in 0..3 {
            let text = r_test(structure, seed, 60, &|k, at, _| {
                if k >= 36 {
                    at[1].1 += 0.05;
                }
            });
            let told = words(structure, &text, SPHERES);
            assert!(
                told.contains("s.csv:38: at this row what is left jumps"),
                "{told}"
            );
            assert!(told.contains("the zero of Y is shifted by -"), "{told}");
            let text = r_test(structure, seed, 60, &|k, _, read| {
                if k >= 36 && k % 2 == 1 {
                    read[2] += 30.0;
                }
            });
            let told = words(structure, &text, SPHERES);
            // The first row of the sphere from there on.
            assert!(
                told.contains("s.csv:39: at this row what is left jumps"),
                "{told}"
            );
            assert!(told.contains("sphere two has moved by ["), "{told}");
            let text = tracker(structure, seed, 60, &|k, _, read| {
                if k >= 24 {
                    read[0] += 0.04;
                }
            });
            let told = words(structure, &text, POINTS);
            assert!(
                told.contains("s.csv:26: at this row what is left jumps"),
                "{told}"
            );
        }
    }
}

/// A spindle that grows and a tracker that drifts: the residuals follow the order of the rows, and nothing jumps.
#[test]
fn what_drifts_follows_the_order_of_the_rows() {
    for structure in STRUCTURES {
        for seed in 0..4 {
            let drifts = |k: usize, _: &mut [(AxisName, f64)], read: &mut [f64; 3]| {
                read[1] += 12.0 * k as f64 / 59.0;
            };
            let told = words(structure, &r_test(structure, seed, 60, &drifts), SPHERES);
            assert!(
                told.contains("s.csv: what is left follows the order"),
                "{told}"
            );
            assert!(told.contains("try `drift = 1`"), "{told}");
            assert!(!told.contains("jumps"), "{told}");
            let frame = |k: usize, _: &mut [(AxisName, f64)], read: &mut [f64; 3]| {
                read[1] += 0.012 * k as f64 / 59.0;
            };
            let text = tracker(structure, seed, 60, &frame);
            let told = words(structure, &text, POINTS);
            assert!(
                told.contains("s.csv: what is left follows the order"),
                "{told}"
            );
            assert!(!told.contains("jumps"), "{told}");
            let with = POINTS.to_owned() + "drift = 1\n";
            let told = words(structure, &text, &with);
            assert!(!is_told(&told), "{told}");
        }
    }
}

/// Rows in the order of an axis, and an error of this axis that nobody asked for: it looks like a drift, and both are said.
#[test]
fn an_error_of_an_axis_that_goes_with_the_rows_is_told_beside() {
    let lab = Lab::new("structure = \"w b X t\"\naxes = { X = { travel = [0, 1000] } }\n");
    let mut noise = Noise::new(3);
    let mut text = String::from("X,deviation_um\n");
    for k in 0..40 {
        let x = 25.0 * f64::from(k);
        let _ = writeln!(text, "{x},{:?}", 0.02 * x + noise.normal(0.5));
    }
    lab.write("d.csv", &text);
    let observed = "folds = 0\nunknown = []\n[[observation]]\nkind = \"line\"\nfile = \"d.csv\"\ndirection = [1, 0, 0]\noffset = \"unknown\"\n";
    let told = lab.identify(observed).expect("found").warnings.join("\n");
    assert!(
        told.contains("d.csv: what is left follows the order"),
        "{told}"
    );
    assert!(told.contains("in the order of X too"), "{told}");
}
