"""Volumetric error of machine tools: measure, model, correct.

Linear axes are in mm, rotary axes in deg, errors in um and urad, temperatures in degC.
"""

from collections.abc import Mapping, Sequence
from os import PathLike
from typing import Any, Literal, TypedDict

import numpy as np
import numpy.typing as npt

__version__: str

_Floats = npt.NDArray[np.float64]
_Bools = npt.NDArray[np.bool_]
_Path = str | PathLike[str]
_Model = Literal["exact", "htm", "twist", "compiled"]
_Positions = Mapping[str, npt.ArrayLike] | npt.ArrayLike
_Axes = str | Sequence[str]
_Approach = dict[str, Literal["+", "-"]]
_Data = _Path | Mapping[str, Any]
_Unit = Literal["mm", "um", "nm", "inch", "deg", "arcsec", "rad", "mrad", "urad"]

class InputError(ValueError):
    """An argument or the content of a file is invalid; each attribute is None where it does not apply."""

    file: str | None
    line: int | None
    key: str | None

class VolumetricError(TypedDict):
    position_um: _Floats
    """(n, 3): actual minus ideal tip along X, Y, Z."""
    rotation_urad: _Floats
    """(n, 3): rotation of the tool about X, Y, Z."""
    outside_range: dict[str, _Bools]
    """Error -> (n,): its curve is evaluated outside its range."""
    outside_travel: dict[str, _Bools]
    """Axis -> (n,): it is outside its travel."""

class Correction(TypedDict):
    correction: dict[str, _Floats]
    """Axis -> (n,): um of linear, urad of rotary axes, to be added to the command."""
    corrected: dict[str, _Floats]
    """Axis -> (n,): command plus correction, mm or deg."""
    residual_um: _Floats
    """(n, 3): error of the tip that remains."""
    residual_axis_urad: _Floats
    """(n, 3): error of the tool axis that remains."""
    iterations: npt.NDArray[np.uint64]
    converged: _Bools
    singular: _Bools
    near_singular: _Bools
    outside_range: dict[str, _Bools]
    outside_travel: dict[str, _Bools]

class Map(TypedDict):
    axes: list[str]
    nodes_mm: dict[str, _Floats]
    position_um: _Floats
    """(count of the first axis, ..., 3), in the order of `axes`."""
    rotation_urad: _Floats
    outside_range: dict[str, _Bools]
    outside_travel: dict[str, _Bools]

class Machine:
    """A machine tool with its measured errors."""

    @staticmethod
    def load(path: _Path, tool: str | None = None) -> Machine: ...
    def save(self, path: _Path) -> None: ...
    def to_toml(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def structure(self) -> str: ...
    @property
    def travels(self) -> dict[str, tuple[float, float]]: ...
    @property
    def errors(self) -> list[str]: ...
    @property
    def sensors(self) -> list[str]: ...
    @property
    def notes(self) -> list[str]: ...
    def error(
        self,
        positions: _Positions,
        axes: _Axes | None = None,
        *,
        approach: _Approach | None = None,
        temperatures_degc: dict[str, float] | None = None,
        model: _Model = "exact",
    ) -> VolumetricError: ...
    def correct(
        self,
        positions: _Positions,
        axes: _Axes | None = None,
        *,
        correct: _Axes | None = None,
        approach: _Approach | None = None,
        temperatures_degc: dict[str, float] | None = None,
    ) -> Correction: ...
    def map(
        self,
        counts: tuple[int, int, int] = (11, 11, 11),
        *,
        at: dict[str, float] | None = None,
        approach: _Approach | None = None,
        temperatures_degc: dict[str, float] | None = None,
        model: _Model = "exact",
    ) -> Map: ...

def read_measurements(path: _Path, unit: _Unit | None = None) -> dict[str, Any]: ...
def iso230_2(
    data: _Data, *, unit: _Unit | None = None, edition: Literal[1997, 2006, 2014] = 2014
) -> dict[str, Any]: ...
def fit(
    data: _Data,
    *,
    method: Literal["auto", "poly", "chebyshev", "mls", "bspline", "table"] = "auto",
    order: int | None = None,
    support: float | None = None,
    shape: float | None = None,
    residual: float | None = None,
    at: npt.ArrayLike | None = None,
    unit: _Unit | None = None,
) -> dict[str, Any]: ...
def calibrate(calibration: _Path) -> dict[str, Any]: ...
def identify(observations: _Path) -> dict[str, Any]: ...
def compensate_nc(
    program: _Path,
    output: _Path,
    machine: Machine,
    *,
    setup: _Path | None = None,
    subroutines: Sequence[_Path] | None = None,
    dialect: Literal["rs274", "siemens", "heidenhain"] | None = None,
    tolerance_um: float = 1.0,
    limit_um: float = 250.0,
    temperatures_degc: dict[str, float] | None = None,
) -> dict[str, Any]: ...
