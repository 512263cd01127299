"""`Machine`: against formulas written out here, against the program, and with arguments that must be refused."""

import os
import re
import threading

import numpy as np
import pytest
import volcomp

AXES = "XYZ"


def sample(machine, count, seed=1):
    """Positions within the travels, by axis."""
    rng = np.random.default_rng(seed)
    return {axis: rng.uniform(low, high, count) for axis, (low, high) in machine.travels.items()}


def write_points(path, positions):
    rows = np.column_stack(list(positions.values()))
    np.savetxt(path, rows, delimiter=",", header=",".join(positions), comments="", fmt="%.17g")
    return path


def polynomials(seed):
    """The 18 error motions of three axes as polynomials: the lines of the file and the coefficients, um and urad."""
    rng = np.random.default_rng(seed)
    names = [f"E{component}{axis}" for axis in AXES for component in "XYZABC"]
    found = {name: rng.normal(size=3) * [3.0, 0.02, 1e-5] for name in names}
    return "\n".join(f"{name} = {{ poly = {c.tolist()} }}" for name, c in found.items()), found


@pytest.mark.parametrize("model", ["twist", "compiled"])
def test_first_order_error_is_the_sum_of_motions_with_their_levers(machine_file, model):
    lines, coefficients = polynomials(7)
    tip = np.array([120.0, 80.0, -150.0])
    machine = volcomp.Machine.load(machine_file(lines, tip=tip.tolist()))
    at = sample(machine, 500)
    x, y, z = (at[axis] for axis in AXES)
    zero = np.zeros_like(x)
    # What an axis carries ends at the tip: the motions of the axes after it, and the tool.
    levers_mm = {
        "X": np.column_stack([zero, y, z]) + tip,
        "Y": np.column_stack([zero, zero, z]) + tip,
        "Z": np.column_stack([zero, zero, zero]) + tip,
    }
    position_um, rotation_urad = np.zeros((500, 3)), np.zeros((500, 3))
    for axis in AXES:
        of = {c: np.polynomial.Polynomial(coefficients[f"E{c}{axis}"])(at[axis]) for c in "XYZABC"}
        shift_um = np.column_stack([of[c] for c in "XYZ"])
        tilt_urad = np.column_stack([of[c] for c in "ABC"])
        position_um += shift_um + 1e-3 * np.cross(tilt_urad, levers_mm[axis])
        rotation_urad += tilt_urad
    found = machine.error(at, model=model)
    # Compiled curves are within 1 nm and 1 nrad each; a nrad over half a metre is half a nm.
    within = 1e-9 if model == "twist" else 0.03
    np.testing.assert_allclose(found["position_um"], position_um, atol=within)
    np.testing.assert_allclose(found["rotation_urad"], rotation_urad, atol=within)
    assert found["outside_range"] == {} and found["outside_travel"] == {}


def test_squareness_leans_the_axis(machine_file):
    machine = volcomp.Machine.load(machine_file("EC0Y = 12.0"))
    y_mm = np.array([0.0, 250.0, 500.0])
    found = machine.error({"Y": y_mm}, model="twist")["position_um"]
    # 12 urad open the angle from X to Y: over y mm the tip moves by -12e-3 y um in X.
    np.testing.assert_allclose(found, np.outer(y_mm, [-0.012, 0.0, 0.0]), atol=1e-12)


@pytest.mark.parametrize("model", ["exact", "htm", "twist"])
@pytest.mark.parametrize("name", ["gantry", "five-axis"])
def test_errors_are_those_of_the_program(examples, volcomp_json, tmp_path, name, model):
    path = examples / f"{name}.toml"
    machine = volcomp.Machine.load(path)
    at = sample(machine, 60)
    at["X"][:5] += 9000.0
    calls = ["--machine", path, "--points", write_points(tmp_path / "p.csv", at), "--model", model]
    more = {}
    if name == "gantry":
        calls += ["--approach", "Z=-", "--temperature", "scale_x=23.5"]
        more = {"approach": {"Z": "-"}, "temperatures_degc": {"scale_x": 23.5}}
    rows = volcomp_json("error", *calls)["points"]
    found = machine.error(at, model=model, **more)
    for key in ["position_um", "rotation_urad"]:
        np.testing.assert_array_equal(found[key], [row[key] for row in rows])
    for key in ["outside_range", "outside_travel"]:
        for place, row in enumerate(rows):
            assert {name for name, flags in found[key].items() if flags[place]} == set(row[key])
    assert "EXX" in found["outside_range"] and found["outside_travel"]["X"].sum() == 5


