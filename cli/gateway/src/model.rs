//! The machine as the cycle computes with it.

use std::path::Path;

use volcomp_kinematics::State;
use volcomp_model::{CompiledMachine, Fading, Machine, ThermalState, Tolerance};
use volcomp_vocabulary::{AxisName, Displacement, MAX_AXES, PerAxis};

use crate::error::GatewayError;

/// A machine that is compiled, with its thermal terms. Boxed and handed over whole.
#[derive(Clone)]
pub struct Model {
    /// Its name.
    pub name: String,
    /// Checksum of its content.
    pub hash: String,
    /// The machine file's text as it is written again.
    pub text: String,
    /// The axes in machine order.
    pub axes: Vec<AxisName>,
    /// Travel of each, mm or deg.
    pub travel: Vec<[f64; 2]>,
    /// Whether the tool axis can be corrected at all.
    pub corrects_tool_axis: bool,
    pub(crate) compiled: CompiledMachine,
    pub(crate) thermal: ThermalState,
}

impl Model {
    /// Reads a machine file.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn read(path: &Path, fading: Fading) -> Result<Self, GatewayError> {
        Self::new(&Machine::read(path)?, fading)
    }

    /// From a machine.
    ///
    /// # Errors
    /// Curves that cannot be compiled.
    pub fn new(machine: &Machine, fading: Fading) -> Result<Self, GatewayError> {
        let joints = machine.chain().joints().iter();
        let axes: Vec<AxisName> = joints.map(|joint| joint.name).collect();
        Ok(Self {
            name: machine.name.clone(),
            hash: machine.checksum(),
            text: machine.to_toml(),
            travel: machine.axes().iter().map(|axis| axis.travel).collect(),
            corrects_tool_axis: axes.iter().filter(|name| name.is_rotary()).count() >= 2,
            axes,
            compiled: machine.compile(Tolerance::default())?,
            thermal: ThermalState::new(machine, fading)?,
        })
    }

    /// The place of an axis in machine order.
    pub fn index_of(&self, name: AxisName) -> Option<usize> {
        self.axes.iter().position(|known| *known == name)
    }

    /// The correction (mm, rad) at a state: two first-order steps, the second with the errors where the
    /// first leads.
    pub fn correction(&self, state: &State) -> (PerAxis<f64>, bool) {
        let first = self.compiled.first_order(state);
        let mut there = *state;
        for (q, delta) in there.q.iter_mut().zip(&first.delta) {
            *q += delta;
        }
        let second = self.compiled.first_order(&there);
        (second.delta, second.singular && self.corrects_tool_axis)
    }

    /// The corners of the work space, mm and rad.
    pub fn corners(&self) -> impl Iterator<Item = State> + '_ {
        let count = self.axes.len().min(MAX_AXES);
        (0..1_usize << count).map(move |corner| {
            let mut state = State::default();
            for (axis, (q, (travel, name))) in state
                .q
                .iter_mut()
                .zip(self.travel.iter().zip(&self.axes))
                .enumerate()
            {
                let end = travel[corner >> axis & 1];
                *q = Displacement::from_coordinate(name.kind(), end).mm_or_rad();
            }
            state
        })
    }

    /// The machine as it is at steady temperatures (degC) by name.
    pub(crate) fn warmed(&self, degc: impl Fn(&str) -> Option<f64>) -> Self {
        let mut warm = self.clone();
        let degc: Vec<Option<f64>> = self
            .thermal
            .sensors()
            .iter()
            .map(|name| degc(name))
            .collect();
        warm.thermal.step(0.0, &degc);
        warm.thermal.apply(&mut warm.compiled);
        warm
    }

    /// How far the correction of any corner moves when `other` takes the place of this model: mm of a linear axis,
    /// rad of a rotary axis at the most. Infinite where the axes differ.
    pub fn worst_corner(&self, other: &Self) -> [f64; 2] {
        if self.axes != other.axes {
            return [f64::INFINITY; 2];
        }
        let mut worst = [0.0_f64; 2];
        for state in self.corners().chain(other.corners()) {
            let (before, after) = (self.correction(&state).0, other.correction(&state).0);
            for (index, name) in self.axes.iter().enumerate() {
                let moved = (after[index] - before[index]).abs();
                let kind = usize::from(name.is_rotary());
                worst[kind] = worst[kind].max(if moved.is_nan() { f64::INFINITY } else { moved });
            }
        }
        worst
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A change that is only seen when the machine is warm.
    #[test]
    fn corners_are_compared_warm_too() {
        let model = |um_per_m_k: f64| {
            let text = format!(
                "structure = \"w X' b Y Z t\"\n[axes.X]\ntravel = [0.0, 1000.0]\n[axes.Y]\ntravel = [0.0, 1.0]\n[axes.Z]\ntravel = [0.0, 1.0]\n[[thermal.expansion]]\nerror = \"EXX\"\nsensor = \"scale\"\num_per_m_k = {um_per_m_k}\n"
            );
            let machine = Machine::parse(&text, "m").expect("valid");
            Model::new(&machine, Fading::default()).expect("compiles")
        };
        let (old, new) = (model(10.0), model(20.0));
        assert_eq!(old.worst_corner(&new), [0.0; 2]);
        let warm = |model: &Model| model.warmed(|_| Some(25.0));
        let [mm, rad] = warm(&old).worst_corner(&warm(&new));
        assert!((mm - 0.05).abs() < 1e-5 && rad == 0.0, "{mm}");
    }
}
