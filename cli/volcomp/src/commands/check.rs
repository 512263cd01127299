use std::{
    fmt::Write,
    path::{Path, PathBuf},
};

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_kinematics::{
    Chain, Form, Joint, MotionFrame, Side, State, along_machine_axis, nalgebra::Vector3,
};
use volcomp_model::{Machine, Source, Temperatures, sha256_of};
use volcomp_vocabulary::{AxisKind, AxisName, Component, CorrectionLimit, ErrorName};

use super::{Answer, ByAxis, in_degrees, machine_notes, micrometres, microradians, rotary_note};
use crate::{
    arguments::SpindleArguments,
    failure::Failure,
    listing::joined,
    table::{HEAD, fixed, folded, table, table_text, to_the_left},
};

/// Show the parsed machine: axes, errors, tool, and the error at home and at the corners
///
/// Compare the motion described for each axis with the machine: it reveals a wrong sign or a missing prime. With thermal
/// terms it reports the largest change of each axis's correction per kelvin of independent sensors, and at how many
/// kelvin from the reference it may reach the limit.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp check gantry.toml
  volcomp check mill.toml --tool T5")]
pub(crate) struct CheckArguments {
    /// Machine file (TOML)
    machine: PathBuf,
    #[command(flatten)]
    spindle: SpindleArguments,
    /// Folder of the measurement files of the provenance, to compare their hashes [default: that of the machine file]
    #[arg(long, value_name = "DIR")]
    files: Option<PathBuf>,
}

/// The document of `volcomp check`: the parsed machine.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Check {
    /// The path of the machine file.
    file: String,
    /// Name of the machine.
    name: String,
    /// Structure code from the workpiece to the tool.
    structure: String,
    /// The chain as a drawing in text.
    sketch: String,
    /// The axes, in the order X Y Z A B C U V W.
    axes: Vec<Axis>,
    /// Position of the tool in the spindle.
    tool: Tool,
    /// Names of the tools that `--tool` can select.
    tools: Vec<String>,
    /// Workpiece origin at machine zero, mm in MCS.
    workpiece_origin_mm: [f64; 3],
    /// Nonzero errors, by axis.
    errors: Vec<Size>,
    /// Errors stated as zero in the machine file.
    zero: Vec<ErrorName>,
    /// Errors not stated in the machine file; they are treated as zero.
    not_stated: Vec<ErrorName>,
    /// Axes with nonzero assembly errors.
    assembly: Vec<Assembly>,
    /// Summary of the thermal terms; null: none.
    thermal: Option<Thermal>,
    /// Measurements from which the errors were determined; missing if the machine file does not
    /// state them.
    #[serde(skip_serializing_if = "Option::is_none")]
    provenance: Option<Provenance>,
    /// The error at machine zero.
    home: Place,
    /// The error at every corner of the travels of X, Y and Z, with other axes at 0.
    corners: Vec<Place>,
}

/// One axis of the machine.
#[derive(Debug, Serialize, JsonSchema)]
struct Axis {
    /// Letter of the axis.
    name: AxisName,
    /// The kind of the axis: `linear` or `rotary`.
    kind: &'static str,
    /// The side that the axis carries: `workpiece` or `tool`.
    carries: &'static str,
    /// Unit of `travel` and `modulo`: `mm` or `deg`.
    unit: &'static str,
    /// Lower and upper end of travel, mm or deg.
    travel: [f64; 2],
    /// Period by which the coordinate is reduced into the travel before curves are evaluated, deg.
    #[serde(skip_serializing_if = "Option::is_none")]
    modulo: Option<f64>,
    /// Unit direction in MCS.
    direction: [f64; 3],
    /// Point at machine zero, mm in MCS: on the line of a rotary axis; for a linear axis, the point
    /// to which its errors refer.
    point_mm: [f64; 3],
    /// Frame in which the error motions of a rotary axis are stated: `fixed` or `turning`.
    #[serde(skip_serializing_if = "Option::is_none")]
    motion_frame: Option<&'static str>,
    /// Description of a positive motion.
    motion: String,
    /// Warning for an axis that is not parallel to the MCS axis of its letter, or points the other way: a positive
    /// deviation is then a negative error, or several errors.
    #[serde(skip_serializing_if = "Option::is_none")]
    signs: Option<String>,
}

