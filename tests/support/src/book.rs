//! Reads the book and the README files for tests that compare them with the code.

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
};

use crate::root;

const UNKNOWN: &str = "zzz_unknown";

/// A fenced block of a page.
pub struct Block {
    /// `docs/src/gateway.md:12`, the line of the opening fence.
    pub place: String,
    /// Info string of the opening fence: `toml`, `console,ignore`.
    pub info: String,
    /// Content between the fences, with included files inserted.
    pub text: String,
}

impl Block {
    /// First line without its `#`, which states the kind of a TOML block: `machine file`.
    pub fn label(&self) -> &str {
        let first = self.text.lines().next().unwrap_or("");
        first.trim_start_matches('#').trim()
    }

    /// True if the block states this kind; more words may follow.
    pub fn is(&self, kind: &str) -> bool {
        self.info == "toml" && self.label().starts_with(kind)
    }
}

/// Path of a chapter of the book.
pub fn chapter(name: &str) -> PathBuf {
    root().join("docs/src").join(name)
}

/// Every chapter and every README file.
pub fn pages() -> Vec<PathBuf> {
    let mut pages = Vec::new();
    let mut folders = vec![root()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("a folder of the repository") {
            let path = entry.expect("an entry of the folder").path();
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            if path.is_dir() && name != "target" && !name.starts_with('.') {
                folders.push(path);
            } else if name == "README.md"
                || (folder.ends_with("docs/src") && path.extension().is_some_and(|e| e == "md"))
            {
                pages.push(path);
            }
        }
    }
    pages.sort();
    pages
}

/// The fenced blocks of a page in their order.
pub fn blocks(page: &Path) -> Vec<Block> {
    let text = fs::read_to_string(page).expect("a page");
    let name = page.strip_prefix(root()).unwrap_or(page).display();
    let mut blocks = Vec::new();
    let mut open: Option<(String, usize, Block)> = None;
    for (index, line) in text.lines().enumerate() {
        let marks = line.trim_start().chars().take_while(|c| *c == '`').count();
        match &mut open {
            None if marks >= 3 => {
                let block = Block {
                    place: format!("{name}:{}", index + 1),
                    info: line.trim_start()[marks..].trim().to_owned(),
                    text: String::new(),
                };
                open = Some(("`".repeat(marks), line.len() - line.trim_start().len(), block));
            }
            Some((fence, indent, block)) => {
                if line.trim() == fence {
                    blocks.extend(open.take().map(|(_, _, block)| block));
                } else {
                    let line = line.get(*indent..).unwrap_or("");
                    block.text += &included(line, page, &block.place);
                    block.text.push('\n');
                }
            }
            None => {}
        }
    }
    assert!(open.is_none(), "{name}: a block is not closed");
    for block in &blocks {
        let place = &block.place;
        assert!(!block.info.is_empty(), "{place}: a block without a language, expected text");
    }
    blocks
}

/// Returns the line or, if it includes a file, the content of the file.
fn included(line: &str, page: &Path, place: &str) -> String {
    let named = line.trim().strip_prefix("{{#include ");
    let Some(named) = named.and_then(|rest| rest.strip_suffix("}}")) else {
        return line.to_owned();
    };
    let file = page.parent().unwrap_or(page).join(named.trim());
    let text = fs::read_to_string(&file).unwrap_or_else(|e| panic!("{place}: {named}: {e}"));
    text.trim_end().to_owned()
}

/// Keys that a page documents: the texts in back quotes in the first column of every table whose first head is `key`.
pub fn documented_keys(page: &Path) -> BTreeSet<String> {
    first_column(page, "key")
}

