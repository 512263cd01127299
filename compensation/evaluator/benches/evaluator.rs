//! The compiled evaluator compared with the exact form on curve objects, with 4×4 products of the same compiled curves,
//! with a plain copy and with plain stores. Only ratios within one run are meaningful; `benches/compare` makes the
//! table.

use std::{hint::black_box, time::Duration};

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_curve::{Curve, ErrorCurve, Field};
use volcomp_fit::{fit_mls, fit_polynomial};
use volcomp_kinematics::{CorrectionOptions, State, actual_pose, correct};
use volcomp_model::{CompiledMachine, Machine, Temperatures, Tolerance};
use volcomp_vocabulary::{AxisKind, AxisName, PerAxis};

#[path = "../../../kinematics/benches/by_hand/mod.rs"]
mod by_hand;

const GANTRY: &str = include_str!("../../../cli/volcomp/demo/truth.toml");
const FIVE_AXIS: &str = include_str!("../../../examples/five-axis.toml");
const POSES: usize = 1024;

/// The demo gantry with curves of one kind fitted to its truth at 21 targets.
fn gantry(fit: impl Fn(&[f64], &[f64]) -> Curve) -> Machine {
    let truth = Machine::parse(GANTRY, "truth.toml").expect("the shipped machine");
    let mut machine = truth.clone();
    for (name, curve) in truth.errors() {
        let own = truth.index_of(name.axis).expect("an axis");
        let [low, high] = truth.axis(name.axis).expect("an axis").travel;
        let x: Vec<f64> = (0..21).map(|i| low + (high - low) * f64::from(i) / 20.0).collect();
        let at = |&x: &f64| {
            let mut coordinates = [0.0; 9];
            coordinates[own] = x;
            curve.value(own, &coordinates, None)
        };
        let u: Vec<f64> = x.iter().map(at).collect();
        let fitted = ErrorCurve::Single(Field::Curve(fit(&x, &u)));
        machine.set_error(name, fitted).expect("an error of the machine");
    }
    machine
}

fn mls(x: &[f64], u: &[f64]) -> Curve {
    fit_mls(x, u, 4, 1.0 / 3.0, 3.0).expect("21 targets").curve
}

fn polynomial(x: &[f64], u: &[f64]) -> Curve {
    fit_polynomial(x, u, 6, [x[0], x[20]]).expect("21 targets").curve
}

/// A machine with every error: 30 curves of order 6 and 11 location errors.
fn five_axis() -> Machine {
    let plain = Machine::parse(FIVE_AXIS, "five-axis.toml").expect("the shipped machine");
    let mut machine = plain.clone();
    machine.clear_errors();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for axis in plain.axes() {
        for component in volcomp_model::Component::ALL {
            let mut c: Vec<f64> = (0..7).map(|_| rng.random_range(-5.0..5.0)).collect();
            if axis.modulo.is_some() {
                // Even polynomials have the same value at both ends of the turn.
                c.iter_mut().skip(1).step_by(2).for_each(|c| *c = 0.0);
            }
            let curve = volcomp_curve::Chebyshev::new(c, axis.travel).expect("finite");
            let name = volcomp_model::ErrorName::motion(component, axis.name);
            machine
                .set_error(name, ErrorCurve::Single(Field::Curve(curve.into())))
                .expect("an axis of the machine");
            // Location errors without effect are rejected: eleven of eighteen remain.
            let location = volcomp_model::ErrorName::location(component, axis.name);
            let _ = machine.set_location(location, 12.0);
        }
    }
    machine
}

fn states(machine: &Machine) -> Vec<State> {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let state = |_| {
        let mut state = State::default();
        for (index, axis) in machine.axes().iter().enumerate() {
            let coordinate = rng.random_range(axis.travel[0]..=axis.travel[1]);
            state.q[index] = match axis.name.kind() {
                AxisKind::Linear => coordinate,
                AxisKind::Rotary => coordinate.to_radians(),
            };
        }
        state
    };
    (0..POSES).map(state).collect()
}

