//! Errors of a device in set-up ([`DeviceError`]) and in a real-time cycle ([`Fault`]).

use std::{error::Error, fmt, sync::Arc};

/// An error in setting up, opening or querying a device. The first three kinds are mistakes of the caller, detected
/// before a device is opened ([`DeviceError::is_input`]). The other kinds are failures of the device or its connection.
#[derive(Clone, Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DeviceError {
    /// The text is not a valid device address.
    #[error(transparent)]
    Address(DeviceProblem),
    /// A setting of the device is invalid. Settings are in the URL, in a file or in the configuration.
    #[error(transparent)]
    Option(DeviceProblem),
    /// The device, or this build of the program, does not support what was requested.
    #[error(transparent)]
    Unsupported(DeviceProblem),
    /// The device does not exist, is in use by another program, or refuses the connection.
    #[error(transparent)]
    Open(DeviceProblem),
    /// The device does not answer in time.
    #[error(transparent)]
    NoAnswer(DeviceProblem),
    /// The device rejects the request, or its response violates the protocol.
    #[error(transparent)]
    Protocol(DeviceProblem),
}

/// Content of every [`DeviceError`]: which device failed, what was found, and what was expected.
#[derive(Clone, Debug)]
pub struct DeviceProblem {
    /// Name of the device: its URL or its name in the configuration.
    pub device: String,
    pub found: String,
    /// Expected value or state, or advice.
    pub expected: String,
    /// Error that caused this error; `None` if there is no cause.
    pub source: Option<Arc<dyn Error + Send + Sync>>,
}

impl fmt::Display for DeviceProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}; {}", self.device, self.found, self.expected)
    }
}

impl Error for DeviceProblem {
    fn source(&self) -> Option<&(dyn Error + 'static)> {
        self.source.as_ref().map(|source| &**source as _)
    }
}

macro_rules! constructors {
    ($($(#[$doc:meta])* $name:ident => $kind:ident),* $(,)?) => {$(
        $(#[$doc])*
        pub fn $name(
            device: impl Into<String>,
            found: impl Into<String>,
            expected: impl Into<String>,
        ) -> Self {
            Self::$kind(DeviceProblem {
                device: device.into(),
                found: found.into(),
                expected: expected.into(),
                source: None,
            })
        }
    )*};
}

impl DeviceError {
    constructors! {
        address => Address,
        option => Option,
        unsupported => Unsupported,
        open => Open,
        no_answer => NoAnswer,
        protocol => Protocol,
    }

    /// Sets the error that caused this error.
    #[must_use]
    pub fn caused_by(mut self, source: impl Error + Send + Sync + 'static) -> Self {
        self.problem_mut().source = Some(Arc::new(source));
        self
    }

    pub fn problem(&self) -> &DeviceProblem {
        match self {
            Self::Address(problem)
            | Self::Option(problem)
            | Self::Unsupported(problem)
            | Self::Open(problem)
            | Self::NoAnswer(problem)
            | Self::Protocol(problem) => problem,
        }
    }

    fn problem_mut(&mut self) -> &mut DeviceProblem {
        match self {
            Self::Address(problem)
            | Self::Option(problem)
            | Self::Unsupported(problem)
            | Self::Open(problem)
            | Self::NoAnswer(problem)
            | Self::Protocol(problem) => problem,
        }
    }

    /// True if the caller's input is invalid (exit status 2 of the programs), false if the device fails (exit status
    /// 1).
    pub fn is_input(&self) -> bool {
        matches!(self, Self::Address(_) | Self::Option(_) | Self::Unsupported(_))
    }

    /// Selects the constructor for the kind of error that this fault is. Its arguments are device, found and expected.
    pub fn of_fault_kind(fault: Fault) -> fn(String, String, String) -> Self {
        match fault {
            Fault::NotConnected | Fault::Disconnected => Self::open,
            Fault::TimedOut => Self::no_answer,
            Fault::Unsupported(_) => Self::unsupported,
            _ => Self::protocol,
        }
    }

    /// Error for an exchange that failed with `fault`, which becomes the source of the error.
    pub fn of_fault(device: impl Into<String>, fault: Fault, expected: impl Into<String>) -> Self {
        let kind = Self::of_fault_kind(fault);
        kind(device.into(), fault.to_string(), expected.into()).caused_by(fault)
    }
}

/// Reason why a call in a real-time cycle failed. Creating a fault does not allocate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Fault {
    /// There is no connection. A background thread is reconnecting.
    #[error("not connected")]
    NotConnected,
    /// The deadline passed before the answer was complete. If a late answer could be taken for the next one, the
    /// connection is dropped.
    #[error("no answer before the deadline")]
    TimedOut,
    /// The other side closed the connection, or the device was removed.
    #[error("connection lost")]
    Disconnected,
    /// The answer violates the protocol.
    #[error("invalid answer: {0}")]
    Protocol(&'static str),
    /// The device refused the request.
    #[error("refused with code {code}: {what}")]
    Refused {
        /// Return code of the device.
        code: i32,
        /// The rejected request or the meaning of the code, in words.
        what: &'static str,
    },
    /// Another gateway corrects this controller.
    #[error("another gateway moves the heartbeat")]
    OtherGateway,
    /// Not every axis has its correction yet, because axes that share lines are written one after the other. Repeat the
    /// call with the same corrections.
    #[error("not every axis is written yet")]
    Unfinished,
    /// The device does not support this call.
    #[error("not supported: {0}")]
    Unsupported(&'static str),
}