/// Texts in back quotes in the first column of every table of the page whose first column has this heading.
pub fn first_column(page: &Path, head: &str) -> BTreeSet<String> {
    let text = fs::read_to_string(page).expect("a page");
    let mut keys = BTreeSet::new();
    let mut is_meant = false;
    for line in text.lines() {
        let Some(row) = line.trim().strip_prefix('|') else {
            is_meant = false;
            continue;
        };
        let cell = row.split('|').next().unwrap_or("").trim();
        if cell == head {
            is_meant = true;
        } else if is_meant {
            // Every second piece is in back quotes.
            keys.extend(cell.split('`').skip(1).step_by(2).map(str::to_owned));
        }
    }
    keys
}

/// Every key that a decoder expects in any table of a text. An unknown key is inserted into each table in turn, and the
/// error message lists the known ones. Tables in `free` have user-defined keys.
pub fn decoded_keys(
    block: &Block,
    free: &[&str],
    decode: impl Fn(&str) -> Result<(), String>,
) -> BTreeSet<String> {
    let table: toml::Table = block.text.parse().expect("decoded before");
    let mut keys = BTreeSet::new();
    for (path, broken) in with_unknown_keys(&table) {
        match decode(&broken.to_string()) {
            Err(message) => {
                if let Some((_, known)) = message.split_once("unknown key, expected one of: ") {
                    keys.extend(known.split(", ").filter(|key| !key.is_empty()).map(str::to_owned));
                } else {
                    assert!(
                        message.contains(UNKNOWN),
                        "{}: unknown key in [{path}]: {message}",
                        block.place
                    );
                }
            }
            Ok(()) => assert!(
                free.contains(&path.as_str()),
                "{}: an unknown key in [{path}] is not refused",
                block.place
            ),
        }
    }
    keys
}

/// Every key of any table of a text.
pub fn used_keys(text: &str) -> BTreeSet<String> {
    fn walk(value: &toml::Value, keys: &mut BTreeSet<String>) {
        match value {
            toml::Value::Table(table) => {
                for (key, value) in table {
                    keys.insert(key.clone());
                    walk(value, keys);
                }
            }
            toml::Value::Array(items) => items.iter().for_each(|item| walk(item, keys)),
            _ => {}
        }
    }
    let mut keys = BTreeSet::new();
    walk(&toml::Value::Table(text.parse().expect("decoded before")), &mut keys);
    keys
}

/// For `table` and each table in it: the path without array indices, and a copy of `table` with an unknown key there.
fn with_unknown_keys(table: &toml::Table) -> Vec<(String, toml::Table)> {
    let mut all = Vec::new();
    let mut changed = table.clone();
    changed.insert(UNKNOWN.to_owned(), toml::Value::Integer(0));
    all.push((String::new(), changed));
    for (key, value) in table {
        for (path, inner) in values_with_unknown_keys(value) {
            let mut changed = table.clone();
            changed.insert(key.clone(), inner);
            let dot = if path.is_empty() { "" } else { "." };
            all.push((format!("{key}{dot}{path}"), changed));
        }
    }
    all
}

fn values_with_unknown_keys(value: &toml::Value) -> Vec<(String, toml::Value)> {
    match value {
        toml::Value::Table(table) => with_unknown_keys(table)
            .into_iter()
            .map(|(path, table)| (path, toml::Value::Table(table)))
            .collect(),
        toml::Value::Array(items) => {
            let mut all = Vec::new();
            for (index, item) in items.iter().enumerate() {
                for (path, inner) in values_with_unknown_keys(item) {
                    let mut changed = items.clone();
                    changed[index] = inner;
                    all.push((path, toml::Value::Array(changed)));
                }
            }
            all
        }
        _ => Vec::new(),
    }
}

/// Merges `part` into `whole`: tables are merged, any other value of `part` replaces that of `whole`.
pub fn joined(whole: &str, part: &str) -> String {
    fn join(whole: &mut toml::Table, part: toml::Table) {
        for (key, value) in part {
            match (whole.get_mut(&key), value) {
                (Some(toml::Value::Table(inner)), toml::Value::Table(value)) => join(inner, value),
                (_, value) => {
                    whole.insert(key, value);
                }
            }
        }
    }
    let mut table: toml::Table = whole.parse().expect("a whole file of the test");
    join(&mut table, part.parse().unwrap_or_else(|e| panic!("{e}\n{part}")));
    table.to_string()
}

