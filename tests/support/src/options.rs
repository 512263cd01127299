//! The options in the book's chapter on commands, generated from the definitions of the command lines.

use std::fmt::Write as _;

use clap::{Arg, Command, builder::StyledStr};

const BEGIN: &str = "<!--options ";
const END: &str = "<!--end-->";

/// Compares the blocks of a program in `docs/src/commands.md` with its options; with `UPDATE=1` rewrites them.
///
/// A block is between `<!--options PROGRAM COMMAND-->` and `<!--end-->`: the usage, and a table of arguments and
/// options. A block `<!--options PROGRAM COMMAND --option …-->` has a table of these options alone; rows of such a
/// table are left out of the other blocks of the program.
///
/// # Panics
/// The page differs, or a command has no block.
pub fn compare(command: Command) {
    let path = crate::root().join("docs/src/commands.md");
    let page = std::fs::read_to_string(&path).expect("the chapter");
    let mut program = command.disable_help_subcommand(true);
    program.build();
    let expected = rendered(&page, &program);
    if expected == page {
        return;
    }
    if std::env::var_os("UPDATE").is_some() {
        std::fs::write(&path, expected).expect("the chapter can be written");
        return;
    }
    let mut lines = page.lines().zip(expected.lines());
    let different = lines.find(|(found, expected)| found != expected);
    panic!("{}: found, expected: {different:#?}\nrun this test with UPDATE=1", path.display());
}

/// The page with regenerated blocks of one program.
fn rendered(page: &str, program: &Command) -> String {
    let blocks = || page.split(BEGIN).skip(1).filter_map(|block| block.split_once("-->"));
    let mut shared = Vec::new();
    for (title, _) in blocks() {
        let (names, options) = words(title);
        if let Some(command) = find(program, &names) {
            let named = command.get_arguments().filter(|a| options.contains(&long(a)));
            shared.extend(named.map(row));
        }
    }
    let visible = program.get_subcommands().filter(|c| !c.is_hide_set());
    for command in visible {
        let name = [program.get_name(), command.get_name()].map(str::to_owned);
        let is_there = blocks().any(|(title, _)| words(title) == (name.to_vec(), Vec::new()));
        assert!(is_there, "commands.md has no `{BEGIN}{}-->`", name.join(" "));
    }
    let mut parts = page.split(BEGIN);
    let mut text = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        text += BEGIN;
        let title = part.split("-->").next().unwrap_or_default();
        let (names, options) = words(title);
        match (find(program, &names), part.split_once(END)) {
            (Some(command), Some((_, rest))) => {
                let table = table(command, &options, &shared);
                write!(text, "{title}-->\n{table}{END}{rest}").expect("text");
            }
            (Some(_), None) => panic!("commands.md: `{BEGIN}{title}-->` without `{END}`"),
            (None, _) => text += part,
        }
    }
    text
}

fn words(title: &str) -> (Vec<String>, Vec<String>) {
    let words = title.split_whitespace().map(str::to_owned);
    words.partition(|word| !word.starts_with('-'))
}

fn find<'a>(program: &'a Command, names: &[String]) -> Option<&'a Command> {
    let (name, commands) = names.split_first()?;
    let mut commands = commands.iter();
    commands.try_fold((name == program.get_name()).then_some(program)?, |found, name| {
        found.find_subcommand(name)
    })
}

/// The usage and the table of arguments and options. If `options` is not empty, only a table of these options.
fn table(command: &Command, options: &[String], shared: &[String]) -> String {
    let arguments = command.get_arguments().filter(|a| {
        let is_built_in = ["help", "version"].contains(&a.get_id().as_str());
        !a.is_hide_set() && !is_built_in
    });
    let (positional, named): (Vec<_>, Vec<_>) = arguments.partition(|a| a.is_positional());
    let rows = positional.into_iter().chain(named);
    let (usage, rows): (_, Vec<String>) = if options.is_empty() {
        let usage = command.clone().render_usage().to_string();
        let usage = usage.replace(" [OPTIONS]", "");
        let usage = usage.trim_start_matches("Usage: ").lines().map(str::trim);
        let usage = usage.map(|line| format!("`{line}`\n"));
        (usage.collect(), rows.map(row).filter(|row| !shared.contains(row)).collect())
    } else {
        let rows = rows.filter(|a| options.contains(&long(a)));
        (String::new(), rows.map(row).collect())
    };
    if rows.is_empty() {
        return usage;
    }
    let blank = if usage.is_empty() { "" } else { "\n" };
    format!("{usage}{blank}|option|meaning|\n|---|---|\n{}", rows.concat())
}

fn long(argument: &Arg) -> String {
    format!("--{}", argument.get_long().unwrap_or_default())
}

/// Row of an argument or option: its names and value, and its help with default and possible values.
fn row(argument: &Arg) -> String {
    let mut names: Vec<String> = Vec::new();
    names.extend(argument.get_short().map(|short| format!("-{short}")));
    names.extend(argument.get_long().map(|long| format!("--{long}")));
    let aliases = argument.get_visible_aliases().unwrap_or_default();
    names.extend(aliases.iter().map(|alias| format!("--{alias}")));
    let takes_value = argument.get_action().takes_values();
    let values = argument.get_value_names().unwrap_or_default();
    let values: Vec<String> = values.iter().map(|value| format!("<{value}>")).collect();
    if takes_value {
        match names.last_mut() {
            Some(last) => write!(last, " {}", values.join(" ")).expect("text"),
            None => names.push(values.join(" ")),
        }
    }
    let names: Vec<String> = names.iter().map(|name| format!("`{name}`")).collect();
    let help = argument.get_help().map(StyledStr::to_string).unwrap_or_default();
    let mut cell = help.replace('\n', " ");
    let defaults = argument.get_default_values();
    if takes_value && !argument.is_hide_default_value_set() && !defaults.is_empty() {
        let defaults: Vec<_> = defaults.iter().map(|value| value.to_string_lossy()).collect();
        write!(cell, " [default: {}]", defaults.join(" ")).expect("text");
    }
    let possible: Vec<String> = argument
        .get_possible_values()
        .iter()
        .filter(|value| takes_value && !value.is_hide_set())
        .map(|value| match value.get_help() {
            Some(help) => format!("{} ({help})", value.get_name()),
            None => value.get_name().to_owned(),
        })
        .collect();
    if !possible.is_empty() {
        write!(cell, " [{}]", possible.join(", ")).expect("text");
    }
    let [names, cell] = [names.join(", "), cell].map(|text| text.replace('|', "\\|"));
    format!("|{names}|{cell}|\n")
}
