//! Reads and writes the error curves of a machine file.

use core::fmt::Write;

use volcomp_curve::{
    BSpline, Chebyshev, Curve, CurveError, ErrorCurve, Field, Fourier, Grid, Interpolation,
    MovingLeastSquares, Polynomial, Table,
};
use volcomp_document::{InputError, Section, Value, nearest};
use volcomp_vocabulary::AxisName;

use crate::axis::Axis;

const KINDS: [&str; 7] = ["poly", "chebyshev", "table", "mls", "bspline", "fourier", "grid"];

const SHOWN_POINTS: usize = 4;

/// Context for decoding a curve: the travel of its axis, and all axes of the machine, on which a grid may depend.
pub(crate) struct CurveContext<'a> {
    pub(crate) axes: &'a [Axis],
    pub(crate) travel: [f64; 2],
}

/// Decodes an error curve: a number, a kind of curve, a `forward`/`backward` pair, or a `mean` with a `reversal`.
pub(crate) fn decode_error_curve(
    value: &Value<'_>,
    context: &CurveContext<'_>,
) -> Result<ErrorCurve, InputError> {
    if value.is_number() {
        return Ok(ErrorCurve::Single(decode_field(value, context)?));
    }
    refuse_array(value)?;
    let section = value.section()?;
    let has = |key| section.get(key).is_some();
    if has("forward") || has("backward") {
        section.allow(&["forward", "backward"])?;
        return Ok(ErrorCurve::Pair {
            forward: decode_field(&section.require("forward")?, context)?,
            backward: decode_field(&section.require("backward")?, context)?,
        });
    }
    if has("mean") || has("reversal") {
        section.allow(&["mean", "reversal"])?;
        let mean = decode_field(&section.require("mean")?, context)?;
        let reversal = section.require("reversal")?;
        return ErrorCurve::with_reversal(mean, reversal.number()?)
            .map_err(|e| reversal.error(e.to_string()));
    }
    Ok(ErrorCurve::Single(decode_field(value, context)?))
}

/// Rejects an array without a named kind of curve, because it could mean the points of a table or the coefficients of a
/// polynomial.
fn refuse_array(value: &Value<'_>) -> Result<(), InputError> {
    let Ok(items) = value.items() else {
        return Ok(());
    };
    let pairs: Option<Vec<String>> = items
        .iter()
        .map(|item| item.vector::<2>().ok().map(|[at, error]| format!("[{at}, {error}]")))
        .collect();
    let expected = match pairs.filter(|pairs| !pairs.is_empty() && pairs.len() <= SHOWN_POINTS) {
        Some(pairs) => format!("a kind of curve: {{ table = [{}] }}", pairs.join(", ")),
        None => {
            "a number or a kind of curve: { table = [[0, 0], [500, 25]] } or { poly = [0, 0.05] }"
                .to_owned()
        }
    };
    Err(value.error(format!("found an array of {}, expected {expected}", items.len())))
}

fn decode_field(value: &Value<'_>, context: &CurveContext<'_>) -> Result<Field, InputError> {
    if value.is_number() {
        return Ok(Curve::Constant(value.number()?).into());
    }
    refuse_array(value)?;
    let section = value.section()?;
    let kinds: Vec<&str> = KINDS.into_iter().filter(|kind| section.get(kind).is_some()).collect();
    let [kind] = kinds[..] else {
        let keys: Vec<&str> = section.values().map(|(key, _)| key).collect();
        let found = match (kinds.len(), keys.is_empty()) {
            (0, true) => "no curve".to_owned(),
            (0, false) => format!("no curve in `{}`", keys.join("`, `")),
            _ => format!("{} together", kinds.join(" and ")),
        };
        let meant = keys.iter().find_map(|key| nearest(key, &KINDS));
        let meant = meant
            .filter(|_| kinds.is_empty())
            .map_or_else(String::new, |meant| format!("; did you mean `{meant}`?"));
        let expected = KINDS.join(", ");
        return Err(section.error(format!("found {found}, expected one of: {expected}{meant}")));
    };
    let inner = section.require(kind)?;
    if kind == "grid" {
        section.allow(&["grid"])?;
        return Ok(decode_grid(&inner, context)?.into());
    }
    Ok(decode_curve(kind, &section, &inner, context)?.into())
}

