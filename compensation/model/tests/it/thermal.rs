//! Thermal terms over time, compared with closed forms and with machines at steady temperatures.

use assert_no_alloc::assert_no_alloc;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_kinematics::{Form, State};
use volcomp_model::{Fading, Machine, Temperatures, ThermalState, Tolerance};
use volcomp_vocabulary::{AxisName, PerAxis};

use crate::EXAMPLE;

const THREE_AXES: &str = r#"
structure = "w X' b Y Z t"
[axes.X]
travel = [0.0, 800.0]
[axes.Y]
travel = [0.0, 400.0]
point = [0.0, 10.0, -30.0]
[axes.Z]
travel = [0.0, 250.0]
[tool]
tip = [0.0, 0.0, -150.0]
[errors]
EXX = { poly = [0.0, 0.01] }
[[thermal.expansion]]
error = "EYY"
sensor = "scale_y"
um_per_m_k = 11.5
fixed_mm = 100.0
[[thermal.drift]]
error = "EAY"
sensors = { spindle = 1.0, bed = -0.5 }
urad_per_k = 2.0
lag_s = 600.0
"#;

fn state_of(text: &str) -> (Machine, ThermalState) {
    let machine = Machine::parse(text, "m").unwrap();
    let thermal = ThermalState::new(&machine, Fading::default()).unwrap();
    (machine, thermal)
}

fn steady(thermal: &ThermalState, degc: &[Option<f64>]) -> Temperatures {
    let named = thermal.sensors().iter().zip(degc);
    named.filter_map(|(name, degc)| Some((name.clone(), (*degc)?))).collect()
}

/// At steady temperatures the error equals that of a machine compiled at these temperatures, with three axes and with more. Nothing allocates.
#[test]
fn steady_temperatures_are_those_of_the_source() {
    for text in [THREE_AXES, EXAMPLE] {
        let (machine, mut thermal) = state_of(text);
        let degc = [Some(26.5), Some(31.0), Some(18.0)];
        let temperatures = steady(&thermal, &degc);
        let mut compiled = machine.compile(Tolerance::default()).unwrap();
        assert_no_alloc(|| {
            thermal.step(0.001, &degc);
            thermal.apply(&mut compiled);
        });
        assert!(!thermal.is_degraded());
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut moved = 0.0_f64;
        for _ in 0..500 {
            let mut state = State::default();
            for q in state.q.iter_mut().take(machine.axes().len()).skip(1) {
                *q = rng.random_range(-500.0..500.0);
            }
            let expected = machine.error_at(&state, Form::Twist, &temperatures);
            let (found, first) = (compiled.evaluate(&state), compiled.first_order(&state));
            let cold = machine.error_at(&state, Form::Twist, &Temperatures::new());
            assert_eq!(found, first.error);
            for k in 0..3 {
                assert!((expected.position_mm[k] - found.position_mm[k]).abs() < 5e-5);
                assert!((expected.rotation_rad[k] - found.rotation_rad[k]).abs() < 5e-9);
                moved = moved.max((expected.position_mm[k] - cold.position_mm[k]).abs());
            }
            let source = machine.source(&temperatures);
            for axis in 0..machine.axes().len() {
                use volcomp_kinematics::ErrorSource;
                let (a, b) =
                    (source.error_motion(axis, &state), compiled.error_motion(axis, &state));
                assert!((a.linear_mm - b.linear_mm).norm() < 5e-6);
                assert!((a.angular_rad - b.angular_rad).norm() < 5e-9);
            }
        }
        assert!(moved > 0.01, "{moved}");
        // Back at the reference temperature the terms are zero.
        thermal.step(1e9, &[Some(20.0); 3]);
        thermal.apply(&mut compiled);
        let cold = machine.compile(Tolerance::default()).unwrap();
        let state = State { q: PerAxis::leading([0.3, 20.0, 30.0, 40.0]), ..State::default() };
        assert_eq!(compiled.evaluate(&state), cold.evaluate(&state));
    }
}

