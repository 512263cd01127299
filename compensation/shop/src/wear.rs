use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use volcomp_model::{
    Machine, ModelError,
    curve::{Curve, CurveError, ErrorCurve, Field, Table},
};
use volcomp_vocabulary::{AxisKind, AxisName, Component, ErrorName};

/// Number of equal intervals of the travel at whose ends a worn curve is tabulated. The sampling coordinates of the
/// previous curve are added, because the equal intervals alone would alias the periodic error of a screw.
const NODES: u32 = 64;
/// Maximum deflection of a guide by wear, µm per month at load 1, before a random factor for each error.
const GUIDE_UM: f64 = 0.06;
/// Elongation of a screw by wear, µm per month at load 1, before the same factor.
const SCREW_UM: f64 = 0.08;
/// Growth of the backlash, µm or µrad per month. It reduces the reversal value (forward minus backward), because the carriage lags.
const PLAY: f64 = 0.05;
/// Growth of the eccentricity of a rotary axis's gear, µrad per month.
const GEAR_URAD: f64 = 0.2;
/// Growth of the run-out of a rotary axis's bearing, µm per month.
const BEARING_UM: f64 = 0.02;
/// Standard deviation of the drift of a squareness or parallelism, µrad per month.
const SETTLED_URAD: f64 = 0.15;
/// Standard deviation of the natural logarithm of the random factors.
const SPREAD: f64 = 0.4;

/// Operating time of a machine. Wear is proportional to `months` and `load`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wear {
    /// Months of operation.
    pub months: f64,
    /// Relative load: 1 is one shift of mixed parts.
    pub load: f64,
    /// Random seed; use another one for each machine.
    pub seed: u64,
}

/// Reasons why wear cannot be computed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WearError {
    /// Months or load are out of range.
    #[error("{what}: found {found}, expected 0 to {most}")]
    Number {
        /// `months` or `load`.
        what: &'static str,
        /// The rejected value.
        found: f64,
        /// Maximum value.
        most: f64,
    },
    /// The errors of the machine are no longer finite.
    #[error(transparent)]
    Curve(#[from] CurveError),
    /// The machine rejects the worn error.
    #[error(transparent)]
    Machine(#[from] ModelError),
}

/// Result of ageing a machine.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Worn {
    /// The machine with its worn errors.
    pub machine: Machine,
    /// Errors that were not changed, because they are grids over two axes.
    pub left: Vec<ErrorName>,
}

impl Wear {
    /// Computes the worn machine. The wear of an error does not depend on which other axes the machine has.
    ///
    /// # Errors
    /// Months outside 0 to 1200, a load outside 0 to 100, errors that are no longer finite.
    pub fn of(&self, machine: &Machine) -> Result<Worn, WearError> {
        for (what, found, most) in [("months", self.months, 1200.0), ("load", self.load, 100.0)] {
            if !(0.0..=most).contains(&found) {
                return Err(WearError::Number { what, found, most });
            }
        }
        let mut worn = Worn { machine: machine.clone(), left: Vec::new() };
        if self.months * self.load == 0.0 {
            return Ok(worn);
        }
        for (place, axis) in machine.axes().iter().enumerate() {
            let direction = machine.chain().joints()[place].direction;
            let along = direction.iamax();
            match axis.name.kind() {
                AxisKind::Linear => self.linear(&mut worn, axis.name, along)?,
                AxisKind::Rotary => self.rotary(&mut worn, axis.name, along)?,
            }
        }
        let mut settled: Vec<ErrorName> = machine.locations().keys().copied().collect();
        settled.extend(SQUARENESSES.map(|(component, axis)| ErrorName::location(component, axis)));
        settled.sort();
        settled.dedup();
        for name in settled {
            if name.component.is_angular() && machine.axis(name.axis).is_some() {
                let before = machine.locations().get(&name).copied().unwrap_or(0.0);
                let drift = SETTLED_URAD * self.amount() * self.draws(name).normal();
                worn.machine.set_location(name, rounded(before + drift))?;
            }
        }
        Ok(worn)
    }

    fn amount(&self) -> f64 {
        self.months * self.load
    }

    fn draws(&self, name: ErrorName) -> Draws {
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        let of_axis = u64::from(u32::from(name.axis.letter()));
        let place = name.component as u64 + if name.location { 8 } else { 0 };
        random.set_stream(256 * of_axis + place);
        Draws(random)
    }

    /// Adds the wear of a linear axis: the guides wear where the axis is used most, the carriage tilts along the bent guide, and the screw
    /// elongates in the same zone.
    fn linear(&self, worn: &mut Worn, axis: AxisName, along: usize) -> Result<(), WearError> {
        let Some([low, high]) = worn.machine.axis(axis).map(|axis| axis.travel) else {
            return Ok(());
        };
        let span = high - low;
        let own = ErrorName::motion(LINEAR[along], axis);
        let mut draws = self.draws(own);
        // The working zone: centre and half width of a bump.
        let zone = Zone {
            middle: low + span * (0.5 + 0.15 * draws.normal()).clamp(0.2, 0.8),
            half: 0.4 * span,
        };
        let stretched = SCREW_UM * self.amount() * draws.factor() * draws.sign();
        let play = PLAY * self.amount() * draws.factor();
        worn.add(own, -play, |q| stretched * zone.passed(q))?;
        for (about, across) in [(1, 2), (2, 1)].map(|(a, b)| ((along + a) % 3, (along + b) % 3)) {
            let name = ErrorName::motion(LINEAR[across], axis);
            let mut draws = self.draws(name);
            let bent = GUIDE_UM * self.amount() * draws.factor() * draws.sign();
            worn.add(name, 0.0, |q| bent * zone.bump(q))?;
            // The tilt is the slope of the bent guide, with the sign by the right-hand rule; µm/mm is mrad.
            let turned = if (along + 1) % 3 == across { 1e3 } else { -1e3 };
            let tilt = ErrorName::motion(ANGULAR[about], axis);
            worn.add(tilt, 0.0, |q| turned * bent * zone.slope(q))?;
        }
        Ok(())
    }

