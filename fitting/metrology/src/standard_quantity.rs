//! A quantity as a standard names it, with its value.

/// A quantity of a standard: what it is called there, and what it came to.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct StandardQuantity {
    /// The symbol in plain letters, as a tolerance names it: `A`, `A_forward`, `mean_B`, `Ps_max`.
    pub symbol: &'static str,
    /// The name in words.
    pub name: &'static str,
    /// The value in the unit of the evaluation; `None` where it cannot be evaluated.
    pub value: Option<f64>,
}

impl StandardQuantity {
    pub(crate) fn new(symbol: &'static str, name: &'static str, value: Option<f64>) -> Self {
        Self {
            symbol,
            name,
            value,
        }
    }
}
