//! The registration of linear Thompson sampling.

use std::sync::Arc;

use crate::agent::actor::{Actor, StudyAgent};
use crate::agent::constraint::EPISODES;
use crate::agent::layers::Shape;
use crate::agent::learner::{Actions, Learner};
use crate::agent::linear_thompson::{
    BanditAllocation, BanditDraw, BanditPosterior, Design, LinearThompson, LinearThompsonLearner,
    LinearThompsonPolicy, LinearThompsonStudy, PersonSd, Posterior, Prior, Sampler, subject_of,
};
use crate::agent::weights::{Weights, WeightsError};
use crate::env::{Interface, VectorEnvironment};
use crate::key::{Assignment, Constraint, Key, KeyType, Keyed, Parameter, Size, Value, Violation};

use super::algorithm::{
    AlgorithmParameters, Start, StartError, StudyPlan, Task, Unsuited, Work, unless_fit,
};

const CENTRING: Parameter = Parameter::Agent("action_centring");
const ACTION_BIAS: Parameter = Parameter::Agent("action_bias");
const ALLOCATION: Parameter = Parameter::Agent("allocation");
const BASELINE_MEANS: Parameter = Parameter::Agent("baseline_means");
const BASELINE_SDS: Parameter = Parameter::Agent("baseline_sds");
const EFFECT_MEANS: Parameter = Parameter::Agent("effect_means");
const EFFECT_SDS: Parameter = Parameter::Agent("effect_sds");
const DRAW: Parameter = Parameter::Agent("draw");
const SMOOTHING: Parameter = Parameter::Agent("smoothing");
const LOWER: Parameter = Parameter::Agent("logistic_lower");
const UPPER: Parameter = Parameter::Agent("logistic_upper");
const PERSON_SD: Parameter = Parameter::Agent("person_sd");
const PI_MIN: Parameter = Parameter::Agent("pi_min");
const PRIOR_FROM: Parameter = Parameter::Agent("prior_from");
const PRIOR_MEAN: Parameter = Parameter::Agent("prior_mean");
const PRIOR_SD: Parameter = Parameter::Agent("prior_sd");
const FEATURES: Parameter = Parameter::Agent("features");
const WARM_UP: Parameter = Parameter::Agent("warm_up");
const UPDATE: Parameter = Parameter::Agent("update");
const POSTERIOR: Parameter = Parameter::Agent("posterior");

/// Maximum number of regressors of a regression: the time of a step grows with their cube, and the
/// stored precision with their square.
const MOST_REGRESSORS: u64 = 500;

/// Maximum number of regressors if a thousand test episodes learn at once, each with its own
/// regressions, which takes half a gigabyte.
const MOST_REGRESSORS_OF_EACH: u64 = 64;

