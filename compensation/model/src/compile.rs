//! The compiled machine: every curve as piecewise cubics, evaluated without allocation.

use volcomp_curve::{Curve, ErrorCurve, Field, Grid};
use volcomp_kinematics::{Approach, Chain, ErrorMotion, ErrorSource, MAX_AXES, State};

use crate::{
    error::ModelError,
    error_name::{Component, ErrorName},
    machine::{Axis, Machine, file_units},
};

/// The most cubic pieces that one curve may need.
pub const MOST_PIECES: usize = 8192;

/// A cubic on each interval between breakpoints; end values are held outside.
#[derive(Clone, Debug, PartialEq)]
struct PiecewiseCubic {
    breakpoints: Vec<f64>,
    /// c0 + c1 t + c2 t² + c3 t³, t from the left breakpoint.
    coefficients: Vec<[f64; 4]>,
    slope_bound: f64,
}

#[derive(Clone, Debug, PartialEq)]
enum CompiledField {
    Cubic(PiecewiseCubic),
    Grid(Grid),
}

/// One error motion: its forward and its backward branch, one of them only when they are the same.
#[derive(Clone, Debug, PartialEq)]
struct CompiledError {
    forward: CompiledField,
    backward: Option<CompiledField>,
}

/// A machine whose curves have been turned into piecewise cubics within a tolerance: plain data,
/// no allocation, no lock in evaluation. Thermal terms are not part of it.
#[derive(Clone, Debug, PartialEq)]
pub struct CompiledMachine {
    chain: Chain,
    axes: Vec<Axis>,
    motions: Vec<[Option<CompiledError>; 6]>,
    location: [ErrorMotion; MAX_AXES],
    assembly: [ErrorMotion; MAX_AXES],
}

impl Machine {
    /// Compiles the machine: each curve follows its source within `tolerance_um` (µm or µrad),
    /// checked on a fine grid in every piece.
    ///
    /// # Errors
    /// [`ModelError::TooManyPieces`] when a curve needs more than [`MOST_PIECES`].
    pub fn compile(&self, tolerance_um: f64) -> Result<CompiledMachine, ModelError> {
        let mut motions: Vec<[Option<CompiledError>; 6]> =
            vec![Default::default(); self.axes().len()];
        for (name, curve) in self.errors() {
            let index = self.index_of(name.axis)?;
            motions[index][name.component.index()] =
                Some(compile_error(name, curve, tolerance_um)?);
        }
        Ok(CompiledMachine {
            chain: self.chain().clone(),
            axes: self.axes().to_vec(),
            motions,
            location: core::array::from_fn(|axis| self.location_of(axis)),
            assembly: core::array::from_fn(|axis| ErrorMotion::from_um_urad(self.assembly(axis))),
        })
    }
}

impl CompiledMachine {
    /// The ideal chain, mm and rad.
    pub fn chain(&self) -> &Chain {
        &self.chain
    }

    /// Bound of |dE/dq| of one error motion over both branches, µm/mm or µm/deg (µrad/…); 0 without a
    /// curve. For a grid the bound holds along each of its two axes.
    pub fn slope_bound(&self, name: ErrorName) -> f64 {
        let Some(index) = self.chain.structure().index_of(name.axis) else {
            return 0.0;
        };
        self.motions[index][name.component.index()]
            .as_ref()
            .filter(|_| !name.location)
            .map_or(0.0, |error| {
                let backward = error
                    .backward
                    .as_ref()
                    .map_or(0.0, CompiledField::slope_bound);
                error.forward.slope_bound().max(backward)
            })
    }

    /// Number of cubic pieces of all curves together.
    pub fn pieces(&self) -> usize {
        let fields = self.motions.iter().flatten().flatten();
        fields
            .flat_map(|error| core::iter::once(&error.forward).chain(&error.backward))
            .map(|field| match field {
                CompiledField::Cubic(cubic) => cubic.coefficients.len(),
                CompiledField::Grid(_) => 0,
            })
            .sum()
    }
}

