//! Limits of the numbers of observations, in files and from programs.
//!
//! Limits of distances scale with the machine. The reader does not panic on any text.

use std::path::Path;

use proptest::prelude::*;
use volcomp_document::Document;
use volcomp_identify::{
    Basis, IdentifyError, Observations, SecondAxis, Unknown, identify, identify_followed,
    machine_with,
};
use volcomp_model::Machine;
use volcomp_test_support::root;
use volcomp_vocabulary::AxisName::{self, C, X, Y, Z};

use crate::lab::{Lab, Noise, csv, tip, value};

const MACHINE: &str = "structure = \"w C' X' b Y Z t\"
axes.X.travel = [-300.0, 300.0]
axes.Y.travel = [-200.0, 200.0]
axes.Z.travel = [0.0, 400.0]
axes.C.travel = [-360.0, 360.0]
";
const POINTS: &str = "[[observation]]
kind = \"points\"
file = \"t.csv\"
frame = [0, 0, 0, 0, 0, 0]
";

/// Poses of a machine whose only error is EXX, in workpiece axes.
fn lab() -> Lab {
    let truth = format!("{MACHINE}[errors]\nEXX = {{ poly = [0.0, 0.02] }}\n");
    let truth = Machine::parse(&truth, "truth").expect("a machine");
    let lab = Lab::new(MACHINE);
    let mut noise = Noise::new(3);
    let rows = (0..20).map(|_| {
        let at = [(X, 300.0), (Y, 200.0), (Z, 200.0), (C, 180.0)]
            .map(|(axis, size)| (axis, noise.between(0.0, size)));
        let seen = tip(&truth, &at, [0.0; 3]);
        let [x, y, z, c] = at.map(|(_, q)| q);
        [x, y, z, c, seen.x, seen.y, seen.z]
    });
    lab.write("t.csv", &csv("X,Y,Z,C,x,y,z", rows));
    lab
}

fn observations(lab: &Lab) -> Observations {
    let unknown = "folds = 0\nunknown = [{ error = \"EXX\", legendre = 1 }]\n";
    lab.read(&format!("{unknown}{POINTS}")).expect("read")
}

/// C of a small machine is inverted: the sphere position absorbs half of the residual, less than 10 mm remain, and the file is rejected.
#[test]
fn an_inverted_axis_of_a_small_machine_is_refused() {
    let machine = "structure = \"w C' b X Y Z t\"
axes.X.travel = [-25.0, 25.0]
axes.Y.travel = [-25.0, 25.0]
axes.Z.travel = [-25.0, 25.0]
axes.C.travel = [-360.0, 360.0]
[tool]
tip = [0.0, 0.0, -20.0]
";
    let unknown = "folds = 0\nunknown = [\"EX0C\", \"EY0C\"]\n[[observation]]\nkind = \"sphere\"\nfile = \"s.csv\"\n";
    for (sign, is_right) in [(1.0, true), (-1.0, false)] {
        let lab = Lab::new(machine);
        let mut noise = Noise::new(8);
        let rows = (0..24_u8).map(|k| {
            // C rotates the table, so the tool follows a ball at [8, 3, −10] by +C (ISO 841).
            let c = 15.0 * f64::from(k) - 170.0;
            let (sin, cos) = c.to_radians().sin_cos();
            let mut n = || noise.normal(0.0005);
            [8.0 * cos + 3.0 * sin + n(), 3.0 * cos - 8.0 * sin + n(), 10.0 + n(), sign * c]
        });
        lab.write("s.csv", &csv("X,Y,Z,C", rows));
        match lab.identify(unknown) {
            Ok(found) => {
                assert!(is_right);
                assert!(found.residual.max_um < 5.0, "{:?}", found.residual);
            }
            Err(IdentifyError::FarRows { files }) => {
                assert!(!is_right, "{files:?}");
                assert!(files[0].typical_mm < 10.0, "{files:?}");
            }
            Err(other) => panic!("{other}"),
        }
    }
}

