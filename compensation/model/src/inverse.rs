//! Inverse kinematics of the ideal machine: coordinates for a tip and a tool direction.
//!
//! A rotary axis that does not affect the tool direction is free. Its ranges are those in which the other axes reach
//! the tip within their travels.

use std::f64::consts::{PI, TAU};

use volcomp_kinematics::{NoSolution, State, nalgebra::Vector3};
use volcomp_vocabulary::{AxisKind, AxisName, Displacement, MAX_AXES, PerAxis, is_within};

use crate::{error::ModelError, machine::Machine};

/// Maximum number of solutions; an axis whose travel covers many turns has one solution per turn.
const MOST_SOLUTIONS: usize = 1000;

/// The solutions of the inverse kinematics for a tip and a tool direction.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Reached {
    /// All solutions within the travels, mm and rad in chain order, sorted by the sum of the absolute rotary
    /// coordinates. With more than two rotary axes, or several linear axes in one direction, only some of the solutions
    /// are found.
    pub solutions: Vec<State>,
    /// Whether the pose is singular: a rotary axis does not affect the tool direction, or linear axes are linearly dependent.
    pub singular: bool,
    /// The rotary axes that do not affect the tool direction and the dependent linear axes, in the order of `ranges`.
    pub free: Vec<AxisName>,
    /// For each free axis, the ranges, mm or deg, in which the other axes are within their travels. For a rotary axis,
    /// only ranges in the turn nearest to 0 are listed, and each range has a solution at its point nearest to 0. Linear
    /// axes with several dependent moves have no ranges, because their ranges depend on each other.
    pub ranges: Vec<Vec<[f64; 2]>>,
    /// Moves of several linear axes together that leave the tip in place at a solution. They exist where rotary axes
    /// turn one linear axis parallel to another. In chain order, scaled to a largest component of 1.
    pub dependent: Vec<State>,
    /// The axes that are outside their travel in a solution without travel limits.
    pub outside: Vec<AxisName>,
    /// Why there is no solution even with unlimited travels; `None` if there are solutions.
    pub missed: Option<NoSolution>,
}

impl Machine {
    /// The coordinates within travel with which the ideal machine has its tool tip at `tip_mm` (workpiece axes, from the workpiece origin)
    /// and its tool axis along `tool_axis` (workpiece axes, from the tip to the spindle).
    ///
    /// Up to two rotary axes in any directions, and one linear axis per direction, are solved in closed form, with all solutions. With more
    /// rotary axes, each pair moves in turn while the others are at their coordinate nearest to 0. With more linear axes, the first of each
    /// direction moves, and the others only while it is at an end of its travel.
    ///
    /// # Errors
    /// [`ModelError::Target`] for a tip that is not a number up to 1e9 mm or a direction of zero length; [`ModelError::TooMany`] if the
    /// turns of an axis give more than 1000 solutions.
    pub fn axes_at(&self, tip_mm: [f64; 3], tool_axis: [f64; 3]) -> Result<Reached, ModelError> {
        // The comparison is false for NaN, so NaN is rejected too.
        let fits = |found: &[f64; 3]| found.iter().all(|x| x.abs() <= 1e9);
        if !fits(&tip_mm) {
            return Err(ModelError::Target { what: "tool tip", found: tip_mm });
        }
        let largest = Vector3::from(tool_axis).amax();
        if !fits(&tool_axis) || largest == 0.0 {
            return Err(ModelError::Target { what: "tool axis", found: tool_axis });
        }
        let (tip, direction) = (Vector3::from(tip_mm), Vector3::from(tool_axis) / largest);
        let rotary: Vec<usize> =
            (0..self.axes().len()).filter(|&place| self.axes()[place].name.is_rotary()).collect();
        let mut travel = PerAxis([[0.0; 2]; MAX_AXES]);
        let mut held = State::default();
        for (place, axis) in self.axes().iter().enumerate() {
            let rad = |end: f64| Displacement::from_coordinate(axis.name.kind(), end).mm_or_rad();
            travel[place] = axis.travel.map(rad);
            held.q[place] = 0.0_f64.max(travel[place][0]).min(travel[place][1]);
        }
        let mut reached = Reached::default();
        for pair in pairs(&rotary) {
            let found = match self.chain().pointing(&direction, &pair, &held) {
                Ok(found) => found,
                Err(missed) => {
                    reached.missed = reached.missed.or(Some(missed));
                    continue;
                }
            };
            for pointing in found {
                if let Some(place) = pointing.free {
                    let target = Target {
                        tip_mm: &tip,
                        direction: &direction,
                        pair: &pair,
                        held: &held,
                        travel: &travel,
                    };
                    let ranges = self.free_ranges(place, &target);
                    let at =
                        |range: &[f64; 2]| self.with_free(nearest_to_zero(*range), place, &target);
                    for state in ranges.iter().filter_map(at) {
                        self.add_dependent(&state, &travel, &mut reached);
                        self.add_turns(&state, &mut reached)?;
                    }
                    reached.singular = true;
                    let name = self.axes()[place].name;
                    if !reached.free.contains(&name) {
                        reached.free.push(name);
                        reached.ranges.push(ranges.clone());
                    }
                    if !ranges.is_empty() {
                        continue;
                    }
                    // No range is within the travels: the free axis is at its coordinate nearest to 0, and the axes
                    // outside their travel are reported.
                }
                match self.chain().reaching(&tip, &pointing.state, &travel) {
                    Ok(state) => {
                        self.add_dependent(&state, &travel, &mut reached);
                        self.add_turns(&state, &mut reached)?;
                    }
                    Err(missed) => reached.missed = reached.missed.or(Some(missed)),
                }
            }
        }
        let turns = |state: &State| rotary.iter().map(|&place| state.q[place].abs()).sum::<f64>();
        reached.solutions.sort_by(|a, b| turns(a).total_cmp(&turns(b)));
        if !reached.solutions.is_empty() {
            reached.missed = None;
        }
        Ok(reached)
    }

