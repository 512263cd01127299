//! Errors of each kind of curve with 21 targets, for 500 random, 500 nearly even and 500 even sets of targets. Also the
//! fractions of grossly wrong and of correct curves that give a warning.
//!
//! `cargo run --release -p volcomp-fit --example gaps`

#![allow(dead_code, reason = "the tests use the rest")]

#[path = "../tests/it/gaps.rs"]
mod gaps;

use gaps::{KINDS, NOISE, Warned, even, irregular, nearly_even};

type Make = fn(u64) -> (Vec<f64>, Vec<f64>);

fn main() {
    println!("largest miss, µm, of readings with a noise of {NOISE} µm");
    println!(
        "targets      kind                     sets   median     p90      max   over 30 µm: warned of, not   under 3 µm: warned of, not"
    );
    let groups: [(&str, Make); 3] =
        [("by chance", irregular), ("nearly even", nearly_even), ("even", even)];
    for (group, make) in groups {
        for kind in KINDS {
            let mut found = Warned::of(kind, make, 0..500);
            found.misses.sort_by(f64::total_cmp);
            let at = |tenths: usize| found.misses[(found.misses.len() - 1) * tenths / 10];
            let silent = found.silent.len();
            println!(
                "{group:12} {:22} {:6} {:8.2} {:7.1} {:8.1} {:21} {silent:5} {:22} {:5}",
                kind.0,
                found.misses.len(),
                at(5),
                at(9),
                at(10),
                found.gross as usize - silent,
                found.cried,
                found.harmless - found.cried,
            );
        }
    }
}
