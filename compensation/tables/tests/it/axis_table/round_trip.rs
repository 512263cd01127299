//! Tables that are written and read again keep their values in every format, and damaged files cause no panic.

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_tables::axis_table::{
    AxisTable, Content, ErrorTable, ErrorTables, Format, ReadOptions, WriteOptions, curves, read,
    to_toml, write,
};
use volcomp_tables::vocabulary::{AxisName, Direction, ErrorName};
use volcomp_test_support::corpus::{self, replay};

use super::{inside, numbers, of_axes, over, own, read_text, writing};

/// Tables with random values on evenly spaced positions, mm and deg, with the node at index `zero` at 0.
fn table(input: AxisName, output: AxisName) -> impl Strategy<Value = AxisTable> {
    let steps = prop_oneof![Just(0.5), Just(1.0), Just(2.5), Just(10.0), Just(50.0)];
    (2_usize..40, steps, any::<prop::sample::Index>(), any::<bool>()).prop_flat_map(
        move |(count, step, zero, has_reversal)| {
            let values = || prop::collection::vec(-0.05..0.05_f64, count);
            let zero = zero.index(count);
            (values(), values()).prop_map(move |(forward, backward)| {
                // The limits of 2 mm and 2 mrad also apply to half the reversal and to extrapolated nodes.
                let each = |values: Vec<f64>| -> Vec<f64> {
                    values.into_iter().map(|v| inside(output, v)).collect()
                };
                let at = |node: usize| inside(input, (node as f64 - zero as f64) * step);
                AxisTable {
                    output,
                    backward: has_reversal.then(|| each(backward)),
                    ..own(input, (0..count).map(at).collect(), each(forward))
                }
            })
        },
    )
}

/// Part of a table that a format keeps.
#[derive(Clone, Copy)]
enum Keeps {
    Everything,
    /// Both directions of positioning tables, the mean of others.
    OwnDirections,
    /// The mean of positioning tables, both directions of others.
    CrossDirections,
    OwnAlone,
    /// Deviations relative to the deviation at 0.
    OwnFromZero,
}

fn kept(table: &AxisTable, keeps: Keeps) -> Option<AxisTable> {
    let mean = || AxisTable { forward: table.mean(), backward: None, ..table.clone() };
    let own = table.input == table.output;
    match keeps {
        Keeps::Everything => Some(table.clone()),
        Keeps::OwnDirections => Some(if own { table.clone() } else { mean() }),
        Keeps::CrossDirections => Some(if own { mean() } else { table.clone() }),
        Keeps::OwnAlone => own.then(|| table.clone()),
        Keeps::OwnFromZero => own.then(|| {
            let zero = table.deviation(0.0, Some(Direction::Positive));
            let less =
                |values: &Vec<f64>| values.iter().map(|value| value - zero).collect::<Vec<_>>();
            AxisTable {
                forward: less(&table.forward),
                backward: table.backward.as_ref().map(less),
                ..table.clone()
            }
        }),
    }
}

/// Asserts that written tables are read back; `within` is the resolution in mm or deg.
fn comes_back(
    format: Format,
    tables: &[AxisTable],
    keeps: Keeps,
    within: f64,
) -> Result<(), TestCaseError> {
    let content = Content::Axes(tables.to_vec());
    let written = write(format, &content, &writing()).expect("written");
    for file in &written.files {
        let text = &file.text;
        let has_minus = text.contains("-0.0000\n") || text.contains("=-0\n");
        prop_assert!(!has_minus, "{text}");
    }
    if !matches!(format, Format::Linuxcnc | Format::LinuxcncType1) {
        prop_assert_eq!(Format::of_files(&written.files), Some(format));
    }
    let options = ReadOptions { encoder: Some(0), ..super::options() };
    let found = read(format, &written.files, &options).expect("read");
    let found = of_axes(found.content);
    let expected = tables.iter().filter_map(|table| kept(table, keeps));
    let expected: Vec<AxisTable> = expected.collect();
    prop_assert_eq!(found.len(), expected.len());
    for expected in expected {
        let found = over(&found, expected.input, expected.output);
        let positions: Vec<f64> = expected
            .positions
            .windows(2)
            .flat_map(|pair| [pair[0], 0.7 * pair[0] + 0.3 * pair[1]])
            .collect();
        let ends =
            [expected.positions[0] - 1.0, expected.positions[expected.positions.len() - 1] + 1.0];
        for at in positions.into_iter().chain(ends) {
            for direction in [Some(Direction::Positive), Some(Direction::Negative), None] {
                let [a, b] = [found, &expected].map(|of| of.deviation(at, direction));
                let off = expected.output_in_file_unit(a - b);
                let is_near = off.abs() <= within + 1e-9;
                prop_assert!(is_near, "{format} {expected:?} at {at}: {off}");
            }
        }
    }
    Ok(())
}

