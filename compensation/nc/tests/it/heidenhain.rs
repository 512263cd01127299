//! HEIDENHAIN conversational: the paths of RS-274 in several notations, results, and refusals.

use std::fmt::Write as _;

use volcomp_model::Machine;
use volcomp_nc::{Dialect, NcError};
use volcomp_test_support::{cases, rows};

use crate::{
    identity::{begins, written, written_with},
    random_programs::{
        Draw, Step, Way, accepts_with_result, assert_copied, assert_equal_paths,
        assert_same_positions, centre_point_lines, judged, path, tilting, worn,
    },
};

const SEEDS: u64 = 64;

fn program(lines: &[String]) -> String {
    let mut text = String::new();
    let all = ["BEGIN PGM DRAWN MM".to_owned()];
    let end = ["END PGM DRAWN MM".to_owned()];
    for (number, line) in all.iter().chain(lines).chain(&end).enumerate() {
        writeln!(text, "{number} {line}").expect("a string");
    }
    text
}

fn is_numbered(text: &str) {
    for (number, line) in text.lines().enumerate() {
        let found = line.split(' ').next();
        assert_eq!(found, Some(number.to_string().as_str()), "{line}\n{text}");
    }
}

/// The lines of a step to the position in `words`; a pole precedes an arc.
fn step_lines(draw: &mut Draw, step: &Step, words: &str) -> Vec<String> {
    match step.way {
        Way::Rapid => vec![format!("L {words} FMAX")],
        Way::Line => vec![format!("L  {words} R0 F1000")],
        Way::Arc(centre, turns) => {
            let direction = if turns < 0.0 { "DR-" } else { "DR+" };
            let by: [f64; 2] = std::array::from_fn(|i| centre[i] - step.from[i]);
            if draw.below(3) == 0 && (0.8..2.4).contains(&turns.abs()) {
                let radius = by[0].hypot(by[1]);
                return vec![format!("CR {words} R{radius:+.6} {direction}")];
            }
            let pole = match draw.below(2) {
                0 => format!("CC X{:+.6} Y{:+.6}", centre[0], centre[1]),
                _ => format!("CC IX{:+.6} IY{:+.6}", by[0], by[1]),
            };
            vec![pole, format!("C {words} {direction} F800")]
        }
    }
}

#[test]
fn absolute_words() {
    // Reversal values of both signs: the carriage of X runs ahead or lags.
    let machines = [6.0, -6.0].map(worn);
    for (machine, seed) in
        machines.iter().flat_map(|machine| (0..SEEDS).map(move |seed| (machine, seed)))
    {
        let draw = &mut Draw::new(10_000 + seed);
        let path = path(draw, 12);
        let mut lines = Vec::new();
        for step in &path {
            let [x, y, z] = step.to;
            let mut words = format!("X{x:+.6} Y{y:+.6}");
            if !matches!(step.way, Way::Arc(..)) {
                write!(words, " Z{z:+.6}").expect("a string");
            }
            lines.extend(step_lines(draw, step, &words));
        }
        let text = program(&lines);
        let result = assert_same_positions(machine, &path, Dialect::Heidenhain, &text);
        is_numbered(&result);
    }
}

#[test]
fn incremental_words_and_decimal_commas() {
    let machine = worn(6.0);
    for seed in 0..SEEDS {
        let draw = &mut Draw::new(11_000 + seed);
        let path = path(draw, 12);
        let mut lines = Vec::new();
        for step in &path {
            let mut word = |axis: usize| {
                let name = ["X", "Y", "Z"][axis];
                let (to, by) = (step.to[axis], step.to[axis] - step.from[axis]);
                match draw.below(2) {
                    0 => format!("{name}{to:+.6}"),
                    _ => format!("I{name}{by:+.6}"),
                }
            };
            let words = format!("{} {} {}", word(0), word(1), word(2));
            lines.extend(step_lines(draw, step, &words));
        }
        let text = program(&lines).replace('.', ",");
        let result = assert_same_positions(&machine, &path, Dialect::Heidenhain, &text);
        assert!(!result.contains('.'), "{result}");
    }
}

