//! Options of readers and writers: origin of the tables, and axis numbers of the control.

use core::fmt::Write;

use volcomp_model::Machine;
use volcomp_vocabulary::{AxisName, Displacement};

use super::table::{AxisTable, Content, from_file_unit};
use super::text::{Format, TextFile, short};

/// Axis numbers in the control, from 1.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AxisNumbers(Vec<(AxisName, u16)>);

impl AxisNumbers {
    /// Creates a list of axis numbers; `None` if an axis or a number occurs twice.
    pub fn stated(numbers: Vec<(AxisName, u16)>) -> Option<Self> {
        let twice = numbers.iter().enumerate().any(|(place, (name, number))| {
            let before = &numbers[..place];
            before.iter().any(|(a, b)| a == name || b == number)
        });
        (!twice).then_some(Self(numbers))
    }

    /// Default numbers of a machine's axes: 1, 2, 3 … in the order X Y Z A B C U V W.
    pub fn of_machine(machine: &Machine) -> Self {
        Self::counted(machine.axes().iter().map(|axis| axis.name))
    }

    /// Numbers 1, 2, 3 … for axes in the order X Y Z A B C U V W.
    pub fn counted(axes: impl IntoIterator<Item = AxisName>) -> Self {
        let mut names: Vec<AxisName> = axes.into_iter().collect();
        names.sort_unstable_by_key(|name| name.index());
        names.dedup();
        Self(names.into_iter().zip(1..).collect())
    }

    /// Number of an axis; `None` if it has none.
    pub fn number(&self, axis: AxisName) -> Option<u16> {
        let found = self.0.iter().find(|(name, _)| *name == axis);
        found.map(|(_, number)| *number)
    }

    /// Axis with this number in the control; `None` if there is none.
    pub fn axis(&self, number: u16) -> Option<AxisName> {
        let found = self.0.iter().find(|(_, known)| *known == number);
        found.map(|(name, _)| *name)
    }

    /// All axes with their numbers.
    pub fn iter(&self) -> impl Iterator<Item = (AxisName, u16)> {
        self.0.iter().copied()
    }
}

/// Name of the facts file, which accompanies table files without comments. The name contains the format, which
/// identifies the tables that the file describes.
pub fn facts_file(format: Format) -> String {
    format!("{FACTS_STEM}-{format}.txt")
}

/// Whether this is the name of a facts file, which no control reads; older names do not contain the format.
pub fn is_facts_file(name: &str) -> bool {
    let format = name.strip_prefix(FACTS_STEM).and_then(|end| end.strip_suffix(".txt"));
    format.is_some_and(|format| format.is_empty() || format.starts_with('-'))
}

const FACTS_STEM: &str = "volcomp-tables";
const NUMBERS: &str = "Axis numbers:";

/// Origin of tables: the machine, reference position and temperatures for which they were computed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Facts {
    /// Name of the machine.
    pub machine: String,
    /// Checksum of the machine file.
    pub checksum: String,
    /// Reference position of the axes that a table does not cover, mm or deg.
    pub at: Vec<(AxisName, f64)>,
    /// Temperatures of the sensors, as text; empty if none was given.
    pub temperatures: String,
    /// Mean deviations of positioning tables at the reference position, mm or rad.
    own_at_reference: Vec<(AxisName, f64)>,
}

/// Deviations at the reference position up to this magnitude are not reported, mm or rad.
const NEGLIGIBLE_DEVIATION: f64 = 1e-6;

impl Facts {
    /// Creates the facts of a machine with its axes at a reference position.
    pub fn of(machine: &Machine, at: Vec<(AxisName, f64)>, temperatures: String) -> Self {
        Self {
            machine: machine.name.clone(),
            checksum: machine.checksum(),
            at,
            temperatures,
            own_at_reference: Vec::new(),
        }
    }

    pub(crate) fn with_tables(&self, content: &Content) -> Self {
        let Content::Axes(tables) = content else {
            return self.clone();
        };
        let at_reference = |table: &AxisTable| {
            let at = self.at.iter().find(|(name, _)| *name == table.input);
            let at = from_file_unit(table.input, at.map_or(0.0, |(_, at)| *at));
            (table.input, table.deviation(at, None))
        };
        let own = tables.iter().filter(|table| table.is_own()).map(at_reference);
        Self {
            own_at_reference: own.filter(|(_, by)| by.abs() > NEGLIGIBLE_DEVIATION).collect(),
            ..self.clone()
        }
    }

    /// Note that positioning tables are not zero at the reference position; `None` if they are. `None` also for FANUC, whose increments begin
    /// at 0 there; another note reports the omitted deviation.
    fn moved_reference(&self, format: Format) -> Option<String> {
        if self.own_at_reference.is_empty() || format == Format::Fanuc {
            return None;
        }
        let moved = self.own_at_reference.iter().map(|(axis, by)| {
            let micro = Displacement::new(axis.kind(), *by).um_or_urad();
            let unit = if axis.is_rotary() { "urad" } else { "um" };
            format!("{axis} {} {unit}", short(micro, 2))
        });
        Some(format!(
            "Deviations at the reference position: {} (mean of both directions). A table of an axis over itself does not begin at zero there: switched on, it moves the \
             axis by as much the other way, and work offsets set before with it",
            moved.collect::<Vec<_>>().join(", ")
        ))
    }

