//! The largest move of a model change equals that of a dense scan, for random curves of every kind.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_kinematics::State;
use volcomp_model::{
    Fading, Machine,
    curve::{
        BSpline, Chebyshev, Curve, ErrorCurve, Fourier, MovingLeastSquares, Polynomial, Table,
    },
};
use volcomp_runtime::Model;
use volcomp_vocabulary::{Direction, PerAxis};

const TRAVELS: [f64; 3] = [800.0, 400.0, 250.0];

fn machine() -> Machine {
    let text = "structure = \"w b X Y Z t\"\n[axes.X]\ntravel = [0.0, 800.0]\n[axes.Y]\ntravel = [0.0, 400.0]\n[axes.Z]\ntravel = [0.0, 250.0]\n[errors]\n";
    Machine::parse(text, "m").expect("a machine")
}

fn model(machine: &Machine) -> Model {
    Model::new(machine, Fading::default()).unwrap_or_else(|e| panic!("{e}"))
}

/// A random curve of one of seven kinds over a travel from 0, µm or µrad.
fn drawn(kind: usize, travel: f64, rng: &mut ChaCha8Rng) -> Curve {
    let mut some =
        |count: usize| -> Vec<f64> { (0..count).map(|_| rng.random_range(-20.0..20.0)).collect() };
    let nodes = |values: Vec<f64>| -> Vec<[f64; 2]> {
        let steps = (values.len() - 1) as f64;
        let node = |(k, value): (usize, &f64)| [travel * k as f64 / steps, *value];
        values.iter().enumerate().map(node).collect()
    };
    let ends = [0.0, travel];
    let curve: Result<Curve, _> = match kind {
        0 => {
            let c = some(6);
            let scaled = c.iter().enumerate();
            let scaled = scaled.map(|(k, c)| c / travel.powi(i32::try_from(k).unwrap_or(0)));
            Polynomial::new(scaled.collect(), ends).map(Into::into)
        }
        1 => Chebyshev::new(some(12), ends).map(Into::into),
        2 => Table::linear(nodes(some(19))).map(Into::into),
        3 => Table::cubic(nodes(some(19))).map(Into::into),
        4 => {
            let inner = (1..12).map(|k| travel * f64::from(k) / 12.0);
            let knots = [0.0; 4].into_iter().chain(inner).chain([travel; 4]);
            BSpline::new(knots.collect(), some(15), 3).map(Into::into)
        }
        5 => {
            let c = some(5);
            // Includes pitches that divide the travel, which equidistant samples always meet at the same phase.
            let period = [20.0, 25.0, 23.7, 40.0, travel / 25.0, travel / 24.0];
            let period = period[rng.random_range(0..period.len())];
            Fourier::new(c, period, ends).map(Into::into)
        }
        _ => MovingLeastSquares::new(nodes(some(21)), 4, 1.0 / 3.0, 3.0).map(Into::into),
    };
    curve.unwrap_or_else(|e| panic!("{e}"))
}

/// Minimum and maximum of a curve, or 0, from 20 000 samples.
fn extremes(curve: &Curve, travel: f64) -> [f64; 2] {
    (0..=20_000).fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], k| {
        let value = curve.value(travel * f64::from(k) / 20_000.0);
        [low.min(value), high.max(value)]
    })
}

/// For errors in X over one to three axes, with periods far below the travel, the reported move is within 5 % of the
/// sum of the extremes that a scan along each axis finds.
#[test]
fn the_largest_move_is_that_of_a_dense_scan() {
    let flat = model(&machine());
    let mut rng = ChaCha8Rng::seed_from_u64(17);
    for round in 0..42_usize {
        let mut changed = machine();
        let mut sums = [0.0; 2];
        let axes = 1 + round / 7 % 3;
        for (axis, name) in ["EXX", "EXY", "EXZ"].into_iter().enumerate().take(axes) {
            let kind = if axis == 0 { round % 7 } else { rng.random_range(0..7) };
            let curve = drawn(kind, TRAVELS[axis], &mut rng);
            for (sum, extreme) in sums.iter_mut().zip(extremes(&curve, TRAVELS[axis])) {
                *sum += extreme;
            }
            let name = name.parse().expect("an error");
            let set = changed.set_error(name, ErrorCurve::Single(curve.into()));
            set.unwrap_or_else(|e| panic!("{e}"));
        }
        let dense = sums[1].max(-sums[0]);
        let reported = flat.largest_move(&model(&changed), []).linear.to_um().0;
        assert!(
            (0.95 * dense..1.01 * dense + 0.01).contains(&reported),
            "round {round}: found {reported} µm, scanned {dense} µm"
        );
    }
}

/// A periodic tilt acts through the lever of Z: the reported move is within 5 % of a scan over X at both ends of Y and Z.
#[test]
fn levers_are_found_by_a_dense_scan() {
    let old = model(&machine());
    let mut rng = ChaCha8Rng::seed_from_u64(23);
    for kind in 0..7 {
        let mut changed = machine();
        let curve = drawn(kind, TRAVELS[0], &mut rng);
        let name = "EBX".parse().expect("an error");
        let set = changed.set_error(name, ErrorCurve::Single(curve.into()));
        set.unwrap_or_else(|e| panic!("{e}"));
        let new = model(&changed);
        let correctors = [&old, &new].map(|model| model.correctors_among(&model.axes));
        let mut dense = 0.0_f64;
        for k in 0..=4000 {
            for end in [[0.0, 0.0], [400.0, 0.0], [0.0, 250.0], [400.0, 250.0]] {
                let mut q = PerAxis::default();
                (q[0], q[1], q[2]) = (800.0 * f64::from(k) / 4000.0, end[0], end[1]);
                let approach = PerAxis::from_fn(|_| Some(Direction::Positive));
                let state = State { q, approach };
                let [before, after] = [(&old, &correctors[0]), (&new, &correctors[1])]
                    .map(|(model, correctors)| model.correction_of(&state, correctors).delta);
                for axis in 0..3 {
                    dense = dense.max(1e3 * (after[axis] - before[axis]).abs());
                }
            }
        }
        let reported = old.largest_move(&new, []).linear.to_um().0;
        assert!(
            (0.95 * dense..1.05 * dense + 0.01).contains(&reported),
            "kind {kind}: found {reported} µm, scanned {dense} µm"
        );
    }
}
