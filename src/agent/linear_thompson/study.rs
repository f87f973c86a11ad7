//! Linear Thompson sampling in a trial: many people at once, and updates at calendar times.

use pulp::{Simd, WithSimd};

use crate::agent::Actions;
use crate::agent::actor::{Actor, Rewards, StudyAgent, StudyUpdate};
use crate::agent::effect_posterior::EffectPosterior;
use crate::agent::layers::Shape;
use crate::agent::learner::LearnerError;
use crate::agent::linear_thompson::partial::Pooled;
use crate::agent::linear_thompson::posterior::{Acting, Decision, Made, regressors};
use crate::agent::linear_thompson::regression::{NotPositiveDefinite, Regression};
use crate::agent::linear_thompson::sampler::Sampler;
use crate::agent::linear_thompson::updates::Updates;
use crate::agent::linear_thompson::{BanditDraw, Design, LinearThompson, Posterior};
use crate::agent::registry::{Sharing, StudyPlan};
use crate::agent::unavailable::Unavailable;
use crate::agent::weights::{Tensor, Weights};
use crate::env::{Action, EpisodeStatus, Observations, Simulated, VectorEnvironment};
use crate::kernel::Isa;
use crate::rng::Stream;
use crate::state::resumable;

/// A bandit in a trial: one for everybody, one for each person or group, or one in which people deviate. An update starts
/// from the prior and the data that count, so that the data of people who have left can be forgotten.
pub struct LinearThompsonStudy {
    sampler: Sampler,
    design: Design,
    unavailable: Unavailable,
    prior: Posterior,
    /// The posteriors from which actions are chosen: one per agent, or one per person with partial pooling; and which of
    /// them is each person's, \[people\].
    acting: Vec<Acting>,
    acting_of: Vec<usize>,
    /// How people deviate, per regression; `None` without partial pooling.
    pooled: Option<Vec<Pooled>>,
    people: Vec<Person>,
    /// The decisions of the last step, one per person, and whether the agent made them.
    decisions: Vec<Decision>,
    chooses: Vec<bool>,
    /// The number of steps of the trial so far.
    time: u32,
    /// The last observations, if they are read: features in full precision need none in some families.
    observations: Observations,
    observes: bool,
    letters: Vec<f64>,
    /// Coefficients of an episode, which trials do not have.
    drawn: Vec<f64>,
    /// What the one agent of the trial learned at its updates; `None` if it is not kept.
    updates: Option<Updates>,
}

/// The data of a person.
struct Person {
    /// The sums over the first decisions, those that have counted in an update, and their number.
    known: Posterior,
    counted: usize,
    /// The steps of the trial at which the person's decisions were made, \[decisions\]; their actions and rewards; their
    /// features, \[decisions, features\], and probabilities, \[decisions, actions\].
    times: Vec<u32>,
    actions: Vec<u8>,
    rewards: Vec<f64>,
    features: Vec<f64>,
    probabilities: Vec<f64>,
}

impl Person {
    /// A person before the first decision, with memory for this number of decisions, but no more than for 256.
    fn new(known: Posterior, decisions: usize, shape: Shape) -> Person {
        let decisions = decisions.min(256);
        Person {
            known,
            counted: 0,
            times: Vec::with_capacity(decisions),
            actions: Vec::with_capacity(decisions),
            rewards: Vec::with_capacity(decisions),
            features: Vec::with_capacity(decisions * shape.inputs),
            probabilities: Vec::with_capacity(decisions * shape.actions),
        }
    }

    /// Records a decision with its reward.
    fn push(&mut self, time: u32, decision: &Decision, reward: f64) {
        self.times.push(time);
        self.actions.push(decision.action.index() as u8);
        self.rewards.push(reward);
        self.features.extend_from_slice(&decision.features);
        self.probabilities.extend_from_slice(&decision.probabilities);
    }

    /// Counts the decisions before a step.
    #[inline(always)]
    fn count(&mut self, before: u32) {
        let decisions = self.times.len().max(1);
        let [features, chances] =
            [&self.features, &self.probabilities].map(|all| all.len() / decisions);
        while self.times.get(self.counted).is_some_and(|time| *time < before) {
            let index = self.counted;
            let decision = Made {
                features: &self.features[index * features..(index + 1) * features],
                probabilities: &self.probabilities[index * chances..(index + 1) * chances],
                action: Action::from_index(self.actions[index].into()).unwrap_or_default(),
            };
            self.known.learn_made(decision, self.rewards[index]);
            self.counted += 1;
        }
    }

