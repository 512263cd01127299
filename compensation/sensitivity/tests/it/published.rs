//! Counts of the published models: 60 errors with 20 distinct motions, and a machine with 37 errors.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_kinematics::{Form, MotionFrame, State};
use volcomp_model::{Machine, Temperatures};
use volcomp_sensitivity::{Poses, Sensitivity, sensitivity, terms};
use volcomp_vocabulary::{AxisKind, Displacement, ErrorName};

use crate::example;

fn poses(machine: &Machine, count: usize) -> Poses {
    let travel = |axis: &volcomp_model::Axis| {
        let inside = |end: f64| Displacement::from_coordinate(axis.name.kind(), end).mm_or_rad();
        (axis.name, axis.travel.map(inside))
    };
    Poses::over(machine.chain(), machine.axes().iter().map(travel), count).unwrap()
}

fn sixty(machine: &Machine) -> Sensitivity {
    let errors = terms(machine.chain(), true, &[]);
    assert_eq!(errors.len(), 60);
    sensitivity(machine.chain(), &errors, &poses(machine, 3)).unwrap()
}

fn names(found: &Sensitivity) -> Vec<&str> {
    found.motions.iter().map(|motion| motion.name.as_str()).collect()
}

#[test]
fn sixty_errors_are_twenty_motions_in_the_turning_frame() {
    let machine = example("blade-mill.toml");
    assert_eq!(machine.errors().count(), 30);
    let assembled: usize =
        (0..5).map(|axis| machine.assembly(axis).iter().filter(|x| **x != 0.0).count()).sum();
    assert_eq!(assembled, 30);
    let found = sixty(&machine);
    let mut names = names(&found);
    names.sort_unstable();
    // Seven translations: all three of the frame, Y and Z of A, X and Z of B. Thirteen rotations about lines.
    let expected = [
        "rotation about X, line carried by B",
        "rotation about X, line carried by Y",
        "rotation about X, line carried by Z",
        "rotation about X, line carried by the workpiece",
        "rotation about Y, line carried by A",
        "rotation about Y, line carried by X",
        "rotation about Y, line carried by Z",
        "rotation about Y, line carried by the workpiece",
        "rotation about Z, line carried by A",
        "rotation about Z, line carried by B",
        "rotation about Z, line carried by X",
        "rotation about Z, line carried by Y",
        "rotation about Z, line carried by the workpiece",
        "translation along X, frame of B",
        "translation along X, frame of the workpiece",
        "translation along Y, frame of A",
        "translation along Y, frame of the workpiece",
        "translation along Z, frame of A",
        "translation along Z, frame of B",
        "translation along Z, frame of the workpiece",
    ];
    assert_eq!(expected.len(), 20);
    assert_eq!(names, expected);
    let of = |term: &str| {
        let has = |motion: &&volcomp_sensitivity::DistinctMotion| {
            motion.terms.iter().any(|t| t.to_string() == term)
        };
        let motion = found.motions.iter().find(has).unwrap();
        motion.terms.iter().map(ToString::to_string).collect::<Vec<_>>().join(" ")
    };
    assert_eq!(of("EXX"), "EXX SXX EXY SXY EXZ SXZ EXA SXA SXB");
    assert_eq!(of("EYA"), "EYA EYB SYB");
    assert_eq!(of("SBX"), "SBX");
    assert_eq!(of("ECX"), "ECX SCY");
    assert_eq!(of("EAZ"), "EAZ EAA SAA SAB");
    // Measurements of the complete tool pose distinguish all distinct motions.
    assert_eq!(found.rank, 20);
    assert_eq!(found.indistinguishable.len(), 40);
}

#[test]
fn sixty_errors_are_sixteen_motions_in_the_fixed_frame() {
    let turning = example("blade-mill.toml");
    let fixed = turning.to_toml().replace("motion_frame = \"turning\"\n", "");
    let fixed =
        fixed.lines().filter(|line| !line.starts_with("checksum")).collect::<Vec<_>>().join("\n");
    let machine = Machine::parse(&fixed, "fixed.toml").unwrap();
    assert!(machine.axes().iter().all(|axis| axis.motion_frame == MotionFrame::Fixed));
    let found = sixty(&machine);
    assert_eq!(found.motions.len(), 16, "{:#?}", names(&found));
    let translations = names(&found).iter().filter(|name| name.starts_with("translation")).count();
    assert_eq!(translations, 5);
}

/// With Y as reference: one squareness error of X, two of Z, two parallelism errors of A and two of C.
#[test]
fn the_machine_with_37_errors() {
    let (file, structure) = ("poe-mill-table.toml", "w C' X' Y' b Z A t");
    let machine = example(file);
    assert_eq!(machine.chain().structure().to_string(), structure);
    assert_eq!(machine.errors().count(), 30);
    let stated: Vec<ErrorName> = machine.locations().keys().copied().collect();
    let linear = stated.iter().filter(|name| name.axis.kind() == AxisKind::Linear);
    assert_eq!((stated.len(), linear.count()), (7, 3));
    let all = terms(machine.chain(), false, &[]);
    let stated: Vec<_> = all
        .into_iter()
        .filter(|term| {
            let name: Result<ErrorName, _> = term.to_string().parse();
            name.is_ok_and(|name| !name.location || stated.contains(&name))
        })
        .collect();
    assert_eq!(stated.len(), 37, "{file}");
    let found = sensitivity(machine.chain(), &stated, &poses(&machine, 3)).unwrap();
    // Every published location error has an effect.
    assert!(found.errors.iter().all(|error| error.position_rms_um > 0.0), "{file}");
    println!("{file}: rank {} of 37, {} motions", found.rank, found.motions.len());
}

/// At 1000 poses the sum of the 60 error twists deviates from the exact product by less than 0.1 %, but by more than 0.0001 %, which is the
/// second order that it lacks.
#[test]
fn at_a_thousand_poses_linear_and_actual_errors_differ_by_less_than_a_thousandth() {
    let machine = example("blade-mill.toml");
    let mut rng = ChaCha8Rng::seed_from_u64(60);
    let none = Temperatures::new();
    let mut worst = 0.0_f64;
    for _ in 0..1000 {
        let mut state = State::default();
        for (q, axis) in state.q.iter_mut().zip(machine.axes()) {
            let [low, high] = axis.travel;
            let at = rng.random_range(low..=high);
            *q = Displacement::from_coordinate(axis.name.kind(), at).mm_or_rad();
        }
        let error = |form| machine.error_at(&state, form, &none).position_mm.norm();
        let ratio = error(Form::Twist) / error(Form::Exact);
        worst = worst.max((ratio - 1.0).abs());
    }
    println!("largest deviation of the ratio from 1: {worst:.2e}");
    assert!(worst < 1e-3, "{worst}");
    assert!(worst > 1e-6, "second order must show: {worst}");
}
