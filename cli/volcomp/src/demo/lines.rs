//! The measured lines before and after correction, and the floor below which nothing can be expected.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use volcomp_calibrate::{Method, Setup};
use volcomp_kinematics::State;
use volcomp_metrology::{self as metrology, MotionKind, ReferenceLine, squareness_parts};
use volcomp_model::Temperatures;
use volcomp_shop::{LineOfSight, Shop, ShopLine};
use volcomp_vocabulary::{Direction, ErrorName, Urad};

use crate::failure::Failure;

/// Resolution of the controller's correction.
pub(crate) const OUTPUT_STEP_MM: f64 = 1e-3;
const POINTS: usize = 61;
const TRIALS: u64 = 100;
/// More steps of a bridge than any line has.
const MAX_STEPS: usize = 100_000;

/// One measured line before and after.
pub(crate) struct LineResult {
    pub(crate) error: ErrorName,
    /// Where the other axes stand.
    pub(crate) description: String,
    pub(crate) is_straightness: bool,
    /// Largest minus smallest deviation over the line, µm; of straightness after its best-fit line is taken out.
    pub(crate) before_um: f64,
    pub(crate) after_um: f64,
    pub(crate) floor_um: f64,
    /// Slopes of the least-squares lines before and after.
    slopes: [Urad; 2],
}

impl LineResult {
    pub(crate) fn ratio(&self) -> f64 {
        self.after_um / self.floor_um
    }
}

/// A squareness as the slopes of the straightness lines show it.
pub(crate) struct Squareness {
    pub(crate) error: ErrorName,
    pub(crate) before: Urad,
    pub(crate) after: Urad,
}

/// Every linear line of the shop on the truth machine: as it is, and with `command` in place of the
/// target.
pub(crate) fn compare_lines(
    shop: &Shop,
    command: &impl Fn(&State) -> State,
    mut progress: impl FnMut(usize),
) -> Result<Vec<LineResult>, Failure> {
    let none = Temperatures::new();
    let errors = shop.truth.source(&none);
    let mut results = Vec::new();
    for (index, line) in shop.lines.iter().enumerate() {
        progress(index + 1);
        if line.setup.error.component.is_angular() {
            continue;
        }
        // What a bridge measured is judged by the straightness itself.
        let setup = Setup {
            method: Method::Direct,
            ..line.setup.clone()
        };
        let sight = LineOfSight::new(&shop.truth, &setup)?;
        let targets = points(shop, line);
        let profile = |command: &dyn Fn(&State) -> State| -> Vec<(f64, f64)> {
            let reading = |&target: &f64| {
                let state = sight.state(target, Direction::Positive);
                (target, sight.reading(&errors, &state, &command(&state)))
            };
            targets.iter().map(reading).collect()
        };
        let name = line.setup.error;
        let is_straightness = MotionKind::of(name) == MotionKind::Straightness;
        let before = profile(&|state| *state);
        let after = profile(command);
        let slope = |profile: &[(f64, f64)]| {
            ReferenceLine::least_squares(profile).map_or(Urad(0.0), |line| line.slope())
        };
        results.push(LineResult {
            error: name,
            description: description(shop, line),
            is_straightness,
            before_um: peak_to_peak(&before, is_straightness),
            after_um: peak_to_peak(&after, is_straightness),
            floor_um: floor(shop.seed, line, &before, is_straightness),
            slopes: [slope(&before), slope(&after)],
        });
    }
    Ok(results)
}

fn points(shop: &Shop, line: &ShopLine) -> Vec<f64> {
    let axis = shop.truth.axis(line.setup.error.axis);
    let [low, high] = axis.map_or([0.0; 2], |axis| axis.travel);
    let last = (POINTS - 1) as f64;
    (0..POINTS)
        .map(|index| low + (high - low) * index as f64 / last)
        .collect()
}

fn description(shop: &Shop, line: &ShopLine) -> String {
    let axes = shop.truth.axes().iter().zip(&line.setup.at);
    let held: Vec<String> = axes
        .filter(|(axis, at)| axis.name != line.setup.error.axis && **at != 0.0)
        .map(|(axis, at)| format!("{}={at}", axis.name))
        .collect();
    format!("at {}", held.join(" "))
}

