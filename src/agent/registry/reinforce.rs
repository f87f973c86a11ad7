//! The registration of REINFORCE.

use crate::agent::burn::device::inference;
use crate::agent::burn::{BurnReinforce, PolicyNetwork};
use crate::agent::constraint::{
    CURVE_FITS, Constraint, EPISODES, HORIZON, LAYERS, ONE_HOT, batch_fits, network_fits,
};
use crate::agent::fused::{FusedPolicyNetwork, FusedReinforce};
use crate::agent::network::Engine;
use crate::agent::policy::{Policy, SoftmaxPolicy};
use crate::agent::reinforce::{Reinforce, ReinforceLearner};
use crate::agent::{Actions, Weights, WeightsError, layers};
use crate::env::Observer;
use crate::kernel::Isa;
use crate::key::Parameter;

use super::algorithm::{AlgorithmParameters, Setting, Start, StartError};

const TRAJECTORIES_PER_UPDATE: Parameter = Parameter::Agent("trajectories_per_update");

impl AlgorithmParameters for Reinforce {
    const NAME: &'static str = "reinforce";
    const LEARNS: bool = true;
    const CONSTRAINTS: &'static [Constraint] = &[
        Constraint {
            parameters: &[EPISODES, TRAJECTORIES_PER_UPDATE],
            violation: |chosen| {
                let each = chosen.whole(TRAJECTORIES_PER_UPDATE);
                let violated = !chosen.whole(EPISODES).is_multiple_of(each);
                violated.then(|| {
                    chosen.contradiction(EPISODES, "must be a multiple of", TRAJECTORIES_PER_UPDATE)
                })
            },
        },
        Constraint {
            parameters: &[LAYERS, HORIZON, ONE_HOT],
            violation: |chosen| network_fits(chosen.network_parameters(1, 4)),
        },
        Constraint {
            parameters: &[TRAJECTORIES_PER_UPDATE, LAYERS, HORIZON, ONE_HOT],
            violation: |chosen| {
                let each = chosen.whole(TRAJECTORIES_PER_UPDATE);
                let rows = each.saturating_mul(chosen.whole(HORIZON));
                batch_fits(rows.saturating_mul(chosen.row_numbers()))
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
        let stacks = [layers::policy(self, inputs)];
        // The weights as drawn and as trained, their gradient, and Adam's two moments of them.
        let weights = layers::initial(&stacks, 5, seed)?;
        Ok(Start::Learner(match self.engine {
            Engine::Fused => {
                let engine = FusedReinforce::new(self, inputs, &weights, Isa::chosen());
                let engine = engine.expect(layers::DRAWN);
                Box::new(ReinforceLearner::new(engine, self, environment, scenario, seed))
            }
            Engine::Burn => {
                let engine = BurnReinforce::new(self, inputs, &weights).expect(layers::DRAWN);
                Box::new(ReinforceLearner::new(engine, self, environment, scenario, seed))
            }
        }))
    }

    fn trained(
        &self,
        setting: &Setting,
        weights: &Weights,
        actions: Actions,
    ) -> Result<Box<dyn Policy>, WeightsError> {
        let inputs = Observer::new(setting.environment, setting.scenario).inputs();
        Ok(match self.engine {
            Engine::Fused => Box::new(SoftmaxPolicy::new(
                FusedPolicyNetwork::new(self, inputs, weights, Isa::chosen())?,
                actions,
            )),
            Engine::Burn => Box::new(SoftmaxPolicy::new(
                PolicyNetwork::from_weights(self, inputs, weights, &inference())?,
                actions,
            )),
        })
    }
}
