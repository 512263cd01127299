//! `volcomp report`: the written file, the verdict, and rejected calls.

use std::fs;

use serde_json::Value;

use crate::{Folder, contains, float, json, list, refuse_each, refused, refuses, text, volcomp};

const CALIBRATION: &str = "examples/calibration/calibration.toml";

fn report(arguments: &[&str]) -> (Value, String) {
    let folder = Folder::new();
    let path = folder.path().join("report.html");
    let output = path.display().to_string();
    let document = json(&[&["report"], arguments, &["-o", &output]].concat());
    (document, fs::read_to_string(&path).expect("the report"))
}

#[test]
fn a_calibration_makes_a_report() {
    let (document, page) = report(&[
        CALIBRATION,
        "--serial",
        "4711 </style>",
        "--date",
        "2026-02-03",
        "--tolerance",
        "E=1,EC0Y=1000,R=1",
    ]);
    assert_eq!(document["verdict"], "fail");
    let outcomes: Vec<&Value> = list(&document["checks"]).iter().map(|c| &c["outcome"]).collect();
    assert_eq!(outcomes[0], "fail");
    assert!(outcomes.iter().any(|outcome| *outcome == "pass"));
    assert!(page.contains("4711 &lt;/style&gt;") && page.contains("2026-02-03"));
    assert!(page.contains("exx.csv") && page.ends_with("</html>\n"));
    assert!(float(&document["before"]["max_um"]) > 0.0);
    assert_eq!(document["after"], Value::Null);
}

#[test]
fn the_first_page_states_customer_certificate_and_temperatures() {
    let (document, page) = report(&[
        CALIBRATION,
        "--customer",
        "Example & Co.",
        "--certificate",
        "K-17",
        "--air-degc",
        "20.5",
        "--material-degc",
        "22,22.5",
    ]);
    for part in ["Example &amp; Co.", "K-17", "20.50 °C", "22.00 … 22.50 °C"] {
        contains(&page, part);
    }
    contains(&document["warnings"].to_string(), "stated as 22.00 to 22.50 °C");
    let folder = Folder::new();
    let output = folder.file("report.html");
    for (option, value) in [
        ("--air-degc", "warm"),
        ("--material-degc", "22,21"),
        ("--air-degc", "1,2,3"),
        ("--air-degc", "900"),
    ] {
        let call = ["report", CALIBRATION, option, value, "-o", &output];
        let message = refused(&call);
        contains(&message, &format!("{option}: found `{value}`, expected one temperature"));
    }
}

#[test]
fn the_same_call_gives_the_same_bytes() {
    let call = [CALIBRATION, "--trials", "3"];
    assert_eq!(report(&call).1, report(&call).1);
}

/// With the truth on which its files were measured, the report of the example shows a smaller error after the correction.
#[test]
fn a_truth_shows_what_a_compensation_leaves() {
    let (document, page) = report(&[CALIBRATION, "--truth", "examples/calibration/truth.toml"]);
    let of = |state: &str| float(&document[state]["form_max_um"]);
    assert!(of("after") < of("before"), "{document}");
    assert!(page.contains("what the compensation by this model leaves of the stated truth"));
    // V is what the correction leaves, and the test quantities are those of the files. The check of V names its state.
    let truth = ["--truth", "examples/calibration/truth.toml"];
    let judged = [&[CALIBRATION][..], &truth, &["--tolerance", "V=99,E=99"]].concat();
    for check in list(&report(&judged).0["checks"]) {
        assert_eq!(check["symbol"] == "V", check["of"] == "what the correction leaves", "{check}");
    }
    // A model compared with itself leaves only the terms that the correction neglects.
    let (document, _) = report(&["examples/gantry.toml", "--truth", "examples/gantry.toml"]);
    let after = float(&document["after"]["max_um"]);
    assert!(after < 0.01, "{document}");
}

