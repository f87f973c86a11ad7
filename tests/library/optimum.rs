//! Compares the optimum and the reference rules with simulated episodes.

use jitai::agent::RulePolicy;
use jitai::agent::{Agent, DecisionRule, RuleParameters};
use jitai::env::{Action, PhysicalActivity};
use jitai::env::{FirstContext, Scenario, StepCount};
use jitai::job::Evaluation;
use jitai::job::Job;
use jitai::job::{Outcome, Results};
use jitai::optimum::optimum;
use jitai::train::{self, RollStreams, StepObserver, Uncontrolled};

/// The returns of episodes, collected while the episodes are rolled.
struct Returns(Vec<f64>);

impl StepObserver<PhysicalActivity> for Returns {
    fn chosen(&mut self, _: &PhysicalActivity, _: &[Action], _: &[f64]) {}

    fn paid(&mut self, _: &PhysicalActivity, rewards: &[f64]) {
        self.0.iter_mut().zip(rewards).for_each(|(total, reward)| *total += reward);
    }
}

/// The mean return of a rule in this number of episodes, and its standard error.
fn simulated(
    rule: DecisionRule,
    environment: &StepCount,
    scenario: &Scenario,
    lanes: usize,
) -> [f64; 2] {
    let mut policy = RulePolicy::new(&RuleParameters::new(rule), environment, scenario).unwrap();
    let mut streams = RollStreams::of_test(7);
    let mut simulation = PhysicalActivity::new(environment, scenario, lanes);
    let mut returns = Returns(vec![0.0; lanes]);
    train::begin(&mut simulation, &mut policy, &mut streams);
    train::roll(&mut simulation, &mut policy, &mut streams, &mut returns);
    let n = lanes as f64;
    let mean = returns.0.iter().sum::<f64>() / n;
    let variance = returns.0.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / (n - 1.0);
    [mean, (variance / n).sqrt()]
}

/// Number of episodes of an optimal policy; `JITAI_EPISODES` overrides it.
const EPISODES: usize = 20_000;

#[test]
fn the_optimal_policy_reaches_the_optimum_in_many_episodes() {
    let episodes = std::env::var("JITAI_EPISODES").map_or(EPISODES, |n| n.parse().unwrap());
    for (sigma, first_context) in [(0.6, FirstContext::Fixed), (1.0, FirstContext::Sampled)] {
        let environment = StepCount { first_context, ..StepCount::paper(sigma) };
        for scenario in ["C-H-D", "P-H-D", "L-H-D"] {
            let is_certain = scenario.starts_with('C');
            let scenario: Scenario = scenario.parse().unwrap();
            let best = optimum(&environment, &scenario).unwrap().mean_return;
            // C-H-D is deterministic.
            let lanes = if is_certain { 10 } else { episodes };
            let [mean, error] = simulated(DecisionRule::Optimal, &environment, &scenario, lanes);
            assert!((mean - best).abs() < 4.0 * error + 0.1, "{scenario} {sigma}: {mean} {best}");
        }
    }
}

#[test]
fn the_optimal_policy_reaches_the_optimum_of_another_environment() {
    let environment = StepCount {
        horizon: 30,
        epsilon_d: 0.25,
        delta_d: 0.2,
        epsilon_h: 0.12,
        disengagement_threshold: 0.7,
        mu: [-20.0, 40.0],
        ..StepCount::paper(0.8)
    };
    let scenario: Scenario = "P-H-D".parse().unwrap();
    let best = optimum(&environment, &scenario).unwrap().mean_return;
    let [mean, error] = simulated(DecisionRule::Optimal, &environment, &scenario, 30_000);
    assert!((mean - best).abs() < 4.0 * error + 0.1, "{mean} ± {error}, {best}");
}

#[test]
fn the_optimal_policy_reaches_the_optimum_where_known_contexts_persist() {
    let environment = StepCount {
        context_persistence: 0.9,
        context_probability: 0.3,
        first_context: FirstContext::Sampled,
        ..StepCount::paper(0.8)
    };
    let scenario: Scenario = "C-H-D".parse().unwrap();
    let best = optimum(&environment, &scenario).unwrap().mean_return;
    let [mean, error] = simulated(DecisionRule::Optimal, &environment, &scenario, 200);
    assert!((mean - best).abs() < 4.0 * error + 0.1, "{mean} ± {error}, {best}");
}

#[test]
fn no_rule_is_better_than_the_optimal_one() {
    let environment = StepCount::paper(0.8);
    let scenario: Scenario = "P-H-D".parse().unwrap();
    let best = optimum(&environment, &scenario).unwrap().mean_return;
    let rules = [
        DecisionRule::Never,
        DecisionRule::Untailored,
        DecisionRule::Tailored,
        DecisionRule::Threshold,
        DecisionRule::Random,
    ];
    for rule in rules {
        let [mean, error] = simulated(rule, &environment, &scenario, 2000);
        assert!(mean < best - 4.0 * error, "{rule:?}: {mean} {best}");
    }
    // Without messages, each of the fifty steps pays the baseline of 0.1.
    let [mean, error] = simulated(DecisionRule::Never, &environment, &scenario, 10);
    assert!((mean - 5.0).abs() < 1e-9 && error < 1e-9, "{mean}");
}

fn tested(rule: DecisionRule, scenario: &str) -> Results {
    let job = Job {
        environment: StepCount::paper(0.6).into(),
        scenario: scenario.parse().unwrap(),
        agent: Agent::of(&RuleParameters::new(rule)),
        evaluation: Evaluation::default(),
        trial: None,
        seed: 1,
    };
    match train::run(&job, &Uncontrolled) {
        Outcome::Completed(results) => results,
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_rule_is_tested_like_any_agent_and_learns_nothing() {
    let results = tested(DecisionRule::Tailored, "L-T");
    assert_eq!((results.episodes.len(), results.curve.len()), (1000, 0));
    assert_eq!(results.weights, None);
    assert_eq!(tested(DecisionRule::Tailored, "P"), results, "what it goes by is the same");
    assert_ne!(tested(DecisionRule::Tailored, "C"), results);
    // The contexts of the test do not depend on the policy: common random numbers.
    let contexts = |results: &Results| {
        let of_zero =
            results.actions.iter().filter(|choice| choice.stratum.is_some_and(|of| of % 2 == 0));
        of_zero.map(|choice| choice.count).sum::<u64>()
    };
    assert_eq!(
        contexts(&tested(DecisionRule::Never, "P")),
        contexts(&tested(DecisionRule::Optimal, "C-H-D"))
    );
}
