//! Two connections to one control, each with a mailbox of its own for frames, and one barrier that judges both alike.

use volcomp_focas::{
    BarrierArea, FocasConfig, FocasController,
    simulator::{BarrierLadder, Ladder, Options, Simulator, World},
};
use volcomp_guard::{barrier::Program, protocol::ReportStatus};

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
    let ways = [area(), second].map(|barrier| {
        connected(FocasConfig {
            barrier: Some(barrier),
            ..config(&simulator, &AXES)
        })
    });
    simulator.world().reset_largest_steps();
    (simulator, ways)
}

/// One gateway changes its way with the correction applied, again and again. What it left in the other mailbox, whole or
/// torn, lies there meanwhile.
#[test]
fn one_gateway_changes_its_way_without_a_step() {
    let (simulator, mut ways) = simulated();
    let mut sender = Sender::new(77);
    for turn in 0..8_i16 {
        let way = usize::from(turn % 2 == 1);
        let goal = [40 - 10 * turn, -60 + 12 * turn, turn];
        sender.drive(&mut ways[way], goal);
        if turn % 3 == 0 {
            // The last frame over this way is torn: its last words lack.
            let at = [area().frame.at, 300][way];
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

/// Another gateway in the other mailbox is refused as it would be in the same one, and hears who holds the control.
#[test]
fn another_gateway_in_the_other_mailbox_is_refused() {
    let (simulator, [mut first, mut second]) = simulated();
    let (mut ours, mut other) = (Sender::new(77), Sender::new(78));
    // It reads while nobody holds the control, and sends when somebody does.
    // A scan may fall into a report, which is then torn and read again.
    while other.read(&mut second).is_none() {}
    let late = other.frame([100, 100, 100]).expect("a report was read");
    ours.drive(&mut first, [20, -20, 5]);
    let soon = crate::controller::soon();
    volcomp_port::Controller::post(&mut second, &late, soon).unwrap();
    for _ in 0..20 {
        ours.drive(&mut first, [20, -20, 5]);
        let seen = other.read(&mut second);
        assert!(
            matches!(
                seen,
                None | Some(ReportStatus::Old | ReportStatus::Held { owner: 77 })
            ),
            "{seen:?}"
        );
    }
    assert_eq!(simulator.world().shift_counts()[..3], [20, -20, 5]);
    let steps = simulator.world().largest_steps().to_vec();
    assert!(steps.iter().all(|step| *step <= 2), "{steps:?}");
}
