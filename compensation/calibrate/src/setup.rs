//! Set-up of one measured line (error, positions, sign) and the keys of a `[[measurement]]` that state it.

use volcomp_document::{InputError, Section, Value};
use volcomp_kinematics::Side;
use volcomp_metrology::{Rides, TiltReading};
use volcomp_model::Machine;
use volcomp_vocabulary::ErrorName;

/// Set-up of one error measured along one line.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// Measured error.
    pub error: ErrorName,
    /// Position of every axis, mm or deg, by index in the chain; the measured axis is at 0. An axis without a value is at 0.
    pub at: Vec<f64>,
    /// Measured point m, mm in MCS with the measured axis at 0; `None`: the point at which the axis's errors are stated.
    pub point_mcs: Option<[f64; 3]>,
    /// Whether the measured point moves with the carriage of the axis.
    pub rides: Rides,
    /// Conversion of the readings to the error.
    pub method: Method,
    /// −1 if the instrument gives the motion of the workpiece-side component, else 1.
    pub sign: f64,
}

/// Conversion of readings to the error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Method {
    /// The readings are the error itself.
    Direct,
    /// Tilts of a bridge, summed to a straightness.
    Angular {
        /// Foot spacing of the bridge, mm.
        bridge_mm: f64,
        /// Sign convention of a tilt.
        reading: TiltReading,
    },
}

impl Setup {
    /// Whether the measured point belongs to the tool side of the machine, for an axis that carries
    /// `side`.
    pub fn point_is_on_tool_side(&self, side: Side) -> bool {
        (side == Side::Tool) == (self.rides == Rides::Carriage)
    }

    /// Whether the readings are angles: of an angular error, or of a bridge.
    pub fn reads_angles(&self) -> bool {
        self.error.component.is_angular() || self.method != Method::Direct
    }
}

impl Setup {
    /// Keys of a `[[measurement]]` that [`Setup::decode`] reads, in addition to the key that names the error.
    pub const KEYS: [&str; 7] = ["at", "point", "rides", "sign", "method", "bridge_mm", "reading"];

    /// Decodes the set-up of `error` from a `[[measurement]]` of a calibration file or shop file.
    ///
    /// # Errors
    /// An axis that the machine does not have, or an invalid word or number.
    pub fn decode(
        section: &Section<'_>,
        error: ErrorName,
        machine: &Machine,
    ) -> Result<Self, InputError> {
        let mut at = vec![0.0; machine.axes().len()];
        if let Some(held) = section.section("at")? {
            if let Some(own) = held.get(&error.axis.to_string()) {
                let message =
                    format!("{} is the measured axis, expected the other axes only", error.axis);
                return Err(own.error(message));
            }
            set_coordinates(&mut at, &held, machine)?;
        }
        Ok(Self {
            error,
            at,
            point_mcs: section.get("point").map(|value| value.vector()).transpose()?,
            rides: section.one_of(
                "rides",
                &[("carriage", Rides::Carriage), ("other", Rides::Other)],
                Rides::Carriage,
            )?,
            method: decode_method(section)?,
            sign: decode_sign(section)?,
        })
    }

    /// Formats the keys of a `[[measurement]]` that decode to this set-up, one per line.
    pub fn to_toml(&self, machine: &Machine) -> String {
        let mut lines = vec![format!("error = \"{}\"", self.error)];
        let held: Vec<String> = machine
            .axes()
            .iter()
            .zip(&self.at)
            .filter(|(_, coordinate)| **coordinate != 0.0)
            .map(|(axis, coordinate)| format!("{} = {coordinate:?}", axis.name))
            .collect();
        if !held.is_empty() {
            lines.push(format!("at = {{ {} }}", held.join(", ")));
        }
        if let Some(point) = self.point_mcs {
            lines.push(format!("point = {point:?}"));
        }
        if self.rides == Rides::Other {
            lines.push("rides = \"other\"".to_owned());
        }
        if self.sign < 0.0 {
            lines.push("sign = -1".to_owned());
        }
        if let Method::Angular { bridge_mm, reading } = self.method {
            lines.push(format!("method = \"angular\"\nbridge_mm = {bridge_mm:?}"));
            if reading == TiltReading::Slope {
                lines.push("reading = \"slope\"".to_owned());
            }
        }
        lines.join("\n") + "\n"
    }
}

