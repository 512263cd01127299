//! The INI file of a LinuxCNC: what of it stands in the way of a correction.

use volcomp_vocabulary::{AxisKind, AxisName};

use crate::PORT;

/// An INI file of LinuxCNC: sections, keys and values as they are written.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ini(Vec<(String, String, String)>);

/// What is expected of an INI file.
#[derive(Clone, Debug, PartialEq)]
pub struct Expected {
    /// The number of the machine.
    pub machine: u16,
    /// The UDP port of the bridge.
    pub port: u16,
    /// The axes that are corrected, in the order of the configuration.
    pub axes: Vec<AxisName>,
    /// The size of a count of linear axes, nm.
    pub step_nm: f64,
    /// The size of a count of rotary axes, millionths of a degree.
    pub step_udeg: f64,
    /// The period of the servo thread, ms.
    pub scan_ms: f64,
}

/// What is wrong or missing in an INI file.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Problem {
    /// The bridge is not loaded.
    #[error(
        "[HAL]HALFILE: volcomp.tcl or volcomp-servo.tcl is missing, expected one of them behind the file that loads the motion controller"
    )]
    NoHalFile,
    /// A key of the bridge is missing.
    #[error("[VOLCOMP]{key} is missing")]
    Missing {
        /// The key.
        key: &'static str,
    },
    /// A key of the bridge is not as the gateway is configured.
    #[error("[VOLCOMP]{key}: found {found}, expected {expected} as in the gateway's configuration")]
    Other {
        /// The key.
        key: &'static str,
        /// The value of this key in the INI file.
        found: String,
        /// What the gateway is configured for.
        expected: String,
    },
    /// An axis has no share of velocity for its offset.
    #[error(
        "[AXIS_{axis}]OFFSET_AV_RATIO is missing, expected a number such as 0.02: without it LinuxCNC takes no offset"
    )]
    NoRatio {
        /// The axis.
        axis: AxisName,
    },
    /// The share of an axis makes no sense.
    #[error(
        "[AXIS_{axis}]OFFSET_AV_RATIO: found {found}, expected more than 0 and at most 0.2: it is taken from the velocity of programs"
    )]
    Ratio {
        /// The axis.
        axis: AxisName,
        /// The value of this key in the INI file.
        found: String,
    },
    /// A joint has a compensation table of LinuxCNC, which would be added to ours.
    #[error(
        "[JOINT_{joint}]COMP_FILE: found {found}, expected none: its correction and that of the gateway would add up"
    )]
    CompFile {
        /// The joint.
        joint: String,
        /// The name of the table's file in the INI file.
        found: String,
    },
    /// A joint has a backlash of LinuxCNC, which would be added to ours.
    #[error(
        "[JOINT_{joint}]BACKLASH: found {found}, expected none or 0: the model of the machine has the reversal errors, and both would add up"
    )]
    Backlash {
        /// The joint.
        joint: String,
        /// The backlash in the INI file.
        found: String,
    },
    /// Lengths are not mm.
    #[error("[TRAJ]{key}: found {found}, expected {expected}: the bridge counts in these")]
    Units {
        /// The key.
        key: &'static str,
        /// The unit in the INI file.
        found: String,
        /// The unit that is expected.
        expected: &'static str,
    },
    /// The kinematics are not those of machine axes.
    #[error(
        "[KINS]KINEMATICS: found {found}, expected trivkins: with other kinematics LinuxCNC adds offsets to coordinates of the workpiece, not of the machine"
    )]
    Kinematics {
        /// The kinematics module in the INI file.
        found: String,
    },
    /// The servo thread has another period than the gateway is configured for.
    #[error(
        "[EMCMOT]SERVO_PERIOD: found {found} ns, expected {expected} ns, barrier.scan_ms of the gateway's configuration"
    )]
    Period {
        /// The period in the INI file, ns.
        found: String,
        /// The period of the configuration, ns.
        expected: f64,
    },
}

