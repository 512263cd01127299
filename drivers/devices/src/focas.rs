//! FANUC controls over Ethernet (FOCAS).

use std::{
    any::Any,
    time::{Duration, Instant},
};

use volcomp_document::Mistakes;
use volcomp_focas::{
    BarrierArea, Client, FocasConfig, FocasController, FocasError, MapPlaces, PORT, PmcAddress,
    PmcArea, PositionKind, ShiftSource, Width, inspect,
};
use volcomp_port::{Controller, Description, DeviceError};
use volcomp_vocabulary::{AxisKind, AxisName, Displacement, Um, Urad};

use crate::{
    address::{Address, hosts},
    driver::{
        Block, ControlMemory, ControllerDevice, Driver, GuardRequirements, Inspected, MapDevice,
        MapError, MapWords, PmcPlan, Rules, Settings, USUAL,
    },
    first_config::{FirstConfig, Setting, barrier, includes_correction},
    keys::{ControllerConfig, MapKeys, PmcByte, PmcLetter, PmcTable, Referenced, of_ms},
    probe::{ControlFacts, Facts, Probe},
};

/// Number of exchanges in a probe whose round-trip times are measured.
const TIMED: usize = 100;

/// Interval of frames to a PMC. It is well within every timeout and a small load for the ladder.
const MAP_PERIOD: Duration = Duration::from_millis(50);

impl From<PmcByte> for PmcAddress {
    fn from(PmcByte { pmc, at }: PmcByte) -> Self {
        let area = match pmc {
            PmcLetter::G => PmcArea::G,
            PmcLetter::F => PmcArea::F,
            PmcLetter::R => PmcArea::R,
            PmcLetter::D => PmcArea::D,
        };
        Self { area, at }
    }
}

impl PmcTable {
    fn places(&self, capacity: usize) -> MapPlaces {
        MapPlaces {
            mailbox: self.mailbox.into(),
            report: self.report.into(),
            buffers: self.buffers.into(),
            capacity,
        }
    }
}

pub(crate) const DRIVER: Driver = Driver {
    name: "a FANUC control (focas://)",
    keys: &["referenced"],
    writer_keys: &[
        "includes_correction",
        "unwatched",
        "resolution_um",
        "resolution_urad",
        "area",
        "heartbeat",
        "barrier",
    ],
    map_tables: &["pmc"],
    port: PORT,
    devices: |address| hosts(address, PORT),
    validate,
    controller: |address, own| Ok(Box::new(configured(&address, own)?)),
    validate_map,
    map: |address, keys| {
        let (host, port) = (address.host.clone(), address.port.unwrap_or(PORT));
        let at_most = of_ms(keys.pmc.time_out_ms);
        let places = keys.pmc.places(keys.capacity);
        Ok(MapDevice {
            period: MAP_PERIOD,
            open: Box::new(move || {
                let words = volcomp_focas::MapWords::open(&host, port, at_most, places);
                Ok(Box::new(words.map_err(MapError::of)?))
            }),
        })
    },
    example: "focas://192.0.2.10:8193",
    first: |_, _| first(),
    probe,
    ..USUAL
};

fn first() -> FirstConfig {
    let mut settings = vec![includes_correction(true)];
    settings.extend(barrier(8.0));
    settings.extend([
        Setting::new(
            "barrier.frame",
            "{ pmc = \"R\", at = 200 }",
            "First PMC byte of the gateway's frame to the barrier",
        ),
        Setting::new(
            "barrier.report",
            "{ pmc = \"R\", at = 240 }",
            "First PMC byte of the barrier's report",
        ),
        Setting::new(
            "heartbeat",
            "{ pmc = \"R\", at = 120 }",
            "Instead of the keys of the barrier: PMC byte that the ladder watches; limits corrections to 30 µm",
        )
        .example(),
    ]);
    FirstConfig { cycle_ms: 4.0, settings, ..FirstConfig::default() }
}

fn validate(own: &ControllerConfig, rules: &Rules<'_>, found: &mut Mistakes<'_>) {
    if own.heartbeat.is_some() && own.unwatched {
        found.add(
            &format!("{}.heartbeat", rules.at),
            "found both heartbeat and unwatched = true, expected one of them",
        );
    }
    if let Some(area) = own.area.filter(|area| ![1, 2, 4].contains(&area.width)) {
        let message = format!("found {}, expected 1, 2 or 4 bytes", area.width);
        found.add(&format!("{}.area.width", rules.at), message);
    }
    if own.referenced == Some(Referenced::Not(true)) {
        found.add(
            &format!("{}.referenced", rules.at),
            "found true, expected false or a byte such as { pmc = \"F\", at = 94 }",
        );
    }
    if let Some(barrier) = &own.barrier {
        for (key, byte) in [("frame", barrier.frame), ("report", barrier.report)] {
            if byte.is_none() {
                found.require(&format!("{}.barrier", rules.at), key);
            }
        }
    }
}

