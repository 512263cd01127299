//! `volcomp demo`: from laser files to a corrected machine, on a simulated gantry of published size.
//!
//! The results are compared with those of the paper on such a gantry (10.1177/0954405416645985).

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use schemars::JsonSchema;
use serde::Serialize;
use volcomp_calibrate::{CalibrationFile, CurveChoice, Method, Setup};
use volcomp_curve::{Curve, ErrorCurve, Field, MovingLeastSquares};
use volcomp_fit::{Fit, FitError, FitOptions, fit_auto, fit_bspline, fit_mls, fit_polynomial};
use volcomp_kinematics::{CorrectionOptions, State};
use volcomp_metrology as metrology;
use volcomp_metrology::{MotionKind, ReferenceLine, read_file, squareness_parts};
use volcomp_model::{Machine, Temperatures, corrected, diagonals, quantised};
use volcomp_shop::{LineOfSight, Shop, ShopLine};
use volcomp_vocabulary::{Direction, ErrorName, Urad};

use super::{
    Answer, calibrate, fixed, range,
    simulate::{self, write_listed},
    table, table_text,
};
use crate::{
    failure::Failure,
    output::{self, TemporaryFolder},
    table::{folded, or_dash, to_the_left},
};

const TRUTH: &str = include_str!("../../demo/truth.toml");
const SHOP: &str = include_str!("../../demo/shop.toml");

/// Measure, calibrate and correct a simulated gantry, and compare with published figures
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp demo
  volcomp demo -o demo --seed 7 --curve mls")]
pub(crate) struct DemoArguments {
    /// Keep the measurement files and both machine files in this folder
    #[arg(long, short)]
    output: Option<PathBuf>,
    /// Seed of the noise [default: that of the shop file]
    #[arg(long)]
    seed: Option<u64>,
    /// Kind of curve: by leave-one-out error (auto), order 6 (poly, chebyshev), moving least squares or smoothing
    /// B-spline
    #[arg(long, default_value = "auto")]
    curve: CurveKind,
}

/// The kinds of curve that all lines can be fitted with.
#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum CurveKind {
    Auto,
    Poly,
    Chebyshev,
    Mls,
    Bspline,
}

impl CurveKind {
    fn choice(self) -> CurveChoice {
        match self {
            Self::Auto => CurveChoice::Auto,
            Self::Poly => CurveChoice::Polynomial { order: 6 },
            Self::Chebyshev => CurveChoice::Chebyshev { order: 6 },
            Self::Mls => CurveChoice::AutoMovingLeastSquares { shape: 3.0 },
            Self::Bspline => CurveChoice::BSpline,
        }
    }
}

/// The document of `volcomp demo`: errors of the simulated machine before and after correction.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Demo {
    /// Every measured line of a linear error.
    lines: Vec<Line>,
    /// Every squareness, from the slopes of the straightness lines.
    squareness: Vec<Squareness>,
    /// The body diagonals of ISO 230-6.
    diagonals: Vec<DiagonalRange>,
    /// Mean change over the lines or diagonals of one kind, percent; negative for a reduction.
    mean_percent: MeanPercent,
    /// Largest ratio of the corrected peak-to-peak deviation of a line to its floor.
    worst_times_floor: f64,
    /// Residual deviation of three kinds of curve for one irregular axis.
    irregular_curve: IrregularCurve,
    /// The curves that the calibration fitted, with their settings.
    curves: Vec<FittedCurve>,
    /// Comparison with the paper on such a gantry.
    published: Published,
}

/// Results of the demo and of the paper.
#[derive(Debug, Serialize, JsonSchema)]
struct Published {
    /// Peak-to-peak deviations along the lines.
    lines: Vec<PublishedLine>,
    /// Residuals of the fitted curves from the mean readings at the targets.
    residuals: Vec<PublishedResidual>,
}

/// Peak-to-peak deviation of a line, in the demo and in the paper.
#[derive(Debug, Serialize, JsonSchema)]
struct PublishedLine {
    /// Name of the error, such as `EXX`.
    error: &'static str,
    /// Position of the other axes.
    line: String,
    /// Without correction, µm.
    before_um: f64,
    /// With correction, µm.
    after_um: f64,
    /// Value of the paper without correction, µm.
    paper_before_um: f64,
    /// Value of the paper with correction, µm; null if not printed.
    paper_after_um: Option<f64>,
}

