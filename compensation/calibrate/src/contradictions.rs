//! Notes on lines of one error that contradict each other after the tilts of their axis have been taken out.

use volcomp_metrology::MotionKind;
use volcomp_vocabulary::ErrorName;

use crate::{profile::Profile, side_by_side::SideBySide};

/// Lines differ when they do by so many times their noise.
const TIMES_NOISE: f64 = 3.0;
/// Differences that are nowhere larger matter to no machine tool, µm or µrad.
const NEVER_BELOW: f64 = 0.5;
/// No instrument reads more finely, µm or µrad.
const LEAST_NOISE: f64 = 0.01;
/// A factor on the tilts explains a difference when so much of its square goes with it.
const EXPLAINED: f64 = 0.9;

/// Notes on the lines of an error that do not agree within their noise. `read` are the profiles as they were read, `cleared`
/// the same without what tilts and locations add.
pub(crate) fn contradictions(
    error: ErrorName,
    read: &[Profile<'_>],
    cleared: &[Profile<'_>],
) -> Vec<String> {
    let mut notes = Vec::new();
    for (second, (read_2, cleared_2)) in read.iter().zip(cleared).enumerate() {
        for (read_1, cleared_1) in read.iter().zip(cleared).take(second) {
            notes.extend(contradiction(
                error,
                [read_1, read_2],
                [cleared_1, cleared_2],
            ));
        }
    }
    notes
}

fn contradiction(
    error: ErrorName,
    read: [&Profile<'_>; 2],
    cleared: [&Profile<'_>; 2],
) -> Option<String> {
    let is_straightness = MotionKind::of(error) == MotionKind::Straightness;
    let difference_of = |profiles: &[&Profile<'_>]| {
        let beside = SideBySide::of(profiles, is_straightness)?;
        let pairs = beside.lines[0].iter().zip(&beside.lines[1]);
        let difference: Vec<f64> = pairs.map(|(first, second)| first - second).collect();
        Some((difference, beside))
    };
    let (difference, beside) = difference_of(&cleared)?;
    let noise = noise(cleared, &beside)?.max(LEAST_NOISE);
    let rms = (dot(&difference, &difference) / difference.len() as f64).sqrt();
    let largest = difference
        .iter()
        .fold(0.0_f64, |largest, d| largest.max(d.abs()));
    if rms <= TIMES_NOISE * noise || largest <= NEVER_BELOW {
        return None;
    }
    let unit = error.component.symbol();
    let [first, second] = cleared.map(|profile| profile.line.file.display().to_string());
    // What the tilts took out of the difference of the two lines.
    let raw = difference_of(&read)?.0;
    let taken: Vec<f64> = raw
        .iter()
        .zip(&difference)
        .map(|(raw, left)| raw - left)
        .collect();
    let (along, size) = (dot(&difference, &taken), dot(&taken, &taken));
    let is_explained = along * along > EXPLAINED * size * dot(&difference, &difference);
    let cause = if size > 0.0 && is_explained {
        format!(
            "they would agree with {:.2} times the tilts of {}: check unit and sign of its angular files, and `point` and `at` of these",
            1.0 + along / size,
            error.axis
        )
    } else {
        "check the files, and their `point`, `at` and `sign`".to_owned()
    };
    Some(format!(
        "{error}: {first} and {second} contradict each other by up to ±{largest:.1} {unit}, {:.0} times their noise of {noise:.2} {unit}: {cause}",
        rms / noise
    ))
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// The standard deviation of the difference of two lines: from repeated runs, else from how unevenly each runs from target
/// to target, which also stands for what is lost where targets had to be interpolated.
fn noise(profiles: [&Profile<'_>; 2], beside: &SideBySide) -> Option<f64> {
    let mut variance = 0.0;
    for (profile, values) in profiles.iter().zip(&beside.lines) {
        let of_runs = profile.noise_of_mean();
        let own = match of_runs {
            Some(noise) if !beside.is_interpolated => noise,
            Some(noise) => noise.max(uneven(values)?),
            None => uneven(values)?,
        };
        variance += own * own;
    }
    Some(variance.sqrt())
}

/// The standard deviation of values about a smooth course: of second differences, whose variance is six times theirs.
fn uneven(values: &[f64]) -> Option<f64> {
    let seconds = values.windows(3).map(|v| v[0] - 2.0 * v[1] + v[2]);
    let squares: Vec<f64> = seconds.map(|d| d * d).collect();
    let mean = squares.iter().sum::<f64>() / squares.len().max(1) as f64;
    (!squares.is_empty()).then(|| (mean / 6.0).sqrt())
}
