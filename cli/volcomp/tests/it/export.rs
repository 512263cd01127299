//! `volcomp export`, `volcomp import` and `volcomp map-table`: files, results, round trip, and rejected calls.

use std::fs;

use serde_json::json;
use volcomp_model::Machine;
use volcomp_tables::Map;

use crate::{
    Folder, contains, float, json, list, refuse_each, refused, refuses, root, text, volcomp,
};

const GANTRY: &str = "examples/gantry.toml";
const MILL: &str = "examples/mill.toml";

fn folder() -> (Folder, String) {
    let folder = Folder::new();
    let path = folder.file("tables");
    (folder, path)
}

#[test]
fn from_a_machine_to_tables_and_back_to_curves() {
    let (folder, tables) = folder();
    let curves = folder.file("curves.toml");
    for format in ["csv", "siemens-840d"] {
        let answer = json(&format!(
            "export -m {MILL} --format {format} --step 25 --at X=0,Y=0,Z=0 -o {tables}"
        ));
        assert_eq!(answer["format"], format);
        // A table of X cannot contain the effect of the mill's pitch, which grows with Z. This loss is smaller than the
        // correction.
        let x = &answer["loss"]["axes"][0];
        assert_eq!((x["axis"].as_str(), x["unit"].as_str()), (Some("X"), Some("um")));
        assert!(x["largest"].as_f64() < x["correction"].as_f64(), "{x}");
        let numbers = ["--axis-numbers", "X=1,Y=2,Z=3"];
        let back = json(&[&["import", &tables, "-o", &curves][..], &numbers].concat());
        assert_eq!(back["format"], format);
        let part = fs::read_to_string(&curves).expect("written");
        let whole = format!(
            "structure = \"w X' Y' b Z t\"\n[axes]\nX.travel = [0.0, 600.0]\nY.travel = [0.0, 400.0]\nZ.travel = [-500.0, 0.0]\n{part}"
        );
        let read = Machine::parse(&whole, "m.toml").expect("a part of a machine file");
        // At X = 600 mm, 530 mm above the table surface: 20 µm/m of EXX, and 30 µrad of pitch.
        let exx = read.error("EXX".parse().expect("a name")).expect("a curve");
        let found = exx.value(0, &[600.0, 0.0, 0.0], None);
        assert!((found - (12.0 + 0.03 * 530.0)).abs() < 0.01, "{format}: {found}");
        assert_eq!(back["errors"]["EXX"]["table"].as_array().map(Vec::len), Some(25));
        fs::remove_dir_all(&tables).expect("removed");
    }
}

/// The facts file of each format lists the written files, and gives the axis numbers to the import.
#[test]
fn facts_of_each_format_and_back_without_numbers() {
    let (_folder, all) = folder();
    fs::create_dir(&all).expect("made");
    for format in ["fanuc", "heidenhain"] {
        let tables = format!("{all}/{format}");
        let answer = json(&format!(
            "export -m {GANTRY} --format {format} --step 250 -o {tables} --axis-numbers X=3,Y=1,Z=2"
        ));
        let facts =
            fs::read_to_string(format!("{tables}/volcomp-tables-{format}.txt")).expect("the facts");
        for file in list(&answer["files"]) {
            let name = file.as_str().expect("a name").rsplit('/').next().expect("a name");
            assert!(name.starts_with("volcomp-tables-") || facts.contains(name), "{name}: {facts}");
        }
    }
    let alone = format!("{all}/alone");
    let answer = json(&format!(
        "export -m {GANTRY} --format fanuc --step 250 -o {alone} --axis-numbers X=3,Y=1,Z=2"
    ));
    let back = json(&["import", &alone]);
    assert_eq!(back["format"], "fanuc");
    assert!(
        back["warnings"].to_string().contains("taken from here: X=3,Y=1,Z=2"),
        "{}",
        back["warnings"]
    );
    let outputs = |of: &serde_json::Value| -> Vec<String> {
        let all = list(&of["tables"]).iter();
        let mut all: Vec<String> = all.map(|made| made["output"].to_string()).collect();
        all.sort();
        all
    };
    assert_eq!(outputs(&back), outputs(&answer));
    // The type of a LinuxCNC file is stated in the facts file only.
    let linuxcnc = format!("{all}/linuxcnc");
    json(&format!("export -m {GANTRY} --format linuxcnc-type1 --step 250 -o {linuxcnc}"));
    assert_eq!(json(&["import", &linuxcnc])["format"], "linuxcnc-type1");
}

