//! Unknown errors of a machine as coefficients of curves and of products of the modes of two axes.

use volcomp_curve::{Curve, CurveError, ErrorCurve, Field, Grid};
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisName, Component, ErrorName};

use crate::{
    basis::Modes,
    error::IdentifyError,
    observations::{Observations, SecondAxis},
};

/// Offset of the rank of products. All modes of single-axis curves have lower ranks, so they are kept first.
const PRODUCTS_FROM: usize = 1000;

/// Coefficient of an error: mm or rad internally, µm or µrad in results.
#[derive(Clone, Debug)]
pub(crate) struct Coefficient {
    pub(crate) name: String,
    pub(crate) error: ErrorName,
    pub(crate) curve: usize,
    pub(crate) role: Role,
    /// Index of the penalty group, and weight within the group; `None` if the coefficient is not penalised.
    pub(crate) group: Option<(usize, f64)>,
    /// Rank among indistinguishable coefficients: the coefficients with the lowest ranks are kept.
    rank: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    Location,
    Mode(usize),
    /// A mode of the error's own axis times a mode of the second axis: index in [`Products::pairs`].
    Product(usize),
    Reversal,
}

#[derive(Clone, Debug)]
pub(crate) struct UnknownCurve {
    pub(crate) error: ErrorName,
    pub(crate) axis: usize,
    pub(crate) modes: Option<Modes>,
    pub(crate) products: Option<Products>,
}

#[derive(Clone, Debug)]
pub(crate) struct Unknowns {
    pub(crate) curves: Vec<UnknownCurve>,
    /// Unknown coefficients by rising rank: location errors, constants, modes by rising order, then products by rising
    /// order. If some of them cannot be distinguished, the earlier ones are kept.
    pub(crate) coefficients: Vec<Coefficient>,
    pub(crate) locations: Vec<(usize, usize, usize)>,
    pub(crate) groups: usize,
}

impl Unknowns {
    /// Collects the unknowns of the observations and sets their curves in `machine` to zero.
    pub(crate) fn new(
        observations: &Observations,
        machine: &mut Machine,
    ) -> Result<Self, IdentifyError> {
        let mut curves: Vec<UnknownCurve> = Vec::new();
        let mut coefficients: Vec<Coefficient> = Vec::new();
        let mut groups = 0;
        for (place, item) in observations.unknown.iter().enumerate() {
            let error = item.error;
            let axis = machine.index_of(error.axis)?;
            let add = |name: String, role, rank, group| Coefficient {
                name,
                error,
                curve: place,
                role,
                group,
                rank,
            };
            let not_built = |source| IdentifyError::Curve { error, source };
            let modes = match item.basis {
                Some(basis) if !error.location => {
                    let range = observations.range_of(axis, basis);
                    Some(Modes::new(basis, range).map_err(not_built)?)
                }
                _ => None,
            };
            if error.location {
                coefficients.push(add(error.to_string(), Role::Location, 0, None));
            }
            if let Some(modes) = &modes {
                let group = groups;
                let is_penalised = item.penalised && modes.len() > 1;
                groups += usize::from(is_penalised);
                for (mode, &weight) in modes.weights().iter().enumerate() {
                    let name = format!("{error} {}", modes.label(mode));
                    let group = (is_penalised && weight > 0.0).then_some((group, weight));
                    let rank = 1 + 2 * modes.order(mode);
                    coefficients.push(add(name, Role::Mode(mode), rank, group));
                }
                // The identified curve will replace this curve; a reversal value that is not an unknown is kept.
                let reversal = match machine.error(error) {
                    Some(ErrorCurve::Reversal { reversal, .. }) if !item.reversal => *reversal,
                    _ => 0.0,
                };
                machine.set_error(error, constant(0.0, reversal))?;
            }
            if item.reversal {
                coefficients.push(add(format!("{error} reversal"), Role::Reversal, 2, None));
                if modes.is_none() {
                    machine.set_error(error, without_reversal(machine.error(error)))?;
                }
            }
            let products = match (&modes, item.second) {
                (Some(own), Some(second)) => {
                    let other = machine.index_of(second.axis)?;
                    let range = observations.range_of(other, second.basis);
                    Some(Products::new(own, other, second, range).map_err(not_built)?)
                }
                _ => None,
            };
            if let (Some(own), Some(products)) = (&modes, &products) {
                let group = groups;
                groups += usize::from(item.penalised);
                for place in 0..products.pairs().len() {
                    let name = format!("{error} {}", products.label(own, place));
                    let group = item.penalised.then_some((group, products.weight(own, place)));
                    // The offset gives single-axis curves priority over products.
                    let rank = PRODUCTS_FROM + products.order(own, place);
                    coefficients.push(add(name, Role::Product(place), rank, group));
                }
            }
            curves.push(UnknownCurve { error, axis, modes, products });
        }
        coefficients.sort_by_key(|coefficient| coefficient.rank);
        let mut locations = Vec::new();
        for (place, coefficient) in coefficients.iter().enumerate() {
            if coefficient.role == Role::Location {
                let axis = curves[coefficient.curve].axis;
                locations.push((axis, coefficient.error.component.index(), place));
            }
        }
        Ok(Self { curves, coefficients, locations, groups })
    }
}

