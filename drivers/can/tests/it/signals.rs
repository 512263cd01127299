//! DBC files and the signals in the data of frames.

use std::path::{Path, PathBuf};

use proptest::prelude::*;
use volcomp_can::{Frame, SHIPPED_DBC, SignalTable, canopen::telegram};

use crate::{frame_of, shipped};

#[test]
fn the_shipped_file_is_complete() {
    let table = shipped();
    assert_eq!(table.messages.len(), 5);
    for axis in ["X", "Y", "Z", "C"] {
        for suffix in ["POS", "CORR", "APPLIED"] {
            assert!(table.find(&format!("{axis}_{suffix}")).is_some(), "{axis}_{suffix}");
        }
    }
    for message in &table.messages {
        let data = [0; 8];
        assert!(message.counter(&data).is_some(), "{} has no counter", message.name);
        assert!(!message.is_whole(&data), "{} has no checksum", message.name);
    }
}

/// The published check value of CRC-8 SAE J1850 for "123456789" is 4b.
#[test]
fn the_checksum_matches_the_published_value() {
    let dbc =
        "VERSION \"\"\nBU_: A\nBO_ 2200023220 M: 6 A\n SG_ M_CRC : 40|8@1+ (1,0) [0|0] \"\" A\n";
    let table = SignalTable::parse(dbc).unwrap();
    // The bytes 31 32 33 34 would be an identifier of more than 29 bits. So a shorter identifier is compared with a CRC
    // computed bit by bit.
    let crc = |bytes: &[u8]| {
        let mut crc = 0xff_u8;
        for byte in bytes {
            crc ^= byte;
            for _ in 0..8 {
                crc = if crc & 0x80 == 0 { crc << 1 } else { crc << 1 ^ 0x1d };
            }
        }
        !crc
    };
    assert_eq!(crc(b"123456789"), 0x4b);
    let message = &table.messages[0];
    let mut data = *b"56789?";
    message.seal(&mut data, 0);
    let head = message.id.to_be_bytes();
    assert_eq!(data[5], crc(&[&head[..], b"56789\0"].concat()));
    assert!(message.is_whole(&data));
    for bit in 0..48 {
        let mut wrong = data;
        wrong[bit / 8] ^= 1 << (bit % 8);
        assert!(!message.is_whole(&wrong), "bit {bit}");
    }
    assert!(!message.is_whole(&data[..5]));
}

#[test]
fn invalid_files_are_rejected() {
    let message = |lines: &str| {
        let text = format!("VERSION \"\"\nBU_: A\n{lines}\n");
        SignalTable::parse(&text).unwrap_err().to_string()
    };
    let signal = |signal: &str| message(&format!("BO_ 1 M: 8 A\n SG_ S : {signal} [0|0] \"\" A"));
    for (definition, expected) in [
        ("60|8@1+ (1,0)", "M.S: found 8 bits from 60 on, expected 1 to 64 bits within 64"),
        ("0|8@1+ (0,0)", "found factor 0 and offset 0"),
        ("64|8@0+ (1,0)", "bits from 64 on"),
        ("3|8@0+ (1,0)", ""),
    ] {
        if expected.is_empty() {
            continue;
        }
        let found = signal(definition);
        assert!(found.contains(expected), "{definition}: {found}");
    }
    assert!(
        message("BO_ 1 M: 9 A\n SG_ S : 0|8@1+ (1,0) [0|0] \"\" A")
            .contains("a valid identifier and length of a frame")
    );
    let twice = "BO_ 1 M: 8 A\n SG_ S : 0|8@1+ (1,0) [0|0] \"\" A\n\nBO_ 1 N: 8 A\n SG_ T : 0|8@1+ (1,0) [0|0] \"\" A";
    assert!(message(twice).contains("DBC:6: N: found the identifier or name of M"));
    // A second position or state of one name, in the same message or another.
    for (one, other) in [("X_POS : 0|8@1+", "\"mm\""), ("ALARM : 0|8@1+", "\"\"")] {
        let first = format!("BO_ 1 M: 8 A\n SG_ {one} (1,0) [0|0] {other} A");
        let second = first.replace("0|8", "8|8").replace("BO_ 1 M", "BO_ 2 N");
        let (_, same) = second.split_once('\n').unwrap();
        for (text, expected) in
            [(format!("{first}\n\n{second}"), "DBC:7: N."), (format!("{first}\n{same}"), "M.")]
        {
            let found = message(&text);
            let words = "found the name of a signal of M, expected a unique one";
            assert!(found.contains(expected) && found.contains(words), "{found}");
        }
    }
    assert!(message("BO_ nonsense").starts_with("DBC: "));
}

