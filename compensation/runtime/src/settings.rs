//! The settings of a correction that a person chooses: limits, times, thread. Plain data in the units of the
//! configuration.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use volcomp_guard::{ControlTimeOut, SensorLimits};
use volcomp_model::Fading;
use volcomp_vocabulary::{AxisKind, AxisName, Displacement, Mm, Rad, Um, Unit, Urad};

/// The limits of the axes of one kind: lengths in [`Um`] for linear, angles in [`Urad`] for rotary axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisSettings<U> {
    /// The largest correction, in either direction.
    pub limit: U,
    /// Corrections above are reported.
    pub warn: U,
    /// The largest change of the correction in a second.
    pub slew_per_s: U,
    /// The largest change of the slew in a second; infinite: not limited.
    pub accel_per_s2: U,
    /// A change of model that moves the correction at a corner of the work space by more needs a confirmation.
    pub confirm: U,
    /// The shift at arming that shows whether positions contain the correction; 0: not made.
    pub test_shift: U,
}

/// The limits and times that hold for every controller of a machine.
#[derive(Clone, Debug, PartialEq)]
pub struct GuardSettings {
    /// The limits of linear axes, µm.
    pub linear: AxisSettings<Um>,
    /// The limits of rotary axes, µrad; `None` where no controller has one.
    pub rotary: Option<AxisSettings<Urad>>,
    /// The largest corrections on a path without a barrier.
    pub without_barrier: WithoutBarrier,
    /// A rotary axis is corrected where half its smallest step moves the tool tip by at most this, anywhere in the work
    /// space: while such a step is under way, the tool may be off by as much.
    pub rotary_step: Um,
    /// Positions that are older are held.
    pub hold: Duration,
    /// Positions that are older ramp the correction to zero.
    pub zero_after: Duration,
    /// The time of a ramp; where 20 cycles take longer, it takes those.
    pub ramp: Duration,
    /// The longest time that a stop of the program may ramp out.
    pub stop: Duration,
    /// How long a better controller must be usable before it takes over again.
    pub hand_back: Duration,
    /// The maximum speed of axes: positions that contradict it are not believed.
    pub rapid: Rapid,
    /// Which temperatures are believed.
    pub temperatures: SensorLimits,
    /// The times within which thermal terms fade to zero when their sensor is missing.
    pub fading: Fading,
}

impl GuardSettings {
    /// How far half a rotary step may move the tool tip where nothing else is stated: 10 µm, which a step of 0.001°, that of
    /// most controls, reaches at a lever of 1.15 m.
    pub const ROTARY_STEP: Um = Um(10.0);

    /// Limits of linear axes, with the defaults of everything else: positions are held for 50 ms and ramp the
    /// correction to zero after 500 ms, a ramp takes 500 ms, a stop at most 5 s, a better controller is taken back
    /// after 2 s.
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

    /// The limits of axes of the kind of `axis`, as lengths (mm) or angles (rad); `None` without limits for that
    /// kind.
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
    /// The test shift of linear axes where a configuration states none, or the limit if that is smaller.
    pub const TEST_SHIFT: Um = Um(5.0);
}

impl AxisSettings<Urad> {
    /// The test shift of rotary axes where a configuration states none, or the limit if that is smaller.
    pub const TEST_SHIFT: Urad = Urad(20.0);
}

impl<U: Unit> AxisSettings<U> {
    /// Limits without a limit of the acceleration, and without a test shift: in [`Um`] for linear, in [`Urad`] for
    /// rotary axes.
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
    /// The same settings in other units.
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

/// The maximum speed of axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rapid {
    /// Linear axes, m/min.
    pub linear_m_per_min: f64,
    /// Rotary axes, 1/min.
    pub rotary_rpm: f64,
}

impl Default for Rapid {
    /// 100 m/min and 200/min: linear motors and torque motors are as fast, and few are faster.
    fn default() -> Self {
        Self {
            linear_m_per_min: 100.0,
            rotary_rpm: 200.0,
        }
    }
}

impl Rapid {
    /// The speed of axes of a kind, by the second.
    pub(crate) fn per_s(&self, kind: AxisKind) -> Displacement {
        match kind {
            AxisKind::Linear => Displacement::Length(Mm(self.linear_m_per_min * 1000.0 / 60.0)),
            AxisKind::Rotary => {
                Displacement::Angle(Rad(self.rotary_rpm * core::f64::consts::TAU / 60.0))
            }
        }
    }
}

/// The barrier of a control, as far as it must be known before anything is read from it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BarrierSettings {
    /// The number of the machine that starts every checksum.
    pub machine: u16,
    /// The time of one scan of the control's program.
    pub scan: Duration,
}

/// The largest corrections, in either direction, on a path without a barrier: a wrong reading or a write that lands late
/// may make a step as large as this.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WithoutBarrier {
    /// Of linear axes.
    pub linear: Um,
    /// Of rotary axes.
    pub rotary: Urad,
}

impl Default for WithoutBarrier {
    /// 30 µm and 30 µrad.
    fn default() -> Self {
        Self {
            linear: Um(30.0),
            rotary: Urad(30.0),
        }
    }
}

/// The settings of one controller path besides those of its driver.
#[derive(Clone, Debug, PartialEq)]
pub struct PathSettings {
    /// Machine axes that the controller does not show and that are at this position; rotary axes only those of
    /// `not_driven`.
    pub fixed: BTreeMap<AxisName, Displacement>,
    /// Rotary axes that no drive turns: they are set by hand, or not at all. Only of these is a stated position believed;
    /// every other one must be read, since the correction of the linear axes goes round with it.
    pub not_driven: BTreeSet<AxisName>,
    /// Whether it is accepted that nothing on the control's side notices when the program stops.
    pub unwatched: bool,
    /// Whether it carries the correction of thermal terms alone, for slow controls: positions may then be held for up to 5 s.
    pub only_thermal: bool,
    /// Positions that are older are held on this path; `None`: those of [`GuardSettings::hold`]. Where it is longer than
    /// [`GuardSettings::zero_after`], they ramp the correction to zero at once.
    pub hold: Option<Duration>,
    /// Whether the test shift at arming is made.
    pub proves: bool,
    /// The smallest step that the reported position of an axis shows; of an axis that is not named, finer than that of
    /// the correction.
    pub position_steps: BTreeMap<AxisName, Displacement>,
    /// How many writes its read-back may be behind, from 1.
    pub read_back_cycles: usize,
    /// The barrier of the control, where there is one.
    pub barrier: Option<BarrierSettings>,
    /// For how long nothing on a control without a barrier may move before the first write: another gateway would show.
    pub watch: Duration,
    /// What a control that cannot be asked does by itself when nothing is written any more; `None`: it keeps what it has.
    pub time_out: Option<ControlTimeOut>,
}

impl Default for PathSettings {
    /// Every axis and state is shown, something watches, the test shift is made, the read-back is one write behind, there is
    /// no barrier, and the control is watched for 2 s before the first write.
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

/// How the control thread is scheduled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Realtime {
    /// The priority of SCHED_FIFO, 1 to 99; 0: not requested.
    pub priority: u8,
    /// The processor on which the thread stays; `None`: any.
    pub cpu: Option<usize>,
    /// Whether the thread makes the computation of [`reference_work`](crate::reference_work) after each cycle and reports how
    /// long that took: a measure of the computer, to compare times that were taken on different ones.
    pub reference: bool,
}
