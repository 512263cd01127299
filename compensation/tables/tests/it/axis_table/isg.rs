//! TwinCAT: files for TF5280.

use volcomp_tables::axis_table::{Content, ErrorTables, Format};

use super::{close, read_text, refused};

fn errors(format: Format, text: &str) -> ErrorTables {
    let found = read_text(format, "e.csv", text).unwrap_or_else(|error| panic!("{error}"));
    let Content::Errors(errors) = found.content else { panic!("errors") };
    errors
}

#[test]
fn the_csv_of_tf5280() {
    let text = "// comment\nX EXX EBX\n0 0.001 0.00001\n100; -0.002; 0\n# next\nC,ECC\n0,0\n90,0.00002 // end\n";
    let found = errors(Format::IsgCsv, text);
    let names: Vec<String> = found.curves.iter().map(|table| table.name.to_string()).collect();
    assert_eq!(names, ["EXX", "EBX", "ECC"]);
    assert_eq!(found.curves[0].values, [0.001, -0.002]);
    close(found.curves[2].positions[1], core::f64::consts::FRAC_PI_2, 1e-12);
    for (text, line) in [
        ("X Y EXX\n", 1),
        ("X EXY\n", 1),
        ("X EXX\n0 1 2\n", 2),
        ("X EXX\n0 1\n", 2),
        ("EXX\n", 1),
        ("X EXX\n0 0\n1 0\n#\nX EXX\n0 0\n1 0\n", 7),
    ] {
        let message = refused(Format::IsgCsv, "e.csv", text);
        assert!(message.starts_with(&format!("e.csv:{line}: found ")), "{message}");
    }
}
