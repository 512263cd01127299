//! The map of a model, compared with closed forms.

use volcomp_centre::{
    map::{ErrorMap, error_map},
    models::{ModelDescription, beyond_every_guard},
};
use volcomp_model::Machine;

fn machine(errors: &str) -> Machine {
    let text = format!(
        "name = \"quotes <script>\"\ntype = {{ translational = 0, rotary = 0, rotary_axes = [] }}\naxes.X.travel = [0.0, 500.0]\naxes.Y.travel = [0.0, 400.0]\naxes.Z.travel = [0.0, 300.0]\n[errors]\n{errors}\n"
    );
    Machine::parse(&text, "m").expect("right")
}

fn map(errors: &str) -> ErrorMap {
    error_map(&machine(errors)).expect("within the travels")
}

/// An error of 5 µm at one target between the nodes of any grid is the largest error.
#[test]
fn the_largest_error_includes_points_between_map_nodes() {
    let map = map("EYX = { table = [[0, 0], [111, 0], [112, 5], [113, 0], [500, 0]] }");
    assert!((map.largest_um[0] - 5.0).abs() < 0.01, "{:?}", map.largest_um);
}

#[test]
fn a_squareness_error_appears_in_the_diagonals_before_correction_only() {
    let machine = machine("EC0Y = 20.0");
    let map = error_map(&machine).expect("within the travels");
    let described = ModelDescription::new(&machine, &machine.to_toml());
    assert_eq!(described.structure, "w b X Y Z t");
    assert_eq!(described.type_numbers, Some([0, 0]));
    assert!(described.formula[0].starts_with("dX = "));
    // 20 µrad over 400 mm of Y are 8 µm. After correction half a step of 1 µm in one axis remains.
    assert!(
        (map.largest_um[0] - 8.0).abs() < 0.01 && map.largest_um[1] <= 0.51,
        "{:?}",
        map.largest_um
    );
    // Along a diagonal of length d the tip's deviation is 20 µrad · y · x/d.
    let d = (500.0_f64.powi(2) + 400.0_f64.powi(2) + 300.0_f64.powi(2)).sqrt();
    let range_um = 20e-3 * 400.0 * 500.0 / d;
    for (name, [before, after]) in &map.diagonals_um {
        assert!((before - range_um).abs() < 0.01, "{name}: {before} {range_um}");
        assert!(*after < 1.1, "{name}: {after}");
    }
    assert_eq!(map.sections.len(), 3);
    for section in &map.sections {
        let rows = &section.before_um;
        assert_eq!((rows.len(), rows[0].len()), (21, 21));
    }
    // The first section has X across and Y up. The error grows only upwards.
    let rows = &map.sections[0].before_um;
    assert!((rows[20][0] - 8.0).abs() < 0.01 && rows[0][20] < 0.01, "{rows:?}");
}

/// The largest error is that at a corner of the work space, where the scale errors of three axes add up.
#[test]
fn the_largest_error_covers_the_whole_work_space() {
    let scale = "{ poly = [0.0, 0.1] }";
    let map = map(&format!("EXX = {scale}\nEYY = {scale}\nEZZ = {scale}"));
    // 100 µm/m along 500, 400 and 300 mm give 50, 40 and 30 µm.
    let largest_um = (50.0_f64.powi(2) + 40.0_f64.powi(2) + 30.0_f64.powi(2)).sqrt();
    let [found_um, _] = map.largest_um;
    assert!(
        (found_um - largest_um).abs() < 0.5,
        "{found_um} µm, the corner has {largest_um:.1} µm"
    );
}

/// An error above every guard's limit, as from a misplaced decimal separator, adds a note to the model.
#[test]
fn an_error_beyond_guard_limits_gets_a_note() {
    // The error is 1.9 or 2.1 mm at the end of 500 mm of X.
    for (slope, is_beyond) in [(3.8, false), (4.2, true)] {
        let map = map(&format!("EXX = {{ poly = [0.0, {slope}] }}"));
        let note = beyond_every_guard(&map);
        assert_eq!(note.is_some(), is_beyond, "{note:?}");
        assert!(note.iter().all(|text| text.contains("2.1 mm")));
    }
}
