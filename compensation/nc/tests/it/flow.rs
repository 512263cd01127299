//! Program flow: O-words, subroutines in the program and in separate files.
//!
//! Calls with equal corrections are copied, others are unrolled.

use std::{fs, path::PathBuf};

use volcomp_nc::{NcError, SetUp};
use volcomp_test_support::cases;

use crate::identity::{compensated, compensated_in, has, text_in};

pub(crate) fn text(errors: &str, program: &str) -> String {
    text_in("", errors, program).expect("compensated").0
}

const PROGRAM: &str = "\
O100 sub (a square)
  G91 G1 F200 X[#1]
  Y#1
  X-#1
  Y-#1
  G90
O100 endsub
G90 G0 X0 Y0 Z0
O100 call [10]
#5=0
O101 while [#5 LT 3]
  G0 X[#5*100] Y0
  O100 call [10]
  #5=[#5+1]
O101 endwhile
O102 if [#5 EQ 3]
G0 Z5
O102 else
G0 Z9
O102 endif
M2
";

#[test]
fn without_errors_nothing_changes() {
    assert_eq!(text("", PROGRAM), PROGRAM);
    let constant = "[errors]\nEXX = { poly = [10.0] }\n";
    // Each position has one correction in all passes, so the loop is copied.
    let out = text(constant, "O1 repeat [3]\nG91 G0 X10\nO1 endrepeat\nM2\n");
    assert_eq!(out, "O1 repeat [3]\nG91 G0 X10\nO1 endrepeat\nM2\n");
}

#[test]
fn calls_with_different_corrections_are_unrolled() {
    let scale = "[errors]\nEXX = { poly = [0.0, 0.1] }\n";
    let out = text(scale, PROGRAM);
    assert_eq!(
        out,
        "\
O100 sub (a square)
  G91 G1 F200 X9.999
  Y#1
  X-9.999
  Y-#1
  G90
O100 endsub
G90 G0 X0 Y0 Z0
O100 call [10]
#5=0
;O101 while [#5 LT 3]
;  G0 X[#5*100] Y0
;  O100 call [10]
;  #5=[#5+1]
;O101 endwhile
  G0 X0 Y0
  G91 G1 F200 X9.999
  Y10
  X-9.999
  Y-10
  G90
  #5=[#5+1]
  G0 X99.990 Y0
  G91 G1 F200 X9.999
  Y10
  X-9.999
  Y-10
  G90
  #5=[#5+1]
  G0 X199.980 Y0
  G91 G1 F200 X9.999
  Y10
  X-9.999
  Y-10
  G90
  #5=[#5+1]
O102 if [#5 EQ 3]
G0 Z5
O102 else
G0 Z9
O102 endif
M2
"
    );
}

#[test]
fn unbalanced_o_words_are_reported() {
    for [program, expected] in &cases(
        r"
O1 while [1]\nG4 P1\nO1 endwhile\n | line 2: more than 1000000 blocks are executed (a loop without an end?); --max-blocks allows more
O1 while [1]\n | line 1: the block that begins here does not end in the program
O1 endif\n | line 1: o1 ends or continues a block here that did not begin before or that contains an unfinished one
O1 call\n | line 1: the subroutine o<1> is neither in this program nor as 1.ngc in a folder of --subroutines
O1 sub\nO1 call\nO1 endsub\nO1 call\n | line 2: more than 100 subroutines call one another
O1 if [#5061 GT 0]\nO1 endif\n | line 1: which lines are executed after this one is only known at the machine
O1 break\n | line 1: there is no loop o1 around this line
O1 nothing\n | line 1: expected a word such as sub, call, while, if or repeat after the name of an O-word
",
    ) {
        let error = compensated("", program.as_bytes()).expect_err("refused");
        assert_eq!(&error.to_string(), expected);
    }
}

/// Numbered subprograms of FANUC controls, after the end of the main program.
const BY_NUMBER: &str = "\
%
O0001 (main)
G21 G90 G0 X100 Y0 Z0
M98 P1000 L3
G90 G0 Z50
N70 M98 P21000
M30
O1000 (one step)
G91 G1 X100 F500
G90
M99
%
";

#[test]
fn numbered_subprograms_are_executed() {
    assert_eq!(text("", BY_NUMBER), BY_NUMBER);
    // A constant error: G0 has applied the correction already, so all calls are equal.
    let constant = "[errors]\nEXX = { poly = [10.0] }\n";
    let out = text(constant, BY_NUMBER);
    assert_eq!(out, BY_NUMBER.replace("G0 X100 Y0 Z0", "G0 X99.990 Y0 Z0"));
    // A growing error, 1e-4·x² µm: 16 at X = 400, 36 at X = 600. The steps of 100 mm differ, so the calls are unrolled; the subprogram
    // stays after the end.
    let growing = "[errors]\nEXX = { poly = [0.0, 0.0, 1e-4] }\n";
    let out = text(growing, BY_NUMBER);
    let (main, behind) = out.split_once("M30\n").expect("an end");
    assert_eq!(BY_NUMBER.split_once("M30\n").expect("an end").1, behind);
    let comments: Vec<&str> = main.lines().filter(|line| line.starts_with('(')).collect();
    assert_eq!(comments, ["(M98 P1000 L3)", "(N70 M98 P21000)"]);
    let ways = |text: &str| -> f64 {
        let words = text.split([' ', '\n']).filter_map(|word| word.strip_prefix('X'));
        words.map(|word| word.parse::<f64>().expect("a number")).sum()
    };
    let (before, after) = main.split_once("(N70").expect("two calls");
    assert!((ways(before) - 399.984).abs() < 1e-9, "{out}");
    assert!((ways(after) - 199.980).abs() < 1e-9, "{out}");
    assert_eq!(main.matches("G91 G1").count(), 5);
}

#[test]
fn invalid_subprograms_are_refused() {
    let refused = |program: &str| {
        let error = compensated("", program.as_bytes()).expect_err(program);
        error.to_string()
    };
    for (program, line, expected) in [
        (
            "M98 P7\nM30\n",
            1,
            "the program O7 is neither in this file nor in a file such as O0007 or 7.nc",
        ),
        ("G0 X0\nM99\n", 2, "M99 in the main program would repeat it endlessly"),
        ("M98 P7\nM30\nO7\nM98 P7\nM99\n", 4, "call one another"),
        ("M98 P7\nM30\nO7\nM99\nO7\nM99\n", 5, "is defined twice"),
        ("G0 X0 M98 P7\nM30\nO7\nM99\n", 1, "must be alone in their line"),
    ] {
        let message = refused(program);
        assert!(
            message.contains(expected) && message.contains(&format!("line {line}:")),
            "{message}"
        );
    }
    let none = "M98 P7 L0\nM30\nO7\nG1 X900\nM99\n";
    assert_eq!(text("", none), none);
}

#[test]
fn a_return_ends_the_loops_it_leaves() {
    let bent = "[errors]\nEXX = { poly = [0.0, 0.0, 0.001] }\n";
    let plain = "o1 sub\nG91 G1 X100 F1\no1 endsub\nG90 G0 X0 Y0 Z0\no3 repeat [2]\no1 call\no3 endrepeat\nM2\n";
    let left = plain
        .replace("G91 G1 X100 F1\n", "o2 repeat [3]\nG91 G1 X100 F1\no1 return\no2 endrepeat\n");
    let motions = |program: &str| -> Vec<String> {
        let result = text(bent, program);
        let lines = result.lines().filter(|line| line.starts_with("G91 G1"));
        lines.map(str::to_owned).collect()
    };
    assert_eq!(motions(&left)[1..], motions(plain)[1..]);
    assert_eq!(motions(plain).len(), 3, "the subroutine, and both of its passes");
    let program =
        "G90 G0 X0 Y0 Z0\nM98 P7 L2\nM30\nO7\no2 repeat [3]\nG91 G0 X100\nM99\no2 endrepeat\nM99\n";
    let result = text(bent, program);
    has(&result, "X99.990");
    has(&result, "X99.970");
}

#[test]
fn words_with_g69_are_a_motion() {
    let scale = "[errors]\nEXX = { poly = [0.0, 0.1] }\n";
    assert_eq!(
        text(scale, "G0 X0 Y0\nG69 G1 X300 F1\nX100\n"),
        "G0 X0 Y0\nG69 G1 X299.970 F1\nX99.990\n"
    );
    let error =
        compensated("", b"G0 X0\nG91 G81 X10 Z-5 R-2 K5\n").expect_err("refused").to_string();
    assert!(error.starts_with("line 2: a cycle with K"), "{error}");
}

/// Loops with `break` and `continue` run as in LinuxCNC's interpreter. Where they leave state that changes a later loop, the program is
/// refused.
#[test]
fn loops_left_early() {
    let motions = |program: &str| {
        let done = compensated("", program.as_bytes());
        done.map(|(_, summary)| summary.counts.motions)
    };
    let says = |program: &str, line: &str| {
        let message = motions(program).expect_err(program).to_string();
        assert!(message.starts_with(line), "{program}{message}");
    };
    let while_left = "o1 while [1 eq 1]\nG0 X1\no1 break\nG0 X2\no1 endwhile\n";
    let do_left = "o3 do\n#5=[#5+1]\nG0 Y1\no3 continue\nG0 Y2\no3 while [#5 lt 2]\n";
    let twice = "o2 repeat [2]\nG0 Z1\no2 endrepeat\n";
    // rs274 executes a later do … while loop once instead of three times.
    let three = "#5=0\no4 do\n#5=[#5+1]\nG0 Y1\no4 while [#5 lt 3]\n";
    assert_eq!(motions(&format!("{while_left}{twice}")).ok(), Some(3));
    says(
        &format!("{while_left}{three}"),
        "line 10: LinuxCNC ends this loop here, whatever its condition is, since the break of line 3",
    );
    // The same holds if the break is not executed and the loop ends by its condition.
    let passed =
        "#5=0\no1 while [#5 lt 2]\n#5=[#5+1]\no2 if [#5 eq 9]\no1 break\no2 endif\no1 endwhile\n";
    says(&format!("{passed}{three}"), "line 12: LinuxCNC ends this loop here");
    let in_own = "o4 do\n#5=[#5+1]\nG0 Y1\no4 continue\no4 break\no4 while [#5 lt 3]\n";
    says(in_own, "line 6: LinuxCNC ends this loop here");
    // A loop with a single pass clears the pending break.
    let once = three.replace("lt 3", "lt 0").replace("o4", "o5");
    assert_eq!(motions(&format!("{while_left}{once}{three}")).ok(), Some(5));
    let broken = "o4 do\nG0 Y1\no4 break\nG0 Y2\no4 while [1 eq 1]\n";
    assert_eq!(motions(&format!("{broken}{three}").replacen("o4", "o6", 3)).ok(), Some(4));
    // A continue in do … while: rs274 executes the next counted loop twice, and continues one that was left.
    assert_eq!(motions(do_left).ok(), Some(2));
    says(
        &format!("{do_left}{twice}"),
        "line 9: LinuxCNC repeats all passes of this loop, since the continue of line 4",
    );
    says(
        &format!("{do_left}{while_left}"),
        "line 9: LinuxCNC continues the loop here, since the continue of line 4",
    );
    let no_more = "o7 while [0 eq 1]\nG0 X9\no7 endwhile\n";
    assert_eq!(motions(&format!("{do_left}{no_more}{twice}")).ok(), Some(4));
    // A counted loop that was left has fewer passes later: one in the first call, and two instead of three in the second.
    let sub = "o1 sub\no2 repeat [3]\nG0 X1\no3 if [#100 eq 0]\n#100=1\no1 return\no3 endif\no2 endrepeat\no1 endsub\n#100=0\no1 call\n";
    assert_eq!(motions(sub).ok(), Some(1));
    says(&format!("{sub}o1 call\n"), "line 8: this loop was left before its last pass");
    for word in ["break", "continue"] {
        let counted = format!("o2 repeat [2]\no2 {word}\no2 endrepeat\n");
        says(
            &counted,
            "line 2: break and continue of a loop with a count (repeat), which LinuxCNC refuses",
        );
    }
    // Counts are rounded to the nearest integer, halves to even.
    for (times, done) in [("2.5", 2), ("1.5", 2), ("0.6", 1), ("0.5", 0), ("-2", 0)] {
        let program = format!("o2 repeat [{times}]\nG0 Z1\no2 endrepeat\n");
        assert_eq!(motions(&program).ok(), Some(done), "{times}");
    }
}

const SCALE: &str = "[errors]\nEXX = { poly = [0.0, 0.1] }\n";

fn folder(name: &str, files: &[(&str, &str)]) -> PathBuf {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("subroutines-{name}"));
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).expect("a folder");
    for (name, text) in files {
        fs::write(folder.join(name), text).expect("a file");
    }
    folder
}

fn with_files(errors: &str, program: &str, folders: Vec<PathBuf>) -> Result<String, NcError> {
    let setup = SetUp::default().with_subroutines(folders);
    let (out, _) = compensated_in(&setup, errors, program.as_bytes())?;
    Ok(String::from_utf8(out).expect("text"))
}

const SQUARE: &str =
    "(a square)\no<square> sub\nG91 G1 X#1 F100\nY#1\nX-#1\nY-#1\nG90\no<square> endsub\nM2\n";
const CALLS: &str = "G90 G0 X0 Y0 Z0\no<square> call [100]\nG0 X50\no<Square> call [10]\nM2\n";

#[test]
fn an_uncorrected_call_is_copied() {
    let files = folder("stays", &[("square.ngc", SQUARE)]);
    assert_eq!(with_files("", CALLS, vec![files]).expect("taken"), CALLS);
}

#[test]
fn a_corrected_call_is_unrolled() {
    let files = folder("written", &[("square.ngc", SQUARE)]);
    let result = with_files(SCALE, CALLS, vec![files]).expect("taken");
    let inside = text(SCALE, &(SQUARE.replace("M2\n", "").replace("(a square)\n", "") + CALLS));
    let behind = inside.split("endsub\n").nth(1).expect("what is behind it");
    assert_eq!(result, behind);
    assert!(result.contains(";o<square> call [100]\n"), "{result}");
    assert!(result.contains("X99.990"), "{result}");
}

#[test]
fn files_call_each_other_and_have_local_subroutines() {
    let outer = "o<outer> sub\no1 call [#1]\no<inner> call [#1]\no<outer> endsub\no1 sub\nG1 X#1 F1\no1 endsub\n";
    let inner = "o<inner> sub\no1 call\no<inner> endsub\no1 sub\nG1 Y1\no1 endsub\n";
    let first = folder("first", &[("outer.ngc", outer)]);
    let second = folder("second", &[("INNER.ngc", inner), ("outer.ngc", "not this one")]);
    let program = "o1 sub\nG1 Z5 F1\no1 endsub\nG0 X0 Y0 Z0\no<outer> call [100]\no1 call\nM2\n";
    let folders = vec![first, second];
    assert_eq!(with_files("", program, folders.clone()).expect("taken"), program);
    let result = with_files(SCALE, program, folders).expect("taken");
    assert_eq!(
        result,
        "o1 sub\nG1 Z5 F1\no1 endsub\nG0 X0 Y0 Z0\n;o<outer> call [100]\nG1 X99.99 F1\nG1 Y1\no1 call\nM2\n".replace("99.99 ", "99.990 ")
    );
}

#[test]
fn files_of_numbered_programs() {
    let text = "%\nO1000 (holes)\nG91 G1 X100 F100\nG90\nM99\n%\n";
    let program = "G0 X0 Y0\nM98 P1000 L2\nM98 P2\nM30\n";
    for name in ["O1000", "o1000.NC", "1000.ngc"] {
        let files = folder("numbers", &[(name, text), ("0002.nc", "G1 Y7\nM99\n")]);
        assert_eq!(with_files("", program, vec![files.clone()]).expect("taken"), program);
        assert_eq!(
            with_files(SCALE, program, vec![files]).expect("taken"),
            "G0 X0 Y0\n(M98 P1000 L2)\nG91 G1 X99.990 F100\nG90\nG91 G1 X99.990 F100\nG90\nM98 P2\nM30\n"
        );
    }
}

#[test]
fn a_file_of_a_gibibyte_is_not_read_to_its_end() {
    let files = folder("long", &[("a.ngc", "")]);
    let file = fs::File::create(files.join("a.ngc")).expect("writable");
    file.set_len(1 << 30).expect("a sparse file");
    let error = with_files(SCALE, "o<a> call\n", vec![files]).expect_err("too long").to_string();
    assert!(error.contains("a.ngc: line 1: the files of subroutines are longer than"), "{error}");
}

#[test]
fn errors_name_the_file_and_line() {
    let files = |text: &str| folder("wrong", &[("a.ngc", text), ("O0007", text)]);
    let cases = [
        (
            "o<a> sub\nG1 X1 X2\no<a> endsub\n",
            "o<a> call\n",
            "a.ngc: line 2: found X and X in one block, expected only one of them",
        ),
        (
            "o<a> sub\nG1 X1\n",
            "o<a> call\n",
            "a.ngc: line 1: the block that begins here does not end in the program",
        ),
        (
            "o<b> sub\no<b> endsub\n",
            "o<a> call\n",
            "line 1: the subroutine o<a> is neither in this program nor as a.ngc in a folder of --subroutines",
        ),
        (
            "o<a> sub\no<c> call\no<a> endsub\n",
            "o<a> call\n",
            "a.ngc: line 2: the subroutine o<c> is neither",
        ),
        (
            "o<a> sub\no<a> call\no<a> endsub\n",
            "o<a> call\n",
            "a.ngc: line 2: more than 100 subroutines call one another",
        ),
        ("G1 X1 F1\n", "M98 P7\nM30\n", "O0007: line 1: the subprogram ends here without M99"),
        ("G0 X1\0", "M98 P7\nM30\n", "O0007: line 1: byte 0x00 at column 6; this is no NC program"),
    ];
    for (file, program, expected) in cases {
        let error = with_files("", program, vec![files(file)]).expect_err(expected).to_string();
        let error = error.rsplit('/').next().unwrap_or_default();
        assert!(error.starts_with(expected), "{error}");
    }
    let nowhere = PathBuf::from("no such folder");
    let error = with_files("", "o<a> call\n", vec![nowhere]).expect_err("none").to_string();
    assert!(error.starts_with("no such folder: "), "{error}");
}
