//! A complete session: homing, MDI, a program with arcs and a pause, a probe.

use std::time::Duration;

use serde_json::json;

use super::{
    PORT, alone::alone, corrected, gateway, offset_residuals, oracle, part, peer::LinuxCnc,
    wait_corrected,
};

alone!(whole: what_the_motors_do_is_the_program_and_the_correction);

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
