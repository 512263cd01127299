//! The page of a report, as text and in a browser.
//!
//! No text of a file can inject markup. A headless Chromium without network, driven by Playwright, shows and prints the
//! page: no requests, no script errors, nothing wider than the screen.

use std::{collections::BTreeSet, fs, path::Path, process::Command};

use volcomp_kinematics::{Form, State as Pose, volumetric_error};
use volcomp_model::Temperatures;
use volcomp_report::{Report, State, Stated, checks, html, tolerances, volume};
use volcomp_test_support::{peers, root};

use crate::{
    Shop, calibrated, csv,
    data::{error_of, field},
};

#[test]
fn the_same_input_gives_the_same_bytes() {
    let shop = Shop::new();
    let [first, second] = [shop.report(), shop.report()].map(|report| html(&report));
    assert_eq!(first, second);
    assert!(first.len() < 5_500_000, "{}", first.len());
}

#[test]
fn what_nobody_states_is_said_to_be_not_stated() {
    let report = Shop::new().report();
    let page = html(&report);
    assert!(page.matches("not stated").count() >= 6);
    assert!(page.contains("No tolerance stated."));
}

#[test]
fn texts_of_files_are_never_markup() {
    let shop = Shop::new();
    let hostile =
        "<script>document.title='hit'</script>\"><style>*{display:none}</style></style></main>";
    // A file name cannot contain a slash.
    let name = "<script>alert('x')<img src=x onerror=alert(1)>&.csv";
    shop.write(name, &csv(9, 100.0, 5, |x, _| 0.02 * x));
    shop.write(
        "calibration.toml",
        &format!(
            "machine = \"machine.toml\"\n[[measurement]]\nerror = \"EXX\"\nfile = \"{name}\"\n"
        ),
    );
    let (file, calibration) = calibrated(&shop.folder.path().join("calibration.toml"));
    let text = || Some(hostile.to_owned());
    let stated = Stated {
        machine: text(),
        serial: text(),
        date: text(),
        operator: text(),
        instrument: text(),
        customer: text(),
        certificate: text(),
        ..Stated::default()
    };
    let report = Report::of_calibration(hostile, &file, &calibration, &stated);
    let page = html(&report);
    assert_eq!(page.matches("<script").count(), 1, "its own");
    assert_eq!(page.matches("<style").count(), 1);
    assert_eq!(page.matches("</style>").count(), 1);
    assert_eq!(page.matches("</main>").count(), 1);
    assert!(!page.contains("<img"));
    assert!(page.contains("&lt;script&gt;alert(&#39;x&#39;)&lt;img"));
}

/// With ten thousand targets the page has fewer than 200 rows and 1.5 MB, and the extreme values are plotted.
#[test]
fn many_targets_are_thinned() {
    let shop = Shop::new();
    let spike = |x: f64, _| {
        if (x - 333.36).abs() < 1e-9 { 60.0 } else { 0.01 * x }
    };
    shop.write("exx.csv", &csv(10_000, 0.08, 2, spike));
    shop.write("calibration.toml", "machine = \"machine.toml\"\n[[measurement]]\nerror = \"EXX\"\nfile = \"exx.csv\"\ncurve = { poly = { order = 3 } }\n");
    let page = html(&shop.report());
    assert!(page.len() < 1_500_000, "{}", page.len());
    let rows = page.matches("<tr>").count();
    assert!(rows < 200, "{rows}");
    assert!(page.contains("10000 targets in all"));
    assert!(page.contains(">333.360<"), "the target of the largest mean is in the table");
}

/// In the plot and in the table B is the absolute value of the largest reversal value, whichever direction is higher.
#[test]
fn b_beside_the_plot_has_no_sign() {
    let shop = Shop::new();
    shop.write("exx.csv", &csv(9, 100.0, 5, |_, back| if back { 6.0 } else { 2.0 }));
    let report = shop.report();
    let result = &report.positioning[0].result;
    assert!(result.mean_b.is_some_and(|mean| mean < -3.0), "{result:?}");
    let page = html(&report);
    let b = result.b.expect("both directions");
    assert!(page.contains(&format!("B {b:.1}")), "B {b:.1}");
    assert!(!page.contains("B −"));
}

