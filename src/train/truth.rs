//! The truth of an excursion effect: what an estimator of a trial's effects estimates, by paired simulation.
//!
//! In: a job with a trial, the declaration of an estimate, and excursions from the trial. Out: the marginal excursion
//! effect under the trial's own policy.
//!
//! At every decision at which a message can be sent, copies of all people
//! take the treatment and no message, with the same chance; the trial itself goes on with the agent's choice. The effect
//! is the difference of both outcomes.
//!
//! **Source**: Boruvka, Almirall, Witkiewitz and Murphy, "Assessing time-varying causal effect moderation in mobile
//! health", Journal of the American Statistical Association, 2018. With moderators f(S), the truth is the projection of
//! the effects on f(S) with the weights of the estimand: one weight for every decision at which a message can be sent, as
//! the probability of the numerator is a constant there.

use crate::estimate::{Layout, Rows, Sums};
use crate::job::{
    Decision, EstimateDeclaration, Estimator, Job, Messages, StateNames, Treatment, VALUE_TERMS,
};
use crate::train::excursions::ProximalOutcome;
use crate::train::observers::ObservedTrial;
use crate::train::policy_courses::PolicyCourses;

/// What the truth of an estimate reads of a trial.
pub(super) struct Truth<'d> {
    declaration: &'d EstimateDeclaration,
    layout: Layout,
    /// The number of treatments.
    treatments: usize,
}

