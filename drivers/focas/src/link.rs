//! An open session with the requests of a cycle, in the form that the control accepts.

use std::time::Instant;

use volcomp_port::{Fault, Snapshot};
use volcomp_vocabulary::PerChannel;

use crate::{
    abilities,
    client::Client,
    config::FocasConfig,
    error::FocasError,
    plan::{self, Abilities, Ask, Exchange, Part, PlannedAxis},
    pmc::Width,
    reading,
    session::Session,
    shift_words::put,
};

/// An open session with the requests of a cycle.
pub(crate) struct Link {
    session: Session,
    abilities: Abilities,
    axes: Vec<PlannedAxis>,
    width: Width,
    reads: Vec<Exchange<Ask>>,
    writes: Vec<Exchange<Part>>,
    /// The heartbeat that is on the control: what was written or, before that, read.
    heartbeat: Option<u8>,
    /// The last number of the sequence: what was written or, before that, read.
    sequence: u8,
}

impl Link {
    /// Opens a session, finds the axes on the control and the form in which it accepts requests.
    pub(crate) fn open(config: &FocasConfig) -> Result<Self, FocasError> {
        let client = Client::open(&config.host, config.port, config.at_most)?;
        let mut client = client.with_path(config.path);
        let axes = find_axes(config, &client.axis_names()?)?;
        let sequence = match config.sequence {
            // Goes on where it stands, so that the ladder sees the first correction, too.
            Some(address) => client.read_pmc(address.area, address.at, 1)?,
            None => Vec::new(),
        };
        let mut session = client.into_session();
        let abilities = abilities::find(&mut session, config, &axes)?;
        Ok(Self {
            reads: plan::reads(config, &axes, abilities)?,
            writes: plan::writes(config, &axes, abilities)?,
            session,
            abilities,
            axes,
            width: config.shift.width,
            heartbeat: None,
            sequence: sequence.first().copied().unwrap_or(0),
        })
    }

    pub(crate) fn abilities(&self) -> Abilities {
        self.abilities
    }

    /// Whether a new session is needed.
    pub(crate) fn is_dead(&self) -> bool {
        self.session.is_dead()
    }

    pub(crate) fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault> {
        let (session, width) = (&mut self.session, self.width);
        let reading = reading::read(session, &self.reads, &self.axes, width, deadline)?;
        // Nobody else may move the heartbeat.
        let before = self.heartbeat;
        self.heartbeat = reading.heartbeat.or(before);
        match (before, reading.heartbeat) {
            (Some(before), Some(found)) if before != found => Err(Fault::OtherGateway),
            _ => Ok(reading.snapshot),
        }
    }

    pub(crate) fn apply(
        &mut self,
        corrections: &PerChannel<f64>,
        deadline: Instant,
    ) -> Result<(), Fault> {
        let beat = self.heartbeat.unwrap_or(0).wrapping_add(1);
        self.sequence = self.sequence.wrapping_add(1);
        for exchange in &mut self.writes {
            for (command, part) in exchange.parts.iter().enumerate() {
                let into = exchange.request.data_mut(command);
                let byte = match *part {
                    Part::Heartbeat(_) => beat,
                    Part::Sequence(_) => self.sequence,
                    Part::Shifts(run) => {
                        for (axis, correction) in self.axes.iter().zip(corrections) {
                            let bytes = run.bytes_of(axis.slot, self.width);
                            if let Some(into) = bytes.and_then(|bytes| into.get_mut(bytes)) {
                                put(into, self.width, correction / axis.count);
                            }
                        }
                        continue;
                    }
                };
                if let Some(into) = into.first_mut() {
                    *into = byte;
                }
            }
            let has_heartbeat = exchange
                .parts
                .iter()
                .any(|part| matches!(part, Part::Heartbeat(_)));
            if has_heartbeat {
                // Until it is known whether the control took it: then nobody else has moved it.
                self.heartbeat = None;
            }
            for block in self.session.exchange(&exchange.request, deadline)? {
                reading::data(block)?;
            }
            if has_heartbeat {
                self.heartbeat = Some(beat);
            }
        }
        Ok(())
    }
}

/// The axes of the configuration among those of the control.
fn find_axes(config: &FocasConfig, names: &[char]) -> Result<Vec<PlannedAxis>, FocasError> {
    let planned = |name: &volcomp_vocabulary::AxisName| {
        let slot = names.iter().position(|found| *found == name.letter());
        Ok(PlannedAxis {
            slot: slot.ok_or_else(|| FocasError::NoAxis {
                name: *name,
                found: names.iter().collect(),
            })?,
            kind: name.kind(),
            count: config.shift.count(name.kind()).mm_or_rad(),
        })
    };
    let axes: Vec<PlannedAxis> = config
        .axes
        .iter()
        .map(planned)
        .collect::<Result<_, FocasError>>()?;
    // The control may have axes before those that are corrected: its words then reach further than the description knew.
    let slots = axes.iter().map(|axis| axis.slot + 1).max().unwrap_or(0);
    config.check_addresses(slots)?;
    Ok(axes)
}
