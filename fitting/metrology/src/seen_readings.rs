//! One test under two names.

use std::collections::{BTreeMap, BTreeSet, btree_map::Entry};

use crate::{Direction, Measurement};

/// With fewer different deviations two tests may well be alike.
const FEWEST_DIFFERENT: usize = 3;

/// The tests that were seen, by their readings. No two tests scatter alike: where a second one has the readings of a first, it is
/// most likely the same test under another name.
#[derive(Debug, Clone)]
pub struct SeenReadings<T> {
    /// Target, run, direction and size of the deviation of each reading, and what was said to have them first.
    first: BTreeMap<Vec<[u64; 4]>, T>,
}

impl<T> Default for SeenReadings<T> {
    fn default() -> Self {
        Self {
            first: BTreeMap::new(),
        }
    }
}

impl<T> SeenReadings<T> {
    /// What was seen before with the same readings, signs of deviations apart; where nothing was, `this` is what later ones are told.
    /// `None` also for readings with fewer than three different deviations, which say nothing.
    pub fn before(&mut self, measurement: &Measurement, this: T) -> Option<&T> {
        let key: Vec<[u64; 4]> = (measurement.readings.iter())
            .map(|reading| {
                [
                    // 0 and −0 are one target.
                    (reading.target + 0.0).to_bits(),
                    u64::from(reading.run),
                    u64::from(reading.direction == Direction::Negative),
                    reading.deviation.abs().to_bits(),
                ]
            })
            .collect();
        let different: BTreeSet<u64> = key.iter().map(|of| of[3]).collect();
        if different.len() < FEWEST_DIFFERENT {
            return None;
        }
        match self.first.entry(key) {
            Entry::Occupied(known) => Some(known.into_mut()),
            Entry::Vacant(place) => {
                place.insert(this);
                None
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parse_csv;

    #[test]
    fn a_test_under_another_name_is_told_whatever_its_sign() {
        let mut seen = SeenReadings::default();
        let mut before = |name: &'static str, rows: &str| {
            let text = format!("target,run,direction,deviation\n{rows}");
            let measurement = parse_csv(text.as_bytes(), name).unwrap();
            seen.before(&measurement, name).copied()
        };
        assert_eq!(before("a", "0,1,+,1\n10,1,+,2\n20,1,+,4\n"), None);
        assert_eq!(before("b", "0,1,+,-1\n10,1,+,-2\n20,1,+,-4\n"), Some("a"));
        assert_eq!(before("c", "0,1,+,1\n10,1,+,2\n20,1,+,4\n"), Some("a"));
        // The other direction, another deviation.
        assert_eq!(before("d", "20,1,-,4\n10,1,-,2\n0,1,-,1\n"), None);
        assert_eq!(before("e", "0,1,+,1\n10,1,+,2\n20,1,+,4.1\n"), None);
        // Two different deviations are often alike.
        assert_eq!(before("f", "0,1,+,0\n10,1,+,1\n20,1,+,1\n"), None);
        assert_eq!(before("g", "0,1,+,0\n10,1,+,1\n20,1,+,1\n"), None);
    }
}
