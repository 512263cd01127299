//! Every command's help has two examples, and every example runs.

use std::{fs, process::Command, sync::Arc};

use volcomp_focas::simulator::{Options, Simulator, World};

use crate::{Folder, json, root, text};

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
