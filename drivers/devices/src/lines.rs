//! One axis on digital lines of any port: the table `[controller.digital]`.

use std::time::Duration;

use volcomp_digital_io::{
    Coherence, CorrectionWord, DigitalAxis, DigitalController, PositionWord, Wiring,
};
use volcomp_document::Mistakes;
use volcomp_port::{Controller, Description, DeviceError, DigitalIo, UnopenedLines};
use volcomp_vocabulary::{AxisKind, AxisName, Deg, Displacement};

use crate::{
    address::Address,
    driver::{Configured, ControllerDevice, Driver, Rules, Settings, Travels, USUAL},
    first_config::{FirstConfig, FirstMachine, Setting, includes_correction, unseen, unwatched},
    keys::{ControllerConfig, DigitalConfig, PLAIN_KEYS, has_axis, of_ms},
};

/// Driver fields that all ports with digital lines share.
pub(crate) const LINES: Driver = Driver {
    name: "digital lines (gpio://, modbus://, modbus-rtu://)",
    keys: &["digital"],
    writer_keys: PLAIN_KEYS,
    validate,
    complete: |own, _| _ = own.digital.get_or_insert_default(),
    ..USUAL
};

/// First configuration for one axis on these lines. The position step is that of the default words, 1/32 mm or 1/128
/// deg, doubled until the word covers the travel of the axis.
pub(crate) fn first(
    lines: Option<UnopenedLines>,
    code: &str,
    machine: &FirstMachine<'_>,
) -> FirstConfig {
    // Each cycle has two readings and one write.
    const EXCHANGES: u32 = 3;
    const MM_PER_COUNT: f64 = 1.0 / 32.0;
    const DEG_PER_COUNT: f64 = 1.0 / 128.0;
    let usual = DigitalConfig::default();
    let (inputs, outputs, shortest) = lines.map_or((32, 32, Duration::ZERO), |lines| {
        let cycle = lines.shortest_cycle * EXCHANGES;
        (lines.inputs, lines.outputs, cycle)
    });
    let bits = usual.position_bits.min(inputs);
    let mut settings = vec![
        includes_correction(false),
        unwatched(),
        unseen(),
        Setting::new(
            "digital.position_bits",
            bits,
            "Number of position lines, lowest bit first: 0 to 32",
        ),
        Setting::text(
            "digital.position_code",
            code,
            "Code of the position: \"binary\" or \"gray\"",
        ),
    ];
    let axis = machine.axes.first();
    if let Some((axis, travel)) = axis.and_then(|axis| Some((axis, machine.travel_of(*axis)?))) {
        let [low, high] = travel.map(Displacement::mm_or_deg);
        let (step, zero, meaning, mut count) = match axis.kind() {
            AxisKind::Linear => (
                "digital.position_mm_per_count",
                "digital.position_zero_mm",
                "One count of the position, mm: as set in the control",
                MM_PER_COUNT,
            ),
            AxisKind::Rotary => (
                "digital.position_deg_per_count",
                "digital.position_zero_deg",
                "One count of the position, deg: as set in the control",
                DEG_PER_COUNT,
            ),
        };
        let counts = f64::from(bits).exp2() - 1.0;
        while bits > 0 && count * counts < high - low {
            count *= 2.0;
        }
        settings.push(Setting::number(step, count, meaning));
        settings.push(Setting::number(
            zero,
            low,
            "Position at count 0, mm (deg for a rotary axis): as set in the control",
        ));
    }
    settings.push(Setting::new(
        "digital.correction_bits",
        usual.correction_bits.min(outputs),
        "Number of correction lines: 0 to 32",
    ));
    FirstConfig {
        cycle_ms: (shortest.as_secs_f64() * 1e3).ceil().max(4.0),
        settings,
        shows_one_axis: true,
        ..FirstConfig::default()
    }
}

/// Default correction step of a rotary axis.
const LINE_STEP: Deg = Deg(1e-3);

/// Checks the table `digital`, and that a latch is configured if the barrier needs its edges.
fn validate(own: &ControllerConfig, rules: &Rules<'_>, found: &mut Mistakes<'_>) {
    latch(own, rules, found);
    let Some(digital) = &own.digital else {
        return;
    };
    let key = |name: &str| format!("{}.digital.{name}", rules.at);
    let axes: Vec<AxisName> = own.shown().collect();
    found.whole(&key("position_bits"), digital.position_bits, 0..=32);
    found.whole(&key("correction_bits"), digital.correction_bits, 0..=32);
    let (mm, mm_zero) = (digital.position_mm_per_count, digital.position_zero_mm);
    let (deg, deg_zero) = (digital.position_deg_per_count, digital.position_zero_deg);
    for (kind, unit, step, zero) in
        [(AxisKind::Linear, "mm", mm, mm_zero), (AxisKind::Rotary, "deg", deg, deg_zero)]
    {
        for (name, number, range) in [
            (format!("position_{unit}_per_count"), step, 1e-6..=100.0),
            (format!("position_zero_{unit}"), zero, -1e6..=1e6),
        ] {
            let key = key(&name);
            if let Some(number) = number {
                if found.states(&key) {
                    has_axis(&key, kind, &axes, found);
                }
                found.range(&key, number, range);
            }
        }
    }
    if let Some(latch) = digital.latch {
        found.whole(&key("latch"), latch, 0..=63);
    }
    if let Some(time_out_ms) = digital.time_out_ms {
        found.range(&key("time_out_ms"), time_out_ms, 10.0..=600_000.0);
        if !found.states(&key("latch")) {
            found.add(
                &key("time_out_ms"),
                "found this key without latch, expected it only where the control sees edges of a latch that may fail to come",
            );
        }
    }
}

