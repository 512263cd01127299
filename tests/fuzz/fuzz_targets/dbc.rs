#![no_main]
//! DBC files: no panic on any text, and every signal is decoded as it was encoded.

use libfuzzer_sys::fuzz_target;
use volcomp_can::SignalTable;

fuzz_target!(|text: &str| {
    if let Ok(table) = SignalTable::parse(text) {
        for message in &table.messages {
            let mut data = vec![0; message.length];
            for signal in &message.signals {
                let ones = u64::MAX >> (64 - signal.bits);
                signal.put_raw(&mut data, ones);
                assert_eq!(signal.raw(&data), ones);
            }
        }
    }
});
