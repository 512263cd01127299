//! Programs of others that ours are compared with; `./test` installs them.

use std::path::PathBuf;

/// Says that a program is missing, so that its test does not run. Where the environment variable `CI` is set nothing
/// may be missing, and the test fails.
pub fn not_run(what: &str) {
    assert!(
        std::env::var_os("CI").is_none(),
        "{what} is missing: ./test installs it"
    );
    eprintln!("not run: {what} is missing, ./test installs it");
}

/// The Python with the packages of `tests/peers.txt`; where it is missing, `None` after [`not_run`] said so.
pub fn python() -> Option<PathBuf> {
    let python = crate::root().join("target/test-venv/bin/python");
    if !python.is_file() {
        not_run("target/test-venv, the Python with the packages of tests/peers.txt,");
        return None;
    }
    Some(python)
}
