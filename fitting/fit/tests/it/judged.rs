//! Compares the automatic choice with each kind of curve alone, by refits without each target and by the known truth.

use volcomp_fit::{Choice, FitOptions, Method, choose};

use crate::generated::{Generated, generated};

/// Maximum number of targets that are omitted in turn; they are evenly spread.
const LEFT_OUT: usize = 40;

/// A method and its errors.
pub(crate) struct Judged {
    pub(crate) method: Method,
    /// RMS error at inner targets of curves that are refitted without these targets, µm.
    pub(crate) leave_one_out: f64,
    /// RMS of curve minus truth over the range, µm.
    pub(crate) from_truth: f64,
}

/// A generated line with the automatic choice and the best curve of each kind.
pub(crate) struct Row {
    pub(crate) line: Generated,
    pub(crate) choice: Choice,
    pub(crate) automatic: Judged,
    pub(crate) kinds: Vec<Judged>,
}

impl Row {
    /// Errors of the automatic choice relative to the best single kind: leave-one-out error, and distance from the
    /// truth.
    pub(crate) fn ratios(&self) -> [f64; 2] {
        let ratio = |of: fn(&Judged) -> f64| {
            let best = self.kinds.iter().map(of).fold(f64::INFINITY, f64::min);
            of(&self.automatic) / best
        };
        [ratio(|j| j.leave_one_out), ratio(|j| j.from_truth)]
    }
}

/// Comparisons on `count` generated lines. Lines with more than `refitted` targets are not refitted; their
/// leave-one-out error is NaN.
pub(crate) fn rows(count: u32, refitted: usize) -> impl Iterator<Item = Row> {
    (0..count).map(move |index| {
        let line = generated(17, index);
        let sets: Vec<(Vec<f64>, Vec<f64>)> =
            line.sides.iter().map(|side| side.readings(&line.targets)).collect();
        let parts: Vec<(&[f64], &[f64])> = sets.iter().map(|(x, u)| (&x[..], &u[..])).collect();
        let choice = choose(&parts, &FitOptions::default()).expect("a choice");
        let judged = |method| judged(&line, &sets, method, refitted);
        let kinds = choice.best_of_kinds();
        Row {
            automatic: judged(choice.method),
            kinds: kinds.iter().map(|score| judged(score.method)).collect(),
            line,
            choice,
        }
    })
}

fn judged(
    line: &Generated,
    sets: &[(Vec<f64>, Vec<f64>)],
    method: Method,
    refitted: usize,
) -> Judged {
    let (mut missed, mut off) = ((0.0, 0.0_f64), (0.0, 0.0_f64));
    let last = line.targets.len() - 1;
    let step = last.div_ceil(LEFT_OUT);
    for ((x, u), side) in sets.iter().zip(&line.sides) {
        let fit = method.fit(x, u).expect("a fit");
        for k in (0..=200).map(|k| f64::from(k) / 200.0) {
            let at = line.targets[0] + k * (line.targets[last] - line.targets[0]);
            off.0 += (fit.curve.value(at) - (side.truth)(at)).powi(2);
            off.1 += 1.0;
        }
        if line.targets.len() > refitted {
            continue;
        }
        for &left in line.targets[1..last].iter().step_by(step) {
            let others = || x.iter().zip(u).filter(|(x, _)| **x != left);
            let (kept_x, kept_u): (Vec<f64>, Vec<f64>) = others().unzip();
            let own: Vec<f64> =
                x.iter().zip(u).filter(|(x, _)| **x == left).map(|p| *p.1).collect();
            let mean = own.iter().sum::<f64>() / own.len() as f64;
            // A method that cannot be fitted without the target makes no prediction there.
            let value =
                method.fit(&kept_x, &kept_u).map_or(f64::INFINITY, |fit| fit.curve.value(left));
            missed.0 += (mean - value).powi(2);
            missed.1 += 1.0;
        }
    }
    Judged {
        method,
        leave_one_out: (missed.0 / missed.1).sqrt(),
        from_truth: (off.0 / off.1).sqrt(),
    }
}
