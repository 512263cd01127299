"""Whatever an argument is, a call returns or raises an ordinary exception: no panic crosses into Python."""

import numpy as np
import pytest
import volcomp

NAN = float("nan")
ANYTHING = [
    *(None, True, 0, 3, -1, 10**9, 10**30, 1e308, -0.0, NAN, float("inf"), 1j),
    *("", "x", "X", "+", "a\0b", "\ud800", "µ" * 5000, b"x", "/", "/dev/null"),
    *([], {}, (), set(), object(), print, iter([1.0]), range(3), (2, 2, 2), (0, 0, 0), (10**9, 10**9, 10**9)),
    *([NAN], ["X"], [[1.0], []], {"X": NAN}, {"X": [1e308]}, {"X": None}, {1: 2}, {"X": {}}, {"C": 1.0}, {"scale_x": 1e9}),
    *(np.zeros(0), np.zeros((2, 2)), np.zeros((0, 3)), np.array("x"), np.array([None]), np.array(1.0), np.float32(2.0)),
    np.zeros(3, dtype=[("X", float)]),
    np.broadcast_to(1.0, (5, 3)),
    np.full(3, NAN),
    np.array(["2020-01-01"], dtype="datetime64[D]"),
]
READINGS = {"target": [0.0, 1.0, 2.0, 3.0], "run": [1] * 4, "direction": [1] * 4, "deviation_um": [0.0, 1.0, 0.0, 2.0], "target_unit": "deg"}


def calls(examples):
    machine = volcomp.Machine.load(examples / "gantry.toml")
    positions = {"X": [1.0, 2.0], "Y": 3.0}
    rows = np.zeros((2, 3))
    more = {"approach": {"Z": "+"}, "temperatures_degc": {"scale_x": 20.0}}
    part = {"program": examples / "part.ngc", "output": "out.ngc", "machine": volcomp.Machine.load(examples / "mill.toml")}
    return [
        (volcomp.Machine.load, {"path": examples / "mill.toml", "tool": "T5"}),
        (machine.save, {"path": "m.toml"}),
        (machine.error, {"positions": positions, **more, "model": "compiled"}),
        (machine.error, {"positions": rows, "axes": "XYZ"}),
        (machine.correct, {"positions": positions, "correct": "XY", **more}),
        (machine.map, {"counts": (2, 2, 2), "at": None, **more, "model": "twist"}),
        (volcomp.read_measurements, {"path": examples / "calibration/exx.csv", "unit": "um"}),
        (volcomp.iso230_2, {"data": READINGS, "unit": None, "edition": 1997}),
        *((volcomp.iso230_2, {"data": {**READINGS, key: None}}) for key in READINGS),
        *((volcomp.fit, {"data": READINGS, "method": method, "at": [1.0]}) for method in ["auto", "bspline", "table"]),
        (volcomp.fit, {"data": READINGS, "method": "auto", "residual": 1.0}),
        (volcomp.fit, {"data": READINGS, "method": "mls", "order": 1, "support": 1.0, "shape": 2.0}),
        *((volcomp.fit, {"data": READINGS, "method": method, "order": 1}) for method in ["poly", "chebyshev"]),
        (volcomp.calibrate, {"calibration": examples / "calibration/table-calibration.toml"}),
        (volcomp.identify, {"observations": "none.toml"}),
        (
            volcomp.compensate_nc,
            {**part, "setup": examples / "setup.toml", "subroutines": [], "dialect": "rs274", "tolerance_um": 1.0, "limit_um": 200.0},
        ),
    ]


# NumPy 1 warns of arrays that are taken for numbers.
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_no_argument_makes_a_panic(examples, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    raised = 0
    for call, arguments in calls(examples):
        for name, value in arguments.items():
            tried = [value] if not isinstance(value, dict) else [{**value, key: other} for key in value for other in ANYTHING]
            for other in [*ANYTHING, *tried]:
                try:
                    call(**{**arguments, name: other})
                except (TypeError, ValueError, OSError, OverflowError, MemoryError):
                    raised += 1
    assert raised > 1000


@pytest.mark.parametrize("values", [[1e300, -1e300, 1e300, 0.0], [5e-324] * 4, [1e9, -1e9, 1e9, 1e9]])
def test_no_readings_make_a_panic(values):
    for key in ["target", "deviation_um"]:
        for call in [volcomp.fit, volcomp.iso230_2]:
            try:
                call({**READINGS, key: values})
            except ValueError:
                pass
