//! Positions, approach directions and temperatures from the command line and from CSV files.

use std::path::{Path, PathBuf};

use clap::Args;
use volcomp_document::{Column, CsvTable};
use volcomp_kinematics::State;
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::{AxisName, Direction};

use crate::{answers::OneOrMany, failure::Failure};

/// The machine and what is in its spindle.
#[derive(Args)]
pub(crate) struct MachineArguments {
    /// The machine file (TOML) with axes, tool and errors
    #[arg(long, short, value_name = "FILE")]
    pub(crate) machine: PathBuf,
    #[command(flatten)]
    pub(crate) spindle: SpindleArguments,
}

/// The tool in the spindle and the temperatures of the sensors, on which the errors of a machine depend too.
#[derive(Args)]
pub(crate) struct SpindleArguments {
    /// Tool from the machine file's table `tools`; without it the tool of `[tool]`
    #[arg(long)]
    pub(crate) tool: Option<String>,
    /// Temperatures of the machine's sensors, °C: NAME=DEGC,…
    #[arg(long, value_delimiter = ',')]
    pub(crate) temperature: Vec<String>,
}

/// The positions to evaluate: one from the command line, or the rows of a CSV file.
#[derive(Args)]
#[group(required = true, multiple = true)]
pub(crate) struct PointArguments {
    /// One position: X=100,Y=200,Z=-50 (mm, deg); axes not named stand at 0
    #[arg(long, conflicts_with = "points", allow_hyphen_values = true)]
    pub(crate) at: Option<String>,
    /// Many positions: a CSV file whose header has axis letters; other columns are passed through, and `;` and decimal
    /// commas are read
    #[arg(long, value_name = "FILE")]
    pub(crate) points: Option<PathBuf>,
}

/// The direction each axis came from.
#[derive(Args)]
pub(crate) struct ApproachArguments {
    /// Direction of the last motion, for bidirectional curves: X=+,Y=-
    #[arg(long, allow_hyphen_values = true)]
    pub(crate) approach: Option<String>,
}

/// One position asked for, or many.
pub(crate) enum States {
    One(State),
    Many(PointFile),
}

/// Positions from a CSV file, which may have other columns too.
pub(crate) struct PointFile {
    pub(crate) table: CsvTable,
    /// One state for each row of the table.
    states: Vec<State>,
}

impl States {
    /// Every position, in the order of the rows.
    pub(crate) fn states(&self) -> &[State] {
        match self {
            Self::One(state) => std::slice::from_ref(state),
            Self::Many(file) => &file.states,
        }
    }

    /// The document: the one answer, or a list under `points`.
    pub(crate) fn document<T>(&self, mut answers: Vec<T>) -> OneOrMany<T> {
        match (self, answers.len()) {
            (Self::One(_), 1) => OneOrMany::One(answers.swap_remove(0)),
            _ => OneOrMany::Many { points: answers },
        }
    }
}

impl MachineArguments {
    /// The machine with the tool in its spindle, and the temperatures of its sensors.
    pub(crate) fn read(&self) -> Result<(Machine, Temperatures), Failure> {
        self.spindle.read(&self.machine)
    }
}

impl SpindleArguments {
    /// Reads a machine file and puts the tool into its spindle.
    pub(crate) fn read(&self, path: &Path) -> Result<(Machine, Temperatures), Failure> {
        let mut machine = Machine::read(path)?;
        if let Some(tool) = &self.tool {
            machine.select_tool(tool)?;
        }
        let temperatures = self.temperatures(&machine)?;
        Ok((machine, temperatures))
    }

    fn temperatures(&self, machine: &Machine) -> Result<Temperatures, Failure> {
        let sensors = machine.thermal().sensors();
        let mut temperatures = Temperatures::new();
        for item in &self.temperature {
            let (name, value) = assignment("--temperature", item, "NAME=DEGC")?;
            let degc = number("--temperature", item, value)?;
            if !sensors.contains(&name) {
                let expected = if sensors.is_empty() {
                    "none: the machine file has no thermal terms".to_owned()
                } else {
                    format!("one of: {}", sensors.join(", "))
                };
                let message = format!("--temperature: found sensor `{name}`, expected {expected}");
                return Err(Failure::Input(message));
            }
            if temperatures.insert(name.to_owned(), degc).is_some() {
                return Err(Failure::Input(format!(
                    "--temperature: sensor `{name}` stands twice"
                )));
            }
        }
        Ok(temperatures)
    }
}