impl<'d> Truth<'d> {
    /// The truth of an estimate of a job's trial; `None` if there is no trial, if the recorded state lacks a name of the
    /// declaration, or if no message changes the outcome.
    pub(super) fn new(job: &Job, declaration: &'d EstimateDeclaration) -> Option<Truth<'d>> {
        let trial = job.trial.as_ref()?;
        let names = StateNames::new(&job.environment, trial.recorded_names());
        let own = job.environment.state_names().len();
        let of_person = own + usize::from(trial.unreported > 0.0);
        let actions = job.task().interface().actions;
        let layout = Layout::of(declaration, actions, &names).ok()?;
        let is_changed = layout.outcome.is_none_or(|index| index < of_person);
        let treatments = declaration.treatment.count(actions);
        is_changed.then_some(Truth { declaration, layout, treatments })
    }

    /// The outcome that excursions observe for it.
    pub(super) fn outcome(&self) -> ProximalOutcome {
        let less_costs = self.declaration.less_costs;
        let Layout { outcome: index, is_own, .. } = self.layout;
        ProximalOutcome { index, is_own, less_costs }
    }

    /// The coefficients of the effects in a trial, in the order of [`EstimateDeclaration::terms`]; `None` if no decision can
    /// have the treatment, or if a term is a linear combination of the terms before it. Of a value, each term has the same
    /// truth, that of courses of its policy.
    pub(super) fn coefficients(&self, job: &Job, observed: &ObservedTrial) -> Option<Vec<f64>> {
        match self.declaration.estimator {
            Estimator::Wcls => {}
            Estimator::Emee => return self.relative_risks(observed),
            Estimator::Value => {
                let value = |wanted: &PolicyCourses| {
                    let known = observed.courses.iter().find(|known| known.equals(wanted))?;
                    known.value(&observed.decisions)
                };
                let values = self.courses(job)?.iter().map(value).collect::<Option<Vec<_>>>()?;
                let difference = values.first()? - values.get(1).unwrap_or(&0.0);
                return Some(vec![difference; VALUE_TERMS.len()]);
            }
        }
        let mut sums = self.sums();
        self.add_to(&mut sums, 0, observed);
        let coefficients = |sums: &Sums| sums.coefficients().ok().filter(|_| sums.rows() > 0);
        Some(sums.iter().map(coefficients).collect::<Option<Vec<_>>>()?.concat())
    }

    /// Whether it is of the value of a policy.
    pub(super) fn is_of_value(&self) -> bool {
        self.declaration.estimator == Estimator::Value
    }

    /// The courses of each of its policies, before the first; `None` for an effect, and where one has none.
    pub(super) fn courses(&self, job: &Job) -> Option<Vec<PolicyCourses>> {
        let policies = self.declaration.policies().zip(&self.layout.policies);
        let courses = policies.map(|((_, policy), feature)| {
            PolicyCourses::new(job, self.declaration.steps, self.outcome(), (policy, *feature))
        });
        self.is_of_value().then(|| courses.collect())?
    }

    /// The coefficients β of each treatment with Σ f (exp(−f'β) Y₁ − Y₀) = 0 over decisions. They are those of pairs of rows,
    /// one with the treatment and one without, from whose equations every model without treatment drops out.
    fn relative_risks(&self, observed: &ObservedTrial) -> Option<Vec<f64>> {
        let terms = 1 + self.declaration.moderators.len();
        let new = Rows { columns: 1 + terms, controls: 1, terms, centre: 0.5, numbers: Vec::new() };
        let mut all = vec![new; self.treatments];
        let mut row = Vec::new();
        self.each(observed, |decision, outcomes| {
            let effects = self.effects(decision, outcomes);
            for (rows, effect) in all.iter_mut().zip(effects) {
                for (centred, outcome) in [(0.5, outcomes[0] + effect), (-0.5, outcomes[0])] {
                    row.clear();
                    row.extend([1.0, centred]);
                    row.extend(self.layout.moderators.iter().map(|one| centred * one.of(decision)));
                    rows.add(0, &row, 1.0, outcome);
                }
            }
        });
        let coefficients = |rows: &Rows| Some(rows.coefficients().ok()?.split_off(1));
        Some(all.iter().map(coefficients).collect::<Option<Vec<_>>>()?.concat())
    }

    /// Empty sums, one for each treatment.
    fn sums(&self) -> Vec<Sums> {
        let columns = 1 + self.declaration.moderators.len();
        vec![Sums { columns, numbers: Vec::new() }; self.treatments]
    }

    /// Adds the decisions of a trial at which the treatment is possible, as those of one person of the sums: 1 and the
    /// moderators, and the effect of every treatment.
    fn add_to(&self, sums: &mut [Sums], person: usize, observed: &ObservedTrial) {
        let mut row = Vec::new();
        self.each(observed, |decision, outcomes| {
            row.clear();
            row.push(1.0);
            row.extend(self.layout.moderators.iter().map(|one| one.of(decision)));
            let each = sums.iter_mut().zip(self.effects(decision, outcomes));
            each.for_each(|(sums, effect)| sums.add(person, &row, 1.0, effect));
        });
    }

    /// Calls `see` with each decision of a trial at which the treatment is possible, and the outcomes of all actions.
    fn each(&self, observed: &ObservedTrial, mut see: impl FnMut(&Decision, &[f64])) {
        let ObservedTrial { decisions, excursions: Some(excursions), .. } = observed else {
            return;
        };
        let mut excursions = excursions.by_decision(self.outcome());
        for (index, decision) in decisions.iter().enumerate().filter(|(_, one)| one.can_send) {
            let Some((excursion, outcomes)) = excursions.next() else { return };
            assert_eq!((decision.episode, decision.step), (excursion.episode, excursion.step));
            let effects = self.effects(decision, &outcomes);
            // A state is an outcome at the person's next decision.
            let next = decisions.get(index + 1);
            let is_last = next.is_none_or(|next| next.episode != decision.episode);
            let is_paid = self.layout.outcome.is_none() || self.layout.is_own || !is_last;
            if is_paid && effects.iter().all(|effect| effect.is_finite()) {
                see(decision, &outcomes);
            }
        }
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
    use crate::agent::{
        Agent, DecisionRule, External, LinearThompson, Rewards, RuleParameters, StudyPlan,
    };
    use crate::env::{
        Action, Environment, EpisodeStatus, Family, Reported, Scenario, Simulated, StateNoise,
        StepCount, StepNoise, VectorEnvironment,
    };
    use crate::estimate::Correction;
    use crate::job::{
        Estimator, EvaluatedOn, Evaluation, Pooling, REWARD, ROWS, RecordedEpisodes, STEP,
        StandardErrors, TargetPolicy, Trial, UpdateData,
    };
    use crate::key::{Content, Keyed, Kind, Value};
    use crate::rng::{Purpose, Stream};
    use crate::train::excursions::Excursions;
    use crate::train::once_more::play;
    use crate::train::study::Study;
    use crate::train::trace::NoTrace;

    /// The coefficients of an effect over simulated trials, and their standard errors.
    #[derive(Debug, PartialEq)]
    struct Found {
        coefficients: Vec<f64>,
        errors: Vec<f64>,
    }

    /// The truth of an estimate over this number of trials; standard errors are clustered by trial.
    fn truth(job: &Job, declaration: &EstimateDeclaration, trials: u32) -> Found {
        let truth = Truth::new(job, declaration).unwrap();
        let mut sums = truth.sums();
        for (trial, seed) in seeds(job, trials).enumerate() {
            truth.add_to(&mut sums, trial, &observed(&Job { seed, ..job.clone() }, &truth));
        }
        let mut found = Found { coefficients: Vec::new(), errors: Vec::new() };
        for sums in &sums {
            let fit = sums.fit(Correction::ManclDeRouen).unwrap();
            found.coefficients.extend(fit.coefficients);
            let variances = fit.covariance.iter().step_by(sums.columns + 1);
            // Rounding can make a variance of 0 negative.
            found.errors.extend(variances.map(|variance| variance.max(0.0).sqrt()));
        }
        found
    }

    fn seeds(job: &Job, trials: u32) -> impl Iterator<Item = u64> {
        let mut seeds = Stream::new(job.seed, Purpose::Bootstrap);
        (0..trials).map(move |_| seeds.bits())
    }

    /// What is observed of the trial of a job for a truth.
    fn observed(job: &Job, truth: &Truth<'_>) -> ObservedTrial {
        let excursions = Excursions::new(vec![truth.outcome()]);
        play(job, |observers| observers.explore(job, excursions), &|| false).unwrap()
    }

    /// The truth of an estimate in the trial of a job.
    fn own_truth(job: &Job, declaration: &EstimateDeclaration) -> Option<Vec<f64>> {
        let truth = Truth::new(job, declaration)?;
        truth.coefficients(job, &observed(job, &truth))
    }

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
            policy: None,
            against: None,
            standard_errors: StandardErrors::Nominal,
            steps: 1,
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
        let all = |treatment, moderators: &[&str]| truth(&job, &estimate(treatment, moderators), 4);
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
        let found = truth(&job, &habituation, 2);
        assert_close(&found.coefficients, &[0.125], 1e-12);
    }

    #[test]
    fn an_effect_in_a_micro_randomised_trial_by_hand() {
        // A message has 0, 64 or 256 steps, times 1 - h, and 3/4 of a message comes before each decision: at decision t,
        // E h = 3t/32 + 1/8 after a message.
        let job = job(simple(3), rule(DecisionRule::Random), trial(40, 3));
        let found = truth(&job, &estimate(ANY, &[STEP]), 100);
        let mean = 320.0 / 3.0;
        let expected = [mean * 0.875, -mean * 3.0 / 32.0];
        for ((found, error), expected) in found.coefficients.iter().zip(&found.errors).zip(expected)
        {
            assert!(*error < 0.2 && (found - expected).abs() < 4.0 * error, "{found}, {error}");
        }
        assert_eq!(truth(&job, &estimate(ANY, &[STEP]), 100), found);
        let without = StepCount { rho_1: 0.0, rho_2: 0.0, ..simple(3) };
        let none = Job { environment: without.into(), ..job };
        let found = truth(&none, &estimate(EACH, &[]), 2);
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
            sharing: crate::train::training::sharing(trial),
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
            study.begin_step(&mut lanes, &mut *actor, &mut streams).unwrap();
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
            study.end_step(lanes.times());
            actor.observe(&lanes, Rewards { values: &rewards, reached: study.reached() });
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
            for seed in seeds(&job, 3) {
                let played = Job { seed, ..job.clone() };
                for (person, step) in (0..24).map(|index| (index / 6, index as u32 % 6)) {
                    let outcome =
                        |action| forced(&played, person, step, Action::from_index(action).unwrap());
                    let Some((nothing, probabilities)) = outcome(0) else { continue };
                    let gains: Vec<f64> =
                        (1..4).map(|action| outcome(action).unwrap().0 - nothing).collect();
                    let weighted = gains.iter().zip(&probabilities[1..]).map(|(gain, p)| gain * p);
                    any += weighted.sum::<f64>() / probabilities[1..].iter().sum::<f64>();
                    third += gains[2];
                    decisions += 1.0;
                }
            }
            assert!(decisions > 20.0);
            let found = truth(&job, &estimate(ANY, &[]), 3);
            assert_close(&found.coefficients, &[any / decisions], 1e-9);
            assert!(found.errors[0] > 0.0);
            let found = truth(&job, &estimate(Treatment::Action(3), &[]), 3);
            assert_close(&found.coefficients, &[third / decisions], 1e-9);
        }
    }

