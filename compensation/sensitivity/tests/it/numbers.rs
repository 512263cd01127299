//! Effects compared with single evaluations of the model, and rank with singular values.

use nalgebra::DMatrix;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_kinematics::{
    Chain, ErrorMotion, ErrorSource, Form, GivenErrors, MotionFrame, State, volumetric_error,
};
use volcomp_model::{Machine, Temperatures};
use volcomp_sensitivity::{
    Dependence, ErrorTerm, Poses, Sensitivity, SensitivityError, effects_of,
    effects_of_with_progress, sensitivity, sensitivity_with_progress, terms,
};
use volcomp_test_support::structures::all_types;
use volcomp_vocabulary::{AxisKind, AxisName, Direction, ErrorName, MAX_AXES};

fn random_chain(structure: &volcomp_kinematics::Structure, rng: &mut ChaCha8Rng) -> Chain {
    let mut chain = Chain::new(structure.clone());
    let mut vector = |size: f64| [(); 3].map(|()| rng.random_range(-size..=size));
    chain.set_tool(vector(200.0), [0.0, 0.0, 1.0]).unwrap();
    let mut turning = false;
    for &axis in structure.axes() {
        chain.set_point(axis, vector(300.0)).unwrap();
        if axis.is_rotary() {
            turning = !turning;
            let frame = if turning { MotionFrame::Turning } else { MotionFrame::Fixed };
            chain.set_motion_frame(axis, frame).unwrap();
        }
    }
    chain
}

fn random_poses(chain: &Chain, count: usize, rng: &mut ChaCha8Rng) -> Vec<State> {
    let pose = |_| {
        let mut state = State::default();
        for (q, joint) in state.q.iter_mut().zip(chain.joints()) {
            *q = match joint.kind {
                AxisKind::Linear => rng.random_range(-400.0..=400.0),
                AxisKind::Rotary => rng.random_range(-3.0..=3.0),
            };
        }
        state
    };
    (0..count).map(pose).collect()
}

/// A single error of 1 µm or 1 µrad.
fn one(chain: &Chain, term: ErrorTerm) -> GivenErrors {
    let mut errors = GivenErrors::default();
    let axis = chain.structure().index_of(term.axis()).unwrap();
    let set = match term {
        ErrorTerm::Assembly(..) => &mut errors.assembly,
        ErrorTerm::Named(ErrorName { location: true, .. }) => &mut errors.location,
        ErrorTerm::Named(_) => &mut errors.motion,
    };
    let mut six = [0.0; 6];
    six[term.component().index()] = 1.0;
    set[axis] = ErrorMotion::from_um_urad(six);
    errors
}

/// Stacked columns from one evaluation of the twist form per pose and error: µm, and µrad times a lever arm.
fn stacked(chain: &Chain, errors: &[ErrorTerm], poses: &[State]) -> DMatrix<f64> {
    let mut matrix = DMatrix::zeros(6 * poses.len(), errors.len());
    for (column, &term) in errors.iter().enumerate() {
        let given = one(chain, term);
        for (row, state) in poses.iter().enumerate() {
            let error = volumetric_error(chain, &given, state, Form::Twist);
            for k in 0..3 {
                matrix[(6 * row + k, column)] = error.position_mm[k] * 1e3;
                matrix[(6 * row + 3 + k, column)] = error.rotation_rad[k] * 1e6 * 0.3;
            }
        }
    }
    matrix
}

fn all_terms(chain: &Chain) -> Vec<ErrorTerm> {
    let located = terms(chain, false, &[]);
    let stated: Vec<ErrorName> = located
        .into_iter()
        .filter_map(|term| match term {
            ErrorTerm::Named(name) if name.location => Some(name),
            _ => None,
        })
        .collect();
    terms(chain, true, &stated)
}

