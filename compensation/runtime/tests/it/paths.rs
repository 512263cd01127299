//! Several paths to one control: which path writes, and what the axes receive when the path changes, also behind a barrier and with delays.

use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use volcomp_model::Machine;
use volcomp_port::{Clock, Description, Fault, Snapshot, Words};
use volcomp_runtime::{
    BarrierSettings, Cycle, CycleInput, GuardSettings, Model, PathPlan, PathSettings, PlanError,
    PositionReader, ReaderPlan, Report,
    guard::{
        ControlTimeOut, Hold, Interlock, Reasons, Request, State,
        barrier::{Barrier, REPORT_WORDS},
        protocol::Counts,
    },
};
use volcomp_vocabulary::{AxisName, Displacement, PerAxis, PerChannel};

use crate::{
    rig::{PERIOD, alone, guard, referenced, without_barrier},
    ways::{AXES, Control, Plant, Ways, barrier_of, guard_um, three_axes, value},
};

const SCAN: Duration = Duration::from_millis(2);
/// Timeout of a control, and duration of its ramp to zero.
const TIME_OUT: ControlTimeOut =
    ControlTimeOut { after: Duration::from_millis(200), to_zero: Duration::from_millis(100) };
/// EXX of 0.5 µm per mm, −25 µm at 0.
const SLOPE: &str = "EXX = { poly = [-25, 0.5] }";

fn to_barrier() -> PathSettings {
    PathSettings {
        barrier: Some(BarrierSettings { machine: 1, scan: SCAN }),
        proves: false,
        ..alone()
    }
}

/// Settings of a path whose control ramps to zero after its timeout.
fn lets_go() -> PathSettings {
    PathSettings { time_out: Some(TIME_OUT), proves: false, ..alone() }
}

/// A controller that writes these axes and reads the others of [`AXES`].
fn writing(device: &str, axes: &[AxisName]) -> Description {
    let others = AXES.iter().filter(|name| !axes.contains(name));
    Description { reads: others.copied().collect(), ..without_barrier(device, axes) }
}

/// X stops, travels 100 mm at 60 m/min from cycle `begins` on, and stops. The first path fails for one second from cycle 800 + `offset`
/// on. Returns the largest change of the correction on X by one write, µm.
fn largest_write_um(offset: u64, begins: u64, hand_back: Duration) -> f64 {
    let ways = Ways::to(Control::default(), Clock::manual());
    let guard = GuardSettings { hand_back, ..guard_um(30.0) };
    let model = three_axes(SLOPE, &guard);
    let paths = ["first", "second"]
        .map(|device| ways.path(without_barrier(device, &AXES), &model, &guard, &alone()));
    let mut cycle = ways.cycle(model, &guard, paths.into()).expect("two paths");
    let mut seen = [false; 2];
    for number in 0..2500 {
        {
            let mut control = ways.plant();
            let travels = (begins..begins + 25).contains(&number);
            *control.place.entry(AxisName::X).or_default() += if travels { 4.0 } else { 0.0 };
            let is_away = (800 + offset..1050 + offset).contains(&number);
            control.away = is_away.then_some("first");
        }
        let report = ways.step(&mut cycle, (number == 5).then_some(Request::Arm));
        seen[report.active] |= report.state == State::Compensating;
    }
    assert_eq!(seen, [true; 2], "both correct in their turn");
    ways.plant().largest * 1e3
}

/// A change of path in motion changes the correction by at most 2 µm per write, although the standby reading is up to 100 ms old, which is
/// equivalent to 26 µm.
#[test]
fn a_change_of_paths_in_motion_makes_no_step() {
    let (sooner, later) = (Duration::from_secs(2), Duration::from_millis(2050));
    for offset in (0..30).step_by(3) {
        for (begins, hand_back) in [
            (800, sooner),
            (805, sooner),
            (810, sooner),
            (1550, later),
            (1560, later),
            (1570, later),
        ] {
            let largest = largest_write_um(offset, begins, hand_back);
            assert!(
                largest <= 2.0 + 1e-6,
                "away at 800 + {offset}, travels at {begins}: {largest} µm"
            );
        }
    }
}

