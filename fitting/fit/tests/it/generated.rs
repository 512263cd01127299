//! Generated error curves with known truth, and their readings.

use std::f64::consts::TAU;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

pub(crate) const FAMILIES: [&str; 5] = ["smooth", "kinked", "pitch", "steps", "hysteresis"];
/// Standard deviations of a reading, µm. The heights of the curves are some tens of µm.
pub(crate) const NOISE: [f64; 3] = [0.1, 0.5, 2.0];
const COUNTS: [u32; 10] = [5, 7, 9, 11, 15, 21, 31, 51, 101, 200];

/// One direction of a measured line: readings of each run (µm), and the truth.
pub(crate) struct Side {
    pub(crate) runs: Vec<Vec<f64>>,
    /// True value (µm) at a coordinate (mm).
    pub(crate) truth: Box<dyn Fn(f64) -> f64>,
}

/// A generated line: its targets (mm), and one or both directions.
pub(crate) struct Generated {
    #[allow(dead_code, reason = "the table of the example groups by it")]
    pub(crate) family: &'static str,
    #[allow(dead_code, reason = "the table of the example groups by it")]
    pub(crate) noise: f64,
    pub(crate) targets: Vec<f64>,
    pub(crate) sides: Vec<Side>,
}

impl Side {
    /// Targets (mm) and readings (µm) of all runs, one after the other.
    pub(crate) fn readings(&self, targets: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let x = self.runs.iter().flat_map(|_| targets.to_vec()).collect();
        (x, self.runs.concat())
    }
}

/// A normally distributed number with standard deviation 1 (G. E. P. Box, M. E. Muller, Ann. Math. Stat. 29, 1958).
fn normal(random: &mut ChaCha8Rng) -> f64 {
    let (a, b): (f64, f64) = (random.random(), random.random());
    (-2.0 * (1.0 - a).ln()).sqrt() * (TAU * b).cos()
}

pub(crate) fn generated(seed: u64, index: u32) -> Generated {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(u64::from(index));
    let family = FAMILIES[index as usize % FAMILIES.len()];
    let noise = NOISE[(index as usize / FAMILIES.len()) % NOISE.len()];
    let count = COUNTS[random.random_range(0..COUNTS.len())];
    let runs = random.random_range(1..=10);
    let range = 1000.0;
    let step = range / f64::from(count - 1);
    // On a third of the lines the targets are unevenly spaced, as ISO 230-2 requires.
    let jitter = if index.is_multiple_of(3) { 0.3 } else { 0.0 };
    let targets: Vec<f64> = (0..count)
        .map(|k| step * (f64::from(k) + jitter * (random.random::<f64>() - 0.5)))
        .collect();
    let both = family == "hysteresis";
    let truth = truth(family, &mut random);
    let reversal = if both { 3.0 } else { 0.0 };
    let sides = if both { &[1.0, -1.0][..] } else { &[0.0][..] };
    let sides = sides.iter().map(|side| {
        let shift = side * reversal;
        let base = truth.clone();
        let of_side = move |x: f64| base.value(x) + shift * (1.0 + 0.4 * (x / 300.0).sin());
        let readings = (0..runs).map(|_| {
            let at = |&x: &f64| of_side(x) + noise * normal(&mut random);
            targets.iter().map(at).collect::<Vec<f64>>()
        });
        Side { runs: readings.collect(), truth: Box::new(of_side.clone()) }
    });
    Generated { family, noise, sides: sides.collect(), targets }
}

/// A line whose targets are too sparse: the pitch of the ball screw is shorter than two gaps between targets. A pitch
/// near one gap is avoided, because no target would show it.
#[allow(dead_code, reason = "the tests of bands ask for it")]
pub(crate) fn undersampled(seed: u64, index: u32) -> Generated {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(u64::from(index));
    let gaps = random.random_range(8..=20_u32);
    let step = 1000.0 / f64::from(gaps);
    let targets: Vec<f64> = (0..=gaps).map(|k| step * f64::from(k)).collect();
    let [shortest, longest] = if index.is_multiple_of(2) { [0.55, 0.85] } else { [1.25, 1.85] };
    let length = step * (shortest + (longest - shortest) * random.random::<f64>());
    let (phase, slow) = (TAU * random.random::<f64>(), TAU * random.random::<f64>());
    let truth = Truth {
        slope: 0.02,
        waves: vec![[4.0, 2500.0, slow], [2.0, length, phase]],
        ..Truth::default()
    };
    let noise = 0.3;
    let runs = (0..5).map(|_| {
        let at = |&x: &f64| truth.value(x) + noise * normal(&mut random);
        targets.iter().map(at).collect::<Vec<f64>>()
    });
    let runs = runs.collect();
    let side = Side { runs, truth: Box::new(move |x| truth.value(x)) };
    Generated { family: "undersampled", noise, targets, sides: vec![side] }
}

/// A true curve: the sum of a slope, waves, a polygon and steps.
#[derive(Clone, Default)]
struct Truth {
    slope: f64,
    /// Height (µm), length (mm) and phase (rad) of each wave.
    waves: Vec<[f64; 3]>,
    /// Position (mm) of each kink, and its change of slope (µm/mm).
    kinks: Vec<[f64; 2]>,
    /// Position (mm) and height (µm) of each step.
    steps: Vec<[f64; 2]>,
}

impl Truth {
    fn value(&self, x: f64) -> f64 {
        let waves = self.waves.iter().map(|[h, l, p]| h * (TAU * x / l + p).sin());
        let kinks = self.kinks.iter().map(|[at, s]| s * (x - at).max(0.0));
        let steps = self.steps.iter().map(|[at, h]| if x > *at { *h } else { 0.0 });
        self.slope * x + waves.chain(kinks).chain(steps).sum::<f64>()
    }
}

fn truth(family: &str, random: &mut ChaCha8Rng) -> Truth {
    let mut truth = Truth { slope: 0.02 * normal(random), ..Truth::default() };
    for _ in 0..2 {
        let length = 700.0 + 1500.0 * random.random::<f64>();
        let phase = TAU * random.random::<f64>();
        truth.waves.push([5.0 * normal(random), length, phase]);
    }
    match family {
        "kinked" => {
            truth.waves.clear();
            for _ in 0..2 {
                let at = 150.0 + 700.0 * random.random::<f64>();
                truth.kinks.push([at, 0.06 * normal(random)]);
            }
        }
        "pitch" => {
            let length = 60.0 + 150.0 * random.random::<f64>();
            let phase = TAU * random.random::<f64>();
            truth.waves.push([2.0, length, phase]);
        }
        "steps" => {
            let at = 200.0 + 600.0 * random.random::<f64>();
            truth.steps.push([at, 6.0 * normal(random)]);
        }
        _ => {}
    }
    truth
}
