//! Effects of errors over many poses: of one unit of each error, or of the values of a machine.

use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

use nalgebra::Vector3;
use rayon::prelude::*;
use volcomp_kinematics::{Chain, ChainError, ErrorMotion, ErrorSource, State};
use volcomp_vocabulary::{AxisName, MAX_AXES};

use crate::error::SensitivityError;
use crate::term::{ErrorTerm, Gaps, InGap, twists};

/// Effect of one error over the poses: of one unit (1 µm of a displacement, 1 µrad of a rotation) in [`sensitivity`](crate::sensitivity()),
/// or of a machine's values in [`effects_of`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "schema", derive(serde::Serialize, schemars::JsonSchema))]
pub struct Effect {
    /// Name of the error.
    #[cfg_attr(feature = "schema", serde(rename = "name"))]
    pub term: ErrorTerm,
    /// Root mean square of the displacement of the tool tip, µm.
    pub position_rms_um: f64,
    /// Largest displacement of the tool tip, µm.
    pub position_max_um: f64,
    /// Root mean square of the rotation of the tool, µrad.
    pub orientation_rms_urad: f64,
    /// Largest rotation of the tool, µrad.
    pub orientation_max_urad: f64,
    /// Fraction of the mean square displacement that this error causes if all errors are
    /// independent.
    pub share: f64,
}

const MAX_POSES: usize = 1 << 28;

/// Returns the number of poses, if it is within the limit and the chain has the axes of all errors.
pub(crate) fn checked(
    chain: &Chain,
    terms: &[ErrorTerm],
    poses: &Poses,
) -> Result<usize, SensitivityError> {
    if terms.is_empty() {
        return Err(SensitivityError::NoErrors);
    }
    let found = poses.count();
    let count = found
        .filter(|count| (1..=MAX_POSES).contains(count))
        .ok_or(SensitivityError::Poses { found, most: MAX_POSES })?;
    for &term in terms {
        let axis = term.axis();
        if chain.structure().index_of(axis).is_none() {
            let term = term.to_string();
            return Err(SensitivityError::NoSuchAxis { term, axis });
        }
    }
    Ok(count)
}

/// Sum and maximum of the squares of the displacement (mm²) and of the rotation (rad²).
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Squares {
    position: [f64; 2],
    rotation: [f64; 2],
}

impl Squares {
    pub(crate) fn take(&mut self, [position, rotation]: [Vector3<f64>; 2]) {
        let of = |v: Vector3<f64>| [v.norm_squared(); 2];
        self.join(&Self { position: of(position), rotation: of(rotation) });
    }

    pub(crate) fn join(&mut self, other: &Self) {
        let both = |one: [f64; 2], other: [f64; 2]| [one[0] + other[0], one[1].max(other[1])];
        self.position = both(self.position, other.position);
        self.rotation = both(self.rotation, other.rotation);
    }
}

/// Computes the first-order effect on the tool of each error alone, with the values (µm or µrad) of a source, over the poses. An error motion is
/// evaluated at each pose, for the pose's direction of approach.
///
/// # Errors
/// See [`sensitivity`](crate::sensitivity()).
pub fn effects_of(
    chain: &Chain,
    source: &(impl ErrorSource + Sync),
    terms: &[ErrorTerm],
    poses: &Poses,
) -> Result<Vec<Effect>, SensitivityError> {
    effects_of_with_progress(chain, source, terms, poses, |_, _| {})
}

/// Like [`effects_of`]; `progress` receives, from any thread, the number of finished poses and their total number.
///
/// # Errors
/// See [`effects_of`].
pub fn effects_of_with_progress(
    chain: &Chain,
    source: &(impl ErrorSource + Sync),
    terms: &[ErrorTerm],
    poses: &Poses,
    progress: impl Fn(usize, usize) + Sync,
) -> Result<Vec<Effect>, SensitivityError> {
    let count = checked(chain, terms, poses)?;
    let made_of: Vec<(usize, Vec<InGap>)> = terms
        .iter()
        // All axes were checked above, so nothing is filtered out.
        .filter_map(|&term| Some((chain.structure().index_of(term.axis())?, twists(chain, term))))
        .collect();
    let parts: Vec<Vec<Squares>> = chunks(count, &progress, |places| {
        let mut sums = vec![Squares::default(); terms.len()];
        for place in places {
            let state = poses.state(place);
            let gaps = Gaps::at(chain, &state);
            let mut motions = [ErrorMotion::ZERO; MAX_AXES];
            for (axis, motion) in motions.iter_mut().enumerate().take(chain.joints().len()) {
                *motion = source.error_motion(axis, &state);
            }
            for ((sums, term), (axis, twists)) in sums.iter_mut().zip(terms).zip(&made_of) {
                let six = match term {
                    ErrorTerm::Assembly(..) => source.assembly(*axis),
                    ErrorTerm::Named(name) if name.location => source.location(*axis),
                    ErrorTerm::Named(_) => motions[*axis],
                };
                let value = component_of(&six, *term);
                sums.take(gaps.effect(twists).map(|v| v * value));
            }
        }
        sums
    });
    let mut sums = vec![Squares::default(); terms.len()];
    for part in &parts {
        for (sums, other) in sums.iter_mut().zip(part) {
            sums.join(other);
        }
    }
    effects(terms, &sums, count, |_| 1.0)
}

/// Component of a motion that belongs to a term, mm or rad.
fn component_of(six: &ErrorMotion, term: ErrorTerm) -> f64 {
    let along = term.component().mcs_index();
    if term.component().is_angular() { six.angular_rad[along] } else { six.linear_mm[along] }
}

