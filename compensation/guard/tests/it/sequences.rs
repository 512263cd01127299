//! Random sequences of all faults on machines of three and five axes with one to three paths: no axis steps, or exceeds its slew or
//! limit. `VOLCOMP_SEQUENCES` is the number of sequences, `VOLCOMP_CYCLES` their length.

use std::{collections::VecDeque, time::Duration};

use proptest::prelude::*;
use volcomp_guard::{Request, State};
use volcomp_vocabulary::PerChannel;

use crate::machine::{KINDS, Kind, Machine};

fn environment(name: &str, otherwise: u32) -> u32 {
    let environment = std::env::var(name).ok();
    environment.and_then(|environment| environment.parse().ok()).unwrap_or(otherwise)
}

/// The checks after each cycle.
#[derive(Default)]
struct Watch {
    /// Times and corrections of the axes since the last restart of the time windows.
    trace: VecDeque<(f64, PerChannel<f64>)>,
}

impl Watch {
    fn look(&mut self, machine: &mut Machine) -> Result<(), String> {
        let seen = std::mem::take(&mut machine.seen);
        let (now, applied) = (machine.now.as_secs_f64(), machine.applied);
        if seen.changed || seen.began {
            self.trace.clear();
        }
        if !seen.changed && seen.step > 1.0 + 1e-6 {
            return Err(format!("a step of {} times what is allowed at {now} s", seen.step));
        }
        if seen.not_finite || !applied.iter().all(|value| value.is_finite()) {
            return Err(format!("no number at {now} s"));
        }
        if seen.out > 1.0 + 1e-6 {
            return Err(format!("{} of the limit at {now} s", seen.out));
        }
        // With a barrier the axis moves at the barrier's rate, which was checked at every scan.
        if matches!(machine.kind, Kind::Barrier | Kind::LinesWithTimeOut) {
            return Ok(());
        }
        let limits = machine.limits();
        for back in [1, 2, 3, 5, 9, 17, 33, 65, 129] {
            let Some((then, before)) = self.trace.len().checked_sub(back).map(|at| self.trace[at])
            else {
                break;
            };
            for i in 0..limits.count {
                let axis = &limits.axes[i];
                let most = axis.slew_per_s * (now - then) + 2.0 * axis.resolution;
                let moved = (applied[i] - before[i]).abs();
                if moved > most * (1.0 + 1e-6) {
                    return Err(format!(
                        "axis {i} moved by {moved} in {} s at {now} s",
                        now - then
                    ));
                }
            }
        }
        self.trace.push_back((now, applied));
        if self.trace.len() > 130 {
            self.trace.pop_front();
        }
        Ok(())
    }
}

/// Runs a sequence; returns the states that occurred, or the first violation.
fn run(seed: u64, kind: Kind, axes: usize, ways: usize, cycles: u32) -> Result<Vec<State>, String> {
    let mut machine = Machine::new(seed, kind, axes, ways);
    let mut watch = Watch::default();
    let mut states = Vec::new();
    for cycle in 0..cycles {
        // Before arming, a control with a barrier is observed for 1 s, a control without a barrier for 0.7 s.
        let request = if cycle > 400 && cycle % 8 == 0 {
            machine.random_event()
        } else {
            (cycle % 100 == 0).then_some(Request::Arm)
        };
        let dt = machine.next_dt();
        let output = machine.cycle(dt, request);
        watch
            .look(&mut machine)
            .map_err(|wrong| format!("cycle {cycle}, {:?}: {wrong}", output.state))?;
        if states.last() != Some(&output.state) {
            states.push(output.state);
        }
    }
    // After repair, acknowledgement and disarming the correction must go to zero.
    machine.repair();
    for cycle in 0..1600 {
        let request = match cycle {
            // Three acknowledgements, because a fault follows if a correction beyond the limit is found while
            // disarming, or is confirmed later.
            300 | 700 | 1100 => Some(Request::Acknowledge),
            320 | 720 | 1120 => Some(Request::Disarm),
            _ => None,
        };
        let dt = Duration::from_millis(4);
        let output = machine.cycle(dt, request);
        watch
            .look(&mut machine)
            .map_err(|wrong| format!("at the end, {cycle}, {:?}: {wrong}", output.state))?;
        if cycle > 1140 && output.state == State::Disarmed && !machine.holds() {
            return Ok(states);
        }
    }
    Err(format!("it does not come to rest: {:?}", machine.guard.state()))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(environment("VOLCOMP_SEQUENCES", 96)))]

    #[test]
    fn nothing_leaves_its_bounds(
        seed: u64,
        kind in prop::sample::select(KINDS.to_vec()),
        axes in prop::sample::select(vec![3_usize, 5]),
        ways in 1..=3_usize,
    ) {
        let cycles = environment("VOLCOMP_CYCLES", 2000);
        if let Err(wrong) = run(seed, kind, axes, ways, cycles) {
            prop_assert!(false, "{wrong}");
        }
    }
}

#[test]
fn sequences_visit_every_state() {
    for kind in KINDS {
        let mut seen = std::collections::BTreeSet::new();
        for seed in 0..60 {
            let (axes, ways) = (3 + 2 * (seed % 2), 1 + seed % 3);
            let states = run(seed as u64, kind, axes, ways, 4000).unwrap_or_default();
            seen.extend(states.into_iter().map(State::name));
        }
        let all = ["arming", "compensating", "disarmed", "faulted", "holding", "ramping-out"];
        assert_eq!(seen.into_iter().collect::<Vec<_>>(), all, "{kind:?}");
    }
}

#[test]
fn sequences_that_once_failed() {
    for (seed, kind, axes, ways, cycles) in FAILED {
        assert_eq!(
            run(seed, kind, axes, ways, cycles).map(|_| ()),
            Ok(()),
            "{seed} {kind:?} {axes} {ways}"
        );
    }
}

const FAILED: [(u64, Kind, usize, usize, u32); 6] = [
    (15841279278081801058, Kind::Late, 5, 3, 700),
    (9344477052774393391, Kind::Lossy, 5, 3, 1000),
    (15637356826912720972, Kind::Lossy, 5, 3, 1000),
    (13427742941852155154, Kind::Lines, 5, 1, 1000),
    (2102507349263377414, Kind::Late, 5, 3, 1000),
    (9392928835973895512, Kind::Late, 3, 1, 1000),
];
