//! SINUMERIK: the paths of RS-274 in several notations, results, and refusals.

use std::fmt::Write as _;

use volcomp_model::Machine;
use volcomp_nc::{Dialect, NcError};
use volcomp_test_support::{cases, rows};

use crate::{
    identity::{written, written_with},
    random_programs::{
        Draw, Step, Way, accepts_with_result, assert_copied, assert_equal_paths,
        assert_same_positions, centre_point_lines, judged, path, tilting, worn,
    },
};

const SEEDS: u64 = 64;

fn header() -> String {
    "%_N_DRAWN_MPF\nG71 G90 G54 G17 ; as RS-274\nF1000\n".to_owned()
}

fn circle(draw: &mut Draw, step: &Step, centre: [f64; 2], turns: f64) -> String {
    let [i, j] = [centre[0] - step.from[0], centre[1] - step.from[1]];
    match draw.below(3) {
        0 => format!("I{i:.6} J={j:.6}"),
        1 => format!("I=AC({:.6}) J=AC({:.6})", centre[0], centre[1]),
        // A radius defines the centre only if the arc is neither flat nor close to half a turn.
        _ if (0.8..2.4).contains(&turns.abs()) => format!("CR={:.6}", i.hypot(j)),
        _ => format!("J=IC({j:.6}) I{i:.6}"),
    }
}

fn code(way: Way) -> u32 {
    match way {
        Way::Rapid => 0,
        Way::Line => 1,
        Way::Arc(_, turns) if turns < 0.0 => 2,
        Way::Arc(..) => 3,
    }
}

#[test]
fn absolute_words() {
    // Reversal values of both signs: the carriage of X runs ahead or lags.
    let machines = [6.0, -6.0].map(worn);
    for (machine, seed) in
        machines.iter().flat_map(|machine| (0..SEEDS).map(move |seed| (machine, seed)))
    {
        let draw = &mut Draw::new(seed);
        let path = path(draw, 12);
        let mut text = header();
        for (place, step) in path.iter().enumerate() {
            let [x, y, z] = step.to;
            let circle = match step.way {
                Way::Arc(centre, turns) => circle(draw, step, centre, turns),
                _ => format!("Z={z:.6}"),
            };
            let code = code(step.way);
            writeln!(text, "N{place}0 G{code} X{x:.6}Y={y:.6} {circle} ; {place}")
                .expect("a string");
        }
        assert_same_positions(machine, &path, Dialect::Siemens, &(text + "M30\n"));
    }
}

#[test]
fn incremental_words() {
    let machine = worn(6.0);
    for seed in 0..SEEDS {
        let draw = &mut Draw::new(1000 + seed);
        let path = path(draw, 12);
        let mut text = header();
        for (place, step) in path.iter().enumerate() {
            let modal = ["G90", "G91"][draw.below(2)];
            let mut word = |axis: usize| {
                let name = ["X", "Y", "Z"][axis];
                let (to, by) = (step.to[axis], step.to[axis] - step.from[axis]);
                // After G54 an axis needs an absolute position first.
                match (draw.below(if place == 0 { 1 } else { 2 }), modal) {
                    (0, "G90") => format!("{name}{to:.6}"),
                    (0, _) => format!("{name}=AC({to:.6})"),
                    (_, "G90") => format!("{name}=IC({by:.6})"),
                    (_, _) => format!("{name}{by:.6}"),
                }
            };
            let (x, y, z) = (word(0), word(1), word(2));
            let rest = match step.way {
                Way::Arc(centre, turns) => circle(draw, step, centre, turns),
                _ => z,
            };
            writeln!(text, "{modal}\nG{} {x} {y} {rest}", code(step.way)).expect("a string");
        }
        assert_same_positions(&machine, &path, Dialect::Siemens, &(text + "M30\n"));
    }
}

