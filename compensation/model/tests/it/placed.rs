//! Positions of the axes and frames of their errors, as a machine file defines them.

use volcomp_model::Machine;
use volcomp_model::kinematics::{DhConvention, DhTable, MotionFrame, State};

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
