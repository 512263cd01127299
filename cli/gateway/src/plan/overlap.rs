//! Bytes of a control that a configuration uses twice, named by the keys of both.

use volcomp_devices::{Block, ControllerDevice};

use crate::{config::Config, error::GatewayError};

/// Checks that the bytes of a controller, the next one after those `before`, lie apart from one another and from those of the
/// controllers before.
pub(super) fn check(
    config: &Config,
    before: &[Box<dyn ControllerDevice>],
    device: &dyn ControllerDevice,
) -> Result<(), GatewayError> {
    let own = before.len();
    if let Some([one, other]) = device.overlap() {
        return Err(refused(config, (own, one), (own, other)));
    }
    for (index, before) in before.iter().enumerate() {
        if let Some([one, other]) = device.overlap_with(&**before) {
            return Err(refused(config, (own, one), (index, other)));
        }
    }
    Ok(())
}

/// The error at the key of one block, or at that of the other where the place of the first is the driver's own.
fn refused(config: &Config, one: (usize, Block), other: (usize, Block)) -> GatewayError {
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
    let verb = if at.1.is_byte {
        "lies within"
    } else {
        "overlap"
    };
    let message = format!(
        "{} {verb} {} ({where_beside}): expected bytes of their own for each",
        at.1.text, beside.1.text
    );
    let place = if source.states(&key(&at)) {
        key(&at)
    } else {
        url(&at)
    };
    GatewayError::Place(source.error(&config.file, &place, message))
}
