//! Next step of a person for a board in some state.

use r4_protocol::{Causes, SafetyState};

/// Returns the remedy for the first cause; without a cause, the meaning of the state.
#[must_use]
pub fn next_step(state: SafetyState, causes: Causes) -> &'static str {
    match (causes.iter().next(), state) {
        (Some(cause), _) => cause.advice(),
        (None, SafetyState::Armed) => "outputs follow set points",
        (None, SafetyState::Disarmed) => "outputs are safe",
        (None, SafetyState::Tripped) => "outputs are safe; clear it when it is safe to go on",
    }
}

#[cfg(test)]
mod tests {
    use r4_protocol::Cause;

    use super::*;

    #[test]
    fn a_cause_goes_before_the_state() {
        for state in [SafetyState::Disarmed, SafetyState::Armed, SafetyState::Tripped] {
            assert_eq!(next_step(state, Causes::only(Cause::DeadMan)), Cause::DeadMan.advice());
            assert!(next_step(state, Causes::NONE).starts_with("outputs "));
        }
        assert!(next_step(SafetyState::Tripped, Causes::NONE).contains("clear it"));
    }
}
