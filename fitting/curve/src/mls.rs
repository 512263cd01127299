use alloc::vec::Vec;

use crate::{CurveError, domain, series::affine_nodes};

const MAX_ORDER: usize = 8;
const SIZE: usize = MAX_ORDER + 1;
/// Valid range of the shape. Above it the weights of distant nodes underflow.
const SHAPES: [f64; 2] = [1e-6, 20.0];

/// Moving least squares: at every `x`, the value of a polynomial that is fitted to the nodes near `x`.
///
/// Let `h = support · range` and `d = |x − x_j|`. Node `j` has the Gaussian weight with compact support `w = (e^{−(a
/// d/h)²} − e^{−a²}) / (1 − e^{−a²})` for `d < h`, else 0, with the shape `a`. The value at `x` is that of the weighted
/// least-squares polynomial (Lancaster and Salkauskas, Math. Comp. 37, 1981). The value does not depend on the
/// polynomial basis. So the best conditioned basis is used, which is local to `x`, and the problem is solved by
/// orthogonal transformation.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "serde",
    derive(serde::Serialize, serde::Deserialize),
    serde(try_from = "crate::serialised::MovingLeastSquares")
)]
pub struct MovingLeastSquares {
    nodes: Vec<[f64; 2]>,
    order: usize,
    support: f64,
    shape: f64,
}

impl MovingLeastSquares {
    /// Builds the curve from nodes `[argument, value]`, the order of the polynomial (0 to 8), the
    /// support as a fraction of the range of the nodes, and the shape `a` of the weight (1e-6 to
    /// 20).
    ///
    /// # Errors
    /// Fewer than `order + 1` or fewer than 2 nodes, a number that is not finite, abscissae that do not increase, a
    /// parameter out of range, or a support so narrow that fewer than `order + 1` nodes have a positive weight
    /// somewhere in the range.
    pub fn new(
        nodes: Vec<[f64; 2]>,
        order: usize,
        support: f64,
        shape: f64,
    ) -> Result<Self, CurveError> {
        if order > MAX_ORDER {
            let (lowest, highest) = (0, MAX_ORDER);
            return Err(CurveError::OutOfRange { what: "order", found: order, lowest, highest });
        }
        let [lower, upper] = domain::nodes(&nodes, (order + 1).max(2))?;
        domain::positive("support", support)?;
        domain::positive("support in argument units", support * (upper - lower))?;
        if !domain::contains(SHAPES, shape) {
            let expected = "1e-6 to 20";
            return Err(CurveError::Parameter { what: "shape", value: shape, expected });
        }
        let (at, reach) = sparsest(&nodes, order);
        let required_support = reach / (upper - lower);
        // A node at the very edge of the support has a negligible weight, so the support must be wider.
        if support <= required_support * (1.0 + 1e-9) {
            return Err(CurveError::SupportTooNarrow {
                support,
                order,
                needed: order + 1,
                nodes: nodes.len(),
                at,
                required_support,
            });
        }
        Ok(Self { nodes, order, support, shape })
    }

    /// Nodes `[argument, value]`, with increasing arguments.
    pub fn nodes(&self) -> &[[f64; 2]] {
        &self.nodes
    }

    /// Order of the local polynomial, 0 to 8.
    pub fn order(&self) -> usize {
        self.order
    }

    /// Support of the weight as a fraction of the range of the nodes.
    pub fn support(&self) -> f64 {
        self.support
    }

    /// Shape `a` of the weight. With a larger shape the weight is more concentrated near `x`.
    pub fn shape(&self) -> f64 {
        self.shape
    }

    /// Half width `h` of the weight, in argument units.
    pub fn half_width(&self) -> f64 {
        self.support * self.range()
    }

    /// Range of arguments, from the first to the last node.
    pub fn domain(&self) -> [f64; 2] {
        [self.nodes[0][0], self.nodes[self.nodes.len() - 1][0]]
    }

    /// Value at `x`. Outside the range the end value is kept.
    pub fn value(&self, x: f64) -> f64 {
        domain::held(self.domain(), x, |x| self.triangle(x).coefficients()[0])
    }

