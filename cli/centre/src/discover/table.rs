//! What was found, as a table for people.

use std::fmt::Write;

use super::Device;

/// Lines of text: a device each, with the first proposal and how many there are.
pub fn table(devices: &[Device]) -> String {
    if devices.is_empty() {
        return "Nothing was found.\n".to_owned();
    }
    let mut rows = vec![["address", "what", "control", "axes", "structure"].map(str::to_owned)];
    for device in devices {
        let axes: Vec<String> = device.axes.iter().map(ToString::to_string).collect();
        let what = if device.answers {
            device.kind.name().to_owned()
        } else {
            format!("not {}", device.kind.name())
        };
        let control: Vec<&str> = [&device.control, &device.name]
            .into_iter()
            .filter(|text| !text.is_empty())
            .map(String::as_str)
            .collect();
        rows.push([
            format!("{}:{}", device.address, device.port),
            what,
            control.join(", "),
            axes.join(" "),
            structure(device),
        ]);
    }
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max();
    let widths: [usize; 4] = core::array::from_fn(|column| width(column).unwrap_or(0));
    let mut text = String::new();
    for (row, device) in rows
        .iter()
        .zip([None].into_iter().chain(devices.iter().map(Some)))
    {
        let mut line = String::new();
        for (cell, width) in row.iter().zip(widths) {
            // Writing to a string never fails.
            let _ = write!(line, "{cell:width$}  ");
        }
        line.push_str(&row[4]);
        text.push_str(line.trim_end());
        text.push('\n');
        if let Some(note) = device
            .map(|device| &device.note)
            .filter(|note| !note.is_empty())
        {
            let _ = writeln!(text, "    {note}");
        }
    }
    text
}

fn structure(device: &Device) -> String {
    if let Some(stated) = &device.structure {
        return stated.clone();
    }
    match &device.proposals[..] {
        [] => String::new(),
        [only] => format!("{}?", only.structure),
        [first, rest @ ..] => format!("{}? or one of {} others", first.structure, rest.len()),
    }
}
