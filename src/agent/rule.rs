//! Decision rules that need no training, with which researchers compare agents.

use crate::agent::actor::Actor;
use crate::agent::unavailable::certain;
use crate::env::{
    Action, Belief, ContextDraw, EpisodeStatus, FirstContext, OPTIONS, PhysicalActivity, Scenario,
    Simulated, StepCount, StepCountModel, VectorEnvironment,
};
use crate::key::{KeyType, Keyed, Kind, choices, keys};
use crate::optimum::{NoOptimum, OptimalPolicy};
use crate::rng::Stream;
use crate::state::resumable;

keys! {
    /// A decision rule that needs no training.
    pub struct RuleParameters {
        /// the rule: "never" sends nothing, "tailored" tailors to the likelier context, "threshold"
        /// does so only if that context is probable enough, "optimal" maximises the mean return less the cost of
        /// messages, "recorded" repeats the actions of a trial that happened
        rule: DecisionRule;
        /// minimum probability of the likelier context at which "threshold" sends a message
        threshold: f64 = 0.8, in Kind::Real { min: 0.5, max: 1.0 };
    }
}

impl RuleParameters {
    /// A rule, with the default threshold.
    pub fn new(rule: DecisionRule) -> Self {
        RuleParameters::with_required(&[rule.to_value()])
    }
}

choices! {
    /// The decision rules. They see the context only as the scenario shows it.
    pub enum DecisionRule {
        /// Never sends a message.
        Never = "never",
        /// Always sends a message that is not tailored.
        Untailored = "untailored",
        /// Always sends a message tailored to the likelier context.
        Tailored = "tailored",
        /// As `Tailored` if the likelier context is probable enough; otherwise sends nothing.
        Threshold = "threshold",
        /// Chooses among all actions with equal probability, as in a micro-randomised trial.
        Random = "random",
        /// Maximises the mean return; the scenario must show habituation and disengagement
        /// risk.
        Optimal = "optimal",
        /// Takes the actions of a recorded trial, with the recorded probabilities.
        Recorded = "recorded",
    }
}

/// The actor of a decision rule. A rule sees the context as its scenario shows it; only the optimal
/// rule also uses habituation, disengagement risk and time.
#[derive(Clone, Debug)]
pub struct RulePolicy {
    choice: Choice,
    belief: Belief,
}

/// What a rule knows of a lane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RuleState {
    /// The context; the rule sees it as its scenario shows it.
    pub context: ContextDraw,
    /// Steps taken in the episode.
    pub time: u32,
    /// Habituation.
    pub habituation: f64,
    /// Disengagement risk.
    pub disengagement: f64,
    /// Whether the episode has ended.
    pub status: EpisodeStatus,
}

impl RuleState {
    /// The state of a lane.
    fn of(lanes: &PhysicalActivity, lane: usize) -> RuleState {
        RuleState {
            context: lanes.context(lane),
            time: lanes.times()[lane],
            habituation: lanes.habituation()[lane],
            disengagement: lanes.disengagement()[lane],
            status: lanes.statuses()[lane],
        }
    }
}

#[derive(Clone, Debug)]
enum Choice {
    Always(Action),
    Tailored,
    Threshold(f64),
    Random,
    Recorded,
    Optimal(Box<OptimalPolicy>),
}

impl RulePolicy {
    /// The rule in an environment, for a scenario. Computing the optimal rule takes a moment.
    ///
    /// **Errors**: the rule is the optimal one, and the optimum cannot be computed.
    pub fn new(
        rule: &RuleParameters,
        environment: &StepCount,
        scenario: &Scenario,
    ) -> Result<Self, NoOptimum> {
        let choice = match rule.rule {
            DecisionRule::Never => Choice::Always(Action::NONE),
            DecisionRule::Untailored => Choice::Always(Action::UNTAILORED),
            DecisionRule::Tailored => Choice::Tailored,
            DecisionRule::Threshold => Choice::Threshold(rule.threshold),
            DecisionRule::Random => Choice::Random,
            DecisionRule::Recorded => Choice::Recorded,
            DecisionRule::Optimal => {
                Choice::Optimal(Box::new(OptimalPolicy::new(environment, scenario)?))
            }
        };
        Ok(RulePolicy { choice, belief: belief(rule, environment, scenario) })
    }

