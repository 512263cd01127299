use volcomp_fit::student_widening;
use volcomp_kinematics::State;
use volcomp_model::CompiledMachine;

/// Monte Carlo samples of a machine within the measurement uncertainty (JCGM 101, propagation of distributions).
#[derive(Clone, Debug)]
pub struct Ensemble {
    drawn: Vec<CompiledMachine>,
    found: Option<CompiledMachine>,
    scatters: Vec<Scatter>,
}

/// An uncertainty contribution whose standard deviation was estimated from a few repeated readings and is therefore itself uncertain.
#[derive(Clone, Debug)]
pub struct Scatter {
    /// Degrees of freedom of the estimate: n − 1 for n runs.
    pub degrees: f64,
    /// One machine for each independent part of the contribution, computed with the readings shifted by that part. The
    /// sum of the squared changes is the variance.
    pub shifted: Vec<CompiledMachine>,
}

impl Ensemble {
    /// An ensemble of sampled machines. `None` for fewer than two, which have no spread, or if their structures differ.
    pub fn new(machines: Vec<CompiledMachine>) -> Option<Self> {
        let first = machines.first()?;
        let same = |m: &CompiledMachine| has_structure_of(m, first);
        (machines.len() > 1 && machines.iter().all(same)).then_some(Self {
            drawn: machines,
            found: None,
            scatters: Vec::new(),
        })
    }

    /// Adds contributions that were estimated from a few repeated readings. Their changes are relative to `found`, the identified machine. `None` if a
    /// machine differs in structure from the samples.
    #[must_use]
    pub fn with_scatters(mut self, found: CompiledMachine, scatters: Vec<Scatter>) -> Option<Self> {
        let shifted = scatters.iter().flat_map(|scatter| &scatter.shifted);
        // The index is valid: an ensemble has at least two machines.
        let same = |m: &CompiledMachine| has_structure_of(m, &self.drawn[0]);
        if !core::iter::once(&found).chain(shifted).all(same) {
            return None;
        }
        self.found = Some(found);
        self.scatters = scatters;
        Some(self)
    }

    /// Number of Monte Carlo samples.
    pub fn trials(&self) -> usize {
        self.drawn.len()
    }

    /// Standard uncertainty (k = 1) of ΔP (mm) and ρ (rad) at a state; see [`Ensemble::uncertainty_of`].
    pub fn standard_uncertainty(&self, state: &State) -> [f64; 6] {
        self.uncertainty_of(|machine| machine.evaluate(state).into_six())
    }

    /// [`standard_uncertainty`](Self::standard_uncertainty) at each of many states. Several times faster than one state after another, because the
    /// tables of a machine stay in the cache.
    pub fn standard_uncertainties(&self, states: &[State]) -> Vec<[f64; 6]> {
        self.uncertainties_of(states.len(), |machine, found| {
            for (state, found) in states.iter().zip(found) {
                *found = machine.evaluate(state).into_six();
            }
        })
    }

    /// Standard uncertainty (k = 1) of quantities computed from a machine: their standard deviation over the samples, summed in sample
    /// order so that the result does not depend on the number of cores.
    ///
    /// The result is widened by t(ν)/1.96, so that ±1.96 times the result is the 95 % confidence band. t is Student's factor; its degrees
    /// of freedom ν follow from the number of samples, and for contributions estimated from a few readings from the Welch–Satterthwaite
    /// formula (JCGM 100, G.4).
    pub fn uncertainty_of<const N: usize>(
        &self,
        number: impl Fn(&CompiledMachine) -> [f64; N],
    ) -> [f64; N] {
        let of_one = self.uncertainties_of(1, |machine, found| found.fill(number(machine)));
        of_one.into_iter().next().unwrap_or([f64::NAN; N])
    }

