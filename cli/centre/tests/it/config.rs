use std::path::Path;

use volcomp_centre::{config::Config, rollout::Rules, store::Retention};

fn read(text: &str) -> Result<Config, String> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("centre.toml");
    std::fs::write(&file, text).unwrap();
    let strip = |text: String| text.replace(&format!("{}/", folder.path().display()), "");
    Config::read(&file).map_err(|e| strip(e.to_string()))
}

fn book_example() -> String {
    let book = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/src/fleet.md");
    let book = std::fs::read_to_string(book).unwrap();
    let blocks = book.split("```toml\n").skip(1);
    let mut blocks = blocks.map(|block| block.split("```").next().unwrap());
    let block = blocks.find(|block| block.starts_with("# centre file"));
    block.unwrap().to_owned()
}

#[test]
fn the_book_shows_every_key_with_its_default() {
    let shown = read(&book_example()).unwrap();
    let bare = read("[nats]\nurl = \"nats://127.0.0.1:4222\"\n").unwrap();
    assert_eq!(shown.keep, Retention::default());
    assert_eq!(shown.keep, bare.keep);
    assert_eq!(shown.rollout, Rules::default());
    assert_eq!(shown.rollout, bare.rollout);
    assert_eq!(shown.nats.stream_retention(), bare.nats.stream_retention());
    assert_eq!(shown.nats.url, bare.nats.url);
    assert_eq!(shown.keys.sign_with, bare.keys.sign_with);
    assert!(shown.store.file.ends_with("centre.db"));
    assert_eq!(shown.store.file.file_name(), bare.store.file.file_name());
    // The book lists every key that the program accepts.
    for table in ["nats", "store", "keep", "keys", "rollout", "server"] {
        let text = format!("[nats]\nurl = \"nats://a:1\"\n[{table}]\n")
            .replace("[nats]\nurl = \"nats://a:1\"\n[nats]\n", "[nats]\nurl = \"nats://a:1\"\n");
        let reported = read(&format!("{text}zzzzzzzz = 1\n")).unwrap_err();
        let expected = reported.split("expected").nth(1).unwrap();
        let block = book_example();
        let section = block.split(&format!("[{table}]")).nth(1).unwrap();
        let section = section.split("\n[").next().unwrap();
        for key in expected.split(|c: char| !c.is_ascii_lowercase() && c != '_') {
            if key.len() > 1 && key != "one" && key != "of" && key != "or" && key != "and" {
                assert!(section.contains(key), "{table}.{key}: {reported}");
            }
        }
    }
}

#[test]
fn the_nats_server_listens_on_the_port_of_the_url() {
    for (url, server, listen) in [
        ("nats://127.0.0.1:4300", "", "127.0.0.1:4300"),
        ("tls://a:4300,tls://b:4301", "", "127.0.0.1:4300"),
        ("nats://127.0.0.1", "", "127.0.0.1:4222"),
        // A stated address is kept: behind a proxy the port differs.
        ("tls://a:443", "listen = \"0.0.0.0:4222\"", "0.0.0.0:4222"),
    ] {
        let config = read(&format!("[nats]\nurl = {url:?}\n[server]\n{server}\n"));
        assert_eq!(config.unwrap().server_listen(), listen, "{url}");
    }
}

#[test]
fn configuration_errors_name_line_and_key() {
    let nats = "[nats]\nurl = \"nats://a:1\"\n";
    for (text, reported) in [
        ("", "centre.toml"),
        (
            "[nats]\nreplicas = 2\nurl = \"nats://a:1\"\n",
            "centre.toml:2: nats.replicas: found 2, expected 1, 3 or 5",
        ),
        (
            "[nats]\nurl = \"nats://a:1,http://b\"\n",
            "centre.toml:2: nats.url: found \"http://b\", expected nats://HOST:PORT or tls://HOST:PORT",
        ),
        (
            "[rollout]\nwaves = [50, 20]\n[nats]\nurl = \"nats://a:1\"\n",
            "centre.toml:2: rollout.waves: found [50, 20], expected percentages from 1, ascending to 100",
        ),
        ("[rollout]\nwaves = [50]\n[nats]\nurl = \"nats://a:1\"\n", "ascending to 100"),
        (
            "[server]\nkey = \"a\"\n[nats]\nurl = \"nats://a:1\"\n",
            "certificate and key, expected both or neither",
        ),
        (
            "[store]\npostgres = \"host=a\"\n[nats]\nurl = \"nats://a:1\"\n",
            "centre.toml:2: store.postgres: PostgreSQL is not supported any more, expected `file`, a SQLite file",
        ),
        ("[server]\ncluster = \"a\"\n[nats]\nurl = \"nats://a:1\"\n", "cluster_listen"),
    ] {
        let found = read(text).unwrap_err();
        assert!(found.contains(reported), "{text}: {found}");
    }
    assert!(read(nats).is_ok());
}