/// Assigns coordinates by axis letter, mm or deg, to the indices of the axes in the chain. A coordinate outside the
/// travel of its axis is rejected: it would give a wrong lever arm, or set the zero of a curve outside its readings.
pub(crate) fn set_coordinates(
    coordinates: &mut [f64],
    section: &Section<'_>,
    machine: &Machine,
) -> Result<(), InputError> {
    for (key, value) in section.values() {
        let place = machine.axes().iter().position(|axis| axis.name.to_string() == key);
        let structure = machine.chain().structure();
        let place = place
            .ok_or_else(|| value.error(format!("the structure `{structure}` has no axis {key}")))?;
        let found = value.number()?;
        let stands = machine.axes()[place].check_coordinate(found);
        stands.map_err(|message| value.error(message))?;
        coordinates[place] = found;
    }
    Ok(())
}

/// Decodes the errors that a table names by `error` or by `errors`, and passes each value and error to `check`.
/// `missing` returns the message for a table without both keys.
pub(crate) fn decode_errors(
    section: &Section<'_>,
    machine: &Machine,
    missing: impl FnOnce() -> InputError,
    check: impl Fn(&Value<'_>, ErrorName) -> Result<(), InputError>,
) -> Result<Vec<ErrorName>, InputError> {
    let names = match (section.get("error"), section.get("errors")) {
        (Some(one), None) => vec![one],
        (None, Some(several)) => several.items()?,
        (Some(_), Some(both)) => {
            return Err(both.error("found `error` and `errors` together, expected one of them"));
        }
        (None, None) => return Err(missing()),
    };
    let mut errors = Vec::new();
    for name in &names {
        let error = machine.decode_error(name)?;
        check(name, error)?;
        if errors.contains(&error) {
            return Err(name.error(format!("{error} appears twice")));
        }
        errors.push(error);
    }
    if errors.is_empty() {
        return Err(section.error("found no error in `errors`, expected at least one"));
    }
    Ok(errors)
}

/// Decodes the name of an error motion of an axis that the machine has.
///
/// # Errors
/// A text that is not an error name or names a location error, or an axis that the machine does not have.
pub fn decode_motion(value: &Value<'_>, machine: &Machine) -> Result<ErrorName, InputError> {
    let error = machine.decode_error(value)?;
    if error.location {
        let message =
            format!("found {error}, expected an error motion E?N; squareness has its own table");
        return Err(value.error(message));
    }
    Ok(error)
}

pub(crate) fn decode_sign(section: &Section<'_>) -> Result<f64, InputError> {
    let Some(value) = section.get("sign") else {
        return Ok(1.0);
    };
    let sign = value.number()?;
    if sign.abs() == 1.0 {
        Ok(sign)
    } else {
        Err(value.error(format!("found {sign}, expected 1 or -1")))
    }
}

fn decode_method(section: &Section<'_>) -> Result<Method, InputError> {
    if !section.one_of("method", &[("direct", false), ("angular", true)], false)? {
        for key in ["bridge_mm", "reading"] {
            if let Some(value) = section.get(key) {
                return Err(value.error("expected only with method = \"angular\""));
            }
        }
        return Ok(Method::Direct);
    }
    let bridge = section.require("bridge_mm")?;
    let bridge_mm = bridge.number()?;
    if bridge_mm <= 0.0 {
        return Err(bridge.error(format!("found {bridge_mm}, expected a positive length")));
    }
    let words = [("right-hand", TiltReading::RightHand), ("slope", TiltReading::Slope)];
    Ok(Method::Angular {
        bridge_mm,
        reading: section.one_of("reading", &words, TiltReading::RightHand)?,
    })
}
