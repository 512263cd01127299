//! Part 4: circular tests.

use std::{cell::RefCell, fmt::Write as _, path::Path};

use clap::ValueEnum;
use schemars::JsonSchema;
use serde::Serialize;
use volcomp_document::read_bytes;
use volcomp_metrology::{
    DeviationUnit, Metadata, MetrologyError, Tolerance,
    circular::{
        CircularPlane, CircularTrace, Sense, Signature, SignatureKind, Signatures,
        circular_deviations, circular_signatures, parse_trace,
    },
    judged, opening,
};
use volcomp_report::{CirclePlot, circles_picture};

use super::Iso230Arguments;
use crate::{
    commands::{
        Answer,
        evaluation::{
            CIRCULAR, Evaluated, Judgement, decision_text, evaluated, quantities_text, tolerances,
        },
        fixed, table, table_text,
    },
    failure::Failure,
    table::to_the_left,
};

/// Options of circles.
#[derive(clap::Args)]
#[command(next_help_heading = "Circles (--part 4)")]
pub(super) struct CircleOptions {
    /// Plane of the circle [default: xy]
    #[arg(long)]
    plane: Option<Plane>,
    /// Nominal radius, mm; optional for positions
    #[arg(long, value_name = "MM")]
    radius_mm: Option<f64>,
    /// Feed along the circle, mm/min, to give a servo mismatch as a delay too
    #[arg(long, value_name = "MM_PER_MIN")]
    feed: Option<f64>,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Plane {
    Xy,
    Yz,
    Zx,
}

/// A circular test evaluated by ISO 230-4.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct CircularTest {
    /// Path as named in the call.
    file: String,
    /// The plane: `xy`, `yz` or `zx`.
    plane: &'static str,
    /// The nominal radius, mm; without `--radius-mm` the mean radius of the points.
    radius_mm: f64,
    /// Number of points of the counter-clockwise and of the clockwise run.
    points: [usize; 2],
    /// The least-squares centre that was removed, along the two axes, µm. For positions, the centre
    /// that remains after removal during reading.
    centre_um: [f64; 2],
    /// Error sources fitted to the shape, largest first; empty if the points do not determine them.
    signatures: Vec<NamedSignature>,
    /// Spikes at 0°, 90°, 180° and 270°, µm, positive outward; null at an angle without points, or
    /// without signatures.
    spikes_um: Option<[Option<f64>; 4]>,
    /// Root mean square of the residuals after all signatures, µm; null without signatures.
    rms_left_um: Option<f64>,
    /// G of each direction of rotation, G(b), F and D.
    #[serde(flatten)]
    judgement: Judgement,
}

/// A fitted error source with the axes of its plane. The size of a squareness has the sign of the
/// error.
#[derive(Debug, Serialize, JsonSchema)]
struct NamedSignature {
    /// Error or axes of the signature: `EC0Y`, `X`, `X − Y`.
    of: String,
    #[serde(flatten)]
    signature: Signature,
    /// For a servo mismatch, the delay of the first axis behind the second, ms; only with `--feed`.
    #[serde(skip_serializing_if = "Option::is_none")]
    delay_ms: Option<f64>,
}

impl CircleOptions {
    pub(super) fn given(&self) -> Option<&'static str> {
        match (self.plane, self.radius_mm, self.feed) {
            (Some(_), ..) => Some("--plane"),
            (_, Some(_), _) => Some("--radius-mm"),
            (.., Some(_)) => Some("--feed"),
            _ => None,
        }
    }

    fn plane(&self) -> (CircularPlane, &'static str) {
        match self.plane.unwrap_or(Plane::Xy) {
            Plane::Xy => (CircularPlane::Xy, "xy"),
            Plane::Yz => (CircularPlane::Yz, "yz"),
            Plane::Zx => (CircularPlane::Zx, "zx"),
        }
    }
}

pub(super) fn run(arguments: &Iso230Arguments) -> Result<Answer, Failure> {
    let tolerances = tolerances(arguments.tolerance.as_deref(), &CIRCULAR)?;
    if let Some(feed) = arguments.circle.feed
        && !(feed.is_finite() && feed > 0.0)
    {
        return Err(Failure::Input(format!("--feed: found {feed}, expected mm/min above zero")));
    }
    let csv = arguments.csv.as_deref();
    let plot = arguments.plot_file()?;
    let drawn = RefCell::new(Vec::new());
    let answer = evaluated(&arguments.files, csv, |path| {
        one(path, &arguments.circle, &tolerances, arguments.files.len() == 1, &drawn)
    })?;
    if let Some(plot) = plot {
        plot.write(&circles_picture(&drawn.into_inner()))?;
    }
    Ok(answer)
}

fn read(path: &Path, options: &CircleOptions) -> Result<CircularTrace, Failure> {
    let file = path.display().to_string();
    if path.is_dir() {
        let found = MetrologyError::Directory { file };
        return Err(found.into());
    }
    let bytes = read_bytes(path)
        .map_err(|source| MetrologyError::Unreadable { file: file.clone(), source })?;
    let (plane, _) = options.plane();
    Ok(parse_trace(&bytes, &file, plane, options.radius_mm)?)
}

