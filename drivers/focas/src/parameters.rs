//! Parameters of the control that must match the configuration: the source of the machine zero point shift and the unit
//! of positions.
//!
//! - Parameter 1203#0: the extended external machine zero point shift is in use.
//! - Parameter 1280: first R address of the words of this shift, two bytes for each axis of the control.
//! - Parameter 1001#0 (INM): the machine coordinate system counts in inches.
//! - Parameter 3104#0 (MCN): positions are reported in the unit of the program. Parameter 0#2 (INI): that unit is the
//!   inch.
//!
//! These meanings are from memory of the manuals and unverified on a real control. So a control that does not report
//! the parameters is accepted.

use crate::{
    config::{FocasConfig, check_disjoint, without_axis_words},
    error::FocasError,
    pmc::{Block, PmcAddress, PmcArea},
};

/// Parameter whose lowest bit enables the extended external machine zero point shift.
pub(crate) const SHIFT_IN_USE: i32 = 1203;
/// Parameter with the first R address of the shift words.
pub(crate) const SHIFT_FIRST: i32 = 1280;

/// The words from which the control takes the machine zero point shift; see
/// [`Client::shift_source`](crate::Client::shift_source).
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum ShiftSource {
    #[cfg_attr(feature = "serde", serde(rename = "Told"))]
    Reported {
        /// Whether the extended external machine zero point shift is in use (parameter 1203#0).
        in_use: bool,
        /// Number of the first byte of the shift words in R (parameter 1280). Each axis has a word of two bytes.
        first: u32,
    },
    /// The control does not report the parameters, because it is too old for the request or lacks the option, or a
    /// value is invalid.
    #[cfg_attr(feature = "serde", serde(rename = "Untold"))]
    Unreported {
        /// Reason why the control does not report the parameters.
        why: String,
    },
}

impl ShiftSource {
    /// Compares the reported shift source with a configuration. Returns remarks if both agree.
    ///
    /// Errors: the parameters name other source words than the configuration; or, if a ladder copies the configured
    /// words, the source words overlap them.
    pub(crate) fn check(
        &self,
        config: &FocasConfig,
        control_axes: usize,
    ) -> Result<Vec<String>, FocasError> {
        let area = config.shift.first;
        let is_direct = config.barrier.is_none() && !config.copied;
        let (in_use, first) = match self {
            Self::Reported { in_use, first } => (*in_use, *first),
            Self::Unreported { why } => {
                return Ok(vec![format!(
                    "the control does not report parameters 1203 and 1280 ({why}): the words from which it takes the \
                     shifts of the axes are unknown"
                )]);
            }
        };
        if !in_use && is_direct {
            return Err(FocasError::Parameter {
                parameter: "1203#0",
                meaning: "extended external machine zero point shift in use",
                found: "0".to_owned(),
                expected: format!(
                    "1, since the corrections are written to {area} for the control to take; or area.copied = true, \
                     where a ladder brings them to the axes"
                ),
            });
        }
        if !in_use {
            return Ok(vec![
                "parameter 1203#0 of the control is 0: the extended external machine zero point shift is not in use, so \
                 the ladder must bring the correction to the axes in another way"
                    .to_owned(),
            ]);
        }
        let wrong = |expected: String| FocasError::Parameter {
            parameter: "1280",
            meaning: "first R address of the words from which the control takes the shifts",
            found: first.to_string(),
            expected,
        };
        if is_direct {
            return if area.area == PmcArea::R && u32::from(area.at) == first {
                Ok(Vec::new())
            } else {
                let expected = match area.area {
                    PmcArea::R => format!("{} as configured in area", area.at),
                    _ => format!("words in R, but area is {area}"),
                };
                Err(wrong(format!(
                    "{expected}; or area.copied = true, where a ladder copies the words on"
                )))
            };
        }
        let at = |byte: u32| {
            let at = u16::try_from(byte).ok();
            at.map(|at| PmcAddress { area: PmcArea::R, at })
        };
        let bytes = u32::try_from(control_axes).unwrap_or(u32::MAX).saturating_mul(2);
        let words = at(first).zip(at(first.saturating_add(bytes.saturating_sub(1))));
        let (first, last) =
            words.ok_or_else(|| wrong("words that end at byte 65535 at the latest".to_owned()))?;
        let words = Block {
            key: "",
            what: "the words from which the control takes the shifts (parameter 1280)",
            first,
            last,
        };
        for block in without_axis_words(config, control_axes)? {
            check_disjoint(&block, &words)?;
        }
        Ok(Vec::new())
    }
}

/// Parameters with the bits that determine the unit of reported positions.
pub(crate) const UNIT_NUMBERS: [i32; 3] = [1001, 3104, 0];

/// Checks that positions are in mm, by the reported values of `UNIT_NUMBERS`. Returns remarks if they are.
///
/// Errors: a parameter means that positions are in inches, or become so when a program selects inches.
pub(crate) fn check_units(reported: &[Result<u32, String>; 3]) -> Result<Vec<String>, FocasError> {
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
        let now = if is_set(program, 2) { "inches now" } else { "mm now" };
        return Err(wrong(
            "3104#0",
            "machine positions in the unit of the program",
            &format!(
                "0, mm independent of G20 and G21 in the program: parameter 0#2 selects {now}"
            ),
        ));
    }
    let unreported = reported[..2].iter().find_map(|reported| reported.as_ref().err());
    let note = unreported.map(|why| {
        format!(
            "the control does not report parameters 1001 and 3104 ({why}): the unit of its positions is not verified"
        )
    });
    Ok(note.into_iter().collect())
}
