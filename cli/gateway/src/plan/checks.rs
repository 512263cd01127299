//! Checks before any device is opened: folders, sensor names, overlapping memory blocks, positions
//! and states that no controller reports, and tables that this build does not support.

use std::{io, path::Path};

use rustix::fs::{Access, FsWord, PROC_SUPER_MAGIC, access, statfs};
use volcomp_devices::{Block, ControllerDevice, ThermometerDevice};
use volcomp_port::{Description, ShownStates};
use volcomp_runtime::{Model, PathPlan, ReaderPlan};
use volcomp_vocabulary::AxisName;

use super::{Devices, Fleet};
use crate::{
    audit,
    config::{Config, is_blank},
    error::GatewayError,
};

/// File-system type of `/sys`, as returned by `statfs`.
const SYSFS_MAGIC: FsWord = 0x6265_6572;

/// Rejects an audit-log folder that this user cannot create or write: the path is a file or below one, its name is
/// invalid, or its parent is not writable. Writes nothing.
pub(super) fn audit_folder(dir: &Path) -> Result<(), GatewayError> {
    let wrong = |found: &Path| {
        let what = if found.starts_with(dir) && found != dir {
            "is a folder, expected a file"
        } else {
            "is no folder"
        };
        Err(GatewayError::invalid(format!(
            "[audit] dir = {}: {} {what}",
            dir.display(),
            found.display()
        )))
    };
    let refused = |found: &Path, source: io::Error| {
        let [dir, found] = [dir, found].map(|path| path.display().to_string());
        GatewayError::invalid(format!("[audit] dir = {dir:?}: {found:?} cannot be used: {source}"))
    };
    for above in dir.ancestors() {
        // The parent of a relative path is the working directory.
        let above = if above == Path::new("") { Path::new(".") } else { above };
        // A dangling link exists but is not a folder.
        match (above.symlink_metadata(), above.metadata()) {
            (_, Ok(found)) if found.is_dir() => {
                can_write_in(above).map_err(|source| refused(above, source))?;
                break;
            }
            (Ok(_), _) => return wrong(above),
            (Err(source), _) if is_missing(&source) => {}
            (Err(source), _) => return Err(refused(above, source)),
        }
    }
    let log = audit::log_file(dir);
    if log.is_dir() {
        return wrong(&log);
    }
    match access(&log, Access::READ_OK | Access::WRITE_OK).map_err(io::Error::from) {
        Err(source) if !is_missing(&source) => Err(refused(&log, source)),
        _ => Ok(()),
    }
}

fn is_missing(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory)
}

/// Checks that files and folders can be created in a folder. `access` permits everything for root, but the kernel's own
/// file systems reject new files even for root.
fn can_write_in(folder: &Path) -> io::Result<()> {
    access(folder, Access::WRITE_OK | Access::EXEC_OK)?;
    if [PROC_SUPER_MAGIC, SYSFS_MAGIC].contains(&statfs(folder)?.f_type) {
        return Err(io::ErrorKind::PermissionDenied.into());
    }
    Ok(())
}

pub(super) fn device_twice(config: &Config, table: &str, url: &str) -> GatewayError {
    GatewayError::invalid_in(
        &config.file,
        format_args!("{url} is configured in two [[{table}]], expected one for each device"),
    )
}

/// Rejects a sensor name that is blank or belongs to an earlier thermometer.
pub(super) fn sensor_names(
    config: &Config,
    before: &[ThermometerDevice],
    device: &ThermometerDevice,
    url: &str,
) -> Result<(), GatewayError> {
    for name in &device.names {
        let expected = if is_blank(name) {
            "expected a name of visible characters for each sensor"
        } else if before.iter().any(|other| other.names.contains(name)) {
            "which is a sensor of another [[thermometer]] already, expected another name for each sensor of the machine"
        } else {
            continue;
        };
        return Err(GatewayError::invalid_in(
            &config.file,
            format_args!("{url}: names: found {name:?}, {expected}"),
        ));
    }
    Ok(())
}

