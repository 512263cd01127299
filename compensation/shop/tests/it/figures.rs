//! Two published machines, measured in the virtual shop, identified, and compared with the truth over the whole volume.

use std::fmt::Write as _;
use std::fs;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_identify::Identification;
use volcomp_kinematics::nalgebra::{DMatrix, DVector, Vector3};
use volcomp_kinematics::{Form, State};
use volcomp_model::{Machine, Temperatures};
use volcomp_test_support::root;
use volcomp_vocabulary::Displacement;

use crate::{identified, shop_in, write};

/// Measures a true machine and identifies its errors. Returns the result and the largest differences from the truth before and after.
fn measured(truth: &str, shop: &str) -> (Identification, Differences, Differences) {
    let folder = tempfile::tempdir().expect("a folder");
    let shop = shop_in(folder.path(), truth, &format!("machine = \"truth.toml\"\n{shop}"));
    write(&shop, folder.path());
    let found = identified(folder.path());
    let mut nominal = shop.truth.clone();
    nominal.clear_errors();
    let before = against(&shop.truth, &nominal);
    let after = against(&shop.truth, &found.machine);
    (found, before, after)
}

fn against(truth: &Machine, machine: &Machine) -> Differences {
    compare(truth, machine, 2000, 99)
}

const SIX: [&str; 6] = ["EX", "EY", "EZ", "EA", "EB", "EC"];

fn all_thirty_seven() -> String {
    let mut items: Vec<String> = ["EC0X", "EA0Z", "EB0Z", "EB0A", "EC0A", "EA0C", "EB0C"]
        .map(|name| format!("\"{name}\""))
        .to_vec();
    for (letters, curve) in [("XYZ", "legendre = 2"), ("AC", "fourier = 1")] {
        for letter in letters.chars() {
            items.extend(SIX.map(|what| format!("{{ error = \"{what}{letter}\", {curve} }}")));
        }
    }
    format!("unknown = [{}]\n", items.join(", "))
}

