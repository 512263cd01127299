//! Polar coordinates of LinuxCNC (@ and ^) and FANUC controls (G16) give the same paths as X and Y.

use std::fmt::Write as _;

use volcomp_nc::Dialect;
use volcomp_test_support::cases;

use crate::{
    flow::text,
    identity::{TRAVELS, compensated},
    random_programs::{
        Draw, SETUP, Step, Way, assert_equal_paths, assert_same_positions, copy_unchanged, judged,
        path, worn,
    },
};

fn distance([x, y, _]: [f64; 3]) -> f64 {
    x.hypot(y)
}

fn angle_deg([x, y, _]: [f64; 3]) -> f64 {
    y.atan2(x).to_degrees()
}

fn line(step: &Step, words: &str) -> String {
    let z = step.to[2];
    match step.way {
        Way::Rapid => format!("G0 {words} Z{z:.6}\n"),
        Way::Line => format!("G1 {words} Z{z:.6}\n"),
        Way::Arc(centre, turns) => {
            let [i, j] = [centre[0] - step.from[0], centre[1] - step.from[1]];
            let code = if turns < 0.0 { 2 } else { 3 };
            format!("G{code} {words} I{i:.6} J{j:.6}\n")
        }
    }
}

#[test]
fn distances_and_angles_of_linuxcnc() {
    for (play, seed) in
        [6.0, -6.0].into_iter().flat_map(|play| (0..48).map(move |seed| (play, seed)))
    {
        let draw = &mut Draw::new(3000 + seed);
        let path = path(draw, 12);
        let mut program = "G21 G90 G54\nF1000\n".to_owned();
        for (place, step) in path.iter().enumerate() {
            let [radius, angle] = [distance(step.to), angle_deg(step.to)];
            let [by, turn] = [radius - distance(step.from), angle - angle_deg(step.from)];
            let is_line = !matches!(step.way, Way::Arc(..));
            let text = match draw.below(3) {
                0 => line(step, &format!("X{:.6} Y{:.6}", step.to[0], step.to[1])),
                1 if place > 0 && is_line => {
                    let dz = step.to[2] - step.from[2];
                    let code = i32::from(step.way == Way::Line);
                    format!("G91 G{code} @{by:.9} ^{turn:.9} Z{dz:.6}\nG90\n")
                }
                _ => line(step, &format!("@{radius:.9} ^{angle:.9}")),
            };
            program += &text;
        }
        let machine = worn(play);
        assert_same_positions(&machine, &path, Dialect::Rs274, &(program.clone() + "M2\n"));
        let perfect = volcomp_model::Machine::parse(TRAVELS, "m.toml").expect("a good machine");
        copy_unchanged(&perfect, Dialect::Rs274, program.as_bytes()).expect("taken");
    }
}

#[test]
fn distances_and_angles_under_g16() {
    for seed in 0..96 {
        let draw = &mut Draw::new(4000 + seed);
        let path = path(draw, 14);
        let mut program = "G21 G90 G54 G17\nF1000\n".to_owned();
        let (mut is_on, mut said) = (false, false);
        let mut angle = 0.0;
        for step in &path {
            if draw.below(4) == 0 {
                is_on = !is_on;
                said = false;
                program += if is_on { "G16\n" } else { "G15\n" };
            }
            if !is_on {
                program += &line(step, &format!("X{:.6} Y{:.6}", step.to[0], step.to[1]));
                continue;
            }
            let to = angle_deg(step.to);
            let mut words = format!("X{:.9}", distance(step.to));
            let is_way = said && draw.below(3) == 0;
            let by_radius = match step.way {
                Way::Arc(centre, turns) => {
                    let radius = (centre[0] - step.from[0]).hypot(centre[1] - step.from[1]);
                    Some((turns, if turns.abs() > std::f64::consts::PI { -radius } else { radius }))
                }
                _ => None,
            };
            if let Some((turns, radius)) = by_radius {
                // A radius defines the centre only if the arc is neither flat nor close to half a turn.
                let is_plain =
                    (0.8..2.4).contains(&turns.abs()) || (3.9..5.5).contains(&turns.abs());
                let code = if turns < 0.0 { 2 } else { 3 };
                if is_plain {
                    writeln!(program, "G{code} {words} Y{to:.9} R{radius:.9}").expect("a string");
                    (angle, said) = (to, true);
                } else {
                    program += "G15\n";
                    (is_on, said) = (false, false);
                    program += &line(step, &format!("X{:.6} Y{:.6}", step.to[0], step.to[1]));
                }
                continue;
            }
            if is_way {
                // The distance is modal in G90; the angle is incremental in G91.
                let [x, y, z] = step.to;
                let code = i32::from(step.way == Way::Line);
                let radius = distance([x, y, z]);
                writeln!(program, "G{code} X{radius:.9} Y{angle:.9} Z{:.6}", step.from[2])
                    .expect("a string");
                let turn = to - angle;
                writeln!(program, "G91 G{code} Y{turn:.9} Z{:.6}\nG90", z - step.from[2])
                    .expect("a string");
                (angle, said) = (to, true);
                continue;
            }
            write!(words, " Y{to:.9}").expect("a string");
            (angle, said) = (to, true);
            program += &line(step, &words);
        }
        program += "M2\n";
        // The same path by X and Y, worked out here.
        let cartesian = by_x_and_y(&program);
        let machine = worn(6.0);
        let (result, _, found) = judged(&machine, SETUP, Dialect::Rs274, &program)
            .unwrap_or_else(|error| panic!("{error}\n{program}"));
        let (_, _, expected) = judged(&machine, SETUP, Dialect::Rs274, &cartesian).expect("taken");
        assert_equal_paths(&found, &expected, &program, &result);
        let perfect = volcomp_model::Machine::parse(TRAVELS, "m.toml").expect("a good machine");
        copy_unchanged(&perfect, Dialect::Rs274, program.as_bytes()).expect("taken");
    }
}

