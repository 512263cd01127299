//! Measurement files of several kinds: what `inspect` says, and a calibration file drafted from a folder.

use std::fs;

use serde_json::Value;

use crate::{json, refused, text, volcomp};

const SHOP: &str = "cli/volcomp/demo/shop.toml";

fn written(folder: &tempfile::TempDir, name: &str, text: &str) -> String {
    let path = folder.path().join(name);
    fs::write(&path, text).expect("written");
    path.display().to_string()
}

#[test]
fn inspect_takes_several_files_and_tells_the_odd_ones() {
    let folder = tempfile::tempdir().expect("a folder");
    let good = written(
        &folder,
        "exx.csv",
        "target_mm,deviation_um\n0,1\n10,2\n20,4\n",
    );
    let same = written(
        &folder,
        "eyy.csv",
        "target_mm,deviation_um\n0,-1\n10,-2\n20,-4\n",
    );
    let cut = written(&folder, "ezz.rtl", "HEADER::\r\nFile type : rtl\r\n");
    let log = written(
        &folder,
        "x.log",
        "A:POS 2026-03-14 10:00:00.5 1.5\nA:POS 2026-03-14 10:00:01.5 2.5\n",
    );
    let output = volcomp(&["--json", "inspect", &good, &same, &cut, &log]);
    assert_eq!(output.status.code(), Some(2));
    let document: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let files = document["files"].as_array().expect("a list");
    assert_eq!(files.len(), 4);
    assert_eq!(files[0]["kind"], "table");
    assert_eq!(files[0]["warnings"], Value::Array(Vec::new()));
    assert!(
        files[1]["warnings"][0]
            .as_str()
            .expect("a text")
            .contains("the same readings as")
    );
    assert!(
        files[2]["error"]
            .as_str()
            .expect("a text")
            .contains("EOF::")
    );
    assert_eq!(files[3]["channels"][0]["max"], 2.5);
    let shown = text(&["inspect", &good, &log]);
    assert!(shown.contains("measured minus target"), "{shown}");
    assert!(shown.contains("A:POS: 2 values from 1.5 to 2.5"), "{shown}");
    assert_eq!(text(&["inspect", &same]).matches("WARNING").count(), 0);
    assert!(refused(&["inspect", &cut]).contains("ezz.rtl:"));
}

/// The files of the virtual shop: their names and headers say which error each is, nothing says where lines ran.
#[test]
fn a_folder_becomes_a_draft_that_asks_before_it_is_calibrated() {
    let folder = tempfile::tempdir().expect("a folder");
    let lasers = folder.path().display().to_string();
    json(&["simulate", SHOP, "-o", &lasers]);
    let [machine, drafted, result] = ["machine.toml", "drafted.toml", "result.toml"]
        .map(|name| folder.path().join(name).display().to_string());
    let call = [
        "calibrate",
        "--draft",
        &lasers,
        "--machine",
        &machine,
        "-o",
        &drafted,
    ];
    let document = json(&call);
    let measurements = document["measurements"].as_array().expect("a list");
    let files = fs::read_dir(folder.path()).expect("a folder").count();
    assert!(
        measurements.len() > 10 && measurements.len() < files,
        "{}",
        measurements.len()
    );
    assert!(
        measurements.iter().all(|of| of["error"].is_string()),
        "{measurements:?}"
    );
    let questions = document["questions"].as_array().expect("a list");
    assert!(questions.iter().any(|asked| asked["key"] == "point"));
    let message = refused(&["calibrate", &drafted, "-o", &result]);
    assert!(
        message.contains("open question") && message.contains("drafted.toml:"),
        "{message}"
    );
    // A draft that is as it was is written once more, one with an answer only where the call says so.
    json(&call);
    let draft = fs::read_to_string(&drafted).expect("the draft");
    let answered = draft.replacen("\"?\"", "0.0", 1);
    assert_ne!(answered, draft);
    fs::write(&drafted, &answered).expect("written");
    let message = refused(&call);
    assert!(
        message.contains("drafted.toml: the file is there")
            && message.contains("expected another file, or --replace"),
        "{message}"
    );
    let kept = || fs::read_to_string(&drafted).expect("the draft");
    assert_eq!(kept(), answered);
    json(&[&call[..], &["--replace"]].concat());
    assert_eq!(kept(), draft);
    assert!(refused(&["calibrate", &drafted, "--replace", "-o", &result]).contains("--draft"));
    // The draft does not take the place of what it was made from.
    let laser = folder.path().join("exx.rtl").display().to_string();
    let call = [
        "calibrate",
        "--draft",
        &lasers,
        "--machine",
        &machine,
        "-o",
        &laser,
    ];
    assert!(refused(&call).contains("expected another file"));
    assert!(refused(&["calibrate", "--draft", &lasers, "-o", &drafted]).contains("--machine"));
    let empty = tempfile::tempdir().expect("a folder");
    let nothing = empty.path().display().to_string();
    let call = [
        "calibrate",
        "--draft",
        &nothing,
        "--machine",
        &machine,
        "-o",
        &drafted,
    ];
    assert!(refused(&call).contains("it holds no files"));
}