def test_a_coordinate_beyond_a_turn_is_within_the_range_of_an_axis_with_modulo(examples):
    machine = volcomp.Machine.load(examples / "five-axis.toml")
    found = machine.error({"C": [-30.0, 330.0, 690.0, 5000.0]}, model="twist")
    np.testing.assert_allclose(found["position_um"][:3], found["position_um"][[0, 0, 0]], atol=1e-9)
    assert found["outside_range"] == {} and found["outside_travel"] == {}


@pytest.mark.parametrize("travel", [(0.0, 360.0), (0.0, 270.0), (-180.0, 180.0)])
def test_positions_outside_are_flagged_on_an_axis_with_modulo(machine_file, volcomp_json, tmp_path, travel):
    axis = f"[axes.C]\ntravel = {list(travel)}\nmodulo = 360.0\npoint = [0.0, 0.0, 0.0]\n"
    curve = "EZC = { table = [[0.0, 1.0], [90.0, 2.0], [180.0, 1.0]] }\n"
    path = machine_file(curve, structure="w C' b X Y Z t", more=axis)
    at = {"C": np.linspace(-400.0, 400.0, 161), "X": np.linspace(-10.0, 400.0, 161)}
    rows = volcomp_json("error", "-m", path, "--points", write_points(tmp_path / "p.csv", at))["points"]
    for part in [slice(None), slice(80, 100), slice(81, 82)]:
        found = volcomp.Machine.load(path).error({axis: q[part] for axis, q in at.items()})
        for key in ["outside_range", "outside_travel"]:
            for place, row in enumerate(rows[part]):
                assert {name for name, flags in found[key].items() if flags[place]} == set(row[key])


@pytest.mark.parametrize("name", ["gantry", "five-axis", "table-tilting"])
def test_the_compiled_form_is_the_first_order_one(examples, name):
    machine = volcomp.Machine.load(examples / f"{name}.toml")
    at = sample(machine, 3000)
    twist, compiled = (machine.error(at, model=model) for model in ["twist", "compiled"])
    for key in ["position_um", "rotation_urad"]:
        np.testing.assert_allclose(compiled[key], twist[key], atol=0.05)


@pytest.mark.parametrize("model", ["exact", "compiled"])
def test_many_positions_are_the_same_as_few(examples, model):
    machine = volcomp.Machine.load(examples / "gantry.toml")
    at = sample(machine, 20_001)
    at["Y"][15_000] = 5000.0
    whole = machine.error(at, model=model)
    for start in [0, 4000, 14_990, 20_000]:
        part = machine.error({axis: q[start : start + 20] for axis, q in at.items()}, model=model)
        for key in ["position_um", "rotation_urad"]:
            np.testing.assert_array_equal(whole[key][start : start + 20], part[key])
    assert np.flatnonzero(whole["outside_travel"]["Y"]).tolist() == [15_000]
    corrected = machine.correct(at)
    part = machine.correct({axis: q[14_990:15_010] for axis, q in at.items()})
    np.testing.assert_array_equal(corrected["correction"]["X"][14_990:15_010], part["correction"]["X"])


def test_positions_in_every_form_are_the_same(examples):
    machine = volcomp.Machine.load(examples / "gantry.toml")
    at = {axis: np.floor(q) for axis, q in sample(machine, 50).items()}
    x, y, z = (at[axis] for axis in AXES)
    expected = machine.error(at)["position_um"]
    rows = np.column_stack([x, y, z])
    zxy = np.column_stack([z, x, y])
    wide = np.zeros((100, 6))
    wide[::2, ::2] = rows
    packed = np.zeros(50, dtype=[("number", "u1"), ("X", "f8"), ("Y", "f8"), ("Z", "f8")])
    packed["X"], packed["Y"], packed["Z"] = x, y, z
    assert not packed["X"].flags.aligned
    forms = [
        ({"Z_mm": z, "Y": y, "X mm": x}, None),
        ({"X": x.astype(np.float32), "Y": y.astype(np.int64), "Z": z.astype(">f8")}, None),
        ({"X": x.tolist(), "Y": y, "Z": z[::-1][::-1]}, None),
        (rows, "XYZ"),
        (rows.tolist(), ("X", "Y", "Z")),
        (zxy, ["Z_mm", "X", "Y"]),
        (np.asfortranarray(rows), "XYZ"),
        (wide[::2, ::2], "XYZ"),
        ({axis: packed[axis] for axis in AXES}, None),
    ]
    for positions, axes in forms:
        np.testing.assert_array_equal(machine.error(positions, axes)["position_um"], expected)
    # A number stands for every position; axes that are not named are at 0.
    some = machine.error({"X": x, "Y": 250.0})["position_um"]
    same = machine.error({"X": x, "Y": np.full(50, 250.0), "Z": np.zeros(50)})["position_um"]
    np.testing.assert_array_equal(some, same)
    assert machine.error({"X": 1.0})["position_um"].shape == (1, 3)
    assert machine.error({"X": []})["position_um"].shape == (0, 3)
    assert machine.correct(np.empty((0, 3)), "XYZ")["correction"]["X"].shape == (0,)


