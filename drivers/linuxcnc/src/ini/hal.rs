//! Checks the HAL files besides the bridge's file: the files before it, and the files that a display loads later
//! (`[HAL]POSTGUI_HALFILE`).

use std::{
    collections::HashMap,
    io,
    path::{Path, PathBuf},
};

use volcomp_document::read_bytes;

use super::{Ini, Problem, below, is_bridge};

/// Directory in which LinuxCNC searches for HAL files that are not next to the INI file.
const HAL_LIBRARY: &str = "/usr/share/linuxcnc/hallib";

fn path_of(folder: &Path, value: &str) -> PathBuf {
    let name = value.split_whitespace().next().unwrap_or_default();
    if let Some(name) = name.strip_prefix("LIB:") {
        return Path::new(HAL_LIBRARY).join(name);
    }
    let own = below(folder, name);
    let library = Path::new(HAL_LIBRARY).join(name);
    if !own.exists() && library.exists() {
        return library;
    }
    own
}

fn read(folder: &Path, value: &str) -> io::Result<String> {
    let bytes = read_bytes(&path_of(folder, value))?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// Line number, pin and signal of each connection in a HAL file.
fn connections(text: &str) -> impl Iterator<Item = (usize, &str, &str)> {
    text.lines().enumerate().flat_map(|(number, line)| {
        let line = line.split('#').next().unwrap_or_default();
        let is_arrow = |word: &&str| matches!(*word, "=>" | "<=" | "<=>");
        let words: Vec<&str> = line.split_whitespace().filter(|word| !is_arrow(word)).collect();
        let found: Vec<(&str, &str)> = match words[..] {
            ["net", signal, ref pins @ ..] => pins.iter().map(|pin| (*pin, signal)).collect(),
            ["linksp", signal, pin] | ["linkps", pin, signal] => vec![(pin, signal)],
            _ => Vec::new(),
        };
        found.into_iter().map(move |(pin, signal)| (number + 1, pin, signal))
    })
}

/// Signal to which the bridge's HAL file connects a pin of LinuxCNC, unless an earlier file has connected the pin;
/// `None` if it does not connect the pin.
fn signal_of(pin: &str) -> Option<String> {
    let of_axis = pin.strip_prefix("axis.").and_then(|rest| rest.split_once('.'));
    let of_joint = pin.strip_prefix("joint.").and_then(|rest| rest.split_once('.'));
    let signal = match (pin, of_axis, of_joint) {
        ("motion.probe-input", ..) => "probe".to_owned(),
        ("motion.motion-enabled", ..) => "enabled".to_owned(),
        ("iocontrol.0.emc-enable-in", ..) => "estop".to_owned(),
        ("iocontrol.0.user-enable-out", ..) => "user".to_owned(),
        ("motion.eoffset-limited", ..) => "limited".to_owned(),
        ("motion.motion-type", ..) => "type".to_owned(),
        ("motion.coord-mode", ..) => "coord-mode".to_owned(),
        ("motion.teleop-mode", ..) => "teleop-mode".to_owned(),
        (_, Some((axis, "pos-cmd")), _) => format!("cmd-{axis}"),
        (_, Some((axis, "eoffset")), _) => format!("eoffset-{axis}"),
        (_, Some((axis, "eoffset-request")), _) => format!("request-{axis}"),
        (_, Some((axis, "eoffset-counts")), _) => format!("counts-{axis}"),
        (_, Some((_, "eoffset-enable")), _) => "enable".to_owned(),
        (_, _, Some((joint, "homed"))) => format!("homed-{joint}"),
        _ => return None,
    };
    Some(format!("volcomp-{signal}"))
}

impl Ini {
    /// Finds pins of the bridge that a HAL file of the display connects to another signal. LinuxCNC stops at such a
    /// connection.
    pub(super) fn check_display_files(&self, problems: &mut Vec<Problem>) {
        let Some(folder) = &self.folder else {
            return;
        };
        let read = |file: &str| read(folder, file);
        // Pins that a file before the bridge's file has connected keep their signal.
        let before: Vec<String> = self
            .all("HAL", "HALFILE")
            .take_while(|file| !is_bridge(file))
            .filter_map(|file| read(file).ok())
            .collect();
        let known: HashMap<&str, &str> = before
            .iter()
            .flat_map(|text| connections(text))
            .map(|(_, pin, signal)| (pin, signal))
            .collect();
        let [corrected, read_only] = self.letters().map(|letters| letters.to_lowercase());
        // For a read-only axis, the bridge connects only the position.
        let is_reported =
            |pin: &str| match pin.strip_prefix("axis.").and_then(|rest| rest.split_once('.')) {
                Some((axis, name)) => {
                    corrected.contains(axis) || name == "pos-cmd" && read_only.contains(axis)
                }
                None => true,
            };
        for file in self.all("HAL", "POSTGUI_HALFILE") {
            let text = match read(file) {
                Ok(text) => text,
                Err(e) => {
                    let (file, reason) = (file.to_owned(), e.to_string());
                    problems.push(Problem::PostGui { file, reason });
                    continue;
                }
            };
            for (line, pin, found) in connections(&text) {
                let known = known.get(pin).map(|signal| (*signal).to_owned());
                let Some(expected) = signal_of(pin)
                    .filter(|_| is_reported(pin))
                    .map(|signal| known.unwrap_or(signal))
                else {
                    continue;
                };
                if found != expected {
                    problems.push(Problem::Connected {
                        file: file.to_owned(),
                        line,
                        pin: pin.to_owned(),
                        found: found.to_owned(),
                        expected,
                    });
                }
            }
        }
    }
}
