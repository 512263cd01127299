//! `volcomp map`: the error on a grid over the travels.

use std::{
    fmt::Write,
    path::{Path, PathBuf},
    str::FromStr,
};

use serde_json::{Map, Value, json};
use volcomp_kinematics::{Form, State, VolumetricError, volumetric_error};
use volcomp_model::{Machine, MapGrid, MapNode, Temperatures, Tolerance};

use super::{Answer, micrometres, microradians, thermal_note};
use crate::{failure::Failure, output::OutputFile, points::MachineArguments, progress};

/// The volumetric map: the error on a grid over the travels of X, Y and Z
#[derive(clap::Args)]
pub(crate) struct Arguments {
    #[command(flatten)]
    machine: MachineArguments,
    /// Nodes along X, Y and Z: 21x21x21
    #[arg(long)]
    grid: String,
    /// File for the field: .csv, .vti (VTK image data) or .vtr (VTK rectilinear grid)
    #[arg(long, short)]
    output: Option<PathBuf>,
    /// Form of the model: exact, htm, twist, or compiled: first order, for maps of many nodes
    #[arg(long, default_value = "exact")]
    model: Model,
}

/// How the error at a node is computed.
#[derive(Clone, Copy, Debug)]
enum Model {
    Form(Form),
    Compiled,
}

impl FromStr for Model {
    type Err = &'static str;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        match name {
            "compiled" => Ok(Self::Compiled),
            _ => name
                .parse()
                .map(Self::Form)
                .map_err(|_| "unknown model form, expected exact, htm, twist or compiled"),
        }
    }
}

type ErrorAt<'a> = Box<dyn Fn(&State) -> VolumetricError + 'a>;

impl Model {
    fn errors<'a>(
        self,
        machine: &'a Machine,
        temperatures: &Temperatures,
    ) -> Result<ErrorAt<'a>, Failure> {
        match self {
            Self::Form(form) => {
                let source = machine.source(temperatures);
                Ok(Box::new(move |state| {
                    volumetric_error(machine.chain(), &source, state, form)
                }))
            }
            Self::Compiled if !temperatures.is_empty() => Err(Failure::Input(
                "--model compiled takes no temperatures, expected another form with --temperature"
                    .to_owned(),
            )),
            Self::Compiled => {
                let compiled = machine.compile(Tolerance::default())?;
                Ok(Box::new(move |state| {
                    let found = compiled.evaluate(state);
                    VolumetricError {
                        position_mm: found.position_mm.into(),
                        rotation_rad: found.rotation_rad.into(),
                    }
                }))
            }
        }
    }
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    let counts = parse_grid(&arguments.grid)?;
    let (machine, temperatures) = arguments.machine.read()?;
    let grid = MapGrid::over_travels(&machine, counts);
    let mut field = Field::open(arguments.output.as_deref(), &grid)?;
    let errors = arguments.model.errors(&machine, &temperatures)?;
    let mut largest: Option<(f64, MapNode)> = None;
    for pass in 0..field.passes() {
        let bar = progress::bar(grid.len(), "nodes");
        field.begin(pass)?;
        for (index, node) in grid.evaluate(&machine, &errors).enumerate() {
            if index % 4096 == 0 {
                bar.set_position(index as u64);
            }
            field.write(pass, &grid, &node)?;
            let length = node.error.position_mm.norm();
            if largest.as_ref().is_none_or(|(most, _)| length > *most) {
                largest = Some((length, node));
            }
        }
        bar.finish_and_clear();
    }
    field.finish()?;
    let counts: Vec<usize> = grid.nodes_mm.iter().map(Vec::len).collect();
    let mut json = json!({ "counts": counts, "nodes": grid.len() });
    let mut text = format!("{} nodes\n", grid.len());
    if let Some((length, node)) = largest {
        let at: Map<String, Value> = grid
            .axes
            .iter()
            .zip(node.at_mm)
            .map(|(name, place)| (name.to_string(), json!(place)))
            .collect();
        let position_um = micrometres(&node.error.position_mm);
        let _ = writeln!(
            text,
            "largest error {:.3} um [{:.3}, {:.3}, {:.3}] at {}",
            length * 1e3,
            position_um[0],
            position_um[1],
            position_um[2],
            at.iter()
                .map(|(name, place)| format!("{name}={place}"))
                .collect::<Vec<_>>()
                .join(" ")
        ); // writing to a String cannot fail
        json["largest_um"] = json!(length * 1e3);
        json["at"] = Value::Object(at);
        json["position_um"] = json!(position_um);
        json["rotation_urad"] = json!(microradians(&node.error.rotation_rad));
    }
    if let Some(path) = &arguments.output {
        json["file"] = json!(path.display().to_string());
    }
    Ok(Answer {
        json,
        text,
        notes: thermal_note(&machine, &temperatures).into_iter().collect(),
    })
}

fn parse_grid(text: &str) -> Result<[usize; 3], Failure> {
    let counts: Option<Vec<usize>> = text.split('x').map(|count| count.parse().ok()).collect();
    counts
        .and_then(|counts| <[usize; 3]>::try_from(counts).ok())
        .filter(|counts| {
            let product = counts
                .iter()
                .try_fold(1_usize, |product, &count| product.checked_mul(count));
            product.is_some_and(|product| (1..=10_000_000_000).contains(&product))
        })
        .ok_or_else(|| {
            Failure::Input(format!(
                "--grid: found `{text}`, expected three counts of nodes from 1: 21x21x21"
            ))
        })
}

