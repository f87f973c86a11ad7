//! What agents do where no message can be sent: the value of the key `unavailable`.
//!
//! **Source**: trials with sending limits neither choose nor learn at such decision points (Liao et al.,
//! "Personalized HeartSteps", 2020). For policy gradients, this is the masking of invalid actions (Huang
//! and Ontañón, "A closer look at invalid action masking in policy gradient algorithms", 2022); for
//! Q-learning, the maximum over the actions that are possible in the next state.

use crate::env::{Action, VectorEnvironment};
use crate::key::choices;

/// Name of the key.
pub const UNAVAILABLE: &str = "unavailable";

choices! {
    /// What a learning agent does where no message can be sent.
    pub enum Unavailable {
        /// It does not choose: messages are masked. A bandit and a policy learn nothing from the step; values
        /// are learned about action 0, which was taken.
        Masked = "masked",
        /// It chooses, and learns as if its choice had been taken.
        Chosen = "chosen",
    }
}

impl Unavailable {
    /// Whether the agent chooses in a lane.
    pub fn chooses<Env: VectorEnvironment + ?Sized>(self, environment: &Env, lane: usize) -> bool {
        match self {
            Unavailable::Masked => environment.can_send(lane),
            Unavailable::Chosen => true,
        }
    }

    /// The choice of `action` in a lane: action 0 where the agent does not choose. The probabilities of such a
    /// choice, \[actions\], are replaced in place.
    pub fn choice<Env: VectorEnvironment + ?Sized>(
        self,
        environment: &Env,
        lane: usize,
        action: Action,
        probabilities: &mut [f64],
    ) -> Action {
        if self.chooses(environment, lane) {
            return action;
        }
        certain(Action::default(), probabilities);
        Action::default()
    }

    /// Replaces choices that the agent does not make by action 0 with probability 1.
    ///
    /// **Shapes**: `actions` is \[lanes\], `probabilities` is \[lanes, actions\].
    pub fn withhold<Env: VectorEnvironment + ?Sized>(
        self,
        environment: &Env,
        actions: &mut [Action],
        probabilities: &mut [f64],
    ) {
        let rows = probabilities.chunks_exact_mut(probabilities.len() / actions.len());
        for (lane, (action, row)) in actions.iter_mut().zip(rows).enumerate() {
            *action = self.choice(environment, lane, *action, row);
        }
    }
}

/// Writes the probabilities of a choice that is certain.
pub fn certain(action: Action, probabilities: &mut [f64]) {
    probabilities.fill(0.0);
    probabilities[action.index()] = 1.0;
}
