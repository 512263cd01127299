//! The volumetric map and its uncertainty.

use std::{fs, path::Path, process::Command};

use serde_json::Value;

use crate::{Folder, contains, float, json, notes, refuses, root, text};

const SHOP: &str = "cli/volcomp/demo/shop.toml";

/// Runs a map with uncertainty on `threads` threads. Returns the document and the written file.
fn uncertain(folder: &Path, threads: &str, file: &str, seed: &str) -> (Value, String) {
    let calibration = folder.join("calibration.toml");
    let map = folder.join(file);
    let output = Command::new(env!("CARGO_BIN_EXE_volcomp"))
        .env("RAYON_NUM_THREADS", threads)
        .current_dir(root())
        .args(["--json", "map", "--grid", "5x4x3", "--trials", "12", "--seed", seed, "-m"])
        .arg(folder.join("machine.toml"))
        .arg("--uncertainty")
        .arg(calibration)
        .arg("-o")
        .arg(&map)
        .output()
        .expect("started");
    assert!(output.status.success(), "{output:?}");
    let document = serde_json::from_slice(&output.stdout).expect("a document");
    (document, fs::read_to_string(map).expect("written"))
}

#[test]
fn the_uncertainty_is_the_same_on_any_number_of_cores() {
    let folder = Folder::new();
    let path = folder.path();
    json(&["simulate", SHOP, "-o", path.to_str().expect("UTF-8")]);
    let (answer, csv) = uncertain(path, "1", "map.csv", "3");
    let (again, same) = uncertain(path, "2", "map.csv", "3");
    assert_eq!((&answer, &csv), (&again, &same));
    assert_ne!(uncertain(path, "2", "map.csv", "4").1, csv);
    assert_eq!(answer["uncertainty"]["trials"], 12);
    // The readings have noise of 1 µm and five runs in each direction. Slopes and squareness are computed from the same
    // lines.
    let largest = float(&answer["uncertainty"]["largest_um"]);
    assert!((0.3..5.0).contains(&largest), "{largest}");
    let mut lines = csv.lines();
    assert_eq!(
        lines.next(),
        Some(
            "X_mm,Y_mm,Z_mm,error_x_um,error_y_um,error_z_um,error_a_urad,error_b_urad,error_c_urad,uncertainty_x_um,uncertainty_y_um,uncertainty_z_um,uncertainty_a_urad,uncertainty_b_urad,uncertainty_c_urad"
        )
    );
    let rows: Vec<Vec<f64>> =
        lines.map(|line| line.split(',').map(|n| n.parse().expect("a number")).collect()).collect();
    assert_eq!(rows.len(), 60);
    // At the reference all positioning curves are zero by definition.
    assert!(rows[0][9..12].iter().all(|u| *u < 1.0), "{:?}", rows[0]);
    let (_, vti) = uncertain(path, "2", "map.vti", "3");
    assert_eq!(vti.matches("NumberOfComponents=\"3\"").count(), 4);
    assert_eq!(vti.lines().count(), 6 + 4 * 60 + 3 * 2 + 5);
}

#[test]
fn an_uncertainty_of_another_machine_is_refused() {
    let folder = Folder::new();
    let path = folder.path().to_str().expect("UTF-8");
    json(&["simulate", SHOP, "-o", path]);
    let calibration = folder.path().join("calibration.toml");
    let calibration = calibration.to_str().expect("UTF-8");
    let map = ["map", "-m", "examples/five-axis.toml", "--grid", "2x2x2"];
    refuses(
        &[&map[..], &["--uncertainty", calibration]].concat(),
        "found the structure `w X' b Y Z t`",
    );
    refuses(&[&map[..], &["--trials", "5"]].concat(), "--uncertainty");
}

/// A map of a machine without linear axes is rejected with the reason that its grid would be one node.
#[test]
fn a_machine_without_linear_axes_has_no_map() {
    let folder = Folder::new();
    let text = "structure = \"w C' b t\"\n[axes]\nC.travel = [0, 360]\n[errors]\nECC = 5.0\n";
    let machine = folder.write("table.toml", text);
    refuses(
        &["map", "-m", &machine, "--grid", "5x5x5"],
        "structure `w C' b t`, expected one of the axes X, Y and Z for a map",
    );
}

