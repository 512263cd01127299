//! What a machine tells: conditions, whole states, audit records and acknowledgements, each in an envelope.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use volcomp_vocabulary::AxisName;

/// What every message of a machine carries. `instance` and `number` name a message, so that one sent twice counts once, and
/// two programs with the identity of one machine are seen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Envelope<T> {
    /// Drawn at every start of the gateway.
    pub instance: String,
    /// The number of the message since the start, counted over all kinds.
    pub number: u64,
    /// Seconds since the start of the gateway when it was made.
    pub uptime_s: f64,
    /// Seconds since 1970 by the clock of the gateway, for people; nothing is decided by it.
    pub wall_s: f64,
    /// The version of the manifest that is in force; 0: none.
    pub version: u64,
    /// The checksum of the machine file that corrects, as `/api/state` tells it.
    pub model: String,
    pub body: T,
}

/// The condition of a machine in short, once a second.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Condition {
    /// The state of the guard, as `/api/state` tells it.
    pub state: String,
    /// Why the state is what it is, and what else is to be known.
    pub reasons: Vec<String>,
    /// Whether it corrects, or will again by itself.
    pub armed: bool,
    /// The correction that is confirmed, µm by linear axis.
    pub correction_um: BTreeMap<AxisName, f64>,
    /// The correction that is confirmed, µrad by rotary axis.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub correction_urad: BTreeMap<AxisName, f64>,
    /// The position error that the model leaves, µm; `None` while it is not known.
    pub residual_um: Option<f64>,
    /// Temperatures by name, °C; `None` where one is broken.
    pub temperatures_degc: BTreeMap<String, Option<f64>>,
    /// The 99th percentile of the time of a cycle, µs.
    pub cycle_p99_us: f64,
    /// Cycles that took too long since the start.
    pub overruns: u64,
    /// Exchanges with controllers that failed since the start.
    pub faults: u64,
}

/// A record of the audit log, as it stands in the log of the machine. Each names the checksum of the one before, so that one
/// that is missing or was changed is seen.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AuditLine {
    /// SHA-256 over the checksum of the record before, a line feed, and `record`; 64 hexadecimal digits.
    pub checksum: String,
    /// The record, JSON of the schema `gateway-audit-record.json` of the gateway, byte by byte as it was written.
    pub record: String,
}

/// What became of a manifest.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "outcome", rename_all = "kebab-case")]
pub enum Outcome {
    /// It is in force: the correction has ramped, or ramps, over to it.
    Activated,
    /// It is on disk, and moves the axes so far that a person must confirm it (rule 13): a new manifest with `confirm`.
    NeedsConfirmation {
        hash: String,
        /// The largest move of a linear axis, µm, as text; empty where it is not finite.
        worst_um: String,
        /// The largest move of a rotary axis, µrad, as text; empty where there is none or it is not finite.
        worst_urad: String,
    },
    /// It was not accepted, or its machine file cannot be used; what ran before runs on.
    Refused { why: String },
}

/// How far a change moves the axes, in words, from the largest moves that [`Outcome::NeedsConfirmation`] tells.
pub fn largest_moves(worst_um: &str, worst_urad: &str) -> String {
    match (worst_um, worst_urad) {
        ("", "") => "a distance that is not finite".to_owned(),
        (um, "") => format!("{um} µm"),
        ("", urad) => format!("{urad} µrad"),
        (um, urad) => format!("{um} µm and {urad} µrad"),
    }
}

/// The answer to a manifest.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Acknowledgement {
    /// The version of the manifest that is answered; 0 where it could not be read.
    pub version: u64,
    /// SHA-256 of the bytes of the whole value that is answered, so that a foreign one is seen.
    pub value_sha256: String,
    #[serde(flatten)]
    pub outcome: Outcome,
}

#[cfg(test)]
mod tests {
    use super::largest_moves;

    /// No sentence ends with a unit that has no number.
    #[test]
    fn what_is_not_told_is_left_out() {
        assert_eq!(largest_moves("75.0", ""), "75.0 µm");
        assert_eq!(largest_moves("", "20.0"), "20.0 µrad");
        assert_eq!(largest_moves("75.0", "20.0"), "75.0 µm and 20.0 µrad");
        assert!(!largest_moves("", "").contains('µ'));
    }
}
