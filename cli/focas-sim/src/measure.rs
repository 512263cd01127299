//! Measurement at the targets of a program: the machine stops at each target until the correction has settled.

use std::{
    sync::mpsc::Receiver,
    thread,
    time::{Duration, Instant},
};

use volcomp_focas::simulator::{Ladder, Simulator, World};
use volcomp_guard::{barrier::Report as BarrierReport, protocol::Layout};

use crate::{
    error::SimError,
    print,
    program::Stop,
    report::{Reporter, json, rounded},
    targets::{Line, Pass, Sheet, Target},
    walk::Walk,
};

const POLL_INTERVAL: Duration = Duration::from_millis(5);
/// Number of frames that must be accepted without a change before a correction counts as settled. The first frames may
/// have been computed or queued before the machine stopped, and on a busy computer all frames are late.
const FRAMES: u16 = 10;

#[derive(Clone, Copy)]
pub(crate) struct Settling {
    pub(crate) stands: Duration,
    /// Timeout after which the target is recorded as not settled.
    pub(crate) at_most: Duration,
    pub(crate) barrier: Option<(u16, Layout)>,
}

pub(crate) struct Measurement {
    pub(crate) walk: std::sync::Arc<Walk>,
    pub(crate) settling: Settling,
    pub(crate) reporter: Reporter,
    pub(crate) sheet: Sheet,
    pub(crate) json: bool,
}

impl Measurement {
    /// Runs the program once for each message, until the channel is closed.
    pub(crate) fn run(
        mut self,
        simulator: &Simulator,
        run_requests: &Receiver<()>,
    ) -> Result<(), SimError> {
        let mut pass = 0;
        while run_requests.recv().is_ok() {
            pass += 1;
            let pass = self.pass(pass, simulator)?;
            print(&if self.json { json(&pass) } else { pass.text() });
        }
        Ok(())
    }

    fn pass(&mut self, pass: u32, simulator: &Simulator) -> Result<Pass, SimError> {
        let mut targets = Vec::new();
        for index in 0..self.walk.stops.len() {
            self.go_to(index, simulator);
            let dwell = self.walk.dwells.get(index).copied().unwrap_or_default();
            match self.walk.stops.get(index).cloned() {
                Some(Stop::Target(line)) => {
                    let (settled, waited) = self.settle(dwell, simulator);
                    let target = Target {
                        pass,
                        number: targets.len() + 1,
                        line,
                        settled,
                        stood_s: rounded(waited.as_secs_f64()),
                        report: self.reporter.report(simulator),
                    };
                    self.sheet.write(&target)?;
                    targets.push(target);
                }
                Some(Stop::OnTheWay) | None => thread::sleep(dwell),
            }
        }
        Ok(Pass {
            number: pass,
            targets: targets.len(),
            not_settled: targets.iter().filter(|target| !target.settled).count(),
            lines: Line::of(&targets),
        })
    }

    /// Moves to the end of the move `index`, and records the direction of each axis.
    fn go_to(&mut self, index: usize, simulator: &Simulator) {
        self.walk.go_to(index, simulator.world().moved_for());
        while !self.walk.has_arrived(simulator.world().moved_for()) {
            self.reporter.watch(simulator);
            thread::sleep(POLL_INTERVAL);
        }
        self.reporter.watch(simulator);
    }

    /// Returns whether the correction has settled, and the time waited.
    fn settle(&self, dwell: Duration, simulator: &Simulator) -> (bool, Duration) {
        let arrived = Instant::now();
        let mut stability = Stability::since(arrived, self.sample(simulator));
        loop {
            thread::sleep(POLL_INTERVAL);
            stability.update(self.sample(simulator));
            let settled = stability.is_settled(self.settling.stands);
            let waited = arrived.elapsed();
            if waited >= dwell && (settled || waited >= self.settling.at_most) {
                return (settled, waited);
            }
        }
    }

    fn sample(&self, simulator: &Simulator) -> Sample {
        let mut world = simulator.world();
        Sample {
            shifts: world.shift_counts(),
            sender: self.settling.barrier.and_then(|barrier| sender(&mut world, barrier)),
        }
    }
}

/// Owner number of the sender whose frames the barrier accepts, and the sequence number of its last accepted frame;
/// `None` without a sender.
fn sender(world: &mut World, (machine, axes): (u16, Layout)) -> Option<(u16, u16)> {
    let Some(Ladder::Barrier(ladder)) = &world.ladder else {
        return None;
    };
    let at = ladder.report;
    let words = world.words(at, BarrierReport::length(axes));
    let report = BarrierReport::decode(machine, axes, &words)?;
    (report.owner != 0).then_some((report.owner, report.sequence))
}

#[derive(Clone, Debug, PartialEq)]
struct Sample {
    shifts: Vec<i64>,
    sender: Option<(u16, u16)>,
}

/// Tracks how long the corrections have not changed.
struct Stability {
    since: Instant,
    sample: Sample,
    frames: u16,
}

impl Stability {
    fn since(since: Instant, sample: Sample) -> Self {
        let frames = 0;
        Self { since, sample, frames }
    }

    fn update(&mut self, sample: Sample) {
        let owner = |sample: &Sample| sample.sender.map(|(owner, _)| owner);
        if sample.shifts != self.sample.shifts || owner(&sample) != owner(&self.sample) {
            *self = Self::since(Instant::now(), sample);
        } else if sample != self.sample {
            self.frames = self.frames.saturating_add(1);
            self.sample = sample;
        }
    }

    fn is_settled(&self, stands: Duration) -> bool {
        let is_confirmed = self.sample.sender.is_none() || self.frames >= FRAMES;
        is_confirmed && self.since.elapsed() >= stands
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(shift: i64, sender: Option<(u16, u16)>) -> Sample {
        Sample { shifts: vec![shift], sender }
    }

    /// An unchanged correction without new frames is not settled. A change restarts the wait. Without a sender at a
    /// barrier only the time counts.
    #[test]
    fn a_settled_correction_was_confirmed_while_unchanged() {
        let none = Duration::ZERO;
        let mut stability = Stability::since(Instant::now(), sample(5, Some((9, 1))));
        stability.update(sample(5, Some((9, 1))));
        assert!(!stability.is_settled(none));
        for sequence in 0..FRAMES {
            assert!(!stability.is_settled(none));
            stability.update(sample(5, Some((9, 2 + sequence))));
        }
        assert!(stability.is_settled(none));
        assert!(!stability.is_settled(Duration::MAX));
        stability.update(sample(6, Some((9, 99))));
        assert!(!stability.is_settled(none));
        stability.update(sample(6, None));
        assert!(stability.is_settled(none));
    }
}
