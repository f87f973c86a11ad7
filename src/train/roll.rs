//! Rolling a policy through episodes, for tests and for `simulate`.

use crate::agent::{Policy, Rule};
use crate::env::{Action, Episodes, Observer};
use crate::rng::Stream;

/// What chooses the actions.
pub enum Chooser {
    /// A decision rule on the inferred context.
    Rule(Rule),
    /// A trained policy with the observations it was trained on.
    Trained {
        /// The policy.
        policy: Box<dyn Policy>,
        /// What it sees.
        observer: Observer,
    },
}

impl Chooser {
    /// An action for every lane; `observations` is room to work in.
    fn choose(
        &self,
        episodes: &Episodes,
        observations: &mut Vec<f32>,
        actions: &mut [Action],
        stream: &mut Stream,
    ) {
        match self {
            Chooser::Rule(rule) => {
                for (action, signal) in actions.iter_mut().zip(episodes.signals()) {
                    *action = rule.choose(signal, stream);
                }
            }
            Chooser::Trained { policy, observer } => {
                observations.resize(episodes.lanes() * observer.width(), 0.0);
                observer.observe(episodes, observations);
                policy.act(observations, actions, stream);
            }
        }
    }
}

/// Rolls episodes from their first step to the end of the last.
///
/// `visit` sees every step: the episodes before it, the actions, and the rewards paid; lanes that
/// have ended are still there and must be told by their endings.
pub fn roll(
    episodes: &mut Episodes,
    chooser: &Chooser,
    environment_stream: &mut Stream,
    action_stream: &mut Stream,
    mut visit: impl FnMut(&Episodes, &[Action], &[f64]),
) {
    let mut observations = Vec::new();
    let mut actions = vec![Action::NONE; episodes.lanes()];
    let mut rewards = vec![0.0; episodes.lanes()];
    while episodes.any_running() {
        chooser.choose(episodes, &mut observations, &mut actions, action_stream);
        let before = episodes.clone();
        episodes.step(&actions, &mut rewards, environment_stream);
        visit(&before, &actions, &rewards);
    }
}
