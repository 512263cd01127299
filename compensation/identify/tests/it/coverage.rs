//! Coverage of the stated uncertainties, and the spread of Monte Carlo samples from the covariance.
//!
//! The samples are compared with repeated identifications from new readings.

use volcomp_identify::{Identification, IdentifyError, MachineSampler, identify, machine_with};
use volcomp_kinematics::Form;
use volcomp_kinematics::nalgebra::{DMatrix, DVector, Rotation3, Vector3};
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::AxisName::{X, Y, Z};

use crate::lab::{Lab, Noise, csv, tip, value, worn};

const MACHINE: &str = "structure = \"w b X Y t\"
[axes.X]
travel = [0.0, 500.0]
[axes.Y]
travel = [0.0, 400.0]
";
const RUNS: u32 = 500;

/// 95 % bands contain the truth in 93 to 97 % of 500 runs, also in a robust fit where one reading in twelve scatters ten times as much as
/// stated.
#[test]
fn coverage_of_95_percent_bands() {
    let truth = worn(MACHINE, "EC0Y = 20.0\nEXX = { poly = [-5.0, 0.02] }\n");
    let lab = Lab::new(MACHINE);
    // Numbers of columns and rows of poses, and their spacing, mm; the slope in µm is 0.02 µm/mm times half of the
    // extent in X.
    for (seed, robust, [columns, rows], [by_x, by_y], slope) in
        [(5, false, [4, 3], [160.0, 190.0], 4.8), (6, true, [6, 4], [100.0, 125.0], 5.0)]
    {
        let mut noise = Noise::new(seed);
        let mut inside = [0_u32; 2];
        for _ in 0..RUNS {
            let rows = (0..columns * rows).map(|k| {
                let (x, y) = (f64::from(k % columns) * by_x, f64::from(k / columns) * by_y);
                let at = tip(&truth, &[(X, x), (Y, y)], [0.0; 3]);
                let [px, py, pz] = [at.x, at.y, at.z].map(|p| {
                    let is_slip = robust && noise.between(0.0, 1.0) < 0.08;
                    p + noise.normal(if is_slip { 0.03 } else { 0.003 })
                });
                [x, y, px, py, pz]
            });
            lab.write("t.csv", &csv("X,Y,x,y,z", rows));
            let keys = format!(
                "folds = 0\nrobust = {robust}\nunknown = [\"EC0Y\", {{ error = \"EXX\", legendre = 1 }}]\n[[observation]]\nkind = \"points\"\nfile = \"t.csv\"\nuncertainty_um = 3.0\n"
            );
            let found = lab.identify(&keys).expect("found");
            let expected = [("EC0Y", 20.0), ("EXX legendre 1", slope)];
            for (count, (name, expected)) in inside.iter_mut().zip(expected) {
                let (value, uncertainty) = value(&found, name);
                *count += u32::from((value - expected).abs() < 1.959_964 * uncertainty);
            }
        }
        for count in inside {
            let share = f64::from(count) / f64::from(RUNS);
            assert!((0.93..=0.97).contains(&share), "{inside:?} of {RUNS}");
        }
    }
}

const PORTAL: &str = "structure = \"w b X Y Z t\"
[axes.X]
travel = [0.0, 600.0]
[axes.Y]
travel = [0.0, 500.0]
[axes.Z]
travel = [-400.0, 0.0]
";
const MOTIONS: [&str; 6] = ["EXX", "EYX", "EZX", "EAX", "EBX", "ECX"];

