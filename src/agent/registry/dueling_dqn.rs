//! The registration of the dueling DQN.

use crate::agent::burn::device::inference;
use crate::agent::burn::{BurnDuelingDqn, DuelingQNetwork};
use crate::agent::constraint::{
    CURVE_FITS, Chosen, Constraint, EPISODES, HORIZON, LAYERS, ONE_HOT, batch_fits, network_fits,
    replay_fits,
};
use crate::agent::dueling_dqn::{DuelingDqn, DuelingDqnLearner};
use crate::agent::fused::{FusedDuelingDqn, FusedDuelingNetwork};
use crate::agent::network::Engine;
use crate::agent::policy::{EpsilonGreedy, Policy};
use crate::agent::{Actions, Weights, WeightsError, layers};
use crate::env::Observer;
use crate::kernel::Isa;
use crate::key::Parameter;

use super::algorithm::{AlgorithmParameters, Setting, Start, StartError};

const TRUNK: Parameter = Parameter::Agent("trunk");
const BATCH: Parameter = Parameter::Agent("batch");
const BUFFER: Parameter = Parameter::Agent("buffer");
const EPSILON_START: Parameter = Parameter::Agent("epsilon_start");
const EPSILON_FLOOR: Parameter = Parameter::Agent("epsilon_floor");

/// Stacks of hidden layers.
fn stacks(chosen: &Chosen) -> u64 {
    if chosen.is_word(TRUNK, "separate") { 2 } else { 1 }
}

impl AlgorithmParameters for DuelingDqn {
    const NAME: &'static str = "dueling_dqn";
    const LEARNS: bool = true;
    const CONSTRAINTS: &'static [Constraint] = &[
        Constraint {
            parameters: &[BATCH, BUFFER],
            violation: |chosen| {
                let violated = chosen.whole(BATCH) > chosen.whole(BUFFER);
                violated.then(|| chosen.contradiction(BATCH, "must not exceed", BUFFER))
            },
        },
        Constraint {
            parameters: &[EPSILON_FLOOR, EPSILON_START],
            violation: |chosen| {
                let violated = chosen.real(EPSILON_FLOOR) > chosen.real(EPSILON_START);
                violated
                    .then(|| chosen.contradiction(EPSILON_FLOOR, "must not exceed", EPSILON_START))
            },
        },
        Constraint {
            parameters: &[LAYERS, TRUNK, HORIZON, ONE_HOT],
            violation: |chosen| network_fits(chosen.network_parameters(stacks(chosen), 5)),
        },
        Constraint {
            parameters: &[BATCH, LAYERS, TRUNK, HORIZON, ONE_HOT],
            violation: |chosen| {
                let each = stacks(chosen) * chosen.row_numbers();
                batch_fits(chosen.whole(BATCH).saturating_mul(each))
            },
        },
        Constraint {
            parameters: &[BUFFER, EPISODES, HORIZON, ONE_HOT],
            violation: |chosen| {
                let steps = chosen.whole(EPISODES).saturating_mul(chosen.whole(HORIZON));
                replay_fits(chosen.whole(BUFFER).min(steps))
            },
        },
        CURVE_FITS,
    ];

    fn version(&self) -> u32 {
        2
    }

    fn episodes(&self) -> u32 {
        self.episodes
    }

    fn start(&self, setting: &Setting) -> Result<Start, StartError> {
        let Setting { environment, scenario, seed } = *setting;
        let inputs = Observer::new(environment, scenario).inputs();
        let stacks = layers::dueling(self, inputs);
        // The weights as drawn and as trained, their gradient, Adam's two moments of them, and the
        // target network.
        let weights = layers::initial(&stacks, 6, seed)?;
        Ok(Start::Learner(match self.engine {
            Engine::Fused => {
                let engine = FusedDuelingDqn::new(self, inputs, &weights, Isa::chosen());
                let engine = engine.expect(layers::DRAWN);
                Box::new(DuelingDqnLearner::new(engine, self, environment, scenario, seed))
            }
            Engine::Burn => {
                let engine = BurnDuelingDqn::new(self, inputs, &weights).expect(layers::DRAWN);
                Box::new(DuelingDqnLearner::new(engine, self, environment, scenario, seed))
            }
        }))
    }

    /// A trained dueling DQN explores at the rate that is kept with its weights.
    fn trained(
        &self,
        setting: &Setting,
        weights: &Weights,
        actions: Actions,
    ) -> Result<Box<dyn Policy>, WeightsError> {
        let inputs = Observer::new(setting.environment, setting.scenario).inputs();
        let epsilon = match actions {
            Actions::AsTrained => weights.number("epsilon")?,
            Actions::Greedy => 0.0,
        };
        Ok(match self.engine {
            Engine::Fused => Box::new(EpsilonGreedy::new(
                FusedDuelingNetwork::new(self, inputs, weights, Isa::chosen())?,
                epsilon,
            )),
            Engine::Burn => Box::new(EpsilonGreedy::new(
                DuelingQNetwork::from_weights(self, inputs, weights, &inference())?,
                epsilon,
            )),
        })
    }
}
