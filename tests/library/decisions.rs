//! Recorded decisions: their content, and that recording changes nothing else.

use std::fs;

use jitai::agent::{
    Agent, DecisionRule, DuelingDqn, LinearThompson, Ppo, Recurrent, Reinforce, RuleParameters,
    Unavailable, Weights,
};
use jitai::env::StepCount;
use jitai::job::Job;
use jitai::job::{Decision, Outcome, Phase, Provenance, Results};
use jitai::job::{Evaluation, RecordedDecisions};
use jitai::manifest::{self};
use jitai::store::{
    Answer, Claimed, Experiment, Isolation, Reader, RetryFailed, SqlValue, Store, examine,
};
use jitai::train::{self, Uncontrolled};

fn job(agent: Agent, recorded: RecordedDecisions) -> Job {
    Job {
        environment: StepCount::paper(0.6).into(),
        scenario: "P-H-D".parse().unwrap(),
        agent,
        evaluation: Evaluation {
            test_episodes: 30,
            curve_stride: 1,
            record_decisions: recorded,
            ..Evaluation::default()
        },
        trial: None,
        seed: 3,
    }
}

fn agents() -> [Agent; 6] {
    let policy = Reinforce { episodes: 9, layers: vec![8], ..Reinforce::default() };
    [
        Agent::of(&DuelingDqn { episodes: 9, layers: vec![8], ..DuelingDqn::default() }),
        Agent::of(&Reinforce { trajectories_per_update: 3, ..policy.clone() }),
        Agent::of(&policy),
        Agent::of(&RuleParameters::new(DecisionRule::Random)),
        Agent::of(&bandit()),
        Agent::of(&policy).with_history(4),
    ]
}

fn bandit() -> LinearThompson {
    LinearThompson { episodes: 9, pi_min: 0.05, warm_up: 2, ..LinearThompson::default() }
}

fn results(job: &Job) -> Results {
    match train::run(job, &Uncontrolled) {
        Outcome::Completed(results) => results,
        other => panic!("the job did not complete: {other:?}"),
    }
}

/// The episodes of a phase, each with its steps.
fn episodes(results: &Results, phase: Phase) -> Vec<Vec<Decision>> {
    let of_phase: Vec<Decision> =
        results.decisions.iter().filter(|decision| decision.phase == phase).cloned().collect();
    of_phase.chunk_by(|one, next| one.episode == next.episode).map(<[Decision]>::to_vec).collect()
}

/// The recorded state of the simulation.
struct State {
    context: u8,
    probability: f64,
    likely_context: u8,
    habituation: f64,
    disengagement: f64,
}

fn state(decision: &Decision) -> State {
    let [context, probability, likely, habituation, disengagement] = *decision.state else {
        panic!("five numbers, found {:?}", decision.state)
    };
    let (context, likely_context) = (context as u8, likely as u8);
    State { context, probability, likely_context, habituation, disengagement }
}

/// Whether the last step of an episode terminated and truncated it; no other step may have done so.
fn ending(steps: &[Decision]) -> (bool, bool) {
    let mut endings = steps.iter().map(|step| (step.terminated, step.truncated));
    let last = endings.next_back().unwrap();
    assert!(endings.all(|ending| ending == (false, false)), "{steps:?}");
    last
}

#[test]
fn recording_changes_no_other_result() {
    for agent in agents() {
        let learns = agent.episodes() > 0;
        let none = results(&job(agent.clone(), RecordedDecisions::None));
        assert!(none.decisions.is_empty());
        let test = results(&job(agent.clone(), RecordedDecisions::Test));
        let all = results(&job(agent, RecordedDecisions::All));
        assert!(episodes(&test, Phase::Train).is_empty());
        assert_eq!(episodes(&all, Phase::Train).is_empty(), !learns);
        assert_eq!(episodes(&all, Phase::Test), episodes(&test, Phase::Test));
        for recorded in [test, all] {
            assert_eq!(Results { decisions: Vec::new(), ..recorded }, none);
        }
    }
}

