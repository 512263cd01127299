//! Positions that only the control knows.
//!
//! Values that are not stated are assumed to be zero, but no word may move an axis to an assumed position. Skippable
//! blocks (/) also leave unknown positions: the result is right whether the operator skips them or not. The behaviour
//! of controls is worked out by hand, for LinuxCNC by its interpreter (`rs274 -g`).

use volcomp_nc::{Dialect, NcError, SetUp, Summary};
use volcomp_test_support::{cases, rows};

use crate::{
    flow::text,
    identity::{begins, compensated, has, notes_of, of_control, text_in, written_with},
};

/// Z is 0.1 µm per mm of X too high: 40 µm at 400 mm.
const SLOPE: &str = "[errors]\nEZX = { poly = [0.0, 0.1] }\n";

fn run(setup: &str, program: &str) -> Result<(String, Summary), NcError> {
    text_in(setup, SLOPE, program)
}

fn result(setup: &str, program: &str) -> String {
    run(setup, program).expect(program).0
}

fn refusal(program: &str) -> String {
    run("", program).expect_err(program).to_string()
}

fn notes(setup: &str, program: &str) -> String {
    let (_, summary) = run(setup, program).expect(program);
    notes_of(&summary).join("\n")
}

/// No word of Z is added where it would move by an unknown value: the difference of two offsets, machine zero to part zero, or a tool
/// length.
#[test]
fn no_word_is_added_at_an_assumed_position() {
    for begins in [
        "G54 G0 X0 Y0 Z50\nG55\n",
        "G0 X0 Y0 Z50\nG53 G0 Z0\n",
        "G0 X0 Y0 Z50\nG28 Z0\n",
        "G0 X0 Y0 Z50\nG91 G30 P3 Z0\nG90\n",
        "G0 X0 Y0 Z50\nG43 H7\n",
        "G43 H7 G0 X0 Y0 Z50\nG49\n",
        "G43 H7 G0 X0 Y0 Z50\nG43 H8\n",
        "G43 G0 X0 Y0 Z50\nG49\n",
        // What an earlier program has left in the control.
        "G0 X0 Y0 Z50\nG49\n",
        "G0 X0 Y0 Z50\nG43.1 Z0\n",
        "G0 X0 Y0 Z50\nG54\n",
        "G0 X0 Y0 Z50\nG92.1\n",
        "G0 X0 Y0 Z50\nG92.2\n",
        "G0 X0 Y0 Z50\nG52 Z0\n",
        "G0 X0 Y0 Z50\nG52 X0\nG52 Z0\n",
        "G0 X0 Y0 Z50\nG92 X0\nG92.1\n",
        "G0 X0 Y0 Z50\nG92 Z0\nG92.1\n",
        "G0 X0 Y0 Z50\nG10 L2 P1 Z-310\n",
        "G0 X0 Y0 Z50\nG53 G0 Z0\nG92 Z0\nG92.1\n",
    ] {
        let program = format!("{begins}G0 X400\n");
        let (out, summary) = run("", &program).expect(begins);
        assert_eq!(out, program);
        let notes = format!("{:?}", summary.notes);
        assert!(notes.contains("LeftOut('Z')"), "{begins}{notes}");
        // Once Z is named, it is corrected again.
        let program = format!("{program}G0 Z20\nG0 X300\n");
        let out = result("", &program);
        assert!(out.ends_with("G0 Z19.960\nG0 X300 Z19.970\n"), "{out}");
    }
}

/// If the set-up states the values, or the offset does not change, the word is added: Z50 under G54 at −310 is Z60 under G55 at −320.
#[test]
fn stated_positions_stay_known() {
    let stated = "control = \"linuxcnc\"\n[work_offset.G54]\nZ = -310\n[work_offset.G55]\nZ = -320\n[tool.7]\nZ = 80\n[home.G28]\nZ = 0\n";
    for (begins, z) in [
        ("G54 G0 X0 Y0 Z50\nG55\n", "59.960"),
        ("G0 X0 Y0 Z50\nG53 G0 Z0\n", "309.960"),
        ("G0 X0 Y0 Z50\nG28 Z0\n", "309.960"),
        ("G49 G0 X0 Y0 Z50\nG43 H7\n", "-30.040"),
        ("T7 M6\nG43 H0 G0 X0 Y0 Z50\nG49\n", "129.960"),
        ("M61 Q7\nG43 G0 X0 Y0 Z50\nG49\n", "129.960"),
    ] {
        let out = result(stated, &format!("{begins}G0 X400\n"));
        assert_eq!(out, format!("{begins}G0 X400 Z{z}\n"));
    }
    for begins in [
        "G54 G0 X0 Y0 Z50\nG54\n",
        "G43 H7 G0 X0 Y0 Z50\nG43 H7\n",
        "G0 X0 Y0 Z0\nG92 Z50\n",
        "G53 G0 X0 Y0 Z0\nG92 X0 Y0 Z50\n",
        "G0 X0 Y0 Z0\nG10 L20 P1 Z50\n",
    ] {
        let out = result("", &format!("{begins}G0 X400\n"));
        assert_eq!(out, format!("{begins}G0 X400 Z49.960\n"));
    }
    // Incremental words have the correction under any offset.
    let out = result("", "G54 G0 X0 Y0 Z50\nG55\nG91 G0 X400\n");
    assert!(out.ends_with("G91 G0 X400 Z-0.040\n"), "{out}");
}

