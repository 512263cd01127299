//! A five-axis machine with a tilting rotary table, checked by independent kinematics and the exact model.

use volcomp_model::{
    Machine, Temperatures,
    kinematics::Form,
    vocabulary::{
        AxisName::{self, A, C, X, Y, Z},
        CorrectionLimit,
    },
};
use volcomp_nc::{BoundViolation, Decimals, Dialect, Job, NcError, SetUp, Summary, Verification};

use crate::{
    identity::{begins, has, result_of, verified_by},
    random_programs::{Draw, copy_unchanged},
};

const EXAMPLE: &str = include_str!("../../../../examples/table-tilting.toml");
const LINEAR_WORDS: &str = "rotary_words = \"linear\"\n";
/// Intersection of the table's centre lines, and length of the machine's own tool, mm.
const POINT: [f64; 3] = [300.0, 250.0, -450.0];
const LENGTH: f64 = 150.0;

/// The example machine with a tool of this length and without backlash, so that directions of approach do not matter.
fn machine(length: f64) -> Machine {
    let text = EXAMPLE
        .replace("length = 150.0", &format!("length = {length}"))
        .replace("reversal = 2.0", "reversal = 0.0");
    Machine::parse(&text, "m.toml").expect("a good machine")
}

fn run(machine: &Machine, setup: &str, program: &str, decimals: Decimals) -> (String, Summary) {
    let setup = SetUp::parse(setup, "setup.toml").expect("a set-up");
    let result = result_of((machine, 0.001), &setup, program.as_bytes(), |job| Job {
        decimals,
        keep_shares: true,
        ..job
    });
    let (out, summary) = result.expect("compensated");
    (String::from_utf8(out).expect("text"), summary)
}

/// The result with the default decimals, and the tool deviation with both programs.
fn verified(machine: &Machine, setup: &str, program: &str) -> (Summary, Verification) {
    let (out, summary) = run(machine, setup, program, Decimals::default());
    let setup = SetUp::parse(setup, "setup.toml").expect("a set-up");
    let texts = [program, out.as_str()];
    let found = verified_by(machine, &setup, Dialect::Rs274, texts, &summary.shares);
    (summary, found.expect("verified"))
}

/// Position of a point of the bed in table coordinates, with the table tilted by `a` and turned by `c`, deg.
fn seen_from_table([x, y, z]: [f64; 3], a: f64, c: f64) -> [f64; 3] {
    let (a, c) = (a.to_radians(), c.to_radians());
    let [x, y, z] = [x - POINT[0], y - POINT[1], z - POINT[2]];
    let (y, z) = (a.cos() * y - a.sin() * z, a.sin() * y + a.cos() * z);
    let (x, y) = (c.cos() * x - c.sin() * y, c.sin() * x + c.cos() * y);
    [x + POINT[0], y + POINT[1], z + POINT[2]]
}

fn in_bed([x, y, z]: [f64; 3], a: f64, c: f64) -> [f64; 3] {
    let (a, c) = (a.to_radians(), c.to_radians());
    let [x, y, z] = [x - POINT[0], y - POINT[1], z - POINT[2]];
    let (x, y) = (c.cos() * x + c.sin() * y, -c.sin() * x + c.cos() * y);
    let (y, z) = (a.cos() * y + a.sin() * z, -a.sin() * y + a.cos() * z);
    [x + POINT[0], y + POINT[1], z + POINT[2]]
}

/// The last value of each of X Y Z A C, after each line.
fn places(program: &str) -> Vec<[f64; 5]> {
    let mut at = [0.0; 5];
    let line = |line: &str| {
        for (i, letter) in "XYZAC".chars().enumerate() {
            if let Some(text) = line.split(letter).nth(1) {
                let number: String = text
                    .chars()
                    .take_while(|c| c.is_ascii_digit() || matches!(c, '.' | '-' | '+'))
                    .collect();
                at[i] = number.parse().expect("a number");
            }
        }
        at
    };
    program.lines().map(line).collect()
}

