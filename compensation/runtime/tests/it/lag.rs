//! Late positions at speed: a rotary table at 33 rpm, positions 0 to 500 ms old. The error with correction is at most
//! the error without correction, and the reasons report the reduction.

use std::{f64::consts::TAU, time::Duration};

use volcomp_kinematics::{State, nalgebra::Vector3};
use volcomp_model::{Fading, Machine};
use volcomp_port::{Clock, Description, Fault, Snapshot};
use volcomp_runtime::{
    AxisSettings, Cycle, GuardSettings, Model, PositionReader, ReaderPlan, Report, WithoutBarrier,
    guard::{Reasons, Request},
};
use volcomp_vocabulary::{AxisName, Displacement, PerAxis, PerChannel, Um, Urad};

use crate::{
    rig::{PERIOD, alone, referenced, without_barrier},
    ways::{Plant, Ways},
};

const RPM: f64 = 33.0;
/// One step of the correction, mm.
const STEP: f64 = 1e-4;
const NAMES: [AxisName; 3] = [AxisName::X, AxisName::Y, AxisName::Z];

/// A rotary table under X, with constant errors and errors of one and two periods per turn.
const MACHINE: &str = "structure = \"w C' X' b Y Z t\"
axes.X = { travel = [-400.0, 400.0] }
axes.Y = { travel = [-400.0, 400.0] }
axes.Z = { travel = [-400.0, 400.0] }
axes.C = { travel = [0.0, 360.0], modulo = 360.0, point = [0.0, 0.0, -100.0] }
[errors]
EXC = { fourier = [3.0, 20.0, 4.0, 5.0, 2.0], period = 360.0 }
EYC = { fourier = [-2.0, 3.0, 18.0], period = 360.0 }
EZC = { fourier = [6.0, 4.0, 3.0], period = 360.0 }
EAC = { fourier = [0.0, 10.0, 6.0], period = 360.0 }
EXX = 4.0
EYY = -5.0
";

/// Table angle at a time, rad.
fn turned(at: Duration) -> f64 {
    (RPM / 60.0 * TAU * at.as_secs_f64()).rem_euclid(TAU)
}

/// A control with stationary linear axes. The read-only path reports the table angle of `age` ago; from `silent_since` on, the last one.
#[derive(Default)]
struct Late {
    age: Duration,
    silent_since: Option<Duration>,
    applied: PerChannel<f64>,
}

impl Plant for Late {
    fn read(&mut self, way: &Description, clock: &Clock) -> Result<Snapshot, Fault> {
        let now = clock.elapsed();
        let (taken, positions) = if way.axes.is_empty() {
            let taken = self.silent_since.unwrap_or(now).saturating_sub(self.age);
            (taken, PerChannel::leading([turned(taken)]))
        } else {
            (now, PerChannel::leading([150.0, -80.0, 60.0]))
        };
        let taken = clock.start() + taken;
        Ok(referenced(positions, taken, Some(self.applied)))
    }

    fn apply(
        &mut self,
        _: &Description,
        correction: &PerChannel<f64>,
        _: &Clock,
    ) -> Result<(), Fault> {
        self.applied = *correction;
        Ok(())
    }
}

struct Table {
    cycle: Cycle,
    model: Model,
    ways: Ways<Late>,
}

impl Table {
    fn new(hold: Duration) -> Self {
        let ways = Ways::to(Late::default(), Clock::manual());
        let machine = Machine::parse(MACHINE, "m").expect("valid");
        let model = Model::new(&machine, Fading::default()).expect("compiles");
        let guard = GuardSettings {
            without_barrier: WithoutBarrier { linear: Um(150.0), rotary: Urad(30.0) },
            hold,
            ..GuardSettings::new(AxisSettings::new(Um(150.0), Um(500.0)))
        };
        let mut description = without_barrier("late", &NAMES);
        for axis in &mut description.axes {
            axis.resolution = Displacement::Length(Um(STEP * 1e3).to_mm());
        }
        let table =
            Description { axes: Vec::new(), reads: vec![AxisName::C], ..description.clone() };
        let reads = ReaderPlan::new(table.clone(), &model, &alone()).expect("fits");
        let reader = PositionReader::new(ways.controller(table), &reads);
        let path = ways.path(description, &model, &guard, &alone());
        let cycle = ways.cycle(model.clone(), &guard, vec![path]);
        let cycle = cycle.and_then(|cycle| cycle.with_readers(vec![reader]));
        Self { cycle: cycle.expect("a path and a reader"), model, ways }
    }

    fn step(&mut self, request: Option<Request>) -> Report {
        self.ways.step(&mut self.cycle, request)
    }

    fn falls_silent(&mut self) {
        self.ways.plant().silent_since = Some(self.ways.clock.elapsed());
    }

    /// Tool error at the actual table angle, mm: without and with the applied correction, first right after a write,
    /// then right before the next one.
    fn off(&self) -> [[f64; 2]; 2] {
        let applied = self.ways.plant().applied;
        [Duration::ZERO, PERIOD].map(|later| {
            let mut state = State::default();
            let mut correction = PerAxis::ZERO;
            let at = [150.0, -80.0, 60.0, turned(self.ways.clock.elapsed() + later)];
            let names = NAMES.into_iter().chain([AxisName::C]);
            for (i, name) in names.enumerate() {
                let axis = self.model.index_of(name).expect("an axis");
                (state.q[axis], correction[axis]) = (at[i], applied[i]);
            }
            let errors = self.model.errors(&state, &correction);
            errors.map(|error| Vector3::from(error.position_mm).norm())
        })
    }

