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
