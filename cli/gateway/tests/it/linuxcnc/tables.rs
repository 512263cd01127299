//! LinuxCNC's own compensation tables on the running control, and a complete session without tables.
//!
//! A part runs uncorrected, with tables, and with live correction. Each residual is computed from a virtual truth with
//! squareness, straightness, pitch (Abbe) and reversal. The session consists of homing, MDI, a program with arcs and a
//! pause, and a probe.

use std::{fmt::Write as _, path::Path, time::Duration};

use serde_json::json;
use volcomp_model::{Machine, Temperatures};
use volcomp_tables::axis_table::{
    AxisNumbers, Facts, Format, TableOptions, WriteOptions, sampled, write,
};
use volcomp_vocabulary::AxisName;

use crate::linuxcnc::{
    PORT, configuration_of, corrected, gateway, offset_residuals, oracle, part,
    peer::{Cycle, LinuxCnc, alone},
    start, wait_corrected,
};

alone!(
    tables:
    the_same_part_uncorrected_with_tables_and_live,
    what_the_motors_do_is_the_program_and_the_correction,
);

/// The truth as a machine file. [`truth`] computes the same errors by hand.
const MACHINE: &str = r#"
name = "truth"
structure = "w b X Y Z t"
[axes.X]
travel = [-10.0, 500.0]
[axes.Y]
travel = [-10.0, 400.0]
[axes.Z]
travel = [-300.0, 10.0]
[errors]
EXX = { mean = { poly = [0.0, 0.03] }, reversal = 3.0 }
EYX = { poly = [0.0, 0.0, 4e-5] }
EBX = { poly = [0.0, 0.08] }
EYY = { poly = [0.0, -0.02] }
EXY = { poly = [0.0, 0.0, -3e-5] }
EZZ = { poly = [0.0, 0.02] }
EC0Y = 25.0
EA0Z = -15.0
"#;

/// Tool error by hand, mm: a chain of small motions from bed to tool with ideal levers. `forward` is the direction of
/// X, 1 or -1.
fn truth([x, y, z]: [f64; 3], forward: f64) -> [f64; 3] {
    let um = 1e-3;
    let urad = 1e-6;
    let pitch = 0.08 * x * urad;
    [
        (0.03 * x + 1.5 * forward) * um - 3e-5 * y * y * um + pitch * z - 25.0 * urad * y,
        4e-5 * x * x * um - 0.02 * y * um + 15.0 * urad * z,
        0.02 * z * um,
    ]
}

/// The part program: through the volume, in both directions of X.
const PART: [&str; 6] = [
    "G1 F11000 X180 Y60 Z-40",
    "G1 X60 Y140 Z-150",
    "G17 G2 X100 Y180 I40 J0",
    "G1 X220 Y90 Z-90",
    "G1 X40 Y40 Z-160",
    "G1 X20 Y20 Z-20",
];

fn run(control: &mut LinuxCnc) -> Vec<Cycle> {
    control.mdi("G21 G90 G0 X20 Y20 Z-20");
    std::thread::sleep(std::time::Duration::from_secs(1));
    control.record(|control| {
        for line in PART {
            control.mdi(line);
        }
    })
}

/// RMS and maximum of the residual at the tool, µm. Cycles at a reversal of X are omitted, because the table and the
/// model may detect a reversal at different times.
fn left(cycles: &[Cycle]) -> [f64; 2] {
    let (mut squares, mut largest, mut count) = (0.0, 0.0_f64, 0.0);
    let mut since_turn = 0;
    let mut direction = 0.0;
    for pair in cycles.windows(3) {
        let (then, now) = (&pair[0], &pair[2]);
        let moved = pair[1].nominal[0] - then.nominal[0];
        if moved == 0.0 || moved.signum() != direction {
            since_turn = 0;
            if moved != 0.0 {
                direction = moved.signum();
            }
        }
        since_turn += 1;
        if since_turn < 200 {
            continue;
        }
        let error = truth(then.nominal, direction);
        let square: f64 =
            (0..3).map(|axis| (now.motor[axis] - then.nominal[axis] + error[axis]).powi(2)).sum();
        squares += square;
        largest = largest.max(square);
        count += 1.0;
    }
    assert!(count > 1000.0, "{count} cycles");
    [(squares / count).sqrt() * 1e3, largest.sqrt() * 1e3]
}

