use volcomp_model::{Machine, Temperatures};
use volcomp_nc::{
    Corrector, Found, InspectError, Inspected, Job, Note, Notes, Part, SetUp, Virtual, compensate,
    verify,
};
use volcomp_test_support::cases;

use crate::identity::has;

/// Features before and after compensation on a virtual machine, by name.
fn inspected(errors: &str, program: &str, part: &str) -> Vec<Inspected> {
    inspected_with([errors, errors], "", program, part).0
}

/// Like [`inspected`] on a machine with the first errors, corrected for the second ones, with a work offset; also returns the notes.
fn inspected_with(
    errors: [&str; 2],
    work_offset: &str,
    program: &str,
    part: &str,
) -> (Vec<Inspected>, Notes) {
    let [truth, model] = errors.map(machine);
    let temperatures = Temperatures::default();
    let corrector = Corrector::new(&model, &temperatures, 1e-3).expect("compiled");
    let start = "start = { X = 0.0, Y = 0.0, Z = 0.0, B = 0.0 }\n";
    let setup = SetUp::parse(&format!("{start}{work_offset}"), "s.toml").expect("a set-up");
    let job = Job { keep_shares: true, ..Job::new(&corrector, &setup) };
    let mut out = Vec::new();
    let summary =
        compensate(&mut program.as_bytes(), &mut out, job, |_| Ok(())).expect("compensated");
    let part = Part::parse(part, "part.toml").expect("a part");
    let of = Virtual {
        truth: &truth,
        temperatures: &temperatures,
        setup: &setup,
        most_blocks: 10_000,
        dialect: volcomp_nc::Dialect::Rs274,
        part: Some((&part, &corrector)),
        resolution: None,
    };
    let found = verify(&mut program.as_bytes(), &mut out.as_slice(), &summary.shares, of);
    (found.expect("verified").features, summary.notes)
}

fn machine(errors: &str) -> Machine {
    let text = format!(
        "structure = \"w X' b Y Z B t\"
axes = {{ X = {{ travel = [0, 1000] }}, Y = {{ travel = [0, 1000] }}, Z = {{ travel = [-500, 0] }}, B = {{ travel = [-90, 90] }} }}
tool = {{ tip = [0, 0, 0] }}
[errors]
{errors}
"
    );
    Machine::parse(&text, "m.toml").expect("a machine")
}

fn both(inspected: &Inspected) -> [Found; 2] {
    inspected.found.clone().expect("evaluated")
}

fn near(found: Option<f64>, expected: f64, within: f64) {
    let found = found.expect("a number");
    assert!((found - expected).abs() <= within, "{found} {expected}");
}

/// A squareness of 100 µrad turns a circle of 50 mm into an ellipse whose radii differ by 5 µm. A scale error of 100 µm/m also moves its
/// centre at X = 300 by 30 µm, and a hole at X = 500 by 50 µm.
#[test]
fn circles_and_holes_equal_the_closed_form() {
    let program = "G21 G90 G17\nG0 X350 Y400 Z-10\nG3 X350 Y400 I-50 J0 F500\nG0 Z0\nG81 X500 Y400 Z-20 R-5\nG80\nM2\n";
    let part = "[[feature]]\nname = \"bore\"\nkind = \"circle\"\nplane = \"xy\"\nlines = [3, 3]\n[[feature]]\nname = \"hole\"\nkind = \"hole\"\nlines = [5, 5]\n";
    let square = inspected("EC0Y = 100.0", program, part);
    let [before, after] = both(&square[0]);
    near(before.form_um, 5.0, 0.05);
    near(before.minimum_zone_um, 5.0, 0.05);
    assert!(after.form_um.expect("form") < 1.5, "{after:?}");
    let scale = inspected("EXX = { poly = [0.0, 0.1] }", program, part);
    let [before, after] = both(&scale[0]);
    near(before.form_um, 5.0, 0.05);
    near(before.position_um, 30.0, 0.1);
    near(before.radius_um, 2.5, 0.1);
    near(after.position_um, 0.0, 0.6);
    let [before, after] = both(&scale[1]);
    near(before.position_um, 50.0, 1e-6);
    near(after.position_um, 0.0, 0.5);
    assert_eq!(before.form_um, None);
}