/// Tip deviation (µm) with a tool of this length and the axes at `commanded`.
fn miss_um(length: f64, wanted: [f64; 5], commanded: [f64; 5]) -> f64 {
    const NAMES: [AxisName; 5] = [X, Y, Z, A, C];
    let machine = machine(length);
    let state = |at: [f64; 5]| {
        let named: Vec<_> = NAMES.into_iter().zip(at).collect();
        machine.state(&named).expect("five axes")
    };
    let error = machine.error_at(&state(commanded), Form::Exact, &Temperatures::new());
    let tip = |[x, y, z, a, c]: [f64; 5]| seen_from_table([x, y, z - length], a, c);
    let (wanted, reached) = (tip(wanted), tip(commanded));
    let off: f64 = (0..3).map(|i| (reached[i] + error.position_mm[i] - wanted[i]).powi(2)).sum();
    1e3 * off.sqrt()
}

const PLACES: [[f64; 5]; 6] = [
    [320.0, 240.0, -180.0, 0.0, 0.0],
    [120.0, 330.0, -150.0, -30.0, 45.0],
    [410.0, 120.0, -90.0, -75.0, 200.0],
    [300.0, 250.0, -50.0, -90.0, -120.0],
    [250.0, 300.0, -200.0, 20.0, 10.0],
    [310.0, 260.0, -160.0, -0.05, 300.0],
];

/// Random poses away from singular ones, where errors that only C could correct remain.
fn random_places(count: usize) -> Vec<[f64; 5]> {
    let mut draw = Draw::new(7);
    let mut random = |low, high| draw.between(low, high);
    let mut places = PLACES.to_vec();
    while places.len() < count {
        let a = random(-100.0, 25.0);
        if a.abs() > 2.0 {
            let [x, y] = [random(50.0, 550.0), random(50.0, 450.0)];
            places.push([x, y, random(-300.0, 0.0), a, random(-350.0, 350.0)]);
        }
    }
    let round = |value: f64, by: f64| (value * by).round() / by;
    for [x, y, z, a, c] in &mut places {
        for length in [x, y, z] {
            *length = round(*length, 1e6);
        }
        for angle in [a, c] {
            *angle = round(*angle, 1e4);
        }
    }
    places
}

fn program(first: &str, places: impl Iterator<Item = [f64; 5]>) -> String {
    let lines =
        places.map(|[x, y, z, a, c]| format!("G0 X{x:.6} Y{y:.6} Z{z:.6} A{a:.4} C{c:.4}\n"));
    format!("{first}\n{}", lines.collect::<String>())
}

/// The linear axes match the rounded words of A and C, so that the tip error is below 0.9 µm. Rounding A or C alone by 0.001° would cost
/// up to 2.6 µm at 300 mm.
#[test]
fn coordinates_of_the_axes() {
    let machine = machine(LENGTH);
    let text = program("G90 G54", random_places(300).into_iter());
    let (out, _) = run(&machine, LINEAR_WORDS, &text, Decimals::default());
    let mut before = 0.0;
    for (wanted, commanded) in random_places(300).into_iter().zip(places(&out).into_iter().skip(1))
    {
        before += miss_um(LENGTH, wanted, wanted);
        let miss = miss_um(LENGTH, wanted, commanded);
        assert!(miss < 0.9, "{wanted:?}: {miss} µm, rounding is 0.87");
    }
    assert!(before / 300.0 > 10.0, "nothing to correct: {before}");
}