fn several() -> impl Strategy<Value = Vec<AxisTable>> {
    use AxisName::{A, C, X, Y};
    let pairs = [(X, X), (X, Y), (C, C), (A, C), (A, X)];
    pairs.map(|(input, output)| table(input, output)).prop_map(Vec::from)
}

/// Tables as the TNC requires them: all tables over an axis have the same positions.
fn several_of_one() -> impl Strategy<Value = Vec<AxisTable>> {
    use AxisName::{C, X, Y};
    (table(X, X), prop::collection::vec(-0.05..0.05_f64, 40)).prop_map(|(own, values)| {
        let along = |output: AxisName| AxisTable {
            output,
            forward: (0..own.positions.len()).map(|node| values[node]).collect(),
            backward: None,
            ..own.clone()
        };
        // The largest value is 0.68 mrad at 1950 mm; the limit is 2 mrad.
        let slope = own.positions.iter().map(|at| (at * 2e-5).to_radians());
        let to_rotary = AxisTable { forward: slope.collect(), ..along(C) };
        vec![own.clone(), along(Y), to_rotary]
    })
}

fn error_tables() -> impl Strategy<Value = ErrorTables> {
    use AxisName::{C, X};
    let numbers = |text: &'static str, table: AxisTable| {
        let name: ErrorName = text.parse().expect("a name");
        ErrorTable { name, positions: table.positions, values: table.forward }
    };
    (table(X, X), table(X, C), table(C, X), -1e-3..1e-3_f64).prop_map(move |(a, b, c, square)| {
        ErrorTables {
            curves: vec![numbers("EXX", a), numbers("EBX", b), numbers("EYC", c)],
            locations: vec![("EC0Y".parse().expect("a name"), square)],
        }
    })
}

fn errors_come_back(format: Format, errors: &ErrorTables) -> Result<(), TestCaseError> {
    let content = Content::Errors(errors.clone());
    let written = write(format, &content, &WriteOptions::default()).expect("written");
    prop_assert_eq!(Format::of_files(&written.files), Some(format));
    let found = read(format, &written.files, &ReadOptions::default()).expect("read");
    let Content::Errors(found) = found.content else { panic!("errors") };
    prop_assert_eq!(found.curves.len(), errors.curves.len());
    for expected in &errors.curves {
        let mut curves = found.curves.iter();
        let found = curves.find(|found| found.name == expected.name);
        let found = found.expect("it is there");
        let is_angular = expected.name.component.is_angular();
        let within = if is_angular { 1e-10 } else { 1e-7 };
        prop_assert_eq!(found.positions.len(), expected.positions.len());
        for (a, b) in found.positions.iter().zip(&expected.positions) {
            prop_assert!((a - b).abs() < 1e-9);
        }
        for (a, b) in found.values.iter().zip(&expected.values) {
            prop_assert!((a - b).abs() <= within, "{} {a} {b}", expected.name);
        }
    }
    // This format has no location errors.
    prop_assert!(found.locations.is_empty());
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn csv(tables in several()) {
        comes_back(Format::Csv, &tables, Keeps::Everything, 1e-9)?;
    }

    #[test]
    fn linuxcnc(tables in several()) {
        comes_back(Format::Linuxcnc, &tables, Keeps::OwnAlone, 0.5e-6)?;
        comes_back(Format::LinuxcncType1, &tables, Keeps::OwnAlone, 0.5e-6)?;
    }

    #[test]
    fn siemens_840d(tables in several()) {
        comes_back(Format::Siemens840d, &tables, Keeps::CrossDirections, 0.5e-6)?;
    }

    #[test]
    fn heidenhain(tables in several_of_one()) {
        comes_back(Format::HeidenhainTnc640, &tables, Keeps::OwnDirections, 0.5e-4)?;
    }

    #[test]
    fn fanuc(tables in several()) {
        comes_back(Format::Fanuc, &tables, Keeps::OwnFromZero, 0.5e-3)?;
    }

    #[test]
    fn isg_csv(errors in error_tables()) {
        errors_come_back(Format::IsgCsv, &errors)?;
    }

}

