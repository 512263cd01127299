use std::{collections::BTreeMap, path::PathBuf};

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_model::Machine;
use volcomp_tables::{
    ByteOrder, HEADER_WORDS, MAX_WORDS, MachineMap, Map, MapOptions, TablesError, Transfer,
    axes_of,
    control::{FRAME_WORDS, REPORT_WORDS},
    refresh_s,
};
use volcomp_vocabulary::AxisName;

use super::{Answer, ByAxis, fixed, machine_notes, table, table_text};
use crate::{
    arguments::{MachineArguments, OthersArguments, axis},
    failure::Failure,
    output::OutputFile,
    table::folded,
};

/// Write the corrections as a lookup map for a control that cannot compute
///
/// The map has as few lines along each axis as the largest error --within permits, and fits the words available in the
/// control. Also shows the error of the map, its transfer time, and how often temperature changes require a new one.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp map-table -m gantry.toml --words 5000 -o gantry.map
  volcomp map-table -m mill.toml --tool T5 --within 2 --words 8000 -o mill.map")]
pub(crate) struct MapTableArguments {
    #[command(flatten)]
    machine: MachineArguments,
    /// File for the map: head, values and checksum as 16-bit words
    #[arg(long, short, value_name = "FILE")]
    output: PathBuf,
    /// Largest error of the map against the model, µm
    #[arg(long, value_name = "UM", default_value_t = 1.0)]
    within: f64,
    /// 16-bit words available in the control: two maps, the mailbox (72) and the report (24)
    #[arg(long, value_name = "N")]
    words: usize,
    /// Axes of the map, one to five: X,Y,Z [default: the linear axes]
    #[arg(long)]
    axes: Option<String>,
    #[command(flatten)]
    others: OthersArguments,
    /// Step of the positions in the control: µm on linear axes, 0.001 deg on rotary axes
    #[arg(long, value_name = "STEP", default_value_t = 1.0)]
    position_step: f64,
    /// Step of the corrections in the control, µm
    #[arg(long, value_name = "UM", default_value_t = 1.0)]
    output_step: f64,
    /// Largest correction that the control accepts, µm
    #[arg(long, value_name = "UM", default_value_t = 250.0)]
    limit: f64,
    /// Number of this map, 1 to 65535; must differ from that of the previous map
    #[arg(long, value_name = "N", default_value_t = 1)]
    counter: u16,
    /// Machine number, with which the checksum starts
    #[arg(long, value_name = "N", default_value_t = 1)]
    number: u16,
    /// High byte of each word first (Siemens data block), instead of the low byte (FANUC PMC)
    #[arg(long)]
    high_first: bool,
    /// Link capacity, bytes/s
    #[arg(long, value_name = "BYTES", default_value_t = 10_000.0)]
    link: f64,
    /// Largest rate of temperature change, K/h
    #[arg(long, value_name = "K", default_value_t = 1.0)]
    drift: f64,
}

/// Result of `volcomp map-table`: the written map, its size and its errors.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct MapTable {
    /// Path of the written file.
    file: String,
    /// The size of the file, bytes.
    bytes: usize,
    /// Number that distinguishes the map from earlier ones.
    counter: u16,
    /// First 32 bits of the checksum of the machine file, as hexadecimal digits.
    model: String,
    /// Axes of the grid, the slowest first.
    grid: Vec<GridAxis>,
    /// Corrected axes.
    outputs: Vec<Output>,
    /// Number of map units per output step.
    scale: u16,
    /// Size of the map, words.
    words: usize,
    /// Space for one map in the control, words.
    capacity: usize,
    /// Largest difference between map and model, µm.
    error_max_um: f64,
    /// Root mean square difference between map and model, µm.
    error_rms_um: f64,
    /// Position of the largest difference, mm and deg.
    at: ByAxis,
    /// Number of positions at which map and model were compared.
    positions: usize,
    /// Maximum additional error on one axis by rounding to the output step, µm.
    step_um: f64,
    /// Positions of the axes that are not in the grid, mm and deg.
    held: ByAxis,
    /// Largest change of the correction if the axes of `held` are at other positions, µm; missing
    /// if `held` is empty.
    #[serde(skip_serializing_if = "Option::is_none")]
    elsewhere_um: Option<f64>,
    /// Largest gradient of a correction along an axis, µm/mm (µm/deg along a rotary axis).
    steepest_um: f64,
    /// Number of frames to transfer the map.
    frames: usize,
    /// Bytes transferred with the map, including read-back and reports, without the bus protocol.
    transfer_bytes: usize,
    /// Transfer time over the stated link, s.
    transfer_s: f64,
    /// Largest change of the correction per kelvin of each sensor, µm.
    um_per_k: BTreeMap<String, f64>,
    /// Time until the map is off by the bound if every sensor changes at the stated rate, s; `null`
    /// if no temperature affects the map.
    refresh_s: Option<f64>,
}