/// The tool at machine zero.
#[derive(Debug, Serialize, JsonSchema)]
struct Tool {
    /// Name selected by `--tool`; null: the tool of `[tool]`.
    name: Option<String>,
    /// Tool tip, mm in MCS.
    tip_mm: [f64; 3],
    /// Unit direction from the tip to the spindle, in MCS.
    axis: [f64; 3],
}

/// One error and its range of values.
#[derive(Debug, Serialize, JsonSchema)]
struct Size {
    /// Name by ISO 230-1.
    name: ErrorName,
    /// Standard term for the error.
    meaning: String,
    /// The unit of the values: `um` (µm) or `urad` (µrad).
    unit: &'static str,
    /// Smallest value over the travel, in `unit`; equal to `largest` for a location error.
    smallest: f64,
    /// Largest value over the travel, in `unit`.
    largest: f64,
    /// Position of the value of largest magnitude, mm or deg; missing for a location error.
    #[serde(skip_serializing_if = "Option::is_none")]
    at: Option<ByAxis>,
}

/// The six assembly errors of an axis.
#[derive(Debug, Serialize, JsonSchema)]
struct Assembly {
    /// Letter of the axis.
    axis: AxisName,
    /// Displacements along X, Y and Z, µm.
    position_um: [f64; 3],
    /// Rotations about X, Y and Z, µrad.
    rotation_urad: [f64; 3],
}

/// Summary of the thermal terms.
#[derive(Debug, Serialize, JsonSchema)]
struct Thermal {
    /// Reference temperature of the curves, °C.
    reference_degc: f64,
    /// Names of the sensors.
    sensors: Vec<String>,
    /// Errors with an expansion term.
    expansion: Vec<ErrorName>,
    /// Errors with a drift term.
    drift: Vec<ErrorName>,
}

/// Tool position and error at one position of the axes.
#[derive(Debug, Serialize, JsonSchema)]
struct Place {
    /// Axis coordinates, mm or deg.
    at: ByAxis,
    /// Ideal tool tip from the workpiece origin, in workpiece axes, mm.
    tip_mm: [f64; 3],
    /// Actual minus ideal tool tip, in workpiece axes, µm.
    position_um: [f64; 3],
    /// Rotation of the tool, in workpiece axes, µrad.
    rotation_urad: [f64; 3],
    /// Axes outside their travel at this position.
    outside_travel: Vec<AxisName>,
}

pub(crate) fn run(arguments: &CheckArguments) -> Result<Answer, Failure> {
    let (machine, temperatures) = arguments.spindle.read(&arguments.machine)?;
    let document = document(arguments, &machine, &temperatures);
    let text = text(&document);
    let mut notes = machine_notes(&machine, &temperatures);
    notes.extend(rotary_note(&machine));
    notes.extend(no_point_note(&machine));
    notes.extend(limit_notes(&machine, &temperatures)?);
    notes.extend(machine.provenance().note());
    notes.extend(document.provenance.iter().flat_map(Provenance::notes));
    Answer::new(&document, text, notes)
}

fn document(arguments: &CheckArguments, machine: &Machine, temperatures: &Temperatures) -> Check {
    let chain = machine.chain();
    let mut names: Vec<AxisName> = machine.axes().iter().map(|axis| axis.name).collect();
    names.sort_unstable();
    let sizes = sizes(machine, &names);
    let place = |state: &State| place(machine, temperatures, state);
    Check {
        file: arguments.machine.display().to_string(),
        name: machine.name.clone(),
        structure: chain.structure().to_string(),
        sketch: sketch(chain),
        axes: axes(machine),
        tool: Tool {
            name: arguments.spindle.tool.clone(),
            tip_mm: chain.tool_tip_mm().into(),
            axis: chain.tool_axis().into(),
        },
        tools: machine.tools().keys().cloned().collect(),
        workpiece_origin_mm: chain.workpiece_origin_mm().into(),
        errors: sizes.there,
        zero: sizes.zero,
        not_stated: sizes.not_stated,
        assembly: assembly(machine),
        thermal: thermal(machine),
        provenance: Provenance::of(machine, &folder(arguments)),
        home: place(&State::default()),
        corners: corners(machine).iter().map(place).collect(),
    }
}

