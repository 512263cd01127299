#![no_main]
//! Configurations and token files of the gateway: no panic on any text.

use libfuzzer_sys::fuzz_target;
use volcomp_gateway::{config::Config, http::Tokens};

fuzz_target!(|text: &str| {
    let _ = Config::parse(text, "fuzz", "".as_ref());
    let _ = Tokens::parse(text);
});
