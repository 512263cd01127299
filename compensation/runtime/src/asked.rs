//! The requests that a cycle receives from outside.

use volcomp_guard::{Reasons, Request};

/// The requests that a cycle receives from outside. The default asks for nothing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Asked {
    /// A request to the guard, such as arming.
    pub request: Option<Request>,
    /// Why arming is forbidden; empty where it is allowed.
    pub forbids: Reasons,
    /// Further reasons to report, which forbid nothing.
    pub notes: Reasons,
}
