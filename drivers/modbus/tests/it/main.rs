//! Tests of PT100 according to IEC 60751, of profiles, with simulated faulty modules, and with servers of pymodbus and
//! libmodbus.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod line;
mod outputs;
mod peers;
mod profiles;

use std::{
    path::{Path, PathBuf},
    process::Command,
    time::Duration,
};

use volcomp_modbus::{Bus, Parity, Profile, ThermometerConfig, ThermometerUnit};
use volcomp_port::Backoff;
use volcomp_test_support::{Running, peers::not_run};

pub(crate) fn until(what: &str, holds: impl FnMut() -> bool) {
    volcomp_test_support::until(what, Duration::from_secs(60), holds);
}

pub(crate) fn socat(ours: &Path, theirs: &Path) -> Running {
    let end = |path: &Path| format!("pty,raw,echo=0,link={}", path.display());
    Running::start(Command::new("socat").args([end(ours), end(theirs)]))
}

/// Two serial ports that socat connects to each other.
pub(crate) struct Wire {
    _socat: Running,
    _folder: tempfile::TempDir,
    pub(crate) ours: PathBuf,
    pub(crate) theirs: PathBuf,
}

impl Wire {
    /// `None` without socat. The test is then skipped, but fails under CI.
    pub(crate) fn new() -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let [ours, theirs] = ["ours", "theirs"].map(|name| folder.path().join(name));
        if !Path::new("/usr/bin/socat").exists() {
            not_run("socat");
            return None;
        }
        let wire = Self { _socat: socat(&ours, &theirs), _folder: folder, ours, theirs };
        until("socat creates its ports", || wire.ours.exists() && wire.theirs.exists());
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

pub(crate) fn config(bus: Bus, units: &[u8]) -> ThermometerConfig {
    let profile = Profile::named("pta8c04").unwrap();
    let unit = |unit: &u8| ThermometerUnit {
        unit: *unit,
        profile: profile.clone(),
        names: ["a", "b", "c", "d"].map(|name| format!("{name}{unit}")).to_vec(),
    };
    let mut config = ThermometerConfig::new(bus, unit(&units[0]));
    config.units = units.iter().map(unit).collect();
    config.interval = Duration::from_millis(20);
    config.answer_within = Duration::from_millis(100);
    config.backoff = Backoff { first: Duration::from_millis(5), most: Duration::from_millis(50) };
    config
}