    /// Standard uncertainties of quantities at several places; `numbers` computes the quantities of a machine.
    fn uncertainties_of<const N: usize>(
        &self,
        places: usize,
        numbers: impl Fn(&CompiledMachine, &mut [[f64; N]]),
    ) -> Vec<[f64; N]> {
        let none = vec![[0.0; N]; places];
        let (mut mean, mut squares, mut numbers_of) = (none.clone(), none.clone(), none.clone());
        for (before, machine) in self.drawn.iter().enumerate() {
            numbers(machine, &mut numbers_of);
            let all = numbers_of.as_flattened().iter();
            let sums = mean.as_flattened_mut().iter_mut();
            for ((found, mean), squares) in all.zip(sums).zip(squares.as_flattened_mut()) {
                // Welford's update.
                let away = found - *mean;
                *mean += away / (before + 1) as f64;
                *squares += away * (found - *mean);
            }
        }
        let mut variance = squares;
        for sum in variance.as_flattened_mut() {
            *sum /= (self.drawn.len() - 1) as f64;
        }
        // The standard deviation of few samples is itself uncertain.
        let of_few = student_widening((self.drawn.len() - 1) as f64);
        let mut widened = variance.clone();
        for variance in widened.as_flattened_mut() {
            *variance = of_few * variance.sqrt();
        }
        let Some(machine) = &self.found else {
            return widened;
        };
        let mut found = none.clone();
        numbers(machine, &mut found);
        let (mut of_scatters, mut fourth_powers) = (none.clone(), none.clone());
        for scatter in &self.scatters {
            let mut of_scatter = none.clone();
            for machine in &scatter.shifted {
                numbers(machine, &mut numbers_of);
                let shifted = numbers_of.as_flattened().iter();
                let sums = of_scatter.as_flattened_mut().iter_mut();
                for ((sum, shifted), found) in sums.zip(shifted).zip(found.as_flattened()) {
                    *sum += (shifted - found).powi(2);
                }
            }
            let sums = of_scatters.as_flattened_mut().iter_mut();
            for ((sum, powers), of_scatter) in
                sums.zip(fourth_powers.as_flattened_mut()).zip(of_scatter.as_flattened())
            {
                *sum += of_scatter;
                *powers += of_scatter * of_scatter / scatter.degrees;
            }
        }
        let of_scatters = of_scatters.as_flattened().iter();
        let of_scatters = of_scatters.zip(fourth_powers.as_flattened());
        for ((widened, variance), (of_scatters, powers)) in
            (widened.as_flattened_mut().iter_mut()).zip(variance.as_flattened()).zip(of_scatters)
        {
            if *powers > 0.0 {
                // By chance, the variance of the samples may be less than that of the scatters alone. With the larger
                // of both, the degrees of freedom are at least those of the scatter with the fewest.
                let whole = variance.max(*of_scatters);
                *widened *= student_widening(whole * whole / powers);
            }
        }
        widened
    }
}

fn has_structure_of(machine: &CompiledMachine, other: &CompiledMachine) -> bool {
    machine.chain().structure() == other.chain().structure()
}

#[cfg(test)]
mod tests {
    use volcomp_model::{Machine, ModelError, Tolerance};

    use super::*;

    fn off(um: f64) -> Result<CompiledMachine, ModelError> {
        let text = format!(
            "structure = \"w b X t\"\n[axes]\nX.travel = [0.0, 100.0]\n[errors]\nEXX = {um:?}\n"
        );
        Machine::parse(&text, "m")?.compile(Tolerance::default())
    }

    /// Factor by which scatters with these variances (µm²) and degrees of freedom widen a standard uncertainty.
    /// `variance` is that of the samples.
    fn widened(variance: f64, scatters: &[(f64, f64)]) -> Result<f64, ModelError> {
        let of_x = |ensemble: &Ensemble| ensemble.standard_uncertainty(&State::default())[0] * 1e3;
        // The variance of two values is half the square of their distance.
        let half = (variance / 2.0).sqrt();
        let drawn = Ensemble::new(vec![off(3.0 - half)?, off(3.0 + half)?]).expect("two machines");
        // Table G.2 of JCGM 100, for one degree of freedom.
        let of_two = 12.706_205 / 1.959_964;
        assert!((of_x(&drawn) / variance.sqrt() / of_two - 1.0).abs() < 2e-3);
        let scatter = |&(variance, degrees): &(f64, f64)| -> Result<Scatter, ModelError> {
            // Two runs, each with half of the variance.
            let shifted = off(3.0 + (variance / 2.0).sqrt())?;
            Ok(Scatter { degrees, shifted: vec![shifted.clone(), shifted] })
        };
        let scatters = scatters.iter().map(scatter).collect::<Result<_, _>>()?;
        let with = drawn.clone().with_scatters(off(3.0)?, scatters);
        Ok(of_x(&with.expect("of one structure")) / of_x(&drawn))
    }