/// The same positions with tool centre point control, in table coordinates and with a tool of the program: the tip error is below 0.1 µm.
#[test]
fn coordinates_of_the_centre_point() {
    let own = machine(LENGTH);
    for (setup, first, more, length) in [
        ("tool_centre_point = true\n", "G90 G54", 0.0, LENGTH),
        ("", "G90 M428", 0.0, LENGTH),
        ("[tool.3]\nZ = 90\n", "G90 G43.4 H3", 90.0, 90.0),
    ] {
        // The control computes the axes from tip and tool length; at A0 C0 the coordinates are those of the axes.
        let to_centre = |[x, y, z, a, c]: [f64; 5]| {
            let [x, y, z] = seen_from_table([x, y, z - length], a, c);
            [x, y, z + length - more, a, c]
        };
        let to_axes = |[x, y, z, a, c]: [f64; 5]| {
            let [x, y, z] = in_bed([x, y, z - length + more], a, c);
            [x, y, z + length, a, c]
        };
        let text = program(first, random_places(300).into_iter().map(to_centre));
        let decimals = Decimals { mm: 4, ..Decimals::default() };
        let (out, _) = run(&own, &format!("{LINEAR_WORDS}{setup}"), &text, decimals);
        let commanded = places(&out).into_iter().skip(1).map(to_axes);
        for (wanted, commanded) in random_places(300).into_iter().zip(commanded) {
            let miss = miss_um(length, wanted, commanded);
            assert!(miss < 0.1, "{first}, {wanted:?}: {miss} µm");
        }
    }
}

/// Only X corrects. In the coordinates of a turned table its correction is in all words of the centre point.
#[test]
fn one_linear_axis_corrects_all_words_of_the_centre_point() {
    let text = EXAMPLE.replace("reversal = 2.0", "reversal = 0.0");
    let own = Machine::parse(&format!("correct = [\"X\"]\n{text}"), "m.toml").expect("good");
    let to_centre = |[x, y, z, a, c]: [f64; 5]| {
        let [x, y, z] = seen_from_table([x, y, z - LENGTH], a, c);
        [x, y, z + LENGTH, a, c]
    };
    let places_to_go = || random_places(50).into_iter();
    let text = program("G90 G54", places_to_go().map(to_centre));
    let decimals = Decimals { mm: 5, ..Decimals::default() };
    let setup = format!("{LINEAR_WORDS}tool_centre_point = true\n");
    let (out, _) = run(&own, &setup, &text, decimals);
    for (wanted, [x, y, z, a, c]) in places_to_go().zip(places(&out).into_iter().skip(1)) {
        let commanded = in_bed([x, y, z - LENGTH], a, c);
        let state = own.state(&[X, Y, Z, A, C].into_iter().zip(wanted).collect::<Vec<_>>());
        let error = own.error_at(&state.expect("five axes"), Form::Exact, &Temperatures::new());
        let [along, at] = [1.0, 0.0].map(|by| seen_from_table([by, 0.0, 0.0], a, c));
        let by_x: f64 = (0..3).map(|i| (along[i] - at[i]) * error.position_mm[i]).sum();
        let expected = [wanted[0] - by_x, wanted[1], wanted[2] - LENGTH];
        let off = (0..3).map(|i| (commanded[i] - expected[i]).powi(2)).sum::<f64>().sqrt();
        assert!(off < 1e-4, "{wanted:?}: {commanded:?}, {expected:?}");
    }
}

/// A straight path of the centre point while the table turns is split where the correction bends: the tip error falls from above 20 to
/// below 1.9 µm.
#[test]
fn centre_point_paths_are_within_the_tolerance() {
    let machine = machine(LENGTH);
    let program = "G90 G0 X300 Y250 Z-250 A0 C0\nG1 F1000 X340 Y260 A-40 C60\nX250 Y220 Z-260 A-80 C170\nX260 A10 C10\nG2 X300 Y260 I20 J20 C60\n";
    let (summary, found) = verified(&machine, "tool_centre_point = true\n", program);
    assert!(found.before.max_um > 20.0, "{found:?}");
    // Tolerance of 1 µm plus the rounding of three words.
    assert!(found.after.max_um < 1.9, "{:?}", found.after);
    assert!(summary.counts.added > 10, "{:?}", summary.counts);
}

