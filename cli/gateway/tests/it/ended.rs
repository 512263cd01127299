//! What ends the machine by itself: its state, the correction and the log.

use std::{net::SocketAddr, path::PathBuf, sync::Arc, time::Duration};

use volcomp_gateway::{
    error::Failure,
    machine::{Machine, Turn},
    options::Options,
    service::Service,
    slot::{Phase, Slot},
};

use crate::controlled::{configuration, control};

/// Runs the machine until it has failed.
pub(crate) fn failed(config: PathBuf, slot: &Arc<Slot>, turn: Turn<'_>) -> Failure {
    failed_at(([127, 0, 0, 1], 0).into(), config, slot, turn)
}

/// The same with its dashboard at an address.
pub(crate) fn failed_at(
    listen: SocketAddr,
    config: PathBuf,
    slot: &Arc<Slot>,
    turn: Turn<'_>,
) -> Failure {
    let machine = Machine {
        options: Options {
            config: Some(config),
            listen: Some(listen),
            ..Options::default()
        },
        proven_within: Duration::from_secs(4),
    };
    machine.run(machine.plan().expect("right"), slot, turn);
    let Phase::Failed(failure) = slot.phase() else {
        panic!("it has not failed");
    };
    failure
}

/// The control thread ends, which it never should by itself.
#[test]
fn a_machine_without_its_control_thread_has_failed() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = configuration(dir.path(), &control, "");
    let mut turns = 0;
    let mut turn = |service: &mut Service| {
        service.turn();
        turns += 1;
        if turns == 20 {
            // As good as dead: it is told to end at once.
            service.stop(&mut || true);
        }
    };
    let failure = failed(config, &Arc::default(), &mut turn);
    assert_eq!(turns, 20, "it is noticed at once");
    assert_eq!(failure.status, 1);
    let told = "the control thread has ended by itself";
    assert!(failure.what.contains(told), "{}", failure.what);
}

/// A fault of the program in the service, which is injected here: the correction goes out by its ramp.
#[test]
fn a_fault_of_the_program_ramps_the_correction_out() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    let slot = Arc::default();
    let mut largest = 0.0_f64;
    let mut turn = |service: &mut Service| {
        largest = largest.max(control.world().shifts()[0].abs());
        let Phase::Running(live) = Slot::phase(&slot) else {
            panic!("it runs");
        };
        let compensates = live.published.latest().state.name() == "compensating";
        assert!(!(compensates && largest > 0.015), "injected");
        service.turn();
    };
    let failure = failed(config, &slot, &mut turn);
    assert_eq!(failure.status, 1);
    assert!(failure.what.contains("a fault of the program"));
    assert!(largest > 0.015, "it never corrected");
    assert_eq!(control.world().shifts(), [0.0; 3]);
    let audit = std::fs::read_to_string(dir.path().join("audit/audit.log"));
    assert!(audit.expect("a log").contains("\"what\":\"failed\""));
}
