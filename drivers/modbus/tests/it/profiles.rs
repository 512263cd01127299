//! Profiles of modules, and the PT100 according to IEC 60751.
//!
//! The shipped profiles, the decoding of registers, messages, and the fuzz corpus are tested.

use std::{path::Path, time::Instant};

use proptest::prelude::*;
use volcomp_modbus::{
    Profile, ProfileError,
    iec60751::{RANGE_DEGC, ratio, temperature, two_wire},
    read_channel,
};
use volcomp_port::{Quality, Reason};

#[test]
fn every_shipped_profile_is_valid() {
    let profiles = Profile::shipped();
    assert_eq!(profiles.len(), 14);
    let mut names: Vec<&str> = profiles.iter().map(|p| &*p.name).collect();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), 14);
    for (written, name) in [
        ("PTA8C04", "PTA8C04"),
        ("pta8c04", "PTA8C04"),
        ("Seneca Z-4RTD", "SENECA-Z-4RTD"),
        ("wago 750/461", "WAGO-750-461"),
        ("adam-4015", "ADAM-4015"),
    ] {
        assert_eq!(Profile::named(written).unwrap().name, name);
    }
    let channels = |name: &str| Profile::named(name).unwrap().channels.unwrap();
    assert_eq!((channels("WAGO-750-461").count, channels("WAGO-750-464").count), (2, 4));
    assert_eq!((channels("SENECA-Z-4RTD").address, channels("SENECA-Z-4RTD").scale), (2, 0.1));
    let unknown = Profile::named("PT-9000").unwrap_err().to_string();
    assert!(unknown.contains("no profile `PT-9000`") && unknown.contains("PTA8C04, PT21A01"));
}

fn found(profile: &str, registers: &[u16], status: Option<u16>) -> (Option<f64>, Quality) {
    let channels = Profile::named(profile).unwrap().channels.unwrap();
    let found = read_channel(&channels, registers, 0, status, Instant::now());
    (found.degc, found.quality)
}

/// Out-of-range values that a module clamps, fault codes and fault bits never become temperatures.
#[test]
fn faults_are_reported() {
    let good = Quality::Good;
    let bad = |reason| (None, Quality::Bad(reason));
    let near = |found: (Option<f64>, Quality), degc: f64| {
        assert_eq!(found.1, good);
        assert!((found.0.unwrap() - degc).abs() < 1e-9, "{found:?}");
    };
    near(found("PTA8C04", &[215], None), 21.5);
    near(found("PTA8C04", &[(-55_i16).cast_unsigned()], None), -5.5);
    near(found("WAGO-750-461", &[0xfc18], None), -100.0);
    assert_eq!(found("WAGO-750-461", &[0x2134], None), bad(Reason::Open));
    assert_eq!(found("WAGO-750-461", &[0xf830], None), bad(Reason::Short));
    assert_eq!(found("PTA8C04", &[5000], None), bad(Reason::Open));
    assert_eq!(found("PTA8C04", &[32767], None), bad(Reason::Open));
    assert_eq!(found("PTA8C04", &[32768], None), bad(Reason::Short));
    assert_eq!(found("PTA8C04", &[], None), bad(Reason::NotANumber));
    assert_eq!(found("ICP-DAS-M-7015", &[215], Some(1)), bad(Reason::Reported));
    near(found("ICP-DAS-M-7015", &[215], Some(0)), 21.5);
    near(found("RAW-OHM", &[10_000], None), 0.0);
    assert_eq!(found("RAW-OHM", &[50], None), bad(Reason::Short));
    assert_eq!(found("RAW-OHM", &[60_000], None), bad(Reason::Open));
    assert_eq!(found("RAW-OHM", &[1500], None), bad(Reason::Short), "15 ohm");
    // The module reported 26874 at 32.25 °C; the linear scale gives 32.0 °C.
    near(found("ADAM-4015", &[26_874], None), 26_874.0 * 0.003_051_757_812_5 - 50.0);
}

