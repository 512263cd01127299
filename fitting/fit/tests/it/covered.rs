//! Coverage of plotted bands.

use volcomp_fit::{BandOptions, Between, FitOptions, Noise, band, band_places, choose};

use crate::generated::Generated;

/// Counts of sampled positions: `places` in total, `held` where the truth is within the plotted band, `held_by_targets`
/// where it is within the band of the targets alone. Bands are interpolated between their positions.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Covered {
    pub(crate) places: u32,
    pub(crate) held: u32,
    pub(crate) held_by_targets: u32,
    /// Sum of the half widths of the band over the sampled positions, µm.
    pub(crate) width: f64,
    /// Sum of the absolute errors of the curve over the sampled positions, µm.
    pub(crate) missed: f64,
    /// Number of curves; `warned` is the number of curves with a warning about sparse targets.
    pub(crate) curves: u32,
    pub(crate) warned: u32,
}

impl Covered {
    pub(crate) fn share(&self) -> f64 {
        f64::from(self.held) / f64::from(self.places)
    }

    #[allow(dead_code, reason = "the tests ask for less than the example")]
    pub(crate) fn share_of_targets(&self) -> f64 {
        f64::from(self.held_by_targets) / f64::from(self.places)
    }

    pub(crate) fn add(&mut self, other: Self) {
        self.places += other.places;
        self.held += other.held;
        self.held_by_targets += other.held_by_targets;
        self.width += other.width;
        self.missed += other.missed;
        self.curves += other.curves;
        self.warned += other.warned;
    }
}

/// Linear interpolation at `x` between the ascending positions `at`.
fn drawn(at: &[f64], half: &[f64], x: f64) -> f64 {
    let next = at.partition_point(|at| *at < x).clamp(1, at.len() - 1);
    let part = (x - at[next - 1]) / (at[next] - at[next - 1]);
    half[next - 1] + part * (half[next] - half[next - 1])
}

/// Scatter of the mean of all runs, pooled over the targets; `None` without a difference between runs.
fn noise_of_mean(runs: &[Vec<f64>], means: &[f64]) -> Option<Noise> {
    let of_run =
        |run: &Vec<f64>| -> f64 { run.iter().zip(means).map(|(u, m)| (u - m).powi(2)).sum() };
    let (count, squares) = (runs.len() as f64, runs.iter().map(of_run).sum::<f64>());
    let freedom = (count - 1.0) * means.len() as f64;
    let deviation = (squares / freedom / count).sqrt();
    (deviation > 0.0 && deviation.is_finite()).then_some(Noise { deviation, freedom })
}

/// Coverage of one generated line by the band of its automatically chosen curve, at `places` + 1 positions in each
/// direction.
pub(crate) fn covered(line: &Generated, places: u32) -> Covered {
    let readings = line.sides.iter().map(|s| s.readings(&line.targets));
    let sets: Vec<(Vec<f64>, Vec<f64>)> = readings.collect();
    let parts: Vec<(&[f64], &[f64])> = sets.iter().map(|(x, u)| (&x[..], &u[..])).collect();
    let method = choose(&parts, &FitOptions::default()).expect("a curve").method;
    let dense = band_places(&line.targets);
    let [first, last] = [line.targets[0], line.targets[line.targets.len() - 1]];
    let mut all = Covered::default();
    for side in &line.sides {
        let runs: Vec<(&[f64], &[f64])> =
            (side.runs.iter()).map(|u| (&line.targets[..], &u[..])).collect();
        let of = |at: &[f64]| band(method, &runs, at, &BandOptions::default()).expect("a band");
        let (dense, sparse) = (of(&dense), of(&line.targets));
        let runs_of = side.runs.len();
        let mean = |place: usize| side.runs.iter().map(|u| u[place]).sum::<f64>() / runs_of as f64;
        let means: Vec<f64> = (0..line.targets.len()).map(mean).collect();
        let fit = method.fit(&line.targets, &means).expect("a curve");
        let noise = noise_of_mean(&side.runs, &means);
        let between = Between::of(&fit, &line.targets, &means, noise);
        all.curves += 1;
        all.warned += u32::from(between.is_too_sparse());
        let curve = fit.curve;
        for place in 0..=places {
            let x = first + (last - first) * f64::from(place) / f64::from(places);
            let miss = (curve.value(x) - (side.truth)(x)).abs();
            let half = drawn(&dense.at, &dense.half_width, x);
            all.add(Covered {
                places: 1,
                held: u32::from(miss <= half),
                held_by_targets: u32::from(miss <= drawn(&sparse.at, &sparse.half_width, x)),
                width: if half.is_finite() { half } else { 0.0 },
                missed: miss,
                ..Covered::default()
            });
        }
    }
    all
}