/// Residual of a fit method at the targets, in the demo and in the paper.
#[derive(Debug, Serialize, JsonSchema)]
struct PublishedResidual {
    /// The error that was fitted.
    error: &'static str,
    /// Fit method, or `chosen` for the automatically chosen one.
    method: String,
    /// Smallest residual, with its sign, µm.
    min_um: f64,
    /// Largest residual, with its sign, µm.
    max_um: f64,
    /// Smallest residual in the paper, µm; null if not printed.
    paper_min_um: Option<f64>,
    /// Largest residual in the paper, µm; null if not printed.
    paper_max_um: Option<f64>,
}

/// A fitted curve and its settings.
#[derive(Clone, Debug, Serialize, JsonSchema)]
struct FittedCurve {
    /// The error by its name, such as `EXX`.
    error: ErrorName,
    /// `forward` or `backward`; null: one curve for both directions.
    direction: Option<&'static str>,
    /// Kind of curve, as in the machine file.
    curve: &'static str,
    /// Order of the local polynomials of moving least squares; null for other kinds.
    order: Option<usize>,
    /// Half width of the weight function of moving least squares as a share of the range; null for
    /// other kinds.
    support: Option<f64>,
}

/// Peak-to-peak deviation of one measured line; for straightness after removal of the least-squares
/// line.
#[derive(Debug, Serialize, JsonSchema)]
#[expect(clippy::struct_field_names, reason = "each is a key of the document")]
struct Line {
    /// Name of the error, such as `EXX`.
    error: ErrorName,
    /// Position of the other axes.
    line: String,
    /// Without correction, µm.
    before_um: f64,
    /// With correction, µm.
    after_um: f64,
    /// Deviation that would remain with a perfectly known curve, caused by measurement noise and
    /// rounding of the correction, µm.
    floor_um: f64,
    /// Ratio of `after_um` to `floor_um`.
    times_floor: f64,
    #[serde(skip)]
    is_straightness: bool,
    /// Slopes of the least-squares lines, without and with correction.
    #[serde(skip)]
    slopes: [Urad; 2],
}

/// A squareness without and with correction.
#[derive(Debug, Serialize, JsonSchema)]
struct Squareness {
    /// Name of the error, such as `EC0Y`.
    error: ErrorName,
    /// Without correction, µrad.
    before_urad: f64,
    /// With correction, µrad.
    after_urad: f64,
}

/// The range of the deviations along a body diagonal.
#[derive(Debug, Serialize, JsonSchema)]
struct DiagonalRange {
    /// Directions of X, Y and Z: `PPP`, `NPP`, `PNP` or `PPN`.
    diagonal: &'static str,
    /// Without correction, µm.
    before_um: f64,
    /// With correction, µm.
    after_um: f64,
}

/// Mean changes by the correction, percent.
#[derive(Debug, Serialize, JsonSchema)]
struct MeanPercent {
    /// Mean over the positioning lines.
    positioning: f64,
    /// Mean over the straightness lines.
    straightness: f64,
    /// Mean over the body diagonals.
    diagonals: f64,
}

/// Peak-to-peak difference between truth and fitted curve over 61 points, by kind of curve.
#[derive(Debug, Serialize, JsonSchema)]
struct IrregularCurve {
    /// Name of the fitted error, such as `EXX`.
    error: &'static str,
    /// Difference with a polynomial of order 6, µm.
    polynomial_um: f64,
    /// Difference with moving least squares, µm.
    mls_um: f64,
    /// Difference with a smoothing B-spline, µm.
    bspline_um: f64,
}

pub(crate) fn run(arguments: &DemoArguments) -> Result<Answer, Failure> {
    let texts = [("truth.toml", TRUTH), ("shop.toml", SHOP)];
    let [(truth_name, truth), (shop_name, shop)] = texts;
    let mut shop = Shop::parse(shop, shop_name, |_| Ok(Machine::parse(truth, truth_name)?))?;
    shop.seed = arguments.seed.unwrap_or(shop.seed);
    if arguments.curve != CurveKind::Auto {
        for line in &mut shop.lines {
            line.curve = Some(arguments.curve.choice());
        }
    }
    let temporary;
    let folder = if let Some(folder) = &arguments.output {
        folder.as_path()
    } else {
        temporary = TemporaryFolder::new()?;
        temporary.path()
    };
    let machine = measure_and_calibrate(&shop, &texts, folder)?;
    let found = compare(&shop, &machine, folder)?;
    let text = format!(
        "{}\n{}",
        published_text(&found.published),
        text(&shop, &found, arguments.output.as_deref())
    );
    Answer::new(&found, text, Vec::new())
}