/// A gantry of 20 m whose bed is bent by 20 mm is identified, not rejected: limits grow with the machine.
#[test]
fn limits_grow_with_a_20_m_machine() {
    let machine = "structure = \"w b X Y Z t\"
axes.X.travel = [-10000.0, 10000.0]
axes.Y.travel = [-2000.0, 2000.0]
axes.Z.travel = [-1000.0, 1000.0]
";
    let truth = format!("{machine}[errors]\nEYX = {{ poly = [0.0, 0.0, 2e-4] }}\n");
    let truth = Machine::parse(&truth, "truth").expect("a machine");
    let lab = Lab::new(machine);
    let mut noise = Noise::new(5);
    let rows = (0..60).map(|_| {
        let at = [(X, 1e4), (Y, 2e3), (Z, 1e3)]
            .map(|(axis, size): (AxisName, f64)| (axis, noise.between(-size, size)));
        let seen = tip(&truth, &at, [0.0; 3]).map(|number| number + noise.normal(0.02));
        let [x, y, z] = at.map(|(_, q)| q);
        [x, y, z, seen.x, seen.y, seen.z]
    });
    lab.write("t.csv", &csv("X,Y,Z,x,y,z", rows));
    let found = lab
        .identify(
            "folds = 0\nunknown = [{ error = \"EYX\", legendre = 2 }]
[[observation]]
kind = \"points\"
file = \"t.csv\"
uncertainty_um = 20
",
        )
        .expect("an honest machine");
    // 2e-4 x² µm is (2/3) 2e4 µm of the order 2 Legendre polynomial over ±10 m; the rows end slightly inside.
    let (bent, uncertainty) = value(&found, "EYX legendre 2");
    let ends = found.machine.error("EYX".parse().expect("a name"));
    assert!(ends.is_some());
    assert!(bent > 1.1e4 && bent < 1.36e4 && uncertainty < 50.0, "{bent} {uncertainty}");
    assert!(found.residual.max_um < 200.0, "{:?}", found.residual);
}

#[test]
fn all_uncertainties_have_the_same_bounds() {
    let lab = lab();
    for (column, unit) in [("1e-9", "1e-9 µm"), ("1e7", "1e7 µm"), ("-3", "-3e0 µm")] {
        lab.write("c.csv", &format!("X,x,y,z,uncertainty_um\n1,1,0,0,1\n2,2,0,0,{column}\n"));
        let refused = lab
            .refused("unknown = [\"EXX\"]\n[[observation]]\nkind = \"points\"\nfile = \"c.csv\"\n");
        let expected = format!("c.csv:3: uncertainty_um: found {unit}, expected 1e-6 to 1e6 µm");
        assert!(refused.contains(&expected), "{refused}");
        lab.write("row.csv", &format!("ball,distance_mm,uncertainty_um\nA,0,0\nB,100,{column}\n"));
        lab.write("read.csv", "X,ball,along_um\n0,A,0\n100,B,1\n");
        let refused = lab.refused("unknown = [\"EXX\"]\n[[observation]]\nkind = \"ball-row\"\nfile = \"read.csv\"\nrow = \"row.csv\"\n");
        let expected =
            format!("row.csv:3: uncertainty_um: found {unit}, expected 1e-6 to 1e6 µm, or 0");
        assert!(refused.contains(&expected), "{refused}");
    }
}

/// A direction vector of 1e200 is rejected: its squared length overflows, so the vector would become zero and the
/// readings would have no effect.
#[test]
fn a_direction_of_infinite_length_is_refused() {
    let lab = lab();
    lab.write("row.csv", "ball,distance_mm\nA,0\nB,100\n");
    lab.write("read.csv", "X,ball,along_um\n0,A,0\n100,B,1\n");
    for keys in ["direction = [1e200, 0, 0]", "direction = [1, 0, 0]\nside1 = [0, 1e200, 0]"] {
        let refused = lab.refused(&format!(
            "unknown = [\"EXX\"]\n[[observation]]\nkind = \"ball-row\"\nfile = \"read.csv\"\nrow = \"row.csv\"\n{keys}\n"
        ));
        assert!(refused.contains("found 1e200, expected a number from -1e15 to 1e15"), "{refused}");
    }
}

type Spoil = fn(&mut Observations);

#[test]
fn invalid_observations_of_a_program_are_refused() {
    let lab = lab();
    assert!(identify(&observations(&lab), |_, _| {}).is_ok());
    let cases: [(&str, Spoil); 11] = [
        ("folds: found", |o| o.folds = usize::MAX),
        ("EXX: found Legendre", |o| {
            o.unknown[0].basis = Some(Basis::Legendre { order: usize::MAX });
        }),
        ("EXX: found BSpline", |o| {
            o.unknown[0].basis = Some(Basis::BSpline { coefficients: usize::MAX });
        }),
        ("EXX: found BSpline", |o| {
            o.unknown[0].basis = Some(Basis::BSpline { coefficients: 2 });
        }),
        ("EXX: found Fourier", |o| {
            o.unknown[0].basis = Some(Basis::Fourier { harmonics: usize::MAX });
        }),
        ("along the second axis", |o| {
            let basis = Basis::Legendre { order: usize::MAX };
            o.unknown[0].second = Some(SecondAxis { axis: Y, basis });
        }),
        ("a drift of order", |o| o.setup.frames[0].drift = usize::MAX),
        ("t.csv:frame: found a value", |o| {
            o.setup.frames[0].value = Some([f64::NAN; 6]);
        }),
        ("t.csv:2: found a coordinate or a reading", |o| {
            o.observations[0].rows[0].pose.state.q[0] = f64::NAN;
        }),
        ("t.csv:2: the standard uncertainty: found NaN", |o| {
            o.observations[0].rows[0].uncertainty_mm = f64::NAN;
        }),
        ("t.csv:2: the standard uncertainty: found 0e0", |o| {
            o.observations[0].rows[0].uncertainty_mm = 0.0;
        }),
    ];
    for (expected, change) in cases {
        let mut observations = observations(&lab);
        change(&mut observations);
        let refused = identify(&observations, |_, _| {}).expect_err(expected).to_string();
        assert!(refused.contains(expected), "{refused}");
    }
    // A number without its kind has no unit.
    let line = "folds = 0\nunknown = [\"EXX\"]\n[[observation]]\nkind = \"line\"\nfile = \"l.csv\"\ndirection = [1, 0, 0]\n";
    lab.write("l.csv", "X,deviation_um\n0,1\n100,1\n200,1\n");
    let mut observations = lab.read(line).expect("read");
    observations.setup.number_kinds.pop();
    let refused = identify(&observations, |_, _| {}).expect_err("one kind is missing").to_string();
    assert!(refused.contains("found 1 kinds for 2 numbers, expected one for each"), "{refused}");
}

