"""The type stubs say what the module has, and the examples run."""

import ast
import inspect
import pathlib
import subprocess
import sys

import pytest
import volcomp

FOLDER = pathlib.Path(__file__).parents[1]


def parameters(function):
    """Names, kinds and defaults of a function of the stubs."""
    arguments = function.args
    given = [(a.arg, "POSITIONAL_OR_KEYWORD") for a in arguments.args]
    defaults = [inspect.Parameter.empty] * (len(given) - len(arguments.defaults))
    defaults += [ast.literal_eval(default) for default in arguments.defaults]
    found = [(name, kind, default) for (name, kind), default in zip(given, defaults)]
    for argument, default in zip(arguments.kwonlyargs, arguments.kw_defaults):
        value = inspect.Parameter.empty if default is None else ast.literal_eval(default)
        found.append((argument.arg, "KEYWORD_ONLY", value))
    return found


def test_stubs_are_those_of_the_module():
    stubs = ast.parse((FOLDER / "volcomp.pyi").read_text())
    functions = {node.name: node for node in stubs.body if isinstance(node, ast.FunctionDef)}
    classes = {node.name: node for node in stubs.body if isinstance(node, ast.ClassDef)}
    public = {name for name in dir(volcomp) if not name.startswith("_")} - {"volcomp"}
    typed = {name for name, node in classes.items() if any(getattr(b, "id", "") == "TypedDict" for b in node.bases)}
    assert public == set(functions) | (set(classes) - typed)
    pairs = [(getattr(volcomp, name), node) for name, node in functions.items()]
    methods = {node.name: node for node in classes["Machine"].body if isinstance(node, ast.FunctionDef)}
    assert set(methods) == {name for name in dir(volcomp.Machine) if not name.startswith("_")}
    for name, node in methods.items():
        if any(getattr(decorator, "id", "") == "property" for decorator in node.decorator_list):
            continue
        pairs.append((getattr(volcomp.Machine, name), node))
    for function, node in pairs:
        real = inspect.signature(function).parameters.values()
        found = [(p.name, p.kind.name, p.default) for p in real if p.name != "self"]
        assert [p for p in parameters(node) if p[0] != "self"] == found, node.name
        assert function.__doc__, node.name


def test_the_package_is_typed():
    folder = pathlib.Path(volcomp.__file__).parent
    assert (folder / "py.typed").exists()
    assert (folder / "__init__.pyi").read_text() == (FOLDER / "volcomp.pyi").read_text()


@pytest.mark.parametrize("name", ["calibrate_a_mill", "identify_five_axes"])
def test_the_examples_run(name, tmp_path):
    call = [sys.executable, FOLDER / "examples" / f"{name}.py"]
    done = subprocess.run(call, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "µm" in done.stdout and (tmp_path / f"{name}.toml").exists()


def test_the_readme_runs(tmp_path, monkeypatch):
    text = (FOLDER / "README.md").read_text()
    code = text.split("```python\n")[1].split("```")[0]
    monkeypatch.chdir(FOLDER.parent)
    code = code.replace('"part-compensated.ngc"', repr(str(tmp_path / "part.ngc")))
    code = code.replace('"found.toml"', repr(str(tmp_path / "found.toml")))
    exec(compile(code, "README.md", "exec"), {})
    assert {path.name for path in tmp_path.iterdir()} == {"part.ngc", "found.toml"}
