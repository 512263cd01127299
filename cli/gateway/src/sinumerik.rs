//! SINUMERIK controls over OPC UA: what their configuration means, and opening them in builds that can.

use std::path::Path;

use volcomp_devices::Address;
use volcomp_guard::Limits;
use volcomp_port::{Controller, DeviceError, Thermometer};
use volcomp_sinumerik::{Server, SinumerikConfig, User};
use volcomp_vocabulary::{Um, Urad};

use crate::{
    config::{ControllerConfig, SinumerikTable, ThermometerConfig, tables::of_ms},
    documents::{OnlinePlan, round},
};

/// The control of a `[[controller]]`.
///
/// # Errors
/// A password file that others may read or that cannot be read, a build without OPC UA.
pub(crate) fn controller(
    address: &Address,
    config: &ControllerConfig,
) -> Result<SinumerikConfig, DeviceError> {
    let table = config.sinumerik.clone().unwrap_or_default();
    let mut control = SinumerikConfig::new(server(address, &table)?, &config.axes);
    if let Some(channel) = &config.channel
        && *channel != control.channel
    {
        let expected = format!(
            "expected {:?}, the only channel of a SINUMERIK control",
            control.channel
        );
        return Err(address.wrong(format!("channel: found {channel:?}"), expected));
    }
    control.reads.clone_from(&config.reads);
    control.numbers = table.numbers;
    control.nodes = table.nodes;
    control.sign = table.sign;
    control.includes_correction = config.includes_correction;
    if let Some(um) = config.resolution_um {
        control.step_linear = Um(um).to_mm();
    }
    if let Some(urad) = config.resolution_urad {
        control.step_rotary = Urad(urad).to_rad();
    }
    Ok(control)
}

pub(crate) fn server(address: &Address, config: &SinumerikTable) -> Result<Server, DeviceError> {
    if cfg!(not(feature = "sinumerik")) {
        return Err(address.unsupported(
            "this build of the gateway has no OPC UA",
            "build it with the feature `sinumerik`",
        ));
    }
    let mut server = Server::new(&*address.text);
    server.namespace.clone_from(&config.namespace);
    server.user = match (&config.user, &config.password_file) {
        (Some(name), Some(file)) => Some(User {
            name: name.clone(),
            password: password(address, file)?,
        }),
        _ => None,
    };
    server.security = config.security;
    server.pki.clone_from(&config.certificates);
    server.period = of_ms(config.period_ms);
    server.time_out = of_ms(config.time_out_ms);
    server.source_timestamps = config.source_timestamps;
    Ok(server)
}

/// The first line of a file that nobody but its owner may read.
fn password(address: &Address, file: &Path) -> Result<String, DeviceError> {
    let text = volcomp_document::private::read(file).map_err(|error| {
        let expected = "expected a file with the password in its first line";
        address
            .wrong(format!("password_file: {error}"), expected)
            .caused_by(error)
    })?;
    Ok(text.lines().next().unwrap_or_default().to_owned())
}

/// Temperatures of a control, as they are configured.
#[derive(Clone, Debug)]
pub(crate) struct Temperatures {
    #[cfg_attr(
        not(feature = "sinumerik"),
        expect(dead_code, reason = "only opened with OPC UA")
    )]
    server: Server,
    sensors: Vec<(String, String)>,
}

impl Temperatures {
    /// The temperatures of a `[[thermometer]]`.
    ///
    /// # Errors
    /// As [`controller`].
    pub(crate) fn new(address: &Address, config: &ThermometerConfig) -> Result<Self, DeviceError> {
        let sensors = config
            .names
            .iter()
            .cloned()
            .zip(config.nodes.iter().cloned());
        Ok(Self {
            server: server(address, &config.sinumerik.clone().unwrap_or_default())?,
            sensors: sensors.collect(),
        })
    }
}

#[cfg(feature = "sinumerik")]
mod opened {
    use std::collections::BTreeMap;

