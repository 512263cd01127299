//! Curves as deserialised by serde. Their plain fields are then checked by the constructor of the curve.

use alloc::vec::Vec;

use serde::{Deserialize, Deserializer, Serialize, de::Error};

use crate::{CurveError, Interpolation};

/// Deserialises a number. Like the constructors, rejects NaN and infinity.
pub(crate) fn finite<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    let value = f64::deserialize(deserializer)?;
    if value.is_finite() { Ok(value) } else { Err(D::Error::custom("expected a finite number")) }
}

/// Defines a struct with the same fields as a type, in the same order, and its conversion by the constructor that
/// checks the fields.
macro_rules! checked {
    ($($name:ident { $($field:ident: $kind:ty),* } => $constructor:path;)*) => {$(
        #[derive(Deserialize)]
        pub(crate) struct $name {
            $($field: $kind),*
        }

        impl TryFrom<$name> for $crate::$name {
            type Error = CurveError;

            fn try_from(fields: $name) -> Result<Self, CurveError> {
                $constructor($(fields.$field),*)
            }
        }
    )*};
}

checked! {
    BSpline { knots: Vec<f64>, coefficients: Vec<f64>, degree: usize } => crate::BSpline::new;
    Fourier { coefficients: Vec<f64>, period: f64, domain: [f64; 2] } => crate::Fourier::new;
    Grid { axes: [usize; 2], nodes: [Vec<f64>; 2], values: Vec<Vec<f64>> } => crate::Grid::new;
    MovingLeastSquares { nodes: Vec<[f64; 2]>, order: usize, support: f64, shape: f64 }
        => crate::MovingLeastSquares::new;
}

#[derive(Deserialize)]
pub(crate) struct Series {
    coefficients: Vec<f64>,
    domain: [f64; 2],
}

impl TryFrom<Series> for crate::series::Series {
    type Error = CurveError;

    fn try_from(fields: Series) -> Result<Self, CurveError> {
        Self::new(fields.coefficients, fields.domain)
    }
}

/// Table without its slopes, which follow from the nodes.
#[derive(Deserialize, Serialize)]
pub(crate) struct Table {
    nodes: Vec<[f64; 2]>,
    interpolation: Interpolation,
}

impl From<crate::Table> for Table {
    fn from(table: crate::Table) -> Self {
        Self { interpolation: table.interpolation(), nodes: table.nodes().to_vec() }
    }
}

impl TryFrom<Table> for crate::Table {
    type Error = CurveError;

    fn try_from(fields: Table) -> Result<Self, CurveError> {
        match fields.interpolation {
            Interpolation::Linear => Self::linear(fields.nodes),
            Interpolation::Cubic => Self::cubic(fields.nodes),
        }
    }
}
