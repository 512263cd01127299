//! HEIDENHAIN: the forms that are known, and what a TNC 407 refuses.

use volcomp_tables::axis_table::{
    AxisTable, Content, Format, WriteOptions, read, spacing_refused_by_tnc407, steps_of_tnc407,
    write,
};
use volcomp_tables::vocabulary::{AxisName, Direction};

use super::{close, edges, file, options, refused, tables};

const COM: &str = "BEGIN AXIS_X.COM MM\nNR AXISPOS BACKLASH X Y\n0 +0.0000 +0.0010 +0.0000 +0.0030\n1 +50.0000 +0.0050 +0.0040 -0.0020\n[END]\n";

#[test]
fn the_table_of_a_tnc_640() {
    let (found, warnings) = tables(Format::HeidenhainTnc640, "AXIS_X.COM", COM);
    assert!(warnings.is_empty(), "{warnings:?}");
    assert_eq!(edges(&found[0]), [(0.0, 0.0), (50.0, 0.004)]);
    close(
        found[0].deviation(50.0, Some(Direction::Negative)),
        0.005,
        1e-12,
    );
    assert_eq!(
        (found[1].input, found[1].output),
        (AxisName::X, AxisName::Y)
    );
    assert_eq!(found[1].backward, None);
}

#[test]
fn the_cma_says_which_axis_is_the_input() {
    let cma = "BEGIN CONFIG.CMA MM\nNR ACTIVE X Y\n0 - AXIS_X AXIS_X\n1 * AXIS_Q AXIS_X\n[END]\n";
    let files = [
        file("CONFIG.CMA", &cma.replace(" - ", " = ")),
        file("AXIS_X.COM", &COM.replace("BACKLASH X Y", "BACKLASH Y X")),
    ];
    let found = read(Format::HeidenhainTnc640, &files, &options()).expect("read");
    let Content::Axes(found) = found.content else {
        panic!("tables")
    };
    assert!(found.iter().all(|table| table.input == AxisName::Y));
    let other = [
        file(
            "CONFIG.CMA",
            "BEGIN C.CMA MM\nNR ACTIVE X\n0 * OTHER\n[END]\n",
        ),
        file("AXIS_X.COM", COM),
    ];
    let told = read(Format::HeidenhainTnc640, &other, &options())
        .expect_err("nothing is left")
        .to_string();
    assert!(told.contains("does not name it"), "{told}");
    let none = [
        file(
            "CONFIG.CMA",
            "BEGIN C.CMA MM\nNR ACTIVE X\n0 - AXIS_X\n[END]\n",
        ),
        file("AXIS_X.COM", COM),
    ];
    assert!(
        read(Format::HeidenhainTnc640, &none, &options())
            .expect_err("no active line")
            .to_string()
            .contains("ACTIVE")
    );
}

#[test]
fn the_table_of_an_itnc_530() {
    let text = "BEGIN AXIS-X.COM  DATUM:-50.0000 DISTANCE:+50.0000\nNR    POSITION   X\n0 -50.0000 +0.0010\n1 +0.0000 -0.0000\n2 +50.0000 -0.0020\n[END]\n";
    let (found, warnings) = tables(Format::HeidenhainItnc530, "AXIS-X.COM", text);
    assert_eq!(
        edges(&found[0]),
        [(-50.0, 0.001), (0.0, 0.0), (50.0, -0.002)]
    );
    assert!(
        warnings[0].contains("a TNC 407 would refuse the distance 50")
            && warnings[0].contains("26.2144 or 52.4288"),
        "{warnings:?}"
    );
    let wrong = refused(
        Format::HeidenhainItnc530,
        "AXIS-X.COM",
        &text.replace("2 +50.0000", "2 +60.0000"),
    );
    assert_eq!(
        wrong,
        "AXIS-X.COM:5: found position 60, expected 50, by DATUM and DISTANCE"
    );
}

fn table(step: f64, count: u32, input: AxisName, slope: f64) -> AxisTable {
    let inside = |edge: f64| {
        if input.is_rotary() {
            edge.to_radians()
        } else {
            edge
        }
    };
    AxisTable {
        input,
        output: input,
        positions: (0..count).map(|n| inside(step * f64::from(n))).collect(),
        forward: (0..count)
            .map(|n| inside(slope * step * f64::from(n)))
            .collect(),
        backward: None,
        modulo: false,
    }
}

fn written(format: Format, table: AxisTable) -> Result<usize, String> {
    let written = write(
        format,
        &Content::Axes(vec![table]),
        &WriteOptions::default(),
    );
    written
        .map(|written| written.files.len())
        .map_err(|error| error.to_string())
}

#[test]
fn a_tnc_407_takes_powers_of_two() {
    // 2^16 × 0.1 µm.
    assert_eq!(steps_of_tnc407(6.5536), Some(16));
    assert_eq!(steps_of_tnc407(10.0), None);
    assert_eq!(
        spacing_refused_by_tnc407(10.0).expect("refused"),
        "a power of two times 0.1 µm: 6.5536 or 13.1072"
    );
    let format = Format::HeidenhainTnc407;
    assert!(written(format, table(6.5536, 100, AxisName::X, 1e-4)).is_ok());
    let told = written(format, table(10.0, 100, AxisName::X, 1e-4)).expect_err("refused");
    assert!(
        told.contains(
            "found a spacing of 10, expected a power of two times 0.1 µm: 6.5536 or 13.1072"
        ),
        "{told}"
    );
    let told = written(format, table(6.5536, 100, AxisName::X, 0.02)).expect_err("refused");
    assert!(told.contains("a 64th of the spacing"), "{told}");
}

#[test]
fn every_control_of_the_maker_has_these_limits() {
    for format in [Format::HeidenhainTnc640, Format::HeidenhainItnc530] {
        assert!(written(format, table(1.0, 256, AxisName::X, 1e-4)).is_ok());
        assert!(
            written(format, table(1.0, 257, AxisName::X, 1e-4))
                .expect_err("refused")
                .contains("257 positions, expected 256")
        );
        assert!(written(format, table(15.0, 25, AxisName::C, 1e-5)).is_ok());
        assert!(
            written(format, table(15.0, 26, AxisName::C, 1e-5))
                .expect_err("refused")
                .contains("0 to 360 deg")
        );
    }
}

#[test]
fn refusals_name_line_found_and_expected() {
    let format = Format::HeidenhainTnc640;
    let told = |text: &str| refused(format, "AXIS_X.COM", text);
    assert!(told("hello\n").starts_with("AXIS_X.COM:1: found `hello`"));
    assert!(
        told(&COM.replace("+50.0000", "+0.0000"))
            .contains(":4: found a position that does not rise")
    );
    assert!(told(&COM.replace("-0.0020", "")).contains(":4: found 4 cells, expected 5"));
    assert!(told(&COM.replace("-0.0020", "x")).contains(":4: found `x`, expected a number"));
    assert!(told(&COM.replace("COM MM", "COM INCH")).contains("found INCH"));
    let (_, warnings) = tables(format, "AXIS_X.COM", &COM.replace("[END]\n", ""));
    assert!(warnings[0].contains("no [END]"), "{warnings:?}");
    let (_, warnings) = tables(
        format,
        "AXIS_X.COM",
        &COM.replace("+0.0010", "+0").replace("+0.0050", "+0"),
    );
    assert!(
        warnings[0].contains("BACKLASH is 0 everywhere"),
        "{warnings:?}"
    );
}
