"""`calibrate`, `identify` and `compensate_nc`: what the program writes and prints, and files that must be refused."""

import json
import signal

import numpy as np
import pytest
import volcomp


@pytest.mark.parametrize(
    ("call", "command", "name"),
    [
        (volcomp.calibrate, "calibrate", "calibration/calibration.toml"),
        (volcomp.calibrate, "calibrate", "calibration/table-calibration.toml"),
        (volcomp.identify, "identify", "identification/observations.toml"),
    ],
)
def test_machine_and_document_are_those_of_the_program(examples, volcomp_json, tmp_path, call, command, name):
    path = tmp_path / "machine.toml"
    program = volcomp_json(command, examples / name, "-o", path)
    found = call(examples / name)
    machine = found.pop("machine")
    del program["file"]
    assert json.loads(json.dumps(found)) == program
    machine.save(tmp_path / "same.toml")
    assert (tmp_path / "same.toml").read_bytes() == path.read_bytes()


def test_identified_errors_are_in_the_machine(examples):
    found = volcomp.identify(examples / "identification/observations.toml")
    values = {of["name"]: of["value"] for of in found["parameters"]}
    # The squareness is one number, and leans Y by it.
    y_mm = np.array([0.0, 100.0])
    with_it = found["machine"].error({"Y": y_mm}, model="twist")["position_um"]
    assert "EC0Y" in found["machine"].errors and np.isfinite(with_it).all() and np.isfinite(values["EC0Y"])


@pytest.mark.parametrize("call", [volcomp.calibrate, volcomp.identify])
def test_files_that_are_wrong_are_refused_with_their_place(call, tmp_path, machine_file):
    with pytest.raises(FileNotFoundError) as missing:
        call(tmp_path / "none.toml")
    assert missing.value.filename == str(tmp_path / "none.toml")
    machine_file()
    path = tmp_path / "c.toml"
    path.write_text('machine = "machine.toml"\nmeasurment = 3\n')
    with pytest.raises(volcomp.InputError) as wrong:
        call(path)
    assert (wrong.value.file, wrong.value.line, wrong.value.key) == (str(path), 2, "measurment")


@pytest.mark.parametrize("name", ["part.ngc", "part.mpf", "part.h"])
def test_programs_are_those_of_the_program(examples, volcomp_json, tmp_path, name):
    setup = examples / "setup.toml"
    call = ["nc", examples / name, "-o", tmp_path / name, "-m", examples / "mill.toml", "--setup", setup]
    program = volcomp_json(*call)
    machine = volcomp.Machine.load(examples / "mill.toml")
    output = tmp_path / f"same-{name}"
    found = volcomp.compensate_nc(examples / name, output, machine, setup=setup)
    assert output.read_bytes() == (tmp_path / name).read_bytes() != (examples / name).read_bytes()
    assert found == {**program, "file": str(output)} and found["changed"] > 0


def test_a_straight_line_gets_the_correction_of_a_scale(machine_file, tmp_path):
    # 50 um/m: at X400 the scale is 20 um long.
    machine = volcomp.Machine.load(machine_file("EXX = { poly = [0.0, 0.05] }"))
    program, output = tmp_path / "a.ngc", tmp_path / "b.ngc"
    program.write_text("G21 G90 G54\nG0 X0 Y0 Z0\nG1 F500 X400 (end)\nM2\n")
    found = volcomp.compensate_nc(program, output, machine)
    assert output.read_text() == "G21 G90 G54\nG0 X0 Y0 Z0\nG1 F500 X399.980 (end)\nM2\n"
    assert (found["lines"], found["motions"], found["changed"], found["ended"]) == (4, 2, 1, True)


def test_programs_that_cannot_be_compensated_are_refused(machine_file, tmp_path):
    machine = volcomp.Machine.load(machine_file("EXX = { poly = [0.0, 0.05] }"))
    program, output = tmp_path / "a.ngc", tmp_path / "b.ngc"
    output.write_text("before")
    program.write_text("G21 G90\nG1 X1?2\n")
    with pytest.raises(volcomp.InputError) as wrong:
        volcomp.compensate_nc(program, output, machine)
    assert (wrong.value.file, wrong.value.line) == (str(program), 2)
    assert output.read_text() == "before" and sorted(p.name for p in tmp_path.iterdir()) == ["a.ngc", "b.ngc", "machine.toml"]
    with pytest.raises(FileNotFoundError):
        volcomp.compensate_nc(tmp_path / "none.ngc", output, machine)
    with pytest.raises(FileNotFoundError):
        volcomp.compensate_nc(program, output, machine, setup=tmp_path / "none.toml")
    for settings, says in [
        ({"dialect": "fanuc"}, 'dialect: found "fanuc"'),
        ({"tolerance_um": 0.0}, "tolerance_um: found 0"),
        ({"tolerance_um": float("nan")}, "tolerance_um: found NaN"),
        ({"limit_um": 1e9}, "limit_um: "),
        ({"temperatures_degc": {"room": 20.0}}, "expected none: the machine file has no thermal terms"),
    ]:
        with pytest.raises(volcomp.InputError, match=says):
            volcomp.compensate_nc(program, output, machine, **settings)
    with pytest.raises(volcomp.InputError, match="output: found .*a.ngc, which this call reads"):
        volcomp.compensate_nc(program, program, machine)
    program.write_text("G21 G90 G54\nG0 X0 Y0 Z0\nG1 F500 X400\n")
    with pytest.raises(volcomp.InputError, match="expected at most") as beyond:
        volcomp.compensate_nc(program, output, machine, limit_um=10.0)
    assert beyond.value.line == 3
    with pytest.raises(TypeError):
        volcomp.compensate_nc(program, output, str(program))


def test_a_signal_ends_the_compensation_of_a_long_program(machine_file, tmp_path):
    machine = volcomp.Machine.load(machine_file("EXX = { poly = [0.0, 0.05] }"))
    program, output = tmp_path / "a.ngc", tmp_path / "b.ngc"
    program.write_text("G21 G90 G54\nG0 X0 Y0 Z0\nG1 F500 X1\n" + "X400.5\nX0.25\n" * 300_000)

    class Stop(Exception):
        pass

    def stop(*_):
        raise Stop

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, 0.05)
    try:
        with pytest.raises(Stop):
            volcomp.compensate_nc(program, output, machine)
    finally:
        signal.signal(signal.SIGALRM, before)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.ngc", "machine.toml"]