#[test]
fn effects_are_those_of_the_model_and_the_rank_that_of_singular_values() {
    let mut rng = ChaCha8Rng::seed_from_u64(81);
    for structure in all_types() {
        let chain = random_chain(&structure, &mut rng);
        let errors = all_terms(&chain);
        let poses = random_poses(&chain, 60, &mut rng);
        let found = sensitivity(&chain, &errors, &Poses::List(poses.clone())).unwrap();
        let matrix = stacked(&chain, &errors, &poses);
        for (column, effect) in matrix.column_iter().zip(&found.errors) {
            let (mut squares, mut largest) = ([0.0; 2], [0.0_f64; 2]);
            for six in column.as_slice().chunks(6) {
                for (part, scale) in [1.0, 1.0 / 0.3].into_iter().enumerate() {
                    let three = &six[3 * part..3 * part + 3];
                    let square = three.iter().map(|x| x * x).sum::<f64>() * scale * scale;
                    squares[part] += square;
                    largest[part] = largest[part].max(square.sqrt());
                }
            }
            let rms = squares.map(|sum| (sum / poses.len() as f64).sqrt());
            for (ours, plain) in [
                (effect.position_rms_um, rms[0]),
                (effect.position_max_um, largest[0]),
                (effect.orientation_rms_urad, rms[1]),
                (effect.orientation_max_urad, largest[1]),
            ] {
                assert!(
                    (ours - plain).abs() < 1e-9 * (1.0 + plain),
                    "{structure} {}: {ours} {plain}",
                    effect.term
                );
            }
        }
        let share: f64 = found.errors.iter().map(|error| error.share).sum();
        assert!((share - 1.0).abs() < 1e-12);
        let mut scaled = matrix.clone();
        for mut column in scaled.column_iter_mut() {
            let norm = column.norm();
            column /= norm;
        }
        let singular = scaled.clone().svd(false, false).singular_values;
        let rank = singular.iter().filter(|s| **s > 1e-9 * singular[0]).count();
        assert_eq!(found.rank, rank, "{structure}: {singular}");
        assert_eq!(found.indistinguishable.len(), errors.len() - rank);
        vanish(&found, &errors, &matrix);
        proportional(&found, &errors, &scaled);
    }
}

/// Checks that no null combination moves the tool at any pose, and that the null combinations are linearly independent.
fn vanish(found: &Sensitivity, errors: &[ErrorTerm], matrix: &DMatrix<f64>) {
    let mut null = DMatrix::zeros(errors.len(), found.indistinguishable.len());
    for (column, combination) in found.indistinguishable.iter().enumerate() {
        for &(term, weight) in combination {
            let place = errors.iter().position(|&other| other == term).unwrap();
            null[(place, column)] = weight;
        }
        let length: f64 = combination.iter().map(|(_, weight)| weight * weight).sum();
        assert!((length - 1.0).abs() < 1e-12);
    }
    let moved = (matrix * &null).amax();
    assert!(moved < 1e-6, "{moved} µm");
    let rank = null.clone().svd(false, false).rank(1e-9);
    assert_eq!(rank, null.ncols());
}

/// Checks that exactly the errors of the same motion have proportional columns.
fn proportional(found: &Sensitivity, errors: &[ErrorTerm], scaled: &DMatrix<f64>) {
    let place = |term: &ErrorTerm| errors.iter().position(|other| other == term).unwrap();
    let mut first = Vec::new();
    for motion in &found.motions {
        let lead = place(&motion.terms[0]);
        for term in &motion.terms {
            let cosine = scaled.column(lead).dot(&scaled.column(place(term)));
            assert!((cosine.abs() - 1.0).abs() < 1e-12, "{term}");
        }
        first.push(lead);
    }
    for (at, &one) in first.iter().enumerate() {
        for &other in &first[at + 1..] {
            let cosine = scaled.column(one).dot(&scaled.column(other));
            assert!(cosine.abs() < 1.0 - 1e-9, "{} {}", errors[one], errors[other]);
        }
    }
    let named: usize = found.motions.iter().map(|motion| motion.terms.len()).sum();
    assert_eq!(named, errors.len());
}

