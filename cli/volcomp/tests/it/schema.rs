//! Every JSON document against its schema.

use std::{collections::BTreeMap, fs, sync::LazyLock};

use serde_json::Value;

use crate::{Folder, cases, help::commands, json, list, root, volcomp, words};

const GANTRY: &str = "examples/gantry.toml";
const POSITIONING: &str = "fitting/metrology/tests/data/iso230-2-axis.csv";

/// The schemas that `volcomp schema` writes, by document name.
static SCHEMAS: LazyLock<BTreeMap<String, Value>> = LazyLock::new(|| {
    let folder = Folder::new();
    let document = json(&["schema", &folder.path().display().to_string()]);
    let files = list(&document["files"]).iter();
    let schemas = files.map(|file| {
        let file = file.as_str().expect("a name");
        let text = fs::read_to_string(folder.path().join(file)).expect("written");
        let name = file.strip_prefix("volcomp-").and_then(|name| name.strip_suffix(".json"));
        (name.expect("a name").to_owned(), serde_json::from_str(&text).expect("JSON"))
    });
    schemas.collect()
});

pub(crate) fn validate(name: &str, document: &Value) {
    let schema = &SCHEMAS[name];
    let validator = jsonschema::draft202012::new(schema).expect("the schema is one");
    let wrong: Vec<String> =
        validator.iter_errors(document).map(|e| format!("{}: {e}", e.instance_path())).collect();
    assert!(wrong.is_empty(), "{name}: {wrong:?}\n{document}");
    // A key that the schema lacks is undocumented.
    let known = schema.to_string();
    if let Value::Object(keys) = document {
        for key in keys.keys() {
            assert!(known.contains(&format!("\"{key}\"")), "{name}: {key}");
        }
    }
}

#[test]
fn live_documents_follow_their_schemas() {
    let folder = Folder::new();
    let place = folder.path().display().to_string();
    let in_folder = |call: &str| json(&call.replace('$', &place));
    fs::write(folder.path().join("points.csv"), "X,Y\n0,0\n9000,0\n").expect("written");
    in_folder("demo -o $/demo");
    let calls: &[&str] = &[
        "check examples/gantry.toml",
        "check examples/five-axis.toml",
        "compile examples/gantry.toml -o $/m.blob",
        "completions fish",
        "error -m examples/gantry.toml --at X=1",
        "error -m examples/gantry.toml --points $/points.csv",
        "correct -m examples/five-axis.toml --at X=1,C=9",
        "correct -m examples/gantry.toml --points $/points.csv",
        "diagonals -m examples/gantry.toml",
        "diagonals -m $/demo/calibrated.toml --truth $/demo/truth.toml --resolution 1",
        "map -m examples/gantry.toml --grid 3x3x3",
        "map-table -m examples/gantry.toml --words 8000 --within 3 -o $/gantry.map",
        "export -m examples/five-axis.toml --format csv -o $/tables.csv",
        "import $/tables.csv -o $/curves.toml",
        "export -m examples/printer.toml --format klipper -o $/skew",
        "map -m $/demo/calibrated.toml --grid 3x3x3 --truth $/demo/truth.toml -o $/map.csv",
        "map -m $/demo/calibrated.toml --grid 3x3x3 --uncertainty $/demo/calibration.toml --trials 3",
        "fit $/demo/exx.rtl --method mls --auto --residual-um 1 --scan --at 0,100",
        "fit $/demo/eay.rta --method bspline",
        "fit $/demo/exx.rtl --method auto",
        "iso230 $/demo/exx.rtl",
        "form examples/ring.csv --feature circle",
        "form examples/ring.csv --feature plane",
        "form examples/bore.csv --feature cylinder --datum 0,0,0,0,0,1",
        "nc examples/part.ngc -o $/part-out.ngc -m examples/mill.toml --setup examples/setup.toml --verify",
        "iso230 $/demo/eay.rta",
        "iso230 fitting/metrology/tests/data/iso230-2-axis.csv",
        "iso230 fitting/metrology/tests/data/iso230-2-axis.csv $/demo/exx.rtl --standard all --device-um 1 --tolerance A=1",
        "straightness examples/straight-exy.csv",
        "straightness examples/straight-exy.csv examples/straight-eyx.csv --tolerance end-points=1",
        "squareness examples/straight-exy.csv examples/straight-eyx.csv --error EC0Y",
        "sensitivity -m examples/gantry.toml --grid 2",
        "expression -m examples/gantry.toml",
        "axes -m examples/trunnion.toml --tip 0,0,-50",
        "dh -m examples/five-axis.toml",
        "inspect $/demo/exx.rtl",
        "inspect fitting/metrology/tests/data/iso230-2-axis.csv",
        "inspect $/demo/exx.rtl fitting/metrology/tests/data/iso230-2-axis.csv",
        "calibrate $/demo/calibration.toml -o $/found.toml",
        "report $/demo/calibration.toml --truth $/demo/truth.toml -o $/report.html",
        "identify examples/identification/observations.toml -o $/found.toml",
        "simulate cli/volcomp/demo/shop.toml -o $/lasers",
        "age -m examples/gantry.toml --months 24 -o $/worn.toml",
        "demo",
        "fit-thermal fitting/fit/tests/data/spindle-2min.csv --displacement ch1_um",
    ];
    for call in calls {
        validate(words(call)[0], &in_folder(call));
    }
    let simulator = crate::probe::simulator();
    let url = format!("focas://{}", simulator.address());
    validate("probe", &json(&["probe", &url]));
    let table = "
probe-list => probe --list
calibrate-draft => calibrate --draft $/demo --machine $/demo/calibrated.toml -o $/drafted.toml
squareness-lengths => squareness --lengths 141.46,141.39,100 --error EC0Y
iso230-circle => iso230 examples/circle.csv --part 4 --radius-mm 150 --feed 900
iso230-circle => iso230 examples/circle.csv examples/circle.csv --part 4
nc-average => nc examples/part.ngc --average --verify -o $/o.ngc -m examples/mill.toml --setup examples/setup.toml
";
    for (name, call) in cases(table) {
        validate(name, &in_folder(call));
    }
    let mut known: Vec<&str> = calls.iter().map(|call| words(call)[0]).collect();
    known.extend([
        "probe",
        "probe-list",
        "nc-average",
        "calibrate-draft",
        "iso230-circle",
        "iso230-diagonals",
        "squareness-lengths",
        "failure",
    ]);
    for name in SCHEMAS.keys().map(String::as_str) {
        assert!(
            [
                "failure",
                "probe-list",
                "nc-average",
                "calibrate-draft",
                "iso230-circle",
                "iso230-diagonals",
                "squareness-lengths"
            ]
            .contains(&name)
                || commands().iter().any(|c| c == name),
            "{name}"
        );
        assert!(known.contains(&name), "no call shows {name}");
    }
}

