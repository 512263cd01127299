//! Identification, compared with closed forms, an independent program, and its own statistics.

mod ball_row;
mod checks;
mod coverage;
mod first_rows;
mod lab;
mod limits;
mod line;
mod measure_next;
mod messages;
mod notes;
mod peer;
mod products;
mod reader;
mod run_out;
mod sampler;
mod shrunk;
mod simulated;
mod types;
mod undetermined;
mod weights;