/// The travel of the tilting head begins at −110°, outside a table of 0° to 360°. The table of the head is omitted with
/// a note, and the tables of the other axes are written.
#[test]
fn a_tilting_axis_is_left_out_and_the_others_are_written() {
    let (_folder, tables) = folder();
    let answer = json(&format!(
        "export -m examples/five-axis.toml --format heidenhain --step 100 -o {tables}"
    ));
    let notes = answer["notes"].to_string();
    contains(&notes, "left out, because a table over a rotary axis holds 0 to 360 deg:");
    contains(&notes, " over B");
    let made = list(&answer["tables"]);
    assert!(!made.is_empty() && made.iter().all(|made| made["input"] != "B"), "{made:?}");
    let files = answer["files"].to_string();
    assert!(files.contains("X.COM") && !files.contains("B.COM"), "{files}");
}

#[test]
fn a_file_or_a_folder() {
    let (folder, _) = folder();
    let one = folder.file("one.csv");
    let answer = json(&["export", "-m", MILL, "--format", "csv", "-o", &one]);
    assert_eq!(answer["files"], serde_json::json!([one]));
    let several = refused(&["export", "-m", MILL, "--format", "linuxcnc", "-o", &one]);
    contains(&several, "expected a folder: the format linuxcnc has");
    let itself = folder.path().join("m.toml");
    fs::copy(root().join(MILL), &itself).expect("copied");
    let itself = itself.display().to_string();
    refuses(
        &["export", "-m", &itself, "--format", "csv", "-o", &itself],
        "the file of the machine",
    );
    let nowhere = refused("export -m examples/mill.toml --format csv -o /nowhere/at/all");
    contains(&nowhere, "there is no folder /nowhere/at");
}

#[test]
fn what_people_read() {
    let (_folder, tables) = folder();
    let told = text(&format!("export -m {MILL} --format siemens-840d --at Z=-200 -o {tables}"));
    let flat: Vec<&str> = told.split_whitespace().collect();
    let flat = flat.join(" ");
    for words in [
        "all errors",
        "positioning",
        "reversal",
        "sign unproven",
        "MD38000",
        "half of the reversal",
    ] {
        assert!(flat.contains(words), "{words}: {told}");
    }
    for line in told.lines() {
        assert!(line.chars().count() <= 80 || line.contains("/tables/"), "{line}");
    }
    // Implausible rows give a note on standard error, and the curves are still printed.
    let comp = format!("{tables}/X.comp");
    fs::write(&comp, "0 0.001 0\n50 50.002 50\n\n100 100 100\n").expect("written");
    let output = volcomp(&["import", &comp, "--format", "linuxcnc"]);
    assert_eq!(output.status.code(), Some(0));
    let (said, shown) =
        (String::from_utf8_lossy(&output.stderr), String::from_utf8_lossy(&output.stdout));
    assert!(
        said.split_whitespace()
            .collect::<Vec<_>>()
            .join(" ")
            .contains("LinuxCNC stops reading here"),
        "{said}"
    );
    assert_eq!(
        shown,
        "[errors]\nEXX = { forward = { table = [[0.0, 1.0], [50.0, 2.0]], interpolation = \"linear\" }, backward = { table = [[0.0, 0.0], [50.0, 0.0]], interpolation = \"linear\" } }\n"
    );
}

