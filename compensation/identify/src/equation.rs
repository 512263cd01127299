//! Equations of rows: residuals and their derivatives with respect to every parameter.

use volcomp_kinematics::{
    ErrorMotion,
    nalgebra::{DMatrix, DVector, Matrix3, Vector3},
};

use crate::basis::legendre;
use crate::coefficients::Unknowns;
use crate::derivatives::{Errors, Tip, component_of, tip};
use crate::observations::{Part, RowReading};
use crate::params::{Params, Values};
use crate::system::{PreparedPose, PreparedRow, Rows, System};
use crate::timeline::Sides;

struct Writer<'e> {
    residuals: &'e mut DVector<f64>,
    jacobian: &'e mut DMatrix<f64>,
    sides: &'e mut Sides,
    run: Option<usize>,
    /// Assumed size of the reversal value of each coefficient, mm or rad; `None` for the ideal machine, where all are 1.
    reversals: Option<&'e [f64]>,
    params: &'e Params,
    unknowns: &'e Unknowns,
    /// Location errors that depend on unknowns: axis, component, coefficient of the unknown, and change per unit of the
    /// coefficient.
    following: &'e [(usize, usize, usize, f64)],
    first: usize,
    /// Reciprocal of the uncertainty, 1/mm.
    weight: f64,
    polynomials: &'e [f64],
}

impl Writer<'_> {
    fn coefficients(&mut self, pose: &PreparedPose, tip: &Tip, directions: &[Vector3<f64>]) {
        self.sides(pose, tip, directions);
        if self.jacobian.ncols() <= self.params.setup() {
            return;
        }
        for &(axis, component, coefficient, value) in &pose.terms {
            let moved = tip.by_motion[axis][component] * value;
            self.add(self.params.setup() + coefficient, &moved, directions);
        }
        for &(axis, component, coefficient) in &self.unknowns.locations {
            let moved = tip.by_location[axis][component];
            self.add(self.params.setup() + coefficient, &moved, directions);
        }
        for &(axis, component, coefficient, rate) in self.following {
            let moved = tip.by_location[axis][component] * rate;
            self.add(self.params.setup() + coefficient, &moved, directions);
        }
    }

    /// Adds the effect of an approach in the positive direction for axes whose approach direction is unknown.
    fn sides(&mut self, pose: &PreparedPose, tip: &Tip, directions: &[Vector3<f64>]) {
        let Some(run) = self.run else { return };
        for side in &pose.sides {
            let by_motion = &tip.by_motion[side.axis];
            let known = (side.known != ErrorMotion::ZERO).then(|| {
                let mut moved = Vector3::zeros();
                for k in 0..3 {
                    moved += by_motion[k] * side.known.linear_mm[k];
                    moved += by_motion[k + 3] * side.known.angular_rad[k];
                }
                (None, moved)
            });
            let unknown = side.unknown.iter().map(|&(component, coefficient)| {
                let half = 0.5 * self.reversals.map_or(1.0, |sizes| sizes[coefficient]);
                (Some(coefficient), by_motion[component] * half)
            });
            for (of, moved) in known.into_iter().chain(unknown) {
                for (k, direction) in directions.iter().enumerate() {
                    let by = direction.dot(&moved) * self.weight;
                    self.sides.add((run, side.axis, of), self.first + k, by);
                }
            }
        }
    }

    /// Adds the derivatives with respect to the components of a frame or point. `moved` receives the component and the
    /// order of its drift.
    fn part(
        &mut self,
        part: Part,
        directions: &[Vector3<f64>],
        moved: impl Fn(usize, usize) -> Vector3<f64>,
    ) {
        if self.jacobian.ncols() == 0 {
            return;
        }
        for at in self.params.of(part) {
            let moved = moved(at.place, at.order) * self.polynomials[at.order];
            self.add(at.param, &moved, directions);
        }
    }

    /// Adds the derivatives with respect to a number of the set-up; `by` is the change of the residual per unit.
    fn number(&mut self, number: usize, by: f64) {
        if self.jacobian.ncols() == 0 {
            return;
        }
        for at in self.params.of(Part::Number(number)) {
            self.jacobian[(self.first, at.param)] += by * self.polynomials[at.order] * self.weight;
        }
    }

    fn add(&mut self, column: usize, moved: &Vector3<f64>, directions: &[Vector3<f64>]) {
        for (k, direction) in directions.iter().enumerate() {
            self.jacobian[(self.first + k, column)] += direction.dot(moved) * self.weight;
        }
    }

    fn offsets(
        &mut self,
        axes: &Matrix3<f64>,
        read_mm: &[Option<f64>; 3],
        offset_mm: &Vector3<f64>,
    ) -> Vec<Vector3<f64>> {
        let mut directions = Vec::with_capacity(3);
        for (place, read) in read_mm.iter().enumerate() {
            if let Some(read) = read {
                let direction: Vector3<f64> = axes.column(place).into();
                self.residual(directions.len(), direction.dot(offset_mm) - read);
                directions.push(direction);
            }
        }
        directions
    }

    fn residual(&mut self, k: usize, value_mm: f64) {
        self.residuals[self.first + k] = value_mm * self.weight;
    }
}

