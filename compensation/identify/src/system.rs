//! The equations of some rows: parameters, residuals and their derivatives.

use volcomp_kinematics::nalgebra::{DMatrix, DVector, Vector3};
use volcomp_model::Machine;

use crate::{
    checked::check,
    coefficients::{Coefficient, Role, Unknowns, micro},
    error::IdentifyError,
    followers::Following,
    observations::{Observations, SetUp},
    params::{self, Param, Params, Part},
    prepared::Rows,
    sides::Sides,
    solve::weight,
    values::Values,
};

/// Drifts of frames in six components, of points in three, of numbers.
const DRIFT_GROUPS: usize = 10;

/// What is to be found, and the machine of which it is found.
#[derive(Clone, Debug)]
pub(crate) struct System {
    pub(crate) machine: Machine,
    pub(crate) params: Params,
    pub(crate) unknowns: Unknowns,
    /// How many groups of parameters have a penalty each.
    pub(crate) groups: usize,
    pub(crate) setup: SetUp,
    /// Errors that follow unknowns.
    pub(crate) followers: Vec<Following>,
    /// Axis, component, coefficient of every location error that follows an unknown, and what one unit of it makes.
    pub(crate) following_locations: Vec<(usize, usize, usize, f64)>,
}

/// Residuals (one to three for each row) and their derivatives, both divided by the uncertainty.
pub(crate) struct Equations {
    /// Residuals in units of their uncertainty.
    pub(crate) residuals: DVector<f64>,
    /// Their derivatives by every parameter.
    pub(crate) jacobian: DMatrix<f64>,
    /// For each row its first equation and how many it has.
    pub(crate) places: Vec<(usize, usize)>,
    /// How they are moved by sides from which axes came, which are not known.
    pub(crate) sides: Sides,
}

impl Equations {
    /// The same where the sides are eliminated: numbers that are independent again.
    fn without_sides(mut self) -> Self {
        if self.sides.len() > 0 {
            self.sides.eliminate(&mut self.jacobian);
            self.sides.eliminate_from(&mut self.residuals);
        }
        self
    }
}

impl System {
    /// Whether the coefficient of a column is a convention where it is left at zero: a constant that a curve brings, the slope of
    /// a straightness. `None` for a column of a set-up.
    pub(crate) fn is_convention(&self, column: usize) -> Option<bool> {
        match self.params.at(column) {
            Param::Coefficient(place) => Some(self.unknowns.is_convention(place)),
            Param::SetUp { .. } => None,
        }
    }

    /// Whether a column is that of a reversal value.
    pub(crate) fn is_reversal(&self, column: usize) -> bool {
        matches!(self.params.at(column), Param::Coefficient(place)
            if self.unknowns.coefficients[place].role == Role::Reversal)
    }

    /// The equations of some observations.
    pub(crate) fn new(observations: &Observations) -> Result<Self, IdentifyError> {
        check(observations)?;
        let mut machine = observations.machine.clone();
        let unknowns = Unknowns::new(observations, &mut machine)?;
        // Where curves have penalties, a set-up drifts as much as the observations say, too.
        let drifts = if unknowns.groups > 0 { DRIFT_GROUPS } else { 0 };
        Ok(Self {
            machine,
            params: Params::new(&observations.setup, unknowns.coefficients.len()),
            groups: unknowns.groups + drifts,
            unknowns,
            setup: observations.setup.clone(),
            followers: Vec::new(),
            following_locations: Vec::new(),
        })
    }

    /// The values at the start: what the files state.
    pub(crate) fn start(&self) -> Values {
        let stated = |c: &Coefficient| match c.role {
            Role::Location => {
                let value = self.machine.locations().get(&c.error);
                value.map_or(0.0, |value| value / micro(c.error.component))
            }
            _ => 0.0,
        };
        let coefficients = self.unknowns.coefficients.iter().map(stated);
        Values::stated(&self.setup, coefficients.collect())
    }

    /// The residuals and their derivatives, without the sides that are not known: numbers that are independent.
    pub(crate) fn equations(&self, rows: &Rows, values: &Values) -> Equations {
        self.plain_equations(rows, values, false).without_sides()
    }

