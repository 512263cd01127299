"""Identify the errors of a five-axis machine from a tracker, a sphere, a ballbar and a diagonal.

    python identify_five_axes.py

Reads examples/identification of the repository; writes identify_five_axes.toml and, with matplotlib, identify_five_axes.png into the
current folder.
"""

# %% Identification: values, uncertainties, and what the observations leave open
import pathlib

import numpy as np
import volcomp

FOLDER = pathlib.Path(__file__).parents[2] / "examples/identification"
found = volcomp.identify(FOLDER / "observations.toml")
errors = [of for of in found["parameters"] if of["name"][0] == "E"]
for of in errors:
    uncertainty = "not determined" if of["uncertainty"] is None else f"± {of['uncertainty']:.2f}"
    print(f"{of['name']:>24} {of['value']:9.2f} {uncertainty} {of['unit']}")
counted = len(found["parameters"]) - len(found["redundant"])
print(f"rank {found['rank']} of {counted}, residual {found['residual_um']['rms']:.2f} µm rms")
print(f"poses that were not fitted: {found['judged_um']['rms']:.2f} µm rms in three dimensions")
assert found["judged_um"]["rms"] < 3.0 * max(found["residual_um"]["rms"], 5.0)
for warning in found["warnings"]:
    print("note:", warning)

# %% The machine with these errors: before and after correction
machine = found["machine"]
machine.save("identify_five_axes.toml")
machine = volcomp.Machine.load("identify_five_axes.toml", tool="probe")
rng = np.random.default_rng(1)
positions = {axis: rng.uniform(*travel, 2000) for axis, travel in machine.travels.items()}
error = machine.error(positions)
before_um = np.linalg.norm(error["position_um"], axis=1)
correction = machine.correct(positions, correct="XYZ")
left_um = np.linalg.norm(correction["residual_um"], axis=1)
print(f"2000 poses of all axes: largest {before_um.max():.1f} µm, after correction by X, Y, Z {left_um.max():.2e} µm (of the model)")
tilt_urad = np.linalg.norm(correction["residual_axis_urad"], axis=1)
print(f"tilt of the tool axis that X, Y and Z cannot correct: up to {tilt_urad.max():.1f} µrad")
assert left_um.max() < 1e-3

# %% Plots
try:
    import matplotlib
except ImportError:
    print("no plots: matplotlib is not installed")
else:
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 5), layout="constrained")
    determined = [of for of in errors if of["uncertainty"] is not None]
    places = np.arange(len(determined))
    values = np.array([of["value"] for of in determined])
    widths = 2.0 * np.array([of["uncertainty"] for of in determined])
    left.errorbar(values, places, xerr=widths, fmt="o", capsize=2)
    left.set_yticks(places, [of["name"] for of in determined], fontsize=6)
    left.set(xlabel="µm or µrad, ±2 standard uncertainties", title="Identified errors")
    right.hist(before_um, bins=40)
    right.set(xlabel="position error, µm", ylabel="poses", title="2000 poses of all axes")
    figure.savefig("identify_five_axes.png", dpi=120)
