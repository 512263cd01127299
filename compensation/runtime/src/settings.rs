//! User settings of a correction: limits, times, thread. Plain data in the units of the configuration.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use volcomp_guard::{ControlTimeOut, SensorLimits};
use volcomp_model::Fading;
use volcomp_vocabulary::{AxisKind, AxisName, Displacement, Mm, Rad, Um, Unit, Urad};

/// Limits of the axes of one kind, in [`Um`] for linear and in [`Urad`] for rotary axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisSettings<U> {
    /// Largest correction, in either direction.
    pub limit: U,
    /// Magnitude above which a correction is reported.
    pub warn: U,
    /// Largest change of the correction per second.
    pub slew_per_s: U,
    /// Largest change of the slew per second; infinite: unlimited.
    pub accel_per_s2: U,
    /// Largest change of the correction by a new model, anywhere in the work space, up to which no confirmation is needed.
    pub confirm: U,
    /// Size of the test shift at arming, which proves whether positions contain the correction; 0: none.
    pub test_shift: U,
}

/// The limits and times common to all controllers of a machine.
#[derive(Clone, Debug, PartialEq)]
pub struct GuardSettings {
    /// The limits of linear axes, µm.
    pub linear: AxisSettings<Um>,
    /// The limits of rotary axes, µrad; `None` if no controller has one.
    pub rotary: Option<AxisSettings<Urad>>,
    /// Largest corrections on a path without a barrier.
    pub without_barrier: WithoutBarrier,
    /// Maximum movement of the tool tip by half a step of a rotary axis, anywhere in the work space. Rotary axes with a coarser step do not
    /// correct, because the tool may be off by that amount during a step.
    pub rotary_step: Um,
    /// Maximum age of positions; from then on the correction is held.
    pub hold: Duration,
    /// Age of positions from which the correction ramps to zero.
    pub zero_after: Duration,
    /// Duration of a ramp; at least 20 cycles.
    pub ramp: Duration,
    /// Maximum time for ramping out when the program stops.
    pub stop: Duration,
    /// Time for which a preferred controller must be usable before it takes over again.
    pub hand_back: Duration,
    /// Maximum speed of axes. Positions that imply a higher speed are rejected.
    pub rapid: Rapid,
    /// Plausibility limits of temperatures.
    pub temperatures: SensorLimits,
    /// Times in which thermal terms fade to zero if their sensor is missing.
    pub fading: Fading,
}

impl GuardSettings {
    /// Default of the maximum tip movement by half a rotary step: 10 µm, reached by the usual step of 0.001° at a lever of 1.15 m.
    pub const ROTARY_STEP: Um = Um(10.0);

    /// Creates settings with these limits of linear axes and defaults otherwise: the correction is held from an age of the positions of 50 ms, and
    /// ramps to zero from 500 ms; ramp 500 ms; stop at most 5 s; a preferred controller takes over again after 2 s.
    pub fn new(linear: AxisSettings<Um>) -> Self {
        Self {
            linear,
            rotary: None,
            without_barrier: WithoutBarrier::default(),
            rotary_step: Self::ROTARY_STEP,
            hold: Duration::from_millis(50),
            zero_after: Duration::from_millis(500),
            ramp: Duration::from_millis(500),
            stop: Duration::from_secs(5),
            hand_back: Duration::from_secs(2),
            rapid: Rapid::default(),
            temperatures: SensorLimits::default(),
            fading: Fading::default(),
        }
    }

    /// Limits for the kind of `axis`, as lengths (mm) or angles (rad); `None` if there are none.
    pub fn of(&self, axis: AxisName) -> Option<AxisSettings<Displacement>> {
        match axis.kind() {
            AxisKind::Linear => {
                let length = |length: Um| Displacement::Length(length.to_mm());
                Some(self.linear.map(length))
            }
            AxisKind::Rotary => {
                let angle = |angle: Urad| Displacement::Angle(angle.to_rad());
                self.rotary.map(|rotary| rotary.map(angle))
            }
        }
    }
}

impl AxisSettings<Um> {
    /// Default test shift of linear axes; a smaller limit replaces it.
    pub const TEST_SHIFT: Um = Um(5.0);
}

impl AxisSettings<Urad> {
    /// Default test shift of rotary axes; a smaller limit replaces it.
    pub const TEST_SHIFT: Urad = Urad(20.0);
}

impl<U: Unit> AxisSettings<U> {
    /// Creates limits without an acceleration limit and a test shift, in [`Um`] for linear and in [`Urad`] for rotary axes.
    pub fn new(limit: U, slew_per_s: U) -> Self {
        Self {
            limit,
            warn: limit,
            slew_per_s,
            accel_per_s2: U::of(f64::INFINITY),
            confirm: limit,
            test_shift: U::of(0.0),
        }
    }
}