    /// Derivative at `x`, 0 outside the range. Because the weights move with `x`, it is the derivative of the local
    /// polynomial plus `[A⁻¹ Σ w_j′ φ_j r_j]₀`, with the normal matrix `A`, the basis `φ_j` and the residual `r_j` at
    /// node `j`.
    pub fn derivative(&self, x: f64) -> f64 {
        domain::slope(self.domain(), x, |x| {
            let triangle = self.triangle(x);
            let a = triangle.coefficients();
            let z = triangle.first_column_of_inverse();
            let moved: f64 = self
                .active(x)
                .map(|node| {
                    let powers = self.powers(node.t);
                    let residual = node.u - self.dot(&a, &powers);
                    node.weight_slope * self.dot(&z, &powers) * residual
                })
                .sum();
            let local = if self.order == 0 { 0.0 } else { a[1] / self.scale() };
            local + moved
        })
    }

    /// Derivative of the value at `x` with respect to the value of the node with index `node`. If `x` is a node, it is
    /// an entry of the hat matrix. It is 0 if there is no such node.
    pub fn influence(&self, x: f64, node: usize) -> f64 {
        domain::held(self.domain(), x, |x| {
            let z = self.triangle(x).first_column_of_inverse();
            self.influence_of(node, &self.weighting(x), &z)
        })
    }

    /// [`value`](Self::value) and [`influence`](Self::influence), computed from one factorisation.
    pub fn value_and_influence(&self, x: f64, node: usize) -> (f64, f64) {
        let [lower, upper] = self.domain();
        if x.is_nan() {
            return (x, x);
        }
        // Value and influence are constant outside the range.
        let x = x.clamp(lower, upper);
        let triangle = self.triangle(x);
        let z = triangle.first_column_of_inverse();
        let influence = self.influence_of(node, &self.weighting(x), &z);
        (triangle.coefficients()[0], influence)
    }

    fn influence_of(&self, node: usize, weighting: &Weighting, z: &[f64; SIZE]) -> f64 {
        self.nodes.get(node).map_or(0.0, |&node| {
            let node = weighting.of(node);
            node.weight * self.dot(z, &self.powers(node.t))
        })
    }

    /// Whether at least `count` nodes have a positive weight at every `x` in the range.
    pub fn has_nodes_everywhere(&self, count: usize) -> bool {
        let Some(order) = count.checked_sub(1) else {
            return true;
        };
        // A node at the very edge of the support has a negligible weight, so the support must be wider.
        self.nodes.len() >= count
            && self.half_width() > sparsest(&self.nodes, order).1 * (1.0 + 1e-9)
    }

    /// Rows of the least-squares problem at `x`, one for each node with a positive weight. A row has the powers from 0
    /// to the order of the node's distance divided by [`scale`](Self::scale), each multiplied by the square root of the
    /// node's weight. The condition number of the rows shows whether the nodes determine the curve at `x`. An `x`
    /// outside the range is clamped to its nearer end.
    pub fn design(&self, x: f64) -> Vec<Vec<f64>> {
        let [lower, upper] = self.domain();
        let weighted = self.active(x.clamp(lower, upper));
        let weighted = weighted.filter(|node| node.weight > 0.0);
        let row = |node: Active| {
            let root = libm::sqrt(node.weight);
            let powers = self.powers(node.t);
            powers.iter().take(self.order + 1).map(|p| p * root).collect()
        };
        weighted.map(row).collect()
    }

    /// Solutions at `x` for this order and for all lower orders, from one factorisation. `x` must be in the range.
    pub fn nested(&self, x: f64) -> NestedSolutions {
        let Triangle { size, r, y } = self.triangle(x);
        let is_node = self.nodes.binary_search_by(|n| n[0].total_cmp(&x)).is_ok();
        // The weight of a node at its own abscissa, where it is the nearest node.
        let own = if is_node { -libm::expm1(-self.shape * self.shape) } else { 0.0 };
        let mut found = NestedSolutions {
            values: [0.0; SIZE],
            influences: [0.0; SIZE],
            conditions: [0.0; SIZE],
        };
        // For a lower order, R is its leading block, and the inverse of R is the leading block of the inverse.
        let mut inverse = [[0.0; SIZE]; SIZE];
        let [mut value, mut leverage, mut norm, mut norm_of_inverse] = [0.0; 4];
        for column in 0..size {
            inverse[column][column] = 1.0 / r[column][column];
            for row in (0..column).rev() {
                let known: f64 = (row + 1..=column).map(|k| r[row][k] * inverse[k][column]).sum();
                inverse[row][column] = -known / r[row][row];
            }
            for row in 0..=column {
                norm += r[row][column] * r[row][column];
                norm_of_inverse += inverse[row][column] * inverse[row][column];
            }
            // At `x` the powers are 1, 0, 0, …, so the first row of the inverse gives value and leverage.
            value += inverse[0][column] * y[column];
            leverage += inverse[0][column] * inverse[0][column];
            found.values[column] = value;
            found.influences[column] = own * leverage;
            found.conditions[column] = 1.0 / libm::sqrt(norm * norm_of_inverse);
        }
        found
    }

