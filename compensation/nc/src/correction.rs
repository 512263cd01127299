//! The correction of a machine at a place, and how far a straight way may go before it must be split.

use volcomp_model::{
    Machine, Temperatures, Tolerance,
    curve::ErrorCurve,
    evaluator::CompiledMachine,
    kinematics::State,
    vocabulary::{AxisKind, Direction, MAX_AXES},
};

use crate::{
    NcError,
    coordinates::{Axes, name_of},
};

/// Curves are compiled to 1 nm.
const COMPILED_TO_NM: f64 = 1.0;
/// What a correction of one step may neglect, mm; beyond it the exact one is taken.
const NEGLECTED_MM: f64 = 2e-5;
/// Travel after which a direction counts as another, mm and deg.
const TURNS_AFTER: [f64; 2] = [0.005, 5e-4];

/// The correction of a machine. State: from which side each axis comes.
#[derive(Clone, Debug)]
pub struct Corrector {
    machine: Machine,
    temperatures: Temperatures,
    compiled: CompiledMachine,
    /// The place in the chain of each axis a program can name.
    places: Axes<Option<usize>>,
    corrects: Axes<bool>,
    travels: Axes<[f64; 2]>,
    only_linear: bool,
    bidirectional: bool,
    approach: Axes<Option<Direction>>,
    /// The furthest place of each axis in its direction.
    furthest: Axes<f64>,
    /// Ways of each axis, mm and deg, with which no straight line has to be split, where the axis moves alone.
    unsplit: Axes<f64>,
    split_beyond_mm: f64,
}

impl Corrector {
    /// For a machine at these temperatures. Straight lines are split where the correction would be further than
    /// `tolerance_mm` from where it belongs.
    ///
    /// # Errors
    /// A machine whose curves cannot be compiled.
    pub fn new(
        machine: &Machine,
        temperatures: &Temperatures,
        tolerance_mm: f64,
    ) -> Result<Self, NcError> {
        let compiled = machine.compile_at(Tolerance::from_nm(COMPILED_TO_NM), temperatures)?;
        let mut places = [None; MAX_AXES];
        let mut corrects = [false; MAX_AXES];
        let mut travels = [[f64::NEG_INFINITY, f64::INFINITY]; MAX_AXES];
        let correctors = compiled.correctors();
        for axis in 0..MAX_AXES {
            let Some(name) = name_of(axis) else { continue };
            let Ok(place) = machine.index_of(name) else {
                continue;
            };
            places[axis] = Some(place);
            corrects[axis] =
                correctors.linear().contains(&place) || correctors.rotary().contains(&place);
            if let Some(axis_of_machine) = machine.axis(name) {
                travels[axis] = axis_of_machine.travel;
            }
        }
        let joints = machine.chain().joints();
        let mut corrector = Self {
            machine: machine.clone(),
            temperatures: temperatures.clone(),
            only_linear: joints.iter().all(|joint| joint.kind == AxisKind::Linear),
            bidirectional: machine
                .errors()
                .any(|(_, curve)| !matches!(curve, ErrorCurve::Single(_))),
            compiled,
            places,
            corrects,
            travels,
            approach: [None; MAX_AXES],
            furthest: [0.0; MAX_AXES],
            unsplit: [0.0; MAX_AXES],
            split_beyond_mm: tolerance_mm,
        };
        corrector.unsplit = corrector.unsplit_ways();
        Ok(corrector)
    }

    /// Whether the machine has the axis at a place, and corrects by it.
    pub(crate) fn has(&self, axis: usize) -> bool {
        self.places[axis].is_some()
    }

    pub(crate) fn corrects(&self, axis: usize) -> bool {
        self.corrects[axis]
    }

    pub(crate) fn is_bidirectional(&self) -> bool {
        self.bidirectional
    }

    pub(crate) fn is_within_travel(&self, axis: usize, at: f64) -> bool {
        let [low, high] = self.travels[axis];
        let rounding = 1e-9 * (1.0 + at.abs());
        (low - rounding..=high + rounding).contains(&at)
    }