impl AlgorithmParameters for LinearThompson {
    const NAME: &'static str = "linear_thompson";
    const CONSTRAINTS: &'static [Constraint] = &[
        Constraint {
            parameters: &[EPISODES, WARM_UP],
            violation: |assignment| {
                let violated = assignment.whole(WARM_UP) > assignment.whole(EPISODES);
                violated.then(|| assignment.contradiction(WARM_UP, "must not exceed", EPISODES))
            },
        },
        Constraint {
            parameters: &[CENTRING, PI_MIN, ALLOCATION, LOWER, UPPER],
            violation: |assignment| {
                let is_centred = assignment.is_set(CENTRING);
                // The logistic allocation has bounds of its own.
                let is_bounded = assignment.is_word(ALLOCATION, "logistic")
                    && assignment.real(LOWER) > 0.0
                    && assignment.real(UPPER) < 1.0;
                (is_centred && !is_bounded && assignment.real(PI_MIN) == 0.0).then(|| {
                    Violation::Impossible {
                    says:
                        "action_centring = true requires every action to be possible, but pi_min \
                         is 0.0"
                            .to_owned(),
                    help: "set pi_min above 0, such as 0.05".to_owned(),
                }
                })
            },
        },
        Constraint {
            parameters: &[ALLOCATION, DRAW, SMOOTHING],
            violation: |assignment| {
                let is_drawn = assignment.is_word(DRAW, "episode");
                let is_smooth = assignment.real(SMOOTHING) > 0.0;
                let allocation = assignment.shown(ALLOCATION);
                let help = match assignment.is_word(ALLOCATION, "logistic") {
                    true => "the logistic function smooths by itself; remove draw and smoothing",
                    false => "probabilities are exact; remove draw and smoothing",
                };
                let is_thompson = assignment.is_word(ALLOCATION, "thompson");
                (!is_thompson && (is_drawn || is_smooth)).then(|| Violation::Impossible {
                    says: format!(
                        "allocation = {allocation} requires draw = \"step\" and smoothing = 0"
                    ),
                    help: help.to_owned(),
                })
            },
        },
        Constraint {
            parameters: &[ALLOCATION, LOWER, UPPER],
            violation: |assignment| {
                let is_logistic = assignment.is_word(ALLOCATION, "logistic");
                let violated = assignment.real(LOWER) > assignment.real(UPPER);
                (is_logistic && violated)
                    .then(|| assignment.contradiction(LOWER, "must not exceed", UPPER))
            },
        },
        Constraint {
            parameters: &[
                PRIOR_FROM,
                PRIOR_MEAN,
                PRIOR_SD,
                BASELINE_MEANS,
                BASELINE_SDS,
                EFFECT_MEANS,
                EFFECT_SDS,
            ],
            violation: |assignment| {
                prior_of(assignment)?;
                let is_given = |key: &&Key| {
                    let value = assignment.value(Parameter::Agent(key.name));
                    value.is_some_and(|value| key.default().as_ref() != Some(value))
                        && key.name != PRIOR_FROM.key()
                };
                let replaced = LinearThompson::KEYS.iter().find(is_given)?;
                Some(Violation::Impossible {
                    says: format!(
                        "`prior_from` is the whole prior, and `{}` is given, too",
                        replaced.name
                    ),
                    help: "remove one of them; another [[agent]] can have the other prior"
                        .to_owned(),
                })
            },
        },
        Constraint {
            parameters: &[PRIOR_FROM, FEATURES, CENTRING],
            violation: |assignment| {
                let (design, is_centred) = prior_of(assignment)?.design();
                let differs = |key: &str, of_prior: String, of_agent: String| {
                    (of_prior != of_agent).then(|| {
                        Violation::Contradiction(format!(
                            "the posterior of `prior_from` has {key} = {of_prior}, and this agent has {key} = {of_agent}"
                        ))
                    })
                };
                differs("features", design.to_value().to_string(), assignment.shown(FEATURES))
                    .or_else(|| {
                        differs(
                            "action_centring",
                            is_centred.to_string(),
                            assignment.shown(CENTRING),
                        )
                    })
            },
        },
        Constraint {
            parameters: &[UPDATE, WARM_UP],
            violation: |assignment| {
                let never = assignment.is_word(UPDATE, "once") && assignment.whole(WARM_UP) == 0;
                never.then(|| Violation::Impossible {
                    says: "update = \"once\" updates after the warm-up, but warm_up is 0"
                        .to_owned(),
                    help: "set warm_up to the number of warm-up episodes, such as 10".to_owned(),
                })
            },
        },
        Constraint {
            parameters: &[UPDATE, POSTERIOR],
            violation: |assignment| {
                let is_reset = assignment.is_word(POSTERIOR, "reset");
                (is_reset && assignment.is_word(UPDATE, "episode")).then(|| Violation::Impossible {
                    says: "with posterior = \"reset\" and update = \"episode\" the agent never \
                           learns"
                        .to_owned(),
                    help: "use update = \"step\", which learns within episodes".to_owned(),
                })
            },
        },
    ];

    fn sizes(&self, task: &Task) -> Vec<Size> {
        let most = match self.posterior {
            BanditPosterior::Reset => MOST_REGRESSORS_OF_EACH,
            BanditPosterior::Carried => MOST_REGRESSORS,
        };
        let (what, unit) = ("the regression has", "coefficients");
        vec![Size { what, unit, size: self.regressors(task), most }]
    }

    const UNREAD_IN_TRIALS: Option<&'static [&'static str]> = Some(&[
        "episodes",
        "warm_up",
        "update",
        "update_interval",
        "first_update",
        "posterior",
        "draw",
    ]);
    const SUITED: &'static [Parameter] = &[
        ACTION_BIAS,
        PI_MIN,
        ALLOCATION,
        BASELINE_MEANS,
        BASELINE_SDS,
        EFFECT_MEANS,
        EFFECT_SDS,
        PERSON_SD,
        PRIOR_FROM,
    ];

    fn unsuited(&self, interface: &Interface) -> Option<Unsuited> {
        let Interface { actions, observations } = interface;
        let is_biased = self.action_bias.iter().any(|bias| *bias != 0.0);
        let unsuited = |key, says: &'static str| {
            Some(Unsuited { key, environment: format!("{actions} actions"), says: says.into() })
        };
        if *actions != 2 {
            match self.allocation {
                BanditAllocation::Thompson => {}
                BanditAllocation::Clipped => {
                    return unsuited(ALLOCATION, "the clipped allocation is for two actions");
                }
                BanditAllocation::Logistic => {
                    return unsuited(ALLOCATION, "the logistic allocation is for two actions");
                }
            }
        }
        let width = Design::new(self.features, observations).width();
        let lists = [
            (BASELINE_MEANS, &self.baseline_means),
            (BASELINE_SDS, &self.baseline_sds),
            (EFFECT_MEANS, &self.effect_means),
            (EFFECT_SDS, &self.effect_sds),
        ];
        if let Some((key, _)) =
            lists.into_iter().find(|(_, list)| !list.is_empty() && list.len() != width)
        {
            let environment = format!("{width} features, the intercept among them");
            let says = "it needs one number per feature".into();
            return Some(Unsuited { key, environment, says });
        }
        let shape = Design::regressors(width, *actions, self.action_centring);
        if self.person_sd != PersonSd::Estimated
            && self.person_sd.of_coefficients(shape, width).is_none()
        {
            let all = shape.0 * shape.1;
            let environment = format!("{width} features, the intercept among them");
            let says = format!(
                "it needs one number per feature, or {all} for all coefficients; write lists within a list to sweep it"
            );
            return Some(Unsuited { key: PERSON_SD, environment, says: says.into() });
        }
        if is_biased && self.action_bias.len() != *actions {
            return unsuited(ACTION_BIAS, "it needs one number per action");
        }
        if self.pi_min * *actions as f64 > 1.0 {
            return unsuited(PI_MIN, "it must not exceed 1 divided by the number of actions");
        }
        let prior = self.prior_from.parsed::<Prior>();
        if !self.prior_from.is_none() && prior.as_ref().is_none_or(|prior| !prior.suits(interface))
        {
            let says = match prior {
                Some(prior) => format!("it is of {}", prior.subject()).into(),
                None => "a job of a store has only its digest; run its manifest".into(),
            };
            return Some(Unsuited { key: PRIOR_FROM, environment: subject_of(interface), says });
        }
        None
    }

    fn episodes(&self) -> u32 {
        self.episodes
    }

    /// Per step, one factorisation of a posterior and one prediction per action or effect, and
    /// unless coefficients are drawn per episode, the probabilities by an integral or by draws.
    fn work(&self, task: &Task) -> Work {
        let width = self.regressors(task);
        let actions = task.interface().actions as u64;
        let choices = if self.action_centring { actions - 1 } else { actions };
        let predicted = choices * width * (width + PER_PREDICTION);
        let learned = width * width * width / 6 + 4 * width * width + PER_FACTOR;
        let drawn = u64::from(self.probability_draws) * PER_DRAW;
        let chosen = match self.draw {
            BanditDraw::Episode => choices * width,
            BanditDraw::Step if self.smoothing > 0.0 => predicted + drawn * SOFTMAX,
            BanditDraw::Step if self.action_centring => predicted + drawn,
            BanditDraw::Step => predicted + PER_INTEGRAL,
        };
        let steps = task.steps(self.episodes);
        Work { training: steps.saturating_mul(chosen + learned), choice: chosen }
    }

    fn start(&self, task: &Task) -> Result<Start, StartError> {
        Ok(Start::Learner(learner_in(self, task.simulation(LANES), task.seed)?))
    }

    fn in_trial(&self, task: &Task, plan: StudyPlan) -> Result<Box<dyn StudyAgent>, StartError> {
        let environment = task.tested(plan.people);
        if let Some(unsuited) = self.unsuited(&environment.interface()) {
            return Err(unsuited.into());
        }
        let study = LinearThompsonStudy::new(self, &environment, plan, task.seed);
        Ok(Box::new(study))
    }

    fn trained(
        &self,
        task: &Task,
        weights: &Weights,
        actions: Actions,
    ) -> Result<Box<dyn Actor>, WeightsError> {
        trained(self, &task.interface(), weights, actions, task.seed)
    }
}