/// A path with lower limits and another axis order takes over: it ramps the previous correction down to its limit, without a fault.
#[test]
fn a_path_with_lower_limits_reduces_the_previous_correction_by_a_ramp() {
    let ways = Ways::to(Control::default(), Clock::manual());
    let guard = guard_um(30.0);
    let model = three_axes(SLOPE, &guard);
    let mut turned = AXES;
    turned.reverse();
    let descriptions = [without_barrier("first", &AXES), without_barrier("second", &turned)];
    let second = descriptions[1].clone();
    let plan = PathPlan::new(second, &model, &guard, &alone(), PERIOD).expect("fits");
    let mut lower = plan.limits;
    for axis in lower.axes.iter_mut().take(lower.count) {
        (axis.limit, axis.warn) = (0.010, 0.010);
    }
    let paths = descriptions.map(|of_way| ways.path(of_way, &model, &guard, &alone()));
    let mut cycle = ways.cycle(model, &guard, paths.into()).expect("two paths");
    cycle.set_limits(1, &lower).expect("lower");
    let x = || value(&ways.plant().words, AxisName::X).abs();
    for number in 0..1300 {
        ways.plant().away = (number >= 800).then_some("first");
        let report = ways.step(&mut cycle, (number == 5).then_some(Request::Arm));
        if number == 799 {
            assert_eq!((report.active, report.state), (0, State::Compensating));
            assert!((x() - 0.025).abs() < 1e-9);
        }
    }
    let report = cycle.report();
    assert_eq!((report.active, report.state), (1, State::Compensating));
    assert!((x() - 0.010).abs() < 1e-9);
    let largest = ways.plant().largest;
    assert!(largest <= 0.002 + 1e-9, "{largest} mm");
}

/// Two paths that write these axes; Z needs +20 µm at X 10 mm. With a timeout, the control of the path that writes all axes ramps to
/// zero.
fn fewer_axes(
    axes: [&[AxisName]; 2],
    time_out: Option<ControlTimeOut>,
    ways: &Ways<Control>,
) -> Result<Cycle, PlanError> {
    let guard = guard_um(30.0);
    let model = three_axes("EZX = { poly = [-25, 0.5] }", &guard);
    let paths = axes.map(|axes| {
        let is_first = axes.len() == AXES.len();
        let time_out = time_out.filter(|_| is_first);
        let description = Description {
            tells_applied: time_out.is_none(),
            ..writing(if is_first { "first" } else { "second" }, axes)
        };
        let settings = PathSettings { time_out, ..alone() };
        ways.path(description, &model, &guard, &settings)
    });
    ways.cycle(model, &guard, paths.into())
}

/// A path with additional axes is rejected if its control has no timeout: 20 µm would stay on Z.
#[test]
fn a_path_with_additional_axes_must_go_to_zero_on_its_own() {
    let ways = Ways::to(Control::at(&[(AxisName::X, 10.0)]), Clock::manual());
    let made = |axes, time_out| fewer_axes(axes, time_out, &ways).map(|_| ());
    let few = &AXES[..2];
    for axes in [[&AXES[..], few], [few, &AXES[..]]] {
        let refused = made(axes, None).expect_err("Z would be left");
        let z = AxisName::Z;
        assert!(matches!(refused, PlanError::LeavesAxis { axis, .. } if axis == z));
        assert!(made(axes, Some(TIME_OUT)).is_ok(), "it goes to zero");
    }
    let other_order = [AxisName::Z, AxisName::X, AxisName::Y];
    assert!(made([&AXES, &other_order], None).is_ok());
}

