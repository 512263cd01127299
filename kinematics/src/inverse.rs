//! Inverse kinematics of the ideal chain: coordinates for a tool tip and a tool axis in workpiece axes.
//!
//! If rotary axes have made linear axes parallel, some moves of the linear axes leave the tip in place; these moves are
//! computed too.
//!
//! Linear axes do not rotate the tool. Therefore the rotary axes are determined first, from the tool axis alone, and
//! then the linear axes from the tool tip. One rotary axis is Paden and Kahan's first subproblem, two rotary axes in
//! any directions are their second; both have closed solutions (Murray, Li and Sastry, *A Mathematical Introduction to
//! Robotic Manipulation*, 1994, section 3.3.2).

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, SMatrix, Vector3};
use volcomp_vocabulary::{AxisKind, MAX_AXES, PerAxis};

use crate::chain::{Chain, State};
use crate::correctors::Correctors;
use crate::math::{atan2, sqrt};
use crate::pose::rotation_about_axis;

/// Maximum angle between directions that are treated as parallel, rad. A rotary axis parallel to the tool axis does not
/// rotate the tool axis.
const ALONG_BELOW_RAD: f64 = 1e-9;
/// Maximum deviation of the tool axis in a solution, rad.
const REACHED_WITHIN_RAD: f64 = 1e-9;
/// Maximum difference between the angles of two solutions that are treated as one, rad. Rounding can make one double
/// solution appear as two.
const SAME_BELOW_RAD: f64 = 1e-6;
/// Maximum distance of the tip from its target in a solution, mm.
pub const REACHED_WITHIN_MM: f64 = 1e-7;
/// Tolerance of the tip position at which the iteration ends, mm: the rounding error of coordinates of some metres.
const BROUGHT_WITHIN_MM: f64 = 1e-9;
/// Maximum number of iteration steps. An ideal tip needs two (the second removes the rounding error of the first), an
/// actual tip a few more.
const MOST_STEPS: usize = 12;
const MOST_CHANGES: usize = 10 * MAX_AXES;
/// Minimum volume of the box spanned by the unit directions of three linear axes; below this volume the axes are
/// treated as coplanar. Nearly coplanar axes reach a point off their plane only by long opposite moves, which are not
/// made where travel limits are unknown.
const FLAT_BELOW: f64 = 1e-3;
/// Like [`FLAT_BELOW`], but for axes with known travel limits. Near a pose at which a rotation makes two axes parallel,
/// some points are reached only by long opposite moves. Below this volume the moves affect the tip by less than
/// [`REACHED_WITHIN_MM`].
const EXACT_ABOVE: f64 = 1e-10;

/// Rotary coordinates for a tool direction, and the rotary axis that has no influence on the direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pointing {
    /// Coordinates of the rotary axes, rad: solved ones from −π to π, held ones as given. Linear axes are 0.
    pub state: State,
    /// Chain index of the rotary axis that has no influence on the tool axis at this pose. The pose is then singular:
    /// every coordinate of this axis is a solution, and the axis keeps its held coordinate.
    pub free: Option<usize>,
}

/// Why the axes cannot reach a pose.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum NoSolution {
    /// The rotary axes cannot reach the tool direction.
    #[error("the tool axis cannot be reached: the rotary axes miss it by {:.6} deg", miss_rad.to_degrees())]
    ToolAxis {
        /// Smallest remaining angle between the tool axes, rad; NaN if the requested tool axis has zero length or a
        /// held coordinate is not finite.
        miss_rad: f64,
    },
    /// The linear axes cannot reach the tip position.
    #[error("the tool tip cannot be reached: the linear axes miss it by {miss_mm:.6} mm")]
    Tip {
        /// Smallest reachable distance of the tip from its target, mm.
        miss_mm: f64,
    },
}

/// The requested tool axis has no direction, or the coordinate of a held rotary axis is not finite.
const NO_DIRECTION: NoSolution = NoSolution::ToolAxis { miss_rad: f64::NAN };

