//! A reversal error while the axis creeps, stops, and moves back and forth by less than the reversal threshold.

use super::{PORT, alone::alone, configuration_of, peer::LinuxCnc, start};

alone!(creep: the_side_of_a_reversal_changes_once_and_only_after_its_way);

const MACHINE: &str = r#"
name = "mill"
structure = "w X' b Y Z t"
[axes.X]
travel = [-10.0, 500.0]
[axes.Y]
travel = [-10.0, 400.0]
[axes.Z]
travel = [-300.0, 10.0]
[errors]
EXX = { mean = { poly = [0.0] }, reversal = 3.0 }
"#;

/// Half of the reversal error, mm.
const SIDE: f64 = 1.5e-3;
/// Minimum offset that identifies a side, mm.
const NEARLY: f64 = 1.4e-3;

/// Nominal positions of X at which the side of the reversal error changes, each with the new side: 1 after motion to
/// larger positions, otherwise -1.
fn sides(cycles: &[super::Cycle]) -> Vec<(i32, f64)> {
    let mut found: Vec<(i32, f64)> = Vec::new();
    for cycle in cycles {
        let offset = cycle.offset[0];
        let side = i32::from(offset < -NEARLY) - i32::from(offset > NEARLY);
        if side != 0 && found.last().is_none_or(|(last, _)| *last != side) {
            found.push((side, cycle.nominal[0]));
        }
    }
    found
}

fn the_side_of_a_reversal_changes_once_and_only_after_its_way() {
    let dir = tempfile::tempdir().expect("writable");
    let mut control = LinuxCnc::start(dir.path(), |ini| ini);
    let config = configuration_of(dir.path(), PORT, MACHINE);
    let program = start(dir.path(), &config);
    control.do_it("up");
    program.wait_for("compensating");
    control.mdi("G21 G90 G1 F600 X40");
    control.mdi("X50");
    control.wait("axis.x.eoffset", |has| (has + SIDE).abs() < 3e-6);

    // 0.2 mm/min is 3.3 nm per cycle. A reversal is detected 5 µm from the extreme position: here at 50.003 and then at
    // 49.996.
    let cycles = control.record(|control| {
        for line in [
            "G1 F0.2 X50.003",
            "G4 P0.5",
            "X49.999",
            "G4 P0.5",
            "X50.002",
            "X49.996",
            "G4 P0.5",
            "X50",
            "X49.998",
            "X50.003",
            "G4 P0.5",
        ] {
            control.mdi(line);
        }
    });
    let found = sides(&cycles);
    let order: Vec<i32> = found.iter().map(|(side, _)| *side).collect();
    assert_eq!(order, [1, -1, 1], "{found:?}");
    // Several readings must agree, and the offset moves at its own rate.
    for ((_, at), expected) in found[1..].iter().zip([49.998, 50.001]) {
        assert!((at - expected).abs() < 1e-4, "{at} mm, {expected} mm");
    }
    // The offset moves from side to side monotonically.
    let offsets = || cycles.iter().map(|cycle| cycle.offset[0]);
    let moved: f64 = offsets().zip(offsets().skip(1)).map(|(a, b)| (b - a).abs()).sum();
    assert!((moved - 4.0 * SIDE).abs() < 2e-5, "{moved} mm");
}
