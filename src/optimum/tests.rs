//! The optimum against published values, against every course of short episodes, and at the edges
//! of its parameters.

use std::num::NonZeroUsize;

use super::expectation::Expectation;
use super::search::{MOST_COMPUTED, OF_NOISY_EPISODES, Search};
use super::walk::Walked;
use super::*;
use crate::env::{ContextDraw, apply_action, inference_error};
use crate::kernel::Isa;
use crate::rng::{Purpose, Stream};

const ONE: Effort = Effort { threads: NonZeroUsize::MIN, times: NonZeroU32::MIN };

/// Coarser than a search begins with.
const COARSE: Resolution =
    Resolution { habituation: 10, disengagement: 75, jumps: 25, levels: 0, region: Region::ALL };

fn value(environment: &Environment, scenario: &str) -> Optimum {
    optimum(environment, &scenario.parse().unwrap(), ONE).unwrap()
}

fn assert_known(first_context: FirstContext, scenario: &str, known: &[(f64, f64)]) {
    for (sigma, known) in known {
        let environment = Environment { first_context, ..Environment::paper(*sigma) };
        let ours = value(&environment, scenario);
        assert!((ours.mean_return - known).abs() < 3.0, "{scenario} {sigma}: {ours:?}");
        assert!(ours.error < 0.5, "{scenario} {sigma}: {ours:?}");
    }
}

/// Of an independent program, whose grid error is at most 3.
#[test]
fn optima_with_the_papers_parameters_are_the_known_ones() {
    use FirstContext::{Fixed, Sampled};
    assert_known(Sampled, "C-H-D", &[(0.4, 3397.8), (2.0, 3397.8)]);
    assert_known(Fixed, "C-H-D", &[(0.4, 3397.8)]);
    let sigmas = [0.4, 0.6, 0.8, 1.0, 2.0];
    let of = |values: [f64; 5]| -> Vec<(f64, f64)> { sigmas.into_iter().zip(values).collect() };
    assert_known(Sampled, "P-H-D", &of([3238.0, 2879.0, 2477.0, 2179.0, 1603.0]));
    assert_known(Sampled, "L-H-D", &of([2847.0, 2254.0, 1938.0, 1761.0, 1457.0]));
    assert_known(Fixed, "P-H-D", &of([3254.0, 2924.0, 2547.0, 2263.0, 1706.0]));
    assert_known(Fixed, "L-H-D", &of([2880.0, 2317.0, 2016.0, 1848.0, 1557.0]));
}

/// The optimum by following every course of an episode, without a grid.
fn by_every_course(e: &Environment, belief: &Expectation, time: u32, state: [f64; 2]) -> f64 {
    if time == e.horizon {
        return 0.0;
    }
    let is_known = time == 0 && e.first_context == FirstContext::Fixed;
    let unbiased = Environment { mu: [0.0; 2], ..e.clone() };
    let after = |action| {
        let effect = apply_action(&unbiased, 0, action, state[0], state[1]);
        let ends = effect.disengagement >= e.disengagement_threshold;
        let state = [effect.habituation, effect.disengagement];
        effect.reward + if ends { 0.0 } else { by_every_course(e, belief, time + 1, state) }
    };
    let prospects = Prospects {
        nothing: after(Action::NONE),
        untailored: after(Action::UNTAILORED),
        suitable: after(Action::tailored_to(0)),
        unsuitable: after(Action::tailored_to(1)),
    };
    match is_known {
        true => e.mu[0] + Expectation::Certain.of_best(&prospects),
        false => (e.mu[0] + e.mu[1]) / 2.0 + belief.of_best(&prospects),
    }
}

fn odd_environments() -> Vec<Environment> {
    let paper = || Environment { horizon: 7, ..Environment::paper(0.7) };
    vec![
        paper(),
        Environment { first_context: FirstContext::Sampled, mu: [-30.0, 70.0], ..paper() },
        Environment { delta_h: 0.37, epsilon_h: 0.23, delta_d: 0.31, epsilon_d: 0.17, ..paper() },
        Environment { initial_disengagement: 0.2, initial_habituation: 0.97, ..paper() },
        Environment { epsilon_d: 1.0, disengagement_threshold: 0.55, ..paper() },
        Environment { epsilon_d: 0.0, epsilon_h: 0.0, delta_h: 1.0, delta_d: 1.0, ..paper() },
        Environment { delta_h: 0.0, delta_d: 0.0, epsilon_h: 1.0, ..paper() },
        Environment { initial_disengagement: 1.0, ..paper() },
        Environment { initial_disengagement: 1.0, delta_d: 0.0, ..paper() },
        // Three mistakes make 0.8999999999999999.
        Environment { disengagement_threshold: 0.9, ..of_levels(0.3, 7) },
        Environment { rho_1: -50.0, rho_2: -200.0, mu: [-1e5, -1e5], ..paper() },
        Environment { sigma: 0.0, epsilon_d: 0.3, ..paper() },
        Environment { sigma: 1e6, delta_d: 0.5, epsilon_d: 0.25, ..paper() },
        Environment { horizon: 1, ..paper() },
    ]
}