impl Chain {
    /// Rotary coordinates for which the ideal tool points along `tool_axis` (workpiece axes, from the tip to the
    /// spindle, any length except 0). Only the rotary axes at the chain indices `pair`, at most two, are determined;
    /// for two axes there are up to two solutions. Other rotary axes keep their coordinates in `held`, and so does an
    /// axis without influence on the direction.
    ///
    /// # Errors
    /// [`NoSolution::ToolAxis`].
    pub fn pointing(
        &self,
        tool_axis: &Vector3<f64>,
        pair: &[usize],
        held: &State,
    ) -> Result<ArrayVec<Pointing, 2>, NoSolution> {
        // The vector is scaled first, so that the squares of tiny and huge lengths neither underflow nor overflow.
        let wanted = (tool_axis / tool_axis.amax()).normalize();
        if !wanted.iter().all(|x| x.is_finite()) {
            return Err(NO_DIRECTION);
        }
        // P·Rot(u₁)·H·Rot(u₂)·K·a = n is equivalent to Rot(u₁)·Rot(H·u₂)·(H·K·a) = Pᵀ·n, where P, H and K are the
        // rotations of the held axes.
        let mut turns = [Matrix3::identity(); 3];
        let mut turning: ArrayVec<(usize, Vector3<f64>), 2> = ArrayVec::new();
        for (index, joint) in self.joints().iter().enumerate() {
            if joint.kind == AxisKind::Linear {
                continue;
            }
            if pair.contains(&index) && turning.len() < 2 {
                turning.push((index, joint.direction)); // fewer than two are in it
            } else {
                turns[turning.len()] *= rotation_about_axis(&joint.direction, held.q[index]);
            }
        }
        let [before, between, behind] = turns;
        let onto = before.transpose() * wanted;
        let mut state = *held;
        for (joint, q) in self.joints().iter().zip(state.q.iter_mut()) {
            if joint.kind == AxisKind::Linear {
                *q = 0.0;
            }
        }
        match turning[..] {
            [(first, u1), (second, u2)] => {
                let from = between * (behind * self.tool_axis());
                let stand = [held.q[first], held.q[second]];
                let found = two_turns(&u1, &(between * u2), &from, &onto, stand)?;
                Ok(found
                    .into_iter()
                    .map(|([one, two], free)| {
                        let mut state = state;
                        (state.q[first], state.q[second]) = (one, two);
                        Pointing { state, free: free.map(|place| [first, second][place]) }
                    })
                    .collect())
            }
            [(only, u)] => {
                let angle = one_turn(&u, &(between * self.tool_axis()), &onto)?;
                state.q[only] = angle.unwrap_or(held.q[only]);
                let free = angle.is_none().then_some(only);
                Ok([Pointing { state, free }].into_iter().collect())
            }
            _ => {
                reached(angle_between(&self.tool_axis(), &onto))?;
                Ok([Pointing { state, free: None }].into_iter().collect())
            }
        }
    }

    /// Moves the linear axes of `state` so that the ideal tip is at `tip_mm`, in workpiece axes from the workpiece
    /// origin. Rotary axes do not move.
    ///
    /// Up to three linear axes of different directions are solved in closed form, regardless of their travels. If
    /// several axes have one direction, the first of these axes moves, and the others stay as near to 0 as their
    /// `travel` (mm) allows. Only if an axis reaches an end of its travel do the others move as well (iterative
    /// solution). Axes that rotary axes have made parallel ([`Chain::dependent_moves`]) share the motion in the same
    /// way.
    ///
    /// # Errors
    /// [`NoSolution::Tip`] if the tip misses its target by more than [`REACHED_WITHIN_MM`].
    pub fn reaching(
        &self,
        tip_mm: &Vector3<f64>,
        state: &State,
        travel: &PerAxis<[f64; 2]>,
    ) -> Result<State, NoSolution> {
        let columns = self.linear_columns(state);
        let first_of_each = Correctors::all(self);
        let mut free = [false; MAX_AXES];
        let mut found = *state;
        let mut redundant = false;
        for (index, joint) in self.joints().iter().enumerate() {
            if joint.kind != AxisKind::Linear {
                continue;
            }
            free[index] = first_of_each.linear().contains(&index);
            redundant |= !free[index];
            let [low, high] = travel[index];
            found.q[index] = if free[index] { 0.0 } else { 0.0_f64.max(low).min(high) };
        }
        // Two steps are made, because the second removes the rounding error of the first.
        for _ in 0..2 {
            let missing = tip_mm - self.ideal_tip_mm(&found);
            for (q, step) in
                found.q.iter_mut().zip(least_norm(&columns, &free, &missing, EXACT_ABOVE))
            {
                *q += step;
            }
        }
        let mut reaches = found.q.iter().zip(&travel.0);
        let is_beyond = reaches.any(|(q, [low, high])| q < low || q > high);
        // Linear axes that rotary axes have made parallel share the motion, as axes that are always parallel do.
        if redundant || (is_beyond && !self.dependent_moves(state).is_empty()) {
            self.share(tip_mm, &columns, travel, &mut free, &mut found);
        }
        let miss_mm = (tip_mm - self.ideal_tip_mm(&found)).norm();
        // NaN is an error as well.
        if miss_mm <= REACHED_WITHIN_MM {
            return Ok(found);
        }
        Err(NoSolution::Tip { miss_mm })
    }