fn decode_curve(
    kind: &str,
    section: &Section<'_>,
    inner: &Value<'_>,
    context: &CurveContext<'_>,
) -> Result<Curve, InputError> {
    let refuse = |e: CurveError| inner.error(e.to_string());
    let domain = || match section.get("domain") {
        Some(domain) => domain.vector::<2>(),
        None => Ok(context.travel),
    };
    Ok(match kind {
        "poly" => {
            section.allow(&["poly", "domain"])?;
            Curve::Polynomial(Polynomial::new(inner.numbers()?, domain()?).map_err(refuse)?)
        }
        "chebyshev" => {
            section.allow(&["chebyshev", "domain"])?;
            let domain = section.require("domain")?.vector()?;
            Curve::Chebyshev(Chebyshev::new(inner.numbers()?, domain).map_err(refuse)?)
        }
        "fourier" => {
            section.allow(&["fourier", "period", "domain"])?;
            let period = section.require("period")?.number()?;
            Curve::Fourier(Fourier::new(inner.numbers()?, period, domain()?).map_err(refuse)?)
        }
        "table" => {
            section.allow(&["table", "interpolation"])?;
            let nodes = decode_nodes(inner)?;
            let interpolation = section.get("interpolation");
            let name = interpolation.as_ref().map_or(Ok("linear"), Value::text)?;
            match (name, interpolation) {
                ("linear", _) => Curve::Table(Table::linear(nodes).map_err(refuse)?),
                ("cubic", _) => Curve::Table(Table::cubic(nodes).map_err(refuse)?),
                (_, Some(value)) => {
                    return Err(
                        value.error(format!("found \"{name}\", expected \"linear\" or \"cubic\""))
                    );
                }
                (_, None) => return Err(section.error("expected an interpolation")),
            }
        }
        "bspline" => {
            section.allow(&["bspline"])?;
            let table = inner.section()?;
            table.allow(&["knots", "coefficients", "degree"])?;
            let knots = table.require("knots")?.numbers()?;
            let coefficients = table.require("coefficients")?.numbers()?;
            let degree = table.get("degree").map_or(Ok(3), |d| d.count(5))?;
            Curve::BSpline(BSpline::new(knots, coefficients, degree).map_err(refuse)?)
        }
        _ => {
            section.allow(&["mls"])?;
            let table = inner.section()?;
            table.allow(&["nodes", "order", "support", "shape"])?;
            let nodes = decode_nodes(&table.require("nodes")?)?;
            let number = |key: &str, default: f64| match table.get(key) {
                Some(value) => value.number(),
                None => Ok(default),
            };
            let order = table.get("order").map_or(Ok(4), |order| order.count(8))?;
            let (support, shape) = (number("support", 1.0 / 3.0)?, number("shape", 3.0)?);
            Curve::MovingLeastSquares(
                MovingLeastSquares::new(nodes, order, support, shape).map_err(refuse)?,
            )
        }
    })
}

fn decode_nodes(value: &Value<'_>) -> Result<Vec<[f64; 2]>, InputError> {
    value.items()?.iter().map(Value::vector::<2>).collect()
}

