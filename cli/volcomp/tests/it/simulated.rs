//! `volcomp simulate`: written files, protected files, and the commands to run next.

use std::{
    collections::BTreeMap,
    fs,
    path::Path,
    process::{Command, Output},
};

use serde_json::Value;

/// Scale and squareness errors, which are completely determined by lines and observations.
const TRUTH: &str = "structure = \"w X' b Y Z t\"
[axes]
X.travel = [0, 500]
Y.travel = [0, 400]
Z.travel = [0, 300]
[errors]
EXX = { poly = [0.0, 0.04] }
EYY = { poly = [0.0, -0.03] }
EZZ = { poly = [0.0, 0.05] }
EC0Y = 60.0
EA0Z = -40.0
EB0Z = 50.0
";

const LINES: &str = "[[measurement]]\nerrors = [\"EXX\", \"EYY\", \"EZZ\"]\n";
const OBSERVED: &str =
    "[[observation]]\nkind = \"points\"\nframe = [900, -500, 200, 0, 0, 120]\nposes = 40\n";
const UNKNOWN: &str = "unknown = [\"EC0Y\", \"EA0Z\", \"EB0Z\"]\n";

fn run(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_volcomp"))
        .args(arguments)
        .current_dir(folder)
        .output()
        .expect("the program was built for this test")
}

fn written(folder: &Path) -> BTreeMap<String, String> {
    let entries = fs::read_dir(folder).expect("a folder");
    let files = entries.map(|entry| {
        let path = entry.expect("an entry").path();
        let name = path.file_name().expect("a name").display().to_string();
        (name, fs::read_to_string(&path).expect("text"))
    });
    files.collect()
}

fn simulated(folder: &Path, shop: &str, output: &str) -> Output {
    run(folder, &["simulate", shop, "-o", output])
}

#[test]
fn what_the_shop_reads_is_not_written_over() {
    for (truth, shop, plan, name) in [
        ("machine.toml", "shop.toml", "", "machine.toml"),
        ("truth.toml", "calibration.toml", "", "calibration.toml"),
        ("truth.toml", "observations.toml", "", "observations.toml"),
        // `calibrated.toml` is written by the next command.
        ("calibrated.toml", "shop.toml", "", "calibrated.toml"),
        ("truth.toml", "shop.toml", "points.csv", "points.csv"),
    ] {
        let folder = tempfile::tempdir().expect("a folder");
        let folder = folder.path();
        let mut text = format!("machine = \"{truth}\"\n{UNKNOWN}{LINES}{OBSERVED}");
        if !plan.is_empty() {
            text = text.replace("poses = 40", &format!("poses = \"{plan}\""));
            fs::write(folder.join(plan), "X\n0\n250\n500\n").expect("written");
        }
        fs::write(folder.join(truth), TRUTH).expect("written");
        fs::write(folder.join(shop), text).expect("written");
        let before = written(folder);
        for output in [".", "./", &folder.display().to_string()] {
            let refused = simulated(folder, shop, output);
            let message = String::from_utf8_lossy(&refused.stderr).into_owned();
            assert_eq!(refused.status.code(), Some(2), "{message}");
            let expected = format!(
                "--output {output}: {name} would be written over {name}, which this shop reads; expected another folder"
            );
            assert!(message.contains(&expected), "{message}");
            assert_eq!(written(folder), before, "{name}");
        }
        let elsewhere = simulated(folder, shop, "elsewhere");
        assert_eq!(elsewhere.status.code(), Some(0), "{name}");
        for (name, text) in &before {
            let now = fs::read_to_string(folder.join(name)).expect("still there");
            assert_eq!(now, *text);
        }
    }
}

#[cfg(unix)]
#[test]
fn a_link_to_an_input_is_not_written_over() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    fs::write(folder.join("truth.toml"), TRUTH).expect("written");
    fs::write(folder.join("shop.toml"), format!("machine = \"truth.toml\"\n{LINES}"))
        .expect("written");
    fs::create_dir(folder.join("out")).expect("made");
    std::os::unix::fs::symlink("../truth.toml", folder.join("out/machine.toml")).expect("linked");
    assert_eq!(simulated(folder, "shop.toml", "out").status.code(), Some(2));
    let names: Vec<String> = written(&folder.join("out")).into_keys().collect();
    assert_eq!(names, ["machine.toml"]);
}

