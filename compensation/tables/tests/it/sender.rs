//! The sender with the reference control, on a wire that drops writes, and with senders that stop: the previous map stays active until
//! its timeout, and the applied correction never moves faster than its rate.

use volcomp_tables::{
    Exchange, GRID_AXES, Layout, LimitError, Map, OUTPUTS, SendError, Sender, SenderLimits, Step,
    barrier, build,
    control::{FRAME_WORDS, Lookup, REPORT_WORDS, Settings},
    protocol::{Counts, Refusal},
    vocabulary::AxisName::{X, Y},
};

use crate::world;

const MACHINE: u16 = 77;

/// Control whose mailbox is written over the wire.
struct Control {
    lookup: Lookup,
    settings: Settings,
    mailbox: [u16; FRAME_WORDS],
    position: [i32; GRID_AXES],
    applied: [i16; OUTPUTS],
    /// Largest change between two scans, steps.
    largest: u16,
    writes: usize,
    /// Every n-th write is lost; 0 for none.
    loses: usize,
    /// Whether one word is read back wrong once.
    lies: bool,
}

impl Control {
    fn new() -> Self {
        let settings = Settings {
            grid: Layout::of([X, Y]).expect("each once"),
            outputs: barrier::Settings {
                axes: Layout::of([X, Y]).expect("each once"),
                machine: MACHINE,
                limit: Counts::leading([100; OUTPUTS]),
                rate: Counts::leading([3; OUTPUTS]),
                step_scans: 1,
                hold_scans: 10,
                time_out_scans: 40,
            },
            position_step_millionths: [1000; GRID_AXES],
            output_step_nm: [1000; OUTPUTS],
            capacity: 600,
            turned: [5; GRID_AXES],
        };
        let lookup = Lookup::start(settings, 5, 0, [0; OUTPUTS]).expect("settings");
        Self {
            lookup,
            settings,
            mailbox: [0; FRAME_WORDS],
            position: [700_000, 200_000, 0, 0, 0],
            applied: [0; OUTPUTS],
            largest: 0,
            writes: 0,
            loses: 0,
            lies: false,
        }
    }

    fn scan(&mut self) {
        self.lookup.scan(&self.mailbox, &self.position, false);
        let now = self.lookup.memory().applied;
        for (was, is) in self.applied.iter().zip(now) {
            self.largest = self.largest.max(was.abs_diff(is));
        }
        self.applied = now;
    }
}

impl Exchange for Control {
    type Error = ();

    fn report(&mut self) -> Result<Vec<u16>, ()> {
        self.scan();
        let mut words = [0; REPORT_WORDS];
        let count = self.lookup.report().encode(&mut words);
        Ok(words[..count].to_vec())
    }

    fn write(&mut self, frame: &[u16; FRAME_WORDS]) -> Result<(), ()> {
        self.writes += 1;
        if self.loses == 0 || !self.writes.is_multiple_of(self.loses) {
            self.mailbox = *frame;
        }
        self.scan();
        Ok(())
    }

    fn buffer(&mut self, buffer: u16, count: usize) -> Result<Vec<u16>, ()> {
        let mut words = self.lookup.buffer(usize::from(buffer))[..count].to_vec();
        if std::mem::take(&mut self.lies) {
            words[count - 1] ^= 1;
        }
        Ok(words)
    }
}

/// Map that corrects X by 80 µm along X and Y by 50 µm along Y, multiplied by `times`.
fn map(counter: u16, times: f64) -> Map {
    let request = volcomp_tables::Request { counter, words: 600, ..world::request(2, 2, 0.5) };
    let field = |at: &[f64; GRID_AXES]| {
        let bend = 1e-6 * (at[0] - 500.0).powi(2) * 0.1;
        [times * (0.08 * at[0] / 1000.0 - bend), times * 0.05 * at[1] / 1000.0, 0.0]
    };
    build(&request, &field).expect("a map").map
}

fn allowed() -> SenderLimits {
    SenderLimits {
        limit_mm: 0.1,
        slew_mm_per_s: 0.3,
        zero_after_s: 0.4,
        scan_s: 0.01,
        capacity: 600,
    }
}

fn sender(map: &Map, owner: u16) -> Sender {
    Sender::new(map.clone(), MACHINE, owner, allowed()).expect("within the limits")
}

