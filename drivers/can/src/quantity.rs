//! The quantity that a signal carries, by its name, and the units that are accepted for it: the one place that turns
//! units of a DBC file into mm, rad and °C.

use volcomp_vocabulary::{AxisKind, AxisName};

/// The quantity that a signal carries, where the drivers use it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Quantity {
    /// A position or correction of an axis.
    Of(AxisName),
    /// A temperature in °C.
    Temperature,
}

impl Quantity {
    /// The quantity that the name of a signal stands for: `X_POS`, `X_CORR`, `X_APPLIED`, `…_TEMP`; `None` for every
    /// other signal.
    pub(crate) fn of_signal(name: &str) -> Option<Self> {
        if name.ends_with("_TEMP") {
            return Some(Self::Temperature);
        }
        let letter = ["_POS", "_CORR", "_APPLIED"]
            .iter()
            .find_map(|suffix| name.strip_suffix(suffix))?;
        letter.parse().ok().map(Self::Of)
    }

    /// The units that it may have, each with the factor to mm, rad or °C.
    fn units(self) -> &'static [(&'static str, f64)] {
        const DEG: f64 = std::f64::consts::PI / 180.0;
        match self {
            Self::Of(name) => match name.kind() {
                AxisKind::Linear => &[("mm", 1.0), ("um", 1e-3), ("µm", 1e-3), ("μm", 1e-3)],
                AxisKind::Rotary => &[
                    ("deg", DEG),
                    ("°", DEG),
                    ("rad", 1.0),
                    ("urad", 1e-6),
                    ("µrad", 1e-6),
                    ("μrad", 1e-6),
                ],
            },
            Self::Temperature => &[("degC", 1.0), ("°C", 1.0)],
        }
    }

    /// The factor from a unit to mm, rad or °C; `None` where this quantity does not have such a unit.
    pub(crate) fn factor(self, unit: &str) -> Option<f64> {
        let known = self.units().iter().find(|(name, _)| *name == unit);
        known.map(|(_, factor)| *factor)
    }

    /// The units as a message names them.
    pub(crate) fn expected(self) -> &'static str {
        match self {
            Self::Of(name) => match name.kind() {
                AxisKind::Linear => "mm or um, since the axis is linear",
                AxisKind::Rotary => "deg, rad or urad, since the axis is rotary",
            },
            Self::Temperature => "degC",
        }
    }
}
