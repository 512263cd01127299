//! What `check` prints: the plan of a configuration.

use std::path::Path;

use crate::{config::Config, error::GatewayError, plan::Plan};

/// Checks a configuration. `online` asks the controls, too.
///
/// # Errors
/// The first thing that is wrong.
pub fn check(path: &Path, online: bool, json: bool) -> Result<String, GatewayError> {
    let plan = Plan::new(Config::read(path)?)?;
    let found = if online {
        plan.online()?
    } else {
        plan.document()?
    };
    if json {
        line(&found)
    } else {
        Ok(plan.text_of(&found))
    }
}

/// A document as one line.
///
/// # Errors
/// None for a document of the gateway.
pub fn line(document: &impl serde::Serialize) -> Result<String, GatewayError> {
    let text = serde_json::to_string(document);
    let text = text.map_err(|e| GatewayError::system("JSON", e.into()))?;
    Ok(text + "\n")
}
