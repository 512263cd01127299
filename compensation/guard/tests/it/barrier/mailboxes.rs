//! Several mailboxes at one barrier.

use volcomp_guard::{
    barrier::{Barrier, Settings},
    protocol::{Counts, Seen, Session},
    vocabulary::PerChannel,
};

use super::{at_zero, settings, words};

/// Reads the report and sends what is wanted, at half the rate of the barrier.
fn answer(barrier: &Barrier, sender: &mut Session, wanted: i16, output: &mut i16) -> Vec<u16> {
    let report = barrier.report();
    if let Seen::Confirmed {
        epoch_began: true, ..
    } = sender.read(report.head())
    {
        *output = report.applied[0];
    }
    *output += (wanted - *output).signum();
    let frame = sender.frame(&PerChannel::leading([*output]));
    words(
        &report.settings,
        &frame.expect("nobody else holds the control"),
    )
}

/// One gateway corrects over one way and goes on over another; its last frame stays in the mailbox of the first. Tick and
/// sequence go round every minute or so, and before, the old frame was taken again then: the axis ran off towards it.
#[test]
fn an_old_frame_in_a_mailbox_that_nobody_writes_is_never_taken_again() {
    // How many scans pass between two frames, so that tick and sequence go round at different times.
    for every in [1, 2, 3, 7] {
        let settings = Settings {
            rate: PerChannel::leading([20]),
            ..settings(1)
        };
        let mut barrier = at_zero(settings);
        let mut sender = Session::new(7);
        let (mut first, mut second) = (Vec::new(), Vec::new());
        let mut output = 0;
        barrier.scan(&[], false);
        for scan in 0..200_u32 {
            if scan % every == 0 {
                first = answer(&barrier, &mut sender, 20, &mut output);
            }
            barrier.scan(&[&first, &second], false);
        }
        assert_eq!(barrier.report().applied[0], 20);
        for scan in 0..5 * 65_536_u32 {
            if scan % every == 0 {
                second = answer(&barrier, &mut sender, -20, &mut output);
            }
            let applied = barrier.scan(&[&first, &second], false).applied[0];
            assert!(scan < 300 || applied == -20, "{applied} in scan {scan}");
        }
    }
}

/// The gateway goes from one way to the other and back at random, and each of them loses frames, delivers them late and
/// twice: the axis never moves by more than the rate, and arrives.
#[test]
fn one_gateway_alternates_between_two_mailboxes() {
    use rand::{RngExt, SeedableRng};
    for seed in 0..200 {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let settings = settings(1);
        let mut barrier = at_zero(settings);
        let mut sender = Session::new(7);
        let mut boxes = [Vec::new(), Vec::new()];
        let mut air: Vec<(u32, usize, Vec<u16>)> = Vec::new();
        let (mut output, mut way, mut wanted) = (0, 0, 20);
        barrier.scan(&[], false);
        for scan in 0..3000_u32 {
            let calm = scan >= 2500;
            if rng.random_bool(0.02) {
                way = 1 - way;
            }
            if !calm && rng.random_bool(0.01) {
                wanted = rng.random_range(-20..=20);
            }
            let frame = answer(&barrier, &mut sender, wanted, &mut output);
            if calm || rng.random_bool(0.8) {
                let late = rng.random_bool(if calm { 0.0 } else { 0.1 });
                let late = if late { rng.random_range(0..400) } else { 0 };
                air.push((scan + late, way, frame.clone()));
                if rng.random_bool(0.05) {
                    air.push((scan + rng.random_range(0..400), 1 - way, frame));
                }
            }
            air.retain(|(at, way, frame)| {
                let arrives = *at <= scan;
                if arrives {
                    boxes[*way].clone_from(frame);
                }
                !arrives
            });
            let before = barrier.memory().applied;
            let report = barrier.scan(&[&boxes[0], &boxes[1]], false);
            assert!((report.applied[0] - before[0]).abs() <= settings.rate[0]);
            assert!(report.owner == 7 || report.owner == 0);
        }
        assert_eq!(barrier.report().applied[0], wanted, "seed {seed}");
        assert_eq!(barrier.report().applied[1..], Counts::default()[1..]);
    }
}
