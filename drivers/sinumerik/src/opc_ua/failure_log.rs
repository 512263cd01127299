//! Logs the reason for a missing session once: repeated at every attempt it would bury the rest of the log.

use std::time::Duration;

/// A session that lasted this long counts as a recovery: its end is logged even if the reason is the same as before. One that is lost sooner, at
/// every attempt, is the same failure.
const RECOVERED: Duration = Duration::from_secs(10);

/// The reason logged last.
#[derive(Debug, Default)]
pub(super) struct Said(Option<String>);

impl Said {
    /// Whether this reason is to be logged now. `lived` is how long the session lasted that it ended; zero if none was opened.
    pub(super) fn is_new(&mut self, trouble: &str, lived: Duration) -> bool {
        if lived < RECOVERED && self.0.as_deref() == Some(trouble) {
            return false;
        }
        self.0 = Some(trouble.to_owned());
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Before, a control that was lost a second time for the same reason was lost without a word.
    #[test]
    fn a_trouble_is_said_once_and_again_after_it_was_over() {
        let mut said = Said::default();
        let [short, long] = [1, 3600].map(Duration::from_secs);
        assert!(said.is_new("it does not answer", short));
        assert!(!said.is_new("it does not answer", short));
        assert!(said.is_new("it refuses", short));
        assert!(!said.is_new("it refuses", short));
        assert!(said.is_new("it refuses", long));
        assert!(!said.is_new("it refuses", short));
    }
}
