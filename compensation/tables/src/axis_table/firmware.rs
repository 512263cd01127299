//! Settings of firmware that holds no tables: steps and skew of X, Y and Z.
//!
//! Klipper and Marlin move to x − y·xy − z·(xz − xy·yz), y − z·yz, z, and then multiply by the steps per mm. GRBL has the steps alone. The
//! formulas are those of `skew_correction.py` and `planner.h`.

use core::fmt::Write;

use volcomp_kinematics::State;
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::{AxisName, PerAxis};

use super::options::{Facts, Written, one_line};
use super::sampled::{TableOptions, sampled};
use super::table::{AxisTable, Content, interpolated};
use super::text::{ExchangeError, Format, TextFile, short};

/// Firmware of printers and small routers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Firmware {
    /// `[skew_correction]`, `rotation_distance`.
    Klipper,
    /// `M852`, `M92`.
    Marlin,
    /// `$100`, `$101`, `$102`; no skew.
    Grbl,
}

/// Order of rows and columns of the matrices here.
const AXES: [AxisName; 3] = [AxisName::X, AxisName::Y, AxisName::Z];
/// Decimals of skew and step factors: 1e-7 is 0.1 µm over a metre.
const DECIMALS: usize = 7;
/// Decimals of steps per mm and of rotation distances, mm.
const STEPS_DECIMALS: usize = 6;
/// Largest plausible difference of a step factor from 1; a larger one means another screw.
const LARGEST_SCALE_ERROR: f64 = 0.1;
/// Smallest rotation of the part that is reported, rad.
const NEGLIGIBLE_TURN: f64 = 1e-6;

impl Firmware {
    /// All firmware, in the order in which messages list it.
    pub const ALL: [Self; 3] = [Self::Klipper, Self::Marlin, Self::Grbl];

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Klipper => "klipper",
            Self::Marlin => "marlin",
            Self::Grbl => "grbl",
        }
    }

    fn has_skew(self) -> bool {
        self != Self::Grbl
    }

    /// Sign convention and meaning of the numbers in the file.
    pub fn sign(self) -> &'static str {
        match self {
            Self::Klipper => {
                "a skew factor is the cotangent of the angle between the + directions of two axes, positive where it is below 90 deg; rotation_distance \
                 grows where the axis moves too far"
            }
            Self::Marlin => {
                "a skew factor is the cotangent of the angle between the + directions of two axes, positive where it is below 90 deg; steps per mm \
                 shrink where the axis moves too far"
            }
            Self::Grbl => "steps per mm shrink where the axis moves too far",
        }
    }

    /// Evidence for the sign.
    pub fn trust(self) -> &'static str {
        match self {
            Self::Klipper | Self::Marlin => {
                "Sign proven by the source text of the firmware, not on a machine: print a square afterwards and measure its diagonals."
            }
            Self::Grbl => {
                "Sign by the definition of steps per mm, not proven on a machine: measure a known travel afterwards."
            }
        }
    }

    fn comment(self) -> char {
        if self == Self::Klipper { '#' } else { ';' }
    }
}

/// Skew factors: cotangents of the angles between axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "schema", derive(serde::Serialize, schemars::JsonSchema))]
pub struct Skew {
    /// Motion along +X per mm of Y.
    pub xy: f64,
    /// Motion along +X per mm of Z.
    pub xz: f64,
    /// Motion along +Y per mm of Z.
    pub yz: f64,
}