    fn range(&self) -> f64 {
        let [lower, upper] = self.domain();
        upper - lower
    }

    /// Unit of the local argument: the smaller of the half width of the weight and the range. If the support is wider
    /// than the range, the half width would make the powers tiny.
    pub fn scale(&self) -> f64 {
        self.range().min(self.half_width())
    }

    /// Nodes with a positive weight at `x`.
    fn active(&self, x: f64) -> impl Iterator<Item = Active> + '_ {
        let weighting = self.weighting(x);
        let h = weighting.h;
        let first = self.nodes.partition_point(|n| n[0] <= x - h);
        self.nodes[first..].iter().map_while(move |&node| {
            let r = (node[0] - x) / h;
            let beyond = 1.0 - r * r <= 0.0 && node[0] > x;
            (!beyond).then(|| weighting.of(node))
        })
    }

    fn weighting(&self, x: f64) -> Weighting {
        let h = self.half_width();
        let distance = |i: usize| self.nodes.get(i).map_or(f64::INFINITY, |n| (n[0] - x).abs());
        let above = self.nodes.partition_point(|n| n[0] <= x);
        Weighting {
            x,
            h,
            a2: self.shape * self.shape,
            nearest: distance(above).min(distance(above.wrapping_sub(1))) / h,
            scale: self.scale(),
        }
    }

    fn powers(&self, t: f64) -> [f64; SIZE] {
        let mut powers = [1.0; SIZE];
        for i in 1..=self.order {
            powers[i] = powers[i - 1] * t;
        }
        powers
    }

    fn dot(&self, a: &[f64; SIZE], b: &[f64; SIZE]) -> f64 {
        (0..=self.order).map(|i| a[i] * b[i]).sum()
    }

    fn triangle(&self, x: f64) -> Triangle {
        match self.order {
            0 => self.triangle_of::<1>(x),
            1 => self.triangle_of::<2>(x),
            2 => self.triangle_of::<3>(x),
            3 => self.triangle_of::<4>(x),
            4 => self.triangle_of::<5>(x),
            5 => self.triangle_of::<6>(x),
            6 => self.triangle_of::<7>(x),
            7 => self.triangle_of::<8>(x),
            _ => self.triangle_of::<SIZE>(x),
        }
    }

    /// Builds the triangle for `N` coefficients, one more than the order. The compile-time size makes the rotations
    /// several times faster.
    fn triangle_of<const N: usize>(&self, x: f64) -> Triangle {
        let mut rotated = Rotated::<N>::new();
        for node in self.active(x).filter(|n| n.weight > 0.0) {
            let root = libm::sqrt(node.weight);
            let mut power = 1.0;
            let row = core::array::from_fn(|_| {
                let number = power * root;
                power *= node.t;
                number
            });
            rotated.add(row, node.u * root);
        }
        rotated.into()
    }

    /// Replaces every value by `scale` times the value plus `c`. It is enough to replace the values of the nodes,
    /// because the fit is linear in them and reproduces constants.
    pub(crate) fn affine(mut self, scale: f64, c: f64) -> Self {
        affine_nodes(&mut self.nodes, scale, c);
        self
    }
}

/// Solutions of a [`MovingLeastSquares`] at one argument for all orders up to its own. The index is the order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NestedSolutions {
    pub values: [f64; 9],
    /// [`influence`](MovingLeastSquares::influence) of the node at this argument, for each order; 0 if there is no
    /// node.
    pub influences: [f64; 9],
    /// Lower bound of the reciprocal condition number of [`design`](MovingLeastSquares::design), for each order. The
    /// bound is too small by a factor of at most order + 1. NaN if the design is singular.
    pub conditions: [f64; 9],
}

/// Computes the weights of nodes at `x`. All weights are divided by the Gaussian of the nearest node. This common
/// factor cancels, and prevents underflow.
struct Weighting {
    x: f64,
    h: f64,
    a2: f64,
    /// Distance of the nearest node, divided by `h`.
    nearest: f64,
    scale: f64,
}

