//! Part 2: the positioning test of an axis, to ISO 230-2 and related standards.

use std::{borrow::Cow, cell::RefCell, path::Path};

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Serialize, Serializer};
use serde_json::{Map, Value, json};
use volcomp_metrology::{
    Approach, DeviationUnit, Direction, Edition, Iso230Part2, JudgedQuantity, LARGEST_PLAUSIBLE,
    Measurement, MotionKind, OutlierHint, PositioningUncertainty, Quantity, StandardQuantity,
    TargetRow, Tolerance, Vdi3441, asme_b5_54, axis_kind, axis_named, error_in_title, evaluate,
    implausible_size, judged, material_compensation, not_positioning, positioning_uncertainty,
    read_file, shortfalls, vdi_3441,
};
use volcomp_report::{Positioning, positioning_picture};
use volcomp_vocabulary::{AxisKind, AxisName, ErrorName};

use super::{Iso230Arguments, Standard};
use crate::{
    arguments,
    commands::{
        Answer,
        evaluation::{Evaluated, Judgement, decision_text, evaluated, quantities_text, tolerances},
        fixed, table, table_text,
    },
    failure::Failure,
    table::{coordinate, folded, or_dash},
};

const IS_ANGLE: &str = "the readings are angles of a linear axis: the statistics of the standard are of an angular error motion here, not of \
     positioning (of a rotary axis state --axis)";

/// A positioning test evaluated by ISO 230-2. A value that cannot be evaluated is null.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct PositioningTest {
    /// The unit of every deviation.
    unit: DeviationUnit,
    #[serde(flatten)]
    symbols: Symbols,
    /// Results at each target, in ascending order.
    targets: Vec<TargetRow>,
    /// Runs and readings that differ from the others; none is removed.
    hints: Vec<OutlierHint>,
    /// Path as named in the call; only with several files.
    #[serde(skip_serializing_if = "Option::is_none")]
    file: Option<String>,
    /// Edition of ISO 230-2, as a year.
    edition: u16,
    /// Measurement uncertainty; null if none of its contributions is stated.
    uncertainty: Option<PositioningUncertainty>,
    /// How the file states that the readings were corrected to 20 °C; null if this kind of file
    /// cannot state it.
    material_compensation: Option<String>,
    #[serde(flatten)]
    judgement: Judgement,
}

/// The values of ISO 230-2 by symbol. Each key ends in the unit, so that angles and lengths have different keys.
#[derive(Debug)]
struct Symbols(DeviationUnit, Vec<StandardQuantity>);

impl Serialize for Symbols {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let key = |symbol| format!("{symbol}_{}", self.0.key());
        serializer.collect_map(self.1.iter().map(|q| (key(q.symbol), q.value)))
    }
}

impl JsonSchema for Symbols {
    fn schema_name() -> Cow<'static, str> {
        "Symbols".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        let units = [DeviationUnit::Um, DeviationUnit::Urad].map(DeviationUnit::key);
        let key = |symbol| units.map(|unit| format!("{symbol}_{unit}"));
        let keys = Edition::symbols().into_iter().flat_map(key);
        let properties: Map<String, Value> =
            keys.map(|key| (key, json!({ "type": ["number", "null"] }))).collect();
        json_schema!({ "type": "object", "properties": properties })
    }
}

pub(super) fn run(arguments: &Iso230Arguments) -> Result<Answer, Failure> {
    let iso = Edition::symbols();
    let known: Vec<&str> = match arguments.standard {
        Standard::Vdi => Vdi3441::symbols().to_vec(),
        Standard::All => [&iso[..], &Vdi3441::symbols()].concat(),
        Standard::Iso => iso.to_vec(),
        // ASME B5.54 has no mean deviation.
        Standard::Asme => (iso.into_iter()).filter(|symbol| *symbol != "M").collect(),
    };
    let tolerances = tolerances(arguments.tolerance.as_deref(), &known)?;
    let among_others = arguments.files.len() > 1;
    let csv = arguments.csv.as_deref();
    let plot = arguments.plot_file()?;
    let drawn = RefCell::new(Vec::new());
    let answer = evaluated(&arguments.files, csv, |path| {
        one(path, arguments, &tolerances, among_others, plot.as_ref().map(|_| &drawn))
    })?;
    if let Some(plot) = plot {
        plot.write(&positioning_picture(&drawn.into_inner()))?;
    }
    Ok(answer)
}

