#![no_main]
//! Machine files: no panic on any text, and an accepted machine is written, read back unchanged and evaluated.

use libfuzzer_sys::fuzz_target;
use volcomp_kinematics::{Form, State};
use volcomp_model::{Machine, Temperatures};

fuzz_target!(|text: &str| {
    if let Ok(machine) = Machine::parse(text, "fuzz") {
        let again = Machine::parse(&machine.to_toml(), "written");
        assert_eq!(again.as_ref().map(Machine::checksum).ok(), Some(machine.checksum()));
        let _ = machine.error_at(&State::default(), Form::Exact, &Temperatures::new());
    }
});
