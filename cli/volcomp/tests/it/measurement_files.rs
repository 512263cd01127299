//! Measurement files of several kinds: the output of `inspect`, and the calibration draft from a folder.

use std::fs;

use serde_json::Value;

use crate::{Folder, contains, json, list, refuse_each, refused, refuses, root, text, volcomp};

const SHOP: &str = "cli/volcomp/demo/shop.toml";

#[test]
fn inspect_takes_several_files_and_tells_the_odd_ones() {
    let folder = Folder::new();
    let good = folder.write("exx.csv", "target_mm,deviation_um\n0,1\n10,2\n20,4\n");
    let same = folder.write("eyy.csv", "target_mm,deviation_um\n0,-1\n10,-2\n20,-4\n");
    let cut = folder.write("ezz.rtl", "HEADER::\r\nFile type : rtl\r\n");
    let log =
        folder.write("x.log", "A:POS 2026-03-14 10:00:00.5 1.5\nA:POS 2026-03-14 10:00:01.5 2.5\n");
    let output = volcomp(&["--json", "inspect", &good, &same, &cut, &log]);
    assert_eq!(output.status.code(), Some(2));
    let document: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let files = list(&document["files"]);
    assert_eq!(files.len(), 4);
    assert_eq!(files[0]["kind"], "table");
    assert_eq!(files[0]["warnings"], Value::Array(Vec::new()));
    assert!(files[1]["warnings"][0].as_str().expect("a text").contains("the same readings as"));
    assert!(files[2]["error"].as_str().expect("a text").contains("EOF::"));
    assert_eq!(files[3]["channels"][0]["max"], 2.5);
    let shown = text(&["inspect", &good, &log]);
    contains(&shown, "measured minus target");
    contains(&shown, "A:POS: 2 values from 1.5 to 2.5");
    assert_eq!(text(&["inspect", &same]).matches("WARNING").count(), 0);
    assert!(refused(&["inspect", &cut]).contains("ezz.rtl:"));
}

/// Names and headers of the virtual shop's files state the error, but not the position of the line. The draft asks for
/// this position.
#[test]
fn a_folder_becomes_a_draft_that_asks_before_it_is_calibrated() {
    let folder = Folder::new();
    let lasers = folder.path().display().to_string();
    json(&["simulate", SHOP, "-o", &lasers]);
    let [machine, drafted, result] = ["machine.toml", "drafted.toml", "result.toml"]
        .map(|name| folder.path().join(name).display().to_string());
    let call = ["calibrate", "--draft", &lasers, "--machine", &machine, "-o", &drafted];
    let document = json(&call);
    let measurements = list(&document["measurements"]);
    let files = fs::read_dir(folder.path()).expect("a folder").count();
    assert!(measurements.len() > 10 && measurements.len() < files, "{}", measurements.len());
    assert!(measurements.iter().all(|of| of["error"].is_string()), "{measurements:?}");
    let questions = list(&document["questions"]);
    assert!(questions.iter().any(|asked| asked["key"] == "point"));
    let message = refused(&["calibrate", &drafted, "-o", &result]);
    contains(&message, "open question");
    contains(&message, "drafted.toml:");
    // An unchanged draft is overwritten. An edited draft is overwritten only with `--replace`.
    json(&call);
    let draft = fs::read_to_string(&drafted).expect("the draft");
    let answered = draft.replacen("\"?\"", "0.0", 1);
    assert_ne!(answered, draft);
    fs::write(&drafted, &answered).expect("written");
    let message = refused(&call);
    contains(&message, "drafted.toml: the file is there");
    contains(&message, "expected another file, or --replace");
    let kept = || fs::read_to_string(&drafted).expect("the draft");
    assert_eq!(kept(), answered);
    json(&[&call[..], &["--replace"]].concat());
    assert_eq!(kept(), draft);
    assert!(refused(&["calibrate", &drafted, "--replace", "-o", &result]).contains("--draft"));
    // The draft must not overwrite a source file.
    let laser = folder.file("exx.rtl");
    let call = ["calibrate", "--draft", &lasers, "--machine", &machine, "-o", &laser];
    assert!(refused(&call).contains("expected another file"));
    assert!(refused(&["calibrate", "--draft", &lasers, "-o", &drafted]).contains("--machine"));
    let empty = Folder::new();
    let nothing = empty.path().display().to_string();
    let call = format!("calibrate --draft {nothing} --machine {machine} -o {drafted}");
    assert!(refused(&call).contains("it holds no files"));
}

/// One call answers the error and the questions that follow from the error. An answer that does not apply to the error
/// gets a note.
#[test]
fn an_error_is_answered_in_one_call_with_what_follows() {
    let folder = Folder::new();
    let scan = "target_mm,run,direction,deviation_um\n0,1,+,0\n150,1,+,6\n300,1,+,8\n450,1,+,6\n600,1,+,0\n";
    fs::write(folder.path().join("scan.csv"), scan).expect("written");
    let [files, drafted] =
        ["", "drafted.toml"].map(|name| folder.path().join(name).display().to_string());
    let call = format!(
        "calibrate --draft {files} --machine examples/calibration/machine.toml --replace -o {drafted}"
    );
    let answered = json(&format!("{call} --answer at.X=0 --answer error=EXX"));
    assert!(answered["warnings"].to_string().contains("at.X is no question for EXX"), "{answered}");
    let answered = json(&format!("{call} --answer EZX:sign=-1 --answer error=EZX"));
    assert_eq!(answered["measurements"][0]["error"], "EZX");
    let text = fs::read_to_string(&drafted).expect("the draft");
    contains(&text, "\nsign = -1\n");
}