/// The tests of `--plot`, in the order of the files.
type DrawnTests = RefCell<Vec<(Positioning, Vec<JudgedQuantity>)>>;

fn one(
    path: &Path,
    arguments: &Iso230Arguments,
    tolerances: &[Tolerance],
    among_others: bool,
    drawn: Option<&DrawnTests>,
) -> Result<Evaluated<PositioningTest>, Failure> {
    let mut measurement = read_file(path)?;
    if measurement.quantity == Some(Quantity::Straightness) {
        let what = "found straightness readings, expected positioning; `volcomp straightness` evaluates them";
        return Err(Failure::in_file(path, what));
    }
    let is_unit_stated = measurement.unit.is_some();
    let unit = arguments::apply(path, &mut measurement, arguments.unit)?;
    if arguments.error.is_none() {
        refuse_title(path, &measurement, unit)?;
    }
    if let Some(axis) = arguments.axis() {
        same_axis(path, &measurement, axis)?;
        measurement.check_targets(axis)?;
    }
    let result = evaluate(&measurement)?;
    let edition = arguments.edition();
    let kind = match arguments.axis() {
        Some(axis) => axis.kind(),
        None => axis_kind(&measurement).unwrap_or(AxisKind::Linear),
    };
    let uncertainty = uncertainty(path, arguments, &measurement, unit, kind)?;
    let mut notes = measurement.notes.clone();
    let sizes = measurement.readings.iter().map(|r| r.deviation.abs());
    let largest = sizes.fold(0.0, f64::max);
    // Small values without a stated unit already have a note on how to state the unit.
    if is_unit_stated || largest > LARGEST_PLAUSIBLE {
        notes.extend(implausible_size(largest, Some(unit)));
    }
    let is_angle = unit == DeviationUnit::Urad && kind == AxisKind::Linear;
    if is_angle {
        notes.push(IS_ANGLE.to_owned());
    }
    notes.extend(shortfalls(&measurement, kind, edition));
    notes.extend(result.outlier_hints.iter().map(|hint| hint.text.clone()));
    if let Some(uncertainty) = &uncertainty
        && !uncertainty.left_out.is_empty()
    {
        let left_out = uncertainty.left_out.join("; ");
        notes.push(format!("left out of the measurement uncertainty: {left_out}"));
    }
    let quantities =
        quantities(arguments.standard, edition, &result, unit, tolerances, uncertainty.as_ref());
    if quantities.iter().any(|q| q.symbol == "P" && q.value.is_none()) {
        let note =
            "VDI/DGQ 3441 is not evaluated: it needs both directions and at least two runs in each";
        notes.push(note.to_owned());
    }
    let judgement = Judgement::new(quantities, notes);
    // Angles do not depend on the thermal expansion.
    let is_laser = measurement.quantity == Some(Quantity::Positioning);
    let compensation = is_laser.then(|| material_compensation(&measurement.environment));
    let text =
        text(&result, unit, edition, arguments.standard, &judgement.quantities, !among_others)
            + &uncertainty.as_ref().map_or_else(String::new, uncertainty_text)
            + &compensation.as_ref().map_or_else(String::new, |said| {
                format!("\n{}", folded(&format!("material compensation {said}"), ""))
            })
            + &decision_text(&judgement);
    if let Some(drawn) = drawn {
        let test = drawn_test(path, arguments, &measurement, (kind, unit), &result);
        drawn.borrow_mut().push((test, judgement.quantities.clone()));
    }
    let document = PositioningTest {
        unit,
        symbols: Symbols(unit, edition.quantities(&result)),
        targets: result.targets,
        hints: result.outlier_hints,
        file: among_others.then(|| path.display().to_string()),
        edition: edition.year(),
        uncertainty,
        material_compensation: compensation,
        judgement: judgement.clone(),
    };
    Ok(Evaluated { document, text, metadata: measurement.metadata, judgement })
}

