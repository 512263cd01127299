use std::time::{Duration, Instant};

use volcomp_can::{
    Frame,
    canopen::{
        CanopenDigital, CanopenThermometer, Channel, NmtCommand, NodeState, Number, SdoAnswer,
        SdoClient, Telegram, nmt, sdo_read, sdo_write, telegram,
    },
};
use volcomp_port::{DigitalIo, Fault, InputLevels, Quality, Reason, Thermometer};

use crate::{Bus, soon};

fn frame(id: u32, data: &[u8]) -> Frame {
    Frame::new(id, false, false, data).unwrap()
}

/// Every telegram that a monitored node sends cyclically is asked for, and none of other nodes.
#[test]
fn only_telegrams_of_monitored_nodes_are_asked_for() {
    let bus = Bus::default();
    CanopenDigital::new(bus.clone(), 5, 8, 8, Duration::from_secs(1)).unwrap();
    let asked = bus.state().asked.clone();
    for id in 0..=0x7ff {
        let data = [0x05, 0x10, 1, 0, 0, 0, 0, 0];
        let is_used = match telegram(&frame(id, &data)) {
            Some(
                Telegram::Heartbeat { node, .. }
                | Telegram::Emergency { node, .. }
                | Telegram::Pdo { node, .. },
            ) => node == 5,
            _ => false,
        };
        assert_eq!(asked.contains(&(id, false)), is_used, "{id:x}");
    }
}

#[test]
fn telegrams_are_decoded() {
    let sdo = |data: &[u8]| match telegram(&frame(0x585, data)) {
        Some(Telegram::Sdo { node: 5, answer }) => answer,
        other => panic!("{other:?}"),
    };
    assert_eq!(
        telegram(&frame(0x705, &[0x05])),
        Some(Telegram::Heartbeat { node: 5, state: NodeState::Operational })
    );
    assert_eq!(
        telegram(&frame(0x085, &[0x10, 0x50, 1, 0, 0, 0, 0, 0])),
        Some(Telegram::Emergency { node: 5, code: 0x5010 })
    );
    for (id, number) in [(0x185, 1), (0x285, 2), (0x385, 3), (0x485, 4)] {
        assert_eq!(telegram(&frame(id, &[])), Some(Telegram::Pdo { node: 5, number }));
    }
    let object = (0x1018, 1);
    assert_eq!(
        sdo(&[0x43, 0x18, 0x10, 1, 0x94, 1, 2, 0]),
        SdoAnswer::Read { object, value: 0x0002_0194, bytes: 4 }
    );
    assert_eq!(
        sdo(&[0x4f, 0x18, 0x10, 1, 0x7f, 9, 9, 9]),
        SdoAnswer::Read { object, value: 0x7f, bytes: 1 }
    );
    assert_eq!(sdo(&[0x60, 0x18, 0x10, 1, 0, 0, 0, 0]), SdoAnswer::Written { object });
    assert_eq!(
        sdo(&[0x80, 0x18, 0x10, 1, 0, 0, 2, 6]),
        SdoAnswer::Aborted { object, code: 0x0602_0000 }
    );
    assert_eq!(sdo(&[0x41, 0x18, 0x10, 1, 30, 0, 0, 0]), SdoAnswer::Segmented { object });
    for nothing in
        [frame(0x585, &[0x43, 1]), frame(0x705, &[]), frame(0x100, &[0; 8]), frame(0x700, &[5])]
    {
        assert_eq!(telegram(&nothing), None);
    }
    assert_eq!(nmt(NmtCommand::Start, 5), Some(frame(0, &[1, 5])));
    assert_eq!(sdo_read(5, (0x6130, 2)), Some(frame(0x605, &[0x40, 0x30, 0x61, 2, 0, 0, 0, 0])));
    assert_eq!(
        sdo_write(5, (0x1017, 0), &500_u16.to_le_bytes()),
        Some(frame(0x605, &[0x2b, 0x17, 0x10, 0, 0xf4, 1, 0, 0]))
    );
    assert_eq!(sdo_write(5, (0x1017, 0), &[]), None);
    assert_eq!(sdo_write(5, (0x1017, 0), &[0; 5]), None);
}

