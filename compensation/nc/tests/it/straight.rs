use crate::identity::compensated;

fn lines(errors: &str, program: &str) -> Vec<String> {
    let (out, _) = compensated(errors, program.as_bytes()).expect("compensated");
    let text = String::from_utf8(out).expect("text");
    text.lines().map(str::to_owned).collect()
}

/// With scale errors of 100 µm/m every coordinate is 100 µm/m shorter, and G91 words by their differences.
#[test]
fn a_scale_error_is_subtracted_from_every_coordinate() {
    let scale = "[errors]\nEXX = { poly = [0.0, 0.1] }\n";
    assert_eq!(
        lines(
            scale,
            "G21 G90 G54\nN10 G0 X100 Y0 Z0 (start)\nG1 F500 X200.0\nX300. Y5\nG91 X-100\nG90 G1 X0\n"
        ),
        [
            "G21 G90 G54",
            "N10 G0 X99.990 Y0 Z0 (start)",
            "G1 F500 X199.980",
            "X299.970 Y5",
            "G91 X-99.990",
            "G90 G1 X0",
        ]
    );
    // 10 inch are 254 mm: 25.4 µm too long, 0.001 inch.
    assert_eq!(
        lines(scale, "G20 G90\nG0 X10 Y0 Z0\nX-10\n"),
        ["G20 G90", "G0 X9.9990 Y0 Z0", "X-9.9990"]
    );
    // The decimals of the program are kept.
    assert_eq!(lines(scale, "G0 Y0 Z0\nX100.12345\n")[1], "X100.11344");
}

/// With a squareness error X follows Y, also in blocks without X. As long as X is unknown its correction is omitted, with a note.
#[test]
fn words_are_added_for_unnamed_axes() {
    let square = "[errors]\nEC0Y = 50.0\n";
    let (out, summary) =
        compensated(square, b"G90\nG1 F100 Y200\nX0 Y200\nY100\nG91 Y100\n").expect("compensated");
    assert_eq!(
        String::from_utf8(out).expect("text"),
        "G90\nG1 F100 Y200\nX0.010 Y200\nY100 X0.005\nG91 Y100 X0.005\n"
    );
    let notes: Vec<String> =
        summary.notes.by_line().iter().map(|(line, note)| format!("{line}: {note}")).collect();
    assert_eq!(
        notes,
        [
            "2: corrections of X are omitted until the program names that axis, because its position is unknown",
            "3: the set-up file has no work offset G54: zero is assumed"
        ]
    );
}

/// A straightness error of X splits a long line along X, but not one along Y.
#[test]
fn lines_are_split_where_the_correction_bends() {
    let bent = "[errors]\nEYX = { poly = [0.0, 0.0, 0.0001] }\n";
    let out = lines(bent, "G90 G0 X0 Y0 Z0\nG1 F100 X400 (along)\nY50\n");
    assert!(out.len() > 6 && out[1].ends_with("(along)"), "{out:?}");
    assert_eq!(out.last().map(String::as_str), Some("Y49.984"));
    // Corners are within half a step of the corrected curve, chords within 0.5 µm plus rounding.
    let mut before = (0.0, 0.0);
    for line in &out[1..out.len() - 1] {
        let word = |letter: char| {
            let text = line.split(letter).nth(1)?;
            let text: String =
                text.chars().take_while(|c| c.is_ascii_digit() || matches!(c, '.' | '-')).collect();
            text.parse::<f64>().ok()
        };
        let at = (word('X').expect("X"), word('Y').unwrap_or(before.1));
        let curve = |x: f64| -1e-7 * x * x;
        assert!((at.1 - curve(at.0)).abs() <= 0.000_501, "{line}");
        for step in 0..=20 {
            let share = f64::from(step) / 20.0;
            let x = before.0 + share * (at.0 - before.0);
            let y = before.1 + share * (at.1 - before.1);
            assert!((y - curve(x)).abs() <= 0.001_01, "{line}");
        }
        before = at;
    }
    assert_eq!(before.0, 400.0);
}

/// G92 sets the position of the axes including their correction.
#[test]
fn offsets_are_set_with_the_correction_in_the_axes() {
    let scale = "[errors]\nEXX = { poly = [0.0, 0.1] }\n";
    assert_eq!(
        lines(scale, "G90 G0 X100 Y0 Z0\nG92 X0\nG1 F1 X100\nG92.1\nX200\n"),
        ["G90 G0 X99.990 Y0 Z0", "G92 X-0.010", "G1 F1 X99.980", "G92.1", "X199.980"]
    );
}

/// Lost motion of 4 µm (±2 µm) is corrected where the axis reverses. A line is added for it only above the tolerance.
#[test]
fn play_is_taken_up_before_an_axis_reverses() {
    let play =
        |um: f64| format!("[errors]\nEXX = {{ mean = {{ poly = [0.0] }}, reversal = {um} }}\n");
    let program = "G90 G0 X0 Y0 Z0\nG1 F100 X100\nX40\nG93 G1 X90 F2\n";
    assert_eq!(
        lines(&play(4.0), program),
        [
            "G90 G0 X0 Y0 Z0",
            "G1 F100 X-0.002",
            "X99.998",
            "X100.002",
            "X40.002",
            "G93 G1 X39.998 F2000.0000",
            "X89.998 F2.0000"
        ]
    );
    assert_eq!(lines(&play(0.4), program).len(), 4);
}

/// A line along X has an error of Y in its middle only: Y returns at the end, although its word does not change.
#[test]
fn a_resting_axis_returns_at_the_end_of_a_split_line() {
    let bent = "[errors]\nEYX = { table = [[-1000, 0], [0, 0], [100, 20], [200, 0], [1000, 0]], interpolation = \"linear\" }\n";
    let (out, _) =
        crate::identity::compensated(bent, b"G0 X0 Y0 Z0\nG1 F100 X200 Y0\n").expect("taken");
    let text = String::from_utf8(out).expect("text");
    assert_eq!(text, "G0 X0 Y0 Z0\nG1 F100 X100.000 Y-0.020\nX200.000 Y0.000\n");
}