/// Each number keeps its decimal comma or point; a number with two of them is refused.
#[test]
fn commas_and_points_in_one_program() {
    let run = |text: &str| compensated("[errors]\nEXX = 20.0\nEYX = -30.0\nEZX = 10.0\n", "", text);
    let mixed =
        "0 BEGIN PGM A MM\n1 L X+10,5 Y+20.5 Z-30,5 F100\n2 L X+150.25 Y+80,25\n3 END PGM A MM\n";
    let (result, _) = run(mixed).expect("it is read");
    assert!(!result.contains("X+10,5 ") && !result.contains("Y+20.5 "), "{result}");
    let signs =
        |text: &str| -> String { text.chars().filter(|c| matches!(c, '.' | ',')).collect() };
    assert_eq!(signs(&result), signs(mixed), "{result}");
    for (number, column) in [("1,234.5", 11), ("1.234,5", 11), ("1,2,3", 9), ("1..2", 8)] {
        let text = format!("0 BEGIN PGM A MM\n1 L X{number} Y+0\n2 END PGM A MM\n");
        let said = run(&text).expect_err(number).to_string();
        let expected = format!("line 2: column {column}: found a second decimal comma or point");
        assert!(said.contains(&expected), "{said}");
    }
}

#[test]
fn shifts_of_the_datum() {
    let machine = worn(6.0);
    for seed in 0..SEEDS {
        let draw = &mut Draw::new(12_000 + seed);
        let path = path(draw, 12);
        let (mut lines, mut datum) = (Vec::new(), [0.0; 3]);
        for step in &path {
            if draw.below(3) == 0 {
                let axis = draw.below(3);
                let by = draw.thousandths(-50.0, 50.0);
                let name = ["X", "Y", "Z"][axis];
                lines.push("CYCL DEF 7.0 DATUM SHIFT".to_owned());
                if draw.below(2) == 0 {
                    lines.push(format!("CYCL DEF 7.1 {name}{by:+.3}"));
                    datum[axis] = by;
                } else {
                    lines.push(format!("CYCL DEF 7.1 I{name}{by:+.3}"));
                    datum[axis] += by;
                }
            }
            let at = |of: [f64; 3]| std::array::from_fn(|i| of[i] - datum[i]);
            let way = match step.way {
                Way::Arc([i, j], turns) => Way::Arc([i - datum[0], j - datum[1]], turns),
                way => way,
            };
            let inside = Step { way, from: at(step.from), to: at(step.to) };
            let [x, y, z] = inside.to;
            lines.extend(step_lines(draw, &inside, &format!("X{x:+.6} Y{y:+.6} Z{z:+.6}")));
        }
        assert_same_positions(&machine, &path, Dialect::Heidenhain, &program(&lines));
    }
}

#[test]
fn q_parameters() {
    let machine = worn(6.0);
    for seed in 0..SEEDS {
        let draw = &mut Draw::new(13_000 + seed);
        let path = path(draw, 12);
        let mut lines = Vec::new();
        for step in &path {
            let [x, y, z] = step.to;
            let more = draw.thousandths(-20.0, 20.0);
            lines.push(format!("FN 0: Q1 = {:+.6}", x - more));
            lines.push(format!("FN 1: Q2 = +Q1 + {more:+.3}"));
            lines.push(format!("Q3 = ( {:.6} - 9 * SIN 90 + SQ 3 ) / 2 ;half", 2.0 * y));
            lines.push(format!("QL4 = {:.6}", -z));
            lines.extend(step_lines(draw, step, "X+Q2 Y+Q3 Z-QL4"));
        }
        assert_same_positions(&machine, &path, Dialect::Heidenhain, &program(&lines));
    }
}