#[test]
fn decisions_are_the_steps_of_the_episodes_that_the_other_results_count() {
    for agent in agents() {
        let results = results(&job(agent, RecordedDecisions::All));
        let tested = episodes(&results, Phase::Test);
        assert_eq!(tested.len(), results.episodes.len());
        for ((number, steps), episode) in (1..).zip(&tested).zip(&results.episodes) {
            assert!(steps.iter().all(|step| step.episode == number));
            assert!(steps.iter().map(|step| step.step).eq(0..episode.length));
            assert_eq!(ending(steps), (episode.terminated, !episode.terminated));
            assert_eq!(steps.iter().map(|step| step.reward).sum::<f64>(), episode.total_reward);
        }
        // With a stride of 1, the curve has the return of every training episode.
        let returns = results.curve.iter().filter(|point| point.metric == "mean_return");
        let recorded = episodes(&results, Phase::Train);
        for steps in &recorded {
            assert!(ending(steps) == (true, false) || ending(steps) == (false, true));
        }
        let totals = recorded.iter().map(|steps| steps.iter().map(|s| s.reward).sum::<f64>());
        assert!(totals.eq(returns.map(|point| point.value)));
        for count in &results.actions {
            let is_counted = |step: &&Decision| {
                let bin = ((state(step).probability * 10.0) as u8).min(9);
                let stratum = Some(2 * bin + state(step).context);
                (stratum, step.action) == (count.stratum, count.action)
            };
            let found = tested.iter().flatten().filter(is_counted).count();
            assert_eq!(found as u64, count.count);
        }
    }
}

// The step after the horizon of `unpaid_last_step` has no decision, and ends the episode.
#[test]
fn an_episode_that_ends_after_its_last_decision_has_its_ending_there() {
    let mut job =
        job(Agent::of(&RuleParameters::new(DecisionRule::Random)), RecordedDecisions::Test);
    job.environment = StepCount { unpaid_last_step: true, ..StepCount::paper(0.6) }.into();
    let results = results(&job);
    let tested = episodes(&results, Phase::Test);
    for (steps, episode) in tested.iter().zip(&results.episodes) {
        assert_eq!(ending(steps), (episode.terminated, !episode.terminated));
    }
    assert!(results.episodes.iter().any(|episode| !episode.terminated));
}

// Lanes end their episodes at different times, so a short episode may end before an episode that began
// earlier.
#[test]
fn the_first_people_of_ppo_are_the_first_to_begin() {
    let ppo = Ppo { episodes: 40, layers: vec![8], lanes: 8, ..Ppo::default() };
    let mut job = job(Agent::of(&ppo), RecordedDecisions::All);
    job.evaluation.first_episodes = vec![3, 9, 33];
    let results = results(&job);
    let returns: Vec<f64> = episodes(&results, Phase::Train)
        .iter()
        .map(|steps| steps.iter().map(|decision| decision.reward).sum())
        .collect();
    assert_eq!(returns.len(), 40);
    let ended: Vec<f64> = results
        .curve
        .iter()
        .filter(|point| point.metric == "mean_return")
        .map(|point| point.value)
        .collect();
    let mean = |returns: &[f64]| returns.iter().sum::<f64>() / returns.len() as f64;
    for first in [3, 9, 33] {
        let name = format!("mean_return_first_{first}");
        let metric = results.metrics.iter().find(|metric| metric.name == *name).unwrap();
        assert!((metric.value - mean(&returns[..first])).abs() < 1e-9, "{name}");
        assert!((metric.value - mean(&ended[..first])).abs() > 1.0, "{name} of the first to end");
    }
}

