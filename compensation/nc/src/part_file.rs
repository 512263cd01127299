//! The features of a part, and the lines of a program that cut them.

use volcomp_metrology::form::{CoordinatePlane, Feature};
use volcomp_model::document::{Document, InputError, Section, Value};

/// Heights along the tool at which a flank is looked at, at the most.
const MOST_HEIGHTS: usize = 100;
/// No tool is longer, mm.
const LARGEST_HEIGHT_MM: f64 = 1e4;

/// What is inspected of a feature.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Measured {
    /// Form, place and direction of the surface that the tool leaves.
    Form(Feature),
    /// The place of a drilled hole, half-way down.
    Hole,
}

/// A feature of a part.
#[derive(Clone, Debug, PartialEq)]
pub struct PartFeature {
    /// Its name.
    pub name: String,
    /// What is inspected of it.
    pub measured: Measured,
    /// The first and the last line of the program that cut it, from 1.
    pub lines: [usize; 2],
    /// How far above the tip, along the tool, it is cut, mm: one height for a cut by the tip or a ball, several for a flank.
    pub above_mm: Vec<f64>,
    /// The place of the feature, among those before it, whose axis is the datum.
    pub datum: Option<usize>,
}

/// In which coordinates a part is inspected.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Alignment {
    /// In those of the program: how the part lies on the machine counts as an error of place and direction.
    #[default]
    Program,
    /// In its own: moved as a rigid body so that all its points fit best by least squares, as a measuring machine does.
    BestFit,
}

/// A part to be inspected.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Part {
    /// In which coordinates.
    pub alignment: Alignment,
    /// Its features in the order of the file.
    pub features: Vec<PartFeature>,
}

impl Part {
    /// Reads a part file, whose name is used in messages.
    ///
    /// # Errors
    /// Keys that are not known, values of another kind; with file, line and key.
    pub fn parse(text: &str, file: &str) -> Result<Self, InputError> {
        Document::new(file, text).decode(|root| {
            root.allow(&["alignment", "feature"])?;
            let alignment = match root.get("alignment") {
                Some(value) => value.one_of(&[
                    ("program", Alignment::Program),
                    ("best-fit", Alignment::BestFit),
                ])?,
                None => Alignment::default(),
            };
            let mut features: Vec<PartFeature> = Vec::new();
            let items = root.require("feature")?;
            if items.items()?.is_empty() {
                return Err(
                    items.error("found an empty list, expected a table [[feature]] at least")
                );
            }
            for item in items.items()? {
                let feature = feature(&item.section()?, &features)?;
                features.push(feature);
            }
            Ok(Self {
                alignment,
                features,
            })
        })
    }
}

/// A height along the tool, mm.
fn height(value: &Value<'_>) -> Result<f64, InputError> {
    let height = value.number()?;
    if height.abs() > LARGEST_HEIGHT_MM {
        return Err(value.error(format!(
            "found {height}, expected mm from -{LARGEST_HEIGHT_MM} to {LARGEST_HEIGHT_MM}"
        )));
    }
    Ok(height)
}

fn feature(section: &Section<'_>, before: &[PartFeature]) -> Result<PartFeature, InputError> {
    section.allow(&["name", "kind", "plane", "lines", "above_mm", "datum"])?;
    let name_value = section.require("name")?;
    let name = name_value.text()?.to_owned();
    if before.iter().any(|other| other.name == name) {
        return Err(name_value.error(format!("found {name:?} twice, expected a name of its own")));
    }
    let plane_value = section.get("plane");
    let plane = match &plane_value {
        Some(value) => Some(value.one_of(&[
            ("xy", CoordinatePlane::Xy),
            ("yz", CoordinatePlane::Yz),
            ("zx", CoordinatePlane::Zx),
        ])?),
        None => None,
    };
    let measured = section.require("kind")?.one_of(&[
        ("circle", Measured::Form(Feature::Circle { plane })),
        ("line", Measured::Form(Feature::Line { plane })),
        ("plane", Measured::Form(Feature::Plane)),
        ("cylinder", Measured::Form(Feature::Cylinder)),
        ("cone", Measured::Form(Feature::Cone)),
        ("hole", Measured::Hole),
    ])?;
    let has_plane = matches!(
        measured,
        Measured::Form(Feature::Circle { .. } | Feature::Line { .. })
    );
    if let Some(value) = plane_value.filter(|_| !has_plane) {
        return Err(
            value.error("found it for another kind, expected it for circles and lines only")
        );
    }
    let lines_value = section.require("lines")?;
    let [first, last] = lines_value.vector::<2>()?;
    let line = |number: f64| -> Option<usize> {
        let is_line = (1.0..=1e9).contains(&number) && number.fract() == 0.0;
        is_line
            .then(|| format!("{number:.0}").parse().ok())
            .flatten()
    };
    let lines = line(first)
        .zip(line(last))
        .filter(|(first, last)| first <= last);
    let (first, last) = lines.ok_or_else(|| {
        lines_value.error(format!(
            "found [{first}, {last}], expected the numbers of the first and the last line that cut it, from 1"
        ))
    })?;
    let above_mm = match section.get("above_mm") {
        None => vec![0.0],
        Some(value) => {
            let items = value.items()?;
            if items.is_empty() || items.len() > MOST_HEIGHTS {
                return Err(value.error(format!(
                    "found {} heights, expected 1 to {MOST_HEIGHTS}",
                    items.len()
                )));
            }
            items.iter().map(height).collect::<Result<_, _>>()?
        }
    };
    let datum = match section.get("datum") {
        None => None,
        Some(value) => {
            let name = value.text()?;
            let place = before.iter().position(|other| other.name == name);
            let has_axis = |place: &usize| {
                !matches!(
                    before[*place].measured,
                    Measured::Hole | Measured::Form(Feature::Plane)
                )
            };
            Some(place.filter(has_axis).ok_or_else(|| {
                value.error(format!(
                    "found {name:?}, expected the name of a feature above it that has an axis"
                ))
            })?)
        }
    };
    Ok(PartFeature {
        name,
        measured,
        lines: [first, last],
        above_mm,
        datum,
    })
}