/// A plane frame: rotation, then shift.
#[derive(Clone, Copy)]
struct Frame {
    angle: f64,
    by: [f64; 3],
}

impl Frame {
    fn turn(angle: f64, [x, y]: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = angle.sin_cos();
        [cos * x - sin * y, sin * x + cos * y]
    }

    fn then(self, other: Self) -> Self {
        let [x, y] = Self::turn(self.angle, [other.by[0], other.by[1]]);
        Self {
            angle: self.angle + other.angle,
            by: [self.by[0] + x, self.by[1] + y, self.by[2] + other.by[2]],
        }
    }

    /// Workpiece position of a position in this frame.
    fn inside(self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let [x, y] = Self::turn(-self.angle, [x - self.by[0], y - self.by[1]]);
        [x, y, z - self.by[2]]
    }
}

#[test]
fn frames_in_their_order() {
    const NONE: Frame = Frame { angle: 0.0, by: [0.0; 3] };
    // Without backlash, since the rounding of words in a rotated frame must not reverse an axis.
    let machine = worn(0.0);
    for seed in 0..SEEDS {
        let draw = &mut Draw::new(2000 + seed);
        let path = path(draw, 14);
        let (mut text, mut frame) = (header(), NONE);
        for step in &path {
            if draw.below(2) == 0 {
                let by: [f64; 3] = std::array::from_fn(|_| draw.thousandths(-50.0, 50.0));
                let shift = Frame { angle: 0.0, by };
                let degrees = draw.thousandths(-170.0, 170.0);
                let turn = Frame { angle: degrees.to_radians(), by: [0.0; 3] };
                let [x, y, z] = by;
                let added = draw.below(6);
                frame = match added {
                    0 => shift,
                    1 | 2 => frame.then(shift),
                    3 => turn,
                    4 => frame.then(turn),
                    _ => NONE,
                };
                let line = match added {
                    0 => format!("TRANS X{x} Y={y} Z{z}"),
                    1 | 2 => format!("ATRANS X={x} Y{y} Z={z} ; on top"),
                    3 => format!("ROT RPL={degrees}"),
                    4 => format!("AROT Z{degrees}"),
                    _ => ["TRANS", "ROT"][draw.below(2)].to_owned(),
                };
                writeln!(text, "{line}").expect("a string");
            }
            let inside =
                Step { way: step.way, from: frame.inside(step.from), to: frame.inside(step.to) };
            let [x, y, z] = inside.to;
            let rest = match step.way {
                Way::Arc([i, j], turns) => {
                    let [i, j, _] = frame.inside([i, j, 0.0]);
                    circle(draw, &inside, [i, j], turns)
                }
                _ => String::new(),
            };
            writeln!(text, "G{} X{x:.6} Y{y:.6} Z{z:.6} {rest}", code(step.way)).expect("a string");
        }
        assert_same_positions(&machine, &path, Dialect::Siemens, &(text + "M30\n"));
    }
}

#[test]
fn r_parameters() {
    let machine = worn(6.0);
    for seed in 0..SEEDS {
        let draw = &mut Draw::new(3000 + seed);
        let path = path(draw, 12);
        let mut text = header() + "DEF REAL HALF=0.5, DEPTH\n";
        for step in &path {
            let [x, y, z] = step.to;
            let rest = match step.way {
                Way::Arc(centre, turns) => circle(draw, step, centre, turns),
                _ => "Z=DEPTH".to_owned(),
            };
            let more = draw.thousandths(-20.0, 20.0);
            writeln!(text, "R1={:.6} R[2]={:.6}\nDEPTH={z:.6}", x - more, 2.0 * y)
                .expect("a string");
            let code = code(step.way);
            writeln!(text, "G{code} X=R1+({more}) Y=R2*HALF+POT(3)-9*SIN(90) {rest}")
                .expect("a string");
        }
        assert_same_positions(&machine, &path, Dialect::Siemens, &(text + "M30\n"));
    }
}

