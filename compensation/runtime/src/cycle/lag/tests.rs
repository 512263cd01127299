use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_guard::AxisLimits;
use volcomp_model::{Fading, Machine};
use volcomp_vocabulary::PerChannel;

use super::*;

/// The reduced correction is never worse than no correction, for any distance by which the required
/// correction changes.
#[test]
fn a_reduced_correction_is_never_worse_than_none() {
    let of = |x: f64, y: f64| PerAxis::from_fn(|i| [x, y].get(i).copied().unwrap_or(0.0));
    for distance in [0.0, 0.3, 0.5, 0.6, 0.8, 0.99, 1.0, 1.5] {
        for degree in 0..360 {
            let (sin, cos) = f64::from(degree).to_radians().sin_cos();
            let (does, needed) = (of(1.0, 0.0), of(1.0 + distance * cos, distance * sin));
            let part = Comparison::new(&does, &needed, 0.0).part();
            let left = (needed[0] - part).hypot(needed[1]);
            let without = needed[0].hypot(needed[1]);
            assert!(left <= without + 1e-12, "{distance} {degree}: {part}");
            assert_eq!(part > 1.0 - 1e-9, distance <= 0.5, "{distance} {degree}: {part}");
        }
    }
    let part = |needed, step| Comparison::new(&of(0.0, 0.0), &of(needed, 0.0), step).part();
    assert_eq!(part(0.0, 0.0), 1.0);
    assert_eq!(part(0.5, 1.0), 1.0, "within a step");
    assert_eq!(part(2.0, 1.0), 0.0);
}

/// A machine with a rotary table and a head, and random polynomials, waves and tables as errors.
fn random_model(random: &mut ChaCha8Rng) -> Model {
    let mut number = |size: f64| random.random_range(-size..=size);
    let mut lines =
        vec!["structure = \"w C' X' b Y Z B t\"\n[tool]\ntip = [0.0, 0.0, -120.0]".to_owned()];
    for (axis, half) in [("X", 400), ("Y", 400), ("Z", 400), ("B", 110), ("C", 180)] {
        let point = [number(200.0), number(200.0), number(200.0)];
        lines.push(format!("[axes.{axis}]\ntravel = [-{half}, {half}]\npoint = {point:?}"));
    }
    lines.push("[errors]".to_owned());
    for (axis, half) in [("X", 400), ("Y", 400), ("Z", 400), ("B", 110), ("C", 180)] {
        let half: i32 = half;
        for error in ["EX", "EY", "EZ", "EA", "EB", "EC"] {
            let size = 10.0 * number(1.0).abs();
            let of = [number(size), number(size), number(size)];
            let kind = number(1.5);
            lines.push(if kind > 0.5 {
                let nodes = (-(half / 20)..=half / 20).map(|n| [f64::from(20 * n), number(size)]);
                let table: Vec<_> = nodes.collect();
                format!("{error}{axis} = {{ table = {table:?} }}")
            } else if kind > -0.5 {
                let period = 10.0_f64.powf(1.0 + number(1.0).abs());
                format!("{error}{axis} = {{ fourier = {of:?}, period = {period:?} }}")
            } else {
                format!("{error}{axis} = {{ chebyshev = {of:?}, domain = [-{half}, {half}] }}")
            });
        }
    }
    let machine = Machine::parse(&lines.join("\n"), "m").expect("valid");
    Model::new(&machine, Fading::default()).expect("compiles")
}

/// Counts of skipped, made and reducing predictions, and
/// the smallest factor to which a skipped prediction would have reduced the correction.
#[derive(Debug)]
struct Looks {
    spared: u32,
    taken: u32,
    reduced: u32,
    least: f64,
}