#[test]
fn a_decision_says_what_was_seen_before_the_step_and_what_it_paid() {
    let agent = Agent::of(&RuleParameters::new(DecisionRule::Random));
    let mut shown_zero = job(agent, RecordedDecisions::Test);
    shown_zero.environment.change(|e| e.horizon = 12);
    let mut shown_one = shown_zero.clone();
    shown_one.environment.change(|e| e.observed_probability = 1);
    let (zero, one) = (results(&shown_zero), results(&shown_one));
    for (zero, one) in zero.decisions.iter().zip(&one.decisions) {
        assert_eq!(state(one).probability, 1.0 - state(zero).probability);
        let mut same = one.clone();
        same.state[1] = state(zero).probability;
        assert_eq!(same, *zero);
    }
    for steps in episodes(&zero, Phase::Test) {
        let first = &steps[0];
        assert_eq!((state(first).habituation, state(first).disengagement), (0.1, 0.1));
        for step in &steps {
            assert_eq!((step.action_probability(), step.available), (0.25, true));
            assert_eq!((&step.probabilities[..], step.can_send), (&[0.25; 4][..], true));
            assert_eq!(step.chosen, step.action);
            assert_eq!(state(step).likely_context, u8::from(state(step).probability < 0.5));
        }
        for pair in steps.windows(2) {
            let sends = pair[0].action > 0;
            let rises = state(&pair[1]).habituation > state(&pair[0]).habituation;
            assert_eq!(sends, rises, "{pair:?}");
            let base = match pair[0].action {
                1 => 50.0,
                action if action == state(&pair[0]).context + 2 => 200.0,
                _ => 0.0,
            };
            let reward = 0.1 + (1.0 - state(&pair[1]).habituation) * base;
            assert!((pair[0].reward - reward).abs() < 1e-9, "{pair:?}");
        }
    }
}

#[test]
fn training_decisions_have_the_probabilities_of_exploration() {
    let dqn = DuelingDqn {
        episodes: 9,
        layers: vec![8],
        epsilon_start: 0.4,
        epsilon_decrement: 0.0,
        ..DuelingDqn::default()
    };
    let results = results(&job(Agent::of(&dqn), RecordedDecisions::All));
    let training = episodes(&results, Phase::Train).concat();
    let share = |probability: f64| {
        let close = |step: &&Decision| (step.action_probability() - probability).abs() < 1e-12;
        training.iter().filter(close).count() as f64 / training.len() as f64
    };
    // The best action has probability 0.7, and each of the three others has 0.1.
    assert_eq!(share(0.7) + share(0.1), 1.0);
    assert!((share(0.7) - 0.7).abs() < 0.1, "{}", share(0.7));
}

#[test]
fn the_store_shows_every_decision_to_the_bit_and_counts_them_as_results() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("jitai.sqlite");
    let job = job(agents()[1].clone(), RecordedDecisions::All);
    let outcome = train::run(&job, &Uncontrolled);
    let mut store = Store::open(&path).unwrap();
    let experiment = Experiment { name: "e", question: None, hypothesis: None, manifest: "" };
    store.register(&experiment, [("a", &job)]).unwrap();
    let [code_version, git_revision, backend, host, processor] = [(); 5].map(|()| String::new());
    let provenance = Provenance { code_version, git_revision, backend, host, processor };
    let session = store.begin_session(&provenance).unwrap();
    let claimed = store.claim(session, &job.key(), RetryFailed::No, Isolation::Shared).unwrap();
    let Claimed::Claimed(claim) = claimed else { panic!("{claimed:?}") };
    store.finish(&claim, &outcome, 1.0).unwrap();
    store.end_session(session).unwrap();
    drop(store);

    let reader = Reader::open(&path).unwrap();
    let mut stored = Vec::new();
    let sql = "SELECT phase = 'test', episode, step, context, probability, likely_context,
            habituation, disengagement, available, action, action_probability, reward, can_send,
            chosen_action, json_extract(action_probabilities, '$[0]'),
            json_extract(action_probabilities, '$[1]'), json_extract(action_probabilities, '$[2]'),
            json_extract(action_probabilities, '$[3]'), terminated, truncated
        FROM decision ORDER BY phase = 'test', episode, step";
    let number = |value: &SqlValue<'_>| match value {
        SqlValue::Integer(number) => *number as f64,
        SqlValue::Real(number) => *number,
        other => panic!("{other:?}"),
    };
    let hear = |answer: Answer<'_>| {
        if let Answer::Row(row) = answer {
            stored.push(row.iter().map(number).collect::<Vec<f64>>());
        }
        std::ops::ControlFlow::Continue(())
    };
    reader.query(sql, hear).unwrap();
    let Outcome::Completed(results) = outcome else { unreachable!() };
    let expected = results.decisions.iter().map(|d| {
        vec![
            f64::from(u8::from(d.phase == Phase::Test)),
            f64::from(d.episode),
            f64::from(d.step),
            d.state[0],
            d.state[1],
            d.state[2],
            d.state[3],
            d.state[4],
            f64::from(u8::from(d.available)),
            f64::from(d.action),
            d.action_probability(),
            d.reward,
            f64::from(u8::from(d.can_send)),
            f64::from(d.chosen),
            d.probabilities[0],
            d.probabilities[1],
            d.probabilities[2],
            d.probabilities[3],
            f64::from(u8::from(d.terminated)),
            f64::from(u8::from(d.truncated)),
        ]
    });
    assert!(expected.eq(stored));
    drop(reader);
    let examined = examine(&path, &|_, _| Ok(())).unwrap();
    assert_eq!((examined.findings, examined.intact), (Vec::new(), 1));

    // A change of one bit of a recorded probability is detected.
    let mut bytes = fs::read(&path).unwrap();
    let drawn = results.decisions.iter().find(|decision| decision.step == 3).unwrap();
    let pattern = drawn.state[1].to_be_bytes();
    let places = bytes.windows(8).enumerate().filter(|(_, window)| *window == pattern);
    let places: Vec<usize> = places.map(|(index, _)| index).collect();
    // SQLite may have left a copy where it split a page.
    assert!(!places.is_empty());
    places.iter().for_each(|index| bytes[index + 7] ^= 1);
    fs::write(&path, bytes).unwrap();
    let examined = examine(&path, &|_, _| Ok(())).unwrap();
    assert_eq!(examined.intact, 0);
}

