//! Replays the stored fuzz inputs.

use volcomp_model::Machine;
use volcomp_shop::{Shop, ShopError};
use volcomp_test_support::corpus::replay;

/// The machine in `tests/fuzz/fuzz_targets/shop.rs`.
const MACHINE: &str = "structure = \"w b X Y C t\"
axes.X.travel = [0.0, 500.0]
axes.Y.travel = [0.0, 400.0]
axes.C.travel = [-180.0, 180.0]
errors.EXX = { poly = [0.0, 0.01] }
";

#[test]
fn shop_files() {
    replay("shop", |_, bytes| {
        let text = String::from_utf8_lossy(bytes);
        let machine = |_: &str| Ok(Machine::parse(MACHINE, "truth.toml")?);
        let shop = Shop::parse(&text, "shop.toml", machine)?;
        let _ = shop.files(|_, _| {});
        Ok::<_, ShopError>(())
    });
}
