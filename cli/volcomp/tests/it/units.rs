//! No angle under a key of lengths, and no file in a unit that it does not have.

use std::fs;

use serde_json::{Value, json};

use crate::{json, refused, text};

const SHOP: &str = "cli/volcomp/demo/shop.toml";

/// Every key of a document, however deep.
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
    let folder = tempfile::tempdir().expect("a folder");
    let lasers = folder.path().join("lasers");
    json(&["simulate", SHOP, "-o", &lasers.display().to_string()]);
    let file = |name: &str| lasers.join(name).display().to_string();

    let angles = json(&["iso230", &file("eay.rta")]);
    assert_eq!(angles["unit"], "urad");
    assert_eq!(ending_in(&angles, "_um"), Vec::<String>::new());
    let lengths = json(&["iso230", &file("exx.rtl")]);
    assert_eq!(lengths["unit"], "um");
    assert_eq!(ending_in(&lengths, "_urad"), Vec::<String>::new());
    // The same symbols under both units, down to the readings of a target.
    let symbols = |document: &Value, unit: &str| -> Vec<String> {
        let keys = ending_in(document, unit).into_iter();
        let mut symbols: Vec<String> = keys.map(|key| key.replace(unit, "")).collect();
        symbols.sort();
        symbols.dedup();
        symbols
    };
    assert_eq!(symbols(&angles, "_urad"), symbols(&lengths, "_um"));
    assert!(symbols(&lengths, "_um").contains(&"A_forward".to_owned()));

    let machine = folder.path().join("m.toml").display().to_string();
    let answer = json(&["calibrate", &file("calibration.toml"), "-o", &machine]);
    for curve in answer["curves"].as_array().expect("a list") {
        let (unit, other) = match curve["unit"].as_str() {
            Some("urad") => ("_urad", "_um"),
            _ => ("_um", "_urad"),
        };
        assert_eq!(ending_in(curve, unit).len(), 3, "{curve}");
        assert_eq!(ending_in(curve, other), Vec::<String>::new(), "{curve}");
        let is_angular = curve["error"]
            .as_str()
            .is_some_and(|e| "ABC".contains(&e[1..2]));
        assert_eq!(is_angular, unit == "_urad", "{curve}");
    }

    // The option states the unit of a file that does not; it never turns angles into lengths.
    for (name, unit, found, expected) in [
        ("eay.rta", "um", "µrad", "µm"),
        ("exx.rtl", "urad", "µm", "µrad"),
    ] {
        let message = refused(&["iso230", &file(name), "--unit", unit]);
        let said = format!("{name}: found deviations in {found}, expected {expected}");
        assert!(message.contains(&said), "{message}");
    }
    assert_eq!(
        json(&["iso230", &file("eay.rta"), "--unit", "urad"]),
        angles
    );
}

/// A table of a spreadsheet in a country of decimal commas, with a column that nobody reads.
#[test]
fn tables_with_semicolons_and_decimal_commas_are_read() {
    let folder = tempfile::tempdir().expect("a folder");
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
    expected["notes"] = json!(["columns that are not read: Operator"]);
    assert_eq!(json(&["iso230", "--unit", "urad", &comma]), expected);
    assert!(text(&["iso230", &comma, "--unit", "urad"]).contains("all values in µrad"));
    let mixed = write("mixed.csv", "target;deviation\n0;1,5\n1.234;2,25\n");
    let message = refused(&["inspect", &mixed]);
    assert!(
        message.contains("mixed.csv:3: target: found `1.234`, expected a number with a decimal comma as in line 2"),
        "{message}"
    );
}
