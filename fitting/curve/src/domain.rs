//! Functions common to all curves: input checks, and the constant continuation outside the domain.

use crate::CurveError;

pub(crate) fn finite(what: &'static str, values: &[f64]) -> Result<(), CurveError> {
    match values.iter().position(|v| !v.is_finite()) {
        Some(index) => Err(CurveError::NotFinite { what, index, value: values[index] }),
        None => Ok(()),
    }
}

pub(crate) fn at_least(
    what: &'static str,
    found: usize,
    expected: usize,
) -> Result<(), CurveError> {
    if found < expected { Err(CurveError::TooFew { what, found, expected }) } else { Ok(()) }
}

pub(crate) fn interval([lower, upper]: [f64; 2]) -> Result<(), CurveError> {
    finite("domain end", &[lower, upper])?;
    if lower < upper && (upper - lower).is_finite() {
        Ok(())
    } else {
        Err(CurveError::Domain { lower, upper })
    }
}

pub(crate) fn positive(what: &'static str, value: f64) -> Result<(), CurveError> {
    if value > 0.0 && value.is_finite() {
        Ok(())
    } else {
        Err(CurveError::Parameter { what, value, expected: "a positive finite number" })
    }
}

pub(crate) fn increasing(
    what: &'static str,
    abscissae: impl Iterator<Item = f64>,
) -> Result<(), CurveError> {
    let mut previous = f64::NEG_INFINITY;
    for (index, value) in abscissae.enumerate() {
        if value <= previous {
            return Err(CurveError::NotIncreasing { what, index, previous, value });
        }
        previous = value;
    }
    Ok(())
}

/// Checks nodes `[abscissa, value]` and returns the range of their abscissas.
pub(crate) fn nodes(nodes: &[[f64; 2]], least: usize) -> Result<[f64; 2], CurveError> {
    at_least("nodes", nodes.len(), least)?;
    for (index, &[x, u]) in nodes.iter().enumerate() {
        for (what, value) in [("node abscissa", x), ("node value", u)] {
            if !value.is_finite() {
                return Err(CurveError::NotFinite { what, index, value });
            }
        }
    }
    increasing("node abscissa", nodes.iter().map(|n| n[0]))?;
    let range = [nodes[0][0], nodes[nodes.len() - 1][0]];
    interval(range)?;
    Ok(range)
}

pub(crate) fn contains([lower, upper]: [f64; 2], x: f64) -> bool {
    lower <= x && x <= upper
}

/// Evaluates `inside` at `x`, or at the nearer end of the domain if `x` is outside.
///
/// The domain must have passed `interval`, so that the clamp cannot panic. `inside` is never called with NaN.
pub(crate) fn held([lower, upper]: [f64; 2], x: f64, inside: impl FnOnce(f64) -> f64) -> f64 {
    if x.is_nan() { x } else { inside(x.clamp(lower, upper)) }
}

/// Evaluates the slope `inside` at `x`. Outside the domain the slope is 0, because a curve is constant there.
pub(crate) fn slope(domain: [f64; 2], x: f64, inside: impl FnOnce(f64) -> f64) -> f64 {
    if x.is_nan() {
        x
    } else if contains(domain, x) {
        inside(x)
    } else {
        0.0
    }
}

/// Segment `i` with `abscissa(i) <= x < abscissa(i + 1)`, among at least two nodes. The last node belongs to the last
/// segment.
pub(crate) fn segment<T>(nodes: &[T], x: f64, abscissa: impl Fn(&T) -> f64) -> usize {
    nodes.partition_point(|n| abscissa(n) <= x).clamp(1, nodes.len() - 1) - 1
}
