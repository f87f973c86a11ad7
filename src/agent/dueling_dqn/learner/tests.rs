//! Tests of the dueling DQN's learner: the batches that it gives its engine.

use super::*;
use crate::agent::dueling_dqn::{Transitions, target};
use crate::agent::policy::ActionNetwork;
use crate::agent::replay::{Batch, TerminalTarget, Transition};
use crate::env::{
    EpisodeStatus, FirstContext, Observations, PhysicalActivity, StepCount, TimeIndicator,
};
use crate::state::resumable;

/// An engine whose values are a formula of the state and of the number of target renewals. It
/// checks every batch that it receives.
struct Formula {
    parameters: DuelingDqn,
    renewals: u32,
    updates: u32,
    steps: Vec<Step>,
}

/// State, action, reward, status after the step and next state.
type Step = (Vec<f32>, Action, f32, EpisodeStatus, Vec<f32>);

struct Nothing;

impl ActionNetwork for Nothing {
    fn evaluate(&mut self, _: &Observations, _: &mut Vec<f32>) {
        unreachable!("nobody tests it");
    }
}

fn values(state: &[f32], renewals: u32) -> [f32; 4] {
    let sum: f32 = state.iter().sum();
    std::array::from_fn(|action| sum * (action as f32 - 1.0) + renewals as f32)
}

/// The state of a row, with its moment as the last number.
fn state(observations: &Observations, row: usize) -> Vec<f32> {
    let moment = observations.moment(row).map(|moment| moment as f32);
    observations.row(row).iter().copied().chain(moment).collect()
}

impl DuelingDqnEngine for Formula {
    type Network = Nothing;
    type Experience = Transitions;

    fn memory(&self) -> usize {
        0
    }

    fn values(&mut self, observations: &Observations, _: &mut [f32], out: &mut Vec<f32>) {
        *out = values(&state(observations, 0), 0).to_vec();
    }

    fn target_values(&mut self, observations: &Observations, out: &mut Vec<f32>) {
        let rows = 0..observations.rows();
        *out = rows.flat_map(|row| values(&state(observations, row), self.renewals)).collect();
    }

    fn renew_target(&mut self) {
        assert_eq!(self.updates % self.parameters.target_period, 0);
        self.renewals += 1;
    }

    fn update(&mut self, batch: &Batch) -> f32 {
        assert_eq!(self.renewals, self.updates / self.parameters.target_period + 1);
        self.updates += 1;
        let stored = self.steps.len().saturating_sub(self.parameters.buffer as usize);
        for row in 0..batch.actions.len() {
            let before = state(&batch.observations, row);
            let matching =
                self.steps[stored..].iter().filter(|(s, action, reward, status, next)| {
                    let DuelingDqn { gamma, terminal_target, .. } = self.parameters;
                    let best = values(next, self.renewals).into_iter().fold(f32::MIN, f32::max);
                    let (action, status) = (*action, *status);
                    let transition =
                        Transition { action, reward: *reward, status, is_withheld: false };
                    let target = target(&transition, best, gamma, terminal_target);
                    (s, action, target.to_bits())
                        == (&before, batch.actions[row], batch.targets[row].to_bits())
                });
            assert!(matching.count() > 0, "no stored step gives {before:?} and its target");
        }
        1.0
    }

    fn network(&self) -> Nothing {
        Nothing
    }

    fn weights(&self) -> Weights {
        Weights::default()
    }
}

resumable!([] Formula {});

#[test]
fn batches_are_stored_steps_with_the_targets_of_their_period() {
    for (buffer, batch, target_period) in
        [(64, 64, 1), (100, 64, 7), (1, 1, 1), (1000, 32, 1000), (40, 8, 50)]
    {
        for terminal_target in [TerminalTarget::Zero, TerminalTarget::Standard] {
            for (horizon, time_one_hot) in [(1, false), (3, true), (50, false), (50, true)] {
                let parameters = DuelingDqn {
                    buffer,
                    batch,
                    target_period,
                    terminal_target,
                    ..DuelingDqn::default()
                };
                let environment = StepCount {
                    horizon,
                    time_one_hot,
                    first_context: FirstContext::Sampled,
                    time_indicator: TimeIndicator::Exact,
                    ..StepCount::paper(0.6)
                };
                trains_on_what_it_did(parameters, &environment);
            }
        }
    }
}

/// Trains for about 300 steps and shows every step to the engine.
fn trains_on_what_it_did(parameters: DuelingDqn, environment: &StepCount) {
    let engine =
        Formula { parameters: parameters.clone(), renewals: 0, updates: 0, steps: Vec::new() };
    let environment = PhysicalActivity::new(environment, &"P-H-D".parse().unwrap(), 1);
    let mut learner = DuelingDqnLearner::new(engine, &parameters, environment, 1);
    let mut steps = 0;
    while steps < 300 {
        learner.play.begin();
        while learner.play.environment.any_running() {
            let before = state(&learner.play.observation, 0);
            let reward = learner.act(None);
            let position = (steps % parameters.buffer) as usize;
            let transition = learner.experience.replay.transition(position);
            assert_eq!(transition.reward, reward.unwrap() as f32);
            learner.engine.steps.push((
                before,
                transition.action,
                transition.reward,
                transition.status,
                state(&learner.play.observation, 0),
            ));
            steps += 1;
            if learner.experience.stored() >= parameters.batch as usize {
                learner.update().unwrap();
            }
        }
    }
    assert!(learner.engine.updates > 100, "{}", learner.engine.updates);
}