impl System {
    /// Residuals and their derivatives, with unknown approach directions eliminated so that the equations are independent.
    pub(crate) fn equations(&self, rows: &Rows, values: &Values) -> Equations {
        self.plain_equations(rows, values, false).without_sides()
    }

    /// Residuals and their derivatives; unknown approach directions are not eliminated. With `design`, the derivatives
    /// are those of the ideal machine with readings that fit it exactly. They determine which unknowns are
    /// distinguishable. Rows before the first move of an axis are treated as the mean of both directions.
    pub(crate) fn plain_equations(&self, rows: &Rows, values: &Values, design: bool) -> Equations {
        self.equations_in(self.params.len(), rows, values, design)
    }

    /// Like [`System::plain_equations`], with the derivatives with respect to the first `columns` parameters only: all
    /// parameters, those of the set-ups, or none.
    pub(crate) fn equations_in(
        &self,
        columns: usize,
        rows: &Rows,
        values: &Values,
        design: bool,
    ) -> Equations {
        let mut places = Vec::with_capacity(rows.len());
        let mut count = 0;
        for row in rows.iter() {
            let of_row = row.reading.count();
            places.push((count, of_row));
            count += of_row;
        }
        let calibrated = self.calibrated(values);
        let total = count + calibrated.len();
        let mut equations = Equations {
            residuals: DVector::zeros(total),
            jacobian: DMatrix::zeros(total, columns),
            places,
            sides: Sides::default(),
        };
        for (place, row) in rows.0.iter().enumerate() {
            self.write_row(row, values, design, place, &mut equations);
        }
        // A calibrated value is one more observation of its number.
        for (row, (column, residual, uncertainty)) in calibrated.into_iter().enumerate() {
            equations.residuals[count + row] = residual / uncertainty;
            if columns == 0 {
                continue;
            }
            // For distinguishability the value is treated as exact: with its uncertainty, no unknown remains
            // undetermined.
            let least = if design { equations.jacobian.column(column).norm() } else { 0.0 };
            equations.jacobian[(count + row, column)] = least.max(1.0 / uncertainty);
        }
        equations
    }

    /// Quantities that are identified although their value is also known from a calibration or a ruler: column,
    /// difference from the stated value, and uncertainty of the stated value.
    fn calibrated(&self, values: &Values) -> Vec<(usize, f64, f64)> {
        let mut found = Vec::new();
        for (number, quantity) in self.setup.numbers.iter().enumerate() {
            if let (Some(stated), Some(within)) = (quantity.value, quantity.known_within) {
                let columns = self.params.of(Part::Number(number)).iter();
                let more = values.numbers[number][0] - stated;
                found.extend(columns.map(|column| (column, more, within)));
            }
        }
        for (point, quantity) in self.setup.points.iter().enumerate() {
            if let (Some(stated), Some(within)) = (quantity.value, quantity.known_within) {
                let columns = self.params.of(Part::Point(point)).iter();
                let now = values.points[point][0];
                found.extend(
                    columns
                        .map(|column| (column, now[column.place] - stated[column.place], within)),
                );
            }
        }
        let does_not_drift = found.into_iter().filter(|(column, ..)| column.order == 0);
        does_not_drift
            .filter(|(.., within)| *within > 0.0)
            .map(|(column, more, within)| (column.param, more, within))
            .collect()
    }