#[test]
fn numbers_of_two_registers() {
    let profile = |kind: &str, order: &str| {
        let text = format!(
            "name = \"T\"\n[channels]\naddress = 0\ncount = 2\ntype = \"{kind}\"\nword_order = \"{order}\"\n"
        );
        Profile::parse(&text).unwrap().channels.unwrap()
    };
    let second = |kind, order, words: [u16; 2]| {
        let registers = [0, 0, words[0], words[1]];
        read_channel(&profile(kind, order), &registers, 1, None, Instant::now()).degc
    };
    let bits = 21.5_f32.to_bits();
    #[expect(clippy::cast_possible_truncation, reason = "the two halves")]
    let (high, low) = ((bits >> 16) as u16, bits as u16);
    assert_eq!(second("f32", "high", [high, low]), Some(21.5));
    assert_eq!(second("f32", "low", [low, high]), Some(21.5));
    assert_eq!(second("i32", "high", [0xffff, 0xfff6]), Some(-10.0));
    assert_eq!(second("f32", "high", [0x7fc0, 0]), None, "NaN");
}

/// The four usual byte orders of four bytes are decoded, for integers and floats. A float in a wrong byte order is not
/// a good temperature.
#[test]
fn four_byte_orders_are_supported() {
    let profile = |kind: &str, [word, byte]: [&str; 2]| {
        let text = format!(
            "name = \"T\"\n[channels]\naddress = 0\ncount = 1\ntype = \"{kind}\"\nword_order = \"{word}\"\nbyte_order = \"{byte}\"\n"
        );
        Profile::parse(&text).unwrap().channels.unwrap()
    };
    let orders = [
        (["high", "high"], [0, 1, 2, 3]),
        (["low", "high"], [2, 3, 0, 1]),
        (["high", "low"], [1, 0, 3, 2]),
        (["low", "low"], [3, 2, 1, 0]),
    ];
    for single in [21.5_f32, -10.5, 22.6, 225.0, 0.0] {
        let degc = f64::from(single);
        for (keys, places) in orders {
            let registers = |bytes: [u8; 4]| {
                let [a, b, c, d] = places.map(|place| bytes[place]);
                [u16::from_be_bytes([a, b]), u16::from_be_bytes([c, d])]
            };
            let float = registers(single.to_be_bytes());
            let read = |kind, registers: [u16; 2]| {
                read_channel(&profile(kind, keys), &registers, 0, None, Instant::now())
            };
            let found = read("f32", float);
            assert_eq!(found.quality, Quality::Good, "{keys:?}");
            assert!((found.degc.unwrap() - degc).abs() < 1e-5, "{keys:?}: {found:?}");
            #[expect(clippy::cast_possible_truncation, reason = "whole")]
            let whole = registers((degc.trunc() as i32).to_be_bytes());
            assert_eq!(read("i32", whole).degc, Some(degc.trunc()), "{keys:?}");
        }
        // Swapped bytes must not be displayed as "-0.00 °C, good".
        let [a, b, c, d] = single.to_be_bytes();
        let swapped = [u16::from_be_bytes([b, a]), u16::from_be_bytes([d, c])];
        let found =
            read_channel(&profile("f32", ["high", "high"]), &swapped, 0, None, Instant::now());
        let expected = match degc {
            0.0 => Quality::Good,
            _ => Quality::Bad(Reason::Implausible),
        };
        assert_eq!(found.quality, expected, "{degc}: {found:?}");
    }
}

#[test]
fn invalid_profiles_are_rejected() {
    let message = |change: &str| {
        let text = format!("name = \"T\"\n[channels]\naddress = 0\ncount = 4\n{change}\n");
        Profile::parse(&text).unwrap_err().to_string()
    };
    for (change, expected) in [
        ("scale = 0", "profile:5: channels.scale: found 0, expected a number that is not 0"),
        ("scale = nan", "channels.scale: found nan, expected a finite number"),
        ("sclae = 1", "channels.sclae: unknown key, did you mean `scale`?"),
        ("function = 6", "channels.function: found 6, expected a whole number from 3 to 4"),
        ("type = \"i64\"", "channels.type: found \"i64\", expected one of: i16, u16, i32, f32"),
        ("valid_degc = [10, 0]", "expected the lower end below the upper end"),
        ("valid_degc = [10]", "expected an array of 2 numbers"),
        ("unit = \"ohm\"\nr0_ohm = -1", "channels.r0_ohm: found -1, expected a number above 0"),
        ("faults = [{ raw = 1 }]", "channels.faults[0]: key `reason` is missing"),
        ("faults = 3", "channels.faults: found 3, expected an array"),
        ("status = { function = 9, address = 0 }", "channels.status.function: found 9"),
    ] {
        let message = message(change);
        assert!(message.contains(expected), "{change}: {message}");
    }
    let parse = |text: &str| Profile::parse(text).unwrap_err();
    let message = parse("name = \"T\"").to_string();
    assert!(message.contains("[channels] or [digital]"), "{message}");
    let beyond = parse("name = \"T\"\n[channels]\naddress = 65535\ncount = 9").to_string();
    assert!(beyond.contains("below 65536"), "{beyond}");
    assert!(matches!(parse("name = "), ProfileError::Input(_)));
}

