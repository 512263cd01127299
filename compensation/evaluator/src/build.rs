//! Builds a compiled machine from checked parts, or from the tables of a blob: curves become piecewise cubics within a
//! tolerance.

use alloc::{format, string::ToString, vec, vec::Vec};

use volcomp_kinematics::{Chain, Correctors, ErrorMotion, Joint, nalgebra::Vector3};
use volcomp_vocabulary::{AxisName, Component, Direction, Displacement, ErrorName, PerAxis};

use crate::{
    EvaluatorError, Tolerance,
    error::no_axis,
    machine::{CompiledAxis, CompiledMachine, Folded, Range, Thermal, fold},
    parts::{AxisParts, Branches, MachineParts},
    table::{Bounds, CompiledPatch, Head, LANES, MAX_PIECES, Piece, Tables},
    turn::Along,
};

pub(crate) struct AxisTables {
    pub(crate) travel: [f64; 2],
    pub(crate) modulo: Option<f64>,
    /// Pieces of one table, or of three: forward, backward and mean.
    pub(crate) tables: Vec<Vec<Piece>>,
    pub(crate) patches: Vec<CompiledPatch>,
}

pub(crate) struct Frame {
    pub(crate) chain: Chain,
    pub(crate) location: PerAxis<ErrorMotion>,
    pub(crate) assembly: PerAxis<ErrorMotion>,
    pub(crate) tolerance: Tolerance,
    folded: Folded,
}

impl Frame {
    pub(crate) fn new(
        chain: Chain,
        location: &PerAxis<ErrorMotion>,
        assembly: &PerAxis<ErrorMotion>,
        tolerance: Tolerance,
    ) -> Self {
        Self {
            folded: fold(&chain, location, assembly),
            chain,
            location: *location,
            assembly: *assembly,
            tolerance,
        }
    }
}

impl CompiledMachine {
    /// Compiles a machine.
    ///
    /// # Errors
    /// [`EvaluatorError::MissingAxis`]; [`EvaluatorError::Chain`] for a range or patch over an axis that the chain
    /// lacks; [`EvaluatorError::TooLarge`], [`EvaluatorError::NotFinite`], [`EvaluatorError::Tolerance`].
    pub fn new(parts: MachineParts<'_>, tolerance: Tolerance) -> Result<Self, EvaluatorError> {
        for found in [tolerance.linear_mm, tolerance.angular_rad] {
            if !(found > 0.0 && found.is_finite()) {
                return Err(EvaluatorError::Tolerance { found });
            }
        }
        let MachineParts { chain, axes: stated, location, assembly } = parts;
        let structure = chain.structure().clone();
        let frame = Frame::new(chain, &location, &assembly, tolerance);
        let (mut axes, mut ranges) = (Vec::new(), Vec::new());
        for (index, (&axis, parts)) in structure.axes().iter().zip(stated).enumerate() {
            let parts = parts.ok_or(EvaluatorError::MissingAxis { axis })?;
            for range in &parts.ranges {
                let looked_at = structure.index_of(range.looked_at);
                ranges.push(Range {
                    axis: index,
                    component: range.component,
                    looked_at: looked_at.ok_or_else(|| no_axis(&frame.chain, range.looked_at))?,
                    domain: range.domain,
                });
            }
            let mut patches = Vec::new();
            for patch in parts.patches.iter().cloned() {
                patches.push(CompiledPatch::of(patch, &frame.chain)?);
            }
            axes.push(AxisTables {
                travel: parts.travel.map(Displacement::mm_or_deg),
                modulo: parts.modulo.map(|period| period.0),
                tables: tables(&frame, index, &parts)?,
                patches,
            });
        }
        Ok(Self::from_tables(frame, axes, ranges))
    }

