//! Words for a barrier in the control, with the shipped DBC file and with other layouts.

use std::process::Command;

use volcomp_can::{BARRIER_DBC, CanController, Frame, SignalTable};
use volcomp_port::{Controller, Fault, Heartbeat, Words};
use volcomp_vocabulary::{AxisName, Displacement, Mm, PerChannel, Urad};

use crate::{Bus, config, frame_of, soon};

const XYZ: [AxisName; 3] = [AxisName::X, AxisName::Y, AxisName::Z];

fn words(from: u16, count: u16) -> Words {
    let words: Vec<u16> = (0..count).map(|k| from.wrapping_mul(k + 1)).collect();
    Words::new(&words).unwrap()
}

pub(crate) fn report_of(table: &SignalTable, words: &[u16], counter: u64) -> Vec<Frame> {
    let of_report = |m: &&volcomp_can::Message| m.name.starts_with("BARRIER_REPORT");
    let mut frames = Vec::new();
    for message in table.messages.iter().filter(of_report) {
        let mut frame = message.frame().unwrap();
        for signal in &message.signals {
            if let Some(number) = signal.name.strip_prefix("REPORT_") {
                let word = words[number.parse::<usize>().unwrap()];
                signal.put_raw(frame.data_mut(), word.into());
            }
        }
        message.seal(frame.data_mut(), counter);
        frames.push(frame);
    }
    frames
}

#[test]
fn frames_are_sent_and_reports_received() {
    let bus = Bus::default();
    let config = config(BARRIER_DBC, &XYZ);
    let mut controller = CanController::new(bus.clone(), &config).unwrap();
    let description = controller.description().clone();
    assert!(description.barrier && description.tells_applied && description.sees_other_gateways);
    assert_eq!(description.heartbeat, Heartbeat::Watched);
    for axis in &description.axes {
        assert_eq!(axis.resolution, Displacement::Length(Mm(0.001)));
        assert_eq!(axis.largest, Some(Displacement::Length(Mm(32.767))));
    }
    let table = &config.table;
    let mut counter = 0;
    let mut read = |frames: &[Frame]| {
        counter += 1;
        let at = [("X_POS", 1.0), ("Y_POS", 2.0)];
        bus.deliver(frame_of(table, "POSITION_XY", &at, counter));
        bus.deliver(frame_of(table, "POSITION_Z", &[("Z_POS", 3.0)], counter));
        for frame in frames {
            bus.deliver(*frame);
        }
        controller.read(soon()).unwrap()
    };
    let first = report_of(table, words(0x1357, 19).as_slice(), 4);
    assert_eq!(first.len(), 7);
    let snapshot = read(&first[..6]);
    assert_eq!(snapshot.report, None, "a part is missing");
    assert_eq!(snapshot.applied, None);
    assert_eq!(snapshot.positions[..3], [1.0, 2.0, 3.0]);
    assert_eq!(read(&first[6..]).report, Some(words(0x1357, 19)));
    // An incomplete report does not replace the last complete one.
    let second = report_of(table, words(0xfedc, 19).as_slice(), 5);
    assert_eq!(read(&second[..2]).report, Some(words(0x1357, 19)));
    assert_eq!(read(&second[2..]).report, Some(words(0xfedc, 19)));
    // One read processes two complete reports and a part of the next.
    let third = report_of(table, words(0x0a0b, 19).as_slice(), 6);
    let fourth = report_of(table, words(0x0c0d, 19).as_slice(), 7);
    let all = [&third[..], &fourth[..], &first[..3]].concat();
    assert_eq!(read(&all).report, Some(words(0x0c0d, 19)));

    let frame = words(0x8001, 9);
    controller.post(&frame, soon()).unwrap();
    let sent = bus.sent();
    let ids: Vec<u32> = sent.iter().map(|frame| frame.id).collect();
    assert_eq!(ids, [272, 273, 274]);
    for (place, sent) in sent.iter().enumerate() {
        let message = &table.messages[table.message_of(sent).unwrap()];
        assert!(message.is_whole(sent.data()));
        assert_eq!(message.counter(sent.data()), Some(1), "the same counter in all");
        let words = &frame.as_slice()[3 * place..][..3];
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        assert_eq!(sent.data()[..6], bytes);
    }
    // Nothing is sent after the deadline or with too few words. Plain corrections are rejected.
    let late = controller.post(&frame, std::time::Instant::now());
    assert_eq!(late, Err(Fault::TimedOut));
    let few = controller.post(&words(1, 8), soon());
    assert!(matches!(few, Err(Fault::Unsupported(_))));
    let plain = controller.apply(&PerChannel::ZERO, soon());
    assert!(matches!(plain, Err(Fault::Unsupported(_))));
    assert_eq!(bus.sent(), []);
}

