//! Time of the sensitivity of 60 errors, compared with one model evaluation per entry of the table (pose and error), and of the whole grid of nine
//! nodes per axis, which must take less than 10 s on two cores. Only ratios within one run are meaningful.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use volcomp_kinematics::{Chain, ErrorMotion, Form, GivenErrors, volumetric_error};
use volcomp_sensitivity::{ErrorTerm, Poses, sensitivity, terms};
use volcomp_vocabulary::AxisName;

const TRAVELS: [(AxisName, [f64; 2]); 5] = [
    (AxisName::X, [0.0, 500.0]),
    (AxisName::Y, [0.0, 400.0]),
    (AxisName::Z, [0.0, 300.0]),
    (AxisName::A, [-1.0, 1.0]),
    (AxisName::B, [-0.5, 1.5]),
];

/// Evaluates the model for every entry, with one error at 1 and all others at 0.
fn entry_by_entry(chain: &Chain, errors: &[ErrorTerm], poses: &Poses) -> f64 {
    let mut largest = 0.0_f64;
    for term in errors {
        let Some(axis) = chain.structure().index_of(term.axis()) else {
            continue;
        };
        let mut given = GivenErrors::default();
        let motion = match term {
            ErrorTerm::Assembly(..) => &mut given.assembly[axis],
            ErrorTerm::Named(_) => &mut given.motion[axis],
        };
        let mut six = [0.0; 6];
        six[term.component().index()] = 1.0;
        *motion = ErrorMotion::from_um_urad(six);
        for place in 0..poses.count().unwrap_or(0) {
            let error = volumetric_error(chain, &given, &poses.state(place), Form::Twist);
            largest = largest.max(error.position_mm.norm());
        }
    }
    largest
}

fn sixty(c: &mut Criterion) {
    let mut chain = Chain::new("w b X Y Z A B t".parse().expect("a structure"));
    chain.set_tool([10.0, 20.0, -150.0], [0.0, 0.0, 1.0]).expect("a tool");
    let errors = terms(&chain, true, &[]);
    assert_eq!(errors.len(), 60);
    let mut group = c.benchmark_group("sixty_errors");
    group.sample_size(10);
    let few = Poses::over(&chain, TRAVELS, 5).expect("the axes of the chain");
    group.bench_function("grid_5", |b| {
        b.iter(|| sensitivity(black_box(&chain), black_box(&errors), black_box(&few)));
    });
    group.bench_function("grid_5_entry_by_entry", |b| {
        b.iter(|| entry_by_entry(black_box(&chain), black_box(&errors), black_box(&few)));
    });
    let many = Poses::over(&chain, TRAVELS, 9).expect("the axes of the chain");
    group.bench_function("grid_9", |b| {
        b.iter(|| sensitivity(black_box(&chain), black_box(&errors), black_box(&many)));
    });
    group.bench_function("grid_9_entry_by_entry", |b| {
        b.iter(|| entry_by_entry(black_box(&chain), black_box(&errors), black_box(&many)));
    });
    group.finish();
}

criterion_group!(benches, sixty);
criterion_main!(benches);
