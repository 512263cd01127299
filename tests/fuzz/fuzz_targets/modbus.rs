#![no_main]
//! Modbus profiles and register images: no panic, and a good temperature is within the module's range.

use std::time::Instant;

use libfuzzer_sys::fuzz_target;
use volcomp_modbus::{Profile, read_channel};
use volcomp_port::Quality;

fuzz_target!(|input: (&str, Vec<u16>, u8, Option<u16>)| {
    let (text, registers, channel, status) = input;
    if let Ok(profile) = Profile::parse(text)
        && let Some(channels) = &profile.channels
    {
        let found = read_channel(channels, &registers, usize::from(channel), status, Instant::now());
        let [low, high] = channels.valid_degc;
        match found.quality {
            Quality::Good => assert!(found.degc.is_some_and(|t| low < t && t < high)),
            _ => assert_eq!(found.degc, None),
        }
    }
});
