//! Checks the INI file of LinuxCNC for settings that prevent a correction.

mod hal;
mod numbers;
mod problem;

pub use numbers::GuardMinimum;
pub use problem::Problem;

use std::{
    io::ErrorKind,
    path::{Path, PathBuf},
};

use volcomp_document::{PrivateError, read_bytes};
use volcomp_vocabulary::AxisKind;

use crate::{Key, KeyError, LinuxCncConfig, PORT};

/// An INI file of LinuxCNC, with its sections, keys and values as written.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ini {
    entries: Vec<(String, String, String)>,
    /// Included files that cannot be read, each with the reason.
    unread: Vec<(String, String)>,
    /// Folder of the INI file, to which paths in it are relative; `None` for a text without a file.
    folder: Option<PathBuf>,
}

/// Configuration and requirements of the gateway that the settings of an INI file must match.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Expected<'a> {
    pub control: &'a LinuxCncConfig,
    /// Period of the servo thread, ms.
    pub scan_ms: f64,
    /// Minimum values that the guard requires of the bridge; `None` if no axis is corrected.
    pub least: Option<GuardMinimum>,
}

const BRIDGE: &str = "volcomp.tcl";

/// Keys that the bridge's section may contain, as in `volcomp.tcl`.
const KEYS: [&str; 15] = [
    "MACHINE",
    "AXES",
    "READS",
    "PORT",
    "LISTEN",
    "STEP_NM",
    "STEP_UDEG",
    "LIMIT_UM",
    "LIMIT_MDEG",
    "RATE_UM_PER_S",
    "RATE_MDEG_PER_S",
    "HOLD_MS",
    "TIME_OUT_MS",
    "EPOCH_FILE",
    "KEY_FILE",
];

const MAX_JOINTS: f64 = 16.0;

/// Axes of the joints of `trivkins`, in order, if `[KINS]KINEMATICS` does not state them.
const COORDINATES: &str = "XYZABCUVW";

/// Units that the bridge accepts. Each entry has the key, the accepted words, case-insensitive, and these words for
/// messages. LinuxCNC also accepts numbers, and text after a number. The bridge rejects both, and so does this check.
const UNITS: [(&str, [&str; 2], &str); 2] = [
    ("LINEAR_UNITS", ["mm", "metric"], "mm or metric"),
    ("ANGULAR_UNITS", ["degree", "deg"], "degree or deg"),
];

/// Whether a value of `HALFILE` names the bridge's file. Arguments may follow the name.
fn is_bridge(value: &str) -> bool {
    let file = value.split_whitespace().next().unwrap_or_default();
    file.rsplit('/').next() == Some(BRIDGE)
}

/// Path of a file that is named in an INI file. A name is relative to `folder`, or to the user's home if it starts with
/// `~/`.
fn below(folder: &Path, name: &str) -> PathBuf {
    let home = std::env::home_dir().zip(name.strip_prefix("~/"));
    home.map_or_else(|| folder.join(name), |(home, rest)| home.join(rest))
}