    fn armed(age: Duration, hold: Duration) -> Self {
        let mut table = Self::new(hold);
        table.ways.plant().age = age;
        for _ in 0..100 {
            table.step(None);
        }
        table.step(Some(Request::Arm));
        table
    }
}

/// Maximum effect of rounding, the slew of one cycle and the model's steps, mm.
const ROUNDING: f64 = 3.0 * STEP + 2e-5;

/// With `hold_ms` = 200 (the maximum) the correction reduced by the age of the positions is at most as wrong as none; with older positions
/// nothing is corrected.
#[test]
fn a_correction_by_late_positions_is_never_worse_than_none() {
    let hold = Duration::from_millis(200);
    println!("age | rms without | rms with | remaining part | reduced");
    let mut lefts = Vec::new();
    for age_ms in (0..=200).step_by(20).chain([250, 300, 400, 500]) {
        let mut table = Table::armed(Duration::from_millis(age_ms), hold);
        for _ in 0..700 {
            table.step(None);
        }
        let (mut squares, mut count, mut reported, mut worst) =
            ([0.0, 0.0], 0, 0, f64::NEG_INFINITY);
        for _ in 0..1000 {
            let report = table.step(None);
            // At 200 ms the positions may be too old in some cycles.
            let state = if age_ms <= 180 { "compensating" } else { report.state.name() };
            assert_eq!(report.state.name(), state, "{age_ms} ms: {:?}", report.reasons);
            for [without, with] in table.off() {
                squares[0] += without * without;
                squares[1] += with * with;
                count += 1;
                worst = worst.max(with - without);
            }
            reported += usize::from(report.reasons.contains(Reasons::REDUCED_BY_AGE));
        }
        let [without, with] = squares.map(|sum: f64| (sum / f64::from(count)).sqrt());
        let left = with / without;
        println!(
            "{age_ms} ms | {:.2} µm | {:.2} µm | {left:.3} | {reported} of 1000, worst {:.3} µm",
            without * 1e3,
            with * 1e3,
            worst * 1e3
        );
        assert!(worst <= ROUNDING, "{age_ms} ms: {worst} mm worse than without");
        assert!(reported == 0 || reported == 1000, "{age_ms} ms: reported {reported} times");
        lefts.push((age_ms, left, reported > 0));
    }
    // Values of the table in the book.
    for (age_ms, expected) in [(0, 0.03), (20, 0.1), (40, 0.17), (100, 0.4), (200, 1.0)] {
        let (_, left, _) = lefts.iter().find(|(age, _, _)| *age == age_ms).expect("measured");
        assert!(*left <= expected, "{age_ms} ms: {left} is left");
    }
    assert!(!lefts[0].2, "no reduction with fresh positions");
    assert!(lefts.iter().any(|(age, _, reported)| *age == 160 && *reported));
}

/// Positions freeze while the table turns on: the held correction ramps out before it is worse than none.
#[test]
fn a_held_correction_ramps_out_before_it_is_worse_than_none() {
    for silent_ms in (0..=500).step_by(50) {
        for begins_ms in [0, 450, 900, 1350] {
            let mut table = Table::armed(Duration::ZERO, Duration::from_millis(50));
            for _ in 0..400 + begins_ms / 4 {
                table.step(None);
            }
            table.falls_silent();
            let mut reported = false;
            let mut look = |table: &mut Table, began: f64| {
                let report = table.step(None);
                for [without, with] in table.off() {
                    let worse = with - without.max(began);
                    assert!(
                        worse <= ROUNDING,
                        "silent for {silent_ms} ms from {begins_ms} ms on: {worse} mm worse, {:?} {:?}",
                        report.state,
                        report.reasons
                    );
                }
                reported |= report.reasons.contains(Reasons::REDUCED_BY_AGE);
            };
            for _ in 0..silent_ms / 4 {
                look(&mut table, 0.0);
            }
            table.ways.plant().silent_since = None;
            // On a ramp the error may be as large as at its start.
            let began = table.off()[1][1];
            for _ in 0..400 {
                look(&mut table, began);
            }
            assert!(reported || silent_ms < 250, "{silent_ms} ms: not reported");
            assert!(!reported || silent_ms > 0, "{silent_ms} ms: reported");
            assert_eq!(table.step(None).state.name(), "compensating");
            let [[without, with], _] = table.off();
            assert!(with < 0.3 * without, "it corrects again: {with} {without}");
        }
    }
}

#[test]
fn no_reduction_is_reported_without_a_correction() {
    let is_told = |report: &Report| report.reasons.contains(Reasons::REDUCED_BY_AGE);
    for disarms in [true, false] {
        let mut table = Table::armed(Duration::ZERO, Duration::from_millis(50));
        for _ in 0..400 {
            table.step(None);
        }
        table.falls_silent();
        let reported = (0..100).any(|_| is_told(&table.step(None)));
        assert!(reported, "at speed");
        if disarms {
            table.step(Some(Request::Disarm));
        }
        for _ in 0..2000 {
            table.step(None);
        }
        let report = table.step(None);
        assert!(!is_told(&report), "{:?}: {:?}", report.state, report.reasons);
    }
}
