use std::{path::Path, sync::Arc};

use volcomp_focas::simulator::{Options, Simulator, World};

use crate::{manual::configuration_of, program::token_file};

pub(crate) fn control() -> Simulator {
    let mut world = World::new(&['X', 'Y', 'Z']);
    world.motion = Arc::new(|elapsed| {
        let x = 400.0 + 300.0 * (elapsed.as_secs_f64() * 0.5).sin();
        vec![x, 150.0, 50.0]
    });
    Simulator::start("127.0.0.1:0", Options::default(), world).expect("loopback")
}

/// A configuration with machine file and tokens for this control, without a test shift and with a short ramp, so that
/// the gateway arms quickly.
pub(crate) fn configuration(dir: &Path, control: &Simulator, more: &str) -> std::path::PathBuf {
    token_file(dir);
    let address = control.address().to_string();
    configuration_of(&address, dir, more, "[dashboard]\ntoken_file = \"tokens\"\n")
}