#[test]
fn a_turn_comes_back_as_a_turn() {
    use AxisName::C;
    let positions: Vec<f64> = (0..=24).map(|node| f64::from(node * 15).to_radians()).collect();
    let forward = (positions.iter().map(|at| 1e-4 * at.sin() + 0.0))
        .map(|v| if v.abs() < 1e-12 { 0.0 } else { v });
    let table =
        AxisTable { modulo: true, forward: forward.collect(), ..own(C, positions, Vec::new()) };
    let formats = [Format::Csv, Format::Siemens840d, Format::HeidenhainTnc640, Format::Fanuc];
    for format in formats {
        let content = Content::Axes(vec![table.clone()]);
        let files = write(format, &content, &writing()).expect("written").files;
        let found = read(format, &files, &super::options()).expect("read");
        let found = of_axes(found.content);
        assert!(found[0].modulo, "{format}");
        // 380° equals 20°, −90° equals 270°.
        for (at, same) in [(380.0_f64, 20.0_f64), (-90.0, 270.0)] {
            let [a, b] = [at, same].map(|deg| found[0].deviation(deg.to_radians(), None));
            assert!((a - b).abs() < 1e-9, "{format}: {a} {b}");
            assert!((a - table.deviation(same.to_radians(), None)).abs() < 1e-5, "{format}");
        }
    }
}

fn target(format: Format) -> String {
    format!("table_{}", format.name().replace('-', "_"))
}

#[test]
fn corpus_files_are_read_or_refused_by_their_names() {
    for format in Format::ALL {
        replay(&target(format), |_, bytes| {
            let text = std::str::from_utf8(bytes).expect("UTF-8");
            read_text(format, "X.comp", text)
        });
    }
}

/// Random mutations of the corpus do not panic; every text that is read can be written and read again.
#[test]
fn mutated_texts_do_not_panic() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let pieces: Vec<&str> = "- . 1e9 1e-9 [ ] 0 -0.000 nan ; = X { } % 9999999999 µ"
        .split(' ')
        .chain(["\n", " "])
        .collect();
    for format in Format::ALL {
        let texts: Vec<String> = corpus::files(&target(format))
            .into_iter()
            .map(|(_, bytes)| String::from_utf8(bytes).expect("UTF-8"))
            .collect();
        let mut read_again = 0;
        for number in 0..600 {
            let mut characters: Vec<char> = texts[number % texts.len()].chars().collect();
            for _ in 0..rng.random_range(1..4) {
                let at = rng.random_range(0..characters.len());
                let to = (at + rng.random_range(0..4)).min(characters.len());
                let piece = pieces[rng.random_range(0..pieces.len())];
                characters.splice(at..to, piece.chars());
            }
            let text: String = characters.into_iter().collect();
            let Ok(found) = read_text(format, "X.comp", &text) else {
                continue;
            };
            if let Ok(curves) = curves(&found.content) {
                to_toml(&curves);
            }
            let options = WriteOptions { axes: numbers(), ..WriteOptions::default() };
            let Ok(written) = write(format, &found.content, &options) else {
                continue;
            };
            if read(format, &written.files, &super::options()).is_ok() {
                read_again += 1;
            }
        }
        assert!(read_again > 0, "{format}: {read_again}");
    }
}
