//! Checks by its parameters that a control reports positions in mm.
//!
//! Parameter 1001#0 (INM) states whether the machine system counts in inches, 3104#0 (MCN) whether positions are reported in the unit of the
//! program, and 0#2 (INI) which unit that is at present. All three are from memory of manuals and were not verified on a real control, so a control
//! that does not report them is accepted.

use crate::error::FocasError;

/// Parameters of which one bit determines the unit of reported positions.
pub(crate) const NUMBERS: [i32; 3] = [1001, 3104, 0];

/// Checks the reported values of [`NUMBERS`] against mm, the unit of the configuration; returns notes if there is no conflict.
///
/// # Errors
/// The parameter by which positions are, or may become, inches.
pub(crate) fn check(reported: &[Result<u32, String>; 3]) -> Result<Vec<String>, FocasError> {
    let [inch_machine, in_unit_of_program, program] = reported;
    let is_set =
        |of: &Result<u32, String>, bit: u8| of.as_ref().is_ok_and(|word| word >> bit & 1 == 1);
    let wrong = |parameter, meaning, expected: &str| FocasError::Parameter {
        parameter,
        meaning,
        found: "1".to_owned(),
        expected: expected.to_owned(),
    };
    if is_set(inch_machine, 0) {
        return Err(wrong(
            "1001#0",
            "machine system in inches",
            "0: corrections and positions are counted in mm",
        ));
    }
    if is_set(in_unit_of_program, 0) {
        let now = if is_set(program, 2) {
            "inches now"
        } else {
            "mm now"
        };
        return Err(wrong(
            "3104#0",
            "machine positions in the unit of the program",
            &format!(
                "0, mm independent of G20 and G21 in the program: parameter 0#2 selects {now}"
            ),
        ));
    }
    let unreported = reported[..2]
        .iter()
        .find_map(|reported| reported.as_ref().err());
    let note = unreported.map(|why| {
        format!(
            "the control does not report parameters 1001 and 3104 ({why}): the unit of its positions is not verified"
        )
    });
    Ok(note.into_iter().collect())
}
