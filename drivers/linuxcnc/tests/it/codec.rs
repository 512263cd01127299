//! Tests of datagrams: known bytes, round trips, the fuzz corpus, and the tables of flags and causes in README.md.

use std::{fmt::Write as _, path::Path, time::Duration};

use proptest::prelude::*;
use volcomp_guard::protocol::Refusal;
use volcomp_linuxcnc::{
    AxisState, COMMAND_BYTES, Command, Content, DatagramError, Flags, Key, STATE_BYTES, State,
};
use volcomp_port::{MOST_WORDS, Words};
use volcomp_vocabulary::AxisName;

const KEY: Key = Key::new([7; 16]);

const LETTERS: [AxisName; 9] = [
    AxisName::X,
    AxisName::Y,
    AxisName::Z,
    AxisName::A,
    AxisName::B,
    AxisName::C,
    AxisName::U,
    AxisName::V,
    AxisName::W,
];

fn encoded(command: &Command) -> Vec<u8> {
    let mut bytes = [0; COMMAND_BYTES];
    let length = command.encode(&KEY, &mut bytes);
    bytes[..length].to_vec()
}

fn encoded_state(state: &State) -> Vec<u8> {
    let mut bytes = [0; STATE_BYTES];
    let length = state.encode(&KEY, &mut bytes);
    bytes[..length].to_vec()
}

/// An encoded command equals the bytes that Python's `struct.pack("<4sBBHIIHH3H", b"VCLF", 2, 0, 7, 9, 5, 1, 3, 1, 2,
/// 65535)` gives for the same content, followed by the authentication code of a Python SipHash that was checked with
/// the published test vectors.
#[test]
fn a_command_has_the_bytes_of_an_independent_implementation() {
    let command = Command {
        machine: 7,
        answers: [9, 5],
        content: Content::Frame(Words::new(&[1, 2, 65535]).unwrap()),
    };
    let expected = "56434c460200070009000000050000000100030001000200ffffd52018d947b83c75";
    let mut hex = String::new();
    for byte in encoded(&command) {
        write!(hex, "{byte:02x}").unwrap();
    }
    assert_eq!(hex, expected);
}

proptest! {
    #[test]
    fn commands_round_trip(machine: u16, answers: [u32; 2], words in prop::option::of(prop::collection::vec(any::<u16>(), 0..=MOST_WORDS))) {
        let content = words.map_or(Content::Listen, |words| Content::Frame(Words::new(&words).unwrap()));
        let command = Command { machine, answers, content };
        prop_assert_eq!(Command::decode(&encoded(&command), &KEY), Ok(command));
    }

    #[test]
    fn states_round_trip(
        machine: u16, run: u32, sequence: u32, flags: u16, nanos: u64, scan: u32,
        axes in prop::collection::vec((1_u32.., -1e6..1e6, -1e4..1e4, any::<i64>()), 0..=9),
        words in prop::collection::vec(any::<u16>(), 0..=MOST_WORDS),
    ) {
        let axes: Vec<AxisState> = axes.iter().zip(LETTERS).map(|(&(step, position, velocity, offset), name)| {
            AxisState { name, step, position, velocity, offset }
        }).collect();
        let mut state = State::of(&axes).unwrap();
        (state.machine, state.run, state.sequence) = (machine, run, sequence);
        state.flags = Flags(flags);
        state.time = Duration::from_nanos(nanos);
        state.scan = Duration::from_nanos(scan.into());
        state.report = Words::new(&words).unwrap();
        prop_assert_eq!(State::decode(&encoded_state(&state), &KEY), Ok(state));
    }

    /// Changed or truncated datagrams are rejected. A wrong authentication code is accepted with probability 2^-64.
    #[test]
    fn changed_or_missing_bytes_are_rejected(at in any::<prop::sample::Index>(), by in 1_u8..) {
        let axis = AxisState { name: AxisName::X, step: 1, position: 1.5, velocity: 0.0, offset: -3 };
        let mut state = State::of(&[axis]).unwrap();
        state.report = Words::new(&[1, 2, 3]).unwrap();
        let command = Command { machine: 1, answers: [4, 2], content: Content::Frame(Words::new(&[9; 8]).unwrap()) };
        for whole in [encoded_state(&state), encoded(&command)] {
            let mut bytes = whole.clone();
            let place = at.index(bytes.len());
            bytes[place] ^= by;
            prop_assert!(State::decode(&bytes, &KEY).is_err() && Command::decode(&bytes, &KEY).is_err());
            prop_assert!(State::decode(&whole[..place], &KEY).is_err() && Command::decode(&whole[..place], &KEY).is_err());
        }
    }

    #[test]
    fn arbitrary_bytes_do_not_panic(bytes in prop::collection::vec(any::<u8>(), 0..500)) {
        let _ = (State::decode(&bytes, &KEY), Command::decode(&bytes, &KEY));
    }
}

