//! Generates the man pages of the programs from their help into `target/man`.

use std::fs;

use clap::Command;
use clap_mangen::Man;

/// Generates one page for the program and one for each command in its help. `end` is appended only to the program's
/// page, in roff. It contains what help texts do not, such as files and signals.
fn pages(command: Command, section: &str, end: &str) -> Vec<(String, String)> {
    // The pages of the commands replace `help COMMAND`.
    let mut command = command.disable_help_subcommand(true);
    command.build();
    let mut pages = Vec::new();
    for (index, page) in listed(&command).into_iter().enumerate() {
        let man = Man::new(page.clone()).section(section);
        let mut text = Vec::new();
        man.render(&mut text).expect("a Vec takes every byte");
        let mut text = String::from_utf8(text).expect("a page is UTF-8");
        if index == 0 {
            text += end;
        }
        pages.push((man.get_filename(), text));
    }
    pages
}

/// A command and its subcommands of all levels, without hidden ones.
fn listed(command: &Command) -> Vec<&Command> {
    let below = command.get_subcommands().filter(|c| !c.is_hide_set());
    std::iter::once(command).chain(below.flat_map(listed)).collect()
}

/// Writes the man pages of a program to `man` in cargo's target folder, where `docs/build` and packages find them.
///
/// # Panics
/// A command or an option has no help.
pub fn write(command: Command, section: &str, end: &str) {
    check_help(&command);
    let program = std::env::current_exe().expect("this test");
    // The test is target/debug/deps/NAME.
    let target = program.ancestors().nth(3).expect("cargo's target folder");
    let folder = target.join("man");
    fs::create_dir_all(&folder).expect("the folder can be made");
    for (file, text) in pages(command, section, end) {
        fs::write(folder.join(file), text).expect("the page can be written");
    }
}

fn check_help(command: &Command) {
    let name = command.get_name();
    assert!(command.get_about().is_some(), "{name} has no help");
    for argument in command.get_arguments() {
        let has_help = argument.is_hide_set() || argument.get_help().is_some();
        assert!(has_help, "{name}: {} has no help", argument.get_id());
    }
    command.get_subcommands().for_each(check_help);
}