    fn add_dependent(&self, state: &State, travel: &PerAxis<[f64; 2]>, reached: &mut Reached) {
        let moves = self.chain().dependent_moves(state);
        for (place, axis) in self.axes().iter().enumerate() {
            if moves.iter().all(|moves| moves[place] == 0.0) {
                continue;
            }
            reached.singular = true;
            let range = match &moves[..] {
                [only] => range_along(only, place, state, travel),
                _ => None,
            };
            let known = reached.free.iter().position(|name| *name == axis.name);
            let known = known.unwrap_or_else(|| {
                reached.free.push(axis.name);
                reached.ranges.push(Vec::new());
                reached.free.len() - 1
            });
            let ranges = &mut reached.ranges[known];
            if let Some(range) = range.filter(|range| !ranges.contains(range)) {
                ranges.push(range);
            }
        }
        for moves in moves {
            let mut move_ = State::default();
            for (q, share) in move_.q.iter_mut().zip(moves) {
                *q = share;
            }
            if !reached.dependent.contains(&move_) {
                reached.dependent.push(move_);
            }
        }
    }

    fn add_turns(&self, state: &State, reached: &mut Reached) -> Result<(), ModelError> {
        let mut all = vec![*state];
        for (place, axis) in self.axes().iter().enumerate() {
            let kind = axis.name.kind();
            let coordinate = Displacement::new(kind, state.q[place]).mm_or_deg();
            let [low, high] = axis.travel;
            let within: Vec<f64> = match (kind, axis.modulo) {
                (AxisKind::Linear, _) => vec![coordinate],
                // With `modulo`, other turns are the same pose.
                (AxisKind::Rotary, Some(_)) => vec![axis.looked_up(coordinate)],
                (AxisKind::Rotary, None) => {
                    let (first, last) = (
                        ((low - coordinate) / 360.0).ceil(),
                        ((high - coordinate) / 360.0).floor(),
                    );
                    // One more turn at each end, since rounding may put an end of travel just outside.
                    let count = (last - first).max(-1.0) + 3.0;
                    if count > MOST_SOLUTIONS as f64 {
                        return Err(too_many(count));
                    }
                    let turn = |n: f64| coordinate + 360.0 * (first - 1.0 + n);
                    (0..=MOST_SOLUTIONS)
                        .map(|n| n as f64)
                        .take_while(|n| *n < count)
                        .map(turn)
                        .collect()
                }
            };
            let within: Vec<f64> =
                within.into_iter().filter(|q| is_within([low, high], *q)).collect();
            if within.is_empty() {
                note(&mut reached.outside, axis.name);
            }
            if all.len() * within.len() > MOST_SOLUTIONS {
                return Err(too_many((all.len() * within.len()) as f64));
            }
            let turned = |state: &State| {
                let state = *state;
                let at = within.clone().into_iter().map(move |q| {
                    let mut state = state;
                    if kind == AxisKind::Rotary {
                        // Rounding errors are clamped to the end of travel.
                        let q = q.max(low).min(high);
                        state.q[place] = Displacement::from_coordinate(kind, q).mm_or_rad();
                    }
                    state
                });
                at.collect::<Vec<_>>()
            };
            all = all.iter().flat_map(turned).collect();
        }
        for state in all {
            if !reached.solutions.contains(&state) {
                reached.solutions.push(state);
            }
        }
        if reached.solutions.len() > MOST_SOLUTIONS {
            return Err(too_many(reached.solutions.len() as f64));
        }
        Ok(())
    }
}