/// Angle of Y about X at coordinate 0 in this thermal state, rad.
fn tilt_y(machine: &Machine, thermal: &ThermalState) -> f64 {
    let mut compiled = machine.compile(Tolerance::default()).unwrap();
    thermal.apply(&mut compiled);
    compiled.evaluate(&State::default()).rotation_rad[0]
}

/// The response to a temperature step is 1 − exp(−t/τ), in one time step or in many of any length.
#[test]
fn a_lag_answers_a_step_exactly() {
    let (machine, start) = state_of(THREE_AXES);
    // In the order of names: bed, scale_y, spindle.
    let at = |spindle: f64| [Some(20.0), Some(20.0), Some(spindle)];
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    for pieces in [1, 7, 1000] {
        let mut thermal = start.clone();
        thermal.step(0.0, &at(20.0));
        let mut left_s: f64 = 450.0;
        for piece in 0..pieces {
            let dt_s =
                if piece + 1 == pieces { left_s } else { left_s * rng.random_range(0.0..0.5) };
            thermal.step(dt_s, &at(30.0));
            left_s -= dt_s;
        }
        let expected = 2e-6 * 10.0 * (1.0 - (-450.0_f64 / 600.0).exp());
        assert!((tilt_y(&machine, &thermal) - expected).abs() < 1e-15);
    }
    // The lag starts at its first input.
    let mut thermal = start;
    thermal.step(1.0, &at(30.0));
    assert!((tilt_y(&machine, &thermal) - 2e-5).abs() < 1e-15);
}

#[test]
fn a_missing_sensor_holds_then_fades_then_counts_again() {
    let (machine, mut thermal) = state_of(THREE_AXES);
    let (warm, missing) = ([Some(20.0), Some(20.0), Some(30.0)], [Some(20.0), Some(20.0), None]);
    thermal.step(1.0, &missing);
    assert!(thermal.is_degraded());
    assert!(tilt_y(&machine, &thermal).abs() < 1e-15, "no temperature");
    thermal.step(1.0, &warm);
    assert!(!thermal.is_degraded());
    thermal.step(299.0, &missing);
    assert!(thermal.is_degraded());
    assert!((tilt_y(&machine, &thermal) - 2e-5).abs() < 1e-15, "held");
    thermal.step(301.0, &[Some(20.0), Some(20.0), Some(f64::NAN)]);
    assert!((tilt_y(&machine, &thermal) - 1e-5).abs() < 1e-15, "half faded");
    thermal.step(1e6, &missing);
    assert!(tilt_y(&machine, &thermal).abs() < 1e-15, "gone");
    thermal.step(150.0, &warm);
    assert!(thermal.is_degraded(), "comes in again");
    assert!((tilt_y(&machine, &thermal) - 0.5e-5).abs() < 1e-15);
    thermal.step(450.0, &warm);
    assert!(!thermal.is_degraded());
    assert!((tilt_y(&machine, &thermal) - 2e-5).abs() < 1e-15, "back");
}

/// The machine cools while a sensor is missing, and its term fades. When the sensor returns, the term continues from the new temperature, not
/// from its value of hours ago.
#[test]
fn a_term_that_has_faded_does_not_go_back_to_its_value_of_hours_ago() {
    let (machine, mut thermal) = state_of(THREE_AXES);
    let at = |spindle: Option<f64>| [Some(20.0), Some(20.0), spindle];
    thermal.step(0.0, &at(Some(40.0)));
    assert!((tilt_y(&machine, &thermal) - 4e-5).abs() < 1e-15);
    for _ in 0..36_000 {
        thermal.step(1.0, &at(None));
    }
    assert!(tilt_y(&machine, &thermal).abs() < 1e-15, "faded");
    for _ in 0..3600 {
        thermal.step(1.0, &at(Some(20.0)));
        assert!(tilt_y(&machine, &thermal).abs() < 1e-12);
    }
    // After a short time without temperatures, the lag advances over that time with the next temperature.
    let (_, mut thermal) = state_of(THREE_AXES);
    thermal.step(0.0, &at(Some(20.0)));
    thermal.step(200.0, &at(None));
    thermal.step(100.0, &at(Some(30.0)));
    let expected = 2e-5 * (1.0 - (-0.5_f64).exp());
    assert!((tilt_y(&machine, &thermal) - expected).abs() < 1e-15);
}

