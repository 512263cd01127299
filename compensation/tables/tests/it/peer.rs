//! Look-up and stated error, compared with SciPy's `RegularGridInterpolator`.

use std::{fmt::Write, process::Command};

use volcomp_tables::{GRID_AXES, HEADER_WORDS, Position, build};
use volcomp_test_support::peers;

use crate::world::request;

const PROGRAM: &str = r#"
import json, sys
import numpy as np
from scipy.interpolate import RegularGridInterpolator
task = json.load(sys.stdin)
lines = [np.array(axis) for axis in task["lines"]]
values = np.array(task["values"]).reshape([len(axis) for axis in lines] + [task["outputs"]])
inside = RegularGridInterpolator(lines, values, method="linear")
print(json.dumps(inside(np.array(task["points"])).tolist()))
"#;

fn field(at: &[f64; GRID_AXES]) -> [f64; 3] {
    let [x, y, z] = [at[0], at[1], at[2]].map(|x| x / 1000.0);
    [
        0.06 * (3.0 * x).sin() * (0.5 + y) + 0.02 * z * z,
        0.04 * (2.0 * y + x).cos() - 0.03 * x * z,
        0.05 * x * y * z + 0.02 * (4.0 * z).sin(),
    ]
}

#[test]
fn look_up_and_error_match_scipy() {
    let Some(python) = peers::python() else {
        return;
    };
    let table = build(&request(3, 3, 1.0), &field).expect("a map");
    let header = table.map.header();
    let lines: Vec<String> = header.lines[..3]
        .iter()
        .map(|lines| {
            let at: Vec<String> = (0..lines.count).map(|line| lines.at(line).to_string()).collect();
            format!("[{}]", at.join(","))
        })
        .collect();
    let parts_in_mm = 0.001 / f64::from(header.scale);
    let values: Vec<String> = table.map.words()[HEADER_WORDS..]
        .iter()
        .map(|word| (f64::from(word.cast_signed()) * parts_in_mm).to_string())
        .collect();
    let positions: Vec<[i32; 3]> = (0..4000_i64)
        .map(|number| [7919, 104_729, 1_299_709].map(|step| (number * step % 1_000_001) as i32))
        .collect();
    let mut points = String::new();
    for [x, y, z] in &positions {
        let [x, y, z] = [x, y, z].map(|steps| f64::from(*steps) * 1e-3);
        write!(points, "[{x},{y},{z}],").expect("a string");
    }
    let task = format!(
        "{{\"lines\":[{}],\"values\":[{}],\"outputs\":3,\"points\":[{}]}}",
        lines.join(","),
        values.join(","),
        points.trim_end_matches(',')
    );
    let folder = std::env::temp_dir().join(format!("volcomp-tables-{}", std::process::id()));
    std::fs::write(&folder, task).expect("written");
    let output = Command::new(python)
        .args(["-c", PROGRAM])
        .stdin(std::fs::File::open(&folder).expect("there"))
        .output()
        .expect("runs");
    std::fs::remove_file(&folder).expect("removed");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let answer = String::from_utf8(output.stdout).expect("text");
    let numbers: Vec<f64> = answer
        .split(['[', ']', ',', ' ', '\n'])
        .filter(|word| !word.is_empty())
        .map(|word| word.parse().expect("a number"))
        .collect();
    assert_eq!(numbers.len(), 3 * positions.len());
    // Half a part per axis, plus half a digit along each axis times the steepest slope.
    let slope = table.steepest;
    let places: f64 =
        header.lines[..3].iter().map(|lines| 0.5 * f64::from(lines.part) * 1e-3).sum();
    let close_mm = 1.5 * parts_in_mm + 3.0_f64.sqrt() * slope * places + 1e-9;
    let mut largest_mm = 0.0_f64;
    for (at, scipy) in positions.iter().zip(numbers.chunks_exact(3)) {
        let mut position = Position::default();
        position.steps[..3].copy_from_slice(at);
        let found = table.map.correction_mm(&position);
        let mut coordinates = [0.0; GRID_AXES];
        for (into, steps) in coordinates.iter_mut().zip(at) {
            *into = f64::from(*steps) * 1e-3;
        }
        let wanted = field(&coordinates);
        let mut square = 0.0;
        for output in 0..3 {
            assert!(
                (found[output] - scipy[output]).abs() <= close_mm,
                "{at:?}: {found:?}, {scipy:?}"
            );
            square += (scipy[output] - wanted[output]).powi(2);
        }
        largest_mm = largest_mm.max(square.sqrt());
    }
    // SciPy's interpolation error on the same values is within the stated one and not far below.
    let stated = table.misfit.max_mm;
    assert!(largest_mm <= stated + close_mm, "{largest_mm}, stated {stated}");
    assert!(largest_mm > 0.5 * stated, "{largest_mm}, stated {stated}");
}
