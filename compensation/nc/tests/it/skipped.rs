//! Blocks with a slash: the result is right whether the operator has them skipped or not.

use crate::{flow::text, identity::compensated};

use crate::identity::{begins, has};

/// The places that a program of plain words leads to, with its blocks with a slash executed or not.
fn ends(program: &str, skips: bool) -> [f64; 3] {
    let mut at = [0.0; 3];
    for line in program
        .lines()
        .filter(|line| !(skips && line.starts_with('/')))
    {
        for word in line.trim_start_matches('/').split(' ') {
            let axis = "XYZ".find(|letter| word.starts_with(letter));
            if let Some(axis) = axis {
                at[axis] = word[1..].parse().expect("a number");
            }
        }
    }
    at
}

#[test]
fn no_axis_is_led_where_a_skipped_block_would_have() {
    let square = "[errors]\nEC0Y = 200.0\nEZX = { poly = [0.0, 0.1] }\n";
    for program in [
        "G0 X10 Y10 Z5\nG1 Z-5 F100\n/Z-25\nX120 Y60\n",
        "G0 X10 Y10 Z5\n/G1 X100 F100\nG1 Y50 F100\n",
        "G0 X10 Y10 Z5\nG81 X20 Z-5 R2 F10\n/X40\nY30\n",
        "G0 X10 Y10 Z5\n/Z50\n/X200\nY0\nX0 Z1\nY100\n",
    ] {
        let result = text(square, program);
        for skips in [false, true] {
            let (wanted, found) = (ends(program, skips), ends(&result, skips));
            for axis in 0..3 {
                assert!(
                    (wanted[axis] - found[axis]).abs() < 0.1,
                    "{program}{result}"
                );
            }
        }
    }
}

#[test]
fn no_way_is_split_that_may_begin_elsewhere() {
    let bent = "[errors]\nEYX = { poly = [0.0, 0.0, 0.001] }\n";
    let result = text(bent, "G0 X0 Y0 Z0\n/X500\nG1 X-500 F100\nX500\n");
    let lines: Vec<&str> = result.lines().collect();
    assert!(lines[2].starts_with("G1 X-500"), "{result}");
    assert!(
        !lines[3].starts_with("X500"),
        "the way back is split: {result}"
    );
    // The same where the program does not say where it begins.
    let result = text(bent, "G0 Z0\nG1 X-500 Y0 F100\nX500\n");
    let second = result.lines().nth(1).expect("a line");
    assert!(second.starts_with("G1 X-500 Y"), "{result}");
    assert!(result.lines().count() > 3, "{result}");
}

#[test]
fn what_a_skipped_block_would_switch_is_refused() {
    for (block, line) in [
        ("/G91", 2),
        ("/G54", 2),
        ("/G20", 2),
        ("/G18 X1", 2),
        ("/G92 X0", 2),
        ("/#1=5", 2),
        ("/M30", 2),
        ("/G43 H1", 2),
        ("/G0 X5", 3),
    ] {
        let program = format!("G1 X0 Y0 Z0 F1\n{block}\nX10\n");
        let error = compensated("", program.as_bytes())
            .expect_err(block)
            .to_string();
        begins(&error, &format!("line {line}: a "));
        has(&error, "(/)");
    }
    for good in [
        "/M8",
        "/G4 P1",
        "/X5 F100",
        "/G1 X5",
        "/(nothing)",
        "/G0 Z5\nG1",
    ] {
        let program = format!("G1 X0 Y0 Z0 F1\n{good}\nG1 X10\n");
        let (out, _) = compensated("", program.as_bytes()).expect(good);
        assert_eq!(String::from_utf8_lossy(&out), program);
    }
}
