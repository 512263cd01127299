//! S7 and NCK: published bytes, every message there and back, a client with a simulated control that lies.

use std::{net::TcpListener, path::Path, time::Duration};

use proptest::prelude::*;
use volcomp_sinumerik::s7::{
    Area, Client, Cotp, Item, LONGEST_BLOCK, MOST_ITEMS, Memory, Message, NckVariable, ReturnCode,
    S7Error, Simulator, Target, Write, connect_frame, frame_of, parse_frame,
};

/// Long enough for a loaded machine.
const PATIENCE: Duration = Duration::from_secs(20);
const R1: NckVariable = NckVariable {
    area: Area::Channel,
    unit: 1,
    column: 1,
    line: 1,
    module: 0x15,
    lines: 1,
};

#[test]
fn items_are_those_of_published_captures() {
    let frame = frame_of(&Message::Read {
        reference: 0x0203,
        items: vec![Item::Nck(R1)],
    });
    // The R parameter of DotNetSiemensPLCToolBoxLibrary's capture, in a frame by RFC 1006 and ISO 8073.
    let expected = [
        3, 0, 0, 29, 2, 0xf0, 0x80, 0x32, 1, 0, 0, 2, 3, 0, 12, 0, 0, 4, 1, 0x12, 8, 0x82, 0x41, 0,
        1, 0, 1, 0x15, 1,
    ];
    assert_eq!(frame, expected);
    assert_eq!(NckVariable::r_parameter(1, 1), R1);

    // DB5, 4 bytes from byte 2 on: Wireshark's dissector calls it DB 5.DBX 2.0 BYTE 4.
    let frame = frame_of(&Message::Read {
        reference: 1,
        items: vec![Item::Block {
            number: 5,
            first: 2,
            count: 4,
        }],
    });
    assert_eq!(frame[19..], [0x12, 10, 0x10, 2, 0, 4, 0, 5, 0x84, 0, 0, 16]);

    // The connection of a programming device to rack 0, slot 4.
    let frame = connect_frame(0x0104);
    assert_eq!(frame[..7], [3, 0, 0, 22, 17, 0xe0, 0]);
    assert_eq!(parse_frame(&frame).unwrap(), Cotp::Connect { to: 0x0104 });
}

fn item() -> impl Strategy<Value = Item> {
    let block = (
        any::<u16>(),
        any::<u16>().prop_map(|at| at & 0x7fff),
        1..=LONGEST_BLOCK,
    )
        .prop_map(|(number, first, count)| Item::Block {
            number,
            first,
            count,
        });
    let areas = [
        Area::Nck,
        Area::ModeGroup,
        Area::Channel,
        Area::Axis,
        Area::Tool,
        Area::FeedDrive,
        Area::MainDrive,
        Area::Panel,
    ];
    let nck = (
        prop::sample::select(areas.to_vec()),
        0_u8..32,
        any::<u16>(),
        any::<u16>(),
        any::<u8>(),
        1_u8..,
    )
        .prop_map(|(area, unit, column, line, module, lines)| {
            Item::Nck(NckVariable {
                area,
                unit,
                column,
                line,
                module,
                lines,
            })
        });
    prop_oneof![block, nck]
}

