"""Calibrate a milling machine from its measurement files, and look at what is left.

    python calibrate_a_mill.py

Reads the calibration in examples/calibration of the repository; writes calibrate_a_mill.toml and, with matplotlib, calibrate_a_mill.png
into the current folder.
"""

# %% The readings of one axis, evaluated by ISO 230-2 and fitted
import pathlib

import numpy as np
import volcomp

FOLDER = pathlib.Path(__file__).parents[2] / "examples/calibration"
readings = volcomp.read_measurements(FOLDER / "exx.csv", unit="um")
test = volcomp.iso230_2(readings)
print(f"EXX over {np.ptp(readings['target']):.0f} mm: E = {test['E_um']:.2f} µm")

x_mm = np.linspace(readings["target"].min(), readings["target"].max(), 101)
curve = volcomp.fit(readings, at=x_mm)
print(f"fitted {curve['curve']}, residual {curve['residual_um']['rms']:.3f} µm rms")

# %% All files together: Abbe errors removed, squareness from the straightness lines
found = volcomp.calibrate(FOLDER / "calibration.toml")
for row in found["curves"]:
    direction = row["direction"] or "both directions"
    print(f"{row['error']} ({direction}): {row['curve']}, residual {row['residual']['rms']:.3f} {row['unit']} rms")
for error, urad in found["squareness_urad"].items():
    print(f"{error}: {urad:.2f} µrad")
for warning in found["warnings"]:
    print("note:", warning)
machine = found["machine"]
machine.save("calibrate_a_mill.toml")

# %% The volumetric error, and what the correction leaves of it
field = machine.map((13, 9, 1))
size_um = np.linalg.norm(field["position_um"], axis=-1)
rng = np.random.default_rng(1)
positions = {axis: rng.uniform(*travel, 1000) for axis, travel in machine.travels.items()}
before_um = np.linalg.norm(machine.error(positions)["position_um"], axis=1)
correction = machine.correct(positions)
left_um = np.linalg.norm(correction["residual_um"], axis=1)
print(f"largest error of 1000 positions: {before_um.max():.2f} µm, after correction {left_um.max():.2e} µm (of the model)")
assert correction["converged"].all() and left_um.max() < 1e-3

# %% Plots
try:
    import matplotlib
except ImportError:
    print("no plots: matplotlib is not installed")
else:
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
    left.plot(readings["target"], readings["deviation_um"], "o", label="readings")
    left.plot(x_mm, curve["values"]["value_um"], label="curve")
    if "band" in curve:
        band, at = curve["band"], curve["band"]["at"]
        middle = np.interp(at, x_mm, curve["values"]["value_um"])
        left.fill_between(at, middle - band["half_width"], middle + band["half_width"], alpha=0.3, label="95 % band")
    left.set(xlabel="X, mm", ylabel="EXX, µm", title="Positioning of X")
    left.legend()
    nodes = field["nodes_mm"]
    drawn = right.contourf(nodes["X"], nodes["Y"], size_um[:, :, 0].T)
    right.set(xlabel="X, mm", ylabel="Y, mm", title=f"Position error at Z = {nodes['Z'][0]:.0f} mm")
    figure.colorbar(drawn, label="µm")
    figure.savefig("calibrate_a_mill.png", dpi=120)
