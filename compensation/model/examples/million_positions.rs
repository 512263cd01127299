//! Measures how long the compiled machine takes to evaluate the errors at a million scattered positions on all
//! processors, including the allocation of the results: `cargo run --release -p volcomp-model --example
//! million_positions -- examples/gantry.toml`.

use std::{path::Path, time::Instant};

use volcomp_model::{
    Machine, Tolerance,
    kinematics::State,
    vocabulary::{Displacement, PerAxis},
};

const POSITIONS: u32 = 1_000_000;
const REPEATS: usize = 21;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1);
    let path = path.unwrap_or_else(|| "examples/gantry.toml".to_owned());
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let machine = Machine::read(folder.join(path))?;
    let compiled = machine.compile(Tolerance::default())?;
    let names: Vec<_> = machine.axes().iter().map(|axis| axis.name).collect();
    // Evenly distributed over the travels, without a pattern: the fractional parts of multiples of irrational numbers.
    let share = |number: u32, axis: usize| (f64::from(number) * (axis as f64 + 2.0).sqrt()).fract();
    let mut poses = Vec::new();
    for number in 0..POSITIONS {
        for (index, axis) in machine.axes().iter().enumerate() {
            let [low, high] = axis.travel;
            let coordinate = low + (high - low) * share(number, index);
            let coordinate = Displacement::from_coordinate(axis.name.kind(), coordinate);
            poses.push(coordinate.mm_or_rad());
        }
    }
    let mut times_ms = Vec::new();
    let mut first = [0.0; 6];
    for _ in 0..REPEATS {
        let begin = Instant::now();
        let mut errors = vec![[0.0; 6]; POSITIONS as usize];
        compiled.evaluate_batch_parallel(&names, &poses, PerAxis::default(), &mut errors)?;
        times_ms.push(1e3 * begin.elapsed().as_secs_f64());
        first = errors[0];
    }
    let mut state = State::default();
    state.q[..names.len()].copy_from_slice(&poses[..names.len()]);
    assert_eq!(first, compiled.evaluate(&state).into_six());
    times_ms.sort_by(f64::total_cmp);
    println!("{:.3} ms, the median of {REPEATS}", times_ms[REPEATS / 2]);
    Ok(())
}