#[test]
fn objects_are_transferred_one_at_a_time() {
    let bus = Bus::default();
    let mut client = SdoClient::new(bus.clone());
    // Late answers to other requests, answers of other nodes, and other frames arrive first.
    bus.deliver(frame(0x586, &[0x43, 0x32, 0x61, 1, 9, 0, 0, 0]));
    bus.deliver(frame(0x585, &[0x43, 0x32, 0x61, 2, 9, 0, 0, 0]));
    bus.deliver(frame(0x185, &[1, 2]));
    bus.deliver(frame(0x585, &[0x43, 0x32, 0x61, 1, 1, 0, 0, 0]));
    assert_eq!(client.read(5, (0x6132, 1), soon()), Ok(1));
    assert_eq!(client.read(5, (0x6132, 1), soon()), Err(Fault::TimedOut));
    bus.deliver(frame(0x585, &[0x80, 0x32, 0x61, 1, 0, 0, 2, 6]));
    assert_eq!(
        client.read(5, (0x6132, 1), soon()),
        Err(Fault::Refused { code: 0x0602_0000, what: "an object of the node" })
    );
    bus.deliver(frame(0x585, &[0x60, 0x17, 0x10, 0, 0, 0, 0, 0]));
    assert_eq!(client.write(5, (0x1017, 0), &[0xf4, 1], soon()), Ok(()));
    assert_eq!(client.write(5, (0x1017, 0), &[], soon()), Err(Fault::Unsupported("1 to 4 bytes")));
}

fn channels() -> Vec<Channel> {
    let channel = |name: &str, at, number, status_at| Channel {
        name: name.to_owned(),
        node: 5,
        pdo: 1,
        at,
        number,
        status_at,
    };
    vec![
        channel("bed", 0, Number::I16 { decimals: 1 }, Some(6)),
        channel("column", 2, Number::F32, Some(7)),
    ]
}

fn pdo(bed: i16, column: f32, status: [u8; 2]) -> Frame {
    let data = [&bed.to_le_bytes()[..], &column.to_le_bytes(), &status].concat();
    frame(0x185, &data)
}