/// Disengagement risk grows from 0 and never decays.
fn of_levels(epsilon_d: f64, horizon: u32) -> Environment {
    let paper = Environment::paper(0.7);
    Environment { initial_disengagement: 0.0, delta_d: 0.0, epsilon_d, horizon, ..paper }
}

#[test]
fn the_optimum_of_short_episodes_is_the_best_of_every_course() {
    for environment in odd_environments() {
        for scenario in ["C-H-D", "P-H-D", "L-H-D", "D-T-H"] {
            let scenario: Scenario = scenario.parse().unwrap();
            let ours = optimum(&environment, &scenario, ONE).unwrap();
            let start = [environment.initial_habituation, environment.initial_disengagement];
            let belief = Expectation::new(Belief::new(&environment, &scenario));
            let exact = by_every_course(&environment, &belief, 0, start);
            let difference = (ours.mean_return - exact).abs();
            assert!(
                difference < 0.02 + 2.0 * ours.error,
                "{scenario} {environment:?}: {ours:?} {exact}"
            );
            assert!(ours.error < 0.2, "{scenario} {environment:?}: {ours:?}");
        }
    }
}

#[test]
fn other_parameters_and_horizons_converge_too() {
    for (horizon, epsilon_d) in [(50, 0.13), (200, 0.05), (400, 0.4)] {
        let environment = Environment { horizon, epsilon_d, ..Environment::paper(0.8) };
        for scenario in ["C-H-D", "P-H-D", "L-H-D"] {
            let ours = value(&environment, scenario);
            assert!(ours.error < 0.5, "{horizon} {epsilon_d} {scenario}: {ours:?}");
        }
    }
}

/// Twice as fine a habituation is the same lines where its increments are shorter than that.
#[test]
fn the_error_counts_habituation_where_its_increments_are_short() {
    let environment = Environment {
        delta_h: 0.5,
        epsilon_h: 0.01,
        delta_d: 0.3,
        epsilon_d: 0.7,
        disengagement_threshold: 0.6,
        horizon: 200,
        ..Environment::paper(2.0)
    };
    let ours = value(&environment, "P-H-D");
    let belief = Belief::new(&environment, &"P-H-D".parse().unwrap());
    let on = |habituation| {
        let resolution = Resolution { habituation, ..COARSE.refined() };
        walk::mean_return(&Grid::new(&environment, belief, resolution), |_| 2_000)
    };
    let (coarse, alike, finer) = (on(10), on(40), on(300));
    assert_eq!(coarse.mean_return, alike.mean_return);
    let missed = finer.mean_return - alike.mean_return;
    assert!(missed > 0.1 && ours.error < 0.1, "{ours:?} {finer:?} {alike:?}");
    let missed = finer.mean_return - ours.mean_return;
    assert!(missed.abs() < ours.error + 2.0 * finer.standard_error, "{ours:?} {finer:?}");
    // With time for the first grids alone.
    let mut search = Search::new(&environment, belief, ONE);
    search.most_computed = 1;
    let hasty = search.best_from(COARSE);
    let missed = (finer.mean_return - hasty.mean_return).abs();
    assert!(missed < hasty.error && hasty.error < 2.0, "{hasty:?} {finer:?}");
}

#[test]
fn more_effort_makes_a_smaller_error() {
    let environment = Environment { horizon: 400, delta_d: 0.03, ..Environment::paper(0.8) };
    let belief = Belief::new(&environment, &"L-H-D".parse().unwrap());
    let of_times = |times: u32| {
        let mut search = Search::new(
            &environment,
            belief,
            Effort { times: NonZeroU32::new(times).unwrap(), ..ONE },
        );
        assert_eq!(search.most_computed, times as usize * MOST_COMPUTED);
        search.most_computed /= 2_000;
        search.best_from(COARSE)
    };
    let [usual, longer] = [1, 100].map(of_times);
    assert!(longer.error < usual.error / 2.0, "{usual:?} {longer:?}");
    let apart = (longer.mean_return - usual.mean_return).abs();
    assert!(0.0 < apart && apart < usual.error, "{usual:?} {longer:?}");
}

