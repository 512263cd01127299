//! The automatic choice on 200 generated error curves with known truth, compared with each kind of curve alone.
//!
//! `cargo run --release -p volcomp-fit --example automatic`

#![allow(dead_code, reason = "the tests use the rest")]

#[path = "../tests/it/generated.rs"]
mod generated;
#[path = "../tests/it/judged.rs"]
mod judged;

use generated::{FAMILIES, NOISE};

fn main() {
    let all = std::env::args().any(|a| a == "--all");
    let rows: Vec<judged::Row> = judged::rows(200, usize::MAX).collect();
    if all {
        for (index, row) in rows.iter().enumerate() {
            let [loo, truth] = row.ratios();
            let line = &row.line;
            println!(
                "{index:3} {:10} noise {:3} targets {:3} runs {:2}  loo {loo:5.2} truth {truth:6.2}  {:.3} {}",
                line.family,
                line.noise,
                line.targets.len(),
                line.sides[0].runs.len(),
                row.automatic.from_truth,
                row.choice.method
            );
        }
    }
    println!(
        "family      noise µm  lines   leave-one-out: median, largest    from the truth: median, largest"
    );
    println!("                             times the best kind alone");
    for family in FAMILIES {
        for noise in NOISE {
            let of: Vec<[f64; 2]> = rows
                .iter()
                .filter(|row| row.line.family == family && row.line.noise == noise)
                .map(judged::Row::ratios)
                .collect();
            let column = |which: usize| {
                let mut ratios: Vec<f64> = of.iter().map(|r| r[which]).collect();
                ratios.sort_by(f64::total_cmp);
                (ratios[ratios.len() / 2], ratios[ratios.len() - 1])
            };
            let (loo, truth) = (column(0), column(1));
            println!(
                "{family:11} {noise:8.1} {:6} {:15.2} {:8.2} {:24.2} {:8.2}",
                of.len(),
                loo.0,
                loo.1,
                truth.0,
                truth.1
            );
        }
    }
    let mut counts: Vec<(&str, usize)> = Vec::new();
    for row in &rows {
        let kind = row.choice.method.kind();
        match counts.iter_mut().find(|c| c.0 == kind) {
            Some(count) => count.1 += 1,
            None => counts.push((kind, 1)),
        }
    }
    println!("chosen: {counts:?}");
    let mut all: Vec<[f64; 2]> = rows.iter().map(judged::Row::ratios).collect();
    all.sort_by(|a, b| a[1].total_cmp(&b[1]));
    let mean = (all.iter().map(|r| r[1].ln()).sum::<f64>() / all.len() as f64).exp();
    println!(
        "truth: geometric mean {mean:.3}, 90 % {:.2}, 97.5 % {:.2}, worst {:.2}",
        all[180][1], all[195][1], all[199][1]
    );
    // For each kind alone: the geometric mean, over all lines, of its distance from the truth divided by that of the
    // automatic choice.
    for kind in [
        "polynomial",
        "Chebyshev series",
        "smoothing B-spline",
        "moving least squares",
        "monotone table",
        "linear table",
    ] {
        let logs: Vec<f64> = rows
            .iter()
            .filter_map(|row| {
                let one = row.kinds.iter().find(|k| k.method.kind() == kind)?;
                Some((one.from_truth / row.automatic.from_truth).ln())
            })
            .collect();
        println!(
            "{kind:22} alone is {:.2} times as far from the truth in the mean ({} lines)",
            (logs.iter().sum::<f64>() / logs.len() as f64).exp(),
            logs.len()
        );
    }
}
