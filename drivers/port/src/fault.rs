/// The reason why a call of a real-time cycle failed. Creating one does not allocate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Fault {
    /// There is no connection; a background thread is reconnecting.
    #[error("not connected")]
    NotConnected,
    /// The deadline passed before the answer was complete. A connection on which a late answer could be taken for the next one is dropped.
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
        /// The device's own code.
        code: i32,
        /// The request that was refused, in words.
        what: &'static str,
    },
    /// Another gateway corrects this controller.
    #[error("another gateway moves the heartbeat")]
    OtherGateway,
    /// Not every axis has its correction yet, because axes that share lines are written one after the other. Further calls with the same
    /// corrections continue.
    #[error("not every axis is written yet")]
    Unfinished,
    /// The device does not support this call.
    #[error("not supported: {0}")]
    Unsupported(&'static str),
}
