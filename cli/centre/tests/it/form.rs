//! Models by form, against closed forms.

use volcomp_centre::form::{
    AxisForm, CurveForm, ErrorForm, Form, FormError, StructureForm, Upload, build,
};
use volcomp_vocabulary::AxisName;

fn axis(axis: AxisName, travel: [f64; 2]) -> AxisForm {
    AxisForm {
        axis,
        travel,
        point_mm: None,
        modulo: None,
    }
}

fn form() -> Form {
    Form {
        name: "quotes \" and\nlines = 'kept' <script>".to_owned(),
        structure: StructureForm::Type {
            translational: 0,
            rotary: 0,
            rotary_axes: Vec::new(),
        },
        axes: vec![
            axis(AxisName::X, [0.0, 500.0]),
            axis(AxisName::Y, [0.0, 400.0]),
            axis(AxisName::Z, [0.0, 300.0]),
        ],
        tip_mm: None,
        correct: None,
        errors: Vec::new(),
        uploads: Vec::new(),
    }
}

fn typed(error: &str, value: CurveForm) -> ErrorForm {
    ErrorForm {
        error: error.parse().expect("an error"),
        value,
    }
}

/// 5 µm at one target between the nodes of any grid: before, the largest error of such a model was 0.
#[test]
fn the_largest_error_is_seen_between_the_nodes_of_the_map() {
    let mut form = form();
    let belly = [
        [0.0, 0.0],
        [111.0, 0.0],
        [112.0, 5.0],
        [113.0, 0.0],
        [500.0, 0.0],
    ];
    form.errors = vec![typed("EYX", CurveForm::Table(belly.to_vec()))];
    let built = build(&form).expect("a model");
    assert!(
        (built.map.largest_um[0] - 5.0).abs() < 0.01,
        "{:?}",
        built.map.largest_um
    );
}

#[test]
fn a_squareness_takes_the_diagonals_apart_and_the_correction_takes_it_away() {
    let mut form = form();
    form.errors = vec![typed("EC0Y", CurveForm::Number(20.0))];
    let built = build(&form).expect("a model");
    assert_eq!(built.described.structure, "w b X Y Z t");
    assert_eq!(built.described.type_numbers, Some([0, 0]));
    // 20 µrad over 400 mm of Y.
    assert!(
        (built.map.largest_um[0] - 8.0).abs() < 0.01,
        "{:?}",
        built.map.largest_um
    );
    // What is left is half a step of 1 µm in one axis.
    assert!(
        built.map.largest_um[1] <= 0.51,
        "{:?}",
        built.map.largest_um
    );
    // Along a diagonal of the box the tip misses by 20 µrad · y · x/d.
    let d = (500.0_f64.powi(2) + 400.0_f64.powi(2) + 300.0_f64.powi(2)).sqrt();
    let range_um = 20e-3 * 400.0 * 500.0 / d;
    for (name, [before, after]) in &built.map.diagonals_um {
        assert!(
            (before - range_um).abs() < 0.01,
            "{name}: {before} {range_um}"
        );
        assert!(*after < 1.1, "{name}: {after}");
    }
    assert_eq!(built.map.sections.len(), 3);
    for section in &built.map.sections {
        assert_eq!(
            (section.before_um.len(), section.before_um[0].len()),
            (21, 21)
        );
    }
    // The first section is over X across and Y up: the error grows upwards only.
    let rows = &built.map.sections[0].before_um;
    assert!(
        (rows[20][0] - 8.0).abs() < 0.01 && rows[0][20] < 0.01,
        "{rows:?}"
    );
    assert!(built.described.formula[0].starts_with("dX = "));
    assert!(
        built.described.text.contains("<script>"),
        "the name is kept as a text"
    );
}

