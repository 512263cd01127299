//! A sensor that jumped, when the gateway is started again and when something else is acknowledged.

use std::{
    io::{Read, Write},
    net::{SocketAddr, TcpListener},
    sync::{
        Arc,
        atomic::{AtomicI16, Ordering},
    },
    time::Duration,
};

use serde_json::Value;
use volcomp_focas::simulator::{Options, Simulator, World};

use crate::{
    controlled::configuration,
    program::{MACHINE, PATIENCE, Program, path},
    standing::{SmallDisk, kept},
};

/// A module with one sensor, whose temperature a test sets, tenths of a degree.
fn module() -> (SocketAddr, Arc<AtomicI16>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("loopback");
    let address = listener.local_addr().expect("bound");
    let tenths = Arc::new(AtomicI16::new(200));
    let told = Arc::clone(&tenths);
    std::thread::spawn(move || {
        for mut stream in listener.incoming().flatten() {
            let told = Arc::clone(&told);
            std::thread::spawn(move || {
                let mut request = [0; 12];
                while stream.read_exact(&mut request).is_ok() {
                    let mut answer = [&request[..4], &[0, 5], &request[6..8], &[2]].concat();
                    answer.extend(told.load(Ordering::Relaxed).to_be_bytes());
                    if stream.write_all(&answer).is_err() {
                        return;
                    }
                }
            });
        }
    });
    (address, tenths)
}

/// The scale of X expands by 11.5 µm a metre and kelvin, at 400 mm.
fn bench(dir: &std::path::Path) -> (Simulator, Arc<AtomicI16>, std::path::PathBuf) {
    let mut world = World::new(&['X', 'Y', 'Z']);
    world.motion = Arc::new(|t: Duration| vec![400.0 + t.as_secs_f64().sin(), 150.0, 50.0]);
    let control = Simulator::start("127.0.0.1:0", Options::default(), world).expect("loopback");
    let (address, tenths) = module();
    let config = configuration(dir, &control, "auto_arm = true");
    let profile = "name = \"ONE\"\n[channels]\nfunction = 4\naddress = 0\ncount = 1\ntype = \"i16\"\nscale = 0.1\nunit = \"degc\"\nvalid_degc = [-50.0, 200.0]\n";
    std::fs::write(dir.join("one.toml"), profile).expect("writable");
    let thermal = "[thermal]\nreference = 20.0\n[[thermal.expansion]]\nerror = \"EXX\"\nsensor = \"scale_x\"\num_per_m_k = 11.5\n";
    std::fs::write(dir.join("machine.toml"), format!("{MACHINE}{thermal}")).expect("writable");
    let text = std::fs::read_to_string(&config).expect("readable");
    let thermometer = format!(
        "[[thermometer]]\nurl = \"modbus://{address}?profile={}\"\nnames = [\"scale_x\"]\n",
        dir.join("one.toml").display()
    );
    std::fs::write(&config, text + &thermometer).expect("writable");
    (control, tenths, config)
}

fn quality(state: &Value) -> String {
    let sensor = &state["temperatures"][0];
    format!("{} {}", sensor["quality"], sensor["reason"])
}

/// The sensor is heard while the machine is corrected, and then jumps.
fn let_sensor_jump(program: &Program, tenths: &AtomicI16) {
    program.wait_for("compensating");
    program
        .wait(|state| quality(state).contains("good"))
        .expect("it is heard");
    tenths.store(350, Ordering::Relaxed);
    program
        .wait(|state| quality(state).contains("jumped"))
        .expect("it jumped");
}

/// A broken sensor was out, and the gateway was started again: its first reading was believed, it armed itself, and X was
/// moved by what the sensor told.
#[test]
fn a_sensor_that_jumped_keeps_a_restart_from_arming() {
    let dir = tempfile::tempdir().expect("writable");
    let (control, tenths, config) = bench(dir.path());
    let mut program = Program::start(dir.path(), &["--config", path(&config)]);
    let_sensor_jump(&program, &tenths);
    let kept = dir.path().join("audit/standing.slots");
    volcomp_test_support::until("it is written down", PATIENCE, || {
        std::fs::read_to_string(&kept).is_ok_and(|text| text.contains("scale_x"))
    });
    program.running.kill();
    drop(program);
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    let told = program.wait(|state| {
        state["reasons"]
            .to_string()
            .contains("temperature that jumped before the restart: scale_x")
    });
    assert_eq!(told.expect("it says why")["state"], "faulted");
    std::thread::sleep(Duration::from_secs(3));
    assert_eq!(program.state()["state"], "faulted");
    // A person has looked at it.
    assert_eq!(program.post("/api/acknowledge", "").status, 200);
    program.wait_for("disarmed");
    drop(control);
}

/// The same on a full disk.
#[test]
fn a_sensor_that_jumped_is_kept_on_a_full_disk() {
    let dir = tempfile::tempdir().expect("writable");
    let Some(disk) = SmallDisk::at(dir.path().join("audit")) else {
        return;
    };
    let (control, tenths, config) = bench(dir.path());
    let mut program = Program::start(dir.path(), &["--config", path(&config)]);
    program.wait_for("compensating");
    disk.fill(0);
    let_sensor_jump(&program, &tenths);
    let file = disk.0.join("standing.slots");
    volcomp_test_support::until("it is written down", PATIENCE, || {
        kept(&file).contains("scale_x")
    });
    program.running.kill();
    drop(program);
    disk.make_room();
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    let told = program.wait(|state| {
        let reasons = state["reasons"].to_string();
        reasons.contains("temperature that jumped before the restart: scale_x")
    });
    assert_eq!(told.expect("it is remembered")["state"], "faulted");
    drop(control);
}

/// The sensor jumped, and an alarm of the control was acknowledged: with it the sensor was believed.
#[test]
fn acknowledging_an_alarm_believes_no_sensor() {
    let dir = tempfile::tempdir().expect("writable");
    let (control, tenths, config) = bench(dir.path());
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    let_sensor_jump(&program, &tenths);
    control.world().alarms = vec![(1, "door".to_owned())];
    program.wait_for("holding");
    program.post("/api/acknowledge", "");
    control.world().alarms.clear();
    program.wait_for("compensating");
    std::thread::sleep(Duration::from_secs(2));
    let state = program.state();
    assert!(quality(&state).contains("jumped"), "{state}");
    assert_eq!(program.post("/api/acknowledge", "").status, 200);
    program
        .wait(|state| quality(state).contains("good"))
        .expect("a person has looked at it");
}