#[test]
fn a_node_is_started_monitored_and_read() {
    let bus = Bus::default();
    let quick = Duration::from_millis(150);
    let mut thermometer = CanopenThermometer::new(bus.clone(), channels(), quick).unwrap();
    assert_eq!(thermometer.latest()[0].quality, Quality::Bad(Reason::NotRead));
    assert_eq!(bus.sent(), [frame(0, &[1, 5])], "it is started");
    let mut seen = |frames: &[Frame]| {
        for frame in frames {
            bus.deliver(*frame);
        }
        thermometer.latest().to_vec()
    };
    let operational = frame(0x705, &[5]);
    let latest = seen(&[operational, pdo(-215, 21.5, [0, 0])]);
    assert_eq!(latest.iter().map(|t| t.degc).collect::<Vec<_>>(), [Some(-21.5), Some(21.5)]);
    let latest = seen(&[pdo(215, f32::NAN, [0, 0])]);
    assert_eq!(latest[1].quality, Quality::Bad(Reason::NotANumber));
    let latest = seen(&[pdo(215, 21.5, [1, 0])]);
    assert_eq!(latest[0].quality, Quality::Bad(Reason::Reported));
    assert_eq!(latest[1].degc, Some(21.5));
    // The frame is too short for the data of both channels.
    let latest = seen(&[frame(0x185, &[1])]);
    assert!(latest.iter().all(|t| t.degc.is_none()));
    let emergency = frame(0x085, &[0x10, 0x50, 0, 0, 0, 0, 0, 0]);
    let latest = seen(&[pdo(215, 21.5, [0, 0]), emergency]);
    assert_eq!(latest[1].quality, Quality::Bad(Reason::Reported));
    let gone = frame(0x085, &[0, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(seen(&[pdo(215, 21.5, [0, 0]), gone])[1].quality, Quality::Good);
    // After a power cycle the node must be started again.
    let latest = seen(&[frame(0x705, &[0x7f])]);
    assert_eq!(latest[1].quality, Quality::Bad(Reason::NotRead));
    assert_eq!(seen(&[operational, pdo(215, 21.5, [0, 0])])[1].quality, Quality::Good);
    std::thread::sleep(Duration::from_millis(200));
    assert_eq!(
        seen(&[pdo(215, 21.5, [0, 0])])[1].quality,
        Quality::Bad(Reason::NoAnswer),
        "no heartbeat"
    );
}

#[test]
fn invalid_channels_are_rejected() {
    let quick = Duration::from_millis(150);
    let message = |change: fn(&mut Vec<Channel>)| {
        let mut channels = channels();
        change(&mut channels);
        let refused = CanopenThermometer::new(Bus::default(), channels, quick);
        refused.err().unwrap().to_string()
    };
    assert!(message(Vec::clear).contains("no channel is named"));
    assert!(message(|c| c[1].at = 5).contains("column: node 5, process data 1, byte 5"));
    assert!(message(|c| c[0].node = 128).contains("nodes 1 to 127"));
    assert!(message(|c| c[1].name = "bed".to_owned()).contains("the sensor bed is listed twice"));
}

#[test]
fn lines_of_a_node() {
    let bus = Bus::default();
    // The two intervals differ by a factor of 3000, so a busy computer cannot change the result.
    let (quick, patient) = (Duration::from_millis(20), Duration::from_secs(60));
    let mut port = CanopenDigital::new(bus.clone(), 9, 15, 8, patient).unwrap();
    assert_eq!(port.read(soon()), Err(Fault::NotConnected));
    assert_eq!(bus.sent(), [frame(0, &[1, 9])]);
    bus.deliver(frame(0x709, &[5]));
    bus.deliver(frame(0x189, &[0x34, 0xff]));
    let came = Instant::now();
    let found = port.read(soon()).unwrap();
    assert_eq!(found.levels, 0x7f34, "fifteen lines");
    bus.deliver(frame(0x189, &[0x35]));
    assert_eq!(port.read(soon()), Ok(found), "a frame with eight of them");
    assert!(found.taken <= came, "the time of the frame, not of the call");
    assert_eq!(port.confirmed(), None);
    port.write(0x1a5, soon()).unwrap();
    assert_eq!(bus.sent(), [frame(0x209, &[0xa5])]);
    assert_eq!(port.write(0x1a6, Instant::now()), Err(Fault::TimedOut), "too late");
    assert_eq!((bus.sent(), port.confirmed()), (vec![], Some(0x1a5)));
    bus.deliver(frame(0x709, &[4]));
    assert!(matches!(port.read(soon()), Err(Fault::Protocol(_))), "stopped");
    bus.state().down = true;
    assert_eq!(port.read(Instant::now()), Err(Fault::Disconnected));
    for (heartbeat, expected) in [(patient, Ok(0x34)), (quick, Err(Fault::NotConnected))] {
        let bus = Bus::default();
        let mut port = CanopenDigital::new(bus.clone(), 9, 15, 8, heartbeat).unwrap();
        let before = Instant::now();
        bus.deliver(frame(0x709, &[5]));
        bus.deliver(frame(0x189, &[0x34, 0]));
        let came = Instant::now();
        // The heartbeat is still fresh here. The result of later reads depends on the elapsed time.
        let _ = port.read(soon());
        std::thread::sleep(3 * quick);
        let found = port.read(soon());
        assert_eq!(found.map(|found| found.levels), expected);
        // The lines of a running node keep their levels and arrival time.
        let age = |found: InputLevels| (before..=came).contains(&found.taken);
        assert!(found.is_ok_and(age) || expected.is_err());
    }
    let refused = CanopenDigital::new(Bus::default(), 0, 8, 8, quick);
    assert!(refused.err().unwrap().to_string().contains("found node 0"));
}

/// A node that reboots, stops or fails loses its outputs, also if it runs again before the next reading. They are no longer confirmed, and the next
/// write is not sent but fails.
#[test]
fn a_node_that_did_not_run_has_lost_its_outputs() {
    let heartbeat = |state| frame(0x709, &[state]);
    let emergency = |code: u8| frame(0x089, &[code, 0, 0, 0, 0, 0, 0, 0]);
    let (boot_up, stopped, running, pre_operational) = (0, 4, 5, 0x7f);
    let runs = heartbeat(running);
    for (case, frames, fault) in [
        ("reboot", vec![heartbeat(boot_up)], Fault::NotConnected),
        ("quick reboot", vec![heartbeat(boot_up), runs], Fault::Disconnected),
        ("pre-operational", vec![heartbeat(pre_operational)], Fault::NotConnected),
        ("quick start", vec![heartbeat(pre_operational), runs], Fault::Disconnected),
        ("stopped", vec![heartbeat(stopped)], Fault::NotConnected),
        ("emergency", vec![emergency(0x10)], Fault::NotConnected),
    ] {
        let bus = Bus::default();
        let mut port = CanopenDigital::new(bus.clone(), 9, 15, 8, Duration::from_secs(60)).unwrap();
        bus.deliver(runs);
        bus.deliver(frame(0x189, &[0x34, 0]));
        port.read(soon()).unwrap();
        port.write(0xa5, soon()).unwrap();
        port.read(soon()).unwrap();
        assert_eq!(port.confirmed(), Some(0xa5), "{case}");
        for frame in frames {
            bus.deliver(frame);
        }
        assert_eq!(port.read(soon()).is_ok(), fault == Fault::Disconnected, "{case}");
        assert_eq!(port.confirmed(), None, "{case}");
        bus.sent();
        assert_eq!(port.write(0xa6, soon()), Err(fault), "{case}");
        bus.deliver(emergency(0));
        bus.deliver(runs);
        port.read(soon()).unwrap();
        let sent = bus.sent();
        assert!(sent.iter().all(|frame| frame.id != 0x209), "{case}: {sent:?}");
        assert_eq!(port.confirmed(), None, "{case}");
        port.write(0, soon()).unwrap();
        assert_eq!(port.confirmed(), Some(0), "{case}");
    }
}
