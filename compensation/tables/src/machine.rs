//! The map of a machine, its refresh interval, and its transfer time.

use volcomp_kinematics::{Chain, CorrectionOptions, State, correct};
use volcomp_model::{Machine, MachineErrors, Temperatures, halton};
use volcomp_vocabulary::{AxisName, Direction, Displacement};

use crate::{
    build::{Field, GridAxis, Output, Request, Table, TablesError, build, distance, lattice},
    control::{DATA_WORDS, FRAME_WORDS, REPORT_WORDS},
    map::{GRID_AXES, Map, MapError, OUTPUTS},
};

/// Number of poses sampled over the travel of the axes that a map does not cover.
const SAMPLED_POSES: u32 = 2000;

/// Requirements on the map of a machine: axes, error bound and memory.
#[derive(Clone, Debug, PartialEq)]
pub struct MapOptions {
    /// Input axes of the map; if empty, the linear axes of the machine.
    pub grid: Vec<AxisName>,
    /// Fixed positions of axes that the map does not cover, mm or deg; axes without an entry are at 0.
    pub others: Vec<(AxisName, f64)>,
    /// Position resolution in the control's program, mm for linear axes.
    pub position_step_mm: f64,
    /// Position resolution in the control's program, deg for rotary axes.
    pub position_step_deg: f64,
    /// Resolution of the correction, mm.
    pub output_step_mm: f64,
    /// Maximum correction, mm.
    pub limit_mm: f64,
    /// Maximum error of the map, mm.
    pub within_mm: f64,
    /// Memory of the control for one map, words.
    pub words: usize,
    /// Number of the map, 1 to 65535.
    pub counter: u16,
}

impl Default for MapOptions {
    /// A map over the linear axes in 2500 words: positions in 1 µm and 0.001 deg, corrections in 1 µm up to 250 µm, error at most 1 µm.
    fn default() -> Self {
        Self {
            grid: Vec::new(),
            others: Vec::new(),
            position_step_mm: 0.001,
            position_step_deg: 0.001,
            output_step_mm: 0.001,
            limit_mm: 0.25,
            within_mm: 0.001,
            words: 2500,
            counter: 1,
        }
    }
}

/// Map of a machine at fixed temperatures, and the effects that it neglects.
#[derive(Clone, Debug, PartialEq)]
pub struct MachineMap {
    /// The map with its error.
    pub table: Table,
    /// Fixed axes and their positions, mm or deg.
    pub held: Vec<(AxisName, f64)>,
    /// Maximum change of the correction if the fixed axes are elsewhere, mm; `None` without fixed axes.
    pub elsewhere_mm: Option<f64>,
    /// Effect of 1 K at each sensor.
    pub sensitivities: Vec<Sensitivity>,
}

struct MachineField<'a> {
    chain: &'a Chain,
    source: MachineErrors<'a>,
    options: CorrectionOptions,
    grid: Vec<(AxisName, usize)>,
    outputs: Vec<usize>,
    held: State,
    bidirectional: bool,
}

impl MachineField<'_> {
    fn at(&self, state: &State) -> [f64; OUTPUTS] {
        let found = correct(self.chain, &self.source, state, &self.options);
        let mut correction = [0.0; OUTPUTS];
        for (into, index) in correction.iter_mut().zip(&self.outputs) {
            *into = found.delta[*index];
        }
        correction
    }

    fn state(&self, at: &[f64; GRID_AXES], directions: [Option<Direction>; GRID_AXES]) -> State {
        let mut state = self.held;
        for ((&(name, index), at), direction) in self.grid.iter().zip(at).zip(directions) {
            state.q[index] = Displacement::from_coordinate(name.kind(), *at).mm_or_rad();
            state.approach[index] = direction;
        }
        state
    }
}

impl Field for MachineField<'_> {
    fn correction_mm(
        &self,
        at: &[f64; GRID_AXES],
        directions: &[Option<Direction>; GRID_AXES],
    ) -> [f64; OUTPUTS] {
        self.at(&self.state(at, *directions))
    }

    fn is_bidirectional(&self) -> bool {
        self.bidirectional
    }
}