/// A grid axis of a map.
#[derive(Debug, Serialize, JsonSchema)]
struct GridAxis {
    /// Letter of the axis.
    axis: AxisName,
    /// Number of grid lines.
    lines: u16,
    /// Position of the first line, mm or deg.
    first: f64,
    /// Distance between lines, mm or deg.
    pitch: f64,
}

/// A corrected axis of a map.
#[derive(Debug, Serialize, JsonSchema)]
struct Output {
    /// Letter of the axis.
    axis: AxisName,
    /// Largest correction at the grid nodes, µm.
    largest_um: f64,
}

pub(crate) fn run(arguments: &MapTableArguments) -> Result<Answer, Failure> {
    above_zero("--link", arguments.link)?;
    above_zero("--drift", arguments.drift)?;
    if arguments.number == u16::MAX {
        return Err(Failure::Input(format!(
            "--number: found {}, expected 0 to 65534",
            arguments.number
        )));
    }
    let (machine, temperatures) = arguments.machine.read()?;
    let mut notes = machine_notes(&machine, &temperatures);
    let options = options(arguments, &machine, &mut notes)?;
    let machine_file = &arguments.machine.machine;
    let file = OutputFile::open_beside(&arguments.output, &[(machine_file, "the machine")])?;
    let made = MachineMap::new(&machine, &temperatures, &options)?;
    let map = &made.table.map;
    let order = if arguments.high_first { ByteOrder::HighFirst } else { ByteOrder::LowFirst };
    let image = map.image(arguments.number, order);
    file.write_whole(&image)?;
    let document = document(arguments, &options, &made, image.len());
    let text = text(arguments, &document);
    Answer::new(&document, text, notes)
}

fn above_zero(option: &str, found: f64) -> Result<(), Failure> {
    if found > 0.0 && found.is_finite() {
        return Ok(());
    }
    Err(Failure::Input(format!("{option}: found {found}, expected a number above 0")))
}

fn options(
    arguments: &MapTableArguments,
    machine: &Machine,
    notes: &mut Vec<String>,
) -> Result<MapOptions, Failure> {
    let mut grid = Vec::new();
    for name in arguments.axes.iter().flat_map(|text| text.split(',')) {
        grid.push(axis("--axes", name.trim())?);
    }
    let others = arguments.others.read(machine, notes)?;
    if let Some((name, _)) = others.iter().find(|(name, _)| grid.contains(name)) {
        return Err(Failure::Input(format!(
            "--at: found {name}, which the map goes over, expected other axes"
        )));
    }
    let besides = FRAME_WORDS + REPORT_WORDS;
    let words = (arguments.words.saturating_sub(besides) / 2).min(MAX_WORDS);
    if words <= HEADER_WORDS {
        return Err(Failure::Input(format!(
            "--words: found {}, expected {} at the least: twice the head of a map and a value, a mailbox and a report",
            arguments.words,
            2 * (HEADER_WORDS + 1) + besides
        )));
    }
    Ok(MapOptions {
        grid,
        others,
        position_step_mm: arguments.position_step * 1e-3,
        position_step_deg: arguments.position_step * 1e-3,
        output_step_mm: arguments.output_step * 1e-3,
        limit_mm: arguments.limit * 1e-3,
        within_mm: arguments.within * 1e-3,
        words,
        counter: arguments.counter,
    })
}

fn document(
    arguments: &MapTableArguments,
    options: &MapOptions,
    made: &MachineMap,
    bytes: usize,
) -> MapTable {
    let (map, misfit) = (&made.table.map, &made.table.misfit);
    let header = map.header();
    let names: Vec<AxisName> = axes_of(header.grid).collect();
    let transfer = Transfer::of(map);
    let grid = names.iter().zip(&header.lines).map(|(&name, lines)| GridAxis {
        axis: name,
        lines: lines.count,
        first: lines.at(0),
        pitch: lines.at(1) - lines.at(0),
    });
    MapTable {
        file: arguments.output.display().to_string(),
        bytes,
        counter: header.counter,
        model: format!("{:08x}", header.model),
        grid: grid.collect(),
        outputs: outputs(map),
        scale: header.scale,
        words: map.words().len(),
        capacity: options.words,
        error_max_um: misfit.max_mm * 1e3,
        error_rms_um: misfit.rms_mm * 1e3,
        at: names.iter().copied().zip(misfit.at).collect(),
        positions: misfit.positions,
        step_um: 0.6 * arguments.output_step,
        held: made.held.iter().copied().collect(),
        elsewhere_um: made.elsewhere_mm.map(|mm| mm * 1e3),
        steepest_um: made.table.steepest * 1e3,
        frames: transfer.frames,
        transfer_bytes: transfer.bytes,
        transfer_s: transfer.duration_s(arguments.link, 0.0),
        um_per_k: made
            .sensitivities
            .iter()
            .map(|found| (found.sensor.clone(), found.mm_per_k * 1e3))
            .collect(),
        refresh_s: refresh_s(&made.sensitivities, arguments.drift, options.within_mm),
    }
}