/// Checks that the memory blocks of a controller overlap neither each other nor those of the controllers in `before`,
/// which precede it in the configuration.
pub(super) fn overlap(
    config: &Config,
    before: &[Box<dyn ControllerDevice>],
    device: &dyn ControllerDevice,
) -> Result<(), GatewayError> {
    let own = before.len();
    if let Some([one, other]) = device.overlap() {
        return Err(overlapping(config, (own, one), (own, other)));
    }
    for (index, before) in before.iter().enumerate() {
        if let Some([one, other]) = device.overlap_with(&**before) {
            return Err(overlapping(config, (own, one), (index, other)));
        }
    }
    Ok(())
}

/// The error for two overlapping blocks. Its position is the key of `one`, or the key of `other` if the file states
/// only that key.
fn overlapping(config: &Config, one: (usize, Block), other: (usize, Block)) -> GatewayError {
    let source = &config.source;
    let key = |(index, block): &(usize, Block)| format!("controller[{index}].{}", block.key);
    let url = |(index, _): &(usize, Block)| format!("controller[{index}].url");
    let (at, beside) = if source.states(&key(&one)) || !source.states(&key(&other)) {
        (one, other)
    } else {
        (other, one)
    };
    let where_beside = match (source.line(&key(&beside)), source.line(&url(&beside))) {
        (Some(line), _) => format!("{} in line {line}", key(&beside)),
        (None, Some(line)) => format!("the driver's own place, {} in line {line}", url(&beside)),
        (None, None) => "the driver's own place".to_owned(),
    };
    let verb = if at.1.is_byte { "lies within" } else { "overlap" };
    let message = format!(
        "{} {verb} {} ({where_beside}): expected bytes of their own for each",
        at.1.text, beside.1.text
    );
    let place = if source.states(&key(&at)) { key(&at) } else { url(&at) };
    GatewayError::Place(source.error(&config.file, &place, message))
}

/// Rejects a read-only controller that precedes a writing one, or is the only controller. Read-only controllers have no
/// rank in the order of preference.
pub(super) fn readers_last(config: &Config) -> Result<(), GatewayError> {
    let controllers = &config.controllers;
    let misplaced = controllers.iter().enumerate().find(|(index, own)| {
        let later = &controllers[index + 1..];
        own.axes.is_empty() && (*index == 0 || later.iter().any(|later| !later.axes.is_empty()))
    });
    let Some((_, own)) = misplaced else {
        return Ok(());
    };
    Err(GatewayError::invalid_in(
        &config.file,
        format_args!(
            "{}: found axes = [], a controller that is only read, expected it after a [[controller]] that writes and after all of those",
            own.url
        ),
    ))
}

/// Rejects a controller whose correction depends on an unknown position. A writing controller needs the position of
/// every axis of the machine: from its own readings, from another controller, or from `fixed`.
pub(super) fn positions_known(
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
            let what = unknown_positions(&unknown, &config.machine);
            return Err(GatewayError::invalid_in(
                &config.file,
                format_args!("{}: {what}", path.description.device),
            ));
        }
    }
    Ok(())
}

/// The message about axes with unknown positions, with the keys to set for each kind of axis.
fn unknown_positions(axes: &[AxisName], machine: &Path) -> String {
    let list = |with: &str| {
        let words = axes.iter().map(|axis| format!("{with}{axis}{with}"));
        words.collect::<Vec<_>>().join(", ")
    };
    let linear = axes.iter().filter(|axis| !axis.is_rotary());
    let linear: Vec<String> = linear.map(|axis| format!("{axis} = …")).collect();
    let (axis, they, them, they_are) = match axes {
        [_] => ("axis", "it stands", "it", "it is"),
        _ => ("axes", "they stand", "them", "they are"),
    };
    let or_fixed = if linear.is_empty() {
        String::new()
    } else {
        format!(", or state fixed = {{ {} }}", linear.join(", "))
    };
    let not_fixed = if linear.len() == axes.len() { " and `fixed` does not state it" } else { "" };
    let letters = list("");
    format!(
        "{axis} {letters} of {}: the correction depends on where {they}, but no [[controller]] shows {them}{not_fixed}: name {letters} in axes where {they_are} corrected, in reads = [{}] where {they_are} not{or_fixed}",
        machine.display(),
        list("\""),
    )
}

