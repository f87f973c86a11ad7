//! The truth of an excursion effect: what an estimator of a trial's effects estimates, by paired simulation.
//!
//! In: a job with a trial, and the declaration of an estimate. Out: the marginal excursion effect under the trial's own
//! policy: in the job's own trial, or over trials with seeds of their own, with its standard error.
//!
//! At every decision at which a message can be sent, copies of all people
//! take the treatment and no message, with the same chance; the trial itself goes on with the agent's choice. The effect
//! is the difference of both outcomes.
//!
//! **Source**: Boruvka, Almirall, Witkiewitz and Murphy, "Assessing time-varying causal effect moderation in mobile
//! health", Journal of the American Statistical Association, 2018. With moderators f(S), the truth is the projection of
//! the effects on f(S) with the weights of the estimand: one weight for every decision at which a message can be sent, as
//! the probability of the numerator is a constant there.

use crate::agent::StartError;
use crate::estimate::{Correction, Layout, NoFit, Sums};
use crate::job::{
    Decision, EstimateDeclaration, Failure, Job, Messages, ROWS, RecordedDecisions, Treatment,
};
use crate::key::Content;
use crate::rng::{Purpose, Stream};
use crate::train::excursions::Excursions;
use crate::train::study::Study;
use crate::train::training::{Stage, Training};

/// True coefficients of an effect.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// The coefficients, in the order of [`EstimateDeclaration::terms`].
    pub coefficients: Vec<f64>,
    /// Their standard errors, over trials.
    pub errors: Vec<f64>,
}

/// Why a truth cannot be computed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoTruth {
    /// The job has no trial.
    #[error("the truth of an effect is simulated for trials alone; declare [trial]")]
    NoTrial,
    /// The agent or the environment is an outside program.
    #[error(
        "the truth of an effect cannot be simulated with an outside program, which cannot return to an earlier \
         decision"
    )]
    Outside,
    /// The declaration or a file of the trial does not suit it; the text says how.
    #[error("{0}")]
    Unsuitable(String),
    /// The agent cannot start.
    #[error(transparent)]
    Start(#[from] StartError),
    /// A simulated trial has failed.
    #[error("a simulated trial failed: {}", .0.message)]
    Failed(Failure),
    /// The simulation was stopped.
    #[error("the simulation was stopped")]
    Stopped,
    /// There is no decision to compare.
    #[error("no decision of the simulated trials can have the treatment")]
    Never,
    /// Standard errors need more trials than coefficients.
    #[error("the truth of {0} coefficients needs at least {least} simulated trials, found {1}", least = .0 + 1)]
    TooFew(usize, usize),
    /// The term is a linear combination of the terms before it.
    #[error("the term `{0}` is a linear combination of the terms before it; leave it out")]
    Dependent(String),
    /// A trial alone determines a coefficient.
    #[error("one of the simulated trials alone determines a coefficient; simulate more trials")]
    Determined,
}

/// A job whose trials are simulated with other seeds, and what an estimate reads of them.
struct Paired<'d> {
    job: Job,
    declaration: &'d EstimateDeclaration,
    layout: Layout,
}

/// The truth of an estimate of a job's trial, over this number of simulated trials.
///
/// The seeds of the simulated trials are words of the stream [`Purpose::Truth`] of the job's seed. Where a file says who
/// the people of the job are, the simulated trials have the same people. Standard errors are clustered by trial.
///
/// **Errors**: see [`NoTruth`].
pub fn truth(job: &Job, declaration: &EstimateDeclaration, trials: u32) -> Result<Truth, NoTruth> {
    let mut paired = Paired::new(job, declaration)?;
    let mut sums = paired.sums();
    let mut seeds = Stream::new(job.seed, Purpose::Truth);
    for trial in 0..trials as usize {
        paired.job.seed = seeds.bits();
        paired.add_to(&mut sums, trial, &|| false)?;
    }
    let columns = 1 + declaration.moderators.len();
    let mut truth = Truth { coefficients: Vec::new(), errors: Vec::new() };
    for sums in &sums {
        let fit = sums.fit(Correction::ManclDeRouen).map_err(|why| match why {
            NoFit::People(0) => NoTruth::Never,
            NoFit::People(found) => NoTruth::TooFew(columns, found),
            NoFit::Dependent(column) => NoTruth::Dependent(declaration.terms(2)[column].clone()),
            NoFit::Determined(_) => NoTruth::Determined,
        })?;
        truth.coefficients.extend(fit.coefficients);
        let variances = fit.covariance.iter().step_by(columns + 1);
        // Rounding can make a variance of 0 negative.
        truth.errors.extend(variances.map(|variance| variance.max(0.0).sqrt()));
    }
    Ok(truth)
}

