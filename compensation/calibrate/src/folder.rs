//! The files below a folder.

use std::path::{Path, PathBuf};

/// Files below a folder in the order of their names, without hidden ones, those that are no plain files, and the TOML files that say something of others. Links to folders are
/// not followed, and the folders `without` not entered. The search ends once it has found more than `most` files.
///
/// # Errors
/// A folder that cannot be read.
pub fn files_below(
    folder: &Path,
    without: &[PathBuf],
    most: usize,
) -> std::io::Result<Vec<PathBuf>> {
    let mut paths = Vec::new();
    list(folder, without, 0, most, &mut paths)?;
    paths.sort();
    Ok(paths)
}

fn list(
    folder: &Path,
    without: &[PathBuf],
    depth: usize,
    most: usize,
    paths: &mut Vec<PathBuf>,
) -> std::io::Result<()> {
    const DEEPEST: usize = 8;
    for entry in std::fs::read_dir(folder)? {
        if paths.len() > most {
            return Ok(());
        }
        let entry = entry?;
        let path = entry.path();
        let name = entry.file_name().to_string_lossy().into_owned();
        let is_toml = path
            .extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("toml"));
        if name.starts_with('.') || is_toml {
            continue;
        }
        let kind = entry.file_type()?;
        if kind.is_dir() {
            if depth < DEEPEST && !without.contains(&path) {
                list(&path, without, depth + 1, most, paths)?;
            }
        } else if path.is_file() {
            // A pipe or a socket would keep its reader waiting.
            paths.push(path);
        }
    }
    Ok(())
}