#[test]
fn cycles_do_not_allocate() {
    let (bus, plain_bus) = (Bus::default(), Bus::default());
    let barrier = config(BARRIER_DBC, &XYZ);
    let plain = config(volcomp_can::SHIPPED_DBC, &XYZ);
    let mut posting = CanController::new(bus.clone(), &barrier).unwrap();
    let mut applying = CanController::new(plain_bus.clone(), &plain).unwrap();
    for counter in 0..16 {
        let z = |table: &SignalTable, name| frame_of(table, name, &[], counter);
        for name in ["POSITION_XY", "POSITION_Z", "STATE"] {
            bus.deliver(z(&barrier.table, name));
        }
        for frame in report_of(&barrier.table, words(7, 19).as_slice(), counter) {
            bus.deliver(frame);
        }
        for name in ["POSITION_XY", "POSITION_ZC", "STATE"] {
            plain_bus.deliver(z(&plain.table, name));
        }
    }
    for bus in [&bus, &plain_bus] {
        bus.state().sent.reserve(100);
    }
    let frame = words(3, 9);
    assert_no_alloc::assert_no_alloc(|| {
        for _ in 0..10 {
            let snapshot = posting.read(soon()).unwrap();
            assert!(snapshot.report.is_some());
            posting.post(&frame, soon()).unwrap();
            let snapshot = applying.read(soon()).unwrap();
            assert!(snapshot.applied.is_some());
            applying.apply(&PerChannel([0.01; 9]), soon()).unwrap();
        }
    });
    assert_eq!((bus.sent().len(), plain_bus.sent().len()), (30, 10));
}

/// Two axes in big-endian FD frames with counters and checksums. The words of a frame are in two messages, the second
/// with the lower identifier; the message with the last word is sent last.
#[test]
fn a_custom_layout() {
    let mut text = "VERSION \"\"\nBU_: A\nBO_ 1 WHERE: 8 A\n SG_ X_POS : 7|24@0- (0.001,0) [0|0] \"mm\" A\n SG_ C_POS : 31|24@0- (0.001,0) [0|0] \"deg\" A\n\n".to_owned();
    let mut message = |id: u32, name: &str, prefix: &str, numbers: &[usize], counts: &[&str]| {
        use std::fmt::Write;
        writeln!(text, "BO_ {id} {name}: 48 A").unwrap();
        for (place, number) in numbers.iter().enumerate() {
            let start = 16 * place + 7;
            let unit = counts.get(*number).unwrap_or(&"1:");
            let (factor, unit) = unit.split_once(':').unwrap();
            writeln!(
                text,
                " SG_ {prefix}_{number} : {start}|16@0+ ({factor},0) [0|0] \"{unit}\" A"
            )
            .unwrap();
        }
        writeln!(
            text,
            " SG_ {name}_CNT : 367|4@0+ (1,0) [0|0] \"\" A\n SG_ {name}_CRC : 375|8@0+ (1,0) [0|0] \"\" A\n"
        )
        .unwrap();
    };
    let frame_counts = ["1:", "1:", "1:", "1:", "0.5:um", "2:urad"];
    message(9, "EARLY", "FRAME", &[0, 1, 2, 3], &frame_counts);
    message(5, "LATE", "FRAME", &[7, 6, 5, 4], &frame_counts);
    let plain = ["1:"; 8];
    let of_axes = ["0.5:um", "0.5:um", "1:", "2:urad", "2:urad", "1:"];
    let counts = [&plain[..], &of_axes[..]].concat();
    message(7, "STATUS", "REPORT", &(0..16).collect::<Vec<_>>(), &counts);
    let bus = Bus::default();
    let config = config(&text, &[AxisName::X, AxisName::C]);
    let mut controller = CanController::new(bus.clone(), &config).unwrap();
    let axes = &controller.description().axes;
    assert_eq!(axes[0].resolution, Displacement::Length(Mm(0.0005)));
    assert_eq!(axes[1].resolution, Displacement::Angle(Urad(2.0).to_rad()));
    let frame = words(0x0102, 8);
    for round in 1..=20_u64 {
        controller.post(&frame, soon()).unwrap();
        let sent = bus.sent();
        assert_eq!((sent[0].id, sent[1].id, sent.len()), (9, 5, 2));
        assert_eq!(sent[0].data()[..4], [1, 2, 2, 4], "high byte first");
        for frame in &sent {
            let message = &config.table.messages[config.table.message_of(frame).unwrap()];
            assert!(frame.fd && message.is_whole(frame.data()));
            assert_eq!(message.counter(frame.data()), Some(round % 16));
        }
    }
}