    /// The residuals and their derivatives. `design`: the derivatives of the ideal machine with readings that fit it
    /// exactly, from which it is judged what can be told apart. Rows before an axis first moved are as if they had the mean of
    /// both directions.
    pub(crate) fn plain_equations(&self, rows: &Rows, values: &Values, design: bool) -> Equations {
        let mut places = Vec::with_capacity(rows.len());
        let mut count = 0;
        for row in rows.iter() {
            let of_row = row.seen.count();
            places.push((count, of_row));
            count += of_row;
        }
        let calibrated = self.calibrated(values);
        let total = count + calibrated.len();
        let mut equations = Equations {
            residuals: DVector::zeros(total),
            jacobian: DMatrix::zeros(total, self.params.len()),
            places,
            sides: Sides::default(),
        };
        for (place, row) in rows.0.iter().enumerate() {
            self.write_row(row, values, design, place, &mut equations);
        }
        // What a calibration says of a number is one more observation of it.
        for (row, (column, residual, uncertainty)) in calibrated.into_iter().enumerate() {
            equations.residuals[count + row] = residual / uncertainty;
            // Whether something can be told apart is judged as if it were exact: however wide, it leaves nothing open.
            let least = if design {
                equations.jacobian.column(column).norm()
            } else {
                0.0
            };
            equations.jacobian[(count + row, column)] = least.max(1.0 / uncertainty);
        }
        equations
    }

    /// The numbers that are found beside what a calibration or a ruler says of them: column, how much more they are than that, and
    /// its uncertainty.
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

    /// The residuals alone of every row, mm: three numbers, or one and two zeros. Rows before an axis first moved have the
    /// side that they fit best, or less of it.
    pub(crate) fn residuals(&self, rows: &Rows, values: &Values) -> Vec<Vector3<f64>> {
        /// So often the rows that do not fit are counted less.
        const ROUNDS: usize = 5;
        /// What was found is uncertain, too, where a row tells nothing of it: by so many uncertainties of a reading at the most.
        const WITHIN: f64 = 8.0;
        let mut equations = self.plain_equations(rows, values, false);
        if equations.sides.len() > 0 {
            let mut sides = DVector::zeros(equations.sides.len());
            let columns = equations.sides.columns(equations.residuals.len(), false);
            for _ in 0..ROUNDS {
                let mut left = equations.residuals.clone();
                equations.sides.add_to(&mut left, &sides);
                let roots = left.map(|residual| weight(residual).sqrt());
                let mut weighted = equations.sides.clone();
                weighted.scale(|equation| roots[equation]);
                // An axis came from one side or from the other: a slip is no side.
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

    /// The same of rows as they are without any error, before it is known how large errors are: rows before an axis first
    /// moved as if they had the mean of both directions.
    pub(crate) fn plain_residuals(&self, rows: &Rows, values: &Values) -> Vec<Vector3<f64>> {
        in_mm(rows, &self.plain_equations(rows, values, false))
    }

    /// The group and the weight of a parameter in the penalty.
    pub(crate) fn group(&self, param: usize) -> Option<(usize, f64)> {
        match self.params.at(param) {
            Param::Coefficient(coefficient) => self.unknowns.coefficients[coefficient].group,
            Param::SetUp { order: 0, .. } => None,
            Param::SetUp { part, place, order } => {
                let first = match part {
                    Part::Frame(_) => 0,
                    Part::Point(_) => 6,
                    Part::Number(_) => 9,
                };
                let weight = (order as f64).powi(2);
                let is_penalised = self.groups > self.unknowns.groups;
                is_penalised.then_some((self.unknowns.groups + first + place, weight))
            }
        }
    }

    /// The name of a parameter in answers.
    pub(crate) fn name(&self, param: usize) -> String {
        match self.params.at(param) {
            Param::Coefficient(coefficient) => self.unknowns.coefficients[coefficient].name.clone(),
            Param::SetUp { part, place, order } => params::name_of(&self.setup, part, place, order),
        }
    }

    /// The unit of a parameter in answers, and its number for one mm or rad inside.
    pub(crate) fn unit_of(&self, param: usize) -> (&'static str, f64) {
        match self.params.at(param) {
            Param::Coefficient(coefficient) => {
                let component = self.unknowns.coefficients[coefficient].error.component;
                (component.unit(), micro(component))
            }
            Param::SetUp { part, place, order } => params::unit_of(&self.setup, part, place, order),
        }
    }
}

/// Residuals of every row, mm.
fn in_mm(rows: &Rows, equations: &Equations) -> Vec<Vector3<f64>> {
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