fn message() -> impl Strategy<Value = Message> {
    let bytes = || prop::collection::vec(any::<u8>(), 0..40);
    let items = || prop::collection::vec(item(), 0..=MOST_ITEMS);
    let bad = any::<u8>()
        .prop_filter("a bad code", |code| *code != 0xff)
        .prop_map(ReturnCode);
    let value = prop_oneof![bytes().prop_map(Ok), bad.prop_map(Err)];
    prop_oneof![
        (any::<u16>(), any::<u16>(), any::<bool>()).prop_map(|(reference, longest, is_answer)| {
            Message::Setup {
                reference,
                longest,
                is_answer,
            }
        }),
        (any::<u16>(), items()).prop_map(|(reference, items)| Message::Read { reference, items }),
        (
            any::<u16>(),
            prop::collection::vec((item(), bytes()), 0..=MOST_ITEMS)
        )
            .prop_map(|(reference, writes)| {
                let writes = writes
                    .into_iter()
                    .map(|(item, bytes)| Write { item, bytes });
                Message::Write {
                    reference,
                    writes: writes.collect(),
                }
            }),
        (
            any::<u16>(),
            prop::collection::vec((value, any::<bool>()), 0..=MOST_ITEMS)
        )
            .prop_map(|(reference, values)| {
                let of_nck = values
                    .iter()
                    .map(|(value, of_nck)| *of_nck && value.is_ok())
                    .collect();
                let values = values.into_iter().map(|(value, _)| value).collect();
                Message::Values {
                    reference,
                    values,
                    of_nck,
                }
            }),
        (
            any::<u16>(),
            prop::collection::vec(any::<u8>().prop_map(ReturnCode), 0..=MOST_ITEMS)
        )
            .prop_map(|(reference, codes)| Message::Written { reference, codes }),
        (any::<u16>(), 1_u8.., any::<u8>()).prop_map(|(reference, class, code)| Message::Refused {
            reference,
            class,
            code
        }),
    ]
}

proptest! {
    #[test]
    fn messages_come_back(message in message()) {
        let frame = frame_of(&message);
        let Cotp::Data(data) = parse_frame(&frame).unwrap() else { panic!("no data") };
        prop_assert_eq!(Message::parse(data).unwrap(), message);
    }

    #[test]
    fn no_bytes_are_too_wrong(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let _ = parse_frame(&bytes);
        let _ = Message::parse(&bytes);
    }

    #[test]
    fn a_message_with_other_bytes_is_another_or_none(message in message(), at in any::<prop::sample::Index>(), flip in 1_u8..) {
        let mut frame = frame_of(&message);
        let at = at.index(frame.len());
        frame[at] ^= flip;
        if let Ok(Cotp::Data(data)) = parse_frame(&frame) {
            let _ = Message::parse(data);
        }
        frame.truncate(at);
        prop_assert!(parse_frame(&frame).is_err());
    }
}

fn control() -> Simulator {
    let mut memory = Memory::default();
    memory.blocks.insert(5, (0..100).collect());
    memory.set_nck(&R1, 17.25);
    Simulator::start("127.0.0.1:0", memory).unwrap()
}

#[test]
fn blocks_and_variables_are_read_and_written() {
    let control = control();
    control.memory().fragment = 3;
    let mut client = Client::connect(control.address(), Target::NCK, PATIENCE).unwrap();
    let block = Item::Block {
        number: 5,
        first: 7,
        count: 3,
    };
    let values = client.read(&[block, Item::Nck(R1)]).unwrap();
    assert_eq!(values[0], [7, 8, 9]);
    assert_eq!(values[1], 17.25_f64.to_le_bytes());
    let write = |item, bytes: &[u8]| Write {
        item,
        bytes: bytes.to_vec(),
    };
    client
        .write(&[
            write(block, &[1, 2, 3]),
            write(Item::Nck(R1), &(-0.5_f64).to_le_bytes()),
        ])
        .unwrap();
    assert_eq!(control.memory().blocks[&5][6..11], [6, 1, 2, 3, 10]);
    assert_eq!(
        client.read(&[Item::Nck(R1)]).unwrap()[0],
        (-0.5_f64).to_le_bytes()
    );
}

