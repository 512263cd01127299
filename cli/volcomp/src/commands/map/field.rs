//! Writes the field of a map to its file in chunks of nodes, because a map may be larger than memory.

use std::{fmt::Write, path::Path};

use volcomp_kinematics::nalgebra::Vector3;
use volcomp_model::MapGrid;

use crate::{failure::Failure, output::OutputFile};

/// Names of the arrays stored per node besides its position: the errors (µm, µrad), then their standard uncertainties.
/// Each group has two vectors of three components.
const VECTORS: [[&str; 2]; 2] =
    [["position_um", "rotation_urad"], ["u_position_um", "u_rotation_urad"]];
/// Column names. They differ from those of positions (`X_mm`) by more than case, because databases ignore case.
const COLUMNS: [[&str; 6]; 2] = [
    ["error_x_um", "error_y_um", "error_z_um", "error_a_urad", "error_b_urad", "error_c_urad"],
    [
        "uncertainty_x_um",
        "uncertainty_y_um",
        "uncertainty_z_um",
        "uncertainty_a_urad",
        "uncertainty_b_urad",
        "uncertainty_c_urad",
    ],
];

/// One node of the map: its position, and the tool error in workpiece axes (mm, rad).
#[derive(Clone, Copy)]
pub(super) struct Node {
    /// Coordinates along the axes of the grid, mm.
    pub(super) at_mm: [f64; 3],
    /// The ideal tool tip in workpiece axes, mm.
    pub(super) tip_mm: Vector3<f64>,
    /// Position error (mm) and rotation error (rad).
    pub(super) error: [f64; 6],
    /// Standard uncertainties of the six components of `error`; `None` if not requested.
    pub(super) uncertainty: Option<[f64; 6]>,
}

impl Node {
    /// The error in the units of the files: three of position in µm, three of rotation in µrad.
    pub(super) fn in_file_units(&self) -> [f64; 6] {
        in_file_units(&self.error)
    }

    /// The standard uncertainty in the units of the files; zero if not requested.
    pub(super) fn uncertainty_in_file_units(&self) -> [f64; 6] {
        in_file_units(&self.uncertainty.unwrap_or_default())
    }
}

/// Converts three lengths in mm and three angles in rad to µm and µrad.
fn in_file_units(six: &[f64; 6]) -> [f64; 6] {
    let [x, y, z, a, b, c] = six;
    [x * 1e3, y * 1e3, z * 1e3, a * 1e6, b * 1e6, c * 1e6]
}

pub(super) enum Field {
    None,
    Text(TextField),
    #[cfg(feature = "parquet")]
    Parquet(Box<super::parquet::ParquetField>),
}

pub(super) struct TextField {
    file: OutputFile,
    format: TextFormat,
    /// Number of column groups: 1 for errors, 2 for errors and their uncertainties.
    groups: usize,
}

/// Text formats. Chunks of nodes are formatted in parallel.
#[derive(Clone, Copy)]
pub(super) enum TextFormat {
    Csv,
    /// Stores one array after another, which needs several passes over the nodes.
    Vtk(&'static str),
}

impl Field {
    pub(super) fn open(
        path: Option<&Path>,
        grid: &MapGrid,
        uncertain: bool,
    ) -> Result<Self, Failure> {
        let Some(path) = path else {
            return Ok(Self::None);
        };
        let groups = 1 + usize::from(uncertain);
        let text = |format, head: String| {
            let mut file = OutputFile::open(path)?;
            file.append(head.as_bytes())?;
            Ok(Self::Text(TextField { file, format, groups }))
        };
        match path.extension().and_then(|e| e.to_str()) {
            Some("csv") => {
                let axes: Vec<String> = grid.axes.iter().map(|name| format!("{name}_mm")).collect();
                let columns = COLUMNS[..groups].concat().join(",");
                text(TextFormat::Csv, format!("{},{columns}\n", axes.join(",")))
            }
            Some("vti") => text(TextFormat::Vtk("ImageData"), vti_head(grid)),
            Some("vtr") => text(TextFormat::Vtk("RectilinearGrid"), vtr_head(grid)),
            #[cfg(feature = "parquet")]
            Some("parquet") => {
                let columns = COLUMNS[..groups].concat();
                let field = super::parquet::ParquetField::open(path, grid, &columns)?;
                Ok(Self::Parquet(Box::new(field)))
            }
            #[cfg(not(feature = "parquet"))]
            Some("parquet") => Err(Failure::Input(format!(
                "{}: this build writes no Parquet (cargo feature `parquet`), expected .csv, .vti or .vtr",
                path.display()
            ))),
            _ => Err(Failure::Input(format!(
                "{}: found no known ending, expected .csv, .vti, .vtr or .parquet",
                path.display()
            ))),
        }
    }