fn outputs(map: &Map) -> Vec<Output> {
    let header = map.header();
    let count = header.outputs.count();
    let named = axes_of(header.outputs).enumerate().map(|(place, name)| {
        let values = map.words()[HEADER_WORDS..].iter().skip(place).step_by(count);
        let largest = values.map(|word| word.cast_signed().unsigned_abs()).max();
        let step_um = f64::from(header.output_step_nm[place]) * 1e-3;
        Output {
            axis: name,
            largest_um: f64::from(largest.unwrap_or(0)) * step_um / f64::from(header.scale),
        }
    });
    named.collect()
}

fn text(arguments: &MapTableArguments, document: &MapTable) -> String {
    let mut lines = table(&["axis", "lines", "first", "pitch", "unit"]);
    for axis in &document.grid {
        lines.add_row(vec![
            axis.axis.to_string(),
            axis.lines.to_string(),
            fixed(axis.first, 3),
            fixed(axis.pitch, 3),
            axis.axis.kind().coordinate_unit().to_owned(),
        ]);
    }
    let mut text = format!(
        "{}: {} words of {}, map {} of model {}\n\n{}\n",
        document.file,
        document.words,
        document.capacity,
        document.counter,
        document.model,
        table_text(&lines)
    );
    let at: Vec<String> = document.at.iter().map(|(name, at)| format!("{name}={at:.3}")).collect();
    let corrected: Vec<String> = document
        .outputs
        .iter()
        .map(|output| format!("{} up to {:.1} µm", output.axis, output.largest_um))
        .collect();
    let (unit, feed) = if document.grid.iter().any(|axis| axis.axis.is_rotary()) {
        ("mm or deg", "10 m/min or 10000 deg/min")
    } else {
        ("mm", "10 m/min")
    };
    let mut sentences = vec![
        format!("Corrected: {}.", corrected.join(", ")),
        format!(
            "Error of the map: {:.3} µm at the most, at {}; {:.3} µm RMS, over {} positions, on the lines and between them. \
             The step of the control adds up to {:.1} µm on each axis.",
            document.error_max_um,
            at.join(", "),
            document.error_rms_um,
            document.positions,
            document.step_um
        ),
        format!(
            "The steepest correction changes by {:.3} µm in a {unit}: at {feed} that is {:.0} µm/s, which the rate in the control has to \
             follow.",
            document.steepest_um,
            document.steepest_um * 10_000.0 / 60.0
        ),
        format!(
            "Into the control: {} frames, {} bytes with all that is read back, {:.1} s at {} bytes/s.",
            document.frames, document.transfer_bytes, document.transfer_s, arguments.link
        ),
        refresh_words(arguments, document),
    ];
    if let Some(elsewhere) = document.elsewhere_um {
        let held: Vec<String> =
            document.held.iter().map(|(name, at)| format!("{name}={at}")).collect();
        sentences.insert(
            2,
            format!(
                "Held at {}: where they stand elsewhere the correction differs by up to {elsewhere:.1} µm, which the map does not know.",
                held.join(", ")
            ),
        );
    }
    for sentence in sentences {
        text += &folded(&sentence, "");
    }
    text
}

fn refresh_words(arguments: &MapTableArguments, document: &MapTable) -> String {
    let Some(seconds) = document.refresh_s else {
        return "No temperature changes it.".to_owned();
    };
    let each: Vec<String> =
        document.um_per_k.iter().map(|(name, um)| format!("{name} {um:.1} µm/K")).collect();
    format!(
        "Temperatures ({}): at {} K/h each the map is old by {} µm after {:.0} s; until then another one has to be in use.",
        each.join(", "),
        arguments.drift,
        arguments.within,
        seconds
    )
}

impl From<TablesError> for Failure {
    fn from(error: TablesError) -> Self {
        match error {
            TablesError::Model(error) => error.into(),
            other => Self::Input(other.to_string()),
        }
    }
}
