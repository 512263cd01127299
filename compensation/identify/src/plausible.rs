//! Rows that no machine like the nominal one can have given, and what they may be in place of it. They are judged file by
//! file: a file that is wrong throughout is no better for good ones beside it.

use std::ops::Range;

use volcomp_kinematics::nalgebra::Vector3;

use crate::{
    causes::{causes, with_cause},
    error::{Cause, FarFile, IdentifyError},
    judge::median,
    observations::{Observations, Row, Seen},
    prepared::Rows,
    shifted::shifted,
    span::Span,
    start::start,
    system::System,
    values::Values,
};

/// Machines miss by micrometres to tenths of a millimetre, one that was just put together by a few millimetres (of usual sizes). What is
/// further away is another sphere, tool, unit or sign.
const USUAL_MM: f64 = 10.0;
/// A row is explained where a cause leaves less than this share of what there is without it.
const EXPLAINED: f64 = 0.1;
/// A cause is named where it explains so much of a file's absurd rows: slips may be among them.
const MOST: f64 = 0.75;
/// Two causes are equally good where one leaves no more than so many times what the other leaves, or this, mm: a tenth of a
/// millimetre is what the errors of a machine make.
const ALIKE: f64 = 2.0;
const ALIKE_MM: f64 = 0.1;
/// So many absurd files are tried one by one before what was found counts: each takes a fit for every cause.
const ONE_BY_ONE: usize = 4;

/// A file with rows that are too far away.
struct Absurd {
    file: String,
    own: Range<usize>,
    far: Vec<usize>,
    causes: Vec<Cause>,
}

/// Rows with a cause taken away from some files.
struct Trial {
    cause: Cause,
    rows: Vec<Row>,
    /// Absurd rows that are explained less others that became absurd.
    score: isize,
    /// The median of the rows that are explained, mm.
    left_mm: f64,
    /// Places of the absurd files that are explained.
    explained: Vec<usize>,
    /// Places of the absurd files from which the cause was taken.
    changed: Vec<usize>,
}

/// Refuses rows that are further from the nominal machine than machines are, once set-ups were found without any error of
/// the machine (`values`).
pub(crate) fn plausible(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    values: &Values,
) -> Result<(), IdentifyError> {
    let limit_mm = Span::of(&system.machine, rows.iter()).limit_mm(USUAL_MM);
    let sizes = sizes(system, rows, values);
    let far = |own: &Range<usize>| {
        let far = own.clone().filter(|row| sizes[*row] > limit_mm);
        far.collect::<Vec<usize>>()
    };
    let files = observations.fitted().map(|(observation, own)| Absurd {
        file: observation.file.clone(),
        far: far(&own),
        own,
        causes: Vec::new(),
    });
    let absurd: Vec<Absurd> = files.filter(|file| !file.far.is_empty()).collect();
    match &absurd[..] {
        [] => return Ok(()),
        [only] if only.far.len() == 1 => {
            let row = only.far[0];
            return Err(IdentifyError::FarRow {
                file: only.file.clone(),
                line: rows.get(row).line,
                found_mm: sizes[row],
                limit_mm,
            });
        }
        _ => {}
    }
    let explained = explained(system, observations, (rows, limit_mm), &sizes, absurd);
    if explained.iter().any(|file| file.causes.is_empty()) {
        refuse_moved_sphere(system, observations, rows, limit_mm)?;
    }
    let mut files: Vec<FarFile> = explained
        .into_iter()
        .map(|absurd| {
            let of_far: Vec<f64> = absurd.far.iter().map(|row| sizes[*row]).collect();
            let worst = absurd.far.iter().copied();
            let worst = worst.max_by(|a, b| sizes[*a].total_cmp(&sizes[*b]));
            FarFile {
                file: absurd.file,
                // A file is absurd by one row at the least.
                line: worst.map_or(0, |row| rows.get(row).line),
                rows: absurd.far.len(),
                of: absurd.own.len(),
                typical_mm: median(&of_far),
                limit_mm,
                causes: absurd.causes,
            }
        })
        .collect();
    files.sort_by(|a, b| b.typical_mm.total_cmp(&a.typical_mm));
    Err(IdentifyError::FarRows { files })
}

