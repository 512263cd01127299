//! What a measuring machine would find of a part, against closed forms.

use volcomp_model::{Machine, Temperatures};
use volcomp_nc::{
    Corrector, Found, InspectError, Inspected, Job, Note, Notes, Part, SetUp, Virtual, compensate,
    verify,
};
use volcomp_test_support::cases;

use crate::identity::has;

/// Features of a part by name, before and after, on a machine that is taken for the real one.
fn inspected(errors: &str, program: &str, part: &str) -> Vec<Inspected> {
    inspected_with([errors, errors], "", program, part).0
}

/// The same on a machine with the first errors, corrected for the second ones, with a work offset; and the notes.
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
    let job = Job {
        keep_shares: true,
        ..Job::new(&corrector, &setup)
    };
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
    };
    let found = verify(
        &mut program.as_bytes(),
        &mut out.as_slice(),
        &summary.shares,
        of,
    );
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

/// A squareness of 100 µrad makes of a circle of 50 mm an ellipse whose radii differ by 5 µm; a scale of 100 µm/m along X one whose radii
/// differ by 5 µm, and moves its centre at X = 300 by 30 µm; a hole at X = 500 is 50 µm off.
#[test]
fn circles_and_holes_are_those_of_the_closed_form() {
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

/// A zero at X = 200 that was probed on a machine with a scale of 100 µm/m lies 20 µm beside what the control shows, and so does the part that is
/// cut there: of the 50 µm at X = 500 it has 30. Where the model knows 90 µm/m of them, 18 µm are added to the work offset, and of the 5 µm
/// that are left at X = 500 the part has the 3 that grow from its zero.
#[test]
fn a_place_is_counted_from_the_zero_that_was_probed() {
    // A motion without the tool's length, and a shift on top of the work offset, make no other zero.
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

/// A zero that the program sets where the axes stand is not that of the work offset, which was probed: the part counts from machine zero.
#[test]
fn an_own_zero_was_not_probed() {
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

/// The flank of a tool that is tilted by 40 µrad leaves a cylinder whose axis leans by as much, and is 40·10⁻⁶·60 mm = 2.4 µm further
/// away at its upper end than at its lower one; its axis through the tip's circle is the datum of the second, which is coaxial to itself.
#[test]
fn a_flank_shows_the_direction_of_the_tool() {
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

/// EYX of 30 µm in the middle of 800 mm is the straightness of a line along X; its height is straight.
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
fn what_is_not_cut_is_said() {
    let program = "G21 G90\nG0 X100 Y400 Z-10\nG1 X900 F500\nM2\n";
    let part = "[[feature]]\nname = \"a\"\nkind = \"hole\"\nlines = [3, 3]\n[[feature]]\nname = \"b\"\nkind = \"circle\"\nlines = [2, 3]\n[[feature]]\nname = \"c\"\nkind = \"line\"\nlines = [7, 9]\n";
    let found = inspected("EXX = 1.0", program, part);
    assert_eq!(
        found[0].found,
        Err(InspectError::NothingCut { lines: [3, 3] })
    );
    assert!(matches!(found[1].found, Err(InspectError::Form(_))));
    assert_eq!(
        found[2].found,
        Err(InspectError::NothingCut { lines: [7, 9] })
    );
}

#[test]
fn wrong_part_files_are_refused_with_their_place() {
    for [text, expected] in &cases(
        r#"
 | feature
feature = []\n | found an empty list
[[feature]]\nname = "a"\nkind = "plane"\nlines = [1, 2]\nabove_mm = [0, -20000]\n | above_mm[1]: found -20000, expected mm from -10000 to 10000
[[feature]]\nname = "a"\nkind = "cube"\nlines = [1, 2]\n | cube
[[feature]]\nname = "a"\nkind = "plane"\nplane = "xy"\nlines = [1, 2]\n | expected it for circles and lines only
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

/// All axes turned alike by 200 µrad and shifted by 30 µm is how the part lies: with its own alignment nothing is left of it. A squareness of
/// 100 µrad stays: it is an error of form of the circle, and turns the edges against each other.
#[test]
fn a_part_aligned_by_its_own_points_has_no_place_of_its_own() {
    let program = "G21 G90 G17\nG0 X350 Y400 Z-10\nG3 X350 Y400 I-50 J0 F500\nG0 Z0\nG81 X500 Y400 Z-20 R-5\nG80\nG0 X100 Y100\nG1 X600\nY500\nM2\n";
    let features = "[[feature]]\nname = \"bore\"\nkind = \"circle\"\nplane = \"xy\"\nlines = [3, 3]\n[[feature]]\nname = \"hole\"\nkind = \"hole\"\nlines = [5, 5]\n\
        [[feature]]\nname = \"front\"\nkind = \"line\"\nplane = \"xy\"\nlines = [8, 8]\n[[feature]]\nname = \"side\"\nkind = \"line\"\nplane = \"xy\"\nlines = [9, 9]\n";
    let turned = "EXX = 30.0\nEC0X = 200.0\nEC0Y = 200.0";
    let before = |errors: &str, alignment: &str| -> Vec<Found> {
        let part = format!("alignment = \"{alignment}\"\n{features}");
        inspected(errors, program, &part)
            .iter()
            .map(|feature| both(feature)[0])
            .collect()
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
