//! A simulated control and a configuration for it.

use std::{path::Path, sync::Arc};

use volcomp_focas::simulator::{Options, Simulator, World};

use crate::program::{MACHINE, token_file};

/// A control whose X goes to and fro.
pub(crate) fn control() -> Simulator {
    let mut world = World::new(&['X', 'Y', 'Z']);
    world.motion = Arc::new(|elapsed| {
        let x = 400.0 + 300.0 * (elapsed.as_secs_f64() * 0.5).sin();
        vec![x, 150.0, 50.0]
    });
    Simulator::start("127.0.0.1:0", Options::default(), world).expect("loopback")
}

/// A configuration for a control, with its machine and tokens. It arms as soon as it may: no test shift, and a short ramp.
pub(crate) fn configuration(dir: &Path, control: &Simulator, more: &str) -> std::path::PathBuf {
    std::fs::write(dir.join("machine.toml"), MACHINE).expect("writable");
    token_file(dir);
    let text = format!(
        r#"
machine = "machine.toml"
cycle_ms = 4.0
{more}
[guard]
limit_um = 150.0
limit_without_barrier_um = 150.0
slew_um_per_s = 500.0
hold_ms = 200
zero_after_ms = 3000
confirm_um = 10.0
ramp_s = 0.1
# It moves all the time.
test_shift_um = 0
[[controller]]
url = "focas://{}"
axes = ["X", "Y", "Z"]
heartbeat = {{ pmc = "R", at = 120 }}
[dashboard]
token_file = "tokens"
"#,
        control.address()
    );
    let file = dir.join("G.toml");
    std::fs::write(&file, text).expect("writable");
    file
}
