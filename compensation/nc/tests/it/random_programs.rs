//! Random paths in several languages, and the tool positions of each.

use std::fmt::Write as _;

use volcomp_model::Machine;
use volcomp_nc::{Decimals, Dialect, Job, NcError, Place, SetUp, Summary, Verification};

use crate::identity::{TRAVELS, result_of, verified_by, written};

/// Seeded random numbers.
pub(crate) struct Draw(u64);

impl Draw {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ 0x5EED)
    }

    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * ((self.0 >> 11) as f64 / (1_u64 << 53) as f64)
    }

    /// A number with three decimals.
    pub(crate) fn thousandths(&mut self, low: f64, high: f64) -> f64 {
        (self.between(low, high) * 1e3).round() / 1e3
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "not negative, and below the count"
    )]
    pub(crate) fn below(&mut self, count: usize) -> usize {
        (self.between(0.0, count as f64) as usize).min(count - 1)
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Way {
    Rapid,
    Line,
    /// An arc about a centre by an angle (rad, counterclockwise positive).
    Arc([f64; 2], f64),
}

/// A step of a path, mm in workpiece coordinates.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Step {
    pub(crate) way: Way,
    pub(crate) from: [f64; 3],
    pub(crate) to: [f64; 3],
}

/// A random path in a box of 400 mm; the first step is rapid.
pub(crate) fn path(draw: &mut Draw, steps: usize) -> Vec<Step> {
    // Start position of the axes, equal to the work offset.
    let mut at = [-40.0, 30.0, -20.0];
    let mut path = Vec::new();
    for place in 0..steps {
        let kind = if place == 0 { 0 } else { draw.below(5) };
        let from = at;
        let way = match kind {
            0 => {
                at = std::array::from_fn(|_| draw.thousandths(-150.0, 150.0));
                Way::Rapid
            }
            3 | 4 => {
                let (radius, angle) = (draw.between(3.0, 50.0), draw.between(-3.1, 3.1));
                let centre: [f64; 2] = [angle.cos(), angle.sin()];
                let centre =
                    std::array::from_fn(|i| ((at[i] + radius * centre[i]) * 1e3).round() / 1e3);
                let turns = draw.between(0.3, 5.5) * [1.0, -1.0][draw.below(2)];
                let [x, y] = [at[0] - centre[0], at[1] - centre[1]];
                let (sin, cos) = turns.sin_cos();
                let end = [cos * x - sin * y + centre[0], sin * x + cos * y + centre[1]];
                at[0] = (end[0] * 1e6).round() / 1e6;
                at[1] = (end[1] * 1e6).round() / 1e6;
                Way::Arc(centre, turns)
            }
            _ => {
                for at in &mut at {
                    if draw.below(3) > 0 {
                        *at = draw.thousandths(-150.0, 150.0);
                    }
                }
                Way::Line
            }
        };
        path.push(Step { way, from, to: at });
    }
    path
}

pub(crate) fn rs274(path: &[Step]) -> String {
    let mut text = "G21 G90 G54\nF1000\n".to_owned();
    for step in path {
        let [x, y, z] = step.to;
        match step.way {
            Way::Rapid => writeln!(text, "G0 X{x:.6} Y{y:.6} Z{z:.6}"),
            Way::Line => writeln!(text, "G1 X{x:.6} Y{y:.6} Z{z:.6}"),
            Way::Arc(centre, turns) => {
                let [i, j] = [centre[0] - step.from[0], centre[1] - step.from[1]];
                let code = if turns < 0.0 { 2 } else { 3 };
                writeln!(text, "G{code} X{x:.6} Y{y:.6} I{i:.6} J{j:.6}")
            }
        }
        .expect("a string");
    }
    text + "M2\n"
}

pub(crate) const SETUP: &str =
    "[work_offset.G54]\nX = 40.0\nY = -30.0\nZ = 20.0\n[start]\nX = 0.0\nY = 0.0\nZ = 0.0\n";
const ERRORS: &str = "[errors]\nEXX = { mean = { poly = [0.0, 0.1] }, reversal = 6.0 }\nEYX = { poly = [0.0, 0.0, 0.0004] }\nEYY = { table = [[-1000, 0], [0, 30], [1000, -20]], interpolation = \"linear\" }\nEZX = { poly = [0.0, 0.05, 0.0002] }\nEC0Y = 60.0\n";

/// The machine of the random programs with this reversal value of X, µm.
pub(crate) fn worn(reversal_um: f64) -> Machine {
    let errors = ERRORS.replace("6.0", &reversal_um.to_string());
    let text = format!("{TRAVELS}{errors}");
    Machine::parse(&text, "m.toml").expect("a good machine")
}

/// The example of a machine with a tilting rotary table.
pub(crate) fn tilting() -> Machine {
    let text = include_str!("../../../../examples/table-tilting.toml");
    Machine::parse(text, "m.toml").expect("a good machine")
}