/// TRAORI gives the same digits as M428 in RS-274.
#[test]
fn traori_has_the_numbers_of_m428() {
    let machine = tilting();
    for seed in 0..SEEDS {
        let draw = &mut Draw::new(4000 + seed);
        let lines = centre_point_lines(draw).join("\n");
        let in_rs274 = format!("G54 F2000\n{lines}\nG0 X300 Y250 Z-50 A0 C0\n");
        let in_siemens = in_rs274.replace("M428", "TRAORI(1)").replace("M429", "TRAFOOF");
        let setup = "[work_offset.G54]\nX = 1.0\nY = 2.0\nZ = -3.0\n";
        let in_linear_words = format!("rotary_words = \"linear\"\n{setup}");
        let (expected, _, of_rs274) =
            judged(&machine, &in_linear_words, Dialect::Rs274, &in_rs274).expect("taken");
        let (found, _, of_siemens) =
            judged(&machine, setup, Dialect::Siemens, &in_siemens).expect("taken");
        let expected = expected.replace("M428", "TRAORI(1)").replace("M429", "TRAFOOF");
        assert_eq!(found, expected, "{seed}");
        assert_equal_paths(&of_siemens, &of_rs274, &in_siemens, &found);
    }
}

fn compensated(errors: &str, setup: &str, program: &str) -> Result<(String, Vec<String>), NcError> {
    written_with(Dialect::Siemens, errors, setup, program)
}

/// X is 100 µm/m too long. The expected positions follow from this closed form; each word keeps its notation.
#[test]
fn words_keep_their_notation() {
    let scale = "[errors]\nEXX = { poly = [0.0, 0.1] }\n";
    for [program, expected] in &cases(
        r"
G90 G0 X100\n | G90 G0 X99.990\n
G0 X=100 ; there\n | G0 X=99.990 ; there\n
N10 G1 X=AC( 100 ) F=R9\n | N10 G1 X=AC( 99.990 ) F=R9\n
G0 X0\nX=IC(100)\nX=IC(-100.0)\n | G0 X0\nX=IC(99.990)\nX=IC(-99.990)\n
G0 X0\nG91 X100\nX=AC(200) X=AC(200)\n | line 3: found X and X in one block, expected only one of them
G0 X0\nG91 X100\nX=AC(200)\nX100\n | G0 X0\nG91 X99.990\nX=AC(199.980)\nX99.990\n
R1=40 R2=60\nG0 X=R1+R2\n | R1=40 R2=60\nG0 X=99.990\n
DEF REAL LENGTH=50\nG0X=LENGTH*2\n | DEF REAL LENGTH=50\nG0X=99.990\n
G0 X=1EX2\n | G0 X=99.990\n
TRANS X100\nG0 X0\n | TRANS X100\nG0 X-0.010\n
G0 X0\nTRANS Y50\nX=IC(100)\n | G0 X0\nTRANS Y50\nX=IC(99.990)\n
G54\nG0 X0\nG54\nX=IC(100)\n | G54\nG0 X0\nG54\nX=IC(99.990)\n
TRANS X100\nG0 X0\nG91 X100\n | TRANS X100\nG0 X-0.010\nG91 X99.990\n
G70 G0 X10\nG71 X254\n | G70 G0 X9.9990\nG71 X253.975\n
/2 N5 G0 X100 M5\nX200\n | /2 N5 G0 X99.990 M5\nX199.980\n
G0 X0 Y0\nG2 X20 Y0 CR=10\nX0 I=AC(10) J0\n | G0 X0 Y0\nG2 X19.998 Y0 CR=9.999\nX0 I=AC(9.999) J-0.001\n
G4 F3\nG0 X100 F5\n | G4 F3\nG0 X99.990 F5\n
G25 X100\nG0 X100\n | G25 X100\nG0 X99.990\n
STAGE: G0 X100\n | STAGE: G0 X99.990\n
",
    ) {
        let found = match compensated(scale, "", program) {
            Ok((found, _)) => found,
            Err(error) => error.to_string(),
        };
        assert_eq!(&found, expected, "{program}");
    }
}