/// The first path becomes silent with 20 µm on Z: the second, which writes only X and Y, takes over once Z is at zero.
#[test]
fn fewer_axes_take_over_once_the_others_are_at_zero() {
    let ways = Ways::to(Control::at(&[(AxisName::X, 10.0)]), Clock::manual());
    let mut cycle = fewer_axes([&AXES, &AXES[..2]], Some(TIME_OUT), &ways).expect("fits");
    let mut reports: Vec<Report> = Vec::new();
    for number in 0..1500 {
        ways.clock.advance(PERIOD);
        {
            let mut control = ways.plant();
            control.away = (number >= 1000).then_some("first");
            let written = control.written.get("first").copied().unwrap_or_default();
            let silent = ways.clock.elapsed().saturating_sub(written);
            if silent > TIME_OUT.after + TIME_OUT.to_zero {
                control.words.remove(&AxisName::Z);
            }
        }
        let report = ways.run(&mut cycle, (number == 50).then_some(Request::Arm));
        let word = value(&ways.plant().words, AxisName::Z);
        assert!(report.active == 0 || word == 0.0, "cycle {number}: {word} mm are left on Z");
        reports.push(report);
    }
    assert!((reports[999].correction[2] - 0.020).abs() < 0.001);
    let waits = reports[1050].reasons;
    assert!(waits.contains(Reasons::OTHER_CHANNEL_UNKNOWN), "{waits:?}");
    let last = &reports[1499];
    assert_eq!((last.state, last.active), (State::Compensating, 1));
}

/// Three axes with a barrier, and a second path that writes two of them, whose control has a timeout as well; Z needs 120 µm. The first
/// path is cut at cycle 1500; an emergency stop that only the second reports lasts until cycle `stop_until`. Returns the largest
/// correction of Z while the second path writes, in counts, and whether that path wrote.
fn left_on_z(real_scan: Duration, time_out_scans: u16, stop_until: i32) -> (i16, bool) {
    let control = Control {
        barrier: Some(barrier_of(&AXES, 150, 25, time_out_scans)),
        ..Control::at(&[(AxisName::X, 10.0)])
    };
    let ways = Ways::to(control, Clock::manual());
    let guard = GuardSettings { zero_after: Duration::from_secs(3), ..guard_um(150.0) };
    let model = three_axes("EZZ = -120", &guard);
    let first = Description { barrier: true, ..writing("first", &AXES) };
    let second = Description { tells_applied: false, ..writing("second", &AXES[..2]) };
    let paths = [(first, to_barrier()), (second, lets_go())]
        .map(|(description, settings)| ways.path(description, &model, &guard, &settings));
    let mut cycle = ways.cycle(model, &guard, paths.into()).expect("fits");
    let (mut most, mut taken_over) = (0, false);
    for number in 0..4000 {
        ways.clock.advance(PERIOD);
        {
            let mut control = ways.plant();
            control.away = (number >= 1500).then_some("first");
            control.stop = (1500..stop_until).contains(&number);
            control.scan_until(ways.clock.elapsed(), real_scan);
        }
        let report = ways.run(&mut cycle, (number == 700).then_some(Request::Arm));
        assert!(number != 1499 || report.state == State::Compensating);
        if report.active == 1 {
            taken_over = true;
            most = most.max(ways.plant().applied()[2]);
        }
    }
    (most, taken_over)
}

/// With scans longer than configured, Z is at zero when a path with fewer axes takes over, not at 120 µm.
#[test]
fn a_slow_control_is_at_zero_when_fewer_axes_take_over() {
    let found = left_on_z(Duration::from_micros(2450), 1000, 0);
    assert_eq!(found, (0, true));
}

/// A barrier holds its correction during a stop, so the stop does not count towards the time to zero: Z is at zero at the take-over, not
/// at 112 µm.
#[test]
fn a_stop_does_not_count_towards_the_time_to_zero() {
    assert_eq!(left_on_z(SCAN, 100, 2500), (0, true));
}

