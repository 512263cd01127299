//! Replays the stored fuzz inputs.

use volcomp_gateway::{audit::verify, config::Config, http::Tokens};
use volcomp_test_support::corpus::replay;

#[test]
fn configurations_and_tokens() {
    replay("config", |_, bytes| {
        let text = String::from_utf8_lossy(bytes);
        let has_tokens = || Tokens::parse(&text).is_ok_and(|tokens| !tokens.is_empty());
        let read = Config::parse(&text, "corpus", "".as_ref()).map(|_| ());
        read.or_else(|error| has_tokens().then_some(()).ok_or(error))
    });
}

#[test]
fn audit_logs() {
    replay("audit", |_, bytes| {
        let found = verify(bytes);
        assert_eq!(verify(&bytes[..found.end]).records, found.records);
        let is_whole = found.broken.is_none() && found.end == bytes.len();
        is_whole.then_some(()).ok_or(found.end)
    });
}
