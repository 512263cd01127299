#![no_main]
//! CAN frames: CANopen telegrams and signals of the shipped table, no panic on any frame.

use std::sync::LazyLock;

use libfuzzer_sys::fuzz_target;
use volcomp_can::{Frame, SHIPPED_DBC, SignalTable, canopen::telegram};

static TABLE: LazyLock<SignalTable> = LazyLock::new(|| SignalTable::parse(SHIPPED_DBC).expect("shipped"));

fuzz_target!(|input: (u32, bool, bool, &[u8])| {
    let (id, extended, fd, data) = input;
    let Some(frame) = Frame::new(id, extended, fd, data) else { return };
    let _ = telegram(&frame);
    for message in &TABLE.messages {
        let _ = (message.is_whole(frame.data()), message.counter(frame.data()));
        for signal in &message.signals {
            let mut copy = frame;
            let value = signal.value(frame.data());
            if signal.put(copy.data_mut(), value) && frame.data().len() == message.length {
                assert_eq!(copy, frame);
            }
        }
    }
});