#[test]
fn polar_coordinates() {
    // The rounding of polar words must not reverse an axis.
    let machines = [0.0, -6.0].map(worn);
    for (machine, seed) in
        machines.iter().flat_map(|machine| (0..SEEDS).map(move |seed| (machine, seed)))
    {
        let draw = &mut Draw::new(14_000 + seed);
        let path = path(draw, 12);
        let mut lines = Vec::new();
        for step in &path {
            let angle = |at: [f64; 3], pole: [f64; 2]| (at[1] - pole[1]).atan2(at[0] - pole[0]);
            let z = step.to[2];
            if let Way::Arc(centre, turns) = step.way {
                let direction = if turns < 0.0 { "DR-" } else { "DR+" };
                let [from, to] = [step.from, step.to].map(|at| angle(at, centre).to_degrees());
                lines.push(format!("CC X{:+.6} Y{:+.6}", centre[0], centre[1]));
                let by = (to - from).rem_euclid(360.0);
                let by = if turns < 0.0 { by - 360.0 } else { by };
                lines.push(match draw.below(2) {
                    0 => format!("CP PA{to:+.8} {direction}"),
                    _ => format!("CP IPA{by:+.8} {direction}"),
                });
                continue;
            }
            let pole: [f64; 2] = std::array::from_fn(|_| draw.thousandths(-100.0, 100.0));
            let radius = |at: [f64; 3]| (at[0] - pole[0]).hypot(at[1] - pole[1]);
            let [from, to] =
                [step.from, step.to].map(|at| (radius(at), angle(at, pole).to_degrees()));
            lines.push(format!("CC X{:+.3} Y{:+.3}", pole[0], pole[1]));
            let distance = match draw.below(2) {
                0 => format!("PR{:+.7}", to.0),
                _ => format!("IPR{:+.7}", to.0 - from.0),
            };
            let turned = match draw.below(2) {
                0 => format!("PA{:+.8}", to.1),
                _ => format!("IPA{:+.8}", to.1 - from.1),
            };
            let feed = if step.way == Way::Rapid { "FMAX" } else { "F500" };
            lines.push(format!("LP {distance} {turned} Z{z:+.6} {feed}"));
        }
        assert_same_positions(machine, &path, Dialect::Heidenhain, &program(&lines));
    }
}

/// M128 gives the same digits as M428 in RS-274.
#[test]
fn m128_has_the_numbers_of_m428() {
    let machine = tilting();
    for seed in 0..SEEDS {
        let draw = &mut Draw::new(15_000 + seed);
        let rs274 = centre_point_lines(draw);
        let text = rs274.join("\n") + "\n";
        let mut lines = Vec::new();
        for line in &rs274 {
            let words = line.replace("G90 ", "");
            lines.push(match words.split_once(' ') {
                None if words == "M428" => "L M128".to_owned(),
                None => "FUNCTION RESET TCPM".to_owned(),
                Some((code, words)) => {
                    let feed = if code == "G0" { "FMAX" } else { "F500" };
                    let words = words.split(' ').map(|word| {
                        let (letter, value) = word.split_at(1);
                        let sign = if value.starts_with('-') { "" } else { "+" };
                        format!("{letter}{sign}{value}")
                    });
                    format!("L {} {feed}", words.collect::<Vec<_>>().join(" "))
                }
            });
        }
        let in_heidenhain = program(&lines);
        let (expected, _, of_rs274) =
            judged(&machine, "rotary_words = \"linear\"\n", Dialect::Rs274, &text).expect("taken");
        let (found, _, of_heidenhain) =
            judged(&machine, "", Dialect::Heidenhain, &in_heidenhain).expect("taken");
        let numbers = |text: &str| -> Vec<String> {
            let words = text.split_whitespace();
            let words = words.filter(|word| word.starts_with(['X', 'Y', 'Z', 'A', 'C']));
            words.map(|word| word.replace('+', "")).collect()
        };
        assert_eq!(numbers(&found), numbers(&expected), "{seed}");
        assert_equal_paths(&of_heidenhain, &of_rs274, &in_heidenhain, &found);
    }
}

