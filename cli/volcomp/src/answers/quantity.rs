//! A quantity of a standard in a JSON document, with its uncertainty and its tolerance.

use schemars::JsonSchema;
use serde::Serialize;

/// A quantity of a standard.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub(crate) struct Quantity {
    /// The standard: `ISO 230-2:2014`, `VDI/DGQ 3441`, `ASME B5.54`, `ISO 230-4`, `ISO 230-6`.
    pub(crate) standard: String,
    /// The symbol, as `--tolerance` names it.
    pub(crate) symbol: &'static str,
    /// The name in the standard.
    pub(crate) name: &'static str,
    /// The value; null where it cannot be evaluated.
    pub(crate) value: Option<f64>,
    /// The unit of value, uncertainty and limit: `um` or `urad`.
    pub(crate) unit: &'static str,
    /// The expanded measurement uncertainty (k = 2); null where none is stated.
    pub(crate) uncertainty: Option<f64>,
    /// The limit of `--tolerance`; null where there is none.
    pub(crate) limit: Option<f64>,
    /// `pass`, `fail`, `undecided` (nearer to the limit than the uncertainty) or `not evaluated`; null without a limit.
    pub(crate) verdict: Option<&'static str>,
}

/// What was decided over all tolerances.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
pub(crate) struct Decision {
    /// `pass`, `fail`, `undecided` or `not evaluated`: the worst of the quantities.
    pub(crate) verdict: &'static str,
    /// Whether every quantity with a tolerance passes.
    pub(crate) pass: bool,
    /// How it was decided: `ISO 14253-1` with the uncertainty of each quantity with a limit, `simple` without, `mixed` where some have one.
    pub(crate) rule: &'static str,
}