#[test]
fn what_cannot_be_is_refused() {
    let (folder, tables) = folder();
    let comp = folder.write("x.comp", "0 0 0\n1 1 1\n");
    let calls = "
export $mill --format haas => found format `haas`
export $mill --format csv --step 0 => --step: found 0, expected a number above 0
export $mill --format csv --at X=700 => --at X: found 700, expected 0 to 600, its travel
export $mill --format linuxcnc --step 1 => found 601 positions, expected at most 256
export $mill --format fanuc --at X=10 => no point at machine zero
export $mill --format fanuc --axis-numbers X=1 => found no number
export $mill --format csv --axis-numbers X=1,Y=1 => each axis and each number once
import $comp => --format linuxcnc for COMP_FILE_TYPE 0
import nowhere.csv => nowhere.csv
import $comp --format linuxcnc -o $comp => the file of a table
";
    refuse_each(calls, &[("$mill", &format!("-m {MILL} -o {tables}")), ("$comp", &comp)]);
    assert!(fs::metadata(&tables).is_err(), "nothing is left");
    let archive = folder.write("a.ini", "$AN_CEC[0,0]=x y\n");
    let output = volcomp(&["--json", "import", &archive]);
    assert_eq!(output.status.code(), Some(2));
    let told: serde_json::Value = serde_json::from_slice(&output.stderr).expect("an object");
    assert_eq!(told["error"]["file"], archive);
    assert_eq!(told["error"]["line"], 1);
    assert_eq!(fs::read_to_string(&comp).expect("kept"), "0 0 0\n1 1 1\n");
}

/// The pitch of X acts with the lever of Z, which a table of X does not contain. Far from the table's reference in Z,
/// the table makes positions worse, and `export` warns.
#[test]
fn a_table_that_does_harm_is_told() {
    let (folder, tables) = folder();
    let machine = folder.path().join("m.toml");
    let of_travel = |low: f64, high: f64| {
        format!(
            "name = \"tall\"\nstructure = \"w X' b Z t\"\n[axes]\nX.travel = [{low:?}, {high:?}]\nZ.travel = [-500.0, 500.0]\n\
             [errors]\nEXX = {{ poly = [5.0] }}\nEBX = {{ poly = [0.0, 0.1] }}\n"
        )
    };
    let run = |options: &[&str]| {
        let machine = machine.display().to_string();
        let call = ["export", "-m", &machine, "--format", "linuxcnc", "-o", &tables];
        let output = volcomp(&[&call[..], options].concat());
        let told = String::from_utf8_lossy(&output.stderr).replace("\n  ", " ");
        assert_eq!(output.status.code(), Some(0), "{told}");
        (told, String::from_utf8_lossy(&output.stdout).into_owned())
    };
    // A pitch that differs between the directions, for which the table takes the lever at one height only.
    let of_directions = "EBX = { mean = { poly = [0.0] }, reversal = 10.0 }";
    let text = of_travel(0.0, 400.0).replace("EBX = { poly = [0.0, 0.1] }", of_directions);
    fs::write(&machine, text).expect("written");
    let (told, _) = run(&["--at", "X=0,Z=500"]);
    contains(&told, "WARNING: with these tables the reversal error of axis X grows");
    fs::write(&machine, of_travel(0.0, 400.0)).expect("written");
    // The tables are made at Z = 500. At Z = −500 the lever has the opposite sign, so that the table doubles the error.
    let (told, said) = run(&["--at", "X=0,Z=500"]);
    contains(&told, "WARNING: with these tables axis X is further off than without");
    assert!(!told.contains("--at is not given"), "{told}");
    contains(&said, "error by");
    contains(&said, "left with");
    let (told, _) = run(&[]);
    contains(
        &told,
        "--at is not given: the tables hold on the lines through the middle of the travel, X=200,Z=0",
    );
    assert!(!told.contains("WARNING"), "{told}");
    // EXX is 5 µm everywhere, including the reference position.
    let facts = fs::read_to_string(format!("{tables}/volcomp-tables-linuxcnc.txt")).expect("read");
    contains(&facts, "Deviations at the reference position: X ");
    contains(&facts, "does not begin at zero there");
    // The reference is the middle of the travel in whole steps of 50 mm from the lower end, so that it is a node of the
    // table.
    fs::write(&machine, of_travel(30.0, 410.0)).expect("written");
    contains(&run(&[]).0, "X=230,Z=0");
}

