//! Identification against closed forms, an independent program, and its own statistics.

mod ball_row;
mod checks;
mod coverage;
mod draws;
mod first_rows;
mod fuzz_corpus;
mod lab;
mod left_open;
mod limits;
mod line;
mod measure_next;
mod messages;
mod notes;
mod peer;
mod penalised;
mod products;
mod reader;
mod robust;
mod run_out;
mod shrunk;
mod simulated;
mod types;