impl Unknowns {
    /// Whether a coefficient is fixed at zero by convention if the observations do not determine it: the constant of a
    /// curve, or the slope of the straightness of a linear axis.
    pub(crate) fn is_convention(&self, place: usize) -> bool {
        let coefficient = &self.coefficients[place];
        let error = coefficient.error;
        let is_straightness = !error.axis.is_rotary()
            && !error.component.is_angular()
            && error.component.mcs_index() != error.axis.mcs_index();
        match coefficient.role {
            Role::Mode(0) => true,
            Role::Mode(1) => is_straightness,
            _ => false,
        }
    }
}

/// Factor from mm to µm or from rad to µrad.
pub(crate) fn micro(component: Component) -> f64 {
    if component.is_angular() { 1e6 } else { 1e3 }
}

fn constant(value: f64, reversal: f64) -> ErrorCurve {
    let mean = Field::Curve(Curve::Constant(value));
    if reversal == 0.0 { ErrorCurve::Single(mean) } else { ErrorCurve::Reversal { mean, reversal } }
}

/// A curve without its reversal value. A pair of curves for the two directions is returned unchanged; a missing curve
/// becomes zero.
fn without_reversal(curve: Option<&ErrorCurve>) -> ErrorCurve {
    match curve {
        Some(ErrorCurve::Single(field) | ErrorCurve::Reversal { mean: field, .. }) => {
            ErrorCurve::Single(field.clone())
        }
        Some(pair) => pair.clone(),
        None => constant(0.0, 0.0),
    }
}

const MIN_PARTS: usize = 8;
const MAX_PARTS: usize = 128;
/// Maximum interpolation error of the grid midway between its nodes, µm or µrad.
const MISSES: f64 = 0.01;

/// Products of one error: c_k φ_i(q) ψ_j(p). ψ_j is a mode of the second axis, but not its constant.
#[derive(Clone, Debug)]
pub(crate) struct Products {
    axis: usize,
    name: AxisName,
    modes: Modes,
    /// Index of the mode of the error's own axis and of the mode of the second axis, for each product.
    pairs: Vec<(usize, usize)>,
}

impl Products {
    /// The products of each mode of the error's own curve, up to the order of the second axis's curve, with each mode
    /// of the second axis. `axis` is the index of the second axis and `range` its range, mm or deg. Fails if no spline
    /// can be built over this range.
    pub(crate) fn new(
        own: &Modes,
        axis: usize,
        second: SecondAxis,
        range: [f64; 2],
    ) -> Result<Self, CurveError> {
        let modes = Modes::new(second.basis, range)?;
        let highest = second.basis.highest_order();
        let mut pairs = Vec::new();
        for mode in (0..own.len()).filter(|&mode| own.order(mode) <= highest) {
            pairs.extend((1..modes.len()).map(|other| (mode, other)));
        }
        Ok(Self { axis, name: second.axis, modes, pairs })
    }

    pub(crate) fn axis(&self) -> usize {
        self.axis
    }

    pub(crate) fn pairs(&self) -> &[(usize, usize)] {
        &self.pairs
    }

    /// Sum of the orders of both modes of a product.
    pub(crate) fn order(&self, own: &Modes, place: usize) -> usize {
        let (first, second) = self.pairs[place];
        own.order(first) + self.modes.order(second)
    }

    pub(crate) fn label(&self, own: &Modes, place: usize) -> String {
        let (first, second) = self.pairs[place];
        let of_second = self.modes.label(second);
        format!("{} × {} {of_second}", own.label(first), self.name)
    }

    /// Penalty weight of a product. The weight of a single-axis mode is its order cubed, so this is the Euclidean norm of both orders, cubed.
    pub(crate) fn weight(&self, own: &Modes, place: usize) -> f64 {
        let (first, second) = self.pairs[place];
        let squared = |weight: f64| weight.powf(2.0 / 3.0);
        let sum = squared(own.weights()[first]) + squared(self.modes.weights()[second]);
        sum.powf(1.5)
    }

