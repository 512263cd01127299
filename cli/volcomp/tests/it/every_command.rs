//! Rules that hold for every command.
//!
//! The help has two examples, and every example runs. No text output on an example is wider than 80 columns. Every JSON
//! document agrees with its schema.

use std::{
    collections::BTreeMap,
    fs,
    process::Command,
    sync::{Arc, LazyLock},
};

use serde_json::Value;
use volcomp_focas::simulator::{Options, Simulator, World};

use crate::{Folder, cases, json, list, root, text, volcomp, words};

pub(crate) fn commands() -> Vec<String> {
    let help = text(&["--help"]);
    let listed = help
        .lines()
        .skip_while(|line| *line != "Commands:")
        .skip(1)
        .take_while(|line| !line.is_empty());
    let named = listed.filter(|line| line.starts_with("  ") && !line.starts_with("   "));
    let names = named.filter_map(|line| line.split_whitespace().next());
    names.filter(|name| *name != "help").map(str::to_owned).collect()
}

fn examples(command: &str) -> Vec<String> {
    let help = text(&[command, "--help"]);
    let block = help.lines().skip_while(|line| *line != "Examples:").skip(1);
    block.map(|line| line.trim().to_owned()).collect()
}

/// A folder with the files of the examples in the help texts: `examples/` and the demo.
fn scratch() -> Folder {
    let folder = Folder::new();
    json(&["demo", "-o", &folder.path().display().to_string()]);
    for entry in fs::read_dir(root().join("examples")).expect("the examples") {
        let path = entry.expect("an entry").path();
        if path.is_file() {
            let name = path.file_name().expect("a name");
            fs::copy(&path, folder.path().join(name)).expect("copied");
        }
    }
    let identification = folder.path().join("identification");
    fs::create_dir(&identification).expect("made");
    for entry in fs::read_dir(root().join("examples/identification")).expect("the examples") {
        let path = entry.expect("an entry").path();
        let name = path.file_name().expect("a name");
        fs::copy(&path, identification.join(name)).expect("copied");
    }
    let points = "N,X,Y,Z\n10,100,200,0\n20,8000,4000,2500\n";
    fs::write(folder.path().join("points.csv"), points).expect("written");
    let spindle = root().join("fitting/fit/tests/data/spindle-2min.csv");
    fs::copy(spindle, folder.path().join("spindle.csv")).expect("copied");
    folder
}

#[test]
fn every_command_has_two_examples_that_run() {
    let folder = scratch();
    let mut world = World::new(&['X', 'Y', 'Z']);
    world.motion = Arc::new(|_| vec![0.0; 3]);
    let simulator =
        Simulator::start("127.0.0.1:0", Options::default(), world).expect("a free port");
    let address = simulator.address().to_string();
    let program = std::path::Path::new(env!("CARGO_BIN_EXE_volcomp"));
    let path = format!(
        "{}:{}",
        program.parent().expect("a folder").display(),
        std::env::var("PATH").expect("a path")
    );
    let commands = commands();
    assert!(commands.len() >= 15, "{commands:?}");
    for command in commands {
        let examples = examples(&command);
        assert_eq!(examples.len(), 2, "volcomp {command} --help: {examples:?}");
        for example in examples {
            assert!(example.split_whitespace().any(|word| word == command), "{example}");
            // The studio runs until it is stopped, and opens a browser. `studio.rs` tests it.
            if command == "studio" {
                continue;
            }
            let output = Command::new("sh")
                .args(["-c", &example.replace("127.0.0.1:8193", &address)])
                .env("PATH", &path)
                .current_dir(folder.path())
                .output()
                .expect("a shell");
            let said = String::from_utf8_lossy(&output.stderr);
            // The result of an example may exceed its tolerance, which gives exit status 3.
            let is_done = output.status.success()
                || example.contains("--tolerance") && output.status.code() == Some(3);
            assert!(is_done, "{example}\n{said}");
            let shown = String::from_utf8_lossy(&output.stdout);
            assert!(!shown.is_empty() || example.contains('>'), "{example}");
            let tables = !example.contains("--json") && !example.contains("fit");
            for line in shown.lines().filter(|_| tables) {
                assert!(line.chars().count() <= 80, "{example}\n{line}");
            }
        }
    }
}

#[test]
fn help_fits_eighty_columns_and_speaks_of_micrometres() {
    for command in commands().iter().map(String::as_str).chain([""]) {
        let call = [command, "--help"];
        let help = text(if command.is_empty() { &call[1..] } else { &call });
        let mut among_values = false;
        for line in help.lines() {
            assert!(line.chars().count() <= 80, "{command}: {line}");
            // Possible values are printed as the user types them, so `um` may be among them.
            among_values |= line.contains("[possible") || line.contains("Possible values");
            if among_values {
                among_values = !line.ends_with(']');
                continue;
            }
            for word in line.split(|c: char| !c.is_alphanumeric() && c != '_' && c != '-') {
                assert!(!["um", "urad", "degC"].contains(&word), "{command}: {line}");
            }
        }
    }
}

#[test]
fn completions_know_the_commands() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = text(&["completions", shell]);
        for command in commands() {
            assert!(script.contains(&command), "{shell}: {command}");
        }
    }
    let document = json(&["completions", "bash"]);
    assert_eq!(document["shell"], "bash");
}

