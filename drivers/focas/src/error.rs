//! Why a control cannot be used, or refuses.

use std::{io, net::SocketAddr};

use volcomp_port::{DeviceError, Fault, UnfitAxes};
use volcomp_vocabulary::AxisName;

use crate::{
    frame::Broken,
    pmc::{Block, PmcAddress, Width},
    return_code::ReturnCode,
};

/// Why a control cannot be reached, refuses a question, or is configured wrongly.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FocasError {
    /// The name of the host cannot be resolved.
    #[error("the name {host} cannot be resolved: {source}")]
    Resolve { host: String, source: io::Error },
    #[error("the name {0} has no address")]
    NoAddress(String),
    #[error("no connection to {address}: {source}")]
    Connect {
        address: SocketAddr,
        source: io::Error,
    },
    /// The control serves no more sessions.
    #[error("the session was refused")]
    SessionRefused,
    /// The connection was made, but no session could be opened on it.
    #[error("no session: {0}")]
    NoSession(#[source] Fault),
    /// The control refused a question or an order.
    #[error("{asked} was refused with {code}")]
    Refused { asked: String, code: ReturnCode },
    /// A question or an order got no answer, or one that cannot be read.
    #[error("{asked}: {source}")]
    Failed { asked: String, source: Fault },
    /// The control is to take the words of the shifts itself, and they do not have two bytes for each axis.
    #[error(
        "area.width: found {}, expected 2: the control takes two bytes for each axis; or area.copied = true, where a ladder copies the words on",
        .0.bytes()
    )]
    Width(Width),
    /// The control lacks an axis of the configuration.
    #[error("the control has no axis {name}, found {found}")]
    NoAxis { name: AxisName, found: String },
    /// Several axes of the control begin with the letter of an axis of the configuration.
    #[error(
        "axis {name}: found several axes of the control whose names begin with this letter, {found}, expected one"
    )]
    SameLetter { name: AxisName, found: String },
    /// Two blocks of bytes with a meaning of their own have bytes in common: what is written into one would change the
    /// other.
    #[error(
        "{one} {} {other}",
        if one.first == one.last { "lies within" } else { "overlap" }
    )]
    Overlap {
        /// The block that lies within the other, or overlaps it.
        one: Block,
        other: Block,
    },
    /// Something is to be written into an area of the PMC that is not the ladder's own memory.
    #[error("{key}: found {at}, expected a place in R or D: {}", at.area.holds())]
    NotWritable {
        /// The key of the configuration: `area.first`, `heartbeat`, `sequence`, `barrier.frame` or `barrier.report`.
        key: &'static str,
        at: PmcAddress,
    },
    /// Words would end beyond the largest address of an area.
    #[error(
        "{key}: found {first} for {points} words of {bytes} bytes each, expected words that end at byte 65535 at the latest"
    )]
    BeyondEnd {
        /// The key of the configuration: `area.first`, `barrier.frame` or `barrier.report`.
        key: &'static str,
        first: PmcAddress,
        points: usize,
        bytes: u16,
    },
    /// The control does not take shifts from the words that the configuration names.
    #[error("parameter {parameter} of the control ({meaning}): found {found}, expected {expected}")]
    Parameter {
        parameter: &'static str,
        meaning: &'static str,
        found: String,
        /// The value that fits the configuration, in words.
        expected: String,
    },
    /// The axes of the configuration, or what one count moves them, make no sense.
    #[error(transparent)]
    Axes(#[from] UnfitAxes),
    /// The requests of a cycle do not fit into a frame.
    #[error("the request of a cycle cannot be built: {0}")]
    Request(#[from] Broken),
}

impl FocasError {
    /// A fault of an exchange in which something was asked for.
    pub(crate) fn asking(asked: impl Into<String>, fault: Fault) -> Self {
        let asked = asked.into();
        match fault {
            Fault::Refused { code, .. } => Self::Refused {
                asked,
                code: ReturnCode(i16::try_from(code).unwrap_or(i16::MAX)),
            },
            source => Self::Failed { asked, source },
        }
    }

    /// Advice on how to remedy the error.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::Resolve { .. } | Self::NoAddress(_) => "check the host",
            Self::Connect { .. } => {
                "check the address, the cable and that FOCAS is enabled on the control"
            }
            Self::SessionRefused => {
                "end another program that talks to this control; it serves only a few"
            }
            Self::NoSession(_) => "check that this port is the control's FOCAS port",
            Self::Refused { .. } => {
                "check the address in the configuration and the options and parameters of the control"
            }
            Self::Failed { .. } => "check the cable and that the control is not overloaded",
            Self::SameLetter { .. } => {
                "leave this axis to the control: it cannot be told which one is meant"
            }
            Self::Width(_) => "state area.width = 2, or leave it out",
            Self::NoAxis { .. } => "correct the axes of the configuration",
            Self::Overlap { .. } => "name a byte that nothing else uses",
            Self::NotWritable { .. } => "name a byte in R or D that the ladder leaves free",
            Self::BeyondEnd { .. } => "begin at a lower address",
            Self::Parameter { .. } => {
                "correct the addresses of the configuration, or with the machine builder the parameters of the control"
            }
            Self::Axes(_) => "correct the axes, or what one count moves them",
            Self::Request(_) => "correct fewer axes",
        }
    }

    /// The error as drivers tell it: which device, what, what to do, and of which kind. This error is its source.
    pub fn of(self, device: impl Into<String>) -> DeviceError {
        let kind = match &self {
            Self::NoAxis { .. }
            | Self::Overlap { .. }
            | Self::NotWritable { .. }
            | Self::BeyondEnd { .. }
            | Self::SameLetter { .. }
            | Self::Width(_)
            | Self::Parameter { .. }
            | Self::Axes(_)
            | Self::Request(_) => DeviceError::option,
            Self::Resolve { .. }
            | Self::NoAddress(_)
            | Self::Connect { .. }
            | Self::SessionRefused => DeviceError::open,
            Self::NoSession(fault) | Self::Failed { source: fault, .. } => {
                DeviceError::of_fault_kind(*fault)
            }
            Self::Refused { .. } => DeviceError::protocol,
        };
        kind(device.into(), self.to_string(), self.remedy().to_owned()).caused_by(self)
    }
}