#[test]
fn refusals_name_their_item_and_the_connection_goes_on() {
    let control = control();
    let mut client = Client::connect(control.address(), Target::PLC, PATIENCE).unwrap();
    let good = Item::Block {
        number: 5,
        first: 0,
        count: 1,
    };
    let beyond = Item::Block {
        number: 5,
        first: 99,
        count: 2,
    };
    let error = client.read(&[good, beyond]).unwrap_err();
    assert!(
        matches!(
            error,
            S7Error::Item {
                place: 1,
                code: ReturnCode::ADDRESS
            }
        ),
        "{error}"
    );
    assert_eq!(
        error.to_string(),
        "item 1: there is no such address (return code 0x05)"
    );
    let error = client.write(&[Write {
        item: Item::Block {
            number: 6,
            first: 0,
            count: 1,
        },
        bytes: vec![0],
    }]);
    assert!(matches!(
        error,
        Err(S7Error::Item {
            place: 0,
            code: ReturnCode::NO_OBJECT
        })
    ));
    control.memory().refuses = true;
    assert!(matches!(
        client.read(&[good]),
        Err(S7Error::Refused { class: 0x85, .. })
    ));
    control.memory().refuses = false;
    assert_eq!(client.read(&[good]).unwrap(), [[0]]);
    // What no message can carry is not sent.
    assert!(matches!(client.read(&[]), Err(S7Error::Request { .. })));
    let long = Item::Block {
        number: 5,
        first: 0,
        count: 201,
    };
    let error = client.read(&[long]).unwrap_err();
    assert_eq!(
        error.to_string(),
        "found 201 bytes of a data block, expected 1 to 200 in one item"
    );
    assert!(
        client
            .read(
                &[Item::Block {
                    number: 5,
                    first: 0,
                    count: 200
                }; 4]
            )
            .unwrap_err()
            .is_refusal()
    );
    assert_eq!(client.read(&[good]).unwrap(), [[0]]);
}

#[test]
fn what_is_not_the_answer_ends_the_connection() {
    let control = control();
    let good = Item::Block {
        number: 5,
        first: 0,
        count: 1,
    };
    let mut client = Client::connect(control.address(), Target::PLC, PATIENCE).unwrap();
    control.memory().wrong_reference = true;
    assert!(matches!(
        client.read(&[good]),
        Err(S7Error::Frame("the answer to another request"))
    ));
    assert!(matches!(client.read(&[good]), Err(S7Error::Closed)));
    control.memory().wrong_reference = false;

    let mut client =
        Client::connect(control.address(), Target::PLC, Duration::from_millis(300)).unwrap();
    control.memory().latency = PATIENCE;
    assert!(matches!(client.read(&[good]), Err(S7Error::TimedOut(_))));
    assert!(matches!(client.read(&[good]), Err(S7Error::Closed)));
}

#[test]
fn a_server_of_another_protocol_is_no_control() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let other = std::thread::spawn(move || {
        use std::io::Write as _;
        let (mut stream, _) = listener.accept().unwrap();
        // It may have gone away already.
        let _ = stream.write_all(b"HTTP/1.1 400 Bad Request\r\n\r\n");
        stream
    });
    let error = Client::connect(address, Target::PLC, PATIENCE).unwrap_err();
    assert!(
        matches!(error, S7Error::Frame("no TPKT of version 3")),
        "{error}"
    );
    other.join().unwrap();
}

#[test]
fn kept_inputs_of_the_fuzz_target() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fuzz/corpus/s7");
    let mut seen = 0;
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let bytes = std::fs::read(&path).unwrap();
        let frame = parse_frame(&bytes);
        if name.starts_with("valid-message-") {
            let Ok(Cotp::Data(data)) = frame else {
                panic!("{name}: no data")
            };
            let message = Message::parse(data).unwrap();
            assert_eq!(frame_of(&message), bytes, "{name}");
        } else if name.starts_with("valid-connect-") {
            assert!(matches!(frame, Ok(Cotp::Connect { .. })), "{name}");
        } else {
            assert!(
                !matches!(frame, Ok(Cotp::Data(data)) if Message::parse(data).is_ok()),
                "{name}"
            );
        }
        seen += 1;
    }
    assert!(seen >= 6);
}