    /// Residuals of every row, mm: three components, or one or two padded with zeros. A row before the first move of an
    /// axis is evaluated with the approach direction that fits it best, or with a fraction of it.
    pub(crate) fn residuals(&self, rows: &Rows, values: &Values) -> Vec<Vector3<f64>> {
        const ROUNDS: usize = 5;
        /// Margin of an approach direction beyond ±1, in uncertainties of a reading: the reversal
        /// value itself is uncertain if a row hardly depends on it.
        const WITHIN: f64 = 8.0;
        let mut equations = self.equations_in(0, rows, values, false);
        if equations.sides.len() > 0 {
            let mut sides = DVector::zeros(equations.sides.len());
            let columns = equations.sides.columns(equations.residuals.len(), false);
            for _ in 0..ROUNDS {
                let mut left = equations.residuals.clone();
                equations.sides.add_to(&mut left, &sides);
                let roots = left.map(|residual| weight(residual).sqrt());
                let mut weighted = equations.sides.clone();
                weighted.scale(|equation| roots[equation]);
                // An axis approaches from one of two sides, so the estimate is limited and cannot absorb an outlier.
                sides = weighted.estimate(&equations.residuals.component_mul(&roots));
                for (side, column) in sides.iter_mut().zip(columns.column_iter()) {
                    let most = 1.0 + WITHIN / column.amax().max(f64::MIN_POSITIVE);
                    *side = side.clamp(-most, most);
                }
            }
            equations.sides.add_to(&mut equations.residuals, &sides);
        }
        in_mm(rows, &equations)
    }

    /// Residuals of rows without any error of the machine, before the size of errors is known: rows before an axis
    /// first moved are treated as the mean of both directions.
    pub(crate) fn plain_residuals(&self, rows: &Rows, values: &Values) -> Vec<Vector3<f64>> {
        in_mm(rows, &self.equations_in(0, rows, values, false))
    }

    /// Actual tip in workpiece axes and its derivatives by the errors; with `design`, tip and derivatives of the ideal
    /// machine.
    fn tip_at(
        &self,
        pose: &PreparedPose,
        values: &Values,
        offset: &Vector3<f64>,
        design: bool,
    ) -> Tip {
        let mut errors = Errors::default();
        if !design {
            errors = pose.known;
            for &(axis, component, coefficient, value) in &pose.terms {
                *component_of(&mut errors.motion[axis], component) +=
                    value * values.coefficients[coefficient];
            }
            for &(axis, component, coefficient) in &self.unknowns.locations {
                *component_of(&mut errors.location[axis], component) =
                    values.coefficients[coefficient];
            }
            for &(axis, component, coefficient, rate) in &self.following_locations {
                *component_of(&mut errors.location[axis], component) +=
                    rate * values.coefficients[coefficient];
            }
        }
        let chain = self.machine.chain();
        let at_mm = pose.pose.tip_mm + offset;
        let mut tip = tip(chain, &errors, &pose.pose.state, &at_mm);
        tip.position_mm -= chain.workpiece_origin_mm();
        tip
    }

    /// Displacement of the ideal machine's tip at a pose, mm, per unit of each coefficient: index of the coefficient, and displacement.
    pub(crate) fn moved_by(
        &self,
        pose: &PreparedPose,
        values: &Values,
    ) -> Vec<(usize, Vector3<f64>)> {
        let tip = self.tip_at(pose, values, &Vector3::zeros(), true);
        let mut moved = vec![Vector3::zeros(); self.unknowns.coefficients.len()];
        for &(axis, component, coefficient, value) in &pose.terms {
            moved[coefficient] += tip.by_motion[axis][component] * value;
        }
        for &(axis, component, coefficient) in &self.unknowns.locations {
            moved[coefficient] += tip.by_location[axis][component];
        }
        for &(axis, component, coefficient, rate) in &self.following_locations {
            moved[coefficient] += tip.by_location[axis][component] * rate;
        }
        moved.into_iter().enumerate().collect()
    }

