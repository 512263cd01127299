"""The features of volcomp-metrology by SciPy: what the tests compare with.

  form.py FEATURE < points        points as rows x y z; the answer as numbers in one line

circle     (in xy) LS centre x y, radius; minimum zone by linear programs (HiGHS) about better and better centres
plane      LS roundoff-free normal by SVD: flatness; minimum zone by a linear program in the frame of the normal
cylinder   LS radius, range of the distances, axis
cone       LS half angle, range of the distances, apex
"""

import sys

import numpy as np
from scipy.optimize import least_squares, linprog

TIGHT = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15, "max_nfev": 2000}


def minimax(rows, b):
    """The least largest |b - rows x|, and x, as a linear program."""
    n, d = rows.shape
    ones = np.ones((n, 1))
    a = np.block([[-rows, -ones], [rows, -ones]])
    bound = np.concatenate([-b, b])
    options = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}
    result = linprog(np.r_[np.zeros(d), 1.0], A_ub=a, b_ub=bound, bounds=[(None, None)] * (d + 1), options=options)
    return result.x[d], result.x[:d]


def circle(p):
    def distances(v):
        return np.hypot(p[:, 0] - v[0], p[:, 1] - v[1]) - v[2]

    start = [p[:, 0].mean(), p[:, 1].mean(), 0.5 * np.ptp(p[:, 0])]
    fit = least_squares(distances, start, **TIGHT)
    centre = fit.x[:2]
    for _ in range(20):
        beside = p[:, :2] - centre
        r = np.hypot(*beside.T)
        # In micrometres of the radius, so that the tolerance of the solver is far below it.
        _, x = minimax(np.column_stack([np.ones(len(p)), beside / r[:, None]]), 1e3 * (r - r.mean()))
        centre = centre + x[1:] / 1e3
    return [*fit.x, np.ptp(distances(fit.x)), np.ptp(np.hypot(*(p[:, :2] - centre).T)), *centre]


def plane(p):
    q = p - p.mean(axis=0)
    _, _, v = np.linalg.svd(q, full_matrices=False)
    flatness = np.ptp(q @ v[2])
    for _ in range(5):
        size = np.abs(q).max()
        _, x = minimax(np.column_stack([np.ones(len(p)), q @ v[0] / size, q @ v[1] / size]), 1e3 * (q @ v[2]))
        normal = v[2] - (x[1] * v[0] + x[2] * v[1]) / (1e3 * size)
        normal /= np.linalg.norm(normal)
        first = np.cross(normal, v[1])
        first /= np.linalg.norm(first)
        v = np.array([first, np.cross(normal, first), normal])
    return [flatness, np.ptp(q @ v[2])]


def revolved(p, psi_free):
    """Least squares over angles of the axis from many starts; unlike the program it has no frame on the axis."""
    mean = p.mean(axis=0)
    q = p - mean

    def distances(v):
        w = np.array([np.sin(v[0]) * np.cos(v[1]), np.sin(v[0]) * np.sin(v[1]), np.cos(v[0])])
        beside = np.cross(q - v[2:5], w)
        r = np.sqrt((beside**2).sum(axis=1))
        s = (q - v[2:5]) @ w
        psi = v[6] if psi_free else 0.0
        # The point on the axis is held near the mean.
        return np.r_[r * np.cos(psi) - s * np.sin(psi) - v[5], v[2:5] @ w]

    best = None
    for theta in np.linspace(0.15, np.pi - 0.15, 6):
        for phi in np.linspace(0.1, np.pi, 6):
            start = [theta, phi, 0, 0, 0, np.abs(q).max() / 2] + ([0.1] if psi_free else [])
            fit = least_squares(distances, start, method="lm", **TIGHT)
            if fit.x[5] > 0 and (best is None or fit.cost < best.cost):
                best = fit
    v = best.x
    w = np.array([np.sin(v[0]) * np.cos(v[1]), np.sin(v[0]) * np.sin(v[1]), np.cos(v[0])])
    form = np.ptp(best.fun[: len(q)])
    if not psi_free:
        return [v[5], form, *w]
    return [abs(v[6]), form, *(mean + v[2:5] - w * v[5] / np.sin(v[6]))]


points = np.loadtxt(sys.stdin)
answer = {
    "circle": circle,
    "plane": plane,
    "cylinder": lambda p: revolved(p, False),
    "cone": lambda p: revolved(p, True),
}[sys.argv[1]](points)
print(*(repr(float(x)) for x in answer))
