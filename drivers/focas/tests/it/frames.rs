//! Compares frames with bytes from public captures and the protocol description.

use proptest::prelude::*;
use volcomp_focas::frame::{
    Blocks, Command, FrameError, HEAD, Head, Kind, Request, Target, close_frame, frame, number,
    number_bytes, open_frame, parse_commands, push_block,
};
use volcomp_test_support::corpus;

fn hex(text: &str) -> Vec<u8> {
    let digits: String = text.split_whitespace().collect();
    let byte = |i: usize| u8::from_str_radix(&digits[i..i + 2], 16).unwrap();
    (0..digits.len()).step_by(2).map(byte).collect()
}

fn command(target: Target, function: u16, args: [i32; 5], data: &[u8]) -> Command<'_> {
    Command { target, path: 1, function, args, data }
}

#[test]
fn requests_match_captures() {
    use Target::{Cnc, Pmc};
    let eight = 1.5_f64.to_be_bytes();
    let words = hex("fff4 0005 0007");
    let offset = hex("fffffff4 0000 ffff");
    let table: [(&[Command<'_>], &str); 8] = [
        (
            &[command(Cnc, 0x18, [0; 5], &[])],
            "a0a0a0a0 0001 2101 001e 0001 001c 0001 0001 0018 00000000 00000000 00000000 00000000 00000000",
        ),
        (
            &[command(Cnc, 0x26, [1, -1, 0, 0, 0], &[]), command(Cnc, 0x26, [4, -1, 0, 0, 0], &[])],
            "a0a0a0a0 0001 2101 003a 0002
             001c 0001 0001 0026 00000001 ffffffff 00000000 00000000 00000000
             001c 0001 0001 0026 00000004 ffffffff 00000000 00000000 00000000",
        ),
        (
            &[command(Pmc, 0x8002, [100, 105, 5, 1, 6], &words)],
            "a0a0a0a0 0001 2101 0024 0001 0022 0002 0001 8002 00000064 00000069 00000005 00000001 00000006 fff4 0005 0007",
        ),
        (
            &[command(Pmc, 0x8001, [100, 105, 5, 1, 0], &[])],
            "a0a0a0a0 0001 2101 001e 0001 001c 0002 0001 8001 00000064 00000069 00000005 00000001 00000000",
        ),
        (
            &[command(Cnc, 0x0b, [0, 0, -1, 0, 0], &[])],
            "a0a0a0a0 0001 2101 001e 0001 001c 0001 0001 000b 00000000 00000000 ffffffff 00000000 00000000",
        ),
        (
            &[command(Cnc, 0x0c, [0, 0, 1, 0, 8], &offset)],
            "a0a0a0a0 0001 2101 0026 0001 0024 0001 0001 000c 00000000 00000000 00000001 00000000 00000008 fffffff4 0000 ffff",
        ),
        (
            &[command(Cnc, 0xa8, [500, 0, 0, 0, 8], &eight)],
            "a0a0a0a0 0001 2101 0026 0001 0024 0001 0001 00a8 000001f4 00000000 00000000 00000000 00000008 3ff8000000000000",
        ),
        (
            &[command(Cnc, 0x8d, [0x500, 0x500, 0, 0, 0], &[])],
            "a0a0a0a0 0001 2101 001e 0001 001c 0001 0001 008d 00000500 00000500 00000000 00000000 00000000",
        ),
    ];
    for (commands, expected) in table {
        let request = Request::new(commands).unwrap();
        assert_eq!(request.bytes(), hex(expected), "{expected}");
        assert_eq!(parse_commands(&request.bytes()[HEAD..]).unwrap(), commands);
    }
    assert_eq!(open_frame()[..], hex("a0a0a0a0 0001 0101 0002 0002")[..]);
    assert_eq!(close_frame()[..], hex("a0a0a0a0 0001 0201 0000")[..]);
}

#[test]
fn captured_responses_are_decoded() {
    let bytes = hex("a0a0a0a0 0003 2102 0024 0001 0022 0001 0001 0018 0000 0000 0000 0012
         0662 0020 2030 204d 44344733 32382e30 3033");
    let head = Head::parse(bytes.first_chunk().unwrap()).unwrap();
    assert_eq!((head.version, head.kind, head.length), (3, Kind::Answer, 36));
    let request = Request::new(&[command(Target::Cnc, 0x18, [0; 5], &[])]).unwrap();
    let blocks: Vec<_> = request.answers(&bytes[HEAD..]).unwrap().collect();
    let block = blocks[0].unwrap();
    assert_eq!((block.error, block.data.len()), (0, 18));
    assert_eq!(&block.data[8..12], b"D4G3");
    // Missing option: sixteen bytes with code 6.
    let refused = hex("0001 0010 0001 0001 0026 0006 0000 0000 0000");
    let blocks: Vec<_> = Blocks::parse(&refused).unwrap().collect();
    assert_eq!(blocks[0].unwrap().error, 6);
    // A response to another function.
    assert_eq!(request.answers(&refused).err(), Some(FrameError("an answer to another command")));
    // An unknown number rejects the whole frame.
    let negative = hex("a0a0a0a0 0003 2103 0008 0000 ffef 0001 0000");
    let head = Head::parse(negative.first_chunk().unwrap()).unwrap();
    assert_eq!(head.kind, Kind::Negative);
}

#[test]
fn eight_byte_numbers_are_decoded_and_saturate() {
    let parse = |text: &str| number(hex(text).try_into().unwrap());
    assert_eq!(parse("fff6deaa 000a 0003"), Some(-598.358));
    assert_eq!(parse("0bc77120 000a 0006"), Some(197.62));
    assert_eq!(parse("00000003 0002 0001"), Some(1.5));
    assert_eq!(parse("00000000 000a ffff"), None);
    assert_eq!(parse("00000001 0003 0001"), None);
    assert_eq!(number_bytes(-598.358, 3)[..], hex("fff6deaa 000a 0003")[..]);
    assert_eq!(number(number_bytes(f64::INFINITY, 3)), Some(2_147_483.647));
    assert_eq!(number(number_bytes(f64::NAN, 3)), Some(0.0));
}

#[test]
fn data_can_be_changed_in_place() {
    let first = command(Target::Pmc, 0x8002, [100, 103, 5, 1, 4], &[0; 4]);
    let second = command(Target::Pmc, 0x8002, [120, 120, 5, 0, 1], &[0]);
    let mut request = Request::new(&[first, second]).unwrap();
    request.data_mut(0).copy_from_slice(&[1, 2, 3, 4]);
    request.data_mut(1)[0] = 9;
    assert!(request.data_mut(2).is_empty());
    let commands = parse_commands(&request.bytes()[HEAD..]).unwrap();
    assert_eq!((commands[0].data, commands[1].data), (&[1, 2, 3, 4][..], &[9][..]));
}

#[test]
fn truncated_responses_are_rejected() {
    let commands = [
        command(Target::Cnc, 0x26, [1, -1, 0, 0, 0], &[]),
        command(Target::Pmc, 0x8001, [100, 105, 5, 1, 0], &[]),
    ];
    let request = Request::new(&commands).unwrap();
    let mut payload = vec![0, 2];
    push_block(&mut payload, &commands[0], 0, &[7; 24]).unwrap();
    push_block(&mut payload, &commands[1], 0, &[1, 2, 3, 4, 5, 6]).unwrap();
    assert!(request.answers(&payload).is_ok());
    for cut in 0..payload.len() {
        assert!(request.answers(&payload[..cut]).is_err(), "{cut}");
    }
    let mut more = payload.clone();
    more[1] = 3;
    assert!(request.answers(&more).is_err());
}

/// Each file of the corpus parses as the response, request or header that its name says.
#[test]
fn corpus_frames_parse() {
    let mut seen = 0;
    for (name, bytes) in corpus::files("focas") {
        let head = bytes.first_chunk().map(Head::parse);
        let blocks = Blocks::parse(&bytes).map(Iterator::collect::<Vec<_>>);
        let commands = parse_commands(&bytes);
        if name.starts_with("answer-") {
            assert!(blocks.unwrap().iter().all(Result::is_ok), "{name}");
        } else if name.starts_with("request-") {
            let request = Request::new(commands.as_ref().unwrap()).unwrap();
            assert_eq!(request.bytes()[HEAD..], bytes, "{name}");
        } else if name.starts_with("head-") {
            assert!(head.unwrap().is_ok(), "{name}");
        }
        seen += 1;
    }
    assert!(seen >= 5);
}

proptest! {
    #[test]
    fn arbitrary_bytes_do_not_panic(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        if let Some(head) = bytes.first_chunk() {
            let _ = Head::parse(head);
        }
        let _ = parse_commands(&bytes);
        if let Ok(blocks) = Blocks::parse(&bytes) {
            prop_assert!(blocks.count() <= 65_535);
        }
    }

    #[test]
    fn commands_round_trip(
        function: u16, path: u16, args: [i32; 5], pmc: bool,
        data in proptest::collection::vec(any::<u8>(), 0..300),
    ) {
        let target = if pmc { Target::Pmc } else { Target::Cnc };
        let command = Command { target, path, function, args, data: &data };
        let request = Request::new(&[command, command]).unwrap();
        prop_assert_eq!(parse_commands(&request.bytes()[HEAD..]).unwrap(), vec![command; 2]);
        let head = Head::parse(request.bytes().first_chunk().unwrap()).unwrap();
        prop_assert_eq!(head.length + HEAD, request.bytes().len());
    }

    #[test]
    fn numbers_round_trip(mantissa: i32, decimals in 0_i16..7) {
        let value = f64::from(mantissa) / 10_f64.powi(i32::from(decimals));
        prop_assert_eq!(number(number_bytes(value, decimals)), Some(value));
    }

    #[test]
    fn frames_round_trip(payload in proptest::collection::vec(any::<u8>(), 0..300)) {
        let bytes = frame(4, Kind::Answer, &payload).unwrap();
        let head = Head::parse(bytes.first_chunk().unwrap()).unwrap();
        prop_assert_eq!((head.version, head.kind, head.length), (4, Kind::Answer, payload.len()));
    }
}
