//! Device URLs, and probes of simulated devices.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::{collections::BTreeMap, time::Duration};

use volcomp_devices::{
    Address, Facts,
    config::{ControllerConfig, ThermometerConfig},
    controller, probe, thermometer,
};
use volcomp_focas::simulator::{Options, Simulator, World};
use volcomp_port::DeviceError;
use volcomp_vocabulary::AxisName;

fn message(url: &str) -> String {
    match Address::parse(url) {
        Err(e) => e.to_string(),
        Ok(address) => probe(&address, Duration::from_millis(200)).unwrap_err().to_string(),
    }
}

#[test]
fn urls_are_parsed() {
    let address =
        Address::parse("gpio://?position=panel-out:0-14&correction=panel-in:0-7").unwrap();
    assert_eq!(address.scheme, "gpio");
    assert_eq!(address.get("position"), Some("panel-out:0-14"));
    let address = Address::parse("can://vcan0").unwrap();
    assert_eq!((address.scheme, &*address.host), ("can", "vcan0"));
    let config = ControllerConfig {
        url: "focas://[::1]:9000?path=2".to_owned(),
        axes: vec![AxisName::X],
        ..ControllerConfig::default()
    };
    let device = controller(&config).unwrap().describe().unwrap().device;
    assert_eq!(device, "focas://[::1]:9000");
}

#[test]
fn invalid_urls_name_the_expected_value() {
    for (url, expected) in [
        ("nonsense", "nonsense: this is no device URL"),
        ("opc://x", "found the scheme `opc`; expected focas://HOST"),
        ("focas://", "is missing"),
        ("focas://h?unit=3", "found the key `unit`; expected one of: path"),
        ("focas://h?axes=X", "found the key `axes`; expected one of: path"),
        ("opc.tcp://h?user=anna", "found the key `user`; expected no keys"),
        ("modbus://h?unit=1&unit=2", "the key `unit` is listed twice"),
        ("modbus://h", "no profile is named; expected profile=NAME, one of: PTA8C04"),
        ("modbus://h?profile=XY", "there is no profile `XY`"),
        (
            "modbus://h?profile=PTA8C04&unit=0",
            "found unit=0; expected a whole number from 1 to 247",
        ),
        ("modbus-rtu://?profile=PTA8C04", "the serial device is missing; expected three slashes"),
        (
            "modbus-rtu:///dev/x?profile=PTA8C04&parity=odd1",
            "found parity=odd1; expected none, even or odd",
        ),
        (
            "modbus://h?profile=PTA8C04&byte_order=low",
            "found byte_order, and profile PTA8C04 has no numbers of two registers",
        ),
        (
            "modbus://h?profile=PTA8C04&answer_ms=5",
            "found answer_ms=5; expected a whole number from 10 to 10000",
        ),
        ("modbus-rtu:///dev/none?profile=PTA8C04", "the module does not answer; check wire"),
        ("modbus://127.0.0.1:1?profile=PTA8C04", "the module does not answer; check address"),
        ("gpio://?position=a:0-14", "correction is missing; expected gpio://"),
        ("gpio://?position=a:0-14&correction=b", "found `b` as lines"),
        ("can://can77?dbc=nowhere.dbc", "nowhere.dbc: cannot be read: No such file"),
        ("focas://127.0.0.1:1", "no connection to 127.0.0.1:1"),
    ] {
        let message = message(url);
        assert!(message.contains(expected), "{url}: {message}");
    }
    let config = ThermometerConfig {
        url: "modbus://h?profile=ADAM-6050".to_owned(),
        ..ThermometerConfig::default()
    };
    let message = thermometer(&config).err().unwrap().to_string();
    assert!(message.contains("ADAM-6050 has no temperatures"), "{message}");
}

#[test]
fn the_book_lists_every_key_of_a_url() {
    let book = volcomp_test_support::root().join("docs/src/commands.md");
    let book = std::fs::read_to_string(book).unwrap();
    let (_, table) = book.split_once("\n## Device URLs\n").unwrap();
    let row = |scheme: &str| {
        let begin = format!("| `{scheme}://");
        let row = table.lines().find(|line| line.starts_with(&begin));
        row.unwrap_or_else(|| panic!("no row of {scheme}"))
    };
    for scheme in ["focas", "modbus", "modbus-rtu", "can", "gpio", "opc.tcp", "linuxcnc"] {
        let mut said = row(scheme).to_owned();
        if scheme == "modbus-rtu" {
            assert!(said.contains("| Those, and "), "{said}");
            said += row("modbus");
        }
        let refused = message(&format!("{scheme}://h/x?unheard-of=1"));
        let keys = refused.split_once("expected one of: ").map(|(_, keys)| keys);
        for key in keys.iter().flat_map(|keys| keys.split(", ")) {
            let is_said =
                [format!("`{key}`"), format!("`{key}=")].iter().any(|word| said.contains(word));
            assert!(is_said, "{scheme}: {key} in {said}");
        }
    }
}

