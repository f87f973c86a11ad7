//! The intervention options of the paper, as actions.

use crate::env::Action;

/// The number of intervention options.
pub const OPTIONS: usize = 4;

/// The intervention options of the paper (table 1).
impl Action {
    /// The intervention option of this number; `None` above 3.
    pub fn option(number: usize) -> Option<Action> {
        Action::from_index(number).filter(|_| number < OPTIONS)
    }

    /// Send nothing.
    pub const NONE: Action = Action(0);
    /// Send an untailored message.
    pub const UNTAILORED: Action = Action(1);

    /// Send a message tailored to this context, 0 or 1.
    pub fn tailored_to(context: u8) -> Action {
        debug_assert!(context < 2);
        Action(context + 2)
    }
}