impl Weighting {
    fn of(&self, [xj, u]: [f64; 2]) -> Active {
        let r = (xj - self.x) / self.h;
        let inside = 1.0 - r * r;
        let gauss = libm::exp(-self.a2 * (r * r - self.nearest * self.nearest));
        Active {
            t: (xj - self.x) / self.scale,
            u,
            weight: (-gauss * libm::expm1(-self.a2 * inside)).max(0.0),
            weight_slope: if inside > 0.0 { 2.0 * self.a2 * r / self.h * gauss } else { 0.0 },
        }
    }
}

struct Active {
    /// Local argument `(x_j − x) / scale`.
    t: f64,
    u: f64,
    weight: f64,
    /// Derivative of the weight with respect to `x`.
    weight_slope: f64,
}

/// The argument whose `(order + 1)`-th nearest node is farthest away, and the distance of that node. The argument is an
/// end of the range, or the middle between two nodes whose indices differ by `order + 1`.
fn sparsest(nodes: &[[f64; 2]], order: usize) -> (f64, f64) {
    let last = nodes.len() - 1;
    let start = (nodes[0][0], nodes[order][0] - nodes[0][0]);
    let end = (nodes[last][0], nodes[last][0] - nodes[last - order][0]);
    nodes
        .windows(order + 2)
        .map(|w| (w[0][0], w[order + 1][0]))
        .map(|(l, r)| (l + (r - l) / 2.0, (r - l) / 2.0))
        .chain([end])
        .fold(start, |worst, candidate| if candidate.1 > worst.1 { candidate } else { worst })
}

/// Upper triangle R of a QR factorisation, and Qᵀ times the right-hand side, built row by row by Givens rotations.
struct Rotated<const N: usize> {
    r: [[f64; N]; N],
    y: [f64; N],
}

impl<const N: usize> Rotated<N> {
    fn new() -> Self {
        Self { r: [[0.0; N]; N], y: [0.0; N] }
    }

    fn add(&mut self, mut row: [f64; N], mut right: f64) {
        for i in 0..N {
            if row[i] == 0.0 {
                continue;
            }
            let length = libm::sqrt(self.r[i][i] * self.r[i][i] + row[i] * row[i]);
            let (c, s) = (self.r[i][i] / length, row[i] / length);
            // Rotate all columns, because a fixed length is faster. Before the diagonal both rows are zero or no longer
            // used.
            for (mine, other) in self.r[i].iter_mut().zip(&mut row) {
                (*mine, *other) = (c * *mine + s * *other, c * *other - s * *mine);
            }
            (self.y[i], right) = (c * self.y[i] + s * right, c * right - s * self.y[i]);
        }
    }
}

struct Triangle {
    size: usize,
    r: [[f64; SIZE]; SIZE],
    y: [f64; SIZE],
}

impl<const N: usize> From<Rotated<N>> for Triangle {
    fn from(rotated: Rotated<N>) -> Self {
        let mut all = Self { size: N, r: [[0.0; SIZE]; SIZE], y: [0.0; SIZE] };
        for (mine, row) in all.r.iter_mut().zip(&rotated.r) {
            mine[..N].copy_from_slice(row);
        }
        all.y[..N].copy_from_slice(&rotated.y);
        all
    }
}

impl Triangle {
    /// Solves R a = b.
    fn back(&self, b: &[f64; SIZE]) -> [f64; SIZE] {
        let mut a = [0.0; SIZE];
        for i in (0..self.size).rev() {
            let known: f64 = (i + 1..self.size).map(|j| self.r[i][j] * a[j]).sum();
            a[i] = (b[i] - known) / self.r[i][i];
        }
        a
    }

    fn coefficients(&self) -> [f64; SIZE] {
        self.back(&self.y)
    }

    /// First column of the inverse of the normal matrix: `(RᵀR)⁻¹ e₀`.
    fn first_column_of_inverse(&self) -> [f64; SIZE] {
        let mut q = [0.0; SIZE];
        for i in 0..self.size {
            let known: f64 = (0..i).map(|j| self.r[j][i] * q[j]).sum();
            q[i] = (f64::from(u8::from(i == 0)) - known) / self.r[i][i];
        }
        self.back(&q)
    }
}
