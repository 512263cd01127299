//! Accuracy of evaluations over many seeds: straightness by the angular method, squareness from two lines, and angles
//! from three parallel lines. Prints the 95th percentile and the maximum without checking them.

use std::error::Error;

use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use volcomp_metrology::{
    ParallelLine, ReferenceKind, TiltReading, angular_method_um, separate_parallel_lines,
    straightness_of_profile,
};
use volcomp_vocabulary::ErrorName;

const SEEDS: u64 = 2000;

/// Straightness deviation of a guideway of 8 m at `q` mm, µm.
fn guideway(q: f64) -> f64 {
    let t = q / 8000.0 * std::f64::consts::TAU;
    20.0 * t.sin() + 6.0 * (3.0 * t).cos()
}

fn percentile_and_worst(mut errors: Vec<f64>) -> (f64, f64) {
    errors.sort_by(f64::total_cmp);
    let place = errors.len() * 95 / 100;
    let at = |k: usize| errors.get(k).copied().unwrap_or(f64::NAN);
    (at(place), at(errors.len().saturating_sub(1)))
}

/// Largest difference of the measured profile from the guideway, µm. Both are relative to their least-squares lines.
fn angular_method(
    bridge_mm: f64,
    noise_urad: f64,
    runs: u32,
    seed: u64,
) -> Result<f64, Box<dyn Error>> {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let noise = Normal::new(0.0, noise_urad)?;
    let error: ErrorName = "EZX".parse()?;
    let mut tilts = Vec::new();
    let mut q = 0.0;
    while q <= 8000.0 {
        let tilt = (guideway(q) - guideway(q - bridge_mm)) / bridge_mm * 1e3;
        let drawn: f64 = (0..runs).map(|_| noise.sample(&mut rng)).sum();
        tilts.push((q, tilt + drawn / f64::from(runs)));
        q += bridge_mm;
    }
    let profile = angular_method_um(error, TiltReading::Slope, &tilts, bridge_mm)?;
    let truth: Vec<(f64, f64)> = profile.iter().map(|p| (p.0, guideway(p.0))).collect();
    let about = |profile: &[(f64, f64)]| {
        let found = straightness_of_profile(profile)?;
        let line = found.of(ReferenceKind::LeastSquares).line;
        Ok::<_, Box<dyn Error>>(line.removed_from(profile))
    };
    let differences = about(&profile)?.into_iter().zip(about(&truth)?);
    Ok(differences.fold(0.0, |m, (a, b)| f64::max(m, (a.1 - b.1).abs())))
}

/// Error of the squareness from two straight lines with noise, µrad.
fn squareness(
    length_mm: f64,
    targets: u32,
    noise_um: f64,
    seed: u64,
) -> Result<f64, Box<dyn Error>> {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let noise = Normal::new(0.0, noise_um)?;
    let mut sum = 0.0;
    for slope_urad in [12.0, -7.0] {
        let profile: Vec<(f64, f64)> = (0..targets)
            .map(|k| length_mm * f64::from(k) / f64::from(targets - 1))
            .map(|q| (q, 1e-3 * slope_urad * q + noise.sample(&mut rng)))
            .collect();
        let found = straightness_of_profile(&profile)?;
        sum += found.of(ReferenceKind::LeastSquares).line.slope().0 - slope_urad;
    }
    Ok(sum.abs())
}

/// Largest error over all targets of the two angles from three parallel lines, µrad.
fn three_lines(lever_mm: f64, runs: u32, noise_um: f64, seed: u64) -> Result<f64, Box<dyn Error>> {
    const TARGETS: usize = 21;
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let noise = Normal::new(0.0, noise_um / f64::from(runs).sqrt())?;
    let truth = |k: usize| [15.0 - k as f64, 0.5 * k as f64 - 8.0];
    let mut line = |b: f64, c: f64| ParallelLine {
        offset_mm: [b, c],
        deviations_um: (0..TARGETS)
            .map(|k| 1e-3 * (truth(k)[0] * c - truth(k)[1] * b) + noise.sample(&mut rng))
            .collect(),
    };
    let lines = [line(0.0, 0.0), line(lever_mm, 0.0), line(0.0, lever_mm)];
    let found = separate_parallel_lines(&lines)?;
    let errors = found.iter().enumerate().flat_map(|(k, found)| {
        let [a, b] = truth(k);
        [found.angles_urad[0] - a, found.angles_urad[1] - b]
    });
    Ok(errors.fold(0.0, |m: f64, e| m.max(e.abs())))
}

fn figure(
    name: &str,
    unit: &str,
    of: impl Fn(u64) -> Result<f64, Box<dyn Error>>,
) -> Result<(), Box<dyn Error>> {
    let errors = (0..SEEDS).map(of).collect::<Result<Vec<_>, _>>()?;
    let (percentile, worst) = percentile_and_worst(errors);
    println!("{name:<78} {percentile:>8.3} {worst:>8.3} {unit}");
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    println!("{SEEDS} seeds{:<68} {:>8} {:>8}", "", "95 %", "worst");
    for (bridge_mm, noise_urad, runs) in [
        (200.0, 1.0, 1),
        (200.0, 1.0, 5),
        (200.0, 5.0, 1),
        (200.0, 5.0, 10),
        (500.0, 2.0, 1),
        (500.0, 2.0, 10),
        (1000.0, 1.0, 1),
        (1000.0, 1.0, 10),
    ] {
        let um = 1e-3 * bridge_mm * noise_urad;
        let name = format!(
            "straightness over 8 m, bridge {bridge_mm} mm, {noise_urad} µrad ({um} µm a step), runs {runs}"
        );
        figure(&name, "µm", |seed| angular_method(bridge_mm, noise_urad, runs, seed))?;
    }
    for (length_mm, targets) in [(500.0, 11), (500.0, 51), (1000.0, 21), (4000.0, 41)] {
        let bound = 0.5 + 1.0 / length_mm * 1e3;
        let name = format!(
            "squareness, {length_mm} mm, {targets} targets, 1 µm: required {bound:.2} µrad"
        );
        figure(&name, "µrad", |seed| squareness(length_mm, targets, 1.0, seed))?;
    }
    for (lever_mm, runs) in [(1000.0, 1), (1000.0, 10), (2000.0, 10), (4000.0, 10)] {
        let name =
            format!("angles from three lines {lever_mm} mm apart, 21 targets, 1 µm, runs {runs}");
        figure(&name, "µrad", |seed| three_lines(lever_mm, runs, 1.0, seed))?;
    }
    Ok(())
}