#[test]
fn files_of_an_earlier_run_are_counted() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    fs::write(folder.join("truth.toml"), TRUTH).expect("written");
    let shop = |lines: &str| {
        let text = format!("machine = \"truth.toml\"\n{lines}");
        fs::write(folder.join("shop.toml"), text).expect("written");
        let output = simulated(folder, "shop.toml", "out");
        String::from_utf8(output.stdout).expect("UTF-8")
    };
    let first = shop("[[measurement]]\nerror = \"EXX\"\n");
    assert!(first.starts_with("3 files in out\n"), "{first}");
    let second = shop(LINES);
    let expected = "5 files in out, 3 of them over earlier ones\n";
    assert!(second.starts_with(expected), "{second}");
    let output = run(folder, &["--json", "simulate", "shop.toml", "-o", "out"]);
    let document: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(document["replaced"], document["files"]);
}

/// A foreign or edited file is not overwritten, and the run writes no file.
#[test]
fn files_of_others_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    fs::write(folder.join("truth.toml"), TRUTH).expect("written");
    let shop = |seed: u8| {
        let text = format!(
            "machine = \"truth.toml\"\nseed = {seed}\n{UNKNOWN}[instrument]\nnoise_um = 1.0\n{LINES}{OBSERVED}noise_um = 1.0\n"
        );
        fs::write(folder.join("shop.toml"), text).expect("written");
        simulated(folder, "shop.toml", "out")
    };
    let refused = |seed: u8, name: &str| {
        let before = written(&folder.join("out"));
        let output = shop(seed);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{name}: {message}");
        let expected = format!("out/{name}: found a file that `volcomp simulate` did not write");
        let message = message.replace('\\', "/");
        assert!(message.contains(&expected), "{message}");
        assert_eq!(written(&folder.join("out")), before, "{name}");
    };
    let out = folder.join("out");
    fs::create_dir(&out).expect("made");
    for name in ["machine.toml", "exx.rtl", "points.csv", "simulated-files.sha256"] {
        fs::write(out.join(name), "structure = \"by hand\"\n").expect("written");
        refused(1, name);
        fs::remove_file(out.join(name)).expect("removed");
    }
    for seed in [1, 2, 2] {
        assert_eq!(shop(seed).status.code(), Some(0));
    }
    // The user has replaced simulated readings.
    let own = written(&out)["points.csv"].clone() + "\n";
    fs::write(out.join("points.csv"), own).expect("written");
    refused(3, "points.csv");
    fs::remove_file(out.join("points.csv")).expect("removed");
    assert_eq!(shop(3).status.code(), Some(0));
    // Without the list of checksums, files identical to this run's files may be overwritten. Files of another run may
    // not.
    fs::remove_file(out.join("simulated-files.sha256")).expect("removed");
    assert_eq!(shop(3).status.code(), Some(0));
    fs::remove_file(out.join("simulated-files.sha256")).expect("removed");
    refused(4, "exx.rtl");
    let help = run(folder, &["simulate", "--help"]);
    let help = String::from_utf8_lossy(&help.stdout).into_owned();
    assert!(help.contains("simulated-files.sha256"), "{help}");
}

#[test]
fn the_demo_writes_over_no_files_of_others() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    fs::write(folder.join("shop.toml"), "by hand\n").expect("written");
    let refused = run(folder, &["demo", "-o", "."]);
    assert_eq!(refused.status.code(), Some(2), "{refused:?}");
    assert_eq!(written(folder).len(), 1);
    fs::remove_file(folder.join("shop.toml")).expect("removed");
    for curve in ["poly", "mls"] {
        let again = run(folder, &["demo", "-o", ".", "--curve", curve]);
        assert_eq!(again.status.code(), Some(0), "{again:?}");
    }
}

