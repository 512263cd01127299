//! Lost motion and directions of approach on a virtual machine and in the result.

use volcomp_model::Machine;
use volcomp_nc::{Dialect, Strategy, Verification};
use volcomp_test_support::rows;

use crate::identity::{TRAVELS, verified_in, written};

/// The axes start at machine zero, which in X is also the zero of G54.
const START: &str = "[start]\nX = 0\nY = 0\nZ = 0\n[work_offset.G54]\nX = 0\n[tool.1]\nZ = 0\n";
const EXAMPLE: &str = include_str!("../../../../examples/table-tilting.toml");
const CONE: &str = include_str!("../../../../examples/parts/cone.ngc");
const CONE_SETUP: &str = include_str!("../../../../examples/parts/cone-setup.toml");

fn verified(machine: &str, setup: &str, program: &str, strategy: Strategy) -> Verification {
    played(Dialect::Rs274, [machine, setup, program], strategy)
}

fn played(dialect: Dialect, texts: [&str; 3], strategy: Strategy) -> Verification {
    let (_, _, found) = verified_in(dialect, texts, strategy).expect("compensated and verified");
    found
}

/// Closed form: a carriage with lost motion of 4 µm rests while its drive moves back and forth by 1 µm; with compensation at most 0.5 µm
/// remain.
#[test]
fn a_carriage_rests_within_its_play() {
    let lags = format!("{TRAVELS}[errors]\nEXX = {{ mean = {{ poly = [0.0] }}, reversal = -4 }}\n");
    let program = "G90 G0 X0 Y0 Z0\nG1 F100 X100\nX99.999\nX100\nX99.990\n";
    let found = verified(&lags, "", program, Strategy::Plain);
    let last_of = |line: usize| {
        let mut places = found.path.iter().rev();
        let last = places.find(|place| place.line == line).expect("looked at");
        (last.before_um[0], last.after_um[0])
    };
    // The carriage starts in the middle of the lost motion, 2 µm behind, and moves once the drive has travelled 4 µm.
    for (line, before) in [(2, -2.0), (3, -1.0), (4, -2.0), (5, 2.0)] {
        let (found, left) = last_of(line);
        assert!((found - before).abs() < 1e-6, "line {line}: {found} µm");
        assert!(left.abs() < 0.501, "line {line}: {left} µm");
    }
}

/// Closed form: from A350, `A=DC(10)` turns forward by the shorter way, although the coordinate falls. The drive has
/// not reversed, so the table stays at the same flank of its lost motion.
#[test]
fn the_shorter_way_keeps_the_flank() {
    let travel = "travel = [-500, 500]\n";
    let lags = format!(
        "name = \"m\"\nstructure = \"w A' b X Y Z t\"\n[axes.X]\n{travel}[axes.Y]\n{travel}[axes.Z]\n{travel}[axes.A]\n{travel}[errors]\nEAA = {{ mean = {{ poly = [0.0] }}, reversal = -40 }}\n"
    );
    let program =
        "G0 X0 Y100 Z0 A340\nA=DC(350)\nA=DC(10)\nA=DC(30)\nA=DC(10)\nA=DC(350)\nA=DC(330)\n";
    let start = "[start]\nA = 0\n[work_offset.G500]\nA = 0\n";
    let found = played(Dialect::Siemens, [&lags, start, program], Strategy::Plain);
    let length = |um: [f64; 3]| um.iter().map(|um| um * um).sum::<f64>().sqrt();
    // Deviation of the table along the circle about its centre, with sign.
    let off: Vec<f64> = found
        .path
        .iter()
        .map(|place| {
            let [_, y, z] = place.tip_mm;
            let [_, by_y, by_z] = place.before_um;
            assert!((length(place.before_um) - 2.0).abs() < 1e-3, "{place:?}");
            (y * by_z - z * by_y).signum()
        })
        .collect();
    let forward = off[0];
    let expected = [1.0, 1.0, 1.0, 1.0, -1.0, -1.0, -1.0].map(|side| side * forward);
    assert_eq!(off, expected);
    for place in &found.path {
        assert!(length(place.after_um) < 1.0, "{place:?}");
    }
}