/// FANUC controls may move Z by a length that G43 or G49 changes, Haas controls cancel the length at G28, and on LinuxCNC T alone puts no
/// tool into the spindle.
#[test]
fn no_word_is_added_where_controls_treat_tool_lengths_differently() {
    let stated = "[work_offset.G54]\nZ = -310\n[tool.7]\nZ = 80\n[home.G28]\nZ = 0\n";
    for (control, begins) in [
        ("", "G0 X0 Y0 Z50.\nG43 H7\n"),
        ("fanuc", "G0 X0 Y0 Z50.\nG43 H7\n"),
        ("mazak", "G43 H7 G0 X0 Y0 Z50.\nG49\n"),
        ("haas", "G43 H7 G0 X0 Y0 Z50.\nG28 Z60.\n"),
        ("haas", "G43 H7 G0 X0 Y0 Z50.\nG53 G0 Z0\n"),
        ("fanuc", "G0 X0 Y0 Z50.\nG28\n"),
        ("linuxcnc", "T7\nG43 G0 X0 Y0 Z50.\nG49\n"),
    ] {
        let program = format!("{begins}G0 X400.\n");
        let setup = of_control(control) + stated;
        let (out, summary) = run(&setup, &program).expect(begins);
        assert_eq!(out, program, "{control}");
        assert!(format!("{:?}", summary.notes).contains("LeftOut('Z')"), "{control}{begins}");
    }
}

#[test]
fn motions_from_an_assumed_position_are_not_split() {
    let bent = "[errors]\nEZX = { poly = [0.0, 0.0, 0.0005] }\n";
    let run = |program: &str| {
        let (out, summary) = text_in("", bent, program).expect(program);
        (out.lines().count(), format!("{:?}", summary.notes))
    };
    let (lines, notes) = run("G54 G0 X0 Y0 Z50\nG55\nG1 X400 Z10 F100\n");
    assert_eq!(lines, 3, "a way from 50 mm under another offset is split");
    assert!(notes.contains("NotSplit"), "{notes}");
    let (lines, notes) = run("G54 G0 X0 Y0 Z50\nG54\nG1 X400 Z10 F100\n");
    assert!(lines > 5 && !notes.contains("NotSplit"), "{lines} {notes}");
}

#[test]
fn other_languages_have_unknown_positions_too() {
    for program in [
        "L X+0 Y+0 Z+50 FMAX\nTOOL CALL 5 Z S100\nL X+400 FMAX\n",
        "L X+0 Y+0 Z+50 FMAX\nL Z+0 FMAX M91\nL X+400 FMAX\n",
    ] {
        let (out, _) = written_with(Dialect::Heidenhain, SLOPE, "", program).expect("compensated");
        assert_eq!(out, program);
    }
    // A length or work offset that an earlier program has left in the control.
    for program in [
        "G0 X0 Y0 Z50\nD0\nG0 X400\n",
        "T=\"MILL\"\nG0 X0 Y0 Z50\nD0\nG0 X400\n",
        "G0 X0 Y0 Z50\nG500\nG0 X400\n",
        "G0 X0 Y0 Z50\nG54\nG0 X400\n",
    ] {
        let (out, _) = written_with(Dialect::Siemens, SLOPE, "", program).expect("compensated");
        assert_eq!(out, program);
    }
}

#[test]
fn a_stored_unknown_position_stays_unknown() {
    let program = "G28.1\nG28\nG0 X400\n";
    assert_eq!(result("", program), program);
    let program = "G0 X0 Y0 Z50\nG28.1\nG0 Z70\nG28\nG0 X400\n";
    assert!(result("", program).ends_with("G0 X400 Z49.960\n"));
}

/// Without a start position machine coordinates are unknown, so coordinates set there are not corrected, and a note names `[start]`.
#[test]
fn coordinates_set_at_an_unknown_position_are_not_corrected() {
    for set in ["G92 X0 Y0 Z0", "G10 L20 P1 X0 Y0 Z0"] {
        let program = format!("{set}\nG0 X400 Z5\nG1 X200 F100\n");
        let (out, summary) = run("", &program).expect(set);
        assert_eq!(out, program);
        let notes = notes_of(&summary);
        assert!(
            notes.iter().any(|note| note.starts_with("1: ") && note.contains("[start]")),
            "{notes:?}"
        );
        // 400 mm from 100 mm are at 500 mm.
        let start = "[work_offset.G54]\nX = 0\n[start]\nX = 100\nY = 0\nZ = 0\n";
        let out = result(start, &program);
        assert!(out.contains("G0 X400 Z4.950"), "{out}");
    }
}