fn drawn_test(
    path: &Path,
    arguments: &Iso230Arguments,
    measurement: &Measurement,
    (kind, unit): (AxisKind, DeviationUnit),
    result: &Iso230Part2,
) -> Positioning {
    Positioning::of_measurement(
        path.display().to_string(),
        error_of(arguments, measurement),
        kind,
        unit.to_string(),
        measurement,
        result.clone(),
        arguments.edition(),
    )
}

/// The name of the measured error from the command line, the title or the axis of the file; empty if unknown.
fn error_of(arguments: &Iso230Arguments, measurement: &Measurement) -> String {
    let of_axis = || {
        let stated = measurement.metadata.axis.as_deref().and_then(axis_named);
        let axis = arguments.axis().or(stated)?;
        format!("E{axis}{axis}").parse().ok()
    };
    let error: Option<ErrorName> =
        arguments.error.or_else(|| error_in_title(measurement)).or_else(of_axis);
    error.map_or_else(String::new, |error| error.to_string())
}

/// Rejects a file whose title names an error other than positioning. Angles of a linear axis are evaluated with a note.
fn refuse_title(
    path: &Path,
    measurement: &Measurement,
    unit: DeviationUnit,
) -> Result<(), Failure> {
    let Some((error, message)) = not_positioning(measurement, unit) else { return Ok(()) };
    let how = match MotionKind::of(error) {
        // `volcomp straightness` rejects files that are marked as positioning, so do not recommend it.
        MotionKind::Straightness
            if !error.location && measurement.quantity != Some(Quantity::Positioning) =>
        {
            "`volcomp straightness` evaluates it; "
        }
        MotionKind::Other
            if error.component.is_angular() && error.axis.kind() == AxisKind::Linear =>
        {
            "of angles state their unit (--unit); "
        }
        _ => "",
    };
    let what = format_args!(
        "{message}; {how}where the title is wrong, state --error, such as --error EXX"
    );
    Err(Failure::in_file(path, what))
}

fn same_axis(path: &Path, measurement: &Measurement, axis: AxisName) -> Result<(), Failure> {
    let stated = measurement.metadata.axis.as_deref().and_then(axis_named);
    match stated {
        Some(found) if found != axis => {
            let what = format!("found axis {found}, expected axis {axis} (--axis)");
            Err(Failure::in_file(path, what))
        }
        _ => Ok(()),
    }
}

fn uncertainty(
    path: &Path,
    arguments: &Iso230Arguments,
    measurement: &Measurement,
    unit: DeviationUnit,
    kind: AxisKind,
) -> Result<Option<PositioningUncertainty>, Failure> {
    if !arguments.uncertainty.stated() {
        return Ok(None);
    }
    if unit == DeviationUnit::Urad || kind == AxisKind::Rotary {
        let what = "found angles or a rotary axis with options of the measurement uncertainty, expected lengths of a linear axis: its formulas are for these";
        return Err(Failure::in_file(path, what));
    }
    let targets = measurement.targets();
    let travel_mm = targets.last().zip(targets.first()).map_or(0.0, |(b, a)| b - a);
    let runs = Direction::BOTH.map(|direction| measurement.runs(direction).len());
    let fewest = runs.into_iter().filter(|n| *n > 0).min().unwrap_or(1);
    let inputs = arguments.uncertainty.inputs(&measurement.environment);
    Ok(Some(positioning_uncertainty(&inputs, 1e-3 * travel_mm, fewest)?))
}

fn quantities(
    standard: Standard,
    edition: Edition,
    result: &Iso230Part2,
    unit: DeviationUnit,
    tolerances: &[Tolerance],
    uncertainty: Option<&PositioningUncertainty>,
) -> Vec<JudgedQuantity> {
    let u = |symbol: &str| uncertainty.and_then(|u| u.of(symbol));
    let none = |_: &str| None;
    let mut all = Vec::new();
    if matches!(standard, Standard::Iso | Standard::All) {
        let name = format!("ISO 230-2:{}", edition.year());
        let quantities = edition.quantities(result);
        all.extend(judged(&name, quantities, unit, tolerances, u));
    }
    if matches!(standard, Standard::Vdi | Standard::All) {
        let quantities = Vdi3441::quantities(vdi_3441(result).as_ref());
        all.extend(judged("VDI/DGQ 3441", quantities, unit, tolerances, none));
    }
    if matches!(standard, Standard::Asme | Standard::All) {
        let quantities = asme_b5_54(result);
        all.extend(judged("ASME B5.54", quantities, unit, tolerances, u));
    }
    all
}

