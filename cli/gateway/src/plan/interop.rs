//! The ways over which other systems read the gateway, as a plan has them.

use super::Plan;
use crate::{
    config::{Config, InteropConfig},
    documents::InteropPlan,
    error::GatewayError,
};

/// Refuses a table that this program was built without.
///
/// # Errors
/// The table and the feature that it needs.
pub(super) fn check(config: &Config) -> Result<(), GatewayError> {
    let InteropConfig { shdr, opc_ua } = &config.interop;
    let ways = [
        (shdr.is_some(), cfg!(feature = "shdr"), "shdr", "shdr"),
        (
            opc_ua.is_some(),
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

/// The ways of a plan.
pub(super) fn described(plan: &Plan) -> Vec<InteropPlan> {
    let mut ways = Vec::new();
    if let Some(shdr) = &plan.config.interop.shdr {
        ways.push(InteropPlan {
            table: "shdr".to_owned(),
            address: shdr.listen.to_string(),
            name: plan.shdr_device().to_owned(),
        });
    }
    if let Some(opc_ua) = &plan.config.interop.opc_ua {
        ways.push(InteropPlan {
            table: "opc_ua".to_owned(),
            address: format!("opc.tcp://{}", opc_ua.listen),
            name: plan.model.name.clone(),
        });
    }
    ways
}

impl Plan {
    /// The name of the device that an agent of MTConnect shows.
    pub fn shdr_device(&self) -> &str {
        let shdr = self.config.interop.shdr.as_ref();
        let stated = shdr.and_then(|shdr| shdr.device.as_deref());
        stated.unwrap_or(&self.model.name)
    }
}

/// What should be known of these ways before the first start.
pub(super) fn notes(config: &Config) -> Vec<String> {
    let shdr = config.interop.shdr.as_ref().map(|own| own.listen);
    let opc_ua = config.interop.opc_ua.as_ref().map(|own| own.listen);
    let listens = [("shdr", shdr), ("opc_ua", opc_ua)].into_iter();
    let listens = listens.filter_map(|(table, listen)| Some((table, listen?)));
    let open = listens.filter(|(_, listen)| !listen.ip().is_loopback());
    open.map(|(table, listen)| {
        format!("[{table}] {listen}: everybody who reaches this address reads the state, without a token and without TLS")
    })
    .collect()
}