#[test]
fn a_record_that_would_be_too_large_is_a_fault_of_the_manifest() {
    let check = |recorded: &str| {
        let text = format!(
            "format = 1\nname = 'e'\nscenarios = ['P-H-D']\nseeds = 1\n\
             environment.sigma = 0.4\nenvironment.horizon = 500\n\
             evaluation.record_decisions = '{recorded}'\n\
             [[agent]]\nname = 'a'\nalgorithm = 'reinforce'\n"
        );
        manifest::parse("e.toml", text.as_bytes())
    };
    assert!(check("none").is_ok() && check("test").is_ok());
    let error = check("all").unwrap_err().to_string();
    assert!(error.contains("the record of decisions can have 8000000 steps"), "{error}");
}

#[test]
fn every_decision_of_a_trial_counts_and_its_agents_have_no_training() {
    let check = |days: u32, recorded: &str| {
        let text = format!(
            "format = 1\nname = 'e'\nscenarios = ['P-H-D']\nseeds = 1\n\
             environment.sigma = 0.4\nenvironment.horizon = {}\n\
             trial.people = 10_000\ntrial.days = {days}\ntrial.decisions_per_day = 2\n\
             evaluation.on = 'trial'\nevaluation.record_decisions = '{recorded}'\n\
             [[agent]]\nname = 'a'\nalgorithm = 'linear_thompson'\n",
            2 * days
        );
        manifest::parse("e.toml", text.as_bytes()).map(|_| ()).map_err(|error| error.to_string())
    };
    assert_eq!((check(250, "test"), check(250, "all")), (Ok(()), Ok(())));
    let error = check(251, "test").unwrap_err();
    assert!(error.contains("the record of decisions can have 5020000 steps"), "{error}");
    assert!(error.contains("people = 10000, horizon = 502"), "{error}");
}

#[test]
fn an_unpaid_last_step_counts_in_every_limit_of_steps() {
    let check = |unpaid: bool, agent: &str| {
        let text = format!(
            "format = 1\nname = 'e'\nscenarios = ['P-H-D']\nseeds = 1\n\
             environment.sigma = 0.4\nenvironment.horizon = 100\n\
             environment.unpaid_last_step = {unpaid}\n{agent}"
        );
        manifest::parse("e.toml", text.as_bytes()).map(|_| ()).map_err(|error| error.to_string())
    };
    // 50,000 episodes of 100 steps are all that a job records.
    let rule = "evaluation.record_decisions = 'test'\nevaluation.test_episodes = 50_000\n\
                [[agent]]\nname = 'a'\nalgorithm = 'rule'\nrule = 'never'\n";
    assert_eq!(check(false, rule), Ok(()));
    let error = check(true, rule).unwrap_err();
    assert!(error.contains("the record of decisions can have 5050000 steps"), "{error}");
    assert!(error.contains("unpaid_last_step = true"), "{error}");
    let dqn = "[[agent]]\nname = 'a'\nalgorithm = 'dueling_dqn'\nrecurrent = 'gru'\nbatch = 32\n\
               buffer = 3300\n";
    assert_eq!(check(false, dqn), Ok(()));
    let error = check(true, dqn).unwrap_err();
    assert!(error.contains("3333 steps for `batch` = 32 and `horizon` = 100 with"), "{error}");
}

