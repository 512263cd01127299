//! Which numbers were seen, as intervals: what comes twice, and what is missing.

use std::{fmt, str::FromStr};

use serde::{Deserialize, Serialize};

/// So many intervals are remembered. Beyond that the lowest is forgotten: its numbers count as not seen, so that nothing is
/// ever taken for seen that was not.
const MOST: usize = 256;

/// Intervals of whole numbers, both ends included, in rising order, none touching the next.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Intervals(Vec<(u64, u64)>);

/// A text that tells no intervals.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("found {found:?}, expected intervals such as 1-5,7-9")]
pub struct NoIntervals {
    /// The text.
    pub found: String,
}

impl Intervals {
    /// Adds a number. Tells whether it is new.
    pub fn insert(&mut self, number: u64) -> bool {
        // The first interval that ends at the number or behind it.
        let place = self.0.partition_point(|(_, last)| *last < number);
        if self.0.get(place).is_some_and(|(first, _)| *first <= number) {
            return false;
        }
        let after_last = place
            .checked_sub(1)
            .filter(|before| self.0[*before].1.checked_add(1) == Some(number));
        let before_first = self
            .0
            .get(place)
            .is_some_and(|(first, _)| number.checked_add(1) == Some(*first));
        match (after_last, before_first) {
            (Some(before), true) => {
                self.0[before].1 = self.0[place].1;
                self.0.remove(place);
            }
            (Some(before), false) => self.0[before].1 = number,
            (None, true) => self.0[place].0 = number,
            (None, false) => self.0.insert(place, (number, number)),
        }
        if self.0.len() > MOST {
            self.0.remove(0);
        }
        true
    }

    /// The highest number.
    pub fn highest(&self) -> Option<u64> {
        self.0.last().map(|(_, last)| *last)
    }

    /// How many numbers are missing between the lowest that is remembered and `below`.
    pub fn missing_below(&self, below: u64) -> u64 {
        let holes = self.0.windows(2).map(|pair| (pair[0].1 + 1, pair[1].0));
        holes
            .map(|(from, to)| to.min(below).saturating_sub(from))
            .sum()
    }
}

impl fmt::Display for Intervals {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (place, (first, last)) in self.0.iter().enumerate() {
            if place > 0 {
                f.write_str(",")?;
            }
            write!(f, "{first}-{last}")?;
        }
        Ok(())
    }
}

impl FromStr for Intervals {
    type Err = NoIntervals;

    fn from_str(text: &str) -> Result<Self, NoIntervals> {
        let wrong = || NoIntervals {
            found: text.to_owned(),
        };
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

impl TryFrom<String> for Intervals {
    type Error = NoIntervals;

    fn try_from(text: String) -> Result<Self, NoIntervals> {
        text.parse()
    }
}

impl From<Intervals> for String {
    fn from(intervals: Intervals) -> Self {
        intervals.to_string()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// Against a plain set, up to the number of intervals that are remembered.
        #[test]
        fn it_is_a_set(numbers in proptest::collection::vec(prop_oneof![0_u64..60, u64::MAX - 5..=u64::MAX], 0..120), below in 0_u64..70) {
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
            let text = intervals.to_string();
            prop_assert_eq!(text.parse::<Intervals>().unwrap(), intervals);
        }

        #[test]
        fn any_text_is_told_or_read(text in "[0-9,-]{0,20}") {
            if let Ok(mut intervals) = text.parse::<Intervals>() {
                intervals.insert(3);
                prop_assert_eq!(intervals.to_string().parse::<Intervals>().unwrap(), intervals);
            }
        }
    }

    #[test]
    fn what_is_forgotten_counts_as_not_seen() {
        let mut intervals = Intervals::default();
        for number in 0..300 {
            assert!(intervals.insert(2 * number));
        }
        assert!(intervals.insert(0), "forgotten");
        assert!(!intervals.insert(598), "remembered");
        assert!(intervals.0.len() <= MOST);
    }
}
