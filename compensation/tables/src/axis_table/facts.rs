//! What every file of tables states about itself.

use core::fmt::Write;

use volcomp_model::Machine;
use volcomp_vocabulary::{AxisName, Displacement};

use super::{
    AxisNumbers, AxisTable, Content,
    exchange::WriteOptions,
    format::Format,
    text::{TextFile, short},
};

/// The name of the file with the facts, beside files that hold no comments: each format has its own, so that it says of
/// which the tables are.
pub fn facts_file(format: Format) -> String {
    format!("{FACTS_STEM}-{format}.txt")
}

/// Whether a file is one with facts, which no control reads; also by its name before there was one for each format.
pub fn is_facts_file(name: &str) -> bool {
    let format = name
        .strip_prefix(FACTS_STEM)
        .and_then(|end| end.strip_suffix(".txt"));
    format.is_some_and(|format| format.is_empty() || format.starts_with('-'))
}

const FACTS_STEM: &str = "volcomp-tables";
const NUMBERS: &str = "Axis numbers:";

/// Where tables come from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Facts {
    /// The name of the machine.
    pub machine: String,
    /// The checksum of the machine file.
    pub checksum: String,
    /// Where the axes stand that a table does not go over, mm or deg.
    pub at: Vec<(AxisName, f64)>,
    /// The temperatures of the sensors, in words; empty where none is stated.
    pub temperatures: String,
    /// Deviations that tables of an axis over itself have at the reference position, mm or rad.
    own_at_reference: Vec<(AxisName, f64)>,
}

/// A deviation at the reference position below which nothing is said, mm or rad.
const NO_MOVE: f64 = 1e-6;

impl Facts {
    /// The facts of a machine with its axes at a reference position.
    pub fn of(machine: &Machine, at: Vec<(AxisName, f64)>, temperatures: String) -> Self {
        Self {
            machine: machine.name.clone(),
            checksum: machine.checksum(),
            at,
            temperatures,
            own_at_reference: Vec::new(),
        }
    }

    /// The same with what these tables have at the reference position.
    pub(crate) fn with_tables(&self, content: &Content) -> Self {
        let Content::Axes(tables) = content else {
            return self.clone();
        };
        let there = |table: &AxisTable| {
            let at = self.at.iter().find(|(name, _)| *name == table.input);
            let at = AxisTable::input_from_edge(table.input, at.map_or(0.0, |(_, at)| *at));
            (table.input, table.deviation(at, None))
        };
        let own = tables.iter().filter(|table| table.is_own()).map(there);
        Self {
            own_at_reference: own.filter(|(_, by)| by.abs() > NO_MOVE).collect(),
            ..self.clone()
        }
    }

    /// Why tables of an axis over itself are not zero at the reference position, in a sentence. FANUC's steps begin at 0 there, and a note
    /// says what they leave out.
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

    /// The lines of a head, without the mark of a comment.
    pub(crate) fn lines(&self, format: Format, options: &WriteOptions) -> Vec<String> {
        let mut at = String::new();
        for (name, place) in &self.at {
            // Writing to a string does not fail.
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
            let used = options.axes.iter();
            let used = used.map(|(name, number)| format!(" {name}={number}"));
            lines.push(format!("{NUMBERS}{}", used.collect::<String>()));
        }
        lines.push("No real control was tried, and nothing is certified.".to_owned());
        lines
    }
}

fn title(format: Format) -> String {
    format!("Compensation tables, format {format}")
}

/// The numbers of the axes as a head that [`write`](super::write) made for this format states them, and the file with it.
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

/// The numbers of the axes in a line of a head; `None` where it is another line.
pub(crate) fn numbers_in(line: &str) -> Option<Vec<(AxisName, u16)>> {
    let (_, stated) = line.split_once(NUMBERS)?;
    let number = |word: &str| {
        let (name, number) = word.split_once('=')?;
        Some((name.parse().ok()?, number.parse().ok()?))
    };
    Some(stated.split_whitespace().filter_map(number).collect())
}

/// The format that a file with facts states.
pub(crate) fn stated_format(file: &TextFile) -> Option<Format> {
    let is_head = |format: &Format| file.text.contains(&format!("{},", title(*format)));
    Format::ALL.into_iter().find(is_head)
}

/// What a format says of the two directions of motion.
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

/// Text that stays one line.
pub(crate) fn one_line(text: &str) -> String {
    text.chars()
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect()
}

/// The file with the facts.
pub(crate) fn file(
    format: Format,
    options: &WriteOptions,
    tables: &[TextFile],
    more: &[String],
) -> TextFile {
    let mut text = String::new();
    let names: Vec<&str> = tables.iter().map(|file| file.name.as_str()).collect();
    let mut lines = options.facts.lines(format, options);
    lines.push(format!("Files: {}", names.join(", ")));
    for line in lines.iter().chain(more) {
        text += line;
        text.push('\n');
    }
    TextFile {
        name: facts_file(format),
        text,
    }
}
