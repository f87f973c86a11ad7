//! Tests of PPO's learner: its step sizes, early ends of epochs, and values at the ends of
//! episodes.

use std::cell::RefCell;
use std::rc::Rc;

use super::*;
use crate::agent::learner::Learner;
use crate::env::{Action, PhysicalActivity, StepCount};
use crate::state::resumable;

/// The value of every state.
const VALUE: f32 = 10.0;
const HORIZON: u32 = 5;

/// The step size of an update, and the returns of its minibatch.
type Update = (f64, Vec<f32>);

/// An engine that always prefers one action, gives all states the same value, and records its
/// updates.
struct Noting {
    preferred: Action,
    approx_kl: f32,
    updates: Rc<RefCell<Vec<Update>>>,
}

struct Nothing;

impl ActionNetwork for Nothing {
    fn evaluate(&mut self, _: &Observations, _: &mut Vec<f32>) {
        unreachable!("nobody tests it");
    }
}

impl PpoEngine for Noting {
    type Network = Nothing;

    fn evaluate(
        &mut self,
        observations: &Observations,
        _: &mut [f32],
        logits: &mut Vec<f32>,
        values: &mut Vec<f32>,
    ) {
        let mut row = [0.0; 4];
        row[self.preferred.index()] = 60.0;
        *logits = row.repeat(observations.rows());
        *values = vec![VALUE; observations.rows()];
    }

    fn update(&mut self, minibatch: &Minibatch, learning_rate: f64) -> Losses {
        self.updates.borrow_mut().push((learning_rate, minibatch.returns.clone()));
        Losses { approx_kl: self.approx_kl, ..Losses::default() }
    }

    fn network(&self) -> Nothing {
        Nothing
    }

    fn weights(&self) -> Weights {
        Weights::default()
    }
}

resumable!([] Noting {});

/// Rollouts of one episode in each of two lanes.
fn parameters() -> Ppo {
    Ppo {
        episodes: 8,
        lanes: 2,
        steps: HORIZON,
        minibatches: 2,
        epochs: 3,
        learning_rate: 0.4,
        gamma: 0.5,
        gae_lambda: 0.0,
        norm_adv: false,
        ..Ppo::default()
    }
}

/// The updates of a whole training, and the number of its episodes that ended in a terminal state.
fn trained(parameters: &Ppo, preferred: usize, approx_kl: f32) -> (Vec<Update>, usize) {
    let environment = StepCount { horizon: HORIZON, ..StepCount::paper(0.6) };
    let lanes = parameters.lanes as usize;
    let environment = PhysicalActivity::new(&environment, &"P".parse().unwrap(), lanes);
    let updates = Rc::default();
    let preferred = Action::from_index(preferred).unwrap();
    let engine = Noting { preferred, approx_kl, updates: Rc::clone(&updates) };
    let mut learner = PpoLearner::new(engine, parameters, environment, 3);
    let mut finished = Vec::new();
    while finished.len() < parameters.episodes as usize {
        learner.advance(&mut finished, None, &|| false).unwrap();
    }
    let terminated = finished.iter().filter(|episode| episode.terminated).count();
    (updates.take(), terminated)
}

#[test]
fn the_step_size_falls_with_the_episodes_that_ended_before_the_rollout() {
    let rates = |anneal| -> Vec<f64> {
        let (updates, _) = trained(&Ppo { anneal, ..parameters() }, 0, 0.0);
        updates.iter().map(|(rate, _)| *rate).collect()
    };
    // Four rollouts of two episodes, each with two minibatches in three epochs.
    let expected: Vec<f64> = [0.4, 0.3, 0.2, 0.1].iter().flat_map(|rate| [*rate; 6]).collect();
    let annealed = rates(true);
    assert_eq!(annealed.len(), 24);
    assert!(annealed.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-12), "{annealed:?}");
    assert_eq!(rates(false), [0.4; 24]);
}

#[test]
fn epochs_end_where_the_policy_has_moved_too_far() {
    let updates =
        |target_kl, approx_kl| trained(&Ppo { target_kl, ..parameters() }, 0, approx_kl).0.len();
    // An epoch is two updates, and there are four rollouts.
    assert_eq!(updates(0.125, 0.25), 4 * 2);
    assert_eq!(updates(0.125, 0.125), 4 * 2 * 3);
    assert_eq!(updates(0.0, 0.25), 4 * 2 * 3, "0 is no limit");
}

#[test]
fn nothing_follows_an_end_and_the_value_follows_a_truncation() {
    // Rewards are at most 1 after scaling; the value after the horizon contributes half of 10.
    let ends = |at_horizon, preferred| {
        let epochs = 1;
        let (updates, terminated) =
            trained(&Ppo { at_horizon, epochs, ..parameters() }, preferred, 0.0);
        let returns: Vec<f32> = updates.into_iter().flat_map(|(_, returns)| returns).collect();
        assert!(returns.iter().all(|r| (0.0..=1.0).contains(r) || (5.0..=6.0).contains(r)));
        (returns.iter().filter(|r| **r <= 1.0).count(), terminated)
    };
    // Without messages nobody disengages: each of the eight episodes ends at the horizon.
    assert_eq!(ends(AtHorizon::Termination, 0), (8, 0));
    assert_eq!(ends(AtHorizon::Truncation, 0), (0, 0));
    // Messages for one context are wrong in the other, so that some episodes end by disengagement.
    let (without_value, terminated) = ends(AtHorizon::Truncation, 2);
    assert!(terminated > 0);
    assert_eq!(without_value, terminated);
    assert_eq!(ends(AtHorizon::Termination, 2).0, 8);
}