/// Writes the tables as `volcomp export` does, with LinuxCNC's maximum number of lines. Returns the lines for the INI
/// file.
fn tables(dir: &Path, format: Format) -> Vec<String> {
    let machine = Machine::parse(MACHINE, "truth").expect("valid");
    let options = TableOptions {
        step_mm: 2.0,
        // The tables are exact on a line through the middle of the part.
        at: vec![(AxisName::X, 110.0), (AxisName::Y, 90.0), (AxisName::Z, -90.0)],
        ..TableOptions::default()
    };
    let temperatures = Temperatures::default();
    let content = sampled(&machine, &temperatures, &options, format).expect("sampled");
    let options = WriteOptions {
        facts: Facts::of(&machine, options.reference(&machine).expect("there"), String::new()),
        axes: AxisNumbers::of_machine(&machine),
        ..WriteOptions::default()
    };
    let written = write(format, &content, &options).expect("it holds them");
    let mut lines = vec![String::new(); 3];
    for file in written.files {
        let Some(joint) =
            ["X", "Y", "Z"].iter().position(|axis| file.name == format!("{axis}.comp"))
        else {
            continue;
        };
        if joint == 0 {
            assert_eq!(file.text.lines().count(), 256, "as many as LinuxCNC takes");
        }
        std::fs::write(dir.join(&file.name), file.text).expect("writable");
        let kind = u8::from(format == Format::LinuxcncType1);
        write!(lines[joint], "COMP_FILE = {}\nCOMP_FILE_TYPE = {kind}\n", file.name)
            .expect("a string");
    }
    lines
}

/// The INI file without the bridge, with `lines` in the joint sections.
fn with_tables(ini: &str, lines: &[String]) -> String {
    let mut text: String = ini
        .lines()
        .filter(|line| !line.contains("volcomp.tcl"))
        .fold(String::new(), |text, line| text + line + "\n");
    for (joint, lines) in lines.iter().enumerate() {
        let section = format!("[JOINT_{joint}]\n");
        text = text.replace(&section, &format!("{section}{lines}"));
    }
    text
}

/// Largest deviation of the motor offset from the truth at rest, µm, on the line for which the tables were made, in
/// both directions of X.
fn on_the_line(control: &mut LinuxCnc) -> f64 {
    control.mdi("G21 G90 G0 X0 Y90 Z-90");
    let mut worst = 0.0_f64;
    for (x, forward) in [(50.0, 1.0), (333.0, 1.0), (480.0, 1.0), (333.0, -1.0), (51.0, -1.0)] {
        control.mdi(&format!("G0 X{x}"));
        std::thread::sleep(std::time::Duration::from_millis(500));
        // The pin holds the offset added to the joint position. halcmd prints seven digits, too few for the positions
        // themselves.
        let found = control.pin("joint.0.backlash-filt");
        let wanted = -truth([x, 90.0, -90.0], forward)[0];
        worst = worst.max((found - wanted).abs() * 1e3);
    }
    worst
}

fn the_same_part_uncorrected_with_tables_and_live() {
    let dir = tempfile::tempdir().expect("writable");
    let (uncorrected, live) = {
        let mut control = LinuxCnc::start(dir.path(), |ini| ini);
        control.do_it("up");
        let uncorrected = run(&mut control);
        let config = configuration_of(dir.path(), 47_001, MACHINE);
        let program = start(dir.path(), &config);
        program.wait_for("compensating");
        (left(&uncorrected), left(&run(&mut control)))
    };
    let mut rows = vec![("uncorrected", uncorrected)];
    for (name, format) in
        [("COMP_FILE, type 0", Format::Linuxcnc), ("COMP_FILE, type 1", Format::LinuxcncType1)]
    {
        let dir = tempfile::tempdir().expect("writable");
        let lines = tables(dir.path(), format);
        let mut control = LinuxCnc::start(dir.path(), |ini| with_tables(&ini, &lines));
        control.do_it("up");
        let worst = on_the_line(&mut control);
        println!("{name}: on its own line within {worst:.4} um");
        // The file has six decimals of a millimetre, and the errors are linear between its lines.
        assert!(worst < 0.002, "{name}: {worst} um");
        rows.push((name, left(&run(&mut control))));
    }
    rows.push(("live", live));
    for (name, [rms, largest]) in &rows {
        println!(
            "{name:20} rms {rms:8.4} um  largest {largest:8.4} um  {:6.2} % of the uncorrected",
            100.0 * rms / rows[0].1[0]
        );
    }
    // A table over one axis cannot represent errors that depend on another axis, but the gateway can correct them.
    assert!(rows[1].1[0] > 0.3 * rows[0].1[0] && rows[2].1[0] > 0.3 * rows[0].1[0], "{rows:?}");
    assert!(live[0] < 0.05 * uncorrected[0], "{rows:?}");
}