/// Notes on the largest correction of each axis. They warn if `nc` or `export` reject the correction at these
/// temperatures, and state at how many kelvin from the reference temperature they may reject it.
fn limit_notes(machine: &Machine, temperatures: &Temperatures) -> Result<Vec<String>, Failure> {
    let usual = CorrectionLimit::default();
    let largest = machine.largest_corrections(temperatures)?;
    // If rotary axes correct, `nc` limits the effect of all axes on the tool.
    let (who, but) = if largest.iter().any(|(axis, _)| axis.is_rotary()) {
        ("export allows", " (nc bounds by it what the corrections of all axes move the tool by)")
    } else {
        ("nc and export allow", "")
    };
    let beyond = largest.iter().filter(|(_, most)| !usual.allows(*most));
    let mut notes: Vec<String> = beyond
        .map(|(axis, most)| {
            let kind = axis.kind();
            let (limit, ceiling) = (usual.of(kind), CorrectionLimit::LARGEST.of(kind));
            if CorrectionLimit::LARGEST.allows(*most) {
                format!(
                    "WARNING: the correction of {axis} reaches {most:.1} within the travels, more than the {limit} that {who} without --limit-um{but}: check the units of the errors"
                )
            } else {
                format!(
                    "WARNING: the correction of {axis} reaches {most:.1} within the travels, more than the {ceiling} that no command and no gateway applies: check the units of the errors"
                )
            }
        })
        .collect();
    let reference_degc = machine.thermal().reference_degc;
    let per_k = machine.largest_corrections_per_k()?;
    if per_k.is_empty() {
        return Ok(notes);
    }
    let at_reference = machine.largest_corrections(&Temperatures::new())?;
    for ((axis, per_k), (_, most)) in per_k.into_iter().zip(at_reference) {
        let limit = usual.of(axis.kind());
        let left_k = (limit.um_or_urad() - most.um_or_urad()) / per_k.um_or_urad();
        // A value that would be printed as zero is omitted.
        if per_k.um_or_urad() >= 0.05 && left_k >= 0.0 {
            notes.push(format!(
                "the correction of {axis} changes by up to {per_k:.1} with each kelvin of the sensors: {:.1} K from {reference_degc} °C it may reach the {limit} that {who} without --limit-um{but}",
                (10.0 * left_k).floor() / 10.0
            ));
        }
    }
    Ok(notes)
}

fn folder(arguments: &CheckArguments) -> PathBuf {
    match (&arguments.files, arguments.machine.parent()) {
        (Some(folder), _) => folder.clone(),
        (None, Some(folder)) => folder.to_owned(),
        (None, None) => PathBuf::new(),
    }
}

/// Note on the rotary axes without a stated centre line, which is assumed to run through the origin.
fn no_point_note(machine: &Machine) -> Option<String> {
    let axes = machine.axes().iter();
    let without = axes.filter(|axis| axis.name.is_rotary() && axis.point_mm.is_none());
    let mut names: Vec<AxisName> = without.map(|axis| axis.name).collect();
    names.sort_unstable();
    (!names.is_empty()).then(|| {
        let names: Vec<String> = names.iter().map(ToString::to_string).collect();
        format!(
            "no `point` is stated for {}: the centre line is taken to run through the origin [0, 0, 0] of the machine",
            names.join(", ")
        )
    })
}

fn axes(machine: &Machine) -> Vec<Axis> {
    let stated = machine.axes().iter().zip(machine.chain().joints());
    let mut axes: Vec<Axis> = stated
        .map(|(axis, joint)| Axis {
            name: axis.name,
            kind: joint.kind.name(),
            carries: match joint.side {
                Side::Workpiece => "workpiece",
                Side::Tool => "tool",
            },
            unit: joint.kind.coordinate_unit(),
            travel: axis.travel,
            modulo: axis.modulo,
            direction: joint.direction.into(),
            point_mm: joint.point_mm.into(),
            motion_frame: axis.name.is_rotary().then_some(match joint.motion_frame {
                MotionFrame::Fixed => "fixed",
                MotionFrame::Turning => "turning",
            }),
            motion: motion(joint),
            signs: signs(joint),
        })
        .collect();
    axes.sort_unstable_by_key(|axis| axis.name);
    axes
}