fn validate_map(keys: &MapKeys, sizes: [usize; 2], found: &mut Mistakes<'_>) {
    let (pmc, capacity) = (&keys.pmc, keys.capacity);
    found.range("pmc.time_out_ms", pmc.time_out_ms, 10.0..=2000.0);
    for (key, place) in [("mailbox", pmc.mailbox), ("report", pmc.report), ("buffers", pmc.buffers)]
    {
        if !PmcAddress::from(place).area.is_of_ladder() {
            let message =
                format!("found {:?}, expected R or D, the ladder's own memory", place.pmc);
            found.add(&format!("pmc.{key}"), message);
        }
    }
    let places = pmc.places(capacity);
    if !places.fits() {
        let message = format!(
            "found {capacity} words in each of two buffers from {:?}{} on, expected them to end at byte 65535 at the latest",
            places.buffers.area, places.buffers.at
        );
        found.add("capacity", message);
    } else if let Some(what) = overlap(&places, sizes) {
        let message = format!(
            "found {what} in one another's place, expected each of mailbox, report and buffers in its own"
        );
        found.add("pmc", message);
    }
}

impl ControllerDevice for FocasConfig {
    fn describe(&self) -> Result<Description, DeviceError> {
        Self::describe(self).map_err(|error| error.of(self.device()))
    }

    fn open(&self) -> Result<Box<dyn Controller>, DeviceError> {
        Ok(Box::new(FocasController::new(self.clone())?))
    }

    fn settings(&self) -> Settings {
        let axes = self.axes.iter().chain(&self.reads);
        Settings {
            // The resolution of positions is three decimals or, if larger, the step of the corrections.
            position_steps: axes.map(|name| (*name, self.position_step(*name))).collect(),
            ..Settings::default()
        }
    }

    fn inspect(
        &self,
        _needs: Option<&GuardRequirements>,
    ) -> Result<Option<Inspected>, DeviceError> {
        let found = inspect(self).map_err(|error| error.of(self.device()))?;
        let (shift_in_use, shift_words) = match found.shift_source {
            ShiftSource::Reported { in_use, first } => (Some(in_use), Some(first)),
            ShiftSource::Unreported { .. } => (None, None),
        };
        Ok(Some(Inspected {
            axes: found.axes.iter().map(char::to_string).collect(),
            shift_in_use,
            shift_words,
            reports: found.reports,
            notes: found.notes,
            ..Inspected::default()
        }))
    }

    fn overlap(&self) -> Option<[Block; 2]> {
        Some(Self::overlap(self)?.map(Block::from))
    }

    fn overlap_with(&self, other: &dyn Any) -> Option<[Block; 2]> {
        let other = other.downcast_ref::<Self>()?;
        Some(Self::overlap_with(self, other)?.map(Block::from))
    }

    fn memory(&self) -> ControlMemory {
        let plain = self.barrier.is_none() && !self.axes.is_empty();
        let text = |address: PmcAddress| address.to_string();
        let pmc = PmcPlan {
            shift_words: plain.then(|| text(self.shift.first)),
            shift_bytes: plain.then(|| self.shift.width.bytes()),
            copied: plain && self.copied,
            frame: self.barrier.map(|barrier| text(barrier.frame)),
            report: self.barrier.map(|barrier| text(barrier.report)),
            heartbeat: self.heartbeat.filter(|_| plain).map(text),
            referenced: self.referenced.map(text),
        };
        ControlMemory { pmc: Some(pmc) }
    }
}

impl MapWords for volcomp_focas::MapWords {
    fn report(&mut self, count: usize) -> Result<Vec<u16>, MapError> {
        Self::report(self, count).map_err(MapError::of)
    }

    fn write(&mut self, frame: &[u16]) -> Result<(), MapError> {
        Self::write(self, frame).map_err(MapError::of)
    }

    fn buffer(&mut self, buffer: u16, count: usize) -> Result<Vec<u16>, MapError> {
        Self::buffer(self, buffer, count).map_err(MapError::of)
    }
}

