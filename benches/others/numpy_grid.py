"""The error of a three-axis machine over a tensor grid with NumPy: 4x4 products, vectorised.

Prints nanoseconds a node, twice: with every joint's matrices built and multiplied at every node, as a
vectorised chain is usually written, and with the products of the first two joints shared along Z.
"""

import time

import numpy as np

COUNTS = (61, 61, 61)
TRAVELS = (8000.0, 4000.0, 2500.0)


def small(e):
    """Error matrices from (n, 6) errors in mm and rad."""
    m = np.zeros(e.shape[:-1] + (4, 4))
    m[..., range(4), range(4)] = 1.0
    m[..., 0, 1], m[..., 0, 2], m[..., 1, 2] = -e[..., 5], e[..., 4], -e[..., 3]
    m[..., 1, 0], m[..., 2, 0], m[..., 2, 1] = e[..., 5], -e[..., 4], e[..., 3]
    m[..., :3, 3] = e[..., :3]
    return m


def slide(axis, q):
    m = np.zeros(q.shape + (4, 4))
    m[..., range(4), range(4)] = 1.0
    m[..., axis, 3] = q
    return m


def joints(errors, coordinates):
    """Actual and ideal joints of `w X' b Y Z t`."""
    for axis, (e, q) in enumerate(zip(errors, coordinates)):
        ideal = slide(axis, q)
        error = small(e)
        yield (error @ ideal if axis == 0 else ideal @ error), ideal


def error_of(actual, ideal):
    position = actual[..., :3, 3] - ideal[..., :3, 3]
    turned = actual[..., :3, :3] @ np.swapaxes(ideal[..., :3, :3], -1, -2)
    rotation = 0.5 * np.stack(
        [
            turned[..., 2, 1] - turned[..., 1, 2],
            turned[..., 0, 2] - turned[..., 2, 0],
            turned[..., 1, 0] - turned[..., 0, 1],
        ],
        axis=-1,
    )
    return np.concatenate([position, rotation], axis=-1)


def at_every_node(errors, nodes):
    mesh = np.meshgrid(*nodes, indexing="ij")
    index = np.meshgrid(*(np.arange(len(n)) for n in nodes), indexing="ij")
    errors = [e[i.ravel()] for e, i in zip(errors, index)]
    actual = ideal = np.eye(4)
    for a, i in joints(errors, [m.ravel() for m in mesh]):
        actual, ideal = actual @ a, ideal @ i
    return error_of(actual, ideal)


def shared(errors, nodes):
    (ax, ix), (ay, iy), (az, iz) = joints(errors, nodes)
    actual = (ax[:, None] @ ay[None, :])[:, :, None] @ az[None, None, :]
    ideal = (ix[:, None] @ iy[None, :])[:, :, None] @ iz[None, None, :]
    return error_of(actual, ideal)


def best_ns(work):
    times = []
    for _ in range(5):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times) / np.prod(COUNTS) * 1e9


def main():
    rng = np.random.default_rng(1)
    nodes = [np.linspace(0.0, travel, count) for travel, count in zip(TRAVELS, COUNTS)]
    size = np.array([0.02] * 3 + [30e-6] * 3)
    errors = [rng.uniform(-1.0, 1.0, (count, 6)) * size for count in COUNTS]
    every, once = at_every_node(errors, nodes), shared(errors, nodes)
    assert np.allclose(every.ravel(), once.ravel(), atol=1e-12)
    print(f"numpy_every_node {best_ns(lambda: at_every_node(errors, nodes)):.1f}")
    print(f"numpy_shared {best_ns(lambda: shared(errors, nodes)):.1f}")


main()