/// A curved guideway splits a line: added lines keep the notation of the words and the slash of a skippable block, and the stop is at the
/// end.
#[test]
fn added_lines_keep_the_notation() {
    let bent = "[errors]\nEYX = { table = [[-1000, 0], [0, 0], [100, 20], [200, 0], [1000, 0]], interpolation = \"linear\" }\n";
    let program = "G0 X0 Y0 Z0\n/1 N10 G1 X=IC(200) Y=AC(0) F500 M0\n";
    let (text, _) = compensated(bent, "", program).expect("taken");
    assert_eq!(
        text,
        "G0 X0 Y0 Z0\n/1 N10 G1 X=IC(100.000) Y=AC(-0.020) F500\n/1 X=IC(100.000) Y=AC(0.000) M0\n"
    );
    let (text, _) = compensated(bent, "", "G0 X0 Y0 Z0\nG9 G1 X200 F500\n").expect("taken");
    assert!(text.ends_with(" G9\n") && text.matches("G9").count() == 1, "{text}");
}

/// DC takes the shorter way after any number of turns and stays within one turn; DC of half a turn is refused.
#[test]
fn the_shorter_way() {
    let machine_text = "name = \"m\"\nstructure = \"w A' b X Y Z t\"\n[axes.X]\ntravel = [-500, 500]\n[axes.Y]\ntravel = [-500, 500]\n[axes.Z]\ntravel = [-500, 500]\n[axes.A]\ntravel = [-360, 360]\n[errors]\nEAA = { poly = [104.719755] }\n";
    let machine = Machine::parse(machine_text, "m.toml").expect("a good machine");
    // A is corrected by -0.006°.
    let program = "G0 X0 Y0 Z0 A350\nA=DC(10)\nA=DC(0)\nA=DC(359.9)\nA=IC(-10)\n";
    let (text, _) = written(Dialect::Siemens, &machine, "", program).expect("taken");
    assert_eq!(
        text,
        "G0 X0 Y0 Z0 A349.994\nA=DC(9.994)\nA=DC(359.994)\nA=DC(359.894)\nA=IC(-10)\n"
    );
    let error = written(Dialect::Siemens, &machine, "", "G0 X0 Y0 Z0 A0\nA=DC(180)\n")
        .expect_err("refused");
    assert!(error.to_string().contains("half a turn"), "{error}");
    let error = written(Dialect::Siemens, &machine, "", "G0 X=DC(5)\n").expect_err("refused");
    assert!(error.to_string().contains("is not rotary"), "{error}");
    let swivel = machine_text.replace("[-360, 360]", "[-120, 120]");
    let swivel = Machine::parse(&swivel, "m.toml").expect("a good machine");
    let error = written(Dialect::Siemens, &swivel, "", "G0 X0 Y0 Z0 A-100\nA=DC(100)\n")
        .expect_err("refused");
    assert!(error.to_string().contains("over the end of a travel"), "{error}");
    // A word that applies to one block would apply to the first part only.
    let error = written(Dialect::Siemens, &machine, "", "G0 X0 Y0 Z0\nG1 X50 F100 FB=50\n")
        .expect_err("refused");
    assert!(error.to_string().contains("FB is not supported"), "{error}");
}