/// M127 and M129 act at the end of their block, so a motion in that block is still made under M126 or M128. A motion
/// for which the mode makes a difference is refused.
#[test]
fn the_end_of_a_mode_stands_in_a_block_of_its_own() {
    let machine = tilting();
    let begins = "L X+300 Y+250 Z-100 A-10 C+0 FMAX\n";
    for (on, off) in [("M126", "M127"), ("M128", "M129")] {
        let beside = format!("L Z-50 C+20 F500 {off}\n");
        written(Dialect::Heidenhain, &machine, "", &format!("{begins}{beside}"))
            .expect("it was not on");
        let behind = format!("{begins}L {on}\nL Z-50 F500\nL {off}\n");
        written(Dialect::Heidenhain, &machine, "", &behind).expect("a block of its own");
        let linear = format!("{begins}L M126\nL Z-50 F500 M127\n");
        written(Dialect::Heidenhain, &machine, "", &linear).expect("M127 concerns rotary axes");
        let refused =
            written(Dialect::Heidenhain, &machine, "", &format!("{begins}L {on}\n{beside}"));
        let expected = format!("{off} is not supported: it acts at the end of its block");
        let found = refused.expect_err(off).to_string();
        assert!(found.contains(&expected), "{found}");
    }
}

fn compensated(errors: &str, setup: &str, program: &str) -> Result<(String, Vec<String>), NcError> {
    written_with(Dialect::Heidenhain, errors, setup, program)
}

/// X is 100 µm/m too long. The expected positions follow from this closed form; each word keeps its notation.
#[test]
fn words_keep_their_notation() {
    let scale = "[errors]\nEXX = { poly = [0.0, 0.1] }\n";
    for [program, expected] in rows(
        r"
1 L X+100 R0 FMAX M3\n | 1 L X+99.990 R0 FMAX M3\n
L X100,0 F500\n | L X99,990 F500\n
L X+0\nL IX+100 F100\nL IX-100\n | L X+0\nL IX+99.990 F100\nL IX-99.990\n
Q1 = 50 * 2\nL X+Q1\n | Q1 = 50 * 2\nL X+99.990\n
TRANS DATUM AXIS X+100\nL X+0\n | TRANS DATUM AXIS X+100\nL X-0.010\n
// Two arcs about one pole: each gets its own corrected pole.
0 BEGIN PGM A MM\n1 L X+0 Y+0 FMAX\n2 CC X+10 Y+0\n3 C X+20 Y+0 DR-\n4 C X+0 Y+0 DR-\n5 END PGM A MM\n | 0 BEGIN PGM A MM\n1 L X+0 Y+0 FMAX\n2 CC X+10 Y+0\n3 CC X+9.999 Y+0.001\n4 C X+19.998 Y+0 DR-\n5 CC X+9.999 Y-0.001\n6 C X+0 Y+0 DR-\n7 END PGM A MM\n
L X+0 Y+0\nCR X+20 Y+0 R+10 DR-\n | L X+0 Y+0\nCR X+19.998 Y+0 R+9.999 DR-\n
CC X+0 Y+0\nLP PR+100 PA+0 F100 M8\n | CC X+0 Y+0\nL X+99.990 Y+0.000 F100 M8\n
CC X+0 Y+0\nLP PR+100 PA+90\n | CC X+0 Y+0\nLP PR+100 PA+90\n
0 BEGIN PGM A INCH\n1 L X+10\n | 0 BEGIN PGM A INCH\n1 L X+9.9990\n
L X+100 M91\nL X+100\n | L X+100 M91\nL X+99.990\n
",
    ) {
        let found = match compensated(scale, "", program) {
            Ok((found, _)) => found,
            Err(error) => error.to_string(),
        };
        assert_eq!(&found, expected, "{program}");
    }
}

