//! `volcomp map-table`: file, result, and rejected calls.

use std::fs;

use serde_json::json;
use volcomp_tables::Map;

use crate::{Folder, contains, float, json, refused, text};

const GANTRY: &str = "examples/gantry.toml";

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
fn what_cannot_be_is_refused() {
    let folder = Folder::new();
    let name = folder.file("m.map");
    let told = |more: &[&str]| refused(&[&["map-table", "-m", GANTRY, "-o", &name], more].concat());
    assert!(told(&["--words", "200"]).contains("expected 234 at the least"));
    let small = told(&["--words", "400", "--within", "0.2"]);
    contains(&small, "0.2 µm need");
    contains(&small, "with this many the error is");
    assert!(told(&["--words", "8000", "--axes", "X,Q"]).contains('Q'));
    assert!(told(&["--words", "8000", "--link", "0"]).contains("above 0"));
    assert!(told(&["--words", "8000", "--number", "65535"]).contains("0 to 65534"));
    assert_eq!(fs::read_dir(folder.path()).expect("a folder").count(), 0);
}
