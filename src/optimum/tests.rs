//! Compares the optimum with published values, with an enumeration of short episodes and with simulated
//! returns, and tests extreme parameters.

use super::action_values::ActionValues;
use super::expectation::Expectation;
use super::simulation::{MeanReturn, mean_return};
use super::solution::{Resolution, Solution};
use super::two_grids::better_of;
use super::{OptimalPolicy, Optimum, optimum};
use crate::env::{
    Action, Belief, ContextDraw, DisengagementReward, FirstContext, StepCount, StepNoise,
    apply_action, inference_error,
};
use crate::rng::{Purpose, Stream};

fn value(environment: &StepCount, scenario: &str) -> Optimum {
    optimum(environment, &scenario.parse().unwrap()).unwrap()
}

fn assert_known(first_context: FirstContext, scenario: &str, known: &[(f64, f64)]) {
    for (sigma, known) in known {
        let environment = StepCount { first_context, ..StepCount::paper(*sigma) };
        let ours = value(&environment, scenario);
        assert!((ours.mean_return - known).abs() < 3.0, "{scenario} {sigma}: {ours:?}");
        assert!(ours.error < 0.1, "{scenario} {sigma}: {ours:?}");
    }
}

/// Values of an independent program, whose grid error is at most 3.
#[test]
fn optima_with_the_papers_parameters_are_the_known_ones() {
    use FirstContext::{Fixed, Sampled};
    assert_known(Sampled, "C-H-D", &[(0.4, 3397.8), (2.0, 3397.8)]);
    assert_known(Fixed, "C-H-D", &[(0.4, 3397.8)]);
    let sigmas = [0.4, 0.6, 0.8, 1.0, 2.0];
    let pair = |values: [f64; 5]| -> Vec<(f64, f64)> { sigmas.into_iter().zip(values).collect() };
    assert_known(Sampled, "P-H-D", &pair([3238.0, 2879.0, 2477.0, 2179.0, 1603.0]));
    assert_known(Sampled, "L-H-D", &pair([2847.0, 2254.0, 1938.0, 1761.0, 1457.0]));
    assert_known(Fixed, "P-H-D", &pair([3254.0, 2924.0, 2547.0, 2263.0, 1706.0]));
    assert_known(Fixed, "L-H-D", &pair([2880.0, 2317.0, 2016.0, 1848.0, 1557.0]));
}

/// Values from grids many times finer, by an earlier method that refined its grids until they gained nothing.
#[test]
fn optima_are_those_of_much_finer_grids() {
    let environment = |parameters: [f64; 5], sigma| {
        let [delta_h, epsilon_h, delta_d, epsilon_d, disengagement_threshold] = parameters;
        let paper = StepCount::paper(sigma);
        let environment = StepCount { delta_h, epsilon_h, delta_d, epsilon_d, ..paper };
        StepCount { disengagement_threshold, horizon: 200, ..environment }
    };
    for (scenario, sigma, parameters, known, error) in [
        ("L-H-D", 0.36, [0.018, 0.2, 0.16, 0.18, 0.75], 949.012, 0.011),
        ("H-D", 0.49, [0.058, 0.046, 0.012, 0.33, 0.86], 2614.762, 0.108),
        ("P-H-D", 1.6, [0.13, 0.013, 0.016, 0.57, 0.82], 6642.379, 0.034),
        ("C-H-D", 0.76, [0.33, 0.054, 0.018, 0.062, 0.8], 19002.781, 0.0),
    ] {
        let ours = value(&environment(parameters, sigma), scenario);
        let apart = (ours.mean_return - known).abs();
        assert!(apart < ours.error + error + 0.001, "{scenario} {parameters:?}: {ours:?}");
        assert!(ours.error < 0.3, "{scenario} {parameters:?}: {ours:?}");
    }
}

