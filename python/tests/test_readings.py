"""Readings, ISO 230-2 and curves: against formulas and NumPy's own fits, and against the program."""

import csv

import numpy as np
import pytest
import volcomp


def bidirectional(runs=5, targets=9, seed=3):
    """Readings as columns, and the same as an array (direction, run, target)."""
    rng = np.random.default_rng(seed)
    at = np.sort(rng.uniform(0.0, 800.0, targets))
    readings = 0.01 * at + np.array([0.0, 4.0])[:, None, None] + rng.normal(scale=0.6, size=(2, runs, targets))
    direction, run, place = np.meshgrid([1, -1], np.arange(1, runs + 1), np.arange(targets), indexing="ij")
    columns = {
        "target": at[place].ravel(),
        "run": run.ravel(),
        "direction": direction.ravel(),
        "deviation_um": readings.ravel(),
    }
    return columns, at, readings


def write_csv(path, columns):
    rows = zip(columns["target"], columns["run"], columns["direction"], columns["deviation_um"])
    with open(path, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["target mm", "run", "direction", "deviation µm"])
        writer.writerows([repr(float(t)), r, "+" if d > 0 else "-", repr(float(u))] for t, r, d, u in rows)
    return path


def test_iso_230_2_is_what_the_standard_writes():
    columns, _, readings = bidirectional()
    found = volcomp.iso230_2(columns)
    mean, s = readings.mean(axis=1), readings.std(axis=1, ddof=1)
    reversal = mean[0] - mean[1]
    both = np.maximum(2 * s[0] + 2 * s[1] + np.abs(reversal), np.maximum(4 * s[0], 4 * s[1]))
    upper, lower = mean + 2 * s, mean - 2 * s
    expected = {
        "A_um": upper.max() - lower.min(),
        "A_forward_um": upper[0].max() - lower[0].min(),
        "A_backward_um": upper[1].max() - lower[1].min(),
        "R_um": both.max(),
        "R_forward_um": 4 * s[0].max(),
        "R_backward_um": 4 * s[1].max(),
        "E_um": mean.max() - mean.min(),
        "E_forward_um": np.ptp(mean[0]),
        "E_backward_um": np.ptp(mean[1]),
        "M_um": np.ptp(mean.mean(axis=0)),
        "B_um": np.abs(reversal).max(),
        "mean_B_um": reversal.mean(),
    }
    for key, value in expected.items():
        assert found[key] == pytest.approx(value, rel=1e-12), key
    assert found["unit"] == "um" and len(found["targets"]) == 9
    one_run = volcomp.iso230_2({"target": [0.0, 1.0], "deviation_urad": [3.0, -1.0]})
    assert one_run["A_urad"] is None and one_run["E_forward_urad"] == 4.0 and one_run["unit"] == "urad"


