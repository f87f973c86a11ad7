//! A job: the complete content of a training and its test.

use std::path::Path;
use std::time::Duration;

use serde_json::{Map, Value as Json};

use super::identity::{agent_text, environment_text, people_text, text};
use super::metric::TERMINATION_RATE;
use super::{
    CanonicalForm, Evaluation, JobKey, MetricName, Pooling, RecordedEpisodes, Scalar, StateNames,
    TestActions, Trial, UpdateData, Versions,
};
use crate::agent::{Agent, Algorithm, Engine, External, Task, Work};
use crate::env::outside::OutsideModel;
use crate::env::{Environment, Family, Scenario, recorded};
use crate::key::{
    CanonicalError, Key, Keyed, Parameter, PerSection, SectionName, Value, free_key, read_object,
};

/// The complete content of a training and its test.
///
/// Jobs are identified by content: two jobs are the same if their canonical forms and versions are equal,
/// whatever their manifests and agent names.
#[derive(Clone, Debug, PartialEq)]
pub struct Job {
    /// The environment: its family, its parameters and its participants.
    pub environment: Environment,
    /// The scenario that the agent observes.
    pub scenario: Scenario,
    /// The algorithm with its hyper-parameters, including the budget.
    pub agent: Agent,
    /// How the trained agent is tested and its training recorded.
    pub evaluation: Evaluation,
    /// The trial in which the agent meets people; `None` if people come one after another.
    pub trial: Option<Trial>,
    /// Seed of the job's random streams.
    pub seed: u64,
}

/// Why a text is not the canonical form of a job.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum JobError {
    /// The text is not JSON.
    #[error("not JSON: {0}")]
    Syntax(#[from] serde_json::Error),
    /// A part is missing, unknown or of another type.
    #[error("`{0}` is missing, unknown or of another type")]
    Part(String),
    /// The algorithm is not registered.
    #[error("there is no algorithm `{0}`")]
    Algorithm(String),
    /// The keys of a part are not the keys of its table.
    #[error("in `{part}`: {error}")]
    Keys {
        /// The part.
        part: &'static str,
        /// What is wrong.
        error: CanonicalError,
    },
    /// The text describes a job, but is not its canonical form.
    #[error("its canonical form is {0}")]
    Spelling(String),
}

/// Why the results of a job have no weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NoWeights {
    /// The algorithm has none.
    #[error("agents of the algorithm `{0}` have no weights")]
    Algorithm(&'static str),
    /// The job is a trial in which each person has an agent.
    #[error(
        "in its trial, each person has an agent (`pooling = \"none\"`); a trial with `pooling = \"full\"` has one policy"
    )]
    NotPooled,
    /// The job is a trial in which each group of people has an agent.
    #[error(
        "in its trial, each group of people has an agent; a trial with `pooling = \"full\"` has one policy"
    )]
    Grouped,
    /// The job records metrics alone.
    #[error(
        "it stores metrics alone (`record_episodes = \"none\"`); a job with `record_episodes = \"all\"` stores its weights"
    )]
    NotRecorded,
}

/// The number of multiply-adds that take as long as a step of the simulation.
const PER_SIMULATED_STEP: u64 = 500;

/// Fixed time of every job, in seconds, for its claim, rows and transaction.
const LEAST_SECONDS: f64 = 0.001;