    /// Moves linear axes that are beyond their travel back to its ends; other axes compensate. The method is bounded
    /// least squares of the tip deviation, by an active-set method that can also release axes from their ends (P. B.
    /// Stark and R. L. Parker, Computational Statistics 10, 1995). `free` are the axes that may move.
    fn share(
        &self,
        tip_mm: &Vector3<f64>,
        columns: &[Vector3<f64>; MAX_AXES],
        travel: &PerAxis<[f64; 2]>,
        free: &mut [bool; MAX_AXES],
        found: &mut State,
    ) {
        let mut is_beyond = false;
        for (index, is_free) in free.iter_mut().enumerate() {
            if columns[index] == Vector3::zeros() {
                continue;
            }
            let [low, high] = travel[index];
            let within = found.q[index].max(low).min(high);
            *is_free = within == found.q[index];
            is_beyond |= !*is_free;
            found.q[index] = within;
        }
        if !is_beyond {
            return;
        }
        for _ in 0..MOST_CHANGES {
            let mut missing = tip_mm - self.ideal_tip_mm(found);
            let mut stopped = None;
            for _ in 0..2 {
                let steps = least_norm(columns, free, &missing, EXACT_ABOVE);
                // Largest part of the step at which all axes are within their travels.
                let mut share = 1.0;
                for (index, step) in steps.into_iter().enumerate() {
                    let [low, high] = travel[index];
                    let end = if step > 0.0 { high } else { low };
                    let up_to = (end - found.q[index]) / step;
                    if step != 0.0 && up_to < share {
                        (share, stopped) = (up_to.max(0.0), Some((index, end)));
                    }
                }
                for (q, step) in found.q.iter_mut().zip(steps) {
                    *q += share * step;
                }
                if let Some((index, end)) = stopped {
                    found.q[index] = end;
                    free[index] = false;
                    break;
                }
                missing = tip_mm - self.ideal_tip_mm(found);
            }
            if stopped.is_some() {
                continue;
            }
            // An axis at an end of its travel is released if moving inwards reduces the residual.
            let gain = |index: usize| {
                let towards = columns[index].dot(&missing);
                let inside = if found.q[index] <= travel[index][0] { towards } else { -towards };
                if free[index] || travel[index][0] >= travel[index][1] { 0.0 } else { inside }
            };
            let best = (0..MAX_AXES).max_by(|&a, &b| gain(a).total_cmp(&gain(b)));
            match best {
                Some(index)
                    if missing.norm() > BROUGHT_WITHIN_MM && gain(index) > BROUGHT_WITHIN_MM =>
                {
                    free[index] = true;
                }
                _ => break,
            }
        }
    }

    /// Moves linear axes of `state` until the point returned by `tip` is at `to`, both in mm in the axes of
    /// [`Chain::ideal_tip_mm`]. Only linear axes whose chain index satisfies `moves` are moved. Among several
    /// solutions, the shortest move is taken, regardless of travels; without a solution, the tip is moved as near as
    /// possible. Returns the remaining distance, mm.
    ///
    /// `tip` may also return the tip of another tool or an actual tip. Errors that are small relative to the moves only
    /// require a few more steps.
    pub fn bring(
        &self,
        state: &mut State,
        moves: impl Fn(usize) -> bool,
        to: &Vector3<f64>,
        tip: impl Fn(&State) -> Vector3<f64>,
    ) -> f64 {
        let columns = self.linear_columns(state);
        let mut moving = [false; MAX_AXES];
        for (index, joint) in self.joints().iter().enumerate() {
            moving[index] = joint.kind == AxisKind::Linear && moves(index);
        }
        let mut missing = to - tip(state);
        for _ in 0..MOST_STEPS {
            if missing.norm() <= BROUGHT_WITHIN_MM {
                break;
            }
            let steps = least_norm(&columns, &moving, &missing, FLAT_BELOW);
            for (q, step) in state.q.iter_mut().zip(steps) {
                *q += step;
            }
            missing = to - tip(state);
        }
        missing.norm()
    }

    /// Derivatives of the ideal tip with respect to each linear axis at the rotary angles of `state`: unit vectors in
    /// workpiece axes, zero vectors for rotary axes.
    fn linear_columns(&self, state: &State) -> [Vector3<f64>; MAX_AXES] {
        let mut columns = [Vector3::zeros(); MAX_AXES];
        let mut turned = Matrix3::identity();
        for ((joint, &q), column) in self.joints().iter().zip(&state.q).zip(&mut columns) {
            if joint.kind == AxisKind::Linear {
                *column = turned * joint.direction;
            } else {
                turned *= rotation_about_axis(&joint.direction, q);
            }
        }
        columns
    }
}

