//! Tests of fits against closed forms, brute force and published behaviour.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod bands;
mod brute_force;
mod choice;
mod covered;
mod few_terms;
mod gaps;
mod generated;
mod heat_network;
mod judged;
mod leave_one_out;
mod logged;
mod refusals;
mod reproduction;
#[cfg(feature = "serde")]
mod serialised;
mod thermal;

/// `count` evenly spaced targets over 0 to 8000 mm.
fn targets(count: u32) -> Vec<f64> {
    (0..count).map(|i| f64::from(i) * 8000.0 / f64::from(count - 1)).collect()
}

fn at(x: &[f64], f: impl Fn(f64) -> f64) -> Vec<f64> {
    x.iter().map(|&x| f(x)).collect()
}

/// Readings `f` (µm) with normally distributed noise of standard deviation `sigma` (µm).
fn noisy(x: &[f64], sigma: f64, seed: u64, f: impl Fn(f64) -> f64) -> Vec<f64> {
    use rand::{RngExt, SeedableRng};
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
    x.iter().map(|&x| f(x) + sigma * normal()).collect()
}
