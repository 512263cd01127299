//! Fast path: plain lines, and the motions that they execute, against the same lines with a comment in front, with S or with M50, which take the general path.

use std::fmt::Write as _;

use rand::{RngExt as _, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_model::{Machine, Temperatures, vocabulary::CorrectionLimit};
use volcomp_nc::{Corrector, Dialect, Job, NcError, SetUp, Strategy, Summary, compensate};

use crate::identity::verified_by;

const THREE: &str = "structure = \"w X' b Y Z t\"\naxes.X.travel = [0.0, 600.0]\naxes.Y.travel = [0.0, 500.0]\naxes.Z.travel = [-400.0, 0.0]\n[errors]\nEXX = { poly = [0.0, 0.2] }\nEYX = { poly = [0.0, 0.0, 0.0004] }\nECX = { poly = [0.0, 0.3] }\nEYY = { poly = [0.0, -0.1] }\nEAY = { poly = [0.0, 0.1] }\nEC0Y = 20.0\n";
const REVERSAL: &str = "EZZ = { mean = { poly = [0.0, 0.01] }, reversal = 3.0 }\n";
const SETUP: &str =
    "[work_offset.G55]\nX = 12.5\nY = -3.0\nZ = -4.0\nrotation_deg = 4.0\n[tool.1]\nZ = 85.0\n";
const START: &str = "[start]\nX = 300.0\nY = 250.0\nZ = -150.0\n";

/// A program with all kinds of motion, mostly short straight ones, and modal changes.
fn program(draw: &mut ChaCha8Rng, axes: &[(char, f64)]) -> Vec<String> {
    let mut lines = vec!["G21 G90 G17 G54".to_owned()];
    let mut at: Vec<f64> = axes.iter().map(|(_, at)| *at).collect();
    let has_rotary = axes.len() > 3;
    let reach = [0.3, 2.0, 30.0][draw.random_range(0..3)];
    let all = |at: &[f64], first: &str| {
        let mut line = first.to_owned();
        for ((letter, _), at) in axes.iter().zip(at) {
            let _ = write!(line, " {letter}{at:.3}"); // writing to a String cannot fail
        }
        line
    };
    for _ in 0..150 {
        for ((_, middle), at) in axes.iter().zip(&mut at) {
            let far = 60.0;
            let way = draw.random_range(-reach..reach);
            *at = (*at + way).clamp(middle - far, middle + far);
        }
        let kind = draw.random_range(0..100);
        let line = match kind {
            0..78 => {
                let mut line =
                    ["", "G1", "g01", "G0", "G1.0", " G1 "][draw.random_range(0..6)].to_owned();
                let first = draw.random_range(0..axes.len());
                for place in 0..axes.len() {
                    let ((letter, _), at) =
                        (axes[(first + place) % axes.len()], at[(first + place) % axes.len()]);
                    let decimals = draw.random_range(0..6);
                    if place == 0 || draw.random_range(0..4) > 0 {
                        let blank = ["", " ", "\t"][draw.random_range(0..3)];
                        let _ = write!(line, "{blank}{letter}{at:.decimals$}");
                    }
                }
                let number = ["", "", "N10", "n 7 ", "N1.5 "][draw.random_range(0..5)];
                let end = ["", "", "", "F900", " f 12.5", "F1F2", " (c)", "(c) ", "; c", "(c)(c)"];
                let end = end[draw.random_range(0..end.len())];
                format!("{number}{line}{end}")
            }
            78 => all(&at, "G90 G53 G0"),
            79 => "G91 X0.25 Y-0.5\nX0.1 F300\nN7 Y-0.0205 Z.03\nG1 X-0.3 (c)\nG90".to_owned(),
            80 => all(&at, "G90"),
            81 => "G55".to_owned(),
            82 => "G54".to_owned(),
            83 => "G1 X1e3".to_owned().replace("e3", "000.5"),
            84 => "G1 W3".to_owned(),
            85 => "G20".to_owned(),
            86 => "G21".to_owned(),
            87 => "G90 G92.1\nG68 R5 X1 Y2\nG0 X300".to_owned(),
            88 => "G69".to_owned(),
            89 => "G1 X[300+0.5] F100".to_owned(),
            90 => "G92 X300".to_owned(),
            91 => "G92.1".to_owned(),
            92 if has_rotary => ["M428", "M429"][draw.random_range(0..2)].to_owned(),
            92 => "G81 X310 Z-160 R-140".to_owned(),
            93 => "G80".to_owned(),
            94 => "T1 M6 G43 H1".to_owned(),
            95 => "G49".to_owned(),
            96 if !has_rotary => "G91 G2 X20 Y10 I10 J5\nG90".to_owned(),
            97 => "G93 G1 X301 F20".to_owned(),
            98 => "G94 F100".to_owned(),
            _ => "G41.1 D1\nG1 X300.5\nX301 Y250\nX303\nG40\nX304".to_owned(),
        };
        lines.extend(line.lines().map(str::to_owned));
        if matches!(kind, 96 | 97 | 92) {
            lines.push(all(&at, "G1"));
        }
    }
    lines
}

/// The lines that are also valid in the language of SINUMERIK controls.
fn siemens(lines: Vec<String>) -> Vec<String> {
    const OTHER: [&str; 13] =
        ["G92", "G68", "G69", "G8", "M4", "T1", "G49", "G41", "G2 ", "G20", "[", "W", "G40"];
    let is_siemens = |line: &String| !OTHER.iter().any(|other| line.contains(other));
    let in_siemens = |line: String| {
        let line = line.replace("G21", "G71").replace("G1.0", "G1");
        let line = line.replace("N1.5", "N15").replace("F1F2", "F12");
        match line.split_once('(') {
            Some((words, _)) => format!("{};c", words.trim_end()),
            None => line.replace("; c", ";c"),
        }
    };
    lines.into_iter().filter(is_siemens).map(in_siemens).collect()
}

/// A HEIDENHAIN program, mostly of short straight motions.
fn heidenhain(draw: &mut ChaCha8Rng, axes: &[(char, f64)]) -> Vec<String> {
    let mut lines = vec!["BEGIN PGM A MM".to_owned()];
    let mut at: Vec<f64> = axes.iter().map(|(_, at)| *at).collect();
    let reach = [0.3, 2.0, 30.0][draw.random_range(0..3)];
    let sign = [".", ","][draw.random_range(0..2)];
    let all = |at: &[f64], end: &str| {
        let mut line = "L".to_owned();
        for ((letter, _), at) in axes.iter().zip(at) {
            let _ = write!(line, " {letter}{at:+.3}");
        }
        line.replace('.', sign) + end
    };
    lines.push(all(&at, " FMAX"));
    for _ in 0..150 {
        for ((_, middle), at) in axes.iter().zip(&mut at) {
            let way = draw.random_range(-reach..reach);
            *at = (*at + way).clamp(middle - 60.0, middle + 60.0);
        }
        let [x, y] = [at[0], at[1]];
        let line = match draw.random_range(0..100) {
            0..85 => {
                let mut line = ["L", "l", " L"][draw.random_range(0..3)].to_owned();
                let first = draw.random_range(0..axes.len());
                for place in 0..axes.len() {
                    let of = (first + place) % axes.len();
                    let decimals = draw.random_range(0..6);
                    if place == 0 || draw.random_range(0..4) > 0 {
                        let blanks = usize::from(place == 0)..4;
                        let blank = ["", " ", "\t", "  "][draw.random_range(blanks)];
                        let plus = ["", "+"][usize::from(at[of] > 0.0 && draw.random())];
                        let (letter, at) = (axes[of].0, at[of]);
                        let _ = write!(line, "{blank}{letter}{plus}{at:.decimals$}");
                    }
                }
                let end = [
                    "",
                    "",
                    " R0",
                    " r0 F900",
                    "F 12.5",
                    " FMAX",
                    " fmax R0",
                    " R0 FAUTO",
                    " F9 FMAX",
                    " ; c ~",
                    ";c",
                    " F1 F2",
                    " R0. ",
                    " M8",
                ];
                // Two feeds, and R0 with a point, are errors.
                let end = end[draw.random_range(0..if lines.len() < 140 { 11 } else { 14 })];
                let is_usual = draw.random_range(0..20) > 0;
                let sign = if is_usual { sign } else { [".", ","][draw.random_range(0..2)] };
                format!("{line}{end}").replace('.', sign)
            }
            85 => "L IX+0.25 IY-0.5".to_owned(),
            86 => format!("LX+{x:.3}Y+{y:.3}"),
            87 => {
                let [begin, end] = [all(&at, ""), all(&at, " R0")];
                let [middle, behind] = [x + 10.0, x + 20.0];
                format!("{begin}\nCC X{middle:+.3} Y{y:+.3}\nC X{behind:+.3} Y{y:+.3} DR-\n{end}")
            }
            88 => "CYCL DEF 7.0 DATUM\nCYCL DEF 7.1 X+2.5".to_owned(),
            89 => "CYCL DEF 7.0 DATUM\nCYCL DEF 7.1 X+0".to_owned(),
            90 => ["M126", "M127"][draw.random_range(0..2)].to_owned(),
            91 if axes.len() > 3 => ["M128", "M129"][draw.random_range(0..2)].to_owned(),
            92 => format!("Q1 = {x:.3}\nL X+Q1"),
            93 => format!("L Y+250 RL\n{}\nL X+301 R0", all(&at, "")),
            94 => "TOOL CALL 1 Z S1000".to_owned(),
            95 => "L X+300 R0 FMAX M91".to_owned(),
            96 => "* - A section".to_owned(),
            _ => all(&at, " R0 F500"),
        };
        lines.extend(line.lines().map(str::to_owned));
    }
    lines.push("END PGM A MM".to_owned());
    let numbers = draw.random_range(0..4);
    for (number, line) in lines.iter_mut().enumerate() {
        *line = match numbers {
            0 => continue,
            1 => format!("{number:04} {line}"),
            2 => format!(" {number}{line}"),
            _ => format!("{number}\t{line}"),
        };
    }
    lines
}

/// The line with the word `general`, which makes it take the general path. The word precedes a comment; in HEIDENHAIN
/// programs only motions get it.
fn in_general(dialect: Dialect, line: &str, general: &str) -> String {
    let at = line.find(';').unwrap_or(line.len());
    let (words, comment) = line.split_at(at);
    let is_number = |c: char| c.is_ascii_digit() || c.is_ascii_whitespace();
    let keyword = words.trim_start_matches(is_number);
    match dialect {
        Dialect::Rs274 => format!("{general}{line}"),
        Dialect::Heidenhain if !keyword.starts_with(['L', 'l']) => line.to_owned(),
        _ => format!("{words}{general}{comment}"),
    }
}

fn compensated(
    corrector: &Corrector,
    setup: &SetUp,
    (strategy, dialect): (Strategy, Dialect),
    text: &str,
) -> (String, Result<Summary, NcError>) {
    let mut out = Vec::new();
    let job = Job {
        strategy,
        dialect,
        keep_shares: true,
        limit: CorrectionLimit::LARGEST,
        ..Job::new(corrector, setup)
    };
    let summary = compensate(&mut text.as_bytes(), &mut out, job, |_| Ok(()));
    (String::from_utf8(out).expect("text"), summary)
}

#[test]
fn comments_do_not_change_numbers() {
    let five = [('X', 300.0), ('Y', 250.0), ('Z', -150.0), ('A', -45.0), ('C', 10.0)];
    let trunnion = include_str!("../../../../examples/trunnion.toml");
    let [ahead, lags] = ["", "-"].map(|sign| {
        let reversal = REVERSAL.replace("= 3", &format!("= {sign}3"));
        format!("{THREE}{reversal}{}", reversal.replace("EZZ", "EXZ"))
    });
    let turning = trunnion.replace(
        "EXX = { poly = [0.0, 0.01] }",
        "EXX = { mean = { poly = [0.0, 0.01] }, reversal = -4 }",
    );
    let machines = [
        (THREE, &five[..3]),
        (trunnion, &five[..]),
        (&ahead, &five[..3]),
        (&lags, &five[..3]),
        (&turning, &five[..]),
    ];
    let (mut changed, mut finished) = (0, 0);
    for (place, (machine, axes)) in machines.into_iter().enumerate() {
        let machine = Machine::parse(machine, "m.toml").expect("a good machine");
        for seed in 0..150 {
            let mut draw = ChaCha8Rng::seed_from_u64(seed + 1000 * place as u64);
            let tolerance_mm = [0.001, 0.0001][draw.random_range(0..2)];
            let corrector =
                Corrector::new(&machine, &Temperatures::new(), tolerance_mm).expect("compiles");
            let start = ["", START][draw.random_range(0..2)];
            let setup = SetUp::parse(&format!("{SETUP}{start}"), "s.toml").expect("a good set-up");
            let strategy = [Strategy::Plain, Strategy::Floyd][draw.random_range(0..2)];
            let (dialect, general, lines) = match seed % 5 {
                3 => (Dialect::Siemens, " S1", siemens(program(&mut draw, axes))),
                4 => (Dialect::Heidenhain, " M50", heidenhain(&mut draw, axes)),
                _ => (Dialect::Rs274, "(general)", program(&mut draw, axes)),
            };
            let slow = lines.iter().map(|line| in_general(dialect, line, general));
            let (usual, slow) = (lines.join("\n"), slow.collect::<Vec<_>>().join("\n"));
            let (out, summary) = compensated(&corrector, &setup, (strategy, dialect), &usual);
            let (slow_out, expected) = compensated(&corrector, &setup, (strategy, dialect), &slow);
            let without = slow_out.replace(general, "");
            for (number, (line, slow)) in out.lines().zip(without.lines()).enumerate() {
                assert_eq!(
                    line,
                    slow,
                    "machine {place}, seed {seed}, line {}\n{usual}",
                    number + 1
                );
            }
            assert_eq!(out.len(), without.len(), "machine {place}, seed {seed}");
            match (summary, expected) {
                (Ok(summary), Ok(expected)) => {
                    assert_eq!(summary, expected, "machine {place}, seed {seed}");
                    let verified = [[&usual, &out], [&slow, &slow_out]].map(|[program, result]| {
                        let texts = [program.as_str(), result.as_str()];
                        let found = verified_by(&machine, &setup, dialect, texts, &summary.shares);
                        found.map_err(|error| error.to_string())
                    });
                    assert_eq!(verified[0], verified[1], "machine {place}, seed {seed}");
                    changed += summary.counts.changed;
                    finished += 1;
                }
                (found, expected) => {
                    let texts = [found, expected].map(|of| of.map_err(|error| error.to_string()));
                    assert_eq!(texts[0], texts[1], "machine {place}, seed {seed}");
                }
            }
        }
    }
    assert!(changed > 5_000 && finished > 60, "{changed} {finished}");
}

/// At X0 Y0 Z0 this machine needs no correction, so that the usual third line is the first that relies on the assumed work offset.
#[test]
fn the_first_correction_with_an_assumed_offset_is_noted() {
    let machine = Machine::parse(THREE, "m.toml").expect("a good machine");
    let corrector = Corrector::new(&machine, &Temperatures::new(), 0.001).expect("compiles");
    let setup = SetUp::parse("[start]\nX = 0.0\nY = 0.0\nZ = 0.0\n", "s.toml");
    let setup = setup.expect("a good set-up");
    let program = "G21 G90 G54\nG1 X0 Y0 Z0 F900\nX5\nX7\nG56\nX8\n";
    let way = (Strategy::Plain, Dialect::Rs274);
    let (out, summary) = compensated(&corrector, &setup, way, program);
    let notes = summary.expect("compensated").notes;
    let by_line = notes.by_line().into_iter();
    let by_line = by_line.map(|(line, note)| (line, note.to_string()));
    let by_line = by_line.filter(|(_, note)| note.contains("work offset"));
    let expected = [(3, "G54"), (6, "G56")].map(|(line, name)| {
        (line, format!("the set-up file has no work offset {name}: zero is assumed"))
    });
    assert_eq!(by_line.collect::<Vec<_>>(), expected, "{out}");
}
