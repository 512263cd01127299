//! Replays the fuzz corpus: `valid-…` files must parse, `broken-…` files must be rejected.

use std::fs;

use volcomp_model::Machine;
use volcomp_shop::Shop;
use volcomp_test_support::root;

/// The machine in `tests/fuzz/fuzz_targets/shop.rs`.
const MACHINE: &str = "structure = \"w b X Y C t\"
axes.X.travel = [0.0, 500.0]
axes.Y.travel = [0.0, 400.0]
axes.C.travel = [-180.0, 180.0]
errors.EXX = { poly = [0.0, 0.01] }
";

#[test]
fn shop_files() {
    let mut count = 0;
    for entry in fs::read_dir(root().join("tests/fuzz/corpus/shop")).expect("a folder") {
        let path = entry.expect("an entry").path();
        let name = path.file_name().expect("a name").display().to_string();
        let text = String::from_utf8_lossy(&fs::read(&path).expect("read")).into_owned();
        let machine = |_: &str| Ok(Machine::parse(MACHINE, "truth.toml")?);
        let found = Shop::parse(&text, "shop.toml", machine);
        assert!(
            found.is_ok() || !name.starts_with("valid-"),
            "{name}: {found:?}"
        );
        assert!(
            found.is_err() || !name.starts_with("broken-"),
            "{name} was read"
        );
        if let Ok(shop) = found {
            let _ = shop.files(|_, _| {});
        }
        count += 1;
    }
    assert!(count >= 2, "{count} files");
}
