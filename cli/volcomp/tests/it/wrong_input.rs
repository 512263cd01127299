//! Wrong calls, files, units and numbers.
//!
//! The exit status is 2, the message names what was found and the likely intention, nothing is on standard output, and
//! no file is written.

use std::{fs, path::Path};

use serde_json::{Value, json};

use crate::{
    Folder, contains, json, list, one_line, refuse_each, refused, refuses, root, text, volcomp,
    words,
};

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
    let rows: Vec<String> = (0..12).map(|row| format!("{},{}\n", 10 * row, row % 5)).collect();
    let rows = rows.concat();
    let path = folder.write("m.csv", format!("target_mm,deviation_um\n{rows}"));
    let calls = "
fit $file --method mls --auto --order 9 => --order
fit $file --method mls --auto --support 0.5 => --support
fit $file --method poly --support 0.5 => --support: found another method, expected --method mls
fit $file --method chebyshev --shape 2 => --shape: found another method, expected --method mls
fit $file --method bspline --order 3 => --order: found --method bspline
fit $file --method auto --order 3 => --order
fit $file --method poly --residual 1 => --residual
";
    refuse_each(calls, &[("$file", &path)]);
    for options in [
        "mls --order 2 --support 0.5 --shape 2",
        "mls --auto --shape 2 --scan",
        "poly --order 3",
        "bspline",
        "table",
        "auto --residual 5",
    ] {
        text(&format!("fit {path} --method {options}"));
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

const FIRST: &str = "examples/first.toml";

#[test]
fn a_file_of_another_kind_is_named() {
    let folder = Folder::new();
    let blob = folder.file("m.blob");
    json(&["compile", FIRST, "-o", &blob]);
    let calls = "
check examples/calibration/calibration.toml => found a calibration file (it has the key `measurement`), expected a machine file
check examples/gateway.toml => found a configuration of the gateway
check examples/calibration/shop.toml => found a shop file
check examples/temperature-module.toml => found a profile of a Modbus module
check examples/calibration/exx.csv => expected TOML: `key = value` or `[table]`
check $blob => found a compiled machine (volcomp compile)
check $program => is not UTF-8
check examples => examples: cannot be read
calibrate $first -o $out => found a machine file (it has the key `structure`), expected a calibration file
simulate $first -o $out => expected a shop file
identify $first -o $out => expected a file of observations
calibrate examples/calibration/shop.toml -o $out => found a shop file
";
    refuse_each(
        calls,
        &[
            ("$blob", &blob),
            ("$program", env!("CARGO_BIN_EXE_volcomp")),
            ("$first", FIRST),
            ("$out", &folder.file("out")),
        ],
    );
}

#[test]
fn a_file_that_is_read_is_not_written_over() {
    let folder = Folder::new();
    let machine = folder.path().join("machine.toml");
    let file = machine.display().to_string();
    let good = fs::read_to_string(root().join(FIRST)).expect("read");
    fs::write(&machine, &good).expect("written");
    for call in [
        &["compile", &file, "-o", &file][..],
        &["correct", "-m", &file, "--at", "X=1", "-o", &file],
    ] {
        refuses(call, "expected another one to write");
        assert_eq!(fs::read_to_string(&machine).expect("read"), good);
    }
    let points = folder.write("points.csv", "X\n1\n");
    refuses(
        &["correct", "-m", &file, "--points", &points, "-o", &points],
        "this is the file of --points, expected another one to write",
    );
    assert_eq!(fs::read_to_string(&points).expect("read"), "X\n1\n");
}

/// Bytes that are not UTF-8 give the same message in every command, with file and position of the byte.
#[test]
fn bytes_that_are_not_utf_8_are_told_with_their_place() {
    let folder = Folder::new();
    let path = folder.path().join("latin.csv");
    fs::write(&path, b"time_s,spindle_degc,z_um\n0,20,\xb5\n").expect("written");
    let file = path.display().to_string();
    for call in
        [&["fit-thermal", &file][..], &["error", "-m", FIRST, "--points", &file], &["check", &file]]
    {
        let message = refused(call);
        let expected = format!("{file}: byte 30 is not UTF-8, expected a text file in UTF-8");
        assert!(message.contains(&expected), "{call:?}: {message}");
    }
}

/// Mistakes that the message table of volcomp-model does not cover.
#[test]
fn slips_in_a_machine_file_are_told_with_what_was_meant() {
    let folder = Folder::new();
    let good = fs::read_to_string(root().join(FIRST)).expect("read");
    for (from, to, expected) in [
        ("EC0Y = 12.0", "ec0y = 12.0", "found `ec0y`, expected upper-case letters: `EC0Y`"),
        ("[axes.X]", "[axes.x]", "found `x`, expected an upper-case letter: `X`"),
        (
            "travel = [0.0, 1000.0]",
            "travel = [0,0, 1000,0]",
            "found an array of 4, expected an array of 2 numbers; a number has a decimal point",
        ),
    ] {
        let file = folder.write("machine.toml", good.replacen(from, to, 1));
        refuses(&format!("check {file}"), expected);
    }
    refuses(
        &format!("check {FIRST} --tool T1"),
        "has no tool `T1`, and its file states none in [tools]",
    );
}

/// Writes `examples/mill.toml` with `line` in place of the line of the same key (EXX or EC0Y). Returns the path.
fn mill(folder: &Path, name: &str, line: &str) -> String {
    let text = fs::read_to_string(root().join("examples/mill.toml")).expect("the example");
    let key = line.split(' ').next().expect("a key");
    let lines =
        text.lines().map(|old| if old.starts_with(&format!("{key} =")) { line } else { old });
    let path = folder.join(name);
    fs::write(&path, lines.collect::<Vec<_>>().join("\n")).expect("written");
    path.to_str().expect("a path in UTF-8").to_owned()
}

fn said(output: &std::process::Output) -> String {
    String::from_utf8_lossy(&output.stderr).split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn a_slip_of_units_writes_no_program_and_no_table() {
    let folder = Folder::new();
    let machine = mill(folder.path(), "slip.toml", "EXX = { poly = [0.0, 20] }");
    let result = folder.file("result");
    for (call, limit) in [
        ("nc examples/part.ngc --setup examples/setup.toml --limit-um 2000", 2000),
        ("nc examples/part.mpf --setup examples/setup.toml", 250),
        ("export --format csv", 250),
    ] {
        let output = volcomp(&format!("{call} -m {machine} -o {result}"));
        assert_eq!(output.status.code(), Some(2), "{call}: {output:?}");
        let said = said(&output);
        assert!(
            said.contains(&format!("expected at most {limit} µm"))
                && said.ends_with("or allow more with --limit-um"),
            "{said}"
        );
        assert!(!Path::new(&result).exists(), "{call}");
    }
    let checked = said(&volcomp(&["check", &machine]));
    contains(&checked, "WARNING: the correction of X reaches");
    contains(&checked, "more than the 2000 µm that no command and no gateway applies");
    // The correction of X is between the default limit of 250 µm and the maximum of `--limit-um`, 2000 µm.
    let machine = mill(folder.path(), "large.toml", "EXX = { poly = [0.0, 1] }");
    let checked = said(&volcomp(&["check", &machine]));
    contains(&checked, "more than the 250 µm that nc and export allow");
    let output = volcomp(&format!("export -m {machine} --format csv -o {result} --limit-um 700"));
    assert!(output.status.success(), "{output:?}");
    let checked = said(&volcomp(&["check", "examples/mill.toml"]));
    assert!(!checked.contains("WARNING"), "{checked}");
    // 11.5 µm/(m·K) over 8 m, with a correction of 48 µm at 20 °C.
    let checked = said(&volcomp(&["check", "examples/gantry.toml"]));
    let checked = one_line(&checked);
    contains(
        &checked,
        "the correction of X changes by up to 92.0 µm with each kelvin of the sensors: 2.1 K from 20 °C it may reach the 250 µm that nc and export allow",
    );
    // On a machine whose rotary axes correct, `nc` limits the effect of the correction at the tool.
    let text = "structure = \"w C' A' b X Y Z t\"\n[axes]\nX.travel = [-300.0, 300.0]\nY.travel = [-200.0, 200.0]\nZ.travel = [-150.0, 150.0]\nA.travel = [-110.0, -30.0]\nC.travel = [-180.0, 180.0]\n[errors]\nEXX = { poly = [0.0, 1] }\n";
    let machine = folder.path().join("rotary.toml");
    std::fs::write(&machine, text).expect("written");
    let checked = said(&volcomp(&["check", machine.to_str().expect("UTF-8")]));
    let checked = one_line(&checked);
    contains(&checked, "more than the 250 µm that export allows without --limit-um (nc bounds");
}

#[test]
fn limits_above_the_ceiling_are_refused() {
    for limit in ["0", "-5", "2001", "inf"] {
        let call = words("export -m examples/mill.toml --format csv -o x");
        let message = refused(&[&call[..], &["--limit-um", limit]].concat());
        let expected = format!("--limit-um: found {limit}, expected µm above 0, at most 2000");
        contains(&message, &expected);
    }
}

/// A number that overflows is rejected by every command with its position, in any key.
#[test]
fn numbers_that_overflow_are_refused_by_every_command() {
    let folder = Folder::new();
    for line in ["EC0Y = 1e308", "EXX = { poly = [0.0, 1e308] }", "EXX = { poly = [1e14, 1e14] }"] {
        let machine = mill(folder.path(), "m.toml", line);
        for call in [
            vec!["check", &machine],
            vec!["error", "-m", &machine, "--at", "X=100"],
            vec!["correct", "-m", &machine, "--at", "X=100"],
            vec!["diagonals", "-m", &machine],
            vec!["map", "-m", &machine, "--grid", "3x3x3"],
            vec!["dh", "-m", &machine],
        ] {
            let output = volcomp(&call);
            assert_eq!(output.status.code(), Some(2), "{call:?} {line}: {output:?}");
            assert!(output.stdout.is_empty(), "{call:?} {line}: {output:?}");
            let said = said(&output);
            contains(&said, "m.toml:");
            contains(&said, "expected");
        }
    }
}

const SHOP: &str = "cli/volcomp/demo/shop.toml";

fn keys(document: &Value) -> Vec<String> {
    match document {
        Value::Object(entries) => entries
            .iter()
            .flat_map(|(key, value)| std::iter::once(key.clone()).chain(keys(value)))
            .collect(),
        Value::Array(items) => items.iter().flat_map(keys).collect(),
        _ => Vec::new(),
    }
}

fn ending_in(document: &Value, unit: &str) -> Vec<String> {
    let all = keys(document).into_iter();
    all.filter(|key| key.ends_with(unit)).collect()
}

#[test]
fn angles_stand_under_keys_of_angles() {
    let folder = Folder::new();
    let lasers = folder.path().join("lasers");
    json(&["simulate", SHOP, "-o", &lasers.display().to_string()]);
    let file = |name: &str| lasers.join(name).display().to_string();

    let angles = json(&["iso230", &file("eay.rta")]);
    assert_eq!(angles["unit"], "urad");
    assert_eq!(ending_in(&angles, "_um"), Vec::<String>::new());
    let lengths = json(&["iso230", &file("exx.rtl")]);
    assert_eq!(lengths["unit"], "um");
    assert_eq!(ending_in(&lengths, "_urad"), Vec::<String>::new());
    // Lengths and angles have the same symbols, down to the readings of a target.
    let symbols = |document: &Value, unit: &str| -> Vec<String> {
        let keys = ending_in(document, unit).into_iter();
        let mut symbols: Vec<String> = keys.map(|key| key.replace(unit, "")).collect();
        symbols.sort();
        symbols.dedup();
        symbols
    };
    assert_eq!(symbols(&angles, "_urad"), symbols(&lengths, "_um"));
    assert!(symbols(&lengths, "_um").contains(&"A_forward".to_owned()));

    let machine = folder.file("m.toml");
    let answer = json(&["calibrate", &file("calibration.toml"), "-o", &machine]);
    for curve in list(&answer["curves"]) {
        let is_angular = curve["error"].as_str().is_some_and(|e| "ABC".contains(&e[1..2]));
        assert_eq!(is_angular, curve["unit"] == "urad", "{curve}");
    }

    // `--unit` states the unit of a file without a unit. It never turns angles into lengths.
    for (name, unit, found, expected) in
        [("eay.rta", "um", "µrad", "µm"), ("exx.rtl", "urad", "µm", "µrad")]
    {
        let message = refused(&["iso230", &file(name), "--unit", unit]);
        let said = format!("{name}: found deviations in {found}, expected {expected}");
        contains(&message, &said);
    }
    assert_eq!(json(&["iso230", &file("eay.rta"), "--unit", "urad"]), angles);
}

/// A file without a unit is read in the requested unit. Equal deviations in different units give the same evaluation.
#[test]
fn a_file_without_a_unit_is_read_in_the_one_that_is_asked_for() {
    let folder = Folder::new();
    let write = |factor: f64| {
        let rows = [[0.0, 1.5], [10.0, -2.25], [20.0, 4.0]].map(|[target, micro]| {
            let deviation = micro * factor;
            format!("{target},{deviation:?}\n")
        });
        let path = folder.path().join("plain.csv");
        fs::write(&path, format!("target,deviation\n{}", rows.concat())).expect("written");
        path.display().to_string()
    };
    let degree = std::f64::consts::PI / 180.0;
    for (unit, per_micro, answered) in [
        ("mm", 1e-3, "um"),
        ("um", 1.0, "um"),
        ("nm", 1e3, "um"),
        ("rad", 1e-6, "urad"),
        ("mrad", 1e-3, "urad"),
        ("urad", 1.0, "urad"),
        ("deg", 1e-6 / degree, "urad"),
        ("arcsec", 1e-6 / degree * 3600.0, "urad"),
    ] {
        let file = write(per_micro);
        let answer = json(&["iso230", "--unit", unit, &file]);
        assert_eq!(answer["unit"], answered);
        let range = answer[format!("E_forward_{answered}")].as_f64();
        assert!((range.expect("a number") - 6.25).abs() < 1e-9, "{unit}: {range:?}");
        let fit = json(&format!("fit --unit {unit} {file} --method poly --order 1"));
        assert!(!fit[format!("residual_{answered}")].is_null(), "{unit}: {fit}");
    }
    assert!(text(&["iso230", "--unit", "arcsec", &write(1.0)]).contains("all values in µrad"));
    // `--unit` may repeat the unit of the header. The unit is then applied once.
    let path = folder.path().join("stated.csv");
    fs::write(&path, "target,deviation mm\n0,0.001\n10,0.003\n20,0.006\n").expect("written");
    let stated = path.display().to_string();
    assert_eq!(json(&["iso230", "--unit", "mm", &stated]), json(&["iso230", &stated]));
    let message = refused(&["fit", "--unit", "um", &stated, "--method", "poly"]);
    let said = "stated.csv: found deviations in mm, expected µm (--unit um)";
    contains(&message, said);
}

/// A table of a spreadsheet with decimal commas and an unused column is read.
#[test]
fn tables_with_semicolons_and_decimal_commas_are_read() {
    let folder = Folder::new();
    let write = |name: &str, text: &str| {
        let path = folder.path().join(name);
        fs::write(&path, text).expect("written");
        path.display().to_string()
    };
    let plain = write("plain.csv", "target,deviation\n0,1.5\n10.5,2.25\n21,4\n");
    let comma = write(
        "comma.csv",
        "\u{feff}Target;Deviation;Operator\r\n0;1,5;AB\r\n10,5;2,25;AB\r\n21;4;AB\r\n",
    );
    let mut expected = json(&["iso230", "--unit", "urad", &plain]);
    assert_eq!(expected["E_forward_urad"], 2.5);
    let told = list(&expected["notes"]).clone();
    let all = expected["notes"].to_string();
    for said in [
        "3 targets over 21 mm: ISO 230-2:2014 asks for 5 at least",
        "1 run in a direction: ISO 230-2:2014 asks for 5",
        "A and R need at least two runs in a direction",
        "only one direction was run",
    ] {
        contains(&all, said);
    }
    let columns = json!("columns that are not read: Operator");
    expected["notes"] = [vec![columns], told].concat().into();
    assert_eq!(json(&["iso230", "--unit", "urad", &comma]), expected);
    assert!(text(&["iso230", &comma, "--unit", "urad"]).contains("all values in µrad"));
    let notes = |path: &str| json(&["iso230", path])["notes"].to_string();
    assert!(
        notes(&plain).contains("not stated, taken as µm")
            && !notes(&plain).contains("are they mm?")
    );
    let in_mm = write("mm.csv", "target,deviation\n0,0\n300,0.0061\n600,0.0119\n");
    assert!(notes(&in_mm).contains("are they mm?"));
    let stated = write("stated.csv", "target mm,deviation mm\n0,0\n300,0.0061\n600,0.0119\n");
    assert!(!notes(&stated).contains("deviations is not stated"));
    let mixed = write("mixed.csv", "target;deviation\n0;1,5\n1.234;2,25\n");
    refuses(
        &["inspect", &mixed],
        "mixed.csv:3: target: found `1.234`, expected a number with a decimal comma as in line 2",
    );
}
