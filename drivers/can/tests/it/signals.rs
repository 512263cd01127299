use proptest::prelude::*;
use volcomp_can::{Frame, SignalTable};

use crate::{frame_of, shipped};

#[test]
fn the_shipped_file_is_read() {
    let table = shipped();
    assert_eq!(table.messages.len(), 5);
    for axis in ["X", "Y", "Z", "C"] {
        for suffix in ["POS", "CORR", "APPLIED"] {
            assert!(
                table.find(&format!("{axis}_{suffix}")).is_some(),
                "{axis}_{suffix}"
            );
        }
    }
    for message in &table.messages {
        let data = [0; 8];
        assert!(
            message.counter(&data).is_some(),
            "{} has no counter",
            message.name
        );
        assert!(!message.is_whole(&data), "{} has no checksum", message.name);
    }
}

/// CRC-8 SAE J1850 of "123456789" is 4b: here the identifier makes four bytes of it.
#[test]
fn the_checksum_is_the_published_one() {
    let dbc =
        "VERSION \"\"\nBU_: A\nBO_ 2200023220 M: 6 A\n SG_ M_CRC : 40|8@1+ (1,0) [0|0] \"\" A\n";
    let table = SignalTable::parse(dbc).unwrap();
    // 31 32 33 34 as a 29-bit identifier is beyond them; so a shorter one, computed bit by bit.
    let crc = |bytes: &[u8]| {
        let mut crc = 0xff_u8;
        for byte in bytes {
            crc ^= byte;
            for _ in 0..8 {
                crc = if crc & 0x80 == 0 {
                    crc << 1
                } else {
                    crc << 1 ^ 0x1d
                };
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
fn what_cannot_be_used_is_named() {
    let message = |lines: &str| {
        let text = format!("VERSION \"\"\nBU_: A\n{lines}\n");
        SignalTable::parse(&text).unwrap_err().to_string()
    };
    let signal = |signal: &str| message(&format!("BO_ 1 M: 8 A\n SG_ S : {signal} [0|0] \"\" A"));
    for (definition, expected) in [
        (
            "60|8@1+ (1,0)",
            "M.S: found 8 bits from 60 on, expected 1 to 64 bits within 64",
        ),
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
            .contains("a length that frames have")
    );
    let twice = "BO_ 1 M: 8 A\n SG_ S : 0|8@1+ (1,0) [0|0] \"\" A\n\nBO_ 1 N: 8 A\n SG_ T : 0|8@1+ (1,0) [0|0] \"\" A";
    assert!(message(twice).contains("DBC:6: N: found the identifier or name of M"));
    assert!(message("BO_ nonsense").starts_with("DBC: "));
}

/// Data of another length than the message's have no numbers, in either byte order.
#[test]
fn data_that_are_too_short_are_zeros() {
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
fn values_are_held_within_their_bits() {
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
    assert_eq!(data[2..], [0xff; 6], "the other bits are as they were");
}

proptest! {
    /// Any signal at any place in both orders: the bits come back, and no other is touched.
    #[test]
    fn bits_come_back(
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
    fn no_text_and_no_frame_makes_a_panic(
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
    fn positions_come_back(x in -8388.6..8388.6_f64, y in -8388.6..8388.6_f64, counter in 0_u64..16) {
        let table = shipped();
        let frame = frame_of(&table, "POSITION_XY", &[("X_POS", x), ("Y_POS", y)], counter);
        let message = &table.messages[table.message_of(&frame).unwrap()];
        prop_assert!(message.is_whole(frame.data()));
        prop_assert_eq!(message.counter(frame.data()), Some(counter));
        prop_assert!((message.signals[0].value(frame.data()) - x).abs() <= 0.000_501);
        prop_assert!((message.signals[1].value(frame.data()) - y).abs() <= 0.000_501);
    }
}

/// A unit that is missing, or that the axis of the signal does not have, is refused when the table is read, with file,
/// line and signal: µm without their unit would be read as mm.
#[test]
fn units_are_those_of_the_quantity() {
    let refused = |from: &str, to: &str| {
        let text = volcomp_can::SHIPPED_DBC.replacen(from, to, 1);
        assert_ne!(text, volcomp_can::SHIPPED_DBC, "{from}");
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
    let bools = volcomp_can::SHIPPED_DBC.replace("[0|1] \"\"", "[0|1] \"bool\"");
    assert!(SignalTable::parse(&bools).unwrap().find("ALARM").is_some());
    // A position in µm is a thousandth of that in mm.
    let text = volcomp_can::SHIPPED_DBC.replacen("\"mm\"", "\"µm\"", 1);
    let table = SignalTable::parse(&text).unwrap();
    let (message, place) = table.find("X_POS").unwrap();
    let signal = &table.messages[message].signals[place];
    let mut data = [0; 8];
    assert!(signal.put(&mut data, 2.5));
    let (name, at) = signal.position(&data).unwrap();
    assert_eq!(name.letter(), 'X');
    assert!((at.mm_or_rad() - 0.0025).abs() < 1e-12, "{at}");
}

/// What a signal can say with either sign: of two's complement one step less than half its range, of a number without a
/// sign nothing.
#[test]
fn the_largest_value_of_both_signs() {
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
    // An offset makes both signs of a number without one.
    near(largest(8, '+', "(1,-100)"), 100.0);
    near(largest(8, '+', "(1,-200)"), 55.0);
    near(largest(1, '-', "(1,0)"), 0.0);
}