#[test]
fn a_row_without_a_line_is_named_by_its_file() {
    let lab = lab();
    let mut observations = observations(&lab);
    for row in &mut observations.observations[0].rows {
        row.line = 0;
    }
    if let volcomp_identify::RowReading::Point { at_mm, .. } =
        &mut observations.observations[0].rows[4].reading
    {
        at_mm.x += 60.0;
    }
    let refused = identify(&observations, |_, _| {}).expect_err("a slip").to_string();
    assert!(refused.starts_with("t.csv: this row is 60"), "{refused}");
}

#[test]
fn a_value_for_a_name_that_is_not_an_unknown_is_refused() {
    let observations = observations(&lab());
    let with = |name: &str| machine_with(&observations, &[(name.to_owned(), 3.0)]);
    assert!(with("EXX legendre 1").is_ok());
    let refused = with("EXX legendre1").expect_err("misspelt").to_string();
    assert!(
        refused.contains("`EXX legendre1`") && refused.contains("EXX constant, EXX legendre 1"),
        "{refused}"
    );
}

/// The response to known errors of another structure is rejected: the same axes in another order are another machine.
#[test]
fn known_errors_of_another_structure_are_refused() {
    let observations = observations(&lab());
    let (_, response) = identify_followed(&observations, &[], |_, _| {}).expect("found");
    assert!(response.to(&observations.machine).is_ok());
    let other = MACHINE.replace("w C' X' b Y Z t", "w C' b X Y Z t");
    let other = Machine::parse(&other, "other").expect("a machine");
    let refused = response.to(&other).expect_err("another structure");
    assert!(
        matches!(&refused, IdentifyError::OtherStructure { found, .. } if found == "w C' b X Y Z t"),
        "{refused}"
    );
}

#[test]
fn an_unknown_is_read_back_as_it_was_written() {
    let machine = Machine::parse(MACHINE, "machine").expect("a machine");
    let lab = lab();
    let along = |axis, basis| Some(SecondAxis { axis, basis });
    let of = |error: &str, basis, second, reversal| Unknown {
        error: error.parse().expect("a name"),
        basis,
        second,
        reversal,
        penalised: false,
    };
    let legendre = |order| Basis::Legendre { order };
    let spline = |coefficients| Basis::BSpline { coefficients };
    let fourier = |harmonics| Basis::Fourier { harmonics };
    let mut all = vec![
        of("EXX", None, None, true),
        of("ECC", Some(fourier(2)), along(Z, legendre(1)), false),
        of("EAZ", Some(spline(5)), along(C, fourier(1)), true),
    ];
    for basis in [Basis::Constant, legendre(3), spline(5)] {
        for second in [None, along(Y, legendre(2)), along(Y, spline(4)), along(Y, spline(8))] {
            all.push(of("EXX", Some(basis), second, false));
        }
    }
    let penalised = |unknown: &Unknown| Unknown { penalised: true, ..*unknown };
    let with_penalty: Vec<Unknown> = all.iter().map(penalised).collect();
    for unknown in all.into_iter().chain(with_penalty) {
        let written = unknown.to_toml(false);
        let text = format!("unknown = [{written}]\n");
        let document = Document::new("o.toml", &text);
        let read = document.decode(|root| Unknown::decode(&root.require("unknown")?, &machine));
        let read: Vec<Unknown> = read.expect("read");
        assert_eq!(read, [unknown], "{written}");
        for root in ["auto", "none"] {
            let written = unknown.to_toml(root == "auto");
            let text = format!("penalty = \"{root}\"\nunknown = [{written}]\n{POINTS}");
            let read = lab.read(&text).expect("read");
            assert_eq!(read.unknown, [unknown], "{root}: {written}");
        }
    }
}

const READ_MACHINE: &str =
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
        let lab = Lab::new(READ_MACHINE);
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
        let lab = Lab::new(READ_MACHINE);
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
    let lab = Lab::new(READ_MACHINE);
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
    let lab = Lab::new(READ_MACHINE);
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
        let lab = Lab::new(&format!("{READ_MACHINE}{tools}"));
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
