//! Subroutines in separate files are called, or unrolled if they are corrected.

use std::{fs, path::PathBuf};

use volcomp_nc::{NcError, SetUp};

use crate::{flow, identity::compensated_in};

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

fn compensated(errors: &str, program: &str, folders: Vec<PathBuf>) -> Result<String, NcError> {
    let setup = SetUp::default().with_subroutines(folders);
    let (out, _) = compensated_in(&setup, errors, program.as_bytes())?;
    Ok(String::from_utf8(out).expect("text"))
}

const SQUARE: &str =
    "(a square)\no<square> sub\nG91 G1 X#1 F100\nY#1\nX-#1\nY-#1\nG90\no<square> endsub\nM2\n";
const PROGRAM: &str = "G90 G0 X0 Y0 Z0\no<square> call [100]\nG0 X50\no<Square> call [10]\nM2\n";

#[test]
fn an_uncorrected_call_is_copied() {
    let files = folder("stays", &[("square.ngc", SQUARE)]);
    assert_eq!(compensated("", PROGRAM, vec![files]).expect("taken"), PROGRAM);
}

#[test]
fn a_corrected_call_is_unrolled() {
    let files = folder("written", &[("square.ngc", SQUARE)]);
    let result = compensated(SCALE, PROGRAM, vec![files]).expect("taken");
    let inside =
        flow::text(SCALE, &(SQUARE.replace("M2\n", "").replace("(a square)\n", "") + PROGRAM));
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
    assert_eq!(compensated("", program, folders.clone()).expect("taken"), program);
    let result = compensated(SCALE, program, folders).expect("taken");
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
        assert_eq!(compensated("", program, vec![files.clone()]).expect("taken"), program);
        assert_eq!(
            compensated(SCALE, program, vec![files]).expect("taken"),
            "G0 X0 Y0\n(M98 P1000 L2)\nG91 G1 X99.990 F100\nG90\nG91 G1 X99.990 F100\nG90\nM98 P2\nM30\n"
        );
    }
}

#[test]
fn a_file_of_a_gibibyte_is_not_read_to_its_end() {
    let files = folder("long", &[("a.ngc", "")]);
    let file = fs::File::create(files.join("a.ngc")).expect("writable");
    file.set_len(1 << 30).expect("a sparse file");
    let error = compensated(SCALE, "o<a> call\n", vec![files]).expect_err("too long").to_string();
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
        let error = compensated("", program, vec![files(file)]).expect_err(expected).to_string();
        let error = error.rsplit('/').next().unwrap_or_default();
        assert!(error.starts_with(expected), "{error}");
    }
    let nowhere = PathBuf::from("no such folder");
    let error = compensated("", "o<a> call\n", vec![nowhere]).expect_err("none").to_string();
    assert!(error.starts_with("no such folder: "), "{error}");
}