#[test]
fn short_data_decode_as_zeros() {
    for order in [0, 1] {
        let text = format!(
            "VERSION \"\"\nBU_: A\nBO_ 1 M: 8 A\n SG_ S : 7|24@{order}+ (1,0) [0|0] \"\" A\n"
        );
        let table = SignalTable::parse(&text).unwrap();
        let signal = &table.messages[0].signals[0];
        for length in 0..8 {
            let mut data = vec![0xff; length];
            signal.put_raw(&mut data, 0);
            let _ = signal.raw(&data);
        }
        assert_eq!(signal.value(&[]), 0.0);
    }
}

#[test]
fn values_saturate_at_their_bits() {
    let table = shipped();
    let (message, place) = table.find("X_CORR").unwrap();
    let signal = &table.messages[message].signals[place];
    let mut data = [0xff; 8];
    for (wanted, found, within) in [
        (12.4, 12.0, true),
        (-3.6, -4.0, true),
        (5000.0, 2047.0, false),
        (-1e300, -2048.0, false),
        (f64::NAN, 0.0, false),
    ] {
        assert_eq!(signal.put(&mut data, wanted), within, "{wanted}");
        assert_eq!(signal.value(&data), found);
    }
    assert_eq!(data[2..], [0xff; 6], "the other bits are unchanged");
    let mut shifted = signal.clone();
    shifted.offset = -2048.0;
    assert!(!shifted.put(&mut data, f64::NAN));
    assert_eq!(shifted.value(&data), -1.0, "the value nearest to 0");
}

proptest! {
    /// For any signal at any position and in both byte orders: the raw value survives a round trip, and bits outside
    /// the signal do not change.
    #[test]
    fn bits_round_trip(
        start in 0_u64..64, bits in 1_u64..=64, little: bool, signed: bool, raw: u64, background: u64,
    ) {
        let order = u8::from(little);
        let sign = if signed { '-' } else { '+' };
        let text = format!("VERSION \"\"\nBU_: A\nBO_ 1 M: 8 A\n SG_ S : {start}|{bits}@{order}{sign} (1,0) [0|0] \"\" A\n");
        if let Ok(table) = SignalTable::parse(&text) {
            let signal = &table.messages[0].signals[0];
            let mut data = background.to_le_bytes();
            let before = data;
            let raw = raw & (u64::MAX >> (64 - signal.bits));
            signal.put_raw(&mut data, raw);
            prop_assert_eq!(signal.raw(&data), raw);
            let changed: u32 = data.iter().zip(before).map(|(a, b)| (a ^ b).count_ones()).sum();
            prop_assert!(u64::from(changed) <= bits);
            signal.put_raw(&mut data, signal.raw(&before));
            prop_assert_eq!(data, before);
        }
    }

    #[test]
    fn arbitrary_text_and_frames_do_not_panic(
        text in "(BO_ [0-9]{1,5} [A-Z]{1,3}: [0-9]{1,2} A\n SG_ [A-Z]{1,2} : [0-9]{1,3}\\|[0-9]{1,2}@[01][+-] \\([0-9.-]{1,3},[0-9]\\) \\[0\\|0\\] \"\" A\n){0,3}",
        id in 0_u32..0x900, data in proptest::collection::vec(any::<u8>(), 0..70), fd: bool,
    ) {
        if let Ok(table) = SignalTable::parse(&text) {
            for message in &table.messages {
                let _ = message.is_whole(&data);
                let values: Vec<f64> = message.signals.iter().map(|s| s.value(&data)).collect();
                prop_assert_eq!(values.len(), message.signals.len());
            }
        }
        if let Some(frame) = Frame::new(id, false, fd, &data) {
            prop_assert_eq!(frame.data(), &data[..]);
            prop_assert!(data.len() <= 64 && id < 0x800);
            let _ = volcomp_can::canopen::telegram(&frame);
        }
    }

    #[test]
    fn positions_round_trip(x in -8388.6..8388.6_f64, y in -8388.6..8388.6_f64, counter in 0_u64..16) {
        let table = shipped();
        let frame = frame_of(&table, "POSITION_XY", &[("X_POS", x), ("Y_POS", y)], counter);
        let message = &table.messages[table.message_of(&frame).unwrap()];
        prop_assert!(message.is_whole(frame.data()));
        prop_assert_eq!(message.counter(frame.data()), Some(counter));
        prop_assert!((message.signals[0].value(frame.data()) - x).abs() <= 0.000_501);
        prop_assert!((message.signals[1].value(frame.data()) - y).abs() <= 0.000_501);
    }
}