/// The optimum by enumerating every course of an episode, without a grid.
fn by_every_course(e: &StepCount, belief: &Expectation, time: u32, state: [f64; 2]) -> f64 {
    if time == e.horizon {
        return 0.0;
    }
    let is_known = time == 0 && e.first_context == FirstContext::Fixed;
    let unbiased = StepCount { mu: [0.0; 2], ..e.clone() };
    let after = |action| {
        let effect = apply_action(&unbiased, 0, action, state[0], state[1]);
        let ends = effect.disengagement >= e.disengagement_threshold;
        let state = [effect.habituation, effect.disengagement];
        let cost = if action == Action::NONE { 0.0 } else { e.message_cost };
        let paid = match e.disengagement_reward {
            DisengagementReward::Zero if ends => -e.mu[0],
            _ if ends => effect.reward,
            _ => effect.reward + by_every_course(e, belief, time + 1, state),
        };
        paid - cost
    };
    let values = ActionValues {
        nothing: after(Action::NONE),
        untailored: after(Action::UNTAILORED),
        suitable: after(Action::tailored_to(0)),
        unsuitable: after(Action::tailored_to(1)),
    };
    match is_known {
        true => e.mu[0] + Expectation::Certain.of_best(&values),
        false => (e.mu[0] + e.mu[1]) / 2.0 + belief.of_best(&values),
    }
}

/// Disengagement risk grows from 0 and never decays.
fn without_decay(epsilon_d: f64, horizon: u32) -> StepCount {
    let paper = StepCount::paper(0.7);
    StepCount { initial_disengagement: 0.0, delta_d: 0.0, epsilon_d, horizon, ..paper }
}

fn odd_environments() -> Vec<StepCount> {
    let paper = || StepCount { horizon: 7, ..StepCount::paper(0.7) };
    vec![
        paper(),
        StepCount { first_context: FirstContext::Sampled, mu: [-30.0, 70.0], ..paper() },
        StepCount { delta_h: 0.37, epsilon_h: 0.23, delta_d: 0.31, epsilon_d: 0.17, ..paper() },
        StepCount { initial_disengagement: 0.2, initial_habituation: 0.97, ..paper() },
        StepCount { epsilon_d: 1.0, disengagement_threshold: 0.55, ..paper() },
        StepCount { epsilon_d: 0.0, epsilon_h: 0.0, delta_h: 1.0, delta_d: 1.0, ..paper() },
        StepCount { delta_h: 0.0, delta_d: 0.0, epsilon_h: 1.0, ..paper() },
        StepCount { initial_disengagement: 1.0, ..paper() },
        StepCount { initial_disengagement: 1.0, delta_d: 0.0, ..paper() },
        StepCount { disengagement_threshold: 5e-324, ..paper() },
        // Three mistakes add up to 0.8999999999999999.
        StepCount { disengagement_threshold: 0.9, ..without_decay(0.3, 7) },
        StepCount { rho_1: -50.0, rho_2: -200.0, mu: [-1e5, -1e5], ..paper() },
        StepCount { rho_3: 150.0, epsilon_d: 0.2, ..paper() },
        StepCount { rho_3: -70.0, ..paper() },
        StepCount { message_cost: 90.0, ..paper() },
        StepCount { message_cost: 500.0, ..paper() },
        StepCount {
            mu: [60.0, 60.0],
            rho_3: 90.0,
            disengagement_reward: DisengagementReward::Zero,
            step_noise: StepNoise::Gamma,
            steps_cut_at_zero: true,
            unpaid_last_step: true,
            message_cost: 40.0,
            ..paper()
        },
        StepCount { sigma: 0.0, epsilon_d: 0.3, ..paper() },
        StepCount { sigma: 1e6, delta_d: 0.5, epsilon_d: 0.25, ..paper() },
        StepCount { horizon: 1, ..paper() },
    ]
}

#[test]
fn the_optimum_of_short_episodes_is_the_best_of_every_course() {
    for environment in odd_environments() {
        for scenario in ["C-H-D", "P-H-D", "L-H-D", "D-T-H"] {
            let ours = value(&environment, scenario);
            let start = [environment.initial_habituation, environment.initial_disengagement];
            let belief = Belief::new(&environment, &scenario.parse().unwrap());
            let exact = by_every_course(&environment, &Expectation::new(belief), 0, start);
            let apart = (ours.mean_return - exact).abs();
            let which = || format!("{scenario} {environment:?}: {ours:?} {exact}");
            assert!(apart < 0.01 + ours.error && ours.error < 0.1, "{}", which());
        }
    }
}

