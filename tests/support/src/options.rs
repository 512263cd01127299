//! Compares the chapter on commands with the options of the programs.

use std::{collections::BTreeSet, fs, process::Command};

/// Sections with options shared by several commands.
const SHARED: [&str; 2] = [
    "For all commands of `volcomp`",
    "Machine, tool, temperatures and positions",
];

/// Checks that every command of a program has a section `## PROGRAM COMMAND` whose tables headed `option` list exactly its options; those of shared
/// sections may be omitted.
pub fn compare_options(program: &str, path: &str) {
    let page = crate::root().join("docs/src/commands.md");
    let page = fs::read_to_string(page).expect("the chapter");
    let mut titles = vec![(program.to_owned(), Vec::new())];
    for command in commands(&help(path, &[])) {
        titles.push((format!("{program} {command}"), vec![command]));
    }
    for (title, call) in &titles {
        let text = help(path, call);
        // A program that requires a command has no section for itself.
        let Some(section) = section(&page, title) else {
            assert!(
                call.is_empty() && titles.len() > 1,
                "commands.md has no section `## {title}`"
            );
            continue;
        };
        let (known, documented) = (known(&text), documented(section));
        let shared: BTreeSet<String> = SHARED
            .iter()
            .filter_map(|title| self::section(&page, title))
            .flat_map(documented_of)
            .collect();
        let foreign: Vec<_> = documented.difference(&known).collect();
        assert!(foreign.is_empty(), "{title} has no {foreign:?}");
        let missing: Vec<_> = known.difference(&documented).collect();
        let missing: Vec<_> = missing.iter().filter(|o| !shared.contains(**o)).collect();
        assert!(
            missing.is_empty(),
            "commands.md, `## {title}` does not say {missing:?}"
        );
    }
}

fn help(path: &str, call: &[String]) -> String {
    let output = Command::new(path).args(call).arg("--help").output();
    String::from_utf8(output.expect("the program was built for this test").stdout).expect("UTF-8")
}

/// Commands listed in a help text.
fn commands(help: &str) -> Vec<String> {
    let list = help.lines().skip_while(|line| *line != "Commands:").skip(1);
    list.take_while(|line| !line.is_empty())
        // Lines with deeper indentation continue the previous command.
        .filter(|line| line.starts_with("  ") && !line.starts_with("   "))
        .filter_map(|line| line.split_whitespace().next())
        .filter(|name| *name != "help")
        .map(str::to_owned)
        .collect()
}

/// Options listed in a help text.
fn known(help: &str) -> BTreeSet<String> {
    let lines = help.lines().map(str::trim_start);
    lines
        .filter(|line| line.starts_with('-'))
        .filter_map(|line| line.split_whitespace().find(|word| word.starts_with("--")))
        .map(|word| word.trim_end_matches([',', '.']).to_owned())
        .collect()
}

/// The text below a second-level heading.
fn section<'a>(page: &'a str, title: &str) -> Option<&'a str> {
    let heading = format!("\n## {title}\n");
    let (_, rest) = page.split_once(&heading)?;
    Some(rest.split("\n## ").next().unwrap_or(rest))
}

fn documented(section: &str) -> BTreeSet<String> {
    documented_of(section).collect()
}

/// Options in the first column of the tables headed `option`.
fn documented_of(section: &str) -> impl Iterator<Item = String> {
    let mut of_options = false;
    let mut options = Vec::new();
    for line in section.lines() {
        let Some(row) = line.strip_prefix('|') else {
            of_options = false;
            continue;
        };
        let cell = row.split('|').next().unwrap_or("").trim();
        of_options |= cell == "option";
        if of_options {
            let quoted = cell.split('`').skip(1).step_by(2);
            let words = quoted.filter_map(|code| code.split_whitespace().next());
            options.extend(
                words
                    .filter(|word| word.starts_with("--"))
                    .map(str::to_owned),
            );
        }
    }
    options.into_iter()
}
