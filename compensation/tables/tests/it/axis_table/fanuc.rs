//! FANUC pitch error compensation: increments that add up.

use volcomp_tables::axis_table::{AxisTable, Content, Format, write};
use volcomp_tables::vocabulary::{AxisName, Direction};
use volcomp_test_support::cases;

use super::{close, edges, own, refused, tables, writing};

/// Table from −100 to 200 mm in steps of 100 mm; values in µm.
fn table(forward: [f64; 4], backward: Option<[f64; 4]>) -> AxisTable {
    let mm = |um: [f64; 4]| um.map(|um| um * 1e-3).to_vec();
    let positions = vec![-100.0, 0.0, 100.0, 200.0];
    AxisTable { backward: backward.map(mm), ..own(AxisName::X, positions, mm(forward)) }
}

fn written(table: AxisTable) -> Result<String, String> {
    let written = write(Format::Fanuc, &Content::Axes(vec![table]), &writing());
    written.map(|written| written.files[0].text.clone()).map_err(|error| error.to_string())
}

#[test]
fn a_value_is_minus_the_step_of_the_error() {
    // Errors 2, 0, 3, 7 µm: from −100 to 0 the error falls by 2, then it rises by 3 and 4.
    let text = written(table([2.0, 0.0, 3.0, 7.0], None)).expect("written");
    assert_eq!(
        text,
        "%\nN03605A1P00000000\nN03620A1P1\nN03621A1P0\nN03622A1P3\nN03623A1P1\nN03624A1P100.0\nN03625A1P0.0\nN10000P0\nN10001P2\nN10002P-3\nN10003P-4\n%\n"
    );
    // Rounding errors of thirds of a detection unit do not accumulate.
    let text = written(table([0.0, 0.0, 0.4, 0.8], None)).expect("written");
    assert!(text.contains("N10002P0\nN10003P-1\n"), "{text}");
}

#[test]
fn both_directions() {
    let text = written(table([2.0, 0.0, 3.0, 7.0], Some([5.0, 4.0, 4.0, 9.0]))).expect("written");
    assert!(
        text.contains("N03605A1P00000001\n") && text.contains("N03626A1P4\nN03627A1P-4\n"),
        "{text}"
    );
    let (found, _) = tables(Format::Fanuc, "PITCH.TXT", &text);
    for (at, forward, backward) in
        [(-100.0, 0.002, 0.005), (0.0, 0.0, 0.004), (200.0, 0.007, 0.009)]
    {
        for (direction, expected) in Direction::BOTH.into_iter().zip([forward, backward]) {
            close(found[0].deviation(at, Some(direction)), expected, 1e-12);
        }
    }
}

#[test]
fn files_as_controls_put_them_out() {
    // End of block as LF, CR or semicolon, other parameters in between, and two axes in a record are accepted.
    let text = "%\rN00000P00001100;\rN05898S1P30.0S2P30.0;\rN03620A1P1A2P0;\rN03621A1P0A2P0;\rN03622A1P2A2P0;\rN03623A1P2A2P0;\rN03624A1P50.0A2P0;\rN10000P0;\rN10001P-1;\rN10002P3;\r%\r";
    let (found, warnings) = tables(Format::Fanuc, "p", text);
    // With magnification 2 an increment of 1 µm counts twice; the second axis has no points.
    assert_eq!(found.len(), 1);
    let expected = [(-50.0, -0.002), (0.0, 0.0), (50.0, -0.006)];
    for (found, expected) in edges(&found[0]).into_iter().zip(expected) {
        close(found.0, expected.0, 1e-12);
        close(found.1, expected.1, 1e-12);
    }
    let message = warnings.concat();
    assert!(message.contains("axis Y: no interval"), "{message}");
    let (_, warnings) = tables(Format::Fanuc, "p", &text.replace("A1P50.0", "A1P50"));
    assert!(warnings.concat().contains("no decimal point"), "{warnings:?}");
}

#[test]
fn refusals() {
    let message = written(table([0.0, 0.0, 0.0, 200.0], None)).expect_err("refused");
    assert!(message.contains("a step of -200 detection units"), "{message}");
    let mut shifted = table([0.0, 1.0, 2.0, 3.0], None);
    shifted.positions = vec![10.0, 110.0, 210.0, 310.0];
    let message = written(shifted).expect_err("refused");
    let expected = "no point at machine zero, between 10 and 310";
    assert!(message.contains(expected), "{message}");
    for [text, expected] in &cases(
        r"
hello\n | p.txt:1: found 
N\n | p.txt:1: found 
N03620A1\n | p.txt:1: found 
N03620AxP1\n | p.txt:1: found 
N10000Q1\n | p.txt:1: found 
N10000P\n | p.txt:1: found 
N03620A7P0\nN03621A7P0\nN03622A7P1\nN03624A7P1.0\n | --axis-numbers X=7
N03620A1P9\nN03621A1P0\nN03622A1P1\nN03624A1P1.0\n | reference 9
",
    ) {
        let message = refused(Format::Fanuc, "p.txt", text);
        assert!(message.contains(expected.as_str()), "{message}");
    }
}