#[test]
fn nothing_infinite_stands_in_the_page() {
    let page = html(&Shop::new().report());
    let pictures =
        page.split("<svg").skip(1).map(|rest| rest.split("</svg>").next().unwrap_or_default());
    for picture in pictures {
        assert!(!picture.contains("NaN") && !picture.contains("inf"), "{picture}");
    }
}

#[test]
fn the_page_asks_for_nothing_outside_of_itself() {
    let page = html(&Shop::new().report());
    for outside in ["http://", "https://", "src=", "url(", "@import", "<link"] {
        let found = page.matches(outside).count();
        // The namespace name in the script is no request.
        let own = usize::from(outside == "http://");
        assert_eq!(found, own, "{outside}");
    }
}

/// The first page states the customer and the figures of the report, with a line for the signature, before any section.
#[test]
fn the_first_page_is_a_certificate() {
    let shop = Shop::new();
    let (file, calibration) = shop.calibrated();
    let stated = Stated {
        customer: Some("Example & Co.".to_owned()),
        certificate: Some("K-2026-17".to_owned()),
        air_degc: Some([20.1, 20.4]),
        material_degc: Some([21.5, 22.25]),
        ..Stated::default()
    };
    let report = Report::of_calibration("c.toml", &file, &calibration, &stated);
    let page = html(&report);
    let (first, _) = page.split_once("<section").expect("sections");
    let result = &report.positioning[0].result;
    let a = result.a.expect("two runs");
    for part in [
        "<dt>Customer</dt><dd>Example &amp; Co.</dd>",
        "<dt>Certificate number</dt><dd>K-2026-17</dd>",
        "20.10 … 20.40 °C",
        "21.50 … 22.25 °C",
        "No tolerance stated.",
        "EXX, positioning (ISO 230-2:2014)",
        &format!("A {a:.2} µm, R "),
        "squareness of X and Y",
        "12.00 µrad",
        "17, which count as 0",
        "Place and date",
        "Signature",
    ] {
        assert!(first.contains(part), "{part}: {first}");
    }
    let warned =
        |report: &Report, part: &str| report.warnings.iter().any(|of| of.text.contains(part));
    assert!(
        warned(&report, "stated as 21.50 to 22.25 °C, farther than 1 K from 20 °C"),
        "{:?}",
        report.warnings
    );
    assert!(!warned(&report, "no material temperature"));
    // Without these statements the page has no empty lines for them, and the files are named.
    let plain = shop.report();
    assert!(warned(&plain, "exx.csv states no material temperature"), "{:?}", plain.warnings);
    let page = html(&plain);
    assert!(!page.contains("Customer") && !page.contains("Certificate number"));
}

/// Texts between the tags of a page, without styles and scripts.
fn between_tags(page: &str) -> Vec<String> {
    let mut rest = page;
    let mut found = Vec::new();
    while let Some((text, after)) = rest.split_once('<') {
        found.push(text.split_whitespace().collect::<Vec<_>>().join(" "));
        let unseen = ["style", "script"].into_iter().find(|tag| after.starts_with(tag));
        let end = unseen.map_or_else(|| ">".to_owned(), |tag| format!("</{tag}>"));
        rest = after.split_once(&end).map_or("", |(_, rest)| rest);
    }
    found.push(rest.trim().to_owned());
    found
}

/// Snapshot of each distinct text of a page, without the numbers, which change with the model.
#[test]
fn words_of_a_report() {
    let page = html(&whole());
    let words = |text: &String| -> String {
        let keep =
            |word: &&str| !word.starts_with(|c: char| c.is_ascii_digit() || "-±−".contains(c));
        text.split(' ').filter(keep).collect::<Vec<_>>().join(" ")
    };
    // Texts with file paths differ between computers.
    let texts = between_tags(&page);
    let texts: BTreeSet<String> = (texts.iter())
        .filter(|text| !text.contains('/'))
        .map(words)
        .filter(|text| text.contains(' '))
        .collect();
    insta::assert_snapshot!(texts.into_iter().collect::<Vec<_>>().join("\n"));
}

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
