//! Bytes of a control that a configuration uses twice, named by the keys of both.

use volcomp_document::InputError;
use volcomp_focas::Block;

use crate::{config::Config, devices::ControllerDevice, error::GatewayError};

/// Checks that the bytes of a controller, the next one after those `before`, lie apart from one another and from those of the
/// controllers before.
pub(super) fn check(
    config: &Config,
    before: &[ControllerDevice],
    device: &ControllerDevice,
) -> Result<(), GatewayError> {
    let own = before.len();
    if let Some([one, other]) = device.overlap() {
        return Err(refused(config, (own, one), (own, other)));
    }
    for (index, before) in before.iter().enumerate() {
        if let Some([one, other]) = device.overlap_with(before) {
            return Err(refused(config, (own, one), (index, other)));
        }
    }
    Ok(())
}

/// The error at the key of one block, or at that of the other where the place of the first is the driver's own.
fn refused(config: &Config, one: (usize, Block), other: (usize, Block)) -> GatewayError {
    let stated = |(index, block): (usize, Block)| {
        config
            .stated
            .place(&format!("controller.{index}.{}", block.key))
    };
    let url = |(index, _): (usize, Block)| config.stated.place(&format!("controller.{index}.url"));
    let (at, beside) = if stated(one).is_some() || stated(other).is_none() {
        (one, other)
    } else {
        (other, one)
    };
    let where_beside = match (stated(beside), url(beside)) {
        (Some(place), _) => format!("{} in line {}", place.key, place.line),
        (None, Some(url)) => format!("the driver's own place, {} in line {}", url.key, url.line),
        (None, None) => "the driver's own place".to_owned(),
    };
    let verb = if at.1.first == at.1.last {
        "lies within"
    } else {
        "overlap"
    };
    let message = format!(
        "{} {verb} {} ({where_beside}): expected bytes of their own for each",
        at.1, beside.1
    );
    GatewayError::Place(match stated(at).or_else(|| url(at)) {
        Some(place) => InputError {
            message,
            ..place.clone()
        },
        // No text: the configuration was put together by a program.
        None => InputError {
            file: config.file.clone(),
            line: 1,
            key: String::new(),
            message,
            span: 0..0,
            text: "".into(),
        },
    })
}