/// Assignments to parameters of the control are refused. With #5223 = −50, `rs274` moves `G0 Z[#5223+40]` to −10.
#[test]
fn assignments_to_control_parameters_are_refused() {
    for number in ["5161", "5223", "5220", "5390", "5403", "5420"] {
        let message = refusal(&format!("G0 X0\n#{number}=-50\n"));
        begins(&message, &format!("line 2: a value for #{number}, "));
    }
    result("", "#5391=2\n#5160=1\n#5399=1\n");
}

/// The height after a cycle is known only with G98 or G99 in the program; `rs274` starts with G99 and continues at Z2, not at Z50.
#[test]
fn the_height_after_a_cycle_is_known_only_with_g98_or_g99() {
    let hole = |said: &str| format!("{said}G0 X0 Y0 Z50\nG81 X0 R2 Z-5 F100\nG80\nG1 X300\n");
    let last = |said: &str| {
        let out = result("", &hole(said));
        out.lines().last().expect("a line").to_owned()
    };
    assert_eq!(last(""), "G1 X300");
    assert_eq!(last("G98\n"), "G1 X300 Z49.970");
    assert_eq!(last("G99\n"), "G1 X300 Z1.970");
    let notes = notes("", &hole(""));
    assert!(notes.contains("2: a cycle before G98 or G99"), "{notes}");
}

/// (20, 0) rotated by 90° about (10, 5): (10, −5) becomes (5, 10), so the position is (15, 15).
#[test]
fn a_rotation_turns_about_its_centre() {
    // The correction at the machine position along X and Y, rotated back.
    let errors = "[errors]\nEXX = { poly = [0.0, 0.2] }\nEYY = { poly = [0.0, 0.4] }\n";
    let program = "G0 X0 Y0 Z0\nG68 X10 Y5 R90\nG0 X20 Y0\nG69\n";
    let (out, _) = text_in("", errors, program).expect("compensated");
    let (sin, cos) = (1.0, 0.0);
    let [x, y] = [20.0 - 10.0, 0.0 - 5.0];
    let machine = [10.0 + cos * x - sin * y, 5.0 + sin * x + cos * y];
    let delta = [-2e-4 * machine[0], -4e-4 * machine[1]];
    let back = [cos * delta[0] + sin * delta[1], cos * delta[1] - sin * delta[0]];
    let expected = format!("G0 X{:.3} Y{:.3}", 20.0 + back[0], back[1]);
    assert_eq!(out.lines().nth(2), Some(expected.as_str()), "{out}");
    for [program, why] in rows(
        r"
G0 X0 Y0\nG68 X10 R90\n | line 2: G68 without X and Y
G0 X0 Y0\nG52 X5\nG68 X10 Y5 R90\n | line 3: G68 while a shift
G0 X0 Y0\nG68 X10 Y5 R90\nG91 G0 X5\n | line 3: an incremental motion (G91) after G68
G68 X10 Y5 R90\nG0 X0 Y0\nG69\nG91 G0 X5\n | line 4: an incremental motion (G91) after G68
G91 G68 X10 Y5 R90\n | line 1: G68 in G91
G68 X10 Y5 G91 R90\n | line 1: G68 in G91
G68 X10 Y5 R90\nG52 Y5\n | line 2: a shift of X or Y
G68 X10 Y5 R90\nG92 X0\n | line 2: a shift of X or Y
",
    ) {
        let message = refusal(program);
        assert!(message.starts_with(why), "{message}");
    }
    result("", "G0 X0 Y0\nG68 X10 Y5 R90\nG0 X5\nG91 X5\n");
    // The control may leave Y at its position, or at its number.
    for switches in ["G68 X10 Y5 R90\n", "G68 X10 Y5 R90\nG0 X20 Y0\nG69\n"] {
        let program = format!("G0 X20 Y0 Z0\n{switches}G0 X400\n");
        let (out, _) = text_in("", errors, &program).expect("compensated");
        let last = out.lines().last().expect("a line");
        assert!(!last.contains('Y'), "{out}");
    }
}