#[test]
fn a_bandit_records_the_probabilities_that_it_drew_by() {
    let results = results(&job(Agent::of(&bandit()), RecordedDecisions::All));
    let trained = episodes(&results, Phase::Train);
    let (warm_up, rest) = trained.split_at(2);
    assert!(warm_up.iter().flatten().all(|step| step.action_probability() == 0.25));
    let steps: Vec<&Decision> = rest.iter().flatten().collect();
    assert!(steps.iter().all(|step| (0.05..=0.85 + 1e-12).contains(&step.action_probability())));
    assert!(steps.iter().any(|step| step.action_probability() != 0.25));
    // If actions are drawn with the recorded probabilities p, the mean of 1 / p over the taken actions
    // is 4.
    let tested = episodes(&results, Phase::Test);
    let inverse: Vec<f64> =
        tested.iter().flatten().map(|step| 1.0 / step.action_probability()).collect();
    let mean = inverse.iter().sum::<f64>() / inverse.len() as f64;
    assert!((mean - 4.0).abs() < 0.5, "{mean} over {} decisions", inverse.len());
}

/// Learning agents with this value of `unavailable`.
fn learners(unavailable: Unavailable) -> [Agent; 5] {
    let dqn =
        DuelingDqn { episodes: 9, layers: vec![8], batch: 4, unavailable, ..DuelingDqn::default() };
    let ppo = Ppo { episodes: 20, layers: vec![8], lanes: 8, unavailable, ..Ppo::default() };
    [
        Agent::of(&DuelingDqn { recurrent: Recurrent::Gru, units: 8, ..dqn.clone() }),
        Agent::of(&Reinforce { episodes: 9, layers: vec![8], unavailable, ..Reinforce::default() }),
        Agent::of(&Ppo { recurrent: Recurrent::Gru, units: 8, minibatches: 2, ..ppo.clone() }),
        Agent::of(&ppo),
        Agent::of(&dqn),
    ]
}

/// A job whose messages are unavailable in some steps, and have a budget.
fn limited(agent: Agent) -> Job {
    let mut job = job(agent, RecordedDecisions::All);
    job.environment.change(|e| e.availability = 0.6);
    job.environment.change(|e| e.message_budget = 12);
    job
}

/// Checks availability and budget of an episode, and that a step without a message took action 0.
fn assert_limits(steps: &[Decision]) {
    let mut sent = 0;
    for step in steps {
        assert_eq!(step.can_send, step.available && sent < 12, "{step:?}");
        let taken = if step.can_send { step.chosen } else { 0 };
        assert_eq!(step.action, taken, "{step:?}");
        let certain = if step.can_send { step.probabilities[usize::from(taken)] } else { 1.0 };
        assert_eq!(step.action_probability(), certain, "{step:?}");
        sent += u32::from(step.action > 0);
    }
}

#[test]
fn agents_choose_only_where_a_message_can_be_sent() {
    let bandit = |unavailable| Agent::of(&LinearThompson { unavailable, ..bandit() });
    for unavailable in [Unavailable::Masked, Unavailable::Chosen] {
        for agent in learners(unavailable).into_iter().chain([bandit(unavailable)]) {
            let algorithm = agent.algorithm().name();
            let results = results(&limited(agent));
            for phase in [Phase::Train, Phase::Test] {
                let episodes = episodes(&results, phase);
                episodes.iter().for_each(|steps| assert_limits(steps));
                let mut withheld = episodes.iter().flatten().filter(|step| !step.can_send);
                match unavailable {
                    Unavailable::Masked => assert!(
                        withheld.all(|step| *step.probabilities == [1.0, 0.0, 0.0, 0.0]),
                        "{algorithm} in {phase:?}"
                    ),
                    Unavailable::Chosen => assert!(
                        withheld.any(|step| step.probabilities[0] < 1.0),
                        "{algorithm} in {phase:?}"
                    ),
                }
            }
        }
    }
}