/// A curved guideway splits a line: added blocks are numbered, later blocks renumbered, also after the program end, and a stop moves to
/// the last part.
#[test]
fn added_blocks_have_the_next_numbers() {
    let bent = "[errors]\nEYX = { table = [[-1000, 0], [0, 0], [100, 20], [200, 0], [1000, 0]], interpolation = \"linear\" }\n";
    let program = "0 BEGIN PGM A MM\r\n1 L X+0 Y+0 Z+0 FMAX\r\n2 L X+200 Y+0 R0 F500 M13 M9\r\n3 L Z+5\r\n4 M30\r\n5 LBL 1\r\n6 END PGM A MM\r\n";
    let (text, _) = compensated(bent, "", program).expect("taken");
    assert_eq!(
        text,
        "0 BEGIN PGM A MM\r\n1 L X+0 Y+0 Z+0 FMAX\r\n2 L X+100.000 Y-0.020 R0 F500 M13\r\n3 L X+200.000 Y+0.000 M9\r\n4 L Z+5\r\n5 M30\r\n6 LBL 1\r\n7 END PGM A MM\r\n"
    );
    let lines = program.lines().map(|line| &line[2..]);
    let without = lines.collect::<Vec<_>>().join("\n") + "\n";
    let (text, _) = compensated(bent, "", &without).expect("taken");
    assert!(text.contains("\nL X+200.000 Y+0.000 M9\nL Z+5\n"), "{text}");
}

#[test]
fn tools_and_the_shorter_way() {
    let errors = "[errors]\nEXZ = { poly = [0.0, 0.1] }\n";
    let setup = "[tool.3]\nZ = 200.0\n";
    let program = "TOOL CALL 3 Z S1000 DL+100 DR-0.1\nL Z+0 X+0\nTOOL DEF 4 L+100 R+5\nTOOL CALL 4 Z\nL Z+0 X+0\n";
    let (text, _) = compensated(errors, setup, program).expect("taken");
    assert_eq!(text, program.replacen("X+0", "X-0.030", 1).replacen("X+0", "X-0.010", 1));
    let machine = "name = \"m\"\nstructure = \"w A' b X Y Z t\"\n[axes.X]\ntravel = [-500, 500]\n[axes.Y]\ntravel = [-500, 500]\n[axes.Z]\ntravel = [-500, 500]\n[axes.A]\ntravel = [-360, 360]\n[errors]\nEAA = { poly = [104.719755] }\n";
    let machine = Machine::parse(machine, "m.toml").expect("a good machine");
    // A is corrected by -0.006°.
    let (text, _) = written(
        Dialect::Heidenhain,
        &machine,
        "",
        "L X+0 Y+0 Z+0 A+350 FMAX\nL M126\nL A+10 FMAX\nL IA+350 FMAX\n",
    )
    .expect("taken");
    assert_eq!(text, "L X+0 Y+0 Z+0 A+349.994 FMAX\nL M126\nL A+9.994 FMAX\nL IA+350 FMAX\n");
    let error = written(Dialect::Heidenhain, &machine, "", "L X+0 Y+0 Z+0 A+0 M126\nL A+180\n")
        .expect_err("refused");
    assert!(error.to_string().contains("half a turn"), "{error}");
}

/// Cycles are copied with all their lines; afterwards the position is unknown.
#[test]
fn cycles_are_copied() {
    let errors = "[errors]\nEXX = { poly = [0.0, 0.1] }\nEZX = { poly = [0.0, 0.1] }\n";
    let program = "1 L X+100 Y+0 Z+50 FMAX\n2 CYCL DEF 200 DRILLING ~\n    Q200=2 ;SET-UP CLEARANCE ~\n    Q201=-20 ;DEPTH\n3 CYCL CALL M8\n4 L X+200 FMAX M99\n5 L Z+100 FMAX\n6 L X+300\n";
    let (text, notes) = compensated(errors, "", program).expect("taken");
    let expected = program
        .replace("X+100 Y+0 Z+50", "X+99.990 Y+0 Z+49.990")
        .replace("X+200", "X+199.980")
        .replace("L Z+100", "L Z+99.980")
        .replace("X+300", "X+299.970 Z+99.970");
    assert_eq!(text, expected);
    assert!(notes.iter().any(|note| note.contains("motions of cycle 200 are copied")), "{notes:?}");
}