/// The posterior that `prior_from` names.
fn prior_of(assignment: &Assignment) -> Option<Arc<Prior>> {
    match assignment.value(PRIOR_FROM)? {
        Value::Content(content) => content.parsed(),
        _ => None,
    }
}

impl LinearThompson {
    /// Number of coefficients of a regression.
    fn regressors(&self, task: &Task) -> u64 {
        let width = Design::new(self.features, &task.observations()).width() as u64;
        let blocks = 2 * task.interface().actions as u64 - 1;
        if self.action_centring { blocks * width } else { width }
    }
}

/// Linear Thompson sampling before its first episode in any environment of one lane.
///
/// **Errors**: the environment does not have one lane and 2 to 256 actions, or `action_bias` or `pi_min` does
/// not suit their number.
pub fn learner_in<Env: VectorEnvironment + 'static>(
    parameters: &LinearThompson,
    environment: Env,
    seed: u64,
) -> Result<Box<dyn Learner<Env>>, StartError> {
    unless_fit(&environment, LANES)?;
    let (observations, actions) =
        (environment.observation_spec().clone(), environment.action_spec().count);
    if let Some(unsuited) = parameters.unsuited(&Interface { observations, actions }) {
        return Err(unsuited.into());
    }
    Ok(Box::new(LinearThompsonLearner::new(parameters, environment, seed)))
}

