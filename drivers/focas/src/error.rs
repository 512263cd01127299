use std::{fmt, io, net::SocketAddr};

use volcomp_port::{DeviceError, Fault, UnfitAxes};
use volcomp_vocabulary::AxisName;

use crate::{
    frame::FrameError,
    pmc::{Block, PmcAddress, Width},
};

#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FocasError {
    #[error("the name {host} cannot be resolved: {source}")]
    Resolve { host: String, source: io::Error },
    #[error("the name {0} has no address")]
    NoAddress(String),
    #[error("no connection to {address}: {source}")]
    Connect { address: SocketAddr, source: io::Error },
    #[error("the session was refused")]
    SessionRefused,
    /// The TCP connection was made, but opening a session on it failed.
    #[error("no session: {0}")]
    NoSession(#[source] Fault),
    #[error("{request} was refused with {code}")]
    Refused { request: String, code: ReturnCode },
    /// A request timed out, or its response is unreadable.
    #[error("{request}: {source}")]
    Failed { request: String, source: Fault },
    /// The control takes the shift words directly, without a ladder, so each word must have two bytes.
    #[error(
        "area.width: found {}, expected 2: the control takes two bytes for each axis; or area.copied = true, where a ladder copies the words on",
        .0.bytes()
    )]
    Width(Width),
    #[error("the control has no axis {name}, found {found}")]
    NoAxis { name: AxisName, found: String },
    /// Several axes of the control have names that begin with the letter of a configured axis.
    #[error(
        "axis {name}: found several axes of the control whose names begin with this letter, {found}, expected one"
    )]
    SameLetter { name: AxisName, found: String },
    /// Two memory blocks overlap, so writing one would change the other.
    #[error(
        "{one} {} {other}",
        if one.first == one.last { "lies within" } else { "overlap" }
    )]
    Overlap {
        /// The block named first in the message.
        one: Block,
        other: Block,
    },
    /// A block that is written is in a PMC area outside the ladder's memory.
    #[error("{key}: found {at}, expected an address in R or D: {}", at.area.holds())]
    NotWritable {
        /// Configuration key: `area.first`, `heartbeat`, `sequence`, `barrier.frame` or `barrier.report`.
        key: &'static str,
        at: PmcAddress,
    },
    /// The words of a block extend beyond the largest address of an area.
    #[error(
        "{key}: found {first} for {points} words of {bytes} bytes each, expected words that end at byte 65535 at the latest"
    )]
    BeyondEnd {
        /// Configuration key: `area.first`, `barrier.frame` or `barrier.report`.
        key: &'static str,
        first: PmcAddress,
        points: usize,
        bytes: u16,
    },
    /// A parameter of the control does not match the configuration.
    #[error("parameter {parameter} of the control ({meaning}): found {found}, expected {expected}")]
    Parameter {
        parameter: &'static str,
        meaning: &'static str,
        found: String,
        /// Value that matches the configuration, in words.
        expected: String,
    },
    #[error(transparent)]
    Axes(#[from] UnfitAxes),
    #[error("the request of a cycle cannot be built: {0}")]
    Request(#[from] FrameError),
}

impl FocasError {
    pub(crate) fn in_request(request: impl Into<String>, fault: Fault) -> Self {
        let request = request.into();
        match fault {
            Fault::Refused { code, .. } => {
                Self::Refused { request, code: ReturnCode(i16::try_from(code).unwrap_or(i16::MAX)) }
            }
            source => Self::Failed { request, source },
        }
    }

    pub fn remedy(&self) -> &'static str {
        match self {
            Self::Resolve { .. } | Self::NoAddress(_) => "check the host",
            Self::Connect { .. } => {
                "check the address, the cable and that FOCAS is enabled on the control"
            }
            Self::SessionRefused => {
                "end another program that talks to this control; it supports few sessions"
            }
            Self::NoSession(_) => "check that this port is the control's FOCAS port",
            Self::Refused { .. } => {
                "check the address in the configuration and the options and parameters of the control"
            }
            Self::Failed { .. } => "check the cable and that the control is not overloaded",
            Self::SameLetter { .. } => {
                "leave this axis to the control: the letter does not identify one axis"
            }
            Self::Width(_) => "set area.width = 2, or omit it",
            Self::NoAxis { .. } => "correct the axes of the configuration",
            Self::Overlap { .. } => "use a byte that is not used otherwise",
            Self::NotWritable { .. } => "use a byte in R or D that the ladder does not use",
            Self::BeyondEnd { .. } => "use a lower first address",
            Self::Parameter { .. } => {
                "correct the addresses of the configuration, or with the machine builder the parameters of the control"
            }
            Self::Axes(_) => "correct the axes, or their displacement per count",
            Self::Request(_) => "correct fewer axes",
        }
    }

    /// Converts to a driver error with device, cause, remedy and kind. The source of the driver error is this error.
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

/// Return code of the control: 0 for success, otherwise the reason for the rejection. Names and numbers are those of
/// the manufacturer's library.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReturnCode(pub i16);

/// Each number with its name and meaning. The meanings are from public descriptions of the library.
const CODES: [(i16, &str); 31] = [
    (-17, "EW_PROTOCOL, the request is not what the protocol allows here"),
    (-16, "EW_SOCKET, the connection of the control fails"),
    (-15, "EW_NODLL, the control has no such library"),
    (-11, "EW_BUS, a bus inside the control fails"),
    (-9, "EW_HSSB, the serial bus to the control fails"),
    (-8, "EW_HANDLE, unknown session"),
    (-7, "EW_VERSION, the versions of the two sides do not fit together"),
    (-6, "EW_UNEXP, something unexpected failed"),
    (-5, "EW_SYSTEM, the system of the control fails"),
    (-4, "EW_PARITY, a parity error in the memory of the control"),
    (-3, "EW_MMCSYS, the user interface of the control fails"),
    (-2, "EW_RESET, the control was reset meanwhile"),
    (-1, "EW_BUSY, the control is busy"),
    (0, "EW_OK, done"),
    (1, "EW_FUNC, the control does not know this function or has no PMC"),
    (2, "EW_LENGTH, the length of the data is wrong"),
    (3, "EW_NUMBER, the number, address or range does not exist"),
    (4, "EW_ATTRIB, the attribute or type is wrong"),
    (5, "EW_DATA, the data are wrong"),
    (6, "EW_NOOPT, the control lacks the option for it"),
    (7, "EW_PROT, writing is protected"),
    (8, "EW_OVRFLOW, the memory of the control is full"),
    (9, "EW_PARAM, a parameter of the control forbids it"),
    (10, "EW_BUFFER, a buffer of the control is full or empty"),
    (11, "EW_PATH, the control has no such path"),
    (12, "EW_MODE, the mode of the control forbids it"),
    (13, "EW_REJECT, the control rejects it in its state"),
    (14, "EW_DTSRVR, the data server fails"),
    (15, "EW_ALARM, an alarm of the control forbids it"),
    (16, "EW_STOP, the control is stopped"),
    (17, "EW_PASSWD, a password protects it"),
];

impl ReturnCode {
    /// The control is busy. The same request may succeed later.
    pub const BUSY: Self = Self(-1);

    /// Name and meaning, such as `EW_NOOPT, the control lacks the option for it`.
    pub fn words(self) -> &'static str {
        CODES
            .iter()
            .find(|(number, _)| *number == self.0)
            .map_or("unknown code", |(_, words)| words)
    }

    /// Name in the manufacturer's library, such as `EW_NOOPT`; `None` for an unknown code.
    pub fn name(self) -> Option<&'static str> {
        let name = self.words().split(',').next()?;
        name.starts_with("EW_").then_some(name)
    }
}

impl From<ReturnCode> for volcomp_port::Fault {
    /// Converts the code to a fault of a real-time cycle. The fault contains name and meaning.
    fn from(code: ReturnCode) -> Self {
        Self::Refused { code: i32::from(code.0), what: code.words() }
    }
}

impl fmt::Display for ReturnCode {
    /// Formats number, name and meaning: `code 6: EW_NOOPT, the control lacks the option for it`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "code {}: {}", self.0, self.words())
    }
}