#[test]
fn offsets_and_tools() {
    let scale = "[errors]\nEXX = { poly = [0.0, 0.1] }\nEXZ = { poly = [0.0, 0.1] }\n";
    let setup =
        "[work_offset.G54]\nX = 100.0\n[work_offset.G505]\nX = 300.0\n[tool.3]\nZ = 200.0\n";
    for [program, expected] in rows(
        r"
// 10 µm per 100 mm.
G0 Z0 X0\nG54 X0\nG505 X0\nG500 X0\n | G0 Z0 X0\nG54 X-0.010\nG505 X-0.030\nG500 X0\n
G54 G0 Z0 X0\nSUPA X100\nX0\n | G54 G0 Z0 X-0.010\nSUPA X100\nX-0.010\n
T3 M6\nG0 Z0 X0\nD0\nZ0 X0\n | T3 M6\nG0 Z0 X-0.020\nD0\nZ0 X0\n
T=3\nD1\nG0 Z0 X0\n | T=3\nD1\nG0 Z0 X-0.020\n
",
    ) {
        let (text, notes) = compensated(scale, setup, program).expect("taken");
        assert_eq!(text, expected, "{notes:?}");
    }
    let (_, notes) = compensated(scale, setup, "T=\"DRILL\" M6\nG0 X1\n").expect("taken");
    assert!(notes[0].contains("by number only"), "{notes:?}");
}

/// Cycles are copied; the next motion starts where they leave the tool.
#[test]
fn cycles_are_copied() {
    let errors = "[errors]\nEXX = { poly = [0.0, 0.1] }\nEZX = { poly = [0.0, 0.1] }\n";
    let program = "G0 X100 Y0 Z50\nCYCLE81(20, 0, 2, -10)\nX200\nMCALL CYCLE82(30,0,2,-5,,1)\nG1 X300 F100\nX400\nMCALL\nPOCKET3(50,0,2,-5,40,30,5,0,0,0)\nX100\n";
    let (text, notes) = compensated(errors, "", program).expect("taken");
    assert_eq!(
        text,
        "G0 X99.990 Y0 Z49.990\nCYCLE81(20, 0, 2, -10)\nX199.980 Z19.980\nMCALL CYCLE82(30,0,2,-5,,1)\nG1 X299.970 F100 Z19.970\nX399.960 Z29.960\nMCALL\nPOCKET3(50,0,2,-5,40,30,5,0,0,0)\nX99.990\n"
    );
    let passed = |name: &str| {
        notes.iter().any(|note| note.contains(&format!("motions of {name} are copied")))
    };
    assert!(passed("CYCLE81") && passed("CYCLE82") && passed("POCKET3"), "{notes:?}");
}