/// The absurd files with the causes that explain them. Files that are absurd only by what others did to the set-up that they
/// share are left out.
fn explained(
    system: &System,
    observations: &Observations,
    (rows, limit_mm): (&Rows, f64),
    before: &[f64],
    mut absurd: Vec<Absurd>,
) -> Vec<Absurd> {
    let in_absurd = absurd.iter().flat_map(|file| file.own.clone());
    let in_absurd: Vec<&Row> = in_absurd.map(|row| rows.get(row)).collect();
    let causes = causes(&system.machine, &in_absurd);
    let mut now: Vec<Row> = rows.iter().cloned().collect();
    let mut before = before.to_vec();
    loop {
        let open: Vec<usize> = (0..absurd.len())
            .filter(|place| absurd[*place].causes.is_empty())
            .collect();
        // All that are open at once, and each for itself: a machine file may be wrong, or one file of rows.
        let mut sets = vec![open.clone()];
        if open.len() > 1 {
            sets.extend(open.iter().map(|place| vec![*place]));
        }
        let mut trials: Vec<Trial> = Vec::new();
        for some in sets.chunks(1 + ONE_BY_ONE) {
            for set in some {
                let tried = causes.iter().filter_map(|cause| {
                    trial(
                        system,
                        observations,
                        (&now, &before, limit_mm),
                        &absurd,
                        set,
                        cause,
                    )
                });
                // Each round gives a file its causes, so that the rounds end.
                trials.extend(tried.filter(|trial| {
                    let explained = &trial.explained;
                    explained.iter().any(|place| trial.changed.contains(place))
                }));
            }
            if !trials.is_empty() {
                break;
            }
        }
        if trials.is_empty() {
            // Three numbers explain more by chance than one cause does: only where nothing else does.
            let tried = sets.iter().take(1 + ONE_BY_ONE).filter_map(|set| {
                let places: Vec<Range<usize>> =
                    set.iter().map(|place| absurd[*place].own.clone()).collect();
                let cause = shifted(system, observations, &now, &places)?;
                let state = (&now[..], &before[..], limit_mm);
                let found = trial(system, observations, state, &absurd, set, &cause)?;
                let is_own = |place: &usize| found.changed.contains(place);
                found.explained.iter().any(is_own).then_some(found)
            });
            trials.extend(tried);
        }
        let better = |a: &&Trial, b: &&Trial| {
            let fewer = || b.changed.len().cmp(&a.changed.len());
            let by_score = a.score.cmp(&b.score).then_with(fewer);
            by_score.then_with(|| b.left_mm.total_cmp(&a.left_mm))
        };
        let Some(best) = trials.iter().max_by(better) else {
            return absurd;
        };
        let is_alike = |other: &&Trial| {
            other.score == best.score
                && other.changed == best.changed
                && other.left_mm <= (ALIKE * best.left_mm).max(ALIKE_MM)
        };
        let alike: Vec<Cause> = trials
            .iter()
            .filter(is_alike)
            .map(|trial| trial.cause.clone())
            .collect();
        for place in best
            .explained
            .iter()
            .filter(|place| best.changed.contains(place))
        {
            let file = &mut absurd[*place];
            file.causes.clone_from(&alike);
            now[file.own.clone()].clone_from_slice(&best.rows[file.own.clone()]);
        }
        let prepared = system.prepare(now.iter());
        let Ok(values) = start(system, observations, &prepared) else {
            return absurd;
        };
        before = sizes(system, &prepared, &values);
        // What others did to a set-up is gone with their cause.
        absurd.retain(|file| {
            !file.causes.is_empty() || file.own.clone().any(|row| before[row] > limit_mm)
        });
        if absurd.iter().all(|file| !file.causes.is_empty()) {
            return absurd;
        }
    }
}

