//! The virtual shop: its output, its rejections, and the calibration of its output.

mod both_sides;
mod coverage;
mod figures;
mod formats;
mod held_rotary;
mod locations;
mod messages;
mod observation_messages;
mod observations;
mod round_trip;
mod wear;

use std::{fs, path::Path};

use volcomp_identify::{Identification, Observations, identify};
use volcomp_shop::Shop;

/// A shop file and its true machine, `truth.toml`, written to a folder and read.
fn shop_in(folder: &Path, truth: &str, shop: &str) -> Shop {
    fs::write(folder.join("truth.toml"), truth).expect("written");
    fs::write(folder.join("shop.toml"), shop).expect("written");
    Shop::read(&folder.join("shop.toml")).expect("a valid shop")
}

/// Writes what a shop measures.
fn write(shop: &Shop, folder: &Path) {
    for (name, text) in shop.files(|_, _| {}).expect("measured") {
        fs::write(folder.join(name), text).expect("written");
    }
}

fn identified(folder: &Path) -> Identification {
    let mut file = Observations::read(&folder.join("observations.toml")).expect("read back");
    // The result is compared with the true machine, so cross-validation is not needed.
    file.folds = 0;
    identify(&file, |_, _| {}).expect("identified")
}