/// Replays the fuzz corpus: `valid-…` files must be parsed, `broken-…` files rejected.
#[test]
fn corpus_profiles_parse_or_are_rejected() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fuzz/corpus/modbus");
    let mut seen = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let bytes = std::fs::read(&path).unwrap();
        let read = Profile::parse(&String::from_utf8_lossy(&bytes));
        assert!(read.is_ok() || !name.starts_with("valid-"), "{name}: {read:?}");
        assert!(read.is_err() || !name.starts_with("broken-"), "{name}");
        if let Some(channels) = read.ok().and_then(|profile| profile.channels) {
            let registers: Vec<u16> = bytes.iter().map(|byte| u16::from(*byte) * 257).collect();
            for channel in 0..usize::from(channels.count) {
                let found = read_channel(&channels, &registers, channel, None, Instant::now());
                assert_eq!(found.quality == Quality::Good, found.degc.is_some(), "{name}");
            }
        }
        seen += 1;
    }
    assert!(seen >= 10);
}

proptest! {
    #[test]
    fn arbitrary_text_does_not_panic(text in "[a-z0-9_=\\[\\]{}\", .\n-]{0,300}") {
        let _ = Profile::parse(&text);
    }

    #[test]
    fn good_values_are_within_the_range(registers in proptest::collection::vec(any::<u16>(), 0..20), which in 0_usize..11, channel in 0_usize..8, status: Option<u16>) {
        let profile = &Profile::shipped()[which];
        let channels = profile.channels.as_ref().unwrap();
        let found = read_channel(channels, &registers, channel, status, Instant::now());
        let [low, high] = channels.valid_degc;
        if found.quality == Quality::Good {
            prop_assert!(found.degc.is_some_and(|t| low < t && t < high));
        } else {
            prop_assert_eq!(found.degc, None);
        }
    }
}

#[test]
fn resistances_match_the_standard() {
    for (degc, ohm) in [
        (-200.0, 18.5201),
        (-100.0, 60.2558),
        (0.0, 100.0),
        (20.0, 107.7935),
        (50.0, 119.3971),
        (100.0, 138.5055),
        (200.0, 175.8560),
        (400.0, 247.0920),
        (850.0, 390.4811),
    ] {
        let found = 100.0 * ratio(degc).unwrap();
        assert!((found - ohm).abs() < 6e-5, "{degc}: {found}");
        // A change of 0.0001 Ω corresponds to 0.25 mK.
        let back = temperature(ohm / 100.0).unwrap();
        assert!((back - degc).abs() < 3e-4, "{ohm}: {back}");
    }
}

#[test]
fn values_outside_the_range_are_rejected() {
    for degc in [-200.1, 850.1, f64::NAN, f64::INFINITY] {
        assert_eq!(ratio(degc), None);
    }
    for broken in [0.0, 0.18, 3.91, -1.0, f64::NAN, f64::INFINITY] {
        assert_eq!(temperature(broken), None);
    }
    let ends = RANGE_DEGC.map(|degc| temperature(ratio(degc).unwrap()));
    assert_eq!(ends, RANGE_DEGC.map(Some));
}

#[test]
fn lead_resistance() {
    // 0.1 Ω of lead resistance corresponds to 0.25 K.
    let off = two_wire(107.7935 + 0.1, 0.0, 100.0).unwrap() - 20.0;
    assert!((off - 0.257).abs() < 1e-3, "{off}");
    assert!((two_wire(107.7935 + 0.1, 0.1, 100.0).unwrap() - 20.0).abs() < 1e-3);
    assert!((two_wire(1077.935, 0.0, 1000.0).unwrap() - 20.0).abs() < 1e-3);
}

proptest! {
    #[test]
    fn temperatures_round_trip(degc in -200.0..850.0_f64) {
        let back = temperature(ratio(degc).unwrap()).unwrap();
        prop_assert!((back - degc).abs() < 1e-9, "{degc}: {back}");
    }

    #[test]
    fn resistance_increases_with_temperature(degc in -199.9..850.0_f64) {
        prop_assert!(ratio(degc).unwrap() > ratio(degc - 0.1).unwrap());
    }
}
