#![no_main]
//! Shop files: no panic on any text, also when a small accepted one is measured and observed.

use libfuzzer_sys::fuzz_target;
use volcomp_model::Machine;
use volcomp_shop::Shop;

const MACHINE: &str = "structure = \"w b X Y C t\"
axes.X.travel = [0.0, 500.0]
axes.Y.travel = [0.0, 400.0]
axes.C.travel = [-180.0, 180.0]
errors.EXX = { poly = [0.0, 0.01] }
";

fuzz_target!(|text: &str| {
    let machine = |_: &str| Ok(Machine::parse(MACHINE, "truth.toml")?);
    if let Ok(shop) = Shop::parse(text, "shop.toml", machine) {
        let readings = shop.lines.iter().map(|line| line.instrument.targets * line.instrument.runs as usize);
        if shop.observations.is_empty() && readings.sum::<usize>() < 1000 {
            let _ = shop.files(|_, _| {});
        }
    }
});