fn one(
    path: &Path,
    options: &CircleOptions,
    tolerances: &[Tolerance],
    with_names: bool,
    drawn: &RefCell<Vec<CirclePlot>>,
) -> Result<Evaluated<CircularTest>, Failure> {
    let trace = read(path, options)?;
    let deviations = circular_deviations(&trace)?;
    let mut notes = trace.notes.clone();
    if !trace.radius_is_stated {
        notes.push("F and D need the nominal radius: state it with --radius-mm".to_owned());
    }
    for sense in Sense::BOTH {
        if !trace.has(sense) {
            notes.push(format!(
                "nothing was run {}: so there is no G(b) and no D, and squareness holds servo mismatch",
                sense.key()
            ));
        }
    }
    let signatures = match circular_signatures(&trace) {
        Ok(signatures) => Some(signatures),
        Err(error) => {
            notes.push(error.to_string());
            None
        }
    };
    let missing =
        signatures.iter().flat_map(|s| s.spikes_um.iter().zip(["0°", "90°", "180°", "270°"]));
    let missing = missing.filter(|(spike, _)| spike.is_none());
    let missing: Vec<&str> = missing.map(|(_, place)| place).collect();
    if !missing.is_empty() {
        notes.push(format!(
            "the points do not pass {}: nothing is known of spikes there",
            missing.join(", ")
        ));
    }
    let none = |_: &str| None;
    let quantities = deviations.quantities();
    let quantities = judged("ISO 230-4", quantities, DeviationUnit::Um, tolerances, none);
    let (plane, plane_name) = options.plane();
    let count = |sense: Sense| trace.points.iter().filter(|p| p.sense == sense).count();
    let document = CircularTest {
        file: path.display().to_string(),
        plane: plane_name,
        radius_mm: trace.radius_mm,
        points: Sense::BOTH.map(count),
        centre_um: deviations.centre_um,
        signatures: signatures.iter().flat_map(|s| named(s, plane, options.feed)).collect(),
        spikes_um: signatures.as_ref().map(|s| s.spikes_um),
        rms_left_um: signatures.as_ref().map(|s| s.rms_left_um),
        judgement: Judgement::new(quantities, notes),
    };
    drawn.borrow_mut().push(CirclePlot {
        file: document.file.clone(),
        plane,
        centre_um: document.centre_um,
        quantities: document.judgement.quantities.clone(),
        trace,
    });
    Ok(Evaluated {
        text: text(&document, with_names),
        metadata: Metadata::default(),
        judgement: document.judgement.clone(),
        document,
    })
}

fn named(signatures: &Signatures, plane: CircularPlane, feed: Option<f64>) -> Vec<NamedSignature> {
    use SignatureKind as Kind;
    let [first, second] = plane.axes();
    let error = plane.squareness();
    // A squareness error increases or decreases the angle of its plane.
    let sense = opening(error).unwrap_or(1.0);
    let one = |signature: &Signature| {
        let (of, sign) = match signature.kind {
            Kind::Squareness => (error.to_string(), sense),
            Kind::ScaleMismatch => (format!("{first} − {second}"), 1.0),
            Kind::ServoMismatch => (format!("{first} behind {second}"), 1.0),
            Kind::BacklashFirst | Kind::SpikesFirst => (first.to_string(), 1.0),
            Kind::BacklashSecond | Kind::SpikesSecond => (second.to_string(), 1.0),
        };
        // Size of a servo mismatch: c = v Δt/2, with c in µm, v in mm/min and the result in ms.
        let delay = |feed: f64| 2.0 * signature.size * 1e-3 / (feed / 60.0) * 1e3;
        NamedSignature {
            of,
            signature: Signature { size: sign * signature.size, ..signature.clone() },
            delay_ms: feed.filter(|_| signature.kind == Kind::ServoMismatch).map(delay),
        }
    };
    signatures.ranked.iter().map(one).collect()
}

fn text(document: &CircularTest, with_names: bool) -> String {
    let mut text = format!(
        "ISO 230-4, plane {}, radius {} mm, about the centre of least squares, µm\n\n{}",
        document.plane,
        fixed(document.radius_mm, 4),
        quantities_text(&document.judgement.quantities, with_names)
    );
    if !document.signatures.is_empty() {
        let mut rows =
            table(&["signature", "of", "size", "±U (k=2)", "unit", "range µm", "share %"]);
        to_the_left(&mut rows, &[1, 4]);
        for NamedSignature { of, signature, .. } in &document.signatures {
            rows.add_row([
                signature.kind.key().to_owned(),
                of.clone(),
                fixed(signature.size, 2),
                fixed(signature.uncertainty, 2),
                signature.unit.to_string(),
                fixed(signature.range_um, 2),
                fixed(100.0 * signature.share, 1),
            ]);
        }
        let _ = write!(text, "\n{}", table_text(&rows));
    }
    if let Some(rms) = document.rms_left_um {
        let _ = writeln!(text, "\nleft by all of them: {} µm (rms)", fixed(rms, 2));
    }
    for signature in &document.signatures {
        if let Some(delay) = signature.delay_ms {
            let _ = writeln!(text, "{}: {} ms", signature.of, fixed(delay, 3));
        }
    }
    text + &decision_text(&document.judgement)
}
