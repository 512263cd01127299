//! Lines that take over from a barrier and name the axes in another order.

use std::{collections::BTreeMap, time::Duration};

use volcomp_model::Machine;
use volcomp_port::{Clock, Description, Fault, Snapshot, Words};
use volcomp_runtime::{
    BarrierSettings, Model, PathSettings,
    guard::{
        ControlTimeOut, Request, State,
        barrier::{Barrier, REPORT_WORDS, Settings},
        protocol::{Counts, Layout},
    },
};
use volcomp_vocabulary::{AxisName, Displacement, MAX_AXES, PerChannel};

use crate::{
    rig::{PERIOD, alone, guard, referenced, without_barrier},
    ways::{Plant, Ways},
};

const SCAN: Duration = Duration::from_millis(2);

/// The control: its barrier and mailbox, the words of the lines by the names of the axes, where it stands, and whether the
/// first way is away.
struct Control {
    barrier: Barrier,
    mailbox: Option<Vec<u16>>,
    lines: BTreeMap<AxisName, f64>,
    place: [f64; 5],
    first_is_away: bool,
}

impl Control {
    fn at(place: [f64; 5]) -> Self {
        let barrier = Settings {
            axes: Layout::of(FIRST).expect("each once"),
            machine: 1,
            limit: PerChannel([300; MAX_AXES]),
            rate: PerChannel([2; MAX_AXES]),
            step_scans: 1,
            hold_scans: 25,
            time_out_scans: 100,
        };
        Self {
            barrier: Barrier::start(barrier, 1, 0, &Counts::default()).expect("good settings"),
            mailbox: None,
            lines: BTreeMap::new(),
            place,
            first_is_away: false,
        }
    }

    fn scan(&mut self) {
        let mailbox = self.mailbox.clone();
        let mailboxes: Vec<&[u16]> = mailbox.as_deref().into_iter().collect();
        self.barrier.scan(&mailboxes, false);
    }
}

/// The first way leads to the barrier; the second one is lines that cannot be asked.
impl Plant for Control {
    fn read(&mut self, way: &Description, clock: &Clock) -> Result<Snapshot, Fault> {
        if way.barrier && self.first_is_away {
            return Err(Fault::TimedOut);
        }
        let mut positions = PerChannel::ZERO;
        for (position, axis) in positions.iter_mut().zip(&way.axes) {
            let at = FIRST.iter().position(|name| *name == axis.name);
            let at = self.place[at.expect("known")];
            *position = Displacement::from_coordinate(axis.name.kind(), at).mm_or_rad();
        }
        let mut snapshot = referenced(positions, clock.now(), None);
        if way.barrier {
            let mut words = [0; REPORT_WORDS];
            let length = self.barrier.report().encode(&mut words);
            snapshot.report = Words::new(&words[..length]);
        }
        Ok(snapshot)
    }

    fn post(&mut self, _: &Description, frame: &Words) -> Result<(), Fault> {
        if self.first_is_away {
            return Err(Fault::TimedOut);
        }
        self.mailbox = Some(frame.as_slice().to_vec());
        Ok(())
    }

    fn apply(
        &mut self,
        way: &Description,
        corrections: &PerChannel<f64>,
        _: &Clock,
    ) -> Result<(), Fault> {
        for (axis, word) in way.axes.iter().zip(corrections) {
            self.lines.insert(axis.name, *word);
        }
        Ok(())
    }
}

const TABLE: &str = "structure = \"w C' A' b X Y Z t\"
axes.X = { travel = [-500.0, 500.0] }
axes.Y = { travel = [-500.0, 500.0] }
axes.Z = { travel = [-500.0, 500.0] }
axes.A = { travel = [-120.0, 30.0], point = [0.0, 0.0, -100.0] }
axes.C = { travel = [0.0, 360.0], modulo = 360.0 }
[errors]
EXX = 100.0
EYY = 100.0
EXC = { fourier = [0.0, 0.0, 40.0], period = 30.0 }
EZC = { fourier = [0.0, 0.0, 40.0], period = 30.0 }
";
const FIRST: [AxisName; 5] = [
    AxisName::X,
    AxisName::Y,
    AxisName::Z,
    AxisName::A,
    AxisName::C,
];