/// Effects of errors with the value `size` (mm or rad), from the squares for one unit (mm or rad) of each
/// error.
pub(crate) fn effects(
    terms: &[ErrorTerm],
    squares: &[Squares],
    count: usize,
    size: impl Fn(ErrorTerm) -> f64,
) -> Result<Vec<Effect>, SensitivityError> {
    let square =
        |(term, squares): (&ErrorTerm, &Squares)| squares.position[0] * size(*term).powi(2);
    let total: f64 = terms.iter().zip(squares).map(square).sum();
    let effect = |(term, squares): (&ErrorTerm, &Squares)| {
        let sizes = |[sum, largest]: [f64; 2], micro: f64| {
            [(sum / count as f64).sqrt(), largest.sqrt()].map(|of_one| of_one * size(*term) * micro)
        };
        let [position_rms_um, position_max_um] = sizes(squares.position, 1e3);
        let [orientation_rms_urad, orientation_max_urad] = sizes(squares.rotation, 1e6);
        let part = square((term, squares));
        Effect {
            term: *term,
            position_rms_um,
            position_max_um,
            orientation_rms_urad,
            orientation_max_urad,
            share: if total > 0.0 { part / total } else { 0.0 },
        }
    };
    let found: Vec<Effect> = terms.iter().zip(squares).map(effect).collect();
    let is_finite = |effect: &Effect| {
        [
            effect.position_rms_um,
            effect.position_max_um,
            effect.orientation_rms_urad,
            effect.orientation_max_urad,
        ]
        .iter()
        .all(|size| size.is_finite())
    };
    if found.iter().all(is_finite) { Ok(found) } else { Err(SensitivityError::NotFinite) }
}

/// Poses of a chain, in mm and rad, in chain order.
#[derive(Clone, Debug, PartialEq)]
pub enum Poses {
    /// Every combination of the listed nodes of each axis.
    Grid(Vec<Vec<f64>>),
    /// Every combination of `count` evenly spaced nodes over the travel of each axis, both ends included; a count of 1 gives the middle.
    Even {
        /// Travel of each axis, mm or rad.
        travels: Vec<[f64; 2]>,
        /// Number of nodes of each axis.
        count: usize,
    },
    /// The listed poses, in order.
    List(Vec<State>),
}

impl Poses {
    /// Creates a grid of `count` evenly spaced nodes over the travel (mm, rad) of each axis, both ends included; a count of 1 gives the middle.
    ///
    /// # Errors
    /// See [`Chain::by_axis`].
    pub fn over(
        chain: &Chain,
        travels: impl IntoIterator<Item = (AxisName, [f64; 2])>,
        count: usize,
    ) -> Result<Self, ChainError> {
        let travels = chain.by_axis(travels)?;
        Ok(Self::Even { travels: travels[..chain.joints().len()].to_vec(), count })
    }

    /// Number of poses; `None` if it overflows.
    pub fn count(&self) -> Option<usize> {
        match self {
            Self::Grid(nodes) => {
                nodes.iter().try_fold(1_usize, |product, nodes| product.checked_mul(nodes.len()))
            }
            Self::Even { travels, count } => {
                travels.iter().try_fold(1_usize, |product, _| product.checked_mul(*count))
            }
            Self::List(states) => Some(states.len()),
        }
    }

    /// Pose at an index; in a grid the last axis varies fastest. Beyond the end a grid wraps around, and a list returns machine zero.
    pub fn state(&self, place: usize) -> State {
        let axes = match self {
            Self::List(states) => return states.get(place).copied().unwrap_or_default(),
            Self::Grid(nodes) => nodes.len(),
            Self::Even { travels, .. } => travels.len(),
        };
        let mut state = State::default();
        let mut rest = place;
        for (axis, q) in state.q.iter_mut().enumerate().take(axes).rev() {
            let count = self.nodes(axis).max(1);
            *q = self.node(axis, rest % count);
            rest /= count;
        }
        state
    }

    fn nodes(&self, axis: usize) -> usize {
        match self {
            Self::Grid(nodes) => nodes[axis].len(),
            Self::Even { count, .. } => *count,
            Self::List(_) => 0,
        }
    }

    fn node(&self, axis: usize, place: usize) -> f64 {
        match self {
            Self::Grid(nodes) => nodes[axis].get(place).copied().unwrap_or_default(),
            Self::Even { travels, count } => {
                let [low, high] = travels[axis];
                match count {
                    0 | 1 => 0.5 * (low + high),
                    _ => low + (high - low) * place as f64 / (count - 1) as f64,
                }
            }
            Self::List(_) => 0.0,
        }
    }
}

const CHUNK: usize = 2048;

/// Calls `work` for each chunk of the indices 0 to `count`. The results are in the order of the poses, so that joining them gives the same digits
/// in every run. `progress` receives, from any thread, the number of finished poses and their total number.
pub(crate) fn chunks<T: Send>(
    count: usize,
    progress: &(impl Fn(usize, usize) + Sync),
    work: impl Fn(Range<usize>) -> T + Sync,
) -> Vec<T> {
    let starts: Vec<usize> = (0..count).step_by(CHUNK).collect();
    let done = AtomicUsize::new(0);
    starts
        .into_par_iter()
        .map(|start| {
            let places = start..count.min(start + CHUNK);
            let more = places.len();
            let made = work(places);
            progress(done.fetch_add(more, Ordering::Relaxed) + more, count);
            made
        })
        .collect()
}
