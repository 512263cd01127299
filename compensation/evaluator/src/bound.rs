//! Bounds of errors, from the derivatives of the curves.
//!
//! [`CompiledMachine::chord_bound_mm`] bounds the distance between the errors along a straight move and the straight
//! line between the errors at its ends. [`Neglected`] bounds the residual of first-order corrections.

use arrayvec::ArrayVec;
use volcomp_kinematics::{State, nalgebra::Vector3};
use volcomp_vocabulary::{AxisKind, Component, Direction, MAX_AXES, PerAxis};

use crate::{
    machine::{CompiledAxis, CompiledMachine},
    parts::branch_index,
    table::{LANES, Piece},
};

/// Maximum move of one linear axis in [`CompiledMachine::short_ways`].
const MAX_MOVE_MM: f64 = 100.0;
const MAX_TURN_RAD: f64 = 0.1;

/// Slopes of the error motions of an axis over an interval of its travel, per mm or deg.
#[derive(Clone, Copy, Debug, Default)]
struct Slopes {
    /// Largest difference between two slopes within the interval: displacement (mm) and tilt (rad), per mm or deg.
    varies: [f64; 2],
    /// Maximum absolute slopes of displacement (mm) and tilt (rad), per mm or deg.
    largest: [f64; 2],
}

impl CompiledMachine {
    /// Upper bound, mm, of the deviation of the position error from linear interpolation between its values at the two
    /// ends of a move. All axes move linearly from `from` to `to`. The bound holds everywhere on the move, for the
    /// approach of `to`. It is 0 on machines without rotary axes if the error is linear along the move. Otherwise it
    /// shrinks with the square of the length of the move, or with the length where a slope jumps.
    pub fn chord_bound_mm(&self, from: &State, to: &State) -> f64 {
        let reach_mm = self.reach_mm();
        let (mut way, mut turned) = (Vector3::zeros(), 0.0);
        for (index, axis) in self.axes.iter().enumerate() {
            let passed = to.q[index] - from.q[index];
            match axis.joint.kind {
                AxisKind::Linear => way += axis.joint.direction * passed,
                AxisKind::Rotary => turned += libm::fabs(passed),
            }
        }
        let moved = way.norm() + turned * reach_mm;
        let second = 2.0 * turned * way.norm() + turned * turned * reach_mm;
        let mut bound = 0.0;
        for (index, axis) in self.axes.iter().enumerate() {
            let ends = [from.q[index], to.q[index]].map(|q| axis.looked_up(q));
            let length = libm::fabs(match axis.joint.kind {
                AxisKind::Linear => to.q[index] - from.q[index],
                AxisKind::Rotary => (to.q[index] - from.q[index]).to_degrees(),
            });
            if length > 0.0 {
                let slopes = self.slopes(axis, to.approach[index], ends, length);
                let [linear, angular] = slopes.varies;
                bound += 0.25 * length * (linear + angular * reach_mm);
                let [linear, angular] = slopes.largest;
                bound += 0.25 * length * (linear * turned + angular * moved);
            }
            let [linear, angular] = self.sizes(index, axis);
            bound += 0.125 * (linear * turned * turned + angular * second);
        }
        bound
    }

    /// Length of move for each axis (mm, rad, in chain order) over which [`chord_bound_mm`](Self::chord_bound_mm) stays
    /// within `tolerance_mm`, anywhere in the travels. If several axes move, the sum of their moves as fractions of
    /// these lengths must be at most 1. A length is at most 100 mm or 0.1 rad. On a machine without rotary axes it is
    /// infinite for an axis without effect.
    pub fn short_ways(&self, tolerance_mm: f64) -> PerAxis<f64> {
        let reach_mm = self.reach_mm();
        // The bound contains products of two moves. It becomes linear in the moves if one factor of each product is
        // replaced by the maximum move of all axes.
        let turned: f64 = self.of_kind(AxisKind::Rotary).map(|_| MAX_TURN_RAD).sum();
        let way: f64 = self.of_kind(AxisKind::Linear).map(|_| MAX_MOVE_MM).sum();
        let moved = way + turned * reach_mm;
        let (mut sizes, mut tilts) = (0.0, 0.0);
        for (index, axis) in self.axes.iter().enumerate() {
            let [linear, angular] = self.sizes(index, axis);
            sizes += linear;
            tilts += angular;
        }
        PerAxis::from_fn(|index| {
            let Some(axis) = self.axes.get(index) else {
                return f64::INFINITY;
            };
            let is_rotary = axis.joint.kind == AxisKind::Rotary;
            let mut per_unit = 0.0_f64;
            for approach in [Some(Direction::Positive), Some(Direction::Negative), None] {
                let slopes = self.slopes(axis, approach, [0.0; 2], f64::INFINITY);
                let ([varies, tilt_varies], [slope, tilt_slope]) = (slopes.varies, slopes.largest);
                let along = varies + tilt_varies * reach_mm + slope * turned + tilt_slope * moved;
                per_unit = per_unit.max(0.25 * along);
            }
            let most = if is_rotary {
                per_unit = per_unit.to_degrees();
                per_unit += 0.125 * (sizes * turned + tilts * (2.0 * way + turned * reach_mm));
                MAX_TURN_RAD
            } else {
                MAX_MOVE_MM
            };
            if per_unit > 0.0 {
                most.min(tolerance_mm / per_unit)
            } else if turned == 0.0 {
                f64::INFINITY
            } else {
                most
            }
        })
    }