/// On a table with C next to the workpiece, a shift of C's line equals a shift of the workpiece minus a rotating one: three errors have two
/// independent effects, and the null combination names them.
#[test]
fn a_null_direction_names_its_errors() {
    let chain = Chain::new("w C' b t".parse().unwrap());
    let named = |names: &[&str]| {
        names.iter().map(|name| ErrorTerm::Named(name.parse().unwrap())).collect::<Vec<_>>()
    };
    let poses = Poses::over(&chain, [(AxisName::C, [-3.0, 3.0])], 9).unwrap();
    let found = sensitivity(&chain, &named(&["EXC", "EYC", "EX0C", "EY0C"]), &poses).unwrap();
    assert_eq!((found.rank, found.indistinguishable.len()), (4, 0));
    // Two slides along X: every error of the first has the same effect as one of the second.
    let chain = Chain::new("w b X U t".parse().unwrap());
    let poses = Poses::over(&chain, [AxisName::X, AxisName::U].map(|axis| (axis, [0.0, 100.0])), 3)
        .unwrap();
    let found = sensitivity(&chain, &named(&["EXX", "EYX", "EYU"]), &poses).unwrap();
    assert_eq!(found.rank, 2);
    let [null] = &found.indistinguishable[..] else { panic!("{found:?}") };
    let words: Vec<(String, f64)> =
        null.iter().map(|(term, weight)| (term.coefficient(), *weight)).collect();
    let half = 0.5_f64.sqrt();
    assert_eq!(words[0].0, "EYX constant");
    assert_eq!(words[1].0, "EYU constant");
    assert!((words[0].1 - half).abs() < 1e-12 && (words[1].1 + half).abs() < 1e-12);
    // A tilt of a slide about its own line has no effect if the tool is on that line.
    let found = sensitivity(&chain, &named(&["EAX"]), &poses).unwrap();
    assert_eq!((found.rank, found.motions.len()), (1, 1), "it turns the tool");
}

#[test]
fn digits_do_not_depend_on_the_number_of_cores() {
    let mut rng = ChaCha8Rng::seed_from_u64(82);
    let chain = random_chain(&"w C' X' b Y Z B t".parse().unwrap(), &mut rng);
    let errors = terms(&chain, false, &[]);
    let travels = [
        (AxisName::X, [0.0, 300.0]),
        (AxisName::Y, [0.0, 300.0]),
        (AxisName::Z, [0.0, 300.0]),
        (AxisName::B, [-1.0, 1.0]),
        (AxisName::C, [-3.0, 3.0]),
    ];
    let poses = Poses::over(&chain, travels, 6).unwrap();
    let one_core = rayon_of(1, || sensitivity(&chain, &errors, &poses).unwrap());
    let two_cores = rayon_of(2, || sensitivity(&chain, &errors, &poses).unwrap());
    assert_eq!(one_core, two_cores);
}

fn rayon_of<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(work)
}

