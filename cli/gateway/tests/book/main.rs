//! The book and the README files agree with the gateway: configurations are valid, console blocks run, and tables of
//! keys list the keys of the decoder.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    io::{Read, Write},
    net::TcpStream,
    path::Path,
    process::{Command, Stdio},
};

use volcomp_gateway::config::{Config, MapSender};
use volcomp_guard::Reasons;
use volcomp_test_support::{
    Running,
    book::{
        Block, blocks, chapter, compare_keys, decoded_keys, first_column, joined, pages,
        run_console_blocks, used_keys,
    },
};

/// The smallest valid configuration, into which a fragment of the book is inserted.
const SMALL: &str = r#"
machine = "machine.toml"
[[controller]]
url = "focas://192.0.2.10:8193"
axes = ["X", "Y", "Z"]
"#;

fn decode(text: &str) -> Result<(), String> {
    Config::parse(text, "gateway.toml", Path::new("")).map(drop).map_err(|e| e.to_string())
}

/// A configuration block; a fragment is completed with [`SMALL`].
fn whole(block: &Block) -> Option<String> {
    if block.is("gateway file") {
        Some(block.text.clone())
    } else if block.is("part of a gateway file") {
        Some(joined(SMALL, &block.text))
    } else {
        None
    }
}

#[test]
fn every_configuration_is_read_by_the_gateway() {
    let mut count = 0;
    for block in pages().iter().flat_map(|page| blocks(page)) {
        if block.is("file of a map sender") {
            MapSender::parse(&block.text, "map-sender.toml", Path::new(""))
                .unwrap_or_else(|e| panic!("{}: {e}", block.place));
            count += 1;
        }
        if let Some(text) = whole(&block) {
            decode(&text).unwrap_or_else(|e| panic!("{}: {e}", block.place));
            count += 1;
        }
    }
    assert!(count > 2, "only {count} configurations were read");
}

#[test]
fn keys_of_the_configuration() {
    let page = chapter("gateway.md");
    let (mut decoded, mut used) = (BTreeSet::new(), BTreeSet::new());
    for mut block in blocks(&page) {
        if let Some(text) = whole(&block) {
            used.extend(used_keys(&block.text));
            block.text = text;
            decoded.extend(decoded_keys(&block, &[], decode));
        }
    }
    compare_keys(&page, &decoded, &used);
}

#[test]
fn every_console_block_prints_what_it_says() {
    run_console_blocks(
        &[("volcomp-gateway", env!("CARGO_BIN_EXE_volcomp-gateway"))],
        &["volcomp", "focas-sim", "cargo"],
    );
}

struct Gateway {
    _running: Running,
    address: String,
}

impl Gateway {
    fn start(audit_dir: &Path) -> Self {
        let (running, line, _) = Running::start_and_hear(
            Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"))
                .args(["--listen", "127.0.0.1:0", "--audit-dir"])
                .arg(audit_dir)
                .stderr(Stdio::null()),
        );
        Self { _running: running, address: line.rsplit('/').next().unwrap_or("").to_owned() }
    }

    fn get(&self, path: &str) -> String {
        let mut stream = TcpStream::connect(&self.address).expect("it listens");
        let address = &self.address;
        write!(stream, "GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n")
            .expect("a request");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).expect("an answer");
        let (_, body) = answer.split_once("\r\n\r\n").expect("a body");
        body.to_owned()
    }
}

#[test]
fn every_metric_and_every_key_of_the_state_is_in_the_chapter() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let gateway = Gateway::start(folder.path());
    let page = chapter("http-api.md");

    let metrics = gateway.get("/metrics");
    let types = metrics.lines().filter_map(|l| l.strip_prefix("# TYPE "));
    let reported: BTreeSet<String> =
        types.filter_map(|line| line.split(' ').next()).map(str::to_owned).collect();
    let documented: BTreeSet<String> = first_column(&page, "metric")
        .iter()
        .filter_map(|name| name.split('{').next())
        .map(str::to_owned)
        .collect();
    assert_eq!(documented, reported, "documented (left) and found (right)");

    let state: serde_json::Value = serde_json::from_str(&gateway.get("/api/state")).expect("JSON");
    let documented = first_column(&page, "name");
    let state = state.as_object().expect("an object");
    let missing: Vec<_> = state.keys().filter(|key| !documented.contains(*key)).collect();
    assert!(missing.is_empty(), "http-api.md does not say {missing:?}");
    assert!(fs::read_dir(folder.path()).expect("the folder").count() > 0);
}

#[test]
fn every_reason_is_in_the_chapter() {
    let text = fs::read_to_string(chapter("operating.md")).expect("a page");
    let rows = text.lines().map(|line| line.split(" | ").collect::<Vec<_>>());
    let reported: BTreeMap<&str, bool> = rows
        .filter_map(|row| match row[..] {
            [reasons, "no", ..] => Some((reasons, false)),
            [reasons, "yes", ..] => Some((reasons, true)),
            _ => None,
        })
        .flat_map(|(reasons, forbids)| {
            let reasons = reasons.trim_start_matches("| ").split(", ");
            reasons.map(move |reason| (reason, forbids))
        })
        .collect();
    let informing: Vec<_> = Reasons::DOES_NOT_FORBID.texts().collect();
    let missing: Vec<_> = Reasons::from_bits(u64::MAX)
        .texts()
        .filter(|text| reported.get(text) != Some(&!informing.contains(text)))
        .collect();
    assert!(
        missing.is_empty(),
        "operating.md does not say whether these forbid arming: {missing:?}"
    );
}

fn tests_of_hazards() -> BTreeSet<String> {
    let text = fs::read_to_string(chapter("guard.md")).expect("a page");
    let rows = text.lines().map(|line| line.split(" | ").collect::<Vec<_>>());
    let mut rows = rows.skip_while(|row| row[0] != "| hazard");
    let place = rows.next().expect("the table");
    let place = place.iter().position(|head| *head == "test").expect("it");
    let cells = rows.map_while(|row| row.get(place).map(ToString::to_string));
    let names = cells.flat_map(|cell| {
        let names = cell.split('`').skip(1).step_by(2);
        names.map(str::to_owned).collect::<Vec<_>>()
    });
    names.collect()
}

fn functions(folder: &Path, names: &mut BTreeSet<String>) {
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("an entry").path();
        if path.is_dir() && path.file_name().is_some_and(|name| name != "target") {
            functions(&path, names);
        } else if path.extension().is_some_and(|ending| ending == "rs") {
            let text = fs::read_to_string(&path).expect("a source");
            let named = text.lines().filter_map(|line| {
                let (name, _) = line.trim_start().strip_prefix("fn ")?.split_once('(')?;
                Some(name.to_owned())
            });
            names.extend(named);
        }
    }
}

#[test]
fn every_test_in_the_table_of_hazards_exists() {
    let named = tests_of_hazards();
    assert!(named.len() > 50, "only {} tests are named", named.len());
    let mut there = BTreeSet::new();
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    for folder in ["cli", "compensation", "drivers"] {
        functions(&root.join(folder), &mut there);
    }
    let missing: Vec<_> = named.difference(&there).collect();
    assert!(missing.is_empty(), "guard.md names {missing:?}");
}
