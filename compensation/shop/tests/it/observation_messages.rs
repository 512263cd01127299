//! Every error in the observations of a shop file is reported.

use proptest::prelude::*;
use volcomp_model::Machine;
use volcomp_shop::{Shop, ShopError};
use volcomp_test_support::rows;

const TRUTH: &str = "structure = \"w C' X' b Y Z t\"
[axes]
C.travel = [-90, 90]
X.travel = [0, 500]
Y.travel = [0, 400]
Z.travel = [0, 300]
[tools.T1]
tip = [0, 0, 10]
";

fn shop(text: &str) -> Result<Shop, ShopError> {
    Shop::parse(text, "shop.toml", |_| Ok(Machine::parse(TRUTH, "truth.toml")?))
}

fn refused(text: &str) -> String {
    let text = format!("machine = \"truth.toml\"\n{text}");
    match shop(&text).and_then(|shop| shop.files(|_, _| {})) {
        Ok(_) => panic!("made files, expected a refusal: {text}"),
        Err(error) => error.to_string(),
    }
}

const UNKNOWN: &str = "unknown = [\"EX0C\"]\n[[observation]]\n";
const BAR: &str = "kind = \"ball-row\"\norigin = [0, 0, 0]\ndirection = [1, 0, 0]\n";

/// Each message names the error. `U:` abbreviates the unknowns and the head of an observation, `B:` the start of a ball row.
#[test]
fn what_is_wrong_is_named() {
    for [text, expected] in rows(
        r#"
unknown = ["EX0C"]\n | expected an [[observation]]
[[observation]]\nkind = "points"\n | key `unknown` is missing
unknown = ["EXA"]\n[[observation]]\nkind = "points"\n | has no axis A
U:kind = "laser"\n | found "laser", expected
U:kind = "points"\nradius_mm = 3\n | unknown key
U:kind = "points"\nposes = 0\n | 1 to 100000
U:kind = "points"\ntools = ["T9"]\n | found "T9", expected a tool of the machine file: T1
U:kind = "points"\ntools = ["T1", "T1"]\n | tool T1 appears twice
U:kind = "points"\nat = { B = 3 }\n | has no axis B
U:kind = "points"\nat = { X = 900 }\n | found 900 mm, expected a position within the travel of X, 0 to 500 mm
U:kind = "points"\nnoise_um = -1\n | found -1, expected 0 or more
U:kind = "sphere"\ncentres = []\n | expected at least one centre
U:kind = "sphere"\ncentres = [[9000, 0, 0]]\nposes = 7\n | sphere S1 at [9000, 0, 0] mm in workpiece axes: found 0 of 7 poses within travel
U:kind = "distance"\n | key `point` is missing
U:kind = "distance"\npoint = [0, 0, 0]\nradius_mm = 0\n | radius_mm
U:kind = "ball-row"\norigin = [0, 0, 0]\ndirection = [0, 0, 0]\ndistances = [0, 1]\n | found a zero direction
U:B:distances = [0]\n | found 1 distances, expected 2
U:B:distances = [0, 100, 100]\n | found 100 mm after 100 mm, expected rising distances
U:B:distances = [0, 600]\n | found no position within travel with the tool at [600.000, 0.000, 0.000] mm
U:kind = "diagonals"\ndiagonals = ["PPP", "PPP"]\n | PPP appears twice
U:kind = "diagonals"\nat = { X = 3 }\n | X moves along the diagonals
U:kind = "points"\nfile = "a/b"\n | expected a name without a folder
U:kind = "points"\nfile = "observations"\n | the file observations is written already
U:B:distances = [0, 9]\n[[observation]]\nkind = "points"\nfile = "ball-row-row"\n | the file ball-row-row is written already
"#,
    ) {
        let text = text.replace("U:", UNKNOWN).replace("B:", BAR);
        let message = refused(&text);
        assert!(message.contains(expected), "{text}\n{message}\n{expected}");
    }
}

const SHOP: &str = "machine = \"truth.toml\"\nseed = 2\nunknown = [\"EX0C\", { error = \"EXX\", legendre = 2 }]
[instrument]\nnoise_um = 1.0\nruns = 1\n[[observation]]\nkind = \"sphere\"\nposes = 3\ncentres = [[90, 80, 70]]
reads = \"offset\"\n[[observation]]\nkind = \"points\"\nposes = 3\nframe = [1, 2, 3, 4, 5, 6]\ntarget = [1, 0, 0]\ndrift_um = 3
tools = [\"T1\"]\n[[observation]]\nkind = \"distance\"\npoint = [1, 2, 3]\nposes = 4\n[[observation]]\nkind = \"ball-row\"
origin = [10, 20, 30]\ndirection = [0, 1, 0]\ndistances = [0, 50, 90]\nat = { C = 0 }\ncalibration_um = 0.5
[[observation]]\nkind = \"step-gauge\"\norigin = [10, 20, 30]\ndirection = [0, 1, 1]\ndistances = [0, 50, 90]\nat = { C = 0 }
[[observation]]\nkind = \"diagonals\"\ntargets = 3\n";

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn damaged_observations_do_not_panic(
        place in 0..SHOP.len(), cut in 0..20_usize, put in "[\\[\\]{}=,.'\"# \n0-9a-zA-Z-]{0,6}",
    ) {
        let end = (place + cut).min(SHOP.len());
        let damaged = format!("{}{put}{}", &SHOP[..place], &SHOP[end..]);
        match shop(&damaged) {
            // A damaged number can request thousands of poses.
            Ok(shop) if damaged.len() < SHOP.len() + 2 => match shop.files(|_, _| {}) {
                Ok(files) => prop_assert!(files.len() >= 2),
                Err(error) => prop_assert!(error.to_string().starts_with("the "), "{}", error),
            },
            Ok(_) => {}
            Err(error) => prop_assert!(error.to_string().starts_with("shop.toml"), "{}", error),
        }
    }
}