    /// This rule for a population in which `widest` has the most noise. If contexts are certain for
    /// the environment's own parameters, the rule uses the belief under `widest` instead.
    pub fn among(self, widest: &StepCount, scenario: &Scenario) -> Self {
        match self.belief {
            Belief::Certain => RulePolicy { belief: Belief::new(widest, scenario), ..self },
            _ => self,
        }
    }

    /// The rule that always takes one action.
    pub fn fixed(action: Action) -> Self {
        RulePolicy { choice: Choice::Always(action), belief: Belief::Certain }
    }

    /// The rule in an environment of any family; `None` if it acts on the state of the simulation.
    pub fn anywhere(rule: DecisionRule) -> Option<Self> {
        let choice = match rule {
            DecisionRule::Never => Choice::Always(Action::NONE),
            DecisionRule::Random => Choice::Random,
            DecisionRule::Recorded => Choice::Recorded,
            DecisionRule::Untailored
            | DecisionRule::Tailored
            | DecisionRule::Threshold
            | DecisionRule::Optimal => return None,
        };
        Some(RulePolicy { choice, belief: Belief::Certain })
    }

    /// Whether the rule acts on the state of the simulation.
    pub fn needs_state(&self) -> bool {
        match self.choice {
            Choice::Always(_) | Choice::Random | Choice::Recorded => false,
            Choice::Tailored | Choice::Threshold(_) | Choice::Optimal(_) => true,
        }
    }

    /// The action among `count` in a lane. The random rule draws from the stream once.
    pub fn choose(&self, state: &RuleState, count: usize, stream: &mut Stream) -> Action {
        let zero = self.belief.probability_of_zero(&state.context);
        let tailored = Action::tailored_to(u8::from(zero < 0.5));
        match &self.choice {
            Choice::Always(action) => *action,
            Choice::Tailored => tailored,
            Choice::Threshold(least) if zero.max(1.0 - zero) >= *least => tailored,
            Choice::Threshold(_) | Choice::Recorded => Action::NONE,
            Choice::Random => Action::uniform(stream.bits(), count),
            // After the end of an episode, nothing remains to plan.
            Choice::Optimal(_) if state.status != EpisodeStatus::Running => Action::NONE,
            Choice::Optimal(policy) => {
                policy.choose(state.time, zero, state.habituation, state.disengagement)
            }
        }
    }

    /// Writes the probabilities of the actions, of which the rule chose `action`.
    pub fn write_probabilities(&self, action: Action, probabilities: &mut [f64]) {
        match self.choice {
            Choice::Random => probabilities.fill(1.0 / probabilities.len() as f64),
            Choice::Always(_)
            | Choice::Tailored
            | Choice::Threshold(_)
            | Choice::Recorded
            | Choice::Optimal(_) => {
                certain(action, probabilities);
            }
        }
    }
}

/// What the rule knows about the context. The threshold compares the probability that the scenario shows, also
/// where the other steps leave no doubt: a fixed first context has the probability 0.5.
fn belief(rule: &RuleParameters, environment: &StepCount, scenario: &Scenario) -> Belief {
    match rule.rule {
        DecisionRule::Threshold if scenario.shows_probability_alone() => {
            Belief::Inferred { sigma: environment.sigma }
        }
        _ => Belief::new(environment, scenario),
    }
}

impl RuleParameters {
    /// Whether earlier versions of the rule had other results: the threshold sent a message in the first step if all
    /// other contexts are certain, and the optimal rule ignored the cost of messages. `widest` is the environment
    /// with the largest noise of any participant.
    pub(super) fn acts_otherwise(&self, model: &StepCountModel, scenario: &Scenario) -> bool {
        let environment = &model.parameters;
        let is_certain = |of: &StepCount| Belief::new(of, scenario) == Belief::Certain;
        match self.rule {
            DecisionRule::Threshold => {
                self.threshold > 0.5
                    && scenario.shows_probability_alone()
                    && environment.first_context == FirstContext::Fixed
                    && is_certain(environment)
                    && is_certain(&model.widest())
            }
            DecisionRule::Optimal => environment.message_cost > 0.0,
            DecisionRule::Never
            | DecisionRule::Untailored
            | DecisionRule::Tailored
            | DecisionRule::Random
            | DecisionRule::Recorded => false,
        }
    }
}