#[test]
fn invalid_contents_are_named() {
    let axis = AxisState { name: AxisName::X, step: 1, position: 0.0, velocity: 0.0, offset: 0 };
    let state = |axes: &[AxisState]| State::decode(&encoded_state(&State::of(axes).unwrap()), &KEY);
    let nan = AxisState { position: f64::NAN, ..axis };
    let nothing = AxisState { step: 0, ..axis };
    let number = DatagramError::Number { axis: AxisName::X };
    assert_eq!(state(&[nan]), Err(number));
    assert_eq!(state(&[nothing]), Err(number));
    let twice = DatagramError::Letter { found: b'X' };
    assert_eq!(state(&[axis, axis]), Err(twice));
    assert!(twice.to_string().contains("'X'"), "{twice}");
    assert_eq!(State::of(&[axis; 10]), None);
    let mut bytes = encoded_state(&State::of(&[axis]).unwrap());
    assert_eq!(Command::decode(&bytes, &KEY), Err(DatagramError::Magic));
    bytes[4] = 3;
    assert_eq!(State::decode(&bytes, &KEY), Err(DatagramError::Version { found: 3 }));
    bytes[4] = 2;
    bytes[40] ^= 1;
    assert_eq!(State::decode(&bytes, &KEY), Err(DatagramError::Mac));
}

/// Replays the fuzz corpus of datagrams without authentication code: `valid-…` files must be decoded, `broken-…` files
/// rejected.
#[test]
fn corpus_datagrams_are_decoded_or_rejected() {
    let folder = volcomp_test_support::root().join("tests/fuzz/corpus/linuxcnc");
    let mut valid = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let entry = entry.unwrap();
        let name = entry.file_name().to_string_lossy().into_owned();
        let body = std::fs::read(entry.path()).unwrap();
        let bytes = [&body[..], &KEY.mac(&body)].concat();
        let again = match (State::decode(&bytes, &KEY), Command::decode(&bytes, &KEY)) {
            (Ok(state), _) => {
                let mut again = [0; STATE_BYTES];
                let length = state.encode(&KEY, &mut again);
                Some(again[..length].to_vec())
            }
            (_, Ok(command)) => {
                let mut again = [0; COMMAND_BYTES];
                let length = command.encode(&KEY, &mut again);
                Some(again[..length].to_vec())
            }
            _ => None,
        };
        assert!(again.is_some() || !name.starts_with("valid-"), "{name}");
        assert!(again.is_none() || !name.starts_with("broken-"), "{name}");
        if let Some(again) = again {
            assert_eq!(again, bytes, "{name}");
            valid += 1;
        }
    }
    assert_eq!(valid, 3);
}

/// Rows of the table in README.md whose first column has the heading `first`; backticks in cells are removed.
fn table(first: &str) -> Vec<Vec<String>> {
    let text = std::fs::read_to_string(crate_file("README.md")).unwrap();
    let rows = text
        .lines()
        .skip_while(|line| !line.starts_with(&format!("| {first} |")))
        .skip(2)
        .take_while(|line| line.starts_with('|'));
    let cells = |line: &str| {
        let inner = line.trim_matches('|').split('|');
        inner.map(|cell| cell.replace('`', "").trim().to_owned()).collect()
    };
    rows.map(cells).collect()
}

fn crate_file(file: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(file)
}

fn names(rows: &[Vec<String>]) -> Vec<(u16, String)> {
    rows.iter().map(|row| (row[0].parse().unwrap(), row[1].clone())).collect()
}

/// Constants of the C enumeration that begins with `prefix` + `first`: number, and name without `prefix`.
fn component_constants(first: &str, prefix: &str) -> Vec<(u16, String)> {
    let text = std::fs::read_to_string(crate_file("bridge/volcomp.comp")).unwrap();
    let (_, rest) = text.split_once(&format!("enum {{ {prefix}{first}")).unwrap();
    let (rest, _) = rest.split_once("};").unwrap();
    let mut next = 0;
    let mut found = Vec::new();
    for constant in format!("{prefix}{first}{rest}").split(',') {
        let (name, value) = match constant.split_once('=') {
            Some((name, value)) => (name, value.trim().parse().unwrap()),
            None => (constant, next),
        };
        next = value + 1;
        let name = name.trim().strip_prefix(prefix).unwrap();
        found.push((value, name.to_owned()));
    }
    found
}

#[test]
fn flags_match_readme_and_component() {
    let rows = table("flag");
    let own = Flags::ALL
        .map(|flag| [&flag.bit.to_string(), flag.name, flag.set, flag.unset].map(str::to_owned));
    assert_eq!(rows, own);
    assert_eq!(component_constants("EMERGENCY_STOP", ""), names(&rows));
    assert_eq!(
        Flags(Flags::ENABLED | Flags::LOST).to_string(),
        format!("on, not homed, {}", rows[5][2])
    );
}

#[test]
fn refusals_match_readme_and_component() {
    let rows = table("refusal");
    let own = [
        Refusal::None,
        Refusal::Checksum,
        Refusal::Epoch,
        Refusal::Tick,
        Refusal::Owner,
        Refusal::Sequence,
        Refusal::Value,
    ];
    let own = own.map(|why| {
        let name = format!("{why:?}").to_uppercase();
        [(why as u16).to_string(), name, why.to_string()]
    });
    assert_eq!(rows, own);
    assert_eq!(component_constants("NONE", "REFUSED_"), names(&rows));
}
