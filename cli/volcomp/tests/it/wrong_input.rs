//! Wrong calls and broken files: status 2, a message, nothing on standard output.

use std::{fs, path::Path};

use crate::{Folder, contains, refuse_each, refused, refuses, root, volcomp};

const GANTRY: &str = "examples/gantry.toml";

/// A call and a part of its message; `$m` is the machine, `$axis` a positioning test.
const WRONG_CALLS: &str = "
error $m --at Q=1 => found axis `Q`
error $m --at A=1 => has no axis A
error $m --at X=1,X=2 => axis X appears twice
error $m --at X=nan => found `X=nan`, expected a finite number
error $m --at X=inf => expected a finite number
error $m --at X => found `X`, expected X=100
error $m --at X=1,Y => found `Y`, expected X=100
error $m --at =5 => found `=5`, expected X=100
error $m => --at
error $m --at X=1 --approach X=0 => expected X=+ or X=-
error $m --at X=1 --model magic => expected exact, htm or twist
error $m --at X=1 --temperature bed=20 => expected one of: scale_x
error $m --at X=1 --temperature scale_x=hot => expected a finite number
error $m --at X=1 --temperature scale_x=-300 => found `scale_x=-300`, expected -200 to 850 °C
error $m --at X=1 --temperature scale_x=1e308 => found `scale_x=1e308`, expected -200 to 850 °C
error $m --at X=1 --temperature scale_x=1000.1 => found `scale_x=1000.1`, expected -200 to 850 °C
fit-thermal no.csv --reference -300 => --reference: found -300, expected -200 to 850 °C
error $m --at X=1 --tool T9 => has no tool `T9`
error -m nowhere.toml --at X=1 => nowhere.toml: cannot be read
error -m examples --at X=1 => examples: cannot be read
correct $m --at X=1 --correct X,X => each once
diagonals $m --points 1 => --points
map $m --grid 21x21 => expected three counts
map $m --grid 0x1x1 => expected three counts
map $m --grid 3x3x3 -o m.doc => expected .csv, .vti, .vtr
map $m --grid 3x3x3 -o nowhere/m.csv => cannot be written
map $m --grid 3x3x3 -o examples => expected .csv, .vti, .vtr
iso230 nowhere.csv => nowhere.csv: cannot be read
form nowhere.csv --feature circle => nowhere.csv: cannot be read
form examples/mill-moves.csv --feature sphere => --feature
form examples/ring.csv --feature cone => examples/ring.csv: cone: found points in one plane, expected points around the axis
form examples/bore.csv --feature cylinder --plane xy => --plane: found another feature, expected --feature circle or line
form examples/bore.csv --feature plane --datum 0,0,0,0,0,1 => --datum: found --feature plane, expected a feature with an axis or a centre
form examples/bore.csv --feature cylinder --datum 0,0,0 => --datum: found `0,0,0`, expected six finite numbers
form examples/bore.csv --feature cylinder --datum 1,2,3,0,0,0 => --datum: datum axis: found the direction 0,0,0
iso230 examples => examples
iso230 $axis --part 9 => --part
fit $axis --method poly --order 9 => iso230-2-axis.csv
fit $axis --method poly --auto => --method mls
fit $axis --method bspline --scan => --scan: found another method, expected --method mls
fit $axis --method mls --support 50 => support is 50: expected a share of the measured range, above 0 and at most 1
calibrate nowhere.toml -o m.toml => nowhere.toml: cannot be read
unknown => unknown
 => Usage
";

#[test]
fn wrong_arguments_say_what_was_found_and_expected() {
    refuse_each(
        WRONG_CALLS,
        &[
            ("$m", &format!("-m {GANTRY}")),
            ("$axis", "fitting/metrology/tests/data/iso230-2-axis.csv"),
        ],
    );
    #[cfg(not(feature = "parquet"))]
    refuses(&format!("map -m {GANTRY} --grid 3x3x3 -o m.parquet"), "no Parquet");
}

fn written(folder: &Path, name: &str, bytes: &[u8]) -> String {
    let path = folder.join(name);
    fs::write(&path, bytes).expect("written");
    path.to_str().expect("UTF-8").to_owned()
}

