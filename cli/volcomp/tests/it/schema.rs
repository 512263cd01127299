//! Every JSON document against its schema.

use std::{collections::BTreeMap, fs, sync::LazyLock};

use serde_json::Value;

use crate::{help::commands, json, root, volcomp};

const GANTRY: &str = "examples/gantry.toml";
const SPINDLE: &str = "fitting/fit/tests/data/spindle-2min.csv";
const STRAIGHT: [&str; 2] = ["examples/straight-exy.csv", "examples/straight-eyx.csv"];
const POSITIONING: &str = "fitting/metrology/tests/data/iso230-2-axis.csv";

/// The schemas that `volcomp schema` writes, by the name of their document.
static SCHEMAS: LazyLock<BTreeMap<String, Value>> = LazyLock::new(|| {
    let folder = tempfile::tempdir().expect("a folder");
    let document = json(&["schema", &folder.path().display().to_string()]);
    let files = document["files"].as_array().expect("a list").iter();
    let schemas = files.map(|file| {
        let file = file.as_str().expect("a name");
        let text = fs::read_to_string(folder.path().join(file)).expect("written");
        let name = file
            .strip_prefix("volcomp-")
            .and_then(|name| name.strip_suffix(".json"));
        (
            name.expect("a name").to_owned(),
            serde_json::from_str(&text).expect("JSON"),
        )
    });
    schemas.collect()
});

pub(crate) fn validate(name: &str, document: &Value) {
    let schema = &SCHEMAS[name];
    let validator = jsonschema::draft202012::new(schema).expect("the schema is one");
    let wrong: Vec<String> = validator
        .iter_errors(document)
        .map(|e| format!("{}: {e}", e.instance_path()))
        .collect();
    assert!(wrong.is_empty(), "{name}: {wrong:?}\n{document}");
    // A key that the schema does not know is one that nobody documented.
    let known = schema.to_string();
    if let Value::Object(keys) = document {
        for key in keys.keys() {
            assert!(known.contains(&format!("\"{key}\"")), "{name}: {key}");
        }
    }
}

#[test]
#[expect(clippy::too_many_lines, reason = "one call for each document")]
fn live_documents_follow_their_schemas() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let demo = path("demo");
    let machine = format!("{demo}/calibrated.toml");
    let truth = format!("{demo}/truth.toml");
    let calibration = format!("{demo}/calibration.toml");
    let points = path("points.csv");
    fs::write(&points, "X,Y\n0,0\n9000,0\n").expect("written");
    let blob = path("m.blob");
    let map = path("map.csv");
    let image = path("gantry.map");
    let (exported, imported) = (path("tables.csv"), path("curves.toml"));
    let fit = format!("{demo}/exx.rtl");
    let angular = format!("{demo}/eay.rta");
    let (found, lasers) = (path("found.toml"), path("lasers"));
    let report = path("report.html");
    let (program, worn) = (path("part-out.ngc"), path("worn.toml"));
    json(&["demo", "-o", &demo]);
    let calls: &[&[&str]] = &[
        &["check", GANTRY],
        &["check", "examples/five-axis.toml"],
        &["compile", GANTRY, "-o", &blob],
        &["completions", "fish"],
        &["error", "-m", GANTRY, "--at", "X=1"],
        &["error", "-m", GANTRY, "--points", &points],
        &[
            "correct",
            "-m",
            "examples/five-axis.toml",
            "--at",
            "X=1,C=9",
        ],
        &["correct", "-m", GANTRY, "--points", &points],
        &["diagonals", "-m", GANTRY],
        &[
            "diagonals",
            "-m",
            &machine,
            "--truth",
            &truth,
            "--resolution",
            "1",
        ],
        &["map", "-m", GANTRY, "--grid", "3x3x3"],
        &[
            "map-table",
            "-m",
            GANTRY,
            "--words",
            "8000",
            "--within",
            "3",
            "-o",
            &image,
        ],
        &[
            "export",
            "-m",
            "examples/five-axis.toml",
            "--format",
            "csv",
            "-o",
            &exported,
        ],
        &["import", &exported, "-o", &imported],
        &[
            "map", "-m", &machine, "--grid", "3x3x3", "--truth", &truth, "-o", &map,
        ],
        &[
            "map",
            "-m",
            &machine,
            "--grid",
            "3x3x3",
            "--uncertainty",
            &calibration,
            "--trials",
            "3",
        ],
        &[
            "fit",
            &fit,
            "--method",
            "mls",
            "--auto",
            "--residual-um",
            "1",
            "--scan",
            "--at",
            "0,100",
        ],
        &["fit", &angular, "--method", "bspline"],
        &["iso230", &fit],
        &["form", "examples/ring.csv", "--feature", "circle"],
        &["form", "examples/ring.csv", "--feature", "plane"],
        &[
            "form",
            "examples/bore.csv",
            "--feature",
            "cylinder",
            "--datum",
            "0,0,0,0,0,1",
        ],
        &[
            "nc",
            "examples/part.ngc",
            "-o",
            &program,
            "-m",
            "examples/mill.toml",
            "--setup",
            "examples/setup.toml",
            "--verify",
        ],
        &["iso230", &angular],
        &["iso230", POSITIONING],
        &[
            "iso230",
            POSITIONING,
            &fit,
            "--standard",
            "all",
            "--device-um",
            "1",
            "--tolerance",
            "A=1",
        ],
        &["straightness", STRAIGHT[0]],
        &[
            "straightness",
            STRAIGHT[0],
            STRAIGHT[1],
            "--tolerance",
            "end-points=1",
        ],
        &["squareness", STRAIGHT[0], STRAIGHT[1], "--error", "EC0Y"],
        &["sensitivity", "-m", GANTRY, "--grid", "2"],
        &["expression", "-m", GANTRY],
        &["axes", "-m", "examples/trunnion.toml", "--tip", "0,0,-50"],
        &["dh", "-m", "examples/five-axis.toml"],
        &["inspect", &fit],
        &["inspect", POSITIONING],
        &["inspect", &fit, POSITIONING],
        &["calibrate", &calibration, "-o", &found],
        &["report", &calibration, "--truth", &truth, "-o", &report],
        &[
            "identify",
            "examples/identification/observations.toml",
            "-o",
            &found,
        ],
        &["simulate", "cli/volcomp/demo/shop.toml", "-o", &lasers],
        &["age", "-m", GANTRY, "--months", "24", "-o", &worn],
        &["demo"],
        &["fit-thermal", SPINDLE, "--displacement", "ch1_um"],
    ];
    for call in calls {
        validate(call[0], &json(call));
    }
    let simulator = crate::probe::simulator();
    let url = format!("focas://{}", simulator.address());
    validate("probe", &json(&["probe", &url]));
    validate("probe-list", &json(&["probe", "--list"]));
    let drafted = path("drafted.toml");
    let call = [
        "calibrate",
        "--draft",
        &demo,
        "--machine",
        &machine,
        "-o",
        &drafted,
    ];
    validate("calibrate-draft", &json(&call));
    let circle = [
        "iso230",
        "examples/circle.csv",
        "--part",
        "4",
        "--radius-mm",
        "150",
        "--feed",
        "900",
    ];
    validate("iso230-circle", &json(&circle));
    validate(
        "iso230-circle",
        &json(&[&circle[..], &["examples/circle.csv"]].concat()),
    );
    let mill = ["-m", "examples/mill.toml", "--setup", "examples/setup.toml"];
    let averaged = [
        &[
            "nc",
            "examples/part.ngc",
            "--average",
            "--verify",
            "-o",
            &program,
        ],
        &mill[..],
    ]
    .concat();
    validate("nc-average", &json(&averaged));
    let mut known: Vec<&str> = calls.iter().map(|call| call[0]).collect();
    known.extend([
        "probe",
        "probe-list",
        "nc-average",
        "calibrate-draft",
        "iso230-circle",
        "iso230-diagonals",
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
                "iso230-diagonals"
            ]
            .contains(&name)
                || commands().iter().any(|c| c == name),
            "{name}"
        );
        assert!(known.contains(&name), "no call shows {name}");
    }
}