/// Runs the printed commands; returns the ranges of the body diagonals on the truth after correction by the last machine file.
fn ranges_after_the_printed_commands(lines: &str, output: &str) -> Vec<f64> {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    fs::create_dir(folder.join("plans")).expect("made");
    fs::write(folder.join("plans/truth.toml"), TRUTH).expect("written");
    let text = format!("machine = \"truth.toml\"\nseed = 4\n{lines}");
    fs::write(folder.join("plans/shop.toml"), text).expect("written");
    let printed = simulated(folder, "plans/shop.toml", output);
    let printed = String::from_utf8(printed.stdout).expect("UTF-8");
    let commands: Vec<&str> = printed
        .lines()
        .filter_map(|line| {
            let next = line.strip_prefix("next: ");
            next.or_else(|| line.strip_prefix("then: "))
        })
        .collect();
    assert!(!commands.is_empty(), "{printed}");
    for command in &commands {
        // Splits words like a shell: double quotes keep a path together.
        let mut quoted = false;
        let words: Vec<String> = command
            .split(|c: char| {
                quoted ^= c == '"';
                c == ' ' && !quoted
            })
            .map(|word| word.replace('"', ""))
            .collect();
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        assert_eq!(words[0], "volcomp");
        let output = run(folder, &words[1..]);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(0), "{command}: {message}");
    }
    let judged = run(
        folder,
        &[
            "--json",
            "diagonals",
            "--machine",
            "MACHINE.toml",
            "--compensated",
            "--truth",
            "plans/truth.toml",
        ],
    );
    let document: Value = serde_json::from_slice(&judged.stdout).expect("JSON");
    ["PPP", "NPP", "PNP", "PPN"]
        .map(|name| document[name]["range_um"].as_f64().expect("a number"))
        .to_vec()
}

#[test]
fn the_printed_commands_lead_to_a_good_machine() {
    let largest = |ranges: Vec<f64>| ranges.into_iter().fold(0.0, f64::max);
    // Lines and observations together determine all errors.
    for output in ["out", "plans/out", ".", "a folder/with blanks"] {
        let all = format!("{UNKNOWN}{LINES}{OBSERVED}");
        let left = largest(ranges_after_the_printed_commands(&all, output));
        assert!(left < 0.05, "{output}: {left}");
    }
    // Observations alone, with all errors as unknowns.
    let unknown = "unknown = [\"EC0Y\", \"EA0Z\", \"EB0Z\", { error = \"EXX\", legendre = 1 }, { error = \"EYY\", legendre = 1 }, { error = \"EZZ\", legendre = 1 }]\n";
    let alone = format!("{unknown}{OBSERVED}");
    let left = largest(ranges_after_the_printed_commands(&alone, "out"));
    assert!(left < 0.05, "{left}");
    // Without observations the squareness errors remain.
    let left = largest(ranges_after_the_printed_commands(LINES, "out"));
    assert!(left > 10.0, "{left}");
}

#[cfg(unix)]
#[test]
fn printed_commands_keep_paths_in_one_word() {
    let folder = tempfile::tempdir().expect("a folder");
    fs::write(folder.path().join("truth.toml"), TRUTH).expect("written");
    let shop = format!("machine = \"truth.toml\"\n{LINES}");
    fs::write(folder.path().join("shop.toml"), shop).expect("written");
    for name in [
        "plain",
        "~",
        "~root",
        "a~b",
        "back\\slash",
        "back\\\\slash and \\ space",
        "~ space",
        "-dash",
        "with space",
        "a $HOME `id` $(id)",
        "it's \"so\"",
        "a;b&c|d*?",
    ] {
        let output = format!("--output={name}");
        let output = run(folder.path(), &["--json", "simulate", "shop.toml", &output]);
        let answer: Value = serde_json::from_slice(&output.stdout).expect("JSON");
        let command = answer["next"][0].as_str().expect("a command");
        // A real shell splits the command.
        let script = format!("volcomp() {{ printf '%s' \"$2\"; }}\n{command}\n");
        let output = std::process::Command::new("sh").args(["-c", &script]).output();
        let output = output.expect("a shell");
        let read = String::from_utf8(output.stdout).expect("UTF-8");
        let dash = if name.starts_with('-') { "./" } else { "" };
        assert_eq!(read, format!("{dash}{name}/calibration.toml"), "{command}");
        assert!(folder.path().join(read).exists(), "{command}");
    }
}