fn measure_and_calibrate(
    shop: &Shop,
    texts: &[(&str, &str)],
    folder: &Path,
) -> Result<Machine, Failure> {
    simulate::make(folder)?;
    write_listed(folder, texts)?;
    simulate::write(shop, folder)?;
    let file = CalibrationFile::read(&folder.join("calibration.toml"))?;
    let calibration = calibrate::fit(&file)?;
    write_listed(folder, &[("calibrated.toml", &calibration.machine.to_toml())])?;
    Ok(calibration.machine)
}

fn compare(shop: &Shop, machine: &Machine, folder: &Path) -> Result<Demo, Failure> {
    let none = Temperatures::new();
    let truth = shop.truth.source(&none);
    let options = CorrectionOptions::default();
    let command = |state: &_| {
        let delta = machine.correction_at(state, &none, &options).delta;
        let step = quantised(machine, &delta, OUTPUT_STEP_MM, 1e-6);
        corrected(state, &step)
    };
    let before = diagonals(&shop.truth, &truth, 20, &[], |state| *state)?;
    let after = diagonals(&shop.truth, &truth, 20, &[], command)?;
    let diagonals: Vec<DiagonalRange> = (before.iter().zip(&after))
        .map(|(before, after)| DiagonalRange {
            diagonal: before.name,
            before_um: before.range_um,
            after_um: after.range_um,
        })
        .collect();
    let bar = output::bar(shop.lines.len(), "lines compared");
    let lines = compare_lines(shop, &command, |done| bar.set_position(done as u64))?;
    bar.finish_and_clear();
    let mean_of = |straightness: bool| {
        let lines = lines.iter().filter(|line| line.is_straightness == straightness);
        mean_reduction(lines.map(|line| (line.before_um, line.after_um)))
    };
    Ok(Demo {
        squareness: squareness(shop, &lines),
        mean_percent: MeanPercent {
            positioning: mean_of(false),
            straightness: mean_of(true),
            diagonals: mean_reduction(diagonals.iter().map(|of| (of.before_um, of.after_um))),
        },
        worst_times_floor: lines.iter().map(|line| line.times_floor).fold(0.0, f64::max),
        irregular_curve: irregular_curve(shop, &folder.join("exx.rtl"))?,
        curves: curves(machine),
        published: published(&lines, folder)?,
        lines,
        diagonals,
    })
}

/// The curves of a machine, with the settings of moving least squares.
fn curves(machine: &Machine) -> Vec<FittedCurve> {
    let of = |(error, curve): (ErrorName, &ErrorCurve)| {
        let directions: &[Option<&'static str>] = match curve {
            ErrorCurve::Pair { .. } => {
                &[Some(Direction::Positive.name()), Some(Direction::Negative.name())]
            }
            _ => &[None],
        };
        let parts = curve.fields().zip(directions.iter().copied());
        let part = |(field, direction): (&Field, Option<&'static str>)| {
            let kind = match field {
                Field::Curve(curve) => curve.kind(),
                Field::Grid(_) => "grid",
            };
            let mls = match field {
                Field::Curve(Curve::MovingLeastSquares(mls)) => Some(mls),
                _ => None,
            };
            FittedCurve {
                error,
                direction,
                curve: kind,
                order: mls.map(MovingLeastSquares::order),
                support: mls.map(MovingLeastSquares::support),
            }
        };
        parts.map(part).collect::<Vec<_>>()
    };
    machine.errors().flat_map(of).collect()
}

/// The change from `before` to `after` in percent of `before`; negative for a reduction.
fn reduction(before: f64, after: f64) -> f64 {
    100.0 * (after / before - 1.0)
}

fn mean_reduction(pairs: impl Iterator<Item = (f64, f64)>) -> f64 {
    let (sum, count) = pairs.fold((0.0, 0.0_f64), |(sum, count), (before, after)| {
        (sum + reduction(before, after), count + 1.0)
    });
    sum / count.max(1.0)
}