#[test]
fn ambiguous_words_are_refused() {
    for [program, why] in &cases(
        r"
o100 sub\no100 endsub\n/o100 call\n | line 3: an O-word in a block that may be skipped
/G98\n | line 1: a block that may be skipped
/G99\n | line 1: a block that may be skipped
/T5\n | line 1: a block that may be skipped
/M6\n | line 1: a block that may be skipped
/G95\n | line 1: a block that may be skipped
G91 G10 L2 P1 X5\n | line 1: G10 L2 in G91
G10 L2 P0 X5\n | line 1: G10 L2 without a P from 1 to 9
G91 G53 G0 X5\n | line 1: G53 in G91
G43 H1\nG0 X0\nH2\n | line 3: H without G43
T1 M6\nG43 H0\n | line 2: G43 H0, the length of the tool in the spindle on LinuxCNC
G15 H1\n | line 1: H with G15, G16 or G54 to G59
G0 X0 Y0\nG16 H0\nX300 Y200\n | line 2: H with G15
G56 Z50 H5\n | line 1: H with G15
G43 H1\nG1 G42 H19 X5 F1\n | line 2: H with G41 or G42
G1 G41 H19 X5 F1\n | line 1: H with G41 or G42
M428\nG1 X1 A5 F1\n | line 2: a motion of A, which the machine file lacks
G43.4 H1\nG1 X1 B5 F1\n | line 2: a motion of B, which the machine file lacks
",
    ) {
        let message = refusal(program);
        assert!(message.starts_with(why), "{message}");
    }
    for good in [
        "M1001\nM12345678\n",
        "G43 H1\nG0 X0\nH1\n",
        "G54 G43 H1\n",
        "G91\nG90 G53 G0 X5\n",
        "H2\n",
    ] {
        assert_eq!(result("", good), good);
    }
    // G05.1 Q1 moves nothing; X continues with G1.
    assert_eq!(
        result("", "G0 X0 Y0 Z0\nG1 X100 F100\nG05.1 Q1\nX400\nG5 P10000\nX0\n"),
        "G0 X0 Y0 Z0\nG1 X100 F100 Z-0.010\nG05.1 Q1\nX400 Z-0.040\nG5 P10000\nX0 Z0.000\n"
    );
}

#[test]
fn tapping_returns_with_its_correction() {
    let tap = "G90 G33.1 Z-20 K1\nG91 G1 X0.5 F100\n";
    let out = result("", &format!("G90 G0 X400 Y0 Z10\n{}", tap.repeat(3)));
    assert_eq!(out, format!("G90 G0 X400 Y0 Z9.960\n{}", tap.repeat(3)));
}

#[test]
fn assumed_zeros_and_uncorrected_motions_are_noted() {
    let program = "G0 X400 Y0 Z0\nG53 G0 Z0\nG28 Z0\n";
    let found = notes("", program);
    assert_eq!(
        found,
        "1: the set-up file has no work offset G54: zero is assumed\n2: motions in machine coordinates (G53, G28, G30, SUPA, M91) are copied without correction\n3: the set-up file has no position of G28 ([home.G28]): machine zero is assumed"
    );
    let stated = "[work_offset.G54]\nX = 0\n[home.G28]\nX = 0\nY = 0\nZ = 0\n";
    assert_eq!(notes(stated, program).lines().count(), 1);
}

#[test]
fn other_languages_are_recognised() {
    for (line, why) in [
        ("IF [#1 EQ 1] GOTO 10", "macro language of FANUC"),
        ("N10 WHILE [#1 LT 5] DO1", "macro language of FANUC"),
        ("GOTO 10", "macro language of FANUC"),
        ("0 BEGIN PGM PART MM", "--dialect heidenhain"),
        ("5 L X+10 Y+20 R0 FMAX", "--dialect heidenhain"),
        ("TRANS X10", "--dialect siemens"),
        ("R1=5", "--dialect siemens"),
        ("N10 G1 X=IC(5)", "--dialect siemens"),
    ] {
        let message = refusal(&format!("{line}\n"));
        assert!(message.contains(why), "{line}: {message}");
    }
    let error = SetUp::parse("[work_offset.G60]\nX = 1\n", "s.toml").expect_err("refused");
    let message = error.to_string();
    has(&message, "G54 to G59");
    assert!(!message.contains("G560"), "{message}");
}

/// With G98 the tool returns to its height before the first hole; if that is unknown, no word of Z is added afterwards.
#[test]
fn a_hole_from_an_unknown_height_leaves_an_unknown_height() {
    let without_start = |program: &str| {
        let (out, summary) = run("[work_offset.G54]\nX = 0\n", program).expect("taken");
        (out, notes_of(&summary).join("; "))
    };
    let (out, notes) = without_start("G98\nG81 X100 Y0 Z-10 R5\nX200\nG80\nG0 X300\nG0 X400 Z9\n");
    assert_eq!(
        out,
        "G98\nG81 X100 Y0 Z-10.010 R4.990\nX200 Z-10.020\nG80\nG0 X300\nG0 X400 Z8.960\n"
    );
    assert!(notes.contains("corrections of Z are omitted"), "{notes}");
    // In plane R the height is known.
    let (out, _) = without_start("G99\nG81 X100 Y0 Z-10 R5\nG80\nG0 X300\n");
    assert_eq!(out, "G99\nG81 X100 Y0 Z-10.010 R4.990\nG80\nG0 X300 Z4.970\n");
    // After a skippable block the height is unknown, and also after the next hole.
    let (out, _) = without_start("G98\nG0 X0 Y0 Z150\n/G0 Z30\nG81 X100 Z-10 R5\nG80\nG0 X300\n");
    assert!(out.ends_with("G80\nG0 X300\n"), "{out}");
}