fn decode_grid(value: &Value<'_>, context: &CurveContext<'_>) -> Result<Grid, InputError> {
    let table = value.section()?;
    table.allow(&["axes", "nodes", "values"])?;
    let axes_value = table.require("axes")?;
    let mut axes = Vec::new();
    for item in axes_value.items()? {
        let name = item.text()?;
        let index = context.axes.iter().position(|axis| axis.name.to_string() == name);
        axes.push(index.ok_or_else(|| {
            item.error(format!("found axis \"{name}\", expected an axis of the structure"))
        })?);
    }
    let axes = <[usize; 2]>::try_from(axes)
        .map_err(|found| axes_value.error(format!("found {} axes, expected 2", found.len())))?;
    let nodes_value = table.require("nodes")?;
    let lists: Result<Vec<_>, _> = nodes_value.items()?.iter().map(Value::numbers).collect();
    let nodes = <[Vec<f64>; 2]>::try_from(lists?).map_err(|found| {
        nodes_value.error(format!("found {} lists of nodes, expected 2", found.len()))
    })?;
    let rows: Result<Vec<_>, _> =
        table.require("values")?.items()?.iter().map(Value::numbers).collect();
    Grid::new(axes, nodes, rows?).map_err(|e| value.error(e.to_string()))
}

pub(crate) fn write_error_curve(curve: &ErrorCurve, axes: &[Axis]) -> String {
    match curve {
        ErrorCurve::Single(field) => write_field(field, axes),
        ErrorCurve::Pair { forward, backward } => format!(
            "{{ forward = {}, backward = {} }}",
            write_field(forward, axes),
            write_field(backward, axes)
        ),
        ErrorCurve::Reversal { mean, reversal } => {
            format!("{{ mean = {}, reversal = {reversal:?} }}", write_field(mean, axes))
        }
    }
}

fn write_field(field: &Field, axes: &[Axis]) -> String {
    match field {
        Field::Curve(curve) => write_curve(curve),
        Field::Grid(grid) => {
            let name = |index: usize| axes.get(index).map_or(AxisName::X, |axis| axis.name);
            let [first, second] = grid.axes();
            let [nodes_first, nodes_second] = grid.nodes();
            format!(
                "{{ grid = {{ axes = [\"{}\", \"{}\"], nodes = [{nodes_first:?}, {nodes_second:?}], values = {:?} }} }}",
                name(first),
                name(second),
                grid.values()
            )
        }
    }
}

/// Writes a curve as the inline value of a machine file.
pub fn write_curve(curve: &Curve) -> String {
    match curve {
        Curve::Constant(value) => format!("{value:?}"),
        Curve::Polynomial(p) => {
            format!("{{ poly = {:?}, domain = {:?} }}", p.coefficients(), p.domain())
        }
        Curve::Chebyshev(c) => {
            format!("{{ chebyshev = {:?}, domain = {:?} }}", c.coefficients(), c.domain())
        }
        Curve::Fourier(f) => format!(
            "{{ fourier = {:?}, period = {:?}, domain = {:?} }}",
            f.coefficients(),
            f.period(),
            f.domain()
        ),
        Curve::Table(table) => {
            let interpolation = match table.interpolation() {
                Interpolation::Linear => "linear",
                Interpolation::Cubic => "cubic",
            };
            let nodes = write_nodes(table.nodes());
            format!("{{ table = {nodes}, interpolation = \"{interpolation}\" }}")
        }
        Curve::BSpline(s) => format!(
            "{{ bspline = {{ knots = {:?}, coefficients = {:?}, degree = {} }} }}",
            s.knots(),
            s.coefficients(),
            s.degree()
        ),
        Curve::MovingLeastSquares(m) => format!(
            "{{ mls = {{ nodes = {}, order = {}, support = {:?}, shape = {:?} }} }}",
            write_nodes(m.nodes()),
            m.order(),
            m.support(),
            m.shape()
        ),
    }
}

fn write_nodes(nodes: &[[f64; 2]]) -> String {
    let mut text = String::from("[");
    for (index, [x, value]) in nodes.iter().enumerate() {
        let comma = if index == 0 { "" } else { ", " };
        let _ = write!(text, "{comma}[{x:?}, {value:?}]"); // writing to a String cannot fail
    }
    text.push(']');
    text
}
