//! The requests of the whole process to the operating system: locked memory and processors that stay awake.

use std::{fs::File, io::Write};

use rustix::mm::{MlockAllFlags, mlockall};

/// Memory that stays locked and processors that stay awake, for the whole process and as long as this lives.
pub struct Process {
    _awake: Option<File>,
    /// The requests that the operating system refused, in words.
    pub lacking: Vec<String>,
}

impl Process {
    /// Asks the operating system for both.
    pub fn prepare() -> Self {
        let mut lacking = Vec::new();
        let flags = MlockAllFlags::CURRENT | MlockAllFlags::FUTURE | MlockAllFlags::ONFAULT;
        if let Err(e) = mlockall(flags) {
            lacking.push(format!("memory is not locked: {e} (LimitMEMLOCK)"));
        }
        let awake = std::fs::OpenOptions::new()
            .write(true)
            .open("/dev/cpu_dma_latency")
            .and_then(|mut file| {
                file.write_all(&0_i32.to_ne_bytes())?;
                Ok(file)
            });
        if let Err(e) = &awake {
            lacking.push(format!("processors may sleep: /dev/cpu_dma_latency: {e}"));
        }
        Self {
            _awake: awake.ok(),
            lacking,
        }
    }
}
