//! The reader takes any text without a panic.

use proptest::prelude::*;

use crate::lab::Lab;

const MACHINE: &str =
    "structure = \"w b X Y t\"\n[axes.X]\ntravel = [0.0, 500.0]\n[axes.Y]\ntravel = [0.0, 400.0]\n";

fn word() -> impl Strategy<Value = String> {
    prop::sample::select(vec![
        "X",
        "Y",
        "x",
        "y",
        "z",
        "tool",
        "order",
        "pose",
        "from",
        "to",
        "length_mm",
        "deviation_um",
        "dx_um",
        "sphere",
        "1",
        "-3.5",
        "nan",
        "inf",
        "1e300",
        "",
        "a",
        "0",
        "250",
        "\"",
        ";",
        "499.99",
    ])
    .prop_map(str::to_owned)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn no_table_and_no_keys_are_a_panic(
        rows in prop::collection::vec(prop::collection::vec(word(), 1..7), 0..8),
        kind in prop::sample::select(vec!["points", "sphere", "distance", "line", "other"]),
        extra in prop::sample::select(vec!["", "point = \"unknown\"", "direction = [0, 0, 0]", "direction = [1, 0, 0]\noffset = \"unknown\"", "frame = 3", "target = \"unknown\"", "drift = 2"]),
        unknown in prop::sample::select(vec!["\"EC0Y\"", "\"EXX\"", "{ error = \"EXX\", bspline = 5 }", "{ error = \"EXX\", legendre = 2, reversal = true }", "3", "\"EX0X\""]),
        penalty in prop::sample::select(vec!["", "penalty = \"auto\"\n", "robust = true\n"]),
    ) {
        let lab = Lab::new(MACHINE);
        let rows: Vec<String> = rows.iter().map(|row| row.join(",")).collect();
        lab.write("t.csv", &rows.join("\n"));
        let text = format!("{penalty}unknown = [{unknown}]\n[[observation]]\nkind = \"{kind}\"\nfile = \"t.csv\"\n{extra}\n");
        if let Ok(found) = lab.identify(&text) {
            prop_assert!(found.parameters.iter().all(|p| p.value.is_finite()));
            prop_assert!(found.rank <= found.parameters.len());
        }
    }
}
