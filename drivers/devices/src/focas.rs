//! FANUC controls, reached over Ethernet by FOCAS.

use std::time::{Duration, Instant};

use volcomp_focas::{Client, FocasConfig, FocasError, PositionKind, ShiftSource};
use volcomp_port::DeviceError;
use volcomp_vocabulary::{AxisKind, AxisName, Displacement};

use crate::{
    address::Address,
    facts::{ControlFacts, Facts},
    probed::Probe,
};

/// Exchanges whose times are told.
const TIMED: usize = 100;

/// How the control of a URL is corrected: these axes, everything else as [`FocasConfig::new`] has it.
///
/// # Errors
/// Keys that make no sense.
pub fn focas_config(address: &Address, axes: &[AxisName]) -> Result<FocasConfig, DeviceError> {
    let mut config = FocasConfig::new(&*address.host, axes);
    config.port = address.port.unwrap_or(volcomp_focas::PORT);
    config.path = address.number("path", [1, 10], 1)?;
    Ok(config)
}

pub(crate) fn probe(address: &Address, at_most: Duration) -> Result<Probe, DeviceError> {
    let config = focas_config(address, &[])?;
    let told = |error: FocasError| error.of(&*address.text);
    let mut client = Client::open(&config.host, config.port, at_most).map_err(told)?;
    let system = client.system_info().map_err(told)?;
    let names = client.axis_names().map_err(told)?;
    let positions = client
        .positions(PositionKind::Machine, names.len())
        .map_err(told)?;
    let status = client.status().map_err(told)?;
    let (shift_in_use, shift_words, shift_untold) = match client.shift_source().map_err(told)? {
        ShiftSource::Told { in_use, first } => (Some(in_use), Some(first), None),
        ShiftSource::Untold { why } => (None, None, Some(why)),
    };
    let mut times = Vec::new();
    for _ in 0..TIMED {
        let begun = Instant::now();
        client.status().map_err(told)?;
        times.push(begun.elapsed());
    }
    times.sort_unstable();
    let microseconds = |time: Duration| (time.as_secs_f64() * 1e6).round();
    let mut probe = Probe::of(&address.text);
    for (name, value) in names.iter().zip(positions) {
        // The control does not say which axes turn; their letters do, as everywhere.
        let known = AxisName::from_letter(*name);
        let kind = known.map_or(AxisKind::Linear, AxisName::kind);
        probe.add_position(name.to_string(), Displacement::from_coordinate(kind, value));
    }
    probe.facts = Some(Facts::Control(ControlFacts {
        control: format!("{}{}", system.cnc_type, system.machine_type)
            .trim()
            .to_owned(),
        series: format!("{} {}", system.series, system.version),
        version: client.version(),
        emergency_stop: status.emergency != 0,
        alarm: status.alarm != 0,
        shift_in_use,
        shift_words,
        shift_untold,
        round_trip_p50_us: microseconds(times[TIMED / 2]),
        round_trip_max_us: microseconds(times[TIMED - 1]),
    }));
    Ok(probe)
}
