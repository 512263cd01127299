//! Programs of 3D printers and Grbl: E words, commands of Klipper and Marlin, settings.

use rand::{RngExt as _, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_nc::{NcError, Summary};
use volcomp_test_support::{cases, rows};

use crate::identity::{begins, notes_of, of_control, text_in};

const PRINTERS: [&str; 2] = ["klipper", "marlin"];
/// Y bends at X 50, so lines across it are split there.
const BENT: &str = "[errors]\nEXX = { poly = [0.0, 0.1] }\nEYX = { table = [[-1000, 0], [0, 0], [50, 20], [100, 0], [1000, 0]], interpolation = \"linear\" }\n";
/// X is corrected by 1 µm per mm of Y.
const SKEW: &str = "[errors]\nEC0Y = 1000.0\n";

fn run(control: &str, errors: &str, program: &str) -> Result<(String, Summary), NcError> {
    text_in(&of_control(control), errors, program)
}

fn result(control: &str, errors: &str, program: &str) -> Result<String, String> {
    let result = run(control, errors, program);
    result.map(|(text, _)| text).map_err(|error| error.to_string())
}

fn is_unknown_after_line_3(summary: &Summary) -> bool {
    notes_of(summary)
        .iter()
        .any(|note| note.starts_with("3: ") && note.contains("unknown after it"))
}

/// A split motion shares its filament in proportion to length. Each part has the motion code, which printers require.
#[test]
fn filament_is_shared_over_the_parts() {
    let start = "G21\nG90\nG28\n";
    for [program, expected] in rows(
        r"
M82\nG0 X0 Y0 Z0.2\nG92 E0\nG1 X100 Y100 E5.0 F1200\nG1 X0 Y100 E10.0\n | M82\nG0 X0 Y0 Z0.2\nG92 E0\nG1 X49.995 Y49.980 E2.5 F1200\nG1 X99.990 Y100.000 E5.0\nG1 X49.995 Y99.980 E7.5\nG1 X0.000 Y100.000 E10.0\n
M83\nG0 X0 Y0 Z0.2\nG1 X100 Y100 E5.00001 ; comment\nG1 E-.8\nG1 X0\n | M83\nG0 X0 Y0 Z0.2\nG1 X49.995 Y49.980 E2.50000 ; comment\nG1 X99.990 Y100.000 E2.50001\nG1 E-.8\nG1 X49.995 Y99.980\nG1 X0.000 Y100.000\n
// Incremental positions and E.
M83\nG0 X0 Y0 Z0.2\nG91\nG1 X100 E4\n | M83\nG0 X0 Y0 Z0.2\nG91\nG1 X49.995 E2 Y-0.020\nG1 X49.995 Y0.020 E2\n
// A motion without travel keeps its filament.
M82\nG0 X0 Y0 Z0.2\nG92 E0\nG1 E5\nG1 X100 E5\n | M82\nG0 X0 Y0 Z0.2\nG92 E0\nG1 E5\nG1 X49.995 Y-0.020\nG1 X99.990 Y0.000\n
",
    ) {
        for control in PRINTERS {
            let found = result(control, BENT, &format!("{start}{program}"));
            assert_eq!(found, Ok(format!("{start}{expected}")), "{control}");
        }
    }
}

/// Numbers of the words with this letter, in units of the ninth decimal.
fn numbers(text: &str, letter: char) -> Vec<i64> {
    let lines = text.lines().filter(|line| line.starts_with("G1") || line.starts_with('G'));
    let words = lines.flat_map(|line| line.split_whitespace());
    (words.filter_map(|word| word.strip_prefix(letter)))
        .map(|number| {
            let (sign, number) = match number.strip_prefix('-') {
                Some(number) => (-1, number),
                None => (1, number),
            };
            let (whole, decimals) = number.split_once('.').unwrap_or((number, ""));
            let digits = format!("{whole}{decimals:0<9}");
            sign * digits.parse::<i64>().expect("a number")
        })
        .collect()
}

/// In random prints the incremental parts add up to the E word to the last digit. Absolute motions end at their E word, and E grows with
/// the path.
#[test]
fn no_filament_is_lost() {
    let mut draw = ChaCha8Rng::seed_from_u64(12);
    let mut split = 0;
    for case in 0..300 {
        let control = PRINTERS[case % 2];
        let relative = case % 4 < 2;
        let decimals = draw.random_range(0..8_usize);
        let mut program =
            format!("G90\n{}\nG0 X0 Y0 Z0.2\nG92 E0\n", ["M82", "M83"][usize::from(relative)]);
        let mut e = 0.0;
        let mut words = Vec::new();
        for _ in 0..12 {
            let [x, y]: [f64; 2] = [(); 2].map(|()| draw.random_range(-100.0..100.0));
            let way = draw.random_range(-1.0..6.0);
            e = if relative { way } else { e + way };
            let word = format!("{e:.decimals$}");
            e = word.parse().expect("a number");
            let motion = match draw.random_range(0..4) {
                0 => format!("G2 X{x:.3} Y{y:.3} R900.0 E{word}\n"),
                _ => format!("G1 X{x:.3} Y{y:.3} E{word} F1800\n"),
            };
            program += &motion;
            words.push(word);
        }
        // Each motion alone, after the preceding lines.
        let lines: Vec<&str> = program.lines().collect();
        let mut before =
            numbers(&result(control, BENT, &(lines[..4].join("\n") + "\n")).expect("taken"), 'E')
                .len();
        let mut e_before = 0;
        for (place, word) in words.iter().enumerate() {
            let part = lines[..5 + place].join("\n") + "\n";
            let text = result(control, BENT, &part).expect("taken");
            let all = numbers(&text, 'E');
            let parts = &all[before..];
            before = all.len();
            split += usize::from(parts.len() > 1);
            let said = numbers(&format!("G1 E{word}"), 'E')[0];
            if relative {
                assert_eq!(parts.iter().sum::<i64>(), said, "{text}");
                // No part retracts.
                assert!(parts.iter().all(|part| part.signum() * said.signum() >= 0), "{text}");
                continue;
            }
            if said == e_before && parts.is_empty() {
                continue;
            }
            assert_eq!(parts.last(), Some(&said), "{text}");
            let rises = said >= e_before;
            let mut last = e_before;
            for part in parts {
                assert!(if rises { *part >= last } else { *part <= last }, "{text}");
                last = *part;
            }
            e_before = said;
        }
    }
    assert!(split > 500, "{split}");
}

/// Each part has the share of its length, on a line halved by the bend and on a half circle.
#[test]
fn filament_follows_the_path_length() {
    for relative in [false, true] {
        let mode = ["M82", "M83"][usize::from(relative)];
        let program = format!("G90\n{mode}\nG0 X100 Y0 Z0.2\nG92 E0\nG3 X-100 Y0 I-100 J0 E4.25\n");
        let text = result("klipper", BENT, &program).expect("taken");
        let [x, y, e] = ['X', 'Y', 'E'].map(|letter| numbers(&text, letter));
        // Without the first words of X, Y and E, which are those of G0 and G92.
        let (mut angle, mut filament) = (0.0_f64, 0.0);
        assert!(e.len() > 6, "{text}");
        for ((x, y), e) in x[1..].iter().zip(&y[1..]).zip(&e[1..]) {
            let e = *e as f64 * 1e-9;
            filament = if relative { filament + e } else { e };
            angle = (*y as f64).atan2(*x as f64).max(angle);
            assert!(
                (filament - 4.25 * angle / std::f64::consts::PI).abs() < 2e-3,
                "{angle} {filament}\n{text}"
            );
        }
        assert!((filament - 4.25).abs() < 1e-9, "{filament}");
    }
}

#[test]
fn unknown_filament_of_a_split_motion_is_refused() {
    let line = "G1 X100 Y0 E5\n";
    for [control, program, expected] in &cases(
        r"
klipper | G90\nG0 X0 Y0 Z0\n | line 3: a motion that is split: the position of E before it is unknown
marlin | G90\nG0 X0 Y0 Z0\n | line 3: a motion that is split: the position of E before it is unknown
marlin | M83\nG90\nG0 X0 Y0 Z0\n | line 4: a motion that is split: versions of Marlin differ in whether its E
marlin | G91\nM82\nG90\nG0 X0 Y0 Z0\nG91\nM82\n | line 7: a motion that is split: versions of Marlin differ
klipper | G92\n | line 1: G92 without an axis
",
    ) {
        let error = result(control, BENT, &format!("{program}{line}")).expect_err(program);
        assert!(error.starts_with(expected), "{error}");
    }
    for (control, program) in [
        ("klipper", "M83\nG90\nG0 X0 Y0 Z0\n"),
        ("marlin", "G90\nM83\nG0 X0 Y0 Z0\n"),
        ("marlin", "M83\nG90\nG0 X0 Y0 Z0\nG1 X10 E5\nM83\n"),
        ("klipper", "M82\nG0 X0 Y0 Z0\nG1 X1 E3\n"),
    ] {
        let found = result(control, BENT, &format!("{program}{line}"));
        assert!(found.is_ok(), "{control} {program} {found:?}");
    }
}

/// G53 is refused for Klipper, which ignores it and moves in program coordinates; Marlin has machine coordinates.
#[test]
fn klipper_has_no_machine_coordinates() {
    let program = "G0 X0 Y0 Z0\nG53 G0 X10\n";
    let error = result("klipper", "", program).expect_err("refused");
    assert!(error.starts_with("line 2: G53"), "{error}");
    assert_eq!(result("marlin", "", program).as_deref(), Ok(program));
}

/// Commands are copied unchanged, whatever letters and numbers they have. After those that may move an axis, the positions are unknown.
#[test]
fn printer_commands_are_copied() {
    let harmless = [
        "M73 P0 R12",
        "M104 S215",
        "M106 S127.5",
        "M107",
        "M109 S215",
        "M140 S60",
        "M190 S60",
        "M204 P1000 T1500",
        "M205 X8 Y8 Z0.4 E5",
        "M201 X9000 Y9000 Z500 E10000",
        "M203 X500 Y500 Z12 E120",
        "M220 S100",
        "M221 S95",
        "M117 Layer 3 of 7 (X10 Y20",
        "M117 100% done",
        "M118 E1 done: X=3",
        "M900 K0.04",
        "M115 U3.10.1",
        "M400",
        "M486 S-1",
        "G4 P100",
        "G4 S1",
        "G10",
        "G11",
        "; X1 Y2",
        "  m117 hi",
        "N12 M105",
        "SET_PRESSURE_ADVANCE ADVANCE=0.05",
        "set_velocity_limit accel=3000",
        "EXCLUDE_OBJECT_START NAME=part_0",
        "SET_PRINT_STATS_INFO CURRENT_LAYER=3",
        "M30 file.gco",
    ];
    let moves = [
        "PRINT_START BED=60 EXTRUDER=215",
        "_HOME_XY",
        "BED_MESH_CALIBRATE",
        "M600",
        "T0",
        "Tx",
        "M92 X80 Y80 Z400 E93",
        "M206 X1.5",
        "G28",
        "G28 X Y",
        "G28 W",
        "G29",
        "G80",
        "G61 S0",
        "G27 P2",
        "M420 S1",
        "M84 X Y E",
        "M702 C",
        "M851 Z-1.2",
    ];
    for control in PRINTERS {
        for (lines, known) in [(&harmless[..], true), (&moves[..], false)] {
            for line in lines {
                let program = format!("G90\nG0 X0 Y100 Z0.2\n{line}\nG1 Y200\nG1 X20\n");
                let (text, summary) = run(control, SKEW, &program).expect(line);
                // After a possible motion of X no word of X is added.
                let added = if known { " X0.200" } else { "" };
                let expected =
                    format!("G90\nG0 X0.100 Y100 Z0.2\n{line}\nG1 Y200{added}\nG1 X20.200\n");
                assert_eq!(text, expected, "{control}");
                assert_eq!(is_unknown_after_line_3(&summary), !known, "{line} {:?}", summary.notes);
            }
        }
        for [line, expected] in &cases(
            r"
G81 X1 Y1 Z1 R1 | line 1: column 1: G81 is not supported
SET_GCODE_OFFSET X=10 | line 1: column 1: SET_GCODE_OFFSET is not supported
RESTORE_GCODE_STATE NAME=a | line 1: column 1: RESTORE_GCODE_STATE is not supported
G1 X0 Y0\nX10 | line 2: coordinates without a code
G1 X0 Y0\nG92 X10\nG28 Y | line 3: G28 of some axes
N3 G1 X10 Y5*71 | line 1: column 13: found '*'
",
        ) {
            let error = result(control, SKEW, &format!("{line}\n")).expect_err(line);
            assert!(error.starts_with(expected), "{error}");
        }
    }
    // On another control this is a word.
    assert!(result("linuxcnc", SKEW, "PRINT_START BED=60\n").is_err());
    assert!(result("linuxcnc", SKEW, "M117 Layer\n").is_err());
}

/// After homing an incremental motion is not split, and shifts have ended.
#[test]
fn homing_makes_positions_unknown() {
    let text = result("klipper", BENT, "G90\nM83\nG0 X0 Y0 Z0\nG28\nG1 X100 E1\nG1 Y1\nG1 X0 E1\n")
        .expect("taken");
    assert_eq!(
        text,
        "G90\nM83\nG0 X0 Y0 Z0\nG28\nG1 X99.990 E1\nG1 Y1\nG1 X49.995 E0.5 Y0.980\nG1 X0.000 Y1.000 E0.5\n"
    );
    let text = result("klipper", SKEW, "G90\nG0 X0 Y0\nG92 Y100\nG0 Y200\nG28\nG0 X0 Y200\n")
        .expect("taken");
    assert_eq!(text, "G90\nG0 X0 Y0\nG92 Y100\nG0 Y200 X0.100\nG28\nG0 X0.200 Y200\n");
}

#[test]
fn grbl_settings_are_copied() {
    for (line, known) in [
        ("$X", true),
        ("$$", true),
        ("$110=5000", true),
        ("$10=1", true),
        ("$I", true),
        ("$H", false),
        ("$100=80", false),
        ("$RST=$", false),
    ] {
        let program = format!("G90\nG0 X0 Y100\n{line}\nX20\n");
        let (text, summary) = run("grbl", SKEW, &program).expect(line);
        assert_eq!(text, format!("G90\nG0 X0.100 Y100\n{line}\nX20.100\n"));
        assert_eq!(is_unknown_after_line_3(&summary), !known, "{line}");
    }
    let error = result("grbl", SKEW, "$J=G91 X10 F100\n").expect_err("a jog");
    begins(&error, "line 1: column 1: $J is not supported");
}