    /// Weeks with invented people, who are prompted at random.
    fn brushing(effect_factor: f64, people_file: &str) -> Job {
        let declared = Family::named("declared").unwrap();
        let family = declared.with_parameters.unwrap()(&["parameters.effect_factor"]).unwrap();
        let content = |index: usize, text: &str| match family.keys[index].kind {
            Kind::Content(form) => Value::Content(Content::read(form, text).unwrap()),
            other => panic!("{other:?}"),
        };
        let values = [
            content(0, include_str!("../../experiments/oralytics/v2.toml")),
            content(1, include_str!("../../experiments/oralytics/synthetic_v2.csv")),
            Value::Content(Content::default()),
            Value::Integer(7),
            Value::Real(effect_factor),
        ];
        let environment = (family.read)(family, &values, &[]).unwrap();
        let people_file = match people_file {
            "" => Content::default(),
            text => Content::read(&ROWS, text).unwrap(),
        };
        let trial = Trial { decisions_per_day: 2, people_file, ..trial(2, 7) };
        Job { scenario: Scenario::all(), ..job(environment, rule(DecisionRule::Random), trial) }
    }

    #[test]
    fn the_value_of_a_policy_by_hand() {
        // With a message at every decision, as in the first test; and one decision after those of the trial's own rule.
        let less = |rule, steps: u32, policy: Vec<f64>, against: Option<Vec<f64>>| {
            let of = EstimateDeclaration {
                estimator: Estimator::Value,
                policy: Some(TargetPolicy::Actions(policy)),
                against: against.map(TargetPolicy::Actions),
                steps,
                ..estimate(ANY, &[])
            };
            let job = job(simple(6), rule, trial(4, 6));
            let truth = Truth::new(&job, &of).unwrap();
            let courses = truth.courses(&job).unwrap();
            let observed = play(&job, |observers| observers.follow(&job, courses), &|| false);
            truth.coefficients(&job, &observed.unwrap()).unwrap()
        };
        let value = |rule, steps: u32, policy: Vec<f64>| less(rule, steps, policy, None);
        let never = || rule(DecisionRule::Never);
        let nothing = vec![1.0, 0.0, 0.0, 0.0];
        assert_eq!(less(never(), 2, nothing, Some(vec![0.0, 1.0, 0.0, 0.0])), [-52.0; 3]);
        assert_eq!(value(never(), 6, vec![0.0, 1.0, 0.0, 0.0]), [36.0; 3]);
        assert_eq!(value(never(), 2, vec![0.0, 1.0, 0.0, 0.0]), [52.0; 3]);
        let untailored = || rule(DecisionRule::Untailored);
        assert_eq!(value(untailored(), 1, vec![0.0, 1.0, 0.0, 0.0]), [36.0; 3]);
        assert_eq!(value(untailored(), 3, vec![1.0, 0.0, 0.0, 0.0]), [0.0; 3]);
        let half = value(never(), 1, vec![0.5, 0.5, 0.0, 0.0])[0];
        // So many of 24 decisions had the message.
        let messages = 24.0 * half / 56.0;
        assert!((messages - messages.round()).abs() < 1e-9 && messages > 0.0, "{half}");
    }

