//! What every kind of curve misses of the truth, with 500 sets of 21 targets in places that chance takes and with 500 nearly even ones, and how
//! many are warned of.
//!
//! `cargo run --release -p volcomp-fit --example gaps`

#[path = "../tests/it/gaps.rs"]
mod gaps;

use gaps::{KINDS, Kind, NOISE, between, irregular, missed, nearly_even};

/// What each of 500 sets is missed by, ascending; how many curves are warned of, and how many that miss more than 30 µm are not.
fn misses((_, fit): Kind, make: fn(u64) -> (Vec<f64>, Vec<f64>)) -> (Vec<f64>, usize, usize) {
    let (mut all, mut warned, mut silent) = (Vec::new(), 0, 0);
    for (x, u) in (0..500).map(make) {
        let Ok(fit) = fit(&x, &u) else { continue };
        let miss = missed(&fit);
        let is_warned = !between(&fit, &x, &u).warnings("µm", "mm").is_empty();
        warned += usize::from(is_warned);
        silent += usize::from(miss > 30.0 && !is_warned);
        all.push(miss);
    }
    all.sort_by(f64::total_cmp);
    (all, warned, silent)
}

fn main() {
    println!("largest miss, µm, of readings with a noise of {NOISE} µm");
    println!(
        "kind                     median     p90     max  over 30 (silent)  warned | median     max  over 30 (silent)  warned"
    );
    for kind in KINDS {
        let at = |all: &[f64], tenths: usize| all[(all.len() - 1) * tenths / 10];
        let over = |all: &[f64]| all.iter().filter(|miss| **miss > 30.0).count();
        let (irregular, warned, silent) = misses(kind, irregular);
        let (even, even_warned, even_silent) = misses(kind, nearly_even);
        println!(
            "{:22} {:8.2} {:7.1} {:7.1}  {:7} ({silent:6})  {warned:6} | {:6.2} {:7.2}  {:7} ({even_silent:6})  {even_warned:6}",
            kind.0,
            at(&irregular, 5),
            at(&irregular, 9),
            at(&irregular, 10),
            over(&irregular),
            at(&even, 5),
            at(&even, 10),
            over(&even),
        );
    }
}
