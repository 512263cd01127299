//! PT100 by the standard, profiles, judgement, and modules on the wire: our own that misbehave, and servers of
//! pymodbus and libmodbus.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod fuzz_corpus;
mod iec60751;
mod line;
mod peers;
mod profiles;
mod quality;

use std::{
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

use volcomp_modbus::{Bus, Parity, Profile, ThermometerConfig, ThermometerUnit};
use volcomp_port::Backoff;

/// A program that is ended with the test.
pub(crate) struct Running(pub(crate) Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

pub(crate) fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let end = Instant::now() + Duration::from_secs(20);
    while !holds() {
        assert!(Instant::now() < end, "{what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Two serial ports wired to each other, by socat.
pub(crate) struct Wire {
    _socat: Running,
    _folder: tempfile::TempDir,
    pub(crate) ours: PathBuf,
    pub(crate) theirs: PathBuf,
}

impl Wire {
    /// `None` where there is no socat: the test is named and left out, but not under CI.
    pub(crate) fn new() -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let [ours, theirs] = ["ours", "theirs"].map(|name| folder.path().join(name));
        let end = |path: &Path| format!("pty,raw,echo=0,link={}", path.display());
        let socat = Command::new("socat")
            .args([end(&ours), end(&theirs)])
            .spawn();
        let Ok(socat) = socat else {
            not_run("socat");
            return None;
        };
        let wire = Self {
            _socat: Running(socat),
            _folder: folder,
            ours,
            theirs,
        };
        until("socat makes its ports", || {
            wire.ours.exists() && wire.theirs.exists()
        });
        Some(wire)
    }

    pub(crate) fn bus(&self) -> Bus {
        Bus::Rtu {
            path: self.ours.display().to_string(),
            baud: 19200,
            parity: Parity::None,
            stop_bits: 1,
        }
    }
}

/// Something that `./test` installs is not there.
pub(crate) fn not_run(what: &str) {
    assert!(
        std::env::var_os("CI").is_none(),
        "{what} is missing: ./test installs it"
    );
    eprintln!("not run: {what} is missing, ./test installs it");
}

pub(crate) fn config(bus: Bus, units: &[u8]) -> ThermometerConfig {
    let profile = Profile::named("pta8c04").unwrap();
    let unit = |unit: &u8| ThermometerUnit {
        unit: *unit,
        profile: profile.clone(),
        names: ["a", "b", "c", "d"]
            .map(|name| format!("{name}{unit}"))
            .to_vec(),
    };
    let mut config = ThermometerConfig::new(bus, unit(&units[0]));
    config.units = units.iter().map(unit).collect();
    config.interval = Duration::from_millis(20);
    config.answer_within = Duration::from_millis(100);
    config.backoff = Backoff {
        first: Duration::from_millis(5),
        most: Duration::from_millis(50),
    };
    config
}

pub(crate) fn start(command: &mut Command) -> Running {
    use std::io::{BufRead, BufReader};
    let mut child = command
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut line = String::new();
    let stdout = child.stdout.take().unwrap();
    BufReader::new(stdout).read_line(&mut line).unwrap();
    assert_eq!(line.trim(), "ready");
    Running(child)
}
