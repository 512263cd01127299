//! Kinds of errors, and the machine that has one of them alone.

use volcomp_curve::Field;
use volcomp_model::{Machine, Thermal};
use volcomp_vocabulary::AxisKind;

use super::{ExchangeError, curves::own_component};

/// A kind of error whose share of the loss is told alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "schema", derive(serde::Serialize, schemars::JsonSchema))]
#[cfg_attr(feature = "schema", serde(rename_all = "lowercase"))]
pub enum Category {
    /// Error motions of linear axes along themselves.
    Positioning,
    /// Error motions of linear axes across themselves.
    Straightness,
    /// Location and assembly errors of linear axes.
    Squareness,
    /// Angular error motions of linear axes, which act through levers (Abbe).
    Angular,
    /// Errors that depend on a second coordinate.
    #[cfg_attr(feature = "schema", serde(rename = "second coordinate"))]
    SecondCoordinate,
    /// What differs between the directions of motion.
    Reversal,
    /// What 1 K at every sensor changes.
    #[cfg_attr(feature = "schema", serde(rename = "thermal, 1 K"))]
    Thermal,
    /// All errors of rotary axes.
    Rotary,
}

impl Category {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::Positioning,
        Self::Straightness,
        Self::Squareness,
        Self::Angular,
        Self::SecondCoordinate,
        Self::Reversal,
        Self::Thermal,
        Self::Rotary,
    ];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Positioning => "positioning",
            Self::Straightness => "straightness",
            Self::Squareness => "squareness",
            Self::Angular => "angular",
            Self::SecondCoordinate => "second coordinate",
            Self::Reversal => "reversal",
            Self::Thermal => "thermal, 1 K",
            Self::Rotary => "rotary",
        }
    }
}

/// The machine with the errors of one category alone; `None` where it has none.
pub(crate) fn alone(
    machine: &Machine,
    category: Category,
) -> Result<Option<Machine>, ExchangeError> {
    let mut found = machine.clone();
    found.clear_errors();
    found.set_thermal(Thermal::default())?;
    let mut is_empty = true;
    for (name, curve) in machine.errors() {
        let own = own_component(name.axis);
        let is_grid = curve.fields().any(|field| matches!(field, Field::Grid(_)));
        let of = match (name.axis.kind(), is_grid) {
            (AxisKind::Rotary, _) => Category::Rotary,
            (AxisKind::Linear, true) => Category::SecondCoordinate,
            (AxisKind::Linear, false) if name.component.is_angular() => Category::Angular,
            (AxisKind::Linear, false) if name.component == own => Category::Positioning,
            (AxisKind::Linear, false) => Category::Straightness,
        };
        if of == category {
            found.set_error(name, curve.clone())?;
            is_empty = false;
        }
    }
    let kind = match category {
        Category::Squareness => AxisKind::Linear,
        Category::Rotary => AxisKind::Rotary,
        _ => return Ok((!is_empty).then_some(found)),
    };
    for (name, value) in machine.locations() {
        if name.axis.kind() == kind && *value != 0.0 {
            found.set_location(*name, *value)?;
            is_empty = false;
        }
    }
    for (index, axis) in machine.axes().iter().enumerate() {
        let six = machine.assembly(index);
        if axis.name.kind() == kind && six.iter().any(|value| *value != 0.0) {
            found.set_assembly(axis.name, six)?;
            is_empty = false;
        }
    }
    Ok((!is_empty).then_some(found))
}