def test_a_title_that_names_a_straightness_is_not_evaluated_as_positioning(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text(
        "Title: EXY straightness\nTarget Mean error forward (um) Mean error reverse (um) System mean 2 sigma forward "
        "2 sigma reverse Dead zone\n1 0.0 0.0 1.0 0.5 0.2 0.2 1.0\n2 100.0 2.0 3.0 2.5 0.2 0.2 1.0\n"
    )
    with pytest.raises(volcomp.InputError, match="which names EXY, a straightness; expected positioning"):
        volcomp.iso230_2(path)
    assert volcomp.iso230_2(volcomp.read_measurements(path))["unit"] == "um"


def test_a_file_is_the_same_as_its_columns_and_as_the_program(volcomp_json, tmp_path):
    columns, _, _ = bidirectional()
    path = write_csv(tmp_path / "exx.csv", columns)
    read = volcomp.read_measurements(path)
    assert read["file"] == str(path) and read["target_unit"] == "mm"
    for key, values in columns.items():
        np.testing.assert_array_equal(read[key], values)
    program = volcomp_json("iso230", path)
    for data in [path, str(path), read]:
        found = volcomp.iso230_2(data)
        for key in [key for key in found if key.endswith("_um")] + ["unit", "targets", "hints", "edition"]:
            assert found[key] == program[key], key
    at = [10.0, 333.25, 900.0]
    for method, settings in [
        ("auto", {}),
        ("auto", {"residual": 2.5}),
        ("poly", {"order": 2}),
        ("chebyshev", {"order": 3}),
        ("mls", {"order": 2, "support": 0.8, "shape": 2.0}),
        ("bspline", {}),
        ("table", {}),
    ]:
        options = [part for key, value in settings.items() for part in (f"--{key}", value)]
        program = volcomp_json("fit", path, "--method", method, *options, "--at", ",".join(map(str, at)))
        for data in [path, read]:
            found = volcomp.fit(data, method=method, at=at, **settings)
            for key in ["unit", "curve", "residual_um"]:
                assert found[key] == program[key], (method, key)
            for key in ["leave_one_out_um", "choice", "meets_required"]:
                assert found.get(key) == program.get(key), (method, key)
            for key in ["at", "value_um", "outside_range"]:
                assert found["values"][key].tolist() == [row[key] for row in program["values"]]
            assert ("band" in found) == ("band" in program)
            if "band" in found:
                assert found["band"]["from"] == program["band"]["from"]
                for key in ["at", "half_width"]:
                    assert found["band"][key].tolist() == [row[key] for row in program["band"]["half_widths"]]


def test_files_of_instruments_are_read(examples):
    for name in ["exx-z0.rtl", "eay.rta", "eyx.rts", "ezz.pos", "exy.txt", "ebx.csv"][:5]:
        found = volcomp.read_measurements(examples / "from-files/gantry/lasers" / name)
        deviation = found.get("deviation_um", found.get("deviation_urad"))
        assert ("deviation_urad" in found) == name.endswith(".rta")
        assert found["target"].shape == found["run"].shape == found["direction"].shape == deviation.shape
        assert set(found["direction"].tolist()) <= {1, -1} and found["run"].min() == 1


def test_polynomials_are_those_of_numpy():
    columns, at, readings = bidirectional(seed=11)
    mean = readings.mean(axis=(0, 1))
    places = np.linspace(at[0], at[-1], 40)
    for method in ["poly", "chebyshev"]:
        found = volcomp.fit(columns, method=method, order=3, at=places)
        expected = np.polynomial.Polynomial.fit(at, mean, 3)
        np.testing.assert_allclose(found["values"]["value_um"], expected(places), atol=1e-9)
        left = mean - expected(at)
        assert found["residual_um"]["rms"] == pytest.approx(np.sqrt(np.mean(left**2)), rel=1e-9)
        np.testing.assert_allclose(found["target"], at)
        np.testing.assert_allclose(found["mean_um"], mean, atol=1e-12)
        # Leave-one-out by leaving each out.
        errors = []
        for place in range(len(at)):
            others = np.arange(len(at)) != place
            without = np.polynomial.Polynomial.fit(at[others], mean[others], 3)
            errors.append(mean[place] - without(at[place]))
        assert found["leave_one_out_um"] == pytest.approx(np.sqrt(np.mean(np.square(errors))), rel=1e-7)
    table = volcomp.fit(columns, method="table", at=at)
    np.testing.assert_allclose(table["values"]["value_um"], mean, atol=1e-12)


GOOD = {"target": [0.0, 1.0, 2.0], "deviation_um": [0.0, 1.0, 0.5]}


@pytest.mark.parametrize(
    ("data", "kind", "says"),
    [
        (3, TypeError, "data: found .*int.*, expected a path or a mapping"),
        ({"target": [0.0]}, ValueError, "found neither of deviation_um and deviation_urad"),
        ({**GOOD, "deviation_urad": [0.0] * 3}, ValueError, "found both of deviation_um and deviation_urad"),
        ({"deviation_um": [0.0]}, ValueError, "data: found no target"),
        ({**GOOD, "target": [0.0, 1.0]}, ValueError, r"deviation: found shape \(3,\), expected \(2,\)"),
        ({**GOOD, "run": [1]}, ValueError, r"run: found shape \(1,\), expected \(3,\)"),
        ({**GOOD, "run": [1, 0, 1]}, ValueError, r"run\[1\]: found 0, expected a whole number from 1"),
        ({**GOOD, "direction": [1, 2, 1]}, ValueError, r"direction\[1\]: found 2, expected \+1 or -1"),
        ({**GOOD, "target_unit": "in"}, ValueError, "target_unit: found 'in'"),
        ({**GOOD, "deviation_um": [0.0, float("nan"), 1.0]}, ValueError, r"deviation_um\[1\]: found NaN"),
        ({**GOOD, "deviation_um": np.zeros((3, 1))}, ValueError, r"deviation_um: found shape \(3, 1\), expected \(n,\)"),
        ({**GOOD, "deviation_um": ["a", "b", "c"]}, TypeError, "deviation_um: found dtype <U1"),
        ({"target": [], "deviation_um": []}, ValueError, "one reading at least"),
    ],
)
def test_readings_that_are_wrong_are_refused(data, kind, says):
    for call in [volcomp.fit, volcomp.iso230_2]:
        with pytest.raises(kind, match=says):
            call(data)


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"method": "spline"}, 'method: found "spline", expected one of auto'),
        ({"order": 2}, 'order: found it with method="auto"'),
        ({"method": "poly", "support": 0.5}, "support: found it with"),
        ({"method": "poly", "residual": 0.5}, "residual: found it with"),
        ({"method": "poly", "order": 7}, "data: found 3 different targets"),
        ({"unit": "um"}, "unit: found it together with columns"),
        ({"at": [0.0, float("inf")]}, r"at\[1\]: found inf"),
        ({"at": np.zeros((2, 2))}, r"at: found shape \(2, 2\)"),
    ],
)
def test_settings_that_are_wrong_are_refused(settings, says):
    with pytest.raises(volcomp.InputError, match=says):
        volcomp.fit(GOOD, **settings)