/// The coefficients of the effects in a job's own trial, in the order of [`EstimateDeclaration::terms`].
///
/// **Errors**: see [`NoTruth`].
pub(super) fn own_truth(
    job: &Job,
    declaration: &EstimateDeclaration,
    stop: &dyn Fn() -> bool,
) -> Result<Vec<f64>, NoTruth> {
    let paired = Paired::new(job, declaration)?;
    let mut sums = paired.sums();
    paired.add_to(&mut sums, 0, stop)?;
    if sums.iter().any(|sums| sums.rows() == 0) {
        return Err(NoTruth::Never);
    }
    let each = sums.iter().map(Sums::coefficients).collect::<Result<Vec<_>, usize>>();
    let dependent = |column: usize| NoTruth::Dependent(declaration.terms(2)[column].clone());
    Ok(each.map_err(dependent)?.concat())
}

impl<'d> Paired<'d> {
    fn new(job: &Job, declaration: &'d EstimateDeclaration) -> Result<Self, NoTruth> {
        let mut job = job.clone();
        let mut trial = job.trial.clone().ok_or(NoTruth::NoTrial)?;
        if job.is_outside() {
            return Err(NoTruth::Outside);
        }
        if let Some(rows) = trial.rows(job.seed).map_err(NoTruth::Unsuitable)? {
            let lines = rows.iter().enumerate().map(|(person, row)| format!("{person},{row}\n"));
            let text = format!("person,row\n{}", lines.collect::<String>());
            trial.people_file = Content::read(&ROWS, &text).map_err(NoTruth::Unsuitable)?;
        }
        job.evaluation.record_decisions = RecordedDecisions::Test;
        let mut names = job.environment.state_names();
        let of_person = names.len() + usize::from(trial.unreported > 0.0);
        names.extend(Study::new(&trial, job.seed).names());
        job.trial = Some(trial);
        let actions = job.task().interface().actions;
        let layout = Layout::of(declaration, actions, &names).map_err(NoTruth::Unsuitable)?;
        if layout.outcome.is_some_and(|place| place >= of_person) {
            let name = &declaration.outcome;
            let says = format!("the outcome `{name}` is the same whatever message is sent");
            return Err(NoTruth::Unsuitable(says));
        }
        Ok(Paired { job, declaration, layout })
    }

    /// Empty sums, one for each treatment.
    fn sums(&self) -> Vec<Sums> {
        let columns = 1 + self.declaration.moderators.len();
        let treatments = self.declaration.treatment.count(self.job.task().interface().actions);
        vec![Sums { columns, numbers: Vec::new() }; treatments]
    }

    /// Simulates the trial and adds its decisions, as those of one person of the sums.
    fn add_to(
        &self,
        sums: &mut [Sums],
        person: usize,
        stop: &dyn Fn() -> bool,
    ) -> Result<(), NoTruth> {
        let mut add = |row: &[f64], effects: &[f64]| {
            let each = sums.iter_mut().zip(effects);
            each.for_each(|(sums, effect)| sums.add(person, row, 1.0, *effect));
        };
        self.simulate(&mut add, stop)
    }

