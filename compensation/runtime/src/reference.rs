//! A fixed computation whose time tells how fast a computer is at the moment. The times of the cycle's own work are
//! stated beside it, so that those of two computers can be compared.

/// The degree of the polynomial.
const DEGREE: usize = 511;

/// The coefficients 1 / (k + 1), 4 KB: so that what is read comes from memory as the model's tables do.
static COEFFICIENTS: [f64; DEGREE + 1] = {
    let mut coefficients = [0.0; DEGREE + 1];
    let mut power = 0;
    while power <= DEGREE {
        // Below 512, so exact.
        coefficients[power] = 1.0 / (power + 1) as f64;
        power += 1;
    }
    coefficients
};

/// The polynomial of degree 511 with the coefficients 1 / (k + 1) by Horner's rule: 511 multiplications and additions,
/// each of which needs the result of the one before. It never changes, so that results stay comparable.
#[must_use]
pub fn reference_work(x: f64) -> f64 {
    let powers = COEFFICIENTS.iter().rev();
    powers.fold(0.0, |sum, coefficient| sum * x + coefficient)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The series is -ln(1 - x) / x.
    #[test]
    fn it_is_the_series_of_the_logarithm() {
        for x in [-0.9_f64, -0.5, 0.25, 0.5, 0.9] {
            let expected = -(1.0 - x).ln() / x;
            assert!(
                (reference_work(x) - expected).abs() < 1e-14 * expected,
                "{x}"
            );
        }
    }
}
