//! How the gateway is called, and the configuration that follows from it.

use std::{net::SocketAddr, path::PathBuf, time::Duration};

use volcomp_devices::config::ms;

use crate::{config::Config, error::GatewayError, simulate};

/// How the gateway is called.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// The configuration; `None`: the built-in simulation.
    pub config: Option<PathBuf>,
    /// Where the dashboard listens, instead of the configured address.
    pub listen: Option<SocketAddr>,
    /// The file with named tokens, instead of the configured one.
    pub token_file: Option<PathBuf>,
    /// The folder of the audit log, instead of the configured one.
    pub audit_dir: Option<PathBuf>,
    /// The time of a cycle of the simulation.
    pub simulated_cycle: Option<Duration>,
}

impl Options {
    /// The configuration, with what the call says instead of it.
    ///
    /// # Errors
    /// What is wrong with the file.
    pub fn configuration(&self) -> Result<Config, GatewayError> {
        let mut config = match &self.config {
            Some(path) => Config::read(path)?,
            None => simulate::config(),
        };
        if let Some(listen) = self.listen {
            config.dashboard.listen = listen;
        }
        if let Some(file) = &self.token_file {
            config.dashboard.token_file = Some(file.clone());
        }
        if let Some(dir) = &self.audit_dir {
            config.audit.dir.clone_from(dir);
            // The models that are in force stand beside the log.
            config = config.with_machine_in_force();
        }
        if let (None, Some(cycle)) = (&self.config, self.simulated_cycle) {
            config.cycle_ms = ms(cycle);
        }
        Ok(config)
    }
}
