//! The sum of the 60 error twists against the exact product: what first order neglects is nothing.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_kinematics::{Form, State};
use volcomp_model::Temperatures;
use volcomp_vocabulary::Displacement;

use crate::example;

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
