//! The files of the ball row example equal the shop's output, and its errors are identified.

use std::fs;

use volcomp_identify::{Observations, identify};
use volcomp_shop::Shop;
use volcomp_test_support::root;

use crate::volume::compare;

#[test]
fn the_ball_rows_of_the_example_are_those_of_its_shop() {
    let folder = root().join("examples/ball-row");
    let shop = Shop::read(&folder.join("shop.toml")).expect("a valid shop");
    let files = shop.files(|_, _| {}).expect("measured");
    assert_eq!(files.len(), 2 * 7 + 2);
    for (name, text) in files {
        let shipped = fs::read_to_string(folder.join(&name)).expect("shipped");
        assert_eq!(shipped, text, "{name}");
    }
    let file = Observations::read(&folder.join("observations.toml")).expect("read");
    let found = identify(&file, |_, _| {}).expect("identified");
    let mut nominal = shop.truth.clone();
    nominal.clear_errors();
    let before = compare(&shop.truth, &nominal, 500, 1).position_um;
    let after = compare(&shop.truth, &found.machine, 500, 1).position_um;
    // 0.5 µm over rows of 375 mm correspond to 2 µrad of squareness, which is 1 µm at the other end of the volume.
    assert!(before > 15.0 && after < 4.0, "{before} {after}");
}
