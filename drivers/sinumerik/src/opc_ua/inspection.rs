//! Reads the properties of a control when a session is opened, and checks that the control accepts corrections.

use opcua::types::{DataValue, Variant};
use volcomp_vocabulary::{AxisName, MAX_AXES};

use super::link::{Link, number_of, runtime};
use crate::{
    config::{Server, SinumerikConfig},
    error::SinumerikError,
    nodes::Nodes,
    reading,
};

/// Properties of one axis as reported by the control.
#[derive(Clone, Debug, PartialEq)]
pub struct InspectedAxis {
    pub axis: AxisName,
    /// Number of the axis in the control, from 1.
    pub number: u16,
    /// Name of the axis in the control; `None` if the control does not report it, or if the configuration has no node
    /// for it.
    pub name: Option<String>,
    /// Maximum rate of a correction of the axis, MD32760 times MD32000, mm/min or rev/min. `None` if the axis is
    /// read-only, if the control does not report the values, or if the configuration has no nodes for them.
    pub fastest_per_min: Option<f64>,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Inspection {
    /// The axes in the order of the configuration: corrected axes, then read-only axes.
    pub axes: Vec<InspectedAxis>,
    pub notes: Vec<String>,
}

/// Reads the properties of a control in a separate session, and checks that it accepts corrections. Writes nothing to
/// the control.
///
/// # Errors
/// A control that cannot be reached or does not match the configuration; [`SinumerikError::SwitchedOff`].
pub fn inspect(config: &SinumerikConfig) -> Result<Inspection, SinumerikError> {
    config.describe()?;
    block_on(async {
        let link = Link::open(&config.server).await?;
        let found = opened(&link, config).await;
        link.close().await;
        found
    })
}

/// Lists names and positions (mm or deg) of the axes of an unknown control. The axes are read by number from 1 until
/// one does not exist. An axis without a name gets its number as the name. Writes nothing to the control.
///
/// # Errors
/// A control that cannot be reached, or that has no axis at these nodes.
pub fn list_axes(server: &Server, nodes: &Nodes) -> Result<Vec<(String, f64)>, SinumerikError> {
    server.check()?;
    block_on(async {
        let link = Link::open(server).await?;
        let found = axis_positions(&link, nodes).await;
        link.close().await;
        found
    })
}

async fn axis_positions(link: &Link, nodes: &Nodes) -> Result<Vec<(String, f64)>, SinumerikError> {
    let mut found = Vec::new();
    let count = u16::try_from(MAX_AXES).unwrap_or(u16::MAX);
    for number in 1..=count {
        let at = match required(link, &Nodes::of_axis(&nodes.position, number)).await {
            Ok(at) => at,
            Err(SinumerikError::Node { .. }) if number > 1 => break,
            Err(error) => return Err(error),
        };
        let name = name(link, &Nodes::of_axis(&nodes.name, number), &mut Vec::new()).await?;
        found.push((name.unwrap_or_else(|| number.to_string()), at));
    }
    Ok(found)
}

fn block_on<T>(work: impl Future<Output = Result<T, SinumerikError>>) -> Result<T, SinumerikError> {
    runtime()?.block_on(work)
}

pub(super) async fn opened(
    link: &Link,
    config: &SinumerikConfig,
) -> Result<Inspection, SinumerikError> {
    let mut found = Inspection::default();
    let is_written = |place: usize| place < config.axes.len();
    for (place, (axis, number)) in config.numbered().enumerate() {
        let mut inspected = InspectedAxis { axis, number, name: None, fastest_per_min: None };
        let node = |pattern: &str| Nodes::of_axis(pattern, number);
        if is_written(place) {
            let kind = node(&config.nodes.kind);
            let md32750 = required(link, &kind).await?;
            reading::is_switched_on(axis, md32750)?;
            required(link, &node(&config.nodes.setting)).await?;
            inspected.fastest_per_min = fastest(link, config, number, &mut found.notes).await?;
        }
        required(link, &node(&config.nodes.position)).await?;
        if !config.nodes.name.is_empty() {
            inspected.name = name(link, &node(&config.nodes.name), &mut found.notes).await?;
        }
        if let Some(name) = inspected.name.as_ref().filter(|name| !name.starts_with(axis.letter()))
        {
            return Err(SinumerikError::OtherAxis { axis, number, found: name.clone() });
        }
        found.axes.push(inspected);
    }
    let states = [&config.nodes.emergency_stop, &config.nodes.alarm];
    for node in states.into_iter().flatten() {
        required(link, node).await?;
    }
    Ok(found)
}

async fn fastest(
    link: &Link,
    config: &SinumerikConfig,
    number: u16,
    notes: &mut Vec<String>,
) -> Result<Option<f64>, SinumerikError> {
    let mut product = 1.0;
    for pattern in [&config.nodes.share, &config.nodes.speed] {
        if pattern.is_empty() {
            return Ok(None);
        }
        let node = Nodes::of_axis(pattern, number);
        let Some(factor) = number_of(&one(link, &node).await?) else {
            notes.push(format!(
                "node {node}: cannot be read, so the rate at which the control applies a correction is unknown"
            ));
            return Ok(None);
        };
        product *= factor;
    }
    Ok(Some(product))
}

async fn name(
    link: &Link,
    node: &str,
    notes: &mut Vec<String>,
) -> Result<Option<String>, SinumerikError> {
    match one(link, node).await?.value {
        Some(Variant::String(name)) if !name.is_null() => Ok(Some(name.as_ref().to_owned())),
        _ => {
            notes.push(format!(
                "node {node}: cannot be read, so the name of the axis is not compared"
            ));
            Ok(None)
        }
    }
}

async fn required(link: &Link, node: &str) -> Result<f64, SinumerikError> {
    let value = one(link, node).await?;
    number_of(&value).ok_or_else(|| SinumerikError::Node {
        node: node.to_owned(),
        found: match value.status {
            Some(status) if !status.is_good() => status.to_string(),
            _ => "not a number".to_owned(),
        },
    })
}

async fn one(link: &Link, node: &str) -> Result<DataValue, SinumerikError> {
    let answer = link.read(std::slice::from_ref(&node.to_owned())).await?;
    // The link has checked that the answer has one value per node.
    Ok(answer.values.into_iter().next().unwrap_or_else(DataValue::null))
}