fn assembly(machine: &Machine) -> Vec<Assembly> {
    let stated = machine.axes().iter().enumerate();
    let mut assembly: Vec<Assembly> = stated
        .filter_map(|(index, axis)| {
            let [x, y, z, a, b, c] = machine.assembly(index);
            let found =
                Assembly { axis: axis.name, position_um: [x, y, z], rotation_urad: [a, b, c] };
            (machine.assembly(index) != [0.0; 6]).then_some(found)
        })
        .collect();
    assembly.sort_unstable_by_key(|assembly| assembly.axis);
    assembly
}

fn thermal(machine: &Machine) -> Option<Thermal> {
    let thermal = machine.thermal();
    let sensors = thermal.sensors();
    (!sensors.is_empty()).then(|| Thermal {
        reference_degc: thermal.reference_degc,
        sensors: sensors.into_iter().map(str::to_owned).collect(),
        expansion: thermal.expansion.iter().map(|term| term.error).collect(),
        drift: thermal.drift.iter().map(|term| term.error).collect(),
    })
}

/// All corners of the travels of the machine's linear axes among X, Y, Z, with X varying fastest. Other axes are at 0.
fn corners(machine: &Machine) -> Vec<State> {
    let linear = [AxisName::X, AxisName::Y, AxisName::Z];
    let linear = linear.into_iter().filter_map(|name| machine.axis(name));
    let mut corners = vec![Vec::new()];
    for axis in linear {
        corners = axis
            .travel
            .into_iter()
            .zip([&corners, &corners])
            .flat_map(|(end, corners)| {
                let extended = corners
                    .iter()
                    .map(move |corner: &Vec<_>| [&[(axis.name, end)], corner.as_slice()].concat());
                extended.collect::<Vec<_>>()
            })
            .collect();
    }
    // This cannot fail, because ends of travel are finite and the axes exist.
    let states = corners.iter().filter_map(|corner| machine.state(corner).ok());
    states.collect()
}

fn place(machine: &Machine, temperatures: &Temperatures, state: &State) -> Place {
    let error = machine.error_at(state, Form::Exact, temperatures);
    let joints = machine.chain().joints().iter().zip(&state.q);
    let mut outside_travel = machine.outside_travel(state);
    outside_travel.sort_unstable();
    Place {
        at: joints.map(|(joint, &q)| (joint.name, in_degrees(joint.kind, q))).collect(),
        tip_mm: machine.chain().ideal_tip_mm(state).into(),
        position_um: micrometres(&error.position_mm),
        rotation_urad: microradians(&error.rotation_rad),
        outside_travel,
    }
}

struct Sizes {
    there: Vec<Size>,
    zero: Vec<ErrorName>,
    not_stated: Vec<ErrorName>,
}

fn sizes(machine: &Machine, axes: &[AxisName]) -> Sizes {
    let mut sizes = Sizes { there: Vec::new(), zero: Vec::new(), not_stated: Vec::new() };
    for &axis in axes {
        for component in Component::ALL {
            let name = ErrorName::motion(component, axis);
            match machine.range_of(name) {
                Some(range) => sizes.take(Size {
                    name,
                    meaning: meaning(name),
                    unit: component.unit(),
                    smallest: range.smallest,
                    largest: range.largest,
                    at: Some(range.at.into_iter().collect()),
                }),
                None => sizes.not_stated.push(name),
            }
        }
        for component in Component::ALL {
            let name = ErrorName::location(component, axis);
            match machine.locations().get(&name) {
                Some(&value) => sizes.take(Size {
                    name,
                    meaning: meaning(name),
                    unit: component.unit(),
                    smallest: value,
                    largest: value,
                    at: None,
                }),
                None if is_expected(name, axes) => sizes.not_stated.push(name),
                None => {}
            }
        }
    }
    sizes
}

impl Sizes {
    fn take(&mut self, size: Size) {
        if size.smallest == 0.0 && size.largest == 0.0 {
            self.zero.push(size.name);
        } else {
            self.there.push(size);
        }
    }
}