impl ErrorSource for CompiledMachine {
    fn error_motion(&self, axis: usize, state: &State) -> ErrorMotion {
        let Some(curves) = self.motions.get(axis) else {
            return ErrorMotion::ZERO;
        };
        let mut coordinates = [0.0; MAX_AXES];
        for ((place, axis), &q) in coordinates.iter_mut().zip(&self.axes).zip(&state.q) {
            *place = axis.looked_up(file_units(axis.name, q));
        }
        let value = |component: Component| {
            curves[component.index()].as_ref().map_or(0.0, |error| {
                error.value(axis, &coordinates, state.approach[axis])
            })
        };
        ErrorMotion::from_um_urad(Component::ALL.map(value))
    }

    fn location(&self, axis: usize) -> ErrorMotion {
        self.location.get(axis).copied().unwrap_or_default()
    }

    fn assembly(&self, axis: usize) -> ErrorMotion {
        self.assembly.get(axis).copied().unwrap_or_default()
    }
}

impl CompiledError {
    fn value(&self, own: usize, coordinates: &[f64; MAX_AXES], approach: Approach) -> f64 {
        let forward = || self.forward.value(own, coordinates);
        let Some(backward) = &self.backward else {
            return forward();
        };
        match approach {
            Approach::Positive => forward(),
            Approach::Negative => backward.value(own, coordinates),
            Approach::Unknown => 0.5 * (forward() + backward.value(own, coordinates)),
        }
    }
}

impl CompiledField {
    fn value(&self, own: usize, coordinates: &[f64; MAX_AXES]) -> f64 {
        match self {
            Self::Cubic(cubic) => cubic.value(coordinates[own]),
            Self::Grid(grid) => grid.value(coordinates),
        }
    }

    fn slope_bound(&self) -> f64 {
        match self {
            Self::Cubic(cubic) => cubic.slope_bound,
            Self::Grid(grid) => grid_slope_bound(grid),
        }
    }
}

fn compile_error(
    name: ErrorName,
    curve: &ErrorCurve,
    tolerance_um: f64,
) -> Result<CompiledError, ModelError> {
    let field = |field: &Field, offset: f64| match field {
        Field::Grid(grid) if offset == 0.0 => Ok(CompiledField::Grid(grid.clone())),
        Field::Grid(grid) => offset_grid(grid, offset, name).map(CompiledField::Grid),
        Field::Curve(curve) => {
            let refused = || ModelError::TooManyPieces {
                error: name.to_string(),
                tolerance_um,
                most_pieces: MOST_PIECES,
            };
            PiecewiseCubic::follow(curve, offset, tolerance_um)
                .map(CompiledField::Cubic)
                .ok_or_else(refused)
        }
    };
    Ok(match curve {
        ErrorCurve::Single(single) => CompiledError {
            forward: field(single, 0.0)?,
            backward: None,
        },
        ErrorCurve::Pair { forward, backward } => CompiledError {
            forward: field(forward, 0.0)?,
            backward: Some(field(backward, 0.0)?),
        },
        ErrorCurve::Reversal { mean, reversal } => CompiledError {
            forward: field(mean, reversal / 2.0)?,
            backward: Some(field(mean, -reversal / 2.0)?),
        },
    })
}

fn offset_grid(grid: &Grid, offset: f64, name: ErrorName) -> Result<Grid, ModelError> {
    let shift = |row: &Vec<f64>| row.iter().map(|value| value + offset).collect();
    let values = grid.values().iter().map(shift).collect();
    Grid::new(grid.axes(), grid.nodes().clone(), values).map_err(|e| ModelError::Error {
        error: name.to_string(),
        reason: e.to_string(),
    })
}

fn grid_slope_bound(grid: &Grid) -> f64 {
    let [first, second] = grid.nodes();
    let values = grid.values();
    let mut bound = 0.0_f64;
    for (i, row) in values.iter().enumerate() {
        for (j, value) in row.iter().enumerate() {
            if let Some(next) = values.get(i + 1) {
                bound = bound.max(((next[j] - value) / (first[i + 1] - first[i])).abs());
            }
            if let Some(next) = row.get(j + 1) {
                bound = bound.max(((next - value) / (second[j + 1] - second[j])).abs());
            }
        }
    }
    bound
}