impl<U> AxisSettings<U> {
    /// Converts the settings to other units.
    pub fn map<V>(self, convert: impl Fn(U) -> V) -> AxisSettings<V> {
        AxisSettings {
            limit: convert(self.limit),
            warn: convert(self.warn),
            slew_per_s: convert(self.slew_per_s),
            accel_per_s2: convert(self.accel_per_s2),
            confirm: convert(self.confirm),
            test_shift: convert(self.test_shift),
        }
    }
}

/// Maximum speeds of axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rapid {
    /// Maximum speed of linear axes, m/min.
    pub linear_m_per_min: f64,
    /// Maximum speed of rotary axes, 1/min.
    pub rotary_rpm: f64,
}

impl Default for Rapid {
    /// 100 m/min and 200/min: the speeds of linear motors and torque motors, which few axes exceed.
    fn default() -> Self {
        Self { linear_m_per_min: 100.0, rotary_rpm: 200.0 }
    }
}

impl Rapid {
    /// Maximum speed of this kind of axis, mm/s or rad/s.
    pub fn per_s(&self, kind: AxisKind) -> Displacement {
        match kind {
            AxisKind::Linear => Displacement::Length(Mm(self.linear_m_per_min * 1000.0 / 60.0)),
            AxisKind::Rotary => {
                Displacement::Angle(Rad(self.rotary_rpm * core::f64::consts::TAU / 60.0))
            }
        }
    }
}

/// Settings of a control's barrier that must be known before the barrier is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BarrierSettings {
    /// Machine number, which seeds every checksum.
    pub machine: u16,
    /// Scan period of the control's program.
    pub scan: Duration,
}

/// Largest corrections, in either direction, on a path without a barrier. They bound the step that a wrong reading or a
/// late write may cause there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WithoutBarrier {
    /// Largest correction of a linear axis.
    pub linear: Um,
    /// Largest correction of a rotary axis.
    pub rotary: Urad,
}

impl Default for WithoutBarrier {
    /// 30 µm for linear axes and 30 µrad for rotary axes.
    fn default() -> Self {
        Self { linear: Um(30.0), rotary: Urad(30.0) }
    }
}

/// Settings of one controller path that are not part of its driver.
#[derive(Clone, Debug, PartialEq)]
pub struct PathSettings {
    /// Fixed positions of machine axes that the controller does not report; rotary axes only if in `not_driven`.
    pub fixed: BTreeMap<AxisName, Displacement>,
    /// Rotary axes without a drive, which are set by hand or never move. Only these may have a fixed position. All other rotary axes must be
    /// read, because the correction of the linear axes rotates with them.
    pub not_driven: BTreeSet<AxisName>,
    /// Whether a control without a fail-safe for a stop of the program is accepted.
    pub unwatched: bool,
    /// Whether the path carries thermal terms alone, for slow controls; positions may then be held for up to 5 s.
    pub only_thermal: bool,
    /// Maximum age of positions on this path, from which the correction is held; `None`: [`GuardSettings::hold`]. If it exceeds
    /// [`GuardSettings::zero_after`], the correction ramps to zero as soon as this age is exceeded.
    pub hold: Option<Duration>,
    /// Whether a test shift is made at arming.
    pub proves: bool,
    /// Resolution of the reported position by axis. Axes without an entry are assumed to report positions more finely than the step of their
    /// correction.
    pub position_steps: BTreeMap<AxisName, Displacement>,
    /// Maximum lag of the read-back, in writes, from 1.
    pub read_back_cycles: usize,
    /// `None`: corrections are written as plain values.
    pub barrier: Option<BarrierSettings>,
    /// Time for which a control without a barrier is watched before the first write, to detect another gateway.
    pub watch: Duration,
    /// Behaviour of a control without read-back when writes stop; `None`: it keeps its correction.
    pub time_out: Option<ControlTimeOut>,
}

impl Default for PathSettings {
    /// All axes and states are reported, and the control monitors the gateway. The test shift is
    /// made, and the read-back lags by one write. There is no barrier, and the control is watched
    /// for 2 s before the first write.
    fn default() -> Self {
        Self {
            fixed: BTreeMap::new(),
            not_driven: BTreeSet::new(),
            unwatched: false,
            only_thermal: false,
            hold: None,
            proves: true,
            position_steps: BTreeMap::new(),
            read_back_cycles: 1,
            barrier: None,
            watch: Duration::from_secs(2),
            time_out: None,
        }
    }
}

/// Scheduling of the control thread.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Realtime {
    /// The priority of SCHED_FIFO, 1 to 99; 0: not requested.
    pub priority: u8,
    /// The processor on which the thread stays; `None`: any.
    pub cpu: Option<usize>,
    /// Whether the thread times [`reference_work`](crate::reference_work) after each cycle, to compare compute times between computers.
    pub reference: bool,
}