#[test]
fn invalid_words_are_rejected() {
    let refused = |from: &str, to: &str, axes: &[AxisName]| {
        let text = BARRIER_DBC.replacen(from, to, 1);
        assert!(from.is_empty() || text != BARRIER_DBC, "{from}");
        let refused = config(&text, axes).describe("can://memory");
        refused.unwrap_err().to_string()
    };
    for (from, to, axes, expected) in [
        (
            "",
            "",
            &XYZ[..2],
            "found 9 words FRAME_0, FRAME_1, …, expected 8 for a barrier of 2 axes",
        ),
        (
            "SG_ FRAME_8",
            "SG_ SPARE",
            &XYZ,
            "found 8 words FRAME_0, FRAME_1, …, expected 9 for a barrier of 3 axes",
        ),
        (
            "SG_ BARRIER_REPORT_C_CNT",
            "SG_ SPARE",
            &XYZ,
            "message BARRIER_REPORT_C: found no signal BARRIER_REPORT_C_CNT, expected one, since the words come in several messages",
        ),
        (
            "SG_ REPORT_18",
            "SG_ REPORT_19",
            &XYZ,
            "found the signal REPORT_19, expected REPORT_18: each word once, counted from 0",
        ),
        (
            "SG_ FRAME_2 : 32|16",
            "SG_ FRAME_2 : 32|15",
            &XYZ,
            "signal FRAME_2: found 15 bits, expected 16",
        ),
        (
            "SG_ FRAME_4 : 16|16@1- (1,0) [-32768|32767] \"um\"",
            "SG_ FRAME_4 : 16|16@1- (1,0) [-32768|32767] \"\"",
            &XYZ,
            "signal FRAME_4: found no unit, expected mm or um, since the axis is linear; unit and factor define a count of X",
        ),
        (
            "SG_ REPORT_8 : 32|16@1- (1,0)",
            "SG_ REPORT_8 : 32|16@1- (0.1,0)",
            &XYZ,
            "signal REPORT_8: found a count of 0.1 um, expected 1 um as in FRAME_4",
        ),
        (
            "SG_ FRAME_0 : 0|16@1+ (1,0)",
            "SG_ FRAME_0 : 0|16@1+ (2,0)",
            &XYZ,
            "signal FRAME_0: found the factor 2, the offset 0 and the unit ``, expected 1, 0 and no unit: it is a plain word",
        ),
    ] {
        let found = refused(from, to, axes);
        assert!(found.contains(expected), "{found}");
    }
}

/// cantools (PyPI) encodes the same reports and decodes the same frames.
#[test]
fn cantools_agrees_on_barrier_words() {
    let Some(python) = volcomp_test_support::peers::python() else {
        return;
    };
    let bus = Bus::default();
    let config = config(BARRIER_DBC, &XYZ);
    let mut controller = CanController::new(bus.clone(), &config).unwrap();
    // −20 µm in X, as two's complement.
    let frame = [7, 65535, 3, 0xbeef, (-20_i16).cast_unsigned(), 150, 0, 0xffff, 0x8000];
    controller.post(&Words::new(&frame).unwrap(), soon()).unwrap();
    let sent = bus.sent();
    let hex = |data: &[u8]| {
        let bytes: Vec<String> = data.iter().map(|b| format!("{b:02x}")).collect();
        bytes.concat()
    };
    let data: Vec<String> = sent.iter().map(|f| format!("{}:{}", f.id, hex(f.data()))).collect();
    let program = "import sys, cantools\n\
        db = cantools.database.load_file(sys.argv[1])\n\
        found = {}\n\
        for part in sys.argv[2:]:\n\
        \x20   id, data = part.split(':')\n\
        \x20   found.update(db.decode_message(int(id), bytes.fromhex(data)))\n\
        assert found['FRAME_4'] == -20, found\n\
        print(*[int(found['FRAME_%d' % k]) & 0xffff for k in range(9)])\n\
        for name in 'ABCDEFG':\n\
        \x20   message = db.get_message_by_name('BARRIER_REPORT_' + name)\n\
        \x20   own = {message.name + '_CNT': 9, message.name + '_CRC': 0}\n\
        \x20   words = {s.name: 1000 * (int(s.name[7:]) + 1) for s in message.signals if s.name not in own}\n\
        \x20   words.update(own)\n\
        \x20   print(message.frame_id, message.encode(words).hex())\n";
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/barrier.dbc");
    let output = Command::new(&python).args(["-c", program, path]).args(data).output().unwrap();
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{error}");
    let text = String::from_utf8(output.stdout).unwrap();
    let mut lines = text.lines();
    let found: Vec<u16> = lines.next().unwrap().split(' ').map(|w| w.parse().unwrap()).collect();
    assert_eq!(found, frame);
    for line in lines {
        let (id, data) = line.split_once(' ').unwrap();
        let bytes = (0..data.len()).step_by(2).map(|k| u8::from_str_radix(&data[k..k + 2], 16));
        let bytes: Vec<u8> = bytes.map(Result::unwrap).collect();
        let mut frame = Frame::new(id.parse().unwrap(), false, false, &bytes).unwrap();
        let message = &config.table.messages[config.table.message_of(&frame).unwrap()];
        assert_eq!(message.counter(frame.data()), Some(9));
        // cantools does not compute checksums.
        message.seal(frame.data_mut(), 9);
        bus.deliver(frame);
    }
    bus.deliver(frame_of(&config.table, "POSITION_XY", &[], 1));
    bus.deliver(frame_of(&config.table, "POSITION_Z", &[], 1));
    let report = controller.read(soon()).unwrap().report.unwrap();
    let expected: Vec<u16> = (1..=19).map(|k| 1000 * k).collect();
    assert_eq!(report.as_slice(), expected);
}
