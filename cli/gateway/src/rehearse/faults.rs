//! Catalogue of faults of the simulated machine, the connection to it, and the gateway.

use std::time::Duration;

use volcomp_port::inject::{Faults, Injection, Lie};

/// A fault of the catalogue.
#[derive(Clone, Copy, Debug)]
pub struct Fault {
    /// Name, as given to `--fault`.
    pub name: &'static str,
    /// Description of the fault.
    pub meaning: &'static str,
    pub(super) act: FaultAction,
    /// True if the fault causes a step that cannot be detected without a barrier; only the limit bounds the step.
    pub(super) is_unseen_without_barrier: bool,
    /// True if the gateway reads that the machine may be moved although it may not; only a barrier can hold the
    /// correction then.
    pub(super) hides_interlock: bool,
}

#[derive(Clone, Copy, Debug)]
pub(super) enum FaultAction {
    Nothing,
    Chance(Faults),
    Directed(Injection),
    /// Once every `every` cycles, the next `readings` readings report the position of the first axis mirrored
    /// between the ends of its travel.
    OtherEnd {
        every: u64,
        readings: u32,
    },
    /// Writes are delayed and all delivered at the end.
    HeldBack,
    EmergencyStop,
    Alarm,
    Unreferenced,
    /// The emergency stop is pressed, but readings do not show it.
    HiddenStop,
    /// As `HiddenStop`, but at random times.
    HiddenStopByChance,
    /// The control restarts; its words keep their values.
    Reset,
    /// The control is power-cycled; its words are cleared.
    PowerUp,
    ProgramStopped,
    Garbage,
    /// The gateway is killed without ramping out, then restarted.
    Restart,
    /// The connection is lost for longer than the guard accepts missing positions.
    PositionsLost,
    /// A temperature jumps by 15 K.
    SensorJump,
    SensorCorrupt,
}

const NONE: Faults = Faults {
    delay: Duration::ZERO,
    jitter: false,
    drop: 0.0,
    corrupt: 0.0,
    freeze: 0.0,
    disconnect: 0.0,
    calls: 20,
    lie: 0.0,
    constant: 0.0,
    late_write: 0.0,
    double_write: 0.0,
    torn_write: 0.0,
    reordered_write: 0.0,
    late_answer: 0.0,
    frozen_positions: 0.0,
    stop_after_read: 0.0,
    stop_before_write: 0.0,
    stop: Duration::from_millis(800),
    dropped_flag: 0.0,
    flicker: 0.0,
    lag: 0,
};

/// Probability of a random fault per call.
const CHANCE: f64 = 0.1;
/// Probability per call of a random fault that lasts or stops the control.
const SELDOM: f64 = 0.02;

const ALL: Faults = Faults {
    drop: SELDOM,
    corrupt: SELDOM,
    freeze: SELDOM,
    disconnect: 0.005,
    lie: SELDOM,
    constant: SELDOM,
    late_write: SELDOM,
    double_write: SELDOM,
    torn_write: SELDOM,
    reordered_write: SELDOM,
    late_answer: SELDOM,
    frozen_positions: SELDOM,
    stop_after_read: 0.002,
    stop_before_write: 0.002,
    flicker: SELDOM,
    ..NONE
};

const fn fault(name: &'static str, meaning: &'static str, act: FaultAction) -> Fault {
    Fault { name, meaning, act, is_unseen_without_barrier: false, hides_interlock: false }
}

const fn unseen(name: &'static str, meaning: &'static str, act: FaultAction) -> Fault {
    Fault { is_unseen_without_barrier: true, ..fault(name, meaning, act) }
}

const fn hiding(name: &'static str, meaning: &'static str, act: FaultAction) -> Fault {
    Fault { hides_interlock: true, ..fault(name, meaning, act) }
}

const fn lie(lie: Lie) -> FaultAction {
    FaultAction::Directed(Injection::Lie { lie, readings: 5 })
}

/// A wrong position of the first axis: `factor` · position + `add`.
const fn wrong_position(factor: f64, add: f64) -> FaultAction {
    FaultAction::Directed(Injection::WrongPosition { axis: 0, factor, add, readings: 20 })
}