/// The policy of previously trained linear Thompson sampling, with a seed for its fixed draws.
///
/// **Errors**: the weights are not a posterior of this agent.
pub fn trained<Env: VectorEnvironment>(
    parameters: &LinearThompson,
    interface: &Interface,
    weights: &Weights,
    actions: Actions,
    seed: u64,
) -> Result<Box<dyn Actor<Env>>, WeightsError> {
    let Interface { observations, actions: count } = interface;
    let design = Design::new(parameters.features, observations);
    let shape = Shape { inputs: design.width(), actions: *count };
    let posterior = Posterior::trained(parameters, shape, weights)?;
    let sampler = Sampler::new(parameters, *count, seed);
    let parts = (design, sampler, observations.observations());
    Ok(Box::new(LinearThompsonPolicy::new(parameters, parts, posterior, actions)?))
}

/// Number of lanes in training.
const LANES: usize = 1;
/// Costs of parts of a step, in multiply-adds that take equally long, as timed by
/// `benches/jobs.rs`.
const PER_PREDICTION: u64 = 500;
const PER_FACTOR: u64 = 20_000;
const PER_INTEGRAL: u64 = 100_000;
const PER_DRAW: u64 = 500;
/// Cost of a draw with the softmax, relative to a draw with the maximum.
const SOFTMAX: u64 = 8;
