//! Replaces the map of a running sender: it is confirmed like the first one, and activated without ramping the
//! corrections to zero.
//!
//! The confirmation is a file beside the audit log, which the sender picks up. A separate thread does the disk work,
//! because the map in use must be kept valid meanwhile.

use std::{
    fs, io,
    path::{Path, PathBuf},
    sync::mpsc::{Receiver, channel},
    thread,
    time::Duration,
};

use super::{Checked, check};
use crate::{audit::replace_file, config::MapSender, error::GatewayError, lock};

/// Polling interval for a confirmation.
const LOOK: Duration = Duration::from_secs(1);

/// Path of the confirmation.
fn confirmation(audit_dir: &Path) -> PathBuf {
    audit_dir.join("confirmed-map")
}

/// Requests the running sender to use this map.
///
/// # Errors
/// No sender is running with this configuration, or its folder cannot be written.
pub fn ask(checked: &Checked) -> Result<(), GatewayError> {
    let config = &checked.config;
    // A running sender locks its folder; a gateway on the same control uses another folder.
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

/// A replacement map, or why it is refused.
pub(super) type Another = Result<Box<Checked>, String>;

/// Polls for confirmations until the receiver is dropped.
///
/// # Errors
/// The operating system cannot create a thread.
pub(super) fn watch(running: &Checked) -> std::io::Result<Receiver<Another>> {
    let (told, heard) = channel();
    let (path, config) = (running.path.clone(), running.config.clone());
    let file = confirmation(&config.keys.audit.dir);
    // A confirmation left by an earlier sender is invalid.
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
                        // The error persists: report it once.
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

/// Takes the pending confirmation. It is renamed before it is read, so that a confirmation written meanwhile is kept
/// for the next poll.
fn taken(file: &Path) -> io::Result<Option<String>> {
    let mine = file.with_extension("taken");
    match fs::rename(file, &mine) {
        Ok(()) => fs::read_to_string(&mine).map(Some),
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(e) => Err(e),
    }
}

/// The confirmed map, provided that nothing else in the sender's configuration has changed.
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

/// Rejects a map that cannot replace the one in use: its number must differ, because the control identifies maps by
/// number, and its axes and steps must match.
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
