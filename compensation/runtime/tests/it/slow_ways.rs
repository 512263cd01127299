//! Tests of a barrier behind paths with delays: a path takes over again while the correction moves.

use std::{collections::VecDeque, time::Duration};

use volcomp_port::{Clock, Description, Fault, Snapshot, Words};
use volcomp_runtime::{
    BarrierSettings, Cycle, PathSettings,
    guard::{
        Request,
        barrier::{Barrier, REPORT_WORDS},
    },
};
use volcomp_vocabulary::PerChannel;

use crate::{
    rig::{alone, referenced, without_barrier},
    ways::{AXES, Plant, Ways, barrier_of, guard_um, three_axes},
};

/// Two paths to one control's barrier, with delays of some cycles.
struct Slow {
    barrier: Barrier,
    x: f64,
    late: usize,
    first_is_away: bool,
    reports: VecDeque<Words>,
    air: VecDeque<(usize, Vec<u16>)>,
    mailboxes: [Option<Vec<u16>>; 2],
    cycle: usize,
}

impl Slow {
    fn new(late: usize) -> Self {
        Self {
            barrier: barrier_of(&AXES, 150, 50, 100),
            x: 0.0,
            late,
            first_is_away: false,
            reports: VecDeque::new(),
            air: VecDeque::new(),
            mailboxes: [None, None],
            cycle: 0,
        }
    }

    fn cycle(&mut self) {
        self.cycle += 1;
        while self.air.front().is_some_and(|(at, _)| *at <= self.cycle) {
            if let Some((_, words)) = self.air.pop_front() {
                self.mailboxes[0] = Some(words);
            }
        }
        for _ in 0..2 {
            let boxes: Vec<&[u16]> = self.mailboxes.iter().flatten().map(Vec::as_slice).collect();
            self.barrier.scan(&boxes, false);
        }
        let mut words = [0; REPORT_WORDS];
        let length = self.barrier.report().encode(&mut words);
        self.reports.push_back(Words::new(&words[..length]).expect("fits"));
        while self.reports.len() > self.late + 1 {
            self.reports.pop_front();
        }
    }
}

impl Plant for Slow {
    fn read(&mut self, way: &Description, clock: &Clock) -> Result<Snapshot, Fault> {
        if way.device == "first" && self.first_is_away {
            return Err(Fault::TimedOut);
        }
        let mut snapshot = referenced(PerChannel::leading([self.x]), clock.now(), None);
        snapshot.report = self.reports.front().copied();
        Ok(snapshot)
    }

    fn post(&mut self, way: &Description, frame: &Words) -> Result<(), Fault> {
        if way.device == "first" && self.first_is_away {
            return Err(Fault::TimedOut);
        }
        self.air.push_back((self.cycle + self.late, frame.as_slice().to_vec()));
        Ok(())
    }
}

fn slow_ways(late: usize) -> (Ways<Slow>, Cycle) {
    let ways = Ways::to(Slow::new(late), Clock::manual());
    let guard = guard_um(150.0);
    let model = three_axes("EXX = { poly = [-75, 1.5] }", &guard);
    let settings = PathSettings {
        barrier: Some(BarrierSettings { machine: 1, scan: Duration::from_millis(2) }),
        read_back_cycles: 2 * late + 2,
        proves: false,
        ..alone()
    };
    let describe = |device| Description { barrier: true, ..without_barrier(device, &AXES) };
    let paths =
        ["first", "second"].map(|device| ways.path(describe(device), &model, &guard, &settings));
    let cycle = ways.cycle(model, &guard, paths.into()).expect("fits");
    (ways, cycle)
}

/// X moves up for 80 cycles and down for 80 within the slew, then the first path takes over again: between the turning points the axis
/// moves back by at most 1 µm.
#[test]
fn a_hand_back_in_motion_reverses_no_axis() {
    let mut looked = 0;
    for late in [0, 2, 4, 6] {
        for offset in [0, 20, 40, 60] {
            let (ways, mut cycle) = slow_ways(late);
            let mut applied = Vec::new();
            let mut handed_back = None;
            let mut active = 0;
            for number in 0..2200_usize {
                {
                    let mut plant = ways.plant();
                    let phase = (number + offset) % 160;
                    let up = if phase < 80 { phase } else { 160 - phase };
                    plant.x = 10.0 + up as f64;
                    plant.first_is_away = (900..1150).contains(&number);
                    plant.cycle();
                    applied.push(plant.barrier.memory().applied[0]);
                }
                let report = ways.step(&mut cycle, (number == 600).then_some(Request::Arm));
                if active == 1 && report.active == 0 {
                    assert!(report.state.is_armed(), "{:?}", report.state);
                    handed_back = Some(number);
                }
                active = report.active;
            }
            let at = handed_back.expect("handed back");
            let phase = (at + offset) % 80;
            if !(25..50).contains(&phase) {
                continue;
            }
            looked += 1;
            let about = &applied[at - 10..at + 20];
            let sign = (applied[at] - applied[at - 10]).signum();
            let mut furthest = about[0] * sign;
            for value in about {
                furthest = furthest.max(value * sign);
                let back = furthest - value * sign;
                assert!(back <= 1, "{late} late, offset {offset}: {back} um in {about:?}");
            }
        }
    }
    assert!(looked > 0);
}