/// All faults, in the order of the rehearsal.
#[rustfmt::skip]
pub const CATALOGUE: &[Fault] = &[
    fault("none", "no fault: start, ramp, correction", FaultAction::Nothing),
    // Random faults.
    fault("delay", "a busy network", FaultAction::Chance(Faults { delay: Duration::from_millis(1), jitter: true, ..NONE })),
    fault("drop", "answers that are lost", FaultAction::Chance(Faults { drop: CHANCE, ..NONE })),
    fault("corrupt", "positions that are wrong or no number", FaultAction::Chance(Faults { corrupt: CHANCE, ..NONE })),
    unseen("freeze", "a module that answers from its memory", FaultAction::Chance(Faults { freeze: SELDOM, ..NONE })),
    fault("disconnect", "a cable that is pulled and plugged in", FaultAction::Chance(Faults { disconnect: SELDOM, ..NONE })),
    unseen("lie", "read-backs that are wrong", FaultAction::Chance(Faults { lie: CHANCE, ..NONE })),
    unseen("constant", "read-backs that stay as they are", FaultAction::Chance(Faults { constant: SELDOM, ..NONE })),
    unseen("late_write", "writes that arrive late", FaultAction::Chance(Faults { late_write: CHANCE, ..NONE })),
    unseen("double_write", "writes that arrive twice", FaultAction::Chance(Faults { double_write: CHANCE, ..NONE })),
    fault("torn_write", "words read while they are written", FaultAction::Chance(Faults { torn_write: CHANCE, ..NONE })),
    unseen("reordered_write", "writes that overtake one another", FaultAction::Chance(Faults { reordered_write: CHANCE, ..NONE })),
    fault("late_answer", "answers just within the deadline", FaultAction::Chance(Faults { late_answer: CHANCE, ..NONE })),
    fault("frozen_positions", "positions that stay as they are", FaultAction::Chance(Faults { frozen_positions: SELDOM, ..NONE })),
    fault("stop_after_read", "the program pauses after a reading", FaultAction::Chance(Faults { stop_after_read: SELDOM, ..NONE })),
    fault("stop_before_write", "the program pauses before a write", FaultAction::Chance(Faults { stop_before_write: SELDOM, ..NONE })),
    hiding("dropped_flag", "an emergency stop that is seen at times", FaultAction::HiddenStopByChance),
    fault("flicker", "a count that flickers", FaultAction::Chance(Faults { flicker: CHANCE, ..NONE })),
    fault("lag", "positions five readings late", FaultAction::Chance(Faults { lag: 5, ..NONE })),
    unseen("all", "all of these at once", FaultAction::Chance(ALL)),
    // Injected faults.
    fault("lie_value", "five read-backs with a wrong value", lie(Lie::Value)),
    fault("lie_not_a_number", "five read-backs that are no number", lie(Lie::NotANumber)),
    unseen("lie_other_axis", "five read-backs of another axis", lie(Lie::OtherAxis)),
    fault("lie_torn", "five read-backs that are torn", lie(Lie::Torn)),
    unseen("lie_zero", "five read-backs of zero", lie(Lie::Zero)),
    unseen("constant_100", "100 read-backs that stay as they are", FaultAction::Directed(Injection::Constant { readings: 100 })),
    unseen("late_write_50", "a write that arrives 50 calls late", FaultAction::Directed(Injection::LateWrite { calls: 50 })),
    unseen("double_write_50", "a write that arrives again after 50 calls", FaultAction::Directed(Injection::DoubleWrite { calls: 50 })),
    fault("torn_write_one", "single writes that are torn", FaultAction::Directed(Injection::TornWrite)),
    unseen("reordered_one", "single writes that are overtaken", FaultAction::Directed(Injection::ReorderedWrite)),
    unseen("held_back", "writes that arrive after seconds", FaultAction::HeldBack),
    fault("late_answer_one", "single answers that are late", FaultAction::Directed(Injection::LateAnswer(Duration::from_millis(100)))),
    fault("frozen_100", "100 readings of the same position", FaultAction::Directed(Injection::FrozenPositions { readings: 100 })),
    fault("position_jump", "20 readings of a position 4 m away", wrong_position(1.0, 4000.0)),
    fault("position_jump_within", "20 readings of a position elsewhere in the travel", FaultAction::OtherEnd { every: 100, readings: 20 }),
    fault("position_alternates", "every other position is elsewhere in the travel", FaultAction::OtherEnd { every: 2, readings: 1 }),
    fault("position_inches", "20 readings of a position in inches", wrong_position(1.0 / 25.4, 0.0)),
    fault("stop_read_2s", "the program pauses for 2 s after a reading", FaultAction::Directed(Injection::StopAfterRead(Duration::from_secs(2)))),
    fault("stop_write_2s", "the program pauses for 2 s before a write", FaultAction::Directed(Injection::StopBeforeWrite(Duration::from_secs(2)))),
    hiding("hidden_stop", "an emergency stop that is not seen", FaultAction::HiddenStop),
    fault("flicker_one", "single counts that flicker", FaultAction::Directed(Injection::Flicker { axis: 0 })),
    fault("lag_20", "positions 20 readings late", FaultAction::Directed(Injection::Lag(20))),
    fault("disconnect_50", "50 calls without a connection", FaultAction::Directed(Injection::Disconnect { calls: 50 })),
    // Faults of the control, the gateway and the sensors.
    fault("emergency_stop", "the emergency stop is pressed", FaultAction::EmergencyStop),
    fault("alarm", "the control has an alarm", FaultAction::Alarm),
    fault("unreferenced", "the axes lose their reference", FaultAction::Unreferenced),
    fault("reset", "the control starts anew", FaultAction::Reset),
    fault("power_up", "the control is switched off and on", FaultAction::PowerUp),
    fault("program_stopped", "the program in the control stops", FaultAction::ProgramStopped),
    fault("garbage", "another sender writes random words", FaultAction::Garbage),
    fault("restart", "the gateway is ended and started anew", FaultAction::Restart),
    fault("positions_lost", "the connection is gone for long", FaultAction::PositionsLost),
    fault("sensor_jump", "a temperature jumps by 15 K", FaultAction::SensorJump),
    fault("sensor_corrupt", "temperatures that are wrong or no number", FaultAction::SensorCorrupt),
];
