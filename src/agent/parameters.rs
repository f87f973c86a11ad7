//! The agents' hyper-parameters, as one job holds them: single values, every key present.

use serde::{Deserialize, Serialize};

/// The algorithm of an `[[agent]]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Algorithm {
    /// `dueling_dqn`.
    DuelingDqn,
    /// `reinforce`.
    Reinforce,
    /// `rule`.
    Rule,
}

impl Algorithm {
    /// Every algorithm.
    pub const ALL: [Algorithm; 3] = [Algorithm::DuelingDqn, Algorithm::Reinforce, Algorithm::Rule];

    /// The word that manifests, jobs and the store write.
    pub fn name(self) -> &'static str {
        match self {
            Algorithm::DuelingDqn => "dueling_dqn",
            Algorithm::Reinforce => "reinforce",
            Algorithm::Rule => "rule",
        }
    }
}

/// An algorithm with its hyper-parameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "algorithm", rename_all = "snake_case")]
pub enum Agent {
    /// Dueling deep Q-network with a replay buffer (Mnih et al. 2013; Wang et al. 2016).
    DuelingDqn(DuelingDqn),
    /// Monte-Carlo policy gradient (Williams 1992).
    Reinforce(Reinforce),
    /// A decision rule, which learns nothing: what learners are compared with.
    Rule(DecisionRule),
}

impl Agent {
    /// The algorithm.
    pub fn algorithm(&self) -> Algorithm {
        match self {
            Agent::DuelingDqn(_) => Algorithm::DuelingDqn,
            Agent::Reinforce(_) => Algorithm::Reinforce,
            Agent::Rule(_) => Algorithm::Rule,
        }
    }

    /// Episodes of training: the job's budget. None for a rule.
    pub fn episodes(&self) -> u32 {
        match self {
            Agent::DuelingDqn(agent) => agent.episodes,
            Agent::Reinforce(agent) => agent.episodes,
            Agent::Rule(_) => 0,
        }
    }
}

/// Hyper-parameters of the dueling DQN; the defaults reproduce the published figures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DuelingDqn {
    /// Episodes of training.
    pub episodes: u32,
    /// Widths of the hidden layers, input side first.
    pub layers: Vec<u32>,
    /// Activation of the hidden layers.
    pub activation: Activation,
    /// Whether the state value and the advantages share their hidden layers.
    pub trunk: Trunk,
    /// Adam's step size.
    pub learning_rate: f64,
    /// Discount factor a step, in [0, 1].
    pub gamma: f64,
    /// Transitions in a batch, drawn without replacement; learning starts once as many are stored.
    pub batch: u32,
    /// Most transitions the replay buffer keeps; then the oldest is overwritten.
    pub buffer: u32,
    /// Exploration rate at the start.
    pub epsilon_start: f64,
    /// Decrease of the exploration rate an update.
    pub epsilon_decrement: f64,
    /// Exploration rate at which the decrease stops.
    pub epsilon_floor: f64,
    /// Updates between two copies of the network into the target network.
    pub target_period: u32,
    /// The regression target of a transition that ends its episode.
    pub terminal_target: TerminalTarget,
    /// Which code trains the network.
    pub engine: Engine,
}

impl Default for DuelingDqn {
    fn default() -> Self {
        DuelingDqn {
            episodes: 1000,
            layers: vec![128, 128],
            activation: Activation::Relu,
            trunk: Trunk::Shared,
            learning_rate: 5e-4,
            gamma: 0.99,
            batch: 64,
            buffer: 1_000_000,
            epsilon_start: 1.0,
            epsilon_decrement: 1e-3,
            epsilon_floor: 0.01,
            target_period: 1000,
            terminal_target: TerminalTarget::Zero,
            engine: Engine::Fused,
        }
    }
}

/// Hyper-parameters of REINFORCE; the defaults reproduce the published figures.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reinforce {
    /// Episodes of training: `updates × trajectories_per_update`.
    pub episodes: u32,
    /// Widths of the hidden layers, input side first.
    pub layers: Vec<u32>,
    /// Activation of the hidden layers.
    pub activation: Activation,
    /// Adam's step size.
    pub learning_rate: f64,
    /// Discount factor a step, in [0, 1].
    pub gamma: f64,
    /// Episodes sampled for one update.
    pub trajectories_per_update: u32,
    /// What the summed loss of an update is divided by (the "M = 50" of the published runs).
    pub loss_divisor: f64,
    /// Which code trains the network.
    pub engine: Engine,
}

impl Default for Reinforce {
    fn default() -> Self {
        Reinforce {
            episodes: 15_000,
            layers: vec![128],
            activation: Activation::Relu,
            learning_rate: 6e-4,
            gamma: 0.99,
            trajectories_per_update: 1,
            loss_divisor: 50.0,
            engine: Engine::Fused,
        }
    }
}

/// A decision rule that needs no training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DecisionRule {
    /// Which rule.
    pub rule: Rule,
    /// The least probability of the likelier context at which `Threshold` sends a message, in
    /// [0.5, 1]. Other rules do not read it.
    pub threshold: f64,
}

impl DecisionRule {
    /// A rule, with the threshold 0.8.
    pub fn new(rule: Rule) -> Self {
        DecisionRule { rule, threshold: 0.8 }
    }
}

/// The decision rules. What they know of the context is what the scenario shows of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rule {
    /// No message, ever.
    Never,
    /// A message that is not tailored, always.
    Untailored,
    /// A message tailored to the likelier context, always.
    Tailored,
    /// As `Tailored` where the likelier context is probable enough, else nothing.
    Threshold,
    /// Any action, each equally likely: a micro-randomised trial.
    Random,
    /// What maximises the mean return; the scenario must show habituation and disengagement risk.
    Optimal,
}

/// Activation of a hidden layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Activation {
    /// max(0, x).
    Relu,
    /// Hyperbolic tangent.
    Tanh,
}

/// Whether the two streams of the dueling network share their hidden layers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Trunk {
    /// One stack of hidden layers with two linear heads, as in the published code.
    Shared,
    /// A stack of hidden layers for each head, as the paper's words read.
    Separate,
}

/// The regression target of a transition that ends its episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TerminalTarget {
    /// 0 on any end, time-outs included: the last reward is dropped, as in the published code.
    Zero,
    /// The reward when the episode terminated (disengagement); bootstrapped when it was truncated
    /// (horizon reached).
    Standard,
}

/// Which code performs the training updates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Engine {
    /// Kernels written for these networks: the same arithmetic, many times as fast.
    Fused,
    /// Burn modules with Burn's automatic differentiation and Adam.
    Burn,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_agent_is_written_under_its_algorithms_name() {
        for agent in [
            Agent::DuelingDqn(DuelingDqn::default()),
            Agent::Reinforce(Reinforce::default()),
            Agent::Rule(DecisionRule::new(Rule::Never)),
        ] {
            let json = serde_json::to_value(&agent).unwrap();
            assert_eq!(json["algorithm"], agent.algorithm().name());
        }
    }
}
