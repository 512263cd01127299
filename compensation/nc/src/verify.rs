//! How far the tool of a virtual machine is from where a program wants it, with the program as it is and with its result.

use std::{
    io::{self, BufRead},
    sync::mpsc::{SyncSender, sync_channel},
    thread,
};

use volcomp_model::{Machine, Temperatures, Thermal, vocabulary::CorrectionLimit};

use crate::{
    Average, Decimals, NcError,
    comparison::Comparison,
    correction::Corrector,
    deviation::{Deviation, Place},
    dialect::Dialect,
    inspect::Inspected,
    made::Made,
    part_file::Part,
    program::execute,
    rewrite::Rewriter,
    setup::SetUp,
};

/// Motions that wait between two threads.
pub(crate) const WAITING: usize = 1024;

/// A program and its result on a virtual machine.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "schema", derive(serde::Serialize, schemars::JsonSchema))]
#[non_exhaustive]
pub struct Verification {
    /// With the original program.
    pub before: Deviation,
    /// With the compensated program.
    pub after: Deviation,
    /// Motions with whose result the tool is further off than before.
    pub further: Further,
    /// Motions that were looked at; those that pass on without a correction are not among them.
    pub motions: u64,
    /// Places on them that were looked at.
    pub places: u64,
    /// Some of these places, evenly spread, in the order of the program.
    #[cfg_attr(feature = "schema", serde(skip))]
    pub path: Vec<Place>,
    /// The features of the part, if one is to be inspected.
    #[cfg_attr(feature = "schema", serde(skip))]
    pub features: Vec<Inspected>,
    /// Any of the motions is written in inches.
    #[cfg_attr(feature = "schema", serde(skip))]
    pub in_inches: bool,
}

/// Motions with whose result the tool is further off than with the original program, by more than the 0.01 µm that are printed: in the
/// root of the mean square of its places, or in the largest deviation of them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "schema", derive(serde::Serialize, schemars::JsonSchema))]
#[non_exhaustive]
pub struct Further {
    /// How many there are.
    pub motions: u64,
    /// By how much at the most, µm.
    pub by_um: f64,
    /// The line of that one in the original program, counted from 1; `None` where there is none.
    pub line: Option<usize>,
}

/// What a verification needs to know besides the two programs.
#[derive(Clone, Copy, Debug)]
pub struct Virtual<'a> {
    /// The machine whose errors are the real ones.
    pub truth: &'a Machine,
    /// The temperatures of the machine.
    pub temperatures: &'a Temperatures,
    /// What the programs rely on.
    pub setup: &'a SetUp,
    /// Blocks that are executed at the most.
    pub most_blocks: u64,
    /// The language of the programs.
    pub dialect: Dialect,
    /// The part whose features are to be inspected, and the correction of the result: of each work offset that the set-up states, the zero
    /// is probed on the machine without correction, and the error that this correction has there is added to it for the result.
    pub part: Option<(&'a Part, &'a Corrector)>,
}

/// Runs a program and its result through a virtual machine. `shares` are those of
/// [`Summary`](crate::Summary): in which parts each motion was written.
///
/// # Errors
/// What executing the programs says; a result whose motions are others than those of the program.
pub fn verify(
    original: &mut (impl BufRead + Send),
    result: &mut (impl BufRead + Send),
    shares: &[f64],
    of: Virtual<'_>,
) -> Result<Verification, NcError> {
    compare(original, result, &mut shares.iter().copied(), of, None)
}

/// The same for the result of [`average`](crate::average) and the mean corrections that it has returned.
///
/// # Errors
/// As [`verify`].
pub fn verify_average(
    original: &mut (impl BufRead + Send),
    result: &mut (impl BufRead + Send),
    averages: &[Average],
    of: Virtual<'_>,
) -> Result<Verification, NcError> {
    let shares = &mut std::iter::repeat(1.0);
    compare(original, result, shares, of, Some(averages))
}

fn compare(
    original: &mut (impl BufRead + Send),
    result: &mut (impl BufRead + Send),
    shares: &mut dyn Iterator<Item = f64>,
    of: Virtual<'_>,
    averages: Option<&[Average]>,
) -> Result<Verification, NcError> {
    // Executed on a machine without errors: no line is changed.
    let mut ideal = of.truth.clone();
    ideal.clear_errors();
    ideal.set_thermal(Thermal::default())?;
    let ideal = Corrector::new(&ideal, of.temperatures, 1.0)?;
    let truth = Corrector::new(of.truth, of.temperatures, 1.0)?;
    thread::scope(|scope| {
        let (to_original, originals) = sync_channel(WAITING);
        let (to_result, results) = sync_channel(WAITING);
        let ideal = &ideal;
        let runs = [
            scope.spawn(move || {
                motions(
                    original,
                    ideal,
                    of.setup,
                    (of.dialect, of.most_blocks),
                    to_original,
                )
            }),
            scope.spawn(move || {
                motions(
                    result,
                    ideal,
                    of.setup,
                    (of.dialect, of.most_blocks),
                    to_result,
                )
            }),
        ];
        let compared = Comparison::new(truth, &of, averages).all(&originals, &results, shares);
        // A sender that goes on gets an error.
        drop((originals, results));
        for run in runs {
            match run.join() {
                Ok(Err(error)) if !is_end(&error) => return Err(error),
                Ok(_) => {}
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        compared
    })
}

/// A run that was stopped since nobody listens any more.
pub(crate) fn is_end(error: &NcError) -> bool {
    matches!(error, NcError::Io(error) if error.kind() == io::ErrorKind::BrokenPipe)
}

/// Sends the motions of a program, one after the other.
pub(crate) fn motions(
    program: &mut impl BufRead,
    ideal: &Corrector,
    setup: &SetUp,
    (dialect, most_blocks): (Dialect, u64),
    to: SyncSender<Made>,
) -> Result<(), NcError> {
    let mut rewriter = Rewriter::new(
        setup,
        ideal.clone(),
        Decimals::default(),
        dialect,
        CorrectionLimit::default(),
    )?;
    rewriter.tells = Some(to);
    // Both programs have been read by now.
    rewriter.interpreter.points.may_mix = true;
    execute(program, &mut io::sink(), rewriter, most_blocks, |_| Ok(()))?;
    Ok(())
}

/// The result has other motions than the program, at a line of it.
pub(crate) fn other_motions(line: usize) -> NcError {
    NcError::Flow {
        line,
        what: "the result does not make the motions of the program: this is a defect of the program that made it, please report it".to_owned(),
    }
}