#[test]
fn invalid_poses_are_refused() {
    let chain = Chain::new("w b X t".parse().unwrap());
    let errors = terms(&chain, false, &[]);
    let none = sensitivity(&chain, &errors, &Poses::List(Vec::new()));
    assert!(matches!(none, Err(SensitivityError::Poses { found: Some(0), .. })));
    let many = Poses::Grid(vec![vec![0.0; 256]; 9]);
    let uncounted = sensitivity(&chain, &errors, &many).unwrap_err();
    assert!(uncounted.to_string().contains("found too many poses"), "{uncounted}");
    assert_eq!(sensitivity(&chain, &[], &many), Err(SensitivityError::NoErrors));
    // A grid too large for any memory is counted without creating its nodes.
    let endless = Poses::Even { travels: vec![[0.0, 1.0]; 9], count: usize::MAX };
    assert_eq!(endless.count(), None);
    let uncounted = sensitivity(&chain, &errors, &endless).unwrap_err();
    assert!(uncounted.to_string().contains("found too many poses"));
    let few = Poses::over(&chain, [(AxisName::X, [0.0, 1.0])], 1).unwrap();
    let foreign = ErrorTerm::Named("EXY".parse().unwrap());
    let refused = sensitivity(&chain, &[foreign], &few).unwrap_err();
    assert_eq!(refused.to_string(), "EXY: the structure has no axis Y");
    let infinite = Poses::List(vec![State::new(&chain, [(AxisName::X, f64::INFINITY)]).unwrap()]);
    assert_eq!(sensitivity(&chain, &errors, &infinite), Err(SensitivityError::NotFinite));
}

#[test]
fn dependence_of_a_known_matrix() {
    let matrix = DMatrix::from_row_slice(
        3,
        4,
        &[1.0, 2.0, 0.0, 3.0, 0.0, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0, 0.0],
    );
    let found = Dependence::of(&matrix);
    assert_eq!(found.rank(), 2);
    let five = 5.0_f64.sqrt();
    let [twice, nothing] = &found.null[..] else { panic!("{found:?}") };
    assert!(
        (twice[0].1 - 2.0 / five).abs() < 1e-15 && (twice[1].1 + 1.0 / five).abs() < 1e-15,
        "{twice:?}"
    );
    assert_eq!(nothing[..], [(2, 1.0)]);
}

/// A source with a single error of another source.
struct Only<'a, S> {
    source: &'a S,
    term: ErrorTerm,
    axis: usize,
}

impl<S: ErrorSource> Only<'_, S> {
    fn of(&self, axis: usize, six: ErrorMotion, is_kind: bool) -> ErrorMotion {
        let mut kept = ErrorMotion::ZERO;
        if axis == self.axis && is_kind {
            let component = self.term.component();
            let place = component.index() % 3;
            if component.is_angular() {
                kept.angular_rad[place] = six.angular_rad[place];
            } else {
                kept.linear_mm[place] = six.linear_mm[place];
            }
        }
        kept
    }
}

impl<S: ErrorSource> ErrorSource for Only<'_, S> {
    fn error_motion(&self, axis: usize, state: &State) -> ErrorMotion {
        let is_motion = matches!(self.term, ErrorTerm::Named(name) if !name.location);
        self.of(axis, self.source.error_motion(axis, state), is_motion)
    }
    fn location(&self, axis: usize) -> ErrorMotion {
        let is_location = matches!(self.term, ErrorTerm::Named(name) if name.location);
        self.of(axis, self.source.location(axis), is_location)
    }
    fn assembly(&self, axis: usize) -> ErrorMotion {
        let is_assembly = matches!(self.term, ErrorTerm::Assembly(..));
        self.of(axis, self.source.assembly(axis), is_assembly)
    }
}

