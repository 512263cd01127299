//! VDI/DGQ 3441: positional uncertainty, position deviation, reversal and scatter of an axis.

use crate::{Iso230Part2, StandardQuantity};

/// Results of VDI/DGQ 3441 at one target, in the unit of the deviations.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Vdi3441Target {
    /// Target position, mm or deg.
    pub target: f64,
    /// Mean of both directions x̄_j = (x̄_j↑ + x̄_j↓)/2.
    pub mean: f64,
    /// Reversal U_j = |x̄_j↑ − x̄_j↓|.
    pub u: f64,
    /// Scatter Ps_j = 6 s̄_j with s̄_j = (s_j↑ + s_j↓)/2.
    pub ps: f64,
}

/// Results of VDI/DGQ 3441 for an axis, in the unit of the deviations.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Vdi3441 {
    /// Results at the targets, by ascending target.
    pub targets: Vec<Vdi3441Target>,
    /// Positional uncertainty P = max(x̄_j + (U_j + Ps_j)/2) − min(x̄_j − (U_j + Ps_j)/2).
    pub p: f64,
    /// Position deviation Pa = max x̄_j − min x̄_j.
    pub pa: f64,
    /// Largest reversal U_max.
    pub u_max: f64,
    /// Mean reversal Ū.
    pub u_mean: f64,
    /// Largest scatter Ps_max.
    pub ps_max: f64,
    /// Mean scatter P̄s.
    pub ps_mean: f64,
}

/// Evaluates the results of [`evaluate`](crate::evaluate) by VDI/DGQ 3441.
///
/// `None` if a target lacks a direction or a standard deviation, because the guideline requires both directions and
/// several runs.
pub fn vdi_3441(result: &Iso230Part2) -> Option<Vdi3441> {
    let at = |row: &crate::TargetRow| {
        let (up, down) = (row.forward?, row.backward?);
        Some(Vdi3441Target {
            target: row.target,
            mean: row.mean?,
            u: row.reversal?.abs(),
            ps: 6.0 * f64::midpoint(up.s?, down.s?),
        })
    };
    let targets: Vec<Vdi3441Target> = result.targets.iter().map(at).collect::<Option<_>>()?;
    let largest = |of: fn(&Vdi3441Target) -> f64| {
        let all = targets.iter().map(of);
        all.reduce(f64::max)
    };
    let mean =
        |of: fn(&Vdi3441Target) -> f64| targets.iter().map(of).sum::<f64>() / targets.len() as f64;
    let half = |t: &Vdi3441Target| 0.5 * (t.u + t.ps);
    Some(Vdi3441 {
        p: largest(|t| t.mean + 0.5 * (t.u + t.ps))?
            + targets.iter().map(|t| half(t) - t.mean).reduce(f64::max)?,
        pa: largest(|t| t.mean)? + largest(|t| -t.mean)?,
        u_max: largest(|t| t.u)?,
        u_mean: mean(|t| t.u),
        ps_max: largest(|t| t.ps)?,
        ps_mean: mean(|t| t.ps),
        targets,
    })
}

/// Symbol and name of a quantity, and function that returns its value.
type Quantity = (&'static str, &'static str, fn(&Vdi3441) -> f64);

const QUANTITIES: [Quantity; 6] = [
    ("P", "positional uncertainty", |v| v.p),
    ("Pa", "position deviation", |v| v.pa),
    ("U_max", "largest reversal", |v| v.u_max),
    ("U_mean", "mean reversal", |v| v.u_mean),
    ("Ps_max", "largest scatter, 6 s", |v| v.ps_max),
    ("Ps_mean", "mean scatter, 6 s", |v| v.ps_mean),
];

impl Vdi3441 {
    /// Symbols of the six quantities, in the order of [`Self::quantities`].
    pub fn symbols() -> [&'static str; 6] {
        QUANTITIES.map(|(symbol, ..)| symbol)
    }

    /// Quantities with symbol and name. They have no values if the guideline could not be evaluated (`None`).
    pub fn quantities(evaluated: Option<&Self>) -> Vec<StandardQuantity> {
        QUANTITIES
            .map(|(symbol, name, value)| StandardQuantity::new(symbol, name, evaluated.map(value)))
            .to_vec()
    }
}