/// Runs steps until the map is active in the control; returns their number.
fn bring(sender: &mut Sender, control: &mut Control) -> usize {
    for count in 1..2000 {
        if sender.step(control).expect("no fault that lasts") == Step::Kept {
            return count;
        }
    }
    panic!("not in use: {:?}", control.lookup.report());
}

#[test]
fn the_active_map_is_reported_during_a_transfer() {
    let mut control = Control::new();
    let mut first = sender(&map(1, 1.0), 9);
    assert_eq!(first.in_use(), None, "nothing was read");
    bring(&mut first, &mut control);
    assert_eq!(first.in_use(), Some(1));
    first.replace(map(2, 0.5)).expect("within the limits");
    while first.step(&mut control) == Ok(Step::Loading) {
        assert_eq!(first.in_use(), Some(1));
    }
    assert_eq!(first.in_use(), Some(2));
    // The frames stop for longer than the timeout, during the transfer of a third map.
    first.replace(map(3, 1.0)).expect("within the limits");
    assert_eq!(first.step(&mut control), Ok(Step::Loading));
    assert_eq!(first.in_use(), Some(2));
    for _ in 0..50 {
        control.scan();
    }
    assert!(first.step(&mut control).is_ok());
    assert_eq!(first.in_use(), None);
}

/// Keeps the map active for this number of steps.
fn keep(sender: &mut Sender, control: &mut Control, steps: usize) {
    for _ in 0..steps {
        sender.step(control).expect("it stays");
    }
}

#[test]
fn a_map_is_transferred_and_kept() {
    let mut control = Control::new();
    let map = map(3, 1.0);
    let mut sender = sender(&map, 9);
    bring(&mut sender, &mut control);
    keep(&mut sender, &mut control, 200);
    let report = control.lookup.report();
    assert!(report.valid && report.counter == 3 && report.of.owner == 9, "{report:?}");
    let wanted = [0.08 * 700.0 - 4.0, 0.05 * 200.0].map(f64::round);
    for (applied, wanted) in report.of.applied.iter().zip(wanted) {
        assert!((f64::from(*applied) - wanted).abs() <= 1.0, "{report:?}");
    }
    assert_eq!(control.largest, 3, "the way there is at the control's rate");
}

#[test]
fn lost_writes_and_a_wrong_word_only_cost_time() {
    let map = map(3, 1.0);
    let mut whole = Control::new();
    let without = bring(&mut sender(&map, 9), &mut whole);
    for loses in [2, 3, 5] {
        let mut control = Control::new();
        control.loses = loses;
        control.lies = true;
        let mut sender = sender(&map, 9);
        let with = bring(&mut sender, &mut control);
        assert!(with > without, "{with} {without}");
        let buffer = usize::from(control.lookup.report().buffer);
        assert_eq!(control.lookup.buffer(buffer)[..map.words().len()], *map.words());
    }
}

/// A sender stops during the transfer of a second map: the first map stays active until the timeout, then both are discarded and the
/// correction ramps to zero at the control's rate.
#[test]
fn a_lost_sender_ramps_to_zero() {
    let mut control = Control::new();
    let mut first = sender(&map(3, 1.0), 9);
    bring(&mut first, &mut control);
    keep(&mut first, &mut control, 200);
    let full = control.applied;
    // The sender is given another map, and stops during its transfer.
    first.replace(map(4, -1.0)).expect("within the limits");
    for _ in 0..3 {
        assert_eq!(first.step(&mut control), Ok(Step::Loading));
    }
    let report = control.lookup.report();
    assert!(report.loading.is_some_and(|(counter, next)| counter == 4 && next > 0), "{report:?}");
    assert!(report.valid && report.counter == 3 && control.applied == full, "{report:?}");
    control.largest = 0;
    for _ in 0..39 {
        control.scan();
    }
    assert_eq!(control.applied, full, "before the time is out");
    for _ in 0..100 {
        control.scan();
    }
    let report = control.lookup.report();
    assert!(
        !report.valid && report.of.applied == Counts::default() && report.of.owner == 0,
        "{report:?}"
    );
    assert_eq!(control.largest, 3, "at the control's rate");
    // The next sender starts from the beginning.
    bring(&mut sender(&map(4, -1.0), 10), &mut control);
}