    /// Values of all products at a coordinate of the second axis, mm or deg; `own` are the values of the error's own modes.
    pub(crate) fn values(&self, own: &[f64], at: f64) -> Vec<f64> {
        self.of_modes(own, &self.modes.values(at)).collect()
    }

    fn of_modes(&self, own: &[f64], second: &[f64]) -> impl Iterator<Item = f64> {
        self.pairs.iter().map(|&(i, j)| own[i] * second[j])
    }

    /// Grid of the error with the coefficients of the error's own modes and of the products, µm or µrad. The grid is
    /// refined until its interpolation error half-way between nodes is within [`MISSES`], or it has [`MAX_PARTS`] parts
    /// along an axis. `own_axis` is the index of the error's axis; `go_round` states whether that axis and the second
    /// axis have a modulo.
    pub(crate) fn grid(
        &self,
        own: &Modes,
        own_axis: usize,
        [modes, products]: [&[f64]; 2],
        go_round: [bool; 2],
    ) -> Result<Grid, CurveError> {
        let value = |first: &[f64], second: &[f64]| -> f64 {
            let along = first.iter().zip(modes).map(|(v, c)| v * c);
            let both = self.of_modes(first, second).zip(products);
            along.sum::<f64>() + both.map(|(v, c)| v * c).sum::<f64>()
        };
        let both = [own, &self.modes];
        let nodes = [0, 1].map(|along| {
            let other = 1 - along;
            let across: Vec<Vec<f64>> = nodes(both[other], 2 * MIN_PARTS)
                .iter()
                .map(|&at| both[other].values(at))
                .collect();
            let is_fine = |nodes: &[f64]| {
                nodes.windows(2).all(|pair| {
                    let places = [pair[0], f64::midpoint(pair[0], pair[1]), pair[1]];
                    let [low, middle, high] = places.map(|at| both[along].values(at));
                    across.iter().all(|across| {
                        let [low, middle, high] = [&low, &middle, &high].map(|at| match along {
                            0 => value(at, across),
                            _ => value(across, at),
                        });
                        (middle - f64::midpoint(low, high)).abs() <= MISSES
                    })
                })
            };
            let mut parts = MIN_PARTS;
            while parts < MAX_PARTS && !is_fine(&nodes(both[along], parts)) {
                parts *= 2;
            }
            nodes(both[along], parts)
        });
        // Only a range of a full turn closes.
        let is_turn = |along: usize| {
            let [low, high] = both[along].domain();
            go_round[along] && (high - low - 360.0).abs() < 1e-6
        };
        let go_round = [is_turn(0), is_turn(1)];
        let columns: Vec<Vec<f64>> = nodes[1].iter().map(|&at| self.modes.values(at)).collect();
        let row = |&at: &f64| {
            let first = own.values(at);
            let mut row: Vec<f64> = columns.iter().map(|second| value(&first, second)).collect();
            // Along a periodic axis the grid must close exactly.
            if go_round[1] {
                let first = row[0];
                row[nodes[1].len() - 1] = first;
            }
            row
        };
        let mut values: Vec<Vec<f64>> = nodes[0].iter().map(row).collect();
        if go_round[0] {
            let first = values[0].clone();
            values[nodes[0].len() - 1] = first;
        }
        Grid::new([own_axis, self.axis], nodes, values)
    }
}

