//! Conformance tests for thermometers and digital ports, with nodes that send periodically.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
    time::Duration,
};

use volcomp_can::{
    CanThermometer, Frame,
    canopen::{CanopenDigital, CanopenThermometer, Channel, Number},
};
use volcomp_port::contract;

use crate::{Bus, frame_of, shipped};

const LONG: Duration = Duration::from_secs(5);

/// A node that sends frames until dropped.
struct Sender(Arc<AtomicBool>, Option<JoinHandle<()>>);

impl Sender {
    fn start(bus: &Bus, frames: impl Fn(u64) -> Vec<Frame> + Send + 'static) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let (stopped, bus) = (Arc::clone(&stop), bus.clone());
        let thread = std::thread::spawn(move || {
            for round in 0.. {
                if stopped.load(Ordering::Relaxed) {
                    return;
                }
                for frame in frames(round) {
                    bus.deliver(frame);
                }
                std::thread::sleep(Duration::from_millis(2));
            }
        });
        Self(stop, Some(thread))
    }
}

impl Drop for Sender {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
        if let Some(thread) = self.1.take() {
            let _ = thread.join();
        }
    }
}

fn frame(id: u32, data: &[u8]) -> Frame {
    Frame::new(id, false, false, data).unwrap()
}

#[test]
fn thermometer_contract_of_plain_frames() {
    let bus = Bus::default();
    let values =
        [("BED_TEMP", 21.0), ("COLUMN_TEMP", 22.0), ("SPINDLE_TEMP", 30.0), ("SCALE_X_TEMP", 20.5)];
    let _sender = Sender::start(&bus, move |round| {
        vec![frame_of(&shipped(), "TEMPERATURES", &values, round % 16)]
    });
    let mut thermometer = CanThermometer::new(bus, &shipped(), &[]).unwrap();
    contract::thermometer(&mut thermometer);
    assert_eq!(thermometer.health(), volcomp_can::Health::default());
}

#[test]
fn thermometer_and_line_contracts_of_canopen_nodes() {
    let bus = Bus::default();
    let _sender =
        Sender::start(&bus, |_| vec![frame(0x705, &[5]), frame(0x185, &[215, 0, 0x34, 0x12])]);
    let channel = Channel {
        name: "bed".to_owned(),
        node: 5,
        pdo: 1,
        at: 0,
        number: Number::I16 { decimals: 1 },
        status_at: None,
    };
    let mut thermometer = CanopenThermometer::new(bus.clone(), vec![channel], LONG).unwrap();
    contract::thermometer(&mut thermometer);
    drop(thermometer);
    let mut port = CanopenDigital::new(bus, 5, 32, 16, LONG).unwrap();
    // Wait for the node's first heartbeat.
    while volcomp_port::DigitalIo::read(&mut port, crate::soon()).is_err() {}
    contract::digital_io(&mut port, false);
}