impl Ini {
    /// Parses a file like LinuxCNC. Keys before the first section and malformed lines are ignored. A comment takes a
    /// whole line; text after a value is part of the value.
    #[must_use]
    pub fn parse(text: &str) -> Self {
        let (mut entries, mut section) = (Vec::new(), String::new());
        for line in text.lines().map(str::trim) {
            if line.starts_with(['#', ';']) {
                continue;
            }
            if let Some(name) = line.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
                name.0.trim().clone_into(&mut section);
            } else if let Some((key, value)) = line.split_once('=') {
                let (key, value) = (key.trim().to_owned(), value.trim().to_owned());
                entries.push((section.clone(), key, value));
            }
        }
        Self { entries, unread: Vec::new(), folder: None }
    }

    /// Reads an INI file, and the files that its lines `#INCLUDE FILE` name relative to it. As in LinuxCNC, `#INCLUDE`
    /// lines in an included file are comments.
    ///
    /// # Errors
    /// The file cannot be read. An included file that cannot be read is reported as a [`Problem`].
    pub fn read(file: &Path) -> std::io::Result<Self> {
        let folder = file.parent().unwrap_or(Path::new(""));
        let (mut text, mut unread) = (String::new(), Vec::new());
        for line in String::from_utf8_lossy(&read_bytes(file)?).lines() {
            let words = line.trim().split_once(char::is_whitespace);
            let Some(("#INCLUDE", named)) = words else {
                text += line;
                text.push('\n');
                continue;
            };
            let named = named.trim();
            match read_bytes(&below(folder, named)) {
                Ok(bytes) => {
                    text += &String::from_utf8_lossy(&bytes);
                    text.push('\n');
                }
                Err(e) => unread.push((named.to_owned(), e.to_string())),
            }
        }
        Ok(Self { unread, folder: Some(folder.to_owned()), ..Self::parse(&text) })
    }

    /// All values of a key, in file order.
    pub fn all<'a>(&'a self, section: &str, key: &str) -> impl Iterator<Item = &'a str> {
        let of = move |(in_section, name, _): &&(String, String, String)| {
            in_section == section && name == key
        };
        self.entries.iter().filter(of).map(|(_, _, value)| value.as_str())
    }

    /// First value of a key, which is the only one that LinuxCNC uses; `None` if the key is missing.
    #[must_use]
    pub fn get(&self, section: &str, key: &str) -> Option<&str> {
        self.all(section, key).next()
    }

    /// Finds all settings that are wrong or missing.
    #[must_use]
    pub fn problems(&self, expected: &Expected<'_>) -> Vec<Problem> {
        let mut problems = Vec::new();
        for (file, reason) in &self.unread {
            let (file, reason) = (file.clone(), reason.clone());
            problems.push(Problem::Include { file, reason });
        }
        self.hal_files(&mut problems);
        self.unknown(&mut problems);
        self.check_display_files(&mut problems);
        self.bridge(expected, &mut problems);
        self.key(expected, &mut problems);
        self.reads(expected, &mut problems);
        self.shares(expected, &mut problems);
        self.joints(&mut problems);
        self.joint_limits(expected, &mut problems);
        self.control(expected, &mut problems);
        problems
    }

    /// Checks that the last file in `[HAL]` is the file of the bridge.
    fn hal_files(&self, problems: &mut Vec<Problem>) {
        let mut files = self.all("HAL", "HALFILE");
        if !files.any(is_bridge) {
            problems.push(Problem::NoHalFile);
        } else if let Some(found) = files.next() {
            let found = found.to_owned();
            problems.push(Problem::Behind { found });
        }
    }

    /// Finds unknown keys in the bridge's section, such as `HOLDMS`. LinuxCNC and the bridge ignore them and use the
    /// defaults.
    fn unknown(&self, problems: &mut Vec<Problem>) {
        for (section, key, _) in &self.entries {
            if section == "VOLCOMP" && !KEYS.contains(&key.as_str()) {
                let (key, known) = (key.clone(), KEYS.join(", "));
                problems.push(Problem::Unknown { key, known });
            }
        }
    }

    /// Checks that the bridge has the gateway's key. A key file that belongs to another user cannot be read, and is not
    /// compared.
    fn key(&self, expected: &Expected<'_>, problems: &mut Vec<Problem>) {
        let Some(folder) = &self.folder else {
            return;
        };
        let file = folder.join(self.get("VOLCOMP", "KEY_FILE").unwrap_or("volcomp.key"));
        match Key::read(&file) {
            Ok(key) if key == expected.control.key => {}
            Ok(_) => problems.push(Problem::OtherKey { file }),
            Err(KeyError::Private(PrivateError::Read { source, .. }))
                if source.kind() == ErrorKind::PermissionDenied => {}
            Err(error) => {
                let reason = error.to_string();
                problems.push(Problem::Key { reason });
            }
        }
    }

    /// Checks that the bridge reports all axes whose positions the gateway reads. It reports the axes in `AXES` and
    /// `READS`.
    fn reads(&self, expected: &Expected<'_>, problems: &mut Vec<Problem>) {
        let [axes, reads] = self.letters();
        for axis in &expected.control.reads {
            if !axes.contains(axis.letter()) && !reads.contains(axis.letter()) {
                let found = self.get("VOLCOMP", "READS").unwrap_or_default().to_owned();
                problems.push(Problem::NotRead { axis: *axis, found });
            }
        }
    }

    /// Letters of the axes that the bridge corrects, and letters of the axes that it only reports.
    fn letters(&self) -> [String; 2] {
        let of = |key| self.bridge_value(key);
        [of("AXES").unwrap_or_else(|| "XYZ".to_owned()), of("READS").unwrap_or_default()]
    }

    /// Value in the bridge's section as the bridge uses it, without blanks and in upper case; `None` if the key is
    /// missing.
    fn bridge_value(&self, key: &str) -> Option<String> {
        let text = self.get("VOLCOMP", key)?;
        Some(text.replace(' ', "").to_uppercase())
    }

    /// Checks in the axis sections that each corrected axis reserves a fraction of its velocity for the offset
    /// (`OFFSET_AV_RATIO`).
    fn shares(&self, expected: &Expected<'_>, problems: &mut Vec<Problem>) {
        for axis in &expected.control.axes {
            match self.get(&format!("AXIS_{axis}"), "OFFSET_AV_RATIO") {
                None => problems.push(Problem::NoRatio { axis: *axis }),
                Some(text) => {
                    let ratio: Option<f64> = text.parse().ok();
                    if !ratio.is_some_and(|ratio| ratio > 0.0 && ratio <= 0.2) {
                        let found = text.to_owned();
                        problems.push(Problem::Ratio { axis: *axis, found });
                    }
                }
            }
        }
    }

    /// Checks in the joint sections that LinuxCNC does not compensate the same errors.
    fn joints(&self, problems: &mut Vec<Problem>) {
        for (section, key, value) in &self.entries {
            let Some(joint) = section.strip_prefix("JOINT_") else {
                continue;
            };
            let (joint, found) = (joint.to_owned(), value.clone());
            if key == "COMP_FILE" {
                problems.push(Problem::CompFile { joint, found });
            } else if key == "BACKLASH" && value.parse() != Ok(0.0) {
                problems.push(Problem::Backlash { joint, found });
            }
        }
    }

    /// Checks that the soft limits of each joint are within the soft limits of its axis, for corrected axes.
    fn joint_limits(&self, expected: &Expected<'_>, problems: &mut Vec<Problem>) {
        let kinematics = self.get("KINS", "KINEMATICS").unwrap_or_default();
        let mut words = kinematics.split_whitespace();
        let stated = words.find_map(|word| word.strip_prefix("coordinates="));
        for (joint, letter) in stated.unwrap_or(COORDINATES).to_uppercase().chars().enumerate() {
            let axis = expected.control.axes.iter().find(|axis| axis.letter() == letter);
            let Some(&axis) = axis else {
                continue;
            };
            for key in ["MIN_LIMIT", "MAX_LIMIT"] {
                let Some(limit) = self.get(&format!("AXIS_{axis}"), key) else {
                    continue;
                };
                let found = self.get(&format!("JOINT_{joint}"), key).unwrap_or("none");
                let numbers = found.parse().ok().zip(limit.parse().ok());
                let is_within = |(found, limit): (f64, f64)| match key {
                    "MIN_LIMIT" => found >= limit,
                    _ => found <= limit,
                };
                if !numbers.is_some_and(is_within) {
                    let (found, limit) = (found.to_owned(), limit.to_owned());
                    problems.push(Problem::JointLimit { joint, key, found, axis, limit });
                }
            }
        }
    }

    fn control(&self, expected: &Expected<'_>, problems: &mut Vec<Problem>) {
        for (key, known, words) in UNITS {
            match self.get("TRAJ", key) {
                None => problems.push(Problem::NoUnits { key, expected: words }),
                Some(found) if !known.iter().any(|word| word.eq_ignore_ascii_case(found)) => {
                    problems.push(Problem::Units { key, found: found.to_owned(), expected: words });
                }
                Some(_) => {}
            }
        }
        match self.get("KINS", "JOINTS") {
            None => problems.push(Problem::NoJoints),
            Some(found) => {
                let is_one = |n: f64| n.fract() == 0.0 && (1.0..=MAX_JOINTS).contains(&n);
                if !found.parse().is_ok_and(is_one) {
                    let found = found.to_owned();
                    problems.push(Problem::Joints { found });
                }
            }
        }
        let kinematics = self.get("KINS", "KINEMATICS").unwrap_or("trivkins");
        if kinematics.split_whitespace().next() != Some("trivkins") {
            let found = kinematics.to_owned();
            problems.push(Problem::Kinematics { found });
        }
        let period = self.get("EMCMOT", "SERVO_PERIOD").unwrap_or("1000000");
        let expected = expected.scan_ms * 1e6;
        let same =
            period.parse().is_ok_and(|found: f64| (found - expected).abs() <= 1e-3 * expected);
        if !same {
            problems.push(Problem::Period { found: period.to_owned(), expected });
        }
    }

    fn bridge(&self, expected: &Expected<'_>, problems: &mut Vec<Problem>) {
        let mut compare = |key: &'static str, default: Option<String>, required: String| match self
            .bridge_value(key)
            .or(default)
        {
            None => problems.push(Problem::Missing { key, expected: "a number" }),
            Some(found) => {
                let as_number = |text: &str| text.parse::<f64>().ok();
                let numbers = as_number(&found).zip(as_number(&required));
                let same = numbers
                    .map_or(found == required, |(a, b)| (a - b).abs() < 1e-6 * b.abs().max(1.0));
                if !same {
                    problems.push(Problem::Other { key, found, expected: required });
                }
            }
        };
        let control = expected.control;
        let has = |kind: AxisKind| control.axes.iter().any(|axis| axis.kind() == kind);
        let letters: String = control.axes.iter().map(|axis| axis.letter()).collect();
        compare("MACHINE", None, control.machine.to_string());
        compare("AXES", Some("XYZ".to_owned()), letters);
        compare("PORT", Some(PORT.to_string()), control.port.to_string());
        for keys in &numbers::KEYS {
            if has(keys.of) {
                let step = control.step_nano(keys.of).to_string();
                compare(keys.step, Some("1".to_owned()), step);
            }
        }
        self.numbers(expected, problems);
    }
}