    /// Builds the machine from tables that already include the constant errors.
    pub(crate) fn from_tables(frame: Frame, axes: Vec<AxisTables>, ranges: Vec<Range>) -> Self {
        let folded = frame.folded;
        let tip = frame.chain.tool_tip_mm();
        let mut tables = Tables::default();
        let compiled = |(index, (joint, axis)): (usize, (&Joint, AxisTables))| {
            let slide = &folded.slide[index];
            axis.compiled(joint, tip - joint.point_mm, slide, &mut tables)
        };
        let joints = frame.chain.joints().iter();
        let axes: Vec<CompiledAxis> = joints.zip(axes).enumerate().map(compiled).collect();
        let mut machine = Self {
            patched: false,
            three_slides: false,
            at_workpiece: folded.workpiece_end != ErrorMotion::ZERO,
            may_move: frame.chain.structure().axes().iter().copied().collect(),
            correctors: Correctors::all(&frame.chain),
            chain: frame.chain,
            location: frame.location,
            assembly: frame.assembly,
            tolerance: frame.tolerance,
            axes,
            tables,
            ranges,
            folded,
        };
        machine.choose_path();
        machine
    }
}

impl AxisTables {
    /// Compiles the axis and adds its tables to those of the machine.
    fn compiled(
        self,
        joint: &Joint,
        arm_mm: Vector3<f64>,
        slide: &Vector3<f64>,
        tables: &mut Tables,
    ) -> CompiledAxis {
        let heads: Vec<Head> = self.tables.iter().map(|pieces| tables.add(pieces)).collect();
        // The function `tables` and a blob supply one table or three.
        let (branches, heads) = match heads[..] {
            [forward, backward, mean] => (Branches::Three, [forward, backward, mean]),
            _ => (Branches::One, [heads[0]; 3]),
        };
        let all = self.tables.iter().flatten();
        CompiledAxis {
            joint: *joint,
            travel: self.travel,
            modulo: self.modulo,
            branches,
            heads,
            bounds: Bounds::of(all, &arm_mm, slide),
            patches: self.patches,
            arm_mm,
            before_motion: joint.errors_on_tool_side(),
            along: Along::of(&joint.direction),
            thermal: Thermal::default(),
        }
    }
}

/// Tables of one axis: one for all directions, or one for each branch. Errors are transformed to the tool tip at
/// machine zero. Constant errors are included.
fn tables(
    frame: &Frame,
    index: usize,
    parts: &AxisParts<'_>,
) -> Result<Vec<Vec<Piece>>, EvaluatorError> {
    let branches: &[Option<Direction>] = match parts.branches {
        Branches::One => &[None],
        // The branches must be in the order of `branch_index`.
        Branches::Three => &[Some(Direction::Positive), Some(Direction::Negative), None],
    };
    let joint = &frame.chain.joints()[index];
    let slope = frame.folded.slide[index] + Vector3::from(parts.slope_mm);
    let table = |approach: &Option<Direction>| {
        let curve_fit = CurveFit {
            errors: &|x| (parts.errors)(x, *approach),
            travel: parts.travel.map(Displacement::mm_or_deg),
            breakpoints: &parts.breakpoints,
            arm_mm: frame.chain.tool_tip_mm() - joint.point_mm,
            constant: frame.folded.constant[index],
            tolerance: frame.tolerance,
            axis: joint.name,
        };
        let mut pieces = curve_fit.fit()?;
        for piece in &mut pieces {
            piece.add_slope(&slope);
        }
        Ok(pieces)
    };
    branches.iter().map(table).collect()
}

/// Number of nodes of the Chebyshev interpolant against which a piece is checked: its degree plus 1.
const NODES: usize = 12;

#[derive(Clone, Copy, Debug, PartialEq)]
enum FitFailure {
    TooManyPieces,
    /// A coordinate at or near which the function is not finite.
    NotFinite(f64),
}