/// Predicts, or skips the prediction, with the axes at this position and time; counts the outcome.
fn look(
    lag: &mut Lag,
    looks: &mut Looks,
    model: &Model,
    q: PerAxis<f64>,
    now: Duration,
    ahead: Duration,
) {
    let axes = std::array::from_fn(|i| {
        let axis = AxisLimits::NONE;
        model.axes.get(i).map_or(axis, |name| AxisLimits {
            kind: name.kind(),
            resolution: if name.is_rotary() { 1e-6 } else { 1e-4 },
            ..axis
        })
    });
    let limits = Limits {
        axes,
        count: model.axes.len(),
        period: Duration::from_millis(4),
        hold: Duration::from_millis(50),
        zero_after: Duration::from_millis(500),
        ramp: Duration::from_millis(500),
        test_shift: PerChannel::ZERO,
        read_back_cycles: 1,
        only_thermal: false,
    };
    let place = MachinePosition { positions: q, oldest: Some(now), ..MachinePosition::default() };
    lag.update(&place, model);
    let state = State { q, ..State::default() };
    let correctors = model.correctors_among(&model.axes);
    let wanted = model.wanted(&state, &correctors, &PerAxis::ZERO);
    let inputs = PredictionInputs {
        model,
        correctors: &correctors,
        only_thermal: false,
        limits: &limits,
        way_out: Duration::ZERO,
        state: &state,
        wanted: &wanted,
        applied: &PerAxis::ZERO,
    };
    let part = inputs.part_ahead(&lag.speed, ahead);
    looks.reduced += u32::from(part < 1.0);
    if lag.is_calm(&inputs, now, ahead) {
        looks.spared += 1;
        looks.least = looks.least.min(part);
    } else {
        looks.taken += 1;
    }
    lag.remember(&wanted, now);
}

const NO_LOOKS: Looks = Looks { spared: 0, taken: 0, reduced: 0, least: 1.0 };

#[test]
fn a_skipped_prediction_would_reduce_nothing() {
    let mut random = ChaCha8Rng::seed_from_u64(6);
    let mut looks = NO_LOOKS;
    for _ in 0..60 {
        let model = random_model(&mut random);
        for _ in 0..20 {
            let period_s = 10.0_f64.powf(random.random_range(-3.0..-1.8));
            let feed = 10.0_f64.powf(random.random_range(0.0..2.9));
            let ahead = Duration::from_secs_f64(period_s * random.random_range(1.0..8.0));
            let [mut q, mut speed, mut goal] = [PerAxis::ZERO; 3];
            for (q, name) in q.iter_mut().zip(&model.axes) {
                let most = if name.is_rotary() { 1.5 } else { 300.0 };
                *q = random.random_range(-most..most);
            }
            let mut lag = Lag::default();
            for cycle in 0..150_u32 {
                for (axis, name) in model.axes.iter().enumerate() {
                    let scale = if name.is_rotary() { 0.005 } else { 1.0 };
                    if cycle % 40 == 0 {
                        let moves = random.random_bool(0.6);
                        let part = random.random_range(-1.0..1.0);
                        goal[axis] = if moves { part * feed * scale } else { 0.0 };
                    }
                    // Acceleration of 5 m/s², scaled for rotary axes.
                    let most = 5000.0 * period_s * scale;
                    speed[axis] += (goal[axis] - speed[axis]).clamp(-most, most);
                    q[axis] += speed[axis] * period_s;
                }
                let now = Duration::from_secs_f64(1.0 + f64::from(cycle) * period_s);
                look(&mut lag, &mut looks, &model, q, now, ahead);
            }
        }
    }
    println!("{looks:?}");
    assert!(looks.least >= 1.0, "{looks:?}");
    assert!(looks.spared > 50_000 && looks.reduced > 5_000, "{looks:?}");
}

/// The curve is flat up to a node and steep after it.
#[test]
fn no_prediction_is_skipped_before_a_bend() {
    let text = "structure = \"w X' b Y Z t\"\n[axes]\nX.travel = [0, 400]\nY.travel = [0, 400]\nZ.travel = [0, 400]\n[errors]\nEXX = { table = [[0.0, 10.0], [200.0, 10.0], [204.0, -10.0], [400.0, -10.0]] }\n";
    let machine = Machine::parse(text, "m").expect("valid");
    let model = Model::new(&machine, Fading::default()).expect("compiles");
    let (mut lag, mut looks) = (Lag::default(), NO_LOOKS);
    for ms in 0..1000_u32 {
        let at = f64::from(ms) * 0.3;
        let q = PerAxis::from_fn(|axis| if axis == 0 { at } else { 100.0 });
        let now = Duration::from_millis(u64::from(ms));
        look(&mut lag, &mut looks, &model, q, now, Duration::from_millis(12));
    }
    println!("{looks:?}");
    assert!(looks.least >= 1.0 && looks.reduced > 5, "{looks:?}");
    assert!(looks.spared > 900, "{looks:?}");
}
