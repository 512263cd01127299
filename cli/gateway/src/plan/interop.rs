//! The ways over which other systems read the gateway, as a plan has them.

use super::Plan;
use crate::{config::Config, error::GatewayError};

/// Refuses a table that this program was built without.
///
/// # Errors
/// The table and the feature that it needs.
pub(super) fn check(config: &Config) -> Result<(), GatewayError> {
    let ways = [
        (
            config.shdr.is_some(),
            cfg!(feature = "shdr"),
            "shdr",
            "shdr",
        ),
        (
            config.opc_ua.is_some(),
            cfg!(feature = "opc-ua-server"),
            "opc_ua",
            "opc-ua-server",
        ),
    ];
    let lacking = ways
        .into_iter()
        .find(|(configured, built, ..)| *configured && !built);
    match lacking {
        Some((_, _, table, feature)) => Err(GatewayError::NotBuilt {
            file: config.file.clone(),
            table,
            feature,
        }),
        None => Ok(()),
    }
}

impl Plan {
    /// The name of the device that an agent of MTConnect shows.
    pub fn shdr_device(&self) -> &str {
        let shdr = self.config.shdr.as_ref();
        let stated = shdr.and_then(|shdr| shdr.device.as_deref());
        stated.unwrap_or(&self.model.name)
    }
}

/// What should be known of these ways before the first start.
pub(super) fn notes(config: &Config) -> Vec<String> {
    let shdr = config.shdr.as_ref().map(|own| own.listen);
    let opc_ua = config.opc_ua.as_ref().map(|own| own.listen);
    let listens = [("shdr", shdr), ("opc_ua", opc_ua)].into_iter();
    let listens = listens.filter_map(|(table, listen)| Some((table, listen?)));
    let open = listens.filter(|(_, listen)| !listen.ip().is_loopback());
    open.map(|(table, listen)| {
        format!("[{table}] {listen}: everybody who reaches this address reads the state, without a token and without TLS")
    })
    .collect()
}
