//! The machine file is read, written and rejected: messages name file, line, key, found and expected value.

use std::path::Path;

use proptest::prelude::*;
use sha2::{Digest, Sha256};
use volcomp_kinematics::{CorrectionOptions, State};
use volcomp_model::{
    CompiledMachine, CorrectRefusal, Machine, ModelError, Provenance, Source, Temperatures,
    Tolerance,
    evaluator::BLOB_VERSION,
    is_date,
    kinematics::{DhConvention, DhTable, MotionFrame},
    sha256_of,
};
use volcomp_test_support::cases;
use volcomp_vocabulary::{AxisName, PerAxis};

use crate::EXAMPLE;

/// Changes to the example: the old text | the new text. The resulting messages are in the snapshot.
const CHANGES: &str = r#"
structure = "w C' X' b Y Z t" | structure = "w C' X' Y Z t"
structure = "w C' X' b Y Z t" | structure = "w C' X' b Y' Z t"
structure = "w C' X' b Y Z t" | structure = "w C' X' b Y Z Z t"
structure = "w C' X' b Y Z t" | structure = 3
structure = "w C' X' b Y Z t" |
structure = "w C' X' b Y Z t" | type = { translational = 4 }
name = "gantry-8000" | name = "gantry-8000"\nnmae = 1
name = "gantry-8000" | name = "gantry-8000"\nname = "b"
[axes.X] | [axes.Q]
[axes.X] | [axes.A]
travel = [0.0, 8000.0] |
travel = [0.0, 8000.0] | travel = [8000.0, 8000.0]
travel = [0.0, 8000.0] | travel = [nan, 8000.0]
travel = [0.0, 8000.0] | travel = [0.0, inf]
travel = [0.0, 8000.0] | travel = [0.0]
travel = [0.0, 8000.0] | travel = "long"
travel = [0.0, 8000.0] | travel = [0.0, 8000.0]\ndirection = [0, 0, 0]
travel = [0.0, 8000.0] | travel = [0.0, 8000.0]\nmodulo = 360
travel = [0.0, 8000.0] | travel = [0.0, 8000.0]\nmotion_frame = "turning"
travel = [-360.0, 360.0] | travel = [-360.0, 360.0]\nmotion_frame = "spinning"
point = [400.0, 300.0, -200.0] | [dh]\nconvention = "paul"
point = [400.0, 300.0, -200.0] | [dh]\nrows = []
[tool]\n | [dh]\nrows = [{ axis = "C" }, { axis = "X" }, { axis = "Y" }, { axis = "Z" }]\n[tool]\n
point = [400.0, 300.0, -200.0] | direction = [0, 0, 1]\n[dh]\nrows = [{ axis = "C" }, { axis = "X" }, { axis = "Y" }, { axis = "Z" }]
point = [400.0, 300.0, -200.0] | [dh]\nrows = [{ axis = "X" }, { axis = "C" }, {}, {}]
point = [400.0, 300.0, -200.0] | [dh]\nrows = [{ axis = "C", alfa = 90 }, {}, {}, {}]
point = [400.0, 300.0, -200.0] | [dh]\nrows = [{ axis = "C", a = nan }, {}, {}, {}]
point = [400.0, 300.0, -200.0] | [dh]\nbase = { x = [0, 0, 2] }\nrows = [{}, {}, {}, {}]
axis = [0.0, 0.0, 1.0] | axis = [0, 0, 0.0]
tip = [0.0, 0.0, -150.0] | tip = [0.0, 0.0, -150.0]\ngauge = [0, 0, 0]
tip = [0.0, 0.0, -150.0] | tip = [0.0, 0.0, -150.0]\nlength = 5
name = "gantry-8000" | name = "gantry-8000"\ncorrect = ["X",\n"A"]
name = "gantry-8000" | name = "gantry-8000"\ncorrect = ["X", "C", "X"]
name = "gantry-8000" | name = "gantry-8000"\ncorrect = []
name = "gantry-8000" | name = "gantry-8000"\ncorrect = ["Q"]
name = "gantry-8000" | name = "gantry-8000"\ncorrect = "X"
lag_s = 600.0 | lag_s = -1
sensors = { spindle = 1.0, bed = -1.0 } | sensors = {}
EC0Y = 12.0 | EC0Y = nan
EC0Y = 12.0 | EC0Y = "nan"
EC0Y = 12.0 | EC0Y = { poly = [1] }
EC0Y = 12.0 | EC0Y = 12.0\n"EC(0X)Y" = 3
EC0Y = 12.0 | EY0Y = 12.0
EC0Y = 12.0 | EB0Y = 12.0
EC0Y = 12.0 | EC0C = 12.0
EC0Y = 12.0 | EXA = 12.0
EC0Y = 12.0 | EQX = 12.0
EAY = 4.0 | EAY = {}
EAY = 4.0 | EAY = { poly = [1], table = [[0, 1], [1, 2]] }
EAY = 4.0 | EAY = { poly = [] }
EAY = 4.0 | EAY = { poly = [1], order = 2 }
EAY = 4.0 | EAY = { chebyshev = [1] }
EAY = 4.0 | EAY = { table = [[0, 1], [5, 2], [5, 3]] }
EAY = 4.0 | EAY = { table = [[0, 1], [5, 2], [4, 3]] }
EAY = 4.0 | EAY = { table = [[0, 1], [5, 2, 3]] }
EAY = 4.0 | EAY = { table = [[0, 1], [5, -inf]] }
EAY = 4.0 | EAY = { table = [[0, 1], [5, 2]], interpolation = "wavy" }
EAY = 4.0 | EAY = { forward = 1 }
EAY = 4.0 | EAY = { forward = 1, backward = { forward = 1, backward = 2 } }
EAY = 4.0 | EAY = { mean = 1, reversal = inf }
EAY = 4.0 | EAY = { grid = { axes = ["Y", "A"], nodes = [[0, 1], [0, 1]], values = [[0, 1], [2, 3]] } }
EAY = 4.0 | EAY = { grid = { axes = ["Y", "Z"], nodes = [[0, 1], [0, 1]], values = [[0, 1], [2]] } }
EAY = 4.0 | EAY = { mls = { nodes = [[0, 1], [1, 2]], order = 9 } }
EAY = 4.0 | EAY = [1, 2
X = [1, 2, 3, 4, 5, 6] | X = [1, 2, 3]
X = [1, 2, 3, 4, 5, 6] | A = [1, 2, 3, 4, 5, 6]
error = "EZZ" | error = "EZA"
error = "EXX" | error = "EAX"
um_per_k = 3.2 | urad_per_k = 3.2
[thermal] | [thermal]\nrefrence = 3
"#;

#[test]
fn every_broken_file_has_its_message() {
    let mut text = String::new();
    for [from, to] in &cases(CHANGES) {
        assert!(EXAMPLE.contains(from), "{from}");
        let broken = EXAMPLE.replacen(from, to, 1);
        let message = Machine::parse(&broken, "machine.toml").expect_err(to).to_string();
        let to = to.replace('\n', " ⏎ ");
        text.extend([to.as_str(), "\n    ", message.as_str(), "\n"]);
    }
    insta::assert_snapshot!(text);
}

#[test]
fn unreadable_files_have_their_message() {
    let dir = tempfile::tempdir().unwrap();
    let latin = dir.path().join("latin.toml");
    std::fs::write(&latin, b"name = \"Fr\xe4se\"").unwrap();
    let message = Machine::read(&latin).unwrap_err().to_string();
    assert!(
        message.ends_with("latin.toml: byte 10 is not UTF-8, expected a text file in UTF-8"),
        "{message}"
    );
    for path in [dir.path().to_owned(), dir.path().join("missing.toml")] {
        let message = Machine::read(&path).unwrap_err().to_string();
        assert!(message.contains("cannot be read"), "{message}");
    }
}

proptest::proptest! {
    /// A machine file with any removal or insertion gives a machine or a message.
    #[test]
    fn damaged_files_do_not_panic(
        place in 0..crate::EXAMPLE.len(), cut in 0..40_usize,
        put in "[\\[\\]{}=,.'\"# \n0-9a-zA-Z-]{0,6}",
    ) {
        let text: Vec<char> = crate::EXAMPLE.chars().collect();
        let place = place.min(text.len());
        let end = (place + cut).min(text.len());
        let damaged: String =
            text[..place].iter().copied().chain(put.chars()).chain(text[end..].iter().copied()).collect();
        match Machine::parse(&damaged, "m.toml") {
            // Every machine that is read can be written and read again.
            Ok(machine) => {
                let again = Machine::parse(&machine.to_toml(), "m.toml");
                proptest::prop_assert_eq!(again.ok(), Some(machine));
            }
            Err(error) => proptest::prop_assert!(error.to_string().starts_with("m.toml")),
        }
    }
}

#[test]
fn the_frame_of_the_error_motions_is_part_of_the_geometry() {
    let machine = |frame: &str| {
        let text = format!(
            "structure = \"w C' b X Y Z t\"\n[axes]\nX.travel = [0, 500]\nY.travel = [0, 500]\nZ.travel = [0, 500]\n\
             C = {{ travel = [0, 360], motion_frame = \"{frame}\" }}\n"
        );
        Machine::parse(&text, "machine.toml").expect("a machine")
    };
    let turning = machine("turning");
    assert_eq!(turning.other_geometry(&machine("turning")), None);
    assert_eq!(
        turning.other_geometry(&machine("fixed")).as_deref(),
        Some("motion_frame of axis C is `turning`, expected `fixed`")
    );
}

/// A tilting rotary table with these additional lines.
fn table_table(rest: &str) -> Machine {
    let axes = "[axes]\nC.travel = [-360, 360]\nA.travel = [-120, 30]\nX.travel = [0, 800]\nY.travel = [0, 600]\nZ.travel = [-500, 0]\n";
    Machine::parse(&format!("structure = \"w C' A' b X Y Z t\"\n{axes}{rest}"), "m.toml").unwrap()
}

#[test]
fn a_motion_frame_is_read_and_written() {
    let text = "structure = \"w C' b X t\"\n[axes.C]\ntravel = [0, 360]\nmotion_frame = \"turning\"\n[axes.X]\ntravel = [0, 1]\n";
    let machine = Machine::parse(text, "m.toml").unwrap();
    assert_eq!(machine.chain().joints()[0].motion_frame, MotionFrame::Turning);
    let again = Machine::parse(&machine.to_toml(), "n.toml").unwrap();
    assert_eq!(again, machine);
    let fixed = Machine::parse(&text.replace("turning", "fixed"), "m.toml").unwrap();
    assert_eq!(fixed.chain().joints()[0].motion_frame, MotionFrame::Fixed);
    assert_ne!(fixed.checksum(), machine.checksum());
    assert!(!fixed.to_toml().contains("motion_frame"));
}

/// Two rotary and three linear joints (RRTTT) by hand: C about Z, A about X 50 mm above it, then X, Y and Z.
const ROWS: [(&str, [f64; 4]); 5] = [
    ("C", [90.0, 50.0, 0.0, 90.0]),
    ("A", [0.0, 0.0, 0.0, 0.0]),
    ("X", [90.0, 0.0, 0.0, 90.0]),
    ("Y", [90.0, 0.0, 0.0, 90.0]),
    ("Z", [0.0, 0.0, 0.0, 0.0]),
];

fn rows_of(rows: &[(&str, [f64; 4])]) -> String {
    let row = |(axis, [theta, d, a, alpha]): &(&str, [f64; 4])| {
        format!(
            "  {{ axis = \"{axis}\", theta = {theta:?}, d = {d:?}, a = {a:?}, alpha = {alpha:?} }},\n"
        )
    };
    format!("rows = [\n{}]\n", rows.iter().map(row).collect::<String>())
}

#[test]
fn a_table_places_the_axes() {
    let machine = table_table(&format!("[dh]\n{}", rows_of(&ROWS)));
    let directions: Vec<[f64; 3]> =
        machine.axes().iter().map(|axis| axis.direction.unwrap()).collect();
    let expected =
        [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    for (found, expected) in directions.iter().zip(expected) {
        let off = found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 1e-15, "{directions:?}");
    }
    assert_eq!(machine.axes()[1].point_mm, Some([0.0, 0.0, 50.0]));
    assert_eq!(
        machine.axes()[2].point_mm,
        None,
        "the errors of a slide are stated where its `point` says"
    );
    // The written file has directions and points, and gives the same machine.
    let again = Machine::parse(&machine.to_toml(), "n.toml").unwrap();
    assert_eq!(again, machine);
}

/// 4×4 products of the elementary motions, row by row, from the definition.
fn by_hand(rows: &[(&str, [f64; 4])], proximal: bool, coordinates: &[f64]) -> [[f64; 4]; 4] {
    type M = [[f64; 4]; 4];
    let product = |a: &M, b: &M| -> M {
        std::array::from_fn(|i| std::array::from_fn(|j| (0..4).map(|k| a[i][k] * b[k][j]).sum()))
    };
    let z = |angle: f64, slide: f64| -> M {
        let (s, c) = angle.sin_cos();
        [[c, -s, 0.0, 0.0], [s, c, 0.0, 0.0], [0.0, 0.0, 1.0, slide], [0.0, 0.0, 0.0, 1.0]]
    };
    let x = |angle: f64, slide: f64| -> M {
        let (s, c) = angle.sin_cos();
        [[1.0, 0.0, 0.0, slide], [0.0, c, -s, 0.0], [0.0, s, c, 0.0], [0.0, 0.0, 0.0, 1.0]]
    };
    let mut all = z(0.0, 0.0);
    for ((axis, [theta, d, a, alpha]), q) in rows.iter().zip(coordinates) {
        let (turn, slide) = if "ABC".contains(axis) { (*q, 0.0) } else { (0.0, *q) };
        let along_z = z(theta.to_radians() + turn, d + slide);
        let along_x = x(alpha.to_radians(), *a);
        all = if proximal {
            product(&product(&all, &along_x), &along_z)
        } else {
            product(&product(&all, &along_z), &along_x)
        };
    }
    all
}

/// T(q) of the chain is Π A(q) · (Π A(0))⁻¹, for both conventions and links and offsets of every kind.
#[test]
fn a_table_moves_as_the_product_of_its_rows() {
    let rows = [
        ("C", [20.0, 45.0, 12.0, 88.0]),
        ("A", [-35.0, 7.0, -30.0, 91.0]),
        ("X", [10.0, -60.0, 25.0, -89.0]),
        ("Y", [-85.0, 15.0, 8.0, -92.0]),
        ("Z", [5.0, 30.0, 4.0, 3.0]),
    ];
    let q = [0.7, -1.1, 120.0, 45.0, -80.0];
    for (word, proximal) in [("distal", false), ("proximal", true)] {
        let text = format!(
            "[dh]\nconvention = \"{word}\"\n{}[tool]\ntip = [10, 20, -150]\n",
            rows_of(&rows)
        );
        let machine = table_table(&text);
        let (moved, home) = (by_hand(&rows, proximal, &q), by_hand(&rows, proximal, &[0.0; 5]));
        // The tip in the last frame: Rᵀ(tip − p).
        let tip = [10.0, 20.0, -150.0];
        let inside: [f64; 3] =
            std::array::from_fn(|j| (0..3).map(|i| home[i][j] * (tip[i] - home[i][3])).sum());
        let expected: [f64; 3] = std::array::from_fn(|i| {
            (0..3).map(|k| moved[i][k] * inside[k]).sum::<f64>() + moved[i][3]
        });
        let named = rows.iter().zip(q);
        let named = named.map(|((name, _), q)| (name.parse().unwrap(), q));
        let state = State::new(machine.chain(), named).unwrap();
        let found = machine.chain().ideal_tip_mm(&state);
        for (k, expected) in expected.into_iter().enumerate() {
            assert!((found[k] - expected).abs() < 1e-9, "{word}: {found} {expected:?}");
        }
        // The Denavit–Hartenberg table of the chain gives the same motion in both conventions.
        for convention in [DhConvention::Distal, DhConvention::Proximal] {
            let table = DhTable::of_chain(machine.chain()).in_convention(convention);
            let back = table.to_chain(machine.chain().structure().clone()).unwrap();
            for (one, other) in back.joints().iter().zip(machine.chain().joints()) {
                assert!((one.direction - other.direction).norm() < 1e-12, "{convention:?}");
            }
        }
    }
}

#[test]
fn a_base_turns_and_shifts_the_whole_table() {
    let base = "base = { point = [100, 200, 300], z = [0, 0, 2], x = [0, 5, 0] }\n";
    let machine = table_table(&format!("[dh]\n{base}{}", rows_of(&ROWS)));
    assert_eq!(machine.axes()[0].point_mm, Some([100.0, 200.0, 300.0]));
    assert_eq!(machine.axes()[1].point_mm, Some([100.0, 200.0, 350.0]));
    let along = machine.axes()[2].direction.unwrap();
    assert!((along[1] - 1.0).abs() < 1e-15, "{along:?}");
}

/// U is parallel to X, C is under the workpiece; every axis could correct some errors.
const WITH_U_AND_C: &str = r#"
structure = "w C' X' b U Y Z t"
[axes.X]
travel = [0.0, 800.0]
[axes.U]
travel = [0.0, 800.0]
[axes.Y]
travel = [0.0, 500.0]
[axes.Z]
travel = [-400.0, 0.0]
[axes.C]
travel = [-360.0, 360.0]
[tool]
tip = [0.0, 0.0, -150.0]
axis = [0.3, 0.0, 1.0]
[errors]
EXX = { poly = [0.0, 0.02] }
EYX = 10.0
ECX = 25.0
EZC = 3.0
"#;

fn machine(correct: &str) -> Machine {
    Machine::parse(&format!("{correct}\n{WITH_U_AND_C}"), "m.toml").unwrap()
}

/// Letters of the axes that the correction moves, in chain order.
fn moved(machine: &Machine, options: &CorrectionOptions) -> String {
    let state =
        machine.state(&[(AxisName::X, 400.0), (AxisName::Y, 200.0), (AxisName::C, 30.0)]).unwrap();
    let found = machine.correction_at(&state, &Temperatures::new(), options);
    let joints = machine.chain().joints().iter().zip(&found.delta);
    joints.filter(|(_, delta)| **delta != 0.0).map(|(joint, _)| joint.name.letter()).collect()
}

#[test]
fn the_machine_file_says_which_axes_correct() {
    let default = CorrectionOptions::default();
    assert_eq!(moved(&machine(""), &default), "CXYZ");
    assert_eq!(moved(&machine("correct = [\"X\", \"Y\", \"Z\"]"), &default), "XYZ");
    assert_eq!(moved(&machine("correct = [\"U\", \"X\", \"Y\", \"Z\"]"), &default), "UYZ");
    assert_eq!(moved(&machine("correct = [\"Y\"]"), &default), "Y");
    // The key also applies to the first-order step; explicit options override it.
    let file = machine("correct = [\"Y\"]");
    assert_eq!(moved(&file, &CorrectionOptions::first_order()), "Y");
    let asked = CorrectionOptions { correct: Some([AxisName::Z].into_iter().collect()), ..default };
    assert_eq!(moved(&file, &asked), "Z");
}

#[test]
fn the_compiled_machine_corrects_the_same_axes() {
    for correct in ["", "correct = [\"X\", \"Z\"]", "correct = [\"U\", \"Y\", \"C\"]"] {
        let machine = machine(correct);
        let compiled = machine.compile(Tolerance::default()).unwrap();
        let state = State::new(
            machine.chain(),
            [
                (AxisName::C, 0.5),
                (AxisName::X, 400.0),
                (AxisName::U, 20.0),
                (AxisName::Y, 200.0),
                (AxisName::Z, -100.0),
            ],
        )
        .unwrap();
        let exact =
            machine.correction_at(&state, &Temperatures::new(), &CorrectionOptions::first_order());
        let compiled = compiled.first_order(&state);
        for (exact, compiled) in exact.delta.iter().zip(&compiled.delta) {
            assert!((exact - compiled).abs() < 2e-6, "{correct}: {exact} {compiled}");
            assert_eq!(*exact == 0.0, *compiled == 0.0, "{correct}");
        }
    }
}

#[test]
fn the_key_is_written_back_and_is_part_of_the_checksum() {
    let machine = machine("correct = [\"Z\", \"X\"]");
    let text = machine.to_toml();
    assert!(text.contains("correct = [\"Z\", \"X\"]\n"), "{text}");
    let again = Machine::parse(&text, "again.toml").unwrap();
    assert_eq!(again.correct(), Some(&[AxisName::Z, AxisName::X][..]));
    assert_eq!(again, machine);
    // A file is written without the key if it had none, so that its checksum does not change.
    let mut every = machine;
    every.set_correct(None).unwrap();
    assert!(!every.to_toml().contains("correct"));
    assert_ne!(every.checksum(), again.checksum());
}

#[test]
fn lists_that_cannot_be_are_refused() {
    let mut machine = machine("correct = [\"Y\"]");
    let mut set = |axes: &[AxisName]| machine.set_correct(Some(axes));
    assert!(matches!(set(&[]), Err(ModelError::Correct(CorrectRefusal::Empty))));
    let axis = AxisName::X;
    assert!(matches!(
        set(&[axis, axis]),
        Err(ModelError::Correct(CorrectRefusal::Twice { axis: AxisName::X }))
    ));
    assert!(matches!(set(&[AxisName::B]), Err(ModelError::NoSuchAxis { axis: AxisName::B, .. })));
    assert_eq!(machine.correct(), Some(&[AxisName::Y][..]));
}

fn parsed(error: &str) -> Result<Machine, String> {
    let text = format!(
        "structure = \"w C' b X Y Z t\"\n[axes]\nX.travel = [0, 500]\nY.travel = [0, 500]\nZ.travel = [0, 500]\n\
         C = {{ travel = [0, 360], modulo = 360 }}\n[errors]\n{error}\n"
    );
    Machine::parse(&text, "m.toml").map_err(|error| error.to_string())
}

fn grid(axes: &str, nodes: &str, values: &str) -> String {
    format!("EZC = {{ grid = {{ axes = {axes}, nodes = {nodes}, values = {values} }} }}")
}

#[test]
fn a_grid_closes_along_the_axis_that_goes_round() {
    let closed = [
        grid("[\"C\", \"X\"]", "[[0, 180, 360], [0, 500]]", "[[0, 1], [5, 6], [0, 1]]"),
        grid("[\"X\", \"C\"]", "[[0, 500], [0, 180, 360]]", "[[0, 5, 0], [1, 6, 1]]"),
        grid("[\"X\", \"Z\"]", "[[0, 500], [0, 500]]", "[[0, 5], [1, 6]]"),
    ];
    for error in closed {
        assert!(parsed(&error).is_ok(), "{error}: {:?}", parsed(&error));
    }
    let open = [
        grid("[\"C\", \"X\"]", "[[0, 180, 360], [0, 500]]", "[[0, 1], [5, 6], [0, 2]]"),
        grid("[\"X\", \"C\"]", "[[0, 500], [0, 180, 360]]", "[[0, 5, 0], [1, 6, 2]]"),
        // An error of another axis that also depends on C.
        grid("[\"X\", \"C\"]", "[[0, 500], [0, 360]]", "[[0, 0], [1, 2]]").replace("EZC", "EZX"),
    ];
    for error in open {
        let message = parsed(&error).expect_err(&error);
        let expected =
            "first value 1 and last value 2 differ, expected the same: the axis has a modulo";
        assert!(message.contains(expected) && message.starts_with("m.toml:8: "), "{message}");
    }
}

/// A curve of any kind that jumps at the roll-over of its axis is rejected with the size of the jump. For a table at
/// 0.000° a flickering last digit would change the correction by 160 µm.
#[test]
fn curves_of_every_kind_close_where_the_axis_rolls_over() {
    for [curve, jump] in &cases(
        r"
{ chebyshev = [0.0, 80.0], domain = [0.0, 360.0] } | 160.000
{ poly = [0.0, 0.5] } | 180.000
{ fourier = [0.0, 80.0, 80.0], period = 250.0 } | 124.9
{ bspline = { knots = [0, 0, 0, 0, 360, 360, 360, 360], coefficients = [0, 10, 70, 80], degree = 3 } } | 80.000
{ forward = { poly = [1.0] }, backward = { poly = [0.0, 0.5] } } | 180.000
",
    ) {
        let message = parsed(&format!("EXC = {curve}")).expect_err(curve);
        let expected = format!("jumps by {jump}");
        assert!(
            message.contains(&expected)
                && message.starts_with("m.toml:8: ")
                && message.contains("EXC"),
            "{message}"
        );
        assert!(message.contains("expected at most 1 µm or µrad"), "{message}");
    }
    for curve in [
        "{ poly = [3.0] }",
        "{ fourier = [0.0, 80.0, 80.0], period = 360.0 }",
        "{ fourier = [0.0, 80.0, 80.0], period = 120.0 }",
        // Curves fitted to readings close only within the scatter of the readings.
        "{ chebyshev = [0.0, 0.4], domain = [0.0, 360.0] }",
        "{ poly = [0.0, -0.5, 0.0013888888888888888] }",
    ] {
        let message = parsed(&format!("EXC = {curve}"));
        assert!(message.is_ok(), "{curve}: {message:?}");
    }
}

/// SHA-256 of the empty message and of "abc" (FIPS 180-4, examples).
const OF_NOTHING: &str = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855";
const OF_ABC: &str = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";

fn text(provenance: &str) -> String {
    format!(
        "structure = \"w X' b Z t\"\n[axes]\nX.travel = [0, 500]\nZ.travel = [0, 300]\n[errors]\nEXX = {{ poly = [0, 0.01] }}\nEBZ = 2\nEB0Z = 4\n{provenance}"
    )
}

fn told() -> String {
    text(&format!(
        "[provenance]\nversion = \"0.1.0\"\nserial = \"7 \\\"b\\\"\"\ndate = \"2024-02-29\"\n[[provenance.error]]\nerror = \"EXX\"\nmethod = \"polynomial of order 1\"\nrule = \"smallest\"\nresidual_um = 0.25\nleave_one_out_um = 0.5\nfrom = [{{ file = \"x.rtl\", sha256 = \"{OF_ABC}\", runs = 5, targets = 21, at = {{ Z = 120.5 }}, date = \"today\" }}]\n[[provenance.error]]\nerror = \"EBZ\"\nmethod = \"stated\"\nresidual_urad = 1\n[[provenance.error]]\nerror = \"EB0Z\"\nmethod = \"stated\"\n"
    ))
}

#[test]
fn what_is_written_is_what_was_read_and_counts_in_the_checksum() {
    let machine = Machine::parse(&told(), "m.toml").expect("a machine");
    let again = Machine::parse(&machine.to_toml(), "n.toml").expect("written");
    assert_eq!(again, machine);
    let exx = machine.provenance().of("EXX".parse().expect("a name"));
    let exx = exx.expect("told");
    assert_eq!((exx.residual, exx.leave_one_out), (Some(0.25), Some(0.5)));
    let expected = Source {
        file: "x.rtl".to_owned(),
        sha256: OF_ABC.to_owned(),
        runs: Some(5),
        targets: Some(21),
        at: vec![(volcomp_model::vocabulary::AxisName::Z, 120.5)],
        date: Some("today".to_owned()),
    };
    assert_eq!(exx.sources, [expected]);
    let other = told().replace("runs = 5", "runs = 4");
    let other = Machine::parse(&other, "m.toml").expect("a machine");
    assert_ne!(other.checksum(), machine.checksum());
    let bare = Machine::parse(&text(""), "m.toml").expect("a machine");
    assert!(!bare.to_toml().contains("provenance"));
}

#[test]
fn what_is_set_anew_loses_its_provenance() {
    let mut machine = Machine::parse(&told(), "m.toml").expect("a machine");
    let name = |text: &str| text.parse().expect("a name");
    let curve = machine.error(name("EBZ")).expect("there").clone();
    machine.set_error(name("EBZ"), curve.clone()).expect("set");
    assert!(machine.provenance().of(name("EBZ")).is_none());
    assert!(machine.provenance().of(name("EXX")).is_some());
    machine.set_location(name("EB0Z"), 5.0).expect("set");
    assert_eq!(machine.provenance().errors.len(), 1);
    machine.set_error(name("EXX"), curve).expect("set");
    assert_eq!(*machine.provenance(), Provenance::default());
    let mut machine = Machine::parse(&told(), "m.toml").expect("a machine");
    machine.clear_errors();
    assert!(machine.provenance().is_empty());
}

#[test]
fn what_cannot_be_is_refused_with_its_place() {
    for [from, to, expected] in &cases(
        r#"
2024-02-29 | 2023-02-29 | m.toml:9: provenance: date: found `2023-02-29`
error = "EBZ" | error = "EXX" | residual_urad
error = "EB0Z" | error = "EXX" | EXX appears twice
error = "EB0Z" | error = "EYX" | found EYX, expected an error of the table [errors]
residual_um = 0.25 | residual_um = -1 | EXX: found -1, expected a finite number of 0 or more
residual_um | residual_urad | residual_urad
ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad | abc | EXX: found `abc` as sha256
method = "stated"\nresidual | methode = "stated"\nresidual | methode
runs = 5 | runs = -5 | runs
{ Z = 120.5 } | { Q = 120.5 } | Q
"#,
    ) {
        let wrong = told().replacen(from, to, 1);
        assert_ne!(wrong, told(), "{from}");
        let message = Machine::parse(&wrong, "m.toml").expect_err(to).to_string();
        assert!(message.contains(expected), "{to}: {message}");
    }
}

#[test]
fn hashes_are_those_of_the_standard() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("f");
    for (bytes, hash) in [(&b""[..], OF_NOTHING), (b"abc", OF_ABC)] {
        std::fs::write(&path, bytes).expect("written");
        assert_eq!(sha256_of(&path).expect("read"), hash);
    }
    assert!(sha256_of(folder.path()).is_err());
}