    pub(crate) fn lines(&self, format: Format, axes: &AxisNumbers) -> Vec<String> {
        let mut at = String::new();
        for (name, place) in &self.at {
            let _ = write!(at, " {name}={}", short(*place, 6));
        }
        let temperatures = match self.temperatures.as_str() {
            "" => "not stated (thermal terms left out)",
            stated => stated,
        };
        let mut lines = vec![
            format!("{}, written by volcomp {}", title(format), env!("CARGO_PKG_VERSION")),
            format!("Machine: {}, {}", one_line(&self.machine), self.checksum),
            "Convention: deviation = actual - commanded of the output axis, over the commanded position of the input axis".to_owned(),
            format!("Reference position (mm, deg), where tables of one axis over another are zero:{at}"),
        ];
        lines.extend(self.moved_reference(format));
        lines.extend([
            format!("Temperatures: {}", one_line(temperatures)),
            format!("Sign: {}", format.sign()),
            format!("Directions: {}", directions(format)),
            format.trust().to_owned(),
        ]);
        if matches!(format, Format::Siemens840d | Format::Fanuc) {
            let used = axes.iter().map(|(name, number)| format!(" {name}={number}"));
            lines.push(format!("{NUMBERS}{}", used.collect::<String>()));
        }
        lines.push("No real control was tried, and nothing is certified.".to_owned());
        lines
    }
}

fn title(format: Format) -> String {
    format!("Compensation tables, format {format}")
}

/// Axis numbers in a header that [`write`](super::exchange::write) made for this format, with the file that has this header.
pub(crate) fn stated_numbers(
    format: Format,
    files: &[TextFile],
) -> Option<(&TextFile, AxisNumbers)> {
    let title = format!("{},", title(format));
    let of = |file: &TextFile| {
        let mut lines = file.text.lines();
        lines.by_ref().find(|line| line.contains(&title))?;
        AxisNumbers::stated(lines.find_map(numbers_in)?)
    };
    files.iter().find_map(|file| Some((file, of(file)?)))
}

/// Axis numbers in a header line; `None` for any other line.
pub(crate) fn numbers_in(line: &str) -> Option<Vec<(AxisName, u16)>> {
    let (_, stated) = line.split_once(NUMBERS)?;
    let number = |word: &str| {
        let (name, number) = word.split_once('=')?;
        Some((name.parse().ok()?, number.parse().ok()?))
    };
    Some(stated.split_whitespace().filter_map(number).collect())
}

pub(crate) fn stated_format(file: &TextFile) -> Option<Format> {
    let is_head = |format: &Format| file.text.contains(&format!("{},", title(*format)));
    Format::ALL.into_iter().find(is_head)
}

/// Text on how a format represents the two directions of motion.
fn directions(format: Format) -> &'static str {
    match format {
        Format::Csv => {
            "forward after positive, backward after negative motion; an empty cell of backward: as forward"
        }
        Format::Linuxcnc | Format::LinuxcncType1 => "both",
        Format::Siemens840d => {
            "$AA_ENC_COMP holds the mean of both; $AN_CEC_DIRECTION 1 holds for positive, -1 for negative motion, 0 for both"
        }
        Format::HeidenhainTnc640 => {
            "BACKLASH holds the values of the own axis after negative motion; columns of other axes the mean of both"
        }
        Format::Fanuc => "both where 3605#0 is 1, the second set of points for negative motion",
        _ => "the mean of both",
    }
}

/// Replaces control characters by spaces, so that the text stays on one line.
pub(crate) fn one_line(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}

pub(crate) fn facts_with(format: Format, options: &WriteOptions, written: &Written) -> TextFile {
    let mut text = String::new();
    let names = written.files.iter().map(|file| file.name.as_str());
    let names: Vec<&str> = names.collect();
    let mut lines = options.facts.lines(format, &options.axes);
    lines.push(format!("Files: {}", names.join(", ")));
    for line in lines.iter().chain(&written.notes) {
        text += line;
        text.push('\n');
    }
    TextFile { name: facts_file(format), text }
}

/// Settings of the control on which the written tables depend, and their origin.
#[derive(Clone, Debug, PartialEq)]
pub struct WriteOptions {
    /// Origin of the tables.
    pub facts: Facts,
    pub axes: AxisNumbers,
    /// Number of the encoder whose `$AA_ENC_COMP` table is written: 0 or 1.
    pub encoder: u8,
    /// FANUC detection unit, mm or deg.
    pub detection_unit: f64,
}

/// Settings of the control on which the meaning of the read tables depends.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadOptions {
    /// Axis numbers in the control; empty if unknown.
    pub axes: AxisNumbers,
    /// Number of the encoder whose `$AA_ENC_COMP` table is read; `None`: the only one with a table.
    pub encoder: Option<u8>,
    /// FANUC detection unit, mm or deg.
    pub detection_unit: f64,
}

impl Default for WriteOptions {
    fn default() -> Self {
        Self {
            facts: Facts::default(),
            axes: AxisNumbers::default(),
            encoder: 0,
            detection_unit: 0.001,
        }
    }
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self { axes: AxisNumbers::default(), encoder: None, detection_unit: 0.001 }
    }
}

/// Result of writing tables.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Written {
    /// Files for the control, and the facts file if any.
    pub files: Vec<TextFile>,
    /// Notes: information that the files cannot represent, and settings that the control needs.
    pub notes: Vec<String>,
    /// Output and input axis of each omitted table; a note gives the reason.
    pub left_out: Vec<(AxisName, AxisName)>,
}

impl Written {
    pub(crate) fn leave_out(&mut self, why: &str, tables: &[&AxisTable]) {
        if tables.is_empty() {
            return;
        }
        let names = tables.iter().map(|table| format!("{} over {}", table.output, table.input));
        let names: Vec<String> = names.collect();
        self.notes.push(format!("left out, because {why}: {}", names.join(", ")));
        let pairs = tables.iter().map(|table| (table.output, table.input));
        self.left_out.extend(pairs);
    }
}
