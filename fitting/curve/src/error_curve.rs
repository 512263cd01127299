use alloc::vec::Vec;

use volcomp_vocabulary::Direction;

use crate::{Curve, CurveError, Grid, domain};

/// An error as a function of the coordinate of its axis (curve) or of two coordinates (grid).
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(rename_all = "snake_case")
)]
pub enum Field {
    /// Curve over the coordinate of the axis that has the error.
    Curve(Curve),
    Grid(Grid),
}

impl Field {
    /// Value at `coordinates`. A curve uses `coordinates[own]`; a grid uses the coordinates of its two axes. A missing
    /// coordinate counts as 0.
    pub fn value(&self, own: usize, coordinates: &[f64]) -> f64 {
        match self {
            Self::Curve(curve) => curve.value(coordinate(own, coordinates)),
            Self::Grid(grid) => grid.value(coordinates),
        }
    }

    /// Partial derivative with respect to `coordinates[with_respect_to]`.
    pub fn partial(&self, with_respect_to: usize, own: usize, coordinates: &[f64]) -> f64 {
        match self {
            Self::Curve(curve) if with_respect_to == own => {
                curve.derivative(coordinate(own, coordinates))
            }
            Self::Curve(_) => 0.0,
            Self::Grid(grid) => grid.partial(with_respect_to, coordinates),
        }
    }

    /// Index and range of each coordinate on which the field depends; empty for a constant.
    pub fn domains(&self, own: usize) -> Vec<(usize, [f64; 2])> {
        match self {
            Self::Curve(curve) => curve.domain().map(|range| (own, range)).into_iter().collect(),
            Self::Grid(grid) => grid.axes().into_iter().zip(grid.domain()).collect(),
        }
    }

    /// Whether the coordinates on which the field depends are in their ranges.
    pub fn contains(&self, own: usize, coordinates: &[f64]) -> bool {
        match self {
            Self::Curve(curve) => curve.contains(coordinate(own, coordinates)),
            Self::Grid(grid) => grid.contains(coordinates),
        }
    }
}

impl From<Curve> for Field {
    fn from(curve: Curve) -> Self {
        Self::Curve(curve)
    }
}

impl From<Grid> for Field {
    fn from(grid: Grid) -> Self {
        Self::Grid(grid)
    }
}

/// One error component of one axis, with or without dependence on the direction of motion.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(rename_all = "snake_case")
)]
pub enum ErrorCurve {
    /// Same field in both directions of motion.
    Single(Field),
    /// One field for each direction of motion.
    Pair {
        /// After motion in the positive direction.
        forward: Field,
        /// After motion in the negative direction.
        backward: Field,
    },
    /// Mean of both directions, and reversal value B = forward − backward of ISO 230-2.
    Reversal {
        mean: Field,
        /// Reversal value B, in value units.
        #[cfg_attr(feature = "serde", serde(deserialize_with = "crate::serialised::finite"))]
        reversal: f64,
    },
}

impl ErrorCurve {
    /// Creates an error curve from a mean and a reversal value B: forward = mean + B/2, backward = mean − B/2.
    ///
    /// # Errors
    /// The reversal value is not finite.
    pub fn with_reversal(mean: Field, reversal: f64) -> Result<Self, CurveError> {
        domain::finite("reversal", &[reversal])?;
        Ok(Self::Reversal { mean, reversal })
    }

    /// Value at `coordinates` for the direction of approach `branch`. `None` gives the mean of both directions.
    pub fn value(&self, own: usize, coordinates: &[f64], branch: Option<Direction>) -> f64 {
        let value = self.blend(branch, |field| field.value(own, coordinates));
        match (self, branch) {
            (Self::Reversal { reversal, .. }, Some(Direction::Positive)) => value + reversal / 2.0,
            (Self::Reversal { reversal, .. }, Some(Direction::Negative)) => value - reversal / 2.0,
            _ => value,
        }
    }

    /// Derivative with respect to `coordinates[own]`, the coordinate of the axis that has the error.
    pub fn derivative(&self, own: usize, coordinates: &[f64], branch: Option<Direction>) -> f64 {
        self.partial(own, own, coordinates, branch)
    }

    /// Partial derivative with respect to `coordinates[with_respect_to]`.
    pub fn partial(
        &self,
        with_respect_to: usize,
        own: usize,
        coordinates: &[f64],
        branch: Option<Direction>,
    ) -> f64 {
        self.blend(branch, |field| field.partial(with_respect_to, own, coordinates))
    }

    /// Whether the coordinates are in the ranges of all fields.
    pub fn contains(&self, own: usize, coordinates: &[f64]) -> bool {
        self.fields().all(|field| field.contains(own, coordinates))
    }

    /// Whether the value depends on the direction of approach.
    pub const fn has_directions(&self) -> bool {
        !matches!(self, Self::Single(_))
    }

    /// All fields: the single one, the mean, or forward and then backward.
    pub fn fields(&self) -> impl Iterator<Item = &Field> {
        let (first, second) = match self {
            Self::Single(field) | Self::Reversal { mean: field, .. } => (field, None),
            Self::Pair { forward, backward } => (forward, Some(backward)),
        };
        core::iter::once(first).chain(second)
    }

    /// Whether every number is finite. [`Curve::Constant`] and [`ErrorCurve::Reversal`] can be built without a
    /// constructor, which would check this.
    pub fn is_finite(&self) -> bool {
        let reversal = match self {
            Self::Reversal { reversal, .. } => *reversal,
            Self::Single(_) | Self::Pair { .. } => 0.0,
        };
        let constant = |field: &Field| match field {
            Field::Curve(Curve::Constant(value)) => value.is_finite(),
            // The constructors of these curves reject numbers that are not finite.
            Field::Curve(_) | Field::Grid(_) => true,
        };
        reversal.is_finite() && self.fields().all(constant)
    }

    fn blend(&self, branch: Option<Direction>, of: impl Fn(&Field) -> f64) -> f64 {
        match self {
            Self::Single(field) | Self::Reversal { mean: field, .. } => of(field),
            Self::Pair { forward, backward } => match branch {
                Some(Direction::Positive) => of(forward),
                Some(Direction::Negative) => of(backward),
                None => 0.5 * of(forward) + 0.5 * of(backward),
            },
        }
    }
}

impl From<Field> for ErrorCurve {
    fn from(field: Field) -> Self {
        Self::Single(field)
    }
}

impl From<Curve> for ErrorCurve {
    fn from(curve: Curve) -> Self {
        Self::Single(Field::Curve(curve))
    }
}

fn coordinate(own: usize, coordinates: &[f64]) -> f64 {
    coordinates.get(own).copied().unwrap_or(0.0)
}
