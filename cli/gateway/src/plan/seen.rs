//! What a controller does not show of the machine: states of the control that the configuration must accept by name, and
//! positions that its words cannot say.

use volcomp_port::{Description, ShownStates};
use volcomp_runtime::Model;
use volcomp_vocabulary::AxisName;

use super::Devices;
use crate::{config::Config, error::GatewayError};

/// Refuses a controller that does not show a state of the control unless its `unseen` names it, an `unseen` that names a
/// state which is shown, and a travel beyond the position word.
///
/// # Errors
/// The first of them.
pub(super) fn check<'a>(
    config: &Config,
    model: &Model,
    devices: &Devices,
    described: impl Iterator<Item = &'a Description>,
) -> Result<(), GatewayError> {
    let travel = |name: AxisName| {
        let index = model.axes.iter().position(|axis| *axis == name)?;
        model.travel.get(index).copied()
    };
    for ((controller, device), description) in config
        .controllers
        .iter()
        .zip(&devices.controllers)
        .zip(described)
    {
        states(
            &config.file,
            &controller.url,
            description.shown,
            controller.unseen(),
        )?;
        device
            .check_travel(&travel)
            .map_err(|source| GatewayError::DeviceConfig {
                file: config.file.clone(),
                source,
            })?;
    }
    Ok(())
}

fn states(
    file: &str,
    url: &str,
    shown: ShownStates,
    unseen: ShownStates,
) -> Result<(), GatewayError> {
    for (state, is_shown, is_accepted) in [
        ("referenced", shown.referenced, unseen.referenced),
        ("alarm", shown.alarm, unseen.alarm),
        (
            "emergency_stop",
            shown.emergency_stop,
            unseen.emergency_stop,
        ),
    ] {
        let (file, url) = (file.to_owned(), url.to_owned());
        match (is_shown, is_accepted) {
            (false, false) => return Err(GatewayError::StateUnseen { file, url, state }),
            (true, true) => return Err(GatewayError::StateSeen { file, url, state }),
            _ => {}
        }
    }
    Ok(())
}
