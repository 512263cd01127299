"""Writes truth.toml: a gantry with irregular error curves of the sizes published for one, 10.1177/0954405416645985.

Every curve is a sum of a few waves, the shortest 2 travels / 9 long: longer than two intervals of 21
targets (2 travels / 20). Positioning X 58.6 um, of which a polynomial of order 6 leaves about 5 um; Y 42 um
at Z = 1050 and 68 um at Z = 650 through the beam's pitch, which is nearly linear in Y; Z 36.6 um; straightness EYX 19,
EZX 33, EXY 34, EZY 50 um.

    python3 make_truth.py > truth.toml
"""

import math
import random

TRAVEL = {"X": 8000.0, "Y": 4000.0, "Z": 2500.0}
# Sizes of the waves of X and Z, um.
X_WAVE, Z_WAVE = 9.5, 8.0
SHORTEST = 9  # half waves over the travel
DEGREE = 40


class Wave:
    """A sum of half waves over a travel, without the straight line of its 61 points."""

    def __init__(self, seed, roughness):
        rng = random.Random(seed)
        self.terms = [
            (k, rng.gauss(0.0, 1.0) / k**roughness, rng.uniform(0.0, 2.0 * math.pi))
            for k in range(1, SHORTEST + 1)
        ]

    def __call__(self, t):
        """The value at t from -1 to 1."""
        return sum(a * math.cos(0.5 * math.pi * k * (t + 1.0) + phase) for k, a, phase in self.terms)


POINTS = [2.0 * i / 60.0 - 1.0 for i in range(61)]


def spread(f):
    values = [f(t) for t in POINTS]
    return max(values) - min(values)


def straightened(f):
    """f without its least-squares line."""
    mean = sum(map(f, POINTS)) / 61.0
    slope = sum(t * f(t) for t in POINTS) / sum(t * t for t in POINTS)
    return lambda t: f(t) - mean - slope * t


def scaled(f, to):
    by = to / spread(f)
    return lambda t: by * f(t)


def chebyshev(f, travel):
    """The Chebyshev series of f, exact to the digits written."""
    n = DEGREE + 1
    nodes = [math.pi * (i + 0.5) / n for i in range(n)]
    series = []
    for k in range(n):
        c = 2.0 / n * sum(f(math.cos(x)) * math.cos(k * x) for x in nodes)
        series.append(c / 2.0 if k == 0 else c)
    while len(series) > 1 and abs(series[-1]) < 5e-7:
        series.pop()
    # Zero at the start of travel, where a laser is set to zero.
    series[0] -= sum(c * (-1) ** k for k, c in enumerate(series))
    text = ", ".join(f"{c:.6f}" for c in series)
    return f"{{ chebyshev = [{text}], domain = [0.0, {travel}] }}"


def rising(wave, end):
    """A wave on a straight line."""
    return lambda t: wave(t) + end * (t + 1.0) / 2.0


def pitch_and_positioning():
    """EAY and EYY that give 42 um at Z = 1050 and 68 um at Z = 650: EYY - 1e-3 EAY z."""
    high = scaled(rising(scaled(Wave(22, 0.6), 14.0), 36.0), 42.0)
    bend = rising(scaled(Wave(24, 1.6), 1.5), 40.0)
    least, most = 0.0, 10.0
    while most - least > 1e-12:
        by = 0.5 * (least + most)
        low = lambda t: high(t) + 1e-3 * by * bend(t) * (1050.0 - 650.0)
        least, most = (by, most) if spread(low) < 68.0 else (least, by)
    pitch = lambda t: by * bend(t)
    return pitch, lambda t: high(t) + 1e-3 * pitch(t) * 1050.0


def lever(tilt, arm_mm):
    """um that a tilt in urad adds over a constant lever in mm."""
    return lambda t: 1e-3 * tilt(t) * arm_mm


def travelled(tilt, travel):
    """um that a tilt adds over the travelled distance."""
    return lambda t: 1e-3 * tilt(t) * travel * (t + 1.0) / 2.0


def combined(f, *others):
    """f plus each (sign, curve)."""
    return lambda t: f(t) + sum(sign * g(t) for sign, g in others)


def main():
    pitch, positioning_y = pitch_and_positioning()
    eax, ebx, ecx = (scaled(Wave(seed, 1.3), size) for seed, size in ((14, 8.0), (15, 12.0), (16, 10.0)))
    eby = scaled(Wave(25, 1.3), 16.0)
    # The sizes are those of the lines as measured: at Y = 2000, Z = 1050 the tool, over the table that
    # moves along X under it, sees the table's tilts over the levers (x, 2000, 1050).
    eyx, ezx, exy, ezy = 19.0, 33.0, 34.0, 50.0
    curves = {
        "EXX": combined(
            scaled(rising(scaled(Wave(41, 0.1), X_WAVE), -40.0), 58.6),
            (-1, lever(ebx, 1050.0)), (1, lever(ecx, 2000.0)),
        ),
        "EYX": combined(
            scaled(straightened(Wave(12, 0.9)), eyx),
            (-1, travelled(ecx, 8000.0)), (1, lever(eax, 1050.0)),
        ),
        "EZX": combined(
            scaled(straightened(Wave(13, 0.9)), ezx),
            (-1, lever(eax, 2000.0)), (1, travelled(ebx, 8000.0)),
        ),
        "EAX": eax,
        "EBX": ebx,
        "ECX": ecx,
        "EXY": combined(scaled(straightened(Wave(21, 0.9)), exy), (-1, lever(eby, 1050.0))),
        "EYY": positioning_y,
        "EZY": scaled(straightened(Wave(23, 0.9)), ezy),
        "EAY": pitch,
        "EBY": eby,
        "ECY": scaled(Wave(26, 1.3), 14.0),
        "EXZ": scaled(straightened(Wave(31, 1.1)), 19.0),
        "EYZ": scaled(straightened(Wave(32, 1.1)), 23.0),
        "EZZ": scaled(rising(scaled(Wave(33, 0.7), Z_WAVE), 30.0), 36.6),
        "EAZ": scaled(Wave(34, 1.3), 12.0),
        "EBZ": scaled(Wave(35, 1.3), 13.0),
        "ECZ": scaled(Wave(36, 1.3), 10.0),
    }
    print("# The gantry of `volcomp demo` as it really is; written by make_truth.py.")
    print('name = "demo-gantry"')
    print("structure = \"w X' b Y Z t\"\n")
    for axis, travel in TRAVEL.items():
        print(f"[axes.{axis}]\ntravel = [0.0, {travel}]")
    print("\n[tool]\ntip = [0.0, 0.0, 0.0]\n\n[errors]")
    for name, curve in curves.items():
        series = chebyshev(curve, TRAVEL[name[-1]])
        if name in ("EXX", "EYY", "EZZ"):
            reversal = {"X": 3.0, "Y": -2.0, "Z": 2.5}[name[-1]]
            series = f"{{ mean = {series}, reversal = {reversal} }}"
        print(f"{name} = {series}")
    print("EC0Y = 18.0\nEA0Z = -11.0\nEB0Z = 14.0")


main()
