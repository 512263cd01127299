//! Angles have no length keys, and no file is read in a unit other than its own.

use std::fs;

use serde_json::{Value, json};

use crate::{Folder, contains, json, list, refused, refuses, text};

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
