"""Shared by the tests: the repository's examples, and the program `volcomp`, whose JSON the module is compared with."""

import json
import os
import pathlib
import subprocess

import pytest

ROOT = pathlib.Path(__file__).parents[2]
PROGRAM = os.environ.get("VOLCOMP", ROOT / "target/debug/volcomp")


@pytest.fixture
def examples():
    return ROOT / "examples"


@pytest.fixture
def volcomp_json():
    """Runs the program and returns its JSON document."""

    def run(*arguments):
        call = [str(part) for part in (PROGRAM, "--json", *arguments)]
        done = subprocess.run(call, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return run


@pytest.fixture
def machine_file(tmp_path):
    """Writes a three-axis machine with the given lines of [errors]."""

    def write(errors="", structure="w b X Y Z t", more="", tip=(120.0, 80.0, -150.0)):
        path = tmp_path / "machine.toml"
        axes = "".join(f"[axes.{axis}]\ntravel = [0.0, 500.0]\n" for axis in "XYZ")
        tool = f"[tool]\ntip = {list(tip)}\n"
        path.write_text(f'name = "test"\nstructure = "{structure}"\n{axes}{tool}{more}[errors]\n{errors}\n')
        return path

    return write
