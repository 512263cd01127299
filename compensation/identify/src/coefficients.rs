//! The unknown errors of a machine as coefficients of curves.

use volcomp_curve::{Curve, ErrorCurve, Field};
use volcomp_model::Machine;
use volcomp_vocabulary::{Component, ErrorName};

use crate::{basis::Modes, error::IdentifyError, observations::Observations, products::Products};

/// Products of modes are kept after all modes of curves of one axis.
const PRODUCTS_FROM: usize = 1000;

/// A coefficient of an error: mm or rad inside, µm or µrad outside.
#[derive(Clone, Debug)]
pub(crate) struct Coefficient {
    pub(crate) name: String,
    pub(crate) error: ErrorName,
    /// Which curve it belongs to, by the place in [`Unknowns::curves`].
    pub(crate) curve: usize,
    pub(crate) role: Role,
    /// The group whose penalty holds it down, and its weight there.
    pub(crate) group: Option<(usize, f64)>,
    /// What is kept first.
    rank: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    Location,
    Mode(usize),
    /// A mode of the error's own axis times one of the second axis, by its place in [`Products::pairs`].
    Product(usize),
    Reversal,
}

/// An unknown error with its modes.
#[derive(Clone, Debug)]
pub(crate) struct UnknownCurve {
    pub(crate) error: ErrorName,
    pub(crate) axis: usize,
    pub(crate) modes: Option<Modes>,
    /// What of it depends on a second axis.
    pub(crate) products: Option<Products>,
}

/// Everything unknown of the machine.
#[derive(Clone, Debug)]
pub(crate) struct Unknowns {
    pub(crate) curves: Vec<UnknownCurve>,
    /// In the order in which they are kept where some cannot be told apart: location errors, constants, modes by
    /// rising order, then products by rising order.
    pub(crate) coefficients: Vec<Coefficient>,
    /// Axis, component and coefficient of every unknown location error.
    pub(crate) locations: Vec<(usize, usize, usize)>,
    /// How many groups of coefficients have a penalty each.
    pub(crate) groups: usize,
}

impl Unknowns {
    /// The unknowns of the observations. In `machine` the curves that are to be found become zero.
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
                // Found anew; a reversal value that is not asked for stays.
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
                    let group = item
                        .penalised
                        .then_some((group, products.weight(own, place)));
                    // What a curve of one axis says is kept first.
                    let rank = PRODUCTS_FROM + products.order(own, place);
                    coefficients.push(add(name, Role::Product(place), rank, group));
                }
            }
            curves.push(UnknownCurve {
                error,
                axis,
                modes,
                products,
            });
        }
        coefficients.sort_by_key(|coefficient| coefficient.rank);
        let mut locations = Vec::new();
        for (place, coefficient) in coefficients.iter().enumerate() {
            if coefficient.role == Role::Location {
                let axis = curves[coefficient.curve].axis;
                locations.push((axis, coefficient.error.component.index(), place));
            }
        }
        Ok(Self {
            curves,
            coefficients,
            locations,
            groups,
        })
    }
}

impl Unknowns {
    /// Whether a coefficient is the constant of a curve, or the slope of the straightness of a linear axis: what of it nothing
    /// else says is a convention.
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

/// µm or µrad for one mm or rad of a component.
pub(crate) fn micro(component: Component) -> f64 {
    if component.is_angular() { 1e6 } else { 1e3 }
}

fn constant(value: f64, reversal: f64) -> ErrorCurve {
    let mean = Field::Curve(Curve::Constant(value));
    if reversal == 0.0 {
        ErrorCurve::Single(mean)
    } else {
        ErrorCurve::Reversal { mean, reversal }
    }
}

/// A curve whose reversal value is found anew.
fn without_reversal(curve: Option<&ErrorCurve>) -> ErrorCurve {
    match curve {
        Some(ErrorCurve::Single(field) | ErrorCurve::Reversal { mean: field, .. }) => {
            ErrorCurve::Single(field.clone())
        }
        Some(pair) => pair.clone(),
        None => constant(0.0, 0.0),
    }
}