    /// Simulates the trial. Calls `add` with 1 and the moderators of each decision at which the treatment is possible, and
    /// with the effect of every treatment.
    fn simulate(
        &self,
        add: &mut dyn FnMut(&[f64], &[f64]),
        stop: &dyn Fn() -> bool,
    ) -> Result<(), NoTruth> {
        let excursions = Excursions::new(self.layout.outcome, self.declaration.less_costs);
        let mut training = Training::new(&self.job)?.with_excursions(excursions);
        while training.stage() != Stage::Over {
            training.advance(stop).map_err(NoTruth::Failed)?;
            if stop() {
                return Err(NoTruth::Stopped);
            }
        }
        let (decisions, excursions) = training.into_excursions();
        let mut rows = excursions.finish().into_iter();
        let mut row = Vec::new();
        for (place, decision) in decisions.iter().enumerate().filter(|(_, one)| one.can_send) {
            let (episode, step, outcomes) = rows.next().expect("every decision has a row");
            assert_eq!((decision.episode, decision.step), (episode, step));
            let effects = self.effects(decision, &outcomes);
            // A state is an outcome at the person's next decision.
            let is_last = decisions.get(place + 1).is_none_or(|next| next.episode != episode);
            let is_paid = self.layout.outcome.is_none() || !is_last;
            if is_paid && effects.iter().all(|effect| effect.is_finite()) {
                row.clear();
                row.push(1.0);
                row.extend(self.layout.moderators.iter().map(|one| one.of(decision)));
                add(&row, &effects);
            }
        }
        Ok(())
    }