impl MachineMap {
    /// Builds the map of a machine with its current tool, at these temperatures.
    ///
    /// The map corrects the position of the tool with the linear axes in `correct` of the machine file, but not the tool orientation. A
    /// rotary axis is an axis of the grid if the options name it; otherwise it is fixed at its position in the options.
    ///
    /// # Errors
    /// Same as [`build`]; axes that the machine lacks, that roll over, or that correct nothing.
    pub fn new(
        machine: &Machine,
        temperatures: &Temperatures,
        options: &MapOptions,
    ) -> Result<Self, TablesError> {
        let grid = if options.grid.is_empty() {
            let mut linear: Vec<AxisName> = machine
                .axes()
                .iter()
                .map(|axis| axis.name)
                .filter(|name| !name.is_rotary())
                .collect();
            linear.sort_unstable_by_key(|name| name.index());
            linear
        } else {
            options.grid.clone()
        };
        let held = machine.state(&options.others)?;
        let mut places = Vec::new();
        let mut axes = Vec::new();
        for &name in &grid {
            let index = machine.index_of(name)?;
            let axis = &machine.axes()[index];
            let travel = axis.travel;
            if axis.modulo.is_some() {
                return Err(TablesError::RollsOver {
                    axis: name,
                    lower: travel[0],
                    upper: travel[1],
                });
            }
            let step =
                if name.is_rotary() { options.position_step_deg } else { options.position_step_mm };
            places.push((name, index));
            axes.push(GridAxis { name, travel, step });
        }
        let outputs = correcting_axes(machine);
        if outputs.is_empty() {
            return Err(MapError::Axes.into());
        }
        let names: Vec<AxisName> =
            outputs.iter().map(|&index| machine.axes()[index].name).collect();
        let field = MachineField {
            chain: machine.chain(),
            source: machine.source(temperatures),
            options: CorrectionOptions::of(&names),
            grid: places,
            outputs,
            held,
            bidirectional: machine
                .errors()
                .any(|(_, curve)| !matches!(curve, volcomp_model::curve::ErrorCurve::Single(_))),
        };
        let request = Request {
            axes,
            outputs: names
                .iter()
                .map(|&name| Output {
                    name,
                    step_mm: options.output_step_mm,
                    limit_mm: options.limit_mm,
                })
                .collect(),
            within_mm: options.within_mm,
            words: options.words,
            counter: options.counter,
            model: model_number(machine),
        };
        let table = build(&request, &field)?;
        let others: Vec<usize> = (0..machine.axes().len())
            .filter(|index| field.grid.iter().all(|(_, place)| place != index))
            .collect();
        let held = others.iter().map(|&index| {
            let name = machine.axes()[index].name;
            (name, Displacement::new(name.kind(), field.held.q[index]).mm_or_deg())
        });
        Ok(Self {
            table,
            held: held.collect(),
            elsewhere_mm: elsewhere_mm(machine, &field, &request, &others),
            sensitivities: sensitivities(machine, temperatures, &field, &request),
        })
    }
}

/// Chain indices of the linear axes that correct while rotary axes do not, in the order of the outputs
/// of the map.
fn correcting_axes(machine: &Machine) -> Vec<usize> {
    let names: Vec<AxisName> = match machine.correct() {
        Some(names) => names.to_vec(),
        None => machine.axes().iter().map(|axis| axis.name).collect(),
    };
    let linear: Vec<AxisName> = names.into_iter().filter(|name| !name.is_rotary()).collect();
    let correctors = CorrectionOptions::of(&linear).correctors(machine.chain());
    let mut places = correctors.linear().to_vec();
    places.sort_unstable_by_key(|&index| machine.axes()[index].name.index());
    places.truncate(OUTPUTS);
    places
}

/// First 32 bits of the checksum of the machine file.
fn model_number(machine: &Machine) -> u32 {
    let checksum = machine.checksum();
    let digits = checksum.strip_prefix("sha256:").and_then(|digits| digits.get(..8));
    // The digits are hexadecimal, so the conversion cannot fail.
    digits.and_then(|first| u32::from_str_radix(first, 16).ok()).unwrap_or(0)
}

