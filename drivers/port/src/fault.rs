//! Why a call of a real-time cycle failed.

/// Why a call of a real-time cycle failed. Plain data: making one allocates nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Fault {
    /// There is no connection; a new one is being made in the background.
    #[error("not connected")]
    NotConnected,
    /// The deadline passed before the answer was whole. The connection is given up: a late answer must not
    /// be taken for the next one's.
    #[error("no answer before the deadline")]
    TimedOut,
    /// The other side closed the connection, or the device is gone.
    #[error("connection lost")]
    Disconnected,
    /// The answer is not what the protocol allows.
    #[error("broken answer: {0}")]
    Protocol(&'static str),
    /// The device refused the request.
    #[error("refused with code {code}: {what}")]
    Refused {
        /// The device's own code.
        code: i32,
        /// The request that was refused, in words.
        what: &'static str,
    },
    /// Another gateway corrects this controller.
    #[error("another gateway moves the heartbeat")]
    OtherGateway,
    /// Not every axis has its correction yet: they get them one after the other over lines that they share. Writing the
    /// same corrections again goes on with it.
    #[error("not every axis is written yet")]
    Unfinished,
    /// The device cannot do this.
    #[error("not supported: {0}")]
    Unsupported(&'static str),
}
