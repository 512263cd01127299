//! Invalid configurations are rejected before connecting.

use volcomp_focas::{BarrierArea, FocasConfig, FocasError, PmcAddress, PmcArea, Width};
use volcomp_vocabulary::{AxisName, Displacement, Urad};

use crate::at;

fn config(change: impl Fn(&mut FocasConfig)) -> FocasConfig {
    let mut config = FocasConfig::new("192.0.2.10", &[AxisName::X, AxisName::C]);
    change(&mut config);
    config
}

/// Only the ladder's own memory may be written. Signals between control, ladder and machine may not (G8.4 is the
/// emergency stop). Every area may be read, but the report must be in the ladder's memory.
#[test]
fn only_ladder_memory_is_writable() {
    for area in PmcArea::ALL {
        let address = at(area, 8);
        let barrier = |frame: PmcAddress, report: PmcAddress| {
            config(|c| c.barrier = Some(BarrierArea { frame, report })).describe()
        };
        let valid = at(PmcArea::R, 500);
        let found = [
            ("area.first", config(|c| c.shift.first = address).describe()),
            ("heartbeat", config(|c| c.heartbeat = Some(address)).describe()),
            ("sequence", config(|c| c.sequence = Some(address)).describe()),
            ("barrier.frame", barrier(address, valid)),
            ("barrier.report", barrier(valid, address)),
        ];
        for (expected, found) in found {
            if matches!(area, PmcArea::R | PmcArea::D) {
                assert!(found.is_ok(), "{expected}: {found:?}");
                continue;
            }
            let found = found.unwrap_err();
            assert!(
                matches!(found, FocasError::NotWritable { key, at } if key == expected && at == address),
                "{found}"
            );
            assert!(found.of("focas://a").is_input());
        }
        assert!(config(|c| c.referenced = Some(address)).describe().is_ok());
    }
}

#[test]
fn words_must_end_within_the_area() {
    for (width, bytes) in [(Width::Byte, 1_u16), (Width::Word, 2), (Width::Long, 4)] {
        let at = |at: u16| {
            config(|c| {
                c.copied = true;
                c.shift.width = width;
                c.shift.first.at = at;
            })
            .describe()
        };
        let last = u16::MAX - 2 * bytes + 1;
        assert!(at(last).is_ok());
        let found = at(last + 1).unwrap_err();
        assert!(matches!(found, FocasError::BeyondEnd { points: 2, .. }), "{found}");
        assert!(at(u16::MAX).is_err());
    }
}

/// The largest shift is that of a signed word of one, two or four bytes, in counts of 1 µm and 0.001°.
#[test]
fn the_width_limits_the_shift() {
    for (width, most) in
        [(Width::Byte, 127.0), (Width::Word, 32_767.0), (Width::Long, 2_147_483_647.0)]
    {
        let described = config(|c| {
            c.copied = true;
            c.shift.width = width;
        })
        .describe()
        .unwrap();
        let near = |found: Option<Displacement>, micro: f64| {
            let found = found.unwrap().um_or_urad();
            assert!((found - micro).abs() < 1e-9 * micro, "{found} {micro}");
        };
        near(described.axes[0].largest, most);
        let milli_deg = Urad(1e3 * std::f64::consts::PI / 180.0).0;
        near(described.axes[1].largest, most * milli_deg);
    }
}

/// Words that the control takes without a ladder must have two bytes. With one byte each, 21 µm for X and 2 µm for Y
/// would move X by half a millimetre. With four bytes each, the sign of X would become the shift of Y.
#[test]
fn directly_taken_words_must_have_two_bytes() {
    for width in [Width::Byte, Width::Long] {
        let found = config(|c| c.shift.width = width).describe().unwrap_err();
        assert!(matches!(found, FocasError::Width(of) if of == width), "{found}");
        assert!(found.to_string().contains("expected 2"), "{found}");
        assert!(found.of("focas://a").is_input());
    }
    assert!(config(|_| {}).describe().is_ok());
}
