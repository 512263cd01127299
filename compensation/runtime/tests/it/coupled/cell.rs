//! Machines of every type, with controllers that write all their axes.

use std::fmt::Write;

use rand::{RngExt, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;
use volcomp_guard::{AxisLimits, Limits, RequestedCorrection, Vector};
use volcomp_kinematics::{Correctors, Structure, actual_pose, nalgebra::Vector3};
use volcomp_model::{Fading, Machine, Temperatures};
use volcomp_runtime::{Model, kinematics::State};
use volcomp_vocabulary::{AxisKind, PerAxis, PerChannel};

/// Maximum deviation of compiled curves from the machine's curves over all axes and levers, mm.
pub(crate) const COMPILED_MM: f64 = 3e-5;
fn machine(structure: &Structure, rng: &mut ChaCha8Rng) -> Machine {
    let mut number = |size: f64| rng.random_range(-size..=size);
    let mut text = format!("structure = \"{structure}\"\n");
    for axis in structure.axes() {
        let half = if axis.is_rotary() { 180.0 } else { 400.0 };
        let letter = volcomp_kinematics::letter_direction(*axis);
        // The axis deviates by some degrees from the direction of its letter.
        let oblique = letter + Vector3::from_fn(|_, _| number(0.1));
        let direction: [f64; 3] = oblique.normalize().into();
        let point: [f64; 3] = [(); 3].map(|()| number(300.0));
        writeln!(
            text,
            "[axes.{axis}]\ntravel = [-{half}, {half}]\npoint = {point:?}\ndirection = {direction:?}"
        )
        .expect("a string");
    }
    let tip: [f64; 3] = [(); 3].map(|()| number(150.0));
    writeln!(text, "[tool]\ntip = {tip:?}\n[errors]").expect("a string");
    for axis in structure.axes() {
        let half = if axis.is_rotary() { 180.0 } else { 400.0 };
        for what in ["EX", "EY", "EZ", "EA", "EB", "EC"] {
            let c: [f64; 4] = [(); 4].map(|()| number(10.0));
            writeln!(text, "{what}{axis} = {{ chebyshev = {c:?}, domain = [-{half}, {half}] }}")
                .expect("a string");
        }
    }
    Machine::parse(&text, "m.toml").expect("a machine")
}

/// A machine, and a controller that writes all of its axes in another order.
pub(crate) struct Cell {
    pub(crate) machine: Machine,
    pub(crate) model: Model,
    pub(crate) correctors: Correctors,
    /// Machine axis index of each channel.
    pub(crate) machine_axis: Vec<usize>,
    pub(crate) temperatures: Temperatures,
}

impl Cell {
    pub(crate) fn new(structure: &Structure, rng: &mut ChaCha8Rng) -> Self {
        let mut machine_axis: Vec<usize> = (0..structure.axes().len()).collect();
        machine_axis.shuffle(rng);
        Self::of(machine(structure, rng), &machine_axis)
    }

    pub(crate) fn of(machine: Machine, machine_axis: &[usize]) -> Self {
        let model = Model::new(&machine, Fading::default()).expect("compiles");
        Self {
            correctors: model.correctors_among(&model.axes),
            machine,
            model,
            machine_axis: machine_axis.to_vec(),
            temperatures: Temperatures::new(),
        }
    }

    pub(crate) fn channels(&self, values: &PerAxis<f64>) -> PerChannel<f64> {
        PerChannel::from_fn(|i| self.machine_axis.get(i).map_or(0.0, |axis| values[*axis]))
    }

    pub(crate) fn axes(&self, values: &PerChannel<f64>) -> PerAxis<f64> {
        let mut axes = PerAxis::ZERO;
        for (axis, value) in self.machine_axis.iter().zip(values) {
            axes[*axis] = *value;
        }
        axes
    }

    /// Correction that the model requests while `applied` is applied.
    pub(crate) fn wanted(&self, state: &State, applied: &PerChannel<f64>) -> RequestedCorrection {
        let applied = self.axes(applied);
        let wanted = self.model.wanted(state, &self.correctors, &applied);
        let follow = PerChannel::from_fn(|i| {
            self.machine_axis
                .get(i)
                .map_or(PerChannel::ZERO, |axis| self.channels(&wanted.follow[*axis]))
        });
        RequestedCorrection {
            position: self.channels(&wanted.position),
            rotary: self.channels(&wanted.rotary),
            follow,
        }
    }

    /// Distance of the tool tip from its commanded position with a correction, mm, by the exact chain with the machine's curves.
    pub(crate) fn off(&self, state: &State, correction: &PerChannel<f64>) -> f64 {
        let mut there = *state;
        for (q, delta) in there.q.iter_mut().zip(self.axes(correction)) {
            *q += delta;
        }
        let chain = self.machine.chain();
        let tip = chain.tool_tip_mm();
        let actual = actual_pose(chain, &self.machine.source(&self.temperatures), &there);
        (actual.transform_point(&tip) - chain.ideal_pose(state).transform_point(&tip)).norm()
    }

    /// Difference, mm, between the machine's errors at two corrections: the correction at which the model was
    /// evaluated, and the correction after a cycle in which the machine moved and a limit, slew or acceleration changed
    /// the correction.
    pub(crate) fn differs(&self, state: &State, [one, other]: [&PerChannel<f64>; 2]) -> f64 {
        let chain = self.machine.chain();
        let tip = chain.tool_tip_mm();
        let source = self.machine.source(&self.temperatures);
        let [one, other] = [one, other].map(|correction| {
            let mut there = *state;
            for (q, delta) in there.q.iter_mut().zip(self.axes(correction)) {
                *q += delta;
            }
            let actual = actual_pose(chain, &source, &there);
            actual.transform_point(&tip) - chain.ideal_pose(&there).transform_point(&tip)
        });
        (one - other).norm()
    }

    /// Maximum effect of rounding the output, mm: 0.6 step of each linear axis in the worst direction, and half a
    /// rotary step times its lever. An axis beyond a lowered limit may be rounded by up to one step towards zero.
    pub(crate) fn rounding(&self, state: &State, vector: &Vector, limits: &Limits) -> f64 {
        let chain = self.machine.chain();
        let mut sums = vec![Vector3::zeros()];
        let mut rotary = 0.0;
        for (i, axis) in self.machine_axis.iter().enumerate() {
            let (joint, step) = (&chain.joints()[*axis], limits.axes[i].resolution);
            let comes_in = vector.smooth()[i].abs() > limits.axes[i].reachable();
            if joint.kind == AxisKind::Linear {
                let way = joint.direction * (if comes_in { 1.0 } else { 0.6 } * step);
                sums = sums.iter().flat_map(|sum| [sum + way, sum - way]).collect();
            } else {
                let between = (vector.output()[i] - vector.smooth()[i]).abs();
                let most = if comes_in { 1.0 } else { 0.5 };
                assert!(between <= (most + 1e-6) * step, "{between} of {step}");
                rotary += between * chain.lever_mm(*axis, state);
            }
        }
        sums.iter().map(Vector3::norm).fold(0.0, f64::max) + rotary
    }

    pub(crate) fn random_state(&self, rng: &mut ChaCha8Rng) -> State {
        let mut state = State::default();
        for (q, joint) in state.q.iter_mut().zip(self.machine.chain().joints()) {
            *q = match joint.kind {
                AxisKind::Linear => rng.random_range(-400.0..=400.0),
                AxisKind::Rotary => rng.random_range(-3.1..=3.1),
            };
        }
        state
    }

    pub(crate) fn random_limits(&self, rng: &mut ChaCha8Rng) -> Limits {
        let mut log = |low: f64, high: f64| low * (high / low).powf(rng.random_range(0.0..=1.0));
        let period_s = log(0.001, 0.01);
        let ramp_s = log(0.02, 1.0);
        let has_accel = log(1.0, 4.0) > 2.0;
        let (step, rotary_step) = (log(0.1e-3, 2e-3), log(0.1e-6, 20e-6));
        let (limit, rotary_limit) = (log(0.01, 0.5), log(2e-5, 1e-3));
        let (slew, rotary_slew) = (log(0.1, 5.0), log(1e-4, 5e-3));
        let axes = core::array::from_fn(|i| {
            let Some(axis) = self.machine_axis.get(i) else {
                return AxisLimits::NONE;
            };
            let kind = self.model.axes[*axis].kind();
            let [limit, slew, step] = match kind {
                AxisKind::Linear => [limit, slew, step],
                AxisKind::Rotary => [rotary_limit, rotary_slew, rotary_step],
            };
            let resolution = step * log(0.5, 1.0);
            let limit = (limit * log(0.5, 1.0)).max(2.0 * resolution);
            let slew_per_s = slew * log(0.5, 1.0);
            AxisLimits {
                kind,
                limit,
                warn: limit,
                slew_per_s,
                accel_per_s2: if has_accel { slew_per_s / log(0.01, 0.3) } else { f64::INFINITY },
                resolution,
                includes_correction: false,
            }
        });
        let period = std::time::Duration::from_secs_f64(period_s);
        Limits {
            axes,
            count: self.machine_axis.len(),
            period,
            hold: period * 4,
            zero_after: period * 8,
            ramp: std::time::Duration::from_secs_f64(ramp_s),
            test_shift: PerChannel::ZERO,
            read_back_cycles: 2,
            only_thermal: false,
        }
    }
}
