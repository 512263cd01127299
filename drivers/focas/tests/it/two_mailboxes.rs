//! Two connections to one control, each with its own mailbox for frames, and one barrier that treats both equally.

use volcomp_focas::{
    BarrierArea, FocasConfig, FocasController,
    simulator::{BarrierLadder, Ladder, Options, Simulator, World},
};
use volcomp_guard::{barrier::Program, protocol::Seen};

use crate::{
    barrier::{AXES, Sender, area, r, settings},
    config,
    controller::connected,
};

fn simulated() -> (Simulator, [FocasController; 2]) {
    let program = Program::new(settings(3)).unwrap();
    let mut ladder = BarrierLadder::new(Box::new(program), 3);
    let second = BarrierArea {
        frame: r(300),
        ..area()
    };
    ladder.frames.push(second.frame);
    let mut world = World::new(&['X', 'Y', 'Z', 'C']);
    world.ladder = Some(Ladder::Barrier(ladder));
    let simulator = Simulator::start("127.0.0.1:0", Options::default(), world).unwrap();
    let controllers = [area(), second].map(|barrier| {
        connected(FocasConfig {
            barrier: Some(barrier),
            ..config(&simulator, &AXES)
        })
    });
    simulator.world().reset_largest_steps();
    (simulator, controllers)
}

/// One gateway switches between the connections while a correction is applied; the other mailbox keeps an old frame, complete
/// or torn.
#[test]
fn a_gateway_switches_connections_without_a_step() {
    let (simulator, mut controllers) = simulated();
    let mut sender = Sender::new(77);
    for turn in 0..8_i16 {
        let index = usize::from(turn % 2 == 1);
        let goal = [40 - 10 * turn, -60 + 12 * turn, turn];
        sender.drive(&mut controllers[index], goal);
        if turn % 3 == 0 {
            // Tear the last frame of this connection: its last words are missing.
            let at = [area().frame.at, 300][index];
            simulator
                .world()
                .set(volcomp_focas::PmcArea::R, usize::from(at) + 10, &[9, 9, 9]);
        }
        assert_eq!(sender.last.unwrap().owner, 77);
        let shifts = simulator.world().shift_counts();
        assert_eq!(shifts[..3], goal.map(i64::from));
    }
    let steps = simulator.world().largest_steps().to_vec();
    assert!(steps.iter().all(|step| *step <= 2), "{steps:?}");
}

/// A second gateway is rejected in the other mailbox as in the same one, and receives the owner's number.
#[test]
fn a_second_gateway_in_the_other_mailbox_is_rejected() {
    let (simulator, [mut first, mut second]) = simulated();
    let (mut ours, mut other) = (Sender::new(77), Sender::new(78));
    // It reads while the control has no owner, and sends when it has one. A report torn by a scan is read again.
    while other.read(&mut second).is_none() {}
    let late = other.frame([100, 100, 100]).expect("a report was read");
    ours.drive(&mut first, [20, -20, 5]);
    let soon = crate::controller::soon();
    volcomp_port::Controller::post(&mut second, &late, soon).unwrap();
    for _ in 0..20 {
        ours.drive(&mut first, [20, -20, 5]);
        let seen = other.read(&mut second);
        assert!(
            matches!(seen, None | Some(Seen::Old | Seen::Held { owner: 77 })),
            "{seen:?}"
        );
    }
    assert_eq!(simulator.world().shift_counts()[..3], [20, -20, 5]);
    let steps = simulator.world().largest_steps().to_vec();
    assert!(steps.iter().all(|step| *step <= 2), "{steps:?}");
}
