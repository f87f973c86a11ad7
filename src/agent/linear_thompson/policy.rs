//! A trained bandit in the episodes of its test.

use std::io;

use crate::agent::Actions;
use crate::agent::actor::{Actor, Rewards};
use crate::agent::linear_thompson::posterior::{Acting, Decision};
use crate::agent::linear_thompson::sampler::Sampler;
use crate::agent::linear_thompson::{BanditPosterior, Design, LinearThompson, Posterior};
use crate::agent::unavailable::Unavailable;
use crate::agent::weights::WeightsError;
use crate::env::{Action, EpisodeStatus, LaneSet, Observations, VectorEnvironment};
use crate::rng::Stream;
use crate::state::{Resumable, StateError, StateReader, StateWriter, resumable};

/// The policy of a trained agent.
///
/// A carried posterior is frozen, so that the test measures what training learned. A posterior that
/// is reset learns within every episode from this episode alone, as in training, unless it is
/// updated only once, after the warm-up.
pub struct LinearThompsonPolicy {
    sampler: Sampler,
    design: Design,
    choice: Actions,
    unavailable: Unavailable,
    /// The posterior at the start of episodes.
    known: Posterior,
    /// The same posterior with its Cholesky factors. All lanes act by it unless they learn.
    shared: Acting,
    learns: bool,
    lanes: Vec<Lane>,
    observations: Observations,
}

/// The state of a lane in its episode.
struct Lane {
    /// The lane's own posterior; `None` if the policy does not learn.
    acting: Option<Acting>,
    /// Coefficients drawn for the episode; empty if none are drawn.
    drawn: Vec<f64>,
    decision: Decision,
    /// Whether the agent chose in the last step.
    chooses: bool,
}

impl Lane {
    /// A lane at the start of an episode.
    fn new(own: Option<&Acting>, actions: usize) -> Self {
        let (acting, decision) = (own.cloned(), Decision::among(actions));
        Lane { acting, drawn: Vec::new(), decision, chooses: false }
    }
}

impl LinearThompsonPolicy {
    /// The policy of a posterior.
    ///
    /// **Errors**: a precision is not positive definite.
    pub fn new(
        parameters: &LinearThompson,
        (design, sampler, observations): (Design, Sampler, Observations),
        known: Posterior,
        choice: Actions,
    ) -> Result<Self, WeightsError> {
        let shared = Acting::new(known.clone()).map_err(|_| WeightsError::NotPositiveDefinite)?;
        let learns = match parameters.posterior {
            BanditPosterior::Carried => false,
            BanditPosterior::Reset => parameters.learns_within(),
        };
        Ok(LinearThompsonPolicy {
            sampler,
            design,
            choice,
            unavailable: parameters.unavailable,
            known,
            shared,
            learns,
            lanes: Vec::new(),
            observations,
        })
    }
}

impl<Env: VectorEnvironment> Actor<Env> for LinearThompsonPolicy {
    fn reset(&mut self, lanes: LaneSet<'_>) {
        for (lane, own) in self.lanes.iter_mut().enumerate() {
            if lanes.contains(lane) {
                own.drawn.clear();
                own.acting.iter_mut().for_each(|acting| acting.begin(&self.known));
            }
        }
    }

    fn act(
        &mut self,
        environment: &Env,
        stream: &mut Stream,
        actions: &mut [Action],
        probabilities: Option<&mut [f64]>,
    ) {
        environment.observe(&mut self.observations);
        let own = self.learns.then_some(&self.shared);
        let count = self.sampler.actions();
        self.lanes.resize_with(environment.lanes(), || Lane::new(own, count));
        let LinearThompsonPolicy {
            sampler, design, choice, observations, shared, unavailable, ..
        } = self;
        for (lane, (own, action)) in self.lanes.iter_mut().zip(&mut *actions).enumerate() {
            own.chooses = environment.statuses()[lane] == EpisodeStatus::Running
                && unavailable.chooses(environment, lane);
            let word = match choice {
                Actions::AsTrained => stream.bits(),
                Actions::Greedy => 0,
            };
            if !own.chooses {
                own.decision.withhold();
                *action = own.decision.action;
                continue;
            }
            let Lane { acting, drawn, decision, .. } = own;
            let acting = acting.as_mut().unwrap_or(shared);
            // If the latest precision cannot be factored, the previous factor remains in use.
            let _ = acting.refresh();
            design.fill(observations, lane, &mut decision.features);
            sampler.choose(*choice, (acting, drawn), decision, word);
            *action = decision.action;
        }
        if let Some(probabilities) = probabilities {
            for (row, own) in probabilities.chunks_exact_mut(count).zip(&self.lanes) {
                row.copy_from_slice(&own.decision.probabilities);
            }
        }
    }

    fn observe(&mut self, _: &Env, rewards: Rewards<'_>) {
        for (lane, own) in self.lanes.iter_mut().enumerate().filter(|(_, own)| own.chooses) {
            if let (Some(acting), Some(reward)) = (&mut own.acting, rewards.of_lane(lane)) {
                acting.learn(&own.decision, reward);
            }
        }
    }
}

/// Saves the posteriors and drawn coefficients of the lanes. The learner saves the posterior from
/// which they start.
impl Resumable for LinearThompsonPolicy {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        out.each(self.lanes.iter(), |out, lane| lane.save(out))
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        let own = self.learns.then_some(&self.shared);
        self.lanes = from.each(usize::MAX, "lanes", |from| {
            let mut lane = Lane::new(own, self.sampler.actions());
            lane.restore(from)?;
            let fits = self.shared.fits(&lane.drawn);
            if fits { Ok(lane) } else { Err(StateError::Misfit("drawn coefficients")) }
        })?;
        Ok(())
    }
}

resumable!([] Lane { each acting; grown drawn });