/// A rule reads the state of the simulation in f64, but the context only as its scenario shows it.
impl Actor<PhysicalActivity> for RulePolicy {
    fn act(
        &mut self,
        environment: &PhysicalActivity,
        stream: &mut Stream,
        actions: &mut [Action],
        probabilities: Option<&mut [f64]>,
    ) {
        for (lane, action) in actions.iter_mut().enumerate() {
            *action = self.choose(&RuleState::of(environment, lane), OPTIONS, stream);
        }
        if let Some(probabilities) = probabilities {
            let rows = probabilities.chunks_exact_mut(OPTIONS).zip(&*actions);
            rows.for_each(|(row, action)| self.write_probabilities(*action, row));
        }
    }
}

/// In a job, a rule acts in the simulation of its family.
impl Actor for RulePolicy {
    fn act(
        &mut self,
        environment: &Simulated,
        stream: &mut Stream,
        actions: &mut [Action],
        probabilities: Option<&mut [f64]>,
    ) {
        let lanes: Option<&PhysicalActivity> = environment.downcast();
        if let Some(lanes) = lanes {
            return self.act(lanes, stream, actions, probabilities);
        }
        let count = environment.action_spec().count;
        for (lane, action) in actions.iter_mut().enumerate() {
            *action = match self.choice {
                Choice::Always(action) => action,
                Choice::Random => Action::uniform(stream.bits(), count),
                Choice::Recorded => {
                    environment.recorded(lane).map_or(Action::NONE, |(action, _)| action)
                }
                Choice::Tailored | Choice::Threshold(_) | Choice::Optimal(_) => {
                    unreachable!("such a rule starts in step_count alone")
                }
            };
        }
        if let Some(probabilities) = probabilities {
            let rows = probabilities.chunks_exact_mut(count).zip(&*actions);
            for (lane, (row, action)) in rows.enumerate() {
                match environment.recorded(lane).filter(|_| matches!(self.choice, Choice::Recorded))
                {
                    Some((_, recorded)) => row.copy_from_slice(recorded),
                    None => self.write_probabilities(*action, row),
                }
            }
        }
    }
}

// A rule has no memory.
resumable!([] RulePolicy {});

/// Why a text is not a rule.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum DecisionRuleError {
    /// The threshold cannot be a probability of the likelier of two contexts.
    #[error(
        "the threshold must lie in [0.5, 1], not `{0}`: it is a probability of the likelier of \
         two contexts"
    )]
    Threshold(String),
    /// The name is not a rule.
    #[error(
        "`{0}` is not a rule; the rules are never, untailored, tailored, threshold:<0.5-1>, random, optimal"
    )]
    Unknown(String),
}