impl Job {
    /// The algorithm's name, as in the manifest.
    pub fn algorithm(&self) -> &'static str {
        self.agent.algorithm().name()
    }

    /// Why the results have no weights; `None` if they have weights.
    pub fn no_weights(&self) -> Option<NoWeights> {
        if !self.agent.algorithm().has_weights() {
            return Some(NoWeights::Algorithm(self.algorithm()));
        }
        match self.trial.as_ref().map(|trial| trial.pooling) {
            None | Some(Pooling::Full | Pooling::Partial) => {}
            Some(Pooling::None) => return Some(NoWeights::NotPooled),
            Some(Pooling::Groups(_)) => return Some(NoWeights::Grouped),
        }
        let is_recorded = self.evaluation.record_episodes == RecordedEpisodes::All;
        (!is_recorded).then_some(NoWeights::NotRecorded)
    }

    /// The metric that is the share of episodes that were terminated.
    pub fn termination_metric(&self) -> MetricName {
        let name = self.environment.family().termination_metric;
        MetricName::named(name).unwrap_or(TERMINATION_RATE)
    }

    /// Whether no action of the evaluation is drawn by chance.
    pub fn never_draws(&self) -> bool {
        let is_greedy = self.evaluation.test_actions == TestActions::Greedy;
        (is_greedy && self.trial.is_none() && self.agent.algorithm().learns())
            || self.agent.never_draws()
    }

    /// Whether numbers of the state can be missing, as in the file of a recorded trial.
    pub fn can_miss_numbers(&self) -> bool {
        self.environment.family() == &recorded::FAMILY
    }

    /// Whether the agent or the environment is an outside program.
    pub fn is_outside(&self) -> bool {
        self.agent.parameters::<External>().is_some() || self.environment.family().is_external()
    }

    /// The words of the commands of the outside programs that take part; empty if there is none.
    pub fn programs(&self) -> Vec<String> {
        let agent = self.agent.parameters::<External>().map(|external| external.command);
        let model = self.environment.model::<OutsideModel>();
        let environment = model.map(|model| model.launch(Path::new("")).command);
        agent.into_iter().chain(environment).flatten().collect()
    }

    /// The names of the numbers in the recorded state of a decision, as far as they are known before the job runs.
    pub fn state_names(&self) -> StateNames {
        StateNames::new(&self.environment, self.trial.iter().flat_map(Trial::state_names))
    }

    /// The versions of the code that this job would run with.
    pub fn versions(&self) -> Versions {
        let differs = self.agent.differs_in(&self.task());
        Versions {
            environment: self.environment.version(&self.scenario)
                + u32::from(self.differs_in_trial()),
            algorithm: self.agent.version() + u32::from(differs),
        }
    }

    /// Whether the simulation of its trial has changed: people who have left no longer count as people in the
    /// study, and recorded decisions have whether their outcome reached the agent.
    fn differs_in_trial(&self) -> bool {
        let Some(trial) = &self.trial else { return false };
        let forgets = trial.update_data == UpdateData::InStudy
            && trial.pooling == Pooling::Full
            && self.agent.algorithm().learns()
            && self.environment.can_end_early();
        let hides = trial.missing_outcomes > 0.0 && self.evaluation.record_decisions.of_test();
        forgets || hides
    }

    /// The task that the agent learns.
    pub fn task(&self) -> Task<'_> {
        Task {
            environment: &self.environment,
            scenario: &self.scenario,
            seed: self.seed,
            history: self.agent.history(),
        }
    }

    /// The work of the job if no episode ends early, in multiply-adds.
    pub fn work(&self) -> u64 {
        let (training, rest) = self.parts_of_work();
        training.saturating_add(rest)
    }

    /// The expected time on one core of a recent server processor if no episode ends early, from
    /// [`Job::work`] and the algorithm's declared speed.
    pub fn expected_time(&self) -> Duration {
        let (training, rest) = self.parts_of_work();
        let seconds = training as f64 / self.agent.speed() + rest as f64 / Engine::Fused.speed();
        Duration::try_from_secs_f64(LEAST_SECONDS + seconds).unwrap_or(Duration::MAX)
    }

    /// The part of the expected time that is over once this part of the training is over, both from 0 to 1. The
    /// rest is the test.
    pub fn part_of_time(&self, trained: f64) -> f64 {
        if self.trial.is_some() {
            return trained;
        }
        let Work { choice, .. } = self.agent.work(&self.task());
        let tested = self.task().steps(self.evaluation.test_episodes);
        let test = tested.saturating_mul(PER_SIMULATED_STEP.saturating_add(choice));
        let test = test as f64 / Engine::Fused.speed() / self.expected_time().as_secs_f64();
        trained * (1.0 - test.min(1.0))
    }

    /// The multiply-adds of the training, and of the simulation and the test together.
    fn parts_of_work(&self) -> (u64, u64) {
        let task = self.task();
        let Work { training, choice } = self.agent.work(&task);
        let (trained, tested) = match &self.trial {
            Some(trial) => (0, trial.people),
            None => (self.agent.episodes(), self.evaluation.test_episodes),
        };
        let simulated = (task.steps(trained) + task.steps(tested)) * PER_SIMULATED_STEP;
        let chosen = task.steps(tested).saturating_mul(choice);
        let training = if self.trial.is_some() { 0 } else { training };
        (training, simulated.saturating_add(chosen))
    }

    /// The canonical form, which determines the key.
    pub fn form(&self) -> CanonicalForm {
        self.form_of(&PerSection::of(|section| self.text_of(section)))
    }

    /// The canonical text of a section; empty if the job leaves it out.
    pub fn text_of(&self, section: SectionName) -> String {
        match section {
            SectionName::Environment => environment_text(&self.environment),
            SectionName::Population => match people_text(&self.environment) {
                // Jobs stored before populations were introduced omit them.
                text if text == "{}" => String::new(),
                differing => differing,
            },
            SectionName::Agent => agent_text(&self.agent),
            SectionName::Evaluation => text(&self.evaluation),
            SectionName::Trial => self.trial.as_ref().map(text).unwrap_or_default(),
        }
    }

    /// The canonical form, given the texts of the job's sections.
    pub fn form_of(&self, texts: &PerSection<String>) -> CanonicalForm {
        // A scenario consists of words and hyphens, so nothing needs escaping.
        let (scenario, seed) = (format!("\"{}\"", self.scenario), self.seed.to_string());
        let mut members = vec![("scenario", scenario.as_str()), ("seed", &seed)];
        let sections =
            SectionName::ALL.iter().map(|section| (section.word(), &texts[*section][..]));
        members.extend(sections.filter(|(_, text)| !text.is_empty()));
        members.sort_unstable_by_key(|(name, _)| *name);
        let length = members.iter().map(|(name, text)| name.len() + text.len() + 4).sum::<usize>();
        let mut form = String::with_capacity(length + 1);
        for (name, text) in members {
            form.push(if form.is_empty() { '{' } else { ',' });
            form.extend(["\"", name, "\":", text]);
        }
        form.push('}');
        CanonicalForm::new(form, self.versions())
    }

    /// The job as one line of JSON; see [`CanonicalForm::text`].
    pub fn canonical(&self) -> String {
        self.form().text().to_owned()
    }

    /// See [`CanonicalForm::key`].
    pub fn key(&self) -> JobKey {
        self.form().key()
    }

    /// The job of a canonical form that this or an earlier version of the program wrote.
    ///
    /// **Errors**: the text is not a canonical form, or names an algorithm that is not registered.
    pub fn from_canonical(text: &str) -> Result<Job, JobError> {
        let mut parts: Map<String, Json> = serde_json::from_str(text)?;
        let mut take = |part: &str| parts.remove(part);
        let part = |name: &str| JobError::Part(name.to_owned());
        let (Some(Json::Object(environment)), Some(Json::Object(evaluation))) =
            (take("environment"), take("evaluation"))
        else {
            return Err(part("environment` or `evaluation"));
        };
        // Jobs without differing participants omit the population.
        let population = match take("population") {
            None => Map::new(),
            Some(Json::Object(population)) if !population.is_empty() => population,
            Some(_) => return Err(part("population")),
        };
        let trial = match take("trial") {
            None => None,
            Some(Json::Object(trial)) => Some(read("trial", &trial)?),
            Some(_) => return Err(part("trial")),
        };
        let Some(Json::Object(mut agent)) = take("agent") else { return Err(part("agent")) };
        let scenario =
            take("scenario").and_then(|scenario| scenario.as_str()?.parse::<Scenario>().ok());
        let seed = take("seed").and_then(|seed| seed.as_u64());
        if let Some(unknown) = parts.keys().next() {
            return Err(part(unknown));
        }
        let Some(Json::String(algorithm)) = agent.remove("algorithm") else {
            return Err(part("agent.algorithm"));
        };
        let Some(mut algorithm) = Algorithm::named(&algorithm) else {
            return Err(JobError::Algorithm(algorithm));
        };
        if algorithm.is_external() {
            // Keys that are not parameter names are rejected below.
            let free = agent.keys().map(String::as_str).filter(|key| free_key(key).is_some());
            algorithm = Algorithm::external(free).ok_or_else(|| part("agent"))?;
        }
        let environment = read_environment(environment, &population)?;
        let check = environment.family().check_scenario;
        let job = Job {
            environment,
            scenario: scenario
                .filter(|scenario| check(scenario).is_ok())
                .ok_or_else(|| part("scenario"))?,
            agent: Agent::with_values(algorithm, values("agent", algorithm.keys(), &agent)?)
                .ok_or_else(|| part("agent"))?,
            evaluation: read("evaluation", &evaluation)?,
            trial,
            seed: seed.ok_or_else(|| part("seed"))?,
        };
        match job.canonical() {
            canonical if canonical == text => Ok(job),
            canonical => Err(JobError::Spelling(canonical)),
        }
    }

    /// The job with these values of the keys of its sections; `None` if they are of other kinds. A job without values of
    /// a trial has no trial.
    pub fn of_values(
        (family, algorithm): (&'static Family, &'static Algorithm),
        (scenario, seed): (Scenario, u64),
        values: &dyn Fn(SectionName) -> Vec<Value>,
    ) -> Option<Job> {
        let of_people = values(SectionName::Population);
        Some(Job {
            environment: (family.read)(family, &values(SectionName::Environment), &of_people)?,
            scenario,
            agent: Agent::with_values(algorithm, values(SectionName::Agent))?,
            evaluation: Evaluation::from_values(&values(SectionName::Evaluation))?,
            trial: trial_of(&values(SectionName::Trial))?,
            seed,
        })
    }

    /// Sets a section to the values of its keys; `None` if they are of other kinds.
    pub fn set_section(
        &mut self,
        section: SectionName,
        values: &dyn Fn(SectionName) -> Vec<Value>,
    ) -> Option<()> {
        let own = values(section);
        match section {
            // How people differ is part of the environment.
            SectionName::Environment | SectionName::Population => {
                let family = self.environment.family();
                let of_people = values(SectionName::Population);
                let of_environment = values(SectionName::Environment);
                self.environment = (family.read)(family, &of_environment, &of_people)?;
            }
            SectionName::Agent => self.agent = Agent::with_values(self.agent.algorithm(), own)?,
            SectionName::Evaluation => self.evaluation = Evaluation::from_values(&own)?,
            SectionName::Trial => self.trial = trial_of(&own)?,
        }
        Some(())
    }

    /// The sections with their keys and values, in the order of their names: the agent comes first.
    pub fn sections(&self) -> [(SectionName, &'static [Key], Vec<Value>); SectionName::ALL.len()] {
        let mut names = SectionName::ALL;
        names.sort_unstable_by_key(|name| name.word());
        names.map(|name| {
            let (keys, values) = self.section(name);
            (name, keys, values)
        })
    }

    /// The keys of a section with their values; none for a trial that the job does not have.
    pub fn section(&self, section: SectionName) -> (&'static [Key], Vec<Value>) {
        let family = self.environment.family();
        match section {
            SectionName::Environment => (family.keys, self.environment.values()),
            SectionName::Population => (family.people, self.environment.people_values()),
            SectionName::Agent => (self.agent.algorithm().keys(), self.agent.values().to_vec()),
            SectionName::Evaluation => (Evaluation::KEYS, self.evaluation.to_values()),
            SectionName::Trial => match &self.trial {
                Some(trial) => (Trial::KEYS, trial.to_values()),
                None => (&[], Vec::new()),
            },
        }
    }

    /// The value of a parameter; `None` if the job's algorithm lacks the key, and for the agent's name, which
    /// is not part of a job.
    pub fn value(&self, parameter: Parameter) -> Option<Value> {
        match parameter {
            Parameter::SCENARIO => return Some(Value::Text(self.scenario.to_string())),
            Parameter::SEED => return Some(Value::Integer(self.seed)),
            Parameter::ALGORITHM => return Some(Value::Choice(self.algorithm())),
            _ => {}
        }
        let (keys, values) = self.section(parameter.section()?);
        let index = keys.iter().position(|key| key.name == parameter.key())?;
        Some(values[index].clone())
    }

    /// The value of a parameter, if the job has it and it is a number.
    pub fn number(&self, parameter: Parameter) -> Option<f64> {
        Scalar::from(&self.value(parameter)?).number()
    }

    /// All parameters as dotted names and values, as the view `parameter` shows them, in the order of their
    /// names.
    pub fn parameters(&self) -> Vec<(String, Scalar)> {
        let mut parameters = vec![
            ("agent.algorithm".to_owned(), Scalar::Text(self.algorithm().to_owned())),
            ("scenario".to_owned(), Scalar::Text(self.scenario.to_string())),
            ("seed".to_owned(), Scalar::Integer(self.seed as i64)),
        ];
        for (section, keys, values) in self.sections() {
            let name = |key: &'static Key| section.parameter(key.name).to_string();
            let named = keys.iter().zip(&values);
            parameters.extend(named.map(|(key, value)| (name(key), Scalar::from(value))));
        }
        parameters.sort_by(|(one, _), (other, _)| one.cmp(other));
        parameters
    }
}