/// Where the nodes go, a node at a time: a map may be larger than memory.
enum Field {
    None,
    Csv(OutputFile),
    /// Positions, then rotations: VTK wants one after the other, so the nodes are gone through twice.
    Vtk(OutputFile, &'static str),
}

impl Field {
    fn open(path: Option<&Path>, grid: &MapGrid) -> Result<Self, Failure> {
        let Some(path) = path else {
            return Ok(Self::None);
        };
        match path.extension().and_then(|e| e.to_str()) {
            Some("csv") => {
                let mut file = OutputFile::open(path)?;
                let axes: Vec<String> = grid.axes.iter().map(|name| format!("{name}_mm")).collect();
                let axes = axes.join(",");
                file.write(&format!("{axes},x_um,y_um,z_um,a_urad,b_urad,c_urad\n"))?;
                Ok(Self::Csv(file))
            }
            Some("vti") => {
                let mut file = OutputFile::open(path)?;
                file.write(&vti_head(grid))?;
                Ok(Self::Vtk(file, "ImageData"))
            }
            Some("vtr") => {
                let mut file = OutputFile::open(path)?;
                file.write(&vtr_head(grid))?;
                Ok(Self::Vtk(file, "RectilinearGrid"))
            }
            Some("parquet") => Err(Failure::Input(format!(
                "{}: this build writes no Parquet, expected .csv, .vti or .vtr",
                path.display()
            ))),
            _ => Err(Failure::Input(format!(
                "{}: found no known ending, expected .csv, .vti or .vtr",
                path.display()
            ))),
        }
    }

    fn passes(&self) -> usize {
        if matches!(self, Self::Vtk(..)) { 2 } else { 1 }
    }

    fn begin(&mut self, pass: usize) -> Result<(), Failure> {
        match (self, pass) {
            (Self::Vtk(file, _), 0) => file.write(&array("position_um")),
            (Self::Vtk(file, _), _) => {
                file.write(&format!("</DataArray>\n{}", array("rotation_urad")))
            }
            _ => Ok(()),
        }
    }

    fn write(&mut self, pass: usize, grid: &MapGrid, node: &MapNode) -> Result<(), Failure> {
        let [x, y, z] = micrometres(&node.error.position_mm);
        let [a, b, c] = microradians(&node.error.rotation_rad);
        match self {
            Self::None => Ok(()),
            Self::Csv(file) => {
                let places = node.at_mm.iter().take(grid.axes.len());
                let at: Vec<String> = places.map(ToString::to_string).collect();
                let at = at.join(",");
                file.write(&format!("{at},{x:.6},{y:.6},{z:.6},{a:.6},{b:.6},{c:.6}\n"))
            }
            Self::Vtk(file, _) => file.write(&match pass {
                0 => format!("{x:.6} {y:.6} {z:.6}\n"),
                _ => format!("{a:.6} {b:.6} {c:.6}\n"),
            }),
        }
    }

    fn finish(self) -> Result<(), Failure> {
        match self {
            Self::None => Ok(()),
            Self::Csv(file) => file.finish(),
            Self::Vtk(mut file, kind) => {
                file.write(&format!(
                    "</DataArray>\n</PointData>\n</Piece>\n</{kind}>\n</VTKFile>\n"
                ))?;
                file.finish()
            }
        }
    }
}

fn array(name: &str) -> String {
    format!(
        "<DataArray type=\"Float64\" Name=\"{name}\" NumberOfComponents=\"3\" format=\"ascii\">\n"
    )
}

fn vti_head(grid: &MapGrid) -> String {
    let (mut extent, mut origin, mut spacing) = (String::new(), String::new(), String::new());
    for place in 0..3 {
        let nodes = grid.nodes_mm.get(place).map_or(&[0.0][..], Vec::as_slice);
        let step = nodes.get(1).map_or(1.0, |second| second - nodes[0]);
        // Writing to a String cannot fail.
        let _ = write!(extent, "0 {} ", nodes.len() - 1);
        let _ = write!(origin, "{} ", nodes[0]);
        let _ = write!(spacing, "{step} ");
    }
    let (extent, origin, spacing) = (extent.trim(), origin.trim(), spacing.trim());
    format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"ImageData\" version=\"0.1\" byte_order=\"LittleEndian\">\n\
         <ImageData WholeExtent=\"{extent}\" Origin=\"{origin}\" Spacing=\"{spacing}\">\n\
         <Piece Extent=\"{extent}\">\n<PointData Vectors=\"position_um\">\n"
    )
}

/// The nodes themselves before the data.
fn vtr_head(grid: &MapGrid) -> String {
    let (mut extent, mut coordinates) = (String::new(), String::new());
    for place in 0..3 {
        let nodes = grid.nodes_mm.get(place).map_or(&[0.0][..], Vec::as_slice);
        let name = ["X_mm", "Y_mm", "Z_mm"][place];
        let shown: Vec<String> = nodes.iter().map(ToString::to_string).collect();
        // Writing to a String cannot fail.
        let _ = write!(extent, "0 {} ", nodes.len() - 1);
        let _ = writeln!(
            coordinates,
            "<DataArray type=\"Float64\" Name=\"{name}\" format=\"ascii\">{}</DataArray>",
            shown.join(" ")
        );
    }
    let extent = extent.trim();
    format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"RectilinearGrid\" version=\"0.1\" byte_order=\"LittleEndian\">\n\
         <RectilinearGrid WholeExtent=\"{extent}\">\n<Piece Extent=\"{extent}\">\n\
         <Coordinates>\n{coordinates}</Coordinates>\n<PointData Vectors=\"position_um\">\n"
    )
}
