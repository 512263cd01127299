//! Notes on observations that are too few for what is asked of them, and on errors that are too large for a machine.

use std::{collections::BTreeSet, ops::Range};

use crate::{
    identify::Fitted,
    observations::{Observations, Seen},
    params::{Column, Param, Part},
    prepared::Rows,
    system::System,
    uncertain::LARGEST,
};

/// Fewer numbers for each unknown leave nearly nothing by which it could be judged.
const FEW: f64 = 1.5;

/// Notes on files that say nothing of the machine, on spheres that were met once, and on numbers that hardly exceed the
/// unknowns.
pub(crate) fn thin(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    fitted: &Fitted,
) -> Vec<String> {
    let mut notes = Vec::new();
    let parts = |own: Range<usize>| -> BTreeSet<Part> {
        own.flat_map(|row| rows.get(row).seen.parts()).collect()
    };
    let of_files: Vec<BTreeSet<Part>> = observations.fitted().map(|(_, own)| parts(own)).collect();
    for ((observation, own), parts) in observations.fitted().zip(&of_files) {
        let is_own = |part: &&Part| {
            of_files
                .iter()
                .filter(|others| others.contains(part))
                .count()
                == 1
        };
        let unknowns: usize = parts
            .iter()
            .filter(is_own)
            .map(|part| {
                // What a calibration says of a number is one more number.
                let calibrated = match part {
                    Part::Number(place) => observations.setup.numbers[*place].known_within,
                    Part::Point(place) => observations.setup.points[*place].known_within,
                    Part::Frame(_) => None,
                };
                let is_calibrated = |column: &&Column| column.order == 0 && calibrated.is_some();
                let columns = system.params.of(*part);
                columns.len() - columns.iter().filter(is_calibrated).count()
            })
            .sum();
        let numbers: usize = own.map(|row| rows.get(row).seen.count()).sum();
        if unknowns > 0 && numbers <= unknowns {
            notes.push(format!(
                "{}: {numbers} numbers for {unknowns} unknowns of its own set-up say nothing of the machine",
                observation.file
            ));
        }
    }
    for (place, point) in observations.setup.points.iter().enumerate() {
        let meets = |row: &&crate::observations::Row| matches!(row.seen, Seen::Sphere { centre, .. } if centre == place);
        if point.unknown && rows.iter().filter(meets).count() == 1 {
            notes.push(format!(
                "{} was met once: that says where it is, and nothing of the machine",
                point.name
            ));
        }
    }
    let numbers: usize = rows.iter().map(|row| row.seen.count()).sum();
    let found = fitted.rank.kept.len();
    // With penalties the unknowns count less, but more unknowns than numbers are few numbers all the same.
    let counted = fitted.solution.degrees;
    if (numbers as f64) < FEW * counted || numbers < found {
        notes.push(format!(
            "{numbers} numbers in {} poses for {found} unknowns: they fit nearly whatever the machine is, so observe more poses before you trust what is found",
            rows.poses().1
        ));
    }
    notes
}

/// Notes on errors that are larger than those of machines.
pub(crate) fn large(system: &System, fitted: &Fitted) -> Vec<String> {
    const SHOWN: usize = 5;
    let values = &fitted.solution.values;
    let mut large: Vec<(f64, usize)> = Vec::new();
    for (place, &param) in fitted.rank.kept.iter().enumerate() {
        let what = system.params.at(param);
        // µm and µrad to mm and mrad.
        let size = 1e-3 * system.unit_of(param).1 * values.of(what).abs();
        let variance = fitted.solution.covariance[(place, place)].max(0.0);
        // What is only uncertain says so by its uncertainty.
        let is_sure = values.of(what).abs() > 3.0 * variance.sqrt();
        if matches!(what, Param::Coefficient(_)) && size > LARGEST && is_sure {
            large.push((size, param));
        }
    }
    large.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut notes: Vec<String> = large
        .iter()
        .take(SHOWN)
        .map(|(size, param)| {
            let unit = if system.unit_of(*param).0 == "um" {
                "mm"
            } else {
                "mrad"
            };
            format!(
                "{} is found to be {size:.1} {unit}: is that the machine, or a sign, a unit, a tool or a point in the machine file?",
                system.name(*param)
            )
        })
        .collect();
    if large.len() > SHOWN {
        notes.push(format!(
            "{} more errors beyond 1 mm or 1 mrad",
            large.len() - SHOWN
        ));
    }
    notes
}