/// The rule with this name; a threshold follows a colon, as in `threshold:0.9`.
///
/// **Errors**: the text is not a rule.
pub fn read_rule(text: &str) -> Result<RuleParameters, DecisionRuleError> {
    if let Some(("threshold", number)) = text.split_once(':') {
        let threshold = number.parse().ok().filter(|p| (0.5..=1.0).contains(p));
        let fault = || DecisionRuleError::Threshold(number.to_owned());
        return Ok(RuleParameters {
            rule: DecisionRule::Threshold,
            threshold: threshold.ok_or_else(fault)?,
        });
    }
    let is_complete =
        |rule: &DecisionRule| !matches!(rule, DecisionRule::Threshold | DecisionRule::Recorded);
    let rule = DecisionRule::named(text).filter(is_complete);
    let rule = rule.ok_or_else(|| DecisionRuleError::Unknown(text.to_owned()))?;
    Ok(RuleParameters::new(rule))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::actor::Rewards;
    use crate::env::{LaneSet, LaneStreams};
    use crate::rng::Purpose;

    #[test]
    fn rules_choose_by_what_the_scenario_shows_of_the_context() {
        let environment = StepCount::paper(1.0);
        let mut stream = Stream::new(1, Purpose::TestActions);
        let mut choose = |rule: &str, scenario: &str, p: f64| {
            let (rule, scenario) = (read_rule(rule).unwrap(), scenario.parse().unwrap());
            let mut lanes = PhysicalActivity::new(&environment, &scenario, 1);
            lanes.reset(LaneSet::All, &mut LaneStreams::Shared(stream.clone()));
            lanes.set_context(0, ContextDraw::new(0, p));
            let policy = RulePolicy::new(&rule, &environment, &scenario).unwrap();
            policy.choose(&RuleState::of(&lanes, 0), OPTIONS, &mut stream).index()
        };
        assert_eq!([choose("never", "P", 0.2), choose("untailored", "P", 0.2)], [0, 1]);
        assert_eq!([choose("tailored", "P", 0.2), choose("tailored", "L-T", 0.8)], [3, 2]);
        assert_eq!([choose("tailored", "C", 0.2), choose("tailored", "T", 0.2)], [2, 2]);
        assert_eq!(choose("threshold:0.75", "P", 0.7), 0);
        assert_eq!(choose("threshold:0.75", "P", 0.75), 2);
        assert_eq!(choose("threshold:0.75", "P", 0.1), 3);
        // The most likely context is right with probability Phi(1 / 2) = 0.69.
        assert_eq!([choose("threshold:0.7", "L", 0.1), choose("threshold:0.69", "L", 0.1)], [0, 3]);
        assert_eq!(choose("threshold:1", "C", 0.1), 2);
        assert_eq!([choose("tailored", "F", 0.2), choose("threshold:0.75", "F-E-R", 0.7)], [3, 0]);
        let seen: std::collections::HashSet<usize> =
            (0..100).map(|_| choose("random", "P", 0.5)).collect();
        assert_eq!(seen.len(), 4);
        assert_eq!(choose("optimal", "P-H-D", 0.5), 2);
    }

    #[test]
    fn rules_act_in_ended_lanes_beside_running_ones() {
        let environment = StepCount { horizon: 3, ..StepCount::paper(1.0) };
        for rule in ["never", "untailored", "tailored", "threshold:0.75", "random", "optimal"] {
            let (rule, scenario) = (read_rule(rule).unwrap(), "P-H-D".parse().unwrap());
            let mut lanes = PhysicalActivity::new(&environment, &scenario, 2);
            let mut streams = LaneStreams::Shared(Stream::new(1, Purpose::TestEnvironment));
            let mut actions_stream = Stream::new(1, Purpose::TestActions);
            let mut policy = RulePolicy::new(&rule, &environment, &scenario).unwrap();
            let (mut actions, mut rewards) = ([Action::NONE; 2], [0.0; 2]);
            let mut probabilities = [[0.0; OPTIONS]; 2];
            lanes.reset(LaneSet::All, &mut streams);
            for step in 0..6 {
                policy.act(
                    &lanes,
                    &mut actions_stream,
                    &mut actions,
                    Some(probabilities.as_flattened_mut()),
                );
                for (p, action) in probabilities.iter().zip(&actions) {
                    assert!((0.25..=1.0).contains(&p[action.index()]), "{rule:?}");
                    assert_eq!(p.iter().sum::<f64>(), 1.0, "{rule:?}");
                }
                lanes.step(&actions, &mut rewards, &mut streams);
                policy.observe(&lanes, Rewards::all(&rewards));
                if step == 1 {
                    lanes.reset(LaneSet::Masked(&[false, true]), &mut streams);
                }
            }
            assert!(!lanes.statuses().contains(&EpisodeStatus::Running));
            assert_eq!(rewards, [0.0, 0.0], "both ended before the last step");
        }
    }

    #[test]
    fn names_of_rules_are_those_of_the_manifest_and_faults_are_reported() {
        for word in ["never", "untailored", "tailored", "random", "optimal"] {
            let rule = read_rule(word).unwrap().rule;
            assert_eq!(rule.word(), word);
        }
        let read = read_rule("threshold:0.9").unwrap();
        assert_eq!((read.rule, read.threshold), (DecisionRule::Threshold, 0.9));
        for text in ["threshold:0.4", "threshold:NaN", "threshold:"] {
            assert!(matches!(read_rule(text), Err(DecisionRuleError::Threshold(_))), "{text}");
        }
        for text in ["", "threshold", "never:1", "match", "tailore"] {
            assert!(matches!(read_rule(text), Err(DecisionRuleError::Unknown(_))), "{text}");
        }
    }
}