/// A path with read-back, and a path over digital lines.
fn words_and_lines(ways: &Ways<Control>) -> Cycle {
    let guard = GuardSettings { ramp: Duration::from_millis(500), ..guard_um(30.0) };
    let model = three_axes(SLOPE, &guard);
    let paths = [("words", true), ("lines", false)].map(|(name, tells_applied)| {
        let description = Description { tells_applied, ..without_barrier(name, &AXES) };
        ways.path(description, &model, &guard, &PathSettings::default())
    });
    ways.cycle(model, &guard, paths.into()).expect("fits")
}

/// Runs 500 cycles after a restart, with Acknowledge and Arm, while the path with read-back does not answer and its X has this correction
/// (mm). `remembered` is the stored correction of X, mm. Returns the state, its reasons, and the largest change of X by one write, mm.
fn after_a_restart(
    x: f64,
    remembered: Option<f64>,
    acknowledged: bool,
    was_faulted: bool,
) -> (State, Reasons, f64) {
    let control =
        Control { away: Some("words"), words: [(AxisName::X, x)].into(), ..Control::default() };
    let ways = Ways::to(control, Clock::manual());
    let mut cycle = words_and_lines(&ways);
    if let Some(x) = remembered {
        let last = PerAxis::from_fn(|axis| if axis == 0 { x } else { 0.0 });
        cycle.restore(&last, Duration::from_secs(1));
    }
    for number in 0..500 {
        ways.clock.advance(PERIOD);
        let input = CycleInput {
            request: match number {
                50 if acknowledged => Some(Request::Acknowledge),
                100 => Some(Request::Arm),
                _ => None,
            },
            forbids: Reasons::FAULTED_BEFORE.when(was_faulted && number <= 50),
            ..CycleInput::default()
        };
        cycle.run(ways.clock.now(), &input, &mut || Duration::ZERO);
    }
    let report = cycle.report();
    (report.state, report.reasons, ways.plant().largest)
}

/// After a restart, lines do not take over while the silent path may still apply a correction (−25 µm stored, or none known): otherwise X
/// would move by 25 µm in one write.
#[test]
fn lines_do_not_take_over_while_a_silent_path_may_hold_a_correction() {
    for remembered in [None, Some(-0.025), Some(f64::NAN)] {
        let (state, reasons, change) = after_a_restart(-0.025, remembered, false, false);
        assert_eq!(change, 0.0, "{remembered:?}: nothing is written");
        assert_eq!(state, State::Disarmed, "{remembered:?}");
        assert!(reasons.contains(Reasons::OTHER_CHANNEL_UNKNOWN), "{reasons:?}");
    }
    for (remembered, acknowledged) in [(Some(0.0), false), (None, true), (Some(-0.025), true)] {
        let (state, reasons, change) = after_a_restart(0.0, remembered, acknowledged, false);
        assert_eq!(state, State::Compensating, "{remembered:?}: {reasons:?}");
        assert!(change <= 0.002 + 1e-9, "{remembered:?}: {change} mm");
    }
}

/// Acknowledging another fault does not acknowledge the −25 µm stored for a silent path: X moves by at most 2 µm per write.
#[test]
fn acknowledging_a_fault_does_not_clear_corrections_on_other_paths() {
    let (_, _, change) = after_a_restart(-0.025, Some(-0.025), true, true);
    assert!(change <= 0.002 + 1e-9, "{change} mm");
}

