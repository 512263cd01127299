//! Parts that a virtual machine cuts, compensated by a model that was found from measurements of it and never saw the machine itself.

use std::{fs, path::Path};

use serde_json::Value;

use crate::json;

/// A program compensated by a model, judged on the truth.
fn inspected(folder: &Path, model: &str, truth: &str, part: &str, setup: Option<&str>) -> Value {
    let output = folder.join("out.ngc").display().to_string();
    let program = format!("examples/parts/{part}.ngc");
    let features = format!("examples/parts/{part}.toml");
    let mut call = vec!["nc", &program, "-o", &output, "-m", model];
    call.extend(["--truth", truth, "--verify", "--inspect", &features]);
    if let Some(setup) = setup {
        call.extend(["--setup", setup]);
    }
    json(&call)["verified"]["features"].clone()
}

fn number(features: &Value, name: &str, key: &str) -> [f64; 2] {
    let all = features.as_array().expect("features");
    let feature = all.iter().find(|f| f["name"] == name).expect("the feature");
    ["before", "after"].map(|when| feature[when][key].as_f64().expect("a number"))
}

/// The guideways of a bed of 4800 mm and of a worktable of 4000 mm, measured with a bridge: down by 90 % and more (published: from 19 to 3.5,
/// 33 to 5.2, 34 to 4.6 and 50 to 6.8 µm).
#[test]
fn a_bed_and_a_worktable_become_straight() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path();
    let files = path.join("measured").display().to_string();
    json(&["simulate", "cli/volcomp/demo/shop.toml", "-o", &files]);
    let model = path.join("model.toml").display().to_string();
    json(&[
        "calibrate",
        &format!("{files}/calibration.toml"),
        "-o",
        &model,
    ]);
    let found = inspected(path, &model, "cli/volcomp/demo/truth.toml", "bed", None);
    for name in [
        "bed, sideways",
        "bed, height",
        "worktable, sideways",
        "worktable, height",
    ] {
        let [before, after] = number(&found, name, "minimum_zone_um");
        println!("{name}: {before:.2} {after:.2}");
        assert!(
            before > 15.0 && after < 0.15 * before,
            "{name}: {before} {after}"
        );
    }
}

/// A conical table on a table-tilting machine, its model from laser lines, an instrument centred on the table's axes, and probed spheres.
#[test]
fn a_conical_table_is_coaxial_to_its_bore() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path();
    let files = path.join("measured");
    let shop = "examples/parts/cone-shop.toml";
    json(&["simulate", shop, "-o", &files.display().to_string()]);
    let read = |name: &str| fs::read_to_string(files.join(name)).expect("written");
    let (lines, spheres) = (read("calibration.toml"), read("observations.toml"));
    let (machine, measurements) = lines.split_once('\n').expect("the machine");
    let unknown = &spheres[spheres.find("unknown").expect("unknowns")..];
    let (unknown, observations) = unknown.split_at(unknown.find("[[observation]]").expect("one"));
    let both = files.join("both.toml");
    fs::write(
        &both,
        format!("{machine}\n{unknown}{measurements}\n{observations}"),
    )
    .expect("written");
    let model = path.join("model.toml").display().to_string();
    json(&["calibrate", &both.display().to_string(), "-o", &model]);
    let truth = "examples/table-tilting.toml";
    let setup = Some("examples/parts/cone-setup.toml");
    let found = inspected(path, &model, truth, "cone", setup);
    let [before, after] = number(&found, "cone", "coaxiality_um");
    println!("coaxiality: {before:.2} {after:.2}");
    assert!(before > 15.0 && after < 0.1 * before, "{before} {after}");
    let [before, after] = number(&found, "cone", "position_um");
    println!("position: {before:.2} {after:.2}");
    assert!(after < 0.3 * before, "{before} {after}");
    let [before, after] = number(&found, "cone", "direction_urad");
    println!("direction: {before:.2} {after:.2}");
    assert!(after < 0.1 * before, "{before} {after}");
}