/// After a program pause of ten minutes no sensor counts as missing, and the lags advance over the pause.
#[test]
fn lags_go_on_over_a_time_in_which_the_program_stood() {
    let (machine, mut thermal) = state_of(THREE_AXES);
    let at = |spindle: Option<f64>| [Some(20.0), Some(20.0), spindle];
    thermal.step(0.0, &at(Some(20.0)));
    thermal.step(0.0, &at(Some(30.0)));
    thermal.stand(600.0);
    thermal.step(1.0, &at(None));
    assert!(tilt_y(&machine, &thermal).abs() < 1e-15, "held");
    thermal.step(1.0, &at(Some(30.0)));
    assert!(!thermal.is_degraded());
    let expected = 2e-5 * (1.0 - (-602.0_f64 / 600.0).exp());
    assert!((tilt_y(&machine, &thermal) - expected).abs() < 1e-15);
}

/// A scale that has expanded by 100 µm over a metre moves the carriage 100 µm too far along the direction of its axis,
/// also for a reversed or an oblique axis.
#[test]
fn a_scale_grows_along_the_direction_of_its_axis() {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    for (direction, along) in [
        ([1.0, 0.0, 0.0], [0.1, 0.0, 0.0]),
        ([-1.0, 0.0, 0.0], [-0.1, 0.0, 0.0]),
        ([1.0, 1.0, 0.0], [0.1 * half, 0.1 * half, 0.0]),
    ] {
        for structure in ["w b X Y Z t", "w X' b Y Z t"] {
            let (machine, mut thermal) = state_of(&format!(
                "structure = \"{structure}\"\n[axes.X]\ntravel = [0.0, 1000.0]\ndirection = {direction:?}\n[axes.Y]\ntravel = [0.0, 400.0]\n[axes.Z]\ntravel = [0.0, 250.0]\n[[thermal.expansion]]\nerror = \"EXX\"\nsensor = \"scale\"\num_per_m_k = 10.0\n"
            ));
            assert_eq!(machine.axes()[0].name, AxisName::X);
            let temperatures = steady(&thermal, &[Some(30.0)]);
            let mut compiled = machine.compile(Tolerance::default()).unwrap();
            thermal.step(0.0, &[Some(30.0)]);
            thermal.apply(&mut compiled);
            let state = State::new(
                machine.chain(),
                [(AxisName::X, 1000.0), (AxisName::Y, 0.0), (AxisName::Z, 0.0)],
            )
            .unwrap();
            let of_source = machine.error_at(&state, Form::Exact, &temperatures);
            let of_source: [f64; 3] = of_source.position_mm.into();
            for found in [compiled.evaluate(&state).position_mm, of_source] {
                for (found, expected) in found.into_iter().zip(along) {
                    assert!((found - expected).abs() < 1e-6, "{direction:?}: {found}");
                }
            }
        }
    }
}

