//! Corrected straight motions and arcs, compared with closed forms.

use crate::{
    flow::text,
    identity::{compensated, notes_of, text_in},
};

fn lines(errors: &str, program: &str) -> Vec<String> {
    text(errors, program).lines().map(str::to_owned).collect()
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
        text_in("", square, "G90\nG1 F100 Y200\nX0 Y200\nY100\nG91 Y100\n").expect("compensated");
    assert_eq!(out, "G90\nG1 F100 Y200\nX0.010 Y200\nY100 X0.005\nG91 Y100 X0.005\n");
    assert_eq!(
        notes_of(&summary),
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
    assert_eq!(
        text(bent, "G0 X0 Y0 Z0\nG1 F100 X200 Y0\n"),
        "G0 X0 Y0 Z0\nG1 F100 X100.000 Y-0.020\nX200.000 Y0.000\n"
    );
}

#[test]
fn a_constant_error_shifts_an_arc() {
    let constant = "[errors]\nEXX = { poly = [10.0] }\nEYY = { poly = [-20.0] }\n";
    assert_eq!(
        text(
            constant,
            "G90 G0 X0 Y0 Z0\nG1 F100 X10 Y0\nG3 X0 Y10 I-10 J0\nG2 X10 Y0 R10\nG2 I-5\n"
        ),
        "G90 G0 X-0.010 Y0.020 Z0\nG1 F100 X9.990 Y0.020\nG3 X-0.010 Y10.020 I-10 J0\nG2 X9.990 Y0.020 R10\nG2 I-5\n"
    );
}

/// Equal scale errors of X and Y resize a circle: it stays one arc, with a radius 100 µm/m smaller.
#[test]
fn equal_scales_do_not_split_an_arc() {
    let scales = "[errors]\nEXX = { poly = [0.0, 0.1] }\nEYY = { poly = [0.0, 0.1] }\n";
    assert_eq!(
        text(scales, "G90 G0 X100 Y0 Z0\nG3 F100 X0 Y100 I-100 J0\nG3 X-100 Y0 R100\n"),
        "G90 G0 X99.990 Y0 Z0\nG3 F100 X0 Y99.990 I-99.990 J0\nG3 X-99.990 Y0 R99.990\n"
    );
}

/// A squareness error turns a circle into an ellipse: it is split into 2 to 40 arcs that are within 1.6 µm of the corrected curve.
#[test]
fn unequal_scales_split_a_circle_into_arcs() {
    let square = "[errors]\nEC0Y = 100.0\nEYX = { poly = [0.0, 0.0, 0.00002] }\n";
    let out = text(square, "G90 G0 X100 Y0 Z0\nG3 F100 X-100 Y0 I-100 J0\n");
    let mut at = (0.0, 0.0);
    let mut arcs = 0;
    for line in out.lines() {
        let word = |letter: char| {
            let text = line.split(letter).nth(1)?;
            let number: String =
                text.chars().take_while(|c| c.is_ascii_digit() || matches!(c, '.' | '-')).collect();
            number.parse::<f64>().ok()
        };
        let to = (word('X').unwrap_or(at.0), word('Y').unwrap_or(at.1));
        if let Some(i) = word('I') {
            arcs += 1;
            let j = word('J').unwrap_or(0.0);
            let centre = (at.0 + i, at.1 + j);
            let radius = i.hypot(j);
            let angle = |p: (f64, f64)| (p.1 - centre.1).atan2(p.0 - centre.0);
            let (from, mut until) = (angle(at), angle(to));
            if until <= from {
                until += 2.0 * std::f64::consts::PI;
            }
            for step in 0..=50 {
                let turned = from + (until - from) * f64::from(step) / 50.0;
                let (x, y) = (centre.0 + radius * turned.cos(), centre.1 + radius * turned.sin());
                // Actual tool position: X by the squareness, Y by the straightness of X.
                let tool = (x - 1e-4 * y, y + 2e-8 * x * x);
                let off = tool.0.hypot(tool.1) - 100.0;
                assert!(off.abs() < 0.001_6, "{line}: {off}");
            }
        }
        at = to;
    }
    assert!((2..40).contains(&arcs), "{out}");
}

/// An arc from an unknown start is copied unchanged, and axes that it does not name keep their correction.
#[test]
fn an_arc_from_an_unknown_position_adds_no_words() {
    let scale = "[errors]\nEZZ = { poly = [0.0, 0.1] }\n";
    assert_eq!(
        text(scale, "G90 G0 Z100\nG91 G2 X10 Y0 I5 J0\nG1 Z-50\n"),
        "G90 G0 Z99.990\nG91 G2 X10 Y0 I5 J0\nG1 Z-49.995\n"
    );
}

/// If the start of an arc lacks its correction, a line before the arc applies it.
#[test]
fn a_correction_is_taken_up_before_an_arc() {
    let shift = "[errors]\nEXX = { poly = [20.0] }\n";
    // After G53 the program position is known only with the work offset.
    let setup = "[work_offset.G54]\nX = 0\n";
    let arc = |line: &str| {
        let program = format!("G90 G0 X0 Y0 Z0\nG53 G0 X0\n{line}\n");
        let (out, _) = text_in(setup, shift, &program).expect("compensated");
        out.lines().skip(2).map(str::to_owned).collect::<Vec<_>>()
    };
    assert_eq!(
        arc("G2 X20 Y0 I10 J0 (half)\nX40 I10 J0"),
        ["G1 X-0.020", "G2 X19.980 Y0 I10 J0 (half)", "X39.980 I10 J0"]
    );
    assert_eq!(arc("/G3 X20 I10")[..2], ["/G1 X-0.020", "/G3 X19.980 I10"]);
    // The added line is read under the modes before the block: the start of the arc is a position in G90.
    assert_eq!(arc("G91 G2 X20 I10"), ["G1 X-0.020", "G91 G2 X20 I10"]);
    assert_eq!(arc("G17 G2 X20 I10"), ["G1 X-0.020", "G17 G2 X19.980 I10"]);
}

/// A half circle whose rounded radius is 0.5 µm too short is accepted, as by LinuxCNC.
#[test]
fn a_half_circle_with_a_rounded_radius_is_accepted() {
    for program in [
        "G90 G0 X10.123 Y0 Z0\nG2 X13.124 Y0 R1.5 F100\n",
        "G90 G0 X0 Y0 Z0\nG3 X0.101 Y0 R0.05 F100\n",
        "G20 G90 G0 X0 Y0 Z0\nG2 X0.1251 Y0 R0.0625 F10\n",
    ] {
        assert_eq!(text("", program), program);
        let moved = text("[errors]\nEXX = { poly = [10.0] }\n", program);
        assert_eq!(moved.lines().count(), 2, "{moved}");
    }
    let short = b"G90 G0 X0 Y0 Z0\nG3 X0.105 Y0 R0.05 F100\n";
    assert!(compensated("", short).is_err());
}
