//! Gateway instances: which of their messages are stored, when the gateways started, and whether two instances share
//! the identity of one machine.

use serde::{Deserialize, Serialize};

use crate::records::CreationTime;

/// Maximum number of remembered gateway instances of a machine. Instances active within a day of the newest one are
/// kept beyond this limit, up to [`MAX_INSTANCES_OF_A_DAY`], so that a redelivered batch is recognized regardless of
/// the number of restarts.
const MAX_INSTANCES: usize = 16;
const REMEMBERED_S: f64 = 86_400.0;
/// Maximum number of instances active within a day of the newest one: the number of messages in a batch.
const MAX_INSTANCES_OF_A_DAY: usize = 2048;
/// Minimum length of a window from which the start time of a gateway is estimated anew, s: clocks drift, and the
/// server's clock may be set.
const WINDOW_S: f64 = 300.0;
/// Maximum plausible time since start, s.
const MAX_UPTIME_S: f64 = 1e9;
/// Maximum age of a message on arrival, s; older creation times are clamped to it.
const MAX_AGE_S: f64 = 32.0 * 86_400.0;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Instance {
    pub instance: String,
    /// Storage time of the first message, s by the server's clock.
    pub first_s: f64,
    /// Storage time of the last message, s by the server's clock.
    pub heard_s: f64,
    /// Start of the gateway, s by the server's clock; too late by at most the transit time of its fastest message.
    pub start_s: f64,
    pub stored: Intervals,
    /// Stream sequence number of the first condition or full telemetry of this instance.
    pub passing_from: Option<u64>,
    /// Highest message number received when lost messages were last counted.
    #[serde(default)]
    pub counted_to: u64,
    /// Start time estimated from the latest conditions and telemetry.
    #[serde(default)]
    pub recent: Option<Recent>,
}

/// Start time of a gateway, estimated from the messages of two consecutive windows. Unlike [`Instance::start_s`] the
/// estimate follows clock drift. A window ends only when both the storage times and the creation times of its messages
/// span 300 s: a backlog sent after an hour without connection does not shift the estimate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[expect(clippy::struct_field_names, reason = "each ends with its unit")]
pub struct Recent {
    /// First message of the current window: storage time and time since the gateway's start, s.
    from_s: [f64; 2],
    /// Earliest start time derived from a message of the current window, s.
    start_s: f64,
    /// Earliest start time derived from a message of the previous window, s.
    before_s: f64,
}

impl Recent {
    fn of(stored_s: f64, uptime_s: f64) -> Self {
        let start_s = stored_s - uptime_s;
        Self { from_s: [stored_s, uptime_s], start_s, before_s: start_s }
    }

    /// Adds a message. Returns by how much its transit time exceeds the shortest one of the two windows, s.
    fn take(&mut self, stored_s: f64, uptime_s: f64) -> f64 {
        let start_s = stored_s - uptime_s;
        let [from_stored_s, from_uptime_s] = self.from_s;
        if stored_s - from_stored_s >= WINDOW_S && uptime_s - from_uptime_s >= WINDOW_S {
            *self = Self { before_s: self.start_s, ..Self::of(stored_s, uptime_s) };
        }
        self.start_s = self.start_s.min(start_s);
        (start_s - self.start_s.min(self.before_s)).max(0.0)
    }
}

/// Gateway instances of a machine, the newest last.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Instances {
    pub each: Vec<Instance>,
    /// Last time at which two instances were found to be active at the same time, s by the server's clock.
    pub cloned_s: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Header<'a> {
    pub instance: &'a str,
    pub number: u64,
    /// Time from the start of the gateway to the creation of the message, s.
    pub uptime_s: f64,
    /// Time at which the server stored the message, s.
    pub stored_s: f64,
    /// Sequence number of the message in the stream if it is a condition or full telemetry, which gateways send in the
    /// order of creation; otherwise `None`.
    pub passing: Option<u64>,
}