#[test]
fn broken_files_are_named_with_their_line_unbroken() {
    let folder = tempfile::Builder::new()
        .prefix(&"a-folder-with-a-very-long-name-".repeat(5))
        .tempdir()
        .expect("a folder");
    let machine = fs::read_to_string(root().join(GANTRY)).expect("read");
    let broken = machine.replace("EC0Y = 12.0", "EC0Y = nan");
    let path = written(folder.path(), "machine.toml", broken.as_bytes());
    let message = refused(&["error", "-m", &path, "--at", "X=1"]);
    let place = format!("error: {path}:23: errors.EC0Y: found nan, expected a finite number\n");
    assert_eq!(message, place);
    for (name, bytes, expected) in [
        ("points.csv", &b"P,Q\n1,2\n"[..], "found no axis letter"),
        ("points.csv", b"X,Y\n1,2\n1,nan\n", "points.csv:3: Y: found `nan`"),
        ("points.csv", b"X,Y\n1\n", "points.csv"),
        ("points.csv", b"", "points.csv"),
        ("points.csv", b"X,X\n1,2\n", "column `X` appears twice"),
        ("points.csv", b"X,A\n1,2\n", "has no axis A"),
    ] {
        let path = written(folder.path(), name, bytes);
        refuses(&["error", "-m", GANTRY, "--points", &path], expected);
    }
    for (name, bytes) in [
        ("a.csv", &b"target,run,direction,deviation\n1,1,+,nan\n"[..]),
        ("a.csv", b"target,run,direction,deviation\n1,1,sideways,3\n"),
        ("a.csv", b""),
        ("a.rtl", b""),
        ("a.rtl", b"HEADER::\r\nFile type  : rtl\r\n"),
        ("a.doc", b"1"),
    ] {
        let path = written(folder.path(), name, bytes);
        refuses(&["iso230", &path], name);
    }
    let path = written(folder.path(), "circle.csv", b"");
    let file = fs::File::create(&path).expect("writable");
    file.set_len(1 << 40).expect("a sparse file");
    let call = ["iso230", &path, "--part", "4", "--radius-mm", "150"];
    refuses(&call, "circle.csv: cannot be read: found more than 256 MiB");
}

#[test]
fn a_disk_that_fills_up_leaves_nothing_behind() {
    // Writing to /dev/full fails.
    let Ok(full) = fs::OpenOptions::new().write(true).open("/dev/full") else {
        panic!("this system has no /dev/full");
    };
    let status = std::process::Command::new(env!("CARGO_BIN_EXE_volcomp"))
        .args(["error", "-m", GANTRY, "--at", "X=1"])
        .current_dir(root())
        .stdout(full)
        .status()
        .expect("the program was built for this test");
    assert_eq!(status.code(), Some(1));
}

#[test]
fn an_output_is_opened_before_the_work_starts() {
    // 10^9 nodes would take minutes, so the call must fail before the computation.
    refuses(
        "map -m examples/gantry.toml --grid 1000x1000x1000 -o nowhere/m.csv",
        "nowhere/m.csv: cannot be written",
    );
    assert_eq!(volcomp(&["--version"]).status.code(), Some(0));
}

#[test]
fn options_of_a_fit_that_have_no_effect_are_refused() {
    let folder = Folder::new();
    let path = folder.file("m.csv");
    let rows: Vec<String> = (0..12).map(|row| format!("{},{}\n", 10 * row, row % 5)).collect();
    let rows = rows.concat();
    std::fs::write(&path, format!("target_mm,deviation_um\n{rows}")).expect("written");
    for (options, expected) in [
        (&["mls", "--auto", "--order", "9"][..], "--order"),
        (&["mls", "--auto", "--support", "0.5"][..], "--support"),
        (
            &["poly", "--support", "0.5"][..],
            "--support: found another method, expected --method mls",
        ),
        (
            &["chebyshev", "--shape", "2"][..],
            "--shape: found another method, expected --method mls",
        ),
        (&["bspline", "--order", "3"][..], "--order: found --method bspline"),
        (&["auto", "--order", "3"][..], "--order"),
        (&["poly", "--residual", "1"][..], "--residual"),
    ] {
        let message = refused(&[&["fit", &path, "--method"], options].concat());
        assert!(message.contains(expected), "{options:?}: {message}");
    }
    for options in [
        &["mls", "--order", "2", "--support", "0.5", "--shape", "2"][..],
        &["mls", "--auto", "--shape", "2", "--scan"][..],
        &["poly", "--order", "3"][..],
        &["bspline"][..],
        &["table"][..],
        &["auto", "--residual", "5"][..],
    ] {
        let output = volcomp(&[&["fit", &path, "--method"], options].concat());
        assert_eq!(output.status.code(), Some(0), "{options:?}: {output:?}");
    }
}

#[test]
fn a_mistyped_command_is_told_no_hidden_one() {
    for (typed, meant) in [("chek", "check"), ("schem", "")] {
        let output = volcomp(&[typed]);
        assert_eq!(output.status.code(), Some(2));
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!said.contains("'schema'"), "{said}");
        contains(&said, &format!("'{meant}"));
    }
}