    /// Whether the arrays belong to the same decisions.
    fn fits(&self) -> bool {
        let decisions = self.times.len();
        let arrays = [self.actions.len(), self.rewards.len()];
        let tables = [self.features.len(), self.probabilities.len()];
        arrays.iter().all(|length| *length == decisions)
            && tables.iter().all(|length| *length % decisions.max(1) == 0)
            && self.counted <= decisions
    }
}

/// The sum of a prior and the data of some people before a step.
struct Sum<'a> {
    posterior: Posterior,
    all: &'a mut [Person],
    people: &'a [bool],
    before: u32,
}

impl WithSimd for Sum<'_> {
    type Output = (Posterior, u64);

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) -> (Posterior, u64) {
        let mut steps = 0;
        for (person, _) in self.all.iter_mut().zip(self.people).filter(|(_, counts)| **counts) {
            person.count(self.before);
            self.posterior.add(&person.known);
            steps += person.counted as u64;
        }
        (self.posterior, steps)
    }
}

impl LinearThompsonStudy {
    /// The agent before the first step of a trial with this plan; with one posterior for everybody, or one per person.
    pub fn new(
        parameters: &LinearThompson,
        environment: &Simulated,
        StudyPlan { people, decisions, sharing, keeps_updates }: StudyPlan,
        seed: u64,
    ) -> Self {
        let spec = environment.observation_spec();
        let design = Design::new(parameters.features, &spec);
        let actions = environment.action_spec().count;
        let shape = Shape { inputs: design.width(), actions };
        let prior = match sharing {
            Sharing::Partial => Posterior::common_prior(parameters, shape),
            Sharing::Everybody | Sharing::Apart(_) => Posterior::prior(parameters, shape),
        };
        // Coefficients are drawn for each step: a trial has no episodes that begin together.
        let by_step = LinearThompson { draw: BanditDraw::Step, ..parameters.clone() };
        let person = || Person::new(prior.without_data(), decisions, shape);
        let posteriors_kept = !matches!(sharing, Sharing::Apart(_));
        let mut pooled = (sharing == Sharing::Partial).then(|| {
            let sizes = regressors(parameters, shape);
            let sds = parameters.person_sd.of_coefficients(sizes, shape.inputs);
            // Where the prior is a posterior, the noise of rewards is the scale of deviations.
            let scale = (!parameters.prior_from.is_none()).then_some(parameters.noise_sd);
            Pooled::all(prior.regressions(), sds.as_deref(), scale)
        });
        let mut newcomer = prior.clone();
        for (pooled, out) in pooled.iter_mut().flatten().zip(newcomer.regressions_mut()) {
            pooled.person(None, out).expect("a prior is positive definite");
        }
        let acting = Acting::new(newcomer).expect("a prior is positive definite");
        let acting_of = match sharing {
            Sharing::Everybody => vec![0; people],
            Sharing::Partial => (0..people).collect(),
            Sharing::Apart(agents) => {
                let mut acting_of = vec![0; people];
                for (agent, people) in agents.iter().enumerate() {
                    people.iter().for_each(|person| acting_of[*person] = agent);
                }
                acting_of
            }
        };
        let posteriors = acting_of.iter().max().map_or(1, |last| last + 1);
        LinearThompsonStudy {
            sampler: Sampler::new(&by_step, actions, seed),
            unavailable: parameters.unavailable,
            acting: vec![acting; posteriors],
            acting_of,
            pooled,
            people: (0..people).map(|_| person()).collect(),
            decisions: vec![Decision::among(actions); people],
            chooses: vec![false; people],
            time: 0,
            observations: spec.observations(),
            observes: spec.one_hot > 0 || environment.exact_features_read_observations(),
            letters: Vec::new(),
            drawn: Vec::new(),
            updates: (posteriors_kept && keeps_updates).then(Updates::default),
            prior,
            design,
        }
    }