#[test]
fn corrections_left_on_lines_after_a_hand_back_are_reported() {
    let control = Control { away: Some("words"), lines: Some([].into()), ..Control::default() };
    let ways = Ways::to(control, Clock::manual());
    let mut cycle = words_and_lines(&ways);
    cycle.restore(&PerAxis::ZERO, Duration::from_secs(1));
    let x_um = || {
        let control = ways.plant();
        let lines = control.lines.as_ref().expect("other words");
        [control.um(AxisName::X), (value(lines, AxisName::X) * 1e3).round()]
    };
    let holds = |cycle: &Cycle| cycle.report().reasons.contains(Reasons::STANDBY_HOLDS);
    for n in 0..500 {
        ways.step(&mut cycle, (n == 100).then_some(Request::Arm));
    }
    assert_eq!(x_um(), [0.0, 25.0]);
    ways.plant().away = None;
    for _ in 0..2500 {
        ways.step(&mut cycle, None);
    }
    assert_eq!(cycle.report().active, 0, "{:?}", cycle.report().reasons);
    assert_eq!(x_um(), [25.0, 25.0]);
    assert!(holds(&cycle));
    for n in 0..500 {
        ways.step(&mut cycle, (n == 0).then_some(Request::Disarm));
    }
    assert_eq!(cycle.report().state, State::Disarmed);
    assert_eq!(x_um(), [0.0, 25.0]);
    assert!(holds(&cycle));
}

/// Cycle after which the scale of Z becomes silent.
const SILENT_AT: u32 = 1000;

/// Two paths to a control, and a third controller that alone reports Z for both.
fn with_scale(ways: &Ways<Control>) -> Cycle {
    let guard = guard_um(30.0);
    let model = three_axes(SLOPE, &guard);
    let paths = ["first", "second"]
        .map(|name| ways.path(without_barrier(name, &AXES[..2]), &model, &guard, &alone()));
    let scale = Description {
        reads: vec![AxisName::Z],
        tells_applied: false,
        ..without_barrier("scale", &[])
    };
    let plan = ReaderPlan::new(scale.clone(), &model, &alone()).expect("fits");
    let reader = PositionReader::new(ways.controller(scale), &plan);
    let cycle = ways.cycle(model, &guard, paths.into()).expect("fits");
    cycle.with_readers(vec![reader]).expect("room")
}

/// Runs 3000 cycles with a request to disarm in cycle `disarm_at`. Returns the number of path changes, the final state, and the word of X (µm)
/// in the cycles `look_at`.
fn with_silent_scale(disarm_at: u32, look_at: [u32; 3]) -> (u32, State, [f64; 3]) {
    let ways = Ways::to(Control::at(&[(AxisName::X, 30.0)]), Clock::manual());
    let mut cycle = with_scale(&ways);
    let (mut changes, mut active, mut words) = (0, 0, [f64::NAN; 3]);
    for n in 0..3000 {
        ways.plant().away = (n >= SILENT_AT).then_some("scale");
        for (word, at) in words.iter_mut().zip(look_at) {
            if n == at {
                *word = value(&ways.plant().words, AxisName::X) * 1e3;
            }
        }
        let request = match n {
            5 => Some(Request::Arm),
            _ if n == disarm_at => Some(Request::Disarm),
            _ => None,
        };
        let report = ways.step(&mut cycle, request);
        changes += u32::from(report.active != active);
        active = report.active;
    }
    (changes, cycle.report().state, words)
}

/// Stale positions on both paths ramp the correction out within 1.2 s. The path must not change in every cycle, because each change
/// restarts the ramp.
#[test]
fn stale_positions_on_both_paths_ramp_out() {
    let (changes, state, words) = with_silent_scale(u32::MAX, [SILENT_AT, SILENT_AT + 300, 2999]);
    assert_eq!(state, State::Holding(Hold::Lost));
    assert!((words[0].abs() - 10.0).abs() < 1.0, "{words:?}");
    assert_eq!(words[1..], [0.0; 2], "after 1.2 s");
    assert!(changes <= 1, "{changes} changes");
}

#[test]
fn disarming_with_stale_positions_ramps_out() {
    let look_at = [SILENT_AT, SILENT_AT + 30, SILENT_AT + 130];
    let (changes, state, words) = with_silent_scale(SILENT_AT + 30, look_at);
    assert_eq!(state, State::Disarmed);
    assert!((words[1].abs() - 10.0).abs() < 1.0, "{words:?}");
    assert_eq!(words[2], 0.0);
    assert!(changes <= 1, "{changes} changes");
}

