#![no_main]
//! Tables and logs with their mapping: no panic on any text, and accepted input can be evaluated.

use libfuzzer_sys::fuzz_target;
use volcomp_document::Document;
use volcomp_metrology::{Mapping, evaluate, parse_camonitor, parse_table_with, readings_at_dwells};

// The input is the mapping (TOML) and, after a line `===`, the table or the log.
fuzz_target!(|text: &str| {
    let (toml, rows) = text.split_once("===\n").unwrap_or(("", text));
    let log = parse_camonitor(rows.as_bytes(), "fuzz");
    let document = Document::new("fuzz.toml", toml);
    let read = match document.decode(|root| Mapping::decode(&root)) {
        Ok(Some(Mapping::Columns(columns))) => parse_table_with(rows.as_bytes(), "fuzz", &columns),
        Ok(Some(Mapping::Channels(channels))) => {
            let Ok(log) = log else { return };
            readings_at_dwells(&log, &channels)
        }
        _ => return,
    };
    if let Ok(measurement) = read {
        let _ = evaluate(&measurement);
    }
});
