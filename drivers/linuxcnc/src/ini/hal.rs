//! The HAL files beside that of the bridge: those before it, and those that a display loads behind it (`[HAL]POSTGUI_HALFILE`).

use std::{
    collections::HashMap,
    io,
    path::{Path, PathBuf},
};

use super::{Ini, Problem, SERVO_THREAD, USER_SPACE, below, bridge_of};

/// The components that the bridge in user space loads, as `volcomp.tcl` does.
const COMPONENTS: [&str; 9] = [
    "sum2",
    "oneshot",
    "flipflop",
    "mux2",
    "limit2",
    "comp",
    "mult2",
    "limit1",
    "conv_float_s32",
];

/// Where LinuxCNC looks for HAL files that are not in the folder of the INI file.
const LIBRARY: &str = "/usr/share/linuxcnc/hallib";

/// Where a HAL file is that an INI file in this folder names; arguments may stand behind it.
fn path_of(folder: &Path, value: &str) -> PathBuf {
    let name = value.split_whitespace().next().unwrap_or_default();
    if let Some(name) = name.strip_prefix("LIB:") {
        return Path::new(LIBRARY).join(name);
    }
    let own = below(folder, name);
    let library = Path::new(LIBRARY).join(name);
    if !own.exists() && library.exists() {
        return library;
    }
    own
}

fn read(folder: &Path, value: &str) -> io::Result<String> {
    let bytes = std::fs::read(path_of(folder, value))?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

/// The pin and the signal of each connection in a HAL file, with the number of its line.
fn connections(text: &str) -> impl Iterator<Item = (usize, &str, &str)> {
    text.lines().enumerate().flat_map(|(number, line)| {
        let line = line.split('#').next().unwrap_or_default();
        let is_arrow = |word: &&str| matches!(*word, "=>" | "<=" | "<=>");
        let words: Vec<&str> = line
            .split_whitespace()
            .filter(|word| !is_arrow(word))
            .collect();
        let found: Vec<(&str, &str)> = match words[..] {
            ["net", signal, ref pins @ ..] => pins.iter().map(|pin| (*pin, signal)).collect(),
            ["linksp", signal, pin] | ["linkps", pin, signal] => vec![(pin, signal)],
            _ => Vec::new(),
        };
        found
            .into_iter()
            .map(move |(pin, signal)| (number + 1, pin, signal))
    })
}

/// The signal that the file of the bridge gives to a pin of LinuxCNC that has none; both bridges call those alike that they read.
fn signal_of(pin: &str, is_servo: bool) -> Option<String> {
    let of_axis = pin
        .strip_prefix("axis.")
        .and_then(|rest| rest.split_once('.'));
    let of_joint = pin
        .strip_prefix("joint.")
        .and_then(|rest| rest.split_once('.'));
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
        (_, Some((axis, "eoffset-counts")), _) => {
            format!("{}-{axis}", if is_servo { "counts" } else { "whole" })
        }
        (_, Some((_, "eoffset-enable")), _) => "enable".to_owned(),
        (_, _, Some((joint, "homed"))) => format!("homed-{joint}"),
        _ => return None,
    };
    Some(format!("volcomp-{signal}"))
}

impl Ini {
    /// The HAL files before that of the bridge, and the name of the latter.
    fn before(&self) -> (Vec<&str>, Option<&'static str>) {
        let files = self.all("HAL", "HALFILE");
        let before = files.take_while(|file| bridge_of(file).is_none());
        (
            before.collect(),
            self.all("HAL", "HALFILE").find_map(bridge_of),
        )
    }

    /// What the bridge in user space loads is not loaded before.
    pub(super) fn before_the_bridge(&self, problems: &mut Vec<Problem>) {
        let Some(folder) = &self.folder else {
            return;
        };
        let (before, bridge) = self.before();
        if bridge != Some(USER_SPACE) {
            return;
        }
        for file in before {
            // What cannot be read LinuxCNC tells better: it knows more places.
            let Ok(text) = read(folder, file) else {
                continue;
            };
            for (number, line) in text.lines().enumerate() {
                let mut words = line.split_whitespace();
                if let (Some("loadrt"), Some(component)) = (words.next(), words.next())
                    && COMPONENTS.contains(&component)
                {
                    problems.push(Problem::Loaded {
                        file: file.to_owned(),
                        line: number + 1,
                        component: component.to_owned(),
                    });
                }
            }
        }
    }

    /// Pins that the bridge has connected, and that a later file connects to another signal: LinuxCNC stops there.
    pub(super) fn behind_the_display(&self, problems: &mut Vec<Problem>) {
        let Some(folder) = &self.folder else {
            return;
        };
        let read = |file: &str| read(folder, file);
        // What the files before the bridge have connected keeps its signal.
        let (before, bridge) = self.before();
        let before: Vec<String> = before
            .into_iter()
            .filter_map(|file| read(file).ok())
            .collect();
        let known: HashMap<&str, &str> = before
            .iter()
            .flat_map(|text| connections(text))
            .map(|(_, pin, signal)| (pin, signal))
            .collect();
        let is_servo = bridge == Some(SERVO_THREAD);
        let [corrected, read_only] = self.letters().map(|letters| letters.to_lowercase());
        // Of an axis that is only read the bridge connects the position alone.
        let is_told = |pin: &str| match pin
            .strip_prefix("axis.")
            .and_then(|rest| rest.split_once('.'))
        {
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
                let Some(expected) = signal_of(pin, is_servo)
                    .filter(|_| is_told(pin))
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
