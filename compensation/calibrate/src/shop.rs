//! The virtual shop: a truth machine and instruments make the measurement files that a laser would
//! have produced, and the calibration file that reads them. The inverse of [`calibrate`](crate::calibrate()).

use std::{collections::BTreeMap, fmt::Write, path::Path};

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use volcomp_document::{Document, InputError, Section};
use volcomp_kinematics::{Form, Joint, State};
use volcomp_metrology::{
    DeviationUnit, Measurement, TiltReading, squareness_parts, tilt_sign, write_csv, write_renishaw,
};
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::{Direction, ErrorName};

use crate::{
    curve_choice::CurveChoice,
    error::CalibrateError,
    instrument::{INSTRUMENT_KEYS, Instrument, MAX_TARGETS},
    line_of_sight::LineOfSight,
    setup::{Method, SETUP_KEYS, Setup, decode_error, decode_motion},
    track::Kind,
};

/// A truth machine with the measurements to be made on it.
#[derive(Clone, Debug)]
pub struct Shop {
    /// The machine as it really is.
    pub truth: Machine,
    /// Seed of all that is random.
    pub seed: u64,
    /// The lines to be measured.
    pub lines: Vec<ShopLine>,
    /// Squareness errors with φ − π/2 of their reference, µrad.
    pub squareness: Vec<(ErrorName, f64)>,
    /// Kind of measurement file.
    pub format: Format,
}

/// A line to be measured.
#[derive(Clone, Debug, PartialEq)]
pub struct ShopLine {
    /// The error and how it is measured.
    pub setup: Setup,
    /// With what.
    pub instrument: Instrument,
    /// The kind of curve that the calibration file asks for.
    pub curve: Option<CurveChoice>,
    /// Name of the measurement file without its ending.
    pub name: String,
}

/// Kind of measurement file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Format {
    /// `.rtl` for lengths, `.rta` for angles.
    #[default]
    Renishaw,
    /// `target,run,direction,deviation`.
    Csv,
}

impl Shop {
    /// Reads a shop file and its truth machine.
    ///
    /// # Errors
    /// What is wrong, with file, line and key.
    pub fn read(path: &Path) -> Result<Self, CalibrateError> {
        let folder = path.parent().unwrap_or(Path::new(""));
        Self::decode(&Document::read(path)?, |machine| {
            Ok(Machine::read(&folder.join(machine))?)
        })
    }

    /// Decodes the text of a shop file; `file` names it in messages, `machine` gives the machine of
    /// the name that stands in it.
    ///
    /// # Errors
    /// What is wrong, with file, line and key.
    pub fn parse(
        text: &str,
        file: &str,
        machine: impl FnOnce(&str) -> Result<Machine, CalibrateError>,
    ) -> Result<Self, CalibrateError> {
        Self::decode(&Document::new(file, text), machine)
    }

    fn decode(
        document: &Document,
        machine: impl FnOnce(&str) -> Result<Machine, CalibrateError>,
    ) -> Result<Self, CalibrateError> {
        document.decode(|root| {
            let truth = machine(root.require("machine")?.text()?)?;
            Ok(decode(&root, truth)?)
        })
    }

    /// Every file by name: the machine without errors, the measurements and `calibration.toml`.
    /// `progress` is told how many of how many lines are done.
    ///
    /// # Errors
    /// A line that cannot be laid through the machine.
    pub fn files(
        &self,
        mut progress: impl FnMut(usize, usize),
    ) -> Result<Vec<(String, String)>, CalibrateError> {
        let alignments = self.alignments_urad();
        let mut machine = self.truth.clone();
        machine.clear_errors();
        let mut files = vec![("machine.toml".to_owned(), machine.to_toml())];
        let mut calibration = String::from("machine = \"machine.toml\"\n");
        for (index, line) in self.lines.iter().enumerate() {
            let alignment = alignments.get(&line.setup.error).copied().unwrap_or(0.0);
            let measurement = self.measure(index, alignment)?;
            let (name, text) = self.measurement_file(line, &measurement);
            let setup = line.setup.to_toml(&self.truth);
            // Writing to a String cannot fail.
            let _ = write!(calibration, "\n[[measurement]]\n{setup}file = \"{name}\"\n");
            if let Some(curve) = line.curve {
                let _ = writeln!(calibration, "curve = {}", curve.to_toml());
            }
            files.push((name, text));
            progress(index + 1, self.lines.len());
        }
        for (error, angle) in &self.squareness {
            let _ = write!(
                calibration,
                "\n[[squareness]]\nerror = \"{error}\"\nreference_angle_urad = {angle:?}\n"
            );
        }
        files.push(("calibration.toml".to_owned(), calibration));
        Ok(files)
    }