impl Instances {
    /// Adds a message. Returns when it was created, or `None` for a duplicate.
    ///
    /// The creation time is counted from the gateway's start, so a wrong gateway clock has no effect, and messages delayed by a lost connection get
    /// their true time.
    pub fn take(&mut self, message: &Header<'_>) -> Option<CreationTime> {
        let uptime_s = Some(message.uptime_s).filter(|s| (0.0..MAX_UPTIME_S).contains(s));
        let start_s = message.stored_s - uptime_s.unwrap_or(0.0);
        let known = self.each.iter().position(|one| one.instance == message.instance);
        let place = known.unwrap_or_else(|| {
            while self.each.len() >= MAX_INSTANCES {
                let silent = (0..self.each.len()).min_by(|one, other| {
                    self.each[*one].heard_s.total_cmp(&self.each[*other].heard_s)
                });
                let Some(place) = silent else { break };
                let since_s = message.stored_s - self.each[place].heard_s;
                if since_s < REMEMBERED_S && self.each.len() < MAX_INSTANCES_OF_A_DAY {
                    break;
                }
                self.each.remove(place);
            }
            self.each.push(Instance {
                instance: message.instance.to_owned(),
                first_s: message.stored_s,
                heard_s: message.stored_s,
                start_s,
                stored: Intervals::default(),
                passing_from: None,
                counted_to: 0,
                recent: None,
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
        let late_s = match uptime_s.filter(|_| message.passing.is_some()) {
            Some(uptime_s) => one
                .recent
                .get_or_insert_with(|| Recent::of(message.stored_s, uptime_s))
                .take(message.stored_s, uptime_s),
            None => 0.0,
        };
        if let Some(sequence) = message.passing {
            let from = one.passing_from.map_or(sequence, |from| from.min(sequence));
            one.passing_from = Some(from);
            // A gateway sends all messages created before a restart before those created after it. A message of an
            // earlier instance that follows a message of a later instance therefore comes from a second gateway. The
            // start times are compared too, because a server that lost its disk restarts its sequence numbers from 1.
            let first_s = one.first_s;
            let behind = self.each.iter().any(|other| {
                other.passing_from.is_some_and(|later| from < later && later < sequence)
                    && other.first_s > first_s
            });
            if behind {
                self.cloned_s = Some(message.stored_s);
            }
        }
        Some(CreationTime {
            at_s: made_s.clamp(message.stored_s - MAX_AGE_S, message.stored_s),
            late_s: late_s.min(MAX_AGE_S),
        })
    }

    /// Number of permanently lost messages: missing numbers below the highest number at the previous count. Call it at
    /// intervals longer than any delivery delay.
    pub fn count_missing(&mut self) -> u64 {
        let mut missing = 0_u64;
        for one in &mut self.each {
            let missing_of_one = one.stored.missing_below(one.counted_to);
            missing = missing_of_one.saturating_add(missing);
            one.counted_to = one.stored.highest().unwrap_or(0);
        }
        missing
    }

    /// Instances with messages after `since_s`.
    pub fn active_since(&self, since_s: f64) -> impl Iterator<Item = &Instance> {
        self.each.iter().filter(move |one| one.heard_s >= since_s)
    }
}

/// Maximum number of intervals. Beyond that the lowest is dropped: its numbers are treated as unseen, so a message is never wrongly taken
/// for a duplicate.
const MAX_INTERVALS: usize = 256;

/// Closed intervals of whole numbers in ascending order, with gaps between them.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Intervals(Vec<(u64, u64)>);

impl Intervals {
    /// Adds a number. Returns true if it is new.
    pub fn insert(&mut self, number: u64) -> bool {
        // The first interval that ends at or after the number.
        let place = self.0.partition_point(|(_, last)| *last < number);
        if self.0.get(place).is_some_and(|(first, _)| *first <= number) {
            return false;
        }
        let after_last =
            place.checked_sub(1).filter(|before| self.0[*before].1.checked_add(1) == Some(number));
        let before_first =
            self.0.get(place).is_some_and(|(first, _)| number.checked_add(1) == Some(*first));
        match (after_last, before_first) {
            (Some(before), true) => {
                self.0[before].1 = self.0[place].1;
                self.0.remove(place);
            }
            (Some(before), false) => self.0[before].1 = number,
            (None, true) => self.0[place].0 = number,
            (None, false) => self.0.insert(place, (number, number)),
        }
        if self.0.len() > MAX_INTERVALS {
            self.0.remove(0);
        }
        true
    }

    pub fn highest(&self) -> Option<u64> {
        self.0.last().map(|(_, last)| *last)
    }

    /// Number of missing numbers between the lowest remembered number and `below`.
    pub fn missing_below(&self, below: u64) -> u64 {
        let holes = self.0.windows(2).map(|pair| (pair[0].1 + 1, pair[1].0));
        holes.map(|(from, to)| to.min(below).saturating_sub(from)).sum()
    }
}

impl TryFrom<String> for Intervals {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let wrong = || format!("found {text:?}, expected intervals such as 1-5,7-9");
        let mut intervals: Vec<(u64, u64)> = Vec::new();
        for part in text.split(',').filter(|part| !part.is_empty()) {
            let (first, last) = part.split_once('-').ok_or_else(wrong)?;
            let (Ok(first), Ok(last)) = (first.parse(), last.parse::<u64>()) else {
                return Err(wrong());
            };
            let rises = intervals
                .last()
                .is_none_or(|(_, before)| before.checked_add(1).is_some_and(|next| next < first));
            if first > last || !rises {
                return Err(wrong());
            }
            intervals.push((first, last));
        }
        Ok(Self(intervals))
    }
}

impl From<Intervals> for String {
    fn from(intervals: Intervals) -> Self {
        let each = intervals.0.iter();
        let each: Vec<Self> = each.map(|(first, last)| format!("{first}-{last}")).collect();
        each.join(",")
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// Intervals match a plain set, up to the maximum number of stored intervals.
        #[test]
        fn intervals_match_a_set(numbers in proptest::collection::vec(prop_oneof![0_u64..60, u64::MAX - 5..=u64::MAX], 0..120), below in 0_u64..70) {
            let mut set = BTreeSet::new();
            let mut intervals = Intervals::default();
            for number in numbers {
                prop_assert_eq!(intervals.insert(number), set.insert(number));
            }
            prop_assert_eq!(intervals.highest(), set.last().copied());
            if let (Some(first), Some(last)) = (set.first(), set.last()) {
                let missing = (*first..below.min(*last)).filter(|number| !set.contains(number)).count() as u64;
                prop_assert_eq!(intervals.missing_below(below), missing);
            }
            let text = String::from(intervals.clone());
            prop_assert_eq!(Intervals::try_from(text).unwrap(), intervals);
        }

        #[test]
        fn any_text_is_rejected_or_parsed(text in "[0-9,-]{0,20}") {
            if let Ok(mut intervals) = Intervals::try_from(text) {
                intervals.insert(3);
                let text = String::from(intervals.clone());
                prop_assert_eq!(Intervals::try_from(text).unwrap(), intervals);
            }
        }
    }

    #[test]
    fn dropped_intervals_count_as_unseen() {
        let mut intervals = Intervals::default();
        for number in 0..300 {
            assert!(intervals.insert(2 * number));
        }
        assert!(intervals.insert(0), "forgotten");
        assert!(!intervals.insert(598), "remembered");
        assert!(intervals.0.len() <= MAX_INTERVALS);
    }

    fn message(instance: &str, number: u64, stored_s: f64, sequence: u64) -> Header<'_> {
        Header { instance, number, uptime_s: number as f64, stored_s, passing: Some(sequence) }
    }

    #[test]
    fn a_backlog_gets_its_creation_times() {
        let mut instances = Instances::default();
        let mut made = |message: &Header<'_>| instances.take(message).map(|made| made.at_s);
        assert_eq!(made(&message("a", 5, 105.0, 1)), Some(105.0));
        // 1000 s without connection, then all messages at once.
        for number in 6..1005 {
            let made_s = made(&message("a", number, 1105.0, number));
            assert_eq!(made_s, Some(100.0 + number as f64));
        }
        assert_eq!(instances.take(&message("a", 6, 1106.0, 2000)), None, "twice");
        assert_eq!(instances.cloned_s, None);
    }

    /// A gateway is disconnected for an hour and then sends its queue. Then the server's clock drifts, and is set.
    #[test]
    fn a_delayed_message_is_late_and_clock_errors_are_not() {
        let mut instances = Instances::default();
        let mut number = 0;
        let mut late = |made_s: f64, stored_s: f64| {
            number += 1;
            let message =
                Header { instance: "a", number, uptime_s: made_s, stored_s, passing: Some(number) };
            instances.take(&message).map(|made| made.late_s)
        };
        for second in 0..1000 {
            assert_eq!(late(second.into(), 5000.0 + f64::from(second)), Some(0.0));
        }
        // A queue of one hour is sent at a thousand messages per second: the first is late by an hour, the last is not
        // late.
        for second in 1000..4600_u32 {
            let stored_s = 9600.0 + f64::from((second - 1000) / 1000);
            let reported = late(second.into(), stored_s);
            assert_eq!(reported, Some(stored_s - 5000.0 - f64::from(second)));
        }
        // A clock drift of 100 ppm for ten days, in which the start seems to move by 86 s.
        for minute in 1..14_400 {
            let made_s = 4600.0 + 60.0 * f64::from(minute);
            let reported = late(made_s, 9604.0 + 60.006 * f64::from(minute));
            assert!(reported.is_some_and(|late_s| late_s < 4.5), "{reported:?}");
        }
        // The clock of the server is set by an hour: after two windows of five minutes the delays are correct again.
        for minute in 14_400..14_420 {
            let made_s = 4600.0 + 60.0 * f64::from(minute);
            let reported = late(made_s, 13_204.0 + 60.006 * f64::from(minute));
            assert!(minute < 14_411 || reported < Some(0.5), "{minute}: {reported:?}");
        }
    }

    #[test]
    fn remembered_instances_are_bounded() {
        let mut instances = Instances::default();
        for start in 0..3000_u32 {
            let name = start.to_string();
            instances.take(&message(&name, 1, f64::from(start), start.into()));
        }
        assert_eq!(instances.each.len(), MAX_INSTANCES_OF_A_DAY);
        instances.take(&message("later", 1, 200_000.0, 4000));
        assert_eq!(instances.each.len(), MAX_INSTANCES);
    }

    #[test]
    fn a_restart_is_no_clone_but_simultaneous_instances_are() {
        let mut instances = Instances::default();
        for number in 1..10 {
            instances.take(&message("a", number, 100.0, number));
        }
        // After a restart, an acknowledgement overtakes the remaining messages of the previous run.
        let ack = Header { passing: None, ..message("b", 1, 110.0, 1) };
        instances.take(&ack);
        instances.take(&message("a", 10, 111.0, 10));
        instances.take(&message("b", 2, 112.0, 11));
        assert_eq!(instances.cloned_s, None);
        // The server redelivers a message that is already stored.
        instances.take(&message("a", 10, 113.0, 12));
        assert_eq!(instances.cloned_s, None);
        instances.take(&message("a", 11, 114.0, 13));
        assert_eq!(instances.cloned_s, Some(114.0));
    }

    /// The streams of the server are recreated: sequence numbers restart from 1. Then the gateway restarts.
    #[test]
    fn a_new_stream_makes_no_clone() {
        let mut instances = Instances::default();
        for number in 1..10 {
            instances.take(&message("a", number, number as f64, 100 + number));
        }
        for number in 10..20 {
            instances.take(&message("a", number, number as f64, number - 9));
        }
        for number in 1..200 {
            instances.take(&message("b", number, (20 + number) as f64, 10 + number));
        }
        assert_eq!(instances.cloned_s, None);
        instances.take(&message("a", 20, 220.0, 210));
        assert_eq!(instances.cloned_s, Some(220.0), "it still runs");
    }

    #[test]
    fn missing_messages_are_counted_at_the_second_count() {
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
    fn invalid_times_are_ignored() {
        let mut instances = Instances::default();
        for uptime_s in [f64::NAN, f64::INFINITY, -1.0, 1e300] {
            let made =
                instances.take(&Header { uptime_s, ..message("a", uptime_s.to_bits(), 50.0, 1) });
            assert_eq!(made.map(|made| made.at_s), Some(50.0));
        }
    }
}
