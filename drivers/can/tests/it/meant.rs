//! DBC files that say something else than they seem to: what the control finds is what was asked for, or the file is
//! refused.

use std::time::Duration;

use volcomp_can::{BridgeConfig, CanController, SHIPPED_DBC, SignalTable};
use volcomp_port::Controller;
use volcomp_vocabulary::{AxisName, PerChannel};

use crate::{Bus, soon};

fn refused(from: &str, to: &str) -> String {
    assert!(SHIPPED_DBC.contains(from), "{from}");
    let error = SignalTable::parse(&SHIPPED_DBC.replace(from, to)).unwrap_err();
    error.to_string()
}

/// The control found 532 µm for X where 20 µm were asked for, and X jumped with each frame where the counter lay in its
/// bits.
#[test]
fn signals_that_share_bits_are_refused() {
    let text = refused("Y_CORR : 12|12", "Y_CORR : 8|12");
    assert!(
        text.contains("bits that Y_CORR has, too, expected bits of its own"),
        "{text}"
    );
    let text = refused("CORRECTION_CNT : 48|4", "CORRECTION_CNT : 0|4");
    assert!(text.contains("bits that CORRECTION_CNT has, too"), "{text}");
}

/// 300.0 mm were heard as 1133903872 mm.
#[test]
fn floating_point_numbers_are_refused() {
    let dbc = format!("{SHIPPED_DBC}\nSIG_VALTYPE_ 256 X_POS : 1;\n");
    let error = SignalTable::parse(&dbc).unwrap_err().to_string();
    assert!(
        error.contains("X_POS: found a floating-point number"),
        "{error}"
    );
    let dbc = format!("{SHIPPED_DBC}\nSIG_VALTYPE_ 256 X_POS : 0;\n");
    assert!(SignalTable::parse(&dbc).is_ok());
}

/// A control that says nothing was referenced.
#[test]
fn a_state_that_is_on_without_bits_is_refused() {
    let text = refused("REFERENCED : 52|1@1+ (1,0)", "REFERENCED : 52|1@1+ (1,1)");
    assert!(text.contains("found the offset 1, expected 0"), "{text}");
}

/// Z was moved by -2048 µm from the first frame on, although only X and Y are corrected.
#[test]
fn an_axis_that_is_not_written_gets_zero() {
    let (from, to) = ("Z_CORR : 24|12@1- (1,0)", "Z_CORR : 24|12@1+ (1,-2048)");
    assert!(SHIPPED_DBC.contains(from));
    let table = SignalTable::parse(&SHIPPED_DBC.replace(from, to)).unwrap();
    let config = BridgeConfig {
        table: table.clone(),
        channel: "bridge".to_owned(),
        axes: vec![AxisName::X, AxisName::Y],
        reads: Vec::new(),
        includes_correction: false,
    };
    let bus = Bus::default();
    let mut controller = CanController::new(bus.clone(), &config).unwrap();
    controller.apply(&PerChannel::ZERO, soon()).unwrap();
    let frame = *bus.sent().last().unwrap();
    let (message, place) = table.find("Z_CORR").unwrap();
    let found = table.messages[message].signals[place].value(frame.data());
    assert_eq!(found.abs(), 0.0, "µm");
}

/// Frames that a bridge between two buses doubled lifted an emergency stop, and told an old place as that of now.
#[test]
fn a_frame_that_was_overtaken_says_nothing() {
    let table = crate::shipped();
    let config = BridgeConfig {
        table: table.clone(),
        channel: "bridge".to_owned(),
        axes: vec![AxisName::X],
        reads: Vec::new(),
        includes_correction: false,
    };
    let bus = Bus::default();
    let mut controller = CanController::new(bus.clone(), &config).unwrap();
    let comes = |counter, x, stop| {
        let state = [("REFERENCED", 1.0), ("EMERGENCY_STOP", stop)];
        bus.comes(crate::frame_of(
            &table,
            "POSITION_XY",
            &[("X_POS", x)],
            counter,
        ));
        bus.comes(crate::frame_of(&table, "STATE", &state, counter));
    };
    comes(5, 10.0, 0.0);
    assert!(!controller.read(soon()).unwrap().state.emergency_stop);
    comes(6, 11.0, 1.0);
    assert!(controller.read(soon()).unwrap().state.emergency_stop);
    comes(5, 10.0, 0.0);
    let found = controller.read(soon()).unwrap();
    assert!(found.state.emergency_stop);
    assert!(
        (found.positions[0] - 11.0).abs() < 1e-9,
        "{}",
        found.positions[0]
    );
    assert_eq!(controller.health().repeated, 2);
    comes(7, 12.0, 0.0);
    assert!(!controller.read(soon()).unwrap().state.emergency_stop);
    // After a silence nothing tells how far the counter went.
    std::thread::sleep(Duration::from_millis(120));
    comes(3, 13.0, 1.0);
    assert!(controller.read(soon()).unwrap().state.emergency_stop);
}