/// `is_date` accepts exactly the dates of the calendar.
#[test]
fn days_are_those_of_the_calendar() {
    for day in ["2024-02-29", "2000-02-29", "2026-12-31", "0001-01-01"] {
        assert!(is_date(day), "{day}");
    }
    for day in [
        "",
        "2026",
        "2026-13-01",
        "2026-00-10",
        "2026-11-00",
        "2026-04-31",
        "2026-02-29",
        "2100-02-29",
        "26-11-25",
        "2026-1-05",
        "2026-11-25-",
        "2026-11-25T",
        "+026-11-25",
        "ä026-11-25",
    ] {
        assert!(!is_date(day), "{day}");
    }
}

#[test]
fn a_written_machine_reads_back_the_same() {
    let machine = Machine::parse(EXAMPLE, "a.toml").unwrap();
    let text = machine.to_toml();
    let again = Machine::parse(&text, "b.toml").unwrap();
    assert_eq!(machine, again);
    assert_eq!(text, again.to_toml());
}

#[test]
fn comments_and_order_do_not_change_the_checksum_but_numbers_do() {
    let plain = "name = \"m\"\nstructure = \"w b X t\"\n[axes.X]\ntravel = [0, 1]\n[errors]\nEXX = 1\nEYX = 2\n";
    let other = "structure = \"w b X t\" # chain\nname = \"m\"\n[errors]\nEYX = 2.0\nEXX = 1.0\n[axes]\nX.travel = [0.0, 1.0]\n";
    let checksum = |text: &str| Machine::parse(text, "m.toml").unwrap().checksum();
    assert_eq!(checksum(plain), checksum(other));
    assert_ne!(checksum(plain), checksum(&plain.replace("EYX = 2", "EYX = 2.1")));
}