#[test]
fn a_control_is_probed() {
    let mut world = World::new(&['X', 'Y', 'C']);
    world.motion = std::sync::Arc::new(|_| vec![1.5, -2.0, 90.0]);
    let simulator = Simulator::start("127.0.0.1:0", Options::default(), world).unwrap();
    let address = Address::parse(&format!("focas://{}", simulator.address())).unwrap();
    let found = probe(&address, Duration::from_secs(2)).unwrap();
    let by_name = |names: &[(&str, f64)]| {
        let names = names.iter().map(|(name, at)| ((*name).to_owned(), *at));
        names.collect::<BTreeMap<_, _>>()
    };
    assert_eq!(found.positions_mm, by_name(&[("X", 1.5), ("Y", -2.0)]));
    assert_eq!(found.positions_deg, by_name(&[("C", 90.0)]));
    let Some(Facts::Control(control)) = found.facts else {
        panic!("{:?}", found.facts);
    };
    assert_eq!((&*control.series, control.version), ("D4G3 28.0", 3));
    assert!(!control.alarm && !control.emergency_stop);
    assert_eq!((control.shift_in_use, control.shift_words), (Some(true), Some(100)));
    assert!(control.round_trip_p50_us <= control.round_trip_max_us);
}

/// A profile file works like a shipped profile. Its errors are reported with file, line and key.
#[test]
fn a_profile_may_be_a_file() {
    let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/temperature-module.toml");
    let thermometer = |url: &str| {
        volcomp_devices::thermometer(&ThermometerConfig {
            url: url.to_owned(),
            ..ThermometerConfig::default()
        })
    };
    let found = thermometer(&format!("modbus://127.0.0.1:1?profile={shipped}")).unwrap();
    assert_eq!(found.names.len(), 8);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("oven.toml");
    let text = "name = \"OVEN\"\n[channels]\naddress = 4\ncount = 2\nscale = 0.1\n";
    std::fs::write(&file, text).unwrap();
    let url = format!("modbus://127.0.0.1:1?profile={}&names=door,wall", file.display());
    let found = thermometer(&url).unwrap();
    assert_eq!(found.names, ["door", "wall"]);
    std::fs::write(&file, text.replace("scale", "sclae")).unwrap();
    let refused = thermometer(&url).err().unwrap();
    assert!(refused.is_input());
    let message = refused.to_string();
    assert!(message.contains("oven.toml:5: channels.sclae: unknown key"), "{message}");
    let source = std::error::Error::source(&refused).expect("the error of the profile");
    assert!(message.contains(&source.to_string()));
    std::fs::remove_file(&file).unwrap();
    let refused = thermometer(&url).err().unwrap();
    assert!(refused.to_string().contains("oven.toml: cannot be read"), "{refused}");
}

/// The kind of an error distinguishes invalid input from a failure.
#[test]
fn errors_have_kinds() {
    let probed = |url: &str| {
        let address = Address::parse(url)?;
        probe(&address, Duration::from_millis(50)).map(|_| ())
    };
    let kind = |url: &str| match probed(url).unwrap_err() {
        DeviceError::Address(_) => "address",
        DeviceError::Option(_) => "option",
        DeviceError::Unsupported(_) => "unsupported",
        DeviceError::Open(_) => "open",
        DeviceError::NoAnswer(_) => "no answer",
        DeviceError::Protocol(_) => "protocol",
        _ => "other",
    };
    for (url, expected) in [
        ("nothing", "address"),
        ("opcua://host", "address"),
        ("focas://", "address"),
        ("focas://h?colour=red", "option"),
        ("focas://h?path=77", "option"),
        ("can://can77?dbc=nowhere.dbc", "option"),
        ("gpio://?position=a:0-14", "option"),
        ("can://can77", "open"),
        ("focas://127.0.0.1:1", "open"),
        ("modbus://127.0.0.1:1?profile=PTA8C04", "no answer"),
    ] {
        assert_eq!(kind(url), expected, "{url}");
        let is_input = matches!(expected, "address" | "option" | "unsupported");
        assert_eq!(probed(url).unwrap_err().is_input(), is_input, "{url}");
    }
}

#[test]
fn a_module_without_read_back_is_reported() {
    use std::io::{Read, Write};
    for tells in [true, false] {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        std::thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            let mut request = [0; 12];
            while stream.read_exact(&mut request).is_ok() {
                let body = match request[7] {
                    1 if !tells => vec![0x81, 1],
                    function => vec![function, 1, 0b101],
                };
                let length = u8::try_from(body.len() + 1).unwrap();
                let answer = [&request[..4], &[0, length, request[6]], &body].concat();
                stream.write_all(&answer).unwrap();
            }
        });
        let url = format!("modbus://127.0.0.1:{port}?profile=WAVESHARE-IO-8CH");
        let found = probe(&Address::parse(&url).unwrap(), Duration::from_secs(5)).unwrap();
        assert_eq!(found.inputs[..3], [true, false, true]);
        let Some(Facts::Module(module)) = found.facts else {
            panic!("{:?}", found.facts);
        };
        assert_eq!(module.outputs_told, Some(tells));
    }
}

#[test]
fn local_devices_are_listed() {
    let found = volcomp_devices::list();
    assert_eq!(found, volcomp_devices::list());
    assert!(found.can_interfaces.iter().all(|interface| !interface.name.is_empty()));
}
