//! The part of `volcomp nc --verify`: the program and its result on the virtual machine, and whether the result is kept.

use std::{fs::File, io::BufReader, path::Path};

use volcomp_model::{Machine, Temperatures};
use volcomp_nc::{
    Alignment, Corrector, Decimals, Deviation, Note, Part, SetUp, Verification, Virtual, picture,
    verify, verify_average,
};

use super::{
    nc::{Arguments, Written, failure},
    nc_part, thermal_note,
};
use crate::{
    answers::nc::{NcDeviation, NcFurther, Verified},
    compensation::refuse_other_geometry,
    failure::Failure,
    output::OutputFile,
    table::folded,
};

/// A program that is judged on a virtual machine.
pub(super) struct OnTruth<'a> {
    pub(super) arguments: &'a Arguments,
    pub(super) model: (&'a Machine, &'a Temperatures),
    pub(super) setup: &'a SetUp,
    pub(super) part: Option<(&'a Part, &'a Corrector)>,
}

impl OnTruth<'_> {
    /// The program and its result on the virtual machine; a result that is worse than the program is refused.
    pub(super) fn verified(
        &self,
        made: &Written,
        result: &Path,
        drawn: Option<&mut OutputFile>,
        notes: &mut Vec<String>,
    ) -> Result<Verified, Failure> {
        let arguments = self.arguments;
        if arguments.truth.is_none() {
            notes.push("--verify without --truth: the model is judged by itself, which shows rounding and splits, not how well it knows the machine".to_owned());
        }
        let found = self.run(made, result, notes)?;
        notes.extend(is_better(&found, arguments, &left_out(made))?);
        if let Some(file) = drawn {
            file.append(picture(&found).as_bytes())?;
        }
        Ok(Verified {
            motions: found.motions,
            places: found.places,
            before: deviation(&found.before),
            after: deviation(&found.after),
            further: NcFurther {
                motions: found.further.motions,
                by_um: found.further.by_um,
                line: (found.further.motions > 0).then_some(found.further.line),
            },
            best_fit: self
                .part
                .map(|(part, _)| part.alignment == Alignment::BestFit),
            features: (arguments.inspect.as_deref())
                .map_or_else(Vec::new, |part| nc_part::document(&found.features, part)),
        })
    }

    fn run(
        &self,
        made: &Written,
        result: &Path,
        notes: &mut Vec<String>,
    ) -> Result<Verification, Failure> {
        let arguments = self.arguments;
        let read;
        let (truth, temperatures) = match &arguments.truth {
            Some(path) => {
                read = arguments.machine.spindle.read(path)?;
                refuse_other_geometry(path, &read.0, self.model.0, &"--machine")?;
                let note = thermal_note(&read.0, &read.1);
                notes.extend(note.map(|note| format!("{}: {note}", path.display())));
                (&read.0, &read.1)
            }
            None => self.model,
        };
        let of = Virtual {
            truth,
            temperatures,
            setup: self.setup,
            most_blocks: arguments.max_blocks,
            dialect: arguments.dialect(self.setup),
            part: self.part,
        };
        let open = |path: &Path| {
            let file = File::open(path).map_err(|e| Failure::in_file(path, e))?;
            Ok::<_, Failure>(BufReader::new(file))
        };
        let (mut original, mut result) = (open(&arguments.program)?, open(result)?);
        match made {
            Written::Compensated(summary) => {
                verify(&mut original, &mut result, &summary.shares, of)
            }
            Written::Averaged(averages) => verify_average(&mut original, &mut result, averages, of),
        }
        .map_err(|error| failure(&arguments.program, error))
    }
}

