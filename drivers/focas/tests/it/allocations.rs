//! A cycle does not allocate or free memory, even when the connection is lost.

use std::time::{Duration, Instant};

use assert_no_alloc::assert_no_alloc;
use volcomp_focas::{FocasConfig, FocasController, simulator::Options};
use volcomp_port::{Controller, Fault, Words};
use volcomp_vocabulary::{AxisName, PerChannel};

use crate::{
    TIMEOUT, barrier, config,
    controller::{connected, soon},
};

const AXES: [AxisName; 3] = [AxisName::X, AxisName::Y, AxisName::Z];

/// Runs cycles while the connection is open, lost, missing and restored.
fn cycles(controller: &mut FocasController, silence: impl Fn(), frame: Option<&Words>) {
    let cycle = |controller: &mut FocasController, deadline: Instant| {
        assert_no_alloc(|| {
            let read = controller.read(deadline).map(drop);
            let written = match frame {
                Some(frame) => controller.post(frame, deadline),
                None => controller.apply(&PerChannel::ZERO, deadline),
            };
            (read, written)
        })
    };
    for _ in 0..20 {
        assert_eq!(cycle(controller, soon()), (Ok(()), Ok(())));
    }
    silence();
    let (read, written) = cycle(controller, Instant::now() + Duration::from_millis(5));
    assert_eq!(read, Err(Fault::TimedOut));
    assert_eq!(written, Err(Fault::NotConnected));
    controller.wait(TIMEOUT).unwrap();
    assert_eq!(cycle(controller, soon()), (Ok(()), Ok(())));
}

#[test]
fn cycles_do_not_allocate() {
    let simulator = barrier::simulated(Options::default());
    let silence = || simulator.world().pause(Duration::from_millis(50));
    cycles(&mut connected(config(&simulator, &AXES)), silence, None);
    let with_barrier = FocasConfig { barrier: Some(barrier::area()), ..config(&simulator, &AXES) };
    let frame = Words::new(&[0; 9]).unwrap();
    cycles(&mut connected(with_barrier), silence, Some(&frame));
}
