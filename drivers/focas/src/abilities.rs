//! Finding out in which form a control accepts the requests of a cycle. Nothing is written.

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

/// Asks in the form with the fewest exchanges first; where the control refuses it, what it accepts is found out piece by
/// piece. What is refused in every form is told with the control's return code.
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
    /// Whether every frame of a read is answered whole.
    fn accepts_all(&mut self, abilities: Abilities) -> Result<bool, FocasError> {
        let exchanges = plan::reads(self.config, self.axes, abilities)?;
        let asked = "reading all that a cycle needs";
        self.refusal(&exchanges, asked)
            .map(|refused| refused.is_none())
    }

    /// Whether one command is answered.
    fn accepts(&mut self, ask: Ask) -> Result<bool, FocasError> {
        self.refusal_of(ask).map(|refused| refused.is_none())
    }

    /// One command that must be answered.
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

    /// Why the control does not answer as it should: it refuses, or answers less than was asked for. Everything else
    /// is an error, a control that is busy among it.
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
