//! ISG kernel and TwinCAT: the maker's worked numbers, and the two files of TF5280.

use volcomp_tables::axis_table::{AxisTable, Content, ErrorTables, Format, WriteOptions, write};
use volcomp_tables::vocabulary::AxisName;

use super::{close, numbers, read_text, refused, tables};

#[test]
fn the_worked_numbers_of_the_maker() {
    // Commanded 19866.7 µm, measured 19856.5 µm in positive and 19874.7 µm in negative direction.
    let table = AxisTable {
        input: AxisName::X,
        output: AxisName::X,
        positions: vec![0.0, 19.8667, 50.0],
        forward: vec![0.0, 19.8565 - 19.8667, 0.0],
        backward: Some(vec![0.0, 19.8747 - 19.8667, 0.0]),
        modulo: false,
    };
    let options = WriteOptions {
        axes: numbers(),
        ..WriteOptions::default()
    };
    let written = write(Format::IsgSsfk, &Content::Axes(vec![table]), &options).expect("written");
    let lines: Vec<Vec<&str>> = written.files[0]
        .text
        .lines()
        .map(|line| line.split_whitespace().collect())
        .collect();
    let value = |key: &str| lines.iter().find(|line| line[0] == key).map(|line| line[1]);
    assert_eq!(value("kw.ssfk.interval"), Some("0"));
    assert_eq!(value("kw.ssfk.table[1].setpoint"), Some("198667"));
    assert_eq!(value("kw.ssfk.table[1].pos"), Some("-102"));
    assert_eq!(value("kw.ssfk.table[1].neg"), Some("80"));
    assert_eq!(value("kopf.log_achs_nr"), Some("1"));
}

const LIST: &str = "# axis\nkopf.log_achs_nr 2\nkw.ssfk.interval 500000 // 50 mm\nkw.ssfk.kw_startpos -500000\nkw.ssfk.kw_nr_max 2\nkw.ssfk.bilateral 1\n\
                    kw.ssfk.table[0].pos -102\nkw.ssfk.table[0].neg 80\nkw.ssfk.table[1].pos 0\nkw.ssfk.table[1].neg -0\nother.key 7\n";

#[test]
fn a_list_is_read() {
    let (found, warnings) = tables(Format::IsgSsfk, "y.lis", LIST);
    assert!(warnings.is_empty(), "{warnings:?}");
    assert_eq!(found[0].input, AxisName::Y);
    assert_eq!(found[0].positions, [-50.0, 0.0]);
    close(found[0].forward[0], -0.0102, 1e-12);
    close(found[0].backward.as_ref().expect("both")[0], 0.008, 1e-12);
    let one = LIST.replace("bilateral 1", "bilateral 0");
    assert_eq!(tables(Format::IsgSsfk, "y.lis", &one).0[0].backward, None);
    let told = refused(
        Format::IsgSsfk,
        "y.lis",
        &LIST.replace("achs_nr 2", "achs_nr 9"),
    );
    assert!(
        told.contains("axis number 9") && told.contains("--axis-numbers X=9"),
        "{told}"
    );
    assert!(
        refused(
            Format::IsgSsfk,
            "y.lis",
            &LIST.replace("[1].pos", "[2].pos")
        )
        .contains("entry 1")
    );
    assert!(
        refused(Format::IsgSsfk, "y.lis", &LIST.replace(" -102", " x"))
            .starts_with("y.lis:7: found `x`")
    );
    // The slip of the documentation is read as it stands.
    let slip = "kopf.log_achs_nr 1\nkw.ssfk.interval 0\nkw.ssfk.table[0].setpoint -198667\nkw.ssfk.table[0].pos -102\nkw.ssfk.table[1].setpoint 0\nkw.ssfk.table[1].pos 0\n";
    close(
        tables(Format::IsgSsfk, "x.lis", slip).0[0].positions[0],
        -19.8667,
        1e-9,
    );
}

fn errors(format: Format, text: &str) -> ErrorTables {
    let found = read_text(format, "e.csv", text).unwrap_or_else(|error| panic!("{error}"));
    let Content::Errors(errors) = found.content else {
        panic!("errors")
    };
    errors
}

#[test]
fn the_csv_of_tf5280() {
    let text = "// comment\nX EXX EBX\n0 0.001 0.00001\n100; -0.002; 0\n# next\nC,ECC\n0,0\n90,0.00002 // end\n";
    let found = errors(Format::IsgCsv, text);
    let names: Vec<String> = found
        .curves
        .iter()
        .map(|table| table.name.to_string())
        .collect();
    assert_eq!(names, ["EXX", "EBX", "ECC"]);
    assert_eq!(found.curves[0].values, [0.001, -0.002]);
    close(
        found.curves[2].positions[1],
        core::f64::consts::FRAC_PI_2,
        1e-12,
    );
    for (text, line) in [
        ("X Y EXX\n", 1),
        ("X EXY\n", 1),
        ("X EXX\n0 1 2\n", 2),
        ("X EXX\n0 1\n", 2),
        ("EXX\n", 1),
        ("X EXX\n0 0\n1 0\n#\nX EXX\n0 0\n1 0\n", 7),
    ] {
        let told = refused(Format::IsgCsv, "e.csv", text);
        assert!(told.starts_with(&format!("e.csv:{line}: found ")), "{told}");
    }
}

#[test]
fn the_exchange_format() {
    let text = "[EXY]\nGridpoints = { 0 0.001 50 0.002\n 100 0.003 }\n[C0B]\nVALUE = 0.00004\n[EAX]\nGridpoints = {\n0 0\n10 1e-5\n}\n";
    let found = errors(Format::Etalon, text);
    assert_eq!(found.curves[0].positions, [0.0, 50.0, 100.0]);
    assert_eq!(found.curves[0].values, [0.001, 0.002, 0.003]);
    assert_eq!(
        found.locations,
        [("EC0B".parse().expect("a name"), 0.00004)]
    );
    for (text, line) in [
        ("[EXY]\nGridpoints = { 0 1 2 }\n", 2),
        ("Gridpoints = { 0 1 2 3 }\n", 1),
        ("[EXY]\nVALUE = 1\n", 2),
        ("[EXY]\nGridpoints = { 0 1\n", 2),
        ("[EXY]\n", 1),
        ("[QQ]\n", 1),
        ("[EXY]\nGridpoints = { 0 x }\n", 2),
    ] {
        let told = refused(Format::Etalon, "e.csv", text);
        assert!(told.starts_with(&format!("e.csv:{line}: found ")), "{told}");
    }
}