/// Five machines with lost motion in all five axes, lagging or running ahead: a bore and a cone milled off the table's centre are within
/// 1.5 µm with words of 1 µm.
#[test]
fn worn_machines_are_within_a_step_and_a_half() {
    for play in [-7.0, -3.5, -1.2, 2.0, 7.0] {
        let mut text = EXAMPLE.replace("reversal = 2.0", &format!("reversal = {play}"));
        for (name, share) in [("EXX", 0.9), ("EZZ", 0.7), ("ECC", 0.5)] {
            let line = EXAMPLE.lines().find(|line| line.starts_with(name));
            let line = line.expect("an error of the example");
            let (_, curve) = line.split_once(" = ").expect("a curve");
            let with = format!("{name} = {{ mean = {curve}, reversal = {} }}", share * play);
            text = text.replace(line, &with);
        }
        for strategy in [Strategy::Plain, Strategy::Floyd] {
            let found = verified(&text, CONE_SETUP, CONE, strategy);
            assert!(found.before.max_um > 20.0, "{:?}", found.before);
            assert!(found.after.max_um < 1.5, "{play} µm: {:?}", found.after);
            assert!(found.after.rms_um < 0.6, "{play} µm: {:?}", found.after);
        }
    }
}

/// With lost motion of 4 µm, X80 is 80.002 in positive direction and 79.998 after the reversal. The line added before an arc is read
/// before the codes of the arc, whatever these are.
#[test]
fn play_is_taken_up_before_arcs_with_other_codes() {
    let machine = "[errors]\nEXX = { mean = { poly = [0.0] }, reversal = -4.0 }\n";
    let around = |before: &str, block: &str| {
        format!("{before}G0 X50 Y40 Z0 F400\nG0 X60\nG1 X80\n{block}\nM2\n")
    };
    for block in [
        "G3 X80 Y40 I-20 J0",
        "G17 G3 X80 Y40 I-20 J0",
        "N40 G17 G3 X60 Y60 R20",
        "G18 G3 X60 Z20 I-20 K0",
        "G91 G3 X0 Y0 I-20 J0",
        "G94 G3 X80 Y40 I-20 J0",
        "G40 G3 X80 Y40 I-20 J0",
        "G20 G3 X0 Y0 R20",
        "G7 G3 X120 Y60 R20",
        "G3 X80 Y40 I-20 J0 M8",
        "G3 X80 Y40 I-20 J0 T2 M3 S100",
        "#5=7 G3 X80 Y40 I-20 J0",
    ] {
        let out = crate::flow::text(machine, &around("", block));
        let line = out.lines().nth(3);
        assert_eq!(out.lines().nth(2), Some("G1 X80.002"), "{block}: {out}");
        assert_eq!(line, Some("G1 X79.998"), "{block}: {out}");
    }
    // Incremental, and in inches: 3 inch are 76.2 mm.
    let out = crate::flow::text(
        machine,
        "G0 X50 Y40 Z0 F400\nG0 X60\nG91 G1 X20\nG90 G3 X80 Y40 I-20 J0\nM2\n",
    );
    assert_eq!(out.lines().nth(3), Some("G1 X-0.004"), "{out}");
    let out = crate::flow::text(
        machine,
        "G20 G0 X1 Y2 Z0 F40\nG0 X2\nG1 X3\nG21 G3 X76.2 Y50.8 I-20 J0\nM2\n",
    );
    assert_eq!(out.lines().nth(3), Some("G1 X2.9999"), "{out}");
    // Without an earlier F the added line gets the F of the arc.
    let out = crate::flow::text(
        machine,
        "G0 X60 Y40 Z0\nG0 X80\nG0 Y50\nG17 G3 X80 Y50 I-20 J0 F250\nM2\n",
    );
    assert!(out.contains("\nG1 X79.998 F250\nG17 G3 "), "{out}");
}

