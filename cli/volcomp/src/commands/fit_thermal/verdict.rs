//! Whether thermal terms are worth having: by what they leave in the parts of the tests that they have not seen.

/// A root mean square error that is larger or smaller by this share is no difference that anybody would see.
pub(super) const NO_DIFFERENCE: f64 = 0.1;

/// What is said of terms.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    Good,
    /// They predict no better than no terms at all.
    NoBetterThanNone,
    /// They predict worse than regression without time constants.
    WorseThanPlain,
}

/// The mean of the differences of two lists, part by part, and its standard error. Parts without a number in one of them, of
/// which a gap left out every row, are passed over; where none has one, neither has the mean.
pub(super) fn difference(these: &[f64], those: &[f64]) -> (f64, f64) {
    let of = these.iter().zip(those).map(|(a, b)| a - b);
    let of: Vec<f64> = of.filter(|difference| !difference.is_nan()).collect();
    let count = of.len() as f64;
    if of.is_empty() && !these.is_empty() {
        return (f64::NAN, f64::NAN);
    }
    let mean = of.iter().sum::<f64>() / count.max(1.0);
    let squares: f64 = of.iter().map(|d| (d - mean).powi(2)).sum();
    (
        mean,
        (squares / (count - 1.0).max(1.0) / count.max(1.0)).sqrt(),
    )
}

/// The difference of mean squares that is not seen beside these.
fn unseen(squares: &[f64]) -> f64 {
    let known = || squares.iter().filter(|square| !square.is_nan());
    let mean = known().sum::<f64>() / known().count().max(1) as f64;
    ((1.0 + NO_DIFFERENCE).powi(2) - 1.0) * mean
}

/// Judges terms by the mean square errors in each part that they predict, against those of terms without time constants and
/// those of no terms at all. A difference counts where it is larger than its standard error over the parts, and large enough to be seen.
pub(super) fn verdict(few: &[f64], plain: &[f64], none: &[f64]) -> Verdict {
    let (gain, scatter) = difference(none, few);
    // Also where there is nothing to compare, or a number is none.
    if gain.is_nan() || gain <= scatter.max(unseen(none)) {
        return Verdict::NoBetterThanNone;
    }
    let (loss, scatter) = difference(few, plain);
    if loss > scatter.max(unseen(plain)) {
        return Verdict::WorseThanPlain;
    }
    Verdict::Good
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_told_apart_is_no_reason() {
        let none = [900.0, 800.0, 950.0, 1000.0];
        let plain = [0.048, 0.05, 0.047, 0.049];
        // 0.23 against 0.22.
        let few = [0.052, 0.055, 0.05, 0.053];
        assert_eq!(verdict(&few, &plain, &none), Verdict::Good);
        assert_eq!(verdict(&[0.1; 4], &plain, &none), Verdict::WorseThanPlain);
        // Worse in one part of four only.
        assert_eq!(
            verdict(&[0.04, 0.04, 0.04, 0.1], &plain, &none),
            Verdict::Good
        );
        assert_eq!(verdict(&none, &plain, &none), Verdict::NoBetterThanNone);
        assert_eq!(
            verdict(&[f64::NAN; 4], &plain, &none),
            Verdict::NoBetterThanNone
        );
        assert_eq!(verdict(&[], &[], &[]), Verdict::NoBetterThanNone);
        // A stretch of which a gap left out every row.
        let gap = [0.052, f64::NAN, 0.05, 0.053];
        assert_eq!(verdict(&gap, &plain, &none), Verdict::Good);
    }
}