/// A reload of the machine file during warm-up: equal terms keep their lags, so that the correction does not jump to its final value.
#[test]
fn lags_are_carried_over_to_the_same_terms() {
    let text = |um_per_k: f64, lag_s: f64, reference: f64| {
        format!(
            "structure = \"w X' b Y Z t\"\n[axes.X]\ntravel = [0.0, 800.0]\n[axes.Y]\ntravel = [0.0, 400.0]\n[axes.Z]\ntravel = [0.0, 250.0]\n[thermal]\nreference = {reference}\n[[thermal.drift]]\nerror = \"EZZ\"\nsensors = {{ bed = -1.0, spindle = 1.0 }}\num_per_k = {um_per_k}\nlag_s = {lag_s}\n"
        )
    };
    let z_um = |text: &str, before: Option<&ThermalState>| {
        let (machine, mut thermal) = state_of(text);
        if let Some(before) = before {
            thermal.carry_over(before);
        } else {
            thermal.step(1.0, &[Some(20.0), Some(20.0)]);
            thermal.step(300.0, &[Some(20.0), Some(30.0)]);
        }
        let mut compiled = machine.compile(Tolerance::default()).expect("compiles");
        thermal.apply(&mut compiled);
        let z_mm = compiled.evaluate(&State::default()).position_mm[2];
        (z_mm * 1e3, thermal)
    };
    let (warm, before) = z_um(&text(3.0, 600.0, 20.0), None);
    // The final value is 30 µm, of which the fraction e^(-1/2) is still missing.
    assert!((warm - 30.0 * (1.0 - (-0.5_f64).exp())).abs() < 0.01, "{warm}");
    let (same, _) = z_um(&text(3.0, 600.0, 20.0), Some(&before));
    assert!((same - warm).abs() < 1e-9, "{same}");
    // The lagged temperature does not depend on the error and factor of the term.
    let (twice, _) = z_um(&text(6.0, 600.0, 20.0), Some(&before));
    assert!((twice - 2.0 * warm).abs() < 1e-9, "{twice}");
    // The difference of two sensors does not depend on the reference.
    let (other, _) = z_um(&text(3.0, 600.0, 22.0), Some(&before));
    assert!((other - warm).abs() < 1e-9, "{other}");
    // With another lag and other weights the lagged temperatures of the sensors are kept and continue.
    let (other, _) = z_um(&text(3.0, 60.0, 20.0), Some(&before));
    assert!((other - warm).abs() < 1e-9, "{other}");
    let heavier = text(3.0, 600.0, 20.0).replace("spindle = 1.0", "spindle = 1.001");
    let (heavier, _) = z_um(&heavier, Some(&before));
    assert!((heavier - 1.001 * warm).abs() < 1e-9, "{heavier}");
    // Of two terms with the same sensor, the term with the nearest lag passes on its temperature.
    let two = text(3.0, 600.0, 20.0)
        + "[[thermal.drift]]\nerror = \"EYZ\"\nsensors = { spindle = 1.0 }\num_per_k = 0.0\nlag_s = 5.0\n";
    let (_, before) = z_um(&two, None);
    let (near, _) = z_um(&text(3.0, 599.0, 20.0), Some(&before));
    assert!((near - warm).abs() < 1e-9, "{near}");
}

/// A drift with its tested range: 20 to 30 °C, −0.3 to 0.5 K/min, zero 4 K beyond.
const SEEN: &str = r#"
structure = "w X' b Y Z t"
[axes.X]
travel = [0.0, 800.0]
[axes.Y]
travel = [0.0, 400.0]
[axes.Z]
travel = [0.0, 250.0]
[thermal]
reference = 20.0
margin_k = 4.0
[[thermal.expansion]]
error = "EZZ"
sensor = "column"
um_per_m_k = 10.0
[[thermal.drift]]
error = "EZZ"
sensors = { spindle = 1.0 }
um_per_k = 3.0
[[thermal.drift]]
error = "EXX"
sensors = { spindle = 1.0 }
um_per_k = 1.0
[[thermal.seen]]
error = "EZZ"
sensor = "spindle"
degc = [20.0, 30.0]
k_per_min = [-0.3, 0.5]
"#;

/// Errors along X and Z at Z = 100 mm, µm.
fn x_z_um(machine: &Machine, thermal: &ThermalState) -> [f64; 2] {
    let mut compiled = machine.compile(Tolerance::default()).unwrap();
    thermal.apply(&mut compiled);
    let error = compiled.evaluate(
        &State::new(
            machine.chain(),
            [(AxisName::X, 0.0), (AxisName::Y, 0.0), (AxisName::Z, 100.0)],
        )
        .unwrap(),
    );
    [error.position_mm[0] * 1e3, error.position_mm[2] * 1e3]
}

/// Temperatures of the sensors in the order of their names: column, spindle.
fn column_spindle(column: f64, spindle: f64) -> [Option<f64>; 2] {
    [Some(column), Some(spindle)]
}

