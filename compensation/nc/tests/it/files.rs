//! Files of editors, controls and tape punches: line ends, leaders and trailers.

use volcomp_model::{Machine, Temperatures};
use volcomp_nc::{Corrector, Dialect, Job, MeanOf, NcError, SetUp, average, compensate};
use volcomp_test_support::rows;

use crate::identity::{TRAVELS, compensated_in};

/// X is corrected by 1 µm per mm of Y, and a line over 50 mm of X is split.
const ERRORS: &str = "[errors]\nEC0Y = 1000.0\nEYX = { table = [[-1000, 0], [0, 0], [50, 20], [100, 0], [1000, 0]], interpolation = \"linear\" }\n";

const PROGRAMS: [&str; 4] = [
    "%\nO0001 (PART)\nG21 G90 G54\n\n(A COMMENT)\nG0 X0 Y100. Z10.\nG1 X100. F500.\nG2 X90. Y90. I0 J-10.\nG81 X20. Y50. Z-5. R2.\nG80\nM30\n%\n",
    "G0 X0 Y100 Z0\nG1 X100 F500\n\n\nX0\n",
    "G21 G90\nG0 X0 Y0 Z0\no100 repeat [3]\nG91 G1 X40 Y40 F100\nG90\no100 endrepeat\n\nG0 X0 Y0\nM2\n",
    "O1 (MAIN)\nG0 X0 Y100. Z0\nM98 P2 L2\nM30\nO2\nG91\nG1 X30. F100\nG90\nM99\n",
];

fn result(program: &[u8]) -> Result<Vec<u8>, NcError> {
    compensated_in(&SetUp::default(), ERRORS, program).map(|(out, _)| out)
}

fn with_ends(text: &[u8], end: &str) -> Vec<u8> {
    let text = String::from_utf8(text.to_vec()).expect("text");
    text.replace('\n', end).into_bytes()
}

#[test]
fn added_lines_have_the_line_ends_of_the_program() {
    for program in PROGRAMS {
        let expected = result(program.as_bytes()).expect("compensated");
        assert!(expected != program.as_bytes());
        for end in ["\r\n", "\r\r\n", "\n\r", "\n\r\r", "\r"] {
            let found = result(&with_ends(program.as_bytes(), end)).expect("compensated");
            assert_eq!(
                String::from_utf8_lossy(&found),
                String::from_utf8_lossy(&with_ends(&expected, end)),
                "{end:?}"
            );
        }
    }
}

#[test]
fn leaders_and_trailers_are_copied() {
    for program in PROGRAMS {
        let expected = result(program.as_bytes()).expect("compensated");
        for leader in [
            &b"\xef\xbb\xbf"[..],
            b"\0\0\0\0",
            b"\0\0\x12\0\r\n\0\0",
            b"\xef\xbb\xbf\0\n\n",
            b"\x11",
        ] {
            for trailer in [&b""[..], b"\0\0\0", b"\x1a", b"\x14\x13\r\n", b"\0\n\0\n"] {
                let around = |program: &[u8]| [leader, program, trailer].concat();
                let found = result(&around(program.as_bytes())).expect("compensated");
                assert_eq!(
                    String::from_utf8_lossy(&found),
                    String::from_utf8_lossy(&around(&expected))
                );
            }
        }
    }
}

#[test]
fn line_ends_across_buffers() {
    let machine = Machine::parse(&format!("{TRAVELS}{ERRORS}"), "m.toml").expect("a good machine");
    let corrector = Corrector::new(&machine, &Temperatures::new(), 0.0005).expect("a corrector");
    let setup = SetUp::default();
    for program in PROGRAMS {
        for end in ["\n", "\r\n", "\r\r\n", "\n\r\r", "\r"] {
            let program = with_ends(program.as_bytes(), end);
            let expected = result(&program).expect("compensated");
            for size in [1, 2, 3, 7] {
                let mut input = std::io::BufReader::with_capacity(size, &program[..]);
                let mut out = Vec::new();
                compensate(&mut input, &mut out, Job::new(&corrector, &setup), |_| Ok(()))
                    .expect("compensated");
                assert_eq!(out, expected, "{size}");
            }
        }
    }
}

