//! Determines in which form a control accepts the requests of a cycle. Nothing is written.

use std::time::Instant;

use volcomp_port::Fault;

use crate::{
    config::FocasConfig,
    error::FocasError,
    plan::{self, Abilities, Ask, Exchange, Packing, PlannedAxis},
    reading::{self, Applied},
    return_code::ReturnCode,
    session::Session,
};

/// Tries the form with the fewest exchanges first; if the control rejects it, determines each ability separately. A request that is rejected in
/// every form is reported with the control's return code.
pub(crate) fn find(
    session: &mut Session,
    config: &FocasConfig,
    axes: &[PlannedAxis],
) -> Result<Abilities, FocasError> {
    let mut asker = Asker {
        session,
        config,
        axes,
    };
    if asker.accepts_all(Abilities::ALL)? {
        return Ok(Abilities::ALL);
    }
    asker.must(Ask::Status)?;
    let all_axes = asker.accepts(Ask::Positions)?;
    if !all_axes {
        asker.must_all(plan::positions(axes, false))?;
    }
    let mut ranges = true;
    for ask in plan::words(config, axes, true) {
        ranges &= asker.accepts(ask)?;
    }
    if !ranges {
        asker.must_all(plan::words(config, axes, false))?;
    }
    asker.must_all(plan::bytes(config))?;
    let mut found = Abilities {
        packing: Packing::OneByOne,
        ranges,
        all_axes,
    };
    for packing in [Packing::OneFrame, Packing::ByTarget] {
        let packed = Abilities { packing, ..found };
        if asker.accepts_all(packed)? {
            found = packed;
            break;
        }
    }
    Ok(found)
}

struct Asker<'a> {
    session: &'a mut Session,
    config: &'a FocasConfig,
    axes: &'a [PlannedAxis],
}

impl Asker<'_> {
    /// True if every frame of a read is answered completely.
    fn accepts_all(&mut self, abilities: Abilities) -> Result<bool, FocasError> {
        let exchanges = plan::reads(self.config, self.axes, abilities)?;
        let asked = "reading all that a cycle needs";
        self.refusal(&exchanges, asked)
            .map(|refused| refused.is_none())
    }

    /// True if a command is answered.
    fn accepts(&mut self, ask: Ask) -> Result<bool, FocasError> {
        self.refusal_of(ask).map(|refused| refused.is_none())
    }

    /// Sends a command that must be answered.
    fn must(&mut self, ask: Ask) -> Result<(), FocasError> {
        self.refusal_of(ask)?.map_or(Ok(()), Err)
    }

    fn must_all(&mut self, asks: impl IntoIterator<Item = Ask>) -> Result<(), FocasError> {
        asks.into_iter().try_for_each(|ask| self.must(ask))
    }

    fn refusal_of(&mut self, ask: Ask) -> Result<Option<FocasError>, FocasError> {
        let exchange = plan::read(self.config, &[ask])?;
        self.refusal(&[exchange], &ask.words(self.config))
    }

    /// Why the control does not answer as required: it rejects the request, or returns less than requested. Everything else is an error, including
    /// a busy control.
    fn refusal(
        &mut self,
        exchanges: &[Exchange<Ask>],
        asked: &str,
    ) -> Result<Option<FocasError>, FocasError> {
        let deadline = Instant::now() + self.config.at_most;
        let applied = Applied::of(self.config);
        let Err(fault) = reading::read(self.session, exchanges, self.axes, applied, deadline)
        else {
            return Ok(None);
        };
        let error = FocasError::asking(asked, fault);
        let busy = matches!(error, FocasError::Refused { code, .. } if code == ReturnCode::BUSY);
        let refused = match fault {
            Fault::Refused { .. } => !busy,
            Fault::Protocol(_) => !self.session.is_dead(),
            _ => false,
        };
        if refused { Ok(Some(error)) } else { Err(error) }
    }
}