/// Reports an error for a controller that corrects axes on digital lines without `latch` and without a barrier, if
/// another controller has a barrier. A barrier reads correction words from digital lines only at an edge of the latch.
fn latch(own: &ControllerConfig, rules: &Rules<'_>, found: &mut Mistakes<'_>) {
    let latch = own.digital.and_then(|digital| digital.latch);
    if rules.has_barrier && own.barrier.is_none() && !own.axes.is_empty() && latch.is_none() {
        found.add(
            &format!("{}.digital.latch", rules.at),
            format!(
                "missing for {}, expected the line that the gateway turns once the word has settled: the barrier of the control takes words of lines at its edges only",
                own.url
            ),
        );
    }
}

impl ControllerConfig {
    /// Position and correction words of one axis on digital lines. For a rotary axis the step must be configured,
    /// because the default step is a length.
    ///
    /// # Errors
    /// A missing key.
    pub fn digital_axis(&self, name: AxisName) -> Result<DigitalAxis, DeviceError> {
        let (kind, digital) = (name.kind(), self.digital.unwrap_or_default());
        let (step, zero) = match kind {
            AxisKind::Linear => (digital.position_mm_per_count, digital.position_zero_mm),
            AxisKind::Rotary => (digital.position_deg_per_count, digital.position_zero_deg),
        };
        let stated = step.map(|step| Displacement::from_coordinate(kind, step));
        let published = Some(PositionWord::PUBLISHED.step).filter(|step| step.kind() == kind);
        let step = stated.or(published).ok_or_else(|| {
            let found = format!(
                "[[controller]]: digital.position_deg_per_count: missing, expected a number, since axis {name} is rotary"
            );
            DeviceError::option(&*self.url, found, "state it")
        })?;
        let correction_step = self.resolution(kind).unwrap_or(match kind {
            AxisKind::Linear => CorrectionWord::PUBLISHED.step,
            AxisKind::Rotary => Displacement::Angle(LINE_STEP.to_rad()),
        });
        Ok(DigitalAxis {
            position: PositionWord {
                bits: digital.position_bits,
                code: digital.position_code,
                step,
                zero: Displacement::from_coordinate(kind, zero.unwrap_or(0.0)),
            },
            correction: CorrectionWord {
                bits: digital.correction_bits,
                code: digital.correction_code,
                step: correction_step,
            },
            includes_correction: self.includes_correction,
            ..DigitalAxis::published(name)
        })
    }
}

struct Lines<D> {
    address: Address,
    open: fn(&Address) -> Result<D, DeviceError>,
    unopened: fn(&Address) -> Result<UnopenedLines, DeviceError>,
    channel: String,
    wiring: Wiring,
    coherence: Coherence,
    axis: DigitalAxis,
    time_out: Option<Duration>,
}

/// Creates a controller of one axis on the lines of a port. Errors: more than one axis, a missing key.
pub(crate) fn controller<D: DigitalIo + 'static>(
    address: Address,
    config: &ControllerConfig,
    open: fn(&Address) -> Result<D, DeviceError>,
    unopened: fn(&Address) -> Result<UnopenedLines, DeviceError>,
) -> Configured {
    let mut names = config.shown();
    let (Some(name), None) = (names.next(), names.next()) else {
        let what = format!(
            "axes: found {} axes, expected one: these lines carry one position",
            config.axes.len() + config.reads.len()
        );
        return Err(DeviceError::option(&*config.url, what, "name one axis"));
    };
    let words = config.digital.unwrap_or_default();
    let axis = config.digital_axis(name)?;
    Ok(Box::new(Lines {
        address,
        open,
        unopened,
        channel: config.channel_or("digital"),
        wiring: Wiring {
            position: (0..words.position_bits).collect(),
            correction: (0..words.correction_bits).collect(),
            latch: words.latch,
            ..Wiring::default()
        },
        coherence: words.coherence,
        axis,
        time_out: words.time_out_ms.map(of_ms),
    }))
}

impl<D> Lines<D> {
    fn on<P: DigitalIo>(&self, io: P) -> Result<DigitalController<P>, DeviceError> {
        DigitalController::new(
            io,
            self.channel.clone(),
            self.wiring.clone(),
            self.coherence,
            vec![self.axis],
        )
    }
}

impl<D: DigitalIo + 'static> ControllerDevice for Lines<D> {
    fn describe(&self) -> Result<Description, DeviceError> {
        let lines = self.on((self.unopened)(&self.address)?)?;
        Ok(lines.description().clone())
    }

    fn open(&self) -> Result<Box<dyn Controller>, DeviceError> {
        Ok(Box::new(self.on((self.open)(&self.address)?)?))
    }

    fn settings(&self) -> Settings {
        Settings {
            position_steps: [(self.axis.name, self.axis.position.step)].into(),
            is_coarse: true,
            time_out: self.time_out,
            ..Settings::default()
        }
    }

    fn check_travel(&self, travel: &Travels<'_>) -> Result<(), DeviceError> {
        let axis = &self.axis;
        let Some(travel) = travel(axis.name) else {
            return Ok(());
        };
        let ends = travel.map(Displacement::mm_or_rad);
        axis.position.check_travel(ends).map_err(|beyond| {
            let found = format!("axis {}: {beyond}", axis.name);
            let keys = match axis.name.kind() {
                AxisKind::Linear => "position_mm_per_count or position_zero_mm",
                AxisKind::Rotary => "position_deg_per_count or position_zero_deg",
            };
            let remedy = format!("state other [controller.digital] position_bits, {keys}");
            self.address.wrong(found, remedy).caused_by(beyond)
        })
    }
}
