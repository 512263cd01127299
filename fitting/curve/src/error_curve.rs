//! The curve of an error: over one axis, with a branch for each direction of approach, or over a grid of several axes.

use alloc::vec::Vec;

use volcomp_vocabulary::{Direction, is_within};

use crate::{Curve, CurveError, domain};

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

/// Function of two coordinates, interpolated bilinearly between the nodes of a rectangular grid.
///
/// Outside the grid, each coordinate is clamped to the nearer end.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "crate::serialised::Grid")
)]
pub struct Grid {
    axes: [usize; 2],
    nodes: [Vec<f64>; 2],
    values: Vec<Vec<f64>>,
}

impl Grid {
    /// Builds the grid. `axes` are the indices of its two arguments among the coordinates that are passed for
    /// evaluation. `nodes` are the increasing abscissae along both axes, at least two each. `values[i][j]` is the value
    /// at `nodes[0][i]` and `nodes[1][j]`.
    ///
    /// # Errors
    /// Equal axes, too few nodes, a number that is not finite, abscissae that do not increase, numbers of values that
    /// differ from the numbers of nodes.
    pub fn new(
        axes: [usize; 2],
        nodes: [Vec<f64>; 2],
        values: Vec<Vec<f64>>,
    ) -> Result<Self, CurveError> {
        if axes[0] == axes[1] {
            return Err(CurveError::GridAxes { axis: axes[0] });
        }
        for (nodes, what) in nodes.iter().zip(["node of the first axis", "node of the second axis"])
        {
            domain::at_least("nodes along an axis", nodes.len(), 2)?;
            domain::finite(what, nodes)?;
            domain::increasing(what, nodes.iter().copied())?;
            domain::interval([nodes[0], nodes[nodes.len() - 1]])?;
        }
        if values.len() != nodes[0].len() {
            return Err(CurveError::GridRows { found: values.len(), expected: nodes[0].len() });
        }
        for (row, line) in values.iter().enumerate() {
            if line.len() != nodes[1].len() {
                let (found, expected) = (line.len(), nodes[1].len());
                return Err(CurveError::GridColumns { row, found, expected });
            }
            domain::finite("grid value in column", line)?;
        }
        Ok(Self { axes, nodes, values })
    }

    /// Indices of the two arguments among the coordinates that are passed for evaluation.
    pub fn axes(&self) -> [usize; 2] {
        self.axes
    }

    /// Increasing abscissae along the two axes.
    pub fn nodes(&self) -> &[Vec<f64>; 2] {
        &self.nodes
    }

    /// Values. `values()[i][j]` is the value at `nodes()[0][i]` and `nodes()[1][j]`.
    pub fn values(&self) -> &[Vec<f64>] {
        &self.values
    }

    pub fn domain(&self) -> [[f64; 2]; 2] {
        self.nodes.each_ref().map(|nodes| [nodes[0], nodes[nodes.len() - 1]])
    }

    /// Whether both arguments are in their ranges, including the ends and a tolerance for rounding
    /// ([`COORDINATE_ROUNDING`](volcomp_vocabulary::COORDINATE_ROUNDING)).
    pub fn contains(&self, coordinates: &[f64]) -> bool {
        let arguments = self.arguments(coordinates);
        self.domain().iter().zip(arguments).all(|(&range, x)| is_within(range, x))
    }

    /// Value at the coordinates. A missing coordinate counts as 0.
    pub fn value(&self, coordinates: &[f64]) -> f64 {
        let Some(cell) = self.cell(coordinates) else {
            return f64::NAN;
        };
        let [s, t] = cell.place;
        let [[u00, u01], [u10, u11]] = cell.corners;
        (1.0 - s) * ((1.0 - t) * u00 + t * u01) + s * ((1.0 - t) * u10 + t * u11)
    }

    /// Partial derivative with respect to `coordinates[with_respect_to]`. It is 0 if this coordinate is not an axis of
    /// the grid or is outside its range. At a node it is the right-hand derivative, at the last node the left-hand
    /// derivative.
    pub fn partial(&self, with_respect_to: usize, coordinates: &[f64]) -> f64 {
        let Some(cell) = self.cell(coordinates) else {
            return f64::NAN;
        };
        let Some(along) = self.axes.iter().position(|&axis| axis == with_respect_to) else {
            return 0.0;
        };
        if !domain::contains(self.domain()[along], self.arguments(coordinates)[along]) {
            return 0.0;
        }
        let [s, t] = cell.place;
        let [[u00, u01], [u10, u11]] = cell.corners;
        let rise = if along == 0 {
            (1.0 - t) * (u10 - u00) + t * (u11 - u01)
        } else {
            (1.0 - s) * (u01 - u00) + s * (u11 - u10)
        };
        rise / cell.size[along]
    }

    fn arguments(&self, coordinates: &[f64]) -> [f64; 2] {
        self.axes.map(|axis| coordinates.get(axis).copied().unwrap_or(0.0))
    }

    /// Cell that contains the coordinates; `None` if a coordinate is NaN.
    fn cell(&self, coordinates: &[f64]) -> Option<Cell> {
        let arguments = self.arguments(coordinates);
        if arguments.iter().any(|x| x.is_nan()) {
            return None;
        }
        let domain = self.domain();
        let mut first = [0; 2];
        let mut place = [0.0; 2];
        let mut size = [0.0; 2];
        for k in 0..2 {
            let nodes = &self.nodes[k];
            let x = arguments[k].clamp(domain[k][0], domain[k][1]);
            first[k] = domain::segment(nodes, x, |&node| node);
            size[k] = nodes[first[k] + 1] - nodes[first[k]];
            place[k] = (x - nodes[first[k]]) / size[k];
        }
        let [i, j] = first;
        let corners = [&self.values[i], &self.values[i + 1]].map(|row| [row[j], row[j + 1]]);
        Some(Cell { place, size, corners })
    }
}

struct Cell {
    /// Position in the cell, from 0 to 1 along each axis.
    place: [f64; 2],
    size: [f64; 2],
    corners: [[f64; 2]; 2],
}