pub(super) fn by_name(states: ShownStates) -> [(&'static str, bool); 3] {
    [
        ("referenced", states.referenced),
        ("alarm", states.alarm),
        ("emergency_stop", states.emergency_stop),
    ]
}

/// Checks the states and travels of a controller. Errors: a state is neither reported nor listed in
/// `unseen`, `unseen` lists a reported state, or a travel exceeds the range of the position word.
pub(super) fn shown<'a>(
    config: &Config,
    model: &Model,
    devices: &Devices,
    described: impl Iterator<Item = &'a Description>,
) -> Result<(), GatewayError> {
    let travel = |name: AxisName| {
        let index = model.axes.iter().position(|axis| *axis == name)?;
        model.travel.get(index).copied()
    };
    let controllers = config.controllers.iter().zip(&devices.controllers);
    for ((own, device), description) in controllers.zip(described) {
        let shown = by_name(description.shown).into_iter();
        for ((state, is_shown), (_, is_accepted)) in shown.zip(by_name(own.unseen())) {
            let what = match (is_shown, is_accepted) {
                (false, false) => format!(
                    "this device does not show {state}, so nothing holds the correction by it: let the control show it, or accept that with {state:?} in unseen"
                ),
                (true, true) => format!(
                    "unseen: found {state:?}, expected only states that this device does not show"
                ),
                _ => continue,
            };
            let what = format!("{}: {what}", own.url);
            return Err(GatewayError::invalid_in(&config.file, what));
        }
        let checked = device.check_travel(&travel);
        checked.map_err(|source| config.device_error(source))?;
    }
    Ok(())
}

pub(super) fn built(config: &Config) -> Result<(), GatewayError> {
    for (is_configured, is_built, table, feature) in [
        (config.shdr.is_some(), cfg!(feature = "shdr"), "shdr", "shdr"),
        (config.opc_ua.is_some(), cfg!(feature = "opc-ua-server"), "opc_ua", "opc-ua-server"),
    ] {
        if is_configured && !is_built {
            return Err(GatewayError::invalid_in(
                &config.file,
                format_args!(
                    "[{table}]: not included in this program: build it with the feature {feature}"
                ),
            ));
        }
    }
    Ok(())
}

/// Checks the files named in `[fleet]` and reads the last activation of the centre.
#[cfg(feature = "fleet")]
pub(super) fn fleet(config: &Config) -> Result<Option<Fleet>, GatewayError> {
    use tokio_rustls::rustls::pki_types::{CertificateDer, pem::PemObject};
    let Some(fleet) = &config.fleet else {
        return Ok(None);
    };
    let settings = crate::fleet::settings(fleet)?;
    if let Some(ca) = &fleet.ca {
        let mut found = CertificateDer::pem_file_iter(ca).into_iter().flatten();
        if !matches!(found.next(), Some(Ok(_))) {
            let expected = "expected certificates as PEM";
            return Err(GatewayError::invalid_in(ca.display(), expected));
        }
    }
    let kept = crate::fleet::stored(fleet);
    let document = crate::documents::FleetPlan {
        // Reading the settings has already rejected a seed without a public key.
        nkey: settings.public_key().unwrap_or_default(),
        version: kept.standing.active.unwrap_or(0),
        accepted: kept.standing.highest,
        enabled: !kept.standing.disabled,
    };
    Ok(Some(Fleet { document, damage: kept.damage }))
}

/// Rejects `[fleet]`, which this build does not support.
#[cfg(not(feature = "fleet"))]
pub(super) fn fleet(config: &Config) -> Result<Option<Fleet>, GatewayError> {
    match &config.fleet {
        None => Ok(None),
        Some(_) => Err(GatewayError::invalid_in(
            &config.file,
            "[fleet]: this build of volcomp-gateway has no fleet, expected one that was built with the feature `fleet` (cargo build -p volcomp-gateway --features fleet), or a configuration without this table",
        )),
    }
}
