//! The page and its print in a headless Chromium without network, driven by Playwright: no requests, no script errors, nothing wider than
//! the screen.

use std::{fs, path::Path, process::Command};

use volcomp_kinematics::{Form, State as Pose, volumetric_error};
use volcomp_model::Temperatures;
use volcomp_report::{Report, State, checks, html, tolerances, volume};
use volcomp_test_support::{peers, root};

use crate::{
    Shop,
    data::{error_of, field},
};

pub(crate) fn whole() -> Report {
    let shop = Shop::new();
    let (_, calibration) = shop.calibrated();
    let mut report = shop.report();
    let machine = &calibration.machine;
    let none = Temperatures::new();
    let errors = |pose: &Pose| {
        let found = volumetric_error(machine.chain(), &machine.source(&none), pose, Form::Exact);
        let (p, r) = (found.position_mm, found.rotation_rad);
        [p.x, p.y, p.z, r.x, r.y, r.z]
    };
    let less = |pose: &Pose| errors(pose).map(|x| 0.2 * x);
    report.volume = volume(
        [machine; 2],
        &[],
        (State::Truth, &[field(machine, &errors)], error_of(machine, &errors)),
        Some((State::TruthCorrected, &[field(machine, &less)], error_of(machine, &less))),
    )
    .expect("three axes");
    report.checks = checks(&report, &tolerances("A=100,B=1,V=30").expect("three"));
    report
}

#[test]
fn a_browser_without_a_network_shows_the_page() {
    if !Path::new("/usr/bin/chromium").exists() {
        peers::not_run("Chromium");
        return;
    }
    let Some(python) = peers::python() else {
        return;
    };
    let pictures = root().join("target/report-pictures");
    fs::create_dir_all(&pictures).expect("a folder");
    let report = whole();
    let page = pictures.join("report.html");
    fs::write(&page, html(&report)).expect("written");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/browser.py");
    let output = Command::new(&python)
        .arg(script)
        .arg(&page)
        .arg(&pictures)
        .arg("report")
        .output()
        .expect("Python");
    let said = String::from_utf8_lossy(&output.stdout);
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && said.trim() == "done", "{said}: {message}");
}