ROWS = np.zeros((4, 3))


@pytest.mark.parametrize(
    ("positions", "axes", "kind", "says"),
    [
        (ROWS, None, TypeError, r'positions: found ndarray without axes, expected .*axes="XYZ"'),
        (5.0, None, TypeError, "positions: found float without axes"),
        ({"X": 1.0}, "X", ValueError, "axes: found it together with a mapping"),
        (ROWS, "XY", ValueError, r"positions: found shape \(4, 3\), expected \(n, 2\)"),
        (ROWS[0], "XYZ", ValueError, r"positions: found shape \(3,\), expected \(n, 3\)"),
        (ROWS, "", ValueError, r"positions: found shape \(4, 3\)"),
        (ROWS, "XYQ", ValueError, "axes: found 'Q', expected the letter of an axis"),
        (ROWS, "XYX", ValueError, "axis X twice"),
        (ROWS, ["X", "Y", 3], ValueError, "axes: found 3"),
        (ROWS, "XYC", ValueError, "has no axis C"),
        ({}, None, ValueError, "positions: found no axis"),
        ({"x": 1.0}, None, ValueError, "positions: found 'x'"),
        ({"X_in": 1.0}, None, ValueError, "positions: found 'X_in'"),
        ({"X": 1.0, "X_mm": 1.0}, None, ValueError, "axis X twice"),
        ({"X": [1.0, 2.0], "Y": [1.0]}, None, ValueError, r"positions\['Y'\]: found shape \(1,\), expected \(2,\)"),
        ({"X": ROWS}, None, ValueError, r"positions\['X'\].*found shape \(4, 3\), expected \(n,\)"),
        ({"X": [1.0, float("nan")]}, None, ValueError, r"axis X\[1\]: found NaN, expected a finite number"),
        ({"X": [1.0, 2.0], "Y": float("inf")}, None, ValueError, "axis Y: found inf"),
        ({"X": [-2e9]}, None, ValueError, r"axis X\[0\]: found -2000000000"),
        ({"X": [1j]}, None, TypeError, r"positions\['X'\]: found dtype complex128, expected real numbers"),
        ({"X": ["1"]}, None, TypeError, "found dtype <U1"),
        ({"X": [True]}, None, TypeError, "found dtype bool"),
        ({"X": None}, None, TypeError, "found dtype object"),
        ({"X": [[1.0], [1.0, 2.0]]}, None, ValueError, r"positions\['X'\]: found no array"),
        ({"X": np.ma.masked_equal([1.0, 2.0], 2.0)}, None, ValueError, "found masked values"),
        (ROWS, 3, TypeError, "axes: found int, expected the names of axes"),
    ],
)
def test_positions_that_are_wrong_or_ambiguous_are_refused(examples, positions, axes, kind, says):
    machine = volcomp.Machine.load(examples / "gantry.toml")
    for call in [machine.error, machine.correct]:
        with pytest.raises(kind, match=says):
            call(positions, axes)


def test_a_number_that_is_none_is_named_by_its_place_in_a_large_array(examples):
    machine = volcomp.Machine.load(examples / "gantry.toml")
    x = np.zeros(20_000)
    x[[12_345, 17_000]] = np.nan
    with pytest.raises(volcomp.InputError, match=r"axis X\[12345\]: found NaN"):
        machine.error({"X": x})


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda m: m.error({"X": 0.0}, model="Exact"), 'model: found "Exact"'),
        (lambda m: m.error({"X": 0.0}, approach={"X": 1}), r"approach\['X'\]: found 1"),
        (lambda m: m.error({"X": 0.0}, approach={"C": "+"}), "has no axis C"),
        (lambda m: m.error({"X": 0.0}, temperatures_degc={"room": 20.0}), 'found sensor "room", expected one of: scale_x'),
        (lambda m: m.error({"X": 0.0}, temperatures_degc={"scale_x": float("nan")}), "scale_x.*found NaN"),
        (lambda m: m.correct({"X": 0.0}, correct="XX"), "correct: found axis X twice"),
        (lambda m: m.correct({"X": 0.0}, correct="XC"), "has no axis C"),
        (lambda m: m.correct({"X": 0.0}, correct="x"), "correct: found 'x'"),
        (lambda m: m.map((2, 2, 0)), "counts: found a grid of 0 nodes"),
        (lambda m: m.map((1000, 1000, 1000)), "counts: found a grid of 1000000000 nodes"),
        (lambda m: m.map((10**9, 1, 1)), "nodes along an axis"),
        (lambda m: m.map(at={"X": 1.0}), "at: found X, expected other axes"),
        (lambda m: m.map(at={"C": 1.0}), "has no axis C"),
    ],
)
def test_other_arguments_that_are_wrong_are_refused(examples, call, says):
    with pytest.raises(volcomp.InputError, match=says):
        call(volcomp.Machine.load(examples / "gantry.toml"))