def test_files_that_are_wrong_are_refused_with_their_place(tmp_path):
    with pytest.raises(FileNotFoundError):
        volcomp.read_measurements(tmp_path / "none.csv")
    with pytest.raises(volcomp.InputError) as wrong:
        volcomp.read_measurements(tmp_path / "none.docx")
    assert wrong.value.file.endswith("none.docx")
    path = tmp_path / "exx.csv"
    path.write_text("target,deviation\n0,1\n100,x\n")
    with pytest.raises(volcomp.InputError) as wrong:
        volcomp.read_measurements(path)
    assert (wrong.value.file, wrong.value.line) == (str(path), 3) and "deviation" in wrong.value.key
    path.write_text("target,deviation\n0,1\n100,2\n")
    for call in [volcomp.read_measurements, volcomp.iso230_2, volcomp.fit]:
        with pytest.raises(volcomp.InputError, match='unit of the deviations is not stated, expected unit="um"'):
            call(path)
    assert volcomp.read_measurements(path, "mm")["deviation_um"].tolist() == [1000.0, 2000.0]
    assert "deviation_urad" in volcomp.read_measurements(path, unit="arcsec")
    with pytest.raises(volcomp.InputError, match='unit: found "furlong"'):
        volcomp.read_measurements(path, unit="furlong")
    path.write_text("target,deviation µm\n0,1\n100,2\n")
    with pytest.raises(volcomp.InputError, match="found deviations in .*, expected .*unit=\"mm\""):
        volcomp.read_measurements(path, unit="mm")
    with pytest.raises(volcomp.InputError, match="edition: found 1988"):
        volcomp.iso230_2(path, edition=1988)
