//! What no corrected coordinate may do, whatever the machine file says: move by more than a limit, or leave its travel.

use std::f64::consts::{FRAC_PI_2, TAU};

use volcomp_model::vocabulary::{
    AxisKind, AxisName, Coordinate, CorrectionLimit, Displacement, bounds::LARGEST_CORRECTION,
    is_within,
};

use crate::{
    coordinates::{Axes, is_rotary, name_of},
    correction::Corrector,
    motion::{Arc, Move},
    rewrite::Rewriter,
    vector::dot,
    words::each,
};

/// Coordinates nearer to an end of travel than the largest correction can leave it.
const NEAR_MM: f64 = LARGEST_CORRECTION.0;

/// A correction that no axis may get.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BoundViolation {
    /// A correction beyond the limit of the [`Job`](crate::Job).
    #[error(
        "the correction of {axis} is {found:.1}, expected at most {limit}: check the units in the machine file"
    )]
    BeyondLimit {
        /// The axis.
        axis: AxisName,
        /// The correction.
        found: Displacement,
        /// The limit of the job.
        limit: Displacement,
    },
    /// Corrections that move the tool beyond the limit of the [`Job`](crate::Job), on a machine whose rotary axes correct.
    #[error(
        "the corrections of all axes together move the tool by {found:.1}, expected at most {limit}: check the units in the machine file"
    )]
    ToolBeyondLimit {
        /// How far they move it.
        found: Displacement,
        /// The limit of the job.
        limit: Displacement,
    },
    /// A corrected coordinate outside the travel that the programmed one keeps.
    #[error(
        "the correction moves {axis} from {from} to {to} in machine coordinates, outside its travel of {} to {}",
        travel[0], travel[1]
    )]
    LeavesTravel {
        /// The axis.
        axis: AxisName,
        /// The programmed machine coordinate.
        from: Coordinate,
        /// The corrected machine coordinate.
        to: Coordinate,
        /// The ends of the travel that the machine file states.
        travel: [Coordinate; 2],
    },
}

/// The bounds of the coordinates of each axis that a machine has.
///
/// State: the first corrected coordinate of the line that is being written that is beyond them. Nothing of such a line is
/// written.
#[derive(Clone, Debug)]
pub(crate) struct Bounds {
    limit: CorrectionLimit,
    /// How far the corrections of all axes together may move the tool, where rotary axes correct.
    at_tool: Option<CorrectionLimit>,
    axes: Axes<Option<AxisName>>,
    /// Travel, mm and deg; infinite for an axis without ends.
    travels: Axes<[f64; 2]>,
    violated: Option<BoundViolation>,
}

impl Bounds {
    pub(crate) fn new(corrector: &Corrector, limit: CorrectionLimit) -> Self {
        let machine = corrector.machine();
        let axis = |axis: usize| name_of(axis).and_then(|name| machine.axis(name));
        // Near a singular pose a small error of the tool axis turns a rotary axis far, and the linear axes follow it: what they do together
        // at the tool is bounded instead.
        let rotary_corrects = (0..9).any(|axis| is_rotary(axis) && corrector.corrects(axis));
        Self {
            limit: if rotary_corrects {
                CorrectionLimit::LARGEST
            } else {
                limit
            },
            at_tool: rotary_corrects.then_some(limit),
            axes: each(|of| axis(of).map(|axis| axis.name)),
            travels: each(|of| match axis(of) {
                Some(axis) if axis.has_ends() => axis.travel,
                _ => [f64::NEG_INFINITY, f64::INFINITY],
            }),
            violated: None,
        }
    }

    /// Why axes that are `known` to be at this place, mm and deg of the machine, may not get this correction.
    pub(crate) fn violation(
        &self,
        known: &Axes<bool>,
        at: &Axes,
        by: &Axes,
    ) -> Option<BoundViolation> {
        for (axis, name) in self.axes.iter().enumerate() {
            let (Some(name), true) = (*name, by[axis] != 0.0) else {
                continue;
            };
            let coordinate = |at: f64| Displacement::from_coordinate(name.kind(), at);
            let correction = coordinate(by[axis]);
            if !self.limit.allows(correction) {
                return Some(BoundViolation::BeyondLimit {
                    axis: name,
                    found: correction,
                    limit: self.limit.of(name.kind()),
                });
            }
            let (travel, from, to) = (self.travels[axis], at[axis], at[axis] + by[axis]);
            if known[axis] && is_within(travel, from) && !is_within(travel, to) {
                return Some(BoundViolation::LeavesTravel {
                    axis: name,
                    from: Coordinate(coordinate(from)),
                    to: Coordinate(coordinate(to)),
                    travel: travel.map(|end| Coordinate(coordinate(end))),
                });
            }
        }
        None
    }