impl PiecewiseCubic {
    /// `None` when more than [`MOST_PIECES`] are needed.
    fn follow(curve: &Curve, offset: f64, tolerance: f64) -> Option<Self> {
        let value = |x: f64| curve.value(x) + offset;
        let mut cubic = Self {
            breakpoints: Vec::new(),
            coefficients: Vec::new(),
            slope_bound: 0.0,
        };
        let Some([low, high]) = curve.domain() else {
            cubic.coefficients.push([value(0.0), 0.0, 0.0, 0.0]);
            return Some(cubic);
        };
        let mut starts = curve.breakpoints();
        starts.extend([low, high]);
        starts.retain(|x| (low..=high).contains(x));
        starts.sort_unstable_by(f64::total_cmp);
        starts.dedup();
        cubic.breakpoints.push(low);
        for pair in starts.windows(2) {
            cubic.follow_between(&value, pair[0], pair[1], tolerance)?;
        }
        Some(cubic)
    }

    /// Halves [left, right] until the cubic through four points of it keeps the tolerance.
    fn follow_between(
        &mut self,
        value: &impl Fn(f64) -> f64,
        left: f64,
        right: f64,
        tolerance: f64,
    ) -> Option<()> {
        let mut pending = vec![(left, right)];
        while let Some((from, to)) = pending.pop() {
            let coefficients = cubic_through(value, from, to);
            let keeps = (1..24).all(|step| {
                let t = (to - from) * f64::from(step) / 24.0;
                (horner(&coefficients, t) - value(from + t)).abs() <= tolerance
            });
            let middle = 0.5 * (from + to);
            // An interval that cannot be halved any more is taken as it is: one rounding wide.
            if keeps || middle <= from || middle >= to {
                if self.coefficients.len() >= MOST_PIECES {
                    return None;
                }
                self.slope_bound = self.slope_bound.max(slope_bound(&coefficients, to - from));
                self.breakpoints.push(to);
                self.coefficients.push(coefficients);
            } else {
                if pending.len() + self.coefficients.len() >= MOST_PIECES {
                    return None;
                }
                pending.push((middle, to));
                pending.push((from, middle));
            }
        }
        Some(())
    }

    fn value(&self, x: f64) -> f64 {
        let (Some(&low), Some(&high)) = (self.breakpoints.first(), self.breakpoints.last()) else {
            return self.coefficients.first().map_or(0.0, |c| c[0]);
        };
        // max/min instead of clamp: NaN passes through, as in the source curve.
        let x = if x < low {
            low
        } else if x > high {
            high
        } else {
            x
        };
        let last = self.coefficients.len().saturating_sub(1);
        let piece = self
            .breakpoints
            .partition_point(|&start| start <= x)
            .saturating_sub(1)
            .min(last);
        horner(&self.coefficients[piece], x - self.breakpoints[piece])
    }
}

fn horner(c: &[f64; 4], t: f64) -> f64 {
    c[0] + t * (c[1] + t * (c[2] + t * c[3]))
}

/// The cubic through the values at 0, ⅓, ⅔ and 1 of the interval (Newton's divided differences,
/// expanded in powers of the distance from `from`).
fn cubic_through(value: &impl Fn(f64) -> f64, from: f64, to: f64) -> [f64; 4] {
    let h = (to - from) / 3.0;
    let v = [
        value(from),
        value(from + h),
        value(from + 2.0 * h),
        value(to),
    ];
    let first = (v[1] - v[0]) / h;
    let second = (v[2] - 2.0 * v[1] + v[0]) / (2.0 * h * h);
    let third = (v[3] - 3.0 * v[2] + 3.0 * v[1] - v[0]) / (6.0 * h * h * h);
    [
        v[0],
        first - second * h + 2.0 * third * h * h,
        second - 3.0 * third * h,
        third,
    ]
}

/// The largest |slope| of a cubic on [0, length]: at an end or where the second derivative is 0.
fn slope_bound(c: &[f64; 4], length: f64) -> f64 {
    let slope = |t: f64| (c[1] + t * (2.0 * c[2] + t * 3.0 * c[3])).abs();
    let turning = -c[2] / (3.0 * c[3]);
    let inside = (0.0..=length).contains(&turning);
    slope(0.0)
        .max(slope(length))
        .max(if inside { slope(turning) } else { 0.0 })
}