#[test]
fn observations_and_machine_files_make_reports() {
    let (_, page) = report(&["examples/identification/observations.toml"]);
    assert!(page.contains("Identifiability") && page.contains("Null space"));
    let (document, page) = report(&["examples/gantry.toml", "--before", "examples/gantry.toml"]);
    assert!(page.contains("nothing was measured here"));
    assert_eq!(document["before"], document["after"]);
    assert!(page.contains("gantry-8000"));
}

#[test]
fn what_is_wrong_is_named() {
    let folder = Folder::new();
    let output = folder.file("report.html");
    let calls = "
report $of --tolerance Q=1 -o $out => --tolerance: symbol: found `Q`
report missing.toml -o $out => missing.toml
report examples/gantry.toml --trials 5 -o $out => --trials: examples/gantry.toml is a machine file
report $of --truth examples/gantry.toml -o $out => examples/gantry.toml:
report $of --truth examples/gantry.toml -o $out => examples/calibration/calibration.toml
report $of -o $of => which this report reads
";
    refuse_each(calls, &[("$of", CALIBRATION), ("$out", &output)]);
    assert!(!fs::exists(&output).expect("a folder"), "nothing half-written");
}

#[test]
fn people_read_the_verdict() {
    let folder = Folder::new();
    let output = folder.file("report.html");
    let said = text(&format!("report {CALIBRATION} -o {output} --tolerance EC0Y=1000"));
    assert!(
        said.starts_with(
            "all stated tolerances are met; 15 errors were not measured and count as 0\n  EC0Y: "
        ),
        "{said}"
    );
    contains(&said, "wrote ");
}

/// A model with wrong rotary axes fails. At one rotary pose the errors of the rotary axes are a rigid motion, which the
/// alignment removes. Over all axes no alignment removes these errors.
#[test]
fn wrong_rotary_axes_do_not_pass() {
    let folder = Folder::new();
    let text = "structure = \"w C' A' b X Y Z t\"\n[axes]\nX.travel = [-300.0, 300.0]\nY.travel = [-200.0, 200.0]\nZ.travel = [-150.0, 150.0]\nA.travel = [-110.0, 30.0]\nC.travel = [-360.0, 360.0]\n[errors]\nEX0C = 200.0\nEY0A = 150.0\nEZ0A = 80.0\nEA0C = 300.0\nEXX = { poly = [0.0, 0.001] }\n";
    let machine = folder.write("rotary.toml", text);
    let (document, _) = report(&[&machine, "--tolerance", "V=5"]);
    assert_eq!(document["verdict"], "fail", "{document}");
    let of = &document["volumetric"];
    assert!(of["position_um"].as_f64() > Some(300.0), "{document}");
    assert!(of["tilt_urad"].as_f64() > Some(200.0), "{document}");
    for axis in ["X", "Y", "Z", "A", "C"] {
        assert!(of["worst_at"][axis].is_number(), "{document}");
    }
    // Equals the value of `map` with any grid to the last digit.
    let map = json(&["map", "-m", &machine, "--grid", "3x3x3"]);
    assert_eq!(map["all_axes"]["form_max_um"], of["position_um"]);
    assert_eq!(map["all_axes"]["tilt_max_urad"], of["tilt_urad"]);
}

/// The volumetric error of the report equals that of `map`.
#[test]
fn the_volume_of_a_gantry_has_one_figure() {
    let (document, _) = report(&["examples/gantry.toml"]);
    let map = json(&["map", "-m", "examples/gantry.toml", "--grid", "5x5x5"]);
    assert_eq!(map["all_axes"]["form_max_um"], document["volumetric"]["position_um"]);
}