/// Beyond the tested range all terms of an error are held and fade to zero over the margin; within it nothing changes, and an error
/// without a range is not affected. Steady temperatures give the same.
#[test]
fn beyond_what_they_have_seen_terms_hold_and_fade() {
    for (spindle, share) in [
        (20.0, 1.0),
        (26.0, 1.0),
        (30.0, 1.0),
        (31.0, 0.75),
        (32.0, 0.5),
        (34.0, 0.0),
        (60.0, 0.0),
        (19.0, 0.75),
        (-40.0, 0.0),
    ] {
        let (machine, mut thermal) = state_of(SEEN);
        let degc = column_spindle(25.0, spindle);
        thermal.step(0.004, &degc);
        let held = f64::clamp(spindle, 20.0, 30.0);
        // 10 µm/(m·K) · 5 K · 0.1 m, and 3 µm/K.
        let expected = [spindle - 20.0, share * (5.0 + 3.0 * (held - 20.0))];
        let found = x_z_um(&machine, &thermal);
        let error = machine.error_at(
            &State::new(
                machine.chain(),
                [(AxisName::X, 0.0), (AxisName::Y, 0.0), (AxisName::Z, 100.0)],
            )
            .unwrap(),
            Form::Twist,
            &steady(&thermal, &degc),
        );
        let steady = [error.position_mm[0] * 1e3, error.position_mm[2] * 1e3];
        for found in [found, steady] {
            for (found, expected) in found.iter().zip(expected) {
                assert!((found - expected).abs() < 1e-3, "{spindle}: {found} {expected}");
            }
        }
        assert_eq!(thermal.is_beyond_seen(), share < 1.0, "{spindle}");
        assert!(!thermal.is_degraded());
    }
}

/// No term of an error acts before every sensor with a tested range has a temperature, because the terms may cancel each other.
#[test]
fn terms_wait_for_the_first_temperature_of_every_watched_sensor() {
    let (machine, mut thermal) = state_of(SEEN);
    for _ in 0..10 {
        thermal.step(6.0, &[Some(25.0), None]);
        assert!(!thermal.is_beyond_seen());
        assert!(thermal.is_degraded());
        assert_eq!(x_z_um(&machine, &thermal), [0.0; 2]);
    }
    thermal.step(0.004, &column_spindle(25.0, 26.0));
    // 10 µm/(m·K) · 5 K · 0.1 m, and 3 µm/K.
    let [_, z_um] = x_z_um(&machine, &thermal);
    assert!((z_um - (5.0 + 3.0 * 6.0)).abs() < 1e-3, "{z_um}");
    assert!(!thermal.is_beyond_seen());
}

/// A temperature leaves the range at 2 K/min and returns: the correction does not jump, the warning is not too early,
/// and the terms return with the temperature.
#[test]
fn a_temperature_that_leaves_takes_the_terms_with_it_smoothly() {
    // Without a tested rate only the temperature counts.
    let text = SEEN.replace("k_per_min = [-0.3, 0.5]", "");
    let (machine, mut thermal) = state_of(&text);
    let step_s = 2.0;
    let spindle = |i: u32| {
        let minutes = f64::from(i) * step_s / 60.0;
        22.0 + f64::min(2.0 * minutes, 2.0 * (60.0 - minutes)).clamp(0.0, 18.0)
    };
    let (mut before, mut gone, mut back) = (0.0, false, false);
    for i in 0..3600 {
        let degc = column_spindle(20.0, spindle(i));
        assert_no_alloc(|| thermal.step(if i == 0 { 0.0 } else { step_s }, &degc));
        let z_um = x_z_um(&machine, &thermal)[1];
        if i > 0 {
            // At most 3 µm/K at 2 K/min, plus 30 µm in ten minutes.
            let most = 3.0 * 2.0 * step_s / 60.0 + 30.0 * step_s / 600.0;
            assert!((z_um - before).abs() <= most + 1e-6, "{i}: {before} {z_um}");
        }
        if spindle(i) > 30.0 {
            assert!(thermal.is_beyond_seen(), "{i}");
        }
        gone |= z_um < 1e-9;
        back |= gone && !thermal.is_beyond_seen() && z_um > 1.0;
        before = z_um;
    }
    assert!(gone && back);
}