    /// Why the tool may not move so far.
    fn violation_at_tool(&self, moves_mm: impl FnOnce() -> f64) -> Option<BoundViolation> {
        let limit = self.at_tool?;
        let found = Displacement::from_coordinate(AxisKind::Linear, moves_mm());
        (!limit.allows(found)).then(|| BoundViolation::ToolBeyondLimit {
            found,
            limit: limit.of(AxisKind::Linear),
        })
    }

    /// What the line that has been written violates.
    pub(crate) fn take_violation(&mut self) -> Option<BoundViolation> {
        self.violated.take()
    }

    /// Whether an axis is so near to an end of its travel that a correction within every limit may lead it out.
    fn is_near_end(&self, axis: usize, at: f64) -> bool {
        let near = |end: &f64| (at - end).abs() <= NEAR_MM;
        !is_rotary(axis) && self.travels[axis].iter().any(near)
    }
}

impl Rewriter {
    /// Why the axes may not have this correction at a place, both in the coordinates of the program.
    pub(crate) fn bound_violation(&self, at: &Axes, carried: &Axes) -> Option<BoundViolation> {
        let frame = &self.interpreter.frame;
        let by = frame.moved_in_machine(at, carried);
        self.violation_in_machine(&frame.to_machine(at), &by)
    }

    /// The same in the coordinates of the machine.
    fn violation_in_machine(&self, at: &Axes, by: &Axes) -> Option<BoundViolation> {
        let of_axes = self.bounds.violation(&self.interpreter.known, at, by);
        of_axes.or_else(|| {
            self.bounds.violation_at_tool(|| {
                let moved = each(|axis| at[axis] + by[axis]);
                let [from, to] = [at, &moved].map(|at| self.corrector.ideal_tip_mm(at));
                let way: [f64; 3] = std::array::from_fn(|i| to[i] - from[i]);
                dot(way, way).sqrt()
            })
        })
    }

    /// Checks the correction that the axes get at a place, both in the coordinates of the program: the line is refused where
    /// it is beyond the bounds.
    pub(crate) fn check_bounds(&mut self, at: &Axes, carried: &Axes) {
        if self.bounds.violated.is_none() {
            self.bounds.violated = self.bound_violation(at, carried);
        }
    }

    /// Checks the places of an arc where an axis of its plane turns, near an end of travel.
    pub(crate) fn check_arc_bounds(&mut self, motion: &Move, arc: &Arc) {
        let frame = &self.interpreter.frame;
        let [from, to] = [&motion.from, &motion.to].map(|at| frame.to_program(at));
        let (_, start) = arc.start(&from);
        let [first, second, _] = arc.axes;
        let rotation = frame.rotation_deg.to_radians();
        // One turn is enough: a helix goes through the same places of its plane.
        let sweep = arc.turns_by.clamp(-TAU, TAU);
        let places: Vec<Axes> = (-8..=8)
            .filter_map(|quarter| {
                let angle = f64::from(quarter) * FRAC_PI_2 - rotation - start;
                let share = angle / arc.turns_by;
                (share > 0.0 && share < sweep / arc.turns_by).then(|| arc.place(&from, &to, share))
            })
            .collect();
        for place in places {
            let machine = self.interpreter.frame.to_machine(&place);
            let is_near = |axis: usize| self.bounds.is_near_end(axis, machine[axis]);
            if is_near(first) || is_near(second) {
                let delta = self.corrector.at(&machine).delta;
                let by = each(|axis| {
                    if self.corrector.corrects(axis) {
                        delta[axis]
                    } else {
                        0.0
                    }
                });
                if self.bounds.violated.is_none() {
                    self.bounds.violated = self.violation_in_machine(&machine, &by);
                }
            }
        }
    }
}