/// The read-only controller hangs in an exchange of ten seconds: the cycle continues, and the correction ramps out.
#[test]
fn a_hanging_read_only_controller_delays_no_cycle() {
    let ways = Ways::to(Control::at(&[(AxisName::X, 30.0)]), Clock::system());
    let hangs = Duration::from_secs(10);
    ways.plant().hangs = hangs;
    let mut cycle = with_scale(&ways);
    cycle.start_standby_threads().expect("threads");
    let mut longest = Duration::ZERO;
    for n in 0..400 {
        std::thread::sleep(PERIOD);
        ways.plant().away = (n >= 250).then_some("scale");
        let request = match n {
            5 => Some(Request::Arm),
            260 => Some(Request::Disarm),
            _ => None,
        };
        let begun = Instant::now();
        let report = ways.run(&mut cycle, request);
        longest = longest.max(begun.elapsed());
        if n == 249 {
            assert!(report.state.is_armed(), "{report:?}");
        }
    }
    assert_eq!(cycle.report().state, State::Disarmed);
    assert_eq!(value(&ways.plant().words, AxisName::X), 0.0);
    assert!(longest < hangs, "{longest:?}");
}

const TABLE: &str = "structure = \"w C' A' b X Y Z t\"
axes.X = { travel = [-500.0, 500.0] }
axes.Y = { travel = [-500.0, 500.0] }
axes.Z = { travel = [-500.0, 500.0] }
axes.A = { travel = [-120.0, 30.0], point = [0.0, 0.0, -100.0] }
axes.C = { travel = [0.0, 360.0], modulo = 360.0 }
[errors]
EXX = 100.0
EYY = 100.0
EXC = { fourier = [0.0, 0.0, 40.0], period = 30.0 }
EZC = { fourier = [0.0, 0.0, 40.0], period = 30.0 }
";
const FIVE: [AxisName; 5] = [AxisName::X, AxisName::Y, AxisName::Z, AxisName::A, AxisName::C];

/// Digital lines take over from a barrier. Returns the corrections that the axes receive over the lines in each cycle from then on (order
/// of `FIVE`, mm and rad), and the final request.
fn lines_after_a_change(second: [AxisName; 5], place: [f64; 5]) -> (Vec<[f64; 5]>, [f64; 5]) {
    let place = FIVE.into_iter().zip(place).map(|(name, at)| {
        let at = Displacement::from_coordinate(name.kind(), at);
        (name, at.mm_or_rad())
    });
    let control = Control {
        barrier: Some(barrier_of(&FIVE, 300, 25, 100)),
        place: place.collect(),
        ..Control::default()
    };
    let ways = Ways::to(control, Clock::manual());
    let mut guard = guard();
    guard.ramp = Duration::from_secs(2);
    guard.zero_after = Duration::from_secs(3);
    let machine = Machine::parse(TABLE, "m").expect("valid");
    let model = Model::new(&machine, guard.fading).expect("compiles");
    let index = FIVE.map(|name| model.index_of(name).expect("an axis"));
    let paths = [true, false].map(|is_first| {
        let (device, names, settings) =
            if is_first { ("first", FIVE, to_barrier()) } else { ("second", second, lets_go()) };
        let mut description = Description {
            barrier: is_first,
            tells_applied: is_first,
            ..without_barrier(device, &names)
        };
        for axis in &mut description.axes {
            axis.resolution = Displacement::from_micro(axis.name.kind(), 1.0);
        }
        ways.path(description, &model, &guard, &settings)
    });
    let mut cycle = ways.cycle(model, &guard, paths.into()).expect("two paths");
    let mut got = Vec::new();
    for number in 0..4000 {
        ways.clock.advance(PERIOD);
        {
            let mut control = ways.plant();
            control.away = (number >= 1800).then_some("first");
            control.scan_until(ways.clock.elapsed(), SCAN);
        }
        let report = ways.run(&mut cycle, (number == 700).then_some(Request::Arm));
        if number == 1799 {
            assert_eq!(report.state, State::Compensating, "{:?}", report.reasons);
        }
        if report.active == 1 {
            let control = ways.plant();
            assert_eq!(control.applied(), Counts::default());
            got.push(FIVE.map(|name| value(&control.words, name)));
        }
    }
    assert!(got.len() > 1000, "the lines took over: {}", got.len());
    (got, index.map(|index| cycle.report().wanted[index]))
}