fn text(shop: &Shop, found: &Demo, kept: Option<&Path>) -> String {
    let mut lines = table(&["", "before", "after", "change", "floor", "after / floor"]);
    for line in &found.lines {
        lines.add_row([
            format!("{} {}", line.error, line.line),
            format!("{:.1}", line.before_um),
            format!("{:.1}", line.after_um),
            format!("{:.0} %", reduction(line.before_um, line.after_um)),
            format!("{:.1}", line.floor_um),
            format!("{:.2}", line.times_floor),
        ]);
    }
    let mut others = table(&["", "before", "after", "change"]);
    for of in &found.diagonals {
        others.add_row([
            format!("diagonal {}, µm", of.diagonal),
            format!("{:.1}", of.before_um),
            format!("{:.1}", of.after_um),
            format!("{:.0} %", reduction(of.before_um, of.after_um)),
        ]);
    }
    for s in &found.squareness {
        others.add_row([
            format!("squareness {}, µrad", s.error),
            format!("{:.1}", s.before_urad),
            format!("{:.1}", s.after_urad),
            String::new(),
        ]);
    }
    let irregular = &found.irregular_curve;
    let [x, y, z] = ["X", "Y", "Z"].map(|letter| travel_mm(&shop.truth, letter));
    let kept = kept
        .map_or("The files can be kept: volcomp demo -o FOLDER\n".to_owned(), |folder| {
            format!("All files are in {}\n", folder.display())
        });
    let settings = settings_text(&found.curves);
    format!(
        "Gantry {}, {x} x {y} x {z} mm: {} lines measured by laser\n\
         with noise, calibrated, corrected with 1 µm output, on a machine that the\n\
         calibration has never seen.\n\n\
         Along the measured lines, peak to peak over 61 points, µm\n{}\n\
         The floor is what noise of the mean of the runs and 1 µm output leave of a\n\
         perfectly known curve: 100 trials. The best-fit line of each\n\
         straightness is taken out first.\n\n\
         Body diagonals (ISO 230-6) and squareness\n{}\n\
         On average: positioning {:.0} %, straightness {:.0} %, diagonals {:.0} %;\n\
         the worst line {:.2} times its floor.\n\n\
         The irregular X curve: {:.1} µm peak to peak left by a polynomial of order 6,\n\
         {:.1} by moving least squares, {:.1} by the smoothing B-spline.\n\n{settings}{kept}",
        shop.truth.chain().structure(),
        shop.lines.len(),
        table_text(&lines),
        table_text(&others),
        found.mean_percent.positioning,
        found.mean_percent.straightness,
        found.mean_percent.diagonals,
        found.worst_times_floor,
        irregular.polynomial_um,
        irregular.mls_um,
        irregular.bspline_um,
    )
}

/// Order and support of each curve if all curves are moving least squares; otherwise empty.
fn settings_text(curves: &[FittedCurve]) -> String {
    let settings: Option<Vec<(usize, f64)>> =
        curves.iter().map(|c| c.order.zip(c.support)).collect();
    let Some(settings) = settings else {
        return String::new();
    };
    let mut rows = table(&["moving least squares", "direction", "order", "support"]);
    for (curve, (order, support)) in curves.iter().zip(settings) {
        rows.add_row([
            curve.error.to_string(),
            curve.direction.unwrap_or("both").to_owned(),
            order.to_string(),
            fixed(support, 3),
        ]);
    }
    format!(
        "Chosen for each line by its leave-one-out error (support: half width of the\n\
         weight as a share of the range)\n{}\n",
        table_text(&rows)
    )
}

fn travel_mm(machine: &Machine, letter: &str) -> f64 {
    let axis = machine.axes().iter().find(|a| a.name.to_string() == letter);
    axis.map_or(0.0, |axis| axis.travel[1] - axis.travel[0])
}

/// Resolution of the controller's correction, mm.
const OUTPUT_STEP_MM: f64 = 1e-3;
const POINTS: usize = 61;
const TRIALS: u64 = 100;
const MAX_STEPS: usize = 100_000;