/// The document on standard error of a call that fails.
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
    let folder = tempfile::tempdir().expect("a folder");
    let machine = folder.path().join("machine.toml").display().to_string();
    let text = fs::read_to_string(root().join(GANTRY)).expect("read");
    fs::write(&machine, text.replace("EC0Y = 12.0", "EC0Y = nan")).expect("written");
    let (status, error) = failure(&["check", &machine]);
    assert_eq!(status, Some(2));
    assert_eq!(error["kind"], "input");
    assert_eq!(error["file"], machine);
    assert!(
        error["line"].as_u64().is_some_and(|line| line > 10),
        "{error}"
    );
    assert_eq!(error["key"], "errors.EC0Y");
    assert!(
        error["message"]
            .as_str()
            .is_some_and(|m| m.contains("found nan"))
    );
    let points = folder.path().join("points.csv").display().to_string();
    fs::write(&points, "X;Y\n1;2\n1;x\n").expect("written");
    let (_, error) = failure(&["error", "-m", GANTRY, "--points", &points]);
    assert_eq!(
        (&error["file"], &error["line"], &error["key"]),
        (&points.into(), &3.into(), &"Y".into())
    );
    let (status, error) = failure(&["check", "nowhere.toml"]);
    assert_eq!((status, &error["file"]), (Some(2), &"nowhere.toml".into()));
    let (status, error) = failure(&["map", "-m", GANTRY]);
    assert_eq!((status, &error["kind"]), (Some(2), &"call".into()));
    let (status, error) = failure(&["nothing"]);
    assert_eq!((status, &error["kind"]), (Some(2), &"call".into()));
    let (status, error) = failure(&["probe", "focas://127.0.0.1:1", "--within", "0.5"]);
    assert_eq!((status, &error["kind"]), (Some(1), &"work".into()));
    let (status, error) = failure(&["iso230", "nowhere.csv"]);
    assert_eq!((status, &error["kind"]), (Some(2), &"input".into()));
    let broken = folder.path().join("broken.csv").display().to_string();
    fs::write(&broken, "target,run,direction,deviation\n1,1,+,nan\n").expect("written");
    let (_, error) = failure(&["fit", &broken, "--method", "poly"]);
    assert_eq!(error["file"], broken);
    assert_eq!(error["line"], 2);
    assert_eq!(failure(&["iso230", POSITIONING, "--part", "9"]).0, Some(2));
}