/// With a table turned by `--at`, map and diagonals agree with `error` at the same positions.
#[test]
fn rotary_axes_stand_where_at_says() {
    const MACHINE: &str = "examples/trunnion.toml";
    let at = ["--at", "A=-40,C=75"];
    let error = |place: &str| {
        let at = format!("{place},A=-40,C=75");
        let found = json(&["error", "-m", MACHINE, "--at", &at]);
        let number = |k: usize| float(&found["position_um"][k]);
        [number(0), number(1), number(2)]
    };
    let map = json(&[&["map", "-m", MACHINE, "--grid", "1x1x1", "--exact"][..], &at].concat());
    let middle = error("X=300,Y=250,Z=-200");
    for (k, expected) in middle.iter().enumerate() {
        let found = float(&map["position_um"][k]);
        assert!((found - expected).abs() < 1e-6, "{found} {expected}");
    }
    assert_eq!(map["at"]["C"], 75.0);
    assert_ne!(
        map["largest_um"],
        json(&["map", "-m", MACHINE, "--grid", "1x1x1", "--exact"])["largest_um"]
    );

    let diagonals = json(&[&["diagonals", "-m", MACHINE, "--points", "2"][..], &at].concat());
    let found = float(&diagonals["PPP"]["deviation_um"][1]);
    let (low, high) = (error("X=0,Y=0,Z=-400"), error("X=600,Y=500,Z=0"));
    // The diagonal in workpiece axes, which rotate with the table (C on A).
    let ((sin_a, cos_a), (sin_c, cos_c)) =
        ((-40.0_f64).to_radians().sin_cos(), 75.0_f64.to_radians().sin_cos());
    let [x, y, z] = [600.0, 500.0 * cos_a - 400.0 * sin_a, 500.0 * sin_a + 400.0 * cos_a];
    let way = [x * cos_c - y * sin_c, x * sin_c + y * cos_c, z];
    let length = way.iter().map(|w| w * w).sum::<f64>().sqrt();
    let along = |error: [f64; 3]| error.iter().zip(&way).map(|(e, w)| e * w).sum::<f64>() / length;
    let expected = along(high) - along(low);
    assert!((found - expected).abs() < 1e-3, "{found} {expected}");

    refuses(
        &["map", "-m", MACHINE, "--grid", "2x2x2", "--at", "X=5"],
        "--at: found X, which goes over its travel here",
    );
    for call in [&["map", "-m", MACHINE, "--grid", "1x1x1"][..], &["diagonals", "-m", MACHINE]] {
        contains(
            &notes(&[call, &["--at", "A=400"]].concat()),
            "outside travel: A = 400 deg, travel -110 to 30 deg",
        );
    }
    refuses(&["diagonals", "-m", MACHINE, "--at", "B=5"], "has no axis B");
}

/// Constants and a common rotation of all axes only move the workpiece. In machine coordinates these 22.9 µm and 40
/// µrad are no errors of form, even for a model compared with a truth of another zero.
#[test]
fn a_rigid_motion_of_the_workpiece_is_no_error_of_form() {
    let folder = Folder::new();
    let machine = |name: &str, errors: &str| {
        let path = folder.path().join(name).display().to_string();
        let text = format!(
            "structure = \"w X' b Y Z t\"\n[axes]\nX.travel = [0, 20000]\nY.travel = [0, 6000]\nZ.travel = [0, 3000]\n[errors]\n{errors}"
        );
        fs::write(&path, text).expect("written");
        path
    };
    // All axes rotated by one angle about Z.
    let turned = machine("turned.toml", "EXX = 22.9\nEC0X = 40.0\nEC0Y = 40.0\n");
    let number = |map: &Value, key: &str| float(&map[key]);
    for form in ["compiled", "twist"] {
        let map = json(&["map", "-m", &turned, "--grid", "5x4x3", "--model", form]);
        assert!(number(&map, "rms_um") > 300.0, "{map}");
        assert!(number(&map, "form_rms_um") < 1e-6, "{map}");
        assert!(number(&map, "form_max_um") < 1e-6, "{map}");
        assert!(number(&map["all_axes"], "form_max_um") < 1e-2, "{map}");
    }
    let shifted = machine("shifted.toml", "EXX = { poly = [400.0, 0.01] }\n");
    let truth = machine("truth.toml", "EXX = { poly = [0.0, 0.01] }\n");
    let map = json(&["map", "-m", &shifted, "--truth", &truth, "--grid", "5x4x3"]);
    assert!((number(&map, "rms_um") - 400.0).abs() < 1.0, "{map}");
    assert!(number(&map, "form_rms_um") < 0.01, "{map}");
    // A scale error is an error of form: 10 µm/m over 20 m are the RMS of five positions 50 µm apart.
    let map = json(&["map", "-m", &truth, "--grid", "5x4x3"]);
    let spread = 50.0 * 2.0_f64.sqrt();
    assert!((number(&map, "form_rms_um") - spread).abs() < 1e-3, "{map}");
    assert!((number(&map, "form_max_um") - 100.0).abs() < 1e-3, "{map}");
    let shown = text(&["map", "-m", &truth, "--grid", "5x4x3"]);
    contains(
        &shown,
        "after alignment of the workpiece\n  root mean square 70.711 µm, largest 100.000 µm",
    );
}