/// A tracker target away from the tip, on a machine without rotary axes: tilts of X act at the target with another
/// lever than at the tip. Only a ruler gives the difference of the levers; the uncertainty at the tip includes the
/// uncertainty of the ruler.
#[test]
#[expect(clippy::too_many_lines, reason = "one world, from readings to bands")]
fn coverage_at_the_tip_with_a_ruler_measured_target() {
    const WORLDS: u32 = 100;
    const RULER_MM: f64 = 5.0;
    let target = Vector3::new(40.0, -60.0, -250.0);
    let lab = Lab::new(PORTAL);
    let unknown: Vec<String> =
        MOTIONS.iter().map(|error| format!("{{ error = \"{error}\", legendre = 2 }}")).collect();
    let grid: Vec<[f64; 3]> = (0..27)
        .map(|k| [k % 3, k / 3 % 3, k / 9].map(f64::from))
        .map(|[x, y, z]| [60.0 + 240.0 * x, 250.0 * y, 200.0 * z - 400.0])
        .collect();
    // A rigid motion of the workpiece is not an error of the machine.
    let mut rigid = DMatrix::zeros(81, 6);
    for (row, at) in grid.iter().enumerate() {
        for k in 0..3 {
            rigid[(3 * row + k, k)] = 1.0;
            let turned = Vector3::ith(k, 1e-3).cross(&Vector3::from(*at));
            rigid.fixed_view_mut::<3, 1>(3 * row, 3 + k).copy_from(&turned);
        }
    }
    let rigid = rigid.qr().q();
    let beside = |of: DVector<f64>| &of - &rigid * (rigid.transpose() * &of);
    let of_machine = |machine: &Machine| {
        let errors = grid.iter().flat_map(|[x, y, z]| {
            let state = machine.state(&[(X, *x), (Y, *y), (Z, *z)]).expect("a state");
            let error = machine.error_at(&state, Form::Exact, &Temperatures::default());
            (error.position_mm * 1e3).as_slice().to_vec()
        });
        DVector::from_iterator(81, errors)
    };
    let mut noise = Noise::new(12);
    let mut inside = [0_u32; 6];
    for _ in 0..WORLDS {
        let curves: Vec<[f64; 2]> = MOTIONS
            .iter()
            .map(|error| {
                let size = if matches!(&error[1..2], "A" | "B" | "C") { 200.0 } else { 20.0 };
                [noise.normal(size), noise.normal(size)]
            })
            .collect();
        // Z carries the tool, Y carries Z, and X carries Y, so that an error of X rotates everything.
        let tip = |[x, y, z]: [f64; 3], offset: Vector3<f64>| {
            let t = x / 300.0 - 1.0;
            let of = |k: usize| curves[k][0] * t + curves[k][1] * (1.5 * t * t - 0.5);
            let shift = Vector3::new(of(0), of(1), of(2)) * 1e-3;
            let turn = Rotation3::new(Vector3::new(of(3), of(4), of(5)) * 1e-6);
            Vector3::new(x, 0.0, 0.0) + shift + turn * (Vector3::new(0.0, y, z) + offset)
        };
        let rows = (0..60).map(|_| {
            let ends = [[0.0, 600.0], [0.0, 500.0], [-400.0, 0.0]];
            let [x, y, z] =
                ends.map(|[low, high]| (10.0 * noise.between(low, high)).round() / 10.0);
            let seen = tip([x, y, z], target).map(|p| p + noise.normal(0.0005));
            [x, y, z, seen.x, seen.y, seen.z]
        });
        lab.write("t.csv", &csv("X,Y,Z,x,y,z", rows));
        let ruler = target.map(|x| x + noise.normal(RULER_MM));
        let keys = |target: &str| {
            format!(
                "folds = 0\nunknown = [{}]\n[[observation]]\nkind = \"points\"\nfile = \"t.csv\"\nframe = \"unknown\"\ntarget = {target}\nuncertainty_um = 0.5\n",
                unknown.join(", ")
            )
        };
        let observations = lab
            .read(&keys(&format!(
                "[{:?}, {:?}, {:?}]\ntarget_within_mm = {RULER_MM:?}",
                ruler.x, ruler.y, ruler.z
            )))
            .expect("read");
        let found = identify(&observations, |_, _| {}).expect("found");
        let truth = grid.iter().flat_map(|at| {
            let error = (tip(*at, Vector3::zeros()) - Vector3::from(*at)) * 1e3;
            error.as_slice().to_vec()
        });
        let off = beside(of_machine(&found.machine) - DVector::from_iterator(81, truth));
        let determined: Vec<&str> = found
            .parameters
            .iter()
            .filter(|parameter| parameter.determined)
            .map(|parameter| parameter.name.as_str())
            .collect();
        let columns: Vec<DVector<f64>> = determined
            .iter()
            .map(|name| {
                let unit = machine_with(&observations, &[((*name).to_owned(), 1.0)]);
                beside(of_machine(&unit.expect("a machine")))
            })
            .collect();
        let by = DMatrix::from_columns(&columns);
        let covariance = &by * &found.covariance * by.transpose();
        // The three directions at the first pose, and at the middle of the work space.
        for (count, row) in inside.iter_mut().zip([0, 1, 2, 39, 40, 41]) {
            let uncertainty = covariance[(row, row)].sqrt();
            *count += u32::from(off[row].abs() < 1.959_964 * uncertainty);
        }
    }
    println!("{inside:?} of {WORLDS}");
    let share = f64::from(inside.iter().sum::<u32>()) / f64::from(6 * WORLDS);
    assert!((0.92..=0.98).contains(&share), "{inside:?} of {WORLDS}");
    // Without the ruler, the errors are determined only at the position of the target.
    let message = lab.refused(&format!(
        "folds = 0\nunknown = [{}]\n[[observation]]\nkind = \"points\"\nfile = \"t.csv\"\ntarget = \"unknown\"\n",
        unknown.join(", ")
    ));
    assert!(message.contains("`target_within_mm`"), "{message}");
    assert!(message.contains("t.csv:target."), "{message}");
}

