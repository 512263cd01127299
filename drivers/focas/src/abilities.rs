use std::time::Instant;

use volcomp_port::Fault;

use crate::{
    config::FocasConfig,
    error::FocasError,
    plan::{self, Abilities, Exchange, Packing, PlannedAxis, ReadItem},
    reading::{self, Applied},
    return_code::ReturnCode,
    session::Session,
};

/// Finds the request forms that the control accepts in a cycle. Sends only read requests. The form with the fewest
/// exchanges is tried first; if it is rejected, each ability is tried separately.
///
/// Errors: a request that is rejected in every form, with the control's return code.
pub(crate) fn find(
    session: &mut Session,
    config: &FocasConfig,
    axes: &[PlannedAxis],
) -> Result<Abilities, FocasError> {
    let mut probe = FormProbe { session, config, axes };
    if probe.accepts_all(Abilities::ALL)? {
        return Ok(Abilities::ALL);
    }
    probe.require(ReadItem::Status)?;
    let all_axes = probe.accepts(ReadItem::Positions)?;
    if !all_axes {
        probe.require_all(plan::positions(axes, false))?;
    }
    let mut ranges = true;
    for item in plan::words(config, axes, true) {
        ranges &= probe.accepts(item)?;
    }
    if !ranges {
        probe.require_all(plan::words(config, axes, false))?;
    }
    probe.require_all(plan::bytes(config))?;
    let mut found = Abilities { packing: Packing::OneByOne, ranges, all_axes };
    for packing in [Packing::OneFrame, Packing::ByTarget] {
        let packed = Abilities { packing, ..found };
        if probe.accepts_all(packed)? {
            found = packed;
            break;
        }
    }
    Ok(found)
}

struct FormProbe<'a> {
    session: &'a mut Session,
    config: &'a FocasConfig,
    axes: &'a [PlannedAxis],
}

impl FormProbe<'_> {
    fn accepts_all(&mut self, abilities: Abilities) -> Result<bool, FocasError> {
        let exchanges = plan::reads(self.config, self.axes, abilities)?;
        let request = "reading all that a cycle needs";
        self.refusal(&exchanges, request).map(|refused| refused.is_none())
    }

    fn accepts(&mut self, item: ReadItem) -> Result<bool, FocasError> {
        self.refusal_of(item).map(|refused| refused.is_none())
    }

    fn require(&mut self, item: ReadItem) -> Result<(), FocasError> {
        self.refusal_of(item)?.map_or(Ok(()), Err)
    }

    fn require_all(&mut self, items: impl IntoIterator<Item = ReadItem>) -> Result<(), FocasError> {
        items.into_iter().try_for_each(|item| self.require(item))
    }

    fn refusal_of(&mut self, item: ReadItem) -> Result<Option<FocasError>, FocasError> {
        let exchange = plan::read(self.config, &[item])?;
        self.refusal(&[exchange], &item.words(self.config))
    }

    /// Sends read requests. Returns `None` if the control answers all of them, or the error if it rejects one or
    /// returns less data than requested. Fails on any other failure, such as a busy control.
    fn refusal(
        &mut self,
        exchanges: &[Exchange<ReadItem>],
        request: &str,
    ) -> Result<Option<FocasError>, FocasError> {
        let deadline = Instant::now() + self.config.at_most;
        let applied = Applied::of(self.config);
        let Err(fault) = reading::read(self.session, exchanges, self.axes, applied, deadline)
        else {
            return Ok(None);
        };
        let error = FocasError::in_request(request, fault);
        let busy = matches!(error, FocasError::Refused { code, .. } if code == ReturnCode::BUSY);
        let refused = match fault {
            Fault::Refused { .. } => !busy,
            Fault::Protocol(_) => !self.session.is_dead(),
            _ => false,
        };
        if refused { Ok(Some(error)) } else { Err(error) }
    }
}