/// Before the program ended, the second path showed an emergency stop; now it is silent. An answer of the first path alone does not permit arming.
#[test]
fn a_restored_interlock_holds_until_the_same_path_clears_it() {
    let ways = Ways::to(Control::default(), Clock::manual());
    let guard = guard_um(30.0);
    let model = three_axes(SLOPE, &guard);
    let paths = ["first", "second"]
        .map(|device| ways.path(without_barrier(device, &AXES), &model, &guard, &alone()));
    let mut cycle = ways.cycle(model, &guard, paths.into()).expect("two paths");
    cycle.restore_interlock(1, Interlock::of(Reasons::EMERGENCY_STOP));
    ways.plant().away = Some("second");
    let mut arm = || {
        for number in 0..500 {
            ways.step(&mut cycle, (number == 50).then_some(Request::Arm));
        }
        *cycle.report()
    };
    let report = arm();
    assert_eq!(report.state, State::Disarmed, "{report:?}");
    let unseen = Reasons::EMERGENCY_STOP | Reasons::INTERLOCK_UNSEEN;
    assert!(report.reasons.contains(unseen), "{report:?}");
    assert!(report.paths[1].reasons.contains(unseen), "{report:?}");
    ways.plant().away = None;
    assert_eq!(arm().state, State::Compensating);
}

/// Lines with another axis order take over at standstill: they start at zero, and no axis exceeds the ramp by more than a step.
#[test]
fn lines_with_their_axes_in_another_order_take_over_by_a_ramp() {
    let [x, y, z, a, c] = FIVE;
    for place in [
        [300.0, 250.0, 0.0, 20.0, 100.0],
        [-400.0, 400.0, 0.0, 20.0, 107.0],
        [400.0, -300.0, 100.0, -30.0, 15.0],
    ] {
        for second in [FIVE, [c, a, z, x, y]] {
            let (got, wanted) = lines_after_a_change(second, place);
            for (cycle, words) in got.iter().enumerate() {
                // The ramp of 2 s takes 500 cycles; two cycles of delay and one step of rounding are allowed.
                let ramp = (cycle as f64 / 500.0).min(1.0);
                for (i, word) in words.iter().enumerate() {
                    let beyond = (word - ramp * wanted[i]).abs();
                    assert!(
                        beyond <= 0.003,
                        "{second:?} at {place:?}, cycle {cycle}: {word} of {}",
                        FIVE[i]
                    );
                }
            }
        }
    }
}

/// Two paths to one control's barrier, with delays of some cycles.
struct Slow {
    barrier: Barrier,
    x: f64,
    late: usize,
    first_is_away: bool,
    reports: VecDeque<Words>,
    air: VecDeque<(usize, Vec<u16>)>,
    mailboxes: [Option<Vec<u16>>; 2],
    cycle: usize,
}

impl Slow {
    fn new(late: usize) -> Self {
        Self {
            barrier: barrier_of(&AXES, 150, 50, 100),
            x: 0.0,
            late,
            first_is_away: false,
            reports: VecDeque::new(),
            air: VecDeque::new(),
            mailboxes: [None, None],
            cycle: 0,
        }
    }

