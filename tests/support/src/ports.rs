use std::{
    net::TcpListener,
    sync::atomic::{AtomicU32, Ordering},
};

/// First port of the search. The kernel's ephemeral ports start at 32768, so it does not assign ports of this range.
const FIRST: u32 = 20_000;
const COUNT: u32 = 12_000;

/// A free port of this computer, for a program that is started later. The kernel does not assign it to other sockets.
pub fn free_port() -> u16 {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    for _ in 0..COUNT {
        // Concurrent test programs start at different ports.
        let drawn =
            std::process::id().wrapping_mul(97).wrapping_add(NEXT.fetch_add(1, Ordering::Relaxed));
        let port = u16::try_from(FIRST + drawn % COUNT).expect("below 32768");
        if TcpListener::bind(("0.0.0.0", port)).is_ok() {
            return port;
        }
    }
    panic!("no port from {FIRST} on is free");
}

/// A free loopback address, `127.0.0.1:PORT`.
pub fn free_address() -> String {
    format!("127.0.0.1:{}", free_port())
}
