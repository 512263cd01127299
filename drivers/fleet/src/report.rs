//! Messages of a machine, each in an envelope: conditions, full telemetry, audit records and acknowledgements.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use volcomp_vocabulary::AxisName;

/// Common fields of every machine message. `instance` and `number` identify a message, so that duplicates are counted
/// once and two gateways with the identity of one machine are detected.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Envelope<T> {
    /// Random identifier, generated at every start of the gateway.
    pub instance: String,
    /// Number of the message since the start of the gateway, counted over all kinds of messages.
    pub number: u64,
    /// Time at which the message was created, in seconds since the start of the gateway.
    pub uptime_s: f64,
    /// Time at which the message was created, in seconds since 1970 by the gateway's clock. It is only displayed.
    pub wall_s: f64,
    /// Version of the active manifest; 0 if no manifest is active.
    pub version: u64,
    /// Checksum of the active machine file, as in `/api/state`.
    pub model: String,
    pub body: T,
}

/// Short condition of a machine, sent once a second by default.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Condition {
    pub state: String,
    pub reasons: Vec<String>,
    /// Whether the machine corrects, or will resume automatically.
    pub armed: bool,
    /// Confirmed correction of each linear axis, µm.
    pub correction_um: BTreeMap<AxisName, f64>,
    /// Confirmed correction of each rotary axis, µrad.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub correction_urad: BTreeMap<AxisName, f64>,
    /// Residual position error predicted by the model, µm; `None` if unknown.
    pub residual_um: Option<f64>,
    /// Temperature by sensor name, °C; `None` if the sensor is broken.
    pub temperatures_degc: BTreeMap<String, Option<f64>>,
    pub cycle_p99_us: f64,
    /// Number of cycles since the start that exceeded their period.
    pub overruns: u64,
    /// Number of failed exchanges with controllers since the start.
    pub faults: u64,
}

/// Record of the machine's audit log. Each record contains the checksum of the previous record, so that missing and
/// changed records are detected.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AuditLine {
    /// SHA-256 over the checksum of the previous record, a line feed, and `record`; 64 hexadecimal digits.
    pub checksum: String,
    /// The record exactly as written: JSON of the gateway's schema `gateway-audit-record.json`.
    pub record: String,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "outcome", rename_all = "kebab-case")]
pub enum Outcome {
    /// The model is active. The correction has ramped to it, or is still ramping.
    Activated,
    /// The manifest is stored, but its model moves the axes so far that the operator must confirm it (rule 13 of the
    /// guard). The confirmation is a new manifest with `confirm`.
    NeedsConfirmation {
        hash: String,
        /// Largest change of a linear axis, µm, as text; empty if not finite.
        worst_um: String,
        /// Largest change of a rotary axis, µrad, as text; empty if the machine has no rotary axis or the change is not
        /// finite.
        worst_urad: String,
        /// Indications that the model belongs to another machine, one sentence each.
        #[serde(default, skip_serializing_if = "Vec::is_empty")]
        differences: Vec<String>,
    },
    /// The manifest is rejected, or its machine file is invalid. The previous state stays active.
    Refused { why: String },
}

/// Describes in words the largest moves in [`Outcome::NeedsConfirmation`], and the indications of another machine.
pub fn largest_moves(worst_um: &str, worst_urad: &str, differences: &[String]) -> String {
    let mut words = match (worst_um, worst_urad) {
        ("", "") => "a distance that is not finite".to_owned(),
        (um, "") => format!("{um} µm"),
        ("", urad) => format!("{urad} µrad"),
        (um, urad) => format!("{um} µm and {urad} µrad"),
    };
    for difference in differences {
        words.extend(["; ", difference]);
    }
    words
}

/// Response of a gateway to a manifest from the centre.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Acknowledgement {
    /// Version of the manifest; 0 if the manifest could not be read.
    pub version: u64,
    /// SHA-256 of the whole value of the key. It reveals values that other clients put.
    pub value_sha256: String,
    #[serde(flatten)]
    pub outcome: Outcome,
}

#[cfg(test)]
mod tests {
    use super::largest_moves;

    #[test]
    fn unknown_values_are_omitted() {
        assert_eq!(largest_moves("75.0", "", &[]), "75.0 µm");
        assert_eq!(largest_moves("", "20.0", &[]), "20.0 µrad");
        assert_eq!(largest_moves("75.0", "20.0", &[]), "75.0 µm and 20.0 µrad");
        assert!(!largest_moves("", "", &[]).contains('µ'));
        let other = ["another name".to_owned()];
        assert_eq!(largest_moves("0.0", "", &other), "0.0 µm; another name");
    }
}