/// A spindle that cools faster than in the tests of the thermal terms: the terms fade. The rate is smoothed with a time constant of ten
/// minutes.
#[test]
fn a_rate_beyond_what_was_seen_fades_as_well() {
    let (machine, mut thermal) = state_of(SEEN);
    thermal.step(0.0, &column_spindle(20.0, 20.0));
    let mut unseen = 0.0_f64;
    // A rate of 0.45 K/min is within the range.
    for i in 1..=1200 {
        thermal.step(1.0, &column_spindle(20.0, 20.0 + 0.45 * f64::from(i) / 60.0));
        assert!(!thermal.is_beyond_seen(), "{i}");
    }
    // 29 °C for an hour; then a fall of 0.7 K/min, whose smoothed rate passes 0.3 K/min after some minutes.
    for _ in 0..3600 {
        thermal.step(1.0, &column_spindle(20.0, 29.0));
    }
    for i in 1..=700 {
        thermal.step(1.0, &column_spindle(20.0, 29.0 - 0.7 * f64::from(i) / 60.0));
        let z_um = x_z_um(&machine, &thermal)[1];
        let whole = 3.0 * (9.0 - 0.7 * f64::from(i) / 60.0);
        unseen = unseen.max(whole - z_um);
    }
    assert!(thermal.is_beyond_seen());
    assert!(unseen > 1.0, "{unseen}");
    // At constant temperature the rate decays, and the terms return.
    for _ in 0..3600 {
        thermal.step(1.0, &column_spindle(20.0, 20.0));
    }
    assert!(!thermal.is_beyond_seen());
}

/// A reload with a wider range while the terms have faded: the terms ramp in without a jump.
#[test]
fn a_reload_does_not_jump_beyond_what_was_seen() {
    let (_, mut old) = state_of(SEEN);
    let warm = column_spindle(20.0, 33.0);
    old.step(0.0, &warm);
    let (machine, mut new) = state_of(&SEEN.replace("[20.0, 30.0]", "[20.0, 40.0]"));
    new.carry_over(&old);
    new.step(1.0, &warm);
    // A quarter of 39 µm, plus one second of a ramp that takes ten minutes for 39 µm.
    let z_um = x_z_um(&machine, &new)[1];
    assert!((z_um - 39.0 * (0.25 + 1.0 / 600.0)).abs() < 0.01, "{z_um}");
    new.step(600.0, &warm);
    assert!((x_z_um(&machine, &new)[1] - 39.0).abs() < 1e-3);
}

#[test]
fn what_was_seen_is_written_and_read_and_checked() {
    let (machine, _) = state_of(SEEN);
    let text = machine.to_toml();
    let again = Machine::parse(&text, "again").expect(&text);
    assert_eq!(again.thermal(), machine.thermal());
    assert_eq!(again.checksum(), machine.checksum());
    let (without, _) = state_of(THREE_AXES);
    assert!(!without.to_toml().contains("margin_k"));
    for (from, to, expected) in [
        ("margin_k = 4.0", "margin_k = 0.0", "margin_k"),
        ("[20.0, 30.0]", "[30.0, 20.0]", "30 to 20 °C"),
        ("[20.0, 30.0]", "[20.0]", "an array of 2 numbers"),
        ("[-0.3, 0.5]", "[0.1, 0.5]", "0.1 to 0.5 K/min"),
        ("sensor = \"spindle\"", "sensor = \"bed\"", "has the sensor bed"),
        ("k_per_min = [", "k_per_s = [", "k_per_s"),
    ] {
        let wrong = SEEN.replace(from, to);
        let message = Machine::parse(&wrong, "m").unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
    let seen = &SEEN[SEEN.find("[[thermal.seen]]").unwrap()..];
    let message = Machine::parse(&format!("{SEEN}{seen}"), "m").unwrap_err();
    assert!(message.to_string().contains("appears twice"), "{message}");
}