    /// The effect of every treatment at a decision, given the outcomes of all actions. Not a number where the agent sends
    /// no message, so that no message can be compared.
    fn effects(&self, decision: &Decision, outcomes: &[f64]) -> Vec<f64> {
        let gain = |outcome: &f64| outcome - outcomes[0];
        match self.declaration.treatment {
            Treatment::Action(action) => vec![gain(&outcomes[usize::from(action)])],
            Treatment::Messages(Messages::Each) => outcomes[1..].iter().map(gain).collect(),
            Treatment::Messages(Messages::Any) => {
                // Each message with its probability, given that one is sent.
                let messages = &decision.probabilities[1..];
                let gains = outcomes[1..].iter().map(gain);
                let sum: f64 =
                    gains.zip(messages).map(|(gain, probability)| gain * probability).sum();
                vec![sum / messages.iter().sum::<f64>()]
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::{Agent, DecisionRule, External, LinearThompson, RuleParameters, StudyPlan};
    use crate::env::oralytics::{Oralytics, OralyticsModel, PEOPLE};
    use crate::env::{
        Action, Environment, EpisodeStatus, Reported, Scenario, Simulated, StateNoise, StepCount,
        StepNoise, VectorEnvironment,
    };
    use crate::job::{
        Estimator, EvaluatedOn, Evaluation, Pooling, REWARD, RecordedEpisodes, STEP,
        StandardErrors, Trial, UpdateData,
    };
    use crate::key::{Keyed, Value};

    fn job(environment: impl Into<Environment>, agent: Agent, trial: Trial) -> Job {
        Job {
            environment: environment.into(),
            scenario: "C-H".parse().unwrap(),
            agent,
            evaluation: Evaluation {
                test_episodes: 0,
                on: EvaluatedOn::Trial,
                record_episodes: RecordedEpisodes::None,
                ..Evaluation::default()
            },
            trial: Some(trial),
            seed: 7,
        }
    }

    fn trial(people: u32, days: u32) -> Trial {
        Trial::with_required(&[Value::Integer(people.into()), Value::Integer(days.into())])
    }

    fn rule(rule: DecisionRule) -> Agent {
        Agent::of(&RuleParameters::new(rule))
    }

    fn bandit() -> Agent {
        Agent::of(&LinearThompson { noise_sd: 64.0, prior_sd: 128.0, ..LinearThompson::default() })
    }

    fn estimate(treatment: Treatment, moderators: &[&str]) -> EstimateDeclaration {
        EstimateDeclaration {
            control: Vec::new(),
            less_costs: false,
            estimator: Estimator::Wcls,
            moderators: moderators.iter().map(|name| (*name).to_owned()).collect(),
            name: "effect".to_owned(),
            numerator: 0.5,
            outcome: REWARD.to_owned(),
            standard_errors: StandardErrors::Nominal,
            treatment,
            truth: false,
        }
    }

    const ANY: Treatment = Treatment::Messages(Messages::Any);
    const EACH: Treatment = Treatment::Messages(Messages::Each);

    /// Habituation begins at 0 and grows by 1/8 with every message; nothing is noisy, and nobody disengages.
    fn simple(horizon: u32) -> StepCount {
        StepCount {
            horizon,
            initial_habituation: 0.0,
            delta_h: 0.0,
            epsilon_h: 0.125,
            epsilon_d: 0.0,
            rho_1: 64.0,
            rho_2: 256.0,
            mu: [0.0, 0.0],
            ..StepCount::paper(0.0)
        }
    }

    #[track_caller]
    fn assert_close(found: &[f64], expected: &[f64], error: f64) {
        assert_eq!(found.len(), expected.len());
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() <= error, "{found}, expected {expected}");
        }
    }

    #[test]
    fn effects_under_a_rule_by_hand() {
        // With a message at every decision, the steps of an untailored message are 56, 48, 40, 32, 24 and 16.
        let job = job(simple(6), rule(DecisionRule::Untailored), trial(3, 6));
        let all = |treatment, moderators: &[&str]| {
            truth(&job, &estimate(treatment, moderators), 4).unwrap()
        };
        for treatment in [ANY, Treatment::Action(1)] {
            let mean = all(treatment, &[]);
            assert_close(&mean.coefficients, &[36.0], 1e-12);
            assert_close(&mean.errors, &[0.0], 1e-12);
            let by_step = all(treatment, &[STEP]);
            assert_close(&by_step.coefficients, &[56.0, -8.0], 1e-9);
            assert_close(&by_step.errors, &[0.0; 2], 1e-9);
            assert_close(&all(treatment, &["habituation"]).coefficients, &[56.0, -64.0], 1e-9);
        }
        // A message tailored to context 1 has four times this effect there, and none in context 0.
        let tailored = all(Treatment::Action(3), &["context"]);
        // In context 1 are no first decisions, which are in context 0.
        assert_close(&tailored.coefficients, &[0.0, 128.0], 25.0);
        assert_close(&[tailored.coefficients[0], tailored.errors[0]], &[0.0; 2], 1e-6);
        let each = all(EACH, &["context"]);
        assert_close(&each.coefficients[..2], &[39.0, -7.0], 6.0);
        assert_eq!(each.coefficients[4..], tailored.coefficients[..]);
        // Afterwards habituation is larger by 1/8 with a message than without, but there is no decision after the last.
        let habituation =
            EstimateDeclaration { outcome: "habituation".to_owned(), ..estimate(ANY, &[]) };
        let found = truth(&job, &habituation, 2).unwrap();
        assert_close(&found.coefficients, &[0.125], 1e-12);
    }

    #[test]
    fn an_effect_in_a_micro_randomised_trial_by_hand() {
        // A message has 0, 64 or 256 steps, times 1 - h, and 3/4 of a message comes before each decision: at decision t,
        // E h = 3t/32 + 1/8 after a message.
        let job = job(simple(3), rule(DecisionRule::Random), trial(40, 3));
        let found = truth(&job, &estimate(ANY, &[STEP]), 100).unwrap();
        let mean = 320.0 / 3.0;
        let expected = [mean * 0.875, -mean * 3.0 / 32.0];
        for ((found, error), expected) in found.coefficients.iter().zip(&found.errors).zip(expected)
        {
            assert!(*error < 0.2 && (found - expected).abs() < 4.0 * error, "{found}, {error}");
        }
        assert_eq!(truth(&job, &estimate(ANY, &[STEP]), 100), Ok(found));
        let without = StepCount { rho_1: 0.0, rho_2: 0.0, ..simple(3) };
        let none = Job { environment: without.into(), ..job };
        let found = truth(&none, &estimate(EACH, &[]), 2).unwrap();
        assert_eq!((found.coefficients, found.errors), (vec![0.0; 3], vec![0.0; 3]));
    }

    /// A trial with everything that can happen to people.
    fn eventful(agent: Agent, pooling: Pooling) -> Job {
        let environment = StepCount {
            horizon: 6,
            availability: 0.7,
            state_noise: StateNoise::Uniform,
            state_spread: 0.5,
            step_noise: StepNoise::Gamma,
            sigma_s: 20.0,
            ..StepCount::paper(0.6)
        };
        let trial = Trial {
            decisions_per_day: 2,
            entry_every_days: 1,
            dropout: 0.2,
            missing_outcomes: 0.2,
            unreported: 0.3,
            update_data: UpdateData::InStudy,
            pooling,
            ..trial(4, 3)
        };
        job(environment, agent, trial)
    }

    /// The outcome of a person's decision in a trial in which this action is forced, and the probabilities of the agent.
    /// `None` if the person has no such decision, or no message can be sent.
    fn forced(job: &Job, person: usize, step: u32, action: Action) -> Option<(f64, Vec<f64>)> {
        let trial = job.trial.as_ref().unwrap();
        let people = trial.people as usize;
        let plan = StudyPlan {
            people,
            decisions: 0,
            is_pooled: trial.pooling == Pooling::Full,
            keeps_updates: false,
        };
        let mut actor = job.agent.in_trial(&job.task(), plan).unwrap();
        let mut study = Study::new(trial, job.seed);
        let reports = Study::reports(trial, job.seed).unwrap();
        let mut lanes: Simulated = Box::new(Reported::new(job.task().tested(people), reports));
        let (mut streams, mut choices) =
            (study.streams(job.seed), Stream::new(job.seed, Purpose::TestActions));
        let (mut actions, mut rewards) = (vec![Action::default(); people], vec![0.0; people]);
        let count = job.task().interface().actions;
        let mut probabilities = vec![0.0; people * count];
        while !study.is_over() {
            let _ = study.begin_step(&mut lanes, &mut *actor, &mut streams).unwrap();
            actor.act(&lanes, &mut choices, &mut actions, Some(&mut probabilities));
            let is_here =
                lanes.statuses()[person] == EpisodeStatus::Running && lanes.times()[person] == step;
            if is_here && !lanes.can_send(person) {
                return None;
            }
            if is_here {
                actions[person] = action;
            }
            lanes.step(&actions, &mut rewards, &mut streams);
            if is_here {
                let row = &probabilities[person * count..(person + 1) * count];
                return Some((lanes.outcomes(&rewards)[person], row.to_vec()));
            }
            study.end_step(&mut rewards, |person| lanes.times()[person]);
            actor.observe(&lanes, &rewards);
        }
        None
    }

    #[test]
    fn effects_are_those_of_trials_with_one_forced_decision() {
        for job in [
            eventful(bandit(), Pooling::Full),
            eventful(bandit(), Pooling::None),
            eventful(rule(DecisionRule::Random), Pooling::Full),
        ] {
            let (mut any, mut third, mut decisions) = (0.0, 0.0, 0.0);
            let mut seeds = Stream::new(job.seed, Purpose::Truth);
            for _ in 0..3 {
                let played = Job { seed: seeds.bits(), ..job.clone() };
                for (person, step) in (0..24).map(|place| (place / 6, place as u32 % 6)) {
                    let of =
                        |action| forced(&played, person, step, Action::from_index(action).unwrap());
                    let Some((nothing, probabilities)) = of(0) else { continue };
                    let gains: Vec<f64> =
                        (1..4).map(|action| of(action).unwrap().0 - nothing).collect();
                    let weighted = gains.iter().zip(&probabilities[1..]).map(|(gain, p)| gain * p);
                    any += weighted.sum::<f64>() / probabilities[1..].iter().sum::<f64>();
                    third += gains[2];
                    decisions += 1.0;
                }
            }
            assert!(decisions > 20.0);
            let found = truth(&job, &estimate(ANY, &[]), 3).unwrap();
            assert_close(&found.coefficients, &[any / decisions], 1e-9);
            assert!(found.errors[0] > 0.0);
            let found = truth(&job, &estimate(Treatment::Action(3), &[]), 3).unwrap();
            assert_close(&found.coefficients, &[third / decisions], 1e-9);
        }
    }

    /// Weeks with invented people, who are prompted at random.
    fn brushing(effect_factor: f64, people_file: &str) -> Job {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/experiments/oralytics/synthetic_v2.csv");
        let people = Content::read(&PEOPLE, &std::fs::read_to_string(file).unwrap()).unwrap();
        let parameters = Oralytics { effect_factor, days: 7, ..Oralytics::of_people(people) };
        let people_file = match people_file {
            "" => Content::default(),
            text => Content::read(&ROWS, text).unwrap(),
        };
        let trial = Trial { decisions_per_day: 2, people_file, ..trial(2, 7) };
        let environment = Environment::of(OralyticsModel { parameters });
        Job { scenario: Scenario::all(), ..job(environment, rule(DecisionRule::Random), trial) }
    }

    #[test]
    fn prompts_whose_effect_is_removed_have_none() {
        let [none, half, whole] = [0.0, 0.5, 1.0]
            .map(|factor| truth(&brushing(factor, ""), &estimate(ANY, &[]), 200).unwrap());
        assert_eq!((none.coefficients, none.errors), (vec![0.0], vec![0.0]));
        assert!(half.coefficients[0] > 4.0 * half.errors[0]);
        assert!(whole.coefficients[0] > half.coefficients[0]);
    }

    #[test]
    fn people_of_a_file_take_part_in_every_simulated_trial() {
        let of = |rows| truth(&brushing(1.0, rows), &estimate(ANY, &[]), 10);
        let found = of("seed,person,row\n7,0,3\n7,1,5\n8,0,1\n8,1,2\n");
        assert!(found.is_ok());
        assert_eq!(found, of("person,row\n0,3\n1,5\n"));
        assert_ne!(found, of("person,row\n0,1\n1,2\n"));
        let says = "seed 7 has no row for person 0".to_owned();
        assert_eq!(of("seed,person,row\n8,0,1\n8,1,2\n"), Err(NoTruth::Unsuitable(says)));
    }

    #[test]
    fn what_cannot_be_simulated_says_why() {
        let job = job(simple(3), rule(DecisionRule::Never), trial(2, 3));
        let fault = |job: &Job, declaration: &EstimateDeclaration, trials| {
            truth(job, declaration, trials).unwrap_err().to_string()
        };
        let says = "no decision of the simulated trials can have the treatment";
        assert_eq!(fault(&job, &estimate(ANY, &[]), 2), says);
        let found = truth(&job, &estimate(Treatment::Action(1), &[]), 2).unwrap();
        // Nobody habituates.
        assert_close(&found.coefficients, &[56.0], 1e-12);
        let says = "the term `action 1: habituation` is a linear combination of the terms before it; leave it out";
        assert_eq!(fault(&job, &estimate(EACH, &["habituation"]), 3), says);
        let says = "the truth of 2 coefficients needs at least 3 simulated trials, found 2";
        assert_eq!(fault(&job, &estimate(EACH, &[STEP]), 2), says);
        let says = "the environment has no action 4";
        assert_eq!(fault(&job, &estimate(Treatment::Action(4), &[]), 2), says);
        let says = "the recorded state has no `mood`; it has context, probability, likely_context, habituation, \
                    disengagement, calendar_day, policy and step";
        assert_eq!(fault(&job, &estimate(ANY, &["mood"]), 2), says);
        let policy = EstimateDeclaration { outcome: "policy".to_owned(), ..estimate(ANY, &[]) };
        let says = "the outcome `policy` is the same whatever message is sent";
        assert_eq!(fault(&job, &policy, 2), says);
        let without = Job { trial: None, ..job.clone() };
        assert_eq!(truth(&without, &estimate(ANY, &[]), 2), Err(NoTruth::NoTrial));
        let program =
            External { command: vec!["true".to_owned()], version: "1".to_owned(), episodes: 1 };
        let outside = Job { agent: Agent::of(&program), ..job };
        assert_eq!(truth(&outside, &estimate(ANY, &[]), 2), Err(NoTruth::Outside));
    }
}