/// Compares every line of a linear error on the truth machine, without correction and with `command` applied to the
/// targets.
fn compare_lines(
    shop: &Shop,
    command: &impl Fn(&State) -> State,
    mut progress: impl FnMut(usize),
) -> Result<Vec<Line>, Failure> {
    let none = Temperatures::new();
    let errors = shop.truth.source(&none);
    let mut results = Vec::new();
    for (index, line) in shop.lines.iter().enumerate() {
        progress(index + 1);
        if line.setup.error.component.is_angular() {
            continue;
        }
        // A straightness measured with a bridge is evaluated as if read directly.
        let setup = Setup { method: Method::Direct, ..line.setup.clone() };
        let sight = LineOfSight::new(&shop.truth, &setup)?;
        let targets = points(shop, line);
        let profile = |command: &dyn Fn(&State) -> State| -> Vec<(f64, f64)> {
            let reading = |&target: &f64| {
                let state = sight.state(target, Direction::Positive);
                (target, sight.reading(&errors, &state, &command(&state)))
            };
            targets.iter().map(reading).collect()
        };
        let name = line.setup.error;
        let is_straightness = MotionKind::of(name) == MotionKind::Straightness;
        let before = profile(&|state| *state);
        let after = profile(command);
        let slope = |profile: &[(f64, f64)]| {
            ReferenceLine::least_squares(profile).map_or(Urad(0.0), |line| line.slope())
        };
        let after_um = peak_to_peak(&after, is_straightness);
        let floor_um = floor(shop.seed, line, &before, is_straightness);
        results.push(Line {
            error: name,
            line: description(shop, line),
            is_straightness,
            before_um: peak_to_peak(&before, is_straightness),
            after_um,
            floor_um,
            times_floor: after_um / floor_um,
            slopes: [slope(&before), slope(&after)],
        });
    }
    Ok(results)
}

fn points(shop: &Shop, line: &ShopLine) -> Vec<f64> {
    let axis = shop.truth.axis(line.setup.error.axis);
    let [low, high] = axis.map_or([0.0; 2], |axis| axis.travel);
    let last = (POINTS - 1) as f64;
    (0..POINTS).map(|index| low + (high - low) * index as f64 / last).collect()
}

fn description(shop: &Shop, line: &ShopLine) -> String {
    let axes = shop.truth.axes().iter().zip(&line.setup.at);
    let held: Vec<String> = axes
        .filter(|(axis, at)| axis.name != line.setup.error.axis && **at != 0.0)
        .map(|(axis, at)| format!("{}={at}", axis.name))
        .collect();
    format!("at {}", held.join(" "))
}

/// Maximum minus minimum of the values; for straightness after removal of the least-squares line.
fn peak_to_peak(profile: &[(f64, f64)], is_straightness: bool) -> f64 {
    let removed = if is_straightness {
        ReferenceLine::least_squares(profile).map(|line| line.removed_from(profile))
    } else {
        Ok(profile.to_vec())
    };
    range(removed.unwrap_or_default().into_iter().map(|(_, value)| value))
}

/// The residual deviation (peak to peak, µm) of a curve that is perfect between the targets. It comes from the noise of
/// the mean of the runs at the targets, interpolated linearly, and from the rounding of the output.
fn floor(seed: u64, line: &ShopLine, truth: &[(f64, f64)], is_straightness: bool) -> f64 {
    let instrument = &line.instrument;
    let runs = f64::from(instrument.runs).sqrt();
    // The errors of the bridge's tilts accumulate from target to target.
    let (noise, targets, adds_up) = match line.setup.method {
        Method::Direct => (instrument.length.noise.0, instrument.targets, false),
        Method::Angular { bridge_mm, .. } => {
            let ends = truth.first().zip(truth.last());
            let travel = ends.map_or(0.0, |(first, last)| last.0 - first.0);
            let places = (0..=MAX_STEPS).map(|step| bridge_mm * step as f64);
            let steps = places.skip(1).take_while(|place| *place <= travel + 1e-9);
            let steps = steps.count();
            (instrument.angle.noise.0 * bridge_mm * 1e-3, steps + 1, true)
        }
    };
    let noise = noise / runs;
    let step = OUTPUT_STEP_MM * 1e3;
    let mut sum = 0.0;
    for trial in 0..TRIALS {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(trial);
        let mut sum_of_tilts = 0.0;
        let at_targets: Vec<f64> = (0..targets)
            .map(|_| {
                let unit: f64 = StandardNormal.sample(&mut random);
                if adds_up {
                    sum_of_tilts += noise * unit;
                    sum_of_tilts
                } else {
                    noise * unit
                }
            })
            .collect();
        let left: Vec<(f64, f64)> = truth
            .iter()
            .enumerate()
            .map(|(index, &(target, value))| {
                let share = index as f64 / (truth.len() - 1) as f64;
                let known = value + between(&at_targets, share);
                (target, value - (known / step).round() * step)
            })
            .collect();
        sum += peak_to_peak(&left, is_straightness);
    }
    sum / TRIALS as f64
}