/// A table's location errors have no effect on the grid, where the table is at 0. Over poses of all axes the location
/// errors have an effect, which one alignment cannot remove. A model that contains the location errors leaves less than
/// 0.05 µm.
#[test]
fn over_all_axes_a_model_without_rotary_errors_is_told_apart() {
    const TRUTH: &str = "examples/table-tilting.toml";
    let folder = Folder::new();
    let text = fs::read_to_string(root().join(TRUTH)).expect("the example");
    let kept: Vec<&str> = text
        .lines()
        .filter(|line| {
            !["EX0C", "EY0C", "EA0C", "EB0C", "EY0A", "EZ0A"]
                .iter()
                .any(|name| line.starts_with(name))
        })
        .collect();
    let without = folder.write("without.toml", kept.join("\n"));
    let judged = |model: &str| json(&["map", "-m", model, "--truth", TRUTH, "--grid", "3x3x3"]);
    let number = |value: &Value, key: &str| float(&value[key]);
    let (known, unknown) = (judged(TRUTH), judged(&without));
    assert!(
        number(&known, "form_rms_um") < 0.01 && number(&unknown, "form_rms_um") < 0.5,
        "{unknown}"
    );
    let [known, unknown] = [&known["all_axes"], &unknown["all_axes"]];
    assert_eq!(known["poses"], 4096);
    assert!(number(known, "form_rms_um") < 0.05, "{known}");
    // A perfect correction leaves a rotation about the tool axis, which is no tilt.
    assert!(number(known, "form_tilt_rms_urad") < 10.0, "{known}");
    assert!(number(known, "form_about_tool_rms_urad") > 100.0, "{known}");
    assert!(number(unknown, "form_rms_um") > 10.0, "{unknown}");
    assert!(number(unknown, "form_rms_um") < number(unknown, "rms_um"));
    assert!(number(unknown, "form_max_um") > number(unknown, "form_rms_um"));
    let shown = crate::text(&["map", "-m", TRUTH, "--grid", "2x2x2"]);
    contains(&shown, "volumetric error over 4096 poses of all axes:");
    assert_eq!(judged(TRUTH), judged(TRUTH));
}

#[cfg(feature = "parquet")]
#[test]
fn arrow_reads_the_parquet_map() {
    let Some(python) = volcomp_test_support::peers::python() else {
        return;
    };
    let folder = Folder::new();
    let [parquet, csv] = ["map.parquet", "map.csv"].map(|name| {
        let path = folder.path().join(name).display().to_string();
        let map = crate::words("map -m examples/gantry.toml --grid 30x20x10 -o");
        json(&[&map[..], &[&path]].concat());
        path
    });
    let program = "import sys, csv, pyarrow.parquet as p\n\
        t = p.read_table(sys.argv[1])\n\
        rows = list(csv.reader(open(sys.argv[2])))\n\
        assert t.column_names == rows[0], t.column_names\n\
        assert t.num_rows == len(rows) - 1 == 6000\n\
        for k, name in enumerate(rows[0]):\n\
        \x20   worst = max(abs(a - float(row[k])) for a, row in zip(t[name].to_pylist(), rows[1:]))\n\
        \x20   assert worst <= 5.1e-7, (name, worst)\n";
    let output = Command::new(python)
        .args(["-c", program, &parquet, &csv])
        .output()
        .expect("Python is there");
    assert!(output.status.success(), "{output:?}");
}

