//! The plane of a circle, and the names of its axes.

use volcomp_vocabulary::{AxisName, Component, ErrorName};

/// The plane of a circle; angles run from the first axis to the second.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum CircularPlane {
    /// From X to Y.
    #[default]
    Xy,
    /// From Y to Z.
    Yz,
    /// From Z to X.
    Zx,
}

impl CircularPlane {
    /// The two axes.
    pub fn axes(self) -> [AxisName; 2] {
        match self {
            Self::Xy => [AxisName::X, AxisName::Y],
            Self::Yz => [AxisName::Y, AxisName::Z],
            Self::Zx => [AxisName::Z, AxisName::X],
        }
    }

    /// The squareness error of the plane; [`opening`](crate::opening) tells its sign where it opens the angle between the axes.
    pub fn squareness(self) -> ErrorName {
        let (component, axis) = match self {
            Self::Xy => (Component::EC, AxisName::Y),
            Self::Yz => (Component::EA, AxisName::Z),
            Self::Zx => (Component::EB, AxisName::Z),
        };
        ErrorName::location(component, axis)
    }
}