    /// Replaces the last choice by that of a record, from which the agent then learns.
    ///
    /// **Shapes**: `actions` is \[people\], `probabilities` \[people, actions\].
    pub fn replay(&mut self, actions: &[Action], probabilities: &[f64]) {
        let rows = probabilities.chunks_exact(self.sampler.actions());
        for ((decision, action), row) in self.decisions.iter_mut().zip(actions).zip(rows) {
            decision.action = *action;
            decision.probabilities.copy_from_slice(row);
        }
    }

    /// The posterior of the data of some people before a step, \[people\], and the number of their decisions.
    fn posterior(&mut self, people: &[bool], before: u32) -> (Posterior, u64) {
        let (posterior, all) = (self.prior.clone(), &mut self.people);
        Isa::chosen().run(Sum { posterior, all, people, before })
    }

    /// Updates the posteriors of all people, with the data of these people before a step, \[people\]; returns the number
    /// of their decisions.
    fn update_people(&mut self, people: &[bool], before: u32) -> Result<u64, LearnerError> {
        // The sum counts the decisions of the people.
        let (_, steps) = self.posterior(people, before);
        let learned = self.learn_deviations(people);
        learned.map(|()| steps).map_err(|_| LearnerError::Singular { steps })
    }

    /// Keeps the posteriors of an update, if they are kept.
    fn keep_people(&mut self) -> Result<(), NotPositiveDefinite> {
        let LinearThompsonStudy { pooled: Some(pooled), updates: Some(updates), .. } = self else {
            return Ok(());
        };
        let mut common = self.prior.clone();
        for (pooled, out) in pooled.iter().zip(common.regressions_mut()) {
            out.copy_from(pooled.common());
        }
        let common = Acting::new(common)?;
        let features = self.design.width();
        let deviations = Pooled::deviations_of_effects(pooled, features);
        let all = std::iter::once(&common).chain(&self.acting);
        updates.push(self.time, features, all, &deviations);
        Ok(())
    }

    fn learn_deviations(&mut self, people: &[bool]) -> Result<(), NotPositiveDefinite> {
        let LinearThompsonStudy { pooled, prior, acting, people: all, .. } = self;
        let mut number = 0;
        let numbers: Vec<Option<usize>> = all
            .iter()
            .zip(people)
            .map(|(person, counts)| {
                let has_data = *counts && person.counted > 0;
                number += usize::from(has_data);
                has_data.then(|| number - 1)
            })
            .collect();
        for (index, pooled) in pooled.iter_mut().flatten().enumerate() {
            let data = all.iter().map(|person| &person.known.regressions()[index]);
            let data: Vec<&Regression> = data.collect();
            let with_data = data.iter().zip(&numbers).filter(|(_, number)| number.is_some());
            let sums: Vec<&Regression> = with_data.map(|(data, _)| *data).collect();
            pooled.learn(&prior.regressions()[index], &sums)?;
            for ((data, number), acting) in data.iter().zip(&numbers).zip(acting.iter_mut()) {
                let known = number.map(|number| (number, *data));
                pooled.person(known, acting.regression_mut(index))?;
            }
        }
        acting.iter_mut().try_for_each(Acting::refresh)
    }

    /// Factors the posteriors; returns false if a precision is not positive definite.
    fn factors(&mut self) -> bool {
        self.acting.iter_mut().all(|acting| acting.refresh().is_ok())
    }

    /// The posterior of a person of whom nothing is known, as weights of its name, and beside it `person_mean`, the means
    /// of each person, and `person_sd`, the deviations.
    fn weights_of_people(&mut self) -> Result<Weights, LearnerError> {
        let everybody = vec![true; self.people.len()];
        let steps = self.update_people(&everybody, self.time)?;
        let mut newcomer = self.prior.clone();
        let pooled = self.pooled.iter_mut().flatten();
        for (pooled, out) in pooled.zip(newcomer.regressions_mut()) {
            let found = pooled.person(None, out);
            found.map_err(|_| LearnerError::Singular { steps })?;
        }
        let mut weights = newcomer.weights();
        let shape = weights.doubles["mean"].shape.clone();
        let means = (0..self.people.len()).flat_map(|person| self.means(person)).collect();
        let of_people = [vec![self.people.len()], shape.clone()].concat();
        let sds = self.pooled.iter().flatten().flat_map(|one| one.sds().to_vec()).collect();
        weights.doubles.extend([
            ("person_mean".to_owned(), Tensor { shape: of_people, values: means }),
            ("person_sd".to_owned(), Tensor { shape, values: sds }),
        ]);
        Ok(weights)
    }