const PROGRAM: &str = "G21 G90 G17 G64
G1 F600 X40 Y20 Z-10
G2 X50 Y30 I10 J0 F600
G3 X40 Y20 I0 J-10
G1 X50 Y40 Z-15
M2
";

fn what_the_motors_do_is_the_program_and_the_correction() {
    let dir = tempfile::tempdir().expect("writable");
    let mut control = LinuxCnc::start(dir.path(), |ini| ini);
    let program = gateway(dir.path(), PORT);
    // The gateway corrects nothing before homing.
    program.watch();
    let state = program.state();
    assert!(state["reasons"].to_string().contains("not referenced"), "{state}");
    control.do_it("up");
    program.wait_for("compensating");
    control.mdi("G21 G90 G0 X20 Y10 Z-5");
    wait_corrected(&mut control, &program);

    let cycles = control.record(|control| control.mdi("G1 F600 X60 Y45 Z-25"));
    corrected("MDI on a diagonal", &cycles);
    let nominal = control.pin("axis.x.pos-cmd");
    assert!((nominal - 60.0).abs() < 1e-9, "the program knows of nothing: {nominal}");

    let file = dir.path().join("part.ngc");
    std::fs::write(&file, PROGRAM).expect("writable");
    let cycles = control.record(|control| {
        control.ask("begin", &json!({ "path": file }));
        std::thread::sleep(Duration::from_millis(1500));
        control.do_it("pause");
        std::thread::sleep(Duration::from_millis(500));
        control.do_it("resume");
        control.do_it("idle");
    });
    corrected("a program with arcs and a pause", &cycles);

    // At ten times the speed the delay is the same number of cycles, with ten times the motion in each cycle.
    control.mdi("G0 X20 Y20 Z-5");
    wait_corrected(&mut control, &program);
    let cycles = control.record(|control| control.mdi("G1 F6000 X300 Y200 Z-100"));
    let found = offset_residuals(&cycles);
    let [median, most] = [50, 99].map(|of| part(&found, of));
    println!("at 100 mm/s: residual {median:.2} nm median, {most:.1} nm p99");
    assert!(median < 40.0 && most < 200.0, "{median} nm, {most} nm");

    // The control's probe position contains the offset, which the bridge stores with it.
    control.mdi("G0 X50 Y30 Z-10");
    wait_corrected(&mut control, &program);
    control.ask("begin_mdi", &json!({ "text": "G38.3 X120 F300" }));
    control.wait("axis.x.pos-cmd", |x| x > 55.0);
    control.touch(true);
    control.do_it("idle");
    control.touch(false);
    let probed = control.ask("probed", &json!({}));
    assert_eq!(probed[0], true);
    let probed = probed[1].as_f64().expect("a number");
    let shown = "volcomp-probed-offset-x";
    let offset = control.pin(shown);
    let wanted = oracle([probed, 30.0, -10.0])[0];
    // At 5 mm/s the bridge samples the contact at intervals.
    assert!((offset - wanted).abs() < 2e-5, "{offset} mm, {wanted} mm");

    // In a probing move away from a contact, the position at which the contact opens counts.
    control.touch(true);
    control.ask("begin_mdi", &json!({ "text": "G38.5 X10 F300" }));
    control.wait("axis.x.pos-cmd", |x| x < 45.0);
    control.touch(false);
    control.do_it("idle");
    let probed = control.ask("probed", &json!({}));
    assert_eq!(probed[0], true);
    let probed = probed[1].as_f64().expect("a number");
    let offset = control.pin(shown);
    let wanted = oracle([probed, 30.0, -10.0])[0];
    assert!((offset - wanted).abs() < 2e-5, "{offset} mm, {wanted} mm");
    let said = control.ask("said", &json!({}));
    assert_eq!(said, json!([]), "LinuxCNC complains");
}