impl PointArguments {
    pub(crate) fn states(
        &self,
        machine: &Machine,
        approach: &ApproachArguments,
    ) -> Result<States, Failure> {
        let approach = approach.directions(machine)?;
        let with_approach = |mut state: State| {
            for &(index, direction) in &approach {
                state.approach[index] = direction;
            }
            state
        };
        match (&self.at, &self.points) {
            (_, Some(path)) => {
                let mut file = read_points(machine, path)?;
                file.states = file.states.into_iter().map(with_approach).collect();
                Ok(States::Many(file))
            }
            (at, None) => {
                let coordinates = parse_at(at.as_deref().unwrap_or_default())?;
                Ok(States::One(with_approach(machine.state(&coordinates)?)))
            }
        }
    }
}

impl ApproachArguments {
    fn directions(&self, machine: &Machine) -> Result<Vec<(usize, Option<Direction>)>, Failure> {
        let mut directions = Vec::new();
        for item in items(self.approach.as_deref().unwrap_or_default()) {
            let (name, sign) = assignment("--approach", item, "X=+ or X=-")?;
            let direction = match sign {
                "+" => Some(Direction::Positive),
                "-" => Some(Direction::Negative),
                _ => {
                    let message =
                        format!("--approach: found `{item}`, expected {name}=+ or {name}=-");
                    return Err(Failure::Input(message));
                }
            };
            let index = machine.index_of(axis("--approach", name)?)?;
            if directions.iter().any(|&(other, _)| other == index) {
                return Err(Failure::Input(format!(
                    "--approach: axis {name} stands twice"
                )));
            }
            directions.push((index, direction));
        }
        Ok(directions)
    }
}

fn parse_at(text: &str) -> Result<Vec<(AxisName, f64)>, Failure> {
    let mut coordinates: Vec<(AxisName, f64)> = Vec::new();
    for item in items(text) {
        let (name, value) = assignment("--at", item, "X=100")?;
        let name = axis("--at", name)?;
        if coordinates.iter().any(|&(other, _)| other == name) {
            return Err(Failure::Input(format!("--at: axis {name} stands twice")));
        }
        coordinates.push((name, number("--at", item, value)?));
    }
    Ok(coordinates)
}

/// Reads a CSV file whose header has axis letters, one position a row.
fn read_points(machine: &Machine, path: &Path) -> Result<PointFile, Failure> {
    let text = std::fs::read_to_string(path)
        .map_err(|e| Failure::in_file(path, format_args!("cannot be read: {e}")))?;
    let table = CsvTable::parse(&path.display().to_string(), &text)?;
    let mut axes: Vec<(AxisName, Column)> = Vec::new();
    for name in AxisName::ALL {
        if let Some(column) = table.column(&name.to_string())? {
            machine
                .index_of(name)
                .map_err(|e| table.header_error(e.to_string()))?;
            axes.push((name, column));
        }
    }
    if axes.is_empty() {
        let expected = "found no axis letter, expected at least one of X Y Z A B C U V W";
        return Err(table.header_error(expected).into());
    }
    let mut states = Vec::new();
    for row in table.rows() {
        let mut coordinates = Vec::new();
        for &(name, column) in &axes {
            coordinates.push((name, row.cell(column).number()?));
        }
        states.push(machine.state(&coordinates)?);
    }
    Ok(PointFile { table, states })
}

fn items(text: &str) -> impl Iterator<Item = &str> {
    text.split(',')
        .map(str::trim)
        .filter(|item| !item.is_empty())
}

fn assignment<'a>(
    option: &str,
    item: &'a str,
    expected: &str,
) -> Result<(&'a str, &'a str), Failure> {
    let pair = item
        .split_once('=')
        .map(|(name, value)| (name.trim(), value.trim()));
    pair.filter(|(name, _)| !name.is_empty())
        .ok_or_else(|| Failure::Input(format!("{option}: found `{item}`, expected {expected}")))
}

fn axis(place: &str, name: &str) -> Result<AxisName, Failure> {
    let mut letters = name.chars();
    letters
        .next()
        .and_then(AxisName::from_letter)
        .filter(|_| letters.next().is_none())
        .ok_or_else(|| {
            Failure::Input(format!(
                "{place}: found axis `{name}`, expected one of X Y Z A B C U V W"
            ))
        })
}

fn number(place: &str, item: &str, text: &str) -> Result<f64, Failure> {
    text.parse::<f64>()
        .ok()
        .filter(|number| number.is_finite())
        .ok_or_else(|| Failure::Input(format!("{place}: found `{item}`, expected a finite number")))
}