    #[test]
    fn prompts_whose_effect_is_removed_have_none() {
        let [none, half, whole] =
            [0.0, 0.5, 1.0].map(|factor| truth(&brushing(factor, ""), &estimate(ANY, &[]), 200));
        assert_eq!((none.coefficients, none.errors), (vec![0.0], vec![0.0]));
        assert!(half.coefficients[0] > 4.0 * half.errors[0]);
        assert!(whole.coefficients[0] > half.coefficients[0]);
    }

    #[test]
    fn people_of_a_file_take_part_in_the_trial() {
        let of_rows = |rows| own_truth(&brushing(1.0, rows), &estimate(ANY, &[]));
        let found = of_rows("seed,person,row\n7,0,3\n7,1,5\n8,0,1\n8,1,2\n");
        assert!(found.is_some());
        assert_eq!(found, of_rows("person,row\n0,3\n1,5\n"));
        assert_ne!(found, of_rows("person,row\n0,1\n1,2\n"));
    }

    #[test]
    fn an_effect_that_cannot_be_simulated_has_no_truth() {
        let job = job(simple(3), rule(DecisionRule::Never), trial(2, 3));
        // No decision has the treatment.
        assert_eq!(own_truth(&job, &estimate(ANY, &[])), None);
        // Nobody habituates, so that both terms are constant.
        let first = Treatment::Action(1);
        assert_close(&own_truth(&job, &estimate(first, &[])).unwrap(), &[56.0], 1e-12);
        assert_eq!(own_truth(&job, &estimate(first, &["habituation"])), None);
        let is_unknown = |declaration| Truth::new(&job, &declaration).is_none();
        assert!(is_unknown(estimate(Treatment::Action(4), &[])));
        assert!(is_unknown(estimate(ANY, &["mood"])));
        // The outcome is the same whatever message is sent.
        let policy = "policy".to_owned();
        assert!(is_unknown(EstimateDeclaration { outcome: policy, ..estimate(ANY, &[]) }));
        let without = Job { trial: None, ..job.clone() };
        assert!(Truth::new(&without, &estimate(ANY, &[])).is_none());
        let program =
            External { command: vec!["true".to_owned()], version: "1".to_owned(), episodes: 1 };
        let outside = Job { agent: Agent::of(&program), ..job };
        assert_eq!(play(&outside, |_| {}, &|| false).err(), Some(NoTrace::Outside));
    }
}