    pub(super) fn passes(&self) -> usize {
        match self.text_format() {
            Some((TextFormat::Vtk(_), groups)) => 2 * groups,
            _ => 1,
        }
    }

    pub(super) fn begin(&mut self, pass: usize) -> Result<(), Failure> {
        if let Self::Text(TextField { file, format: TextFormat::Vtk(_), .. }) = self {
            let before = if pass == 0 { "" } else { "</DataArray>\n" };
            let name = VECTORS[pass / 2][pass % 2];
            let head = format!(
                "{before}<DataArray type=\"Float64\" Name=\"{name}\" NumberOfComponents=\"3\" format=\"ascii\">\n"
            );
            file.append(head.as_bytes())?;
        }
        Ok(())
    }

    /// The text format and the number of column groups; `None` if the field is not text.
    pub(super) fn text_format(&self) -> Option<(TextFormat, usize)> {
        if let Self::Text(text) = self { Some((text.format, text.groups)) } else { None }
    }

    pub(super) fn write(&mut self, nodes: &[Node], text: &str) -> Result<(), Failure> {
        match self {
            Self::Text(field) => field.file.append(text.as_bytes()),
            #[cfg(feature = "parquet")]
            Self::Parquet(field) => field.write(nodes),
            Self::None => {
                debug_assert!(!nodes.is_empty());
                Ok(())
            }
        }
    }

    pub(super) fn finish(self) -> Result<(), Failure> {
        match self {
            Self::None => Ok(()),
            #[cfg(feature = "parquet")]
            Self::Parquet(field) => field.finish(),
            Self::Text(mut text) => {
                if let TextFormat::Vtk(kind) = text.format {
                    let end =
                        format!("</DataArray>\n</PointData>\n</Piece>\n</{kind}>\n</VTKFile>\n");
                    text.file.append(end.as_bytes())?;
                }
                text.file.finish()
            }
        }
    }
}

impl TextFormat {
    pub(super) fn lines(self, pass: usize, axes: usize, nodes: &[Node]) -> String {
        let mut text = String::new();
        for node in nodes {
            let _ = match self {
                Self::Csv => csv_line(&mut text, axes, node),
                Self::Vtk(_) => {
                    let six = if pass < 2 {
                        node.in_file_units()
                    } else {
                        node.uncertainty_in_file_units()
                    };
                    let from = 3 * (pass % 2);
                    let [x, y, z] = [six[from], six[from + 1], six[from + 2]];
                    writeln!(text, "{x:.6} {y:.6} {z:.6}")
                }
            };
        }
        text
    }
}

fn csv_line(text: &mut String, axes: usize, node: &Node) -> std::fmt::Result {
    for place in &node.at_mm[..axes] {
        write!(text, "{place},")?;
    }
    let [x, y, z, a, b, c] = node.in_file_units();
    write!(text, "{x:.6},{y:.6},{z:.6},{a:.6},{b:.6},{c:.6}")?;
    if node.uncertainty.is_some() {
        let [x, y, z, a, b, c] = node.uncertainty_in_file_units();
        write!(text, ",{x:.6},{y:.6},{z:.6},{a:.6},{b:.6},{c:.6}")?;
    }
    writeln!(text)
}

/// The nodes along X, Y or Z (`place` 0, 1, 2), mm; a single node at 0 if the grid lacks the axis.
fn nodes_along(grid: &MapGrid, place: usize) -> &[f64] {
    let mut along = grid.axes.iter().zip(&grid.nodes_mm);
    let own = along.find(|(axis, _)| axis.mcs_index() == place);
    own.map_or(&[0.0], |(_, nodes)| nodes)
}

fn vti_head(grid: &MapGrid) -> String {
    let (mut extent, mut origin, mut spacing) = (String::new(), String::new(), String::new());
    for place in 0..3 {
        let nodes = nodes_along(grid, place);
        let step = nodes.get(1).map_or(1.0, |second| second - nodes[0]);
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

/// The lines before the data, which contain the coordinates of the nodes.
fn vtr_head(grid: &MapGrid) -> String {
    let (mut extent, mut coordinates) = (String::new(), String::new());
    for place in 0..3 {
        let nodes = nodes_along(grid, place);
        let name = ["X_mm", "Y_mm", "Z_mm"][place];
        let shown: Vec<String> = nodes.iter().map(ToString::to_string).collect();
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