impl From<Job> for CanonicalForm {
    fn from(job: Job) -> CanonicalForm {
        job.form()
    }
}

impl From<&Job> for CanonicalForm {
    fn from(job: &Job) -> CanonicalForm {
        job.form()
    }
}

/// The trial with these values of its keys, which a job without a trial does not have; the outer `None` if they are of
/// other kinds.
fn trial_of(values: &[Value]) -> Option<Option<Trial>> {
    if values.is_empty() { Some(None) } else { Trial::from_values(values).map(Some) }
}

/// The environment written by [`environment_text`] and [`people_text`].
fn read_environment(
    mut environment: Map<String, Json>,
    population: &Map<String, Json>,
) -> Result<Environment, JobError> {
    let part = || JobError::Part("environment.family".to_owned());
    let mut family = match environment.remove("family") {
        None => Family::first(),
        Some(name) => {
            let name = name.as_str().ok_or_else(part)?;
            let retired = || Family::retired(name).map(|(family, _)| family);
            Family::named(name).or_else(retired).ok_or_else(part)?
        }
    };
    if let Some(with_parameters) = family.with_parameters {
        // Keys that are not parameter names are rejected below.
        let free = environment.keys().map(String::as_str).filter(|key| free_key(key).is_some());
        family = with_parameters(&free.collect::<Vec<_>>()).ok_or_else(part)?;
    }
    let parameters = values("environment", family.keys, &environment)?;
    let people = values("population", family.people, population)?;
    (family.read)(family, &parameters, &people)
        .ok_or_else(|| JobError::Part("environment".to_owned()))
}