/// A sender's second map: the first stays active until the second is complete, then every axis moves directly to its new value at the
/// control's rate, not through zero. Lost writes only cost time.
#[test]
fn a_second_map_is_swapped_in_without_a_jump() {
    for loses in [0, 3] {
        let mut control = Control::new();
        let mut first = sender(&map(3, 1.0), 9);
        bring(&mut first, &mut control);
        keep(&mut first, &mut control, 200);
        let from = control.applied;
        (control.largest, control.loses) = (0, loses);
        first.replace(map(4, 0.5)).expect("within the limits");
        let mut way = vec![from];
        for _ in 0..2000 {
            first.step(&mut control).expect("no fault that lasts");
            assert!(control.lookup.report().valid, "a map is in use at all times");
            way.push(control.applied);
        }
        let report = control.lookup.report();
        assert_eq!(report.counter, 4, "{report:?}");
        let to = control.applied;
        for output in 0..2 {
            assert!(to[output] < from[output] - 4, "{from:?} to {to:?}");
            let between = to[output]..=from[output];
            assert!(way.iter().all(|at| between.contains(&at[output])), "{way:?}");
            assert!(way.is_sorted_by(|was, is| is[output] <= was[output]));
        }
        assert!(control.largest <= 3, "at the control's rate");
    }
}

#[test]
fn a_second_sender_sends_nothing() {
    let mut control = Control::new();
    let mut first = sender(&map(3, 1.0), 9);
    bring(&mut first, &mut control);
    let (mailbox, writes) = (control.mailbox, control.writes);
    // This includes a sender that has the same owner number by chance.
    for owner in [10, 9] {
        let found = sender(&map(4, -1.0), owner).step(&mut control);
        assert!(matches!(found, Err(SendError::Held { by: 9, .. })), "{found:?}");
    }
    assert_eq!((control.mailbox, control.writes), (mailbox, writes));
    keep(&mut first, &mut control, 20);
    assert!(control.lookup.report().valid);
}

/// The map at the control becomes invalid when the sequence number of the frames stops advancing, as in a frozen mailbox.
#[test]
fn a_stale_mailbox_keeps_nothing() {
    let mut control = Control::new();
    let mut sender = sender(&map(3, 1.0), 9);
    bring(&mut sender, &mut control);
    let before = control.mailbox;
    // Every write is lost from now on, which the sender does not detect.
    control.loses = 1;
    for _ in 0..60 {
        let _ = sender.step(&mut control);
    }
    assert_eq!(control.mailbox, before);
    assert!(!control.lookup.report().valid);
    // When the wire works again, the transfer restarts.
    control.loses = 0;
    bring(&mut sender, &mut control);
}

type Change = fn(&mut Settings);

#[test]
fn limits_of_sender_and_control_are_checked() {
    let large = Sender::new(map(3, 2.0), MACHINE, 9, allowed());
    assert!(matches!(large, Err(LimitError::Value { .. })), "{large:?}");
    let small = SenderLimits { capacity: 70, ..allowed() };
    let found = Sender::new(map(3, 1.0), MACHINE, 9, small);
    assert!(matches!(found, Err(LimitError::Words { .. })), "{found:?}");
    let change: [(Change, &str); 3] = [
        (|s| s.outputs.limit[1] = 101, "accepts corrections up to"),
        (|s| s.outputs.rate[0] = 4, "moves a correction at"),
        (|s| s.outputs.time_out_scans = 41, "begins to go to zero"),
    ];
    for (change, expected) in change {
        let mut control = Control::new();
        change(&mut control.settings);
        control.lookup = Lookup::start(control.settings, 5, 0, [0; OUTPUTS]).expect("settings");
        let found = sender(&map(3, 1.0), 9).step(&mut control);
        let Err(SendError::Limit(limit)) = found else {
            panic!("{found:?}, expected: {expected}");
        };
        assert!(limit.to_string().contains(expected), "{limit}");
        assert_eq!(control.writes, 0, "{limit}");
    }
}

/// The control's limit is below the corrections of the map: the transfer is repeated a limited number of times, then fails with `Refused`.
#[test]
fn a_rejected_map_stops_the_sender() {
    let mut control = Control::new();
    control.settings.outputs.limit = Counts::leading([20; OUTPUTS]);
    control.lookup = Lookup::start(control.settings, 5, 0, [0; OUTPUTS]).expect("settings");
    let mut sender = sender(&map(3, 1.0), 9);
    let found = (0..200).find_map(|_| sender.step(&mut control).err());
    assert_eq!(found, Some(SendError::Refused(Refusal::Value)));
    assert!(!control.lookup.report().valid);
}
