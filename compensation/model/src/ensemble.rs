//! Many machines that one measurement allows: the uncertainty of the volumetric error.

use volcomp_evaluator::CompiledMachine;
use volcomp_kinematics::State;

use crate::student::{NORMAL_95, student_95};

/// Machines drawn from what the measurements leave open (JCGM 101, propagation of distributions).
#[derive(Clone, Debug)]
pub struct Ensemble {
    drawn: Vec<CompiledMachine>,
    found: Option<CompiledMachine>,
    scatters: Vec<Scatter>,
}

/// A contribution to the uncertainty that was estimated from a few repeated readings: its size is uncertain itself.
#[derive(Clone, Debug)]
pub struct Scatter {
    /// The degrees of freedom of the estimate: for n runs n − 1.
    pub degrees: f64,
    /// The machine with the readings shifted by one part of the contribution each; the parts are independent, and the
    /// squares of what they change add up to the variance.
    pub shifted: Vec<CompiledMachine>,
}

impl Ensemble {
    /// From machines of the same structure; `None` for fewer than two, whose spread means nothing.
    pub fn new(machines: Vec<CompiledMachine>) -> Option<Self> {
        let first = machines.first()?;
        let same = |m: &CompiledMachine| has_structure_of(m, first);
        (machines.len() > 1 && machines.iter().all(same)).then_some(Self {
            drawn: machines,
            found: None,
            scatters: Vec::new(),
        })
    }

    /// With the contributions whose size comes from a few repeated readings, and the machine that was found, from which
    /// their shifts are counted. `None` where a machine has another structure than those that were drawn.
    #[must_use]
    pub fn with_scatters(mut self, found: CompiledMachine, scatters: Vec<Scatter>) -> Option<Self> {
        let shifted = scatters.iter().flat_map(|scatter| &scatter.shifted);
        // An ensemble has two machines at least.
        let same = |m: &CompiledMachine| has_structure_of(m, &self.drawn[0]);
        if !core::iter::once(&found).chain(shifted).all(same) {
            return None;
        }
        self.found = Some(found);
        self.scatters = scatters;
        Some(self)
    }

    /// How many machines were drawn.
    pub fn trials(&self) -> usize {
        self.drawn.len()
    }

    /// Standard uncertainty (k = 1) of ΔP (mm) and ρ (rad) at a state, as [`Ensemble::uncertainty_of`] has it.
    pub fn standard_uncertainty(&self, state: &State) -> [f64; 6] {
        self.uncertainty_of(|machine| machine.evaluate(state).into_six())
    }

    /// Standard uncertainty (k = 1) of numbers that are computed from a machine: the standard deviation over the machines,
    /// in their order, so that the same machines give the same digits on any number of cores.
    ///
    /// Where a contribution was estimated from a few readings, it is widened by t(ν)/1.96, so that ±1.96 of it are the
    /// band of 95 %: t is Student's factor for the effective degrees of freedom of Welch and Satterthwaite (JCGM 100,
    /// G.4).
    pub fn uncertainty_of<const N: usize>(
        &self,
        number: impl Fn(&CompiledMachine) -> [f64; N],
    ) -> [f64; N] {
        let (mut mean, mut squares) = ([0.0; N], [0.0; N]);
        for (before, machine) in self.drawn.iter().enumerate() {
            let found = number(machine);
            for ((found, mean), squares) in found.iter().zip(&mut mean).zip(&mut squares) {
                // Welford's update.
                let away = found - *mean;
                *mean += away / (before + 1) as f64;
                *squares += away * (found - *mean);
            }
        }
        let variance = squares.map(|sum| sum / (self.drawn.len() - 1) as f64);
        let mut widened = variance.map(f64::sqrt);
        let Some(found) = self.found.as_ref().map(&number) else {
            return widened;
        };
        let (mut of_scatters, mut fourth_powers) = ([0.0; N], [0.0; N]);
        for scatter in &self.scatters {
            let mut of_scatter = [0.0; N];
            for machine in &scatter.shifted {
                let shifted = number(machine);
                for ((sum, shifted), found) in of_scatter.iter_mut().zip(&shifted).zip(&found) {
                    *sum += (shifted - found).powi(2);
                }
            }
            for ((sum, powers), of_scatter) in of_scatters
                .iter_mut()
                .zip(&mut fourth_powers)
                .zip(&of_scatter)
            {
                *sum += of_scatter;
                *powers += of_scatter * of_scatter / scatter.degrees;
            }
        }
        let of_scatters = of_scatters.iter().zip(&fourth_powers);
        for ((widened, variance), (of_scatters, powers)) in
            widened.iter_mut().zip(&variance).zip(of_scatters)
        {
            if *powers > 0.0 {
                // The variance of a few machines may by chance be less than what the scatters alone add to it. With the
                // larger one there are never fewer degrees of freedom than those of the scatter with the fewest.
                let whole = variance.max(*of_scatters);
                *widened *= student_95(whole * whole / powers) / NORMAL_95;
            }
        }
        widened
    }
}

fn has_structure_of(machine: &CompiledMachine, other: &CompiledMachine) -> bool {
    machine.chain().structure() == other.chain().structure()
}
