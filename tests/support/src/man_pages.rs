//! Holds the man pages in `docs/man` to the programs that they describe.

use std::{collections::BTreeSet, fs};

use clap::Command;
use clap_mangen::Man;

/// Makes one page for the program and one for each command that its help lists. `end` stands in the program's own page
/// only, in roff: what a man page says and a help text does not, such as files and signals.
fn pages(command: Command, section: &str, end: &str) -> Vec<(String, String)> {
    // The pages of the commands say what `help COMMAND` says.
    let mut command = command.disable_help_subcommand(true);
    command.build();
    let listed = command.get_subcommands().filter(|c| !c.is_hide_set());
    let mut pages = Vec::new();
    for (index, page) in std::iter::once(&command).chain(listed).enumerate() {
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

/// Fails unless the pages of the program in `docs/man` are those of its command line, and there are no others of it.
/// Where the environment variable `VOLCOMP_WRITE` is set, the pages are written again: `VOLCOMP_WRITE=1 cargo test
/// man_pages`. `others` are programs whose names begin with this one's.
pub fn compare(command: Command, section: &str, end: &str, others: &[&str]) {
    let folder = crate::root().join("docs/man");
    let program = command.get_name().to_owned();
    let pages = pages(command, section, end);
    let write = std::env::var_os("VOLCOMP_WRITE").is_some();
    for (file, text) in &pages {
        let path = folder.join(file);
        if write {
            fs::write(&path, text).expect("the page can be written");
        }
        let kept = fs::read_to_string(&path).unwrap_or_default();
        assert!(
            kept == *text,
            "docs/man/{file} differs from the help of {program}; write it again: VOLCOMP_WRITE=1 cargo test man_pages"
        );
    }
    let made: BTreeSet<&str> = pages.iter().map(|(file, _)| file.as_str()).collect();
    let is_of = |file: &str, program: &str| {
        let rest = file.strip_prefix(program).unwrap_or(".");
        file.starts_with(program) && (rest.starts_with('.') || rest.starts_with('-'))
    };
    for entry in fs::read_dir(&folder).expect("docs/man is there") {
        let name = entry.expect("an entry of docs/man").file_name();
        let file = name.to_str().expect("a name in UTF-8");
        let ours = is_of(file, &program) && !others.iter().any(|other| is_of(file, other));
        assert!(
            !ours || made.contains(file),
            "docs/man/{file} is of a command that is gone"
        );
    }
}
