//! No table exceeds the limit, and implausible tables are rejected.

use volcomp_tables::axis_table::{
    AxisNumbers, AxisTable, Content, ErrorTable, ErrorTables, ExchangeError, Format, ReadOptions,
    TableOptions, WriteOptions, read, sampled, write,
};
use volcomp_tables::model::{Machine, Temperatures};
use volcomp_tables::vocabulary::{AxisName, CorrectionLimit};

use super::file;

const HEAD: &str = "name = \"m\"\nstructure = \"w X' b Y Z t\"\n[axes.X]\ntravel = [0, 600]\n[axes.Y]\ntravel = [0, 300]\n[axes.Z]\ntravel = [-400, 0]\n[errors]\n";

fn made(errors: &str, format: Format, limit_um: f64) -> Result<Content, ExchangeError> {
    let machine = Machine::parse(&format!("{HEAD}{errors}"), "m.toml").expect("a machine");
    let options = TableOptions {
        limit: CorrectionLimit::new(limit_um).expect("a limit"),
        ..TableOptions::default()
    };
    sampled(&machine, &Temperatures::new(), &options, format)
}

#[test]
fn implausible_errors_make_no_table_of_any_format() {
    for format in Format::ALL {
        for errors in [
            "EXX = { poly = [0.0, 20] }\n",
            "EXX = { poly = [1e7, 0.02] }\n",
            // A file with positions in place of deviations.
            "EXX = { table = [[0, 0], [300, 299994], [600, 599988]] }\n",
        ] {
            for limit_um in [250.0, 2000.0] {
                let found = made(errors, format, limit_um);
                assert!(
                    matches!(found, Err(ExchangeError::BeyondLimit { .. })),
                    "{format}: {found:?}"
                );
            }
        }
        let errors = "EXX = { poly = [0.0, 0.5] }\n";
        assert!(made(errors, format, 299.0).is_err(), "{format}");
        let content = made(errors, format, 301.0);
        assert!(content.is_ok(), "{format}: {content:?}");
    }
    let message = made("EXX = { poly = [0.0, 20] }\n", Format::Siemens840d, 250.0);
    assert_eq!(
        message.expect_err("refused").to_string(),
        "the deviation of X at X 50 mm is 980.4 µm, expected at most 250 µm: check the units in the machine file"
    );
}

/// Tables above 2 mm or 2 mrad are rejected in every format.
#[test]
fn no_format_writes_implausible_values() {
    let table = |output: AxisName, value: f64| {
        Content::Axes(vec![AxisTable {
            input: AxisName::X,
            output,
            positions: vec![0.0, 100.0],
            forward: vec![0.0, value],
            backward: None,
            modulo: false,
        }])
    };
    let errors = |value: f64| {
        Content::Errors(ErrorTables {
            curves: vec![ErrorTable {
                name: "EXX".parse().expect("a name"),
                positions: vec![0.0, 100.0],
                values: vec![0.0, value],
            }],
            locations: vec![("EC0Y".parse().expect("a name"), 0.0)],
        })
    };
    let options = WriteOptions {
        axes: AxisNumbers::stated(vec![(AxisName::X, 1), (AxisName::C, 4)]).expect("each once"),
        ..WriteOptions::default()
    };
    for (format, content, refused) in [
        (Format::Csv, table(AxisName::X, 2.0), false),
        (Format::Csv, table(AxisName::X, -2.01), true),
        (Format::Siemens840d, table(AxisName::X, 2.01), true),
        (Format::Csv, table(AxisName::C, 0.002), false),
        (Format::Csv, table(AxisName::C, 0.0021), true),
        (Format::IsgCsv, errors(2.0), false),
        (Format::IsgCsv, errors(10.0), true),
    ] {
        let found = write(format, &content, &options);
        let is_refused = matches!(found, Err(ExchangeError::Implausible { .. }));
        assert_eq!(is_refused, refused, "{format}: {found:?}");
    }
}

/// A LinuxCNC file read as the other type has deviations as large as the travel, and is rejected.
#[test]
fn files_of_the_other_type_are_refused() {
    let read = |format, name: &str, text: &str| {
        let found = read(format, &[file(name, text)], &ReadOptions::default());
        found.expect_err("refused").to_string()
    };
    let trims = "0 0.002 -0.003\n10 0.003 -0.004\n";
    assert_eq!(
        read(Format::Linuxcnc, "X.comp", trims),
        "X.comp:2: found a deviation of -9997.0 µm, read as positions (type 0), expected at most 2000 µm; does the file have trims (type 1)?"
    );
    let positions = "0 0.002 -0.003\n10 10.003 9.996\n";
    assert_eq!(
        read(Format::LinuxcncType1, "X.comp", positions),
        "X.comp:2: found a deviation of -10003.0 µm, read as trims (type 1), expected at most 2000 µm; does the file have positions (type 0)?"
    );
}