/// Refuses a sphere that has one name in two files and stands at different places in them, where each of the files fits alone.
fn refuse_moved_sphere(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    limit_mm: f64,
) -> Result<(), IdentifyError> {
    let mut places: Vec<(usize, &str, Vector3<f64>)> = Vec::new();
    for (observation, own) in observations.fitted() {
        let alone = rows.only(|row| own.contains(&row));
        let mut centres: Vec<usize> = alone
            .iter()
            .filter_map(|row| match row.seen {
                Seen::Sphere { centre, .. } => Some(centre),
                _ => None,
            })
            .collect();
        centres.sort_unstable();
        centres.dedup();
        if centres.is_empty() {
            continue;
        }
        let Ok(values) = start(system, observations, &alone) else {
            continue;
        };
        if sizes(system, &alone, &values)
            .iter()
            .any(|size| *size > limit_mm)
        {
            continue;
        }
        for centre in centres {
            let at = values.points[centre][0];
            let is_same = |(other, _, _): &&(usize, &str, Vector3<f64>)| *other == centre;
            let mut before = places.iter().filter(is_same);
            if let Some((_, file, _)) = before.find(|(.., place)| (place - at).norm() > limit_mm) {
                let apart = places
                    .iter()
                    .filter(is_same)
                    .map(|(.., place)| (place - at).norm());
                return Err(IdentifyError::MovedSphere {
                    sphere: system.setup.points[centre].name.clone(),
                    files: [(*file).to_owned(), observation.file.clone()],
                    apart_mm: apart.fold(0.0, f64::max),
                });
            }
            places.push((centre, &observation.file, at));
        }
    }
    Ok(())
}

/// Takes a cause away from some of the absurd files; `None` where no set-up is found then.
fn trial(
    system: &System,
    observations: &Observations,
    (now, before, limit_mm): (&[Row], &[f64], f64),
    absurd: &[Absurd],
    set: &[usize],
    cause: &Cause,
) -> Option<Trial> {
    let mut rows = now.to_vec();
    for place in set {
        for row in absurd[*place].own.clone() {
            rows[row] = with_cause(&now[row], cause, &system.machine);
        }
    }
    let prepared = system.prepare(rows.iter());
    let values = start(system, observations, &prepared).ok()?;
    let sizes = sizes(system, &prepared, &values);
    let is_explained = |row: usize| {
        before[row] > limit_mm && sizes[row] <= (EXPLAINED * before[row]).min(limit_mm)
    };
    let is_new = |row: usize| before[row] <= limit_mm && sizes[row] > limit_mm;
    let score = |own: Range<usize>| -> isize {
        let of = |row| isize::from(is_explained(row)) - isize::from(is_new(row));
        own.map(of).sum()
    };
    let left: Vec<f64> = (0..rows.len())
        .filter(|row| is_explained(*row))
        .map(|row| sizes[row])
        .collect();
    let is_open = |place: &usize| {
        let file = &absurd[*place];
        let far = file
            .own
            .clone()
            .filter(|row| before[*row] > limit_mm)
            .count();
        file.causes.is_empty() && score(file.own.clone()) as f64 >= MOST * far.max(1) as f64
    };
    Some(Trial {
        cause: cause.clone(),
        score: score(0..rows.len()),
        left_mm: median(&left),
        explained: (0..absurd.len()).filter(is_open).collect(),
        changed: set.to_vec(),
        rows,
    })
}

/// How far each row is from what the machine is at these values, mm.
fn sizes(system: &System, rows: &Rows, values: &Values) -> Vec<f64> {
    let residuals = system.plain_residuals(rows, values);
    residuals.iter().map(Vector3::norm).collect()
}