#[test]
fn effects_of_a_machine_are_those_of_its_errors_one_by_one() {
    let machine = Machine::parse(
        "structure = \"w C' X' b Y Z B t\"
[axes]
X.travel = [0, 500]
Y.travel = [0, 400]
Z.travel = [-300, 0]
B = { travel = [-90, 90], point = [10.0, 0.0, 40.0] }
C = { travel = [0, 360], point = [250.0, 200.0, 0.0] }
[tool]
tip = [0.0, 0.0, -150.0]
[errors]
EXX = { poly = [0.0, 0.02] }
EYX = { forward = { poly = [2.0, 0.01] }, backward = { poly = [6.0, 0.01] } }
EBX = { poly = [0.0, 0.05, -1e-4] }
EAC = { fourier = [0.0, 3.0, 1.0], period = 360.0 }
EZB = 4.0
EC0Y = 12.0
EX0C = -7.0
EA0B = 3.0
[assembly]
Z = [0.0, 5.0, 0.0, 8.0, 0.0, 0.0]
",
        "m",
    )
    .expect("a machine");
    let chain = machine.chain();
    let mut rng = ChaCha8Rng::seed_from_u64(77);
    let mut poses = random_poses(chain, 300, &mut rng);
    for (place, pose) in poses.iter_mut().enumerate() {
        let forward = place % 2 == 0;
        let direction = if forward { Direction::Positive } else { Direction::Negative };
        pose.approach = [Some(direction); MAX_AXES].into();
    }
    let errors = all_terms(chain);
    let temperatures = Temperatures::new();
    let source = machine.source(&temperatures);
    let found = effects_of(chain, &source, &errors, &Poses::List(poses.clone())).unwrap();
    let mut squares = Vec::new();
    for (effect, &term) in found.iter().zip(&errors) {
        let axis = chain.structure().index_of(term.axis()).unwrap();
        let only = Only { source: &source, term, axis };
        let each = poses.iter().map(|pose| volumetric_error(chain, &only, pose, Form::Twist));
        let each: Vec<[f64; 2]> =
            each.map(|e| [e.position_mm.norm() * 1e3, e.rotation_rad.norm() * 1e6]).collect();
        let rms = |k: usize| (each.iter().map(|e| e[k] * e[k]).sum::<f64>() / 300.0).sqrt();
        let max = |k: usize| each.iter().map(|e| e[k]).fold(0.0, f64::max);
        for (found, expected) in [
            (effect.position_rms_um, rms(0)),
            (effect.position_max_um, max(0)),
            (effect.orientation_rms_urad, rms(1)),
            (effect.orientation_max_urad, max(1)),
        ] {
            assert!(
                (found - expected).abs() < 1e-9 * (1.0 + expected),
                "{term}: {found} {expected}"
            );
        }
        squares.push(rms(0).powi(2));
    }
    let total: f64 = squares.iter().sum();
    for (effect, square) in found.iter().zip(&squares) {
        assert!((effect.share - square / total).abs() < 1e-12, "{}", effect.term);
    }
    let moving = found.iter().filter(|effect| effect.share > 0.0).count();
    assert_eq!(moving, 10, "the errors of the file: {found:?}");
}

#[test]
fn progress_counts_every_pose_once() {
    let machine = Machine::parse(
        "structure = \"w X' b Y Z t\"\naxes = { X.travel = [0, 500], Y.travel = [0, 400], Z.travel = [0, 300] }\n[errors]\nEXX = { poly = [0, 0.1] }\n",
        "machine.toml",
    )
    .unwrap();
    let chain = machine.chain();
    let errors = terms(chain, false, &[]);
    let poses =
        Poses::over(chain, machine.axes().iter().map(|axis| (axis.name, axis.travel)), 20).unwrap();
    let reported = std::sync::Mutex::new(Vec::new());
    let progress = |done: usize, of: usize| {
        assert_eq!(of, 8000);
        reported.lock().unwrap().push(done);
    };
    let found = sensitivity_with_progress(chain, &errors, &poses, progress).unwrap();
    assert_eq!(found, sensitivity(chain, &errors, &poses).unwrap());
    let mut done = std::mem::take(&mut *reported.lock().unwrap());
    done.sort_unstable();
    // 8000 poses in chunks of 2048: progress is reported after each chunk.
    assert_eq!(done.len(), 4);
    assert_eq!(done.last(), Some(&8000));
    let none = Temperatures::new();
    let source = machine.source(&none);
    let values = effects_of_with_progress(chain, &source, &errors, &poses, progress).unwrap();
    assert_eq!(values, effects_of(chain, &source, &errors, &poses).unwrap());
    let mut done = std::mem::take(&mut *reported.lock().unwrap());
    done.sort_unstable();
    assert_eq!((done.len(), done.last()), (4, Some(&8000)));
}
