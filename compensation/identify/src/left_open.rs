//! What the observations leave open: combinations of unknowns that move nothing in them.

use crate::{identify::Fitted, params::Param, rank::Rank, system::System};

/// An error coefficient that the observations leave open though it is no convention: it is left at zero, and whatever it is, they
/// read the same.
#[derive(Clone, Debug, PartialEq)]
pub struct LeftOpen {
    /// Its name among the unknowns.
    pub name: String,
    /// Its unit, `um` or `urad`.
    pub unit: &'static str,
    /// What goes unseen: the error coefficients, itself among them, and by how much each changes in its unit where this one is
    /// larger by one.
    pub moves: Vec<(String, f64)>,
}

/// What is left open and is no convention.
pub(crate) fn left_open(system: &System, rank: &Rank) -> Vec<LeftOpen> {
    let is_error = |null: &&Vec<(usize, f64)>| system.is_convention(null[0].0) == Some(false);
    let open = rank.null.iter().filter(is_error).map(|null| {
        let left = null[0].0;
        let (unit, _) = system.unit_of(left);
        // Weights are those of columns of unit length.
        let change = |&(param, weight): &(usize, f64)| {
            let length = rank.lengths[param];
            let length = if length > 0.0 { length } else { 1.0 };
            weight / length * system.unit_of(param).1
        };
        let whole = change(&null[0]);
        let errors = (null.iter())
            .filter(|(param, _)| matches!(system.params.at(*param), Param::Coefficient(_)));
        LeftOpen {
            name: system.name(left),
            unit,
            moves: errors
                .map(|share| (system.name(share.0), change(share) / whole))
                .collect(),
        }
    });
    open.collect()
}

/// The names of the unknowns that are left at zero and are conventions: constants of curves and slopes of straightnesses.
pub(crate) fn redundant(system: &System, rank: &Rank) -> Vec<String> {
    let left = rank.left_at_zero();
    left.filter(|column| system.is_convention(*column) == Some(true))
        .map(|column| system.name(column))
        .collect()
}

/// Notes on what cannot be told apart: one for each unknown that more observations could tell, one for all that are conventions.
pub(crate) fn left_at_zero(
    system: &System,
    fitted: &Fitted,
    null: &[Vec<(String, f64)>],
) -> Vec<String> {
    let rank = &fitted.rank;
    let is_convention = |place: &usize| {
        let left = rank.null[*place][0].0;
        system.is_convention(left) == Some(true)
    };
    let (conventions, missing): (Vec<usize>, Vec<usize>) = (0..null.len()).partition(is_convention);
    let is_setup = |place: usize| rank.null[place][0].0 < system.params.setup();
    let words = |place: &usize| {
        let mut uncertain = fitted.uncertain.iter();
        match uncertain.find(|of| of.param == rank.null[*place][0].0) {
            Some(of) => of.words(system),
            None => null_in_words(&null[*place], is_setup(*place)),
        }
    };
    let mut notes: Vec<String> = missing.iter().map(words).collect();
    match &conventions[..] {
        [] => {}
        [one] => notes.push(words(one)),
        several => {
            let names: Vec<&str> = several
                .iter()
                .map(|place| null[*place][0].0.as_str())
                .collect();
            notes.push(format!(
                "left at zero by convention, since they move the tool like location errors, other constants or the set-up: {}",
                names.join(", ")
            ));
        }
    }
    notes
}

/// A combination that moves nothing, in words.
fn null_in_words(null: &[(String, f64)], is_setup: bool) -> String {
    const SHOWN: usize = 4;
    let (left, others) = (&null[0].0, &null[1..]);
    let where_left = if is_setup {
        "as it was at the start"
    } else {
        "at zero"
    };
    if others.is_empty() {
        return format!("{left} moves nothing in these observations: it is left {where_left}");
    }
    let mut names: Vec<&str> = others.iter().map(|(name, _)| name.as_str()).collect();
    let more = names.len().saturating_sub(SHOWN);
    names.truncate(SHOWN);
    let mut with = names.join(", ");
    if more > 0 {
        with = format!("{with} and {more} more");
    }
    format!("{left} cannot be told apart from {with}: it is left {where_left}")
}