impl Skew {
    /// Names of the planes, with their factors.
    pub fn planes(self) -> [(&'static str, f64); 3] {
        [("XY", self.xy), ("XZ", self.xz), ("YZ", self.yz)]
    }
}

/// The linear part of a machine's correction: steps and skew.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "schema", derive(serde::Serialize, schemars::JsonSchema))]
pub struct LinearSettings {
    /// Factors of the steps per mm of X, Y and Z; a rotation distance is divided by its factor.
    pub steps: [f64; 3],
    /// Skew of the axes.
    pub skew: Skew,
    /// Largest turn that these settings leave in the part as a whole, rad.
    pub turn_rad: f64,
}

/// Computes the factors of the steps per mm and the skew that cancel the slopes of the deviations. Each slope is that
/// of the least-squares line through the mean deviations along X, Y or Z through the reference position. A rotation of
/// the whole part may remain, because printer firmware keeps the direction of X and the plane of X and Y.
///
/// # Errors
/// Same as [`sampled`]; a step factor that differs from 1 by more than 0.1.
pub fn linear_settings(
    machine: &Machine,
    temperatures: &Temperatures,
    options: &TableOptions,
) -> Result<LinearSettings, ExchangeError> {
    let mut corrected = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let place = |axis: AxisName| AXES.iter().position(|of| *of == axis);
    if let Content::Axes(tables) = sampled(machine, temperatures, options, Format::Csv)? {
        for table in &tables {
            if let (Some(row), Some(column)) = (place(table.output), place(table.input)) {
                let axis = machine.axes().iter().find(|axis| axis.name == table.input);
                corrected[row][column] -= axis.map_or(0.0, |axis| slope(table, axis.travel));
            }
        }
    }
    of_matrix(&corrected).ok_or_else(|| {
        let scale: Vec<String> = (0..3).map(|at| short(corrected[at][at], 4)).collect();
        ExchangeError::option(
            "steps of X, Y and Z",
            &format!("the factors {}", scale.join(", ")),
            "between 0.9 and 1.1: check the units in the machine file",
        )
    })
}

/// Slope of the least-squares line through the mean deviations within the travel, mm/mm. A node beyond the travel is replaced by the end of travel,
/// because its value is extrapolated and may be far off the line.
fn slope(table: &AxisTable, [low, high]: [f64; 2]) -> f64 {
    let nodes = table.mean();
    let positions: Vec<f64> = table.positions.iter().map(|at| at.clamp(low, high)).collect();
    let each = positions.iter();
    let values: Vec<f64> = each.map(|at| interpolated(&table.positions, &nodes, *at)).collect();
    let count = values.len().max(1) as f64;
    let mean = |of: &[f64]| of.iter().sum::<f64>() / count;
    let (at, value) = (mean(&positions), mean(&values));
    let pairs = positions.iter().zip(&values);
    let (over, under) = pairs.fold((0.0, 0.0), |(over, under), (x, y)| {
        (over + (x - at) * (y - value), under + (x - at) * (x - at))
    });
    over / under
}

/// Splits the matrix C from commands to corrected commands into C = D·S·Qᵀ: steps D, skew S and a rotation Q of the
/// part. K = D·S is the upper triangular root of C·Cᵀ, in which Q cancels. `None` if there is no such root, or if a
/// step factor is implausible.
fn of_matrix(c: &[[f64; 3]; 3]) -> Option<LinearSettings> {
    let dot = |a: usize, b: usize| (0..3).map(|at| c[a][at] * c[b][at]).sum::<f64>();
    let k33 = dot(2, 2).sqrt();
    let (k23, k13) = (dot(1, 2) / k33, dot(0, 2) / k33);
    let k22 = (dot(1, 1) - k23 * k23).sqrt();
    let k12 = (dot(0, 1) - k13 * k23) / k22;
    let k11 = (dot(0, 0) - k12 * k12 - k13 * k13).sqrt();
    let (xy, yz) = (-k12 / k11, -k23 / k22);
    let found = LinearSettings {
        steps: [k11, k22, k33].map(written),
        skew: Skew { xy: written(xy), xz: written(xy * yz - k13 / k11), yz: written(yz) },
        turn_rad: c[1][0].abs().max(c[2][0].abs()).max(c[2][1].abs()),
    };
    let plausible = |steps: &f64| (steps - 1.0).abs() <= LARGEST_SCALE_ERROR;
    found.steps.iter().all(plausible).then_some(found)
}

/// The number after formatting with the decimals of the files.
fn written(value: f64) -> f64 {
    short(value, DECIMALS).parse().unwrap_or(value)
}

impl LinearSettings {
    /// Correction by this firmware, mm, in the order of the machine's axes.
    pub(crate) fn correction(
        &self,
        firmware: Firmware,
        machine: &Machine,
        state: &State,
    ) -> PerAxis<f64> {
        let index = AXES.map(|axis| machine.axes().iter().position(|of| of.name == axis));
        let [x, y, z] = index.map(|at| at.map_or(0.0, |at| state.q[at]));
        let Skew { xy, xz, yz } = if firmware.has_skew() { self.skew } else { Skew::default() };
        let skewed = [x - y * xy - z * (xz - xy * yz), y - z * yz, z];
        let mut correction = PerAxis::ZERO;
        for (place, at) in index.into_iter().enumerate() {
            if let Some(at) = at {
                correction[at] = self.steps[place] * skewed[place] - [x, y, z][place];
            }
        }
        correction
    }