/// The error is answered together with what is asked beside it; what falls away with it is told, what comes with it can be answered too.
#[test]
fn an_error_is_answered_in_one_call_with_what_follows() {
    let folder = tempfile::tempdir().expect("a folder");
    let scan = "target_mm,run,direction,deviation_um\n0,1,+,0\n150,1,+,6\n300,1,+,8\n450,1,+,6\n600,1,+,0\n";
    fs::write(folder.path().join("scan.csv"), scan).expect("written");
    let [files, drafted] =
        ["", "drafted.toml"].map(|name| folder.path().join(name).display().to_string());
    let call = [
        "calibrate",
        "--draft",
        &files,
        "--machine",
        "examples/calibration/machine.toml",
        "--replace",
        "-o",
        &drafted,
    ];
    let answered = json(&[&call[..], &["--answer", "at.X=0", "--answer", "error=EXX"]].concat());
    assert!(
        answered["warnings"]
            .to_string()
            .contains("at.X is not asked of EXX"),
        "{answered}"
    );
    let answered = json(
        &[
            &call[..],
            &["--answer", "EZX:sign=-1", "--answer", "error=EZX"],
        ]
        .concat(),
    );
    assert_eq!(answered["measurements"][0]["error"], "EZX");
    let text = fs::read_to_string(&drafted).expect("the draft");
    assert!(text.contains("\nsign = -1\n"), "{text}");
}

/// A folder with two straightnesses and a mill, and the call that drafts them.
fn straightnesses() -> (tempfile::TempDir, Vec<String>) {
    let folder = tempfile::tempdir().expect("a folder");
    for name in ["eyx.csv", "exy.csv"] {
        let bend = if name == "eyx.csv" { 7 } else { 5 };
        let text = format!("target_mm,deviation_um\n0,0\n50,{bend}\n100,3\n");
        written(&folder, name, &text);
    }
    let mill = fs::read_to_string(crate::root().join("examples/mill.toml")).expect("read");
    let machine = written(&folder, "m.toml", &mill);
    let drafted = folder.path().join("drafted.toml").display().to_string();
    let lasers = folder.path().display().to_string();
    let call = [
        "calibrate",
        "--draft",
        &lasers,
        "--machine",
        &machine,
        "-o",
        &drafted,
    ];
    let call = call.map(str::to_owned).to_vec();
    (folder, call)
}

/// A draft of two straightnesses, each with a question on which side its point rode.
#[test]
fn the_narrower_answer_counts_whatever_the_order() {
    let (_folder, call) = straightnesses();
    let call: Vec<&str> = call.iter().map(String::as_str).collect();
    let drafted = call[6];
    let rides = |answers: &[&str]| {
        let given: Vec<&str> = answers.iter().flat_map(|a| ["--answer", a]).collect();
        let output = volcomp(&[&call[..], &["--replace"], &given].concat());
        assert_eq!(output.status.code(), Some(0));
        let draft = fs::read_to_string(drafted).expect("the draft");
        let of = |error: &str| {
            let (_, behind) = draft
                .split_once(&format!("error = \"{error}\""))
                .expect(error);
            let (_, value) = behind.split_once("rides = ").expect("a key");
            value
                .lines()
                .next()
                .expect("a value")
                .trim_matches('"')
                .to_owned()
        };
        let told = String::from_utf8_lossy(&output.stderr).replace("\n  ", " ");
        (
            [of("EYX"), of("EXY")].join(" "),
            told.contains("settles nothing"),
        )
    };
    for answers in [
        ["rides=other", "Y:rides=carriage"],
        ["Y:rides=carriage", "rides=other"],
    ] {
        assert_eq!(rides(&answers), ("other carriage".to_owned(), false));
    }
    assert_eq!(
        rides(&["Y:rides=carriage", "EXY:rides=other"]),
        ("? other".to_owned(), true)
    );
    assert_eq!(
        rides(&["rides=other", "rides=carriage"]),
        ("other other".to_owned(), true)
    );
}