const SAMPLED_MACHINE: &str = "structure = \"w b X Y t\"
axes.X.travel = [0.0, 500.0]
axes.Y.travel = [0.0, 400.0]
";
const TRUTH: &str =
    "[errors]\nEC0Y = 20.0\nEXX = { poly = [0.0, 0.02, 3e-5] }\nECX = { poly = [0.0, 0.05] }\n";
/// The tracker's frame is unknown, so the unknowns are correlated with it and with each other.
const KEYS: &str = "folds = 0
unknown = [\"EC0Y\", { error = \"EXX\", legendre = 2 }, { error = \"ECX\", legendre = 1 }]
[[observation]]
kind = \"points\"
file = \"t.csv\"
frame = \"unknown\"
uncertainty_um = 3.0
";
const REPEATS: usize = 400;
const POSES: [[f64; 2]; 4] = [[0.0, 0.0], [500.0, 0.0], [120.0, 400.0], [500.0, 400.0]];

fn found(lab: &Lab, truth: &Machine, noise: &mut Noise) -> Identification {
    let rows = (0..20).map(|k| {
        let (x, y) = (f64::from(k % 5) * 125.0, f64::from(k / 5) * 133.0);
        let at = tip(truth, &[(X, x), (Y, y)], [0.0; 3]);
        let [px, py, pz] = [at.x, at.y, at.z].map(|p| p + noise.normal(0.003));
        [x, y, px, py, pz]
    });
    lab.write("t.csv", &csv("X,Y,x,y,z", rows));
    lab.identify(KEYS).expect("found")
}

/// Error along X at the poses, µm.
fn errors(machine: &Machine) -> Vec<f64> {
    let error = |[x, y]: [f64; 2]| {
        let state = machine.state(&[(X, x), (Y, y)]).expect("a state");
        let error = machine.error_at(&state, Form::Exact, &Temperatures::default());
        error.position_mm.x * 1e3
    };
    POSES.into_iter().map(error).collect()
}

/// Standard deviation of each number, and correlation of the first with the last.
fn spread(rows: &[Vec<f64>]) -> (Vec<f64>, f64) {
    let count = rows.len() as f64;
    let mean = |k: usize| rows.iter().map(|row| row[k]).sum::<f64>() / count;
    let product = |a: usize, b: usize| {
        let (of_a, of_b) = (mean(a), mean(b));
        let products = rows.iter().map(|row| (row[a] - of_a) * (row[b] - of_b));
        products.sum::<f64>() / (count - 1.0)
    };
    let last = rows[0].len() - 1;
    let deviations: Vec<f64> = (0..=last).map(|k| product(k, k).sqrt()).collect();
    let correlation = product(0, last) / (deviations[0] * deviations[last]);
    (deviations, correlation)
}

#[test]
fn samples_spread_like_repeated_identifications() {
    let truth = Machine::parse(&format!("{SAMPLED_MACHINE}{TRUTH}"), "truth").expect("a machine");
    let lab = Lab::new(SAMPLED_MACHINE);
    let mut noise = Noise::new(11);
    let once = found(&lab, &truth, &mut noise);
    let observations = lab.read(KEYS).expect("read");
    let draws = MachineSampler::new(&observations, &once).expect("of these observations");
    let drawn = |trial| errors(&draws.machine(3, trial).expect("drawn"));
    // With residuals of twice the stated uncertainty the samples spread twice as far.
    assert_eq!(once.excess, 1.0);
    let more = Identification { excess: 2.0, ..once.clone() };
    let wide = MachineSampler::new(&observations, &more).expect("of these observations");
    let wide = errors(&wide.machine(3, 0).expect("drawn"));
    for ((wide, drawn), found) in wide.iter().zip(drawn(0)).zip(errors(&once.machine)) {
        let [wide, drawn] = [wide - found, drawn - found];
        assert!((wide - 2.0 * drawn).abs() < 1e-3 * drawn.abs().max(0.1), "{wide} {drawn}");
    }
    let drawn: Vec<Vec<f64>> = (0..REPEATS as u64).map(drawn).collect();
    let repeat = |_| errors(&found(&lab, &truth, &mut noise).machine);
    let repeated: Vec<Vec<f64>> = (0..REPEATS).map(repeat).collect();
    let (drawn, repeated) = (spread(&drawn), spread(&repeated));
    // Four standard deviations of the ratio of two spreads, and of the difference of two correlations.
    let allowed = 4.0 / (REPEATS as f64).sqrt();
    for (k, (drawn, repeated)) in drawn.0.iter().zip(&repeated.0).enumerate() {
        assert!(*repeated > 0.1, "{k}: {repeated}");
        assert!((drawn / repeated - 1.0).abs() < allowed, "{k}: {drawn} {repeated}");
    }
    let difference = (drawn.1 - repeated.1).abs();
    assert!(difference < allowed * core::f64::consts::SQRT_2, "{} {}", drawn.1, repeated.1);
}

#[test]
fn samples_are_reproducible_and_belong_to_their_observations() {
    let truth = Machine::parse(&format!("{SAMPLED_MACHINE}{TRUTH}"), "truth").expect("a machine");
    let lab = Lab::new(SAMPLED_MACHINE);
    let once = found(&lab, &truth, &mut Noise::new(12));
    let observations = lab.read(KEYS).expect("read");
    let draws = MachineSampler::new(&observations, &once).expect("of these observations");
    let fifth = errors(&draws.machine(1, 5).expect("drawn"));
    let _ = draws.machine(1, 4);
    assert_eq!(errors(&draws.machine(1, 5).expect("drawn")), fifth);
    assert_ne!(errors(&draws.machine(1, 6).expect("drawn")), fifth);
    assert_ne!(errors(&draws.machine(2, 5).expect("drawn")), fifth);
    let other = lab.read(&KEYS.replace("\"EC0Y\", ", "")).expect("read");
    assert!(matches!(MachineSampler::new(&other, &once), Err(IdentifyError::OtherObservations)));
}