/// Random motions of that machine in RS-274, with tool centre point control (M428) from one of the first to the last.
pub(crate) fn centre_point_lines(draw: &mut Draw) -> Vec<String> {
    let mut lines = vec!["G90 G0 X300.0 Y250.0 Z-100.0 A-10.0 C0.0".to_owned()];
    let on = draw.below(4);
    for place in 0..8 {
        if place == on {
            lines.push("M428".to_owned());
        }
        let [x, y] = [draw.thousandths(260.0, 340.0), draw.thousandths(210.0, 290.0)];
        let [z, a] = [draw.thousandths(-250.0, -100.0), draw.thousandths(-80.0, -5.0)];
        let c = draw.thousandths(-300.0, 300.0);
        let code = draw.below(2);
        lines.push(format!("G{code} X{x:.3} Y{y:.3} Z{z:.3} A{a:.3} C{c:.3}"));
    }
    lines.push("M429".to_owned());
    lines
}

/// Compensates a program, and runs both programs on the virtual machine.
pub(crate) fn judged(
    machine: &Machine,
    setup: &str,
    dialect: Dialect,
    program: &str,
) -> Result<(String, Summary, Verification), NcError> {
    let setup = SetUp::parse(setup, "setup.toml").expect("a good set-up");
    let decimals = Decimals { mm: 5, inch: 6, deg: 5 };
    let bytes = program.as_bytes();
    let (out, summary) = result_of((machine, 0.001), &setup, bytes, |job| Job {
        dialect,
        decimals,
        keep_shares: true,
        ..job
    })?;
    let text = String::from_utf8(out).expect("text");
    let found = verified_by(machine, &setup, dialect, [program, &text], &summary.shares)?;
    Ok((text, summary, found))
}

/// Checks that the compensated path in RS-274 and in another language reaches the same tool positions.
pub(crate) fn assert_same_positions(
    machine: &Machine,
    path: &[Step],
    dialect: Dialect,
    program: &str,
) -> String {
    let (_, _, expected) =
        judged(machine, SETUP, Dialect::Rs274, &rs274(path)).expect("RS-274 is taken");
    let (text, summary, found) = judged(machine, SETUP, dialect, program)
        .unwrap_or_else(|error| panic!("{error}\n{program}"));
    assert!(summary.counts.changed > 0, "{program}");
    assert_eq!(found.motions, expected.motions, "{program}");
    assert_equal_paths(&found, &expected, program, &text);
    text
}

/// Checks for equal tool positions and deviations, within the rounding of words with five decimals.
pub(crate) fn assert_equal_paths(
    found: &Verification,
    expected: &Verification,
    program: &str,
    result: &str,
) {
    // In a rotated frame a motion may be split at another point, but its end is equal.
    let ends = |of: &Verification| -> Vec<Place> {
        let path = of.path.iter();
        let is_last = |(at, place): &(usize, &Place)| {
            of.path.get(at + 1).is_none_or(|next| next.line != place.line)
        };
        let ends = path.enumerate().filter(is_last);
        ends.map(|(_, place)| *place).collect()
    };
    let (of_found, of_expected) = if found.places == expected.places {
        (found.path.clone(), expected.path.clone())
    } else {
        (ends(found), ends(expected))
    };
    assert_eq!(of_found.len(), of_expected.len(), "{program}\n{result}");
    for (found, expected) in of_found.iter().zip(&of_expected) {
        for i in 0..3 {
            let off_mm = (found.tip_mm[i] - expected.tip_mm[i]).abs();
            assert!(off_mm < 2e-5, "{found:?} {expected:?}\n{program}\n{result}");
            let off_um = (found.after_um[i] - expected.after_um[i]).abs();
            assert!(off_um < 0.1, "{found:?} {expected:?}\n{program}\n{result}");
        }
    }
    // Tolerance of splitting plus that of a rotated frame.
    let most_um = expected.after.max_um.max(1.0) + 0.1;
    assert!(found.after.max_um < most_um, "{found:?}\n{program}");
    assert!(found.after.rms_um < 0.5 * found.before.rms_um, "{found:?}\n{program}");
}

/// Checks that a machine without errors returns every byte; `Err` is the reason for a refusal.
pub(crate) fn copy_unchanged(
    machine: &Machine,
    dialect: Dialect,
    program: &[u8],
) -> Result<(), NcError> {
    let setup = SetUp::default();
    let (out, summary) = result_of((machine, 0.001), &setup, program, |job| Job {
        dialect,
        most_blocks: 20_000,
        ..job
    })?;
    assert_eq!(String::from_utf8_lossy(&out), String::from_utf8_lossy(program));
    assert_eq!((summary.counts.changed, summary.counts.added), (0, 0));
    Ok(())
}

pub(crate) fn assert_copied(dialect: Dialect, programs: &[&[u8]]) {
    let machine = Machine::parse(TRAVELS, "m.toml").expect("a good machine");
    for program in programs {
        let text = String::from_utf8_lossy(program);
        copy_unchanged(&machine, dialect, program)
            .unwrap_or_else(|error| panic!("{error}\n{text}"));
    }
}

/// Whether a machine without errors accepts a program and returns it unchanged. If so, checks that the result on a worn
/// machine is accepted as well.
pub(crate) fn accepts_with_result(dialect: Dialect, program: &str) -> bool {
    let ideal = Machine::parse(TRAVELS, "m.toml").expect("a good machine");
    if copy_unchanged(&ideal, dialect, program.as_bytes()).is_err() {
        return false;
    }
    if let Ok((result, _)) = written(dialect, &worn(6.0), "", program)
        && let Err(error) = written(dialect, &ideal, "", &result)
    {
        panic!("{error}\n{program}\n{result}");
    }
    true
}
