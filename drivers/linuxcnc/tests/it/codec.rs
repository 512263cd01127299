//! Datagrams: bytes that are known, and everything there and back.

use std::{fmt::Write as _, time::Duration};

use proptest::prelude::*;
use volcomp_linuxcnc::{
    AxisState, Broken, COMMAND_BYTES, Command, Content, Flags, Key, STATE_BYTES, State,
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

fn told(state: &State) -> Vec<u8> {
    let mut bytes = [0; STATE_BYTES];
    let length = state.encode(&KEY, &mut bytes);
    bytes[..length].to_vec()
}

/// The bytes that Python's `struct` makes of the same content, and the code that an implementation of
/// SipHash in Python, which passes the published test vectors, makes of these bytes:
/// `struct.pack("<4sBBHIIHH3H", b"VCLF", 2, 0, 7, 9, 5, 1, 3, 1, 2, 65535)`.
#[test]
fn a_command_has_the_bytes_of_another_implementation() {
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
    fn commands_come_back(machine: u16, answers: [u32; 2], words in prop::option::of(prop::collection::vec(any::<u16>(), 0..=MOST_WORDS))) {
        let content = words.map_or(Content::Listen, |words| Content::Frame(Words::new(&words).unwrap()));
        let command = Command { machine, answers, content };
        prop_assert_eq!(Command::decode(&encoded(&command), &KEY), Ok(command));
    }

    #[test]
    fn states_come_back(
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
        prop_assert_eq!(State::decode(&told(&state), &KEY), Ok(state));
    }

    /// One datagram in 2^64 has the right code by chance.
    #[test]
    fn no_byte_can_be_changed_and_none_can_be_missing(at in any::<prop::sample::Index>(), by in 1_u8..) {
        let axis = AxisState { name: AxisName::X, step: 1, position: 1.5, velocity: 0.0, offset: -3 };
        let mut state = State::of(&[axis]).unwrap();
        state.report = Words::new(&[1, 2, 3]).unwrap();
        let command = Command { machine: 1, answers: [4, 2], content: Content::Frame(Words::new(&[9; 8]).unwrap()) };
        for whole in [told(&state), encoded(&command)] {
            let mut bytes = whole.clone();
            let place = at.index(bytes.len());
            bytes[place] ^= by;
            prop_assert!(State::decode(&bytes, &KEY).is_err() && Command::decode(&bytes, &KEY).is_err());
            prop_assert!(State::decode(&whole[..place], &KEY).is_err() && Command::decode(&whole[..place], &KEY).is_err());
        }
    }

    #[test]
    fn any_bytes_are_answered(bytes in prop::collection::vec(any::<u8>(), 0..500)) {
        let _ = (State::decode(&bytes, &KEY), Command::decode(&bytes, &KEY));
    }
}

#[test]
fn what_is_wrong_is_said() {
    let axis = AxisState {
        name: AxisName::X,
        step: 1,
        position: 0.0,
        velocity: 0.0,
        offset: 0,
    };
    let state = |axes: &[AxisState]| State::decode(&told(&State::of(axes).unwrap()), &KEY);
    let nan = AxisState {
        position: f64::NAN,
        ..axis
    };
    let nothing = AxisState { step: 0, ..axis };
    let number = Broken::Number { axis: AxisName::X };
    assert_eq!(state(&[nan]), Err(number));
    assert_eq!(state(&[nothing]), Err(number));
    let twice = Broken::Letter { found: b'X' };
    assert_eq!(state(&[axis, axis]), Err(twice));
    assert!(twice.to_string().contains("'X'"), "{twice}");
    assert_eq!(State::of(&[axis; 10]), None);
    let mut bytes = told(&State::of(&[axis]).unwrap());
    assert_eq!(Command::decode(&bytes, &KEY), Err(Broken::Magic));
    bytes[4] = 3;
    assert_eq!(
        State::decode(&bytes, &KEY),
        Err(Broken::Version { found: 3 })
    );
    bytes[4] = 2;
    bytes[40] ^= 1;
    assert_eq!(State::decode(&bytes, &KEY), Err(Broken::Mac));
}
