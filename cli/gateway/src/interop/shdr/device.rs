//! The device description for an MTConnect agent, XML.

use std::fmt::Write;

use super::{
    super::{
        alarms::Place,
        quantities::{Kind, Part, Quantity, Shape, Unit},
    },
    lines::{AVAILABILITY, Items},
};

/// The MTConnect name of a quantity: category, type, sub-type and unit. Types with the prefix `x:` are extensions of
/// the standard.
struct Item {
    category: &'static str,
    kind: String,
    sub: Option<&'static str>,
    units: Option<&'static str>,
}

/// The `Devices.xml` for an agent that reads this gateway. `name` is the device name shown by the agent.
pub fn device(shape: &Shape, name: &str) -> String {
    let items = Items::of(shape);
    let of = |parts: &[Part]| -> Vec<String> {
        let own = items.quantities.iter();
        let own = own.filter(|own| parts.contains(&own.part));
        own.map(data_item).collect()
    };
    let with_condition = |mut own: Vec<String>, wanted: Place, kind: &str| {
        let conditions = items
            .conditions
            .iter()
            .filter(|(_, place)| *place == wanted);
        own.extend(conditions.map(|(key, _)| {
            format!(r#"<DataItem category="CONDITION" id="{key}" name="{key}" type="{kind}"/>"#)
        }));
        own
    };
    let mut xml = Xml::default();
    xml.line(r#"<?xml version="1.0" encoding="UTF-8"?>"#);
    xml.open(
        r#"MTConnectDevices xmlns="urn:mtconnect.org:MTConnectDevices:1.5" xmlns:x="urn:volcomp:VolcompDevices:1""#,
    );
    xml.line(
        r#"<Header creationTime="1970-01-01T00:00:00Z" sender="volcomp-gateway" instanceId="0" version="1.5" assetBufferSize="0" assetCount="0" bufferSize="1"/>"#,
    );
    xml.open("Devices");
    let name = escaped(name);
    xml.open(&format!(
        r#"Device id="d" name="{name}" uuid="volcomp-{name}""#
    ));
    xml.line("<Description manufacturer=\"volcomp\">Volumetric compensation</Description>");
    xml.data_items(&[format!(
        r#"<DataItem category="EVENT" id="{AVAILABILITY}" name="{AVAILABILITY}" type="AVAILABILITY"/>"#
    )]);
    xml.open("Components");
    xml.open(r#"Axes id="a" name="axes""#);
    xml.open("Components");
    for &axis in &shape.axes {
        let tag = if axis.is_rotary() { "Rotary" } else { "Linear" };
        let own = of(&[Part::Axis(axis)]);
        xml.component(tag, &format!("a_{axis}"), &axis.to_string(), &own);
    }
    xml.close("Components");
    xml.close("Axes");
    let own = with_condition(of(&[Part::Gateway, Part::Tool]), Place::Guard, "SYSTEM");
    xml.component("Controller", "c_gateway", "gateway", &own);
    for place in 0..shape.controllers {
        let own = of(&[Part::Controller(place)]);
        let own = with_condition(own, Place::Controller(place), "COMMUNICATIONS");
        let name = format!("path_{place}");
        xml.component("Controller", &format!("c_{name}"), &name, &own);
    }
    for (place, sensor) in shape.sensors.iter().enumerate() {
        let own = of(&[Part::Sensor(place)]);
        let own = with_condition(own, Place::Sensor(place), "TEMPERATURE");
        xml.component("Sensor", &format!("s_{place}"), sensor, &own);
    }
    for tag in ["Components", "Device", "Devices", "MTConnectDevices"] {
        xml.close(tag);
    }
    xml.text
}

/// XML text and the current nesting depth.
#[derive(Default)]
struct Xml {
    text: String,
    depth: usize,
}

impl Xml {
    fn line(&mut self, text: &str) {
        // Writing to a string never fails.
        let _ = writeln!(self.text, "{:1$}{text}", "", 2 * self.depth);
    }

    fn open(&mut self, tag: &str) {
        self.line(&format!("<{tag}>"));
        self.depth += 1;
    }

    fn close(&mut self, tag: &str) {
        self.depth = self.depth.saturating_sub(1);
        self.line(&format!("</{tag}>"));
    }

    fn component(&mut self, tag: &str, id: &str, name: &str, items: &[String]) {
        let name = escaped(name);
        self.open(&format!(r#"{tag} id="{id}" name="{name}""#));
        self.data_items(items);
        self.close(tag);
    }

    fn data_items(&mut self, items: &[String]) {
        self.open("DataItems");
        for item in items {
            self.line(item);
        }
        self.close("DataItems");
    }
}

fn data_item(quantity: &Quantity) -> String {
    let Item {
        category,
        kind,
        sub,
        units,
    } = item(quantity);
    let key = &quantity.key;
    let sub = sub.map_or(String::new(), |sub| format!(r#" subType="{sub}""#));
    let units = units.map_or(String::new(), |units| format!(r#" units="{units}""#));
    format!(
        r#"<DataItem category="{category}" id="{key}" name="{key}" type="{kind}"{sub}{units}/>"#
    )
}

fn item(quantity: &Quantity) -> Item {
    let Kind::Number(unit) = quantity.kind else {
        return Item {
            category: "EVENT",
            kind: own_type(quantity),
            sub: None,
            units: None,
        };
    };
    let units = match unit {
        Unit::Mm | Unit::Um => "MILLIMETER",
        Unit::Deg | Unit::Urad => "DEGREE",
        Unit::Degc => "CELSIUS",
        Unit::Ms => "SECOND",
    };
    let (kind, sub) = match (quantity.row, unit) {
        ("position", Unit::Deg) => ("ANGLE".to_owned(), Some("ACTUAL")),
        ("position", _) => ("POSITION".to_owned(), Some("ACTUAL")),
        ("temperature", _) => ("TEMPERATURE".to_owned(), None),
        _ => (own_type(quantity), None),
    };
    Item {
        category: "SAMPLE",
        kind,
        sub,
        units: Some(units),
    }
}

/// An extension type, for quantities without a type in the standard. `COMPENSATION_` distinguishes it from states and
/// errors of other devices.
fn own_type(quantity: &Quantity) -> String {
    format!("x:COMPENSATION_{}", quantity.row.to_ascii_uppercase())
}

/// Escapes text for XML. Characters that XML cannot represent are dropped.
fn escaped(text: &str) -> String {
    let mut xml = String::new();
    for c in text.chars().filter(|c| !c.is_control()) {
        match c {
            '&' => xml += "&amp;",
            '<' => xml += "&lt;",
            '>' => xml += "&gt;",
            '"' => xml += "&quot;",
            // Noncharacters, which XML forbids.
            '\u{fffe}' | '\u{ffff}' => {}
            c => xml.push(c),
        }
    }
    xml
}