/// Largest minus smallest value, of straightness after its least-squares line is removed.
fn peak_to_peak(profile: &[(f64, f64)], is_straightness: bool) -> f64 {
    let removed = if is_straightness {
        ReferenceLine::least_squares(profile).map(|line| line.removed_from(profile))
    } else {
        Ok(profile.to_vec())
    };
    let values = removed.unwrap_or_default();
    let largest = values.iter().map(|p| p.1).fold(f64::NEG_INFINITY, f64::max);
    let smallest = values.iter().map(|p| p.1).fold(f64::INFINITY, f64::min);
    largest - smallest
}

/// The residual (peak to peak, µm) that would remain if the curve between the targets were known exactly: the noise
/// of the mean of the runs at the targets, interpolated in straight lines between them, and the rounding of the
/// output.
fn floor(seed: u64, line: &ShopLine, truth: &[(f64, f64)], is_straightness: bool) -> f64 {
    let instrument = &line.instrument;
    let runs = f64::from(instrument.runs).sqrt();
    // The tilts of a bridge add up from target to target.
    let (noise, targets, adds_up) = match line.setup.method {
        Method::Direct => (instrument.length.noise.0, instrument.targets, false),
        Method::Angular { bridge_mm, .. } => {
            let ends = truth.first().zip(truth.last());
            let travel = ends.map_or(0.0, |(first, last)| last.0 - first.0);
            let places = (0..=MAX_STEPS).map(|step| bridge_mm * step as f64);
            let steps = places.skip(1).take_while(|place| *place <= travel + 1e-9);
            let steps = steps.count();
            (instrument.angle.noise.0 * bridge_mm * 1e-3, steps + 1, true)
        }
    };
    let noise = noise / runs;
    let step = OUTPUT_STEP_MM * 1e3;
    let mut sum = 0.0;
    for trial in 0..TRIALS {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(trial);
        let mut sum_of_tilts = 0.0;
        let at_targets: Vec<f64> = (0..targets)
            .map(|_| {
                let unit: f64 = StandardNormal.sample(&mut random);
                if adds_up {
                    sum_of_tilts += noise * unit;
                    sum_of_tilts
                } else {
                    noise * unit
                }
            })
            .collect();
        let left: Vec<(f64, f64)> = truth
            .iter()
            .enumerate()
            .map(|(index, &(target, value))| {
                let share = index as f64 / (truth.len() - 1) as f64;
                let known = value + between(&at_targets, share);
                (target, value - (known / step).round() * step)
            })
            .collect();
        sum += peak_to_peak(&left, is_straightness);
    }
    sum / TRIALS as f64
}

/// Straight between equally spaced values, `share` from 0 to 1.
fn between(values: &[f64], share: f64) -> f64 {
    let place = share * (values.len() - 1) as f64;
    let pairs = values.windows(2).enumerate();
    let mut parts = pairs.map(|(first, pair)| (place - first as f64, pair));
    let (part, pair) = parts
        .find(|(part, _)| *part <= 1.0)
        .unwrap_or((0.0, &[0.0; 2]));
    pair[0] * (1.0 - part) + pair[1] * part
}

/// The squareness errors of the shop from the slopes of its lines.
pub(crate) fn squareness(shop: &Shop, lines: &[LineResult]) -> Vec<Squareness> {
    let value = |error: ErrorName, which: usize| {
        let slope = |part: ErrorName| {
            let line = lines.iter().find(|line| line.error == part)?;
            Some((part, line.slopes[which]))
        };
        let [first, second] = squareness_parts(error).ok()?;
        metrology::squareness(error, Urad(0.0), [slope(first)?, slope(second)?]).ok()
    };
    let both = |&(error, _): &(ErrorName, Urad)| {
        Some(Squareness {
            error,
            before: value(error, 0)?,
            after: value(error, 1)?,
        })
    };
    shop.squareness.iter().filter_map(both).collect()
}