#[test]
fn tables_of_two_formats_in_one_folder_are_told() {
    let (_folder, tables) = folder();
    let export = |format: &str, options: &[&str]| {
        let call = ["export", "-m", MILL, "--format", format, "-o", &tables];
        let output = volcomp(&[&call[..], options].concat());
        let told = String::from_utf8_lossy(&output.stderr).replace("\n  ", " ");
        (output.status.code(), told)
    };
    assert_eq!(export("linuxcnc", &[]).0, Some(0));
    // A repeated export replaces nothing.
    let (status, told) = export("linuxcnc", &[]);
    assert!(status == Some(0) && !told.contains("replaced"), "{told}");
    let (status, told) = export("linuxcnc", &["--step", "25"]);
    assert!(
        status == Some(0) && told.contains("replaced what was there: ") && told.contains("X.comp"),
        "{told}"
    );
    let (status, told) = export("csv", &[]);
    assert!(
        status == Some(0)
            && told
                .contains("tables of another format, too: linuxcnc (volcomp-tables-linuxcnc.txt)"),
        "{told}"
    );
}

#[test]
fn the_file_is_the_map_that_is_told_of() {
    let folder = Folder::new();
    let path = folder.path().join("gantry.map");
    let name = path.display().to_string();
    let call = format!("map-table -m {GANTRY} --words 8000 --within 3 -o {name}");
    let answer = json(&format!("{call} --number 7 --counter 12"));
    let bytes = fs::read(&path).expect("written");
    assert_eq!(answer["bytes"], json!(bytes.len()));
    let map = Map::from_image(&bytes, 7).expect("a map of machine 7");
    assert!(Map::from_image(&bytes, 8).is_err());
    assert_eq!(map.header().counter, 12);
    assert_eq!(answer["words"], json!(map.words().len()));
    assert!(float(&answer["error_max_um"]) <= 3.0);
    assert_eq!(answer["grid"][0]["lines"], json!(map.header().lines[0].count));
    // Expansion of 11.5 µm/(m·K) over 8 m.
    let um_per_k = float(&answer["um_per_k"]["scale_x"]);
    assert!((um_per_k - 92.0).abs() < 0.5, "{um_per_k}");
    let refresh_s = float(&answer["refresh_s"]);
    assert!((refresh_s - 3600.0 * 3.0 / um_per_k).abs() < 0.01, "{refresh_s}");

    json(&format!("{call} --high-first"));
    let high = fs::read(&path).expect("written");
    assert_eq!(&high[..2], b"VM");
    let told = text(&call);
    contains(&told, "Error of the map: ");
    assert!(
        told.lines().all(|line| line.chars().count() <= 80 || line.contains("gantry.map")),
        "{told}"
    );
    // Over a rotary axis the steepest change may be in a degree.
    let told = text(&format!(
        "map-table -m examples/table-tilting.toml --words 65000 --within 20 --axes X,C -o {name}"
    ));
    let told = told.split_whitespace().collect::<Vec<_>>().join(" ");
    contains(&told, "µm in a mm or deg: at 10 m/min or 10000 deg/min that is");
}

#[test]
fn a_map_table_that_cannot_be_is_refused() {
    let folder = Folder::new();
    let name = folder.file("m.map");
    let calls = "
map-table $m --words 200 => expected 234 at the least
map-table $m --words 400 --within 0.2 => 0.2 µm need
map-table $m --words 400 --within 0.2 => with this many the error is
map-table $m --words 8000 --axes X,Q => Q
map-table $m --words 8000 --link 0 => above 0
map-table $m --words 8000 --number 65535 => 0 to 65534
";
    refuse_each(calls, &[("$m", &format!("-m {GANTRY} -o {name}"))]);
    assert_eq!(fs::read_dir(folder.path()).expect("a folder").count(), 0);
}
