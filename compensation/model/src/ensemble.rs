//! Many machines that one measurement allows: the uncertainty of the volumetric error.

use volcomp_evaluator::CompiledMachine;
use volcomp_kinematics::State;

/// Machines drawn from what the measurements leave open (JCGM 101, propagation of distributions).
#[derive(Clone, Debug)]
pub struct Ensemble(Vec<CompiledMachine>);

impl Ensemble {
    /// From machines of the same structure; `None` for fewer than two, whose spread means nothing.
    pub fn new(machines: Vec<CompiledMachine>) -> Option<Self> {
        let structure = machines.first()?.chain().structure();
        let same = |m: &CompiledMachine| m.chain().structure() == structure;
        (machines.len() > 1 && machines.iter().all(same)).then_some(Self(machines))
    }

    /// How many machines there are.
    pub fn trials(&self) -> usize {
        self.0.len()
    }

    /// Standard uncertainty (k = 1) of ΔP (mm) and ρ (rad) at a state: the standard deviation over the
    /// machines, in their order, so that the same machines give the same digits on any number of cores.
    pub fn standard_uncertainty(&self, state: &State) -> [f64; 6] {
        let (mut mean, mut squares) = ([0.0; 6], [0.0; 6]);
        for (before, machine) in self.0.iter().enumerate() {
            let found = machine.evaluate(state).into_six();
            for ((found, mean), squares) in found.iter().zip(&mut mean).zip(&mut squares) {
                // Welford's update.
                let away = found - *mean;
                *mean += away / (before + 1) as f64;
                *squares += away * (found - *mean);
            }
        }
        squares.map(|sum| (sum / (self.0.len() - 1) as f64).sqrt())
    }
}