    /// How far a line may be from where it belongs before it is split, mm.
    pub(crate) fn split_beyond_mm(&self) -> f64 {
        self.split_beyond_mm
    }

    fn state(&self, at: &Axes) -> State {
        let mut state = State::default();
        for (axis, place) in self.places.iter().enumerate() {
            if let Some(place) = place {
                state.q[*place] = if (3..6).contains(&axis) {
                    at[axis].to_radians()
                } else {
                    at[axis]
                };
                state.approach[*place] = self.approach[axis];
            }
        }
        state
    }

    /// From which side the axes come, to be put back.
    pub(crate) fn sides(&self) -> (Axes<Option<Direction>>, Axes) {
        (self.approach, self.furthest)
    }

    pub(crate) fn put_back(&mut self, (approach, furthest): (Axes<Option<Direction>>, Axes)) {
        (self.approach, self.furthest) = (approach, furthest);
    }

    /// The axes go to this place: from now on they come from that side.
    pub(crate) fn goes(&mut self, to: &Axes) {
        if !self.bidirectional {
            return;
        }
        for axis in 0..MAX_AXES {
            let after = TURNS_AFTER[usize::from((3..6).contains(&axis))];
            let way = to[axis] - self.furthest[axis];
            let on = match self.approach[axis] {
                Some(Direction::Positive) => way > 0.0 || way < -after,
                Some(Direction::Negative) => way < 0.0 || way > after,
                None => way.abs() > after,
            };
            if on && way != 0.0 {
                self.furthest[axis] = to[axis];
                self.approach[axis] = Some(if way > 0.0 {
                    Direction::Positive
                } else {
                    Direction::Negative
                });
            }
        }
    }

    /// What is to be added to these coordinates of the machine (mm, deg) so that the tool is where it belongs.
    pub(crate) fn delta(&self, at: &Axes) -> Axes {
        let state = self.state(at);
        let first = self.compiled.first_order(&state).delta;
        let mut delta = first;
        if self.only_linear {
            // The errors are those where the axes go to.
            let mut there = state;
            for (q, delta) in there.q.iter_mut().zip(&first) {
                *q += delta;
            }
            delta = self.compiled.first_order(&there).delta;
        } else if self.compiled.neglected_mm(&first) > NEGLECTED_MM {
            let options = self.machine.correction_options();
            let exact = self
                .machine
                .correction_at(&state, &self.temperatures, &options);
            if exact.converged {
                delta = exact.delta;
            }
        }
        std::array::from_fn(|axis| match self.places[axis] {
            Some(place) if self.corrects[axis] => {
                if (3..6).contains(&axis) {
                    delta[place].to_degrees()
                } else {
                    delta[place]
                }
            }
            _ => 0.0,
        })
    }

    /// Whether the correction on the straight way between two places is nowhere further than the tolerance from the straight line
    /// between those at its ends: by the derivatives of the curves.
    pub(crate) fn is_straight(&self, from: &Axes, to: &Axes) -> bool {
        let mut share = 0.0;
        for axis in 0..MAX_AXES {
            let way = (to[axis] - from[axis]).abs();
            if way > 0.0 && self.places[axis].is_some() {
                share += way / self.unsplit[axis];
            }
        }
        share <= 1.0 || self.bound_mm(from, to) <= self.split_beyond_mm
    }

    /// A bound (mm) of the distance between the correction on the straight way and the straight line between those at its ends.
    pub(crate) fn bound_mm(&self, from: &Axes, to: &Axes) -> f64 {
        let [from, to] = [from, to].map(|at| self.state(at));
        self.compiled.chord_bound_mm(&from, &to)
    }

    fn unsplit_ways(&self) -> Axes {
        let ways = self.compiled.short_ways(self.split_beyond_mm);
        std::array::from_fn(|axis| {
            let way = self.places[axis].map_or(f64::INFINITY, |place| ways[place]);
            if (3..6).contains(&axis) {
                way.to_degrees()
            } else {
                way
            }
        })
    }
}
