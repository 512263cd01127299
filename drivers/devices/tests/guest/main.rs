//! Probes of the guest's lines and buses. Run by `./test` in the guest, or by `tests/guest/run`.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::{process::Command, time::Duration};

use volcomp_devices::{Address, Facts, probe};
use volcomp_test_support::Running;

#[test]
fn lines_are_probed() {
    let url = "gpio://?position=panel-out:0-14&correction=panel-in:0-7";
    let found = probe(&Address::parse(url).unwrap(), Duration::from_secs(1)).unwrap();
    assert_eq!((found.device.as_str(), &found.inputs[..]), (url, &[false; 15][..]));
    assert_eq!(found.positions_mm["published"], 0.0);
    let swapped = "gpio://?position=panel-in:0-7&correction=panel-up:0-14";
    let message = probe(&Address::parse(swapped).unwrap(), Duration::from_secs(1)).unwrap_err();
    assert!(message.to_string().contains("gpio panel-up: there is no such chip"), "{message}");
}

/// The probe of a bus reports 100 mm and −2 mm from a frame with counter and checksum of the shipped file.
#[test]
fn a_bus_is_probed() {
    let table = volcomp_can::SignalTable::parse(volcomp_can::SHIPPED_DBC).unwrap();
    let message = table.messages.iter().find(|m| m.name == "POSITION_XY").unwrap();
    let mut data = [0; 8];
    message.signals[0].put(&mut data, 100.0);
    message.signals[1].put(&mut data, -2.0);
    message.seal(&mut data, 1);
    let hex: Vec<String> = data.iter().map(|byte| format!("{byte:02X}")).collect();
    let text = format!("100#{}", hex.concat());
    let script =
        format!("while true; do cansend vcan0 {text}; cansend vcan0 7E5#05; sleep 0.05; done");
    let _control = Running::start(Command::new("bash").args(["-c", &script]));
    let address = Address::parse("can://vcan0").unwrap();
    let found = probe(&address, Duration::from_millis(800)).unwrap();
    let positions = &found.positions_mm;
    assert_eq!(positions.len(), 2);
    assert!((positions["X"] - 100.0).abs() < 1e-9, "{positions:?}");
    let other = positions.iter().find(|(name, _)| *name != "X");
    assert!(other.is_some_and(|(_, at)| (at + 2.0).abs() < 1e-9));
    let Some(Facts::Bus(bus)) = found.facts else {
        panic!("{:?}", found.facts);
    };
    let ids: Vec<u32> = bus.frames.iter().map(|seen| seen.id).collect();
    assert_eq!(ids, [0x100, 0x7e5]);
    assert!(bus.frames[0].to_string().starts_with("100 ("));
    let silent = Address::parse("can://vcan1").unwrap();
    let message = probe(&silent, Duration::from_millis(100)).unwrap_err().to_string();
    assert!(message.contains("no frame came within 100 ms; check the wire"), "{message}");
}