/// Exit status of a failing call, and its document on standard error.
fn failure(arguments: &[&str]) -> (Option<i32>, Value) {
    let output = volcomp(&[&["--json"], arguments].concat());
    assert!(output.stdout.is_empty(), "{arguments:?}");
    let said = String::from_utf8(output.stderr).expect("UTF-8");
    let document =
        serde_json::from_str(&said).unwrap_or_else(|e| panic!("{arguments:?}: {e}\n{said}"));
    validate("failure", &document);
    (output.status.code(), document["error"].clone())
}

#[test]
fn a_failure_is_one_object_on_standard_error() {
    let folder = Folder::new();
    let machine = folder.file("machine.toml");
    let text = fs::read_to_string(root().join(GANTRY)).expect("read");
    fs::write(&machine, text.replace("EC0Y = 12.0", "EC0Y = nan")).expect("written");
    let (status, error) = failure(&["check", &machine]);
    assert_eq!(status, Some(2));
    assert_eq!(error["kind"], "input");
    assert_eq!(error["file"], machine);
    assert!(error["line"].as_u64().is_some_and(|line| line > 10), "{error}");
    assert_eq!(error["key"], "errors.EC0Y");
    assert!(error["message"].as_str().is_some_and(|m| m.contains("found nan")));
    let points = folder.file("points.csv");
    fs::write(&points, "X;Y\n1;2\n1;x\n").expect("written");
    let (_, error) = failure(&["error", "-m", GANTRY, "--points", &points]);
    assert_eq!(
        (&error["file"], &error["line"], &error["key"]),
        (&points.into(), &3.into(), &"Y".into())
    );
    let (status, error) = failure(&["check", "nowhere.toml"]);
    assert_eq!((status, &error["file"]), (Some(2), &"nowhere.toml".into()));
    let (status, error) = failure(&["error", "-m", GANTRY]);
    assert_eq!((status, &error["kind"]), (Some(2), &"call".into()));
    let (status, error) = failure(&["nothing"]);
    assert_eq!((status, &error["kind"]), (Some(2), &"call".into()));
    let (status, error) = failure(&["probe", "focas://127.0.0.1:1", "--within", "0.5"]);
    assert_eq!((status, &error["kind"]), (Some(1), &"work".into()));
    let (status, error) = failure(&["iso230", "nowhere.csv"]);
    assert_eq!((status, &error["kind"]), (Some(2), &"input".into()));
    let broken = folder.write("broken.csv", "target,run,direction,deviation\n1,1,+,nan\n");
    let (_, error) = failure(&["fit", &broken, "--method", "poly"]);
    assert_eq!(error["file"], broken);
    assert_eq!(error["line"], 2);
    assert_eq!(failure(&["iso230", POSITIONING, "--part", "9"]).0, Some(2));
}
