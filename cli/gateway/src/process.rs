//! What the whole process asks of the operating system.

use std::{fs::File, io::Write};

use rustix::mm::{MlockAllFlags, mlockall};

/// Memory stays in, the processor stays awake: for the whole process. What could not be had, in words.
pub struct Process {
    _awake: Option<File>,
    /// What could not be had.
    pub lacking: Vec<String>,
}

impl Process {
    /// Asks for both.
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