    /// Slopes at which the straightness references stand. The two beams of a squareness enclose the
    /// angle of its reference, so their slopes add up to φ − π/2.
    fn alignments_urad(&self) -> BTreeMap<ErrorName, f64> {
        let mut alignments = BTreeMap::new();
        for (index, line) in self.lines.iter().enumerate() {
            if Kind::of(line.setup.error) == Kind::Straightness {
                let mut random = self.random(2 * index + 1);
                let share: f64 = StandardNormal.sample(&mut random);
                alignments
                    .entry(line.setup.error)
                    .or_insert(line.instrument.alignment_urad * share);
            }
        }
        for (error, angle) in &self.squareness {
            let parts = squareness_parts(&error.to_string()).ok();
            let names = parts.map(|parts| parts.map(|part| part.parse::<ErrorName>().ok()));
            if let Some([Some(first), Some(second)]) = names
                && let Some(slope) = alignments.get(&first).copied()
            {
                alignments.insert(second, angle - slope);
            }
        }
        alignments
    }

    /// A generator of its own for each line, so that a further line does not change the others.
    fn random(&self, stream: usize) -> ChaCha8Rng {
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        random.set_stream(stream as u64);
        random
    }

    fn measure(&self, index: usize, alignment_urad: f64) -> Result<Measurement, CalibrateError> {
        let line = &self.lines[index];
        let sight = LineOfSight::new(&self.truth, &line.setup)?;
        let none = Temperatures::new();
        let errors = self.truth.source(&none);
        let travel = self.truth.axis(line.setup.error.axis).map(|a| a.travel);
        let travel = travel.unwrap_or_default();
        let joint = self.truth.chain().joints()[self.truth.index_of(line.setup.error.axis)?];
        let along_mcs = joint.direction[line.setup.error.axis.mcs_index()].signum();
        let slope_urad = alignment_urad * along_mcs + self.reference_slope_urad(line, &joint);
        let perfect = |target: f64, direction: Direction| {
            let state = sight.state(target, direction);
            sight.reading(&errors, &state, &state) + slope_urad * 1e-3 * (target - travel[0])
        };
        let mut random = self.random(2 * index);
        let sign = line.setup.sign;
        Ok(match line.setup.method {
            Method::Direct => {
                let unit = if line.setup.reads_angles() {
                    DeviationUnit::Urad
                } else {
                    DeviationUnit::Um
                };
                let targets = line.instrument.targets_over(travel);
                let zero = perfect(targets[0], Direction::Positive);
                let reading = |target, direction| sign * (perfect(target, direction) - zero);
                line.instrument.run(&targets, unit, reading, &mut random)
            }
            Method::Angular { bridge_mm, reading } => {
                let mut sigma = tilt_sign(&line.setup.error.to_string(), reading)?;
                if reading == TiltReading::RightHand {
                    sigma *= along_mcs;
                }
                let tilt = |target: f64, direction| {
                    if target - bridge_mm < travel[0] - 1e-9 {
                        return 0.0;
                    }
                    let rise = perfect(target, direction) - perfect(target - bridge_mm, direction);
                    sign * sigma * rise / bridge_mm * 1e3
                };
                // Targets one bridge apart, as many as the travel holds.
                let targets: Vec<f64> = (0..=MAX_TARGETS)
                    .map(|step| travel[0] + bridge_mm * step as f64)
                    .take_while(|target| *target <= travel[1] + 1e-9)
                    .collect();
                line.instrument
                    .run(&targets, DeviationUnit::Urad, tilt, &mut random)
            }
        })
    }

    /// A straightness reference is aligned to the axes of the workpiece with all axes at zero: where
    /// it stands on the tool side, the tool's rotation there is part of its alignment.
    fn reference_slope_urad(&self, line: &ShopLine, joint: &Joint) -> f64 {
        let name = line.setup.error;
        if Kind::of(name) != Kind::Straightness || line.setup.point_is_on_tool_side(joint.side) {
            return 0.0;
        }
        let none = Temperatures::new();
        let at_zero = self
            .truth
            .error_at(&State::default(), Form::Exact, &none)
            .rotation_rad;
        at_zero.cross(&joint.direction)[name.component.mcs_index()] * 1e6
    }

    fn measurement_file(&self, line: &ShopLine, measurement: &Measurement) -> (String, String) {
        let ending = match (self.format, measurement.unit) {
            (Format::Csv, _) => "csv",
            (Format::Renishaw, Some(DeviationUnit::Urad)) => "rta",
            (Format::Renishaw, _) => "rtl",
        };
        let text = match self.format {
            Format::Csv => write_csv(measurement),
            Format::Renishaw => {
                let mut described = measurement.clone();
                described.metadata.machine = Some(self.truth.name.clone());
                described.metadata.axis = Some(line.setup.error.axis.to_string());
                described.metadata.title = Some(line.setup.error.to_string());
                write_renishaw(&described)
            }
        };
        (format!("{}.{ending}", line.name), text)
    }
}