#[test]
fn unsupported_words_are_refused_with_position_and_reason() {
    for [line, expected] in &cases(
        r#"
IF R1>5 GOTOF END | column 1: IF is not supported: jumps and loops are not supported
N10 GOTOB START | column 5: GOTOB is not supported
WHILE R1<5 | column 1: WHILE is not supported
REPEAT L1 P=3 | column 1: REPEAT is not supported
L100 | column 1: L100 is not supported: it may be a subprogram
G0 X1 CONTOUR | column 7: CONTOUR is not supported
CONTOUR(5) | column 1: CONTOUR is not supported: it may be a subprogram
CYCLE800(1,"T") | column 1: CYCLE800 is not supported: frames other than
ROT X30 | column 5: X is not supported: only rotations about Z
SCALE X2 | column 1: SCALE is not supported
MIRROR X0 | column 1: MIRROR is not supported
BSPLINE X1 | column 1: BSPLINE is not supported: a curve
G1 X1 RND=2 | column 7: RND is not supported: a rounded
G1 X1 CHF=2 | column 7: CHF is not supported
G2 X1 I1 TURN=2 | column 10: TURN is not supported
CIP X1 Y1 I1=5 J1=3 | column 1: CIP is not supported
G1 A3=0 B3=0 C3=1 | column 4: A3 is not supported: tool directions
G0 C=ACP(10) | column 6: ACP is not supported: a rotary axis that approaches from one side
G0 C=ACN(10) | column 6: ACN is not supported
ORIWKS | column 1: ORIWKS is not supported: tool orientations
G1 AP=30 RP=5 | column 4: AP is not supported: polar
G111 X1 | column 1: G111 is not supported: polar
TRANSMIT | column 1: TRANSMIT is not supported
TRAORI(2) | column 1: TRAORI is not supported
G0 X1=5 | column 4: X1 is not supported: an unknown axis
G0 Q1=5 | column 4: Q1 is not supported: an unknown axis
G33 Z5 K1 | column 1: G33 is not supported: its motions are not supported
G75 Z0 | column 1: G75 is not supported
G123 | column 1: G123 is not supported: it is unknown
POS[X]=5 | column 1: POS is not supported
$P_UIFR[1]=CTRANS(X,5) | column 1: $ is not supported
G0 G1 X1 | found G1 and G0
G0 X | column 4: expected a number
G0 X=R1+ | column 8: expected a number, a parameter or a function after this operator
G0 X=R77 | the value of X is only known at the machine
G0 X=$AA_IW[X] | the value of X is only known at the machine
G0 X=1/0 | column 7: this calculation has no result
R1=5 X=R1 | column 8: a parameter that the same block sets before
G2 X10 | an arc without a centre and without a radius
TRANS X50\nG91 X10 | an incremental motion (G91, IC) of an axis whose frame
G57\nG0 X=IC(10) | an incremental motion (G91, IC) of an axis whose frame
ATRANS X5\nROT RPL=30\nG0 Z=IC(1) Y=IC(1) | an incremental motion (G91, IC) of an axis whose frame
TRANS X50\nSUPA G0 X0\nX=IC(10) | an incremental motion (G91, IC) of an axis whose frame
G91 SUPA G0 X0 | incremental machine coordinates (G53, G153, SUPA, M91)
G0 X1 & | column 7: found '&'
D2 | a cutting edge other than D0 and D1
EX | column 1: EX is not supported
"#,
    ) {
        let error = compensated("", "", &format!("G0 X0 Y0 Z0\n{line}\n")).expect_err(line);
        let text = error.to_string();
        let found = text.split_once(": ").map_or("", |(_, found)| found);
        assert!(found.starts_with(expected), "{line}: {text}");
    }
}

#[test]
fn unusual_programs_are_copied_byte_for_byte() {
    let programs: [&[u8]; 10] = [
        b"",
        b"%_N_PART_MPF\r\n;$PATH=/_N_WKS_DIR/_N_PART_WPD\r\nN10 G71 G90\r\nn20 g1 x10y=20f100 ; caf\xe9 IF GOTO\r\n",
        b"PROC PART(REAL DEPTH) SAVE DISPLOF\nEXTERN OTHER(REAL)\nDEF REAL A1=5, B2, F[5]\nDEF STRING[20] NAME=\"a;b\"\nMSG(\"IF; X10 (\")\nRET\n",
        b"/ N5 G0 X10\n/3 Y5\nSTART: X20 ;label\n:10 G1 X30 F=500\n",
        b"T1 D1 M6\nS1=2000 M1=3\nG96 S200 LIMS=3000\nG0 X0 Y=AC(2)\nX=IC(1)\nM3 S1000 M8\nSPOS=90\n",
        b"G17 G64 SOFT FFWON COMPCAD CTOL=0.01\nG641 ADIS=0.5\nCYCLE832(0.01,_FINISH,1)\nG1 X5 F100\nFGROUP(X,Y)\nFGREF[C]=10\n",
        b"G1 G41 X10 Y10 F100\nX20\nG3 X30 Y20 CR=10\nG1 G40 X0 Y0\n",
        b"TRANS X10\nAROT RPL=30\nG0 X5 Y5\nATRANS Z5\nG2 X7 Y5 I1 J0 F100\nROT\nG500 SUPA G0 Z0 D0\nM30\nIF ELSE not read [[[\n",
        b"R1=5*(3+SIN(30))/2 R[2]=POT(3) R3=1.5EX-3\nR4=ATAN2(3,4) DIV 2 MOD 3\nG0 X=R1 Y=-R3 Z=MINVAL(R2,5)\n",
        b"G93 G1 X5 F2\nG94 F100\nG95 F0.1\nG4 F2\nG25 S100\nWORKPIECE(,,,\"BOX\",0)\nMCALL CYCLE83(50,0,2,-20)\nX5 Y5\nMCALL",
    ];
    assert_copied(Dialect::Siemens, &programs);
}

