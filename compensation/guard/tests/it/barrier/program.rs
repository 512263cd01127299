//! The reference barrier as the program of a simulated control.

use std::time::Duration;

use volcomp_guard::{
    barrier::{Program, Protection, Report, SettingsError},
    protocol::{Counts, Refusal, ReportStatus, Session},
    vocabulary::{AxisName, Displacement, Mm, PerChannel, Rad},
};
use volcomp_port::{Axis, ControlProgram};

use super::words;

fn axes() -> Vec<Axis> {
    [AxisName::X, AxisName::Y, AxisName::C]
        .map(|name| Axis {
            name,
            includes_correction: false,
            resolution: match name {
                AxisName::C => Displacement::Angle(Rad(1e-5)),
                _ => Displacement::Length(Mm(0.001)),
            },
            largest: (name == AxisName::Y).then_some(Displacement::Length(Mm(0.1))),
        })
        .to_vec()
}

#[test]
fn physical_units_become_counts_and_scans() {
    let settings = Protection::default().settings(&axes()).expect("valid");
    assert_eq!(settings.axes.number(), 126);
    // 250 µm for X; the maximum value of the device for Y; 250 µrad in steps of 10 µrad for C.
    assert_eq!(settings.limit, PerChannel::leading([250, 100, 25]));
    // C: 1000 µrad/s is 0.2 counts per scan, thus one step in five scans. X and Y: 2 counts per scan.
    assert_eq!(settings.step_scans, 5);
    assert_eq!(settings.rate, PerChannel::leading([10, 10, 1]));
    assert_eq!((settings.hold_scans, settings.time_out_scans), (25, 100));
}

#[test]
fn invalid_protections_are_refused() {
    let cases: [fn(&mut Protection); 4] = [
        |protection| protection.rate_per_s = Mm(0.0),
        |protection| protection.rate_rotary_per_s = Rad(f64::NAN),
        |protection| protection.scan = Duration::ZERO,
        |protection| protection.time_out = Duration::from_millis(60),
    ];
    for change in cases {
        let mut protection = Protection::default();
        change(&mut protection);
        assert!(protection.settings(&axes()).is_err(), "{protection:?}");
    }
    let default = Protection::default();
    let below = Protection { limit: Mm(0.0005), ..default };
    assert_eq!(below.settings(&axes()), Err(SettingsError::Counts { axis: 0, found: 0 }));
    assert!(default.settings(&[]).is_err());
    assert!(default.settings(&axes().repeat(4)).is_err());
}

/// A restart increments the epoch and keeps the axes where they are; a frame from before the restart is rejected.
#[test]
fn a_restart_forgets_the_owner_and_keeps_epoch_and_axes() {
    let settings = Protection::default().settings(&axes()).expect("valid");
    let mut program = Program::new(settings).expect("valid");
    let decode = |words: &volcomp_port::Words| {
        Report::decode(settings.machine, settings.axes, words.as_slice()).expect("a whole report")
    };
    let mut session = Session::new(7);
    let goal = PerChannel::leading([30, -20, 3]);
    let mut mailbox = Vec::new();
    let mut report = decode(&program.scan(&[], false));
    for _ in 0..40 {
        assert!(matches!(session.read(report.head()), ReportStatus::Confirmed { .. }));
        mailbox = words(&settings, &session.frame(&goal).expect("a report was read"));
        report = decode(&program.scan(&[&mailbox], false));
    }
    assert_eq!((program.applied(), report.owner), (goal, 7));
    let held = program.applied();
    program.restart(&held);
    let after = decode(&program.scan(&[&mailbox], false));
    assert_eq!(after.epoch, report.epoch.wrapping_add(1));
    assert_eq!((after.owner, after.refusal), (0, Refusal::Epoch));
    assert_eq!(after.applied, goal);
    for _ in 0..settings.time_out_scans + 40 {
        program.scan(&[&mailbox], false);
    }
    assert_eq!(program.applied(), Counts::default());
}
