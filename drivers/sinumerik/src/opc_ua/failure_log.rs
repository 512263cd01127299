//! Logs the reason for a missing session once instead of at every attempt.

use std::time::Duration;

/// Minimum duration of a session that counts as a recovery. After a recovery, the next failure is logged again even if
/// its reason is the same.
const RECOVERED: Duration = Duration::from_secs(10);

#[derive(Debug, Default)]
pub(super) struct FailureLog(Option<String>);

impl FailureLog {
    /// Whether to log this failure. `lived` is the duration of the session that ended, zero if none was opened.
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

    /// After a recovery, the loss of the session is logged again even if its reason is the same.
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