/// The expanded uncertainty in the verdict is twice the largest standard uncertainty of the same machine's map.
#[test]
fn the_uncertainty_of_the_volume_is_one_figure() {
    let folder = Folder::new();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (machine, calibration) = (path("machine.toml"), path("calibration.toml"));
    let text = "structure = \"w C' b X Y Z t\"\n[axes]\nX.travel = [-200, 200]\nY.travel = [-200, 200]\nZ.travel = [-200, 200]\nC.travel = [-180, 180]\n[errors]\nEX0C = 3\n";
    fs::write(&machine, text).expect("written");
    let text = "machine = \"machine.toml\"\n[[location]]\nerror = \"EX0C\"\nvalue_um = 3\nuncertainty_um = 5\n";
    fs::write(&calibration, text).expect("written");
    let drawn = ["--trials", "5", "--seed", "3"];
    let (document, _) =
        report(&[&[calibration.as_str(), "--tolerance", "V=5"][..], &drawn].concat());
    let expanded_um = document["checks"][0]["uncertainty"].as_f64();
    let map = ["map", "-m", &machine, "--grid", "2x2x2"];
    let map = json(&[&map[..], &["--uncertainty", &calibration], &drawn].concat());
    let standard_um = map["all_axes"]["uncertainty"]["largest_um"].as_f64();
    let [expanded_um, standard_um] =
        [expanded_um, standard_um].map(|um| um.expect("an uncertainty"));
    assert!(
        standard_um > 1.0 && (expanded_um - 2.0 * standard_um).abs() <= 1e-9 * expanded_um,
        "{expanded_um} {standard_um}"
    );
}

#[test]
fn the_exit_status_is_that_of_the_verdict() {
    let folder = Folder::new();
    let output = folder.file("report.html");
    for (limit, status) in [("1000", 0), ("0.001", 3)] {
        let tolerance = format!("V={limit}");
        let call = format!("report {CALIBRATION} -o {output} --tolerance {tolerance}");
        assert_eq!(volcomp(&call).status.code(), Some(status), "{limit}");
        assert!(fs::exists(&output).expect("a folder"));
    }
    for ending in ["pdf", "txt", "svg"] {
        let output = folder.path().join("report").with_extension(ending);
        let output = output.display().to_string();
        refuses(&["report", "examples/gantry.toml", "-o", &output], "--print-to-pdf");
    }
}

/// A machine without known errors gets the verdict `undecided`. With some known errors the verdict covers only these
/// errors.
#[test]
fn what_was_not_measured_is_not_met() {
    let folder = Folder::new();
    let machine = folder.path().join("bare.toml");
    let axes = "structure = \"w X' b Y Z t\"\n[axes]\nX.travel = [0.0, 400.0]\nY.travel = [0.0, 400.0]\nZ.travel = [-300.0, 0.0]\n";
    fs::write(&machine, axes).expect("written");
    let bare = machine.display().to_string();
    let (document, _) = report(&[&bare, "--tolerance", "V=10"]);
    assert_eq!(document["verdict"], "undecided", "{document}");
    assert_eq!(document["checks"][0]["value"], Value::Null);
    fs::write(&machine, format!("{axes}[errors]\nEXX = {{ poly = [0.0, 0.001] }}\n"))
        .expect("written");
    let (document, _) = report(&[&bare, "--tolerance", "V=10"]);
    assert_eq!(document["verdict"], "pass", "{document}");
    let (document, page) = report(&[CALIBRATION, "--tolerance", "V=1000"]);
    assert_eq!(document["verdict"], "pass", "{document}");
    assert_eq!(document["checks"][0]["of"], "the measured errors alone");
    assert!(page.contains("of the measured errors alone"));
}