#[test]
fn measurement_files_become_curves() {
    let mut form = form();
    form.uploads = vec![Upload {
        error: "EXX".parse().expect("an error"),
        name: "../../etc/x-laser.csv".to_owned(),
        text: "target,deviation\n0,0.0\n250,5.0\n500,10.0\n".to_owned(),
        unit: Some("um".to_owned()),
        workpiece_side: false,
        at: std::collections::BTreeMap::new(),
    }];
    let built = build(&form).expect("a model");
    assert!(
        (built.map.largest_um[0] - 10.0).abs() < 0.01,
        "{:?}",
        built.map.largest_um
    );
    assert!(
        built.notes.iter().any(|note| note.contains("not measured")),
        "{:?}",
        built.notes
    );
    form.errors = vec![typed("EXX", CurveForm::Number(1.0))];
    assert!(matches!(build(&form), Err(FormError::ErrorTwice { .. })));
    form.errors.clear();
    form.uploads[0].name = "x.exe".to_owned();
    assert!(matches!(build(&form), Err(FormError::Ending { .. })));
    form.uploads[0].name = "x.csv".to_owned();
    form.uploads[0].text = "\u{0}garbage".to_owned();
    form.uploads[0].name = "monday.csv".to_owned();
    let error = build(&form).expect_err("no measurement").to_string();
    // The file as it was chosen, and no path of the computer on which the centre runs.
    assert!(
        error.contains("monday.csv") && !error.contains(".tmp"),
        "{error}"
    );
    assert!(
        !error.contains(&*std::env::temp_dir().display().to_string()),
        "{error}"
    );
    form.uploads[0].text = "target,deviation\n0,0\n500,10\n".to_owned();
    form.uploads[0].unit = Some("furlong".to_owned());
    let error = build(&form).expect_err("no unit").to_string();
    assert!(error.starts_with("the measurement files:"), "{error}");
}

#[test]
fn five_axes_by_type_numbers() {
    let mut form = form();
    form.structure = StructureForm::Type {
        translational: 0,
        rotary: 1,
        rotary_axes: vec![AxisName::C, AxisName::A],
    };
    form.axes.push(axis(AxisName::A, [-110.0, 30.0]));
    form.axes.push(axis(AxisName::C, [-360.0, 360.0]));
    form.errors = vec![
        typed("EXX", CurveForm::Table(vec![[0.0, 0.0], [500.0, 10.0]])),
        typed("ECC", CurveForm::Poly(vec![3.0])),
    ];
    let built = build(&form).expect("a model");
    assert_eq!(built.described.structure, "w C' A' b X Y Z t");
    assert_eq!(built.described.type_numbers, Some([0, 1]));
    assert_eq!(built.map.others.len(), 2);
}

#[test]
fn wrong_forms_say_what_is_wrong() {
    let check = |change: &dyn Fn(&mut Form), part: &str| {
        let mut form = form();
        change(&mut form);
        let error = build(&form).expect_err(part).to_string();
        assert!(error.contains(part), "{error}");
        assert!(!error.contains("the form:"), "{error}");
    };
    check(
        &|form| form.axes[0].travel = [5.0, 1.0],
        "Travels, X: from and to: ",
    );
    check(
        &|form| form.axes.push(axis(AxisName::X, [0.0, 1.0])),
        "axis X",
    );
    check(&|form| form.axes.truncate(2), "Z");
    check(
        &|form| {
            form.structure = StructureForm::Code {
                code: "w X b b t".to_owned(),
            }
        },
        "Structure code: ",
    );
    check(
        &|form| form.errors = vec![typed("EXX", CurveForm::Poly(vec![0.0; 20_000]))],
        "nodes",
    );
    check(
        &|form| form.errors = vec![typed("EXB", CurveForm::Number(1.0))],
        "Component error EXB: ",
    );
    check(
        &|form| form.axes[1].travel = [f64::NAN, 1.0],
        "Travels, Y: ",
    );
}

/// "Largest before and after" of the page, against the corner of the work space, where a scale error along three axes is largest.
#[test]
fn the_largest_error_of_the_map_is_that_of_the_work_space() {
    let scale = |name| typed(name, CurveForm::Poly(vec![0.0, 0.1]));
    let mut form = form();
    form.errors = vec![scale("EXX"), scale("EYY"), scale("EZZ")];
    let built = build(&form).expect("a model");
    // 100 µm/m along 500, 400 and 300 mm.
    let largest_um = (50.0_f64.powi(2) + 40.0_f64.powi(2) + 30.0_f64.powi(2)).sqrt();
    let [told_um, _] = built.map.largest_um;
    assert!(
        (told_um - largest_um).abs() < 0.5,
        "told {told_um} µm, the corner has {largest_um:.1} µm"
    );
}

/// A comma in the wrong place makes metres of micrometres: above what a guard corrects at the most, a person is asked.
#[test]
fn an_error_beyond_what_a_guard_corrects_is_asked_about() {
    let mut form = form();
    // 500 mm of X: 1.9 mm and 2.1 mm at its end.
    for (slope, is_asked) in [(3.8, false), (4.2, true)] {
        form.errors = vec![typed("EXX", CurveForm::Poly(vec![0.0, slope]))];
        let built = build(&form).expect("a model");
        assert_eq!(built.warning.is_some(), is_asked, "{:?}", built.warning);
        assert!(built.warning.iter().all(|text| text.contains("2.1 mm")));
    }
}