    /// The means of all coefficients of a person's posterior.
    pub fn means(&mut self, person: usize) -> Vec<f64> {
        let index = self.acting_of[person];
        self.acting[index].factored().iter().flat_map(|one| one.mean().to_vec()).collect()
    }
}

impl Actor for LinearThompsonStudy {
    fn act(
        &mut self,
        environment: &Simulated,
        stream: &mut Stream,
        actions: &mut [Action],
        probabilities: Option<&mut [f64]>,
    ) {
        if self.observes {
            environment.observe(&mut self.observations);
        }
        let count = self.sampler.actions();
        let statuses = environment.statuses();
        for (person, action) in actions.iter_mut().enumerate() {
            // Drawn for everybody, so that choices do not depend on who is in the study.
            let word = stream.bits();
            let decision = &mut self.decisions[person];
            let is_running = statuses[person] == EpisodeStatus::Running;
            self.chooses[person] = is_running && self.unavailable.chooses(environment, person);
            if !self.chooses[person] {
                decision.withhold();
                *action = decision.action;
                continue;
            }
            environment.exact_features(person, &self.observations, &mut self.letters);
            let moment = self.observations.moment(person);
            self.design.fill_exact(&self.letters, moment, &mut decision.features);
            let acting = self.acting_of[person];
            let known = (&mut self.acting[acting], &mut self.drawn);
            self.sampler.choose(Actions::AsTrained, known, decision, word);
            *action = decision.action;
        }
        if let Some(probabilities) = probabilities {
            for (row, decision) in probabilities.chunks_exact_mut(count).zip(&self.decisions) {
                row.copy_from_slice(&decision.probabilities);
            }
        }
    }

    fn observe(&mut self, _: &Simulated, rewards: Rewards<'_>) {
        for (person, own) in self.people.iter_mut().enumerate() {
            if let (true, Some(reward)) = (self.chooses[person], rewards.of_lane(person)) {
                own.push(self.time, &self.decisions[person], reward);
            }
        }
        self.time += 1;
    }
}

impl StudyAgent for LinearThompsonStudy {
    fn update(&mut self, update: &StudyUpdate<'_>) -> Result<(), LearnerError> {
        if self.pooled.is_some() {
            let steps = self.update_people(update.people, update.before)?;
            return self.keep_people().map_err(|_| LearnerError::Singular { steps });
        }
        let (posterior, steps) = self.posterior(update.people, update.before);
        let acting = &mut self.acting[update.agent.unwrap_or(0)];
        acting.begin(&posterior);
        acting.refresh().map_err(|_| LearnerError::Singular { steps })?;
        if let Some(updates) = &mut self.updates {
            updates.push(self.time, self.design.width(), [&*acting].into_iter(), &[]);
        }
        Ok(())
    }

    fn replay(&mut self, actions: &[Action], probabilities: &[f64]) {
        self.replay(actions, probabilities);
    }

    fn updates(&mut self) -> Vec<EffectPosterior> {
        self.updates.take().map_or_else(Vec::new, |updates| updates.0)
    }

    /// The posterior of the prior and all data of everybody; `None` if each person has one.
    fn weights(&mut self) -> Result<Option<Weights>, LearnerError> {
        if self.pooled.is_some() {
            return self.weights_of_people().map(Some);
        }
        if self.acting.len() > 1 {
            return Ok(None);
        }
        let (posterior, steps) = self.posterior(&vec![true; self.people.len()], self.time);
        let last = Acting::new(posterior).map_err(|_| LearnerError::Singular { steps })?;
        Ok(Some(last.posterior().weights()))
    }
}

resumable!([] Person {
    parts known, counted;
    grown times, actions, rewards, features, probabilities;
    check fits, "decisions of a person"
});
// The factors are not saved.
resumable!([] LinearThompsonStudy {
    each acting;
    check factors, "posteriors of a trial";
    each people, decisions, chooses;
    parts time;
    each updates;
    each pooled
});
