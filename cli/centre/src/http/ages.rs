//! How long ago each machine was heard, by the time that this program watches: two clocks that differ make no machine silent, and
//! keep no silent one alive.

use std::{collections::HashMap, time::Instant};

use volcomp_fleet::MachineId;

/// State: when the last message of each machine was seen to be a new one.
#[derive(Default)]
pub(super) struct Ages(HashMap<MachineId, Seen>);

struct Seen {
    heard_s: f64,
    at: Instant,
    /// How old it was when it was seen, s.
    then_s: f64,
}

impl Ages {
    /// The age of the last message of a machine, s, whose time of storage is `heard_s`; `now_s` is the time of this computer.
    pub(super) fn age_s(
        &mut self,
        machine: &MachineId,
        heard_s: f64,
        now_s: f64,
        now: Instant,
    ) -> f64 {
        match self.0.get_mut(machine) {
            Some(seen) if seen.heard_s == heard_s => {
                seen.then_s + now.saturating_duration_since(seen.at).as_secs_f64()
            }
            Some(seen) => {
                *seen = Seen {
                    heard_s,
                    at: now,
                    then_s: 0.0,
                };
                0.0
            }
            None => {
                // Nothing was watched yet: the clocks are all there is.
                let then_s = (now_s - heard_s).max(0.0);
                let seen = Seen {
                    heard_s,
                    at: now,
                    then_s,
                };
                self.0.insert(machine.clone(), seen);
                then_s
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use super::Ages;

    #[test]
    fn a_server_whose_clock_is_ahead_or_behind_changes_nothing() {
        let machine = "mill-1".parse().unwrap();
        for ahead_s in [-3600.0, 0.0, 3600.0] {
            let mut ages = Ages::default();
            let start = Instant::now();
            let at = |s: u64| start + Duration::from_secs(s);
            ages.age_s(&machine, 1000.0 + ahead_s, 1000.0, at(0));
            assert_eq!(ages.age_s(&machine, 1001.0 + ahead_s, 1001.0, at(1)), 0.0);
            // It falls silent.
            assert_eq!(ages.age_s(&machine, 1001.0 + ahead_s, 1010.0, at(10)), 9.0);
            // Somebody sets the clock of this computer back.
            assert_eq!(ages.age_s(&machine, 1001.0 + ahead_s, 5.0, at(20)), 19.0);
        }
    }
}