/// Runs the console blocks of every page with the given programs; pages in `elsewhere` are covered by other tests. Each
/// page has a separate working directory with links to the repository's folders.
pub fn run_console_blocks(programs: &[(&str, &str)], elsewhere: &[&str]) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut copies = Vec::new();
    for page in pages() {
        if !blocks(&page).iter().any(|block| block.info == "console") {
            continue;
        }
        let name = page.strip_prefix(root()).expect("a page of the repository");
        let own = folder.path().join(name.display().to_string().replace('/', "-"));
        // trycmd runs the commands of `page.md` in the folder `page.in`.
        let place = own.join("page.in");
        fs::create_dir_all(&place).expect("a folder for the page");
        for part in ["examples", "fitting", "cli", "drivers", "docs"] {
            std::os::unix::fs::symlink(root().join(part), place.join(part)).expect("a link");
        }
        let copy = own.join("page.md");
        let text = fs::read_to_string(&page).expect("a page");
        fs::write(&copy, with_ends(&text)).expect("a copy of the page");
        copies.push((copy, page));
    }
    let cases = trycmd::TestCases::new();
    for (program, path) in programs {
        cases.register_bin(*program, Path::new(path));
    }
    for program in elsewhere {
        cases.register_bin(*program, trycmd::schema::Bin::Ignore);
    }
    // Fix the width of tables and help texts, independent of the environment.
    cases.env("COLUMNS", "80").env("NO_COLOR", "1");
    for (copy, _) in &copies {
        cases.case(copy);
    }
    cases.run();
    if std::env::var("TRYCMD").is_ok_and(|value| value == "overwrite") {
        for (copy, page) in &copies {
            let [before, after] =
                [page, copy].map(|file| fs::read_to_string(file).expect("a page"));
            if after != with_ends(&before) {
                fs::write(page, without_ends(&after)).expect("the page can be written");
            }
        }
    }
}

/// Adds the empty line that trycmd requires after the output of a command.
fn with_ends(page: &str) -> String {
    let (mut text, mut last, mut in_console) = (String::new(), "", false);
    for line in page.lines() {
        let ends = line.starts_with("```") || line.starts_with("$ ");
        let printed =
            !(last.starts_with("$ ") || last.starts_with("? ") || last.starts_with("```"));
        // An empty line between two commands already serves as that line.
        if in_console && ends && printed && (!last.is_empty() || line.starts_with("```")) {
            text.push('\n');
        }
        in_console = line == "```console" || in_console && !line.starts_with("```");
        text += line;
        text.push('\n');
        last = line;
    }
    text
}

fn without_ends(page: &str) -> String {
    let (mut lines, mut in_console) = (Vec::new(), false);
    for line in page.lines() {
        if in_console && line.starts_with("```") && lines.last() == Some(&"") {
            lines.pop();
        }
        in_console = line == "```console" || in_console && !line.starts_with("```");
        lines.push(line);
    }
    lines.join("\n") + "\n"
}

/// Checks that the documented keys equal the decoded ones, and that each appears in a block.
pub fn compare_keys(page: &Path, decoded: &BTreeSet<String>, used: &BTreeSet<String>) {
    let documented = documented_keys(page);
    let only = |a: &BTreeSet<String>, b: &BTreeSet<String>| -> Vec<String> {
        a.difference(b).cloned().collect()
    };
    let wrong = [
        ("documented, but no decoder knows them", only(&documented, decoded)),
        ("known to a decoder, but not documented", only(decoded, &documented)),
        ("documented, but shown in no block", only(&documented, used)),
    ];
    let wrong: Vec<_> = wrong.iter().filter(|(_, keys)| !keys.is_empty()).collect();
    assert!(wrong.is_empty(), "{}: {wrong:?}", page.display());
}