/// The typed struct of a part written by [`text`].
fn read<T: Keyed>(part: &'static str, object: &Map<String, Json>) -> Result<T, JobError> {
    let values = values(part, T::KEYS, object)?;
    T::from_values(&values).ok_or_else(|| JobError::Part(part.to_owned()))
}

fn values(
    part: &'static str,
    keys: &[Key],
    object: &Map<String, Json>,
) -> Result<Vec<Value>, JobError> {
    read_object(keys, object).map_err(|error| JobError::Keys { part, error })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::{DecisionRule, DuelingDqn, Reinforce, RuleParameters};
    use crate::env::StepCount;
    use crate::job::RecordedDecisions;

    fn jobs() -> Vec<Job> {
        let agents = [
            Agent::of(&DuelingDqn::default()),
            Agent::of(&Reinforce::default()),
            Agent::of(&RuleParameters::new(DecisionRule::Random)),
        ];
        let job = |agent| Job {
            environment: StepCount::paper(0.6).into(),
            scenario: "P-H-D".parse().unwrap(),
            agent,
            evaluation: Evaluation::default(),
            trial: None,
            seed: i64::MAX as u64,
        };
        agents.map(job).into()
    }

    #[test]
    fn the_work_of_jobs_is_that_worked_by_hand() {
        // Three inputs, two layers of 128 units, and heads of 1 and 4 outputs; or one layer and 4 logits.
        let (dueling, policy) = (4 * 128 + 129 * 128 + 129 * 5, 4 * 128 + 129 * 4);
        // Three passes through the network per batch of 64 and one row for the choice; then Adam.
        let of_dqn = 50_000 * ((64 * 3 + 1 + 14) * dueling + 3500);
        // Each step takes one pass for the choice and three for learning; Adam runs after every episode.
        let of_reinforce = 750_000 * (4 * policy + 3500) + 15_000 * 14 * policy;
        let expected = [
            of_dqn + 500 * 100_000 + 50_000 * dueling,
            of_reinforce + 500 * 800_000 + 50_000 * policy,
            500 * 50_000 + 50_000,
        ];
        assert_eq!(jobs().iter().map(Job::work).collect::<Vec<_>>(), expected);
    }

    #[test]
    fn a_stored_job_of_a_retired_family_is_read_and_not_run() {
        let text = include_str!("../../tests/data/retired_oralytics_job.json").trim_end();
        let job = Job::from_canonical(text).unwrap();
        assert_eq!(job.canonical(), text);
        assert_eq!(job.key().to_string(), "af472f17f9add115294762c1e692c359");
        assert_eq!(job.environment.return_unit(), "seconds of brushing");
        assert!(job.runnable().is_err());
    }

    #[test]
    fn versions_are_higher_in_the_jobs_alone_whose_results_changed() {
        let raised = |change: &dyn Fn(&mut StepCount)| {
            let versions = jobs().into_iter().map(|mut job| {
                let before = job.versions();
                job.environment.change(change);
                let Versions { environment, algorithm } = job.versions();
                (environment - before.environment, algorithm - before.algorithm)
            });
            versions.collect::<Vec<_>>()
        };
        assert_eq!(raised(&|_| {}), [(0, 0); 3]);
        assert_eq!(raised(&|environment| environment.unpaid_last_step = true), [(1, 0); 3]);
        let of_beliefs = |scenario: &str, noise: f64| {
            let environment = StepCount {
                parameter_spread: noise,
                context_persistence: 0.5,
                ..StepCount::paper(0.6)
            };
            let scenario = scenario.parse().unwrap();
            let job = Job { environment: environment.into(), scenario, ..jobs().remove(2) };
            job.versions().environment - jobs()[2].versions().environment
        };
        assert_eq!(
            ["F-E-R", "F-E", "F-S", "P-H"].map(|letters| of_beliefs(letters, 0.0)),
            [1, 0, 0, 0]
        );
        assert_eq!(
            ["F-E-R", "F-E", "F-S", "F"].map(|letters| of_beliefs(letters, 0.5)),
            [1, 1, 1, 0]
        );
        assert_eq!(raised(&|environment| environment.availability = 0.9), [(0, 1), (0, 1), (0, 0)]);
    }

    #[test]
    fn versions_are_higher_in_the_trials_alone_whose_results_changed() {
        let in_trial = |change: &dyn Fn(&mut Trial)| {
            let required = [Value::Integer(4), Value::Integer(50)];
            let mut trial = Trial::with_required(&required);
            change(&mut trial);
            let versions = jobs().into_iter().map(|job| {
                let mut evaluation = job.evaluation.clone();
                evaluation.record_decisions = RecordedDecisions::Test;
                let before = job.versions().environment;
                Job { trial: Some(trial.clone()), evaluation, ..job }.versions().environment
                    - before
            });
            versions.collect::<Vec<_>>()
        };
        assert_eq!(in_trial(&|_| {}), [0; 3]);
        assert_eq!(in_trial(&|trial| trial.dropout = 0.1), [0; 3]);
        assert_eq!(in_trial(&|trial| trial.missing_outcomes = 0.1), [1; 3]);
        // The third is a rule.
        let in_study = |trial: &mut Trial| trial.update_data = UpdateData::InStudy;
        assert_eq!(in_trial(&in_study), [1, 1, 0]);
        assert_eq!(
            in_trial(&|trial| {
                in_study(trial);
                trial.pooling = Pooling::None;
            }),
            [0; 3]
        );
    }

    #[test]
    fn versions_are_higher_of_the_rules_alone_whose_results_changed() {
        let threshold = |sigma: f64, scenario: &str, threshold: f64| {
            let rule = RuleParameters { threshold, ..RuleParameters::new(DecisionRule::Threshold) };
            let scenario = scenario.parse().unwrap();
            let environment = StepCount::paper(sigma).into();
            let agent = Agent::of(&rule);
            let job = Job { environment, scenario, agent, ..jobs().remove(2) };
            job.versions().algorithm - jobs()[2].versions().algorithm
        };
        assert_eq!(threshold(0.0, "P-T", 0.8), 1);
        // The context is shown, some are not certain, or the first one is enough.
        assert_eq!(threshold(0.0, "C-T", 0.8), 0);
        assert_eq!(threshold(0.0, "L-T", 0.8), 0);
        assert_eq!(threshold(0.6, "P-T", 0.8), 0);
        assert_eq!(threshold(0.0, "P-T", 0.5), 0);
        let optimal = |message_cost: f64| {
            let agent = Agent::of(&RuleParameters::new(DecisionRule::Optimal));
            let environment = StepCount { message_cost, ..StepCount::paper(0.6) }.into();
            Job { environment, agent, ..jobs().remove(2) }.versions().algorithm
        };
        assert_eq!(optimal(5.0), optimal(0.0) + 1);
    }

    #[test]
    fn the_canonical_form_is_the_whole_job_with_its_keys_in_order() {
        for job in jobs() {
            let canonical = job.canonical();
            let json: Json = serde_json::from_str(&canonical).unwrap();
            assert_eq!(json.to_string(), canonical);
            assert_eq!(Job::from_canonical(&canonical).unwrap(), job);
            let members = |part: &str| json[part].as_object().unwrap().len();
            let written = StepCount::KEYS.iter().filter(|key| key.before().is_none());
            assert_eq!(members("environment"), written.count());
            let keys = job.agent.algorithm().keys().iter();
            let written = keys.filter(|key| key.before().is_none()).count();
            assert_eq!(members("agent"), written + 1);
        }
    }

    #[test]
    fn what_is_no_canonical_form_is_refused_with_its_reason() {
        let canonical = jobs()[1].canonical();
        let refused = |from: &str, to: &str| {
            assert!(canonical.contains(from), "{from}");
            Job::from_canonical(&canonical.replacen(from, to, 1)).unwrap_err().to_string()
        };
        assert_eq!(refused("reinforce", "sarsa"), "there is no algorithm `sarsa`");
        assert_eq!(
            refused("\"sigma\":0.6", "\"sigma\":[]"),
            "in `environment`: key `sigma` has a value of another type"
        );
        assert_eq!(refused(",\"sigma\":0.6", ""), "in `environment`: key `sigma` is missing");
        assert_eq!(refused("\"sigma\"", "\"stigma\""), "in `environment`: key `stigma` is unknown");
        assert_eq!(refused("P-H-D", "P-P"), "`scenario` is missing, unknown or of another type");
        assert_eq!(
            refused("{\"agent\"", "{\"a\":1,\"agent\""),
            "`a` is missing, unknown or of another type"
        );
        assert!(refused("}", "").starts_with("not JSON"));
        // Other spellings of the same numbers.
        let sigma = |text: &str| refused("\"sigma\":0.6", &format!("\"sigma\":{text}"));
        for spelling in ["6e-1", "0.60"] {
            assert!(sigma(spelling).starts_with("its canonical form is {\"agent\""), "{spelling}");
        }
        assert!(sigma("1").contains("\"sigma\":1.0"));
        assert!(sigma("-0.0").contains("\"sigma\":0.0"));
        // A layer wider than the integer type of the struct.
        let wide = refused("[128]", "[4294967296]");
        assert_eq!(wide, "in `agent`: key `layers` has a value of another type");
    }

    #[test]
    fn zero_has_one_sign_and_no_key_is_infinite() {
        let with = |sigma| Job { environment: StepCount::paper(sigma).into(), ..jobs().remove(0) };
        assert_eq!(with(-0.0).key(), with(0.0).key());
        let infinite = std::panic::catch_unwind(|| with(f64::INFINITY).key());
        assert!(infinite.is_err());
    }

    #[test]
    fn parameters_are_listed_once_in_the_order_of_their_names() {
        for job in jobs() {
            let parameters = job.parameters();
            assert!(parameters.is_sorted_by(|(one, _), (other, _)| one < other));
            let value =
                |name: &str| parameters.iter().find(|(known, _)| known == name).unwrap().1.clone();
            assert_eq!(value("environment.mu"), Scalar::Text("[0.1,0.1]".to_owned()));
            assert_eq!(value("environment.rho_1"), Scalar::Real(50.0));
            assert_eq!(value("environment.time_one_hot"), Scalar::Integer(0));
            assert_eq!(value("seed"), Scalar::Integer(i64::MAX));
            assert_eq!(job.value(Parameter::Environment("rho_1")), Some(Value::Real(50.0)));
            assert_eq!(job.value(Parameter::Agent("sigma")), None);
        }
    }
}