/// True if a missing location error is listed as not stated: a squareness between X, Y and Z, or an offset or tilt of a
/// rotary axis.
fn is_expected(name: ErrorName, axes: &[AxisName]) -> bool {
    match name.axis.kind() {
        AxisKind::Rotary => name.component.mcs_index() != name.axis.mcs_index(),
        AxisKind::Linear => {
            let reference = match (name.component, name.axis) {
                (Component::EC, AxisName::Y) | (Component::EB, AxisName::Z) => AxisName::X,
                (Component::EA, AxisName::Z) => AxisName::Y,
                _ => return false,
            };
            axes.contains(&reference)
        }
    }
}

/// Measurements from which the errors of the machine were determined. Residuals are in µm, those of
/// angular errors in µrad.
#[derive(Debug, Serialize, JsonSchema)]
struct Provenance {
    #[serde(flatten)]
    stated: volcomp_model::Provenance,
    /// Every source file, once, and whether it has changed.
    files: Vec<FileState>,
}

/// A source file of the errors.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, JsonSchema)]
struct FileState {
    /// Name in the calibration file.
    file: String,
    /// SHA-256 at the time of the calibration.
    sha256: String,
    /// Comparison with the present file: `same`, `different` or `not at hand`.
    state: &'static str,
}

impl FileState {
    fn of(source: &Source, folder: &Path) -> Self {
        let path = folder.join(&source.file);
        // Reading a named pipe would block.
        let hash = path.is_file().then(|| sha256_of(&path));
        Self {
            file: source.file.clone(),
            sha256: source.sha256.clone(),
            state: match hash {
                Some(Ok(hash)) if hash == source.sha256 => "same",
                Some(Ok(_)) => "different",
                Some(Err(_)) | None => "not at hand",
            },
        }
    }

    fn is(&self, source: &Source) -> bool {
        self.file == source.file && self.sha256 == source.sha256
    }
}

impl Provenance {
    /// The provenance stated in the machine file, with the state of each file below `folder`; `None` if the machine
    /// file states no provenance.
    fn of(machine: &Machine, folder: &Path) -> Option<Self> {
        let stated = machine.provenance();
        let mut files: Vec<FileState> = Vec::new();
        for source in stated.errors.iter().flat_map(|of| &of.sources) {
            if !files.iter().any(|file| file.is(source)) {
                files.push(FileState::of(source, folder));
            }
        }
        files.sort_unstable();
        (!stated.is_empty()).then(|| Self { stated: stated.clone(), files })
    }

    fn notes(&self) -> Vec<String> {
        let changed = self.files.iter().filter(|file| file.state == "different");
        let note = |file: &FileState| {
            let of_it = (self.stated.errors.iter())
                .filter(|of| of.sources.iter().any(|source| file.is(source)));
            let errors: Vec<String> = of_it.map(|of| of.error.to_string()).collect();
            format!(
                "{}: not the file that {} was found from: its SHA-256 is another than the machine file names. It has changed since, or is another test",
                file.file,
                errors.join(" ")
            )
        };
        changed.map(note).collect()
    }

    fn text(&self) -> String {
        let stated = &self.stated;
        let mut said = Vec::new();
        said.extend(stated.version.as_ref().map(|v| format!("volcomp {v}")));
        said.extend(stated.serial.as_ref().map(|s| format!("serial number {s}")));
        said.extend(stated.date.clone());
        let mut text = format!("\n{HEAD}Where the errors come from{HEAD:#}\n");
        if !said.is_empty() {
            text += &folded(&said.join(", "), " ");
        }
        let mut rows = table(&["error", "residual", "", "found by"]);
        to_the_left(&mut rows, &[2, 3]);
        for of in &stated.errors {
            let residual = of.residual;
            rows.add_row([
                of.error.to_string(),
                residual.map_or(String::new(), |residual| fixed(residual, 2)),
                residual.map_or("", |_| of.error.component.symbol()).to_owned(),
                of.method.clone(),
            ]);
        }
        text += &table_text(&rows);
        let files = &self.files;
        let with = |state: &str| files.iter().filter(|file| file.state == state).count();
        if !files.is_empty() {
            text += &folded(
                &format!(
                    "{} measurement files: {} unchanged, {} changed, {} not at hand (--files DIR)",
                    files.len(),
                    with("same"),
                    with("different"),
                    with("not at hand")
                ),
                " ",
            );
        }
        text
    }
}

