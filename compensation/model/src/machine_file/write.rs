use core::fmt::Write;

use volcomp_document::toml_string;
use volcomp_kinematics::MotionFrame;

use super::provenance::write_provenance;
use crate::{curve_file::write_error_curve, machine::Machine, thermal::Thermal, tool::Tool};

/// Writes the machine file, without its checksum, in a fixed order and spelling.
pub(super) fn canonical(machine: &Machine) -> String {
    let mut text = format!("name = {}\n", toml_string(&machine.name));
    let mut line = |content: String| {
        text.push_str(&content);
        text.push('\n');
    };
    line(format!("structure = \"{}\"", machine.chain().structure()));
    if let Some(axes) = machine.correct() {
        let names: Vec<String> = axes.iter().map(|axis| format!("\"{axis}\"")).collect();
        line(format!("correct = [{}]", names.join(", ")));
    }
    for axis in machine.axes() {
        line(format!("\n[axes.{}]\ntravel = {:?}", axis.name, axis.travel));
        if let Some(point) = axis.point_mm {
            line(format!("point = {point:?}"));
        }
        if let Some(direction) = axis.direction {
            line(format!("direction = {direction:?}"));
        }
        if let Some(modulo) = axis.modulo {
            line(format!("modulo = {modulo:?}"));
        }
        if axis.motion_frame == MotionFrame::Turning {
            line("motion_frame = \"turning\"".to_owned());
        }
    }
    line("\n[tool]".to_owned());
    line(write_tool(machine.tool()));
    for (name, tool) in machine.tools() {
        line(format!("[tools.{}]\n{}", toml_string(name), write_tool(tool)));
    }
    line(format!("[workpiece]\norigin = {:?}", machine.workpiece_origin_mm()));
    line("\n[errors]".to_owned());
    for (name, curve) in machine.errors() {
        line(format!("{name} = {}", write_error_curve(curve, machine.axes())));
    }
    for (name, value) in machine.locations() {
        line(format!("{name} = {value:?}"));
    }
    line("\n[assembly]".to_owned());
    for (index, axis) in machine.axes().iter().enumerate() {
        if machine.assembly(index) != [0.0; 6] {
            line(format!("{} = {:?}", axis.name, machine.assembly(index)));
        }
    }
    line(write_thermal(machine.thermal()));
    text += &write_provenance(machine.provenance());
    text
}

fn write_tool(tool: &Tool) -> String {
    let mut text = String::new();
    let vectors = [
        ("tip", tool.tip_mm),
        ("gauge", tool.gauge_mm),
        ("offset", tool.offset_mm),
        ("axis", tool.axis),
    ];
    for (key, vector) in vectors {
        if let Some(vector) = vector {
            let _ = writeln!(text, "{key} = {vector:?}"); // writing to a String cannot fail
        }
    }
    if let Some(length) = tool.length_mm {
        let _ = writeln!(text, "length = {length:?}");
    }
    text
}

fn write_thermal(thermal: &Thermal) -> String {
    let mut text = format!("\n[thermal]\nreference = {:?}\n", thermal.reference_degc);
    // Files without tested ranges are written without `margin_k`, so that they keep their text and checksum.
    if !thermal.seen.is_empty() || thermal.margin_k != Thermal::default().margin_k {
        let _ = writeln!(text, "margin_k = {:?}", thermal.margin_k); // writing to a String cannot fail
    }
    for term in &thermal.expansion {
        let _ = write!(
            text,
            "\n[[thermal.expansion]]\nerror = \"{}\"\nsensor = {}\num_per_m_k = {:?}\nfixed_mm = {:?}\n",
            term.error,
            toml_string(&term.sensor),
            term.um_per_m_k,
            term.fixed_mm
        );
    }
    for term in &thermal.drift {
        let sensors: Vec<String> = term
            .sensors
            .iter()
            .map(|(name, weight)| format!("{} = {weight:?}", toml_string(name)))
            .collect();
        let unit = term.error.component.unit();
        let _ = write!(
            text,
            "\n[[thermal.drift]]\nerror = \"{}\"\nsensors = {{ {} }}\n{unit}_per_k = {:?}\nlag_s = {:?}\n",
            term.error,
            sensors.join(", "),
            term.per_k,
            term.lag_s
        );
    }
    for seen in &thermal.seen {
        let _ = write!(
            text,
            "\n[[thermal.seen]]\nerror = \"{}\"\nsensor = {}\ndegc = {:?}\n",
            seen.error,
            toml_string(&seen.sensor),
            seen.degc
        );
        if let Some(rates) = seen.k_per_min {
            let _ = writeln!(text, "k_per_min = {rates:?}");
        }
    }
    text
}
