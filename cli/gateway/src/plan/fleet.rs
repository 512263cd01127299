//! Whether the table `[fleet]` can be used, and what the centre has put in force so far.

use crate::{config::Config, documents::FleetPlan, error::GatewayError};

/// What was found of the fleet.
pub(super) struct Checked {
    /// The public nkey of the machine.
    nkey: String,
    /// The version in force; 0: none.
    version: u64,
    /// The highest version that was accepted; 0: none was.
    accepted: u64,
    /// Whether the centre allows correcting.
    enabled: bool,
    /// What in the folder is damaged, in words.
    damage: Option<String>,
}

/// Checks the files that `[fleet]` names.
///
/// # Errors
/// This build knows no fleet, or a file cannot be used.
#[cfg(feature = "fleet")]
pub(super) fn check(config: &Config) -> Result<Option<Checked>, GatewayError> {
    use tokio_rustls::rustls::pki_types::{CertificateDer, pem::PemObject};
    let Some(fleet) = &config.fleet else {
        return Ok(None);
    };
    let settings = crate::fleet::settings(fleet)?;
    let nkey = settings.public_key().map_err(|_| GatewayError::Nkey {
        file: fleet.nkey_file.clone(),
    })?;
    if let Some(ca) = &fleet.ca {
        let mut found = CertificateDer::pem_file_iter(ca).into_iter().flatten();
        if !matches!(found.next(), Some(Ok(_))) {
            return Err(GatewayError::FleetCa { file: ca.clone() });
        }
    }
    let kept = crate::fleet::kept(fleet);
    Ok(Some(Checked {
        nkey,
        version: kept.standing.active.unwrap_or(0),
        accepted: kept.standing.highest,
        enabled: !kept.standing.disabled,
        damage: kept.damage,
    }))
}

/// Refuses a fleet, which this build does not know.
///
/// # Errors
/// This build knows no fleet.
#[cfg(not(feature = "fleet"))]
pub(super) fn check(config: &Config) -> Result<Option<Checked>, GatewayError> {
    match &config.fleet {
        None => Ok(None),
        Some(_) => Err(GatewayError::NoFleet {
            file: config.file.clone(),
        }),
    }
}

impl Checked {
    /// What the centre has activated.
    pub(super) fn document(&self) -> FleetPlan {
        FleetPlan {
            nkey: self.nkey.clone(),
            version: self.version,
            accepted: self.accepted,
            enabled: self.enabled,
        }
    }

    /// What a person should know before the gateway is started for the first time.
    pub(super) fn notes(&self, config: &Config) -> Vec<String> {
        let Some(fleet) = &config.fleet else {
            return Vec::new();
        };
        let mut notes = Vec::new();
        if let Some(server) = volcomp_fleet::in_the_clear(&fleet.url).next() {
            notes.push(format!(
                "[fleet] url: {server} is reached in the clear: others on the way can read machine files and states, though they cannot change what is taken; tls:// closes that"
            ));
        }
        if let Some(damage) = &self.damage {
            notes.push(format!(
                "[fleet] dir: {damage}: the configured machine file corrects until the centre sends one again"
            ));
        }
        notes
    }
}
