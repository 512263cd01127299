//! When a request to the guards has taken effect, and what to say when it has not.

use volcomp_guard::{End, Request, State};

/// Whether a state is what a request asks for.
pub(super) fn has_taken(request: Request, state: State) -> bool {
    match request {
        Request::Arm | Request::TakeOver | Request::Switched => state.is_armed(),
        Request::Disarm | Request::End => !state.is_armed(),
        Request::Acknowledge => !matches!(state, State::Faulted(_)),
    }
}

/// Why a request has not taken effect, in words; the reasons of the state say what stands against it.
pub(super) fn refusal(request: Request, state: State) -> &'static str {
    match (request, state) {
        (Request::Acknowledge, _) => {
            "still faulted: a fault ends when no interlock stands against it and it is known what the control applies"
        }
        (Request::Disarm | Request::End, _) => "not disarmed yet",
        (_, State::Faulted(_)) => "not armed: acknowledge the fault first",
        (_, State::RampingOut(End::Disarmed)) => {
            "not armed: the correction still ramps to zero, and something stands against arming"
        }
        _ => "not armed: something stands against it",
    }
}

#[cfg(test)]
mod tests {
    use super::has_taken;
    use volcomp_guard::{Cause, End, Hold, Phase, Request, State};

    /// Every state with every request: whether the request has what it asks for.
    #[test]
    fn every_state_and_every_request() {
        let [arm, disarm, acknowledge] = [Request::Arm, Request::Disarm, Request::Acknowledge];
        // State, then whether it is armed, disarmed, without a fault.
        let table = [
            (State::Disarmed, [false, true, true]),
            (State::Arming(Phase::Proving), [true, false, true]),
            (State::Arming(Phase::Ramping), [true, false, true]),
            (State::Compensating, [true, false, true]),
            (State::Holding(Hold::Stale), [true, false, true]),
            (State::Holding(Hold::Lost), [true, false, true]),
            (State::Holding(Hold::Interlocked), [true, false, true]),
            (State::Holding(Hold::Unconfirmed), [true, false, true]),
            (State::RampingOut(End::Disarmed), [false, true, true]),
            // It corrects again by itself when positions come back.
            (State::RampingOut(End::Lost), [true, false, true]),
            (State::Faulted(Cause::DoesNotStick), [false, true, false]),
            (State::Faulted(Cause::Contradiction), [false, true, false]),
            (State::Faulted(Cause::BeyondLimit), [false, true, false]),
            (State::Faulted(Cause::OtherGateway), [false, true, false]),
        ];
        for (state, expected) in table {
            let found = [arm, disarm, acknowledge].map(|request| has_taken(request, state));
            assert_eq!(found, expected, "{state:?}");
        }
    }
}