    /// Step factors of the axes that the machine has.
    fn factors<'a>(&'a self, machine: &'a Machine) -> impl Iterator<Item = (AxisName, f64)> + 'a {
        let there = |axis: AxisName| machine.axes().iter().any(|of| of.name == axis);
        let all = AXES.into_iter().zip(self.steps);
        all.filter(move |(axis, _)| there(*axis))
    }
}

/// Writes the settings. `now` contains the steps per mm (Klipper: the rotation distances, mm) that are set in the control; for other axes the file
/// contains the factor.
///
/// # Errors
/// `now` names an axis that the machine or the firmware does not have, or contains a number that is not above 0.
pub fn write_settings(
    firmware: Firmware,
    settings: &LinearSettings,
    machine: &Machine,
    facts: &Facts,
    now: &[(AxisName, f64)],
) -> Result<Written, ExchangeError> {
    for (axis, steps) in now {
        if !settings.factors(machine).any(|(of, _)| of == *axis) {
            let expected = "X, Y or Z, which the machine has";
            return Err(ExchangeError::option("--steps", &format!("axis {axis}"), expected));
        }
        if !(*steps > 0.0 && steps.is_finite()) {
            let expected = "a number above 0";
            return Err(ExchangeError::option(format!("--steps {axis}"), steps, expected));
        }
    }
    let mut text = String::new();
    let mark = firmware.comment();
    for line in head(firmware, facts) {
        let _ = writeln!(text, "{mark} {line}");
    }
    match firmware {
        Firmware::Klipper => klipper_skew(&mut text, settings.skew),
        Firmware::Marlin => {
            let [i, j, k] = settings.skew.planes().map(|(_, factor)| short(factor, DECIMALS));
            let _ = writeln!(text, "M852 I{i} J{j} K{k}");
        }
        Firmware::Grbl => {}
    }
    for (axis, factor) in settings.factors(machine) {
        let now = now.iter().find(|(of, _)| *of == axis);
        steps_line(&mut text, firmware, axis, factor, now.map(|(_, now)| *now));
    }
    let (name, mut notes) = match firmware {
        Firmware::Klipper => (
            "volcomp-klipper.cfg",
            vec![
                "put `[include volcomp-klipper.cfg]` into printer.cfg and `SKEW_PROFILE LOAD=volcomp` into the start G-code, after homing; change the \
                 rotation distances in printer.cfg by hand"
                    .to_owned(),
            ],
        ),
        Firmware::Marlin => (
            "volcomp-marlin.gcode",
            vec![
                "M852 needs a firmware with SKEW_CORRECTION and SKEW_CORRECTION_GCODE, for J and K with SKEW_CORRECTION_FOR_Z; M500 keeps the values"
                    .to_owned(),
            ],
        ),
        Firmware::Grbl => ("volcomp-grbl.nc", left_skew(settings.skew)),
    };
    notes.push(
        "one motor has to drive one axis: on CoreXY and delta machines leave the steps as they are"
            .to_owned(),
    );
    if settings.turn_rad > NEGLIGIBLE_TURN {
        notes.push(format!(
            "the part stays turned as a whole, by up to {} urad, because the directions are those of X and of the plane of X and Y; this counts as left",
            short(settings.turn_rad * 1e6, 1)
        ));
    }
    notes.push(
        "not held: curves that are not straight, levers of angular errors, reversal, temperatures, rotary axes; correct programs by `volcomp nc` instead"
            .to_owned(),
    );
    Ok(Written {
        files: vec![TextFile { name: name.to_owned(), text }],
        notes,
        left_out: Vec::new(),
    })
}

fn head(firmware: Firmware, facts: &Facts) -> Vec<String> {
    let mut at = String::new();
    for (name, place) in &facts.at {
        let _ = write!(at, " {name}={}", short(*place, 6));
    }
    let temperatures = match facts.temperatures.as_str() {
        "" => "not stated (thermal terms left out)",
        stated => stated,
    };
    vec![
        format!(
            "Steps and skew, format {}, written by volcomp {}",
            firmware.name(),
            env!("CARGO_PKG_VERSION")
        ),
        format!("Machine: {}, {}", one_line(&facts.machine), facts.checksum),
        format!("Best-fit lines through the position (mm, deg):{at}"),
        format!("Temperatures: {}", one_line(temperatures)),
        format!("Sign: {}", firmware.sign()),
        firmware.trust().to_owned(),
        "No real control was tried, and nothing is certified.".to_owned(),
    ]
}

fn klipper_skew(text: &mut String, skew: Skew) {
    *text += "[skew_correction]\n\n[skew_correction volcomp]\n";
    for (plane, factor) in skew.planes() {
        let _ = writeln!(text, "{}_skew = {}", plane.to_lowercase(), short(factor, DECIMALS));
    }
    let planes = skew.planes().map(|(plane, factor)| format!("{plane}={}", lengths(factor)));
    let _ = writeln!(text, "\n# The same by lengths: SET_SKEW {}", planes.join(" "));
}

/// Lengths AC, BD and AD (both diagonals and a side) of the rhombus with this skew factor, mm, as arguments of `SET_SKEW`.
fn lengths(factor: f64) -> String {
    const SIDE_MM: f64 = 100.0;
    let half = 0.5 * (core::f64::consts::FRAC_PI_2 - factor.atan());
    let [ac, bd] = [half.cos(), half.sin()].map(|of| short(2.0 * SIDE_MM * of, STEPS_DECIMALS));
    format!("{ac},{bd},{SIDE_MM}")
}

fn steps_line(
    text: &mut String,
    firmware: Firmware,
    axis: AxisName,
    factor: f64,
    now: Option<f64>,
) {
    let setting = match firmware {
        Firmware::Klipper => {
            format!("rotation_distance of [stepper_{}]", axis.to_string().to_lowercase())
        }
        Firmware::Marlin => format!("M92 {axis}"),
        Firmware::Grbl => {
            let place = AXES.iter().position(|of| *of == axis).unwrap_or(0);
            format!("${}", 100 + place)
        }
    };
    let mark = firmware.comment();
    let factor = if firmware == Firmware::Klipper { 1.0 / factor } else { factor };
    let _ = match now {
        None => writeln!(text, "{mark} {setting}: multiply by {}", short(factor, DECIMALS)),
        Some(now) => {
            let (new, now) = (short(now * factor, STEPS_DECIMALS), short(now, STEPS_DECIMALS));
            match firmware {
                Firmware::Klipper => writeln!(text, "{mark} {setting}: {new} instead of {now}"),
                Firmware::Marlin => writeln!(text, "{setting}{new} {mark} instead of {now}"),
                Firmware::Grbl => writeln!(text, "{setting}={new} {mark} instead of {now}"),
            }
        }
    };
}

/// Notes on the skew that firmware without a skew correction leaves.
fn left_skew(skew: Skew) -> Vec<String> {
    let left = skew.planes().into_iter().filter(|(_, factor)| *factor != 0.0);
    let left: Vec<String> = left
        .map(|(plane, factor)| format!("{plane} {} urad", short(factor.atan() * 1e6, 1)))
        .collect();
    if left.is_empty() {
        return Vec::new();
    }
    vec![format!("left out, because GRBL has no skew: {}", left.join(", "))]
}