    /// Maximum change of the position error per mm of linear motion, mm/mm: a bound over all travels and both
    /// directions of travel.
    pub fn steepness(&self) -> f64 {
        let reach_mm = self.reach_mm();
        let (mut steepness, mut tilts) = (0.0, 0.0);
        for (index, axis) in self.axes.iter().enumerate() {
            let [_, angular] = self.sizes(index, axis);
            tilts += angular;
            if axis.joint.kind == AxisKind::Linear {
                let mut largest = 0.0_f64;
                for approach in [Some(Direction::Positive), Some(Direction::Negative), None] {
                    let slopes = self.slopes(axis, approach, [0.0; 2], f64::INFINITY);
                    let [linear, angular] = slopes.largest;
                    largest = largest.max(linear + angular * reach_mm);
                }
                steepness += largest;
            }
        }
        steepness + tilts
    }

    fn of_kind(&self, kind: AxisKind) -> impl Iterator<Item = &CompiledAxis> {
        self.axes.iter().filter(move |axis| axis.joint.kind == kind)
    }

    /// Bounds of displacement (mm) and tilt (rad) due to an axis and its constant errors.
    fn sizes(&self, index: usize, axis: &CompiledAxis) -> [f64; 2] {
        let [linear, angular] = axis.size_bounds();
        let (location, assembly) = (&self.location[index], &self.assembly[index]);
        // A location error of a rotary axis counts twice: it acts on both sides of the joint (see `fold`).
        [
            linear + 2.0 * location.linear_mm.norm() + assembly.linear_mm.norm(),
            angular + 2.0 * location.angular_rad.norm() + assembly.angular_rad.norm(),
        ]
    }

    /// The slopes of an axis between two coordinates (mm or deg); `length` is the length of the move between them.
    fn slopes(
        &self,
        axis: &CompiledAxis,
        approach: Option<Direction>,
        ends: [f64; 2],
        length: f64,
    ) -> Slopes {
        let pieces = self.tables.pieces(&axis.heads[branch_index(approach)]);
        let [low, high] = [ends[0].min(ends[1]), ends[0].max(ends[1])];
        // If the ends, reduced by a modulo, are closer than the length of the move, the move crosses the roll-over, and
        // the slopes of the whole table count.
        let is_whole = high - low + 1e-9 < length;
        let mut range = [[f64::INFINITY, f64::NEG_INFINITY]; LANES];
        let last = pieces.len().saturating_sub(1);
        for (place, piece) in pieces.iter().enumerate() {
            let start = if place == 0 { f64::NEG_INFINITY } else { piece.start() };
            let end = if place == last { f64::INFINITY } else { piece.end() };
            if is_whole || (start < high && end > low) {
                let within = if is_whole {
                    [piece.start(), piece.end()]
                } else {
                    [low.max(start), high.min(end)]
                };
                take(piece, within, &mut range);
            }
        }
        let norm = |of: &dyn Fn(usize) -> f64, lanes: core::ops::Range<usize>| {
            libm::sqrt(lanes.map(|lane| of(lane) * of(lane)).sum())
        };
        let varies = |lane: usize| (range[lane][1] - range[lane][0]).max(0.0);
        let largest = |lane: usize| {
            let [low, high] = range[lane].map(libm::fabs);
            let size = low.max(high);
            if size.is_finite() { size } else { 0.0 }
        };
        let mut slopes = Slopes {
            varies: [norm(&varies, 0..3), norm(&varies, 3..6)],
            largest: [norm(&largest, 0..3), norm(&largest, 3..6)],
        };
        let thermal = Vector3::from(axis.thermal.slope_mm).norm();
        slopes.largest[0] += thermal;
        for patch in &axis.patches {
            // For an error over two coordinates only a bound of its slope is available.
            let slope = patch.patch.slope_bound();
            let place = usize::from(patch.patch.component.is_angular());
            slopes.varies[place] += 2.0 * slope;
            slopes.largest[place] += slope;
        }
        slopes
    }
}

