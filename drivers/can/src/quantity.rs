//! Quantity of a signal, derived from its name, and the accepted units. Only this module converts units of a DBC file
//! to mm, rad and °C.

use volcomp_vocabulary::{AxisKind, AxisName};

/// Names of the state signals of a control: every axis is referenced, an alarm is active, the emergency stop is
/// pressed.
pub(crate) const STATES: [&str; 3] = ["REFERENCED", "ALARM", "EMERGENCY_STOP"];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Quantity {
    Of(AxisName),
    Temperature,
    /// A state of the control: off if the value is 0, else on.
    State,
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("found {found}, expected {expected}")]
pub(crate) struct WrongUnit {
    pub(crate) found: String,
    pub(crate) expected: &'static str,
}

impl Quantity {
    /// Quantity of a signal by its name: `X_POS`, `X_CORR`, `X_APPLIED`, `…_TEMP` and the states; `None` for every
    /// other signal.
    pub(crate) fn of_signal(name: &str) -> Option<Self> {
        if STATES.contains(&name) {
            return Some(Self::State);
        }
        if name.ends_with("_TEMP") {
            return Some(Self::Temperature);
        }
        let letter =
            ["_POS", "_CORR", "_APPLIED"].iter().find_map(|suffix| name.strip_suffix(suffix))?;
        letter.parse().ok().map(Self::Of)
    }

    /// Accepted units, each with its factor to mm, rad or °C.
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
            Self::State => &[("", 1.0), ("bool", 1.0)],
        }
    }

    /// Factor from a unit to mm, rad or °C. Errors: a unit that does not match this quantity.
    pub(crate) fn factor(self, unit: &str) -> Result<f64, WrongUnit> {
        let known = self.units().iter().find(|(name, _)| *name == unit);
        known.map(|(_, factor)| *factor).ok_or_else(|| WrongUnit {
            found: match unit {
                "" => "no unit".to_owned(),
                other => format!("the unit `{other}`"),
            },
            expected: self.expected(),
        })
    }

    fn expected(self) -> &'static str {
        match self {
            Self::Of(name) => match name.kind() {
                AxisKind::Linear => "mm or um, since the axis is linear",
                AxisKind::Rotary => "deg, rad or urad, since the axis is rotary",
            },
            Self::Temperature => "degC",
            Self::State => "no unit or bool, since it is 0 or 1",
        }
    }
}

/// Factor from the unit of a signal to mm, rad or °C; 1 for a signal without a known quantity. Errors: a unit that does
/// not match the quantity.
pub(crate) fn to_internal(name: &str, unit: &str) -> Result<f64, WrongUnit> {
    Quantity::of_signal(name).map_or(Ok(1.0), |quantity| quantity.factor(unit))
}