/// Tool centre point control lasts from M428 or the set-up to M429, and from G43.4 to G49, whatever tool length is selected in between.
#[test]
fn centre_point_control_lasts_until_it_is_switched_off() {
    let machine = machine(LENGTH);
    let goes = "G0 X310 Y260 Z-250 A-60 C90\n";
    let last = |setup: &str, first: &str| {
        let program = format!("G0 X300 Y250 Z-100 A0 C0\n{first}\n{goes}");
        let (out, _) = run(&machine, setup, &program, Decimals::default());
        out.lines().last().expect("there are lines").to_owned()
    };
    let by_centre = last("", "G43.1 Z150\nM428");
    let by_axes = last("", "G43.1 Z150");
    assert_ne!(by_centre, by_axes);
    let on = "tool_centre_point = true\n";
    for (setup, first) in
        [("", "M428\nG43.1 Z150"), ("", "M428\nG49\nG43.1 Z150"), (on, "G43.1 Z150")]
    {
        assert_eq!(last(setup, first), by_centre, "{first}");
    }
    for (setup, first) in
        [("", "M428\nG43.1 Z150\nM429"), (on, "M429\nG43.1 Z150"), ("", "G43.4\nG49\nG43.1 Z150")]
    {
        assert_eq!(last(setup, first), by_axes, "{first}");
    }
}

/// An axis with backlash reverses in a straight path of the centre point: a part of the split path corrects it there.
#[test]
fn play_is_taken_up_where_an_axis_reverses() {
    let text = EXAMPLE.replace("reversal = 2.0", "reversal = 20.0");
    let machine = Machine::parse(&text, "m.toml").expect("a good machine");
    let program =
        "G90 G0 X300 Y250 Z-250 A0 C0\nG1 F1000 X340 Y260 A-40 C60\nX250 Y220 Z-260 A-80 C170\n";
    let (summary, found) = verified(&machine, "tool_centre_point = true\n", program);
    assert!(found.after.max_um < 2.5, "{:?}", found.after);
    let inner = summary.shares.windows(2).filter(|pair| pair[0] == pair[1] && pair[0] > 0.0);
    assert!(inner.count() > 0, "{:?}", summary.shares);
}

#[test]
fn own_kinematics_after_m428_are_refused() {
    let mut machine = machine(LENGTH);
    machine.clear_errors();
    let taken = |program: &str| copy_unchanged(&machine, Dialect::Rs274, program.as_bytes());
    for good in ["M430\nG1 X1 F1\n", "M428\nG1 X1 F1\nM429\nM430\nG1 X2\n"] {
        taken(good).expect("taken");
    }
    let error = taken("M428\nG1 X1 F1\nM430\nG1 X2\n").expect_err("refused");
    assert!(error.to_string().starts_with("line 3: M430 after M428"), "{error}");
}

/// With tool centre point control, words of a rotary axis that the machine file lacks are refused, because the table would turn.
#[test]
fn rotary_words_of_missing_axes_are_refused_with_centre_point_control() {
    let mut machine = machine(LENGTH);
    machine.clear_errors();
    let taken = |program: &str| copy_unchanged(&machine, Dialect::Rs274, program.as_bytes());
    taken("G1 X1 B10 F1\nM428\nG1 X2 A5 C5\nM429\nB20\n").expect("taken");
    let error = taken("M428\nG1 X1 F1\nX2 B10\n").expect_err("refused");
    assert!(
        error.to_string().starts_with("line 3: a motion of B, which the machine file lacks"),
        "{error}"
    );
}

#[test]
fn a_new_tool_length_at_a_tilt_makes_positions_unknown() {
    let machine = machine(LENGTH);
    let program = "M428\nG43.1 Z93\nG0 X320 Y260 Z-300 A0 C0\nG1 Z-350 A29 C45 F100\nG43.1 Z120\nG1 Z-340\nG1 X330\nY250\nM2\n";
    let (result, _) = run(&machine, "", program, Decimals::default());
    let behind: Vec<&str> =
        result.lines().skip_while(|line| !line.starts_with("G43.1 Z120")).collect();
    let names = |line: &str| -> String { line.chars().filter(|c| "XYZAC".contains(*c)).collect() };
    assert_eq!(names(behind[1]), "Z", "{result}");
    assert_eq!(names(behind[2]).replace('Z', ""), "X", "{result}");
    assert!(names(behind[3]).contains('Y'), "{result}");
}

