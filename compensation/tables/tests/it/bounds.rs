//! The error bound, compared with closed forms.

use std::fmt::Write;
use std::process::Command;

use volcomp_tables::vocabulary::Direction;
use volcomp_tables::{
    Field, GRID_AXES, HEADER_WORDS, OUTPUTS, Position, Request, Table, TablesError, build,
};
use volcomp_test_support::peers;

use crate::world::request;

/// Maximum rounding error with 64 parts of 1 µm, mm: half a part for the value, and half a part for each axis.
fn rounding_mm(axes: usize, outputs: usize) -> f64 {
    0.5 * (1.0 + axes as f64) * (outputs as f64).sqrt() * 0.001 / 64.0
}

/// Maximum error by rounding the position within a cell, mm: half a digit along each axis, times the steepest slope.
fn places_mm(table: &Table) -> f64 {
    let header = table.map.header();
    let lines = header.lines[..header.grid.count()].iter();
    let places: f64 = lines.map(|lines| 0.5e-3 * f64::from(lines.part)).sum();
    table.steepest * places
}

fn counts(table: &Table) -> Vec<u16> {
    let header = table.map.header();
    header.lines[..header.grid.count()].iter().map(|lines| lines.count).collect()
}

#[test]
fn a_product_is_exact_on_two_lines() {
    // 100 µm at the far corner, linear along each axis: two lines per axis suffice.
    let field = |at: &[f64; GRID_AXES]| [0.1 * at[0] * at[1] * at[2] * 1e-9, 0.0, 0.0];
    let table = build(&request(3, 1, 0.1), &field).expect("a map");
    assert_eq!(counts(&table), [2, 2, 2]);
    assert!(table.misfit.max_mm <= rounding_mm(3, 1) + places_mm(&table), "{:?}", table.misfit);
    assert_eq!(table.map.words().len(), HEADER_WORDS + 8);
    // 100 µm over 1000 mm, at the far sides.
    assert!((table.steepest - 1e-4).abs() < 1e-6);
}

#[test]
fn a_square_needs_as_many_lines_as_its_second_derivative_says() {
    // f'' = 8·peak/L², so the error between lines h apart is h²/8·f'' = peak·(h/L)²: 80 µm over 1000 mm with a bound of 1 µm needs
    // sqrt(80) = 8.94 gaps, hence nine.
    let field = |at: &[f64; GRID_AXES]| [0.08 * (at[0] / 1000.0).powi(2) * 4.0, 0.0, 0.0];
    for within_um in [4.0, 1.0, 0.3] {
        let table = build(&request(1, 1, within_um), &field).expect("a map");
        let gaps = f64::from(counts(&table)[0] - 1);
        let h = 1000.0 / gaps;
        let closed_mm = h * h / 8.0 * (8.0 * 0.08 / 1e6);
        let rounding = rounding_mm(1, 1) + places_mm(&table);
        assert!(
            (table.misfit.max_mm - closed_mm).abs() <= rounding + 1e-6,
            "{within_um}: {:?}, {closed_mm}",
            table.misfit
        );
        assert!(table.misfit.max_mm <= within_um * 1e-3);
        let needed = (80.0 / within_um).sqrt().ceil();
        assert!(gaps >= needed && gaps <= 1.3 * needed + 1.0, "{within_um}: {gaps}, {needed}");
    }
}

#[test]
fn the_rms_is_that_of_a_parabola() {
    // Between two lines x(h - x)·f''/2: maximum h²/8·f'', mean square (h²·f'')²/120, so rms/max = sqrt(8/15).
    let field = |at: &[f64; GRID_AXES]| [0.2 * (at[0] / 1000.0).powi(2), 0.0, 0.0];
    let mut wanted = request(1, 1, 5.0);
    wanted.words = 100;
    let table = build(&wanted, &field).expect("a map");
    let ratio = table.misfit.rms_mm / table.misfit.max_mm;
    assert!((ratio - (8.0_f64 / 15.0).sqrt()).abs() < 0.02, "{ratio}");
    // The maximum is half-way between two lines.
    let lines = &table.map.header().lines[0];
    let gap = (table.misfit.at[0] - lines.at(0)) / (lines.at(1) - lines.at(0));
    assert!((gap.fract() - 0.5).abs() < 0.2, "{gap}");
}

#[test]
fn a_jump_between_the_lines_is_found() {
    // A peak 3 mm wide, not at a power-of-two lattice point: the bound must hold there too, or the request is rejected.
    let field = |at: &[f64; GRID_AXES]| {
        let from = (at[0] - 377.3) / 3.0;
        [0.02 * (-from * from).exp(), 0.0, 0.0]
    };
    match build(&request(1, 1, 1.0), &field) {
        Ok(table) => {
            for step in 370_000..385_000 {
                let mut position = Position::default();
                position.steps[0] = step;
                let found = table.map.correction_mm(&position)[0];
                let wanted = field(&[f64::from(step) * 1e-3, 0.0, 0.0, 0.0, 0.0])[0];
                assert!((found - wanted).abs() < 1.3e-3, "{step}: {found}, {wanted}");
            }
        }
        Err(TablesError::Memory { .. }) => {}
        Err(other) => panic!("{other}"),
    }
}

