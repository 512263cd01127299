//! The choice of the grid: as few lines as keep the bound.

use crate::{
    Field, GRID_AXES, MOST_WORDS, Request, Table, TablesError, misfit,
    sample::{lattice, norm},
    wanted::Wanted,
};

/// The smallest map that keeps the bound.
///
/// The number of lines along each axis follows from the second differences of the field along lines through the work space;
/// then the map is made, and held against the field on a dense sample between its lines; where that shows more than the
/// bound, more lines are taken.
///
/// # Errors
/// Numbers that make no sense, a correction beyond its limit, a bound that no grid keeps or that needs more words than there are.
pub fn build(request: &Request, field: &impl Field) -> Result<Table, TablesError> {
    let mut wanted = Wanted::of(request)?;
    let largest = wanted.survey(request, field)?;
    wanted.choose_scale(largest);
    let rounding_mm = wanted.rounding_mm();
    let reversal_mm = wanted.take_reversals(field);
    let rest_mm = request.within_mm - rounding_mm - reversal_mm;
    if rest_mm <= 0.0 {
        return Err(TablesError::Unreachable {
            within_um: request.within_mm * 1e3,
            rounding_um: rounding_mm * 1e3,
            reversal_um: reversal_mm * 1e3,
        });
    }
    let ladders: Vec<Vec<Rung>> = (0..request.axes.len())
        .map(|axis| wanted.ladder(axis, field, rest_mm))
        .collect();
    let found = wanted.smallest(request, &ladders, field)?;
    let best = match found {
        Some(table) if table.map.words().len() <= request.words => return Ok(table),
        _ => wanted.best_within(request, &ladders, field)?,
    };
    match best {
        Some(table) if table.misfit.max_mm <= request.within_mm => Ok(table),
        best => Err(TablesError::Memory {
            within_um: request.within_mm * 1e3,
            needed: found.as_ref().map(|table| table.map.words().len()),
            lines: said(request, found.as_ref()),
            words: request.words,
            reached_um: best.map(|table| table.misfit.max_mm * 1e3),
        }),
    }
}

/// `lines along X 21, Y 11`.
fn said(request: &Request, table: Option<&Table>) -> String {
    let Some(table) = table else {
        return "more lines than a grid has".to_owned();
    };
    let lines = &table.map.header().lines;
    let each: Vec<String> = request
        .axes
        .iter()
        .zip(lines)
        .map(|(axis, lines)| format!("{} {}", axis.name, lines.count))
        .collect();
    format!("lines along {}", each.join(", "))
}

/// A number of lines along an axis, and the error that they alone make, mm.
#[derive(Clone, Copy, Debug)]
struct Rung {
    count: u16,
    error_mm: f64,
}

/// The smallest grid whose errors of all axes together keep the target: where more lines are needed, the axis that gains most for
/// the words gets them.
fn lines_for(ladders: &[Vec<Rung>], target_mm: f64) -> Option<Vec<u16>> {
    let mut at = vec![0; ladders.len()];
    loop {
        let rungs = ladders.iter().zip(&at).map(|(ladder, at)| ladder.get(*at));
        let rungs: Vec<&Rung> = rungs.collect::<Option<_>>()?;
        if rungs.iter().map(|rung| rung.error_mm).sum::<f64>() <= target_mm {
            return Some(rungs.iter().map(|rung| rung.count).collect());
        }
        let gain = |axis: usize| {
            let here = rungs[axis];
            let above = ladders[axis].iter().enumerate().skip(at[axis] + 1);
            let (next, rung) = above
                .into_iter()
                .find(|(_, rung)| rung.error_mm < here.error_mm)?;
            let growth = (f64::from(rung.count) / f64::from(here.count)).ln();
            Some((axis, next, (here.error_mm - rung.error_mm) / growth))
        };
        let best = (0..ladders.len()).filter_map(gain);
        let (axis, next, _) = best.max_by(|a, b| a.2.total_cmp(&b.2))?;
        at[axis] = next;
    }
}

