//! Curves with penalties chosen from the observations, robust weights, and the uncertainty of unknowns that a penalty
//! shrinks.

use volcomp_identify::{MachineSampler, identify};
use volcomp_kinematics::State;
use volcomp_kinematics::nalgebra::Vector3;
use volcomp_model::Machine;
use volcomp_vocabulary::AxisName::{C, X, Y, Z};

use crate::lab::{Lab, Noise, csv, tip, value};

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

const SHRUNK_MACHINE: &str = "structure = \"w C' b X Y Z t\"
[axes.X]
travel = [-250.0, 250.0]
[axes.Y]
travel = [-250.0, 250.0]
[axes.Z]
travel = [-250.0, 250.0]
[axes.C]
travel = [-360.0, 360.0]
[tool]
tip = [0.0, 0.0, -100.0]
";
const UNKNOWN: &str = "folds = 0
unknown = [\"EX0C\", \"EY0C\", \"EA0C\", \"EB0C\", \"EC0Y\",
 { error = \"EXX\", legendre = 2 }, { error = \"EYX\", legendre = 2 },
 { error = \"EBX\", legendre = 1 }, { error = \"EZY\", legendre = 2 }]
[[observation]]
kind = \"points\"
file = \"t.csv\"
uncertainty_um = 2.0
[[observation]]
kind = \"sphere\"
file = \"s.csv\"
uncertainty_um = 0.5
";
/// True values: EX0C EY0C EA0C EB0C EC0Y, EXX 1 and 2, EYX 2, EZY 1 and 2.
const TRUTH: [(&str, f64); 10] = [
    ("EX0C", 8.0),
    ("EY0C", -5.0),
    ("EA0C", 20.0),
    ("EB0C", -12.0),
    ("EC0Y", 30.0),
    ("EXX legendre 1", 6.0),
    ("EXX legendre 2", -2.0),
    ("EYX legendre 2", 3.0),
    ("EZY legendre 1", 0.0),
    ("EZY legendre 2", 1.0),
];

/// Number of 95 % bands that contain the truth: of the coefficients (order of the truth), of EBX, and of the position at some poses.
struct Held {
    coefficients: [u32; 11],
    places: u32,
    of_places: u32,
    widths: f64,
}

fn held(penalty: &str, ebx_urad: f64, worlds: u32) -> Held {
    let poly = |l1: f64, l2: f64| {
        format!("{{ poly = [{}, {}, {}] }}", -0.5 * l2, l1 / 250.0, 1.5 * l2 / 62500.0)
    };
    let truth = format!(
        "{SHRUNK_MACHINE}[errors]\nEX0C = 8.0\nEY0C = -5.0\nEA0C = 20.0\nEB0C = -12.0\nEC0Y = 30.0\nEXX = {}\nEYX = {}\nEBX = {}\nEZY = {}\n",
        poly(6.0, -2.0),
        poly(0.0, 3.0),
        poly(ebx_urad, 0.0),
        poly(0.0, 1.0)
    );
    let truth = Machine::parse(&truth, "truth").expect("a machine");
    let lab = Lab::new(SHRUNK_MACHINE);
    let nominal = lab.machine();
    let chain = nominal.chain();
    let centre = Vector3::new(90.0, 40.0, -60.0);
    let mut noise = Noise::new(11);
    let mut held = Held { coefficients: [0; 11], places: 0, of_places: 0, widths: 0.0 };
    for _ in 0..worlds {
        let rows = (0..12).map(|k| {
            let [mut x, mut y, z] = [(); 3].map(|()| noise.between(-240.0, 240.0));
            // Curves extend over the range of the poses.
            match k {
                0 => x = -250.0,
                1 => x = 250.0,
                2 => y = -250.0,
                3 => y = 250.0,
                _ => {}
            }
            let c = noise.between(-180.0, 180.0);
            let at = tip(&truth, &[(X, x), (Y, y), (Z, z), (C, c)], [0.0; 3]);
            let [px, py, pz] = [at.x, at.y, at.z].map(|p| p + noise.normal(0.002));
            [x, y, z, c, px, py, pz]
        });
        lab.write("t.csv", &csv("X,Y,Z,C,x,y,z", rows));
        let rows = (0..12).map(|k| {
            let mut state = State::default();
            let c = -180.0 + 30.0 * f64::from(k);
            state.q[nominal.index_of(C).expect("C")] = c.to_radians();
            chain.bring(&mut state, |_| true, &centre, |state| chain.ideal_tip_mm(state));
            let [x, y, z] = [X, Y, Z].map(|axis| state.q[nominal.index_of(axis).expect("an axis")]);
            let at = tip(&truth, &[(X, x), (Y, y), (Z, z), (C, c)], [0.0; 3]) - centre;
            let [dx, dy, dz] = [at.x, at.y, at.z].map(|p| 1e3 * p + noise.normal(0.5));
            [x, y, z, c, dx, dy, dz]
        });
        lab.write("s.csv", &csv("X,Y,Z,C,dx_um,dy_um,dz_um", rows));
        let observations = lab.read(&format!("penalty = \"{penalty}\"\n{UNKNOWN}")).expect("read");
        let found = identify(&observations, |_, _| {}).expect("found");
        let names = TRUTH.into_iter().chain([("EBX legendre 1", ebx_urad)]);
        for (count, (name, expected)) in held.coefficients.iter_mut().zip(names) {
            let (value, uncertainty) = value(&found, name);
            *count += u32::from((value - expected).abs() < 1.959_964 * uncertainty);
            if name == "EBX legendre 1" {
                held.widths += uncertainty / f64::from(worlds);
            }
        }
        let draws = MachineSampler::new(&observations, &found).expect("draws");
        let machines: Vec<Machine> =
            (0..60).map(|trial| draws.machine(1, trial).expect("a machine")).collect();
        for _ in 0..6 {
            let [x, y, z] = [(); 3].map(|()| noise.between(-240.0, 240.0));
            let at = [(X, x), (Y, y), (Z, z), (C, noise.between(-180.0, 180.0))];
            let wrong = tip(&found.machine, &at, [0.0; 3]) - tip(&truth, &at, [0.0; 3]);
            let middle = tip(&found.machine, &at, [0.0; 3]);
            let mut variance = Vector3::zeros();
            for machine in &machines {
                let off = tip(machine, &at, [0.0; 3]) - middle;
                variance += off.component_mul(&off) / 60.0;
            }
            for axis in 0..3 {
                held.of_places += 1;
                held.places += u32::from(wrong[axis].abs() < 1.959_964 * variance[axis].sqrt());
            }
        }
    }
    held
}

/// 95 % bands of coefficients and positions contain the truth in 93 to 97 % of cases, as without a penalty, for any
/// size of the shrunk errors.
#[test]
fn bands_cover_errors_that_a_penalty_shrinks() {
    let worlds = 150_u32;
    for (penalty, ebx_urad) in
        [("none", 10.0), ("auto", 0.0), ("auto", 2.0), ("auto", 10.0), ("auto", 30.0)]
    {
        let held = held(penalty, ebx_urad, worlds);
        let share = f64::from(held.places) / f64::from(held.of_places);
        println!(
            "{penalty} {ebx_urad}: {:?} of {worlds}, EBX ± {:.2}, places {share:.3}",
            held.coefficients, held.widths
        );
        assert!((0.93..=0.97).contains(&share), "{penalty} {ebx_urad}: {share}");
        // 95 % of 150 simulations are 142.5 ± 2.7.
        for (place, count) in held.coefficients.into_iter().enumerate() {
            assert!(count >= 134, "{penalty} {ebx_urad}: {place}: {count}");
        }
        // The observations hardly determine EBX: its uncertainty equals the uncertainty without a penalty, about 10
        // µrad.
        assert!((8.5..11.0).contains(&held.widths), "{}", held.widths);
    }
}
