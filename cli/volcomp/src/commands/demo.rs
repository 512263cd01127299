//! `volcomp demo`: from laser files to a corrected machine, on a simulated gantry of published size.

use std::path::{Path, PathBuf};

use clap::ValueEnum;
use volcomp_calibrate::{CalibrationFile, CurveChoice};
use volcomp_curve::{Curve, ErrorCurve, Field, MovingLeastSquares};
use volcomp_kinematics::CorrectionOptions;
use volcomp_model::{Diagonal, Machine, Temperatures, corrected, diagonals, quantised};
use volcomp_shop::Shop;
use volcomp_vocabulary::{Direction, ErrorName};

use super::{Answer, calibrate, fixed, simulate, simulated_files::write_listed, table, table_text};
use crate::{
    answers::simulate::{self as answers, Demo as Document},
    demo::{
        irregular::{IrregularCurve, irregular_curve},
        lines::{LineResult, OUTPUT_STEP_MM, Squareness, compare_lines, squareness},
        published,
    },
    failure::Failure,
    output::TemporaryFolder,
    progress,
};

const TRUTH: &str = include_str!("../../demo/truth.toml");
const SHOP: &str = include_str!("../../demo/shop.toml");

/// Measure, calibrate and correct a simulated gantry of published size, and compare with the published figures
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Keep the measurement files and both machine files in this folder
    #[arg(long, short)]
    output: Option<PathBuf>,
    /// Seed of the noise; default: the shop's
    #[arg(long)]
    seed: Option<u64>,
    /// Kind of curve that every line is fitted with: chosen for each line by its leave-one-out error, or one for all:
    /// polynomials of order 6, Chebyshev series of order 6, moving least squares whose order and support are chosen for
    /// each line by its leave-one-out error, smoothing B-splines
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
    /// What the calibration file asks for.
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

/// Before and after, of everything.
struct Comparison {
    lines: Vec<LineResult>,
    squareness: Vec<Squareness>,
    /// Name, range before and after, µm.
    diagonals: Vec<(&'static str, f64, f64)>,
    irregular: IrregularCurve,
    curves: Vec<answers::FittedCurve>,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
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
    let comparison = compare(&shop, &machine, folder)?;
    let published = published::published(&comparison.lines, folder)?;
    let text = format!(
        "{}\n{}",
        published::text(&published),
        text(&shop, &comparison, arguments.output.as_deref())
    );
    Answer::new(&document(&comparison, published), text, Vec::new())
}

/// Laser files of the truth machine, and the machine that their calibration finds.
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
    write_listed(
        folder,
        &[("calibrated.toml", &calibration.machine.to_toml())],
    )?;
    Ok(calibration.machine)
}

fn compare(shop: &Shop, machine: &Machine, folder: &Path) -> Result<Comparison, Failure> {
    let none = Temperatures::new();
    let truth = shop.truth.source(&none);
    let options = CorrectionOptions::default();
    let command = |state: &_| {
        let delta = machine.correction_at(state, &none, &options).delta;
        let step = quantised(machine, &delta, OUTPUT_STEP_MM, 1e-6);
        corrected(state, &step)
    };
    let ranges = |diagonals: [Diagonal; 4]| {
        let diagonals = diagonals.into_iter();
        diagonals.map(|d| (d.name, d.range_um)).collect::<Vec<_>>()
    };
    let before = ranges(diagonals(&shop.truth, &truth, 20, &[], |state| *state)?);
    let after = ranges(diagonals(&shop.truth, &truth, 20, &[], command)?);
    let bar = progress::bar(shop.lines.len(), "lines compared");
    let lines = compare_lines(shop, &command, |done| bar.set_position(done as u64))?;
    bar.finish_and_clear();
    let pairs = before.into_iter().zip(after);
    Ok(Comparison {
        squareness: squareness(shop, &lines),
        lines,
        diagonals: pairs.map(|((name, b), (_, a))| (name, b, a)).collect(),
        irregular: irregular_curve(shop, &folder.join("exx.rtl"))?,
        curves: curves(machine),
    })
}

