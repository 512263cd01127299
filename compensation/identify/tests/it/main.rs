//! Identification, compared with closed forms, an independent program, and its own statistics.

mod ball_row;
mod checks;
mod coverage;
mod first_rows;
mod lab;
mod limits;
mod measure_next;
mod messages;
mod products;
mod simulated;
mod types;
mod undetermined;
mod weights;