/// An error that the observations do not determine may have any value, so no tolerance is met. Here a rotary table
/// never turned, so its axis may be anywhere.
#[test]
fn what_observations_leave_open_is_not_met() {
    let folder = Folder::new();
    let write = |name: &str, text: &str| {
        fs::write(folder.path().join(name), text).expect("written");
    };
    write(
        "machine.toml",
        "structure = \"w C' b X Y Z t\"\n[axes]\nX.travel = [0.0, 400.0]\nY.travel = [0.0, 400.0]\nZ.travel = [-300.0, 0.0]\nC.travel = [-360.0, 360.0]\n",
    );
    let row = |(x, y, z): (u32, u32, u32)| {
        let [x, y, z] = [200.0 * f64::from(x), 200.0 * f64::from(y), -150.0 * f64::from(z)];
        format!("{x},{y},{z},0,{:.6},{y},{z}\n", x + 2e-5 * x)
    };
    let places = (0..27).map(|i| (i % 3, i / 3 % 3, i / 9));
    let rows = places.map(row).collect::<Vec<_>>().concat();
    let rows = format!("X,Y,Z,C,x,y,z\n{rows}");
    write("points.csv", &rows);
    write(
        "observations.toml",
        "machine = \"machine.toml\"\nfolds = 0\nunknown = [\"EX0C\", \"EB0C\", { error = \"EXX\", legendre = 1 }]\n[[observation]]\nkind = \"points\"\nfile = \"points.csv\"\n",
    );
    let observations = folder.path().join("observations.toml").display().to_string();
    let call = [&observations, "--tolerance", "EX0C=5,EB0C=5,V=50"];
    let (document, page) = report(&call);
    let checks = list(&document["checks"]);
    for check in &checks[..2] {
        assert_eq!(check["value"], Value::Null, "{check}");
        assert_eq!(check["outcome"], "not_evaluated", "{check}");
    }
    assert_eq!(checks[2]["of"], "errors that the measurements do not confirm");
    assert_eq!(checks[2]["outcome"], "undecided");
    // A wave that no unknown describes makes the fit inconsistent with the readings.
    let wave = |x: f64| x + 0.06 * (x / 48.0).sin();
    let rows = rows.lines().skip(1).map(|row| {
        let mut cells: Vec<String> = row.split(',').map(str::to_owned).collect();
        cells[4] = format!("{:.6}", wave(cells[0].parse().expect("a number")));
        cells.join(",") + "\n"
    });
    let rows = rows.collect::<Vec<_>>().concat();
    write("points.csv", &format!("X,Y,Z,C,x,y,z\n{rows}"));
    let (document, _) = report(&[&observations, "--tolerance", "EXX=500,V=500"]);
    for check in list(&document["checks"]) {
        assert_eq!(check["of"], "errors that the measurements do not confirm");
        assert_eq!(check["outcome"], "undecided", "{check}");
    }
    assert!(page.contains("not determined by the observations, taken as 0: EX0C, EB0C"));
}

/// A limit for lengths does not apply to angles. A symbol without an error or axis is rejected if lengths and angles
/// are tested. It applies to tests without a more specific limit.
#[test]
fn a_limit_is_of_one_unit() {
    const BOTH: &str = "examples/from-files/five-axis/calibration.toml";
    let folder = Folder::new();
    let output = folder.file("report.html");
    let message = refused(&["report", BOTH, "-o", &output, "--tolerance", "A=30"]);
    contains(&message, "--tolerance: A: found 30 for EXX (µm) and for ECC (µrad)");
    contains(&message, "C.A=… or ECC.A=…");
    assert!(!folder.path().join("report.html").exists());
    let (document, _) =
        report(&[BOTH, "--tolerance", "A=1000,A.A=2000,C.A=0.001,EXX.A=0.001,B.A=5"]);
    let mut found: Vec<(String, f64, String, String)> = (document["checks"].as_array())
        .expect("checks")
        .iter()
        .map(|check| {
            let text = |key: &str| check[key].as_str().expect("a text").to_owned();
            let of = text("of");
            let error = of.split(',').next().unwrap_or_default().to_owned();
            let unit = text("unit");
            (error, float(&check["limit"]), unit, text("outcome"))
        })
        .collect();
    found.sort_by(|a, b| a.0.cmp(&b.0));
    // The file `ezz.pos` holds means over the runs, so A cannot be evaluated.
    let row = |error: &str, limit, unit: &str, outcome: &str| {
        (error.to_owned(), limit, unit.to_owned(), outcome.to_owned())
    };
    assert_eq!(
        found,
        [
            row("", 5.0, "µrad", "not_evaluated"),
            row("EAA", 2000.0, "µrad", "pass"),
            row("ECC", 0.001, "µrad", "fail"),
            row("EXX", 0.001, "µm", "fail"),
            row("EYY", 1000.0, "µm", "pass"),
            row("EZZ", 1000.0, "µm", "not_evaluated"),
        ]
    );
}