fn machines() -> Vec<String> {
    let entries = fs::read_dir(root().join("examples")).expect("the examples");
    let files = entries.map(|entry| entry.expect("an entry").path());
    let texts = files.filter_map(|path| {
        let text = fs::read_to_string(&path).ok()?;
        text.contains("[axes.X]").then(|| path.display().to_string())
    });
    let mut machines: Vec<String> = texts.collect();
    machines.sort();
    assert!(machines.len() >= 6, "{machines:?}");
    machines
}

fn fits(arguments: &str) {
    let output = volcomp(arguments);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {said}");
    let shown = String::from_utf8(output.stdout).expect("UTF-8");
    for line in shown.lines().chain(said.lines()) {
        // Long paths and pieces of a machine file may be wider, since they are not wrapped.
        let is_path = line.split_whitespace().any(|word| word.contains('/'));
        let is_toml = line.contains(" = {");
        let wide = line.chars().count();
        assert!(wide <= 80 || is_path || is_toml, "{arguments:?}: {wide} columns\n{line}");
        assert_eq!(line.trim_end(), line, "{arguments:?}: blanks at the end of a line");
    }
}

#[test]
fn every_machine_in_every_command() {
    let folder = Folder::new();
    let place = folder.file("");
    folder.write("points.csv", "X,Y,Z\n1,2,3\n99999,-99999,99999\n-12345.678,0,0\n0,0,-1\n");
    for machine in &machines() {
        for call in [
            "check M",
            "error -m M --at X=1",
            "error -m M --at X=-99999.5,Y=99999.5,Z=-99999.5",
            "error -m M --points $points.csv",
            "correct -m M --at X=1",
            "correct -m M --at X=-99999.5,Y=99999.5,Z=-99999.5",
            "correct -m M --points $points.csv",
            "correct -m M --points $points.csv -o $out.csv",
            "correct -m M --points $out.csv -o $again.csv",
            "diagonals -m M",
            "diagonals -m M --truth M --resolution 0.123",
            "map -m M --grid 3x3x3",
            "map -m M --grid 3x3x3 --compensated",
            "compile M -o $m.blob",
        ] {
            fits(&call.replace('M', machine).replace('$', &place));
        }
    }
}

#[test]
fn every_measurement_in_every_command() {
    let folder = Folder::new();
    let place = folder.file("");
    for call in [
        "demo -o $demo",
        "calibrate $demo/calibration.toml -o $m.toml",
        "calibrate examples/calibration/calibration.toml -o $n.toml",
        "identify examples/identification/observations.toml -o $o.toml",
        "simulate examples/calibration/shop.toml -o $lasers",
        "inspect $demo/exx.rtl",
        "inspect $demo/eay.rta",
        "iso230 $demo/exx.rtl",
        "iso230 $demo/eay.rta",
        "fit-thermal fitting/fit/tests/data/spindle-2min.csv --displacement ch1_um",
        "probe --list",
    ] {
        fits(&call.replace('$', &place));
    }
    for file in ["exx.rtl", "eay.rta"] {
        for method in ["poly", "chebyshev", "mls", "bspline"] {
            // The curve is one line of a machine file, of any length.
            let shown = text(&format!("fit {place}demo/{file} --method {method} --at 0,4000"));
            for line in shown.lines().skip(1) {
                assert!(line.chars().count() <= 80, "{line}");
            }
        }
    }
}

/// A reader that closes the pipe causes no failure. A narrow terminal and missing colours do not change the output.
#[cfg(unix)]
#[test]
fn closed_pipes_and_narrow_terminals() {
    let program = env!("CARGO_BIN_EXE_volcomp");
    let run = |line: &str| {
        Command::new("sh")
            .args(["-c", line])
            .current_dir(root())
            .env("COLUMNS", "40")
            .env("NO_COLOR", "1")
            .output()
            .expect("a shell")
    };
    for call in [
        "check examples/table-tilting.toml",
        "--help",
        "map --help",
        "completions bash",
        "check nowhere.toml",
    ] {
        for reader in ["true", "head -1"] {
            let output = run(&format!("{program} {call} | {reader}"));
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            assert!(!said.contains("panicked"), "{call} | {reader}: {said}");
        }
        let closed = run(&format!("{program} {call} >&- 2>&-"));
        assert!(matches!(closed.status.code(), Some(0..=2)), "{call}: {closed:?}");
    }
    let narrow = run(&format!("{program} check examples/mill.toml"));
    let wide = volcomp(&["check", "examples/mill.toml"]);
    assert_eq!(narrow.stdout, wide.stdout);
}

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
    let simulator = crate::network::simulator();
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
    let text = fs::read_to_string(root().join(GANTRY)).expect("read");
    let machine = folder.write("machine.toml", text.replace("EC0Y = 12.0", "EC0Y = nan"));
    let (status, error) = failure(&["check", &machine]);
    assert_eq!(status, Some(2));
    assert_eq!(error["kind"], "input");
    assert_eq!(error["file"], machine);
    assert!(error["line"].as_u64().is_some_and(|line| line > 10), "{error}");
    assert_eq!(error["key"], "errors.EC0Y");
    assert!(error["message"].as_str().is_some_and(|m| m.contains("found nan")));
    let points = folder.write("points.csv", "X;Y\n1;2\n1;x\n");
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
