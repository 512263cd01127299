//! How much wider a standard uncertainty has to be where parts of it come from the scatter of a few runs.

use volcomp_fit::student_widening;

/// What the scatters of lines, each of a few runs, add to a variance, and how well all of them together are known.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct FewRuns {
    variance: f64,
    /// The sums of the squares of the parts over ν and over ν + 2, ν the degrees of freedom of each.
    over_degrees: f64,
    over_two_more: f64,
}

impl FewRuns {
    /// Adds a part of the variance that comes from a scatter with so many degrees of freedom.
    pub(crate) fn add(&mut self, variance: f64, degrees: f64) {
        self.variance += variance;
        self.over_degrees += variance * variance / degrees;
        self.over_two_more += variance * variance / (degrees + 2.0);
    }

    /// The factor by which a standard uncertainty of this variance, of which the scatters are a part, has to be wider, so that
    /// ±1.96 of it are a band of 95 %.
    ///
    /// The formula of Welch and Satterthwaite (JCGM 100, G.4) takes each estimated variance for the true one. A scatter of two
    /// runs is by chance often much less than it should be; its share of the whole then looks small and the whole looks well known just
    /// where the band is too narrow: with one scatter of two runs beside what is known well such bands hold down to 87 %. Here the degrees of freedom
    /// are those of the scatters alone, and the factor is Student's for these to the power of their share of the variance: so bands hold 91.5 to 97.5 % in
    /// mixtures of one to ten scatters of two to five runs and what is known well.
    pub(crate) fn widening(&self, variance: f64) -> f64 {
        let square = self.variance * self.variance;
        if square <= 0.0 || self.over_degrees <= 0.0 {
            return 1.0;
        }
        // The square of an estimated variance is on average 1 + 2/ν times that of the true one. Left as it is it makes the degrees too few,
        // without it they are too many where there are few scatters: between both.
        let few = square / self.over_degrees;
        let many = square / self.over_two_more - 2.0;
        let degrees = (few * many.max(1.0)).sqrt();
        let share = (self.variance / variance).clamp(0.0, 1.0);
        student_widening(degrees).powf(share)
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{ChiSquared, Distribution, StandardNormal};

    use super::*;

    /// A single scatter has its own degrees of freedom, and two alike have two and √(2ν · (2 (ν + 2) − 2)), worked out by hand.
    #[test]
    fn scatters_alone_have_the_factor_of_student() {
        let widening = |parts: &[(f64, f64)], variance: f64| {
            let mut all = FewRuns::default();
            for (part, degrees) in parts {
                all.add(*part, *degrees);
            }
            all.widening(variance)
        };
        // Table G.2 of JCGM 100.
        for (degrees, t) in [(1.0, 12.706_205), (2.0, 4.302_653), (4.0, 2.776_445)] {
            let found = widening(&[(3.0, degrees)], 3.0) * 1.959_964;
            assert!((found / t - 1.0).abs() < 1e-6, "{found} {t}");
        }
        // 2 · 1 and 2 · 3 − 2: √8.
        let two = widening(&[(1.0, 1.0), (1.0, 1.0)], 2.0);
        assert!((two - student_widening(8.0_f64.sqrt())).abs() < 1e-12);
        // Nothing of it from scatters, and nothing of it at all.
        assert_eq!(widening(&[], 4.0), 1.0);
        assert_eq!(widening(&[(0.0, 1.0)], 0.0), 1.0);
        let little = widening(&[(1e-6, 1.0)], 1.0);
        assert!((1.0..1.001).contains(&little), "{little}");
    }

    /// Bands of 95 % over many mixtures of scatters and of what is known well. With the formula of Welch and Satterthwaite
    /// those of one scatter of two runs hold 87 to 93 %.
    #[test]
    fn bands_hold_whatever_part_the_scatters_are() {
        const TRIALS: u32 = 20_000;
        let mixtures: [&[f64]; 10] = [
            &[1.0],
            &[0.9],
            &[0.8],
            &[0.5],
            &[0.3],
            &[0.1],
            &[0.35, 0.35],
            &[0.48, 0.02, 0.02, 0.02],
            &[0.2; 5],
            &[0.1; 10],
        ];
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        for degrees in [1.0, 2.0, 4.0] {
            let chance = ChiSquared::new(degrees).expect("degrees");
            for mixture in mixtures {
                let known = 1.0 - mixture.iter().sum::<f64>();
                let mut inside = 0;
                for _ in 0..TRIALS {
                    let mut scatters = FewRuns::default();
                    let mut variance = known.max(0.0);
                    for share in mixture {
                        let part: f64 = share * chance.sample(&mut rng) / degrees;
                        scatters.add(part, degrees);
                        variance += part;
                    }
                    let error: f64 = StandardNormal.sample(&mut rng);
                    let band = 1.959_964 * variance.sqrt() * scatters.widening(variance);
                    inside += u32::from(error.abs() < band);
                }
                let share = f64::from(inside) / f64::from(TRIALS);
                assert!(
                    (0.91..0.975).contains(&share),
                    "{degrees} {mixture:?}: {share}"
                );
            }
        }
    }
}