/// What the axes get by the lines, in the order of `FIRST`, mm and rad, in each cycle from their taking over on, and what is
/// wanted at the end.
fn lines_after_a_change(second: [AxisName; 5], place: [f64; 5]) -> (Vec<[f64; 5]>, [f64; 5]) {
    let ways = Ways::to(Control::at(place), Clock::manual());
    let mut settings = guard();
    settings.ramp = Duration::from_secs(2);
    settings.zero_after = Duration::from_secs(3);
    let machine = Machine::parse(TABLE, "m").expect("valid");
    let model = Model::new(&machine, settings.fading).expect("compiles");
    let index: Vec<usize> = FIRST
        .iter()
        .map(|name| model.index_of(*name).expect("an axis"))
        .collect();
    let paths = [true, false].map(|is_first| {
        let names = if is_first { FIRST } else { second };
        let mut description = Description {
            barrier: is_first,
            tells_applied: is_first,
            ..without_barrier(if is_first { "first" } else { "second" }, &names)
        };
        for axis in &mut description.axes {
            axis.resolution = Displacement::from_micro(axis.name.kind(), 1.0);
        }
        let of_path = PathSettings {
            barrier: is_first.then_some(BarrierSettings {
                machine: 1,
                scan: SCAN,
            }),
            time_out: (!is_first).then_some(ControlTimeOut {
                after: Duration::from_millis(200),
                to_zero: Duration::from_millis(100),
            }),
            proves: false,
            ..alone()
        };
        ways.path(description, &model, &settings, &of_path)
    });
    let cycle = ways.cycle(model, &settings, paths.into());
    let mut cycle = cycle.expect("two paths");
    let mut scanned = Duration::ZERO;
    let mut got = Vec::new();
    let mut wanted = [0.0; 5];
    for number in 0..4000 {
        ways.clock.advance(PERIOD);
        let mut control = ways.plant();
        control.first_is_away = number >= 1800;
        while scanned + SCAN <= ways.clock.elapsed() {
            scanned += SCAN;
            control.scan();
        }
        drop(control);
        let report = ways.run(&mut cycle, (number == 700).then_some(Request::Arm));
        if number == 1799 {
            assert_eq!(report.state, State::Compensating, "{:?}", report.reasons);
        }
        if report.active == 1 {
            let control = ways.plant();
            assert_eq!(control.barrier.memory().applied, Counts::default());
            got.push(FIRST.map(|name| control.lines.get(&name).copied().unwrap_or(0.0)));
            for (wanted, index) in wanted.iter_mut().zip(&index) {
                *wanted = report.wanted[*index];
            }
        }
    }
    assert!(got.len() > 1000, "the lines took over: {}", got.len());
    (got, wanted)
}

/// At standstill the lines begin at zero and ramp to what is wanted, in whatever order they name the axes: nothing goes beyond
/// the ramp by more than a step.
#[test]
fn lines_with_their_axes_in_another_order_take_over_by_a_ramp() {
    let [x, y, z, a, c] = FIRST;
    let mut worst = (0.0, String::new());
    for place in [
        [300.0, 250.0, 0.0, 20.0, 100.0],
        [-400.0, 400.0, 0.0, 20.0, 107.0],
        [400.0, -300.0, 100.0, -30.0, 15.0],
    ] {
        for second in [FIRST, [c, a, z, x, y]] {
            let (got, wanted) = lines_after_a_change(second, place);
            let mut most = (0.0_f64, 0, 0, 0.0);
            for (cycle, words) in got.iter().enumerate() {
                // The ramp of 2 s has 500 cycles; two cycles later at the most, and a step of rounding.
                let ramp = (cycle as f64 / 500.0).min(1.0);
                for i in 0..5 {
                    let beyond = (words[i] - ramp * wanted[i]).abs();
                    if beyond > most.0 {
                        most = (beyond, cycle, i, words[i]);
                    }
                }
            }
            if most.0 > worst.0 {
                worst = (most.0, format!("{second:?} at {place:?}: {most:?}"));
            }
        }
    }
    assert!(worst.0 <= 0.003, "{} mm off the ramp: {}", worst.0, worst.1);
}
