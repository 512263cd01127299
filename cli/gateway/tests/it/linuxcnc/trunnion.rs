//! Five axes on LinuxCNC, with the example of a tilting rotary table.
//!
//! X, Y and Z are corrected for the positions of A and C while all five axes move.

use std::time::{Duration, Instant};

use crate::{
    linuxcnc::{
        MOST, PORT, corrected_by, no_jump,
        peer::{LinuxCnc, alone},
        start, write_configuration,
    },
    program::Program,
};

alone!(trunnion: what_the_linear_axes_do_is_the_correction_for_the_table);

/// Intersection of the axes of rotation, mm. The tool tip is 100 mm below the spindle.
const CROSSING: [f64; 3] = [200.0, 150.0, -300.0];
const LENGTH: f64 = 100.0;

const MACHINE: &str = r#"
name = "trunnion"
structure = "w C' A' b X Y Z t"
[axes.C]
travel = [-360.0, 360.0]
point = [200.0, 150.0, -300.0]
[axes.A]
travel = [-120.0, 120.0]
point = [200.0, 150.0, -300.0]
[axes.X]
travel = [-10.0, 500.0]
[axes.Y]
travel = [-10.0, 400.0]
[axes.Z]
travel = [-400.0, 10.0]
[tool]
gauge = [0.0, 0.0, 0.0]
length = 100.0
[errors]
EX0C = 6.0
EY0A = -5.0
ECC = { poly = [0.0, 0.2] }
EXX = { poly = [1.0, 0.02] }
"#;

/// Corrections by hand, mm. The table carries the workpiece, so each error of the table is rotated back by the angle of
/// the table.
fn oracle([x, y, z]: [f64; 3], [a, c]: [f64; 2]) -> [f64; 3] {
    let um = 1e-3;
    // Rotation of the workpiece about the C line in the frame of the bed, and the lever arm of the tip.
    let turn = 0.2 * c * 1e-6;
    let (sin_a, cos_a) = a.to_radians().sin_cos();
    let (sin_c, cos_c) = c.to_radians().sin_cos();
    let lever = [x - CROSSING[0], y - CROSSING[1], z - LENGTH - CROSSING[2]];
    // The C line is displaced by 6 µm to +X, the A line by 5 µm to −Y.
    let (line_c, line_a) = (6.0 * um, -5.0 * um);
    [
        line_c * (1.0 - cos_c) + turn * (cos_a * lever[1] - sin_a * lever[2])
            - (1.0 + 0.02 * x) * um,
        line_c * sin_c * cos_a + line_a * (1.0 - cos_a) - turn * cos_a * lever[0],
        -line_c * sin_c * sin_a + line_a * sin_a + turn * sin_a * lever[0],
    ]
}

fn wait_corrected(control: &mut LinuxCnc, program: &Program) {
    let end = Instant::now() + Duration::from_secs(60);
    loop {
        let at: Vec<f64> = control.get(
            &["x", "y", "z", "a", "c"]
                .map(|axis| format!("axis.{axis}.pos-cmd"))
                .each_ref()
                .map(String::as_str),
        );
        let found = super::offsets(control);
        let wanted = oracle([at[0], at[1], at[2]], [at[3], at[4]]);
        if (0..3).all(|axis| (found[axis] - wanted[axis]).abs() < 3e-6) {
            return;
        }
        assert!(
            Instant::now() < end,
            "at {at:?} offsets {found:?}, wanted {wanted:?}\n{}\n{}",
            program.state(),
            control.log()
        );
        std::thread::sleep(Duration::from_millis(50));
    }
}

fn what_the_linear_axes_do_is_the_correction_for_the_table() {
    let dir = tempfile::tempdir().expect("writable");
    // The output steps are 1 nm, because the test measures nanometres.
    let mut control = LinuxCnc::start_example("trunnion", dir.path(), |ini| {
        let changed = ini.replace("STEP_NM = 10\nLIMIT_UM = 300", "STEP_NM = 1\nLIMIT_UM = 30");
        assert_ne!(changed, ini);
        changed
    });
    let config = write_configuration(dir.path(), PORT, MACHINE, "reads = [\"A\", \"C\"]\n");
    let program = start(dir.path(), &config);
    control.do_it("up");
    control.mdi("G21 G90 G0 X180 Y120 Z-150 A0 C0");
    wait_corrected(&mut control, &program);

    // On each axis the correction changes by far more than the asserted limits.
    let way = [[180.0, 120.0, -150.0, 0.0, 0.0], [200.0, 135.0, -165.0, -30.0, 40.0]];
    let [from, to] = way.map(|at| oracle([at[0], at[1], at[2]], [at[3], at[4]]));
    for axis in 0..3 {
        assert!((to[axis] - from[axis]).abs() > 5e-4, "{from:?} {to:?}");
    }
    let wanted = |at: &super::Cycle| oracle(at.nominal, at.rotary);
    let cycles = control.record(|control| control.mdi("G1 F200 X200 Y135 Z-165 A-30 C40"));
    corrected_by("five axes", &cycles, wanted);
    let turned = cycles.last().expect("some").rotary;
    assert!((turned[0] + 30.0).abs() < 1e-9 && (turned[1] - 40.0).abs() < 1e-9, "{turned:?}");
    no_jump(&cycles, MOST);
    wait_corrected(&mut control, &program);

    // Only the table moves, with both axes through zero, so all motion of the linear axes is correction.
    let cycles = control.record(|control| control.mdi("G1 F300 A5 C-5"));
    corrected_by("the table alone", &cycles, wanted);
    no_jump(&cycles, MOST);
    let moved = |cycle: &super::Cycle| {
        (0..3).map(|k| (cycle.motor[k] - cycles[0].motor[k]).abs()).fold(0.0, f64::max)
    };
    let most = cycles.iter().map(moved).fold(0.0, f64::max);
    assert!(most > 3e-3, "{most} mm");
}