/// Converts X and Y words under G16 to positions; line numbers do not change.
fn by_x_and_y(program: &str) -> String {
    let (mut is_on, mut is_way, mut radius, mut angle) = (false, false, 0.0, 0.0_f64);
    let mut result = String::new();
    for line in program.lines() {
        let mut words: Vec<String> = line.split(' ').map(str::to_owned).collect();
        for word in &words {
            match word.as_str() {
                "G16" => is_on = true,
                "G15" => is_on = false,
                "G91" => is_way = true,
                "G90" => is_way = false,
                _ => {}
            }
        }
        words.retain(|word| word != "G16" && word != "G15");
        if is_on {
            let [x, y]: [Option<f64>; 2] = ["X", "Y"].map(|letter| {
                let found = words.iter().find_map(|word| word.strip_prefix(letter));
                found.map(|value| value.parse().expect("a number"))
            });
            let before: f64 = angle;
            let from = [radius * before.to_radians().cos(), radius * before.to_radians().sin()];
            radius = x.unwrap_or(radius);
            angle = y.map_or(angle, |y| if is_way { angle + y } else { y });
            if x.is_some() || y.is_some() {
                words.retain(|word| !word.starts_with(['X', 'Y']));
                let mut to = [radius * angle.to_radians().cos(), radius * angle.to_radians().sin()];
                if is_way {
                    to = [to[0] - from[0], to[1] - from[1]];
                }
                words.push(format!("X{:.9} Y{:.9}", to[0], to[1]));
            }
        }
        result += &(words.join(" ") + "\n");
    }
    result
}

/// A bolt circle from programming manuals, with an error of X of 0.1 µm per mm.
#[test]
fn a_circle_of_holes_under_g16() {
    let scale = "[errors]\nEXX = { poly = [0.0, 0.1] }\n";
    let program = "G17 G90 G16\nG81 X100.0 Y30.0 Z-20.0 R5.0 F200\nY150.0\nY270.0\nG15 G80\nG0 X100.0 Y30.0\nM2\n";
    assert_eq!(
        text(scale, program),
        "G17 G90 G16\nG81 Z-20.0 R5.0 F200 X86.594 Y50.000 G15\nX-86.594 Y50.000\nX0.000 Y-100.000\nG15 G80\nG0 X99.990 Y30.0\nM2\n"
    );
    // G16 stays if no correction is needed; a second G16 is active again.
    let away =
        "[errors]\nEXX = { table = [[-1000, 0], [0, 0], [100, 10]], interpolation = \"linear\" }\n";
    let program =
        "G16 G1 X100 Y180 F100\nX100 Y90\nX100 Y0\nX50 Y180\nG16\nX50 Y180\nG16 X100 Y0\nM2\n";
    assert_eq!(
        text(away, program),
        "G16 G1 X100 Y180 F100\nX100 Y90\nX99.990 Y0.000 G15\nX-50.000 Y0.000\nG16\nX50 Y180\nG15 X99.990 Y0.000\nM2\n"
    );
}

#[test]
fn a_line_before_an_arc_under_g16() {
    let play = "[errors]\nEXX = { mean = { poly = [0.0] }, reversal = -6.0 }\n";
    let program = "G1 X0 Y0 F100\nG1 X100 Y0\nG16 X90 Y0\nG3 X90 Y90 R90\nG1 X90 Y0\nM2\n";
    let result = text(play, program);
    let mut is_polar = false;
    for line in result.lines() {
        is_polar = (is_polar || line.contains("G16")) && !line.contains("G15");
        let places = ["X100", "X90 Y"].iter().any(|said| line.contains(said));
        assert!(!is_polar || places || line.contains("M2"), "{result}");
    }
}

#[test]
fn ambiguous_words_are_refused() {
    for [program, expected] in &cases(
        r"
G16 G1 X10 F1\n | line 1: polar coordinates under G16 before both the distance and the angle were programmed
G16 G1 X10 Y0 F1\nG91 X5\n | line 2: a distance under G16 in G91
G18 G16 G1 X10 Y0 F1\n | line 1: polar coordinates outside the XY plane
G18 G16 G1 X10 Z0 F1\n | line 1: polar coordinates outside the XY plane
G16 G1 X10 Y0 F1\nG2 X10 Y90 I-10\n | line 2: an arc with a centre under G16
G1 F1 X0 Y0\n@10\n | line 2: polar coordinates whose angle is relative to a tool position at zero
G1 F1 @10 ^5 X3\n | line 1: X or Y with polar coordinates
G1 F1 @10 @5\n | line 1: found @ and @
G53 G1 F1 @10 ^5\n | line 1: polar coordinates that are machine coordinates
G28 X1\n | 
G16\nG28 X1\n | line 2: an intermediate point (G28, G30) under G16
",
    ) {
        match compensated("", program.as_bytes()) {
            Ok(_) => assert!(expected.is_empty(), "{program}"),
            Err(error) => {
                let error = error.to_string();
                assert!(!expected.is_empty() && error.starts_with(expected), "{program}{error}");
            }
        }
    }
}