/// Fits a function of six components with piecewise cubics; the first and the last piece hold the end values.
fn fit(
    function: &dyn Fn(f64) -> [f64; LANES],
    mut points: Vec<f64>,
    tolerance: Tolerance,
) -> Result<Vec<Piece>, FitFailure> {
    points.sort_unstable_by(f64::total_cmp);
    points.dedup();
    let ends = [points.first(), points.last()].map(|end| end.copied().unwrap_or(0.0));
    for &point in &points {
        if !function(point).iter().all(|value| value.is_finite()) {
            return Err(FitFailure::NotFinite(point));
        }
    }
    let chebyshev = Chebyshev::new();
    let mut pieces = vec![Piece::held(ends[0], function(ends[0]))];
    for ends in points.windows(2) {
        let mut pending = vec![(ends[0], ends[1])];
        while let Some((from, to)) = pending.pop() {
            let middle = 0.5 * (from + to);
            let piece = Sampled::over(function, &chebyshev, from, to);
            if !piece.is_finite() {
                return Err(FitFailure::NotFinite(middle));
            }
            // An interval of one rounding unit cannot be halved further and is accepted.
            if piece.keeps(tolerance) || middle <= from || middle >= to {
                if pieces.len() + 1 >= MAX_PIECES {
                    return Err(FitFailure::TooManyPieces);
                }
                pieces.push(Piece::new(from, to, piece.powers(function)));
            } else {
                if pending.len() + pieces.len() + 1 >= MAX_PIECES {
                    return Err(FitFailure::TooManyPieces);
                }
                pending.push((middle, to));
                pending.push((from, middle));
            }
        }
    }
    pieces.push(Piece::held(ends[1], function(ends[1])));
    Ok(pieces)
}

pub(crate) struct CurveFit<'a> {
    pub(crate) errors: &'a dyn Fn(f64) -> ErrorMotion,
    /// Range of the table, mm or deg, extended by breakpoints outside of it.
    pub(crate) travel: [f64; 2],
    pub(crate) breakpoints: &'a [Vec<f64>; LANES],
    /// Vector from the point of the axis to the tool tip, mm.
    pub(crate) arm_mm: Vector3<f64>,
    pub(crate) constant: ErrorMotion,
    pub(crate) tolerance: Tolerance,
    pub(crate) axis: AxisName,
}

impl CurveFit<'_> {
    pub(crate) fn fit(&self) -> Result<Vec<Piece>, EvaluatorError> {
        self.pieces(None, self.tolerance).map_err(|failure| self.refused(failure))
    }

    /// The pieces of all components, or of the component `alone` with all others set to zero; displacements are those
    /// of the tool tip.
    fn pieces(&self, alone: Option<usize>, tolerance: Tolerance) -> Result<Vec<Piece>, FitFailure> {
        let function = |x: f64| {
            let mut error = (self.errors)(x);
            if let Some(alone) = alone {
                for k in 0..3 {
                    error.linear_mm[k] *= f64::from(u8::from(alone == k));
                    error.angular_rad[k] *= f64::from(u8::from(alone == k + 3));
                }
            }
            let carried = error.angular_rad.cross(&self.arm_mm);
            let linear = error.linear_mm + carried + self.constant.linear_mm;
            let angular = error.angular_rad + self.constant.angular_rad;
            [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
        };
        let counted = |lane: usize| alone.is_none_or(|alone| alone == lane);
        let lanes = (0..LANES).filter(|lane| counted(*lane));
        let breakpoints = lanes.flat_map(|lane| self.breakpoints[lane].iter().copied());
        let points = self.travel.into_iter().chain(breakpoints);
        fit(&function, points.collect(), tolerance)
    }

    /// The error for a failed fit. It names the first curve that cannot be compiled alone; if each of them can, it
    /// names all curves of the axis.
    fn refused(&self, failure: FitFailure) -> EvaluatorError {
        let alone = (0..LANES).find(|lane| self.pieces(Some(*lane), self.tolerance).is_err());
        let curve = match alone.and_then(|lane| Component::ALL.get(lane)) {
            Some(&component) => ErrorName::motion(component, self.axis).to_string(),
            None => format!("all of axis {}", self.axis),
        };
        if let FitFailure::NotFinite(at) = failure {
            return EvaluatorError::NotFinite { curve, at };
        }
        let tolerance_nm = self.tolerance.linear_mm * 1e6;
        let tried = (1..=9).map(|power| tolerance_nm * libm::pow(10.0, f64::from(power)));
        let fits = |nm: &f64| self.pieces(None, Tolerance::from_nm(*nm)).is_ok();
        EvaluatorError::TooLarge { curve, tolerance_nm, fitting_nm: tried.into_iter().find(fits) }
    }
}

