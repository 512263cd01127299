//! A gantry measured without noise along lines away from the points at which its errors are stated.

use std::fmt::Write;

use volcomp_calibrate::{Quality, calibrate};
use volcomp_kinematics::{ErrorSource, Form};
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::{AxisName, ErrorName, Um, Urad};

use crate::lab::Lab;

fn axes() -> String {
    volcomp_test_support::machines::gantry([[0.0, 2000.0], [0.0, 1000.0], [0.0, 800.0]])
}

/// Straightness curves are bent, but over equally spaced targets from end to end they have a mean and a slope of zero.
const TRUTH: &str = r"
EXX = { poly = [0, 0.02, -4e-6] }
EYX = { chebyshev = [0, 0, 0, 5], domain = [0, 2000] }
EAX = { poly = [0, 0.01] }
EBX = { poly = [0, -0.02, 1e-5] }
ECX = { poly = [0, 0.015] }
EYY = { forward = { poly = [0, 0.03] }, backward = { poly = [-2, 0.03] } }
EAY = { poly = [0, -0.04] }
EBY = { poly = [0, 0.01] }
ECY = { poly = [0, 0.02] }
EZZ = { poly = [0, -0.02] }
EAZ = { poly = [0, 0.01] }
EBZ = { poly = [0, 0.02] }
";

fn truth(text: &str) -> Machine {
    Machine::parse(&format!("{}[errors]\n{text}", axes()), "truth").expect("a valid machine")
}

/// Writes the readings of `error` along its axis at 11 targets: δ + ε × lever.
fn write_line(lab: &Lab, machine: &Machine, error: &str, lever: impl Fn(f64) -> [f64; 3]) {
    let name: ErrorName = error.parse().expect("an error name");
    let index = machine.index_of(name.axis).expect("an axis");
    let [low, high] = machine.axis(name.axis).expect("an axis").travel;
    let none = Temperatures::new();
    let mut csv = String::from("target,run,direction,deviation\n");
    for (sign, approach) in [
        ("+", Some(volcomp_vocabulary::Direction::Positive)),
        ("-", Some(volcomp_vocabulary::Direction::Negative)),
    ] {
        for step in 0..=10 {
            let q = low + (high - low) * f64::from(step) / 10.0;
            let mut state = machine.state(&[(name.axis, q)]).expect("a state");
            state.approach[index] = approach;
            let motion = machine.source(&none).error_motion(index, &state);
            let k = name.component.mcs_index();
            let value = if name.component.is_angular() {
                motion.angular_rad[k] * 1e6
            } else {
                let lever = volcomp_kinematics::nalgebra::Vector3::from(lever(q));
                (motion.linear_mm + motion.angular_rad.cross(&lever))[k] * 1e3
            };
            writeln!(csv, "{q},1,{sign},{value:.9}").expect("a String");
        }
    }
    lab.write(&format!("{error}.csv"), &csv);
}

#[test]
fn the_volumetric_error_comes_back() {
    let lab = Lab::new(&axes());
    let machine = truth(TRUTH);
    let mut calibration = String::new();
    let mut measure = |error: &str, keys: &str, lever: &dyn Fn(f64) -> [f64; 3]| {
        write_line(&lab, &machine, error, lever);
        writeln!(
            calibration,
            "[[measurement]]\nerror = \"{error}\"\nfile = \"{error}.csv\"\ncurve = {{ poly = {{ order = 3 }} }}\n{keys}"
        )
        .expect("a String");
    };
    for error in ["EAX", "EBX", "ECX", "EAY", "EBY", "ECY", "EAZ", "EBZ"] {
        measure(error, "", &|_| [0.0; 3]);
    }
    // X: retroreflector on the spindle at Y = 300, Z = 400 (tool side), while the table moves.
    measure("EXX", "at = { Y = 300, Z = 400 }\npoint = [0, 300, 400]\nrides = \"other\"", &|q| {
        [q, 300.0, 400.0]
    });
    measure("EYX", "", &|_| [0.0; 3]);
    // Y at two heights, for the pitch.
    measure("EYY", "at = { Z = 650 }\npoint = [0, 0, 650]", &|_| [0.0, 0.0, 650.0]);
    // Z is measured away from its own point, which moves with Y to Y = 500: the lever is the difference.
    measure("EZZ", "at = { Y = 500 }\npoint = [70, 530, 0]", &|_| [70.0, 30.0, 0.0]);
    calibration += "[[squareness]]\nerror = \"EC0Y\"\nvalue_urad = 25.0\n";
    let file = lab.read(&calibration).expect("read");
    let mut steps = Vec::new();
    let found = calibrate(&file, |done, of| steps.push((done, of))).expect("calibrated");
    assert_eq!(steps.last(), Some(&(12, 12)));
    assert_eq!(found.squareness.len(), 1);
    assert!(
        found.curves.iter().all(|curve| match curve.quality {
            Quality::Length(quality) => quality.residual_rms < Um(1e-6),
            Quality::Angle(quality) => quality.residual_rms < Urad(1e-6),
        }),
        "{:?}",
        found.curves
    );

    let expected = truth(&format!("{TRUTH}EC0Y = 25.0\n"));
    let none = Temperatures::new();
    let error = |machine: &Machine, at: [f64; 3]| {
        let axes = [AxisName::X, AxisName::Y, AxisName::Z];
        let state =
            machine.state(&std::array::from_fn::<_, 3, _>(|i| (axes[i], at[i]))).expect("a state");
        machine.error_at(&state, Form::Exact, &none).position_mm * 1e3
    };
    // The zero of the curves is a convention, so a constant difference is subtracted.
    let origin = error(&found.machine, [0.0; 3]) - error(&expected, [0.0; 3]);
    for x in [0.0, 700.0, 2000.0] {
        for y in [0.0, 400.0, 1000.0] {
            for z in [0.0, 300.0, 800.0] {
                let difference =
                    error(&found.machine, [x, y, z]) - error(&expected, [x, y, z]) - origin;
                // A third-order straightness has a least-squares slope over 11 targets, which is removed with the line and subtracted
                // from the truth below.
                let t = x / 1000.0 - 1.0;
                let slope = straightness_slope();
                let expected_y = -5.0 * slope * (t + 1.0);
                assert!((difference.x).abs() < 2e-3, "{difference} at {x} {y} {z}");
                assert!(
                    (difference.y - expected_y).abs() < 2e-3,
                    "{difference} {expected_y} at {x} {y} {z}"
                );
                assert!((difference.z).abs() < 2e-3, "{difference} at {x} {y} {z}");
            }
        }
    }
    let missing = found.warnings.join("\n");
    for name in ["EZX", "EXY", "EZY", "EXZ", "EYZ", "ECZ", "EA0Z", "EB0Z"] {
        assert!(missing.contains(name), "{name} in {missing}");
    }
    assert!(!missing.contains("EC0Y") && !missing.contains("EXX"), "{missing}");
}

