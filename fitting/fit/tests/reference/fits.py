"""Fits by NumPy and SciPy, for tests/it/reproduction.rs.

Reads {"x": [...], "u": [...], "at": [...], "order": n, "support": s, "shape": a} from standard input: readings, of which several
may have one target, and places. Writes for each kind of curve its values at the places and its leave-one-out error over the
readings, every target left out with all of its readings. Nothing here is shared with the program: polynomials and Chebyshev series
are numpy.polynomial's, the monotone table is scipy's PCHIP, moving least squares are solved anew at every place, and the
spline is built from scipy's design matrix, its smoothing found by a bounded search of the generalised cross-validation.
"""

import json
import sys

import numpy as np
from scipy.interpolate import BSpline, PchipInterpolator
from scipy.optimize import minimize_scalar

given = json.load(sys.stdin)
x, u, at = (np.array(given[key], dtype=float) for key in ("x", "u", "at"))
order, support, shape = given["order"], given["support"], given["shape"]
domain = [x.min(), x.max()]


def means(x, u):
    targets = np.unique(x)
    return targets, np.array([u[x == t].mean() for t in targets])


def polynomial(x, u, at):
    return np.polynomial.Polynomial.fit(x, u, order, domain=domain)(at)


def chebyshev(x, u, at):
    return np.polynomial.Chebyshev.fit(x, u, order, domain=domain)(at)


def table(x, u, at):
    return PchipInterpolator(*means(x, u))(at)


def moving(x, u, at):
    nodes, values = means(x, u)
    half = support * (domain[1] - domain[0])
    found = []
    for place in np.atleast_1d(at):
        d = np.abs(nodes - place) / half
        w = np.where(d < 1.0, (np.exp(-((shape * d) ** 2)) - np.exp(-(shape**2))) / (1.0 - np.exp(-(shape**2))), 0.0)
        near = w > 0.0
        # A basis of its own at each place: powers of the distance.
        basis = np.vander((nodes[near] - place) / half, order + 1, increasing=True)
        root = np.sqrt(w[near])
        solution = np.linalg.lstsq(basis * root[:, None], values[near] * root, rcond=None)[0]
        found.append(solution[0])
    return np.array(found)


class Spline:
    """A cubic spline with as many segments as gaps between targets, and a penalty on second differences."""

    def __init__(self, x, u):
        self.targets, self.values = means(x, u)
        segments = len(self.targets) - 1
        step = (domain[1] - domain[0]) / segments
        self.knots = domain[0] + step * np.arange(-3, segments + 4)
        self.basis = self.design(self.targets)
        difference = np.diff(np.eye(self.basis.shape[1]), 2, axis=0)
        self.penalty = difference.T @ difference
        score = lambda log: self.score(10.0**log)
        starts = np.linspace(-8.0, 8.0, 161)
        best = starts[np.argmin([score(log) for log in starts])]
        log = minimize_scalar(score, bounds=(best - 0.1, best + 0.1), method="bounded", options={"xatol": 1e-6}).x
        self.weight = 10.0**log

    def design(self, at):
        inside = np.clip(at, domain[0], domain[1])
        return BSpline.design_matrix(inside, self.knots, 3).toarray()

    def hat(self, weight):
        return np.linalg.solve(self.basis.T @ self.basis + weight * self.penalty, self.basis.T)

    def score(self, weight):
        hat = self.basis @ self.hat(weight)
        left = self.values - hat @ self.values
        n = len(self.values)
        return n * (left @ left) / (n - np.trace(hat)) ** 2

    def values_at(self, at):
        return self.design(at) @ (self.hat(self.weight) @ self.values)

    def without(self, place):
        """The value at a target that is left out, with the smoothing of the whole."""
        keep = np.arange(len(self.targets)) != place
        basis = self.basis[keep]
        coefficients = np.linalg.solve(basis.T @ basis + self.weight * self.penalty, basis.T @ self.values[keep])
        return self.basis[place] @ coefficients


def left_out(curve, inner=False):
    squares, count = 0.0, 0
    targets = np.unique(x)
    for target in targets[1:-1] if inner else targets:
        own = x == target
        value = curve(x[~own], u[~own], np.array([target]))[0]
        squares += ((u[own] - value) ** 2).sum()
        count += own.sum()
    return float(np.sqrt(squares / count))


spline = Spline(x, u)
squares = sum(((u[x == t] - spline.without(place)) ** 2).sum() for place, t in enumerate(spline.targets))
answer = {
    "polynomial": [polynomial(x, u, at).tolist(), left_out(polynomial)],
    "chebyshev": [chebyshev(x, u, at).tolist(), left_out(chebyshev)],
    "table": [table(x, u, at).tolist(), left_out(table, inner=True)],
    "mls": [moving(x, u, at).tolist(), left_out(moving)],
    "bspline": [spline.values_at(at).tolist(), float(np.sqrt(squares / len(x)))],
}
json.dump(answer, sys.stdout)