#[test]
fn unsupported_words_are_refused_with_position_and_reason() {
    for [line, expected] in &cases(
        "
2 CALL LBL 1 REP 2 | column 3: CALL LBL is not supported: jumps and loops are not supported
FN 9: IF +Q1 EQU +Q2 GOTO LBL 1 | column 1: FN is not supported
CALL PGM OTHER.H | column 1: CALL PGM is not supported
PLANE SPATIAL SPA+0 SPB+45 SPC+0 | column 1: PLANE is not supported: only shifts
CYCL DEF 19.0 WORKING PLANE | column 1: CYCL DEF 19 is not supported: only shifts
CYCL DEF 10.0 ROTATION | column 1: CYCL DEF 10 is not supported
CYCL DEF 7.1 #5 | column 1: CYCL DEF 7 is not supported: a datum that only
CYCL DEF 999 | column 1: CYCL DEF 999 is not supported
CT X+1 Y+2 | column 1: CT is not supported: an arc by its tangent
RND R5 | column 1: RND is not supported: a rounded
CHF 2 | column 1: CHF is not supported: a chamfer
APPR LT X+1 | column 1: APPR is not supported
FL X+1 | column 1: FL is not supported: free contours
LN X+1 NX+0 NY+0 NZ+1 | column 1: LN is not supported: tool directions
FUNCTION TCPM F CONT AXIS SPAT PATHCTRL VECTOR | column 1: FUNCTION TCPM is not supported
L X+1 R+ | column 7: R+ is not supported: the radius of the tool along one axis
L X+1 FT2 | column 7: FT2 is not supported
L X+1 M89 | column 7: M89 is not supported
L X+1 M118 X1 Y1 | column 7: M118 is not supported: its words limit the handwheel
L X+1 M92 | column 7: M92 is not supported
L X+1 M140 MB MAX | column 7: M140 is not supported
CP IPA+720 IZ-5 DR+ | column 20: CP is not supported: a helix of more than one turn
C X+1 Y+2 DR+ | an arc without a radius and without a pole (CC)
LP PR+1 PA+2 | polar coordinates without a pole (CC)
C X+1 Y+2 | column 10: expected DR+ or DR- in an arc
CC X+1 | a pole CC with one coordinate
CYCL CALL | a call of a cycle that was not defined
CYCL CALL PAT F100 | column 1: CYCL CALL is not supported: holes at positions in another file
L X+Q9 | the value of X is only known at the machine
Q1 = 1 / 0 | column 8: this calculation has no result
L X | column 4: expected a number
L X+1 ? | column 7: found '?'
/ L X+1 | column 1: / is not supported
L IX+1 M91 | incremental machine coordinates (G53, G153, SUPA, M91)
BLAH | column 1: BLAH is not supported: it is unknown
TOOL CALL 5 X | column 1: TOOL CALL is not supported: another axis
",
    ) {
        let error = compensated("", "", &format!("L X+0 Y+0 Z+0\n{line}\n")).expect_err(line);
        let text = error.to_string();
        let found = text.strip_prefix("line 2: ").unwrap_or_default();
        assert!(found.starts_with(expected), "{line}: {text}");
    }
}