    #[test]
    fn many_states_have_the_uncertainty_of_each() -> Result<(), ModelError> {
        let machine = |slope: f64| {
            let text = format!(
                "structure = \"w b X t\"\n[axes]\nX.travel = [0.0, 100.0]\n[errors]\nEXX = {{ poly = [1.0, {slope:?}] }}\nEAX = {slope:?}\n"
            );
            Machine::parse(&text, "m")?.compile(Tolerance::default())
        };
        let drawn = [0.1, 0.13, 0.08].map(machine).into_iter();
        let ensemble = Ensemble::new(drawn.collect::<Result<_, _>>()?).expect("three machines");
        let scatter = |degrees| -> Result<Scatter, ModelError> {
            let shifted = vec![machine(0.12)?, machine(0.07)?];
            Ok(Scatter { degrees, shifted })
        };
        let scatters = vec![scatter(2.0)?, scatter(1.0)?];
        let with = ensemble.clone().with_scatters(machine(0.1)?, scatters);
        let states: Vec<State> = [0.0, 31.0, 100.0, 120.0]
            .map(|x| State { q: volcomp_vocabulary::PerAxis::leading([x]), ..State::default() })
            .to_vec();
        for ensemble in [ensemble, with.expect("of one structure")] {
            let found = ensemble.standard_uncertainties(&states);
            let each = states.iter().map(|state| ensemble.standard_uncertainty(state));
            assert_eq!(found, each.collect::<Vec<_>>());
            assert!(found[2][0] > 10.0 * found[0][0] && found[0][3] > 0.0);
        }
        Ok(())
    }

    /// Welch–Satterthwaite degrees of freedom computed by hand, with the factors of table G.2 of JCGM 100.
    #[test]
    fn a_band_has_the_effective_degrees_of_freedom() -> Result<(), ModelError> {
        for (variance, scatters, degrees, t) in [
            // One line of three runs contributes the whole variance: its degrees of freedom apply.
            (4.0, &[(4.0, 2.0)][..], 2, 4.302_653),
            // Two equal lines: 1/(¼/2 + ¼/2) = 4; three equal lines: 6.
            (4.0, &[(2.0, 2.0), (2.0, 2.0)], 4, 2.776_445),
            (6.0, &[(2.0, 2.0), (2.0, 2.0), (2.0, 2.0)], 6, 2.446_912),
            // Half of the variance from well-known contributions: 1/(¼/5) = 20.
            (4.0, &[(2.0, 5.0)], 20, 2.085_963),
            // ⅔ with four degrees of freedom, ⅓ with one: 1/(4/9/4 + 1/9/1) = 4.5, between four and five.
            (9.0, &[(6.0, 4.0), (3.0, 1.0)], 4, 2.658_9),
            // The variance of the samples is less than that of the scatter: the degrees of freedom are not below those
            // of the scatter.
            (1.0, &[(4.0, 2.0)], 2, 4.302_653),
        ] {
            let found = widened(variance, scatters)? * 1.959_964;
            assert!((found - t).abs() < 2e-3, "{degrees}: {found} {t}");
        }
        assert!((widened(4.0, &[])? - 1.0).abs() < 1e-9);
        Ok(())
    }

    #[test]
    fn an_ensemble_needs_machines_of_one_structure() -> Result<(), ModelError> {
        let compiled = off(1.0)?;
        assert!(Ensemble::new(Vec::new()).is_none());
        assert!(Ensemble::new(vec![compiled.clone()]).is_none());
        let two = Ensemble::new(vec![compiled; 2]).expect("two machines");
        let state = State { q: volcomp_vocabulary::PerAxis([f64::NAN; 9]), ..State::default() };
        let _ = two.standard_uncertainty(&state);
        assert_eq!(two.standard_uncertainty(&State::default()), [0.0; 6]);
        Ok(())
    }
}
