use volcomp_curve::{BSpline, Chebyshev, Curve, Fourier, Polynomial, Table};

fn close(found: f64, expected: f64) {
    assert!((found - expected).abs() <= 1e-12 * (1.0 + expected.abs()), "{found} != {expected}");
}

#[test]
fn polynomial_of_the_machine_file() {
    let exx = Polynomial::new(vec![0.0, 0.0073, -2.1e-7], [0.0, 8000.0]).unwrap();
    close(exx.value(4000.0), 0.0073 * 4000.0 - 2.1e-7 * 16e6);
    close(exx.derivative(4000.0), 0.0073 - 4.2e-7 * 4000.0);
    close(exx.value(9000.0), exx.value(8000.0));
    assert_eq!(exx.derivative(8000.1), 0.0);
    assert!(exx.derivative(8000.0) != 0.0);
}

#[test]
fn chebyshev_is_the_cosine_of_multiple_angles() {
    let coefficients = vec![0.4, -1.2, 3.0, 0.7, -2.2];
    let eyx = Chebyshev::new(coefficients.clone(), [100.0, 8000.0]).unwrap();
    for i in 1..20 {
        let angle = f64::from(i) * 0.15;
        let x = 4050.0 + 3950.0 * angle.cos();
        let terms = coefficients.iter().zip(0_u32..).map(|(c, k)| (c, f64::from(k)));
        let value: f64 = terms.clone().map(|(c, k)| c * (k * angle).cos()).sum();
        let slope: f64 = terms.map(|(c, k)| c * k * (k * angle).sin() / angle.sin()).sum();
        close(eyx.value(x), value);
        close(eyx.derivative(x), slope / 3950.0);
    }
    // The coefficient c0 is not halved; at the upper end all terms are 1.
    close(eyx.value(8000.0), 0.4 - 1.2 + 3.0 + 0.7 - 2.2);
}

#[test]
fn fourier_of_the_machine_file() {
    let eac = Fourier::new(vec![0.5, 3.0, -1.2, 0.3, 0.2], 360.0, [-360.0, 360.0]).unwrap();
    for degrees in [-350.0, -90.0, 0.0, 33.0, 270.0_f64] {
        let q = degrees.to_radians();
        let value =
            0.5 + 3.0 * q.cos() - 1.2 * q.sin() + 0.3 * (2.0 * q).cos() + 0.2 * (2.0 * q).sin();
        let slope = -3.0 * q.sin() - 1.2 * q.cos() - 0.6 * (2.0 * q).sin() + 0.4 * (2.0 * q).cos();
        close(eac.value(degrees), value);
        close(eac.derivative(degrees), slope.to_radians());
    }
}

#[test]
fn linear_table_of_the_machine_file() {
    let ezx = Table::linear(vec![[0.0, 0.0], [400.0, 1.5], [500.0, 1.0]]).unwrap();
    close(ezx.value(100.0), 0.375);
    close(ezx.derivative(0.0), 1.5 / 400.0);
    close(ezx.derivative(400.0), -0.005);
    close(ezx.derivative(500.0), -0.005);
    close(ezx.value(-3.0), 0.0);
}

#[test]
fn cubic_bspline_with_bezier_knots_is_the_bernstein_polynomial() {
    let knots = vec![0.0, 0.0, 0.0, 0.0, 2.0, 2.0, 2.0, 2.0];
    let spline = BSpline::new(knots, vec![1.0, -2.0, 4.0, 0.5], 3).unwrap();
    for i in 0..=8 {
        let s = f64::from(i) / 8.0;
        let r = 1.0 - s;
        let value = r * r * r - 6.0 * s * r * r + 12.0 * s * s * r + 0.5 * s * s * s;
        close(spline.value(2.0 * s), value);
    }
}

#[test]
fn constant_is_unbounded() {
    let constant = Curve::constant(12.0).unwrap();
    assert_eq!(constant.value(1e300), 12.0);
    assert_eq!(constant.derivative(1.0), 0.0);
    assert!(constant.contains(f64::INFINITY) && !constant.contains(f64::NAN));
    assert_eq!(constant.domain(), None);
    assert!(constant.breakpoints().is_empty());
}

#[test]
fn breakpoints_are_sorted_and_inside() {
    let table = Table::cubic(vec![[0.0, 1.0], [2.0, 3.0], [5.0, 0.0]]).unwrap();
    assert_eq!(Curve::Table(table).breakpoints(), [0.0, 2.0, 5.0]);
    let knots = vec![-1.0, 0.0, 1.0, 1.0, 3.0, 4.0];
    let spline = BSpline::new(knots, vec![0.0; 3], 2).unwrap_err();
    assert!(spline.to_string().contains("domain [1, 1]"), "{spline}");
    let spline = BSpline::new(vec![-1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0], vec![0.0; 4], 2).unwrap();
    assert_eq!(Curve::BSpline(spline).breakpoints(), [1.0, 2.0, 3.0]);
}
