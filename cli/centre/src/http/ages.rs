//! How long ago the last condition of each machine was made, by the time that this program watches: two clocks that differ make no
//! machine silent, and keep no silent one alive. For how long a condition waited at the gateway counts.

use std::{collections::HashMap, time::Instant};

use volcomp_fleet::MachineId;

use crate::records::ConditionMade;

/// State: when the last condition of each machine was seen to be a new one.
#[derive(Default)]
pub(super) struct Ages(HashMap<MachineId, Seen>);

struct Seen {
    made: ConditionMade,
    at: Instant,
    /// How old it was when it was seen, s.
    then_s: f64,
}

impl Ages {
    /// The age of the last condition of a machine, s; `now_s` is the time of this computer.
    pub(super) fn age_s(
        &mut self,
        machine: &MachineId,
        made: ConditionMade,
        now_s: f64,
        now: Instant,
    ) -> f64 {
        match self.0.get_mut(machine) {
            Some(seen) if seen.made == made => {
                seen.then_s + now.saturating_duration_since(seen.at).as_secs_f64()
            }
            Some(seen) => {
                *seen = Seen {
                    made,
                    at: now,
                    then_s: made.late_s,
                };
                made.late_s
            }
            None => {
                // Nothing was watched yet: the clocks are all there is.
                let then_s = (now_s - made.at_s).max(made.late_s);
                let seen = Seen {
                    made,
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
    use crate::records::ConditionMade;

    #[test]
    fn a_server_whose_clock_is_ahead_or_behind_changes_nothing() {
        let machine = "mill-1".parse().unwrap();
        let made = |at_s| ConditionMade { at_s, late_s: 0.0 };
        for ahead_s in [-3600.0, 0.0, 3600.0] {
            let mut ages = Ages::default();
            let start = Instant::now();
            let at = |s: u64| start + Duration::from_secs(s);
            ages.age_s(&machine, made(1000.0 + ahead_s), 1000.0, at(0));
            assert_eq!(
                ages.age_s(&machine, made(1001.0 + ahead_s), 1001.0, at(1)),
                0.0
            );
            // It falls silent.
            assert_eq!(
                ages.age_s(&machine, made(1001.0 + ahead_s), 1010.0, at(10)),
                9.0
            );
            // Somebody sets the clock of this computer back.
            assert_eq!(
                ages.age_s(&machine, made(1001.0 + ahead_s), 5.0, at(20)),
                19.0
            );
        }
    }
}