/// Least-norm steps of the moving axes, mm: Dᵀ·(D·Dᵀ)⁺·missing. Three axes are solved exactly if the box of their unit
/// directions has at least the volume `flat_below`.
fn least_norm(
    columns: &[Vector3<f64>; MAX_AXES],
    moving: &[bool; MAX_AXES],
    missing: &Vector3<f64>,
    flat_below: f64,
) -> [f64; MAX_AXES] {
    let used = || columns.iter().zip(moving).filter(|(_, moves)| **moves);
    let exact: ArrayVec<Vector3<f64>, MAX_AXES> = used().map(|(column, _)| *column).collect();
    if let [a, b, c] = exact[..]
        && a.cross(&b).dot(&c).abs() >= flat_below
        && let Some(inverse) = Matrix3::from_columns(&[a, b, c]).try_inverse()
    {
        let shares = inverse * missing;
        let mut shares = shares.iter().copied();
        return core::array::from_fn(|index| {
            let share = || shares.next().unwrap_or(0.0);
            moving[index].then(share).unwrap_or(0.0)
        });
    }
    let gram =
        used().fold(Matrix3::zeros(), |gram, (column, _)| gram + column * column.transpose());
    // Directions with a singular value below a thousandth are left out.
    let weighted = match gram.pseudo_inverse(1e-6) {
        Ok(inverse) => inverse * missing,
        Err(_) => Vector3::zeros(),
    };
    core::array::from_fn(|index| if moving[index] { columns[index].dot(&weighted) } else { 0.0 })
}

/// Accepts a tool-axis deviation (rad) within the tolerance; rejects larger deviations and NaN.
fn reached(miss_rad: f64) -> Result<(), NoSolution> {
    if miss_rad <= REACHED_WITHIN_RAD {
        return Ok(());
    }
    Err(NoSolution::ToolAxis { miss_rad })
}

/// The angle between two unit vectors, rad.
fn angle_between(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    atan2(a.cross(b).norm(), a.dot(b))
}

/// The angle (rad) about `u` that rotates the unit vector `from` onto `onto`; `None` if `from` is along `u`, so that
/// any angle is a solution.
fn one_turn(
    u: &Vector3<f64>,
    from: &Vector3<f64>,
    onto: &Vector3<f64>,
) -> Result<Option<f64>, NoSolution> {
    let polar = |v: &Vector3<f64>| atan2(v.cross(u).norm(), v.dot(u));
    reached((polar(from) - polar(onto)).abs())?;
    if from.cross(u).norm() < ALONG_BELOW_RAD {
        return Ok(None);
    }
    Ok(Some(turn_in_plane(u, from, onto)))
}

/// The angle (rad) about `u` from one vector to another, both projected onto the plane normal to `u`.
fn turn_in_plane(u: &Vector3<f64>, from: &Vector3<f64>, onto: &Vector3<f64>) -> f64 {
    let across = |v: &Vector3<f64>| v - u * u.dot(v);
    let (from, onto) = (across(from), across(onto));
    atan2(u.dot(&from.cross(&onto)), from.dot(&onto))
}

/// Angles of two rotations (rad), and the index, 0 or 1, of the rotation whose angle is free.
type TwoTurns = ArrayVec<([f64; 2], Option<usize>), 2>;

