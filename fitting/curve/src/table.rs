use alloc::vec::Vec;

use crate::{CurveError, domain, series::affine_nodes};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(rename_all = "snake_case")
)]
pub enum Interpolation {
    /// Straight lines between neighbouring nodes.
    Linear,
    /// Monotone cubics (PCHIP), which neither overshoot nor ripple.
    Cubic,
}

/// Curve through nodes `[argument, value]`.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(into = "crate::serialised::Table", try_from = "crate::serialised::Table")
)]
pub struct Table {
    nodes: Vec<[f64; 2]>,
    /// Slopes at the nodes; empty for straight lines.
    slopes: Vec<f64>,
}

impl Table {
    /// Builds straight lines between at least two nodes.
    ///
    /// At a node the derivative is the slope of the segment to its right, at the last node the slope of the last
    /// segment.
    ///
    /// # Errors
    /// Too few nodes, a number that is not finite, abscissae that do not increase.
    pub fn linear(nodes: Vec<[f64; 2]>) -> Result<Self, CurveError> {
        domain::nodes(&nodes, 2)?;
        Ok(Self { nodes, slopes: Vec::new() })
    }

    /// Builds monotone cubic pieces between at least two nodes. The slope at a node is the weighted harmonic mean of
    /// the neighbouring secants (Fritsch and Butland, SIAM J. Sci. Stat. Comput. 5, 1984). At the ends it is given by
    /// the shape-preserving three-point formula.
    ///
    /// # Errors
    /// Too few nodes, a number that is not finite, abscissae that do not increase.
    pub fn cubic(nodes: Vec<[f64; 2]>) -> Result<Self, CurveError> {
        domain::nodes(&nodes, 2)?;
        let slopes = monotone_slopes(&nodes);
        Ok(Self { nodes, slopes })
    }

    /// Nodes `[argument, value]`, with increasing arguments.
    pub fn nodes(&self) -> &[[f64; 2]] {
        &self.nodes
    }

    pub fn interpolation(&self) -> Interpolation {
        if self.slopes.is_empty() { Interpolation::Linear } else { Interpolation::Cubic }
    }

    /// Range of arguments, from the first to the last node.
    pub fn domain(&self) -> [f64; 2] {
        [self.nodes[0][0], self.nodes[self.nodes.len() - 1][0]]
    }

    /// Value at `x`. Outside the range the end value is kept.
    pub fn value(&self, x: f64) -> f64 {
        domain::held(self.domain(), x, |x| {
            let i = domain::segment(&self.nodes, x, |n| n[0]);
            let ([x0, u0], [x1, u1]) = (self.nodes[i], self.nodes[i + 1]);
            let h = x1 - x0;
            let s = (x - x0) / h;
            match self.interpolation() {
                Interpolation::Linear => (1.0 - s) * u0 + s * u1,
                Interpolation::Cubic => {
                    let r = 1.0 - s;
                    let bend = r * self.slopes[i] - s * self.slopes[i + 1];
                    r * r * (1.0 + 2.0 * s) * u0 + s * s * (3.0 - 2.0 * s) * u1 + s * r * h * bend
                }
            }
        })
    }

    pub fn derivative(&self, x: f64) -> f64 {
        domain::slope(self.domain(), x, |x| {
            let i = domain::segment(&self.nodes, x, |n| n[0]);
            let secant = secant(self.nodes[i], self.nodes[i + 1]);
            match self.interpolation() {
                Interpolation::Linear => secant,
                Interpolation::Cubic => {
                    let s = (x - self.nodes[i][0]) / (self.nodes[i + 1][0] - self.nodes[i][0]);
                    let r = 1.0 - s;
                    6.0 * s * r * secant
                        + r * (r - 2.0 * s) * self.slopes[i]
                        + s * (s - 2.0 * r) * self.slopes[i + 1]
                }
            }
        })
    }

    /// Replaces every value by `scale` times the value plus `c`.
    pub(crate) fn affine(mut self, scale: f64, c: f64) -> Self {
        affine_nodes(&mut self.nodes, scale, c);
        for slope in &mut self.slopes {
            *slope *= scale;
        }
        self
    }
}

fn secant([x0, u0]: [f64; 2], [x1, u1]: [f64; 2]) -> f64 {
    (u1 - u0) / (x1 - x0)
}

fn monotone_slopes(nodes: &[[f64; 2]]) -> Vec<f64> {
    let last = nodes.len() - 1;
    if last == 1 {
        return alloc::vec![secant(nodes[0], nodes[1]); 2];
    }
    let h = |i: usize| nodes[i + 1][0] - nodes[i][0];
    let m = |i: usize| secant(nodes[i], nodes[i + 1]);
    let mut slopes = Vec::with_capacity(nodes.len());
    slopes.push(end_slope(h(0), h(1), m(0), m(1)));
    slopes.extend((1..last).map(|i| inner_slope(h(i - 1), h(i), m(i - 1), m(i))));
    slopes.push(end_slope(h(last - 1), h(last - 2), m(last - 1), m(last - 2)));
    slopes
}

fn inner_slope(h0: f64, h1: f64, m0: f64, m1: f64) -> f64 {
    if same_sign(m0, m1) {
        let (w0, w1) = (2.0 * h1 + h0, h1 + 2.0 * h0);
        (w0 + w1) / (w0 / m0 + w1 / m1)
    } else {
        0.0
    }
}

/// Three-point slope at an end. `h0` and `m0` are width and secant of the end segment, `h1` and `m1` those of the next
/// segment.
fn end_slope(h0: f64, h1: f64, m0: f64, m1: f64) -> f64 {
    let slope = ((2.0 * h0 + h1) * m0 - h0 * m1) / (h0 + h1);
    if !same_sign(slope, m0) {
        0.0
    } else if !same_sign(m0, m1) && slope.abs() > 3.0 * m0.abs() {
        3.0 * m0
    } else {
        slope
    }
}

fn same_sign(a: f64, b: f64) -> bool {
    (a > 0.0 && b > 0.0) || (a < 0.0 && b < 0.0)
}
