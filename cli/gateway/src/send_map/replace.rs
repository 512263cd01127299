//! Another map for a sender that runs: confirmed as the first one was, and taken without the corrections going through zero.
//!
//! The confirmation stands in a file beside the audit log, from where the sender takes it. What waits for the disk is done on a
//! thread of its own: the map in use must be kept meanwhile.

use std::{
    fs, io,
    path::{Path, PathBuf},
    sync::mpsc::{Receiver, channel},
    thread,
    time::Duration,
};

use super::{Checked, check};
use crate::{audit::replace_file, config::MapSender, error::GatewayError, lock};

/// How often it is looked whether another map was confirmed.
const LOOK: Duration = Duration::from_secs(1);

/// The file of the confirmation.
fn confirmation(audit_dir: &Path) -> PathBuf {
    audit_dir.join("confirmed-map")
}

/// Has the sender that runs take this map.
///
/// # Errors
/// No sender of this file runs, or its folder cannot be written.
pub fn ask(checked: &Checked) -> Result<(), GatewayError> {
    let config = &checked.config;
    // A sender holds the folder; a gateway that has the control has another one.
    if !lock::is_folder_locked(&config.keys.audit.dir)? {
        return Err(GatewayError::failed(format!(
            "{}: --replace: found no sender that runs, expected one of {}",
            config.keys.url,
            checked.path.display()
        )));
    }
    let file = confirmation(&config.keys.audit.dir);
    replace_file(&file, &checked.hash)
        .map_err(|e| GatewayError::system(file.display().to_string(), e))
}

/// What another map came to: it, or why it is not taken.
pub(super) type Another = Result<Box<Checked>, String>;

/// Looks for confirmations as long as somebody takes what comes of them.
///
/// # Errors
/// The operating system gives no thread.
pub(super) fn watch(running: &Checked) -> std::io::Result<Receiver<Another>> {
    let (told, heard) = channel();
    let (path, config) = (running.path.clone(), running.config.clone());
    let file = confirmation(&config.keys.audit.dir);
    // One that was left of an earlier sender confirms nothing.
    let _ = fs::remove_file(&file);
    thread::Builder::new()
        .name("volcomp-files".to_owned())
        .spawn(move || {
            let mut trouble = String::new();
            loop {
                thread::sleep(LOOK);
                let another = match taken(&file) {
                    Ok(None) => {
                        trouble.clear();
                        continue;
                    }
                    Ok(Some(hash)) => another(&path, &config, hash.trim()),
                    Err(e) => {
                        let what = format!("{}: {e}", file.display());
                        // It stays so at every look, and is told once.
                        if what == trouble {
                            continue;
                        }
                        trouble.clone_from(&what);
                        Err(what)
                    }
                };
                if told.send(another).is_err() {
                    return;
                }
            }
        })?;
    Ok(heard)
}

/// Takes the confirmation that is there. It has another name before it is read, so that one that comes meanwhile is a
/// confirmation of its own and stays for the next look.
fn taken(file: &Path) -> io::Result<Option<String>> {
    let mine = file.with_extension("taken");
    match fs::rename(file, &mine) {
        Ok(()) => fs::read_to_string(&mine).map(Some),
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(e) => Err(e),
    }
}

/// The map that was confirmed, where nothing else in the file of the sender has changed.
fn another(path: &Path, running: &MapSender, hash: &str) -> Another {
    let checked = check(path).map_err(|e| e.to_string())?;
    checked.confirmed(hash).map_err(|e| e.to_string())?;
    let mut but_for_the_map = checked.config.clone();
    but_for_the_map.keys.map.clone_from(&running.keys.map);
    if but_for_the_map != *running {
        return Err(format!(
            "{}: found other keys than `map` changed, expected the sender to be started again for those",
            path.display()
        ));
    }
    Ok(Box::new(checked))
}

/// Refuses a map that cannot take the place of the one in use: the control knows maps by their numbers, and its axes do not change.
pub(super) fn fits(running: &Checked, another: &Checked) -> Result<(), String> {
    let (is, was) = (another.map.header(), running.map.header());
    let file = another.config.keys.map.display();
    if is.counter == was.counter {
        return Err(format!(
            "{file}: found the number {} of the map in use, expected another one (volcomp map-table --counter)",
            is.counter
        ));
    }
    let steps = |header: &volcomp_tables::Header| header.lines.map(|lines| lines.step_millionths);
    if (is.grid, is.outputs, is.output_step_nm, steps(is))
        != (was.grid, was.outputs, was.output_step_nm, steps(was))
    {
        return Err(format!(
            "{file}: found other axes or other steps than those of the map in use, expected the same"
        ));
    }
    Ok(())
}