/// The tool in the spindle (M6) counts, not the one that T selects for the next change.
#[test]
fn the_length_is_that_of_the_tool_in_the_spindle() {
    let machine = machine(LENGTH);
    let setup =
        "[tool.1]\nZ = 93.0\n[tool.2]\nZ = 61.0\n[start]\nX = 0\nY = 0\nZ = 0\nA = 0\nC = 0\n";
    let program = |length: &str| format!("T1 M6\nT2\n{length}\nG0 X100 Y200 Z-300 A20 C30\nM2\n");
    let last = |length: &str| {
        let (result, _) = run(&machine, setup, &program(length), Decimals::default());
        result.lines().nth(3).expect("a line").to_owned()
    };
    assert_eq!(last("G43"), last("G43 H1"));
    assert_ne!(last("G43 H2"), last("G43 H1"));
}

/// The points that the book gives for the centre lines of LinuxCNC's `xyzac-trt` and `xyzbc-trt` reproduce their formulas within 1e-9 mm.
#[test]
fn linuxcnc_centre_lines_equal_points_of_the_machine_file() {
    let [x_rot_point, y_rot_point, z_rot_point] = [10.0, 20.0, 30.0];
    let [x_offset, y_offset, z_offset] = [6.0, 4.0, 5.0];
    let joints = [33.0, -41.0, -52.0];
    let [tilt, turn] = [25.0_f64, 40.0].map(f64::to_radians);
    // Rotation about a point in the plane of two axes.
    let turned = |at: [f64; 3], [i, j]: [usize; 2], about: [f64; 2], by: f64| {
        let (sin, cos) = by.sin_cos();
        let [u, v] = [at[i] - about[0], at[j] - about[1]];
        let mut to = at;
        to[i] = about[0] + cos * u - sin * v;
        to[j] = about[1] + sin * u + cos * v;
        to
    };
    for tilting in ["A", "B"] {
        let (plane, line, point, direction) = if tilting == "A" {
            let line = [y_rot_point + y_offset, z_rot_point + z_offset];
            ([1, 2], line, [0.0, line[0], line[1]], "[-1, 0, 0]")
        } else {
            let line = [z_rot_point + z_offset, x_rot_point + x_offset];
            ([2, 0], line, [line[1], 0.0, line[0]], "[0, -1, 0]")
        };
        let text = format!(
            "name = \"trt\"\nstructure = \"w C' {tilting}' X' Y' b Z t\"\n\
             [axes.C]\ntravel = [-3600, 3600]\ndirection = [0, 0, -1]\npoint = [{x_rot_point}, {y_rot_point}, 0]\n\
             [axes.{tilting}]\ntravel = [-100, 50]\ndirection = {direction}\npoint = {point:?}\n\
             [axes.X]\ntravel = [-200, 200]\n[axes.Y]\ntravel = [-200, 200]\n[axes.Z]\ntravel = [-300, 100]\n\
             [tool]\ngauge = [0, 0, 0]\n[errors]\nEXX = 30.0\n"
        );
        let machine = Machine::parse(&text, "m.toml").expect("a good machine");
        let program = format!("G21 G90\nG0 X33 Y-41 Z-52 {tilting}25 C40\nM2\n");
        let (_, found) = verified(&machine, "", &program);
        let tip = found.before.tip_mm;
        let back = turned(joints, plane, line, -tilt);
        let expected = turned(back, [0, 1], [x_rot_point, y_rot_point], -turn);
        for (found, expected) in tip.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-9, "{tilting}: {tip:?}");
        }
    }
}