/// Solves Rot(u₁, θ₁)·Rot(u₂, θ₂)·`from` = `onto` for the two angles. `held` are the angles (rad) to keep where an
/// angle is free.
fn two_turns(
    u1: &Vector3<f64>,
    u2: &Vector3<f64>,
    from: &Vector3<f64>,
    onto: &Vector3<f64>,
    held: [f64; 2],
) -> Result<TwoTurns, NoSolution> {
    let one = |angles, free| Ok([(angles, Some(free))].into_iter().collect());
    let sine = u1.cross(u2);
    let back = |angle: f64| rotation_about_axis(u1, -angle) * onto;
    let turned = |angle: f64| rotation_about_axis(u2, angle) * from;
    if sine.norm() < ALONG_BELOW_RAD || from.cross(u2).norm() < ALONG_BELOW_RAD {
        // The angles about parallel axes add up, and a tool along the second axis is independent of the second angle.
        let first = one_turn(u1, &turned(held[1]), onto)?.unwrap_or(held[0]);
        return one([first, held[1]], 1);
    }
    if onto.cross(u1).norm() < ALONG_BELOW_RAD {
        let second = one_turn(u2, from, &back(held[0]))?.unwrap_or(held[1]);
        return one([held[0], second], 0);
    }
    // The vector c = Rot(u₂)·from = Rot(u₁)⁻¹·onto lies on two cones, about u₁ and about u₂.
    let (k, square) = (u1.dot(u2), sine.norm_squared());
    let (along1, along2) = (u1.dot(onto), u2.dot(from));
    let (x, y) = ((along1 - k * along2) / square, (along2 - k * along1) / square);
    let inside = u1 * x + u2 * y;
    let rest = 1.0 - inside.norm_squared();
    if !rest.is_finite() {
        return Err(NO_DIRECTION);
    }
    if rest < 0.0 {
        let polar = |u: &Vector3<f64>, v: &Vector3<f64>| angle_between(u, v);
        let (between, cone1, cone2) = (polar(u1, u2), polar(u1, onto), polar(u2, from));
        // The cones do not intersect; the largest of these angles is the gap between them.
        let gaps = [
            between - cone1 - cone2,
            cone1 - cone2 - between,
            cone2 - cone1 - between,
            between + cone1 + cone2 - core::f64::consts::TAU,
        ];
        reached(gaps.into_iter().fold(0.0, f64::max))?;
    }
    let height = sqrt(rest.max(0.0) / square);
    let mut found = TwoTurns::new();
    for sign in [1.0, -1.0] {
        let common = inside + sine * (sign * height);
        let angles = [turn_in_plane(u1, &common, onto), turn_in_plane(u2, from, &common)];
        let same = found.iter().any(|(other, _): &([f64; 2], Option<usize>)| {
            other.iter().zip(angles).all(|(a, b)| (a - b).abs() < SAME_BELOW_RAD)
        });
        if !same {
            found.push((angles, None)); // at most two
        }
    }
    Ok(found)
}

/// Maximum tip displacement of a dependent move, relative to the move: 1 µm per metre.
const DEPENDENT_BELOW: f64 = 1e-6;
/// Three sets of rotary angles, rad, at which the largest rank of the linear axes is determined: machine zero, and two
/// sets of arbitrary angles at which no axes are parallel.
const GENERIC_ANGLES_RAD: [[f64; MAX_AXES]; 3] = [
    [0.0; MAX_AXES],
    [0.37, 0.83, 1.21, 0.59, 1.07, 0.71, 1.33, 0.47, 0.97],
    [-1.13, 0.61, -0.43, 1.27, -0.79, 0.53, -1.01, 0.89, -0.67],
];

impl Chain {
    /// Moves of the linear axes that leave the ideal tip in place at the rotary angles of `state`. Components are in
    /// the order of the chain, scaled so that the largest is 1. Empty if there are as many such moves at all rotary
    /// angles, as on a machine with two axes in one direction (U parallel to X).
    pub fn dependent_moves(&self, state: &State) -> ArrayVec<PerAxis<f64>, MAX_AXES> {
        let found = self.moves_of_nothing(state);
        let elsewhere = GENERIC_ANGLES_RAD.map(|q| {
            let mut at = State::default();
            for (at, q) in at.q.iter_mut().zip(q) {
                *at = q;
            }
            self.moves_of_nothing(&at).len()
        });
        let [a, b, c] = elsewhere;
        if found.len() > a.min(b).min(c) { found } else { ArrayVec::new() }
    }

    fn moves_of_nothing(&self, state: &State) -> ArrayVec<PerAxis<f64>, MAX_AXES> {
        let columns = self.linear_columns(state);
        let is_linear = |place: usize| {
            let joint = self.joints().get(place);
            joint.is_some_and(|joint| joint.kind == AxisKind::Linear)
        };
        // An axis that cannot move gets the separate eigenvalue 1.
        let gram = SMatrix::<f64, MAX_AXES, MAX_AXES>::from_fn(|i, j| {
            if is_linear(i) && is_linear(j) {
                columns[i].dot(&columns[j])
            } else {
                f64::from(u8::from(i == j))
            }
        });
        let eigen = gram.symmetric_eigen();
        let mut found = ArrayVec::new();
        for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
            if *value >= DEPENDENT_BELOW * DEPENDENT_BELOW {
                continue;
            }
            // The first component of maximum magnitude is scaled to +1.
            let most = vector.amax();
            let first = vector.iter().find(|move_| move_.abs() > 0.999_999 * most);
            let scale = first.copied().unwrap_or(1.0);
            let moves = |place: usize| {
                let share = vector[place] / scale;
                if share.abs() < 1e-9 { 0.0 } else { share }
            };
            found.push(PerAxis::from_fn(moves)); // at most one per axis
        }
        found
    }
}
