//! What a control tells about itself when a session is opened, and whether it can be corrected at all.

use opcua::types::{DataValue, Variant};
use volcomp_vocabulary::{AxisName, MAX_AXES};

use super::link::{Link, number_of};
use crate::{
    config::SinumerikConfig, error::SinumerikError, nodes::Nodes, reading, server::Server,
};

/// One axis as the control tells about it.
#[derive(Clone, Debug, PartialEq)]
pub struct InspectedAxis {
    /// The axis of the configuration.
    pub axis: AxisName,
    /// Its number in the control.
    pub number: u16,
    /// The name by which the control calls it; `None` where it does not tell, or is not asked.
    pub name: Option<String>,
    /// How fast the axis takes a changed correction at the most, MD32760 times MD32000, in mm/min or rev/min; `None` where
    /// the control does not tell.
    pub fastest_per_min: Option<f64>,
}

/// What a control tells about itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Inspection {
    /// The axes in the order of the configuration: those that are written, then those that are only read.
    pub axes: Vec<InspectedAxis>,
    /// What it does not tell, in words.
    pub notes: Vec<String>,
}

/// Asks a control what it tells about itself, and whether it takes corrections: a session of its own, and nothing is
/// written.
///
/// # Errors
/// A control that cannot be reached, or does not fit the configuration; [`SinumerikError::SwitchedOff`].
pub fn inspect(config: &SinumerikConfig) -> Result<Inspection, SinumerikError> {
    config.describe()?;
    block_on(async {
        let link = Link::open(&config.server).await?;
        let found = opened(&link, config).await;
        link.close().await;
        found
    })
}

/// The axes of a control about which nothing is known: their names, and where they stand, mm and deg. Axes are asked for by
/// their numbers from 1 on, until one is missing; one without a name is called by its number. Nothing is written.
///
/// # Errors
/// A control that cannot be reached, or has no axis at these nodes.
pub fn look(server: &Server, nodes: &Nodes) -> Result<Vec<(String, f64)>, SinumerikError> {
    server.check()?;
    block_on(async {
        let link = Link::open(server).await?;
        let found = standing(&link, nodes).await;
        link.close().await;
        found
    })
}

/// The axes on an open session, and where they stand.
async fn standing(link: &Link, nodes: &Nodes) -> Result<Vec<(String, f64)>, SinumerikError> {
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
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|error| SinumerikError::Client(error.to_string()))?;
    runtime.block_on(work)
}

/// What the control tells on an open session.
pub(super) async fn opened(
    link: &Link,
    config: &SinumerikConfig,
) -> Result<Inspection, SinumerikError> {
    let mut found = Inspection::default();
    let is_written = |place: usize| place < config.axes.len();
    for (place, (axis, number)) in config.numbered().enumerate() {
        let mut told = InspectedAxis {
            axis,
            number,
            name: None,
            fastest_per_min: None,
        };
        let node = |pattern: &str| Nodes::of_axis(pattern, number);
        if is_written(place) {
            let kind = node(&config.nodes.kind);
            let md32750 = required(link, &kind).await?;
            reading::is_switched_on(axis, md32750)?;
            required(link, &node(&config.nodes.setting)).await?;
            told.fastest_per_min = fastest(link, config, number, &mut found.notes).await?;
        }
        required(link, &node(&config.nodes.position)).await?;
        if !config.nodes.name.is_empty() {
            told.name = name(link, &node(&config.nodes.name), &mut found.notes).await?;
        }
        if let Some(name) = told
            .name
            .as_ref()
            .filter(|name| !name.starts_with(axis.letter()))
        {
            return Err(SinumerikError::OtherAxis {
                axis,
                number,
                found: name.clone(),
            });
        }
        found.axes.push(told);
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
                "node {node}: cannot be read, so how fast the control takes a correction is not known"
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
            _ => "no number".to_owned(),
        },
    })
}

async fn one(link: &Link, node: &str) -> Result<DataValue, SinumerikError> {
    let answer = link.read(std::slice::from_ref(&node.to_owned())).await?;
    // The link has compared the numbers of values and nodes.
    Ok(answer
        .values
        .into_iter()
        .next()
        .unwrap_or_else(DataValue::null))
}
