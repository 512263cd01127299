//! Tests with servers of two independent libraries, pymodbus and libmodbus, over TCP and RTU.

use std::{
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::{Duration, Instant},
};

use volcomp_modbus::{Bus, DigitalModule, ModbusDigital, Profile, poll_temperatures};
use volcomp_port::{Backoff, DigitalIo, Published, Quality, Reason, Thermometer, contract};
use volcomp_test_support::{
    Running, free_port,
    peers::{not_run, python},
};

use crate::{Wire, config, until};

fn peers() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peers")
}

fn pymodbus(kind: &str, place: &str) -> Option<Running> {
    let server = peers().join("pymodbus_server.py");
    Some(Running::start_ready(
        Command::new(python()?).arg(server).args([kind, place]).stderr(Stdio::null()),
    ))
}

fn libmodbus(folder: &Path, kind: &str, place: &str) -> Option<Running> {
    let program = folder.join("libmodbus_server");
    let compiled = Command::new("cc")
        .arg(peers().join("libmodbus_server.c"))
        .args(["-I/usr/include/modbus", "-lmodbus", "-o"])
        .arg(&program)
        .status();
    if !compiled.is_ok_and(|status| status.success()) {
        not_run("libmodbus-dev");
        return None;
    }
    Some(Running::start_ready(Command::new(program).args([kind, place])))
}

fn tcp(port: u16) -> Bus {
    Bus::Tcp { host: "127.0.0.1".to_owned(), port }
}

/// Checks the temperatures of four channels of each unit, which differ by 0.1 K per channel and 10 K per unit.
fn check(bus: Bus, units: &[u8]) {
    let mut thermometer = poll_temperatures(config(bus, units)).unwrap();
    contract::thermometer(&mut thermometer);
    let latest = thermometer.latest().to_vec();
    for (sensor, found) in latest.iter().enumerate() {
        let (unit, channel) = (units[sensor / 4], u8::try_from(sensor % 4).unwrap());
        let expected = 20.1 + 0.1 * f64::from(channel) + 10.0 * f64::from(unit);
        assert!((found.degc.unwrap() - expected).abs() < 1e-9, "{latest:?}");
    }
}

#[test]
fn pymodbus_over_tcp_killed_and_restarted() {
    let port = free_port();
    let Some(server) = pymodbus("tcp", &port.to_string()) else {
        return;
    };
    check(tcp(port), &[1, 2, 3]);
    let mut thermometer = poll_temperatures(config(tcp(port), &[2])).unwrap();
    let quality = |t: &mut Published| t.latest()[0].quality;
    until("it responds", || quality(&mut thermometer) == Quality::Good);
    drop(server);
    until("the outage is reported", || quality(&mut thermometer) == Quality::Bad(Reason::NoAnswer));
    let _server = pymodbus("tcp", &port.to_string());
    until("it responds again", || quality(&mut thermometer) == Quality::Good);
}

#[test]
fn pymodbus_over_a_serial_line() {
    let Some(wire) = Wire::new() else { return };
    let Some(_server) = pymodbus("rtu", &wire.theirs.display().to_string()) else {
        return;
    };
    check(wire.bus(), &[1, 3]);
}

#[test]
fn libmodbus_over_tcp_and_a_serial_line() {
    let folder = tempfile::tempdir().unwrap();
    let port = free_port();
    let Some(_server) = libmodbus(folder.path(), "tcp", &port.to_string()) else {
        return;
    };
    check(tcp(port), &[1]);
    let Some(wire) = Wire::new() else { return };
    let _server = libmodbus(folder.path(), "rtu", &wire.theirs.display().to_string());
    check(wire.bus(), &[1]);
}

#[test]
fn digital_lines_of_pymodbus() {
    let port = free_port();
    let Some(_server) = pymodbus("tcp", &port.to_string()) else {
        return;
    };
    let profile = Profile::named("waveshare-io-8ch").unwrap();
    let modules = [1, 2].map(|unit| DigitalModule { unit, profile: profile.clone() });
    let within = Duration::from_secs(10);
    let mut io = ModbusDigital::new(tcp(port), &modules, within, Backoff::default()).unwrap();
    let soon = Instant::now() + Duration::from_secs(600);
    until("a read succeeds", || io.read(soon).is_ok_and(|found| found.levels == 0xaaaa));
    contract::digital_io(&mut io, false);
}