/// Mean return in so many plain episodes, and its standard error, of the policy that makes the best
/// choice, given what tells the prospects of a state after which so many steps are left.
fn simulated(
    prospects: impl Fn(u32, [f64; 2]) -> Prospects,
    e: &Environment,
    belief: Belief,
    count: u32,
) -> [f64; 2] {
    let mut stream = Stream::new(3, Purpose::TestEnvironment);
    let mut episode = || {
        let mut state = [e.initial_habituation, e.initial_disengagement];
        let mut total = 0.0;
        for time in 0..e.horizon {
            let signal = match (time, e.first_context) {
                (0, FirstContext::Fixed) => ContextDraw::FIXED_FIRST,
                _ => ContextDraw::draw(e.sigma, &mut stream),
            };
            let is_known = time == 0 && e.first_context == FirstContext::Fixed;
            let believed = if is_known { 1.0 } else { belief.probability_of_zero(&signal) };
            let action = prospects(e.horizon - 1 - time, state).best(believed);
            let effect = apply_action(e, signal.context, action, state[0], state[1]);
            total += effect.reward;
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
    // So coarse that the values promise another return than their policy has.
    let resolution = Resolution { habituation: 3, disengagement: 1, jumps: 1, ..COARSE };
    let mut broken = 0.0;
    for (sigma, first_context) in [(0.6, FirstContext::Fixed), (2.0, FirstContext::Sampled)] {
        let environment = Environment {
            horizon: 80,
            mu: [5.0, -2.0],
            first_context,
            ..Environment::paper(sigma)
        };
        for scenario in ["P-H-D", "L-H-D", "H-D"] {
            let belief = Belief::new(&environment, &scenario.parse().unwrap());
            let grid = Grid::new(&environment, belief, resolution);
            let walked = walk::mean_return(&grid, |_| 2_000);
            let mut layers = Vec::new();
            let last = grid.induce(|_, layer| layers.push(layer.to_vec()));
            let promised = promised(&grid, last.before(environment.horizon - 1));
            let kept = |left: u32| match layers.get(left as usize) {
                Some(layer) => Moment { layer, more: 0.0 },
                None => last.before(left),
            };
            // Kept are the values with every eighth number of steps left, and the last.
            let is_kept = |left| left == last.left || left < last.left && left % 8 == 0;
            let value = |left: u32, h: f64, d: f64| {
                if d >= environment.disengagement_threshold {
                    0.0
                } else if is_kept(left) {
                    grid.value(kept(left), h, d)
                } else {
                    grid.mean_of_best(&grid.prospects(kept(left - 1), h, d))
                }
            };
            let prospects =
                |left: u32, [h, d]: [f64; 2]| grid.prospects_by(|h, d| value(left, h, d), h, d);
            let [mean, error] = simulated(prospects, &environment, belief, 15_000);
            let apart = (walked.mean_return - mean).abs();
            assert!(apart < 4.0 * error.hypot(walked.standard_error), "{walked:?} {mean} {error}");
            broken = f64::max(broken, (promised - mean).abs() / error);
        }
    }
    assert!(broken > 5.0, "{broken}");
}

/// At a node nothing is interpolated, so that a layer must be what the prospects of that state alone
/// make.
fn assert_layers_are_of_single_states(mut grid: Grid, which: &str) {
    let mut later = Vec::new();
    grid.induce(|left, layer| {
        if left == 20 {
            later = layer.to_vec()
        }
    });
    let mut layers = Isa::available().into_iter().map(|isa| {
        let mut now = grid.zeros();
        grid.isa = isa;
        grid.step_back(&later, &mut now);
        now
    });
    let layer = layers.next().unwrap();
    let bits =
        |layer: &[Lanes]| layer.as_flattened().iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    assert!(layers.all(|other| bits(&other) == bits(&layer)), "{which}");
    drop(layers);
    let [later, now] = [&later, &layer].map(|layer| Moment { layer, more: 0.0 });
    let mut compared = 0;
    for [habituation, disengagement] in grid.states() {
        let prospects = grid.prospects(later, habituation, disengagement);
        let alone = grid.mean_of_best(&prospects);
        let ours = grid.value(now, habituation, disengagement);
        assert!((ours - alone).abs() < 1e-7, "{which} {habituation} {disengagement}");
        compared += 1;
    }
    assert!(compared > 20, "{compared}");
}

#[test]
fn layers_are_what_single_states_make_on_every_instruction_set() {
    for environment in [Environment::paper(0.8), of_levels(0.3, 50)] {
        for scenario in ["C-H-D", "P-H-D", "L-H-D", "H-D"] {
            let belief = Belief::new(&environment, &scenario.parse().unwrap());
            let coarsest = coarsest(&environment, belief);
            let region = Region { habituation: [0.3, 0.6], disengagement: [0.2, 0.5] };
            let coarse = Resolution { habituation: 13, ..coarsest };
            let coarser_elsewhere = Resolution { habituation: 83, region, ..coarsest };
            for resolution in [coarse, coarser_elsewhere] {
                let grid = Grid::new(&environment, belief, resolution);
                assert_layers_are_of_single_states(grid, &format!("{scenario} {resolution:?}"));
            }
        }
    }
}

/// A policy loses hardly anything by coarse values of states that it hardly meets, and much more by
/// those of all states.
#[test]
fn a_grid_that_is_coarser_where_episodes_hardly_are_has_as_good_a_policy() {
    for (scenario, delta_d) in [("L-H-D", 0.1), ("H-D", 0.03)] {
        let environment = Environment { delta_d, horizon: 300, ..Environment::paper(0.8) };
        let belief = Belief::new(&environment, &scenario.parse().unwrap());
        let on = |resolution| {
            let grid = Grid::new(&environment, belief, resolution);
            (grid.nodes(), walk::mean_return(&grid, |_| 1_000))
        };
        let coarse = coarsest(&environment, belief);
        let fine = coarse.refined().refined();
        let (nodes, all) = on(fine);
        let (fewer, some) = on(Resolution { region: all.region, ..fine });
        let (_, coarse) = on(coarse);
        let misses = |walked: Walked| (walked.mean_return - all.mean_return).abs();
        assert!(fewer * 4 < nodes * 3, "{scenario} {fewer} {nodes}");
        assert!(
            misses(some) < 0.01 && misses(coarse) > 0.1,
            "{scenario} {all:?} {some:?} {coarse:?}"
        );
    }
}

/// The value of the start, given those of the states after it.
fn promised(grid: &Grid, later: Moment<'_>) -> f64 {
    let e = grid.environment();
    grid.mean_return(&grid.prospects(later, e.initial_habituation, e.initial_disengagement))
}

/// The value of the start by as many layers as there are steps.
fn promised_in_full(grid: &Grid) -> f64 {
    let mut later = grid.zeros();
    let mut now = later.clone();
    for _ in 1..grid.environment().horizon {
        grid.step_back(&later, &mut now);
        std::mem::swap(&mut later, &mut now);
    }
    promised(grid, Moment { layer: &later, more: 0.0 })
}

/// Ten tenths added up are less than 1, so that eleven mistakes are needed and not ten.
#[test]
fn risk_that_never_decays_has_the_levels_of_its_rounded_sums() {
    let environment = of_levels(0.1, 1_000);
    let levels = levels(&environment, MOST_LEVELS).unwrap();
    assert_eq!(
        (levels.len(), levels[3], levels[10]),
        (11, 0.1 + 0.1 + 0.1, 0.999_999_999_999_999_9)
    );
    for scenario in ["P-H-D", "L-H-D", "H-D"] {
        let ours = value(&environment, scenario);
        assert!(ours.error < 0.5, "{scenario}: {ours:?}");
        let belief = Belief::new(&environment, &scenario.parse().unwrap());
        let resolution = coarsest(&environment, belief).refined().refined();
        let promised = promised_in_full(&Grid::new(&environment, belief, resolution));
        assert!((promised - ours.mean_return).abs() < 1.0, "{scenario}: {promised} {ours:?}");
    }
}

#[test]
fn levels_are_none_where_they_are_too_many_or_too_near() {
    let near = Environment { initial_disengagement: 0.999_999_999_9, ..of_levels(8e-11, 50) };
    assert_eq!(levels(&near, MOST_LEVELS), None);
    assert_eq!(levels(&of_levels(1e-3, 50), MOST_LEVELS), None);
    assert_eq!(levels(&of_levels(0.0, 50), MOST_LEVELS), Some(vec![0.0]));
}

#[test]
fn small_rewards_have_as_exact_an_optimum() {
    for scenario in ["C-H-D", "P-H-D", "L-H-D"] {
        let usual = Environment::paper(0.8);
        let small = Environment {
            rho_1: usual.rho_1 / 1e4,
            rho_2: usual.rho_2 / 1e4,
            mu: usual.mu.map(|mu| mu / 1e4),
            ..usual.clone()
        };
        let (usual, small) = (value(&usual, scenario), value(&small, scenario));
        let apart = (usual.mean_return - 1e4 * small.mean_return).abs();
        assert!(apart < 0.01 + usual.error, "{scenario}: {usual:?} {small:?}");
        assert!(small.error < 1e-5 + usual.error / 1e4, "{scenario}: {usual:?} {small:?}");
    }
}

#[test]
fn threads_make_no_difference() {
    // Just beside, and at, a whole number of distances between the layers that are kept.
    for horizon in [129, 130] {
        let environment = Environment { horizon, ..Environment::paper(0.8) };
        let belief = Belief::new(&environment, &"P-H-D".parse().unwrap());
        let walked = |threads| {
            let mut grid = Grid::new(&environment, belief, COARSE.refined().refined().refined());
            assert!(grid.nodes() > 60_000, "enough for threads");
            grid.threads = threads;
            walk::mean_return(&grid, |_| 155).mean_return.to_bits()
        };
        assert_eq!(walked(1), walked(3));
    }
    let environment = Environment { epsilon_h: 0.03, ..Environment::paper(0.6) };
    let scenario = "L-H-D".parse().unwrap();
    let by = |threads| {
        optimum(&environment, &scenario, Effort::usual(NonZeroUsize::new(threads).unwrap()))
    };
    assert_eq!(by(1), by(3));
}

#[test]
fn the_time_is_bounded_where_increments_are_tiny_and_nothing_settles() {
    let usual = || Environment { horizon: 10_000, ..Environment::paper(0.8) };
    for environment in [
        Environment { epsilon_h: 1e-5, ..usual() },
        Environment { epsilon_h: 0.01, delta_d: 0.01, ..usual() },
        Environment { epsilon_h: 1e-9, epsilon_d: 0.0, mu: [-300.0; 2], ..usual() },
        Environment { delta_d: 0.0, epsilon_d: 1e-4, ..usual() },
        Environment { delta_d: 0.0, epsilon_d: 0.0046, epsilon_h: 0.026, ..usual() },
        Environment { delta_h: 0.0, delta_d: 0.0, epsilon_d: 0.02, ..usual() },
        Environment { delta_d: 1e-9, epsilon_d: 1e-9, ..usual() },
    ] {
        let inferred = Belief::Inferred { sigma: 0.8 };
        for belief in [Belief::Certain, Belief::Likely { error: 0.2 }, inferred] {
            let coarsest = coarsest(&environment, belief);
            let mut resolution = coarsest;
            let mut nodes = Grid::new(&environment, belief, coarsest).nodes();
            // Each variable is made finer once, whatever it takes.
            for variable in coarsest.variables().iter().rev() {
                resolution = resolution.with_more_lines(*variable, &environment);
                nodes += Grid::new(&environment, belief, resolution).nodes();
            }
            let takes = Search::new(&environment, belief, ONE).values(nodes, 2 * 10_000);
            // Of all beliefs the inferred one takes most.
            let takes = takes + takes / OF_NOISY_EPISODES;
            let sixteenths = if belief == inferred { 22 } else { 11 };
            let most = MOST_COMPUTED / 16 * sixteenths;
            assert!(takes < most, "{environment:?} {nodes}");
        }
    }
}

#[test]
fn where_steps_settle_the_rest_of_them_adds_the_same() {
    let of_horizon = |horizon| {
        let environment = Environment { horizon, ..Environment::paper(1.0) };
        let belief = Belief::new(&environment, &"L-H-D".parse().unwrap());
        let grid = Grid::new(&environment, belief, COARSE);
        (walk::mean_return(&grid, |_| 150), grid)
    };
    let (long, _) = of_horizon(10_000);
    assert!((100..9_000).contains(&long.layers), "{long:?}");
    let (shorter, grid) = of_horizon(9_000);
    let gain = grid.induce(|_, _| ()).gain;
    let grown = (long.mean_return - shorter.mean_return) / 1_000.0;
    assert!((grown / gain - 1.0).abs() < 0.01, "{grown} {gain}");
}

#[test]
fn single_steps_settle_as_soon_without_a_stretch() {
    let environment = Environment { horizon: 10_000, ..Environment::paper(0.4) };
    let belief = Belief::new(&environment, &"L-H-D".parse().unwrap());
    let mut grid = Grid::new(&environment, belief, COARSE);
    let with = grid.induce(|_, _| ());
    grid.stretches_after = walk::mean_return(&grid, |_| 2).stretches_after;
    assert_eq!((with.smoothed, grid.stretches_after), (0, 2 * with.left));
    let without = grid.induce(|_, _| ());
    assert_eq!((without.left, without.layer), (with.left, with.layer));
}

/// The best choices nearly repeat after 35 steps, and what a single step adds goes up and down with
/// them.
#[test]
fn what_settles_in_the_mean_over_a_stretch_is_the_full_induction_s() {
    let (horizon, delta_h, delta_d, epsilon_d) = (10_000, 0.5, 0.05, 0.7);
    let environment =
        Environment { delta_h, delta_d, epsilon_d, horizon, ..Environment::paper(0.4) };
    let belief = Belief::new(&environment, &"H-D".parse().unwrap());
    let mut grid = Grid::new(&environment, belief, COARSE);
    let mut last_two = [vec![], vec![]];
    let induced = grid.induce(|_, layer| {
        last_two.reverse();
        last_two[1] = layer.to_vec();
    });
    assert!((300..5_000).contains(&induced.left), "{}", induced.left);
    let [later, now] = [&last_two[0], &last_two[1]].map(|layer| layer.as_flattened());
    let added = now.iter().zip(later).map(|(now, later)| now - later);
    let [most, least] = [added.clone().fold(f64::MIN, f64::max), added.fold(f64::MAX, f64::min)];
    let ripple = (most - least) * f64::from(horizon - induced.left);
    assert!(ripple > 100.0, "a single step has settled: {least} {most}");
    let full = promised_in_full(&grid);
    let ours = promised(&grid, induced.before(horizon - 1));
    assert!((full - ours).abs() < 0.5, "{full} {ours}");
    // A finer grid is as likely to; and no stretch begins before it is said to.
    assert_eq!(walk::mean_return(&grid, |_| 2).stretches_after, induced.left / 2);
    grid.stretches_after = 2 * induced.left;
    let later = grid.induce(|_, _| ());
    assert!(induced.smoothed > 0 && later.left > grid.stretches_after, "{}", later.left);
}

#[test]
fn the_optimal_policy_knows_a_fixed_first_context_and_what_is_left() {
    let policy = |scenario: &str| {
        OptimalPolicy::new(&Environment::paper(1.0), &scenario.parse().unwrap()).unwrap()
    };
    let policy = policy("P-H-D");
    assert_eq!(policy.choose(0, 0.5, 0.1, 0.1), Action::tailored_to(0));
    assert_eq!(policy.choose(1, 0.01, 0.1, 0.1), Action::tailored_to(1));
    // Where a mistake would end the episode, certainty counts, until the last step.
    assert_ne!(policy.choose(1, 0.6, 0.1, 0.9), Action::tailored_to(0));
    assert_eq!(policy.choose(49, 0.6, 0.1, 0.9), Action::tailored_to(0));
}

#[test]
fn scenarios_that_hide_the_state_have_no_optimum() {
    let refused = |scenario: &str| {
        let error = optimum(&Environment::paper(1.0), &scenario.parse().unwrap(), ONE).unwrap_err();
        error.to_string()
    };
    assert_eq!(
        refused("P-T"),
        "no optimum is computed for P-T, which does not show both habituation (H) and \
         disengagement risk (D); that of P-T-H-D is an upper bound"
    );
    assert!(refused("D-L").ends_with("that of D-L-H is an upper bound"));
}

#[test]
fn what_a_scenario_shows_besides_makes_no_difference() {
    let environment = Environment { observed_probability: 1, ..Environment::paper(0.6) };
    assert_eq!(value(&environment, "T-H-P-L-D"), value(&Environment::paper(0.6), "P-H-D"));
    let exact = Environment { sigma: 0.0, ..environment };
    assert_eq!(inference_error(0.0), 0.0);
    assert_eq!(value(&exact, "L-H-D"), value(&exact, "C-H-D"));
    assert_eq!(Belief::Certain.probability_of_zero(&ContextDraw::new(1, 0.0)), 0.0);
}