fn text(check: &Check) -> String {
    let name = if check.name.is_empty() { "machine without a name" } else { &check.name };
    let mut text = format!("{HEAD}{name}{HEAD:#}: {}\n\n{}\n", check.structure, check.sketch);
    text += &axes_text(check);
    text += &tool(check);
    text += &errors(check);
    if let Some(provenance) = &check.provenance {
        text += &provenance.text();
    }
    text += &places(check);
    text
}

fn head(text: &mut String, what: &str) {
    let _ = write!(text, "\n{HEAD}{what}{HEAD:#}\n");
}

fn axes_text(check: &Check) -> String {
    let mut text = String::new();
    let mut rows = table(&["axis", "from", "to", "unit", "carries", "point mm"]);
    to_the_left(&mut rows, &[3, 4, 5]);
    for axis in &check.axes {
        let [from, to] = axis.travel.map(|end| end.to_string());
        rows.add_row([
            axis.name.to_string(),
            from,
            to,
            axis.unit.to_owned(),
            axis.carries.to_owned(),
            vector(&axis.point_mm),
        ]);
    }
    text += &table_text(&rows);
    text.push('\n');
    for axis in &check.axes {
        text += &folded(&axis.motion, " ");
        if let Some(signs) = &axis.signs {
            text += &folded(signs, "   ");
        }
        if let Some(period) = axis.modulo {
            let _ =
                writeln!(text, "   {} goes round: its curves repeat after {period} deg", axis.name);
        }
    }
    text
}

fn tool(check: &Check) -> String {
    let mut text = String::new();
    head(&mut text, "Tool and workpiece at machine zero, in machine coordinates");
    let tool = check.tool.name.as_deref().unwrap_or("[tool]");
    let _ = writeln!(
        text,
        " tool {tool}: tip {} mm, from the tip to the spindle {}",
        vector(&check.tool.tip_mm),
        vector(&check.tool.axis)
    );
    if !check.tools.is_empty() {
        text += &folded(&format!("other tools (--tool): {}", check.tools.join(" ")), " ");
    }
    let _ = writeln!(text, " workpiece origin {} mm", vector(&check.workpiece_origin_mm));
    text
}

fn errors(check: &Check) -> String {
    let mut text = String::new();
    head(&mut text, "Errors over travel");
    if check.errors.is_empty() {
        text += " none: every error is zero or not stated\n";
    } else {
        let mut rows = table(&["error", "", "min", "max", "unit", "largest at"]);
        to_the_left(&mut rows, &[1, 4, 5]);
        for size in &check.errors {
            rows.add_row([
                size.name.to_string(),
                size.meaning.clone(),
                fixed(size.smallest, 2),
                fixed(size.largest, 2),
                size.name.component.symbol().to_owned(),
                at(size),
            ]);
        }
        text += &table_text(&rows);
    }
    for assembly in &check.assembly {
        let _ = writeln!(
            text,
            " assembly of {}: {} µm, {} µrad",
            assembly.axis,
            vector(&assembly.position_um),
            vector(&assembly.rotation_urad)
        );
    }
    text += &names("stated as zero", &check.zero);
    text += &names("not stated, taken as zero", &check.not_stated);
    if let Some(thermal) = &check.thermal {
        let mut said = format!(
            "thermal terms, zero at {} °C, sensors {}",
            thermal.reference_degc,
            thermal.sensors.join(" ")
        );
        if !thermal.expansion.is_empty() {
            let _ = write!(said, "; expansion of {}", joined(&thermal.expansion));
        }
        if !thermal.drift.is_empty() {
            let _ = write!(said, "; drift of {}", joined(&thermal.drift));
        }
        text += &folded(&said, " ");
    }
    text
}

fn at(size: &Size) -> String {
    let Some(at) = &size.at else {
        return String::new();
    };
    let at = at.iter().map(|(name, place)| format!("{name}={place:.0}"));
    at.collect::<Vec<_>>().join(" ")
}

fn names(what: &str, names: &[ErrorName]) -> String {
    if names.is_empty() {
        return String::new();
    }
    folded(&format!("{what}: {}", joined(names)), " ")
}