/// The coordinates of an axis along a dependent move from `state`, mm, up to the ends of travel of all moved axes;
/// `None` if a moved axis is already outside its travel.
fn range_along(
    moves: &[f64; MAX_AXES],
    place: usize,
    state: &State,
    travel: &PerAxis<[f64; 2]>,
) -> Option<[f64; 2]> {
    let (mut least, mut most) = (f64::NEG_INFINITY, f64::INFINITY);
    for (axis, share) in moves.iter().enumerate().filter(|(_, share)| **share != 0.0) {
        let to = travel[axis].map(|end| (end - state.q[axis]) / share);
        least = least.max(to[0].min(to[1]));
        most = most.min(to[0].max(to[1]));
    }
    let at = |along: f64| state.q[place] + moves[place] * along;
    let range = [at(least).min(at(most)), at(least).max(at(most))];
    (least <= most).then_some(range)
}

fn note(names: &mut Vec<AxisName>, name: AxisName) {
    if !names.contains(&name) {
        names.push(name);
    }
}

fn too_many(found: f64) -> ModelError {
    ModelError::TooMany {
        what: "solutions",
        // The cast saturates, which is sufficient for a message.
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a count for a message"
        )]
        found: found as usize,
        most: MOST_SOLUTIONS,
    }
}

/// The pairs of rotary axes that move while the others are held; all rotary axes at once if there are at most two.
fn pairs(rotary: &[usize]) -> Vec<Vec<usize>> {
    if rotary.len() <= 2 {
        return vec![rotary.to_vec()];
    }
    let mut pairs = Vec::new();
    for (place, &first) in rotary.iter().enumerate() {
        for &second in &rotary[place + 1..] {
            pairs.push(vec![first, second]);
        }
    }
    pairs
}

/// Number of samples over a turn: dense enough that the distance beyond the travels has at most one relevant minimum
/// between two neighbouring samples.
const STEPS: usize = 720;
/// Number of bisection or ternary-search steps for the ends of ranges and for minima.
const SEARCH_STEPS: usize = 60;
/// Tolerance of the travel limits, mm or rad.
const TRAVEL_TOLERANCE: f64 = 1e-10;

/// The target: tip (mm) and tool direction in workpiece axes. The axes in `pair` reach the direction; all other rotary
/// axes keep their coordinates in `held`.
pub(crate) struct Target<'a> {
    pub(crate) tip_mm: &'a Vector3<f64>,
    pub(crate) direction: &'a Vector3<f64>,
    pub(crate) pair: &'a [usize],
    pub(crate) held: &'a State,
    pub(crate) travel: &'a PerAxis<[f64; 2]>,
}