def test_correction_brings_the_tip_where_the_ideal_one_is(examples):
    machine = volcomp.Machine.load(examples / "gantry.toml")
    at = sample(machine, 300)
    found = machine.correct(at)
    assert found["converged"].all() and found["singular"].all()
    # On axes at right angles the ideal tip moves by the correction itself, so the error there is its opposite.
    left = machine.error({axis: found["corrected"][axis] for axis in AXES})["position_um"]
    correction = np.column_stack([found["correction"][axis] for axis in AXES])
    np.testing.assert_allclose(left + correction, 0.0, atol=1e-5)
    for axis in AXES:
        np.testing.assert_allclose(found["corrected"][axis], at[axis] + 1e-3 * found["correction"][axis], rtol=1e-14)


@pytest.mark.parametrize("correct", [None, "XYZ", ["Z"]])
def test_corrections_are_those_of_the_program(examples, volcomp_json, tmp_path, correct):
    path = examples / "five-axis.toml"
    machine = volcomp.Machine.load(path)
    at = sample(machine, 40)
    points = write_points(tmp_path / "p.csv", at)
    axes = ["--axes", ",".join(correct)] if correct else []
    rows = volcomp_json("correct", "--machine", path, "--points", points, *axes)["points"]
    found = machine.correct(at, correct=correct)
    for key in ["correction", "corrected"]:
        assert list(found[key]) == list(machine.travels)
        for axis, values in found[key].items():
            np.testing.assert_array_equal(values, [row[key][axis] for row in rows])
    for key in ["residual_um", "residual_axis_urad", "iterations", "converged", "singular", "near_singular"]:
        np.testing.assert_array_equal(found[key], [row[key] for row in rows])


def test_a_map_holds_the_errors_at_its_nodes(examples, volcomp_json):
    path = examples / "five-axis.toml"
    machine = volcomp.Machine.load(path)
    found = machine.map((5, 4, 3), at={"B": 30.0, "C": -90.0})
    assert found["axes"] == ["X", "Y", "Z"] and found["position_um"].shape == (5, 4, 3, 3)
    for axis, count in zip(AXES, (5, 4, 3)):
        np.testing.assert_allclose(found["nodes_mm"][axis], np.linspace(*machine.travels[axis], count))
    grid = np.meshgrid(*(found["nodes_mm"][axis] for axis in AXES), indexing="ij")
    at = {axis: nodes.ravel() for axis, nodes in zip(AXES, grid)}
    expected = machine.error({**at, "B": 30.0, "C": -90.0})
    for key in ["position_um", "rotation_urad"]:
        np.testing.assert_array_equal(found[key].reshape(-1, 3), expected[key])
    call = ["map", "--machine", path, "--grid", "5x4x3", "--at", "B=30,C=-90", "--exact"]
    program = volcomp_json(*call)
    sizes_um = np.linalg.norm(found["position_um"], axis=-1)
    assert sizes_um.max() == pytest.approx(program["largest_um"], rel=1e-12)
    assert np.sqrt(np.mean(sizes_um**2)) == pytest.approx(program["rms_um"], rel=1e-12)


def test_a_map_of_a_machine_without_z(examples):
    found = volcomp.Machine.load(examples / "two-axes.toml").map((3, 2, 7))
    assert found["axes"] == ["X", "Y"] and found["position_um"].shape == (3, 2, 3)


