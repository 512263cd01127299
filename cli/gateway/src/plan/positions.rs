//! Where the positions of a machine's axes come from: controllers that write, controllers that are only read, and what is
//! stated.

use volcomp_port::Description;
use volcomp_runtime::{Model, PathPlan, ReaderPlan};
use volcomp_vocabulary::AxisName;

use super::Devices;
use crate::{config::Config, error::GatewayError};

/// The controllers that are only read. They have no place in the order of preference, so they stand last.
///
/// # Errors
/// One before a controller that writes, no controller that writes, or one that does not fit the machine.
pub(super) fn readers(
    config: &Config,
    devices: &Devices,
    model: &Model,
) -> Result<Vec<ReaderPlan>, GatewayError> {
    let controllers = &devices.controllers;
    let is_reader = |index: usize| config.controllers[index].axes.is_empty();
    let count = controllers.len();
    let misplaced = (0..count).find(|&index| {
        is_reader(index) && (index == 0 || (index + 1..count).any(|later| !is_reader(later)))
    });
    if let Some(index) = misplaced {
        return Err(GatewayError::ReaderFirst {
            file: config.file.clone(),
            url: config.controllers[index].url.clone(),
        });
    }
    let all = controllers.iter().zip(&config.controllers);
    all.filter(|(_, controller)| controller.axes.is_empty())
        .map(|(device, controller)| {
            let file = || config.file.clone();
            let description = device
                .describe()
                .map_err(|source| GatewayError::DeviceConfig {
                    file: file(),
                    source,
                })?;
            let settings = crate::devices::settings(&**device, controller, config.cycle());
            ReaderPlan::new(description, model, &settings).map_err(|source| GatewayError::Plan {
                file: file(),
                source,
            })
        })
        .collect()
}

/// Refuses a controller whose correction depends on a position that is never known: every controller that writes needs
/// the position of every axis of the machine, which it shows itself, another controller shows, or `fixed` states.
///
/// # Errors
/// The axes without a position.
pub(super) fn check_known(
    config: &Config,
    model: &Model,
    paths: &[PathPlan],
    readers: &[ReaderPlan],
) -> Result<(), GatewayError> {
    let of_paths = paths.iter().map(|path| &path.description);
    let of_readers = readers.iter().map(|reader| &reader.description);
    let shown: Vec<&Description> = of_paths.chain(of_readers).collect();
    for path in paths {
        let axes = model.axes.iter().zip(path.fixed);
        let unknown = axes.filter(|(axis, fixed)| {
            fixed.is_none() && !shown.iter().any(|description| description.shows(**axis))
        });
        let unknown: Vec<AxisName> = unknown.map(|(axis, _)| *axis).collect();
        if !unknown.is_empty() {
            return Err(GatewayError::PositionUnknown {
                file: config.file.clone(),
                url: path.description.device.clone(),
                axes: unknown,
                machine: config.machine.clone(),
            });
        }
    }
    Ok(())
}