/// With lost motion of 4 µm in X, the word is 80.002 after a positive motion, 79.998 after a negative one, and the mean where the
/// direction is unknown.
#[test]
fn an_axis_from_an_unknown_position_has_no_direction_of_approach() {
    const G54: &str = "[work_offset.G54]\nX = 0\n";
    const MIDDLE: &str =
        "[start]\nX = 0\nY = 0\nZ = 0\n[home.G28]\nX = 30\n[work_offset.G54]\nX = 0\n";
    const HOME: &str = "[home.G28]\nX = 0\n[work_offset.G54]\nX = 0\n";
    let lags = format!("{TRAVELS}[errors]\nEXX = {{ mean = {{ poly = [0.0] }}, reversal = -4 }}\n");
    let machine = Machine::parse(&lags, "m.toml").expect("a good machine");
    // The corrected lines, and the line of the note about X (0: none).
    for [setup, program, expected, noted] in rows(
        r"
START | G0 X80 Y0 Z0\nG1 Z5 F100\n | G0 X80.002 Y0 Z0\nG1 Z5 F100\n | 0
 | G0 X80 Y0 Z0\nG1 Z5 F100\n | G0 X80 Y0 Z0\nG1 Z5 F100\n | 2
 | G1 X80 Y0 Z0 F100\nX90\n | G1 X80 Y0 Z0 F100\nX80.002\nX90.002\n | 1
 | G81 X80 Y0 Z-10 R5 F100\n | G81 X80 Y0 Z-10 R5 F100\n | 1
// A tool change, an M code that may have moved X, and a motion that may be skipped.
START | G0 X80\nT1 M6\nG0 X60 Y0 Z5\nG1 Z0 F100\n | G0 X80.002\nT1 M6\nG0 X60 Y0 Z5\nG1 Z0 F100\n | 4
START | G0 X80\nM92 X80\nG0 X60 Y0 Z5\nG1 Z0 F100\n | G0 X80.002\nM92 X80\nG0 X60 Y0 Z5\nG1 Z0 F100\n | 4
START | G0 X80\n/G0 X100\nG0 X60\nG1 Z0 F100\n | G0 X80.002\n/G0 X100.002\nG0 X60\nG1 Z0 F100\n | 4
// An incremental word shows the direction.
START | G0 X80\nT1 M6\nG91 G0 X-5\nG1 Z1 F100\n | G0 X80.002\nT1 M6\nG91 G0 X-5.004\nG1 Z1 F100\n | 0
// Machine coordinates, with and without the work offset that relates them to the target.
G54 | G53 G0 X0\nG0 X60\n | G53 G0 X0\nG0 X60.002\n | 0
 | G53 G0 X0\nG0 X60\nG1 Z0 F100\n | G53 G0 X0\nG0 X60\nG1 Z0 F100\n | 3
HOME | G28 X0\nG0 X60\n | G28 X0\nG0 X60.002\n | 0
G54 | G28 X0\nG0 X60\n | G28 X0\nG0 X60\n | 0
// The intermediate point lies before home, or beyond it, so that the axis reverses there.
MIDDLE | G0 X60\nG28 X50\nG1 Z1 F100\n | G0 X60.002\nG28 X50\nG1 Z0.000 F100 X29.998\nZ1.000\n | 0
MIDDLE | G0 X60\nG91 G28 X-40\nG90 G1 Z1 F100\nX20\n | G0 X60.002\nG91 G28 X-40\nG90 G1 Z0.000 F100 X30.002\nZ1.000\nX29.998\nX19.998\n | 0
START | G0 X60\nG53 G0 X0\nG53 G0 X90\nG0 X80\n | G0 X60.002\nG53 G0 X0\nG53 G0 X90\nG0 X79.998\n | 0
",
    ) {
        let setup = match setup {
            "START" => START,
            "G54" => G54,
            "MIDDLE" => MIDDLE,
            "HOME" => HOME,
            _ => "",
        };
        let (out, notes) = written(Dialect::Rs274, &machine, setup, program).expect(program);
        assert_eq!(out, expected, "{setup}{notes:?}");
        let approach = notes.iter().find(|note| note.contains("direction of approach of X"));
        let line = approach.and_then(|note| note.split(':').next());
        assert_eq!(line.unwrap_or("0"), noted, "{program}{notes:?}");
    }
}

/// Backlash of Z, 10 µm: after a hole the tool comes from below, wherever the hole and the next motion end; after a drilling cycle of a control, whose
/// bottom is unknown, the side is unknown.
#[test]
fn after_a_hole_the_axis_comes_from_the_bottom() {
    let machine =
        format!("{TRAVELS}[errors]\nEZZ = {{ mean = {{ poly = [0.0] }}, reversal = -10 }}\n");
    let machine = Machine::parse(&machine, "m.toml").expect("a good machine");
    for [dialect, hole, then, expected] in rows(
        r"
rs274 | G98 G81 X10 Y10 Z-16 R2\nX20\nG80\n | G0 Z-5\n | G0 Z-5.005\n
rs274 | G99 G81 X10 Y10 Z-16 R2\nG80\n | G0 Z0\n | G0 Z-0.005\n
rs274 | G98 G81 X10 Y10 Z-16 R2\nG80\n | G0 Z40\n | G0 Z40.005\n
siemens | G0 Z50\nG0 Z38\nCYCLE81(38,0,2,-16)\n | G1 Y50 F500\n | G1 Y50 F500\n
",
    ) {
        let dialect = match dialect {
            "siemens" => Dialect::Siemens,
            _ => Dialect::Rs274,
        };
        let start = "[start]\nX = 0\nY = 0\nZ = 0\n[work_offset.G54]\nX = 0\n";
        let program = format!("G90 G0 X0 Y0\nG0 Z-5\nG0 Z38\n{hole}{then}G1 X100 F500\n");
        let (out, notes) = written(dialect, &machine, start, &program).expect(hole);
        let expected = format!("{expected}G1 X100 F500\n");
        assert!(out.ends_with(&expected), "{expected}{out}{notes:?}");
    }
}