/// Positions of a modulo axis beyond its travel get no note; those of other axes do.
#[test]
fn an_axis_with_modulo_does_not_leave_its_travel() {
    let turns = "G0 X10 Y20 Z0 A0 C0\nG1 C370 F500\nC-900.5\nC12345\n";
    for (modulo, expected) in [("modulo = 360.0\n", None), ("", Some("C leaves its travel"))] {
        let text = format!(
            "structure = \"w C' A' X' Y' b Z t\"\n[axes.X]\ntravel = [-300, 300]\n[axes.Y]\ntravel = [-300, 300]\n[axes.Z]\ntravel = [-300, 300]\n[axes.A]\ntravel = [-100, 100]\n[axes.C]\ntravel = [0, 360]\n{modulo}[errors]\nEC0Y = 20.0\n"
        );
        let machine = Machine::parse(&text, "m.toml").expect("a good machine");
        let setup = "rotary_words = \"linear\"\n";
        let (_, summary) = run(&machine, setup, turns, Decimals::default());
        let notes: Vec<String> = (summary.notes.by_line().iter())
            .map(|(_, note)| note.to_string())
            .filter(|note| note.contains("leaves its travel"))
            .collect();
        match expected {
            None => assert!(notes.is_empty(), "{notes:?}"),
            Some(expected) => assert!(notes[0].starts_with(expected), "{notes:?}"),
        }
    }
    // A cradle cannot turn beyond its travel.
    let text = "structure = \"w C' A' X' Y' b Z t\"\n[axes.X]\ntravel = [-300, 300]\n[axes.Y]\ntravel = [-300, 300]\n[axes.Z]\ntravel = [-300, 300]\n[axes.A]\ntravel = [-100, 100]\nmodulo = 360.0\n[axes.C]\ntravel = [0, 360]\nmodulo = 360.0\n[errors]\nEC0Y = 20.0\n";
    let machine = Machine::parse(text, "m.toml").expect("a good machine");
    let program = "G0 X10 Y20 Z0 A0 C0\nA300\nA150\n";
    let setup = "rotary_words = \"linear\"\n";
    let (_, summary) = run(&machine, setup, program, Decimals::default());
    let lines: Vec<usize> = (summary.notes.by_line().iter())
        .filter(|(_, note)| note.to_string().contains("A leaves its travel"))
        .map(|(line, _)| *line)
        .collect();
    assert_eq!(lines, [3]);
}

