use proptest::prelude::*;
use volcomp_digital_io::{
    CorrectionCode, CorrectionWord, DigitalAxis, PositionCode, PositionWord, Unwrapper,
};
use volcomp_vocabulary::{AxisName, Displacement, Mm};

fn position(bits: u32, code: PositionCode) -> PositionWord {
    PositionWord {
        bits,
        code,
        step: Displacement::Length(Mm(1.0 / 32.0)),
        zero: Displacement::Length(Mm(-100.0)),
    }
}

fn correction(bits: u32, code: CorrectionCode) -> CorrectionWord {
    CorrectionWord { bits, code, step: Displacement::Length(Mm(0.001)) }
}

/// The published words have a position of 15 bits over 1024 mm and a correction of ±127 µm in steps of 1 µm.
#[test]
fn published_words_encode_as_documented() {
    let axis = DigitalAxis::published(AxisName::X);
    assert_eq!(axis.position.range(), 1024.0);
    assert_eq!(axis.position.decode(0).position, 0.0);
    assert_eq!(axis.position.decode(0x7fff).position, 1_023.968_75);
    assert_eq!(axis.position.decode(320).position, 10.0);
    assert!((axis.correction.limit() - 0.127).abs() < 1e-15);
    for (um, word, saturated) in [
        (0.0, 0x00, false),
        (1.0, 0x01, false),
        (-1.0, 0xff, false),
        (127.0, 0x7f, false),
        (127.4, 0x7f, false),
        (-127.0, 0x81, false),
        (-128.0, 0x81, true),
        (1e9, 0x7f, true),
        (-1e300, 0x81, true),
        (0.49, 0x00, false),
        (-0.51, 0xff, false),
    ] {
        let sent = axis.correction.encode(um * 1e-3);
        assert_eq!((sent.word, sent.saturated), (word, saturated), "{um}");
        assert_eq!(axis.correction.decode(word), Some(sent.sent), "{um}");
    }
    let none = axis.correction.encode(f64::NAN);
    assert_eq!((none.word, none.saturated), (0, true));
    assert_eq!(axis.correction.decode(0x80), None, "never sent");
    let size = correction(8, CorrectionCode::SignMagnitude);
    assert_eq!(size.encode(-0.127).word, 0xff);
    assert_eq!(size.encode(-0.005).word, 0x85);
    assert_eq!(size.encode(-1.0).word, 0xff);
    assert_eq!(size.decode(0x80), None, "minus zero");
}

/// Every count of every word length survives a round trip, and neighbours in Gray code differ by one bit.
#[test]
fn codes_round_trip() {
    for bits in [1, 5, 8, 15] {
        let gray = position(bits, PositionCode::Gray);
        let binary = position(bits, PositionCode::Binary);
        let last = (1_u32 << bits) - 1;
        let mut before = None;
        for count in 0..=last {
            let mm = binary.decode(count).position;
            assert_eq!(binary.encode(mm), Some(count));
            let word = gray.encode(mm).unwrap();
            assert_eq!(gray.count(word), count);
            if let Some(before) = before {
                assert_eq!(u32::count_ones(word ^ before), 1);
            }
            before = Some(word);
        }
        assert_eq!(binary.encode(-101.0), None);
        assert_eq!(binary.encode(binary.zero.mm_or_rad() + binary.range()), None);
        assert_eq!(binary.encode(f64::NAN), None);
    }
}

proptest! {
    /// A correction is sent within half a count or reported as saturated, and never as the invalid word.
    #[test]
    fn corrections_round_trip(um in -200.0..200.0_f64, sign in any::<bool>(), bits in 2_u32..12) {
        let code = if sign { CorrectionCode::SignMagnitude } else { CorrectionCode::TwosComplement };
        let word = correction(bits, code);
        let sent = word.encode(um * 1e-3);
        prop_assert_eq!(word.decode(sent.word), Some(sent.sent));
        prop_assert!(sent.word < 1 << bits && sent.word != 1 << (bits - 1));
        let off = (sent.sent - um * 1e-3).abs();
        if sent.saturated {
            prop_assert!((sent.sent.abs() - word.limit()).abs() < 1e-12);
        } else {
            prop_assert!(off <= 0.500_001e-3, "{off}");
        }
    }

    #[test]
    fn positions_round_trip(share in 0.0..1.0_f64, gray: bool, bits in 2_u32..25) {
        let word = position(bits, if gray { PositionCode::Gray } else { PositionCode::Binary });
        let mm = word.zero.mm_or_rad() + share * (word.range() - word.step.mm_or_rad());
        let coded = word.decode(word.encode(mm).unwrap());
        prop_assert!((coded.position - mm).abs() <= coded.within * 1.000_001);
    }

    /// A position word with only the low 8 bits, in counts of 1 µm, is tracked correctly for steps up to 120 µm. At 6
    /// kHz this is a speed of about 40 m/min.
    #[test]
    fn low_bits_are_followed(start in -5e3..5e3_f64, steps in proptest::collection::vec(-0.12..0.12_f64, 1..400)) {
        let word = PositionWord { bits: 8, code: PositionCode::Gray, step: Displacement::Length(Mm(0.001)), zero: Displacement::Length(Mm(0.0)) };
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "only the low bits are needed")]
        let shown = |mm: f64| {
            let count = (mm / 0.001).round() as i64 as u32 & 0xff;
            count ^ (count >> 1)
        };
        let mut place = start;
        // The start position is known within 0.1 mm.
        let mut followed = Unwrapper::new(word, shown(place), place + 0.1);
        for step in steps {
            place += step;
            let found = followed.follow(shown(place));
            prop_assert!((found.position - place).abs() < 0.000_51, "{} {place}", found.position);
        }
    }
}

#[test]
fn invalid_numbers_of_bits_do_not_panic() {
    for bits in [0, 1, 32, 33, u32::MAX] {
        for code in [CorrectionCode::TwosComplement, CorrectionCode::SignMagnitude] {
            let word = correction(bits, code);
            let sent = word.encode(-0.001);
            assert!(word.limit() >= 0.0 && sent.sent.is_finite());
            word.decode(u32::MAX);
        }
        let word = position(bits, PositionCode::Gray);
        word.encode(1e300);
        assert!(word.decode(u32::MAX).position.is_finite());
        Unwrapper::new(word, 0, 1e300).follow(1);
    }
}

/// A travel beyond the word's range is rejected, because positions outside would be ambiguous.
#[test]
fn a_travel_beyond_the_word_is_rejected() {
    let word = PositionWord::PUBLISHED;
    assert_eq!(word.check_travel([0.0, 1023.97]), Ok(()));
    assert_eq!(word.check_travel([-0.01, 1000.0]), Ok(()), "half a count");
    let refused = word.check_travel([0.0, 1500.0]).unwrap_err().to_string();
    assert_eq!(
        refused,
        "found a travel from 0 to 1500 mm, expected one within 0 to 1023.96875 mm, which 15 bits of this step can represent"
    );
    assert!(word.check_travel([-1.0, 10.0]).is_err());
    assert!(word.check_travel([f64::NAN, 10.0]).is_err());
}
