use std::{fmt::Write as _, path::PathBuf};

use clap::ValueEnum;
use schemars::JsonSchema;
use serde::Serialize;
use volcomp_document::read_text;
use volcomp_metrology::form::{
    CoordinatePlane, DatumAxis, Feature, FeatureKind, Form, evaluate_form, parse_points,
};

use super::{Answer, fixed, range, table, table_text};
use crate::{arguments::numbers, failure::Failure, table::folded};

/// Fit a feature to measured points: form deviation, position and axis
///
/// Least-squares and, for circles, planes and lines with --plane, minimum-zone deviation; without filters. At least 4
/// points of a circle or plane, 3 of a line, 6 of a cylinder, 7 of a cone. The deviation of a line without --plane is the
/// diameter of the cylinder about the least-squares line that holds all points. Coaxiality is twice the largest distance
/// of the axis from the datum axis over the extent of the points, for a circle that of its centre.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp form ring.csv --feature circle --plane xy
  volcomp --json form bore.csv --feature cylinder --datum 0,0,0,0,0,1")]
pub(crate) struct FormArguments {
    /// CSV file of points with the columns x, y, z, mm
    points: PathBuf,
    /// Measured feature
    #[arg(long)]
    feature: FeatureName,
    /// Plane of a circle or line [default: least-squares plane of a circle; a line in space]
    #[arg(long)]
    plane: Option<PlaneName>,
    /// Datum axis for coaxiality: a point x,y,z (mm) and a direction i,j,k of any length
    #[arg(long, value_name = "X,Y,Z,I,J,K", allow_hyphen_values = true)]
    datum: Option<String>,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum FeatureName {
    Circle,
    Line,
    Plane,
    Cylinder,
    Cone,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum PlaneName {
    Xy,
    Yz,
    Zx,
}

impl From<PlaneName> for CoordinatePlane {
    fn from(name: PlaneName) -> Self {
        match name {
            PlaneName::Xy => Self::Xy,
            PlaneName::Yz => Self::Yz,
            PlaneName::Zx => Self::Zx,
        }
    }
}

impl FormArguments {
    fn feature(&self) -> Result<Feature, Failure> {
        let plane = self.plane.map(CoordinatePlane::from);
        let feature = match self.feature {
            FeatureName::Circle => return Ok(Feature::Circle { plane }),
            FeatureName::Line => return Ok(Feature::Line { plane }),
            FeatureName::Plane => Feature::Plane,
            FeatureName::Cylinder => Feature::Cylinder,
            FeatureName::Cone => Feature::Cone,
        };
        if plane.is_some() {
            let message = "--plane: found another feature, expected --feature circle or line";
            return Err(Failure::Input(message.to_owned()));
        }
        Ok(feature)
    }

    fn datum(&self) -> Result<Option<DatumAxis>, Failure> {
        let Some(text) = &self.datum else {
            return Ok(None);
        };
        if self.feature == FeatureName::Plane {
            let message =
                "--datum: found --feature plane, expected a feature with an axis or a centre";
            return Err(Failure::Input(message.to_owned()));
        }
        let expected = "six finite numbers, a point and a direction: 100,-20,35.5,0,0,1";
        let [x, y, z, i, j, k] = numbers("--datum", text, expected)?;
        let datum = DatumAxis::new([x, y, z], [i, j, k])
            .map_err(|e| Failure::Input(format!("--datum: {e}")))?;
        Ok(Some(datum))
    }
}

/// Result of `volcomp form`: the fitted feature and its form deviation.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct EvaluatedForm {
    /// `circle`, `line`, `plane`, `cylinder` or `cone`.
    feature: String,
    /// Number of evaluated points.
    points: usize,
    /// Position, mm: centre of a circle, apex of a cone, centroid of the points of a plane,
    /// midpoint of a line or of the axis of a cylinder.
    position_mm: [f64; 3],
    /// Unit vector along a line or an axis, or normal to a plane or to the plane of a circle. For a
    /// cone it points from the apex into the cone; otherwise its largest component is positive.
    direction: [f64; 3],
    /// Radius of a circle or a cylinder, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    radius_mm: Option<f64>,
    /// Half of the apex angle of a cone, deg.
    #[serde(skip_serializing_if = "Option::is_none")]
    half_angle_deg: Option<f64>,
    /// Ends of a line or an axis over the extent of the points, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    axis_mm: Option<[[f64; 3]; 2]>,
    /// Form deviation by least squares and by the minimum zone.
    deviation_um: Deviation,
    /// Range of the distances of the points from the plane of a circle, or from the plane of a
    /// line, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    out_of_plane_um: Option<f64>,
    /// Minimum zone: the narrowest ring, layer or strip that contains all points; null if not
    /// evaluated.
    minimum_zone: Option<Zone>,
    /// Coaxiality (concentricity of a circle's centre) to the axis of `--datum`, µm; only with `--datum`.
    #[serde(skip_serializing_if = "Option::is_none")]
    coaxiality_um: Option<f64>,
    /// Warnings and notes on the result.
    notes: Vec<String>,
}

/// Roundness, straightness, flatness, cylindricity or the form deviation of a cone, µm.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
struct Deviation {
    /// From the least-squares feature: range of the distances; for a line in space, diameter of the
    /// enclosing cylinder about it.
    least_squares: f64,
    /// By the minimum zone; null if not evaluated.
    minimum_zone: Option<f64>,
    /// Root mean square of the distances from the least-squares feature.
    rms: f64,
}

/// A minimum zone.
#[derive(Clone, Debug, Serialize, JsonSchema)]
struct Zone {
    /// Centre of the ring, or a point in the middle of the layer or strip, mm.
    position_mm: [f64; 3],
    /// Unit vector normal to the ring or layer, or along the strip.
    direction: [f64; 3],
    /// Inner and outer radius of the ring, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    radii_mm: Option<[f64; 2]>,
    /// Line numbers of the contact points, which determine the zone.
    contact_lines: Vec<usize>,
}

impl EvaluatedForm {
    /// `lines` holds the line numbers of the points in the file.
    fn new(form: &Form, lines: &[usize], coaxiality_mm: Option<f64>, notes: Vec<String>) -> Self {
        const UM_PER_MM: f64 = 1e3;
        let zone = form.minimum_zone.as_ref();
        let line_of = |&point: &usize| lines.get(point).copied();
        Self {
            feature: form.feature.to_string(),
            points: form.points,
            position_mm: form.position_mm,
            direction: form.direction,
            radius_mm: form.radius_mm,
            half_angle_deg: form.half_angle_rad.map(f64::to_degrees),
            axis_mm: (form.axis)
                .filter(|_| form.feature != FeatureKind::Circle)
                .map(|axis| axis.ends_mm),
            deviation_um: Deviation {
                least_squares: form.deviation_mm * UM_PER_MM,
                minimum_zone: zone.map(|zone| zone.deviation_mm * UM_PER_MM),
                rms: form.rms_mm * UM_PER_MM,
            },
            out_of_plane_um: form.out_of_plane_mm.map(|mm| mm * UM_PER_MM),
            minimum_zone: zone.map(|zone| Zone {
                position_mm: zone.position_mm,
                direction: zone.direction,
                radii_mm: zone.radii_mm,
                contact_lines: zone.contacts.iter().filter_map(line_of).collect(),
            }),
            coaxiality_um: coaxiality_mm.map(|mm| mm * UM_PER_MM),
            notes,
        }
    }
}

pub(crate) fn run(arguments: &FormArguments) -> Result<Answer, Failure> {
    let (feature, datum) = (arguments.feature()?, arguments.datum()?);
    let path = &arguments.points;
    let read = parse_points(&read_text(path)?, &path.display().to_string())?;
    let form = evaluate_form(&read.points_mm, feature).map_err(|error| match error {
        volcomp_metrology::form::FormError::Coordinate { .. } => Failure::input(error),
        other => Failure::in_file(path, other),
    })?;
    let mut notes = read.notes;
    if form.feature == FeatureKind::Circle && form.minimum_zone.is_none() {
        let note = "the narrowest ring about so short an arc is a straight strip: no minimum zone";
        notes.push(note.to_owned());
    }
    notes.extend(doubtful(&read.points_mm, form.deviation_mm));
    let coaxiality_mm = (form.axis.zip(datum)).map(|(axis, datum)| axis.coaxiality_mm(&datum));
    let document = EvaluatedForm::new(&form, &read.lines, coaxiality_mm, notes.clone());
    let text = text(&document, form.feature);
    Answer::new(&document, text, notes)
}

/// Form deviation, as a fraction of the size of the feature, above which points are doubtful for a machined part. The
/// deviation must also exceed `DOUBTFUL_MM`.
const DOUBTFUL_PART: f64 = 0.01;
const DOUBTFUL_MM: f64 = 0.1;
const LARGEST_MM: f64 = 50e3;

/// Notes on points that are probably points of another feature, or not in mm.
fn doubtful(points_mm: &[[f64; 3]], deviation_mm: f64) -> Vec<String> {
    let extent = |axis: usize| range(points_mm.iter().map(|point| point[axis]));
    let size_mm = [0, 1, 2].map(extent).iter().map(|x| x * x).sum::<f64>();
    let size_mm = size_mm.sqrt();
    let mut notes = Vec::new();
    if deviation_mm > DOUBTFUL_MM.max(DOUBTFUL_PART * size_mm) {
        notes.push(format!(
            "the form deviation of {} mm is large against the {} mm over which the points lie: are they points of another feature, or of two, or is a column in another unit?",
            fixed(deviation_mm, 3),
            fixed(size_mm, 1)
        ));
    }
    if size_mm > LARGEST_MM {
        notes.push(format!(
            "the points lie over {} m: are the coordinates in µm? expected mm",
            fixed(1e-3 * size_mm, 1)
        ));
    }
    notes
}

fn text(document: &EvaluatedForm, feature: FeatureKind) -> String {
    let mut places = table(&["", "x", "y", "z"]);
    let mut row = |name: &str, values: [f64; 3], digits: usize| {
        let [x, y, z] = values.map(|value| fixed(value, digits));
        places.add_row([name, &x, &y, &z]);
    };
    let (position, direction) = match feature {
        FeatureKind::Circle => ("centre, mm", "normal"),
        FeatureKind::Line => ("middle, mm", "direction"),
        FeatureKind::Plane => ("mean of the points, mm", "normal"),
        FeatureKind::Cylinder => ("middle of the axis, mm", "axis"),
        FeatureKind::Cone => ("apex, mm", "axis"),
    };
    row(position, document.position_mm, 5);
    row(direction, document.direction, 7);
    if let Some([from, to]) = document.axis_mm {
        row("from, mm", from, 5);
        row("to, mm", to, 5);
    }
    if let Some(zone) = &document.minimum_zone {
        match feature {
            FeatureKind::Circle => row("centre of the minimum zone, mm", zone.position_mm, 5),
            FeatureKind::Plane => row("normal of the minimum zone", zone.direction, 7),
            _ => row("direction of the minimum zone", zone.direction, 7),
        }
    }
    let mut text = format!("{feature} of least squares, {} points\n\n", document.points);
    text += &table_text(&places);
    text.push('\n');
    if let Some(radius) = document.radius_mm {
        let _ = writeln!(text, "radius {} mm", fixed(radius, 5));
    }
    if let Some(angle) = document.half_angle_deg {
        let _ = writeln!(text, "half angle {} deg", fixed(angle, 6));
    }
    let form = &document.deviation_um;
    let name = deviation(document, feature);
    let least = fixed(form.least_squares, 2);
    let _ = writeln!(text, "{name} {least} µm (rms {} µm)", fixed(form.rms, 2));
    if let (Some(width), Some(zone)) = (form.minimum_zone, &document.minimum_zone) {
        let lines: Vec<String> = zone.contact_lines.iter().map(usize::to_string).collect();
        let said =
            format!("minimum zone {} µm, held by lines {}", fixed(width, 2), lines.join(", "));
        text += &folded(&said, "");
    }
    if let Some(out) = document.out_of_plane_um {
        let _ = writeln!(text, "out of the plane {} µm", fixed(out, 2));
    }
    if let Some(coaxiality) = document.coaxiality_um {
        let name = match feature {
            FeatureKind::Circle => "concentricity",
            _ => "coaxiality",
        };
        let _ = writeln!(text, "{name} to the datum axis {} µm", fixed(coaxiality, 2));
    }
    text
}

/// The name of the form deviation from the least-squares feature.
fn deviation(document: &EvaluatedForm, feature: FeatureKind) -> &'static str {
    match feature {
        FeatureKind::Circle => "roundness",
        // Without an out-of-plane deviation the line is a line in space.
        FeatureKind::Line if document.out_of_plane_um.is_none() => {
            "straightness, as diameter of the cylinder about the line,"
        }
        FeatureKind::Line => "straightness",
        FeatureKind::Plane => "flatness",
        FeatureKind::Cylinder => "cylindricity",
        FeatureKind::Cone => "form deviation of the cone",
    }
}