/// A motion of half a turn or more of a rollover axis is refused unless the set-up states the direction.
#[test]
fn the_direction_of_a_modulo_axis_must_be_stated() {
    const MODULO: &str = "travel = [0, 360]\nmodulo = 360.0\n";
    const TURNS: &str = "travel = [-360, 360]\n";
    const SWIVELS: &str = "travel = [-175, 175]\n";
    const LINEAR: &str = "rotary_words = \"linear\"\n";
    const SHORTER: &str = "rotary_words = \"shorter\"\n";
    let machine = |travel: &str| {
        let text = format!(
            "structure = \"w C' X' Y' b Z t\"\n[axes.X]\ntravel = [-300, 300]\n[axes.Y]\ntravel = [-300, 300]\n[axes.Z]\ntravel = [-300, 300]\n[axes.C]\n{travel}[errors]\nECC = {{ poly = [50.0] }}\n"
        );
        Machine::parse(&text, "m.toml").expect("a good machine")
    };
    let result = |travel: &str, setup: &str, program: &str| {
        let machine = machine(travel);
        let setup = SetUp::parse(setup, "setup.toml").expect("a set-up");
        let result = result_of((&machine, 0.001), &setup, program.as_bytes(), |job| job);
        result.map_err(|e| e.to_string()).map(|(out, summary)| {
            let notes = summary.notes.by_line().into_iter();
            let notes = notes.filter(|(_, note)| note.to_string().contains("may roll over"));
            let lines: Vec<usize> = notes.map(|(line, _)| line).collect();
            (String::from_utf8(out).expect("text"), lines)
        })
    };
    let over_the_end = "G0 X10 Y20 Z0 C250\nG1 C10 F500\n";
    for program in
        [over_the_end, "G0 X10 Y20 Z0 C0\nC180\n", "G0 X10 Y20 Z0 C0\nG1 X20 C-200 F500\n"]
    {
        let (_, noted) = result(TURNS, "", program).expect(program);
        assert!(!noted.is_empty(), "{program}");
        let fanuc = "control = \"fanuc\"\nwithout_point = \"unit\"\n";
        for (travel, setup) in [(MODULO, ""), (TURNS, fanuc)] {
            let error = result(travel, setup, program).expect_err(program);
            begins(&error, "line 2: ");
            has(&error, "rotary_words");
        }
        // A tilting axis cannot roll over.
        result(SWIVELS, "", program).expect(program);
    }
    result(MODULO, "", "G0 X10 Y20 Z0 C0\nG91 G1 C250 F500\n").expect("a way");
    // For half a turn there is no shorter way.
    let error = result(MODULO, SHORTER, "G0 X10 Y20 Z0 C0\nC180\n").expect_err("half a turn");
    assert!(error.contains("shorter way"), "{error}");
    for (setup, notes) in [("", &[1][..]), (LINEAR, &[]), (SHORTER, &[])] {
        let (_, found) =
            result(MODULO, setup, "G0 X10 Y20 Z0 C0\nG1 C90 F500\nC10\n").expect("compensated");
        assert_eq!(found, notes, "{setup}");
    }
    let words = |setup: &str| -> Vec<f64> {
        let (out, _) = result(MODULO, setup, over_the_end).expect("compensated");
        places(&out).iter().map(|place| place[4]).collect()
    };
    let (linear, shorter) = (words(LINEAR), words(SHORTER));
    for words in [&linear, &shorter] {
        assert!(words.len() > 2, "it is split: {words:?}");
        assert_eq!((words[0], words[words.len() - 1] % 360.0), (250.0, 10.0));
    }
    assert!(linear.windows(2).all(|pair| pair[1] < pair[0]), "{linear:?}");
    // The set-up applies to rollover axes only: this C is not one and turns by +200° through 0, within its travel.
    let swivel = "G0 X10 Y20 Z0 C-100\nG1 C100 F500\n";
    let (out, _) = result(SWIVELS, SHORTER, swivel).expect("compensated");
    let turned: Vec<f64> = places(&out).iter().map(|place| place[4]).collect();
    assert!(turned.windows(2).all(|pair| pair[1] > pair[0]), "{turned:?}");
    assert!(shorter.iter().all(|c| !(10.1..249.9).contains(c)), "{shorter:?}");
}

/// Errors of a table that turns about A. `START` is the start of the programs.
const TILTED: &str =
    "EC0A = 200.0\nEZA = { table = [[-360, -15], [360, 15]], interpolation = \"linear\" }\n";
const START: &str = "G94 G0 X20 Y0 Z30 A0\nG1 Z25 F100\n";

fn turned(errors: &str, setup: &str, dialect: Dialect, program: &str) -> Result<String, String> {
    let travel = "travel = [-300, 300]\n";
    let text = format!(
        "structure = \"w A' X' Y' b Z t\"\n[axes.X]\n{travel}[axes.Y]\n{travel}[axes.Z]\n{travel}[axes.A]\ntravel = [-360, 360]\n[errors]\n{errors}"
    );
    let machine = Machine::parse(&text, "m.toml").expect("a good machine");
    let setup = SetUp::parse(setup, "setup.toml").expect("a set-up");
    let done =
        result_of((&machine, 0.001), &setup, program.as_bytes(), |job| Job { dialect, ..job });
    done.map(|(out, _)| String::from_utf8(out).expect("text")).map_err(|error| error.to_string())
}

