use crate::identity::compensated;

fn text(errors: &str, program: &str) -> String {
    let (out, _) = compensated(errors, program.as_bytes()).expect("compensated");
    String::from_utf8(out).expect("text")
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
    let program = b"G90 G0 Z100\nG91 G2 X10 Y0 I5 J0\nG1 Z-50\n";
    let (out, _) = crate::identity::compensated(scale, program).expect("compensated");
    assert_eq!(
        String::from_utf8(out).expect("text"),
        "G90 G0 Z99.990\nG91 G2 X10 Y0 I5 J0\nG1 Z-49.995\n"
    );
}

/// If the start of an arc lacks its correction, a line before the arc applies it.
#[test]
fn a_correction_is_taken_up_before_an_arc() {
    let shift = "[errors]\nEXX = { poly = [20.0] }\n";
    // After G53 the program position is known only with the work offset.
    let setup = volcomp_nc::SetUp::parse("[work_offset.G54]\nX = 0\n", "s.toml").expect("good");
    let arc = |line: &str| {
        let program = format!("G90 G0 X0 Y0 Z0\nG53 G0 X0\n{line}\n");
        let (out, _) = crate::identity::compensated_in(&setup, shift, program.as_bytes())
            .expect("compensated");
        String::from_utf8(out).expect("text").lines().skip(2).map(str::to_owned).collect::<Vec<_>>()
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
