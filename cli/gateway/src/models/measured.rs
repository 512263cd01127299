//! From measurement files in a folder to a machine file: the draft with its questions, then the calibration and what a page
//! draws of it.
//!
//! The folder has the model in force as `machine.toml`, the calibration file as `calibration.toml`, and the measurement files in
//! `files`. Messages name files from this folder on.

use std::{
    collections::BTreeMap,
    fs, io,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use volcomp_calibrate::{
    Answer, Calibration, CalibrationFile, Draft, FitQuality, FittedCurve, LeftOver, Quality,
    Question, Subject, Turn, calibrate, draft,
};
use volcomp_document::InputError;
use volcomp_model::{Axis, Machine};
use volcomp_vocabulary::Urad;

use super::diagonals::diagonals;
use crate::{
    differences::{Differences, differences},
    documents::{
        CandidateDraft, CandidateResult, DraftAnswer, DraftQuestion, DraftedMeasurement, ModelFit,
    },
};

const MACHINE: &str = "machine.toml";
const CALIBRATION: &str = "calibration.toml";
/// The folder of the measurement files in the folder of an upload.
pub(crate) const FILES: &str = "files";

/// What is said of open questions, however many there are.
const LEAVE_NONE: &str = "leave none empty, or leave the measurement out. An empty field is not 0";

/// The uncertainty is found from so many calibrations with readings drawn again, where they take no longer than [`VARIED_AT_MOST`].
const TRIALS: u32 = 40;
/// With fewer nothing is said of the uncertainty.
const LEAST_TRIALS: u32 = 12;
const VARIED_AT_MOST: Duration = Duration::from_secs(20);
/// The seed of these draws: the same files give the same band.
const SEED: u64 = 1;
/// The ends of a band are so many standard uncertainties from the curve.
const COVERAGE: f64 = 2.0;

/// Why there is no machine file, in words, with files as a person knows them.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub(crate) struct NotMeasured(pub(crate) String);

impl NotMeasured {
    pub(crate) fn of(why: String) -> Self {
        Self(why)
    }
}

/// The folder of an upload.
#[derive(Clone, Debug)]
pub(crate) struct Folder(pub(crate) PathBuf);

impl Folder {
    /// Makes it, empty but for the model in force.
    pub(crate) fn make(&self, machine: &str) -> io::Result<()> {
        fs::create_dir_all(self.files())?;
        fs::write(self.0.join(MACHINE), machine)
    }

    /// Where the measurement files go.
    pub(crate) fn files(&self) -> PathBuf {
        self.0.join(FILES)
    }

    /// A message without the way to this folder.
    fn told(&self, message: &impl ToString) -> String {
        let way = format!("{}/", self.0.display());
        message.to_string().replace(&way, "")
    }

    fn wrong(&self, message: &impl ToString) -> NotMeasured {
        NotMeasured(self.told(message))
    }

    /// The machine that the measurements are of.
    fn machine(&self) -> Result<Machine, NotMeasured> {
        Machine::read(self.0.join(MACHINE)).map_err(|e| self.wrong(&e))
    }

    /// Looks through the files.
    pub(crate) fn draft(&self) -> Result<Draft, NotMeasured> {
        let machine = self.machine()?;
        let named = |path: &Path| self.told(&path.display());
        let draft = draft(&self.files(), &machine, MACHINE, named).map_err(|e| self.wrong(&e))?;
        if draft.proposed.is_empty() {
            let reasons: Vec<String> = draft.left_over.iter().map(|of| self.told(of)).collect();
            return Err(NotMeasured(format!(
                "none of the files is a measurement of this machine: {}",
                reasons.join("; ")
            )));
        }
        Ok(draft)
    }

    /// The draft as a document, with the answers so far.
    pub(crate) fn document(
        &self,
        drafted: &Draft,
        answers: Vec<DraftAnswer>,
    ) -> Result<CandidateDraft, NotMeasured> {
        let now = answered(drafted, &answers)?;
        Ok(CandidateDraft {
            measurements: (drafted.proposed.iter())
                .map(|of| DraftedMeasurement {
                    files: of.files.clone(),
                    error: of.error.map(|error| error.to_string()),
                    said: of
                        .said
                        .iter()
                        .filter(|said| !said.is_empty())
                        .cloned()
                        .collect(),
                })
                .collect(),
            questions: questions(drafted, &answers)?,
            conflicts: now.conflicts,
            left_over: (now.left_over.iter()).map(|of| self.told(of)).collect(),
            notes: now.notes.iter().map(|note| self.told(note)).collect(),
            text: now.text,
            answers,
        })
    }

    /// Runs the calibration with these answers: the machine file and what is told of it. Open questions are refused by name.
    pub(crate) fn calibrated(
        &self,
        drafted: &Draft,
        answers: &[DraftAnswer],
    ) -> Result<(String, CandidateResult), NotMeasured> {
        let answered = answered(drafted, answers)?;
        match answered.questions.len() {
            0 => {}
            1 => return Err(NotMeasured(format!("one open question: {LEAVE_NONE}"))),
            open => return Err(NotMeasured(format!("{open} open questions: {LEAVE_NONE}"))),
        }
        let path = self.0.join(CALIBRATION);
        fs::write(&path, &answered.text).map_err(|e| self.wrong(&e))?;
        let file = CalibrationFile::read(&path).map_err(|e| self.wrong(&e))?;
        let begun = Instant::now();
        let calibration = calibrate(&file, |_, _| {}).map_err(|e| self.wrong(&e))?;
        let took = begun.elapsed();
        let bands = bands(&file, &calibration, took);
        let fits = calibration.curves.iter().zip(bands);
        let fits = fits.map(|(curve, band)| fit(curve, &file.machine, band));
        let squareness = calibration.squareness.iter();
        let mut result =
            result(&calibration.machine, Some(&file.machine)).map_err(|e| self.wrong(&e))?;
        let warnings = calibration.warnings.iter();
        let warnings = warnings.map(|warning| self.told(warning));
        let missed = missed(&answered.left_over, &calibration, &file.machine);
        let missed = missed.iter().map(|sentence| self.told(sentence));
        result.warnings.splice(0..0, missed.chain(warnings));
        let used = answered.proposed.iter().flat_map(|of| &of.files);
        let folder = format!("{FILES}/");
        let plain = |file: &String| file.strip_prefix(&folder).unwrap_or(file).to_owned();
        result.used = used.map(plain).collect();
        result.fits = fits.collect();
        result.squareness_urad = squareness
            .map(|(error, Urad(value))| (error.to_string(), *value))
            .collect();
        Ok((calibration.machine.to_toml(), result))
    }
}

/// The errors that nothing measured because their file was not used: without this, "taken as 0" and "not used" stand far from one
/// another.
fn missed(left_over: &[LeftOver], calibration: &Calibration, before: &Machine) -> Vec<String> {
    let sentence = |of: &LeftOver| {
        let error = of.error?;
        if calibration.curves.iter().any(|curve| curve.error == error) {
            return None;
        }
        let taken = match before.error(error) {
            Some(_) => "kept from the model in force",
            None => "taken as 0",
        };
        Some(format!(
            "{error} is {taken}, because its file was not used: {}: {}",
            of.file, of.reason
        ))
    };
    left_over.iter().filter_map(sentence).collect()
}

/// What a machine file says, against the model in force.
pub(crate) fn result(
    machine: &Machine,
    before: Option<&Machine>,
) -> Result<CandidateResult, volcomp_model::ModelError> {
    let Differences {
        refusal,
        to_confirm,
    } = before.map_or_else(Differences::default, |before| differences(machine, before));
    let mut warnings = to_confirm;
    if before.is_some_and(|before| machine.checksum() == before.checksum()) {
        warnings.push("this is the model in force: nothing would change".to_owned());
    }
    Ok(CandidateResult {
        refusal,
        hash: machine.checksum(),
        name: machine.name.clone(),
        structure: machine.chain().structure().to_string(),
        warnings,
        used: Vec::new(),
        fits: Vec::new(),
        squareness_urad: BTreeMap::new(),
        diagonals: match before {
            Some(before) => diagonals(before, machine)?,
            None => Vec::new(),
        },
    })
}

fn answered(drafted: &Draft, answers: &[DraftAnswer]) -> Result<Draft, NotMeasured> {
    let answers: Result<Vec<Answer>, NotMeasured> = answers.iter().map(answer).collect();
    drafted
        .answered(&answers?)
        .map_err(|e| NotMeasured(e.to_string()))
}

fn answer(typed: &DraftAnswer) -> Result<Answer, NotMeasured> {
    let of = match typed.of.parse::<usize>() {
        Ok(place) => Subject::Measurement(place),
        Err(_) => Subject::Squareness(typed.of.parse().map_err(|_| {
            NotMeasured(format!(
                "found {:?}, expected the number of a measurement or the name of a squareness",
                typed.of
            ))
        })?),
    };
    Ok(Answer {
        of,
        key: typed.key.clone(),
        value: typed.value.clone(),
    })
}

/// Every question of a draft, those that are answered included: which there are follows from errors and units.
fn questions(drafted: &Draft, answers: &[DraftAnswer]) -> Result<Vec<DraftQuestion>, NotMeasured> {
    let decides = |answer: &&DraftAnswer| Turn::of(&answer.key) != Turn::Other;
    let deciding: Vec<DraftAnswer> = answers.iter().filter(decides).cloned().collect();
    let with_errors = answered(drafted, &deciding)?;
    let mut asked = Vec::new();
    for (place, of) in with_errors.proposed.iter().enumerate() {
        let mut questions = of.questions();
        let first = &drafted.proposed[place];
        // A question that has been answered stays on the page.
        let is_gone = |question: &Question| {
            let mut now = questions.iter();
            Turn::of(&question.key) != Turn::Other && now.all(|of| of.key != question.key)
        };
        let mut first = first.questions();
        first.retain(is_gone);
        questions.splice(0..0, first);
        for question in questions {
            asked.push(DraftQuestion {
                of: place.to_string(),
                choices: choices(&question, &of.files),
                about: question.of,
                key: question.key,
                question: question.question,
            });
        }
    }
    for question in with_errors.questions.iter().skip(count(&with_errors)) {
        asked.push(DraftQuestion {
            of: question.of.clone(),
            about: format!("squareness {}", question.of),
            key: question.key.clone(),
            question: question.question.clone(),
            choices: Vec::new(),
        });
    }
    Ok(asked)
}

/// How many questions are about measurements: they come first.
fn count(draft: &Draft) -> usize {
    let questions = draft.proposed.iter().map(|of| of.questions().len());
    questions.sum()
}

fn choices(question: &Question, files: &[String]) -> Vec<String> {
    match question.key.as_str() {
        "file" => files.to_vec(),
        _ => question
            .choices()
            .iter()
            .map(|word| (*word).to_owned())
            .collect(),
    }
}

/// A fitted curve as plain data.
fn fit(curve: &FittedCurve, before: &Machine, band: Option<Vec<[f64; 3]>>) -> ModelFit {
    let (min, max, rms, leave_one_out) = match curve.quality {
        Quality::Length(of) => numbers(&of, |um| um.0),
        Quality::Angle(of) => numbers(&of, |urad| urad.0),
    };
    ModelFit {
        error: curve.error.to_string(),
        direction: curve.direction.map(|direction| direction.name().to_owned()),
        curve: curve.kind.to_owned(),
        along: curve.error.axis.kind().coordinate_unit().to_owned(),
        unit: curve.error.component.unit().to_owned(),
        residual_min: min,
        residual_max: max,
        residual_rms: rms,
        leave_one_out: leave_one_out.is_finite().then_some(leave_one_out),
        readings: curve.points.iter().map(|[x, u, _]| [*x, *u]).collect(),
        residuals: curve.points.iter().map(|[x, u, f]| [*x, u - f]).collect(),
        fit: curve.sampled.clone(),
        before: held(curve, before),
        band,
    }
}

fn numbers<U: Copy>(of: &FitQuality<U>, number: fn(U) -> f64) -> (f64, f64, f64, f64) {
    (
        number(of.residual_min),
        number(of.residual_max),
        number(of.residual_rms),
        number(of.leave_one_out),
    )
}

/// The same error in the model before, along the axis with the others at zero or the nearest end of travel.
fn held(curve: &FittedCurve, before: &Machine) -> Vec<[f64; 2]> {
    let (Some(error), Ok(own)) = (before.error(curve.error), before.index_of(curve.error.axis))
    else {
        return Vec::new();
    };
    let mut coordinates: Vec<f64> = before.axes().iter().map(Axis::nearest_zero).collect();
    (curve.sampled.iter())
        .map(|[x, _]| {
            coordinates[own] = *x;
            [*x, error.value(own, &coordinates, curve.direction)]
        })
        .collect()
}

/// The band of each curve, by calibrations with readings drawn again; `None` where nothing says how readings scatter, or it
/// would take too long.
fn bands(
    file: &CalibrationFile,
    calibration: &Calibration,
    took: Duration,
) -> Vec<Option<Vec<[f64; 3]>>> {
    let none = || calibration.curves.iter().map(|_| None).collect();
    let is_known = |curve: &FittedCurve| {
        let mut lines = file.measurements.iter();
        let unknown: Vec<&PathBuf> = file.without_scatter().map(|line| &line.file).collect();
        lines.any(|line| line.setup.error == curve.error && !unknown.contains(&&line.file))
    };
    let mut counts = (1..=TRIALS).rev();
    let trials = counts.find(|count| took.saturating_mul(*count) <= VARIED_AT_MOST);
    let trials = trials.unwrap_or_default();
    if trials < LEAST_TRIALS
        || file.observations.is_some()
        || !calibration.curves.iter().any(is_known)
    {
        return none();
    }
    let mut sums: Vec<Vec<f64>> = (calibration.curves.iter())
        .map(|curve| vec![0.0; curve.sampled.len()])
        .collect();
    let mut done = 0_u32;
    for trial in 0..trials {
        // Readings that scatter so much that nothing can be fitted say nothing of those that were taken.
        let Ok(varied) = calibrate(&file.varied(SEED, u64::from(trial)), |_, _| {}) else {
            continue;
        };
        let fits = |(a, b): (&FittedCurve, &FittedCurve)| {
            (a.error, a.direction, a.sampled.len()) == (b.error, b.direction, b.sampled.len())
        };
        if varied.curves.len() != sums.len()
            || !varied.curves.iter().zip(&calibration.curves).all(fits)
        {
            continue;
        }
        done += 1;
        for ((sum, now), first) in sums.iter_mut().zip(&varied.curves).zip(&calibration.curves) {
            for ((sum, now), first) in sum.iter_mut().zip(&now.sampled).zip(&first.sampled) {
                *sum += (now[1] - first[1]).powi(2);
            }
        }
    }
    if done < LEAST_TRIALS {
        return none();
    }
    let with_band = |(curve, sum): (&FittedCurve, &Vec<f64>)| {
        is_known(curve).then(|| {
            let points = curve.sampled.iter().zip(sum);
            points
                .map(|([x, u], sum)| {
                    let half = COVERAGE * (sum / f64::from(done)).sqrt();
                    [*x, u - half, u + half]
                })
                .collect()
        })
    };
    calibration
        .curves
        .iter()
        .zip(&sums)
        .map(with_band)
        .collect()
}

/// A machine file as somebody has uploaded it. `name` stands in messages.
pub(crate) fn machine_file(bytes: Vec<u8>, name: &str) -> Result<Machine, NotMeasured> {
    let text = String::from_utf8(bytes).map_err(|e| {
        NotMeasured(format!(
            "{name}: found a byte that is no text at place {}, expected a machine file in UTF-8",
            e.utf8_error().valid_up_to()
        ))
    })?;
    Machine::parse(&text, name).map_err(|e| match e {
        volcomp_model::ModelError::Input(InputError { .. }) => NotMeasured(e.to_string()),
        other => NotMeasured(format!("{name}: {other}")),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const ARCH: &str = "target_mm,run,direction,deviation_um\n0,1,+,0\n150,1,+,6\n300,1,+,8\n450,1,+,6\n600,1,+,0\n";

    /// The folder of an upload with these files for the machine of the example, and its draft.
    fn drafted(files: &[&str]) -> (tempfile::TempDir, Folder, Draft) {
        let dir = tempfile::tempdir().expect("writable");
        let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/calibration");
        let machine = fs::read_to_string(examples.join(MACHINE)).expect("there");
        let folder = Folder(dir.path().join("upload"));
        folder.make(&machine).expect("writable");
        for name in files {
            fs::write(folder.files().join(name), ARCH).expect("writable");
        }
        let draft = folder.draft().expect("measurements");
        (dir, folder, draft)
    }

    fn typed(key: &str, value: &str) -> DraftAnswer {
        DraftAnswer {
            of: "0".to_owned(),
            key: key.to_owned(),
            value: value.to_owned(),
        }
    }

    /// The page shows all questions at once: one that falls away with the error is no fault, and one that comes with it is asked.
    #[test]
    fn the_error_that_is_answered_decides_what_is_asked() {
        let (_dir, folder, draft) = drafted(&["scan.csv"]);
        let mut answers = vec![
            typed("error", "EXX"),
            typed("at.X", "0"),
            typed("at.Y", "0"),
            typed("at.Z", "0"),
            typed("point", "0, 0, 0"),
            typed("rides", "carriage"),
        ];
        let document = folder.document(&draft, answers.clone()).expect("right");
        assert!(document.notes[0].contains("at.X is not asked of EXX"));
        assert!(folder.calibrated(&draft, &answers).is_ok());
        answers[0] = typed("error", "EZX");
        let document = folder.document(&draft, answers.clone()).expect("right");
        let mut asked = document.questions.iter();
        assert!(asked.any(|of| of.key == "sign" && of.choices == ["1", "-1"]));
        let refused = folder.calibrated(&draft, &answers).expect_err("open");
        assert!(refused.0.contains("open question"), "{refused}");
        // And back, with the answer to what is asked no longer.
        answers.push(typed("sign", "-1"));
        assert!(folder.calibrated(&draft, &answers).is_ok());
        answers[0] = typed("error", "EXX");
        assert!(folder.document(&draft, answers).is_ok());
    }
}