/// The centre of a table has an uncertainty of 5 µm along X. The tip's standard uncertainty at C is 2·5·|sin(C/2)| µm,
/// thus RMS √2·5 µm and maximum 2·5 µm over a turn. On the grid, with C at 0, it is zero.
#[test]
fn poses_of_all_axes_have_their_uncertainty() {
    let folder = Folder::new();
    let path = |name: &str| folder.path().join(name).display().to_string();
    let travels = "X.travel = [-200, 200]\nY.travel = [-200, 200]\nZ.travel = [-200, 200]\nC.travel = [-180, 180]\n";
    let machine = format!("structure = \"w C' b X Y Z t\"\n[axes]\n{travels}[errors]\nEX0C = 3\n");
    std::fs::write(path("machine.toml"), machine).expect("written");
    let calibration = "machine = \"machine.toml\"\n[[location]]\nerror = \"EX0C\"\nvalue_um = 3\nuncertainty_um = 5\n";
    std::fs::write(path("calibration.toml"), calibration).expect("written");
    let (machine, calibration) = (path("machine.toml"), path("calibration.toml"));
    let map = ["map", "-m", &machine, "--grid", "2x2x2"];
    let asked = ["--uncertainty", &calibration, "--trials", "2000"];
    let found = json(&[&map[..], &asked].concat());
    let number = |value: &serde_json::Value| value.as_f64().expect("a number");
    assert!(number(&found["uncertainty"]["largest_um"]) < 1e-6, "{found}");
    let own = &found["all_axes"]["uncertainty"];
    // 2000 samples give a standard deviation to 1.6 % (one sigma). The tolerance is three times as wide.
    let near = |found: f64, expected: f64| (found / expected - 1.0).abs() < 0.048;
    assert!(near(number(&own["rms_um"]), 5.0 * 2.0_f64.sqrt()), "{own}");
    assert!(near(number(&own["largest_um"]), 10.0), "{own}");
    // RMS and maximum are from the same samples, so their ratio is more accurate.
    let ratio = number(&own["largest_um"]) / number(&own["rms_um"]);
    assert!((ratio / 2.0_f64.sqrt() - 1.0).abs() < 0.03, "{ratio}");
    assert!(number(&own["at"]["C"]).abs() > 175.0 && number(&own["rms_urad"]) < 1e-6, "{own}");
    let shown = text(&[&map[..], &asked].concat());
    contains(&shown, "standard uncertainty: root mean square 7.");
    assert!(json(&map)["all_axes"]["uncertainty"].is_null());
}

fn array(vtk: &str, name: &str) -> Vec<f64> {
    let (_, from) = vtk.split_once(&format!("Name=\"{name}\"")).expect(name);
    let (_, from) = from.split_once('>').expect("the end of the tag");
    let (numbers, _) = from.split_once("</DataArray>").expect("the end");
    let numbers = numbers.split_whitespace().map(|n| n.parse().expect("a number"));
    numbers.collect()
}

fn attribute<'v>(vtk: &'v str, name: &str) -> Vec<&'v str> {
    let (_, from) = vtk.split_once(&format!("{name}=\"")).expect(name);
    let (value, _) = from.split_once('"').expect("the end");
    value.split(' ').collect()
}

