//! Linear Thompson sampling in training, one episode at a time.

use crate::agent::Shape;
use crate::agent::actor::{Actor, StepObserver, reborrowed};
use crate::agent::learner::{Actions, Learner, LearnerError, SpanEnd, TrainedEpisode};
use crate::agent::linear_thompson::posterior::{Acting, Decision};
use crate::agent::linear_thompson::sampler::{Sampler, pick};
use crate::agent::linear_thompson::{Design, LinearThompson, LinearThompsonPolicy, Posterior};
use crate::agent::weights::Weights;
use crate::env::{EpisodeStatus, LaneSet, LaneStreams, Observations, Simulated, VectorEnvironment};
use crate::rng::{Purpose, Stream, unit_from_bits};
use crate::state::resumable;

/// A bandit in training, in an environment of one lane.
pub struct LinearThompsonLearner<Env = Simulated> {
    parameters: LinearThompson,
    design: Design,
    sampler: Sampler,
    /// Number of episodes that have ended.
    finished: u32,
    /// Number of steps learned from.
    updates: u64,
    /// The posterior after all steps so far.
    learned: Posterior,
    /// The posterior at the start of episodes.
    known: Posterior,
    /// The posterior from which actions are chosen.
    acting: Acting,
    /// Coefficients drawn for the episode; empty if none are drawn.
    drawn: Vec<f64>,
    decision: Decision,
    /// The running episode, if there is one: its environment, and its record so far.
    environment: Env,
    episode: TrainedEpisode,
    environment_streams: LaneStreams,
    exploration_stream: Stream,
    observations: Observations,
}

impl<Env: VectorEnvironment> LinearThompsonLearner<Env> {
    /// A learner before its first episode, in an environment of one lane.
    pub fn new(parameters: &LinearThompson, environment: Env, seed: u64) -> Self {
        let spec = environment.observation_spec();
        let design = Design::new(parameters.features, &spec);
        let actions = environment.action_spec().count;
        let prior = Posterior::prior(parameters, Shape { inputs: design.width(), actions });
        LinearThompsonLearner {
            parameters: parameters.clone(),
            design,
            sampler: Sampler::new(parameters, actions, seed),
            finished: 0,
            updates: 0,
            learned: prior.clone(),
            known: prior.clone(),
            acting: Acting::new(prior).expect("a prior is positive definite"),
            drawn: Vec::new(),
            decision: Decision::among(actions),
            environment,
            episode: TrainedEpisode::default(),
            environment_streams: LaneStreams::Shared(Stream::new(seed, Purpose::Environment)),
            exploration_stream: Stream::new(seed, Purpose::Exploration),
            observations: spec.observations(),
        }
    }

    /// Whether the drawn coefficients fit the posterior.
    fn fits(&self) -> bool {
        self.acting.fits(&self.drawn)
    }

    fn is_warm_up(&self) -> bool {
        self.finished < self.parameters.warm_up
    }

    /// Chooses an action in the current state; returns whether the agent chooses there.
    fn choose(&mut self) -> Result<bool, LearnerError> {
        self.environment.observe(&mut self.observations);
        self.design.fill(&self.observations, 0, &mut self.decision.features);
        // Drawn in every step, so that later choices do not depend on earlier availability.
        let word = self.exploration_stream.bits();
        if !self.parameters.unavailable.chooses(&self.environment, 0) {
            self.decision.withhold();
            return Ok(false);
        }
        if self.is_warm_up() {
            let Decision { probabilities, action, .. } = &mut self.decision;
            let uniform = 1.0 / probabilities.len() as f64;
            probabilities.fill(uniform);
            *action = pick(probabilities, unit_from_bits(word));
            return Ok(true);
        }
        self.acting.refresh().map_err(|_| LearnerError::Singular { steps: self.updates })?;
        let known = (&mut self.acting, &mut self.drawn);
        self.sampler.choose(Actions::AsTrained, known, &mut self.decision, word);
        Ok(true)
    }

    /// Takes one step in the running episode and learns from it.
    fn step(
        &mut self,
        mut observer: Option<&mut dyn StepObserver<Env>>,
    ) -> Result<(), LearnerError> {
        let chooses = self.choose()?;
        let action = self.decision.action;
        if let Some(observer) = &mut observer {
            observer.chosen(&self.environment, &[action], &self.decision.probabilities);
        }
        let mut reward = [0.0];
        self.environment.step(&[action], &mut reward, &mut self.environment_streams);
        if let Some(observer) = observer {
            observer.paid(&self.environment, &reward);
        }
        self.episode.total_reward += self.environment.outcomes(&reward)[0];
        self.episode.length += 1;
        if chooses {
            self.learn(reward[0]);
        }
        Ok(())
    }

    /// Learns from the reward of the last choice.
    fn learn(&mut self, reward: f64) {
        if !self.is_warm_up() {
            let error = reward - self.acting.predict(&self.decision);
            self.episode.loss_sum += error * error;
            self.episode.updates += 1;
            if self.parameters.learns_within() {
                self.acting.learn(&self.decision, reward);
            }
        }
        self.learned.learn(&self.decision, reward);
        self.updates += 1;
    }
}

impl<Env: VectorEnvironment> Learner<Env> for LinearThompsonLearner<Env> {
    fn advance(
        &mut self,
        finished: &mut Vec<TrainedEpisode>,
        mut observer: Option<&mut dyn StepObserver<Env>>,
        pause: &dyn Fn() -> bool,
    ) -> Result<SpanEnd, LearnerError> {
        if !self.environment.any_running() {
            self.environment.reset(LaneSet::All, &mut self.environment_streams);
            self.acting.begin(&self.known);
            self.drawn.clear();
            self.episode = TrainedEpisode::default();
        }
        while self.environment.any_running() {
            if pause() {
                return Ok(SpanEnd::BrokenOff);
            }
            self.step(reborrowed(&mut observer))?;
        }
        self.episode.terminated = self.environment.statuses()[0] == EpisodeStatus::Terminated;
        self.finished += 1;
        if self.parameters.renews_after(self.finished) {
            self.known.copy_from(&self.learned);
        }
        finished.push(self.episode);
        Ok(SpanEnd::Whole)
    }

    fn policy(&self, actions: Actions) -> Box<dyn Actor<Env>> {
        let observations = self.environment.observation_spec().observations();
        let (parts, known) =
            ((self.design.clone(), self.sampler.clone(), observations), self.known.clone());
        let policy = LinearThompsonPolicy::new(&self.parameters, parts, known, actions);
        Box::new(policy.expect("weights that are finite come from a posterior with a root"))
    }

    /// The posterior with which the next episode starts.
    fn weights(&self) -> Weights {
        self.known.weights()
    }
}

resumable!([Env: VectorEnvironment] LinearThompsonLearner<Env> {
    parts finished, updates, learned, known, acting, environment, episode, environment_streams, exploration_stream;
    grown drawn;
    check fits, "drawn coefficients"
});
