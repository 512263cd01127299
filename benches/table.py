"""Prints the table of the compiled evaluator from criterion's estimates and the other programs' numbers."""

import json
import pathlib
import sys


def main():
    criterion, others = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2])

    def ns(*path):
        """Median of one benchmark; of those over many poses, a pose."""
        folder = criterion.joinpath(*path, "new")
        median = json.loads((folder / "estimates.json").read_text())["median"]["point_estimate"]
        throughput = json.loads((folder / "benchmark.json").read_text())["throughput"] or {}
        return median / throughput.get("Elements", 1)

    numbers = dict(line.split() for line in others.read_text().splitlines())
    rows = []

    def row(work, against, ours, theirs, goal, at_least=True):
        ratio = theirs / ours if at_least else ours / theirs
        met = ratio >= goal if at_least else ratio <= goal
        sign = ">=" if at_least else "<="
        rows.append((work, against, f"{ours:.1f}", f"{theirs:.1f}", f"{ratio:.2f}", f"{sign} {goal}", "yes" if met else "no"))

    for machine in ("gantry_mls", "gantry_poly6"):
        one = ns(f"one_pose_{machine}", "compiled")
        row(f"one pose, {machine}", "exact on curves", one, ns(f"one_pose_{machine}", "exact_on_curves"), 30)
        row(f"one pose, {machine}", "4x4 products", one, ns(f"one_pose_{machine}", "products"), 8)
    five = ns("correction_five_axis", "compiled_first_order")
    row("correction, five axes", "exact, Newton", five, ns("correction_five_axis", "exact_newton_on_curves"), 20)
    row("correction, five axes", "products", five, ns("correction_five_axis", "products_first_order"), 5)
    for machine in ("gantry_mls", "gantry_poly6"):
        batch = ns(f"scattered_{machine}", "batch")
        row(f"scattered, {machine}", "one-pose path", batch, ns(f"scattered_{machine}", "one_pose_path"), 2)
        row(f"scattered, {machine}", "copy", batch, ns(f"scattered_{machine}", "copy"), 4, at_least=False)
    fill = ns("grid", "fill_one_core") / 1e6
    row("grid, ms", "plain stores", fill, ns("grid", "plain_stores") / 1e6, 1.3, at_least=False)
    row("grid on 2 cores, ms", "1 core", ns("grid", "fill_all_cores") / 1e6, fill, 1.8)
    node = fill * 1e6 / 203**3
    for name in ("numpy_every_node", "numpy_shared"):
        if name in numbers:
            row("grid, ns a node", name, node, float(numbers[name]), 200)
    if "pinocchio" in numbers:
        row("one pose, five axes", "pinocchio", ns("one_pose_five_axis", "compiled"), float(numbers["pinocchio"]), 2)
    latencies = (f"{m} {ns(f'one_pose_{m}', 'latency'):.1f}" for m in ("gantry_mls", "gantry_poly6", "five_axis"))

    print("| work | against | ours, ns | theirs, ns | ratio | goal | met |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for cells in rows:
        print("| " + " | ".join(cells) + " |")
    patches = (f"{n} {ns('patches', n):.1f}" for n in ("0", "1", "6"))
    print(f"\nOne pose, ns, with so many errors over two coordinates: {', '.join(patches)}")
    print(f"\nLatency of one pose, ns: {', '.join(latencies)}")


main()
