//! Logs the reason for a missing session once, not at every attempt.

use std::time::Duration;

/// Minimum duration of a session after which a further failure with the same reason is logged again; a shorter session is part of the same
/// failure.
const RECOVERED: Duration = Duration::from_secs(10);

#[derive(Debug, Default)]
pub(super) struct FailureLog(Option<String>);

impl FailureLog {
    /// Whether to log this failure now. `lived` is the duration of the session that ended; zero if none was opened.
    pub(super) fn is_new(&mut self, failure: &str, lived: Duration) -> bool {
        if lived < RECOVERED && self.0.as_deref() == Some(failure) {
            return false;
        }
        self.0 = Some(failure.to_owned());
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A second loss of the session for the same reason must be logged as well (regression).
    #[test]
    fn a_failure_is_logged_once_and_again_after_a_recovery() {
        let mut failures = FailureLog::default();
        let [short, long] = [1, 3600].map(Duration::from_secs);
        assert!(failures.is_new("it does not answer", short));
        assert!(!failures.is_new("it does not answer", short));
        assert!(failures.is_new("it refuses", short));
        assert!(!failures.is_new("it refuses", short));
        assert!(failures.is_new("it refuses", long));
        assert!(!failures.is_new("it refuses", short));
    }
}
