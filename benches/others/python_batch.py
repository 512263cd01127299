"""What a million positions take from Python, next to the same batch of the Rust library: each of them anew, in turns.

    python benches/others/python_batch.py [PROFILE] [MACHINE ...]

Needs the package `volcomp` in this Python and the Rust example `million_positions` in the folder of that profile (default: release).
"""

import os
import pathlib
import re
import statistics
import subprocess
import sys
import time

import numpy as np
import volcomp

ROOT = pathlib.Path(__file__).parents[2]
TARGET = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
POSITIONS, REPEATS, TURNS = 1_000_000, 21, 5


def python_ms(machine, axes, positions):
    times = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        machine.error(positions, axes, model="compiled")
        times.append(1e3 * (time.perf_counter() - begin))
    return statistics.median(times)


def rust_ms(program, path):
    said = subprocess.run([program, path], capture_output=True, text=True, check=True).stdout
    return float(re.match(r"[\d.]+", said)[0])


profile, *files = sys.argv[1:] or ["release"]
program = TARGET / profile / "examples/million_positions"
for file in files or ["examples/first.toml", "examples/gantry.toml", "examples/five-axis.toml"]:
    machine = volcomp.Machine.load(ROOT / file)
    number = np.arange(POSITIONS)
    columns = {}
    for index, (axis, (low, high)) in enumerate(machine.travels.items()):
        columns[axis] = low + (high - low) * (number * np.sqrt(index + 2.0) % 1.0)
    rows, axes = np.column_stack(list(columns.values())), list(columns)
    turns = [(rust_ms(program, file), python_ms(machine, axes, rows), python_ms(machine, None, columns)) for _ in range(TURNS)]
    rust, array, by_axis = (statistics.median(times) for times in zip(*turns))
    print(f"{file}: Rust {rust:.1f} ms, Python {array:.1f} ms (an array, ratio {array / rust:.2f}), {by_axis:.1f} ms (a dict, ratio {by_axis / rust:.2f})")