/// In a motion of rotary axes alone F applies to the rotary axis, and a word of X, Y or Z would change the feed. X, Y
/// and Z therefore follow in separate blocks, within the tolerance. On controls that combine mm and deg all axes move
/// together.
#[test]
fn a_purely_rotary_motion_keeps_its_feed() {
    let program = format!("{START}G1 A90 F600\nX30 F50\n");
    let lines = |setup: &str, dialect| -> Vec<String> {
        let out = turned(TILTED, setup, dialect, &program).expect("compensated");
        out.lines().map(str::to_owned).collect()
    };
    let names = |line: &str, letters: &str| line.contains(|of: char| letters.contains(of));
    for (setup, dialect) in
        [("", Dialect::Rs274), ("control = \"linuxcnc\"\n", Dialect::Rs274), ("", Dialect::Siemens)]
    {
        let lines = lines(setup, dialect);
        let turn = &lines[2..lines.len() - 1];
        let is_mixed = |line: &String| names(line, "A") && names(line, "XYZ");
        assert!(!turn.iter().any(is_mixed), "{lines:?}");
        assert!(turn.iter().any(|line| names(line, "XYZ")), "{lines:?}");
        // Tolerance plus rounding of the words.
        let at = places(&lines.join("\n"));
        for pair in at[2..lines.len() - 1].windows(2) {
            let ways = pair[0].iter().zip(&pair[1]).take(3);
            for (before, after) in ways {
                assert!((after - before).abs() < 0.0025, "{lines:?}");
            }
        }
        // The next motion corrects the remainder at the end.
        assert!(turn.last().is_some_and(|line| line.contains("A90")), "{lines:?}");
    }
    let together = lines("control = \"fanuc\"\nwithout_point = \"unit\"\n", Dialect::Rs274);
    let is_mixed = |line: &String| names(line, "A") && names(line, "XYZ");
    assert!(together[2..].iter().any(is_mixed), "{together:?}");
    // An unchanged word must not move the axis away from its corrected position.
    let bent = "EZA = { table = [[0, 0], [10, -0.6], [20, 0.4]], interpolation = \"linear\" }\n";
    let program = "G94 G0 X0 Y0 Z0 A0\nG1 Z0 A10 F600\nG1 Z0 A20\nG1 Z-5\n";
    let out = turned(bent, "", Dialect::Rs274, program).expect("compensated");
    for pair in places(&out).windows(2) {
        assert!(pair[0][3] == pair[1][3] || pair[0][2] == pair[1][2], "{out}");
    }
}

/// The limit applies to the combined displacement of the tool by all axes, checked by independent kinematics: near a singular pose C
/// turns by more than an axis limit, and X and Y follow.
#[test]
fn the_limit_holds_at_the_tool() {
    let machine = machine(LENGTH);
    let setup = SetUp::default();
    let run = |text: &str, limit_um: f64| {
        let (out, _) = result_of((&machine, 0.001), &setup, text.as_bytes(), |job| Job {
            limit: CorrectionLimit::new(limit_um).expect("a limit"),
            ..job
        })?;
        Ok::<_, NcError>(String::from_utf8(out).expect("text"))
    };
    let tip = |[x, y, z, a, c]: [f64; 5]| seen_from_table([x, y, z - LENGTH], a, c);
    let mut beyond_of_axis = 0;
    for wanted in random_places(200).into_iter().chain(
        (0..20).map(|i| [310.0 + 5.0 * f64::from(i), 260.0, -160.0, -2.0, 20.0 * f64::from(i)]),
    ) {
        let text = program("G90 G54", [wanted].into_iter());
        let out = run(&text, 250.0).expect("the tool moves by less than 250 µm");
        let commanded = places(&out)[1];
        let off: f64 = (tip(wanted).into_iter().zip(tip(commanded)))
            .map(|(from, to)| (to - from).powi(2))
            .sum();
        let moved_um = 1e3 * off.sqrt();
        assert!(moved_um > 1.0, "{wanted:?} {moved_um}");
        // 0.1 µm covers any rounding of the words.
        run(&text, moved_um + 0.1).expect("within the limit");
        let refused = run(&text, moved_um - 0.1).expect_err("beyond the limit");
        let begins = "line 2: the corrections of all axes together move the tool by ";
        let message = refused.to_string();
        assert!(
            matches!(
                refused,
                NcError::OutOfBounds { violation: BoundViolation::ToolBeyondLimit { .. }, .. }
            ) && message.starts_with(begins),
            "{message}"
        );
        let turns = (commanded[4] - wanted[4]).abs().max((commanded[3] - wanted[3]).abs());
        beyond_of_axis += usize::from(1e6 * turns.to_radians() > 250.0);
    }
    assert!(beyond_of_axis > 5, "{beyond_of_axis}");
}
