//! URLs, and a probe of a simulated control.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::time::Duration;

use volcomp_devices::{Address, Scheme, focas_config, probe, thermometer};
use volcomp_focas::simulator::{Options, Simulator, World};
use volcomp_vocabulary::AxisName;

fn message(url: &str) -> String {
    match Address::parse(url) {
        Err(e) => e.to_string(),
        Ok(address) => probe(&address, Duration::from_millis(200))
            .unwrap_err()
            .to_string(),
    }
}

#[test]
fn urls_are_taken_apart() {
    let address =
        Address::parse("gpio://?position=panel-out:0-14&correction=panel-in:0-7").unwrap();
    assert_eq!(address.scheme, Scheme::Gpio);
    assert_eq!(address.get("position"), Some("panel-out:0-14"));
    let address = Address::parse("can://vcan0").unwrap();
    assert_eq!((address.scheme, &*address.host), (Scheme::Can, "vcan0"));
    let address = Address::parse("focas://[::1]:9000?path=2").unwrap();
    let config = focas_config(&address, &[AxisName::X]).unwrap();
    assert_eq!((config.port, config.path), (9000, 2));
}

#[test]
fn wrong_urls_say_what_is_expected() {
    for (url, expected) in [
        ("nonsense", "nonsense: this is no device URL"),
        ("opc://x", "found the scheme `opc`; expected focas://HOST"),
        ("focas://", "is missing"),
        (
            "focas://h?unit=3",
            "found the key `unit`; expected one of: path, axes",
        ),
        ("modbus://h?unit=1&unit=2", "the key `unit` stands twice"),
        (
            "modbus://h",
            "no profile is named; expected profile=NAME, one of: PTA8C04",
        ),
        ("modbus://h?profile=XY", "there is no profile `XY`"),
        (
            "modbus://h?profile=PTA8C04&unit=0",
            "found unit=0; expected a whole number from 1 to 247",
        ),
        (
            "modbus-rtu://?profile=PTA8C04",
            "the serial device is missing; expected three slashes",
        ),
        (
            "modbus-rtu:///dev/x?profile=PTA8C04&parity=odd1",
            "found parity=odd1; expected none, even or odd",
        ),
        (
            "modbus-rtu:///dev/none?profile=PTA8C04",
            "the module does not answer; check wire",
        ),
        (
            "modbus://127.0.0.1:1?profile=PTA8C04",
            "the module does not answer; check address",
        ),
        (
            "gpio://?position=a:0-14",
            "correction is missing; expected gpio://",
        ),
        ("gpio://?position=a:0-14&correction=b", "found `b` as lines"),
        ("can://can77?dbc=nowhere.dbc", "nowhere.dbc: No such file"),
        ("focas://127.0.0.1:1", "no connection to 127.0.0.1:1"),
    ] {
        let message = message(url);
        assert!(message.contains(expected), "{url}: {message}");
    }
    let address = Address::parse("modbus://h?profile=ADAM-6050").unwrap();
    let message = thermometer(&address, &[]).err().unwrap().to_string();
    assert!(
        message.contains("ADAM-6050 has no temperatures"),
        "{message}"
    );
}

#[test]
fn a_control_is_probed() {
    let mut world = World::new(&['X', 'Y', 'C']);
    world.motion = std::sync::Arc::new(|_| vec![1.5, -2.0, 90.0]);
    let simulator = Simulator::start("127.0.0.1:0", Options::default(), world).unwrap();
    let address = Address::parse(&format!("focas://{}", simulator.address())).unwrap();
    let found = probe(&address, Duration::from_secs(2)).unwrap();
    let positions: Vec<_> = found
        .positions
        .iter()
        .map(|p| (&*p.name, p.rotary, p.value))
        .collect();
    assert_eq!(
        positions,
        [("X", false, 1.5), ("Y", false, -2.0), ("C", true, 90.0)]
    );
    assert!(
        found
            .facts
            .contains(&("series".to_owned(), "D4G3 28.0".to_owned()))
    );
}