/// Least-squares slope of the Chebyshev polynomial T3 over 11 equally spaced targets of [−1, 1].
fn straightness_slope() -> f64 {
    let t: Vec<f64> = (0..=10).map(|i| f64::from(i) / 5.0 - 1.0).collect();
    let cubic = |t: f64| 4.0 * t * t * t - 3.0 * t;
    t.iter().map(|&t| t * cubic(t)).sum::<f64>() / t.iter().map(|t| t * t).sum::<f64>()
}

#[test]
fn squareness_is_cleared_of_the_tilt_at_the_held_position() {
    let lab = Lab::new(&axes());
    // Physical lines: EXY at X = 500, where ECX = 30 µrad rotates the table (slope −30 µrad plus −ECX·y of the tilt), and EYX with a
    // slope of 4 µrad.
    let write = |name: &str, f: &dyn Fn(f64) -> f64, length: f64| {
        let mut csv = String::from("target,deviation\n");
        for step in 0..=10 {
            let q = length * f64::from(step) / 10.0;
            writeln!(csv, "{q},{:.9}", f(q)).expect("a String");
        }
        lab.write(name, &csv);
    };
    write("ecx.csv", &|q| 0.06 * q, 2000.0);
    write("eyx.csv", &|q| 0.004 * q + 1.0, 2000.0);
    write("exy.csv", &|q| -0.010 * q - 0.030 * q, 1000.0);
    let text = r#"
[[measurement]]
error = "ECX"
file = "ecx.csv"
[[measurement]]
error = "EYX"
file = "eyx.csv"
[[measurement]]
error = "EXY"
file = "exy.csv"
at = { X = 500 }
[[squareness]]
error = "EC0Y"
from = ["EXY", "EYX"]
reference_angle_urad = -3.0
"#;
    let found = lab.calibrated(text);
    // (φ − π/2) − slope(EXY) − slope(EYX) = −3 − (−10) − 4.
    assert!((found.squareness[0].1.0 - 3.0).abs() < 1e-6, "{:?}", found.squareness);
}

/// If no point is stated and the point is on the other side of the joint, the travel is the lever arm: for a tool at
/// rest at the MCS origin, the yaw of the table acts over the distance travelled. The residual is below 1e-4 µm.
#[test]
fn the_travel_is_a_lever_on_the_other_side_without_a_stated_point() {
    let lab = Lab::new(&axes());
    let machine = truth("ECX = { poly = [0, 0.015] }\n");
    let none = Temperatures::new();
    let (mut tilt, mut straightness) =
        (String::from("target,deviation\n"), String::from("target,deviation\n"));
    let mut largest = 0.0_f64;
    for step in 0..=10 {
        let q = 200.0 * f64::from(step);
        let state = machine.state(&[(AxisName::X, q)]).expect("a state");
        let error = machine.error_at(&state, Form::Twist, &none);
        writeln!(tilt, "{q},{:.9}", error.rotation_rad.z * 1e6).expect("a String");
        writeln!(straightness, "{q},{:.9}", error.position_mm.y * 1e3).expect("a String");
        largest = largest.max((error.position_mm.y * 1e3).abs());
    }
    assert!(largest > 50.0, "30 urad over 2 m: {largest}");
    lab.write("ecx.csv", &tilt);
    lab.write("eyx.csv", &straightness);
    let text = "[[measurement]]\nerror = \"ECX\"\nfile = \"ecx.csv\"\n\
                [[measurement]]\nerror = \"EYX\"\nfile = \"eyx.csv\"\nrides = \"other\"\n";
    let found = lab.calibrated(text);
    for x in [0.0, 300.0, 1000.0, 2000.0] {
        let state = found.machine.state(&[(AxisName::X, x)]).expect("a state");
        let difference = found.machine.error_at(&state, Form::Twist, &none).position_mm
            - machine.error_at(&state, Form::Twist, &none).position_mm;
        assert!(difference.norm() * 1e3 < 1e-4, "{difference} at {x}");
    }
}
