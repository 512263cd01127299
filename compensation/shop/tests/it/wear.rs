//! Wear is zero without work and proportional to time; tilts follow the bent guides.

use volcomp_model::Machine;
use volcomp_shop::{Wear, WearError};
use volcomp_vocabulary::{Direction, ErrorName};

const MACHINE: &str = include_str!("../../../../examples/table-tilting.toml");

fn machine() -> Machine {
    Machine::parse(MACHINE, "m.toml").expect("a good machine")
}

fn worn(months: f64, load: f64, seed: u64) -> Machine {
    let wear = Wear { months, load, seed };
    wear.of(&machine()).expect("worn").machine
}

/// Value of an error (µm or µrad) at a coordinate, after motion in a direction.
fn value(machine: &Machine, name: &str, q: f64, direction: Option<Direction>) -> f64 {
    let name: ErrorName = name.parse().expect("a name");
    let mut coordinates = [0.0; 9];
    let own = machine.index_of(name.axis).expect("an axis");
    coordinates[own] = q;
    machine.error(name).map_or(0.0, |curve| curve.value(own, &coordinates, direction))
}

#[test]
fn without_work_nothing_changes() {
    for (months, load) in [(0.0, 1.0), (12.0, 0.0)] {
        assert_eq!(worn(months, load, 1).to_toml(), machine().to_toml());
    }
    assert_eq!(worn(12.0, 1.0, 1).to_toml(), worn(12.0, 1.0, 1).to_toml());
    assert_ne!(worn(12.0, 1.0, 1).to_toml(), worn(12.0, 1.0, 2).to_toml());
    assert_eq!(worn(6.0, 2.0, 1).to_toml(), worn(12.0, 1.0, 1).to_toml());
}

/// No number in the file has rounding digits, as in 79.99980000000001 or 1e-15.
#[test]
fn numbers_have_six_decimals_at_most() {
    let text = worn(7.0, 1.3, 4).to_toml();
    let (_, errors) = text.split_once("[errors]").expect("errors");
    let mut count = 0;
    for number in errors.split(|c: char| !c.is_ascii_alphanumeric() && !matches!(c, '.' | '-')) {
        let Ok(value) = number.parse::<f64>() else {
            continue;
        };
        count += 1;
        let decimals = number.split_once('.').map_or(0, |(_, behind)| behind.len());
        assert!(decimals <= 6 && !number.contains('e'), "{number}");
        assert!(value != 0.0 || !number.starts_with('-'), "{number}");
    }
    assert!(count > 1000, "{count}");
}

#[test]
fn wear_is_proportional_to_time() {
    let (new, one, two) = (machine(), worn(12.0, 1.0, 3), worn(24.0, 1.0, 3));
    let mut changed = 0;
    for axis in new.axes() {
        let [low, high] = axis.travel;
        for component in ["EX", "EY", "EZ", "EA", "EB", "EC"] {
            let name = format!("{component}{}", axis.name);
            for step in 0..=16 {
                let q = low + (high - low) * f64::from(step) / 16.0;
                for direction in [None, Some(Direction::Positive), Some(Direction::Negative)] {
                    let at = |machine| value(machine, &name, q, direction);
                    let (first, both) = (at(&one) - at(&new), at(&two) - at(&new));
                    assert!((both - 2.0 * first).abs() < 4e-6, "{name} {q}: {first} {both}");
                    changed += usize::from(first.abs() > 0.05);
                }
            }
        }
    }
    assert!(changed > 100, "{changed}");
    for (name, value) in two.locations() {
        let before = new.locations().get(name).copied().unwrap_or(0.0);
        let once = one.locations()[name];
        assert!((value - before - 2.0 * (once - before)).abs() < 4e-6, "{name}");
    }
    let c: ErrorName = "EC0Y".parse().expect("a name");
    assert_ne!(two.locations()[&c], 0.0);
}

/// A carriage on a bent guide tilts by the slope times the axis direction; µm/mm is mrad.
#[test]
fn tilts_are_the_tangents_of_the_bent_ways() {
    let (new, old) = (machine(), worn(36.0, 1.0, 5));
    let added = |name: &str, q: f64| value(&old, name, q, None) - value(&new, name, q, None);
    let mut largest = 0.0_f64;
    for (axis, bent, tilt, sign) in [
        ("X", "EZX", "EBX", -1.0),
        ("X", "EYX", "ECX", 1.0),
        ("Y", "EZY", "EAY", 1.0),
        ("Y", "EXY", "ECY", -1.0),
        ("Z", "EXZ", "EBZ", 1.0),
        ("Z", "EYZ", "EAZ", -1.0),
    ] {
        let [low, high] = machine().axis(axis.parse().expect("an axis")).expect("it").travel;
        // The tolerance is for an eighth of the travel, because the curve between tabulated positions is not exact.
        let way = (high - low) / 8.0;
        for part in 0..8 {
            let from = low + way * f64::from(part);
            let risen = added(bent, from + way) - added(bent, from);
            let tilts =
                (0..50).map(|place| added(tilt, from + way * (f64::from(place) + 0.5) / 50.0));
            let mean = tilts.sum::<f64>() / 50.0;
            let slope = sign * 1e3 * risen / way;
            assert!((mean - slope).abs() < 0.05, "{tilt} {from}: {mean} {slope}");
            largest = largest.max(mean.abs());
        }
    }
    assert!(largest > 5.0, "{largest}");
}

/// The worn machine keeps a periodic error with the pitch of a screw, of which 64 even positions over 500 mm sample only every third period.
#[test]
fn a_wave_that_was_there_stays() {
    let machine = |errors: &str| {
        let text = format!("structure = \"w b X t\"\naxes.X.travel = [0.0, 500.0]\n{errors}");
        Machine::parse(&text, "m.toml").expect("a good machine")
    };
    let wear = Wear { months: 12.0, load: 1.0, seed: 7 };
    let worn = |errors: &str| wear.of(&machine(errors)).expect("worn").machine;
    let (plain, waved) =
        (worn(""), worn("[errors]\nEXX = { fourier = [0.0, 0.0, 5.0], period = 10.0 }\n"));
    for step in 0..=3000 {
        let q = 500.0 * f64::from(step) / 3000.0;
        let [old, new] = [&plain, &waved].map(|machine| value(machine, "EXX", q, None));
        let wave = 5.0 * (core::f64::consts::TAU * q / 10.0).sin();
        assert!((new - old - wave).abs() < 0.2, "{q}: {} {wave}", new - old);
    }
}

#[test]
fn what_cannot_be_is_refused() {
    for (months, load) in [(-1.0, 1.0), (f64::NAN, 1.0), (12.0, -1.0), (1e9, 1.0)] {
        let wear = Wear { months, load, seed: 1 };
        let error = wear.of(&machine()).expect_err("it cannot be");
        assert!(matches!(error, WearError::Number { .. }), "{error}");
    }
}