/// Random lines do not panic. A machine without errors returns accepted programs unchanged, and their result on a worn machine is
/// accepted.
#[test]
fn random_lines_are_copied_byte_for_byte() {
    const PIECES: &str = "G0|G1|G2|G3|G90|G91|X10|Y-5.5|Z=IC(3)|X=AC(7)|I5|J=AC(2)|CR=12|F100|M8|M30|TRANS|ATRANS|ROT RPL=30|\
        AROT Z=15|G54|G505|G500|SUPA|R1=5|X=R1*2|T1|D1|D0|M6|; comment|N10|/|G17|G18|G70|G71|G41|G40|\
        CYCLE81(10,0,2,-5)|MCALL CYCLE82(5,0,2,-5)|MCALL|STAGE:|G4 F2|G93|MSG(\"X\")|C=DC(5)|\"";
    let pieces: Vec<&str> = PIECES.split('|').collect();
    let mut taken = 0;
    for seed in 0..4000 {
        let draw = &mut Draw::new(5000 + seed);
        let mut text = String::new();
        for _ in 0..=draw.below(6) {
            for _ in 0..=draw.below(4) {
                text.push_str(pieces[draw.below(pieces.len())]);
                text.push_str(["", " ", " "][draw.below(3)]);
            }
            text.push('\n');
        }
        taken += usize::from(accepts_with_result(Dialect::Siemens, &text));
    }
    assert!(taken > 300, "only {taken} were taken");
}

/// Unchanged bytes are copied, also the blanks after a value that is replaced by a number. Very deep brackets are refused.
#[test]
fn blanks_after_computed_words_stay() {
    let taken = |program: &str| {
        compensated("[errors]\nEXX = { poly = [11] }\n", "", program).map(|(text, _)| text)
    };
    let program = "R1=10 R2=20\nG0 X=R1 Y=R2 Z0\nG1 X=R1+1  Y=R2 F=R2 ; more\nM30\n";
    assert_eq!(
        taken(program).expect("taken"),
        program.replace("X=R1 ", "X=9.989 ").replace("X=R1+1 ", "X=10.989 ")
    );
    let error = taken(&format!("X={}\n", "R[".repeat(200_000))).expect_err("refused");
    assert!(matches!(error, NcError::Block { .. } | NcError::LongLine { .. }), "{error}");
    let error = taken(&format!("X={}\n", "R[".repeat(2000))).expect_err("refused");
    assert!(error.to_string().contains("nested too deeply"), "{error}");
}

/// G96, G97 and their variants end G93: the parts of a split motion keep the F of the block.
#[test]
fn surface_speed_ends_inverse_time() {
    let bends = "[errors]\nEZX = { poly = [0.0, 0.0, 0.0005] }\n";
    for code in ["G93", "G94", "G96", "G961", "G962", "G97", "G971", "G972", "G973"] {
        let program = format!("G0 X0 Y0 Z0\nG93 G1 X10 F2\n{code} S100\nG1 X400 F0.2\n");
        let (out, _) = compensated(bends, "", &program).expect(code);
        let lines: Vec<&str> = out.lines().skip(3).collect();
        assert!(lines.len() > 2, "{out}");
        let has_own_feed = lines[1..].iter().any(|line| line.contains('F'));
        assert_eq!(has_own_feed, code == "G93", "{out}");
        assert_eq!(lines[0].contains("F0.2"), code != "G93", "{out}");
    }
}