    /// Adds the wear of a rotary axis: backlash and eccentricity of the gear, run-out of the bearing.
    fn rotary(&self, worn: &mut Worn, axis: AxisName, about: usize) -> Result<(), WearError> {
        let own = ErrorName::motion(ANGULAR[about], axis);
        for (component, amplitude) in [
            (own.component, GEAR_URAD),
            (LINEAR[(about + 1) % 3], BEARING_UM),
            (LINEAR[(about + 2) % 3], BEARING_UM),
        ] {
            let name = ErrorName::motion(component, axis);
            let mut draws = self.draws(name);
            let amplitude = amplitude * self.amount() * draws.factor();
            let phase = std::f64::consts::PI * draws.normal();
            let reversal = if name == own { -PLAY * self.amount() * draws.factor() } else { 0.0 };
            worn.add(name, reversal, |q| amplitude * (q.to_radians() + phase).sin())?;
        }
        Ok(())
    }
}

/// Rounds a position, an error or an angle to 1e-6 mm, µm or µrad.
fn rounded(value: f64) -> f64 {
    // Adding 0 turns −0 into 0.
    (1e6 * value).round() / 1e6 + 0.0
}

const LINEAR: [Component; 3] = [Component::EX, Component::EY, Component::EZ];
const ANGULAR: [Component; 3] = [Component::EA, Component::EB, Component::EC];
const SQUARENESSES: [(Component, AxisName); 3] =
    [(Component::EC, AxisName::Y), (Component::EA, AxisName::Z), (Component::EB, AxisName::Z)];

impl Worn {
    /// Adds `more(position)` to the mean of an error of the machine, and `reversal` to its reversal value.
    fn add(
        &mut self,
        name: ErrorName,
        reversal: f64,
        more: impl Fn(f64) -> f64,
    ) -> Result<(), WearError> {
        let Some([low, high]) = self.machine.axis(name.axis).map(|axis| axis.travel) else {
            return Ok(());
        };
        let sum = |before: &Field, sign: f64| -> Result<Option<Field>, CurveError> {
            let Field::Curve(before) = before else {
                return Ok(None);
            };
            let inner = (1..NODES)
                .map(|node| rounded(low + (high - low) * f64::from(node) / f64::from(NODES)));
            let even = [low, high].into_iter().chain(inner);
            let mut places: Vec<f64> =
                even.chain(before.places().into_iter().map(rounded)).collect();
            places.retain(|q| (low..=high).contains(q));
            places.sort_by(f64::total_cmp);
            places.dedup_by(|a, b| (*a - *b).abs() < 1e-6 * (high - low));
            let node = |q: f64| {
                let worn = before.value(q) + more(q) + 0.5 * sign * reversal;
                [q, rounded(worn)]
            };
            let table = Table::cubic(places.into_iter().map(node).collect())?;
            Ok(Some(Curve::Table(table).into()))
        };
        let before = self.machine.error(name).cloned();
        let nothing = || Curve::constant(0.0).map(|zero| ErrorCurve::Single(zero.into()));
        let after = match before.map_or_else(nothing, Ok)? {
            ErrorCurve::Single(mean) => match sum(&mean, 0.0)? {
                Some(mean) if reversal == 0.0 => Some(ErrorCurve::Single(mean)),
                Some(mean) => Some(ErrorCurve::with_reversal(mean, rounded(reversal))?),
                None => None,
            },
            ErrorCurve::Reversal { mean, reversal: before } => match sum(&mean, 0.0)? {
                Some(mean) => Some(ErrorCurve::with_reversal(mean, rounded(before + reversal))?),
                None => None,
            },
            ErrorCurve::Pair { forward, backward } => (sum(&forward, 1.0)?
                .zip(sum(&backward, -1.0)?))
            .map(|(forward, backward)| ErrorCurve::Pair { forward, backward }),
        };
        match after {
            Some(curve) => self.machine.set_error(name, curve)?,
            None => self.left.push(name),
        }
        Ok(())
    }
}

#[derive(Clone, Copy, Debug)]
struct Zone {
    middle: f64,
    half: f64,
}

impl Zone {
    /// A smooth bump: 1 at the centre, 0 outside the zone.
    fn bump(self, q: f64) -> f64 {
        let at = ((q - self.middle) / self.half).clamp(-1.0, 1.0);
        0.5 * (1.0 + (std::f64::consts::PI * at).cos())
    }

    fn slope(self, q: f64) -> f64 {
        let at = ((q - self.middle) / self.half).clamp(-1.0, 1.0);
        -0.5 * std::f64::consts::PI / self.half * (std::f64::consts::PI * at).sin()
    }

    /// Integral of the bump up to `q` as a fraction of the whole: 0 before the zone, 1 after it.
    fn passed(self, q: f64) -> f64 {
        let at = ((q - self.middle) / self.half).clamp(-1.0, 1.0);
        0.5 * (1.0 + at + (std::f64::consts::PI * at).sin() / std::f64::consts::PI)
    }
}

struct Draws(ChaCha8Rng);

impl Draws {
    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    fn factor(&mut self) -> f64 {
        (SPREAD * self.normal()).exp()
    }

    fn sign(&mut self) -> f64 {
        if self.normal() < 0.0 { -1.0 } else { 1.0 }
    }
}
