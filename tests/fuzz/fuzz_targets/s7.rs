#![no_main]
//! Frames of S7 both ways: no panic on any bytes, and a message that is understood is understood the same again.

use libfuzzer_sys::fuzz_target;
use volcomp_sinumerik::s7::{Cotp, Message, frame_length, frame_of, parse_frame};

fuzz_target!(|bytes: &[u8]| {
    if let Some(head) = bytes.first_chunk() {
        let _ = frame_length(*head);
    }
    let data = match parse_frame(bytes) {
        Ok(Cotp::Data(data)) => data,
        _ => bytes,
    };
    if let Ok(message) = Message::parse(data) {
        let frame = frame_of(&message);
        let Ok(Cotp::Data(again)) = parse_frame(&frame) else {
            return;
        };
        assert_eq!(Message::parse(again).ok(), Some(message));
    }
});