/// Bytes that no such file contains are refused with their position. Lines are counted as in an editor.
#[test]
fn other_bytes_are_refused() {
    let texts = rows(
        r"
G0 X0\nG1 X1\rX2\n | line 2: column 6: found a carriage return alone as the end of the line, expected the same as before it, line feeds
G0 X0\r\nG1 X1\rX2\r\n | line 2: column 6: found a carriage return alone as the end of the line, expected the same as before it, line feeds
G0 X0\rG1 X1\rX2\nX3\r | line 3: column 3: found a line feed as the end of the line, expected the same as before it, carriage returns alone
G0 X0\r\rG1 X1 Q\r | line 3: column 7: expected a number
G0 X0\n\r\rG1 X1 Q\n\r\r | line 2: column 7: expected a number
G0 X0\no1 repeat [2]\rX2\no1 endrepeat\n | line 2: column 14: found a carriage return alone
:12 G0 X0\n | line 1: expected nothing but a comment after the number of a program
<PART> G0 X0\n | line 1: expected nothing but a comment after the name of a program
",
    );
    let texts = texts.into_iter().map(|[program, expected]| (program.as_bytes(), expected));
    let bytes: [(&[u8], &str); 3] = [
        (b"G0 X0\nG1 X1\0\n", "line 2: byte 0x00 at column 6"),
        (b"\0\0\nG1 X1 Q\n", "line 2: column 7: expected a number"),
        (b"G0 X0 \xef\xbb\xbf\n", "line 1: column 7: found"),
    ];
    for (program, expected) in texts.chain(bytes) {
        let error = result(program).expect_err("refused").to_string();
        assert!(error.starts_with(expected), "{error}, expected {expected}");
    }
    let job_of = |dialect, program: &[u8]| {
        let machine =
            Machine::parse(&format!("{TRAVELS}{ERRORS}"), "m.toml").expect("a good machine");
        let corrector =
            Corrector::new(&machine, &Temperatures::new(), 0.0005).expect("a corrector");
        let setup = SetUp::default();
        let job = Job { dialect, ..Job::new(&corrector, &setup) };
        let mut out = Vec::new();
        compensate(&mut &program[..], &mut out, job, |_| Ok(())).map(|_| out)
    };
    let error = job_of(Dialect::Heidenhain, b"0 BEGIN PGM A MM\r1 L X+0\r").expect_err("refused");
    assert_eq!(&error.to_string()[..19], "line 1: column 17: ");
}

#[test]
fn programs_have_numbers_and_names() {
    for name in [
        ":0097",
        ":97 (PART)",
        "O0001<PART-1>(REV B)",
        "O0001 <PART-1>",
        "<PART-1>",
        "O1",
        "o<part> sub\no<part> endsub",
    ] {
        let program = format!("%\n{name}\nG0 X0 Y100. Z10.\nX10.\nM30\n%\n");
        let out = result(program.as_bytes()).expect(name);
        let expected = format!("%\n{name}\nG0 X0.100 Y100. Z10.\nX10.100 Y99.996\nM30\n%\n");
        assert_eq!(String::from_utf8_lossy(&out), expected);
    }
    // A call finds its program by either letter.
    let program = "G0 X0 Y0 Z0\nM98 P97\nM30\n:0097\nG1 Y100. F100\nM99\n";
    let out = result(program.as_bytes()).expect("compensated");
    assert_eq!(String::from_utf8_lossy(&out), program.replace("Y100. F100", "Y100. F100 X0.100"));
}

#[test]
fn mean_corrections_follow_the_leader() {
    let machine = Machine::parse(&format!("{TRAVELS}[errors]\nEC0Y = 1000.0\n"), "m.toml")
        .expect("a good machine");
    let corrector = Corrector::new(&machine, &Temperatures::new(), 0.0005).expect("a corrector");
    let setup = SetUp::parse("[work_offset.G54]\nX = 0\n[start]\nX = 0\nY = 0\nZ = 0\n", "s.toml")
        .expect("a set-up");
    for (leader, end) in [("\u{feff}", "\r\n"), ("\0\0\0", "\n\r\r"), ("", "\r")] {
        let program = format!("{leader}%\n:0097\nG1 X0 Y100 Z0 F100\n").replace('\n', end);
        let mut out = Vec::new();
        average(program.as_bytes(), &mut out, Job::new(&corrector, &setup), MeanOf::Places)
            .expect("compensated");
        let expected = format!(
            "{leader}%\n:0097\nG21 G90\nG10 L2 P1 X0.100 Y0.000 Z0.000\nG1 X0 Y100 Z0 F100\n"
        )
        .replace('\n', end);
        assert_eq!(String::from_utf8_lossy(&out), expected);
    }
}
