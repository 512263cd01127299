//! Coverage of the bands of 500 generated lines. On one line in five, the targets are too sparse for the pitch of the
//! ball screw.
//!
//! `cargo run --release -p volcomp-fit --example bands`

#![allow(dead_code, reason = "the tests use the rest")]

#[path = "../tests/it/covered.rs"]
mod covered;
#[path = "../tests/it/generated.rs"]
mod generated;

use covered::{Covered, covered};
use generated::{Generated, generated, undersampled};

const PLACES: u32 = 400;

fn main() {
    let mut groups: Vec<(&'static str, Covered)> = Vec::new();
    let mut all = Covered::default();
    for index in 0..500 {
        let line: Generated =
            if index % 5 == 4 { undersampled(29, index) } else { generated(29, index + index / 5) };
        let found = covered(&line, PLACES);
        all.add(found);
        match groups.iter_mut().find(|group| group.0 == line.family) {
            Some(group) => group.1.add(found),
            None => groups.push((line.family, found)),
        }
    }
    groups.push(("all", all));
    println!(
        "lines          held    by the band of the targets   mean half width and miss, µm   curves  warned of as sparse"
    );
    for (group, found) in groups {
        let places = f64::from(found.places);
        println!(
            "{group:12} {:5.1} %   {:5.1} %   {:6.2} {:6.2}                {:6}  {:6}",
            100.0 * found.share(),
            100.0 * found.share_of_targets(),
            found.width / places,
            found.missed / places,
            found.curves,
            found.warned
        );
    }
}