/// Without `[start]` the virtual machine starts with the carriage of X in the middle of its lost motion.
#[test]
fn the_virtual_machine_assumes_no_direction_of_approach() {
    let program = "G0 X80 Y0 Z0\nG1 Z5 F100\nX90\nX70\n";
    for reversal in [-4.0, 4.0] {
        let error = format!("EXX = {{ mean = {{ poly = [0.0] }}, reversal = {reversal} }}\n");
        let machine = format!("{TRAVELS}[errors]\n{error}");
        for (setup, first) in [("", 0.0), (START, 0.5)] {
            let found = verified(&machine, setup, program, Strategy::Plain);
            for (line, share) in [(1, first), (2, first), (3, 0.5), (4, -0.5)] {
                let at = found.path.iter().rfind(|place| place.line == line);
                let at = at.expect("a place of the line");
                assert!((at.before_um[0] - share * reversal).abs() < 1e-6, "{setup}{at:?}");
                assert!(at.after_um[0].abs() < 1e-6, "{setup}{at:?}");
            }
        }
    }
}

/// Y is 0.2 µm/deg too far by the angle of C, and its carriage lags by 12 µm. At C50 the carriage has to go back by 10 µm, and forward
/// again while C turns to 0: calculated by hand, it is at 10.000 with the drive at 10.006, then at 9.990 with the drive at 9.984, then with the
/// drive at 9.996. A motion without correction leaves the carriage in place, although the correction there differs.
#[test]
fn a_resting_axis_keeps_its_side_of_approach() {
    let travel = "travel = [-500, 500]\n";
    let machine = |reversal: f64| {
        format!(
            "name = \"m\"\nstructure = \"w C' b X Y Z t\"\n[axes.X]\n{travel}[axes.Y]\n{travel}[axes.Z]\n{travel}[axes.C]\ntravel = [-100, 100]\n[errors]\nEYC = {{ poly = [0.0, 0.2] }}\nEYY = {{ mean = {{ poly = [0.0] }}, reversal = {reversal} }}\n"
        )
    };
    let zero = "X = 0\nY = 0\nZ = 0\nC = 0\n";
    let setup = format!(
        "[start]\n{zero}[work_offset.G54]\n{zero}[home.G28]\nX = 0\nY = 0\nZ = 0\nC = 50\n"
    );
    for [program, expected] in rows(
        r"
G28 C0\nG1 C0\n | G28 C0\nG1 C50.000 Y9.984\nY9.996\nC
G53 G0 C50\nG1 C0\n | G53 G0 C50\nG1 C50.000 Y9.984\nY9.996\nC
// The other way round: forward by 10 µm, then back.
G53 G0 C-50\nG1 C0\n | G53 G0 C-50\nG1 C-50.000 Y10.016\nY10.004\nC
// Between the ends of a rapid motion the carriage does not move, or only backward.
G53 G0 C50\nG0 C0\nG1 X9\n | G53 G0 C50\nG0 C0\nG1 X9\n
G53 G0 C50\nG0 C40\nG1 X9\n | G53 G0 C50\nG0 C40 Y9.986\nG1 X9\n
G28 C0\nG1 C60\n | G28 C0\nG1 C50.000 Y9.984\nC
G28 C0\nG1 Y20 C60\n | G28 C0\nG1 Y9.984 C50.000\nY9.996\nY
G28 C0\nG3 X10 Y20 R10 C0\n | G28 C0\nG1 Y9.984\nG1 Y9.996\nG3 X
",
    ) {
        let program = format!("G21 G90 G54\nG1 F500 X0 Y10 C0\n{program}");
        for reversal in [-12.0, 12.0] {
            let machine = machine(reversal);
            let texts = [&*machine, &setup, &program];
            let (out, _, found) =
                verified_in(Dialect::Rs274, texts, Strategy::Plain).expect("verified");
            if reversal < 0.0 {
                let (_, after) = out.split_once("Y10.006\n").expect("the first motion");
                assert!(after.starts_with(expected), "{out}");
            }
            assert!(found.after.max_um < 1.1, "{reversal} µm: {:?}\n{out}", found.after);
        }
    }
}