/// The ends of equal parts of the range of the modes, mm or deg.
fn nodes(modes: &Modes, parts: usize) -> Vec<f64> {
    let [low, high] = modes.domain();
    let node = |k: usize| match k {
        // The last node equals the end of the range exactly, without rounding.
        _ if k == parts => high,
        _ => low + (high - low) * k as f64 / parts as f64,
    };
    (0..=parts).map(node).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{observations::Observations, system::System};
    use std::path::Path;
    use volcomp_curve::{ErrorCurve, Field};
    use volcomp_kinematics::nalgebra::DVector;

    const MACHINE: &str = "structure = \"w C' X' b Y Z t\"
[axes.X]
travel = [-300.0, 300.0]
point = [0.0, 20.0, -50.0]
[axes.Y]
travel = [-200.0, 200.0]
[axes.Z]
travel = [0.0, 400.0]
[axes.C]
travel = [0.0, 360.0]
modulo = 360.0
point = [10.0, 0.0, 0.0]
[tool]
tip = [0.0, 0.0, 100.0]
";
    const ROWS: &str = "X,Y,Z,C,x,y,z
-250,-150,20,10,-240,-130,125
120,30,310,200,-90,-50,400
290,180,150,340,300,100,260
-60,90,390,95,60,-90,480
80,-40,200,270,70,60,290
";
    const TEXT: &str = "machine = \"machine.toml\"
folds = 0
unknown = [
    { error = \"EZX\", legendre = 3, second = { axis = \"Y\", legendre = 2 } },
    { error = \"EAZ\", bspline = 5, second = { axis = \"C\", fourier = 1 }, reversal = true },
    { error = \"ECC\", fourier = 2, second = { axis = \"Z\", legendre = 1 } },
    { error = \"EBY\", second = { axis = \"X\", legendre = 2 } },
]
[[observation]]
kind = \"points\"
file = \"t.csv\"
target = \"unknown\"
";

    fn observations() -> Observations {
        let read = |path: &Path| {
            let is_table = path.extension().is_some_and(|end| end == "csv");
            Ok(if is_table { ROWS } else { MACHINE }.to_owned())
        };
        Observations::parse(TEXT, Path::new("o.toml"), &read).expect("observations")
    }

    #[test]
    fn the_derivatives_are_central_differences() {
        let observations = observations();
        let system = System::new(&observations).expect("a system");
        let rows = system.prepare(observations.observations.iter().flat_map(|o| &o.rows));
        let count = system.params.len();
        // Errors of some micrometres and microradians.
        let some = DVector::from_fn(count, |k, _| 1e-5 * ((k * 7 % 11) as f64 - 5.0));
        let values = system.start().moved(&system.params, &some);
        let found = system.equations(&rows, &values).jacobian;
        let products = system.unknowns.coefficients.iter().enumerate();
        let products = products.filter(|(_, c)| c.name.contains(" × "));
        let mut seen = 0;
        for (place, coefficient) in products {
            let column = system.params.setup() + place;
            let step = 1e-4;
            let at = |by: f64| {
                let mut steps = DVector::zeros(count);
                steps[column] = by;
                let moved = values.moved(&system.params, &steps);
                system.equations(&rows, &moved).residuals
            };
            let expected = (at(step) - at(-step)) / (2.0 * step);
            let difference = (found.column(column) - &expected).amax();
            let largest = expected.amax();
            assert!(largest > 1.0, "{}: {largest}", coefficient.name);
            assert!(difference < 1e-6 * largest, "{}: {difference}", coefficient.name);
            seen += 1;
        }
        // Number of modes and products of each unknown error: 3·2 + 2·2 + 3·1 + 1·2.
        assert_eq!(seen, 15);
    }

    #[test]
    fn the_grid_has_the_values_of_the_products() {
        let observations = observations();
        let system = System::new(&observations).expect("a system");
        let machine = &observations.machine;
        for (unknown, curve) in observations.unknown.iter().zip(&system.unknowns.curves) {
            let own = curve.modes.as_ref().expect("modes");
            let products = curve.products.as_ref().expect("products");
            let c: Vec<f64> = (0..own.len()).map(|m| 4.0 - 1.3 * m as f64).collect();
            let d: Vec<f64> =
                (0..products.pairs().len()).map(|m| 5.0 * (m as f64 + 1.0).sin()).collect();
            let go_round =
                [curve.axis, products.axis()].map(|axis| machine.axes()[axis].modulo.is_some());
            let grid = products.grid(own, curve.axis, [&c, &d], go_round).expect("a grid");
            // The machine accepts the curve: along an axis with a modulo its ends must agree.
            let mut taking = machine.clone();
            taking
                .set_error(unknown.error, ErrorCurve::Single(Field::Grid(grid.clone())))
                .expect("an error of the machine");
            let [rows, columns] = grid.domain();
            for k in 0..200 {
                let share = |of: f64| (f64::from(k) * of).fract();
                let q = rows[0] + (rows[1] - rows[0]) * share(0.618_034);
                let p = columns[0] + (columns[1] - columns[0]) * share(0.414_214);
                let first = own.values(q);
                let expected = first.iter().zip(&c).map(|(v, c)| v * c).sum::<f64>()
                    + products.values(&first, p).iter().zip(&d).map(|(v, d)| v * d).sum::<f64>();
                let mut at = vec![0.0; machine.axes().len()];
                at[curve.axis] = q;
                at[products.axis()] = p;
                let missed = grid.value(&at) - expected;
                assert!(missed.abs() < 3.0 * MISSES, "{} at {q}, {p}: {missed}", unknown.error);
            }
        }
    }
}