#[test]
fn a_memory_shortage_states_the_words_needed() {
    let field = |at: &[f64; GRID_AXES]| {
        let wave = |x: f64| 0.03 * (x / 400.0).sin();
        [wave(at[0]), wave(at[1]), wave(at[2])]
    };
    let mut wanted = request(3, 3, 0.8);
    wanted.words = 1000;
    let refused = build(&wanted, &field).expect_err("three waves of 2.5 m");
    let TablesError::Memory {
        needed: Some(needed), reached_um: Some(reached_um), words: 1000, ..
    } = refused
    else {
        panic!("{refused}")
    };
    assert!(reached_um > 0.8, "{reached_um}");
    let said = refused.to_string();
    assert!(said.starts_with("0.8 µm need ") && said.contains("lines along X "), "{said}");
    // Both numbers in the message are reached: the words for this bound, and the error in this memory.
    wanted.words = needed;
    let table = build(&wanted, &field).expect("as many words as it takes");
    assert!(table.map.words().len() <= needed && table.misfit.max_mm <= 0.0008);
    wanted.words = 1000;
    wanted.within_mm = 1.05 * reached_um * 1e-3;
    let table = build(&wanted, &field).expect("the error that it said");
    assert!(table.map.words().len() <= 1000);
    // The memory is too small for any map.
    wanted.words = 60;
    let refused = build(&wanted, &field).expect_err("no room");
    assert!(matches!(refused, TablesError::Memory { reached_um: None, .. }), "{refused}");
}

#[test]
fn invalid_requests_are_refused() {
    type Change = fn(&mut Request);
    let cases: [(Change, &str); 7] = [
        (|r| r.axes[0].travel = [0.0, f64::NAN], "travel of X"),
        (|r| r.within_mm = f64::NAN, "bound (mm) is NaN"),
        (|r| r.axes[0].step = 0.000_000_1, "step of the position of X"),
        (
            |r| r.outputs[0].limit_mm = 0.005,
            "the correction of X is 10.0 µm at X=0, expected at most 5 µm",
        ),
        (|r| r.outputs[0].limit_mm = 2.001, "limit of X (mm) is 2.001"),
        (|r| r.axes.clear(), "expected one to five different axes of the grid"),
        // The bound is finer than the parts of a step.
        (|r| r.within_mm = 5e-6, "no grid keeps 0.005 µm"),
    ];
    let flat = |_: &[f64; GRID_AXES]| [0.01, 0.0, 0.0];
    for (change, expected) in cases {
        let mut wanted = request(1, 1, 1.0);
        change(&mut wanted);
        let refused = build(&wanted, &flat).expect_err(expected).to_string();
        assert!(refused.contains(expected), "{refused}");
    }
    let not_finite = |_: &[f64; GRID_AXES]| [f64::NAN, 0.0, 0.0];
    assert!(matches!(
        build(&request(1, 1, 1.0), &not_finite),
        Err(TablesError::BeyondLimit { .. })
    ));
}

/// A backlash of 8 µm, plus 2 µm at the far end.
struct Play {
    varies_mm: f64,
}

impl Field for Play {
    fn correction_mm(
        &self,
        at: &[f64; GRID_AXES],
        directions: &[Option<Direction>; GRID_AXES],
    ) -> [f64; OUTPUTS] {
        let half = 0.004 + 0.5 * self.varies_mm * at[0] / 1000.0;
        let side = directions[0].map_or(0.0, Direction::sign);
        [0.05 * at[0] / 1000.0 + half * side, 0.0, 0.0]
    }

    fn is_bidirectional(&self) -> bool {
        true
    }
}

#[test]
fn a_constant_reversal_is_in_the_map_and_the_rest_counts() {
    let table = build(&request(1, 1, 1.0), &Play { varies_mm: 0.0 }).expect("a map");
    assert_eq!(table.map.header().reversal[0][0], 4 * 64);
    assert!(
        table.misfit.max_mm <= 2.0 * rounding_mm(1, 1) + places_mm(&table),
        "{:?}",
        table.misfit
    );
    // The backlash varies by 2 µm, so half of it varies by ±0.5 µm about its mean.
    let table = build(&request(1, 1, 1.0), &Play { varies_mm: 0.002 }).expect("a map");
    assert!((table.misfit.max_mm - 0.0005).abs() <= 2.0 * rounding_mm(1, 1), "{:?}", table.misfit);
    assert!(table.misfit.directions[0].is_some());
    let refused = build(&request(1, 1, 0.4), &Play { varies_mm: 0.002 }).expect_err("0.5 µm");
    assert!(matches!(refused, TablesError::Unreachable { .. }), "{refused}");
}

#[test]
fn five_axes_are_looked_up_too() {
    let field = |at: &[f64; GRID_AXES]| {
        let all: f64 = at.iter().map(|x| x / 1000.0).product();
        [0.1 * all, 0.05 * at[3] / 1000.0, 0.0]
    };
    let table = build(&request(5, 2, 0.2), &field).expect("a map");
    assert_eq!(counts(&table), [2; 5]);
    let position = Position { steps: [500_000; GRID_AXES], ..Position::default() };
    let found = table.map.correction_mm(&position);
    assert!((found[0] - 0.1 / 32.0).abs() < 1e-4 && (found[1] - 0.025).abs() < 1e-4, "{found:?}");
}

#[test]
fn beyond_the_grid_its_end_holds() {
    let field = |at: &[f64; GRID_AXES]| [0.1 * at[0] / 1000.0, 0.0, 0.0];
    let table = build(&request(1, 1, 0.5), &field).expect("a map");
    let at = |steps: i32| {
        let mut position = Position::default();
        position.steps[0] = steps;
        table.map.correction_mm(&position)[0]
    };
    assert_eq!([at(-5_000_000), at(i32::MIN)], [at(0); 2]);
    assert_eq!([at(1_500_000), at(i32::MAX)], [at(1_000_000); 2]);
    assert!((at(1_000_000) - 0.1).abs() < 1e-5);
}

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
