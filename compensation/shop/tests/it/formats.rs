//! Measurement files of all formats contain the same readings, and the shipped examples equal the shop's output.

use std::fs;
use std::path::Path;

use volcomp_identify::{Observations, identify};
use volcomp_metrology::{Measurement, read_file};
use volcomp_model::Machine;
use volcomp_shop::{Shop, ShopError};
use volcomp_test_support::root;
use volcomp_vocabulary::Direction;

use crate::figures::compare;

const MACHINE: &str = "name = \"m\"\nstructure = \"w X' b Y Z t\"\n[axes]\nX.travel = [-100, 500]\nY.travel = [0, 400]\n\
                       Z.travel = [0, 300]\n[errors]\nEXX = { forward = { poly = [0.0, 0.05] }, backward = { poly = [3.0, 0.05] } }\n\
                       EYX = { poly = [0.0, 0.0, 0.0001] }\nECX = { poly = [0.0, 0.1] }";

fn shop(lines: &str) -> Result<Shop, ShopError> {
    let text = format!("machine = \"m.toml\"\nseed = 3\n{lines}");
    Shop::parse(&text, "shop.toml", |_| Ok(Machine::parse(MACHINE, "m.toml")?))
}

/// The measurement of a shop's single line, written in a format and read back.
fn measured(format: &str, error: &str) -> (String, Measurement) {
    let shop = shop(&format!(
        "format = \"{format}\"\n[header]\ndate = \"2026-11-02\"\nby = \"A. Meier\"\nserial = \"17\"\nmaterial_degc = 20.5\n\
         [instrument]\nnoise_um = 0.5\nnoise_urad = 0.5\ntargets = 5\nruns = 3\n[[measurement]]\nerror = \"{error}\""
    ))
    .expect("it works");
    let files = shop.files(|_, _| {}).expect("it works");
    let (name, text) = &files[1];
    assert_eq!(shop.file_names()[1], *name);
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("shop-{format}-{error}"));
    fs::create_dir_all(&folder).expect("it works");
    let path = folder.join(name);
    fs::write(&path, text).expect("it works");
    (name.clone(), read_file(&path).expect("it works"))
}

#[test]
fn the_means_are_the_same_in_every_format() {
    for (error, formats) in [
        (
            "EXX",
            &[("renishaw", "exx.rtl"), ("api-pos", "exx.pos"), ("keysight-report", "exx.txt")][..],
        ),
        ("EYX", &[("renishaw", "eyx.rts"), ("keysight-report", "eyx.txt")]),
        ("ECX", &[("renishaw", "ecx.rta"), ("keysight-report", "ecx.txt")]),
    ] {
        let (_, table) = measured("csv", error);
        for (format, file) in formats {
            let (name, read) = measured(format, error);
            assert_eq!(name, *file);
            assert_eq!(read.unit, table.unit, "{name}");
            for direction in Direction::BOTH {
                let [expected, found] = [&table, &read].map(|m| m.mean_curve_in(direction));
                assert_eq!(expected.len(), 5);
                assert_eq!(found.len(), 5, "{name}");
                for ((at, mean), (found_at, found)) in expected.iter().zip(&found) {
                    // Resolution of the files: µm with four decimals, mm with seven, mrad with nine.
                    assert!((at - found_at).abs() < 1e-9 && (mean - found).abs() < 6e-5, "{name}");
                }
            }
        }
    }
}

#[test]
fn files_say_what_the_shop_says_of_the_test() {
    for format in ["renishaw", "api-pos", "keysight-report"] {
        let (name, read) = measured(format, "EXX");
        let said = &read.metadata;
        let of = |text: &Option<String>| text.clone().unwrap_or_default();
        let found = [
            of(&said.machine),
            of(&said.serial),
            of(&said.date),
            of(&said.by),
            of(&said.axis),
            of(&said.title),
        ];
        assert_eq!(found, ["m", "17", "2026-11-02", "A. Meier", "X", "EXX"], "{name}");
    }
    let (_, read) = measured("renishaw", "EXX");
    assert_eq!(read.environment.material_temperature[0].unwrap().start, 20.5);
}

#[test]
fn what_a_format_has_no_place_for_is_refused() {
    let message = |lines: &str| shop(lines).unwrap_err().to_string();
    let angles = message("[[measurement]]\nerror = \"ECX\"\nformat = \"api-pos\"");
    assert!(angles.contains("shop.toml:") && angles.contains("holds lengths"), "{angles}");
    let one_way = message(
        "[[measurement]]\nerror = \"EXX\"\nformat = \"keysight-report\"\nboth_directions = false",
    );
    assert!(one_way.contains("both_directions = true"), "{one_way}");
    let unknown = message("format = \"laser\"");
    assert!(unknown.contains("keysight-report"), "{unknown}");
}

#[test]
fn the_files_of_the_examples_are_those_of_their_shops() {
    let mut kinds = std::collections::BTreeSet::new();
    let mut count = 0;
    for machine in ["gantry", "five-axis"] {
        let folder = root().join("examples/from-files").join(machine);
        let shop = Shop::read(&folder.join("shop.toml")).unwrap();
        for (name, text) in shop.files(|_, _| {}).unwrap() {
            let (shipped, text) = match name.as_str() {
                // The measurement files are in a separate folder.
                "calibration.toml" => (name.clone(), text.replace("file = \"", "file = \"lasers/")),
                "machine.toml" => (name.clone(), text),
                _ => {
                    count += 1;
                    kinds.insert(name.rsplit_once('.').unwrap().1.to_owned());
                    (format!("lasers/{name}"), text)
                }
            };
            let shipped = fs::read_to_string(folder.join(&shipped))
                .unwrap_or_else(|e| panic!("{shipped}: {e}"));
            assert!(shipped == text, "{machine}: {name} is another one");
        }
    }
    assert!(count >= 40, "{count}");
    assert_eq!(kinds.into_iter().collect::<Vec<_>>(), ["csv", "pos", "rta", "rtl", "rts", "txt"]);
}

#[test]
fn the_ball_rows_of_the_example_are_those_of_its_shop() {
    let folder = root().join("examples/ball-row");
    let shop = Shop::read(&folder.join("shop.toml")).expect("a valid shop");
    let files = shop.files(|_, _| {}).expect("measured");
    assert_eq!(files.len(), 2 * 7 + 2);
    for (name, text) in files {
        let shipped = fs::read_to_string(folder.join(&name)).expect("shipped");
        assert_eq!(shipped, text, "{name}");
    }
    let file = Observations::read(&folder.join("observations.toml")).expect("read");
    let found = identify(&file, |_, _| {}).expect("identified");
    let mut nominal = shop.truth.clone();
    nominal.clear_errors();
    let before = compare(&shop.truth, &nominal, 500, 1).position_um;
    let after = compare(&shop.truth, &found.machine, 500, 1).position_um;
    // 0.5 µm over rows of 375 mm correspond to 2 µrad of squareness, which is 1 µm at the other end of the volume.
    assert!(before > 15.0 && after < 4.0, "{before} {after}");
}