/// Spheres at these centres, and a tracer at four points on the table, with two tools in turn.
fn spheres_and_tracer(centres: &str, each: usize) -> String {
    let mut text = format!(
        "[[observation]]
kind = \"sphere\"
poses = {each}
centres = {centres}
tools = [\"short\", \"long\"]
"
    );
    for point in [[350, 250, -450], [850, 300, -400], [400, 750, -420], [600, 450, 250]] {
        let _ = write!(
            text,
            "[[observation]]
kind = \"distance\"
poses = {}
point = {point:?}
tools = [\"short\", \"long\"]
",
            2 * each
        );
    }
    text
}

/// Published machine with 37 errors (30 position-dependent, 3 squareness, 4 parallelism, reference Y; the shipped file corrects an
/// error in the printed chain), all noise 0.3 µm: after 200 probings and 400 distances, 0.6 of 45 µm remain over 2000 poses, and 2.6 µrad of the
/// tool axis. 83 of 121 unknowns are determined; the others do not change the tip position.
#[test]
fn thirty_seven_errors_are_found_to_two_micrometres() {
    let file = "poe-mill-table.toml";
    let centres = "[[550, 350, -60], [150, 500, -150], [50, 50, -230], [480, -80, -110]]";
    let truth = fs::read_to_string(root().join("examples").join(file)).expect("shipped");
    let tools =
        "[tools.short]\ntip = [300.0, 225.0, 80.0]\n[tools.long]\ntip = [300.0, 225.0, -60.0]\n";
    let shop = format!(
        "seed = 6\n{}[instrument]\nnoise_um = 0.3\n{}",
        all_thirty_seven(),
        spheres_and_tracer(centres, 50)
    );
    let (found, before, after) = measured(&format!("{truth}{tools}"), &shop);
    assert_eq!(found.residual.rows, 600);
    println!("{file}: {before:?} to {after:?}");
    assert!(before.position_um > 30.0, "{file}: {before:?}");
    assert!(after.position_um < 2.0 && after.tool_axis_urad < 3.0, "{file}: {after:?}");
}

/// Published machine with a tilting table, 800 × 600 × 800: two direction cosines and two offsets of each rotary axis, squareness and
/// scales of the linear axes are identified within 2 µm and 3 µrad.
#[test]
fn a_tilting_table_is_found_to_two_micrometres_and_three_microradians() {
    let truth = "structure = \"w C' A' b X Y Z t\"
[axes]
C = { travel = [-180, 180], point = [400, 300, 150] }
A = { travel = [-90, 30], point = [400, 300, 150] }
X.travel = [0, 800]
Y.travel = [0, 600]
Z.travel = [0, 800]
[tool]
tip = [0, 0, 0]
[workpiece]
origin = [400, 300, 200]
[errors]
EX0C = 22.0
EY0C = -17.0
EA0C = 35.0
EB0C = -28.0
EY0A = 26.0
EZ0A = -19.0
EB0A = 31.0
EC0A = -24.0
EC0Y = 30.0
EA0Z = -22.0
EB0Z = 18.0
EXX = { poly = [0.0, 0.03] }
EYY = { poly = [0.0, -0.025] }
EZZ = { poly = [0.0, 0.02] }
";
    let shop = "seed = 8
unknown = [\"EX0C\", \"EY0C\", \"EA0C\", \"EB0C\", \"EY0A\", \"EZ0A\", \"EB0A\", \"EC0A\", \"EC0Y\", \"EA0Z\", \"EB0Z\",
    { error = \"EXX\", legendre = 1 }, { error = \"EYY\", legendre = 1 }, { error = \"EZZ\", legendre = 1 }]
[instrument]
noise_um = 1.0
alignment_urad = 200
runs = 3
[[observation]]
kind = \"sphere\"
poses = 50
centres = [[250, 0, 30], [-200, 200, 30], [0, -220, 200]]
[[observation]]
kind = \"ball-row\"
origin = [-390, 10, 100]
direction = [1, 0, 0]
distances = [0, 100, 200, 300, 400, 500, 600, 700, 780]
at = { A = 0, C = 0 }
[[observation]]
kind = \"ball-row\"
origin = [10, -290, 100]
direction = [0, 1, 0]
distances = [0, 100, 200, 300, 400, 500, 580]
at = { A = 0, C = 0 }
[[observation]]
kind = \"ball-row\"
origin = [10, 10, 20]
direction = [0, 0, 1]
distances = [0, 100, 200, 300, 400, 500, 570]
at = { A = 0, C = 0 }
";
    let (found, before, after) = measured(truth, shop);
    // Three spheres with 50 poses each; rows of 9, 7 and 7 balls, six times.
    assert_eq!(found.residual.rows, 3 * 50 + 6 * 23);
    println!("tilting table: {before:?} to {after:?}");
    assert!(before.position_um > 50.0 && before.rotation_urad > 30.0, "{before:?}");
    assert!(after.position_um < 2.0 && after.rotation_urad < 3.0, "{after:?}");
}

/// The reversal value is identified from probed balls. The machine moves to their actual positions, so an axis without a command still
/// moves by its errors, which changes its approach direction.
#[test]
fn a_reversal_is_found_from_probed_balls() {
    let truth = "structure = \"w X' b Y Z t\"
axes = { X.travel = [0, 500], Y.travel = [0, 400], Z.travel = [0, 300] }
[errors]
EYY = { mean = { poly = [0.0, 0.02] }, reversal = 2.0 }
EYX = { poly = [0.0, 0.4, -8e-4] }
EZX = { poly = [0.0, 0.05] }
";
    let row = |origin: &str, direction: &str, file: &str| {
        format!(
            "[[observation]]\nkind = \"ball-row\"\nfile = \"{file}\"\norigin = {origin}\ndirection = {direction}\n\
             distances = [0, 50, 100, 150, 200, 250, 300, 350]\nnoise_um = 0.3\nruns = 3\nboth_directions = true\n"
        )
    };
    let shop = format!(
        "unknown = [{{ error = \"EYY\", legendre = 1, reversal = true }}, {{ error = \"EYX\", legendre = 2 }}, \
         {{ error = \"EZX\", legendre = 1 }}]\n{}{}",
        row("[50, 200, 100]", "[1, 0, 0]", "along-x"),
        row("[250, 20, 100]", "[0, 1, 0]", "along-y"),
    );
    let (found, _, _) = measured(truth, &shop);
    let reversal = found.parameters.iter().find(|p| p.name == "EYY reversal");
    let reversal = reversal.expect("asked for");
    let uncertainty = reversal.uncertainty.expect("determined");
    assert!(uncertainty < 0.3, "{reversal:?}");
    assert!((reversal.value - 2.0).abs() < 4.0 * uncertainty, "{reversal:?}");
}

/// Largest differences over random poses.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Differences {
    pub(crate) position_um: f64,
    rotation_urad: f64,
    /// Difference of the tool axis directions, µrad; a rotation about the tool axis does not count.
    tool_axis_urad: f64,
}

/// Largest differences of the volumetric errors after best-fit rigid-body alignment of the workpiece.
pub(crate) fn compare(one: &Machine, other: &Machine, poses: usize, seed: u64) -> Differences {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let none = Temperatures::new();
    let mut rigid = DMatrix::zeros(3 * poses, 6);
    let mut difference = DVector::zeros(3 * poses);
    let mut turned = Vec::new();
    for pose in 0..poses {
        let mut state = State::default();
        for (place, axis) in one.axes().iter().enumerate() {
            let [low, high] = axis.travel;
            let q = low + (high - low) * random.random::<f64>();
            state.q[place] = Displacement::from_coordinate(axis.name.kind(), q).mm_or_rad();
        }
        let [a, b] = [one, other].map(|machine| machine.error_at(&state, Form::Exact, &none));
        let tip = one.chain().ideal_tip_mm(&state);
        let row = 3 * pose;
        difference.rows_mut(row, 3).copy_from(&(a.position_mm - b.position_mm));
        rigid.view_mut((row, 0), (3, 3)).fill_with_identity();
        rigid.view_mut((row, 3), (3, 3)).copy_from(&(-tip.cross_matrix()));
        let axis = one.chain().ideal_pose(&state).rotation * one.chain().tool_axis();
        turned.push((a.rotation_rad - b.rotation_rad, axis));
    }
    let normal = rigid.transpose() * &rigid;
    let right = rigid.transpose() * &difference;
    let motion = normal.cholesky().expect("poses in space").solve(&right);
    let left = difference - rigid * &motion;
    let turn: Vector3<f64> = motion.fixed_rows::<3>(3).into();
    let largest = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, f64::max);
    Differences {
        position_um: largest(&mut (0..poses).map(|pose| left.rows(3 * pose, 3).norm() * 1e3)),
        rotation_urad: largest(&mut turned.iter().map(|(by, _)| (by - turn).norm() * 1e6)),
        tool_axis_urad: largest(
            &mut turned.iter().map(|(by, axis)| (by - turn).cross(axis).norm() * 1e6),
        ),
    }
}