fn laser(serial: &str, title: &str) -> String {
    format!(
        "HEADER::\r\nFile Type: rtl\r\nUSER-TEXT::\r\nMachine: Mill 7\r\nSerial No: {serial}\r\nAxis: X\r\nTitle: {title}\r\nTARGET DATA::\r\n\
         Target-count: 3\r\nTargets : 0 100 200\r\nFlags: 1 0 1 1\r\nRUNS::\r\nRun-count: 2\r\nDEVIATIONS::\r\nRun Target Data:\r\n\
         1 1 0.1\r\n1 2 1.5\r\n1 3 2.5\r\n2 3 3.5\r\n2 2 2.0\r\n2 1 1.0\r\nEOF::\r\n"
    )
}

#[test]
fn several_files_end_in_a_table() {
    let folder = tempfile::tempdir().expect("a folder");
    fs::create_dir(folder.path().join("lasers")).expect("made");
    let one = written(&folder, "lasers/exx.rtl", &laser("12", "EXX"));
    let other = written(&folder, "lasers/second.rtl", &laser("13", "EXX once more"));
    written(&folder, "lasers/notes.pdf", "%PDF");
    let lasers = folder.path().join("lasers").display().to_string();
    let shown = text(&["inspect", &lasers]);
    let (_, overview) = shown.split_once("runs ↑ + ↓").expect("a table");
    for row in [
        [
            "exx.rtl",
            "EXX",
            "Mill 7",
            "12",
            "1 + 1",
            "3",
            "0 to 200 mm",
        ],
        [
            "second.rtl",
            "EXX",
            "Mill 7",
            "13",
            "1 + 1",
            "3",
            "0 to 200 mm",
        ],
    ] {
        let found = overview
            .lines()
            .find(|line| line.starts_with(&format!(" {}", row[0])));
        let found = found.expect(row[0]);
        let mut rest = found;
        for cell in row {
            let (_, behind) = rest
                .split_once(cell)
                .unwrap_or_else(|| panic!("{cell}: {found}"));
            rest = behind;
        }
    }
    assert!(
        shown
            .lines()
            .all(|line| line.chars().count() <= 80 || line.contains(&lasers)),
        "{shown}"
    );
    let output = volcomp(&["inspect", &lasers]);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        told.contains("not read") && told.contains("notes.pdf"),
        "{told}"
    );
    // Verdicts at the end, each name once, and the serial numbers.
    let output = volcomp(&["iso230", &one, &other, "--tolerance", "B=1.4,E=1"]);
    let (said, told) = (
        String::from_utf8_lossy(&output.stdout).into_owned(),
        String::from_utf8_lossy(&output.stderr).replace("\n  ", " "),
    );
    assert!(
        told.contains("different serial numbers") && told.contains("`12`") && told.contains("`13`"),
        "{told}"
    );
    assert_eq!(said.matches("reversal error; ").count(), 1, "{said}");
    let (_, verdicts) = said.rsplit_once("verdict").expect("a table");
    assert!(
        verdicts.contains("exx.rtl")
            && verdicts.contains("second.rtl")
            && verdicts.matches("FAIL").count() == 2,
        "{verdicts}"
    );
    // Who is refused is named, for scripts, too.
    let wrong = written(&folder, "lasers/eyy.rtl", "HEADER::\r\n");
    let output = volcomp(&["--json", "iso230", &one, &wrong]);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        told.contains("1 of 2 files are refused: ")
            && told.contains("EOF::")
            && !told.contains("see above"),
        "{told}"
    );
    let empty = tempfile::tempdir().expect("a folder");
    let message = refused(&["inspect", &empty.path().display().to_string()]);
    assert!(
        message.contains("found a folder without files"),
        "{message}"
    );
}

/// The example of a circle is told as one wherever targets are expected; points in space, and tables of readings, are none.
#[test]
fn a_circle_is_told_as_one() {
    let circle = "examples/circle.csv";
    for call in [
        &["inspect", circle][..],
        &["iso230", circle],
        &["fit", circle, "--method", "poly"],
    ] {
        let message = refused(call);
        assert!(
            message.contains("this looks like a circle, which `volcomp iso230 --part 4` evaluates"),
            "{call:?}: {message}"
        );
    }
    let folder = tempfile::tempdir().expect("a folder");
    for (heads, is_circle) in [
        ("angle,deviation,direction", true),
        ("y,z", true),
        ("x,y,z", false),
        ("target,x,y", false),
        ("x,deviation", false),
    ] {
        let row = vec!["1"; heads.split(',').count()].join(",");
        let file = written(&folder, "a.csv", &format!("{heads}\n{row}\n"));
        let message = refused(&["inspect", &file]);
        assert_eq!(
            message.contains("looks like a circle"),
            is_circle,
            "{heads}: {message}"
        );
    }
}
