//! Play: a carriage that lags, as a virtual machine has it and as the result takes it up.

use volcomp_nc::{Dialect, Strategy, Verification};

use crate::identity::{TRAVELS, verified_in};

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

/// A carriage that lags by 4 µm stands still where its drive goes back by 1 µm, and where that comes again: on paper.
#[test]
fn a_carriage_stands_still_within_its_play() {
    let lags = format!("{TRAVELS}[errors]\nEXX = {{ mean = {{ poly = [0.0] }}, reversal = -4 }}\n");
    let program = "G90 G0 X0 Y0 Z0\nG1 F100 X100\nX99.999\nX100\nX99.990\n";
    let found = verified(&lags, "", program, Strategy::Plain);
    let last_of = |line: usize| {
        let mut places = found.path.iter().rev();
        let last = places.find(|place| place.line == line).expect("looked at");
        (last.before_um[0], last.after_um[0])
    };
    // From the middle of its play: 2 µm behind, then the drive comes towards it, and from 4 µm on takes it along.
    for (line, before) in [(2, -2.0), (3, -1.0), (4, -2.0), (5, 2.0)] {
        let (found, left) = last_of(line);
        assert!((found - before).abs() < 1e-6, "line {line}: {found} µm");
        assert!(left.abs() < 0.501, "line {line}: {left} µm");
    }
}

/// A rotary axis that goes on by the shorter way has another number, and its carriage stays at the flank where it is: on paper.
#[test]
fn the_shorter_way_keeps_the_flank() {
    let travel = "travel = [-500, 500]\n";
    let lags = format!(
        "name = \"m\"\nstructure = \"w A' b X Y Z t\"\n[axes.X]\n{travel}[axes.Y]\n{travel}[axes.Z]\n{travel}[axes.A]\n{travel}[errors]\nEAA = {{ mean = {{ poly = [0.0] }}, reversal = -40 }}\n"
    );
    let program =
        "G0 X0 Y100 Z0 A340\nA=DC(350)\nA=DC(10)\nA=DC(30)\nA=DC(10)\nA=DC(350)\nA=DC(330)\n";
    let found = played(Dialect::Siemens, [&lags, "", program], Strategy::Plain);
    let length = |um: [f64; 3]| um.iter().map(|um| um * um).sum::<f64>().sqrt();
    // Which way the table is off: along the circle about its centre.
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

/// Five machines of different play, in all five axes, whose carriages lag or run ahead: a bore and a cone that is milled off the centre
/// of the table are within 1.5 µm with words of 1 µm.
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

/// Lost motion of 4 µm: forward an axis is 2 µm short, so that X80 is written as 80.002, and behind its turning point as 79.998. The line
/// that takes this up is read before the codes of the arc, whatever these are.
#[test]
fn play_is_taken_up_before_arcs_with_other_codes() {
    let machine = "[errors]\nEXX = { mean = { poly = [0.0] }, reversal = -4.0 }\n";
    let around =
        |before: &str, block: &str| format!("{before}G0 X60 Y40 Z0 F400\nG1 X80\n{block}\nM2\n");
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
        let line = out.lines().nth(2);
        assert_eq!(out.lines().nth(1), Some("G1 X80.002"), "{block}: {out}");
        assert_eq!(line, Some("G1 X79.998"), "{block}: {out}");
    }
    // In ways, and in inches: 3 inch are 76.2 mm.
    let out = crate::flow::text(
        machine,
        "G0 X60 Y40 Z0 F400\nG91 G1 X20\nG90 G3 X80 Y40 I-20 J0\nM2\n",
    );
    assert_eq!(out.lines().nth(2), Some("G1 X-0.004"), "{out}");
    let out = crate::flow::text(
        machine,
        "G20 G0 X2 Y2 Z0 F40\nG1 X3\nG21 G3 X76.2 Y50.8 I-20 J0\nM2\n",
    );
    assert_eq!(out.lines().nth(2), Some("G1 X2.9999"), "{out}");
    // The feed is that of the arc where no other has been said.
    let out = crate::flow::text(
        machine,
        "G0 X60 Y40 Z0\nG0 X80\nG0 Y50\nG17 G3 X80 Y50 I-20 J0 F250\nM2\n",
    );
    assert!(out.contains("\nG1 X79.998 F250\nG17 G3 "), "{out}");
}