    use super::{
        Controller, DeviceError, Limits, OnlinePlan, SinumerikConfig, Temperatures, Thermometer,
        round,
    };
    use volcomp_sinumerik::{Sensor, SinumerikController, SinumerikThermometer, inspect};
    use volcomp_vocabulary::AxisKind;

    /// Opens a control: connecting happens in the background.
    ///
    /// # Errors
    /// A configuration that the driver refuses.
    pub(crate) fn open(config: &SinumerikConfig) -> Result<Box<dyn Controller>, DeviceError> {
        Ok(Box::new(SinumerikController::new(config.clone())?))
    }

    impl Temperatures {
        /// Opens them: connecting happens in the background.
        ///
        /// # Errors
        /// A server that the driver refuses.
        pub(crate) fn open(&self) -> Result<Box<dyn Thermometer>, DeviceError> {
            let sensor = |(name, node): &(String, String)| Sensor {
                name: name.clone(),
                node: node.clone(),
            };
            let sensors: Vec<Sensor> = self.sensors.iter().map(sensor).collect();
            Ok(Box::new(SinumerikThermometer::new(
                self.server.clone(),
                &sensors,
            )?))
        }
    }

    /// What the control tells about itself. Nothing is written.
    ///
    /// # Errors
    /// It cannot be reached, or does not take corrections.
    pub(crate) fn online(
        config: &SinumerikConfig,
        limits: Option<&Limits>,
    ) -> Result<OnlinePlan, DeviceError> {
        let found = inspect(config).map_err(|error| error.of(config.device()))?;
        let mut notes = found.notes;
        let mut fastest = BTreeMap::new();
        for (place, axis) in found.axes.iter().enumerate() {
            let Some(per_min) = axis.fastest_per_min else {
                continue;
            };
            fastest.insert(axis.axis.to_string(), round(per_min));
            let slew = limits
                .filter(|limits| place < limits.count)
                .map(|limits| limits.axes[place].slew_per_s);
            // Where a revolution a minute is meant nothing is compared: the slews of rotary axes are tiny.
            if let Some(slew) =
                slew.filter(|slew| axis.axis.kind() == AxisKind::Linear && slew * 60.0 > per_min)
            {
                notes.push(format!(
                    "axis {}: the control takes a correction at {per_min} mm/min at the most (MD32760 times MD32000), and slew_um_per_s asks for {} mm/min: the axis comes behind",
                    axis.axis,
                    round(slew * 60.0)
                ));
            }
        }
        Ok(OnlinePlan {
            url: config.device().to_owned(),
            axes: found
                .axes
                .iter()
                .map(|axis| axis.name.clone().unwrap_or_else(|| axis.axis.to_string()))
                .collect(),
            fastest_per_min: Some(fastest),
            shift_in_use: None,
            shift_words: None,
            protocol: None,
            state: None,
            barrier: None,
            notes,
        })
    }
}

#[cfg(feature = "sinumerik")]
pub(crate) use opened::{online, open};

/// A configuration that needs OPC UA was refused before: [`server`].
#[cfg(not(feature = "sinumerik"))]
mod opened {
    use super::{
        Controller, DeviceError, Limits, OnlinePlan, SinumerikConfig, Temperatures, Thermometer,
    };

    fn unsupported(device: &str) -> DeviceError {
        DeviceError::unsupported(
            device,
            "this build has no OPC UA",
            "build it with the feature `sinumerik`",
        )
    }

    pub(crate) fn open(config: &SinumerikConfig) -> Result<Box<dyn Controller>, DeviceError> {
        Err(unsupported(config.device()))
    }

    pub(crate) fn online(
        config: &SinumerikConfig,
        _limits: Option<&Limits>,
    ) -> Result<OnlinePlan, DeviceError> {
        Err(unsupported(config.device()))
    }

    impl Temperatures {
        pub(crate) fn open(&self) -> Result<Box<dyn Thermometer>, DeviceError> {
            let sensors: Vec<&str> = self.sensors.iter().map(|(name, _)| name.as_str()).collect();
            Err(unsupported(&sensors.join(", ")))
        }
    }
}

#[cfg(not(feature = "sinumerik"))]
pub(crate) use opened::{online, open};