/// Extends the range [minimum, maximum] of slopes of each component by those of a piece between two coordinates.
fn take(piece: &Piece, [low, high]: [f64; 2], range: &mut [[f64; 2]; LANES]) {
    let [c1, c2, c3] = [1, 2, 3].map(|power| piece.power(power));
    let [low, high] = [low, high].map(|x| x - piece.start());
    for lane in 0..LANES {
        let slope = |t: f64| {
            let powers = c1[lane] + t * (2.0 * c2[lane] + t * 3.0 * c3[lane]);
            // The first and the last piece are constant and extend to infinity. 0 times infinity gives NaN; the slope
            // is then `c1`, 0.
            if powers.is_nan() { c1[lane] } else { powers }
        };
        let turning = -c2[lane] / (3.0 * c3[lane]);
        let inside = (low..=high).contains(&turning);
        let between = if inside { turning } else { low };
        for t in [low, high, between] {
            let slope = slope(t);
            range[lane] = [range[lane][0].min(slope), range[lane][1].max(slope)];
        }
    }
}

/// Bound of the position error that remains after first-order corrections. The bound is precomputed once for a machine
/// and evaluated for each correction.
#[derive(Clone, Debug, PartialEq)]
pub struct Neglected {
    axes: ArrayVec<Share, MAX_AXES>,
    tilts: f64,
    reach_mm: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Share {
    is_rotary: bool,
    /// Maximum change of the position error per mm or rad of the axis, mm.
    slope_mm: f64,
    /// Maximum displacement by the errors of the axis, mm.
    linear_mm: f64,
}

impl CompiledMachine {
    /// Precomputes the bound for the current thermal terms.
    pub fn neglected(&self) -> Neglected {
        let reach_mm = self.reach_mm();
        let mut tilts = 0.0;
        let mut axes = ArrayVec::new();
        for (index, axis) in self.axes.iter().enumerate().take(MAX_AXES) {
            let is_rotary = axis.joint.kind == AxisKind::Rotary;
            let per_unit = if is_rotary { 180.0 / core::f64::consts::PI } else { 1.0 };
            let slopes = |angular: bool| -> f64 {
                let components = Component::ALL.into_iter();
                let components = components.filter(|component| component.is_angular() == angular);
                components.map(|component| axis.slope_bound(component) * per_unit).sum()
            };
            let (linear, angular) = (slopes(false), slopes(true));
            let [linear_mm, angular_rad] = axis.size_bounds();
            tilts += angular_rad
                + self.location[index].angular_rad.norm()
                + self.assembly[index].angular_rad.norm();
            axes.push(Share {
                is_rotary,
                slope_mm: linear + angular * reach_mm + tilts,
                linear_mm,
            });
        }
        Neglected { axes, tilts, reach_mm }
    }
}

impl Neglected {
    /// Bound, mm, of the position error that remains after the first-order correction `delta` (mm, rad in chain order):
    /// the errors change along the correction, and tilts have a second-order part.
    pub fn mm(&self, delta: &PerAxis<f64>) -> f64 {
        let (mut bound, mut turned) = (0.0, 0.0);
        for (axis, delta) in self.axes.iter().zip(delta) {
            let size = libm::fabs(*delta);
            bound += size * axis.slope_mm;
            if axis.is_rotary {
                turned += size;
                bound += size * (axis.linear_mm + size * self.reach_mm);
            }
        }
        bound + (self.tilts + turned) * (self.tilts + turned) * self.reach_mm
    }

    /// Bound, mm, of the position error that remains after the correction `second`, which was computed with the errors
    /// at the state corrected by `first` (mm, rad in chain order). The errors change only along `second` − `first`;
    /// `first` itself contributes to second order only.
    pub fn there_mm(&self, first: &PerAxis<f64>, second: &PerAxis<f64>) -> f64 {
        let mut between = *second;
        let (mut turned, mut moved_mm) = (0.0, 0.0);
        for (index, axis) in self.axes.iter().enumerate() {
            between[index] -= first[index];
            let size = libm::fabs(second[index]);
            if axis.is_rotary {
                turned += size;
            } else {
                moved_mm += size;
            }
        }
        self.mm(&between) + turned * (turned * self.reach_mm + moved_mm)
    }
}