/// A folder with two straightness files and a mill, and the call that drafts a calibration from them.
fn straightnesses() -> (Folder, Vec<String>) {
    let folder = Folder::new();
    for name in ["eyx.csv", "exy.csv"] {
        let bend = if name == "eyx.csv" { 7 } else { 5 };
        let text = format!("target_mm,deviation_um\n0,0\n50,{bend}\n100,3\n");
        folder.write(name, &text);
    }
    let mill = fs::read_to_string(root().join("examples/mill.toml")).expect("read");
    let machine = folder.write("m.toml", &mill);
    let drafted = folder.file("drafted.toml");
    let lasers = folder.path().display().to_string();
    let call = ["calibrate", "--draft", &lasers, "--machine", &machine, "-o", &drafted];
    let call = call.map(str::to_owned).to_vec();
    (folder, call)
}

/// The draft of two straightness files asks which side the measured point moves with. The answer for one error
/// overrides the answer for an axis, whatever their order.
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
            let (_, behind) = draft.split_once(&format!("error = \"{error}\"")).expect(error);
            let (_, value) = behind.split_once("rides = ").expect("a key");
            value.lines().next().expect("a value").trim_matches('"').to_owned()
        };
        let told = String::from_utf8_lossy(&output.stderr).replace("\n  ", " ");
        ([of("EYX"), of("EXY")].join(" "), told.contains("settles nothing"))
    };
    for answers in [["rides=other", "Y:rides=carriage"], ["Y:rides=carriage", "rides=other"]] {
        assert_eq!(rides(&answers), ("other carriage".to_owned(), false));
    }
    assert_eq!(rides(&["Y:rides=carriage", "EXY:rides=other"]), ("? other".to_owned(), true));
    assert_eq!(rides(&["rides=other", "rides=carriage"]), ("other other".to_owned(), true));
}

/// An answer about the lever of an error without a file is refused, since the error may be misspelt.
#[test]
fn a_lever_of_an_error_without_a_file_is_refused() {
    let (_folder, call) = straightnesses();
    let call: Vec<&str> = call.iter().map(String::as_str).collect();
    let call = [&call[..], &["--answer", "EZZ:rides=other"]].concat();
    contains(&refused(&call), "--answer EZZ:rides=other: no question is open for it");
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
    let folder = Folder::new();
    fs::create_dir(folder.path().join("lasers")).expect("made");
    let one = folder.write("lasers/exx.rtl", laser("12", "EXX"));
    let other = folder.write("lasers/second.rtl", laser("13", "EXX once more"));
    folder.write("lasers/notes.pdf", "%PDF");
    let lasers = folder.file("lasers");
    let shown = text(&["inspect", &lasers]);
    let (_, overview) = shown.split_once("runs ↑ + ↓").expect("a table");
    for row in [
        ["exx.rtl", "EXX", "Mill 7", "12", "1 + 1", "3", "0 to 200 mm"],
        ["second.rtl", "EXX", "Mill 7", "13", "1 + 1", "3", "0 to 200 mm"],
    ] {
        let found = overview.lines().find(|line| line.starts_with(&format!(" {}", row[0])));
        let found = found.expect(row[0]);
        let mut rest = found;
        for cell in row {
            let (_, behind) = rest.split_once(cell).unwrap_or_else(|| panic!("{cell}: {found}"));
            rest = behind;
        }
    }
    assert!(
        shown.lines().all(|line| line.chars().count() <= 80 || line.contains(&lasers)),
        "{shown}"
    );
    let output = volcomp(&["inspect", &lasers]);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    contains(&told, "not read");
    contains(&told, "notes.pdf");
    // The output ends with the verdicts, each under its name once, and a note on different serial numbers.
    let output = volcomp(&["iso230", &one, &other, "--tolerance", "B=1.4,E=1"]);
    let (said, told) = (
        String::from_utf8_lossy(&output.stdout).into_owned(),
        String::from_utf8_lossy(&output.stderr).replace("\n  ", " "),
    );
    contains(&told, "different serial numbers");
    contains(&told, "`12`");
    contains(&told, "`13`");
    assert_eq!(said.matches("reversal error; ").count(), 1, "{said}");
    let (_, verdicts) = said.rsplit_once("verdict").expect("a table");
    assert!(
        verdicts.contains("exx.rtl")
            && verdicts.contains("second.rtl")
            && verdicts.matches("FAIL").count() == 2,
        "{verdicts}"
    );
    let wrong = folder.write("lasers/eyy.rtl", "HEADER::\r\n");
    let output = volcomp(&["--json", "iso230", &one, &wrong]);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        told.contains("1 of 2 files are refused: ")
            && told.contains("EOF::")
            && !told.contains("see above"),
        "{told}"
    );
    let empty = Folder::new();
    refuses(&["inspect", &empty.path().display().to_string()], "found a folder without files");
}

#[test]
fn a_circle_is_told_as_one() {
    refuse_each(
        "\
inspect examples/circle.csv => this looks like a circle, which `volcomp iso230 --part 4` evaluates
iso230 examples/circle.csv => looks like a circle
fit examples/circle.csv --method poly => looks like a circle",
        &[],
    );
    let folder = Folder::new();
    for (table, is_circle) in [
        ("angle,deviation,direction\n1,1,1\n", true),
        ("y,z\n1,1\n", true),
        ("x,y,z\n1,1,1\n", false),
        ("target,x,y\n1,1,1\n", false),
        ("x,deviation\n1,1\n", false),
    ] {
        let message = refused(&["inspect", &folder.write("a.csv", table)]);
        assert_eq!(message.contains("looks like a circle"), is_circle, "{table}: {message}");
    }
}