    /// Writes the equations of one row; see [`System::plain_equations`].
    fn write_row(
        &self,
        row: &PreparedRow,
        values: &Values,
        design: bool,
        place: usize,
        equations: &mut Equations,
    ) {
        let polynomials = &legendre(row.row.time, self.params.highest_order());
        let mut out = Writer {
            residuals: &mut equations.residuals,
            jacobian: &mut equations.jacobian,
            sides: &mut equations.sides,
            run: row.row.run,
            reversals: (!design).then_some(&values.reversals[..]),
            params: &self.params,
            unknowns: &self.unknowns,
            following: &self.following_locations,
            first: equations.places[place].0,
            weight: 1.0 / row.row.uncertainty_mm,
            polynomials,
        };
        let axes = [Vector3::ith(0, 1.0), Vector3::ith(1, 1.0), Vector3::ith(2, 1.0)];
        let target = match &row.row.reading {
            RowReading::Point { target, .. } => *target,
            _ => None,
        };
        let offset =
            target.map_or_else(Vector3::zeros, |target| values.point_at(target, polynomials));
        let tip = self.tip_at(&row.pose, values, &offset, design);
        match &row.row.reading {
            RowReading::Point { frame, at_mm, .. } => {
                let of = &values.frames[*frame];
                let undrifted = of.pose.transform_point(at_mm);
                // The drift displaces and rotates the observed points; the ideal machine is observed without drift.
                let [shift, turn] =
                    if design { [Vector3::zeros(); 2] } else { of.drifted(polynomials) };
                let seen = if design {
                    tip.position_mm
                } else {
                    undrifted + shift + turn.cross(&(undrifted - of.middle_mm))
                };
                let lever = if design { seen } else { undrifted } - of.middle_mm;
                for k in 0..3 {
                    out.residual(k, tip.position_mm[k] - seen[k]);
                }
                out.coefficients(&row.pose, &tip, &axes);
                out.part(Part::Frame(*frame), &axes, |place, order| {
                    let moved = frame_motion(place, &lever);
                    match order {
                        0 => -moved - turn.cross(&moved),
                        _ => -moved,
                    }
                });
                if let Some(target) = target {
                    let rotation = &tip.rotation;
                    out.part(Part::Point(target), &axes, |place, _| rotation.column(place).into());
                }
            }
            RowReading::Sphere { centre, offset_mm } => {
                let residual = tip.position_mm - values.point_at(*centre, polynomials) - offset_mm;
                for k in 0..3 {
                    out.residual(k, residual[k]);
                }
                out.coefficients(&row.pose, &tip, &axes);
                out.part(Part::Point(*centre), &axes, |place, _| -Vector3::ith(place, 1.0));
            }
            RowReading::Distance { point, dead, length_mm } => {
                let reach = tip.position_mm - values.point_at(*point, polynomials);
                let along = [reach.try_normalize(1e-9).unwrap_or_else(Vector3::z)];
                out.residual(0, reach.norm() - values.number_at(*dead, polynomials) - length_mm);
                out.coefficients(&row.pose, &tip, &along);
                out.part(Part::Point(*point), &along, |place, _| -Vector3::ith(place, 1.0));
                out.number(*dead, -1.0);
            }
            RowReading::Pair { dead, length_mm, .. } => {
                let Some(from) = &row.from else { return };
                let other = self.tip_at(from, values, &Vector3::zeros(), design);
                let reach = tip.position_mm - other.position_mm;
                let along = reach.try_normalize(1e-9).unwrap_or_else(Vector3::z);
                out.residual(0, reach.norm() - values.number_at(*dead, polynomials) - length_mm);
                out.coefficients(&row.pose, &tip, &[along]);
                out.coefficients(from, &other, &[-along]);
                out.number(*dead, -1.0);
            }
            RowReading::Line { direction, offset, slope, deviation_mm } => {
                let place = direction.dot(&row.ideal_mm);
                let displacement = direction.dot(&(tip.position_mm - row.ideal_mm));
                let line = values.number_at(*offset, polynomials)
                    + values.number_at(*slope, polynomials) * place;
                // Every reading contains the offset and the slope of the set-up.
                out.residual(0, displacement + line - deviation_mm);
                out.coefficients(&row.pose, &tip, &[*direction]);
                out.number(*offset, 1.0);
                out.number(*slope, place);
            }
            RowReading::Ball { origin, tilts, distance, axes, offset_mm } => {
                let bar = bar(axes, tilts.map(|tilt| values.number_at(tilt, polynomials)));
                let distance_mm = values.number_at(*distance, polynomials);
                let ball = values.point_at(*origin, polynomials) + bar.along * distance_mm;
                let read = out.offsets(axes, offset_mm, &(tip.position_mm - ball));
                out.coefficients(&row.pose, &tip, &read);
                out.part(Part::Point(*origin), &read, |place, _| -Vector3::ith(place, 1.0));
                out.part(Part::Number(*distance), &read, |_, _| -bar.along);
                for (tilt, by_tilt) in tilts.iter().zip(bar.by_tilt) {
                    out.part(Part::Number(*tilt), &read, |_, _| -by_tilt * distance_mm);
                }
            }
        }
    }
}