/// A result that is worse than the program is not kept. Worse is one whose form is: after alignment of the part the tool is further off
/// by the root of the mean square, or in one place by more than twice as much. A model with another zero moves the part as a whole, which
/// is no error of the part; where the tool is further off as a whole, the form must be better for it. Less than the tolerance and two
/// steps of the words does not count.
fn is_better(
    found: &Verification,
    arguments: &Arguments,
    left_out: &str,
) -> Result<Option<String>, Failure> {
    let Decimals { mm, inch, .. } = arguments.decimals;
    let Verification { before, after, .. } = found;
    let (unit_um, decimals) = if found.in_inches {
        (25.4e3, inch)
    } else {
        (1e3, mm)
    };
    let step_um = unit_um / 10_f64.powi(i32::from(decimals));
    let no_matter_um = arguments.tolerance + 2.0 * step_um;
    let is_worse = |rms: [f64; 2], max: [f64; 2]| {
        rms[1] > rms[0] + no_matter_um || max[1] > 2.0 * max[0] + no_matter_um
    };
    let form_is_worse = is_worse(
        [before.form_rms_um, after.form_rms_um],
        [before.form_max_um, after.form_max_um],
    );
    let is_further = is_worse([before.rms_um, after.rms_um], [before.max_um, after.max_um]);
    let form_is_better = after.form_rms_um < MUCH_BETTER * before.form_rms_um;
    if !form_is_worse && (form_is_better || !is_further) {
        return Ok(is_further.then(|| {
            format!(
                "with the result the whole part lies elsewhere, as with a model that has another zero: RMS {:.2} µm instead of {:.2} µm; after alignment {:.2} µm instead of {:.2} µm",
                after.rms_um, before.rms_um, after.form_rms_um, before.form_rms_um
            )
        }));
    }
    Err(Failure::Work(format!(
        "{}: not written, since the tool is further off with the result than without: at most {:.2} µm (line {}), RMS {:.2} µm, instead of at most {:.2} µm, RMS {:.2} µm; after alignment of the part at most {:.2} µm, RMS {:.2} µm, instead of at most {:.2} µm, RMS {:.2} µm{left_out}",
        arguments.output.display(),
        after.max_um,
        after.line,
        after.rms_um,
        before.max_um,
        before.rms_um,
        after.form_max_um,
        after.form_rms_um,
        before.form_max_um,
        before.form_rms_um
    )))
}

/// What a result lacks where it was not known where an axis stands, which may be why it is worse.
fn left_out(made: &Written) -> String {
    let Written::Compensated(summary) = made else {
        return String::new();
    };
    let notes = summary.notes.by_line();
    let axes: Vec<String> = (notes.iter())
        .filter_map(|(line, note)| match note {
            Note::LeftOut(axis) => Some(format!("{axis} from line {line} on")),
            _ => None,
        })
        .collect();
    if axes.is_empty() {
        return String::new();
    }
    format!(
        "; corrections are left out while it is not known where an axis stands ({}): [start] of the set-up file says it",
        axes.join(", ")
    )
}

/// A form that is better by less does not make up for a part that lies elsewhere: one or two places have no form.
const MUCH_BETTER: f64 = 0.9;

fn deviation(of: &Deviation) -> NcDeviation {
    NcDeviation {
        max_um: of.max_um,
        rms_um: of.rms_um,
        across_max_um: of.across_max_um,
        across_rms_um: of.across_rms_um,
        line: of.line,
        tip_mm: of.tip_mm,
        form_rms_um: of.form_rms_um,
        form_max_um: of.form_max_um,
    }
}

/// How far the tool is from where the program wants it, and the features of the part.
pub(super) fn text(verified: &Verified) -> String {
    let row = |name: &str, of: &NcDeviation| {
        let whole = [of.max_um, of.rms_um, of.across_max_um, of.across_rms_um];
        let form = [of.form_max_um, of.form_rms_um];
        let all = whole.iter().chain(&form);
        let cells: Vec<String> = all.map(|um| format!("{um:>9.2}")).collect();
        format!("{name:<8}{}\n", cells.concat())
    };
    let place = |name: &str, of: &NcDeviation| {
        let [x, y, z] = of.tip_mm;
        format!(
            "largest {name}: line {}, tip at {x:.1} {y:.1} {z:.1} mm\n",
            of.line
        )
    };
    let mut text = format!(
        "\nDeviation of the tool from the programmed path, {} motions looked at; across:\nwithout what is along the path; form: after alignment of the part, since how\nit lies is no error of it\n{:<8}{:>18}{:>18}{:>18}\n{:<8}{}\n",
        verified.motions,
        "",
        "whole",
        "across",
        "form",
        "",
        format!("{:>9}{:>9}", "max µm", "RMS µm").repeat(3)
    );
    text += &row("before", &verified.before);
    text += &row("after", &verified.after);
    text += &place("before", &verified.before);
    text += &place("after", &verified.after);
    let further = &verified.further;
    if let Some(line) = further.line {
        let sentence = format!(
            "In {} of {} motions the tool is further off with the result than before, in RMS or at most, by up to {:.2} µm (line {line}), as where words are rounded or a circle is kept.",
            further.motions, verified.motions, further.by_um
        );
        text += &folded(&sentence, "");
    }
    if let Some(best_fit) = verified.best_fit {
        text += &nc_part::text(&verified.features, best_fit);
    }
    text
}
