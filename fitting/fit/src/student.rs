//! Student's t.

/// The value that Student's t with so many degrees of freedom, 1 at the least, exceeds to both sides in one of twenty cases
/// (G. W. Hill, Algorithm 396, Comm. ACM 13, 1970; better than 1e-3 of the value).
pub(crate) fn student_95(freedom: f64) -> f64 {
    const BOTH_TAILS: f64 = 0.05;
    const NORMAL: f64 = -1.959_964;
    let n = freedom.max(1.0);
    if n < 1.000_001 {
        return 12.706_205;
    }
    let a = 1.0 / (n - 0.5);
    let b = 48.0 / (a * a);
    let mut c = ((20_700.0 * a / b - 98.0) * a - 16.0) * a + 96.36;
    let d = ((94.5 / (b + c) - 3.0) / b + 1.0) * (a * std::f64::consts::FRAC_PI_2).sqrt() * n;
    let mut y = (d * BOTH_TAILS).powf(2.0 / n);
    if y > 0.05 + a {
        let x = NORMAL;
        y = x * x;
        if n < 5.0 {
            c += 0.3 * (n - 4.5) * (x + 0.6);
        }
        c += (((0.05 * d * x - 5.0) * x - 7.0) * x - 2.0) * x + b;
        y = (((((0.4 * y + 6.3) * y + 36.0) * y + 94.5) / c - y - 3.0) / b + 1.0) * x;
        y = a * y * y;
        y = y.exp_m1();
    } else {
        y = ((1.0 / (((n + 6.0) / (n * y) - 0.089 * d - 0.822) * (n + 2.0) * 3.0)
            + 0.5 / (n + 4.0))
            * y
            - 1.0)
            * (n + 1.0)
            / (n + 2.0)
            + 1.0 / y;
    }
    (n * y).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Table G.2 of JCGM 100.
    #[test]
    fn the_values_of_the_table() {
        for (freedom, t) in [
            (1.0, 12.706),
            (2.0, 4.303),
            (3.0, 3.182),
            (4.0, 2.776),
            (5.0, 2.571),
            (10.0, 2.228),
            (20.0, 2.086),
            (100.0, 1.984),
        ] {
            let found = student_95(freedom);
            assert!((found / t - 1.0).abs() < 1.5e-3, "{freedom}: {found} {t}");
        }
        assert!((student_95(1e9) - 1.96).abs() < 1e-3);
    }
}