#[test]
fn a_bandit_learns_from_the_steps_at_which_a_message_could_be_sent() {
    for unavailable in [Unavailable::Masked, Unavailable::Chosen] {
        let bandit = LinearThompson { unavailable, ..bandit() };
        let results = results(&limited(Agent::of(&bandit)));
        let weights = Weights::from_bytes(results.weights.as_ref().unwrap()).unwrap();
        let precision = &weights.double("precision", &[4, 4, 4]).unwrap().values;
        let information = &weights.double("information", &[4, 4]).unwrap().values;
        let (prior, noise) = (bandit.prior_sd.powi(-2), bandit.noise_sd.powi(-2));
        let mut expected = [[[0.0; 4]; 4]; 4];
        let mut sums = [[0.0; 4]; 4];
        (0..4).for_each(|action| (0..4).for_each(|i| expected[action][i][i] = prior));
        for step in episodes(&results, Phase::Train).iter().flatten() {
            if !step.can_send && unavailable == Unavailable::Masked {
                continue;
            }
            let seen = |number: f64| f64::from(number as f32);
            let (h, d) = (seen(state(step).habituation), seen(state(step).disengagement));
            let x = [1.0, seen(state(step).probability), h, d];
            let action = usize::from(step.chosen);
            for i in 0..4 {
                sums[action][i] += x[i] * step.reward * noise;
                (0..4).for_each(|j| expected[action][i][j] += x[i] * x[j] * noise);
            }
        }
        let close = |ours: &[f64], expected: &[f64]| {
            ours.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9 * (1.0 + b.abs()))
        };
        assert!(close(precision, expected.as_flattened().as_flattened()), "{unavailable:?}");
        assert!(close(information, sums.as_flattened()), "{unavailable:?}");
    }
}

#[test]
fn a_training_without_a_single_message_is_no_failure() {
    for agent in learners(Unavailable::Masked) {
        let mut job = limited(agent);
        job.environment.change(|e| e.message_budget = 0);
        let results = results(&job);
        assert!(results.decisions.iter().all(|step| step.action == 0 && !step.can_send));
    }
}

#[test]
fn a_budget_for_every_step_changes_no_result() {
    let agents = [Unavailable::Masked, Unavailable::Chosen].map(learners).into_iter().flatten();
    for agent in agents {
        let mut job = job(agent, RecordedDecisions::None);
        job.environment.change(|e| e.horizon = 3);
        let unlimited = results(&job);
        job.environment.change(|e| e.message_budget = 3);
        assert!(results(&job) == unlimited, "{}", job.algorithm());
    }
}

#[test]
fn only_jobs_whose_messages_can_be_withheld_have_another_version() {
    let version = |job: &Job| job.versions().algorithm;
    let agents = || learners(Unavailable::Masked).into_iter().chain([Agent::of(&bandit())]);
    for agent in agents() {
        let free = job(agent, RecordedDecisions::None);
        let with = |change: fn(&mut Job)| {
            let mut job = free.clone();
            change(&mut job);
            version(&job) - version(&free)
        };
        assert_eq!(with(|job| job.environment.change(|e| e.availability = 0.9)), 1);
        assert_eq!(with(|job| job.environment.change(|e| e.message_budget = 49)), 1);
        // A budget that no episode can spend.
        assert_eq!(with(|job| job.environment.change(|e| e.message_budget = 50)), 0);
        assert_eq!(with(|job| job.environment.change(|e| e.message_cost = 5.0)), 0);
    }
    let mut rule =
        job(Agent::of(&RuleParameters::new(DecisionRule::Random)), RecordedDecisions::None);
    rule.environment.change(|e| e.availability = 0.9);
    assert_eq!(version(&rule), 1);
}
