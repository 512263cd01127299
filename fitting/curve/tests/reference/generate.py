"""Golden values of SciPy for the monotone cubic and the B-spline.

Run with SciPy installed: python generate.py > scipy.csv
Rows: kind, case, x, value, derivative. Nodes and knots stand in the rows before them, so that the
test reads nothing but this file.
"""

import numpy as np
import scipy
from scipy.interpolate import BSpline, PchipInterpolator

random = np.random.default_rng(20)
print(f"# SciPy {scipy.__version__}")


def row(kind, case, *numbers):
    print(",".join([kind, case] + [repr(float(n)) for n in numbers]))


tables = {
    "two": [[0, 1], [3, 5]],
    "three": [[0, 0], [1, 2], [4, 2.5]],
    "flat": [[0, 1], [1, 1], [2, 3], [5, 3], [6, 2]],
    "overshoot": [[0, 0], [1, 0.1], [2, 10], [3, -4], [7, -4.1]],
    "irregular": np.column_stack(
        [np.cumsum(random.uniform(10, 400, 21)), random.normal(0, 20, 21)]
    ).tolist(),
}
for name, nodes in tables.items():
    for x, u in nodes:
        row("node", name, x, u)
    x, u = np.array(nodes, float).T
    curve = PchipInterpolator(x, u)
    for at in np.linspace(x[0], x[-1], 38):
        row("pchip", name, at, curve(at), curve(at, 1))

for degree in range(1, 6):
    for name, inner in {
        "clamped": [1.0, 2.5, 4.0, 4.5],
        "repeated": [2.0, 2.0, 3.0] if degree > 2 else [2.0, 3.0],
    }.items():
        name = f"{name}{degree}"
        knots = np.array([0.0] * (degree + 1) + inner + [6.0] * (degree + 1))
        if name.startswith("clamped"):
            knots[:degree] -= np.arange(degree, 0, -1) * 0.7
        coefficients = random.normal(0, 10, len(knots) - degree - 1)
        for k in knots:
            row("knot", name, k)
        for c in coefficients:
            row("coefficient", name, c)
        spline = BSpline(knots, coefficients, degree)
        for at in np.linspace(0.0, 6.0, 32):
            row("bspline", name, at, spline(at), spline(at, 1))
