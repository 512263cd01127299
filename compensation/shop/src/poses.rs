//! Poses at which a machine is observed, and motions of the axes to a point.

use rand::{Rng, RngExt};
use volcomp_kinematics::{REACHED_WITHIN_MM, State, actual_pose, nalgebra::Vector3};
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::{AxisKind, AxisName, Displacement};

use crate::plan::{Plan, PlannedPose};

/// Resolution of commands, mm or deg.
const COMMAND_STEP: f64 = 1e-3;
/// Maximum number of attempts for one pose, each with other random rotary coordinates.
const TRIES: usize = 200;

#[derive(Clone, Debug)]
pub(crate) struct FreeAxes {
    /// Chain index, kind and travel (mm or deg) of each free axis.
    free: Vec<(usize, AxisKind, [f64; 2])>,
    held: State,
}

impl FreeAxes {
    pub(crate) fn new(machine: &Machine, at: &[(AxisName, f64)]) -> Self {
        let mut held = State::default();
        let mut free = Vec::new();
        for (place, axis) in machine.axes().iter().enumerate() {
            let kind = axis.name.kind();
            match at.iter().find(|(name, _)| *name == axis.name) {
                Some((_, q)) => held.q[place] = Displacement::from_coordinate(kind, *q).mm_or_rad(),
                None => free.push((place, kind, axis.travel)),
            }
        }
        Self { free, held }
    }

    fn of(&self, kind: AxisKind) -> impl Iterator<Item = (usize, [f64; 2])> + '_ {
        let own = self.free.iter().filter(move |(_, of, _)| *of == kind);
        own.map(|(place, _, travel)| (*place, *travel))
    }

    /// Draws poses distributed over the travels: each axis visits `poses` evenly spaced coordinates, ends included, each once in an independent
    /// random order.
    pub(crate) fn everywhere(&self, poses: usize, random: &mut impl Rng) -> Vec<State> {
        let mut states = vec![self.held; poses];
        for (place, kind, travel) in &self.free {
            for (state, q) in states.iter_mut().zip(spread(*travel, poses, random)) {
                state.q[*place] = Displacement::from_coordinate(*kind, q).mm_or_rad();
            }
        }
        states
    }

    /// States of the poses of a plan; axes that the plan does not command are at their held coordinates, or at 0.
    pub(crate) fn planned(&self, machine: &Machine, plan: &Plan) -> Vec<State> {
        let state = |pose: &PlannedPose| {
            let mut state = self.held;
            for (name, q) in plan.axes.iter().zip(&pose.at) {
                if let Ok(place) = machine.index_of(*name) {
                    state.q[place] = Displacement::from_coordinate(name.kind(), *q).mm_or_rad();
                }
            }
            state
        };
        plan.poses.iter().map(state).collect()
    }

    /// Draws poses with the ideal tip at points (mm in workpiece axes), with rotary coordinates distributed over the
    /// travels. `point` and `machine` are called with the index of the pose; poses with unreachable points are redrawn.
    /// `Err`: the number of poses found before an unreachable one.
    pub(crate) fn around<'m, R: Rng>(
        &self,
        poses: usize,
        machine: impl Fn(usize) -> &'m Machine,
        mut point: impl FnMut(usize, &mut R) -> Vector3<f64>,
        random: &mut R,
    ) -> Result<Vec<State>, usize> {
        let rotary: Vec<(usize, [f64; 2])> = self.of(AxisKind::Rotary).collect();
        let angles: Vec<Vec<f64>> =
            rotary.iter().map(|(_, travel)| spread(*travel, poses, random)).collect();
        let mut states = Vec::with_capacity(poses);
        for pose in 0..poses {
            let mut found = None;
            for attempt in 0..TRIES {
                let mut state = self.held;
                for ((place, [low, high]), angles) in rotary.iter().zip(&angles) {
                    let angle = if attempt == 0 {
                        angles[pose]
                    } else {
                        command(low + (high - low) * random.random::<f64>(), [*low, *high])
                    };
                    state.q[*place] = angle.to_radians();
                }
                let target = point(pose, random);
                found = self.ideal(machine(pose), state, &target);
                if found.is_some() {
                    break;
                }
            }
            states.push(found.ok_or(pose)?);
        }
        Ok(states)
    }

    /// Moves the free linear axes, in steps of commands, so that the ideal tip is at `target` (mm in workpiece axes); `None` if they cannot reach it
    /// within their travels.
    pub(crate) fn ideal(
        &self,
        machine: &Machine,
        state: State,
        target: &Vector3<f64>,
    ) -> Option<State> {
        let tip = |state: &State| machine.chain().ideal_tip_mm(state);
        let mut state = self.to(machine, state, target, tip)?;
        for (place, travel) in self.of(AxisKind::Linear) {
            let [low, high] = travel;
            if !(low - COMMAND_STEP..=high + COMMAND_STEP).contains(&state.q[place]) {
                return None;
            }
            state.q[place] = command(state.q[place], travel);
        }
        Some(state)
    }

    pub(crate) fn actual(
        &self,
        machine: &Machine,
        state: State,
        target: &Vector3<f64>,
    ) -> Option<State> {
        let tip = |state: &State| actual_tip(machine, state, &Vector3::zeros());
        self.to(machine, state, target, tip)
    }

    fn to(
        &self,
        machine: &Machine,
        mut state: State,
        target: &Vector3<f64>,
        tip: impl Fn(&State) -> Vector3<f64>,
    ) -> Option<State> {
        let is_free = |place| self.free.iter().any(|(free, ..)| *free == place);
        let missed_mm = machine.chain().bring(&mut state, is_free, target, tip);
        (missed_mm <= REACHED_WITHIN_MM).then_some(state)
    }

    /// Replaces the coordinate of each free linear axis, mm, by the result of `by`.
    pub(crate) fn shift_linear(&self, state: &mut State, mut by: impl FnMut(f64) -> f64) {
        for (place, _) in self.of(AxisKind::Linear) {
            state.q[place] = by(state.q[place]);
        }
    }
}

/// Actual tip plus an offset in tool axes, mm in workpiece axes.
pub(crate) fn actual_tip(
    machine: &Machine,
    state: &State,
    offset_mm: &Vector3<f64>,
) -> Vector3<f64> {
    let none = Temperatures::new();
    let chain = machine.chain();
    let tip = chain.tool_tip_mm() + offset_mm;
    actual_pose(chain, &machine.source(&none), state).transform_point(&tip)
        - chain.workpiece_origin_mm()
}

/// `count` evenly spaced coordinates over a travel, ends included, in random order.
fn spread(travel: [f64; 2], count: usize, random: &mut impl Rng) -> Vec<f64> {
    let [low, high] = travel;
    let last = count.saturating_sub(1) as f64;
    let place = |k: usize| if last > 0.0 { k as f64 / last } else { 0.5 };
    let mut places: Vec<f64> =
        (0..count).map(|k| command(low + (high - low) * place(k), travel)).collect();
    for last in (1..count).rev() {
        places.swap(last, random.random_range(0..=last));
    }
    places
}

fn command(q: f64, [low, high]: [f64; 2]) -> f64 {
    ((q / COMMAND_STEP).round() * COMMAND_STEP).max(low).min(high)
}