/// Unit direction of a ball row and its derivatives with respect to its two tilts.
pub(crate) struct Bar {
    pub(crate) along: Vector3<f64>,
    by_tilt: [Vector3<f64>; 2],
}

/// Direction of a row with the nominal directions `axes` (columns), tilted by `side1` and `side2` (mm/mm) to its sides.
pub(crate) fn bar(axes: &Matrix3<f64>, [side1, side2]: [f64; 2]) -> Bar {
    let laid = axes * Vector3::new(1.0, side1, side2);
    let along = laid.normalize();
    let by_tilt = [1, 2].map(|side| {
        let side: Vector3<f64> = axes.column(side).into();
        (side - along * along.dot(&side)) / laid.norm()
    });
    Bar { along, by_tilt }
}

/// Velocity of a point at the lever arm `lever_mm` for a unit displacement (`place` 0 to 2) or a unit rotation (3 to 5)
/// of its frame.
fn frame_motion(place: usize, lever_mm: &Vector3<f64>) -> Vector3<f64> {
    if place < 3 { Vector3::ith(place, 1.0) } else { Vector3::ith(place - 3, 1.0).cross(lever_mm) }
}

/// Residuals (one to three for each row) and their derivatives, both divided by the uncertainty.
pub(crate) struct Equations {
    pub(crate) residuals: DVector<f64>,
    pub(crate) jacobian: DMatrix<f64>,
    /// Index of the first equation of each row, and number of its equations.
    pub(crate) places: Vec<(usize, usize)>,
    pub(crate) sides: Sides,
}

impl Equations {
    fn without_sides(mut self) -> Self {
        if self.sides.len() > 0 {
            self.sides.eliminate(&mut self.jacobian);
            self.sides.eliminate_from(&mut self.residuals);
        }
        self
    }
}

pub(crate) fn in_mm(rows: &Rows, equations: &Equations) -> Vec<Vector3<f64>> {
    let places = equations.places.iter().zip(rows.iter());
    places
        .map(|(&(first, count), row)| {
            let mut residual = Vector3::zeros();
            for k in 0..count {
                residual[k] = equations.residuals[first + k] * row.uncertainty_mm;
            }
            residual
        })
        .collect()
}

/// Residuals above this multiple of the uncertainty get less weight (Huber, Annals of Mathematical Statistics 35, 1964: 95 % efficiency).
pub(crate) const HUBER: f64 = 1.345;

pub(crate) fn weight(residual: f64) -> f64 {
    let size = residual.abs();
    if size > HUBER { HUBER / size } else { 1.0 }
}
