//! A machine without errors changes no byte, whatever the program.

use volcomp_model::{Machine, Temperatures, vocabulary::CorrectionLimit};
use volcomp_nc::{
    Corrector, Dialect, Job, NcError, SetUp, Strategy, Summary, Verification, Virtual, compensate,
    verify,
};
use volcomp_test_support::{corpus, rows};

pub(crate) const TRAVELS: &str = "name = \"m\"\nstructure = \"w X' b Y Z t\"\n[axes.X]\ntravel = [-1000, 1000]\n[axes.Y]\ntravel = [-1000, 1000]\n[axes.Z]\ntravel = [-1000, 1000]\n";

#[track_caller]
pub(crate) fn begins(text: &str, expected: &str) {
    assert!(text.starts_with(expected), "{text}");
}

#[track_caller]
pub(crate) fn has(text: &str, expected: &str) {
    assert!(text.contains(expected), "{text}");
}

/// Compensates a program on a machine with these errors; tolerance of splitting 0.5 µm.
pub(crate) fn compensated(errors: &str, program: &[u8]) -> Result<(Vec<u8>, Summary), NcError> {
    compensated_in(&SetUp::default(), errors, program)
}

pub(crate) fn compensated_in(
    setup: &SetUp,
    errors: &str,
    program: &[u8],
) -> Result<(Vec<u8>, Summary), NcError> {
    let machine = Machine::parse(&format!("{TRAVELS}{errors}"), "m.toml").expect("a good machine");
    result_of((&machine, 0.0005), setup, program, |job| Job {
        most_blocks: 1_000_000,
        limit: CorrectionLimit::LARGEST,
        ..job
    })
}

/// Compensates a program with the text of a set-up file, on a machine with these errors; tolerance of splitting 0.5 µm.
pub(crate) fn text_in(
    setup: &str,
    errors: &str,
    program: &str,
) -> Result<(String, Summary), NcError> {
    let setup = SetUp::parse(setup, "setup.toml").expect("a good set-up");
    let (out, summary) = compensated_in(&setup, errors, program.as_bytes())?;
    Ok((String::from_utf8(out).expect("text"), summary))
}

/// The notes, each with its line.
pub(crate) fn notes_of(summary: &Summary) -> Vec<String> {
    let notes = summary.notes.by_line().into_iter();
    notes.map(|(line, note)| format!("{line}: {note}")).collect()
}

/// The set-up line that names a control; empty for an empty name.
pub(crate) fn of_control(name: &str) -> String {
    match name {
        "" => String::new(),
        name => format!("control = \"{name}\"\n"),
    }
}

