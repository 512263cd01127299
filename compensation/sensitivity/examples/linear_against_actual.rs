//! Accuracy of the sum of 60 error twists: prints a histogram of the ratio between the linear and the actual volumetric error of the published
//! machine with 60 errors at 1000 random positions.
//!
//!     cargo run -p volcomp-sensitivity --example linear_against_actual

use std::path::Path;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_model::{Machine, Temperatures};
use volcomp_sensitivity::{
    kinematics::{Form, State},
    vocabulary::Displacement,
};

/// Class width of the histogram.
const CLASS: f64 = 1e-4;
/// Number of classes on each side of 1.
const CLASSES: usize = 10;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples");
    let machine = Machine::read(examples.join("blade-mill.toml"))?;
    let mut rng = ChaCha8Rng::seed_from_u64(60);
    let mut counts = [0_usize; 2 * CLASSES];
    for _ in 0..1000 {
        let mut state = State::default();
        for (q, axis) in state.q.iter_mut().zip(machine.axes()) {
            let [low, high] = axis.travel;
            let at = rng.random_range(low..=high);
            *q = Displacement::from_coordinate(axis.name.kind(), at).mm_or_rad();
        }
        let size = |form| {
            let error = machine.error_at(&state, form, &Temperatures::new());
            error.position_mm.norm()
        };
        let ratio = size(Form::Twist) / size(Form::Exact);
        assert!((ratio - 1.0).abs() < 1e-3, "{ratio} at {:?}", state.q);
        let place = ((ratio - 1.0) / CLASS).floor();
        let class = (0..2 * CLASSES).find(|class| *class as f64 - CLASSES as f64 >= place);
        counts[class.unwrap_or(2 * CLASSES - 1)] += 1;
    }
    println!("linear / actual volumetric error at 1000 positions");
    for (class, count) in counts.iter().enumerate() {
        let from = 1.0 + (class as f64 - CLASSES as f64) * CLASS;
        println!("{from:.4} to {:.4} {count:5} {}", from + CLASS, "#".repeat(count / 10));
    }
    Ok(())
}
