//! Third-party programs for comparison tests; `./test` installs them.

use std::path::PathBuf;

/// Reports that a program is missing and its test is skipped. If the environment variable `CI` is set, the test fails instead.
pub fn not_run(what: &str) {
    assert!(std::env::var_os("CI").is_none(), "{what} is missing: ./test installs it");
    eprintln!("not run: {what} is missing, ./test installs it");
}

/// Path of the Python with the packages of `tests/peers.txt`; `None`, after calling [`not_run`], if it is missing.
pub fn python() -> Option<PathBuf> {
    let python = crate::root().join("target/test-venv/bin/python");
    if !python.is_file() {
        not_run("target/test-venv, the Python with the packages of tests/peers.txt,");
        return None;
    }
    Some(python)
}
