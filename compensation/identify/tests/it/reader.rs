//! The reader does not panic on any text.

use std::path::Path;

use proptest::prelude::*;
use volcomp_identify::{Observations, identify};
use volcomp_test_support::root;

use crate::lab::Lab;

const MACHINE: &str =
    "structure = \"w b X Y t\"\n[axes.X]\ntravel = [0.0, 500.0]\n[axes.Y]\ntravel = [0.0, 400.0]\n";

fn word() -> impl Strategy<Value = String> {
    const WORDS: &str = "X Y x y z tool order pose from to length_mm deviation_um dx_um sphere ball distance_mm uncertainty_um along_um side1_um 1 -3.5 nan inf 1e300 a 0 250 \" ; 499.99";
    let words: Vec<&str> = WORDS.split(' ').chain([""]).collect();
    prop::sample::select(words).prop_map(str::to_owned)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn random_tables_and_keys_do_not_panic(
        rows in prop::collection::vec(prop::collection::vec(word(), 1..7), 0..8),
        kind in prop::sample::select(vec!["points", "sphere", "distance", "line", "ball-row", "other"]),
        extra in prop::sample::select(vec!["", "point = \"unknown\"", "direction = [0, 0, 0]", "direction = [1, 0, 0]\noffset = \"unknown\"", "frame = 3", "target = \"unknown\"", "drift = 2", "row = \"t.csv\"", "row = \"t.csv\"\ndirection = [1, 0, 0]"]),
        unknown in prop::sample::select(vec!["\"EC0Y\"", "\"EXX\"", "{ error = \"EXX\", bspline = 5 }", "{ error = \"EXX\", legendre = 2, second = { axis = \"Y\", legendre = 2 } }", "{ error = \"EXX\", legendre = 2, reversal = true }", "3", "\"EX0X\""]),
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

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn random_bytes_do_not_panic(
        keys in prop::collection::vec(any::<u8>(), 0..200),
        table in prop::collection::vec(any::<u8>(), 0..200),
        row in prop::collection::vec(any::<u8>(), 0..60),
        place in 0..VALID.len(),
        cut in 0..30_usize,
    ) {
        let lab = Lab::new(MACHINE);
        lab.write_bytes("t.csv", &table);
        lab.write_bytes("row.csv", &row);
        let _ = lab.identify(&String::from_utf8_lossy(&keys));
        // Valid keys with arbitrary row files; below, valid row files with overwritten bytes in the keys.
        let _ = lab.identify(VALID);
        let end = (place + cut).min(VALID.len());
        let damaged = format!("{}{}{}", &VALID[..place], String::from_utf8_lossy(&keys), &VALID[end..]);
        lab.write("t.csv", "X,Y,ball,along_um\n0,0,A,1\n100,0,B,2\n200,0,C,1\n");
        lab.write("row.csv", "ball,distance_mm,uncertainty_um\nA,0,0\nB,100,1\nC,200,1\n");
        let _ = lab.identify(&damaged);
    }
}

const VALID: &str = "folds = 2\nunknown = [{ error = \"EXX\", legendre = 1 }]\n[[observation]]\nkind = \"ball-row\"\nfile = \"t.csv\"\nrow = \"row.csv\"\nside1 = [0, 1, 0]\nuncertainty_um = 2\ndrift = 1\n";

/// Both tilts of one squareness as unknowns are rejected: together they rotate the whole machine, which cannot be
/// distinguished from a rotation of the set-up.
#[test]
fn both_tilts_of_a_squareness_are_refused() {
    let lab = Lab::new(MACHINE);
    lab.write("t.csv", "X,Y,x,y,z\n0,0,0,0,0\n100,0,100,0,0\n0,100,0,100,0\n100,100,100,100,0\n");
    let observed = |unknown: &str| {
        format!(
            "folds = 0\nunknown = {unknown}\n[[observation]]\nkind = \"points\"\nfile = \"t.csv\"\n"
        )
    };
    for unknown in ["[\"EC0X\", \"EC0Y\"]", "[\"EC0Y\", \"EXX\", \"EC0X\"]"] {
        let message = lab.refused(&observed(unknown));
        assert!(
            message.contains("found EC0X and EC0Y, expected one of them")
                && message.contains("the squareness of X and Y"),
            "{message}"
        );
    }
    for unknown in ["[\"EC0Y\"]", "[\"EC0X\"]", "[\"EC0Y\", \"EB0X\"]"] {
        lab.read(&observed(unknown)).expect("read");
    }
}

#[test]
fn an_axis_with_two_columns_is_refused() {
    let lab = Lab::new(MACHINE);
    let observed =
        "folds = 0\nunknown = [\"EC0Y\"]\n[[observation]]\nkind = \"points\"\nfile = \"t.csv\"\n";
    for (head, expected) in [
        ("X mm,X_mm,Y", "found columns `X_mm` and `X mm`"),
        ("X_mm,X,Y", "found columns `X` and `X_mm`"),
        ("X,Y [mm],Y (mm)", "found columns `Y (mm)` and `Y [mm]`"),
    ] {
        lab.write("t.csv", &format!("{head},x,y,z\n0,0,0,0,0,0\n"));
        let message = lab.refused(observed);
        assert!(message.contains(expected), "{message}");
    }
}

/// Rows without a tool column are noted if the machine file has several tools.
#[test]
fn rows_without_a_tool_column_are_noted() {
    let rows = |tool: &str| {
        let (head, cell) =
            if tool.is_empty() { ("", String::new()) } else { ("tool,", format!("{tool},")) };
        format!(
            "{head}X,Y,x,y,z\n{cell}0,0,0,0,0\n{cell}100,0,100,0,0\n{cell}0,100,0,100,0\n{cell}100,100,100,100,0\n"
        )
    };
    let one = "[tools.short]\ntip = [0, 0, -10]\n";
    let two = "[tools.short]\ntip = [0, 0, -10]\n[tools.long]\ntip = [0, 0, -90]\n";
    for (tools, tool, is_noted) in
        [("", "", false), (one, "", false), (two, "", true), (two, "long", false)]
    {
        let lab = Lab::new(&format!("{MACHINE}{tools}"));
        lab.write("t.csv", &rows(tool));
        let observed = "folds = 0\nunknown = [\"EC0Y\"]\n[[observation]]\nkind = \"points\"\nfile = \"t.csv\"\n";
        let message = lab.read(observed).expect("read").notes.join("\n");
        let note = "t.csv: no column `tool`, so all rows use the tip of `[tool]`; the machine file also has the tools long, short";
        assert_eq!(message.contains(note), is_noted, "{tools}{tool}: {message}");
    }
}

/// The machine of `tests/fuzz/fuzz_targets/observations.rs`.
const CORPUS_MACHINE: &str = "structure = \"w b X Y C t\"
axes.X.travel = [0.0, 500.0]
axes.Y.travel = [0.0, 400.0]
axes.C.travel = [-180.0, 180.0]
";

#[test]
fn corpus_files_are_read_or_refused_by_their_names() {
    let mut count = 0;
    for entry in std::fs::read_dir(root().join("tests/fuzz/corpus/observations")).expect("a folder")
    {
        let path = entry.expect("an entry").path();
        let name = path.file_name().expect("a name").to_string_lossy().into_owned();
        let text = String::from_utf8_lossy(&std::fs::read(&path).expect("read")).into_owned();
        let (keys, rows) = text.split_once("\n===\n").unwrap_or((&text, ""));
        let read = |path: &Path| {
            let text = if path.ends_with("machine.toml") { CORPUS_MACHINE } else { rows };
            Ok(text.to_owned())
        };
        let found = Observations::parse(keys, Path::new("observations.toml"), &read);
        assert!(found.is_ok() || !name.starts_with("valid-"), "{name} was refused: {found:?}");
        assert!(found.is_err() || !name.starts_with("broken-"), "{name} was read");
        if let Ok(found) = found {
            let _ = identify(&found, |_, _| {});
        }
        count += 1;
    }
    assert!(count >= 5, "{count} files");
}
