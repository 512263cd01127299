#![no_main]
//! FOCAS frames in both directions: no panic on any bytes, and a parsed request is encoded to one that is parsed equally.

use libfuzzer_sys::fuzz_target;
use volcomp_focas::frame::{Blocks, Command, HEAD, Head, Request, Target, parse_commands};

fuzz_target!(|bytes: &[u8]| {
    if let Some(head) = bytes.first_chunk() {
        let _ = Head::parse(head);
    }
    if let Ok(blocks) = Blocks::parse(bytes) {
        for block in blocks.flatten() {
            for number in block.data.as_chunks::<8>().0 {
                let _ = volcomp_focas::frame::number(*number);
            }
        }
    }
    if let Ok(commands) = parse_commands(bytes) {
        if let Ok(request) = Request::new(&commands) {
            assert_eq!(parse_commands(&request.bytes()[HEAD..]).as_ref(), Ok(&commands));
            let _ = request.answers(bytes);
        }
    }
    let read = Command { target: Target::Cnc, path: 1, function: 0x26, args: [1, -1, 0, 0, 0], data: &[] };
    if let Ok(request) = Request::new(&[read, read]) {
        let _ = request.answers(bytes);
    }
});