def test_what_the_file_states_is_readable(examples, tmp_path):
    machine = volcomp.Machine.load(examples / "five-axis.toml")
    assert machine.name == "five-axis-800" and machine.structure == "w C' X' b Y Z B t"
    assert machine.errors == sorted(machine.errors) and {"EXX", "EC0Y", "EX0C"} <= set(machine.errors)
    assert machine.travels["B"] == (-110.0, 110.0) and repr(machine) == "<Machine \"five-axis-800\": w C' X' b Y Z B t>"
    assert machine.sensors == [] and volcomp.Machine.load(examples / "gantry.toml").sensors == ["scale_x"]
    machine.save(tmp_path / "same.toml")
    assert (tmp_path / "same.toml").read_text() == machine.to_toml()
    same = volcomp.Machine.load(str(tmp_path / "same.toml"))
    at = sample(machine, 20)
    np.testing.assert_array_equal(machine.error(at)["position_um"], same.error(at)["position_um"])


def test_a_tool_is_chosen_by_name(examples):
    path = examples / "mill.toml"
    short, long = volcomp.Machine.load(path, tool="T5"), volcomp.Machine.load(path)
    # EBX, 0.05 urad/mm, acts on a lever that is 40 mm shorter.
    x_mm = np.array([600.0])
    found = long.error({"X": x_mm}, model="twist")["position_um"] - short.error({"X": x_mm}, model="twist")["position_um"]
    np.testing.assert_allclose(np.abs(found), [[30.0 * 0.040, 0.0, 0.0]], atol=1e-9)
    with pytest.raises(volcomp.InputError, match="has no tool `T6`, expected one of: T5"):
        volcomp.Machine.load(path, tool="T6")


def test_files_that_are_wrong_are_refused_with_their_place(machine_file, tmp_path):
    with pytest.raises(FileNotFoundError) as missing:
        volcomp.Machine.load(tmp_path / "none.toml")
    assert missing.value.filename == str(tmp_path / "none.toml")
    with pytest.raises(IsADirectoryError):
        volcomp.Machine.load(tmp_path)
    path = machine_file("EXX = { poly = [0.0, nan] }")
    with pytest.raises(volcomp.InputError) as wrong:
        volcomp.Machine.load(path)
    line = path.read_text().splitlines().index("EXX = { poly = [0.0, nan] }") + 1
    assert (wrong.value.file, wrong.value.line) == (str(path), line)
    assert wrong.value.key.startswith("errors.EXX") and str(wrong.value).startswith(f"{path}:{line}: errors.EXX")
    with pytest.raises(volcomp.InputError) as argument:
        volcomp.Machine.load(machine_file()).error({})
    assert (argument.value.file, argument.value.line, argument.value.key) == (None, None, None)
    for output, kind in [(tmp_path / "none/m.toml", FileNotFoundError), (tmp_path, volcomp.InputError)]:
        with pytest.raises(kind):
            volcomp.Machine.load(machine_file()).save(output)
    with pytest.raises(TypeError):
        volcomp.Machine.load(3)
    with pytest.raises(TypeError):
        volcomp.Machine()


def test_other_threads_run_during_a_call(examples):
    machine = volcomp.Machine.load(examples / "five-axis.toml")
    at = sample(machine, 100_000)
    counted, ended = [0], threading.Event()

    def count():
        while not ended.is_set():
            counted[0] += 1

    thread = threading.Thread(target=count)
    thread.start()
    before = counted[0]
    machine.correct(at)
    during = counted[0] - before
    ended.set()
    thread.join()
    # A call that held the interpreter would let no other thread count, but for the few places where it takes arguments over.
    assert during > 10_000


def test_a_forked_process_can_call_after_its_parent_did(examples):
    machine = volcomp.Machine.load(examples / "gantry.toml")
    at = sample(machine, 50_000)
    expected = machine.error(at, model="compiled")["position_um"].sum()
    child = os.fork()
    if child == 0:
        same = machine.error(at, model="compiled")["position_um"].sum() == expected
        os._exit(0 if same else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_no_argument_is_changed_and_results_are_writable(examples):
    machine = volcomp.Machine.load(examples / "gantry.toml")
    rows = np.column_stack(list(sample(machine, 10).values()))
    rows.flags.writeable = False
    found = machine.error(rows, list(machine.travels))["position_um"]
    found[:] = 0.0
    assert found.flags.c_contiguous and found.dtype == np.float64


def test_help_names_shapes_and_units():
    for call in [volcomp.Machine.error, volcomp.Machine.correct, volcomp.Machine.map, volcomp.fit, volcomp.read_measurements]:
        assert re.search(r"\(n, 3\)|\(n,\)|, 3\)", call.__doc__) and re.search(r"\bum\b|_um\b", call.__doc__), call
