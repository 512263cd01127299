//! Why there is no session, said once: at every try it would bury everything else in the log.

use std::time::Duration;

/// A session that lasted for so long was there again: what ends it is told, although it is the same as before. One that is lost
/// sooner, at every try, is the trouble of before.
const RECOVERED: Duration = Duration::from_secs(10);

/// What was said last.
#[derive(Debug, Default)]
pub(super) struct Said(Option<String>);

impl Said {
    /// Whether this is to be said now. `lived`: how long the session lasted that it ended; zero where none was made.
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
