//! A sensor that jumped, when the gateway is started again and when something else is acknowledged.

use std::{
    path::{Path, PathBuf},
    sync::atomic::Ordering,
    time::Duration,
};

use serde_json::Value;
use volcomp_gateway::request::Ask;
use volcomp_port::inject::Injection;

use crate::{
    manual::{Gateway, configuration},
    program::{MACHINE, append},
    standing::{SmallDisk, kept},
};

/// The scale of X expands by 11.5 µm a metre and kelvin.
fn with_thermometer(dir: &Path) -> PathBuf {
    let config = configuration(dir, "auto_arm = true");
    let profile = "name = \"ONE\"\n[channels]\nfunction = 4\naddress = 0\ncount = 1\ntype = \"i16\"\nscale = 0.1\nunit = \"degc\"\nvalid_degc = [-50.0, 200.0]\n";
    let file = dir.join("one.toml");
    std::fs::write(&file, profile).expect("writable");
    let thermal = "[thermal]\nreference = 20.0\n[[thermal.expansion]]\nerror = \"EXX\"\nsensor = \"scale_x\"\num_per_m_k = 11.5\n";
    std::fs::write(dir.join("machine.toml"), format!("{MACHINE}{thermal}")).expect("writable");
    let url = format!("modbus://127.0.0.1:1?profile={}", file.display());
    append(
        &config,
        &format!("[[thermometer]]\nurl = \"{url}\"\nnames = [\"scale_x\"]\n"),
    );
    config
}

fn quality(state: &Value) -> String {
    let sensor = &state["temperatures"][0];
    format!("{} {}", sensor["quality"], sensor["reason"])
}

/// The sensor is heard while the machine is corrected, and then jumps.
fn let_sensor_jump(gateway: &mut Gateway) {
    gateway.wait_for("compensating");
    gateway.wait("heard", |state| quality(state).contains("good"));
    let (sensor, kelvin) = (0, 15.0);
    gateway
        .rig
        .inject_sensor(Injection::Jump { sensor, kelvin });
    gateway.wait("jumped", |state| quality(state).contains("jumped"));
}

/// A broken sensor was out, and the gateway was started again, also after a full disk: its first reading was believed, it armed
/// itself, and X was moved by what the sensor told.
#[test]
fn a_sensor_that_jumped_keeps_a_restart_from_arming() {
    for is_full in [false, true] {
        let dir = tempfile::tempdir().expect("writable");
        let folder = dir.path().join("audit");
        let disk = is_full.then(|| SmallDisk::at(folder.clone()));
        let Some(disk) = disk.map_or(Some(None), |disk| disk.map(Some)) else {
            return;
        };
        let config = with_thermometer(dir.path());
        let mut gateway = Gateway::start(&config);
        gateway.wait_for("compensating");
        if let Some(disk) = &disk {
            disk.fill(0);
        }
        let_sensor_jump(&mut gateway);
        gateway.run(Duration::from_millis(100));
        assert!(kept(&folder.join("standing.slots")).contains("scale_x"));
        if let Some(disk) = &disk {
            disk.make_room();
        }
        let mut gateway = gateway.killed_and_started(&config);
        let told = "temperature that jumped before the restart: scale_x";
        assert_eq!(gateway.wait_until_says(told)["state"], "faulted");
        gateway.run(Duration::from_secs(10));
        assert_eq!(gateway.state()["state"], "faulted");
        // A person has looked at it.
        assert_eq!(gateway.ask(Ask::Acknowledge).0, 200);
        assert_ne!(gateway.state()["state"], "faulted");
    }
}

/// The sensor jumped, and an alarm of the control was acknowledged: with it the sensor was believed.
#[test]
fn acknowledging_an_alarm_believes_no_sensor() {
    let dir = tempfile::tempdir().expect("writable");
    let config = with_thermometer(dir.path());
    let mut gateway = Gateway::start(&config);
    let_sensor_jump(&mut gateway);
    gateway.rig.controls.alarm.store(true, Ordering::Relaxed);
    gateway.wait_for("holding");
    gateway.ask(Ask::Acknowledge);
    gateway.rig.controls.alarm.store(false, Ordering::Relaxed);
    gateway.wait_for("compensating");
    gateway.run(Duration::from_secs(5));
    let state = gateway.state();
    assert!(quality(&state).contains("jumped"), "{state}");
    assert_eq!(gateway.ask(Ask::Acknowledge).0, 200);
    gateway.wait("believed", |state| quality(state).contains("good"));
}
