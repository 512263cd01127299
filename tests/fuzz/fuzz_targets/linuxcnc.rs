#![no_main]
//! Datagrams (the input is one without its authentication code) and INI files of LinuxCNC: no panic on any bytes, and a decoded datagram is
//! encoded to one that is decoded equally.

use libfuzzer_sys::fuzz_target;
use volcomp_linuxcnc::{
    COMMAND_BYTES, Command, Expected, Ini, Key, Least, LinuxCncConfig, STATE_BYTES, State,
};
use volcomp_vocabulary::AxisName;

const KEY: Key = Key::new([1; 16]);

fuzz_target!(|bytes: &[u8]| {
    let with_code = [bytes, &KEY.mac(bytes)].concat();
    if let Ok(state) = State::decode(&with_code, &KEY) {
        let mut again = [0; STATE_BYTES];
        let length = state.encode(&KEY, &mut again);
        assert_eq!(State::decode(&again[..length], &KEY), Ok(state));
    }
    if let Ok(command) = Command::decode(&with_code, &KEY) {
        let mut again = [0; COMMAND_BYTES];
        let length = command.encode(&KEY, &mut again);
        assert_eq!(Command::decode(&again[..length], &KEY), Ok(command));
    }
    let control = LinuxCncConfig {
        host: "127.0.0.1".to_owned(),
        port: 47_001,
        key: KEY,
        remote: false,
        channel: "linuxcnc".to_owned(),
        machine: 1,
        axes: vec![AxisName::X, AxisName::C],
        reads: vec![AxisName::A],
        step_linear: LinuxCncConfig::STEP_LINEAR,
        step_rotary: LinuxCncConfig::step_rotary(),
    };
    let expected = Expected {
        control: &control,
        scan_ms: 1.0,
        least: Some(Least {
            limit: [30.0, 5.0],
            rate: [1000.0, 100.0],
            zero_after_ms: 1000.0,
        }),
    };
    let _ = Ini::parse(&String::from_utf8_lossy(bytes)).problems(&expected);
});