fn decode(root: &Section<'_>, truth: Machine) -> Result<Shop, InputError> {
    root.allow(&[
        "machine",
        "seed",
        "format",
        "instrument",
        "measurement",
        "squareness",
    ])?;
    let default = Instrument::default();
    let instrument = match root.section("instrument")? {
        Some(section) => {
            section.allow(&INSTRUMENT_KEYS)?;
            Instrument::decode(&section, &default)?
        }
        None => default,
    };
    let items = |key: &str| {
        root.get(key)
            .map_or_else(|| Ok(Vec::new()), |value| value.items())
    };
    let mut lines: Vec<ShopLine> = Vec::new();
    for item in items("measurement")? {
        decode_measurement(&item.section()?, &truth, &instrument, &mut lines)?;
    }
    let mut squareness: Vec<(ErrorName, f64)> = Vec::new();
    for item in items("squareness")? {
        let section = item.section()?;
        section.allow(&["error", "reference_angle_urad"])?;
        let value = section.require("error")?;
        let error = decode_error(&value, &truth)?;
        squareness_parts(&error.to_string()).map_err(|e| value.error(e.to_string()))?;
        if squareness.iter().any(|(other, _)| *other == error) {
            return Err(value.error(format!("{error} stands twice")));
        }
        let angle = section.get("reference_angle_urad");
        squareness.push((error, angle.map_or(Ok(0.0), |value| value.number())?));
    }
    Ok(Shop {
        truth,
        seed: root.get("seed").map_or(Ok(0), |v| v.count(usize::MAX))? as u64,
        lines,
        squareness,
        format: root.one_of(
            "format",
            &[("renishaw", Format::Renishaw), ("csv", Format::Csv)],
            Format::Renishaw,
        )?,
    })
}

/// One `[[measurement]]`: a line for each error it names.
fn decode_measurement(
    section: &Section<'_>,
    truth: &Machine,
    instrument: &Instrument,
    lines: &mut Vec<ShopLine>,
) -> Result<(), InputError> {
    let keys = [
        &["error", "errors", "file", "curve"][..],
        &SETUP_KEYS,
        &INSTRUMENT_KEYS,
    ];
    section.allow(&keys.concat())?;
    let named = match (section.get("error"), section.get("errors")) {
        (Some(one), None) => vec![one],
        (None, Some(several)) => several.items()?,
        (Some(_), Some(several)) => {
            return Err(several.error("found error and errors together, expected one of them"));
        }
        (None, None) => return Err(section.error("key `error` (or `errors`) is missing")),
    };
    for value in &named {
        let error = decode_motion(value, truth)?;
        let name = match section.get("file") {
            Some(file) if named.len() > 1 => {
                return Err(file.error("one file for several errors, expected `error` with it"));
            }
            Some(file) => {
                let name = file.text()?;
                if name.is_empty() || name.contains(['/', '\\']) {
                    let expected = "expected a name without a folder";
                    return Err(file.error(format!("found {name:?}, {expected}")));
                }
                name.to_owned()
            }
            None => free_name(error, lines),
        };
        if lines.iter().any(|line| line.name == name) || name == "machine" || name == "calibration"
        {
            return Err(value.error(format!("the file {name} is written already")));
        }
        let setup = Setup::decode(section, error, truth)?;
        if let Method::Angular { bridge_mm, .. } = setup.method {
            // Known to be a straightness by this.
            tilt_sign(&error.to_string(), TiltReading::Slope)
                .map_err(|e| value.error(e.to_string()))?;
            let travel = truth.axis(error.axis).map_or([0.0; 2], |axis| axis.travel);
            let steps = (travel[1] - travel[0]) / bridge_mm;
            if !(1.0..=MAX_TARGETS as f64).contains(&steps) {
                return Err(value.error(format!(
                    "the travel holds {steps:.1} bridges, expected 1 to {MAX_TARGETS}"
                )));
            }
        }
        let curve = section.get("curve");
        lines.push(ShopLine {
            setup,
            instrument: Instrument::decode(section, instrument)?,
            curve: curve
                .map(|value| CurveChoice::decode(&value, error.axis))
                .transpose()?,
            name,
        });
    }
    Ok(())
}

/// `eyy`, then `eyy-2`, …
fn free_name(error: ErrorName, lines: &[ShopLine]) -> String {
    let base = error.to_string().to_lowercase();
    let before = lines.iter().filter(|line| line.setup.error == error);
    match before.count() {
        0 => base,
        count => format!("{base}-{}", count + 1),
    }
}