#[test]
fn unusual_programs_are_copied_byte_for_byte() {
    let programs: [&[u8]; 8] = [
        b"",
        b"0  BEGIN PGM PART MM \r\n1  BLK FORM 0.1 Z X+0 Y+0 Z-20\r\n2  BLK FORM 0.2 X+100 Y+100 Z+0\r\n3  ; caf\xe9\r\n4  * - HEADING\r\n5  TOOL CALL 5 Z S3000 F500 DL+0.2 DR-0.1\r\n6  L  Z+100 R0 FMAX M3\r\n7  L X+10 Y+5,5 RL F AUTO M8\r\n8  END PGM PART MM\r\nrest",
        b"L X+1 Y+5\nCC X+5 Y+5\nC X+9 Y+5 DR+ F100\nCP IPA+90 DR+\nCP PA-30 IZ-2 DR-\nLP PR+10 PA+45 Z-5\nLP IPR+5 IPA+10\nCC\nCC IX+1 IY+2\nCP IPA-30 DR-\n",
        b"CR X+10 Y+0 R+10 DR+\nCR X+0 R-10 DR-\nL IX+5 IY-3 IZ+1 R0\n",
        b"Q1 = +5\nQ2=Q1*2+SQRT 16^2\nQS1 = \"a;b\"\nFN 0: Q5 = +60\nFN2: Q6 = +Q5 - -3\nfn4 : Q7 = +Q5 DIV +2\nFN 5: Q8 = SQRT +Q7\nL X+Q1 Y-Q6 FQ5\n",
        b"5 LBL 1\n6 TOOL DEF \"MILL\"\n7 TOOL CALL \"MILL\" Z S500\n8 STOP M6\n9 M5 M9\n10 L M126\n11 L A+5 M91\n12 FUNCTION MODE MILL\n",
        b"CYCL DEF 7.0 DATUM SHIFT\nCYCL DEF 7.1 X+60\nCYCL DEF 7.2 IY+40\nCYCL DEF 32.0 TOLERANCE\nCYCL DEF 32.1 T0.05\nCYCL DEF 200 DRILLING ~\nQ200=2 ;x ~\nQ201=-5\nL X+1 FMAX M99\nTRANS DATUM RESET\n",
        b"L X+1 Y+1 RL F100\nL X+5\nCC X+5 Y+2\nC X+6 Y+2 DR+\nL R0 X+0\nM30\n77 nonsense",
    ];
    assert_copied(Dialect::Heidenhain, &programs);
}

/// Random lines do not panic. A machine without errors returns accepted programs unchanged, and their result on a worn machine is
/// accepted.
#[test]
fn random_lines_are_copied_byte_for_byte() {
    const PIECES: &str = "L|C|CC|CR|LP|CP|X+10|Y-5,5|IZ+3|IX-2|Y+Q1|PR+20|PA+30|IPA+45|IPR-3|R+12|DR+|DR-|R0|RL|FMAX|F100|M8|\
        M30|M91|M99|M126|M128|Q1 = 5|FN 0: Q1 = +3|CYCL DEF 7.1|CYCL DEF 200|CYCL CALL|TOOL CALL 1 Z|\
        ; comment|~|LBL 1|BEGIN PGM A INCH|END PGM A MM|STOP|*|TRANS DATUM RESET|C+30|M5";
    let pieces: Vec<&str> = PIECES.split('|').collect();
    let mut taken = 0;
    for seed in 0..9000 {
        let draw = &mut Draw::new(16_000 + seed);
        let mut text = String::new();
        let is_numbered = draw.below(2) == 0;
        for number in 0..=draw.below(6) {
            if is_numbered {
                write!(text, "{number} ").expect("a string");
            }
            // Half of the lines begin as motions do.
            let first = [6, pieces.len()][draw.below(2)];
            let mut kind = pieces[draw.below(first)];
            for _ in 0..=draw.below(5) {
                text.push_str(kind);
                text.push_str(["", " ", " ", " "][draw.below(4)]);
                kind = pieces[draw.below(pieces.len())];
            }
            text.push('\n');
        }
        taken += usize::from(accepts_with_result(Dialect::Heidenhain, &text));
    }
    assert!(taken > 300, "only {taken} were taken");
}

/// Block numbers up to 10⁹ are accepted; larger ones, also those beyond 64 bits, are refused.
#[test]
fn block_numbers_without_a_next_one_are_refused() {
    let taken = |number: &str| {
        let program = format!(
            "0 BEGIN PGM A MM\n1 L X+0 Y+0 Z+0 FMAX\n{number} L X+300 F100\n3 END PGM A MM\n{number} L X+0\n"
        );
        compensated("[errors]\nEYX = { poly = [0, 0, 0.001] }\n", "", &program)
    };
    taken("1000000000").expect("taken");
    for number in ["1000000001", "18446744073709551615", "99999999999999999999999"] {
        let message = taken(number).expect_err("refused").to_string();
        begins(&message, "line 3: column 1: the number of a block above");
    }
}
