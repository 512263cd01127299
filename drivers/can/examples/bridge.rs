//! Corrects a control that sends its positions in plain CAN frames of the shipped `volcomp.dbc`. The bus is in memory;
//! on a machine use `CanSocket::open("can0")`.
//!
//!     cargo run -p volcomp-can --example bridge

use std::{
    collections::VecDeque,
    error::Error,
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use volcomp_can::{
    BridgeConfig, CanController, CanPort, Frame, Received, SHIPPED_DBC, SignalTable,
};
use volcomp_port::{Controller, Fault};
use volcomp_vocabulary::{AxisName, PerChannel};

/// A bus in memory: a queue of frames to the gateway and a queue of frames to the control.
#[derive(Clone, Default)]
struct Bus(Arc<Mutex<[VecDeque<Frame>; 2]>>);

impl Bus {
    fn push(&self, to: usize, frame: Frame) {
        let mut queues = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        queues[to].push_back(frame);
    }

    fn pop(&self, from: usize) -> Option<Frame> {
        let mut queues = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        queues[from].pop_front()
    }
}

const TO_GATEWAY: usize = 0;
const TO_CONTROL: usize = 1;

impl CanPort for Bus {
    fn device(&self) -> &'static str {
        "can://memory"
    }

    fn receive(&mut self, _deadline: Instant) -> Result<Option<Received>, Fault> {
        let frame = self.pop(TO_GATEWAY);
        Ok(frame.map(|frame| Received::Frame(frame, Instant::now())))
    }

    fn send(&mut self, frame: &Frame, _deadline: Instant) -> Result<(), Fault> {
        self.push(TO_CONTROL, *frame);
        Ok(())
    }
}

/// Frame of the message that contains these signals, with counter and checksum.
fn message(table: &SignalTable, values: &[(&str, f64)], counter: u64) -> Option<Frame> {
    let (place, _) = table.find(values.first()?.0)?;
    let message = &table.messages[place];
    let mut frame = message.frame()?;
    for (name, value) in values {
        let signal = message.signals.iter().find(|s| s.name == *name)?;
        signal.put(frame.data_mut(), *value);
    }
    message.seal(frame.data_mut(), counter % 16);
    Some(frame)
}

fn main() -> Result<(), Box<dyn Error>> {
    let table = SignalTable::parse(SHIPPED_DBC)?;
    let bus = Bus::default();
    let config = BridgeConfig {
        table: table.clone(),
        channel: "bridge".to_owned(),
        axes: vec![AxisName::X, AxisName::Y],
        reads: Vec::new(),
        includes_correction: false,
    };
    let mut controller = CanController::new(bus.clone(), &config)?;
    for axis in &controller.description().axes {
        if let Some(largest) = axis.largest {
            println!("axis {}: steps of {}, at most {largest}", axis.name, axis.resolution);
        }
    }
    let mut counter = 0_u64;
    for x_mm in [0.0, 100.0, 250.0] {
        // The control sends its positions and its reference state.
        counter += 1;
        let position = [("X_POS", x_mm), ("Y_POS", 50.0)];
        let state = [("X_APPLIED", 0.0), ("REFERENCED", 1.0)];
        for values in [&position, &state] {
            let frame = message(&table, values, counter).ok_or("the table lacks a signal")?;
            bus.push(TO_GATEWAY, frame);
        }
        // The gateway answers with the correction of an axis that is 40 µm/m too long.
        let soon = Instant::now() + Duration::from_millis(100);
        let snapshot = controller.read(soon)?;
        assert!(snapshot.state.referenced);
        let correction = PerChannel::leading([-4e-5 * snapshot.positions[0]]);
        controller.apply(&correction, soon)?;
        // The control applies the correction if length, counter and checksum are correct.
        let frame = bus.pop(TO_CONTROL).ok_or("no correction was sent")?;
        let (place, signal) = table.find("X_CORR").ok_or("the table lacks X_CORR")?;
        let found = &table.messages[place];
        assert!(found.is_whole(frame.data()));
        let sent_um = found.signals[signal].value(frame.data());
        println!("X {x_mm:>5} mm: correction {sent_um} µm");
        assert!((sent_um + 0.04 * x_mm).abs() <= 0.5);
    }
    Ok(())
}