/// Without decay, only the number of mistakes matters, and that number depends on how sums of 0.1 are
/// rounded.
#[test]
fn ten_tenths_are_less_than_one() {
    let environment = without_decay(0.1, 200);
    // Eleven mistakes end an episode, as with an increment just below 0.1.
    let alike = StepCount { epsilon_d: 0.0999, ..environment.clone() };
    let fewer = StepCount { epsilon_d: 0.1001, ..environment.clone() };
    for scenario in ["P-H-D", "L-H-D", "H-D"] {
        let [ours, alike, fewer] = [&environment, &alike, &fewer].map(|e| value(e, scenario));
        let apart = (ours.mean_return - alike.mean_return).abs();
        assert!(apart < 0.01 + ours.error + alike.error, "{scenario}: {ours:?} {alike:?}");
        assert!(fewer.mean_return < ours.mean_return - 1.0, "{scenario}: {ours:?} {fewer:?}");
    }
}

/// The mean return and standard error of a solution's policy, from ordinary simulated episodes.
fn simulated(solution: &Solution, e: &StepCount, count: u32) -> [f64; 2] {
    let mut stream = Stream::new(3, Purpose::TestEnvironment);
    let mut episode = || {
        let mut state = [e.initial_habituation, e.initial_disengagement];
        let mut total = 0.0;
        for time in 0..e.horizon {
            let draw = match (time, e.first_context) {
                (0, FirstContext::Fixed) => ContextDraw::FIXED_FIRST,
                _ => ContextDraw::draw(e.sigma, &mut stream),
            };
            let believed = solution.belief().probability_of_zero(&draw);
            let action = solution.choose(time, believed, state[0], state[1]);
            let effect = apply_action(e, draw.context, action, state[0], state[1]);
            total += effect.reward;
            total -= if action == Action::NONE { 0.0 } else { e.message_cost };
            state = [effect.habituation, effect.disengagement];
            if effect.disengagement >= e.disengagement_threshold {
                break;
            }
        }
        total
    };
    let totals: Vec<f64> = (0..count).map(|_| episode()).collect();
    let n = f64::from(count);
    let mean = totals.iter().sum::<f64>() / n;
    let variance = totals.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / (n - 1.0);
    [mean, (variance / n).sqrt()]
}

#[test]
fn errors_of_interpolation_add_up_to_what_a_policy_s_return_differs_by() {
    // The grid is so coarse that its values differ clearly from the policy's return.
    let resolution = Resolution { habituation: 3, disengagement: 1, jumps: 1 };
    let mut broken = 0.0;
    for (sigma, first_context) in [(0.6, FirstContext::Fixed), (2.0, FirstContext::Sampled)] {
        let paper = StepCount::paper(sigma);
        let message_cost = if sigma < 1.0 { 0.0 } else { 20.0 };
        let environment =
            StepCount { horizon: 80, mu: [5.0, -2.0], first_context, message_cost, ..paper };
        for scenario in ["P-H-D", "L-H-D", "H-D"] {
            let belief = Belief::new(&environment, &scenario.parse().unwrap());
            let solution = Solution::new(&environment, belief, resolution);
            let ours = mean_return(&solution, 2_000);
            let [mean, error] = simulated(&solution, &environment, 15_000);
            let apart = (ours.mean - mean).abs();
            assert!(apart < 4.0 * error.hypot(ours.standard_error), "{ours:?} {mean} {error}");
            broken = f64::max(broken, (solution.value_of_start() - mean).abs() / error);
        }
    }
    assert!(broken > 5.0, "{broken}");
}

#[test]
fn the_error_is_what_the_grids_differ_by_and_two_standard_errors() {
    let tried = |mean, standard_error| MeanReturn { mean, standard_error };
    let found = better_of(tried(100.0, 0.5), tried(100.25, 0.125));
    assert_eq!(found, Optimum { mean_return: 100.25, error: 0.5 });
    let found = better_of(tried(100.25, 0.5), tried(100.0, 0.125));
    assert_eq!(found, Optimum { mean_return: 100.25, error: 1.25 });
}