/// Interpolates linearly between equally spaced values. `share` is 0 at the first value and 1 at the last.
fn between(values: &[f64], share: f64) -> f64 {
    let place = share * (values.len() - 1) as f64;
    let pairs = values.windows(2).enumerate();
    let mut parts = pairs.map(|(first, pair)| (place - first as f64, pair));
    let (part, pair) = parts.find(|(part, _)| *part <= 1.0).unwrap_or((0.0, &[0.0; 2]));
    pair[0] * (1.0 - part) + pair[1] * part
}

fn squareness(shop: &Shop, lines: &[Line]) -> Vec<Squareness> {
    let value = |error: ErrorName, which: usize| {
        let slope = |part: ErrorName| {
            let line = lines.iter().find(|line| line.error == part)?;
            Some((part, line.slopes[which]))
        };
        let [first, second] = squareness_parts(error).ok()?;
        metrology::squareness(error, Urad(0.0), [slope(first)?, slope(second)?]).ok()
    };
    let both = |&(error, _): &(ErrorName, Urad)| {
        Some(Squareness { error, before_urad: value(error, 0)?.0, after_urad: value(error, 1)?.0 })
    };
    shop.squareness.iter().filter_map(both).collect()
}

/// Fits the forward means of the X positioning file and compares them with the truth.
fn irregular_curve(shop: &Shop, file: &Path) -> Result<IrregularCurve, Failure> {
    let measurement = read_file(file).map_err(Failure::input)?;
    let means = measurement.mean_curve_in(Direction::Positive);
    let (x, u): (Vec<f64>, Vec<f64>) = means.into_iter().unzip();
    let exx = shop.lines.iter().find(|l| l.setup.error.to_string() == "EXX");
    let line = exx.ok_or_else(|| Failure::Work("the demo measures no EXX".to_owned()))?;
    let sight = LineOfSight::new(&shop.truth, &line.setup)?;
    let none = Temperatures::new();
    let errors = shop.truth.source(&none);
    let domain = [x[0], x[x.len() - 1]];
    let left = |fit: Result<Fit, FitError>| {
        let curve = fit.map_err(Failure::input)?.curve;
        let misses = (0..=60).map(|i| {
            let target = domain[0] + (domain[1] - domain[0]) * f64::from(i) / 60.0;
            let state = sight.state(target, Direction::Positive);
            sight.reading(&errors, &state, &state) - curve.value(target)
        });
        Ok::<f64, Failure>(range(misses))
    };
    Ok(IrregularCurve {
        error: "EXX",
        polynomial_um: left(fit_polynomial(&x, &u, 6, domain))?,
        mls_um: left(fit_mls(&x, &u, 4, 1.0 / 3.0, 3.0))?,
        bspline_um: left(fit_bspline(&x, &u))?,
    })
}

/// Results of the paper: the error, the position of our line (`""` if there is only one), the peak-to-peak deviation
/// before correction and, if printed, after correction, µm.
const PAPER_LINES: [(&str, &str, f64, Option<f64>); 9] = [
    ("EXX", "", 58.6, Some(3.5)),
    ("EYY", "Z=650", 68.0, Some(4.8)),
    ("EYY", "Z=1050", 42.0, Some(2.8)),
    ("EYY", "Z=1352", 23.0, None),
    ("EZZ", "", 36.6, Some(2.7)),
    ("EYX", "", 19.0, Some(3.5)),
    ("EZX", "", 33.0, Some(5.2)),
    ("EXY", "", 34.0, Some(4.6)),
    ("EZY", "", 50.0, Some(6.8)),
];

const FILES: [(&str, &str); 3] = [("EXX", "exx.rtl"), ("EYY", "eyy.rtl"), ("EZZ", "ezz.rtl")];