    fn cycle(&mut self) {
        self.cycle += 1;
        while self.air.front().is_some_and(|(at, _)| *at <= self.cycle) {
            if let Some((_, words)) = self.air.pop_front() {
                self.mailboxes[0] = Some(words);
            }
        }
        for _ in 0..2 {
            let boxes: Vec<&[u16]> = self.mailboxes.iter().flatten().map(Vec::as_slice).collect();
            self.barrier.scan(&boxes, false);
        }
        let mut words = [0; REPORT_WORDS];
        let length = self.barrier.report().encode(&mut words);
        self.reports.push_back(Words::new(&words[..length]).expect("fits"));
        while self.reports.len() > self.late + 1 {
            self.reports.pop_front();
        }
    }
}

impl Plant for Slow {
    fn read(&mut self, way: &Description, clock: &Clock) -> Result<Snapshot, Fault> {
        if way.device == "first" && self.first_is_away {
            return Err(Fault::TimedOut);
        }
        let mut snapshot = referenced(PerChannel::leading([self.x]), clock.now(), None);
        snapshot.report = self.reports.front().copied();
        Ok(snapshot)
    }

    fn post(&mut self, way: &Description, frame: &Words) -> Result<(), Fault> {
        if way.device == "first" && self.first_is_away {
            return Err(Fault::TimedOut);
        }
        self.air.push_back((self.cycle + self.late, frame.as_slice().to_vec()));
        Ok(())
    }
}

fn slow_ways(late: usize) -> (Ways<Slow>, Cycle) {
    let ways = Ways::to(Slow::new(late), Clock::manual());
    let guard = guard_um(150.0);
    let model = three_axes("EXX = { poly = [-75, 1.5] }", &guard);
    let settings = PathSettings {
        barrier: Some(BarrierSettings { machine: 1, scan: Duration::from_millis(2) }),
        read_back_cycles: 2 * late + 2,
        proves: false,
        ..alone()
    };
    let describe = |device| Description { barrier: true, ..without_barrier(device, &AXES) };
    let paths =
        ["first", "second"].map(|device| ways.path(describe(device), &model, &guard, &settings));
    let cycle = ways.cycle(model, &guard, paths.into()).expect("fits");
    (ways, cycle)
}

/// X moves up for 80 cycles and down for 80 within the slew, then the first path takes over again: between the turning points the axis
/// moves back by at most 1 µm.
#[test]
fn a_hand_back_in_motion_reverses_no_axis() {
    let mut looked = 0;
    for late in [0, 2, 4, 6] {
        for offset in [0, 20, 40, 60] {
            let (ways, mut cycle) = slow_ways(late);
            let mut applied = Vec::new();
            let mut handed_back = None;
            let mut active = 0;
            for number in 0..2200_usize {
                {
                    let mut plant = ways.plant();
                    let phase = (number + offset) % 160;
                    let up = if phase < 80 { phase } else { 160 - phase };
                    plant.x = 10.0 + up as f64;
                    plant.first_is_away = (900..1150).contains(&number);
                    plant.cycle();
                    applied.push(plant.barrier.memory().applied[0]);
                }
                let report = ways.step(&mut cycle, (number == 600).then_some(Request::Arm));
                if active == 1 && report.active == 0 {
                    assert!(report.state.is_armed(), "{:?}", report.state);
                    handed_back = Some(number);
                }
                active = report.active;
            }
            let at = handed_back.expect("handed back");
            let phase = (at + offset) % 80;
            if !(25..50).contains(&phase) {
                continue;
            }
            looked += 1;
            let about = &applied[at - 10..at + 20];
            let sign = (applied[at] - applied[at - 10]).signum();
            let mut furthest = about[0] * sign;
            for value in about {
                furthest = furthest.max(value * sign);
                let back = furthest - value * sign;
                assert!(back <= 1, "{late} late, offset {offset}: {back} um in {about:?}");
            }
        }
    }
    assert!(looked > 0);
}