#[test]
fn small_rewards_have_as_exact_an_optimum() {
    for scenario in ["C-H-D", "P-H-D", "L-H-D"] {
        let usual = StepCount::paper(0.8);
        let small = StepCount {
            rho_1: usual.rho_1 / 1e4,
            rho_2: usual.rho_2 / 1e4,
            mu: usual.mu.map(|mu| mu / 1e4),
            ..usual.clone()
        };
        let (usual, small) = (value(&usual, scenario), value(&small, scenario));
        let apart = (usual.mean_return - 1e4 * small.mean_return).abs();
        assert!(apart < 1e-6 && small.error < 1e-5, "{scenario}: {usual:?} {small:?}");
    }
}

#[test]
fn the_optimal_policy_knows_a_fixed_first_context_and_what_is_left() {
    let policy = |scenario: &str| {
        OptimalPolicy::new(&StepCount::paper(1.0), &scenario.parse().unwrap()).unwrap()
    };
    let policy = policy("P-H-D");
    assert_eq!(policy.choose(0, 0.5, 0.1, 0.1), Action::tailored_to(0));
    assert_eq!(policy.choose(1, 0.01, 0.1, 0.1), Action::tailored_to(1));
    // If a mistake would end the episode, the policy must be certain, except in the last step.
    assert_ne!(policy.choose(1, 0.6, 0.1, 0.9), Action::tailored_to(0));
    assert_eq!(policy.choose(49, 0.6, 0.1, 0.9), Action::tailored_to(0));
}

#[test]
fn scenarios_that_hide_the_state_and_long_horizons_have_no_optimum() {
    let refused = |horizon, scenario: &str| {
        let environment = StepCount { horizon, ..StepCount::paper(1.0) };
        optimum(&environment, &scenario.parse().unwrap()).unwrap_err().to_string()
    };
    assert_eq!(
        refused(50, "P-T"),
        "no optimum is computed for P-T, which does not show both habituation (H) and \
         disengagement risk (D); the optimum for P-T-H-D is an upper bound"
    );
    assert!(refused(50, "D-L").ends_with("the optimum for D-L-H is an upper bound"));
    assert_eq!(
        refused(201, "P-H-D"),
        "no optimum is computed for a horizon of 201 steps; the maximum is 200"
    );
}

#[test]
fn contexts_that_persist_do_not_matter_to_who_knows_them() {
    let paper = StepCount::paper(0.6);
    let persistent =
        StepCount { context_persistence: 0.8, context_probability: 0.3, ..paper.clone() };
    assert_eq!(value(&persistent, "C-H-D"), value(&paper, "C-H-D"));
    let exact = StepCount { sigma: 0.0, ..persistent.clone() };
    assert_eq!(value(&exact, "F-H-D"), value(&paper, "C-H-D"));
    let refused = |e: &StepCount, scenario: &str| {
        optimum(e, &scenario.parse().unwrap()).unwrap_err().to_string()
    };
    let not_known = "no optimum can be computed with `context_probability` = 0.3";
    assert_eq!(refused(&persistent, "P-H-D"), not_known);
    let unequal = StepCount { mu: [0.1, 0.2], ..persistent };
    assert_eq!(refused(&unequal, "C-H-D"), not_known);
}

#[test]
fn what_a_scenario_shows_besides_makes_no_difference() {
    let environment = StepCount { observed_probability: 1, ..StepCount::paper(0.6) };
    assert_eq!(value(&environment, "T-H-P-L-D"), value(&StepCount::paper(0.6), "P-H-D"));
    // What can be known of the state is known where the state is shown.
    assert_eq!(value(&environment, "F-E-R-H-D"), value(&environment, "P-H-D"));
    let exact = StepCount { sigma: 0.0, ..environment };
    assert_eq!(inference_error(0.0), 0.0);
    assert_eq!(value(&exact, "L-H-D"), value(&exact, "C-H-D"));
    assert_eq!(Belief::Certain.probability_of_zero(&ContextDraw::new(1, 0.0)), 0.0);
}
