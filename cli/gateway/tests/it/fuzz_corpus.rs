//! Replays the stored fuzz inputs: a file named `valid-…` must parse, a file named `broken-…` must be rejected.

use std::path::Path;

use volcomp_gateway::{audit::verify, config::Config, http::Tokens};

fn replay(target: &str, is_read: impl Fn(&[u8]) -> bool) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../tests/fuzz/corpus")
        .join(target);
    let mut count = 0;
    for entry in std::fs::read_dir(folder).expect("the corpus") {
        let path = entry.expect("readable").path();
        let name = path
            .file_name()
            .expect("a file")
            .to_string_lossy()
            .into_owned();
        let read = is_read(&std::fs::read(&path).expect("readable"));
        assert!(read || !name.starts_with("valid-"), "{name} was refused");
        assert!(!read || !name.starts_with("broken-"), "{name} was read");
        count += 1;
    }
    assert!(count >= 3, "{count} files for {target}");
}

#[test]
fn configurations_and_tokens() {
    replay("config", |bytes| {
        let text = String::from_utf8_lossy(bytes);
        Config::parse(&text, "corpus", "".as_ref()).is_ok()
            || Tokens::parse(&text).is_ok_and(|tokens| !tokens.is_empty())
    });
}

#[test]
fn audit_logs() {
    replay("audit", |bytes| {
        let found = verify(bytes);
        assert_eq!(verify(&bytes[..found.end]).records, found.records);
        found.broken.is_none() && found.end == bytes.len()
    });
}