/// After a tool change the positions are unknown, because many machines move the axes for it.
#[test]
fn positions_are_unknown_after_a_change_of_tool_or_pallet() {
    let setup = "[work_offset.G54]\nX = 0\n[tool.1]\nZ = 0.0\n[tool.2]\nZ = 0.0\n[start]\nX = 0\nY = 0\nZ = 0\n";
    assert_eq!(
        result(setup, "G0 X100 Y0 Z5\nT2 M6\nG0 X200\nG0 Z5\nX300\n"),
        "G0 X100 Y0 Z4.990\nT2 M6\nG0 X200\nG0 Z4.980\nX300 Z4.970\n"
    );
    assert_eq!(
        result(setup, "G0 X100 Y0 Z5 M60\nG0 X200\nG0 Z5\n"),
        "G0 X100 Y0 Z4.990 M60\nG0 X200\nG0 Z4.980\n"
    );
}

/// If one axis of an arc is unknown, start, end and centre get one correction and the arc is not split. X is 50 µm/m too long.
#[test]
fn an_arc_with_one_unknown_axis_is_not_split() {
    let errors = "[errors]\nEXX = { poly = [0.0, 0.05] }\n";
    let result = |program: &str| text_in("", errors, program).expect(program).0;
    // Y is unknown until named; X is known and has -0.020 at 400 mm.
    for (arc, expected) in [
        ("G2 X420 I10 J0 F100", "G2 X419.980 I10 J0 F100"),
        ("G3 X420 R10 F100", "G3 X419.980 R10 F100"),
        ("G3 X420 Y0 R-10 F100", "G3 X419.980 Y0 R-10 F100"),
        ("G90.1 G2 X420 I410 J0 F100", "G90.1 G2 X419.980 I409.980 J0 F100"),
        ("G91 G2 X20 I10 J0 F100", "G91 G2 X20 I10 J0 F100"),
        ("G2 X420 Z-5 I10 J0 F100", "G2 X419.980 Z-5 I10 J0 F100"),
        ("G2 I10 J0 F100", "G2 I10 J0 F100"),
    ] {
        let out = result(&format!("G0 X400\n{arc}\n"));
        assert_eq!(out, format!("G0 X399.980\n{expected}\n"), "{arc}");
    }
    let out = result("G0 X400\nG18 G2 X420 I10 K0 F100\n");
    assert_eq!(out, "G0 X399.980\nG18 G2 X419.980 I10 K0 F100\n");
    // After the arc each known axis is corrected again.
    let out = result("G0 X400\nG2 X420 Y0 I10 J0 F100\nG1 X500 Y1\n");
    assert!(out.ends_with("G2 X419.980 Y0 I10 J0 F100\nG1 X499.975 Y1\n"), "{out}");
}

