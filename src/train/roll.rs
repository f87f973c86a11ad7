//! Rolling a policy through episodes, for tests and for `simulate`.

use crate::agent::{Policy, RulePolicy};
use crate::env::{Action, Episodes, Observations, Observer};
use crate::rng::{Purpose, Stream};

/// What chooses the actions.
pub enum Chooser {
    /// A decision rule.
    Rule(RulePolicy),
    /// A trained policy with the observations it was trained on.
    Trained {
        /// The policy.
        policy: Box<dyn Policy>,
        /// What it sees.
        observer: Observer,
        /// Room for what it sees.
        observations: Observations,
    },
}

impl Chooser {
    /// A trained policy with the observations it was trained on.
    pub fn trained(policy: Box<dyn Policy>, observer: Observer) -> Self {
        let observations = observer.observations();
        Chooser::Trained { policy, observer, observations }
    }

    /// An action for every lane.
    fn choose(&mut self, episodes: &Episodes, actions: &mut [Action], stream: &mut Stream) {
        match self {
            Chooser::Rule(rule) => {
                for (lane, action) in actions.iter_mut().enumerate() {
                    *action = rule.choose(episodes, lane, stream);
                }
            }
            Chooser::Trained { policy, observer, observations } => {
                observer.observe(episodes, observations);
                policy.act(observations, actions, stream);
            }
        }
    }

    /// The probability with which it chooses these actions, \[lanes\], in the present step.
    pub fn probabilities(&mut self, episodes: &Episodes, actions: &[Action]) -> Vec<f64> {
        match self {
            Chooser::Rule(rule) => vec![rule.probability(); actions.len()],
            Chooser::Trained { policy, observer, observations } => {
                observer.observe(episodes, observations);
                policy.probabilities(observations, actions)
            }
        }
    }
}

/// The random streams of a test.
#[derive(Clone, Debug)]
pub struct TestStreams {
    /// Contexts and their features.
    pub environment: Stream,
    /// The choice among actions.
    pub actions: Stream,
}

impl TestStreams {
    /// The streams of a seed, at their start.
    pub fn new(seed: u64) -> Self {
        TestStreams {
            environment: Stream::new(seed, Purpose::TestEnvironment),
            actions: Stream::new(seed, Purpose::TestActions),
        }
    }
}

/// Whoever looks at every step of a roll. Lanes that have ended are still shown; their endings
/// tell them.
pub trait Watch {
    /// Sees the state of a step with the actions chosen in it, and who chose them.
    fn chosen(&mut self, episodes: &Episodes, actions: &[Action], chooser: &mut Chooser);

    /// Sees the rewards paid, 0 in lanes that had ended, and the state after the step.
    fn paid(&mut self, episodes: &Episodes, rewards: &[f64]);

    /// Whether the roll should be broken off before the next step.
    fn stop_requested(&self) -> bool {
        false
    }
}

/// Rolls episodes from their first step to the end of the last, unless the watcher stops it.
pub fn roll(
    episodes: &mut Episodes,
    chooser: &mut Chooser,
    streams: &mut TestStreams,
    watch: &mut impl Watch,
) {
    let mut actions = vec![Action::NONE; episodes.lanes()];
    let mut rewards = vec![0.0; episodes.lanes()];
    while episodes.any_running() && !watch.stop_requested() {
        chooser.choose(episodes, &mut actions, &mut streams.actions);
        watch.chosen(episodes, &actions, chooser);
        episodes.step(&actions, &mut rewards, &mut streams.environment);
        watch.paid(episodes, &rewards);
    }
}