impl Wanted {
    /// The errors of more and more lines along one axis.
    fn ladder(&self, axis: usize, field: &impl Field, within_mm: f64) -> Vec<Rung> {
        let mut ladder = Vec::new();
        let mut count = 2_u16;
        // As many as a control can count where every other axis has two.
        let most = MOST_WORDS / (self.outputs.count() << (self.travels.len() - 1));
        loop {
            let error_mm = self.error_along(axis, count, field);
            ladder.push(Rung { count, error_mm });
            count += (count / 12).max(1);
            if error_mm <= 0.02 * within_mm || usize::from(count) > most {
                return ladder;
            }
        }
    }

    /// The largest error of straight lines between so many lines of an axis: half of the second difference over two halves of a
    /// pitch, with as many again between.
    fn error_along(&self, axis: usize, count: u16, field: &impl Field) -> f64 {
        const WITHIN: [f64; 3] = [0.25, 0.5, 0.75];
        let axes = self.travels.len();
        let lines = self.lines(axis, count);
        let pitch = f64::from(lines.pitch());
        let mut largest = 0.0_f64;
        let others = lattice(axes - 1, if axes <= 3 { 3 } else { 2 });
        for shares in others {
            let mut shares = shares;
            // The axis itself stands in between.
            shares[axis..].rotate_right(1);
            let mut at = self.place(&shares);
            let mut look = |steps: f64| {
                at[axis] = self.coordinate(axis, steps);
                field.correction_mm(&at, &[None; GRID_AXES])
            };
            let mut before = look(0.0);
            for line in 1..count {
                let start = f64::from(line - 1) * pitch;
                let after = look(start + pitch);
                for share in WITHIN {
                    let found = look(start + share * pitch);
                    let error = core::array::from_fn(|output| {
                        let straight = before[output] + share * (after[output] - before[output]);
                        found[output] - straight
                    });
                    largest = largest.max(norm(&error));
                }
                before = after;
            }
        }
        largest
    }

    /// The smallest map that keeps the bound, whatever words there are; `None` where it would have too many for any control.
    ///
    /// The errors along single axes add up to more than the error of the map, so the target is loosened where the map is
    /// better than it has to be, and tightened where it is worse.
    fn smallest(
        &self,
        request: &Request,
        ladders: &[Vec<Rung>],
        field: &impl Field,
    ) -> Result<Option<Table>, TablesError> {
        let mut best: Option<Table> = None;
        let mut target_mm = request.within_mm;
        let mut before = Vec::new();
        for _ in 0..10 {
            let Some(counts) = lines_for(ladders, target_mm) else {
                break;
            };
            if counts == before || self.words(&counts) > MOST_WORDS {
                break;
            }
            let table = self.table(request, &counts, field)?;
            let share = request.within_mm / table.misfit.max_mm.max(0.01 * request.within_mm);
            let words = table.map.words().len();
            let keeps = share >= 1.0;
            if keeps
                && best
                    .as_ref()
                    .is_none_or(|best| words < best.map.words().len())
            {
                best = Some(table);
            }
            target_mm *= if keeps {
                share.clamp(1.02, 2.0)
            } else {
                0.97 * share.max(0.5)
            };
            before = counts;
        }
        Ok(best)
    }

    /// The map on so many lines, and its error.
    fn table(
        &self,
        request: &Request,
        counts: &[u16],
        field: &impl Field,
    ) -> Result<Table, TablesError> {
        let map = self.map(request, counts, field)?;
        let misfit = misfit::of(&map, field, &request.travels());
        let steepest = misfit::steepest(&map);
        Ok(Table {
            map,
            misfit,
            steepest,
        })
    }

    /// The best map that the words have room for; `None` where they have room for none.
    fn best_within(
        &self,
        request: &Request,
        ladders: &[Vec<Rung>],
        field: &impl Field,
    ) -> Result<Option<Table>, TablesError> {
        let fits = |counts: &Vec<u16>| self.words(counts) <= request.words.min(MOST_WORDS);
        // Two lines along each axis keep this one.
        let most = ladders
            .iter()
            .filter_map(|ladder| ladder.first())
            .map(|rung| rung.error_mm);
        let (mut low, mut high) = (0.0, most.sum::<f64>());
        let mut best = lines_for(ladders, high).filter(fits);
        for _ in 0..30 {
            let middle = 0.5 * (low + high);
            match lines_for(ladders, middle).filter(fits) {
                Some(counts) => {
                    best = Some(counts);
                    high = middle;
                }
                None => low = middle,
            }
        }
        best.map(|counts| self.table(request, &counts, field))
            .transpose()
    }
}