/// Smallest and largest residual at the targets that the paper prints for an error and a method, µm; `None` if it
/// prints no residuals.
fn printed(error: &str, method: &str) -> Option<[f64; 2]> {
    match (error, method) {
        ("EXX", "polynomial of order 6") => Some([-5.2, 5.0]),
        ("EXX", MLS) => Some([-1.4, 1.7]),
        ("EYY", MLS) => Some([-1.6, 1.5]),
        ("EZZ", MLS) => Some([-1.5, 1.2]),
        _ => None,
    }
}

const MLS: &str = "moving least squares";

fn published(lines: &[Line], folder: &Path) -> Result<Published, Failure> {
    let row = |&(error, at, paper_before_um, paper_after_um): &(&'static str, &str, f64, _)| {
        let own = |line: &&Line| line.error.to_string() == error && line.line.contains(at);
        let found = lines.iter().find(own);
        let found = found.ok_or_else(|| Failure::Work(format!("the demo measures no {error}")))?;
        Ok::<_, Failure>(PublishedLine {
            error,
            line: found.line.clone(),
            before_um: found.before_um,
            after_um: found.after_um,
            paper_before_um,
            paper_after_um,
        })
    };
    let mut residuals = Vec::new();
    for (error, file) in FILES {
        residuals.extend(left_at_targets(error, &folder.join(file))?);
    }
    Ok(Published { lines: PAPER_LINES.iter().map(row).collect::<Result<_, _>>()?, residuals })
}

fn left_at_targets(error: &'static str, file: &Path) -> Result<Vec<PublishedResidual>, Failure> {
    let means = read_file(file).map_err(Failure::input)?.mean_curve();
    let (x, u): (Vec<f64>, Vec<f64>) = means.into_iter().unzip();
    let domain = [x.first().copied().unwrap_or_default(), x.last().copied().unwrap_or_default()];
    let mut fits: Vec<(String, Result<Fit, FitError>)> = Vec::new();
    for order in 6..=8 {
        let name = format!("polynomial of order {order}");
        fits.push((name, fit_polynomial(&x, &u, order, domain)));
    }
    fits.push((MLS.to_owned(), fit_mls(&x, &u, 4, 1.0 / 3.0, 3.0)));
    let auto = fit_auto(&x, &u, &FitOptions::default());
    fits.push(("chosen".to_owned(), auto.map(|found| found.fit)));
    let row = |(method, fit): (String, Result<Fit, FitError>)| {
        let fit = fit.map_err(Failure::input)?;
        let paper = printed(error, &method);
        Ok(PublishedResidual {
            error,
            method,
            min_um: fit.min(),
            max_um: fit.max(),
            paper_min_um: paper.map(|[min, _]| min),
            paper_max_um: paper.map(|[_, max]| max),
        })
    };
    fits.into_iter().map(row).collect()
}

fn published_text(published: &Published) -> String {
    let mut lines = table(&["", "before", "paper", "after", "paper"]);
    for line in &published.lines {
        lines.add_row([
            format!("{} {}", line.error, line.line),
            fixed(line.before_um, 1),
            fixed(line.paper_before_um, 1),
            fixed(line.after_um, 1),
            or_dash(line.paper_after_um, 1),
        ]);
    }
    let mut residuals = table(&["", "left by", "from", "to", "paper from", "to"]);
    to_the_left(&mut residuals, &[1]);
    for row in &published.residuals {
        residuals.add_row([
            row.error.to_owned(),
            row.method.clone(),
            fixed(row.min_um, 1),
            fixed(row.max_um, 1),
            or_dash(row.paper_min_um, 1),
            or_dash(row.paper_max_um, 1),
        ]);
    }
    format!(
        "Beside the published gantry (10.1177/0954405416645985), peak to peak, µm\n{}\n\
         Left of the mean readings at the 21 targets, µm\n{}\n{}\n",
        table_text(&lines),
        table_text(&residuals),
        folded(
            "The paper's figures are of a real machine, ours of a simulated one of the same travels and sizes, whose curves are made, not measured: they show that the way from files to correction adds less than was left there, not how that machine would do. The straightness of the paper after correction is that of machined parts, of a bed of 4800 mm and a worktable of 4000 mm. Moving least squares are those of the paper: order 4, a third of the range, shape 3.",
            ""
        )
    )
}
