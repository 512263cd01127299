//! Files that no machine gave: another sphere, tool, sign or unit, columns in other letters. Each has its message; none gives numbers.

use std::fmt::Write;

use volcomp_identify::{Cause, FarFile, IdentifyError};
use volcomp_vocabulary::AxisName;

use crate::lab::{Lab, Noise, tip, value};

const MACHINE: &str = "structure = \"w C b X Y Z B t\"
axes.X.travel = [-500.0, 500.0]
axes.Y.travel = [-500.0, 500.0]
axes.Z.travel = [-500.0, 500.0]
axes.C.travel = [-360.0, 360.0]
axes.B.travel = [-100.0, 100.0]
[tool]
tip = [0.0, 0.0, -200.0]
[tools.probe]
tip = [0.0, 0.0, -240.0]
";
const UNKNOWN: &str = "folds = 0
unknown = [\"EX0C\", \"EY0C\"]
[[observation]]
kind = \"sphere\"
file = \"s.csv\"
";

/// Where a ball at [120, 40, −300] or [−150, 60, −280] on the table is met with the tool of `length`: closed form. C turns the
/// table, so that the tool goes round it by +C (ISO 841), B the tool.
fn rows(
    header: &str,
    length: f64,
    mut change: impl FnMut(usize, &mut [f64; 5], &mut &str),
) -> String {
    let mut noise = Noise::new(4);
    let mut text = format!("{header}\n");
    for k in 0..24_u8 {
        let (c, b) = (15.0 * f64::from(k) - 170.0, f64::from(k % 5) * 30.0 - 60.0);
        let ([x, y, z], mut name) = match k % 2 {
            0 => ([120.0, 40.0, -300.0], "one"),
            _ => ([-150.0, 60.0, -280.0], "two"),
        };
        let (sin_c, cos_c) = c.to_radians().sin_cos();
        let (sin_b, cos_b) = b.to_radians().sin_cos();
        let [x, y] = [cos_c * x + sin_c * y, cos_c * y - sin_c * x];
        let mut n = || noise.normal(0.0005);
        let mut at = [
            x + length * sin_b + n(),
            y + n(),
            z + length * cos_b + n(),
            c,
            b,
        ];
        change(usize::from(k), &mut at, &mut name);
        let [x, y, z, c, b] = at;
        let _ = writeln!(text, "{x:?},{y:?},{z:?},{c:?},{b:?},{name}");
    }
    text
}

fn found(text: &str) -> Result<volcomp_identify::Identification, IdentifyError> {
    let lab = Lab::new(MACHINE);
    lab.write("s.csv", text);
    lab.identify(UNKNOWN)
}

fn cause(text: &str) -> Option<Cause> {
    match found(text) {
        Err(IdentifyError::FarRows { files }) => match &files[..] {
            [FarFile { causes, .. }] => causes.first().cloned(),
            _ => panic!("{files:?}"),
        },
        other => panic!("{other:?}"),
    }
}

/// What is said of every file, the worst first.
fn far_files(lab: &Lab, observed: &str) -> Vec<(String, Vec<Cause>)> {
    match lab.identify(observed) {
        Err(IdentifyError::FarRows { files }) => files
            .into_iter()
            .map(|file| (file.file, file.causes))
            .collect(),
        other => panic!("{other:?}"),
    }
}

/// C the other way: with spheres on the other side of X and Y the other way it looks the same.
fn mirrored() -> Vec<Cause> {
    [AxisName::C, AxisName::Y].map(Cause::Reversed).to_vec()
}

/// The spheres of another file are others.
fn apart(name: &mut &str, [one, two]: [&'static str; 2]) {
    *name = if *name == "one" { one } else { two };
}

fn observations(files: &[&str]) -> String {
    let each = |file: &&str| format!("[[observation]]\nkind = \"sphere\"\nfile = \"{file}\"\n");
    let all: String = files.iter().map(each).collect();
    format!("folds = 0\nunknown = [\"EX0C\", \"EY0C\"]\n{all}")
}

/// Diagonals never are far off: a third of all rows, or nine tenths, they must not hide a file that is.
#[test]
fn the_cause_is_named_beside_diagonals() {
    let lab = Lab::new(MACHINE);
    let mut diagonal = String::from("X,Y,Z,deviation_um\n");
    for k in 0..200 {
        let at = f64::from(k) * 2.0 - 200.0;
        let _ = writeln!(diagonal, "{at},{at},{at},{:?}", 0.3 * f64::from(k % 3));
    }
    lab.write("d.csv", &diagonal);
    let observed = format!(
        "{}[[observation]]\nkind = \"line\"\nfile = \"d.csv\"\ndirection = [1, 1, 1]\n",
        observations(&["s.csv"])
    );
    lab.write("s.csv", &rows(HEADER, 200.0, |_, _, _| ()));
    lab.identify(&observed).expect("found");
    for (text, expected) in [
        (rows(HEADER, 200.0, |_, at, _| at[3] = -at[3]), mirrored()),
        (
            rows(HEADER, 200.0, |_, at, _| {
                for x in &mut at[..3] {
                    *x /= 25.4;
                }
            }),
            vec![Cause::Inches],
        ),
        (
            rows(HEADER, 240.0, |_, _, _| ()),
            vec![Cause::Tool("probe".to_owned())],
        ),
    ] {
        lab.write("s.csv", &text);
        let found = far_files(&lab, &observed);
        assert_eq!(found, [("s.csv".to_owned(), expected)]);
    }
}

#[test]
fn each_bad_file_is_named_with_its_own_cause() {
    let lab = Lab::new(MACHINE);
    lab.write("good.csv", &rows(HEADER, 200.0, |_, _, _| ()));
    let reversed = |_: usize, at: &mut [f64; 5], name: &mut &str| {
        apart(name, ["three", "four"]);
        at[3] = -at[3];
    };
    lab.write("reversed.csv", &rows(HEADER, 200.0, reversed));
    let inches = |_: usize, at: &mut [f64; 5], name: &mut &str| {
        apart(name, ["five", "six"]);
        for x in &mut at[..3] {
            *x /= 25.4;
        }
    };
    lab.write("inches.csv", &rows(HEADER, 200.0, inches));
    let named = |file: &str, causes| (file.to_owned(), causes);
    // A third of all rows: one bad file of three.
    lab.write(
        "too.csv",
        &rows(HEADER, 200.0, |_, _, name| apart(name, ["seven", "eight"])),
    );
    let one = far_files(
        &lab,
        &observations(&["good.csv", "too.csv", "reversed.csv"]),
    );
    assert_eq!(one, [named("reversed.csv", mirrored())]);
    let mut two = far_files(
        &lab,
        &observations(&["inches.csv", "good.csv", "reversed.csv"]),
    );
    two.sort_by(|a, b| a.0.cmp(&b.0));
    assert_eq!(
        two,
        [
            named("inches.csv", vec![Cause::Inches]),
            named("reversed.csv", mirrored())
        ]
    );
    // The same spheres in a good and in a bad file: the bad one is named, not both, and the places of the spheres are known.
    let same_spheres = |_: usize, at: &mut [f64; 5], _: &mut &str| at[3] = -at[3];
    lab.write("reversed.csv", &rows(HEADER, 200.0, same_spheres));
    let shared = far_files(&lab, &observations(&["good.csv", "reversed.csv"]));
    assert_eq!(
        shared,
        [named("reversed.csv", vec![Cause::Reversed(AxisName::C)])]
    );
}

/// Some rows of another sphere are neither "this row" nor "0.0 mm in the middle".
#[test]
fn several_rows_of_a_file_are_counted() {
    for bad in [4, 8] {
        let text = rows(HEADER, 200.0, |k, _, name| {
            if k < bad {
                apart(name, ["two", "one"]);
            }
        });
        match found(&text) {
            Err(IdentifyError::FarRows { files }) => {
                assert_eq!(files.len(), 1);
                assert_eq!((files[0].rows, files[0].of), (bad, 24), "{files:?}");
                assert!(files[0].typical_mm > 100.0, "{files:?}");
                assert_eq!(files[0].causes, []);
            }
            other => panic!("{other:?}"),
        }
    }
}

/// A mirrored cloud of points is mirrored whichever axis counts the other way: the frame turns with it.
#[test]
fn causes_that_are_equally_good_are_all_named() {
    let lab = Lab::new(
        "structure = \"w b X Y Z t\"\naxes = { X = { travel = [-500, 500] }, Y = { travel = [-500, 500] }, Z = { travel = [-500, 500] } }\n",
    );
    let mut noise = Noise::new(12);
    let mut text = String::from("X,Y,Z,x mm,y_mm,z [mm]\n");
    for _ in 0..20 {
        let [x, y, z] = [0; 3].map(|_| noise.between(-400.0, 400.0));
        let _ = writeln!(text, "{:?},{y:?},{z:?},{x:?},{y:?},{z:?}", -x);
    }
    lab.write("t.csv", &text);
    let observed =
        "folds = 0\nunknown = [\"EC0Y\"]\n[[observation]]\nkind = \"points\"\nfile = \"t.csv\"\n";
    let found = far_files(&lab, observed);
    let axes = [AxisName::X, AxisName::Y, AxisName::Z];
    let mut all = axes.map(Cause::Reversed).to_vec();
    let [x, y, z] = axes;
    all.extend([(x, y), (x, z), (y, z)].map(|(one, other)| Cause::Exchanged(one, other)));
    all.push(Cause::Mirrored);
    assert_eq!(found, [("t.csv".to_owned(), all)]);
}

const HEADER: &str = "X,Y,Z,C,B,sphere";

#[test]
fn rows_of_the_machine_itself_are_taken() {
    let found = found(&rows(HEADER, 200.0, |_, _, _| ())).expect("found");
    assert!(value(&found, "EX0C").0.abs() < 1.0);
    // Instead of a place of the tip that no ball has, one that turns about a ball.
    let next = found.next.expect("a pose");
    let of = |axis| {
        next.pose
            .iter()
            .find(|(name, _)| *name == axis)
            .map(|(_, at)| *at)
    };
    let [x, y, z, c, b] = [
        AxisName::X,
        AxisName::Y,
        AxisName::Z,
        AxisName::C,
        AxisName::B,
    ]
    .map(|axis| of(axis).expect("a coordinate"));
    let (sin_c, cos_c) = c.to_radians().sin_cos();
    let (sin_b, cos_b) = b.to_radians().sin_cos();
    let [u, v] = [x - 200.0 * sin_b, y];
    let ball = [
        cos_c * u - sin_c * v,
        cos_c * v + sin_c * u,
        z - 200.0 * cos_b,
    ];
    let is_at = |place: [f64; 3]| place.iter().zip(ball).all(|(a, b)| (a - b).abs() < 0.01);
    assert!(
        is_at([120.0, 40.0, -300.0]) || is_at([-150.0, 60.0, -280.0]),
        "{next:?} {ball:?}"
    );
}

#[test]
fn a_row_of_another_sphere_is_named() {
    let text = rows(HEADER, 200.0, |k, _, name| {
        if k == 7 {
            *name = "one";
        }
    });
    match found(&text) {
        Err(IdentifyError::FarRow {
            line: 9, found_mm, ..
        }) => assert!(found_mm > 100.0),
        other => panic!("{other:?}"),
    }
}

#[test]
fn what_makes_all_rows_wrong_is_named() {
    let reversed = rows(HEADER, 200.0, |_, at, _| at[3] = -at[3]);
    assert_eq!(cause(&reversed), Some(Cause::Reversed(AxisName::C)));
    let radians = rows(HEADER, 200.0, |_, at, _| {
        at[3] = at[3].to_radians();
        at[4] = at[4].to_radians();
    });
    assert_eq!(cause(&radians), Some(Cause::Radians));
    let radians_of_c = rows(HEADER, 200.0, |_, at, _| at[3] = at[3].to_radians());
    assert_eq!(cause(&radians_of_c), Some(Cause::RadiansOf(AxisName::C)));
    let inches_of_x = rows(HEADER, 200.0, |_, at, _| at[0] /= 25.4);
    assert_eq!(cause(&inches_of_x), Some(Cause::InchesOf(AxisName::X)));
    let inches = rows(HEADER, 200.0, |_, at, _| {
        for x in &mut at[..3] {
            *x /= 25.4;
        }
    });
    assert_eq!(cause(&inches), Some(Cause::Inches));
    let metres = rows(HEADER, 200.0, |_, at, _| {
        for x in &mut at[..3] {
            *x /= 1000.0;
        }
    });
    assert_eq!(cause(&metres), Some(Cause::Metres));
    let tool = rows(HEADER, 240.0, |_, _, _| ());
    assert_eq!(cause(&tool), Some(Cause::Tool("probe".to_owned())));
    // Two signs at once: no single cause, but no numbers either.
    let both = rows(HEADER, 200.0, |_, at, _| {
        at[3] = -at[3];
        at[0] += 3.0 * at[4];
    });
    assert_eq!(cause(&both), None);
}

#[test]
fn columns_in_other_letters_or_units_are_refused() {
    for (header, expected) in [
        ("X,Y,Z,c,B,sphere", "found a column `c`, expected `C`"),
        (
            "X,Y,Z,C [rad],B,sphere",
            "found a column `C [rad]`, expected `C`",
        ),
        (
            "X,Y,Z_inch,C,B,sphere",
            "found a column `Z_inch`, expected `Z`",
        ),
        (
            "X,Y,Z,C,B,Sphere",
            "found a column `Sphere`, expected `sphere`",
        ),
        (
            "X,Y,Z,A_deg,B,sphere",
            "found a column `A_deg`, the structure `w C' b X Y Z B t` has no axis A",
        ),
        (
            "X (in),Y,Z,C,B,sphere",
            "found a column `X (in)`, expected `X`",
        ),
        ("Xmm,Y,Z,C,B,sphere", "found a column `Xmm`, expected `X`"),
        (
            "X,Y,Z MCS,C,B,sphere",
            "found a column `Z MCS`, expected `Z`",
        ),
        (
            "X,Y,Z,C_actual,B,sphere",
            "found a column `C_actual`, expected `C`",
        ),
    ] {
        let error = found(&rows(header, 200.0, |_, _, _| ())).expect_err(header);
        assert!(error.to_string().contains(expected), "{error}");
    }
    let r_test = "X,Y,Z,C,B,sphere,dx_mm,dy_mm,dz_mm\n1,2,3,4,5,S,0.1,0.2,0.3\n";
    let error = found(r_test).expect_err("mm");
    assert!(
        error
            .to_string()
            .contains("found a column `dx_mm`, expected `dx_um`"),
        "{error}"
    );
}

/// With none of its three columns a file is that of a touch probe; one that is missing or misspelt does not make it one.
#[test]
fn an_r_test_has_all_three_columns() {
    for (columns, missing) in [
        ("foo,dy_um,dz_um", "dx_um"),
        ("dx_um,dy_um,foo", "dz_um"),
        ("dx_um,foo,bar", "dy_um"),
    ] {
        let text = format!("X,Y,Z,C,B,sphere,{columns}\n1,2,3,4,5,S,1,2,3\n");
        let error = found(&text).expect_err(columns).to_string();
        assert!(
            error.contains(&format!("`{missing}`")),
            "{columns}: {error}"
        );
    }
}

#[test]
fn axes_are_headed_by_their_letter_alone_or_with_the_unit() {
    let text = rows("X mm,Y_mm,Z [mm],C_deg,B (deg),sphere", 200.0, |_, _, _| ());
    let found_as_headed = found(&text).expect("found");
    assert!(value(&found_as_headed, "EX0C").0.abs() < 1.0);
    assert_eq!(found_as_headed.warnings, [""; 0]);
    // A column `x` that nobody reads beside `X mm`: noted, not taken for X.
    let mut beside = String::new();
    for (k, line) in rows("X mm,Y,Z,C,B,sphere", 200.0, |_, _, _| ())
        .lines()
        .enumerate()
    {
        let added = if k == 0 { "x" } else { "7" };
        for text in [line, ",", added, "\n"] {
            beside.push_str(text);
        }
    }
    let beside = found(&beside).expect("found");
    assert_eq!(beside.warnings.len(), 1, "{:?}", beside.warnings);
    assert!(beside.warnings[0].ends_with("columns that are not used: x"));
}

/// A tracker's columns may have their unit; in another one they are told by their own name, not by that of an axis.
#[test]
fn columns_of_targets_have_their_own_names() {
    let lab = Lab::new(MACHINE);
    lab.write("t.csv", "X,Y,x mm,y mm,z_um\n1,2,3,4,5\n");
    let observed = "unknown = [\"EC0Y\"]\n[[observation]]\nkind = \"points\"\nfile = \"t.csv\"\n";
    let message = lab.refused(observed);
    assert!(
        message.contains("found a column `z_um`, expected `z`:"),
        "{message}"
    );
}

#[test]
fn readings_below_their_uncertainty_are_noted() {
    let mut text = String::from("X,Y,Z,C,B,sphere,dx_um,dy_um,dz_um\n");
    for (k, line) in rows(HEADER, 200.0, |_, _, _| ())
        .lines()
        .skip(1)
        .enumerate()
    {
        let _ = writeln!(text, "{line},0.0{},0.01,-0.02", k % 7);
    }
    let found = found(&text).expect("found");
    let words = found.warnings.join("\n");
    assert!(
        words.contains("all are below their uncertainty: are they mm?"),
        "{words}"
    );
}

#[test]
fn a_pose_is_proposed_that_tells_of_what_is_not_determined() {
    // C stands still: nothing is known of its run-out.
    let lab = Lab::new(MACHINE);
    let mut still = format!("{HEADER}\n");
    for b in [-60.0_f64, -30.0, 0.0, 30.0, 60.0] {
        let (sin_b, cos_b) = b.to_radians().sin_cos();
        let _ = writeln!(
            still,
            "{:?},40.0,{:?},0,{b},one",
            120.0 + 200.0 * sin_b,
            -300.0 + 200.0 * cos_b
        );
    }
    lab.write("s.csv", &still);
    let found = lab
        .identify("folds = 0\nunknown = [\"EX0C\", \"EA0C\"]\n[[observation]]\nkind = \"sphere\"\nfile = \"s.csv\"\n")
        .expect("found");
    let next = found.next.expect("a pose");
    assert_eq!(next.improvement, None);
    let c = next
        .pose
        .iter()
        .find(|(axis, _)| *axis == AxisName::C)
        .expect("C")
        .1;
    assert!(c.rem_euclid(360.0) > 5.0, "{next:?}");
    assert!(
        ["EX0C", "EA0C"].contains(&next.parameter.as_str()),
        "{next:?}"
    );
}

/// An R-test and a touch probe on one machine, EX0C = 60 µm: the R-test with its signs the other way contradicts the probe.
#[test]
fn an_instrument_that_counts_the_other_way_is_named() {
    let lab = Lab::new(MACHINE);
    let mut noise = Noise::new(8);
    let mut probe = format!("{HEADER}\n");
    let mut r_test = String::from("X,Y,Z,C,B,sphere,dx_um,dy_um,dz_um\n");
    for k in 0..16 {
        let c = 22.5 * f64::from(k) - 170.0;
        let (sin_c, cos_c) = c.to_radians().sin_cos();
        // The ball turns about a line that lies 60 µm to +X: in workpiece axes the tip is off by −60·(cos C − 1), 60·sin C
        // turned back, which is (1 − cos C)·60 along X of the machine.
        let ball = [cos_c * 120.0 + sin_c * 40.0, cos_c * 40.0 - sin_c * 120.0];
        let off = [0.06 * (1.0 - cos_c), 0.06 * sin_c];
        let mut n = || noise.normal(0.0005);
        let _ = writeln!(
            probe,
            "{:?},{:?},{:?},{c},0,one",
            ball[0] + off[0] + n(),
            ball[1] + off[1] + n(),
            -100.0 + n()
        );
        // At the ideal place the tip stands off by as much the other way, in workpiece axes.
        let tip = [-off[0], -off[1]];
        let [dx, dy] = [
            cos_c * tip[0] - sin_c * tip[1],
            sin_c * tip[0] + cos_c * tip[1],
        ];
        let _ = writeln!(
            r_test,
            "{:?},{:?},-100,{c},0,one,{:?},{:?},{:?}",
            ball[0],
            ball[1],
            1e3 * (dx + n()),
            1e3 * (dy + n()),
            1e3 * n()
        );
    }
    lab.write("s.csv", &probe);
    lab.write("r.csv", &r_test);
    let both = format!("{UNKNOWN}[[observation]]\nkind = \"sphere\"\nfile = \"r.csv\"\n");
    let right = lab.identify(&both).expect("found");
    assert!(
        (value(&right, "EX0C").0 - 60.0).abs() < 1.0,
        "{:?}",
        right.parameters
    );
    assert_eq!(right.warnings, [""; 0]);
    let turned: String = r_test
        .lines()
        .enumerate()
        .map(|(row, line)| {
            let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
            if row > 0 {
                for cell in &mut cells[6..] {
                    *cell = format!("{:?}", -cell.parse::<f64>().expect("a number"));
                }
            }
            cells.join(",") + "\n"
        })
        .collect();
    lab.write("r.csv", &turned);
    let wrong = lab.identify(&both).expect("found");
    let words = wrong.warnings.join("\n");
    assert!(
        words.contains("r.csv: with the opposite sign of its readings"),
        "{words}"
    );
}

/// An R-test beside diagonals has one number in common with them, the squareness: the contradiction is small, but it goes with the
/// sign. Two instruments that contradict each other in size are not told to count the other way.
#[test]
fn an_opposite_sign_is_named_beside_diagonals() {
    use AxisName::{C, X, Y, Z};
    let truth = volcomp_model::Machine::parse(
        &format!("{MACHINE}[errors]\nEC0Y = 40.0\nEX0C = 30.0\nEY0C = -20.0\n"),
        "truth",
    )
    .expect("a machine");
    let lab = Lab::new(MACHINE);
    let nominal = lab.machine();
    let mut noise = Noise::new(21);
    let mut diagonals = String::from("X,Y,Z,deviation_um\n");
    for k in 0..40 {
        let x = f64::from(k) * 24.0 - 468.0;
        let at = [(X, x), (Y, x), (Z, 0.0)];
        let moved = tip(&truth, &at, [0.0; 3]) - tip(&nominal, &at, [0.0; 3]);
        let along = (moved.x + moved.y) / 2.0_f64.sqrt();
        let _ = writeln!(diagonals, "{x},{x},0,{:?}", 1e3 * along + noise.normal(1.0));
    }
    lab.write("d.csv", &diagonals);
    let mut r_test = |sign: f64| {
        let mut text = String::from("X,Y,Z,C,B,sphere,dx_um,dy_um,dz_um\n");
        for k in 0..24 {
            let c = 15.0 * f64::from(k) - 170.0;
            let (sin_c, cos_c) = c.to_radians().sin_cos();
            let (x, y) = (cos_c * 120.0 + sin_c * 40.0, cos_c * 40.0 - sin_c * 120.0);
            let at = [(X, x), (Y, y), (Z, -100.0), (C, c)];
            let off = tip(&truth, &at, [0.0; 3]) - tip(&nominal, &at, [0.0; 3]);
            let [dx, dy, dz] =
                [off.x, off.y, off.z].map(|off| sign * (1e3 * off + noise.normal(1.0)));
            let _ = writeln!(text, "{x:?},{y:?},-100,{c},0,one,{dx:?},{dy:?},{dz:?}");
        }
        text
    };
    let [right, turned] = [1.0, -1.0].map(&mut r_test);
    let observed = "folds = 0
unknown = [\"EC0Y\", \"EX0C\", \"EY0C\"]
[[observation]]
kind = \"sphere\"
file = \"r.csv\"
[[observation]]
kind = \"line\"
file = \"d.csv\"
direction = [1, 1, 0]
";
    lab.write("r.csv", &right);
    let found = lab.identify(observed).expect("found");
    assert!((value(&found, "EC0Y").0 - 40.0).abs() < 3.0);
    assert_eq!(found.warnings, [""; 0]);
    lab.write("r.csv", &turned);
    let found = lab.identify(observed).expect("found");
    let words = found.warnings.join("\n");
    assert!(
        words.contains("r.csv: with the opposite sign of its readings"),
        "{words}"
    );
    // As large a contradiction with the same sign.
    let steeper: String = diagonals
        .lines()
        .map(|line| match line.rsplit_once(',') {
            Some((at, um)) => match um.parse::<f64>() {
                Ok(um) => format!("{at},{:?}\n", 3.0 * um),
                Err(_) => format!("{line}\n"),
            },
            None => String::new(),
        })
        .collect();
    lab.write("r.csv", &right);
    lab.write("d.csv", &steeper);
    let found = lab.identify(observed).expect("found");
    let words = found.warnings.join("\n");
    assert!(words.contains("times the stated uncertainty"), "{words}");
    assert!(!words.contains("opposite sign"), "{words}");
}

/// Everything in inches on a machine without a length of its own fits as well as in mm.
#[test]
fn rows_that_keep_to_a_small_part_of_the_travel_are_noted() {
    let lab = Lab::new(
        "structure = \"w b X Y t\"\naxes = { X = { travel = [0, 600] }, Y = { travel = [0, 500] } }\ntool = { tip = [0, 0, 0] }\n",
    );
    let mut text = String::from("X,Y,x,y,z\n");
    for (x, y) in [
        (1, 1),
        (1, 19),
        (12, 3),
        (23, 1),
        (22, 18),
        (11, 10),
        (5, 14),
    ] {
        let _ = writeln!(text, "{x},{y},{x},{y},0");
    }
    lab.write("t.csv", &text);
    let observed =
        "folds = 0\nunknown = [\"EC0Y\"]\n[[observation]]\nkind = \"points\"\nfile = \"t.csv\"\n";
    let found = lab.identify(observed).expect("found");
    let words = found.warnings.join("\n");
    assert!(words.contains("% of their travel at the most"), "{words}");
    // A judged row far off is named, too.
    lab.write("j.csv", "X,Y,x,y,z\n2,2,2,2,0\n9,9,9,9,0\n20,15,70,15,0\n");
    let judged =
        format!("{observed}[[observation]]\nkind = \"points\"\nfile = \"j.csv\"\njudge = true\n");
    let found = lab.identify(&judged).expect("found");
    let words = found.warnings.join("\n");
    assert!(words.contains("j.csv:4: this judged row is 50"), "{words}");
}

/// Lengths between poses move the axes from the one pose to the other: only the ends to which they go lie close together.
#[test]
fn lengths_between_poses_over_the_travel_are_no_small_moves() {
    let lab = Lab::new("structure = \"w b X t\"\naxes.X.travel = [-300.0, 300.0]\n");
    let said = |far: [f64; 5]| {
        let mut text = String::from("pose,X,from,to,length_mm\na,0,,,\nb,1,,,\n");
        for (k, x) in far.iter().enumerate() {
            let _ = writeln!(text, "p{k},{x:?},,,");
        }
        for (k, x) in far.iter().enumerate() {
            let (to, at) = if k % 2 == 0 { ("a", 0.0) } else { ("b", 1.0) };
            let _ = writeln!(text, ",,p{k},{to},{:?}", (x - at).abs());
        }
        lab.write("g.csv", &text);
        let observed = "folds = 0\nunknown = [{ error = \"EXX\", legendre = 1 }]\n[[observation]]\nkind = \"distance\"\nfile = \"g.csv\"\n";
        lab.identify(observed).expect("found").warnings.join("\n")
    };
    let words = said([-250.0, -100.0, 100.0, 200.0, 250.0]);
    assert!(!words.contains("of their travel at the most"), "{words}");
    let words = said([-5.0, -3.0, 4.0, 5.0, 6.0]);
    assert!(
        words.contains("1.8 % of their travel at the most"),
        "{words}"
    );
}

/// The same name in two files, each of which fits alone; a shifted display of one file where it does not.
#[test]
fn a_sphere_at_two_places_is_named() {
    let lab = Lab::new(MACHINE);
    let header = "X,Y,Z,C,B,sphere";
    lab.write("low.csv", &rows(header, 200.0, |_, _, name| *name = "S1"));
    // Both balls at one name are no sphere: only the first.
    let only = |text: &str, odd: bool| -> String {
        let keep = |line: usize| line == 0 || (line % 2 == 1) != odd;
        let lines = text.lines().enumerate();
        lines
            .filter(|(line, _)| keep(*line))
            .flat_map(|(_, line)| [line, "\n"])
            .collect()
    };
    let all = rows(header, 200.0, |_, _, name| *name = "S1");
    lab.write("low.csv", &only(&all, false));
    lab.write("high.csv", &only(&all, true));
    let both = observations(&["low.csv", "high.csv"]);
    match lab.identify(&both) {
        Err(error @ IdentifyError::MovedSphere { .. }) => {
            let words = error.to_string();
            assert!(
                words.contains("S1 stands in low.csv and high.csv at different places, 271.")
                    && words.contains("give it another name in one of them"),
                "{words}"
            );
        }
        other => panic!("{other:?}"),
    }
    // With a name of its own it fits.
    lab.write("high.csv", &only(&all, true).replace("S1", "S2"));
    assert!(lab.identify(&both).is_ok());
}

/// A work offset or a tool length in the display: all X, Y, Z are shifted alike.
#[test]
fn shifted_coordinates_are_named() {
    let by = [30.0, -45.0, 160.0];
    let text = rows("X,Y,Z,C,B,sphere", 200.0, |_, at, _| {
        for (at, by) in at.iter_mut().zip(by) {
            *at += by;
        }
    });
    let Some(Cause::Shifted(shifts)) = cause(&text) else {
        panic!("{:?}", cause(&text));
    };
    // What was added has to be taken away; the spheres were met by some 0.5 µm.
    for (axis, expected) in [(AxisName::X, -30.0), (AxisName::Y, 45.0)] {
        let found = shifts.iter().find(|(name, _)| *name == axis);
        let found = found.expect("a shift").1 as f64 * 1e-3;
        assert!(
            (found - expected).abs() < 0.01,
            "{axis}: {found} {shifts:?}"
        );
    }
    // Along the axis of the table a shift only puts the spheres higher.
    assert!(
        shifts.iter().all(|(name, _)| *name != AxisName::Z),
        "{shifts:?}"
    );
    let words = Cause::Shifted(shifts).to_string();
    assert!(words.contains("work offset or a tool length"), "{words}");
}