/// A missing or wrong unit is rejected with file, line and signal: µm must not be read as mm.
#[test]
fn units_must_match_the_quantity() {
    let refused = |from: &str, to: &str| {
        let text = SHIPPED_DBC.replacen(from, to, 1);
        assert_ne!(text, SHIPPED_DBC, "{from}");
        let refused = SignalTable::parse_file("bridge.dbc", &text).unwrap_err();
        assert!(matches!(refused, volcomp_can::DbcError::Entry { .. }));
        refused.to_string()
    };
    for (from, to, expected) in [
        (
            "[-2048|2047] \"um\" GATEWAY",
            "[-2048|2047] \"\" GATEWAY",
            "bridge.dbc:22: STATE.X_APPLIED: found no unit, expected mm or um, since the axis is linear",
        ),
        (
            "\"um\" CNC",
            "\"\" CNC",
            "bridge.dbc:33: CORRECTION.X_CORR: found no unit, expected mm or um, since the axis is linear",
        ),
        (
            "\"mm\"",
            "\"deg\"",
            "bridge.dbc:10: POSITION_XY.X_POS: found the unit `deg`, expected mm or um, since the axis is linear",
        ),
        (
            "\"deg\"",
            "\"mm\"",
            "bridge.dbc:17: POSITION_ZC.C_POS: found the unit `mm`, expected deg, rad or urad, since the axis is rotary",
        ),
        (
            "\"degC\"",
            "\"K\"",
            "bridge.dbc:41: TEMPERATURES.BED_TEMP: found the unit `K`, expected degC",
        ),
        (
            "EMERGENCY_STOP : 54|1@1+ (1,0) [0|1] \"\"",
            "EMERGENCY_STOP : 54|1@1+ (1,0) [0|1] \"V\"",
            "bridge.dbc:29: STATE.EMERGENCY_STOP: found the unit `V`, expected no unit or bool, since it is 0 or 1",
        ),
    ] {
        assert_eq!(refused(from, to), expected);
    }
    let bools = SHIPPED_DBC.replace("[0|1] \"\"", "[0|1] \"bool\"");
    assert!(SignalTable::parse(&bools).unwrap().find("ALARM").is_some());
    // The value in µm is 1000 times the value in mm.
    let text = SHIPPED_DBC.replacen("\"mm\"", "\"µm\"", 1);
    let table = SignalTable::parse(&text).unwrap();
    let (message, place) = table.find("X_POS").unwrap();
    let signal = &table.messages[message].signals[place];
    let mut data = [0; 8];
    assert!(signal.put(&mut data, 2.5));
    let (name, at) = signal.position(&data).unwrap();
    assert_eq!(name.letter(), 'X');
    assert!((at.mm_or_rad() - 0.0025).abs() < 1e-12, "{at}");
}

/// Largest correction possible with either sign. For two's complement this is half the range minus one step, for an
/// unsigned number 0.
#[test]
fn the_largest_value_with_either_sign() {
    let largest = |size: u32, sign: char, scale: &str| {
        let dbc = format!(
            "VERSION \"\"\nBU_: A\nBO_ 256 M: 8 A\n SG_ S : 0|{size}@1{sign} {scale} [0|0] \"\" A\n"
        );
        SignalTable::parse(&dbc).unwrap().messages[0].signals[0].largest()
    };
    let near = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-9, "{found}");
    near(largest(12, '-', "(1,0)"), 2047.0);
    near(largest(8, '-', "(-0.5,0)"), 63.5);
    near(largest(8, '+', "(1,0)"), 0.0);
    // With a negative offset an unsigned number covers both signs.
    near(largest(8, '+', "(1,-100)"), 100.0);
    near(largest(8, '+', "(1,-200)"), 55.0);
    near(largest(1, '-', "(1,0)"), 0.0);
}