/// Words of an unknown code (steps per mm, accelerations, macro arguments) may not be coordinates: they are not changed, and positions
/// are unknown afterwards. X is corrected by 1 µm per mm of Y.
#[test]
fn words_of_unknown_codes_are_not_coordinates() {
    let skew = "[errors]\nEC0Y = 1000.0\n";
    let run = |control: &str, program: &str| {
        let found = text_in(&of_control(control), skew, program);
        found
            .map(|(out, summary)| (out, notes_of(&summary).join("\n")))
            .map_err(|error| error.to_string())
    };
    for control in ["", "linuxcnc", "fanuc", "haas", "mazak", "grbl"] {
        for block in [
            "M92 X80. Y80.",
            "M201 X1000. Y1000.",
            "M203 Y9.",
            "M205 X30. Y30. Z1. E5.",
            "M206 X1.5",
            "N5 Y50. M92 (steps)",
            "M92 X80",
            "M12345678 X1. Q2. R3.",
            "G90 F200 M203 Y#1",
        ] {
            let begins = "G90 G1 X0. Y100. Z0. F100\n";
            let program = format!("{begins}{block}\nX50.\nY200.\nX100.\nG91 X1. Y1.\n");
            let (out, notes) = run(control, &program).expect(block);
            let begins = "G90 G1 X0.100 Y100. Z0. F100\n";
            let behind = "X50.100\nY200. X50.200\nX100.200\nG91 X1.001 Y1.\n";
            let expected = format!("{begins}{block}\n{behind}");
            assert_eq!(out, expected, "{control} {block}");
            let name = block.split_whitespace().find(|word| word.starts_with('M'));
            let expected = format!("2: {} is copied unchanged", name.expect("an M code"));
            assert!(notes.contains(&expected), "{control} {block}: {notes}");
        }
        // Known codes and blocks with a motion code move the axes; so do unknown codes without axis words.
        for block in ["M8 X50.", "X50. M3 S100", "G1 M205 X50.", "M19 X50."] {
            let program = format!("G90 G1 X0. Y100. Z0. F100\n{block}\nY200.\n");
            let (out, _) = run(control, &program).expect(block);
            assert!(out.contains("X50.100"), "{control} {block}: {out}");
            assert!(out.ends_with("Y200. X50.200\n"), "{control} {block}: {out}");
        }
        let (out, _) = run(control, "G1 X0. Y100. Z0. F100\nM205\nY200.\n").expect("taken");
        assert_eq!(out, "G1 X0.100 Y100. Z0. F100\nM205\nY200. X0.200\n");
        // The arc could start with or without the correction.
        let arc = "G90 G1 X0. Y100. F100\nX10. M205\nG2 X20. I5.\n";
        let message = run(control, arc).expect_err(arc);
        begins(&message, "line 3: an arc after an unknown M code");
        let named = "G90 G1 X0. Y100. F100\nX10. M205\nG1 X10.\nG2 X20. I5.\n";
        run(control, named).expect(named);
        // Incremental words are copied until an absolute word names the position.
        let ways = "G90 G1 X0. Y100. F100\nM205 X1. Y1.\nG91 X5. Y5.\n";
        let (out, _) = run(control, ways).expect(ways);
        assert!(out.ends_with("M205 X1. Y1.\nG91 X5. Y5.\n"), "{out}");
    }
    // User programs of LinuxCNC take P and Q: coordinates in the same block are a motion.
    let (out, _) = run("linuxcnc", "G1 X0 Y100 F100\nM101 P1 Q2 X50\n").expect("taken");
    assert!(out.ends_with("M101 P1 Q2 X50.100\n"), "{out}");
    let (out, _) = run("", "G1 X0 Y100 F100\nM101 P1 Q2 X50\n").expect("taken");
    assert!(out.ends_with("M101 P1 Q2 X50\n"), "{out}");
    // Numbers of an M code do not count as coordinates without a point.
    for control in ["fanuc", "haas", "mazak"] {
        let (out, _) = run(control, "G1 X0. Y100. F100.\nM92 X80 Y80\nX50.\n").expect("taken");
        assert!(out.ends_with("M92 X80 Y80\nX50.100\n"), "{out}");
    }
}

/// Words that no code of the block uses are refused, as in the messages of `rs274` ("R word with no g code that uses it").
#[test]
fn words_that_a_motion_does_not_use_are_refused() {
    for [line, why] in &cases(
        "
G1 X1 E1 | E with G1, which is the filament of a printer
G0 X1 E1 | E with G0, which is
G2 X1 I.5 E1 | E with G2, which is
G1 X1 R1 | R with G1, which rounds a corner on some controls
X1 R1 | R with G1
G1 R5 | R with G1
G53 G1 X1 R1 | R with G1
G1 X1 Q1 | Q with G1, which no code of the block uses
G3 X1 I.5 Q1 | Q with G3
G1 X1 K1 | K with G1
G2 X1 I.5 K1 | K with G2, which is not a centre coordinate
G1 X1 M8 R5 | R with G1
",
    ) {
        for control in ["", "linuxcnc", "fanuc", "haas", "mazak", "grbl"] {
            let mut setup = of_control(control);
            if matches!(control, "fanuc" | "haas" | "mazak") {
                setup += "without_point = \"unit\"\n";
            }
            let program = format!("G90 G17 G0 X0 Y0 Z0\nG1 F100\n{line}\n");
            let message = run(&setup, &program).expect_err(line).to_string();
            let expected = format!("line 3: {why}");
            assert!(message.starts_with(&expected), "{setup}{line}: {message}");
        }
    }
    for line in [
        "G1 X1 G64 P.01 Q.01",
        "G1 X1 M19 R5",
        "G1 X1 M67 E0 Q1",
        "G1 X1 M66 P0 L0 Q1",
        "G1 X1 M61 Q0",
        "G18 G2 X1 I.5 K0",
        "G19 G2 Y1 R1",
        "G81 X1 Z-1 R1",
        "G5.1 Q1 R2",
        "G1 X1 M777 E1 Q1 R1 K1",
    ] {
        run("", &format!("G90 G17 G0 X0 Y0 Z0\nG1 F100\n{line}\n")).expect(line);
    }
    for control in ["marlin", "klipper"] {
        let setup = of_control(control);
        run(&setup, "M83\nG1 X1 E1\n").expect("filament");
        let message = run(&setup, "G1 X1 Q1\n").expect_err("refused").to_string();
        assert!(message.starts_with("line 1: Q with G1"), "{message}");
    }
}

