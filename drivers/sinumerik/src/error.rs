use std::{path::PathBuf, time::Duration};

use volcomp_port::{DeviceError, UnfitAxes};
use volcomp_vocabulary::AxisName;

/// Errors of describing, reaching, reading or writing a control.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SinumerikError {
    #[error(transparent)]
    Axes(#[from] UnfitAxes),
    /// The axis numbers are not distinct numbers from 1 on, one for each axis.
    #[error(
        "numbers: found {found:?}, expected {axes} different numbers from 1 on, one for each axis"
    )]
    Numbers {
        found: Vec<u16>,
        /// Number of configured axes.
        axes: usize,
    },
    /// A required pattern of node ids is empty.
    #[error("nodes.{key}: found an empty text, expected a node id")]
    EmptyPattern {
        /// Key of the pattern below `nodes`.
        key: &'static str,
    },
    /// The pattern yields the positions of geometry axes instead of machine axes.
    #[error(
        "nodes.position: found {0:?}, expected machine coordinates, such as /Channel/MachineAxis/actToolBasePos[u1,{{axis}}]: work offsets, frames and TRAORI change those of a geometry axis"
    )]
    WorkpiecePosition(String),
    /// A pattern yields the same node for several axes.
    #[error(
        "nodes.{key}: found {found:?}, expected {{axis}} or {{db}} in it: every axis has its own node"
    )]
    OnePattern {
        /// Key of the pattern below `nodes`.
        key: &'static str,
        /// The pattern. It contains neither `{axis}` nor `{db}`.
        found: String,
    },
    /// The period is shorter than the sampling period of the control's server.
    #[error("period: found {} ms, expected {} ms or more: the server of the control samples no faster", .found.as_secs_f64() * 1e3, .shortest.as_millis())]
    Period {
        /// The configured period.
        found: Duration,
        shortest: Duration,
    },
    /// The timeout of requests is out of range.
    #[error("time-out: found {} ms, expected 10 ms to 60 s", .0.as_secs_f64() * 1e3)]
    TimeOut(Duration),
    /// A secure connection is configured without a folder of certificates.
    #[error(
        "security: found a secured connection without a folder of certificates (pki), expected one"
    )]
    NoCertificates,
    /// A certificate or key is missing, invalid, expired, or readable by others.
    #[error("{}: found {found}, expected {expected}", .file.display())]
    Certificate {
        /// Certificate or key file.
        file: PathBuf,
        found: String,
        expected: String,
    },
    /// The server's certificate is not among the trusted certificates.
    #[error(
        "found a server that is not trusted, fingerprint (SHA-1) {fingerprint}, expected one in {}: compare the fingerprint with the one that the control shows, then move {} there", .trusted.display(), .file.display()
    )]
    Untrusted {
        /// SHA-1 fingerprint of the server's certificate.
        fingerprint: String,
        /// File in which the certificate was saved.
        file: PathBuf,
        trusted: PathBuf,
    },
    /// The server does not offer the configured message security.
    #[error(
        "security: found a server that offers {}, expected {expected} among them: enable it at the control, or set another `security`", .offered.join(", ")
    )]
    Protection {
        /// Message security that the server offers.
        offered: Vec<String>,
        expected: String,
    },
    /// The OPC UA client rejected its configuration.
    #[error("the OPC UA client cannot be set up: {0}")]
    Client(String),
    /// The server cannot be reached.
    #[error("no connection: {0}")]
    Connect(String),
    /// The server did not answer in time, so the session was closed.
    #[error("no answer within {} ms, so the session was closed", .0.as_secs_f64() * 1e3)]
    TimedOut(Duration),
    /// The server does not have the configured namespace.
    #[error("found the namespaces {}, expected {expected} among them", found.join(", "))]
    NoNamespace {
        /// The configured namespace.
        expected: String,
        found: Vec<String>,
    },
    /// A node cannot be read, or its value is not a number.
    #[error("node {node}: {found}, expected a readable value")]
    Node {
        node: String,
        /// Status that the server reports for the node, or the value of the node.
        found: String,
    },
    /// The temperature compensation of an axis is switched off, so the control ignores its correction.
    #[error(
        "axis {axis}: MD32750 $MA_TEMP_COMP_TYPE is {found}, expected bit 0 set (1 or 3): the control ignores SD43900 otherwise, and writing would not move the axis; set it at the control and activate it there"
    )]
    SwitchedOff {
        axis: AxisName,
        /// Value of machine data 32750.
        found: u32,
    },
    /// The axis with the configured number has another name in the control.
    #[error(
        "axis {axis}: the control calls axis {number} {found:?}, expected a name that begins with {axis}; set other numbers, or another pattern nodes.name"
    )]
    OtherAxis {
        axis: AxisName,
        /// Number of the axis in the control, from 1.
        number: u16,
        found: String,
    },
    /// A response violates the protocol.
    #[error("invalid answer: {0}")]
    Answer(&'static str),
}

impl SinumerikError {
    /// Converts the error to a [`DeviceError`] of the device with this URL.
    pub fn of(self, device: impl Into<String>) -> DeviceError {
        let text = self.to_string();
        let (found, expected) = text.split_once(", expected ").map_or(
            (text.clone(), "check the address, the cable and the server's log".to_owned()),
            |(found, expected)| (found.to_owned(), format!("expected {expected}")),
        );
        let make = match &self {
            Self::Axes(_)
            | Self::Numbers { .. }
            | Self::EmptyPattern { .. }
            | Self::WorkpiecePosition(_)
            | Self::OnePattern { .. }
            | Self::Period { .. }
            | Self::TimeOut(_)
            | Self::NoCertificates
            | Self::Certificate { .. }
            | Self::Client(_) => DeviceError::option,
            Self::Connect(_) | Self::Untrusted { .. } | Self::Protection { .. } => {
                DeviceError::open
            }
            Self::TimedOut(_) => DeviceError::no_answer,
            Self::NoNamespace { .. }
            | Self::Node { .. }
            | Self::SwitchedOff { .. }
            | Self::OtherAxis { .. }
            | Self::Answer(_) => DeviceError::protocol,
        };
        make(device.into(), found, expected).caused_by(self)
    }
}
