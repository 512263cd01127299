//! Curves with penalties chosen from the observations, and robust weights.

use crate::lab::{Lab, Noise, csv};

const MACHINE: &str = "structure = \"w b X t\"
[axes.X]
travel = [0.0, 1000.0]
";

fn readings(of: impl Fn(f64) -> f64, sigma: f64) -> String {
    let mut noise = Noise::new(3);
    let rows = (0..60).map(|k| {
        let x = f64::from(k) * 1000.0 / 59.0;
        [x, of(x) + noise.normal(sigma)]
    });
    csv("X,deviation_um", rows)
}

const TEXT: &str = "penalty = \"auto\"\nfolds = 10
unknown = [{ error = \"EXX\", bspline = 20 }]
[[observation]]
kind = \"line\"
file = \"x.csv\"
direction = [1, 0, 0]
";

#[test]
fn a_straight_line_takes_two_coefficients_and_a_wave_takes_what_it_needs() {
    let lab = Lab::new(MACHINE);
    lab.write("x.csv", &readings(|x| 0.01 * x - 3.0, 1.0));
    let straight = lab.identify(TEXT).expect("found");
    assert!((1.0..6.0).contains(&straight.degrees), "{}", straight.degrees);
    lab.write("x.csv", &readings(|x| 10.0 * (x / 60.0).sin(), 1.0));
    let bent = lab.identify(TEXT).expect("found");
    assert!((10.0..20.0).contains(&bent.degrees), "{}", bent.degrees);
    // The curve deviates from the truth by less than the scatter of the readings.
    let curve = bent.machine.error("EXX".parse().expect("a name")).expect("a curve");
    let wrong = (0..100).map(|k| {
        let x = 10.0 * f64::from(k);
        (curve.value(0, &[x], None) - 10.0 * (x / 60.0).sin()).powi(2)
    });
    let rms = (wrong.sum::<f64>() / 100.0).sqrt();
    assert!(rms < 0.8, "{rms}");
    let left = bent.left_out.expect("judged").figures.rms_um;
    assert!((0.8..1.6).contains(&left), "{left}");
}

#[test]
fn noise_above_the_stated_uncertainty_is_noted() {
    let lab = Lab::new(MACHINE);
    lab.write("x.csv", &readings(|x| 0.01 * x, 5.0));
    let found = lab.identify(TEXT).expect("found");
    assert!((3.5..6.5).contains(&found.variance.sqrt()), "{}", found.variance);
    assert!(
        crate::lab::words(&found).lines().any(|w| w.contains("times the stated uncertainty")),
        "{:?}",
        found.warnings
    );
}

const THREE_AXES: &str = "structure = \"w b X Y Z t\"
axes.X.travel = [0.0, 600.0]
axes.Y.travel = [0.0, 600.0]
axes.Z.travel = [0.0, 600.0]
";

#[test]
fn a_robust_fit_of_many_curves_converges() {
    let lab = Lab::new(THREE_AXES);
    let curves = ["EXX", "EYX", "EYY", "EZY", "EZZ", "EXZ"]
        .map(|error| format!("{{ error = \"{error}\", bspline = 10 }}"));
    let text = format!(
        "robust = true\nfolds = 0\nunknown = [\"EC0Y\", \"EA0Z\", \"EB0Z\", {}]\n[[observation]]\nkind = \"points\"\nfile = \"t.csv\"\nuncertainty_um = 2.0\n",
        curves.join(", ")
    );
    for seed in 0..12 {
        let mut noise = Noise::new(seed);
        let rows = (0..60).map(|_| {
            let at = [(); 3].map(|()| noise.between(0.0, 600.0));
            // EC0Y = 20 µrad.
            let tip = [at[0] - 20e-6 * at[1], at[1], at[2]];
            let is_slip = noise.between(0.0, 1.0) < 0.15;
            let [x, y, z] = tip.map(|q| q + noise.normal(if is_slip { 0.05 } else { 0.002 }));
            [at[0], at[1], at[2], x, y, z]
        });
        lab.write("t.csv", &csv("X,Y,Z,x,y,z", rows));
        let found = lab.identify(&text);
        let found = found.unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        assert!(found.variance.is_finite());
    }
}