fn places(check: &Check) -> String {
    let mut text = String::new();
    head(&mut text, "Tool tip and its error, in workpiece axes");
    let mut rows =
        table(&["", "x mm", "y mm", "z mm", "X µm", "Y µm", "Z µm", "A µrad", "B µrad", "C µrad"]);
    let home = (String::from("home"), &check.home);
    let corners = check.corners.iter().map(|place| (corner(check, place), place));
    for (name, place) in [home].into_iter().chain(corners) {
        let mut cells = vec![name];
        cells.extend(place.tip_mm.iter().map(|x| fixed(*x, 0)));
        cells.extend(place.position_um.iter().map(|x| fixed(*x, 1)));
        cells.extend(place.rotation_urad.iter().map(|x| fixed(*x, 1)));
        rows.add_row(cells);
    }
    text += &table_text(&rows);
    text += "\n Home is every axis at 0; a corner has X, Y, Z at an end of travel, others at 0.\n";
    if !check.home.outside_travel.is_empty() {
        let _ = writeln!(
            text,
            " Home lies outside the travel of {}.",
            joined(&check.home.outside_travel)
        );
    }
    text
}

/// The end of travel of each axis, such as `X- Y+ Z-`.
fn corner(check: &Check, place: &Place) -> String {
    let ends = check.axes.iter().filter_map(|axis| {
        let at = *place.at.get(&axis.name)?;
        let [low, high] = axis.travel;
        (axis.name.mcs_index() == axis.name.index()).then(|| {
            let end = if at == high && low != high { '+' } else { '-' };
            format!("{}{end}", axis.name)
        })
    });
    ends.collect::<Vec<_>>().join(" ")
}

fn vector([x, y, z]: &[f64; 3]) -> String {
    format!("[{x}, {y}, {z}]")
}

const LETTERS: [&str; 3] = ["X", "Y", "Z"];

/// A direction in MCS, such as `+X`; its three components if it is along none of X, Y, Z.
fn direction(u: &Vector3<f64>) -> String {
    match along_machine_axis(u) {
        Some((place, is_positive)) => {
            let sign = if is_positive { '+' } else { '−' };
            format!("{sign}{}", LETTERS[place])
        }
        None => format!("[{:.4}, {:.4}, {:.4}]", u.x, u.y, u.z),
    }
}

/// Describes a positive motion of an axis, relative to the workpiece and as seen on the machine.
fn motion(joint: &Joint) -> String {
    let name = joint.name;
    let (to, back) = (direction(&joint.direction), direction(&-joint.direction));
    let errors = match joint.motion_frame {
        MotionFrame::Fixed => "",
        MotionFrame::Turning => "; its error motions turn with it",
    };
    match (joint.kind, joint.side) {
        (AxisKind::Linear, Side::Workpiece) => format!(
            "+{name}: the tool moves to {to} seen from the workpiece; the table moves to {back}"
        ),
        (AxisKind::Linear, Side::Tool) => format!("+{name}: the tool moves to {to}"),
        (AxisKind::Rotary, Side::Workpiece) => format!(
            "+{name}: the tool turns right-handed about {to} seen from the workpiece; the table turns right-handed about {back}{errors}"
        ),
        (AxisKind::Rotary, Side::Tool) => {
            format!("+{name}: the tool turns right-handed about {to}{errors}")
        }
    }
}

/// Warning for an axis that is not parallel to the MCS axis of its letter, or points the other way: errors refer to the
/// axes of MCS, whatever the direction of the axis. `None` if the axis points along the MCS axis.
fn signs(joint: &Joint) -> Option<String> {
    let (name, along) = (joint.name, joint.name.mcs_index());
    let found = along_machine_axis(&joint.direction);
    if found == Some((along, true)) {
        return None;
    }
    let letter = LETTERS[along];
    let component = Component::ALL.into_iter().find(|component| {
        component.mcs_index() == along && component.is_angular() == name.is_rotary()
    })?;
    let positioning = ErrorName::motion(component, name);
    let too_far = match joint.kind {
        AxisKind::Linear => "goes too far",
        AxisKind::Rotary => "turns too far",
    };
    Some(if found == Some((along, false)) {
        format!(
            "{name} counts against {letter} of the machine, its errors do not: where {name} {too_far} (a positive \
             deviation), {positioning} is negative"
        )
    } else {
        format!(
            "{name} lies aslant, its errors are along and about X, Y and Z of the machine: where {name} {too_far}, \
             more components than {positioning} change"
        )
    })
}