/// The control points of a spline are relative to its ends, so the end keeps the correction of the start. X is 50 µm/m too long, 20 µm at
/// 400 mm.
#[test]
fn a_spline_is_not_split() {
    let errors = "[errors]\nEXX = { poly = [0.0, 0.05] }\n";
    for (spline, expected) in [
        ("G5 I0 J3 P0 Q-3 X500 Y50", "G5 I0 J3 P0 Q-3 X499.980 Y50"),
        ("G5.1 I5 J5 X500 Y60", "G5.1 I5 J5 X499.980 Y60"),
        (
            "G5.2 X500 Y120 P1 L3\nX600 Y130 P1\nG5.3",
            "G5.2 X499.980 Y120 P1 L3\nX599.980 Y130 P1\nG5.3",
        ),
        ("G91 G5.1 I5 J5 X100 Y60", "G91 G5.1 I5 J5 X100 Y60"),
    ] {
        for y in ["", " Y0"] {
            let program = format!("G0 X400{y}\n{spline}\nG90 G1 X800 Y0 F100\n");
            let (out, summary) = text_in("", errors, &program).expect(spline);
            assert_eq!(out, format!("G0 X399.980{y}\n{expected}\nG90 G1 X799.960 Y0 F100\n"));
            let notes = format!("{:?}", summary.notes);
            assert!(notes.contains("GoesWhole"), "{notes}");
        }
    }
}

/// In each language an axis at an unknown position gets no word while the others are corrected, also in cycles and about poles. At 400
/// mm: X −20 µm, Y −80 µm, Z −40 µm.
#[test]
fn unknown_axes_in_cycles_and_in_each_language() {
    let errors = "[errors]\nEXX = { poly = [0.0, 0.05] }\nEYX = { poly = [0.0, 0.2] }\nEZX = { poly = [0.0, 0.1] }\n";
    let run = |dialect, program: &str| {
        let written = written_with(dialect, errors, "", program);
        written.map(|(text, _)| text).map_err(|error| error.to_string())
    };
    for [language, program, expected] in rows(
        r"
// Holes have their own heights; with G98 the height is the one before.
rs274 | G0 X400 Y0 Z50\nT2 M6\nG98 G81 X300 Y10 Z-5 R2 F100\nX200\nG80\nG0 X100\nG0 Z9\n | G0 X399.980 Y-0.080 Z49.960\nT2 M6\nG98 G81 X299.985 Y9.940 Z-5.030 R1.970 F100\nX199.990 Z-5.020 R1.980 Y9.960\nG80\nG0 X99.995 Y9.980\nG0 Z8.990\n
rs274 | G0 X400 Y0 Z50\nM205 X1 Y1\nG99 G81 X300 Z-5 R2 F100\nY5\nX100 Y10\nG80\nG0 X200\n | G0 X399.980 Y-0.080 Z49.960\nM205 X1 Y1\nG99 G81 X299.985 Z-5.030 R1.970 F100\nY4.940\nX99.995 Y9.980 Z-5.010 R1.990\nG80\nG0 X199.990 Y9.960 Z1.980\n
// Both polar coordinates define X and Y.
rs274 | G0 X400 Y0 Z50\nT2 M6\nG16\nG0 X300 Y45\nG15\nG0 X100\n | G0 X399.980 Y-0.080 Z49.960\nT2 M6\nG16\nG0 X212.121 Y212.090 G15\nG15\nG0 X99.995 Y212.112\n
rs274 | G0 X400 Y0 Z50\nM205 X1 Y1\nG0 @300 ^45\nG0 X100\n | G0 X399.980 Y-0.080 Z49.960\nM205 X1 Y1\nG0 X212.121 Y212.090\nG0 X99.995 Y212.112\n
siemens | G0 X400\nG2 X420 I10 J0 F100\nG2 X440 Y0 CR=10\nG1 X500 Y1\n | G0 X399.980\nG2 X419.980 I10 J0 F100\nG2 X439.980 Y0 CR=10\nG1 X499.975 Y0.900\n
siemens | G0 X400 Y0 Z50\nT2 M6\nG0 X300\nCYCLE81(10,0,2,-5)\nG0 X200 Y10\nG0 X100\n | G0 X399.980 Y-0.080 Z49.960\nT2 M6\nG0 X299.985\nCYCLE81(10,0,2,-5)\nG0 X199.990 Y9.960 Z9.980\nG0 X99.995 Y9.980 Z9.990\n
heidenhain | L X+400 Y+0 Z+50 FMAX\nTOOL CALL 5 Z S100\nCYCL DEF 200 DRILLING ~\nQ200=2 ~\nQ201=-5\nL X+300 Y+10 FMAX M99\nL X+200\nL Z+20\nL X+100\n | L X+399.980 Y-0.080 Z+49.960 FMAX\nTOOL CALL 5 Z S100\nCYCL DEF 200 DRILLING ~\nQ200=2 ~\nQ201=-5\nL X+299.985 Y+9.940 FMAX M99\nL X+199.990 Y+9.960\nL Z+19.980\nL X+99.995 Y+9.980 Z+19.990\n
heidenhain | L X+400 FMAX\nCR X+420 Y+0 R+10 DR+ F100\nL X+100\n | L X+399.980 FMAX\nCR X+419.980 Y+0 R+10 DR+ F100\nL X+99.995 Y-0.020\n
",
    ) {
        let dialect = match language {
            "siemens" => Dialect::Siemens,
            "heidenhain" => Dialect::Heidenhain,
            _ => Dialect::Rs274,
        };
        assert_eq!(run(dialect, program).as_deref(), Ok(expected), "{program}");
    }
    // A pole relative to an unknown position is invalid.
    for [line, expected] in rows(
        r"
C X+420 Y+0 DR+ F100 | line 3: an arc without a radius and without a pole (CC) at a known position: program X and Y before
LP PR+50 PA+45 | line 3: polar coordinates without a pole (CC) at a known position: program X and Y before
",
    ) {
        let program = |begins: &str| format!("{begins}\nCC IX+10 IY+0\n{line}\n");
        let error = run(Dialect::Heidenhain, &program("L X+400 FMAX")).expect_err(line);
        assert!(error.starts_with(expected), "{error}");
        run(Dialect::Heidenhain, &program("L X+400 Y+0 FMAX")).expect(line);
    }
}