impl Ini {
    /// Reads a file as LinuxCNC does: keys before any section, and lines that are none, are passed over.
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
                // A comment behind a value begins with a blank.
                let end = [" #", "\t#", " ;", "\t;"]
                    .iter()
                    .filter_map(|mark| value.find(mark))
                    .min();
                let value = value[..end.unwrap_or(value.len())].trim();
                entries.push((section.clone(), key.trim().to_owned(), value.to_owned()));
            }
        }
        Self(entries)
    }

    /// The values of a key, in their order.
    pub fn all<'a>(&'a self, section: &'a str, key: &'a str) -> impl Iterator<Item = &'a str> {
        let of = move |(in_section, name, _): &&(String, String, String)| {
            in_section == section && name == key
        };
        self.0.iter().filter(of).map(|(_, _, value)| value.as_str())
    }

    /// The first value of a key, which is the one that counts.
    #[must_use]
    pub fn get(&self, section: &str, key: &str) -> Option<&str> {
        let of = |(in_section, name, _): &&(String, String, String)| {
            in_section == section && name == key
        };
        self.0.iter().find(of).map(|(_, _, value)| value.as_str())
    }

    /// Everything that is wrong or missing.
    #[must_use]
    pub fn problems(&self, expected: &Expected) -> Vec<Problem> {
        let mut problems = Vec::new();
        let is_ours = |file: &str| {
            let name = file.split_whitespace().next().unwrap_or_default();
            let name = name.rsplit('/').next();
            matches!(name, Some("volcomp.tcl" | "volcomp-servo.tcl"))
        };
        if !self.all("HAL", "HALFILE").any(is_ours) {
            problems.push(Problem::NoHalFile);
        }
        self.bridge(expected, &mut problems);
        for axis in &expected.axes {
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
        for (section, key, value) in &self.0 {
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
        let units = [
            ("LINEAR_UNITS", ["mm", "metric"]),
            ("ANGULAR_UNITS", ["degree", "deg"]),
        ];
        for (key, known) in units {
            if let Some(found) = self.get("TRAJ", key).filter(|unit| !known.contains(unit)) {
                problems.push(Problem::Units {
                    key,
                    found: found.to_owned(),
                    expected: known[0],
                });
            }
        }
        let kinematics = self.get("KINS", "KINEMATICS").unwrap_or("trivkins");
        if kinematics.split_whitespace().next() != Some("trivkins") {
            let found = kinematics.to_owned();
            problems.push(Problem::Kinematics { found });
        }
        let period = self.get("EMCMOT", "SERVO_PERIOD").unwrap_or("1000000");
        let expected = expected.scan_ms * 1e6;
        let same = period
            .parse()
            .is_ok_and(|found: f64| (found - expected).abs() <= 1e-3 * expected);
        if !same {
            problems.push(Problem::Period {
                found: period.to_owned(),
                expected,
            });
        }
        problems
    }

    /// The section of the bridge.
    fn bridge(&self, expected: &Expected, problems: &mut Vec<Problem>) {
        let mut compare = |key: &'static str, default: Option<String>, wanted: String| {
            let found = self
                .get("VOLCOMP", key)
                .map(|text| text.replace(' ', "").to_uppercase());
            match found.or(default) {
                None => problems.push(Problem::Missing { key }),
                Some(found) => {
                    let as_number = |text: &str| text.parse::<f64>().ok();
                    let numbers = as_number(&found).zip(as_number(&wanted));
                    let same = numbers.map_or(found == wanted, |(a, b)| {
                        (a - b).abs() < 1e-6 * b.abs().max(1.0)
                    });
                    if !same {
                        problems.push(Problem::Other {
                            key,
                            found,
                            expected: wanted,
                        });
                    }
                }
            }
        };
        let has = |kind: AxisKind| expected.axes.iter().any(|axis| axis.kind() == kind);
        let letters: String = expected.axes.iter().map(|axis| axis.letter()).collect();
        compare("MACHINE", None, expected.machine.to_string());
        compare("AXES", Some("XYZ".to_owned()), letters);
        compare("PORT", Some(PORT.to_string()), expected.port.to_string());
        let one = || Some("1".to_owned());
        if has(AxisKind::Linear) {
            compare("STEP_NM", one(), expected.step_nm.to_string());
        }
        if has(AxisKind::Rotary) {
            compare("STEP_UDEG", one(), expected.step_udeg.to_string());
        }
        let of_kind = [
            (AxisKind::Linear, ["LIMIT_UM", "RATE_UM_PER_S"]),
            (AxisKind::Rotary, ["LIMIT_MDEG", "RATE_MDEG_PER_S"]),
        ];
        for (kind, keys) in of_kind {
            for key in keys {
                if has(kind) && self.get("VOLCOMP", key).is_none() {
                    problems.push(Problem::Missing { key });
                }
            }
        }
    }
}