/// The standard term for an error, such as `straightness deviation of X in Y` or `pitch of X`. Pitch and yaw are
/// defined for a horizontal axis; the rotations of a vertical axis are called tilts.
fn meaning(error: ErrorName) -> String {
    let axis = error.axis;
    let along = LETTERS[error.component.mcs_index()];
    let own = error.component.mcs_index() == axis.mcs_index();
    match (error.location, axis.kind(), error.component.is_angular()) {
        (true, AxisKind::Linear, _) => match (error.component, axis.letter()) {
            (Component::EC, 'Y') => "squareness of Y to X".to_owned(),
            (Component::EB, 'Z') => "squareness of Z to X".to_owned(),
            (Component::EA, 'Z') => "squareness of Z to Y".to_owned(),
            _ => format!("tilt of the line of {axis} about {along}"),
        },
        (true, AxisKind::Rotary, false) => format!("shift of the line of {axis} along {along}"),
        (true, AxisKind::Rotary, true) => format!("tilt of the line of {axis} about {along}"),
        (false, AxisKind::Linear, false) if own => format!("positioning deviation of {axis}"),
        (false, AxisKind::Linear, false) => format!("straightness deviation of {axis} in {along}"),
        (false, AxisKind::Linear, true) if own => format!("roll of {axis}"),
        (false, AxisKind::Linear, true) => match (axis.mcs_index(), error.component) {
            (0 | 1, Component::EC) => format!("yaw of {axis}"),
            (0, Component::EB) | (1, Component::EA) => format!("pitch of {axis}"),
            _ => format!("tilt of {axis} about {along}"),
        },
        (false, AxisKind::Rotary, false) if own => format!("axial motion of {axis}"),
        (false, AxisKind::Rotary, false) => format!("radial motion of {axis} along {along}"),
        (false, AxisKind::Rotary, true) if own => {
            format!("angular positioning deviation of {axis}")
        }
        (false, AxisKind::Rotary, true) => format!("tilt of {axis} about {along}"),
    }
}

/// Two lines from the workpiece to the tool: the letters, and below each letter its type of motion.
///
/// ```text
///   w-----C'----X'----b-----Y-----Z-----B-----t
///  work  turn slide  bed  slide slide turn  tool
/// ```
fn sketch(chain: &Chain) -> String {
    let mut places = vec![("w".to_owned(), "work")];
    let mut on_bed = false;
    let bed = || ("b".to_owned(), "bed");
    for joint in chain.joints() {
        if joint.side == Side::Tool && !on_bed {
            on_bed = true;
            places.push(bed());
        }
        let prime = if joint.side == Side::Workpiece { "'" } else { "" };
        let does = match joint.kind {
            AxisKind::Linear => "slide",
            AxisKind::Rotary => "turn",
        };
        places.push((format!("{}{prime}", joint.name), does));
    }
    if !on_bed {
        places.push(bed());
    }
    places.push(("t".to_owned(), "tool"));
    let last = places.len() - 1;
    let (mut letters, mut words) = ("   ".to_owned(), " ".to_owned());
    for (index, (letter, word)) in places.iter().enumerate() {
        letters += letter;
        if index < last {
            letters += &"-".repeat(6 - letter.chars().count());
        }
        let _ = write!(words, "{word:^5} ");
    }
    format!("{letters}\n{}\n", words.trim_end())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_element_stands_above_its_word() {
        let chain = |code: &str| Chain::new(code.parse().expect("a structure"));
        assert_eq!(
            sketch(&chain("w C' X' b Y Z B t")),
            "   w-----C'----X'----b-----Y-----Z-----B-----t\n work  turn  slide  bed  slide slide turn  tool\n"
        );
        let longest = sketch(&chain("w A' B' C' X' Y' Z' U' V' W' b t"));
        assert!(longest.lines().all(|line| line.chars().count() <= 80), "{longest}");
        assert!(longest.contains("W'----b-----t"), "{longest}");
    }
}
