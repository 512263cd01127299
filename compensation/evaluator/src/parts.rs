//! Builder of a machine to be compiled; checks each part by name as it is added.

use alloc::{boxed::Box, vec::Vec};

use volcomp_kinematics::{Chain, ErrorMotion};
use volcomp_vocabulary::{
    AxisKind, AxisName, Component, Deg, Direction, Displacement, ErrorName, MAX_AXES, PerAxis,
};

use crate::{EvaluatorError, error::no_axis, table::Patch};

/// Maximum deviation of a compiled curve from its source.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// Maximum deviation of displacements, mm.
    pub linear_mm: f64,
    /// Maximum deviation of rotations, rad.
    pub angular_rad: f64,
}

impl Default for Tolerance {
    /// 1 nm and 1 nrad.
    fn default() -> Self {
        Self::from_nm(1.0)
    }
}

impl Tolerance {
    /// A tolerance of `nm` nanometres for displacements and `nm` nanoradians for rotations.
    pub fn from_nm(nm: f64) -> Self {
        Self { linear_mm: nm * 1e-6, angular_rad: nm * 1e-9 }
    }

    pub(crate) fn lane(&self, lane: usize) -> f64 {
        if lane < 3 { self.linear_mm } else { self.angular_rad }
    }
}

/// The six error motions of an axis, mm and rad, at a coordinate in mm or deg. The second argument is the direction of
/// the last travel; `None` is unknown.
pub type RawCurve<'a> = dyn Fn(f64, Option<Direction>) -> ErrorMotion + 'a;

/// Whether an axis has different errors in its two directions of travel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Branches {
    /// Equal errors in both directions.
    One,
    /// Forward, backward, and their mean for an unknown direction.
    Three,
}