/// End position of a program of plain words, with its slash blocks executed or skipped.
fn ends(program: &str, skips: bool) -> [f64; 3] {
    let mut at = [0.0; 3];
    for line in program.lines().filter(|line| !(skips && line.starts_with('/'))) {
        for word in line.trim_start_matches('/').split(' ') {
            let axis = "XYZ".find(|letter| word.starts_with(letter));
            if let Some(axis) = axis {
                at[axis] = word[1..].parse().expect("a number");
            }
        }
    }
    at
}

#[test]
fn no_word_relies_on_a_skippable_block() {
    let square = "[errors]\nEC0Y = 200.0\nEZX = { poly = [0.0, 0.1] }\n";
    for program in [
        "G0 X10 Y10 Z5\nG1 Z-5 F100\n/Z-25\nX120 Y60\n",
        "G0 X10 Y10 Z5\n/G1 X100 F100\nG1 Y50 F100\n",
        "G0 X10 Y10 Z5\nG81 X20 Z-5 R2 F10\n/X40\nY30\n",
        "G0 X10 Y10 Z5\n/Z50\n/X200\nY0\nX0 Z1\nY100\n",
    ] {
        let result = text(square, program);
        for skips in [false, true] {
            let (wanted, found) = (ends(program, skips), ends(&result, skips));
            for axis in 0..3 {
                assert!((wanted[axis] - found[axis]).abs() < 0.1, "{program}{result}");
            }
        }
    }
}

#[test]
fn motions_after_a_skippable_block_are_not_split() {
    let bent = "[errors]\nEYX = { poly = [0.0, 0.0, 0.001] }\n";
    let result = text(bent, "G0 X0 Y0 Z0\n/X500\nG1 X-500 F100\nX500\n");
    let lines: Vec<&str> = result.lines().collect();
    assert!(lines[2].starts_with("G1 X-500"), "{result}");
    assert!(!lines[3].starts_with("X500"), "the way back is split: {result}");
    // Also if the program does not state its start.
    let result = text(bent, "G0 Z0\nG1 X-500 Y0 F100\nX500\n");
    let second = result.lines().nth(1).expect("a line");
    assert!(second.starts_with("G1 X-500 Y"), "{result}");
    assert!(result.lines().count() > 3, "{result}");
}

#[test]
fn modal_codes_in_skippable_blocks_are_refused() {
    for (block, line) in [
        ("/G91", 2),
        ("/G54", 2),
        ("/G20", 2),
        ("/G18 X1", 2),
        ("/G92 X0", 2),
        ("/#1=5", 2),
        ("/M30", 2),
        ("/G43 H1", 2),
        ("/G0 X5", 3),
    ] {
        let program = format!("G1 X0 Y0 Z0 F1\n{block}\nX10\n");
        let error = compensated("", program.as_bytes()).expect_err(block).to_string();
        begins(&error, &format!("line {line}: a "));
        has(&error, "(/)");
    }
    for good in ["/M8", "/G4 P1", "/X5 F100", "/G1 X5", "/(nothing)", "/G0 Z5\nG1"] {
        let program = format!("G1 X0 Y0 Z0 F1\n{good}\nG1 X10\n");
        let (out, _) = compensated("", program.as_bytes()).expect(good);
        assert_eq!(String::from_utf8_lossy(&out), program);
    }
}
