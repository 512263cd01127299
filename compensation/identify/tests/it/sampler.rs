//! Monte Carlo samples from the covariance, compared with repeated identifications from new readings.

use volcomp_identify::{Identification, IdentifyError, MachineSampler};
use volcomp_kinematics::Form;
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::AxisName::{X, Y};

use crate::lab::{Lab, Noise, csv, tip};

const MACHINE: &str = "structure = \"w b X Y t\"
axes.X.travel = [0.0, 500.0]
axes.Y.travel = [0.0, 400.0]
";
const TRUTH: &str =
    "[errors]\nEC0Y = 20.0\nEXX = { poly = [0.0, 0.02, 3e-5] }\nECX = { poly = [0.0, 0.05] }\n";
/// The tracker's frame is unknown, so the unknowns are correlated with it and with each other.
const KEYS: &str = "folds = 0
unknown = [\"EC0Y\", { error = \"EXX\", legendre = 2 }, { error = \"ECX\", legendre = 1 }]
[[observation]]
kind = \"points\"
file = \"t.csv\"
frame = \"unknown\"
uncertainty_um = 3.0
";
const REPEATS: usize = 400;
const POSES: [[f64; 2]; 4] = [[0.0, 0.0], [500.0, 0.0], [120.0, 400.0], [500.0, 400.0]];

fn found(lab: &Lab, truth: &Machine, noise: &mut Noise) -> Identification {
    let rows = (0..20).map(|k| {
        let (x, y) = (f64::from(k % 5) * 125.0, f64::from(k / 5) * 133.0);
        let at = tip(truth, &[(X, x), (Y, y)], [0.0; 3]);
        let [px, py, pz] = [at.x, at.y, at.z].map(|p| p + noise.normal(0.003));
        [x, y, px, py, pz]
    });
    lab.write("t.csv", &csv("X,Y,x,y,z", rows));
    lab.identify(KEYS).expect("found")
}

/// Error along X at the poses, µm.
fn errors(machine: &Machine) -> Vec<f64> {
    let error = |[x, y]: [f64; 2]| {
        let state = machine.state(&[(X, x), (Y, y)]).expect("a state");
        let error = machine.error_at(&state, Form::Exact, &Temperatures::default());
        error.position_mm.x * 1e3
    };
    POSES.into_iter().map(error).collect()
}

/// Standard deviation of each number, and correlation of the first with the last.
fn spread(rows: &[Vec<f64>]) -> (Vec<f64>, f64) {
    let count = rows.len() as f64;
    let mean = |k: usize| rows.iter().map(|row| row[k]).sum::<f64>() / count;
    let product = |a: usize, b: usize| {
        let (of_a, of_b) = (mean(a), mean(b));
        let products = rows.iter().map(|row| (row[a] - of_a) * (row[b] - of_b));
        products.sum::<f64>() / (count - 1.0)
    };
    let last = rows[0].len() - 1;
    let deviations: Vec<f64> = (0..=last).map(|k| product(k, k).sqrt()).collect();
    let correlation = product(0, last) / (deviations[0] * deviations[last]);
    (deviations, correlation)
}

#[test]
fn samples_spread_like_repeated_identifications() {
    let truth = Machine::parse(&format!("{MACHINE}{TRUTH}"), "truth").expect("a machine");
    let lab = Lab::new(MACHINE);
    let mut noise = Noise::new(11);
    let once = found(&lab, &truth, &mut noise);
    let observations = lab.read(KEYS).expect("read");
    let draws = MachineSampler::new(&observations, &once).expect("of these observations");
    let drawn = |trial| errors(&draws.machine(3, trial).expect("drawn"));
    // With residuals of twice the stated uncertainty the samples spread twice as far.
    assert_eq!(once.excess, 1.0);
    let more = Identification { excess: 2.0, ..once.clone() };
    let wide = MachineSampler::new(&observations, &more).expect("of these observations");
    let wide = errors(&wide.machine(3, 0).expect("drawn"));
    for ((wide, drawn), found) in wide.iter().zip(drawn(0)).zip(errors(&once.machine)) {
        let [wide, drawn] = [wide - found, drawn - found];
        assert!((wide - 2.0 * drawn).abs() < 1e-3 * drawn.abs().max(0.1), "{wide} {drawn}");
    }
    let drawn: Vec<Vec<f64>> = (0..REPEATS as u64).map(drawn).collect();
    let repeat = |_| errors(&found(&lab, &truth, &mut noise).machine);
    let repeated: Vec<Vec<f64>> = (0..REPEATS).map(repeat).collect();
    let (drawn, repeated) = (spread(&drawn), spread(&repeated));
    // Four standard deviations of the ratio of two spreads, and of the difference of two correlations.
    let allowed = 4.0 / (REPEATS as f64).sqrt();
    for (k, (drawn, repeated)) in drawn.0.iter().zip(&repeated.0).enumerate() {
        assert!(*repeated > 0.1, "{k}: {repeated}");
        assert!((drawn / repeated - 1.0).abs() < allowed, "{k}: {drawn} {repeated}");
    }
    let difference = (drawn.1 - repeated.1).abs();
    assert!(difference < allowed * core::f64::consts::SQRT_2, "{} {}", drawn.1, repeated.1);
}

#[test]
fn samples_are_reproducible_and_belong_to_their_observations() {
    let truth = Machine::parse(&format!("{MACHINE}{TRUTH}"), "truth").expect("a machine");
    let lab = Lab::new(MACHINE);
    let once = found(&lab, &truth, &mut Noise::new(12));
    let observations = lab.read(KEYS).expect("read");
    let draws = MachineSampler::new(&observations, &once).expect("of these observations");
    let fifth = errors(&draws.machine(1, 5).expect("drawn"));
    let _ = draws.machine(1, 4);
    assert_eq!(errors(&draws.machine(1, 5).expect("drawn")), fifth);
    assert_ne!(errors(&draws.machine(1, 6).expect("drawn")), fifth);
    assert_ne!(errors(&draws.machine(2, 5).expect("drawn")), fifth);
    let other = lab.read(&KEYS.replace("\"EC0Y\", ", "")).expect("read");
    assert!(matches!(MachineSampler::new(&other, &once), Err(IdentifyError::OtherObservations)));
}
