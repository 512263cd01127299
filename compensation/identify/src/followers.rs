//! Errors that follow unknowns: what else of the machine is another one where an unknown has another value, because it was
//! fitted to readings that contain the unknown (variable projection: G. H. Golub, V. Pereyra, SIAM Journal on Numerical
//! Analysis 10, 1973).

use volcomp_kinematics::{ErrorMotion, ErrorSource, State};
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::Component;

use crate::{
    coefficients::micro, derivatives::component_of, error::IdentifyError, parameters::Parameter,
    prepared::PreparedStand, system::System,
};

/// How the other errors of a machine follow one unknown: straight, as far as they are known.
#[derive(Clone, Debug)]
pub struct Follower {
    /// The unknown by its name among the parameters.
    parameter: String,
    /// Its value with which the machine of the observations was made, in the unit of the parameter.
    value: f64,
    /// A machine, and what it is where the unknown is larger by `by`, in the unit of the parameter.
    machines: [Machine; 2],
    by: f64,
}

impl Follower {
    /// A follower of an unknown error, which has now the value with which the machine of the observations was made:
    /// `machines` are a machine, and what it is where the unknown is larger by `by`, in the unit of the parameter.
    ///
    /// # Errors
    /// [`IdentifyError::NotFollowing`] for a number of a set-up, for a change that is no number or 0, and for machines of two
    /// structures.
    pub fn new(
        parameter: &Parameter,
        machines: [Machine; 2],
        by: f64,
    ) -> Result<Self, IdentifyError> {
        let refused = |why| IdentifyError::NotFollowing {
            parameter: parameter.name.clone(),
            why,
        };
        if parameter.error.is_none() {
            return Err(refused(
                "it is a number of a set-up, expected an error of the machine",
            ));
        }
        if !by.is_finite() || by == 0.0 {
            return Err(refused("expected a change that is a number and not 0"));
        }
        if machines[0].chain().structure() != machines[1].chain().structure() {
            return Err(refused("expected two machines of one structure"));
        }
        Ok(Self {
            parameter: parameter.name.clone(),
            value: parameter.value,
            machines,
            by,
        })
    }

    /// The unknown by its name among the parameters.
    pub fn parameter(&self) -> &str {
        &self.parameter
    }

    /// The same where the machine of the observations was made with another value of the unknown, in the unit of the parameter.
    #[must_use]
    pub fn with_value(self, value: f64) -> Self {
        Self { value, ..self }
    }
}

/// A follower inside: mm and rad.
#[derive(Clone, Debug)]
pub(crate) struct Following {
    coefficient: usize,
    value: f64,
    by: f64,
    machines: [Machine; 2],
}

impl Following {
    /// What one unit of the unknown adds to an error: six numbers.
    fn rate(&self, of: impl Fn(&Machine) -> ErrorMotion) -> [f64; 6] {
        let [from, to] = [&self.machines[0], &self.machines[1]].map(of);
        let (linear, angular) = (
            (to.linear_mm - from.linear_mm) / self.by,
            (to.angular_rad - from.angular_rad) / self.by,
        );
        std::array::from_fn(|k| if k < 3 { linear[k] } else { angular[k - 3] })
    }
}

impl System {
    /// The system with errors that follow its unknowns.
    ///
    /// # Errors
    /// A follower of an unknown that it does not have, or with machines of another structure.
    pub(crate) fn followed_by(mut self, followers: &[Follower]) -> Result<Self, IdentifyError> {
        let none = Temperatures::default();
        for follower in followers {
            let mut unknowns = self.unknowns.coefficients.iter();
            let Some(coefficient) = unknowns.position(|c| c.name == follower.parameter) else {
                return Err(IdentifyError::NotFollowing {
                    parameter: follower.parameter.clone(),
                    why: "it is none of the unknowns of the observations",
                });
            };
            if follower.machines[0].chain().structure() != self.machine.chain().structure() {
                return Err(IdentifyError::NotFollowing {
                    parameter: follower.parameter.clone(),
                    why: "its machines have another structure than that of the observations",
                });
            }
            let scale = micro(self.unknowns.coefficients[coefficient].error.component);
            let following = Following {
                coefficient,
                value: follower.value / scale,
                by: follower.by / scale,
                machines: follower.machines.clone(),
            };
            for axis in 0..self.machine.axes().len() {
                let rate = following.rate(|machine| machine.source(&none).location(axis));
                for (component, rate) in rate.into_iter().enumerate() {
                    if rate != 0.0 && !self.is_unknown(axis, component, true) {
                        let by = (axis, component, coefficient, rate);
                        self.following_locations.push(by);
                    }
                }
            }
            self.followers.push(following);
        }
        Ok(self)
    }

    /// Takes what follows the unknowns into a prepared pose: the known errors as they were without them, and a term for each.
    pub(crate) fn follow(&self, stand: &mut PreparedStand) {
        let none = Temperatures::default();
        let state: State = stand.stand.state;
        for following in &self.followers {
            for axis in 0..self.machine.axes().len() {
                let motion = |machine: &Machine| machine.source(&none).error_motion(axis, &state);
                for (component, rate) in following.rate(motion).into_iter().enumerate() {
                    if rate != 0.0 && !self.is_unknown(axis, component, false) {
                        let known = component_of(&mut stand.known.motion[axis], component);
                        *known -= rate * following.value;
                        let term = (axis, component, following.coefficient, rate);
                        stand.terms.push(term);
                    }
                }
            }
        }
        for &(axis, component, coefficient, rate) in &self.following_locations {
            let of = |following: &&Following| following.coefficient == coefficient;
            let value = self.followers.iter().find(of).map_or(0.0, |f| f.value);
            *component_of(&mut stand.known.location[axis], component) -= rate * value;
        }
    }

    /// Whether an error of an axis is unknown itself.
    fn is_unknown(&self, axis: usize, component: usize, location: bool) -> bool {
        self.unknowns.curves.iter().any(|unknown| {
            unknown.axis == axis
                && unknown.error.location == location
                && Component::ALL.get(component) == Some(&unknown.error.component)
        })
    }
}
