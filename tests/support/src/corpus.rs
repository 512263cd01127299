//! The stored fuzz inputs, in `tests/fuzz/corpus`.

use std::fmt::Debug;

use crate::root;

/// Names and contents of the inputs of a fuzz target.
pub fn files(target: &str) -> Vec<(String, Vec<u8>)> {
    let folder = root().join("tests/fuzz/corpus").join(target);
    let entries = std::fs::read_dir(&folder);
    let entries = entries.unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let read = |entry: std::io::Result<std::fs::DirEntry>| {
        let entry = entry.expect("an entry");
        let name = entry.file_name().to_string_lossy().into_owned();
        (name, std::fs::read(entry.path()).expect("readable"))
    };
    entries.map(read).collect()
}

/// Reads the inputs of a fuzz target, given name and content: a file named `valid-…` must be read, a file named
/// `broken-…` rejected.
pub fn replay<T: Debug, E: Debug>(target: &str, mut read: impl FnMut(&str, &[u8]) -> Result<T, E>) {
    let mut seen = [0; 2];
    for (name, bytes) in files(target) {
        let found = read(&name, &bytes);
        for (place, start) in ["broken-", "valid-"].into_iter().enumerate() {
            if name.starts_with(start) {
                assert_eq!(found.is_ok(), place == 1, "{target} {name}: {found:?}");
                seen[place] += 1;
            }
        }
    }
    assert!(seen.iter().all(|count| *count > 0), "{target}: {seen:?}");
}
