//! The lines of one error as one curve, or one for each direction.

use volcomp_curve::{ErrorCurve, Field};
use volcomp_fit::Fit;
use volcomp_metrology::ReferenceLine;
use volcomp_vocabulary::{Direction, ErrorName};

use crate::{
    calibrate::FittedCurve,
    curve_choice::CurveChoice,
    error::CalibrateError,
    track::{Kind, Points, Track, line_through},
};

/// Lines are moved to agree until they move less than this.
const LINES_AGREE_UM: f64 = 1e-6;
/// Each round leaves at most half of the disagreement where lines share their targets.
const ROUNDS: usize = 40;

/// A mean reading is this many standard deviations off at the most: one in 370.
const WITHIN_SIGMAS: f64 = 3.0;

/// How far a curve may pass by the mean readings, µm or µrad, for what the runs scatter.
fn within_noise(tracks: &[Track<'_>]) -> Option<f64> {
    let noise = tracks.iter().filter_map(Track::noise_of_mean);
    noise.reduce(f64::max).map(|noise| WITHIN_SIGMAS * noise)
}

/// The fits of an error, forward first; one of them at least.
#[derive(Clone)]
pub(crate) struct Branches {
    fits: Vec<(Direction, Fit)>,
    targets: Vec<f64>,
}

impl Branches {
    /// Fits all lines of an error, each direction by itself.
    ///
    /// An instrument is set to zero anew for every line, and a straightness reference is aligned
    /// anew: constants (of straightness also slopes) between lines carry nothing, so lines are moved
    /// onto the first one by what they differ from the common curve in the mean.
    pub(crate) fn fit(
        choice: CurveChoice,
        tracks: &mut [Track<'_>],
    ) -> Result<Self, CalibrateError> {
        let mut branches = Self::fit_once(choice, tracks)?;
        for _ in 1..ROUNDS {
            let Some((first, others)) = tracks.split_first_mut() else {
                break;
            };
            let stays = branches.offset_of(first)?;
            let mut largest = 0.0_f64;
            for track in others {
                let line = branches.offset_of(track)?;
                let line = ReferenceLine {
                    slope_um_per_mm: line.slope_um_per_mm - stays.slope_um_per_mm,
                    intercept_um: line.intercept_um - stays.intercept_um,
                };
                let moved = track.all().map(|(target, _)| line.value_um(*target).abs());
                largest = moved.fold(largest, f64::max);
                track.remove_line(&line);
            }
            if largest < LINES_AGREE_UM {
                break;
            }
            branches = Self::fit_once(choice, tracks)?;
        }
        Ok(branches)
    }

    fn fit_once(choice: CurveChoice, tracks: &[Track<'_>]) -> Result<Self, CalibrateError> {
        let mut fits = Vec::new();
        for (index, direction) in Direction::BOTH.into_iter().enumerate() {
            let points = tracks.iter().flat_map(|track| &track.points[index]);
            let (x, u): (Vec<f64>, Vec<f64>) = points.copied().unzip();
            if x.is_empty() {
                continue;
            }
            let fit = choice
                .fit(&x, &u, within_noise(tracks))
                .map_err(|error| CalibrateError::readings(tracks, &error))?;
            tracing::debug!(
                "{} {}: {} leaves {:.3}, left out {:.3}",
                tracks[0].line.setup.error,
                direction.name(),
                fit.curve.kind(),
                fit.rms(),
                fit.leave_one_out_rms
            );
            fits.push((direction, fit));
        }
        if fits.is_empty() {
            return Err(CalibrateError::readings(tracks, &"no readings"));
        }
        let mut targets: Vec<f64> = tracks.iter().flat_map(Track::all).map(|p| p.0).collect();
        targets.sort_by(f64::total_cmp);
        targets.dedup();
        Ok(Self { fits, targets })
    }

    /// What readings minus curve are in the mean over one measured line: of straightness a line, else
    /// a constant.
    fn offset_of(&self, track: &Track<'_>) -> Result<ReferenceLine, CalibrateError> {
        let residuals: Points = self
            .fits
            .iter()
            .flat_map(|(direction, fit)| {
                let points = track.points[*direction as usize].iter();
                points.map(|(target, value)| (*target, value - fit.curve.value(*target)))
            })
            .collect();
        if Kind::of(track.line.setup.error) == Kind::Straightness {
            return Ok(line_through(residuals)?);
        }
        let sum: f64 = residuals.iter().map(|(_, residual)| residual).sum();
        Ok(ReferenceLine {
            slope_um_per_mm: 0.0,
            intercept_um: sum / residuals.len().max(1) as f64,
        })
    }

    /// Mean of the branches at a coordinate.
    pub(crate) fn mean_at(&self, coordinate: f64) -> f64 {
        let values = self.fits.iter().map(|(_, fit)| fit.curve.value(coordinate));
        values.sum::<f64>() / self.fits.len() as f64
    }

    /// (curve − `zero`) × `factor`, residuals with it.
    pub(crate) fn scaled(&self, factor: f64, zero: f64) -> Self {
        let mut scaled = self.clone();
        for (_, fit) in &mut scaled.fits {
            fit.curve = fit.curve.clone().offset(-zero).scaled(factor);
            for residual in &mut fit.residuals {
                *residual *= factor;
            }
            fit.leave_one_out_rms *= factor.abs();
        }
        scaled
    }

    /// How well each branch follows its readings.
    pub(crate) fn fitted(&self, error: ErrorName) -> Vec<FittedCurve> {
        let reversal = self.reversal();
        let both = self.fits.len() == 2;
        let row = |(direction, fit): &(Direction, Fit)| FittedCurve {
            error,
            direction: both.then_some(*direction),
            kind: fit.curve.kind(),
            readings: fit.residuals.len(),
            residual: [fit.min(), fit.max()],
            rms: fit.rms(),
            leave_one_out: fit.leave_one_out_rms,
            reversal,
        };
        self.fits.iter().map(row).collect()
    }

    fn reversal(&self) -> Option<f64> {
        let [(_, forward), (_, backward)] = &self.fits[..] else {
            return None;
        };
        let difference = |&target: &f64| forward.curve.value(target) - backward.curve.value(target);
        self.targets
            .iter()
            .map(difference)
            .max_by(|a, b| a.abs().total_cmp(&b.abs()))
    }

    /// One curve, or a pair.
    pub(crate) fn into_curve(self) -> ErrorCurve {
        let mut fields = self
            .fits
            .into_iter()
            .map(|(_, fit)| Field::Curve(fit.curve));
        match (fields.next(), fields.next()) {
            (Some(forward), Some(backward)) => ErrorCurve::Pair { forward, backward },
            (Some(single), None) => ErrorCurve::Single(single),
            // `fit_once` makes one fit at least.
            (None, _) => ErrorCurve::Single(Field::Curve(volcomp_curve::Curve::Constant(0.0))),
        }
    }
}