#[test]
fn a_changed_file_is_noticed() {
    let text = Machine::parse(EXAMPLE, "a.toml").unwrap().to_toml();
    let changed = text.replace("EAY = 4.0", "EAY = 4.5");
    assert_ne!(text, changed);
    let message = Machine::parse(&changed, "a.toml").unwrap_err().to_string();
    assert!(message.starts_with("a.toml:2: checksum: found sha256:"), "{message}");
}

proptest! {
    #[test]
    fn no_text_makes_the_reader_panic(text in ".{0,200}") {
        let _ = Machine::parse(&text, "f");
    }

    #[test]
    fn no_change_of_one_place_makes_the_reader_panic(place in 0..EXAMPLE.len(), with in "[ -~]{0,3}") {
        let mut text = EXAMPLE.to_owned();
        text.replace_range(place..=place, &with);
        if let Ok(machine) = Machine::parse(&text, "f") {
            prop_assert_eq!(Machine::parse(&machine.to_toml(), "g").unwrap(), machine);
        }
    }
}

#[test]
fn the_shipped_examples_are_machines() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples");
    for name in ["gantry.toml", "five-axis.toml"] {
        let machine = Machine::read(folder.join(name)).unwrap();
        assert!(machine.errors().count() > 0);
    }
}

fn replay(target: &str, is_read: impl Fn(&[u8]) -> bool) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fuzz/corpus").join(target);
    let mut count = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let read = is_read(&std::fs::read(&path).unwrap());
        assert!(read || !name.starts_with("valid-"), "{name} was refused");
        assert!(!read || !name.starts_with("broken-"), "{name} was read");
        count += 1;
    }
    assert!(count >= 3, "{count} files for {target}");
}

