//! Command-line options, and the configuration that results from them.

use std::{net::SocketAddr, path::PathBuf, time::Duration};

use volcomp_devices::config::ms;

use crate::{config::Config, error::GatewayError, simulate};

/// Command-line options of the gateway.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct Options {
    /// The TOML file of the configuration
    #[arg(long, conflicts_with = "simulate")]
    pub config: Option<PathBuf>,
    /// The address and port of the dashboard, instead of the configured one
    #[arg(long)]
    pub listen: Option<SocketAddr>,
    /// A file with lines NAME ROLE TOKEN, mode 0600, instead of the configured one
    #[arg(long)]
    pub token_file: Option<PathBuf>,
    /// The folder of the audit log, instead of the configured one
    #[arg(long)]
    pub audit_dir: Option<PathBuf>,
    /// The time of a cycle of the simulation, ms
    #[arg(long = "cycle-ms", id = "cycle_ms", value_parser = cycle, conflicts_with = "config")]
    pub simulated_cycle: Option<Duration>,
}

fn cycle(text: &str) -> Result<Duration, String> {
    let ms: f64 = text.parse().map_err(|_| "expected a number of milliseconds".to_owned())?;
    if (0.25..=100.0).contains(&ms) {
        Ok(Duration::from_secs_f64(ms * 1e-3))
    } else {
        Err("expected 0.25 to 100".to_owned())
    }
}

impl Options {
    /// Reads the configuration and applies the overrides of the command line.
    ///
    /// # Errors
    /// The configuration file is invalid.
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
            // Activated models are stored in the folder of the audit log, so read them from the new folder.
            config = config.with_machine_in_force();
        }
        if let (None, Some(cycle)) = (&self.config, self.simulated_cycle) {
            config.cycle_ms = ms(cycle);
        }
        Ok(config)
    }
}