/// Index of a branch in [`Branches::Three`]: forward, backward, mean.
#[inline(always)]
pub(crate) fn branch_index(approach: Option<Direction>) -> usize {
    match approach {
        Some(Direction::Positive) => 0,
        Some(Direction::Negative) => 1,
        None => 2,
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct StatedRange {
    pub(crate) component: Component,
    pub(crate) looked_at: AxisName,
    pub(crate) domain: [f64; 2],
}

/// One axis of a machine to be compiled: its travel and its error motions. Coordinates of curves are mm or deg.
///
/// ```
/// use volcomp_evaluator::AxisParts;
/// use volcomp_kinematics::ErrorMotion;
/// use volcomp_vocabulary::{AxisKind, Displacement};
///
/// let travel = [0.0, 500.0].map(|end| Displacement::from_coordinate(AxisKind::Linear, end));
/// let x = AxisParts::new(travel, |q, _| ErrorMotion::from_um_urad([0.01 * q, 0.0, 0.0, 0.0, 0.0, 0.0]));
/// # let _ = x;
/// ```
pub struct AxisParts<'a> {
    pub(crate) errors: Box<RawCurve<'a>>,
    pub(crate) branches: Branches,
    pub(crate) breakpoints: [Vec<f64>; 6],
    pub(crate) slope_mm: [f64; 3],
    pub(crate) travel: [Displacement; 2],
    pub(crate) modulo: Option<Deg>,
    pub(crate) patches: Vec<Patch>,
    pub(crate) ranges: Vec<StatedRange>,
}

impl<'a> AxisParts<'a> {
    /// An axis with this travel. `errors` returns its error motions (mm, rad) at a coordinate in mm or deg. `errors` is
    /// called with direction `None` unless [`bidirectional`](Self::bidirectional) is set. Error motions are compiled
    /// over the whole travel, where they must be finite; beyond the travel the end values are held. Coordinates where a
    /// derivative jumps must be declared with [`breakpoints`](Self::breakpoints).
    pub fn new(
        travel: [Displacement; 2],
        errors: impl Fn(f64, Option<Direction>) -> ErrorMotion + 'a,
    ) -> Self {
        Self {
            errors: Box::new(errors),
            branches: Branches::One,
            breakpoints: Default::default(),
            slope_mm: [0.0; 3],
            travel,
            modulo: None,
            patches: Vec::new(),
            ranges: Vec::new(),
        }
    }

    pub fn without_errors(travel: [Displacement; 2]) -> Self {
        Self::new(travel, |_, _| ErrorMotion::ZERO)
    }

    /// Declares that the errors differ between the two directions of travel. They are then compiled for forward travel,
    /// for backward travel, and for an unknown direction (`None`), for which `errors` must return the mean.
    #[must_use]
    pub fn bidirectional(mut self) -> Self {
        self.branches = Branches::Three;
        self
    }

    /// Coordinates (mm or deg) at which a derivative of a component may jump, in any order, in addition to the ends of
    /// travel. Breakpoints outside the travel extend the compiled range.
    #[must_use]
    pub fn breakpoints(
        mut self,
        component: Component,
        coordinates: impl IntoIterator<Item = f64>,
    ) -> Self {
        self.breakpoints[component.index()].extend(coordinates);
        self
    }

    /// An additional slope of the displacements, mm per mm or deg of the coordinate, such as thermal expansion. It
    /// continues beyond the travel.
    #[must_use]
    pub fn slope_mm(mut self, slope_mm: [f64; 3]) -> Self {
        self.slope_mm = slope_mm;
        self
    }

    /// Modulo of a rotary axis: coordinates are reduced by this period into the travel before curves are evaluated.
    #[must_use]
    pub fn modulo(mut self, period: Deg) -> Self {
        self.modulo = Some(period);
        self
    }

    /// Adds an error over two coordinates.
    #[must_use]
    pub fn patch(mut self, patch: Patch) -> Self {
        self.patches.push(patch);
        self
    }

    /// Sets the range over which the curve of a component is defined: coordinates of the axis `looked_at`, mm or deg.
    /// States outside are reported by [`CompiledMachine::outside_range`](crate::CompiledMachine::outside_range).
    #[must_use]
    pub fn range(mut self, component: Component, looked_at: AxisName, domain: [f64; 2]) -> Self {
        self.ranges.push(StatedRange { component, looked_at, domain });
        self
    }

    fn check(&self, chain: &Chain, axis: AxisName) -> Result<(), EvaluatorError> {
        let wrong = |what, expected| Err(EvaluatorError::Axis { axis, what, expected });
        let [low, high] = self.travel.map(Displacement::mm_or_deg);
        if self.travel.iter().any(|end| end.kind() != axis.kind()) {
            return wrong(
                "travel",
                match axis.kind() {
                    AxisKind::Linear => "lengths, since the axis is linear",
                    AxisKind::Rotary => "angles, since the axis is rotary",
                },
            );
        }
        if !(low.is_finite() && high.is_finite() && low < high) {
            return wrong("travel", "two finite ends, the lower one first");
        }
        if self.modulo.is_some_and(|period| {
            axis.kind() == AxisKind::Linear || !(period.0 > 0.0 && period.is_finite())
        }) {
            return wrong("modulo", "a positive period of a rotary axis");
        }
        if !self.slope_mm.iter().all(|slope| slope.is_finite()) {
            return wrong("slope", "finite numbers");
        }
        if !self.breakpoints.iter().flatten().all(|at| at.is_finite()) {
            return wrong("breakpoints", "finite coordinates");
        }
        let known = |name: AxisName| chain.structure().index_of(name).is_some();
        let ranges = self.ranges.iter();
        for StatedRange { looked_at, domain, .. } in ranges {
            if !known(*looked_at) {
                return Err(no_axis(chain, *looked_at));
            }
            if domain[0].is_nan() || domain[1].is_nan() || domain[0] > domain[1] {
                return wrong("range", "two ends, the lower one first");
            }
        }
        for patch in &self.patches {
            for looked_at in patch.axes {
                if !known(looked_at) {
                    return Err(no_axis(chain, looked_at));
                }
            }
            if let Err(expected) = patch.check() {
                return wrong("error over two coordinates", expected);
            }
        }
        Ok(())
    }
}

/// A machine to be compiled: its chain, its axes, and the location and assembly errors of each axis.
pub struct MachineParts<'a> {
    pub(crate) chain: Chain,
    pub(crate) axes: [Option<AxisParts<'a>>; MAX_AXES],
    pub(crate) location: PerAxis<ErrorMotion>,
    pub(crate) assembly: PerAxis<ErrorMotion>,
}

impl<'a> MachineParts<'a> {
    /// Starts from a chain with its tool, mm and rad, without errors; every axis must then be added with
    /// [`axis`](Self::axis).
    pub fn new(chain: &Chain) -> Self {
        Self {
            chain: chain.clone(),
            axes: Default::default(),
            location: PerAxis::default(),
            assembly: PerAxis::default(),
        }
    }

    fn place(&self, axis: AxisName) -> Result<usize, EvaluatorError> {
        let index = self.chain.structure().index_of(axis);
        index.ok_or_else(|| no_axis(&self.chain, axis))
    }

    /// Adds one axis.
    ///
    /// # Errors
    /// An axis that the chain does not have or that was already added, numbers that are not finite, a travel of the
    /// wrong kind or with its ends reversed, an error over two coordinates with nodes that do not ascend or with a
    /// wrong number of values.
    pub fn axis(mut self, axis: AxisName, parts: AxisParts<'a>) -> Result<Self, EvaluatorError> {
        let index = self.place(axis)?;
        parts.check(&self.chain, axis)?;
        // A chain index is below MAX_AXES.
        if self.axes[index].replace(parts).is_some() {
            return Err(EvaluatorError::Axis { axis, what: "axis", expected: "each axis once" });
        }
        Ok(self)
    }

    /// Sets a location error, for example the squareness `EC0Y`.
    ///
    /// # Errors
    /// An axis that the chain does not have, the name of an error motion, a length for an angular error or an angle
    /// for a linear one, a number that is not finite.
    pub fn location(
        mut self,
        name: ErrorName,
        value: Displacement,
    ) -> Result<Self, EvaluatorError> {
        let index = self.place(name.axis)?;
        let angle = value.kind() == AxisKind::Rotary;
        if !name.location || name.component.is_angular() != angle || !value.mm_or_rad().is_finite()
        {
            return Err(EvaluatorError::Location { name });
        }
        let motion = &mut self.location[index];
        let vector = if angle { &mut motion.angular_rad } else { &mut motion.linear_mm };
        vector[name.component.mcs_index()] = value.mm_or_rad();
        Ok(self)
    }

    /// Sets the six assembly errors of an axis (mm, rad), about the MCS origin.
    ///
    /// # Errors
    /// An axis that the chain does not have, numbers that are not finite.
    pub fn assembly(mut self, axis: AxisName, motion: ErrorMotion) -> Result<Self, EvaluatorError> {
        let index = self.place(axis)?;
        let numbers = motion.linear_mm.iter().chain(motion.angular_rad.iter());
        if !numbers.into_iter().all(|number| number.is_finite()) {
            return Err(EvaluatorError::Axis {
                axis,
                what: "assembly errors",
                expected: "finite numbers",
            });
        }
        self.assembly[index] = motion;
        Ok(self)
    }
}