/// Chebyshev–Lobatto points, descending from 1 to −1, and the weights that convert values at these points to the
/// coefficients of the Chebyshev series.
struct Chebyshev {
    points: [f64; NODES],
    weights: [[f64; NODES]; NODES],
}

impl Chebyshev {
    fn new() -> Self {
        let last = (NODES - 1) as f64;
        let angle = |j: usize| core::f64::consts::PI * j as f64 / last;
        let end = |i: usize| if i == 0 || i == NODES - 1 { 0.5 } else { 1.0 };
        let weight =
            |k: usize, j: usize| 2.0 / last * end(j) * end(k) * libm::cos(angle(j) * k as f64);
        Self {
            points: core::array::from_fn(|j| libm::cos(angle(j))),
            weights: core::array::from_fn(|k| core::array::from_fn(|j| weight(k, j))),
        }
    }
}

/// Six functions over one interval: their values at its ends, and their Chebyshev series.
struct Sampled {
    from: f64,
    length: f64,
    ends: [[f64; LANES]; 2],
    series: [[f64; LANES]; NODES],
}

impl Sampled {
    fn over(
        function: &dyn Fn(f64) -> [f64; LANES],
        chebyshev: &Chebyshev,
        from: f64,
        to: f64,
    ) -> Self {
        let length = to - from;
        // At the ends the function is evaluated at exactly `from` and `to`, without rounding.
        let at = |t: f64| {
            if t <= -1.0 {
                function(from)
            } else if t >= 1.0 {
                function(to)
            } else {
                function(from + 0.5 * (t + 1.0) * length)
            }
        };
        let values = chebyshev.points.map(at);
        let mut series = [[0.0; LANES]; NODES];
        for (row, weights) in series.iter_mut().zip(&chebyshev.weights) {
            for (value, weight) in values.iter().zip(weights) {
                for lane in 0..LANES {
                    row[lane] += weight * value[lane];
                }
            }
        }
        Self {
            from,
            length,
            // The points descend, so the lower end is the last one.
            ends: [values[NODES - 1], values[0]],
            series,
        }
    }

    fn is_finite(&self) -> bool {
        self.series.iter().flatten().all(|value| value.is_finite())
    }

    /// Whether the cubic is within the tolerance. The cubic through the corners differs from Σ c_k T_k by at most 2
    /// Σ_{k ≥ 4} |c_k|, because at the corners each T_k equals a T of an order below 4. The series is exact for a
    /// polynomial of an order below [`NODES`]. For other functions the remainder is estimated as ten times the last two
    /// coefficients.
    fn keeps(&self, tolerance: Tolerance) -> bool {
        (0..LANES).all(|lane| {
            let size = |k: usize| libm::fabs(self.series[k][lane]);
            let beyond: f64 = (4..NODES).map(size).sum();
            let rest = size(NODES - 1) + size(NODES - 2);
            2.0 * beyond + 10.0 * rest <= tolerance.lane(lane)
        })
    }

    /// Coefficients of powers of the distance from the start, for the cubic through the values at −1, −½, ½ and 1.
    fn powers(&self, function: &dyn Fn(f64) -> [f64; LANES]) -> [[f64; LANES]; 4] {
        let mut powers = [[0.0; LANES]; 4];
        let h = self.length;
        let inner = [-0.5, 0.5].map(|t| function(self.from + 0.5 * (t + 1.0) * h));
        let corners = [self.ends[0], inner[0], inner[1], self.ends[1]];
        for lane in 0..LANES {
            let [v0, v1, v2, v3] = corners.map(|corner| corner[lane]);
            // The cubic passes through the values at 0, ¼, ¾ and 1 of the length.
            let c1 = (-19.0 * v0 + 24.0 * v1 - 8.0 * v2 + 3.0 * v3) / 3.0;
            let c2 = (32.0 * v0 - 56.0 * v1 + 40.0 * v2 - 16.0 * v3) / 3.0;
            let c3 = (-16.0 * v0 + 32.0 * v1 - 32.0 * v2 + 16.0 * v3) / 3.0;
            powers[0][lane] = v0;
            powers[1][lane] = c1 / h;
            powers[2][lane] = c2 / (h * h);
            powers[3][lane] = c3 / (h * h * h);
        }
        powers
    }
}