/// The curves of a machine, with the settings of those by moving least squares.
fn curves(machine: &Machine) -> Vec<answers::FittedCurve> {
    let of = |(error, curve): (ErrorName, &ErrorCurve)| {
        let directions: &[Option<&'static str>] = match curve {
            ErrorCurve::Pair { .. } => &[
                Some(Direction::Positive.name()),
                Some(Direction::Negative.name()),
            ],
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
            answers::FittedCurve {
                error: error.to_string(),
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

/// The change from `before` to `after` in percent of `before`; negative where it became smaller.
fn reduction(before: f64, after: f64) -> f64 {
    100.0 * (after / before - 1.0)
}

/// Mean reduction in percent over lines of one kind.
fn mean_reduction<'a>(pairs: impl Iterator<Item = (&'a f64, &'a f64)>) -> f64 {
    let (sum, count) = pairs.fold((0.0, 0.0_f64), |(sum, count), (b, a)| {
        (sum + reduction(*b, *a), count + 1.0)
    });
    sum / count.max(1.0)
}

impl Comparison {
    fn mean_of_lines(&self, straightness: bool) -> f64 {
        let lines = self
            .lines
            .iter()
            .filter(|l| l.is_straightness == straightness);
        mean_reduction(lines.map(|l| (&l.before_um, &l.after_um)))
    }

    fn mean_of_diagonals(&self) -> f64 {
        mean_reduction(self.diagonals.iter().map(|(_, b, a)| (b, a)))
    }

    fn worst_ratio(&self) -> f64 {
        let ratios = self.lines.iter().map(LineResult::ratio);
        ratios.fold(0.0, f64::max)
    }
}

fn document(comparison: &Comparison, published: answers::Published) -> Document {
    let lines = comparison.lines.iter().map(|line| answers::Line {
        error: line.error.to_string(),
        line: line.description.clone(),
        before_um: line.before_um,
        after_um: line.after_um,
        floor_um: line.floor_um,
        times_floor: line.ratio(),
    });
    let squareness = comparison.squareness.iter().map(|s| answers::Squareness {
        error: s.error.to_string(),
        before_urad: s.before.0,
        after_urad: s.after.0,
    });
    let diagonals = comparison.diagonals.iter();
    let diagonals = diagonals.map(|&(diagonal, before_um, after_um)| answers::Diagonal {
        diagonal,
        before_um,
        after_um,
    });
    let irregular = &comparison.irregular;
    Document {
        lines: lines.collect(),
        squareness: squareness.collect(),
        diagonals: diagonals.collect(),
        mean_percent: answers::MeanPercent {
            positioning: comparison.mean_of_lines(false),
            straightness: comparison.mean_of_lines(true),
            diagonals: comparison.mean_of_diagonals(),
        },
        worst_times_floor: comparison.worst_ratio(),
        irregular_curve: answers::IrregularCurve {
            error: "EXX",
            polynomial_um: irregular.polynomial_um,
            mls_um: irregular.mls_um,
            bspline_um: irregular.bspline_um,
        },
        curves: comparison.curves.clone(),
        published,
    }
}

fn text(shop: &Shop, comparison: &Comparison, kept: Option<&Path>) -> String {
    let mut lines = table(&["", "before", "after", "change", "floor", "after / floor"]);
    for line in &comparison.lines {
        lines.add_row([
            format!("{} {}", line.error, line.description),
            format!("{:.1}", line.before_um),
            format!("{:.1}", line.after_um),
            format!("{:.0} %", reduction(line.before_um, line.after_um)),
            format!("{:.1}", line.floor_um),
            format!("{:.2}", line.ratio()),
        ]);
    }
    let mut others = table(&["", "before", "after", "change"]);
    for (name, before, after) in &comparison.diagonals {
        others.add_row([
            format!("diagonal {name}, µm"),
            format!("{before:.1}"),
            format!("{after:.1}"),
            format!("{:.0} %", reduction(*before, *after)),
        ]);
    }
    for s in &comparison.squareness {
        others.add_row([
            format!("squareness {}, µrad", s.error),
            format!("{:.1}", s.before.0),
            format!("{:.1}", s.after.0),
            String::new(),
        ]);
    }
    let irregular = &comparison.irregular;
    let [x, y, z] = ["X", "Y", "Z"].map(|letter| travel_mm(&shop.truth, letter));
    let kept = kept.map_or(
        "The files can be kept: volcomp demo -o FOLDER\n".to_owned(),
        |folder| format!("All files are in {}\n", folder.display()),
    );
    let settings = settings_text(&comparison.curves);
    format!(
        "Gantry {}, {x} x {y} x {z} mm: {} lines measured by laser\n\
         with noise, calibrated, corrected with 1 µm output, on a machine that the\n\
         calibration has never seen.\n\n\
         Along the measured lines, peak to peak over 61 points, µm\n{}\n\
         The floor is what noise of the mean of the runs and 1 µm output leave of a\n\
         perfectly known curve: 100 trials. The best-fit line of each\n\
         straightness is taken out first.\n\n\
         Body diagonals (ISO 230-6) and squareness\n{}\n\
         In the mean: positioning {:.0} %, straightness {:.0} %, diagonals {:.0} %;\n\
         the worst line {:.2} times its floor.\n\n\
         The irregular X curve: {:.1} µm peak to peak left by a polynomial of order 6,\n\
         {:.1} by moving least squares, {:.1} by the smoothing B-spline.\n\n{settings}{kept}",
        shop.truth.chain().structure(),
        shop.lines.len(),
        table_text(&lines),
        table_text(&others),
        comparison.mean_of_lines(false),
        comparison.mean_of_lines(true),
        comparison.mean_of_diagonals(),
        comparison.worst_ratio(),
        irregular.polynomial_um,
        irregular.mls_um,
        irregular.bspline_um,
    )
}

/// Order and support of each curve where all are moving least squares; else nothing.
fn settings_text(curves: &[answers::FittedCurve]) -> String {
    let settings: Option<Vec<(usize, f64)>> =
        curves.iter().map(|c| c.order.zip(c.support)).collect();
    let Some(settings) = settings else {
        return String::new();
    };
    let mut rows = table(&["moving least squares", "direction", "order", "support"]);
    for (curve, (order, support)) in curves.iter().zip(settings) {
        rows.add_row([
            curve.error.clone(),
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