fn refused(from: &str, to: &str) -> String {
    assert!(SHIPPED_DBC.contains(from), "{from}");
    let error = SignalTable::parse(&SHIPPED_DBC.replace(from, to)).unwrap_err();
    error.to_string()
}

/// Signals that share bits are rejected. With shared bits the control would decode 532 instead of 20 µm. An X that
/// shares bits with the counter would jump with each frame.
#[test]
fn signals_must_not_share_bits() {
    let text = refused("Y_CORR : 12|12", "Y_CORR : 8|12");
    assert!(text.contains("bits shared with Y_CORR, expected separate bits"), "{text}");
    let text = refused("CORRECTION_CNT : 48|4", "CORRECTION_CNT : 0|4");
    assert!(text.contains("bits shared with CORRECTION_CNT"), "{text}");
}

/// Counters of fewer than 16 steps are rejected: a new frame would count as one out of order.
#[test]
fn a_counter_needs_four_bits() {
    let text = refused("STATE_CNT : 48|4", "STATE_CNT : 48|3");
    assert!(text.contains("STATE.STATE_CNT: found 3 bits, expected at least 4"), "{text}");
}

/// Floating-point signals are rejected: 300.0 mm would be decoded as 1133903872 mm.
#[test]
fn floating_point_signals_are_rejected() {
    let dbc = format!("{SHIPPED_DBC}\nSIG_VALTYPE_ 256 X_POS : 1;\n");
    let error = SignalTable::parse(&dbc).unwrap_err().to_string();
    assert!(error.contains("X_POS: found a floating-point number"), "{error}");
    let dbc = format!("{SHIPPED_DBC}\nSIG_VALTYPE_ 256 X_POS : 0;\n");
    assert!(SignalTable::parse(&dbc).is_ok());
}

/// A state signal whose zero bits mean "on" is rejected: a frame with all bits 0 would report the control as
/// referenced.
#[test]
fn a_state_must_be_off_with_bits_zero() {
    let text = refused("REFERENCED : 52|1@1+ (1,0)", "REFERENCED : 52|1@1+ (1,1)");
    assert!(text.contains("found the offset 1, expected 0"), "{text}");
}

fn corpus(target: &str) -> Vec<(String, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fuzz/corpus");
    let entries = std::fs::read_dir(folder.join(target)).unwrap();
    let paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    assert!(paths.len() >= 3, "{target}");
    let name = |path: &PathBuf| path.file_name().unwrap().to_string_lossy().into_owned();
    paths.iter().map(|path| (name(path), std::fs::read(path).unwrap())).collect()
}

#[test]
fn corpus_files_parse_or_are_rejected() {
    for (name, bytes) in corpus("dbc") {
        let read = SignalTable::parse(&String::from_utf8_lossy(&bytes));
        assert!(read.is_ok() || !name.starts_with("valid-"), "{name}: {read:?}");
        assert!(read.is_err() || !name.starts_with("broken-"), "{name}");
    }
}

/// Corpus files (identifier, two flags, data, split as in the fuzz target) are decoded.
#[test]
fn corpus_frames_are_decoded() {
    let table = shipped();
    let mut understood = 0;
    for (name, bytes) in corpus("can") {
        let (Some(id), Some(data)) = (bytes.first_chunk::<4>(), bytes.get(6..)) else {
            continue;
        };
        let frame = Frame::new(u32::from_le_bytes(*id), bytes[4] & 1 == 1, bytes[5] & 1 == 1, data);
        let Some(frame) = frame else { continue };
        let known = telegram(&frame).is_some() || table.message_of(&frame).is_some();
        understood += u32::from(known);
        assert!(known || name.len() == 40, "{name}");
    }
    assert!(understood >= 3);
}