/// Maximum change of the correction if the fixed axes are elsewhere, mm.
fn elsewhere_mm(
    machine: &Machine,
    field: &MachineField<'_>,
    request: &Request,
    others: &[usize],
) -> Option<f64> {
    if others.is_empty() {
        return None;
    }
    let share = |[low, high]: [f64; 2], number: u32, place: usize| {
        low + (high - low) * halton(number, place)
    };
    let poses = (1..=SAMPLED_POSES).map(|number| {
        let mut at = [0.0; GRID_AXES];
        for (place, (at, axis)) in at.iter_mut().zip(&request.axes).enumerate() {
            *at = share(axis.travel, number, place);
        }
        let here = field.state(&at, [None; GRID_AXES]);
        let mut elsewhere = here;
        for (place, &index) in others.iter().enumerate() {
            let axis = &machine.axes()[index];
            let at = share(axis.travel, number, GRID_AXES + place);
            elsewhere.q[index] = Displacement::from_coordinate(axis.name.kind(), at).mm_or_rad();
        }
        distance(field.at(&here), field.at(&elsewhere))
    });
    Some(poses.fold(0.0, f64::max))
}

/// Maximum effect of 1 K at each sensor, over the work space.
fn sensitivities(
    machine: &Machine,
    temperatures: &Temperatures,
    field: &MachineField<'_>,
    request: &Request,
) -> Vec<Sensitivity> {
    let thermal = machine.thermal();
    let mut found = Vec::new();
    for sensor in thermal.sensors() {
        let mut around = temperatures.clone();
        // A sensor without a given temperature is at the reference temperature, where its terms are zero.
        for name in thermal.sensors() {
            around.entry(name.to_owned()).or_insert(thermal.reference_degc);
        }
        let degc = around.get(sensor).copied().unwrap_or(thermal.reference_degc);
        let at = |degc: f64| {
            let mut temperatures = around.clone();
            temperatures.insert(sensor.to_owned(), degc);
            temperatures
        };
        let source = |temperatures: &Temperatures| MachineField {
            chain: field.chain,
            source: machine.source(temperatures),
            options: field.options.clone(),
            grid: field.grid.clone(),
            outputs: field.outputs.clone(),
            held: field.held,
            bidirectional: false,
        };
        let [here, warmer, colder] =
            [source(&at(degc)), source(&at(degc + 1.0)), source(&at(degc - 1.0))];
        let changes = lattice(request.axes.len(), 5).map(|shares| {
            let mut place = [0.0; GRID_AXES];
            for ((place, axis), share) in place.iter_mut().zip(&request.axes).zip(shares) {
                *place = axis.travel[0] + share * (axis.travel[1] - axis.travel[0]);
            }
            let state = here.state(&place, [None; GRID_AXES]);
            let now = here.at(&state);
            distance(now, warmer.at(&state)).max(distance(now, colder.at(&state)))
        });
        found
            .push(Sensitivity { sensor: sensor.to_owned(), mm_per_k: changes.fold(0.0, f64::max) });
    }
    found
}

/// Effect of 1 K at a sensor on the corrections.
#[derive(Clone, Debug, PartialEq)]
pub struct Sensitivity {
    /// Name of the sensor.
    pub sensor: String,
    /// Maximum change of the correction over the work space, mm/K.
    pub mm_per_k: f64,
}

/// Time, s, until a map for fixed temperatures is off by more than `within_mm` if every sensor drifts by `k_per_h` in the worst direction;
/// `None` if temperatures have no effect. Lags of the thermal terms can only extend this time.
pub fn refresh_s(sensitivities: &[Sensitivity], k_per_h: f64, within_mm: f64) -> Option<f64> {
    let mm_per_h: f64 = sensitivities.iter().map(|s| s.mm_per_k * k_per_h.abs()).sum();
    (mm_per_h > 0.0).then(|| within_mm / mm_per_h * 3600.0)
}

/// Size of the transfer of a map to a control.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transfer {
    /// Number of frames, which are written one after the other.
    pub frames: usize,
    /// Number of bytes: the frames, a report before each frame, and the map read back. Bytes of
    /// the bus protocol are not included.
    pub bytes: usize,
}

impl Transfer {
    /// Computes the transfer of a map without losses.
    #[must_use]
    pub fn of(map: &Map) -> Self {
        let words = map.words().len();
        let frames = words.div_ceil(DATA_WORDS) + 2;
        Self { frames, bytes: 2 * (frames * (FRAME_WORDS + REPORT_WORDS) + words) }
    }

    /// Duration of the transfer, s, over a link of `bytes_per_s`, with an overhead of `exchange_s` per frame.
    #[must_use]
    pub fn duration_s(&self, bytes_per_s: f64, exchange_s: f64) -> f64 {
        self.bytes as f64 / bytes_per_s + self.frames as f64 * exchange_s
    }
}