/// Names two of the areas mailbox, report and buffers that share bytes; `None` if no areas overlap. [`MapPlaces::fits`]
/// ensures that both buffers end within the addresses of the PMC.
fn overlap(places: &MapPlaces, sizes: [usize; 2]) -> Option<String> {
    let block = |what, first: PmcAddress, words: usize| {
        let end = usize::from(first.at) + 2 * words - 1;
        let at = u16::try_from(end).unwrap_or(u16::MAX);
        volcomp_focas::Block { key: what, what, first, last: PmcAddress { at, ..first } }
    };
    let mailbox = block("mailbox", places.mailbox, sizes[0]);
    let report = block("report", places.report, sizes[1]);
    let buffers = block("buffers", places.buffers, 2 * places.capacity);
    [(mailbox, report), (mailbox, buffers), (report, buffers)]
        .iter()
        .find(|(one, other)| one.shared(other).is_some())
        .map(|(one, other)| format!("{} and {}", one.what, other.what))
}

impl From<volcomp_focas::Block> for Block {
    fn from(block: volcomp_focas::Block) -> Self {
        Self { key: block.key, text: block.to_string(), is_byte: block.first == block.last }
    }
}

fn configured(address: &Address, config: &ControllerConfig) -> Result<FocasConfig, DeviceError> {
    let mut focas = FocasConfig::new(&*address.host, &config.axes);
    focas.port = address.port.unwrap_or(PORT);
    focas.path = address.number("path", [1, 10], 1)?;
    config.only_channel(address, &focas.channel, "a FANUC control")?;
    if let Some(area) = config.area {
        focas.shift.first = PmcByte { pmc: area.pmc, at: area.first }.into();
        focas.shift.width = match area.width {
            1 => Width::Byte,
            4 => Width::Long,
            _ => Width::Word,
        };
        focas.copied = area.copied;
    }
    if let Some(um) = config.resolution_um {
        focas.shift.count_linear = Um(um).to_mm();
    }
    if let Some(urad) = config.resolution_urad {
        focas.shift.count_rotary = Urad(urad).to_rad();
    }
    focas.reads.clone_from(&config.reads);
    focas.heartbeat = config.heartbeat.map(Into::into);
    focas.barrier = config.barrier.and_then(|barrier| {
        let (frame, report) = (barrier.frame?, barrier.report?);
        Some(BarrierArea { frame: frame.into(), report: report.into() })
    });
    match config.referenced {
        None => {}
        Some(Referenced::Not(_)) => focas.referenced = None,
        Some(Referenced::Byte(byte)) => focas.referenced = Some(byte.into()),
    }
    focas.includes_correction = config.includes_correction;
    Ok(focas)
}

fn probe(address: &Address, at_most: Duration) -> Result<Probe, DeviceError> {
    let config = configured(address, &ControllerConfig::default())?;
    let with_device = |error: FocasError| error.of(&*address.text);
    let mut client = Client::open(&config.host, config.port, at_most).map_err(with_device)?;
    let system = client.system_info().map_err(with_device)?;
    let names = client.axis_names().map_err(with_device)?;
    let positions = client.positions(PositionKind::Machine, names.len()).map_err(with_device)?;
    let status = client.status().map_err(with_device)?;
    let (shift_in_use, shift_words, shift_untold) =
        match client.shift_source().map_err(with_device)? {
            ShiftSource::Reported { in_use, first } => (Some(in_use), Some(first), None),
            ShiftSource::Unreported { why } => (None, None, Some(why)),
        };
    let mut times = Vec::new();
    for _ in 0..TIMED {
        let begun = Instant::now();
        client.status().map_err(with_device)?;
        times.push(begun.elapsed());
    }
    times.sort_unstable();
    let microseconds = |time: Duration| (time.as_secs_f64() * 1e6).round();
    let mut probe = Probe::of(&address.text);
    for (name, value) in names.iter().zip(positions) {
        // The control does not report which axes are rotary, so the letter of the axis decides.
        let known = AxisName::from_letter(*name);
        let kind = known.map_or(AxisKind::Linear, AxisName::kind);
        probe.add_position(name.to_string(), Displacement::from_coordinate(kind, value));
    }
    probe.facts = Some(Facts::Control(ControlFacts {
        control: format!("{}{}", system.cnc_type, system.machine_type).trim().to_owned(),
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