impl Machine {
    /// The ranges of the free axis (index `free`) within one turn, rad, ascending, in which the target is within all travels.
    fn free_ranges(&self, free: usize, target: &Target<'_>) -> Vec<[f64; 2]> {
        let [low, high] = target.travel[free];
        // One turn, as close to −180° to 180° as the travel allows, or the whole travel if it is shorter.
        let from = (-PI).min(high - TAU).max(low);
        let to = high.min(from + TAU);
        let beyond = |q: f64| self.beyond_travel(q, free, target);
        let at = |step: usize| from + (to - from) * (step as f64 / STEPS as f64);
        let mut stations: Vec<(f64, f64)> =
            (0..=STEPS).map(|step| (at(step), beyond(at(step)))).collect();
        for place in 1..STEPS {
            let [before, here, after] =
                [-1, 0, 1].map(|by| stations[place.saturating_add_signed(by)]);
            if here.1 > TRAVEL_TOLERANCE && here.1 <= before.1 && here.1 <= after.1 {
                stations[place] = lowest(before.0, after.0, &beyond);
            }
        }
        // A minimum may also be between an end and its neighbour. For a full turn both ends are the
        // same pose, and each is checked on its side.
        for (end, beside) in [(STEPS, STEPS - 1), (0, 1)] {
            let ([end, beside], place) = ([stations[end], stations[beside]], end.max(beside));
            if end.1 > TRAVEL_TOLERANCE && end.1 <= beside.1 {
                let dip = lowest(end.0.min(beside.0), end.0.max(beside.0), &beyond);
                stations.insert(place, dip);
            }
        }
        let mut ranges: Vec<[f64; 2]> = Vec::new();
        let mut is_open = false;
        for (place, &(q, off)) in stations.iter().enumerate() {
            let before = place.checked_sub(1).map(|before| stations[before].0);
            if off <= TRAVEL_TOLERANCE && !is_open {
                ranges.push([before.map_or(q, |outside| edge(q, outside, &beyond)), q]);
            } else if off > TRAVEL_TOLERANCE
                && is_open
                && let Some(range) = ranges.last_mut()
            {
                range[1] = edge(range[1], q, &beyond);
            } else if let Some(range) = ranges.last_mut().filter(|_| is_open) {
                range[1] = q;
            }
            is_open = off <= TRAVEL_TOLERANCE;
        }
        ranges
    }

    /// The largest distance of an axis beyond its travel, mm or rad, with the free axis at `q`; infinite if the tip or the direction cannot
    /// be reached.
    fn beyond_travel(&self, q: f64, free: usize, target: &Target<'_>) -> f64 {
        let Some(state) = self.with_free(q, free, target) else {
            return f64::INFINITY;
        };
        let joints = self.chain().joints().iter().enumerate();
        let beyond = joints.map(|(place, joint)| {
            let [low, high] = target.travel[place];
            let q = state.q[place];
            match joint.kind {
                AxisKind::Linear => (low - q).max(q - high),
                // Of the equivalent angles, the one nearest to the middle of the travel is used.
                AxisKind::Rotary if place == free => 0.0,
                AxisKind::Rotary => {
                    let turned = q + TAU * ((0.5 * (low + high) - q) / TAU).round();
                    (low - turned).max(turned - high)
                }
            }
        });
        beyond.fold(0.0, f64::max)
    }

    /// The state with the free axis at `q`; `None` if the tool direction cannot be reached with this axis free, or the
    /// linear axes do not reach the tip.
    fn with_free(&self, q: f64, free: usize, target: &Target<'_>) -> Option<State> {
        let mut held = *target.held;
        held.q[free] = q;
        let found = self.chain().pointing(target.direction, target.pair, &held).ok()?;
        let pointing = found.into_iter().find(|pointing| pointing.free == Some(free))?;
        let reached = self.chain().reaching(target.tip_mm, &pointing.state, target.travel);
        reached.ok()
    }
}

fn nearest_to_zero([low, high]: [f64; 2]) -> f64 {
    0.0_f64.max(low).min(high)
}

/// Bisects for the end of a range between a coordinate inside the range and one outside.
fn edge(mut inside: f64, mut outside: f64, beyond: &impl Fn(f64) -> f64) -> f64 {
    for _ in 0..SEARCH_STEPS {
        let middle = 0.5 * (inside + outside);
        if beyond(middle) <= TRAVEL_TOLERANCE {
            inside = middle;
        } else {
            outside = middle;
        }
    }
    inside
}

/// Coordinate and value of the minimum of `beyond` between two coordinates, by ternary search.
fn lowest(mut low: f64, mut high: f64, beyond: &impl Fn(f64) -> f64) -> (f64, f64) {
    for _ in 0..SEARCH_STEPS {
        let [left, right] = [low + (high - low) / 3.0, high - (high - low) / 3.0];
        if beyond(left) <= beyond(right) {
            high = right;
        } else {
            low = left;
        }
    }
    let middle = 0.5 * (low + high);
    (middle, beyond(middle))
}