#[test]
fn machine_files() {
    replay("machine", |bytes| {
        let text = String::from_utf8_lossy(bytes);
        Machine::parse(&text, "corpus").is_ok_and(|machine| {
            let again = Machine::parse(&machine.to_toml(), "written").unwrap();
            assert_eq!(again.checksum(), machine.checksum());
            true
        })
    });
}

#[test]
fn compiled_machines() {
    replay("compiled", |body| {
        let mut blob = b"VOLCOMPM".to_vec();
        blob.extend(BLOB_VERSION.to_le_bytes());
        blob.extend(Sha256::digest(body));
        blob.extend(body);
        CompiledMachine::from_blob(&blob).is_ok_and(|machine| {
            let _ = machine.evaluate(&State { q: PerAxis([f64::INFINITY; 9]), ..State::default() });
            true
        })
    });
}

#[test]
fn a_machine_reads_back_the_same() {
    let machine = Machine::parse(EXAMPLE, "m").unwrap();
    let text = serde_json::to_string(&machine).unwrap();
    assert_eq!(serde_json::from_str::<Machine>(&text).unwrap(), machine);
    // Deserialisation makes all checks of the machine file, including the checksum.
    for (from, to, told) in [
        ("w C'", "w Q'", "machine:3: structure:"),
        ("EC0Y = 12.0", "EC0Y = 13.0", "machine:2: checksum:"),
    ] {
        assert!(text.contains(from), "{text}");
        let error =
            serde_json::from_str::<Machine>(&text.replacen(from, to, 1)).expect_err(to).to_string();
        assert!(error.contains(told), "{error}");
    }
}

#[test]
fn plain_types_read_back_the_same() {
    let machine = Machine::parse(EXAMPLE, "m").unwrap();
    let axes = serde_json::to_string(machine.axes()).unwrap();
    assert_eq!(serde_json::from_str::<Vec<volcomp_model::Axis>>(&axes).unwrap(), machine.axes());
    let thermal = serde_json::to_string(machine.thermal()).unwrap();
    assert_eq!(
        &serde_json::from_str::<volcomp_model::Thermal>(&thermal).unwrap(),
        machine.thermal()
    );
    let tool = serde_json::to_string(machine.tool()).unwrap();
    assert_eq!(&serde_json::from_str::<volcomp_model::Tool>(&tool).unwrap(), machine.tool());
    let fading = serde_json::to_string(&volcomp_model::Fading::default()).unwrap();
    assert_eq!(
        serde_json::from_str::<volcomp_model::Fading>(&fading).unwrap(),
        volcomp_model::Fading::default()
    );
}
