//! Ports at which nobody listens.

use std::{
    net::TcpListener,
    sync::atomic::{AtomicU32, Ordering},
};

/// The kernel gives connections and listeners without a port of their own one from 32768 on: these here it gives to nobody.
const FIRST: u32 = 20_000;
const COUNT: u32 = 12_000;

/// A port of this computer at which nobody listens, and that nobody is given by chance, for a program that is started later.
pub fn free_port() -> u16 {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    for _ in 0..COUNT {
        // Test programs that run at once begin at different places.
        let drawn = std::process::id()
            .wrapping_mul(97)
            .wrapping_add(NEXT.fetch_add(1, Ordering::Relaxed));
        let port = u16::try_from(FIRST + drawn % COUNT).expect("below 32768");
        if TcpListener::bind(("0.0.0.0", port)).is_ok() {
            return port;
        }
    }
    panic!("no port from {FIRST} on is free");
}

/// The same as an address of this computer.
pub fn free_address() -> String {
    format!("127.0.0.1:{}", free_port())
}