fn workloads() -> [(&'static str, Machine); 3] {
    [("gantry_mls", gantry(mls)), ("gantry_poly6", gantry(polynomial)), ("five_axis", five_axis())]
}

/// Throughput with independent poses, and latency with a chain in which each pose depends on the previous result.
fn one_pose(c: &mut Criterion) {
    for (name, machine) in workloads() {
        let compiled = machine.compile(Tolerance::default()).expect("compiles");
        println!("{name}: {} pieces, {} bytes", compiled.pieces(), compiled.bytes());
        let none = Temperatures::new();
        let source = machine.source(&none);
        let states = states(&machine);
        let mut group = c.benchmark_group(format!("one_pose/{name}"));
        group.throughput(Throughput::Elements(POSES as u64));
        let each = |f: &dyn Fn(&State) -> f64| {
            let sum: f64 = states.iter().map(f).sum();
            black_box(sum)
        };
        group.bench_function("compiled", |b| {
            b.iter(|| {
                for state in &states {
                    black_box(compiled.evaluate(black_box(state)));
                }
            });
        });
        group.bench_function("exact_on_curves", |b| {
            b.iter(|| each(&|s| actual_pose(machine.chain(), &source, s).translation_mm.x));
        });
        group.bench_function("products", |b| {
            b.iter(|| each(&|s| by_hand::by_hand(compiled.chain(), &compiled, s)[0].x));
        });
        group.bench_function("latency", |b| {
            b.iter(|| {
                let mut state = states[0];
                for next in &states {
                    let before = compiled.evaluate(&state).position_mm[0];
                    state = *next;
                    for q in &mut state.q {
                        *q += before * 1e-9;
                    }
                }
                black_box(state)
            });
        });
        group.finish();
    }
}

/// Errors over two coordinates: none, one and six bilinear patches on a machine of polynomials.
fn patches(c: &mut Criterion) {
    let mut group = c.benchmark_group("patches");
    group.throughput(Throughput::Elements(POSES as u64));
    let plain = gantry(polynomial);
    let y = AxisName::Y;
    for count in [0, 1, 6] {
        let mut machine = plain.clone();
        for component in &volcomp_model::Component::ALL[..count] {
            let nodes = [1, 2].map(|axis| (0..21).map(|i| 100.0 * f64::from(i * axis)).collect());
            let values = (0..21).map(|i| (0..21).map(|j| f64::from(i * j % 7)).collect());
            let grid = volcomp_curve::Grid::new([1, 2], nodes, values.collect());
            let field = Field::Grid(grid.expect("rising nodes"));
            machine
                .set_error(
                    volcomp_model::ErrorName::motion(*component, y),
                    ErrorCurve::Single(field),
                )
                .expect("an error of the machine");
        }
        let compiled = machine.compile(Tolerance::default()).expect("compiles");
        let states = states(&machine);
        group.bench_function(count.to_string(), |b| {
            b.iter(|| {
                for state in &states {
                    black_box(compiled.evaluate(black_box(state)));
                }
            });
        });
    }
    group.finish();
}

fn correction(c: &mut Criterion) {
    let machine = five_axis();
    let compiled = machine.compile(Tolerance::default()).expect("compiles");
    let none = Temperatures::new();
    let source = machine.source(&none);
    let states = states(&machine);
    let mut group = c.benchmark_group("correction/five_axis");
    group.throughput(Throughput::Elements(POSES as u64));
    group.bench_function("compiled_first_order", |b| {
        b.iter(|| {
            for state in &states {
                black_box(compiled.first_order(black_box(state)));
            }
        });
    });
    group.bench_function("compiled_in_parts", |b| {
        b.iter(|| {
            for state in &states {
                black_box(compiled.parts_of(black_box(state), compiled.correctors()));
            }
        });
    });
    let newton = CorrectionOptions::default();
    group.bench_function("exact_newton_on_curves", |b| {
        b.iter(|| {
            for state in &states {
                black_box(correct(machine.chain(), &source, black_box(state), &newton));
            }
        });
    });
    let first = CorrectionOptions::first_order();
    group.bench_function("products_first_order", |b| {
        b.iter(|| {
            for state in &states {
                black_box(correct(compiled.chain(), &compiled, black_box(state), &first));
            }
        });
    });
    group.finish();
}

/// True under `cargo bench`. In a test run every bench runs once over little data, to check that it works.
fn is_measured() -> bool {
    std::env::args().any(|argument| argument == "--bench")
}

/// 10⁷ scattered poses: 24 bytes read and 48 written per pose.
fn scattered(c: &mut Criterion) {
    let count = if is_measured() { 10_000_000 } else { 1000 };
    for (name, machine) in [("gantry_mls", gantry(mls)), ("gantry_poly6", gantry(polynomial))] {
        let compiled = machine.compile(Tolerance::default()).expect("compiles");
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let poses: Vec<f64> = (0..count)
            .flat_map(|_| [8000.0, 4000.0, 2500.0])
            .map(|travel| rng.random_range(0.0..travel))
            .collect();
        let mut errors = vec![[0.0; 6]; count];
        let mut group = c.benchmark_group(format!("scattered/{name}"));
        group.throughput(Throughput::Elements(count as u64));
        group.sample_size(10);
        let approach = PerAxis([None; 9]);
        let order = compiled.chain().structure().axes();
        group.bench_function("batch", |b| {
            b.iter(|| compiled.evaluate_batch(order, &poses, approach, black_box(&mut errors)));
        });
        group.bench_function("batch_all_cores", |b| {
            b.iter(|| {
                compiled.evaluate_batch_parallel(order, &poses, approach, black_box(&mut errors))
            });
        });
        group.bench_function("one_pose_path", |b| {
            b.iter(|| one_by_one(&compiled, &poses, black_box(&mut errors)));
        });
        group.bench_function("copy", |b| {
            b.iter(|| {
                // Memory traffic of the evaluation without the arithmetic: 24 bytes read, 48 written per pose.
                for (pose, error) in poses.chunks_exact(3).zip(black_box(&mut errors)) {
                    error[..3].copy_from_slice(pose);
                    error[3..].copy_from_slice(pose);
                }
            });
        });
        group.finish();
    }
}

fn one_by_one(compiled: &CompiledMachine, poses: &[f64], errors: &mut [[f64; 6]]) {
    for (pose, error) in poses.as_chunks::<3>().0.iter().zip(errors) {
        let state = State { q: PerAxis::leading(*pose), ..State::default() };
        let found = compiled.evaluate(&state);
        error[..3].copy_from_slice(&found.position_mm);
        error[3..].copy_from_slice(&found.rotation_rad);
    }
}

/// A tensor grid of 400 MB, written to memory that is already mapped.
fn grid(c: &mut Criterion) {
    let machine = gantry(mls);
    let compiled = machine.compile(Tolerance::default()).expect("compiles");
    let nodes = |count: u32, travel: f64| -> Vec<f64> {
        (0..count).map(|i| travel * f64::from(i) / f64::from(count - 1)).collect()
    };
    let count = if is_measured() { 203 } else { 20 };
    let axes = [
        (AxisName::X, nodes(count, 8000.0)),
        (AxisName::Y, nodes(count, 4000.0)),
        (AxisName::Z, nodes(count, 2500.0)),
    ];
    let grid = compiled.linear_grid(&axes, &State::default()).expect("three linear axes");
    let mut errors = vec![1.0_f64; grid.len() * 6];
    let mut group = c.benchmark_group("grid");
    group.throughput(Throughput::Bytes(8 * errors.len() as u64));
    group.sample_size(10).measurement_time(Duration::from_secs(8));
    group.bench_function("fill_one_core", |b| {
        b.iter(|| grid.fill_rows(0, black_box(&mut errors)));
    });
    group.bench_function("fill_all_cores", |b| {
        b.iter(|| grid.fill_parallel(black_box(&mut errors)));
    });
    group.bench_function("plain_stores", |b| {
        b.iter(|| black_box(&mut errors).fill(black_box(1.0)));
    });
    group.finish();
}

criterion_group!(benches, one_pose, patches, correction, scattered, grid);
criterion_main!(benches);