/// Compensates a program with this tolerance of splitting, mm; `wanted` changes the default job.
pub(crate) fn result_of(
    (machine, tolerance_mm): (&Machine, f64),
    setup: &SetUp,
    program: &[u8],
    wanted: impl FnOnce(Job<'_>) -> Job<'_>,
) -> Result<(Vec<u8>, Summary), NcError> {
    let corrector = Corrector::new(machine, &Temperatures::new(), tolerance_mm)?;
    let mut out = Vec::new();
    let job = wanted(Job::new(&corrector, setup));
    let summary = compensate(&mut &program[..], &mut out, job, |_| Ok(()))?;
    Ok((out, summary))
}

/// Deviations of the tool with a program and with its result on a machine with these errors.
pub(crate) fn verified_by(
    truth: &Machine,
    setup: &SetUp,
    dialect: Dialect,
    [program, result]: [&str; 2],
    shares: &[f64],
) -> Result<Verification, NcError> {
    let of = Virtual {
        truth,
        temperatures: &Temperatures::new(),
        setup,
        most_blocks: 100_000,
        dialect,
        part: None,
        resolution: None,
    };
    verify(&mut program.as_bytes(), &mut result.as_bytes(), shares, of)
}

/// The result of a program in a language, and its notes with their lines; tolerance of splitting 1 µm.
pub(crate) fn written(
    dialect: Dialect,
    machine: &Machine,
    setup: &str,
    program: &str,
) -> Result<(String, Vec<String>), NcError> {
    let setup = SetUp::parse(setup, "setup.toml").expect("a good set-up");
    let program = program.as_bytes();
    let (out, summary) =
        result_of((machine, 0.001), &setup, program, |job| Job { dialect, ..job })?;
    Ok((String::from_utf8(out).expect("text"), notes_of(&summary)))
}

/// As [`written`], on a machine with these errors.
pub(crate) fn written_with(
    dialect: Dialect,
    errors: &str,
    setup: &str,
    program: &str,
) -> Result<(String, Vec<String>), NcError> {
    let machine = Machine::parse(&format!("{TRAVELS}{errors}"), "m.toml").expect("a good machine");
    written(dialect, &machine, setup, program)
}

/// The result of a program, and its verification on the same machine; tolerance of splitting 1 µm.
pub(crate) fn verified_in(
    dialect: Dialect,
    [machine, setup, program]: [&str; 3],
    strategy: Strategy,
) -> Result<(String, Summary, Verification), NcError> {
    let machine = Machine::parse(machine, "m.toml").expect("a good machine");
    let setup = SetUp::parse(setup, "setup.toml").expect("a good set-up");
    let bytes = program.as_bytes();
    let (out, summary) = result_of((&machine, 0.001), &setup, bytes, |job| Job {
        dialect,
        strategy,
        keep_shares: true,
        limit: CorrectionLimit::LARGEST,
        ..job
    })?;
    let out = String::from_utf8(out).expect("text");
    let found = verified_by(&machine, &setup, dialect, [program, &out], &summary.shares)?;
    Ok((out, summary, found))
}

#[test]
fn unusual_programs_are_copied_byte_for_byte() {
    let programs: [&[u8]; 12] = [
        b"",
        b"\n\n",
        b"%\r\nO1234 (part)\r\nN10 G21 G90\r\nN20 g1 x 1 0 . 5 Y-2.F100 ; go\r\n%\r\nwhat ever\r\n",
        b"G0 X1 (caf\xe9) Y2\nM2\nthis is not read any more ]]]",
        b"G0 X0\n/N5 G1 X#1 F[100*2] Y[#<_x>+1]\n#1=5 #<name>=3\nG1 X[ABS[-#1] ** 2] Y#<name>\n",
        b"G2 X10 Y0 I5 J0 F100\nG3 X0 R5\nG2 I5\nG2 I5 P3 Z-1\n",
        b"G81 X1 Y1 Z-5 R1 F100\nX2\nX3 L2\nG91 X1 L4\nG80\n",
        b"G20 G91 G1 X.1 F10\nX+.1\nX-0.10\nG92 X0\nG92.1\n",
        b"G43 H1 Z10\nG54.1\n",
        b"G10 L2 P1 X10 R30\nG1 F1 X5\nG68 R45 X1 Y1\nX6\nG69\n",
        b"G28 Z0\nG53 G0 Z0\nG33 Z-5 K1\nG38.2 X5 F10\nG1 X1",
        b"\tG1\tX1\t\n   \nM3 S1000\nT1 M6\nG93 G1 X2 F2\nG95 X3 F.1\n",
    ];
    for (place, program) in programs.iter().enumerate() {
        match compensated("", program) {
            Ok((out, summary)) => {
                assert_eq!(
                    String::from_utf8_lossy(&out),
                    String::from_utf8_lossy(program),
                    "{place}"
                );
                assert_eq!((summary.counts.changed, summary.counts.added), (0, 0));
            }
            Err(error) => assert_eq!(place, 8, "{error}"),
        }
    }
}

/// A writer that counts its writes.
#[derive(Default)]
struct Counted {
    bytes: Vec<u8>,
    writes: usize,
}

impl std::io::Write for Counted {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.writes += 1;
        self.bytes.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// A long program is written in fewer than 20 pieces, completely up to a refused line.
#[test]
fn long_programs_are_streamed() {
    let machine = Machine::parse(TRAVELS, "m.toml").expect("a good machine");
    let corrector = Corrector::new(&machine, &Temperatures::new(), 0.0005).expect("compiles");
    let setup = SetUp::default();
    let lines = (0..20_000).map(|i| format!("G1 X{}.{:03} Y5 (a line)\n", i % 500, i % 1000));
    let good: String = lines.collect();
    for (last, is_good) in [("M30\nbehind the end", true), ("G1 X1\nG1 X\nG1 X2\n", false)] {
        let program = format!("{good}{last}");
        let mut out = Counted::default();
        let job = Job::new(&corrector, &setup);
        let found = compensate(&mut program.as_bytes(), &mut out, job, |_| Ok(()));
        assert_eq!(found.is_ok(), is_good, "{found:?}");
        let expected = program.strip_suffix("G1 X\nG1 X2\n").unwrap_or(&program);
        assert!(out.bytes == expected.as_bytes(), "{last}");
        assert!(out.writes < 20, "{}", out.writes);
    }
}

#[test]
fn unreadable_lines_are_refused_with_position_and_reason() {
    let texts = rows(
        r"
G1 X1\nG1 X Y2\n | line 2: column 4: expected a number, a parameter or an expression after 'X'
G1 (open\n | line 1: column 4: the comment that begins here does not end in its line
G1 X[1/0]\n | line 1: column 7: this calculation has no result (a division by zero, or a function outside its range)
G1 X#5061\n | line 1: the value of X is only known at the machine, so that its motion cannot be compensated
G1 X#<nothing>\n | line 1: the parameter #<nothing> has no value here
G1 X1 X2\n | line 1: found X and X in one block, expected only one of them
G0 G1 X1\n | line 1: found G1 and G0 in one block, expected only one of them
G223 X1\n | line 1: G223 is unknown: it may move an axis, so the program cannot be compensated
X1\n | line 1: axis words without a motion code
G2 X1 Y1\n | line 1: an arc without a centre and without a radius R
",
    );
    let texts = texts.into_iter().map(|[program, expected]| (program.as_bytes(), expected));
    let bytes: [(&[u8], &str); 2] = [
        (b"\x7fELF\x00", "line 1: byte 0x00 at column 5; this is no NC program"),
        (
            b"G1 X\xff\n",
            "line 1: column 4: expected a number, a parameter or an expression after 'X'",
        ),
    ];
    for (program, expected) in texts.chain(bytes) {
        let error = compensated("", program).expect_err("refused");
        assert_eq!(error.to_string(), expected);
    }
    let long = vec![b'('; (1 << 20) + 2];
    let error = compensated("", &long).expect_err("refused");
    assert!(error.to_string().contains("longer than"), "{error}");
}

/// A machine without errors copies all accepted seeds and findings of the fuzz targets unchanged.
#[test]
fn fuzz_inputs_are_copied_byte_for_byte() {
    let machine = Machine::parse(TRAVELS, "m.toml").expect("a good machine");
    let (mut taken, mut taken_in_others) = (0, 0);
    for (name, program) in corpus::files("nc") {
        for dialect in [Dialect::Siemens, Dialect::Heidenhain] {
            let taken = crate::random_programs::copy_unchanged(&machine, dialect, &program);
            taken_in_others += usize::from(taken.is_ok());
        }
        if let Ok((out, _)) = compensated("", &program) {
            taken += 1;
            assert_eq!(String::from_utf8_lossy(&out), String::from_utf8_lossy(&program), "{name}");
        }
    }
    assert!(taken >= 2, "only {taken} were taken");
    assert!(taken_in_others >= 2, "only {taken_in_others} were taken");
}