/// On a machine with 100 µm/m a zero probed at X = 200 is 20 µm off, so the part at X = 500 has 30 of the 50 µm. With a model of 90 µm/m,
/// 18 µm are added to the work offset, and 3 of the remaining 5 µm stay.
#[test]
fn positions_are_relative_to_the_probed_zero() {
    // A motion without tool length, and a shift of the work offset, do not change the zero.
    let program =
        "G21 G90 G17\nG0 X0 Y0\nG43 H1 Z-10\nG52 X10\nG81 X290 Y0 Z-20 R-5 F500\nG80\nM2\n";
    let part = "[[feature]]\nname = \"hole\"\nkind = \"hole\"\nlines = [5, 5]\n";
    let [truth, model] = ["0.1", "0.09"]
        .map(|slope| format!("EXX = {{ poly = [0.0, {slope}] }}\nEXZ = {{ poly = [0.0, 0.1] }}"));
    let offset = "[work_offset.G54]\nX = 200.0\nY = 400.0\nZ = -300.0\n[tool.1]\nZ = 300.0\n";
    let (found, notes) = inspected_with([&truth, &model], offset, program, part);
    let [before, after] = both(&found[0]);
    // Half-way down, at Z -12.5, 1.25 µm less.
    near(before.position_um, 28.75, 0.01);
    near(after.position_um, 3.0, 0.6);
    let zero = Note::OffAtZero("G54".to_owned(), [180, 0, 0]);
    assert_eq!(notes.by_line(), [(5, &zero)]);
}

/// A zero set by the program was not probed. After G92 or G10 positions are relative to machine zero (29 µm at 290 mm); after G52 the
/// probed offset of 200 mm stays active (9 µm).
#[test]
fn a_zero_set_by_the_program_was_not_probed() {
    let part = "[[feature]]\nname = \"hole\"\nkind = \"hole\"\nlines = [3, 3]\n";
    let scale = "EXX = { poly = [0.0, 0.1] }";
    let offset = "[work_offset.G54]\nX = 200.0\nY = 0.0\nZ = 0.0\n";
    for (own, x, before_um) in [
        ("G92 X0 Y0 Z0", 290.0, 29.0),
        ("G10 L2 P1 X200 Y0 Z0", 90.0, 29.0),
        ("G52 X0 Y0 Z0", 90.0, 9.0),
    ] {
        let program = format!("G21 G90 G17\n{own}\nG81 X{x} Y0 Z-20 R-5 F500\nG80\nM2\n");
        let (found, _) = inspected_with([scale, scale], offset, &program, part);
        let [before, after] = both(&found[0]);
        near(before.position_um, before_um, 0.01);
        near(after.position_um, 0.0, 0.6);
    }
}

/// The flank of a tool tilted by 40 µrad leaves a cylinder with the same tilt: 40·10⁻⁶·60 mm = 2.4 µm at its upper end. A second cylinder
/// with this one as datum is coaxial.
#[test]
fn a_flank_shows_the_tool_direction() {
    let program =
        "G21 G90 G17\nG0 X350 Y400 Z-10\nG3 X350 Y400 I-50 J0 F500\nG3 X350 Y400 I-50 J0\nM2\n";
    let part = "[[feature]]\nname = \"one\"\nkind = \"cylinder\"\nlines = [3, 3]\nabove_mm = [0, 30, 60]\n[[feature]]\nname = \"two\"\nkind = \"cylinder\"\nlines = [4, 4]\nabove_mm = [0, 30, 60]\ndatum = \"one\"\n";
    let found = inspected("EBB = 40.0", program, part);
    let [before, _] = both(&found[0]);
    near(before.direction_urad, 40.0, 0.1);
    near(before.position_um, 2.4, 0.05);
    near(before.form_um, 0.0, 0.02);
    let [before, _] = both(&found[1]);
    near(before.coaxiality_um, 0.0, 0.01);
}

/// EYX of 30 µm in the middle of 800 mm is the straightness of a line along X; with compensation less than 2.1 µm remain.
#[test]
fn lines_have_the_straightness_of_the_machine() {
    let program = "G21 G90 G17\nG0 X100 Y400 Z-10\nG1 X900 F500\nM2\n";
    let part = "[[feature]]\nname = \"side\"\nkind = \"line\"\nplane = \"xy\"\nlines = [3, 3]\n[[feature]]\nname = \"height\"\nkind = \"line\"\nplane = \"zx\"\nlines = [3, 3]\n";
    // 30 µm · 4·(x − 100)(900 − x)/800².
    let errors = "EYX = { poly = [-16.875, 0.1875, -1.875e-4] }";
    let found = inspected(errors, program, part);
    let [before, after] = both(&found[0]);
    near(before.minimum_zone_um, 30.0, 0.01);
    assert!(after.minimum_zone_um.expect("form") < 2.1, "{after:?}");
    near(both(&found[1])[0].form_um, 0.0, 1e-3);
}