/// A VTK file has one node, at 0, for a missing axis. X varies fastest.
#[test]
fn vtk_files_hold_each_axis_at_its_own_place() {
    let folder = Folder::new();
    let machine = folder.file("m.toml");
    let map = |structure: &str, travels: &str, file: &str| {
        let text = format!(
            "structure = \"{structure}\"\n[axes]\n{travels}[errors]\nEZZ = {{ poly = [0.0, 0.1] }}\n"
        );
        fs::write(&machine, text).expect("written");
        let file = folder.path().join(file);
        let path = file.display().to_string();
        json(&["map", "-m", &machine, "--grid", "3x5x2", "-o", &path]);
        fs::read_to_string(file).expect("written")
    };
    let (x, z) = ("X.travel = [0, 100]\n", "Z.travel = [-40, 60]\n");
    let both = format!("{x}{z}");
    let vtr = map("w b Z X t", &both, "m.vtr");
    assert_eq!(array(&vtr, "X_mm"), [0.0, 50.0, 100.0]);
    assert_eq!(array(&vtr, "Y_mm"), [0.0]);
    assert_eq!(array(&vtr, "Z_mm"), [-40.0, 60.0]);
    assert_eq!(attribute(&vtr, "WholeExtent"), ["0", "2", "0", "0", "0", "1"]);
    // EZZ = 0.1 µm/mm from the reference depends on Z only; the three nodes along X come first.
    let position = array(&vtr, "position_um");
    assert_eq!(position.len(), 3 * 6);
    let along_z: Vec<f64> = position.chunks(3).map(|node| node[2]).collect();
    assert!(along_z[..3].iter().all(|dz| *dz == along_z[0]));
    assert!(along_z[3..].iter().all(|dz| (dz - along_z[0] - 10.0).abs() < 1e-6));
    let vti = map("w b Z X t", &both, "m.vti");
    assert_eq!(attribute(&vti, "WholeExtent"), ["0", "2", "0", "0", "0", "1"]);
    assert_eq!(attribute(&vti, "Origin"), ["0", "0", "-40"]);
    assert_eq!(attribute(&vti, "Spacing"), ["50", "1", "100"]);
    let alone = map("w b Z t", z, "z.vtr");
    assert_eq!(array(&alone, "X_mm"), [0.0]);
    assert_eq!(array(&alone, "Y_mm"), [0.0]);
    assert_eq!(array(&alone, "Z_mm"), [-40.0, 60.0]);
}

/// An error of the table of 50 µrad tilts the tool relative to the table. An error of 200 µrad about the tool axis is
/// no tilt. The tool is parallel to Z in all poses.
#[test]
fn the_tilt_of_the_tool_is_told_apart_from_the_rotation_about_it() {
    let folder = Folder::new();
    let text = "structure = \"w C' b X Y Z t\"\n[axes]\nX.travel = [-200, 200]\nY.travel = [-200, 200]\nZ.travel = [-300, 0]\n\
                C.travel = [-180, 180]\n[errors]\nECC = 200.0\nEAC = 50.0\n";
    let path = folder.write("m.toml", text);
    let call = ["map", "-m", &path, "--grid", "2x2x2", "--exact"];
    let answer = json(&call);
    let of = |key: &str| answer["all_axes"][key].as_f64().expect(key);
    assert!((of("tilt_rms_urad") - 50.0).abs() < 0.1, "{answer}");
    assert!((of("about_tool_rms_urad") - 200.0).abs() < 0.1, "{answer}");
    assert!((of("rms_urad") - 50.0_f64.hypot(200.0)).abs() < 0.1, "{answer}");
    for beside in ["", "form_"] {
        let parts = of(&format!("{beside}tilt_rms_urad"))
            .hypot(of(&format!("{beside}about_tool_rms_urad")));
        assert!((of(&format!("{beside}rms_urad")) - parts).abs() < 1e-6, "{answer}");
    }
    let shown = crate::text(&call);
    contains(&shown, "  tilt of the tool axis 50.000 µrad, after alignment ");
    contains(&shown, "  rotation about it 200.000 µrad, after alignment ");
}

/// A correction is computed with compiled curves, which differ from the curves of the file by far less than the last
/// printed digit. `--exact` evaluates the curves of the file.
#[test]
fn a_corrected_map_is_that_of_the_curves_of_the_file() {
    let folder = Folder::new();
    let machine = folder.write(
        "m.toml",
        "structure = \"w X' b Y Z t\"\n[axes]\nX.travel = [0, 500]\nY.travel = [0, 400]\nZ.travel = [0, 300]\n[tool]\ntip = [0, 0, -150]\n[errors]\n\
         EXX = { mls = { nodes = [[0, 0], [120, 5], [260, 2], [400, -4], [500, 3]], order = 2, support = 0.8, shape = 3.0 } }\n\
         EBY = { forward = { poly = [1, 0.1] }, backward = { poly = [9, 0.08] } }\nECZ = { poly = [0, 0.3, -2e-4] }\nEA0Z = 40\n",
    );
    for more in [&["--compensated"][..], &["--resolution", "1"]] {
        let map = |exact: &[&str]| {
            json(&[&["map", "-m", &machine, "--grid", "4x4x4"], more, exact].concat())
        };
        let [fast, exact] = [map(&[]), map(&["--exact"])];
        for key in ["largest_um", "rms_um", "form_rms_um", "form_max_um"] {
            crate::close(&fast[key], float(&exact[key]), 2e-4);
        }
    }
}
