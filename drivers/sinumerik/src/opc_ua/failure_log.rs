//! Logs the reason for a missing session once: repeated at every attempt it would bury the rest of the log.

use std::time::Duration;

/// A session that lasted this long is treated as a recovery: its end is logged even if the reason is the same as before. One that is lost
/// sooner, at every attempt, is the same failure.
const RECOVERED: Duration = Duration::from_secs(10);

/// The reason logged last.
#[derive(Debug, Default)]
pub(super) struct FailureLog(Option<String>);

impl FailureLog {
    /// Whether this reason is to be logged now. `lived` is how long the session lasted that it ended; zero if none was opened.
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

    /// A second loss of a control for the same reason must be logged as well (regression).
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