#[test]
fn features_that_are_not_cut_are_reported() {
    let program = "G21 G90\nG0 X100 Y400 Z-10\nG1 X900 F500\nM2\n";
    let part = "[[feature]]\nname = \"a\"\nkind = \"hole\"\nlines = [3, 3]\n[[feature]]\nname = \"b\"\nkind = \"circle\"\nlines = [2, 3]\n[[feature]]\nname = \"c\"\nkind = \"line\"\nlines = [7, 9]\n";
    let found = inspected("EXX = 1.0", program, part);
    assert_eq!(found[0].found, Err(InspectError::NothingCut { lines: [3, 3] }));
    assert!(matches!(found[1].found, Err(InspectError::Form(_))));
    assert_eq!(found[2].found, Err(InspectError::NothingCut { lines: [7, 9] }));
}

#[test]
fn wrong_part_files_are_refused_with_their_position() {
    for [text, expected] in &cases(
        r#"
 | feature
feature = []\n | found an empty list
[[feature]]\nname = "a"\nkind = "plane"\nlines = [1, 2]\nabove_mm = [0, -20000]\n | above_mm[1]: found -20000, expected mm from -10000 to 10000
[[feature]]\nname = "a"\nkind = "cube"\nlines = [1, 2]\n | cube
[[feature]]\nname = "a"\nkind = "plane"\nplane = "xy"\nlines = [1, 2]\n | expected only for circles and lines
[[feature]]\nname = "a"\nkind = "plane"\nlines = [3, 2]\n | lines: found [3, 2], expected the numbers of the first and the last line
[[feature]]\nname = "a"\nkind = "plane"\nlines = [0.5, 2]\n | the first and the last line
[[feature]]\nname = "a"\nkind = "plane"\nlines = [1, 2]\nabove_mm = []\n | found 0 heights
[[feature]]\nname = "a"\nkind = "plane"\nlines = [1, 2]\ndatum = "b"\n | expected the name of a feature above it
[[feature]]\nname = "a"\nkind = "plane"\nlines = [1, 2]\n[[feature]]\nname = "a"\nkind = "plane"\nlines = [1, 2]\n | twice
[[feature]]\nname = "a"\nkind = "plane"\nlines = [1, 2]\n[[feature]]\nname = "b"\nkind = "circle"\nlines = [1, 2]\ndatum = "a"\n | that has an axis
"#,
    ) {
        let error = Part::parse(text, "part.toml").expect_err(text).to_string();
        has(&error, expected);
        has(&error, "part.toml");
    }
}

/// Rotations of 200 µrad and shifts of 30 µm of all axes vanish in the best-fit alignment. A squareness of 100 µrad remains as form error
/// of the circle and as angle between the edges.
#[test]
fn a_part_aligned_by_its_points_has_no_position_error() {
    let program = "G21 G90 G17\nG0 X350 Y400 Z-10\nG3 X350 Y400 I-50 J0 F500\nG0 Z0\nG81 X500 Y400 Z-20 R-5\nG80\nG0 X100 Y100\nG1 X600\nY500\nM2\n";
    let features = "[[feature]]\nname = \"bore\"\nkind = \"circle\"\nplane = \"xy\"\nlines = [3, 3]\n[[feature]]\nname = \"hole\"\nkind = \"hole\"\nlines = [5, 5]\n\
        [[feature]]\nname = \"front\"\nkind = \"line\"\nplane = \"xy\"\nlines = [8, 8]\n[[feature]]\nname = \"side\"\nkind = \"line\"\nplane = \"xy\"\nlines = [9, 9]\n";
    let turned = "EXX = 30.0\nEC0X = 200.0\nEC0Y = 200.0";
    let before = |errors: &str, alignment: &str| -> Vec<Found> {
        let part = format!("alignment = \"{alignment}\"\n{features}");
        inspected(errors, program, &part).iter().map(|feature| both(feature)[0]).collect()
    };
    let of_program = before(turned, "program");
    let own = before(turned, "best-fit");
    for (of_program, own) in of_program.iter().zip(&own) {
        for (as_it_lies, aligned) in [
            (of_program.position_um, own.position_um),
            (of_program.direction_urad, own.direction_urad),
        ] {
            if let Some(as_it_lies) = as_it_lies {
                assert!(as_it_lies > 60.0, "{of_program:?}");
                near(aligned, 0.0, 0.05);
            }
        }
    }
    let square = before("EC0Y = 100.0", "best-fit");
    near(square[0].form_um, 5.0, 0.05);
    let [front, side] = [2, 3].map(|k| square[k].direction_urad.expect("a direction"));
    near(Some(front + side), 100.0, 0.05);
    let error = Part::parse("alignment = \"datum\"\n", "part.toml").expect_err("refused");
    assert!(error.to_string().contains("best-fit"), "{error}");
}