#[test]
fn a_report_that_is_replaced_is_told() {
    let folder = Folder::new();
    let output = folder.file("report.html");
    let told = |options: &[&str]| {
        let call = ["report", "examples/first.toml", "-o", &output];
        let output = volcomp(&[&call[..], options].concat());
        assert_eq!(output.status.code(), Some(0));
        String::from_utf8_lossy(&output.stderr).contains("replaced the file that was there")
    };
    assert_eq!([told(&[]), told(&[]), told(&["--serial", "7"])], [false, false, true]);
}

/// Thermal terms change the volumetric error, so a value below its limit is `undecided`.
#[test]
fn thermal_terms_leave_the_volumetric_error_undecided() {
    for (limit, outcome) in [("V=1000", "undecided"), ("V=1", "fail")] {
        let (document, page) = report(&["examples/gantry.toml", "--tolerance", limit]);
        let check = &document["checks"][0];
        assert_eq!(check["outcome"], outcome, "{document}");
        assert_eq!(check["of"], "the machine at the reference temperature alone");
        assert!(page.contains("hold at 20 °C: thermal terms of"));
    }
}

/// The verdict covers a part of the machine if thermal terms, of the truth or of the model, are omitted, or if curves
/// cover only a part of the travel.
#[test]
fn a_volumetric_error_of_a_part_of_the_machine_is_told() {
    const AXES: &str = "structure = \"w b X Y Z t\"\n[axes]\nX.travel = [0.0, 600.0]\nY.travel = [0.0, 400.0]\nZ.travel = [-500.0, 0.0]\n[errors]\n";
    let folder = Folder::new();
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name).display().to_string();
        std::fs::write(&path, format!("{AXES}{text}")).expect("written");
        path
    };
    let model = write("model.toml", "EXX = { poly = [0.0, 0.02] }\n");
    let truth = write(
        "truth.toml",
        "EXX = { poly = [0.0, 0.02] }\n[thermal]\nreference = 20.0\n[[thermal.expansion]]\nerror = \"EXX\"\nsensor = \"scale\"\num_per_m_k = 11.5\n",
    );
    let (document, page) = report(&[&model, "--truth", &truth, "--tolerance", "V=5"]);
    assert_eq!(document["checks"][0]["outcome"], "undecided", "{document}");
    assert!(page.contains("thermal terms of scale are left out"));
    for (text, told) in [
        (
            "EXX = { poly = [0.0, 0.02], domain = [200.0, 300.0] }\n",
            "EXX is known on 17 % of the travel of X",
        ),
        (
            "EXX = { poly = [0.0, 0.02] }\nEZY = { grid = { axes = [\"Y\", \"Z\"], nodes = [[0, 200, 400], [-300, -200]], values = [[0, 0], [-10, 10], [0, 0]] } }\n",
            "EZY is known on 20 % of the travel of Z",
        ),
    ] {
        let part = write("part.toml", text);
        for call in [&[&part[..]][..], &[&model, "--truth", &part]] {
            let (document, page) = report(&[call, &["--tolerance", "V=500"]].concat());
            assert_eq!(document["checks"][0]["of"], "the measured errors alone");
            assert!(call.len() > 1 || page.contains(told), "{page}");
        }
        let error = &told[..3];
        let limit = format!("{error}=500");
        let (document, _) = report(&[&part, "--tolerance", &limit]);
        assert_eq!(document["checks"][0]["of"], "the part of the travel that its curve covers");
    }
    let bare = write("bare.toml", "");
    let (document, _) = report(&[&model, "--truth", &bare, "--tolerance", "V=500"]);
    assert_eq!(document["checks"][0]["outcome"], "not_evaluated", "{document}");
}
