//! Gateways as they are heard: which of their messages are stored, when they were started, and whether two of them have the
//! identity of one machine.

use serde::{Deserialize, Serialize};

use crate::intervals::Intervals;

/// So many gateways of a machine are remembered.
const MOST: usize = 16;
/// A time since the start that is longer is none, s.
const LONGEST_S: f64 = 1e9;
/// A message is not older than this when it comes, s: no gateway keeps one so long.
const OLDEST_S: f64 = 32.0 * 86_400.0;

/// One run of a gateway, from its start to its end.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Instance {
    /// What the gateway drew at its start.
    pub instance: String,
    /// When it was heard first, s by the server.
    pub first_s: f64,
    /// When it was heard last, s by the server.
    pub heard_s: f64,
    /// When it was started, s by the server: never later than that by more than its fastest message took.
    pub start_s: f64,
    /// The numbers of its messages that are stored.
    pub stored: Intervals,
    /// The place in the stream of its first condition or whole state.
    pub passing_from: Option<u64>,
    /// The highest number at the last count of what is missing.
    #[serde(default)]
    pub counted_to: u64,
}

/// The gateways that a machine has had, the newest last.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Instances {
    /// Each of them.
    pub each: Vec<Instance>,
    /// When two were heard at a time, s by the server.
    pub cloned_s: Option<f64>,
}

/// What a message of a gateway is, beside what it says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Header<'a> {
    /// What the gateway drew at its start.
    pub instance: &'a str,
    /// Its number.
    pub number: u64,
    /// How long after the start it was made, s.
    pub uptime_s: f64,
    /// When the server stored it, s.
    pub stored_s: f64,
    /// Its place in the stream, where it is a condition or a whole state: these are sent in the order in which they are made.
    pub passing: Option<u64>,
}

impl Instances {
    /// Takes a message. `None`: it is stored already; else when it was made, s by the clock of the server.
    ///
    /// The time is counted from the start of the gateway, so that a clock of a gateway which is wrong moves nothing, and what
    /// waited for the connection stands where it belongs.
    pub fn take(&mut self, message: &Header<'_>) -> Option<f64> {
        let uptime_s = Some(message.uptime_s).filter(|s| (0.0..LONGEST_S).contains(s));
        let start_s = message.stored_s - uptime_s.unwrap_or(0.0);
        let known = self
            .each
            .iter()
            .position(|one| one.instance == message.instance);
        let place = known.unwrap_or_else(|| {
            if self.each.len() >= MOST {
                let silent = (0..self.each.len()).min_by(|one, other| {
                    self.each[*one]
                        .heard_s
                        .total_cmp(&self.each[*other].heard_s)
                });
                silent.map(|place| self.each.remove(place));
            }
            self.each.push(Instance {
                instance: message.instance.to_owned(),
                first_s: message.stored_s,
                heard_s: message.stored_s,
                start_s,
                stored: Intervals::default(),
                passing_from: None,
                counted_to: 0,
            });
            self.each.len() - 1
        });
        let one = &mut self.each[place];
        one.heard_s = one.heard_s.max(message.stored_s);
        if !one.stored.insert(message.number) {
            return None;
        }
        one.start_s = one.start_s.min(start_s);
        let made_s = one.start_s + uptime_s.unwrap_or(message.stored_s - one.start_s);
        if let Some(sequence) = message.passing {
            let from = *one.passing_from.get_or_insert(sequence);
            // One gateway sends what it has made before its restart before what it makes after. A message of an earlier one
            // behind one of a later one comes from a second gateway.
            let behind = self.each.iter().any(|other| {
                other
                    .passing_from
                    .is_some_and(|later| from < later && later < sequence)
            });
            if behind {
                self.cloned_s = Some(message.stored_s);
            }
        }
        Some(made_s.clamp(message.stored_s - OLDEST_S, message.stored_s))
    }

    /// Counts what is missing for good: below what was the highest number at the count before, which was long ago enough.
    pub fn count_missing(&mut self) -> u64 {
        let mut missing = 0;
        for one in &mut self.each {
            missing += one.stored.missing_below(one.counted_to);
            one.counted_to = one.stored.highest().unwrap_or(0);
        }
        missing
    }

    /// The gateways that were heard after a time.
    pub fn heard_since(&self, since_s: f64) -> impl Iterator<Item = &Instance> {
        self.each.iter().filter(move |one| one.heard_s >= since_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(instance: &str, number: u64, stored_s: f64, sequence: u64) -> Header<'_> {
        Header {
            instance,
            number,
            uptime_s: number as f64,
            stored_s,
            passing: Some(sequence),
        }
    }

    #[test]
    fn a_backlog_stands_where_it_was_made() {
        let mut instances = Instances::default();
        assert_eq!(instances.take(&message("a", 5, 105.0, 1)), Some(105.0));
        // Cut off for 1000 s, then everything at once.
        for number in 6..1005 {
            let made = instances.take(&message("a", number, 1105.0, number));
            assert_eq!(made, Some(100.0 + number as f64));
        }
        assert_eq!(
            instances.take(&message("a", 6, 1106.0, 2000)),
            None,
            "twice"
        );
        assert_eq!(instances.cloned_s, None);
    }

    #[test]
    fn a_restart_is_no_clone_and_two_at_a_time_are() {
        let mut instances = Instances::default();
        for number in 1..10 {
            instances.take(&message("a", number, 100.0, number));
        }
        // Restarted: an acknowledgement overtakes what is left of the run before.
        let ack = Header {
            passing: None,
            ..message("b", 1, 110.0, 1)
        };
        instances.take(&ack);
        instances.take(&message("a", 10, 111.0, 10));
        instances.take(&message("b", 2, 112.0, 11));
        assert_eq!(instances.cloned_s, None);
        // What the server sends again is stored already.
        instances.take(&message("a", 10, 113.0, 12));
        assert_eq!(instances.cloned_s, None);
        instances.take(&message("a", 11, 114.0, 13));
        assert_eq!(instances.cloned_s, Some(114.0));
    }

    #[test]
    fn what_is_missing_is_counted_at_the_second_look() {
        let mut instances = Instances::default();
        for number in [1, 2, 5] {
            instances.take(&message("a", number, 1.0, number));
        }
        assert_eq!(instances.count_missing(), 0, "it may be under way");
        assert_eq!(instances.count_missing(), 2);
        instances.take(&message("a", 3, 2.0, 3));
        assert_eq!(instances.count_missing(), 1);
    }

    #[test]
    fn numbers_that_are_none_break_nothing() {
        let mut instances = Instances::default();
        for uptime_s in [f64::NAN, f64::INFINITY, -1.0, 1e300] {
            let made = instances.take(&Header {
                uptime_s,
                ..message("a", uptime_s.to_bits(), 50.0, 1)
            });
            assert_eq!(made, Some(50.0));
        }
    }
}