fn number(value: Option<f64>) -> String {
    or_dash(value, 2)
}

fn text(
    result: &Iso230Part2,
    unit: DeviationUnit,
    edition: Edition,
    standard: Standard,
    quantities: &[JudgedQuantity],
    with_names: bool,
) -> String {
    let mut parts = Vec::new();
    let head = match standard {
        Standard::Iso | Standard::All => format!("ISO 230-2:{}", edition.year()),
        Standard::Vdi => "VDI/DGQ 3441".to_owned(),
        Standard::Asme => "ASME B5.54".to_owned(),
    };
    parts.push(format!("{head}, all values in {unit}\n"));
    parts.push(targets_text(result));
    if matches!(standard, Standard::Iso | Standard::All) {
        parts.push(summary(result, edition));
    }
    let judged = quantities.iter().any(|q| q.limit.is_some() || q.uncertainty.is_some());
    for standard in ["ISO", "VDI", "ASME"] {
        let of: Vec<JudgedQuantity> = (quantities.iter())
            .filter(|q| q.standard.starts_with(standard) && (standard != "ISO" || judged))
            .cloned()
            .collect();
        if let Some(first) = of.first() {
            parts.push(format!("{}\n{}", first.standard, quantities_text(&of, with_names)));
        }
    }
    parts.join("\n")
}

fn targets_text(result: &Iso230Part2) -> String {
    let mut targets = table(&["target", "mean ↑", "mean ↓", "s ↑", "s ↓", "B", "R"]);
    for row in &result.targets {
        let mean = |a: &Option<Approach>| number(a.as_ref().map(|a| a.mean));
        let s = |a: &Option<Approach>| number(a.as_ref().and_then(|a| a.s));
        targets.add_row([
            coordinate(row.target),
            mean(&row.forward),
            mean(&row.backward),
            s(&row.forward),
            s(&row.backward),
            number(row.reversal),
            number(row.repeatability),
        ]);
    }
    table_text(&targets)
}

fn summary(result: &Iso230Part2, edition: Edition) -> String {
    let [systematic, mean, reversal, mean_reversal] = if edition == Edition::Iso2014 {
        ["E systematic error", "M mean error", "B reversal error", "mean reversal error"]
    } else {
        ["E systematic deviation", "M mean deviation", "B reversal value", "mean reversal value"]
    };
    let mut summary = table(&["", "both", "forward ↑", "backward ↓"]);
    let r = result;
    for (name, values) in [
        ("A accuracy", [r.a, r.a_forward, r.a_backward]),
        ("R repeatability", [r.r, r.r_forward, r.r_backward]),
        (systematic, [r.e, r.e_forward, r.e_backward]),
    ] {
        let [both, forward, backward] = values.map(number);
        summary.add_row([name, &both, &forward, &backward]);
    }
    for (name, value) in [(mean, r.m), (reversal, r.b), (mean_reversal, r.mean_b)] {
        summary.add_row([name, &number(value), "", ""]);
    }
    table_text(&summary)
}

fn uncertainty_text(uncertainty: &PositioningUncertainty) -> String {
    let mut rows = table(&["contribution", "U (k=2) µm", "from"]);
    crate::table::to_the_left(&mut rows, &[2]);
    for c in &uncertainty.contributions {
        let size = c.u_um.map_or_else(|| "left out".to_owned(), |u| fixed(u, 2));
        rows.add_row([c.symbol, &size, c.name]);
    }
    format!(
        "\nMeasurement uncertainty over {} m, {} runs in a direction\n{}",
        fixed(uncertainty.length_m, 4),
        uncertainty.runs,
        table_text(&rows)
    )
}
