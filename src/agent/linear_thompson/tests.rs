//! Tests of linear Thompson sampling against independent computations.

use nalgebra::{DMatrix, DVector};

use super::posterior::{Acting, Decision};
use super::regression::{Factored, Regression, dot};
use super::sampler::{Sampler, normal, pick};
use super::*;
use crate::agent::registry::trained_linear_thompson;
use crate::agent::{Actions, Actor, Learner, LearnerError, Rewards, Shape};
use crate::env::{
    Action, LaneSet, LaneStreams, PhysicalActivity, Scenario, StepCount, VectorEnvironment,
};
use crate::rng::{Purpose, Stream};
use crate::state::{StateReader, StateWriter};

fn stream(seed: u64) -> Stream {
    Stream::new(seed, Purpose::Exploration)
}

/// Regressors as in the simulation, with the intercept first, and rewards up to 200.
fn data(steps: usize, width: usize, stream: &mut Stream) -> Vec<(Vec<f64>, f64)> {
    let mut row = || -> Vec<f64> {
        (0..width).map(|index| if index == 0 { 1.0 } else { stream.unit() }).collect()
    };
    let rows: Vec<Vec<f64>> = (0..steps).map(|_| row()).collect();
    rows.into_iter().map(|row| (row.clone(), 200.0 * row[1] - 30.0 * row[2])).collect()
}

/// The covariance of a regression, from whitened unit vectors.
fn covariance(factored: &mut Factored, width: usize) -> Vec<f64> {
    let unit = |index: usize| -> Vec<f64> {
        (0..width).map(|other| if index == other { 1.0 } else { 0.0 }).collect()
    };
    let rows: Vec<Vec<f64>> =
        (0..width).map(|index| factored.whiten(&unit(index)).to_vec()).collect();
    rows.iter().flat_map(|one| rows.iter().map(|other| dot(one, other))).collect()
}

#[track_caller]
fn assert_close(ours: &[f64], theirs: &[f64], tolerance: f64) {
    assert_eq!(ours.len(), theirs.len());
    for (one, other) in ours.iter().zip(theirs) {
        assert!((one - other).abs() <= tolerance * other.abs().max(1.0), "{ours:?} {theirs:?}");
    }
}

#[test]
fn the_posterior_after_some_steps_is_that_of_one_batch_and_that_of_bots() {
    const WIDTH: usize = 4;
    let (mean, sd, noise): (f64, f64, f64) = (3.0, 10.0, 25.0);
    let steps = data(300, WIDTH, &mut stream(1));
    let mut regression = Regression::prior(&[mean; WIDTH], &[sd; WIDTH]);
    // BOTS, after every step: S = s^2 (x x' + s^2 Sigma^-1)^-1, mu = S (x r / s^2 + Sigma^-1 mu).
    let mut bots_mean = DVector::from_element(WIDTH, mean);
    let mut bots_covariance = DMatrix::from_diagonal_element(WIDTH, WIDTH, sd * sd);
    let variance = noise * noise;
    for (row, reward) in &steps {
        regression.learn(row, *reward, variance);
        let x = DVector::from_column_slice(row);
        let before = bots_covariance.clone().try_inverse().unwrap();
        let sum = &x * x.transpose() + &before * variance;
        let after = sum.try_inverse().unwrap() * variance;
        bots_mean = &after * (&x * (*reward / variance) + &before * &bots_mean);
        bots_covariance = after;
    }
    // One batch: Sigma = (X'X / s^2 + I / sd^2)^-1, mu = Sigma (X'r / s^2 + m / sd^2).
    let all: Vec<f64> = steps.iter().flat_map(|(row, _)| row.iter().copied()).collect();
    let x = DMatrix::from_row_slice(steps.len(), WIDTH, &all);
    let r = DVector::from_iterator(steps.len(), steps.iter().map(|(_, reward)| *reward));
    let prior = DMatrix::from_diagonal_element(WIDTH, WIDTH, 1.0 / (sd * sd));
    let batch_covariance = (x.transpose() * &x / variance + &prior).try_inverse().unwrap();
    let batch_mean = &batch_covariance
        * (x.transpose() * &r / variance + prior * DVector::from_element(WIDTH, mean));
    let mut ours = Factored::new(&regression).unwrap();
    for (their_mean, their_covariance) in
        [(&bots_mean, &bots_covariance), (&batch_mean, &batch_covariance)]
    {
        assert_close(ours.mean(), their_mean.as_slice(), 1e-9);
        assert_close(&covariance(&mut ours, WIDTH), their_covariance.as_slice(), 1e-9);
    }
}

#[test]
fn drawn_coefficients_have_the_mean_and_the_covariance_of_the_posterior() {
    const DRAWS: usize = 40_000;
    const WIDTH: usize = 3;
    let mut regression = Regression::prior(&[1.0; WIDTH], &[2.0; WIDTH]);
    for (row, reward) in data(5, WIDTH, &mut stream(2)) {
        regression.learn(&row, reward, 9.0);
    }
    let mut factored = Factored::new(&regression).unwrap();
    let mut stream = stream(3);
    let (mut sums, mut products) = ([0.0; WIDTH], [0.0; WIDTH * WIDTH]);
    for _ in 0..DRAWS {
        let mut drawn = [(); WIDTH].map(|()| normal(&mut stream));
        factored.draw(&mut drawn);
        for one in 0..WIDTH {
            let centred = |index: usize| drawn[index] - factored.mean()[index];
            sums[one] += centred(one);
            (0..WIDTH)
                .for_each(|other| products[WIDTH * one + other] += centred(one) * centred(other));
        }
    }
    let n = DRAWS as f64;
    assert!(sums.iter().all(|sum| (sum / n).abs() < 0.05), "{sums:?}");
    let covariance = covariance(&mut factored, WIDTH);
    for (product, expected) in products.iter().zip(covariance) {
        assert!((product / n - expected).abs() < 0.1, "{product} {expected}");
    }
}

/// Number of features of a state.
const WIDTH: usize = 4;

/// The posterior after steps as in the simulation.
fn learned(parameters: &LinearThompson, steps: usize) -> Acting {
    let mut posterior = Posterior::prior(parameters, Shape::of_four(WIDTH));
    let mut stream = stream(4);
    for (features, reward) in data(steps, WIDTH, &mut stream) {
        let probabilities = [0.4, 0.1, 0.3, 0.2];
        let action = pick(&probabilities, stream.unit());
        let reward = reward * (0.3 + 0.1 * action.index() as f64);
        let probabilities = probabilities.to_vec();
        posterior.learn(&Decision { features, probabilities, action }, reward);
    }
    Acting::new(posterior).unwrap()
}

const FEATURES: [f64; WIDTH] = [1.0, 0.5, 0.4, 0.7];

fn probabilities(parameters: &LinearThompson, acting: &mut Acting) -> [f64; 4] {
    let mut out = [f64::NAN; 4];
    let mut sampler = Sampler::new(parameters, 4, 9);
    sampler.probabilities((acting, &mut Vec::new()), &FEATURES, 77, &mut out);
    out
}

/// The share of draws of all coefficients in which each action is chosen.
fn by_monte_carlo(parameters: &LinearThompson, acting: &mut Acting, draws: u64) -> [f64; 4] {
    let one = LinearThompson { draw: BanditDraw::Episode, ..parameters.clone() };
    let mut sampler = Sampler::new(&one, 4, 9);
    let (mut sums, mut drawn) = ([0.0; 4], [0.0; 4]);
    for word in 0..draws {
        sampler.probabilities((acting, &mut Vec::new()), &FEATURES, word, &mut drawn);
        sums.iter_mut().zip(drawn).for_each(|(sum, p)| *sum += p / draws as f64);
    }
    sums
}

#[test]
fn probabilities_are_the_shares_of_drawn_coefficients() {
    let plain = LinearThompson { noise_sd: 200.0, prior_sd: 60.0, ..LinearThompson::default() };
    let biased = LinearThompson { action_bias: vec![0.0, -10.0, 5.0, 3.0], ..plain.clone() };
    let smooth = LinearThompson { smoothing: 0.05, probability_draws: 40_000, ..plain.clone() };
    let centred = LinearThompson {
        action_centring: true,
        pi_min: 0.05,
        probability_draws: 40_000,
        ..biased.clone()
    };
    let both = LinearThompson { smoothing: 0.02, ..centred.clone() };
    for parameters in [plain, biased, smooth, centred, both] {
        let mut acting = learned(&parameters, 40);
        let ours = probabilities(&parameters, &mut acting);
        let drawn = by_monte_carlo(&parameters, &mut acting, 20_000);
        assert!((ours.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        assert!(ours.iter().all(|p| (0.01..0.9).contains(p)), "{ours:?} decide nothing");
        for (one, other) in ours.iter().zip(drawn) {
            // Four standard errors of a share are at most 0.014.
            assert!((one - other).abs() < 0.015, "{parameters:?}: {ours:?} {drawn:?}");
        }
    }
}

#[test]
fn no_action_is_less_likely_than_pi_min() {
    let certain = LinearThompson { pi_min: 0.1, ..LinearThompson::default() };
    let mut acting = learned(&certain, 5000);
    let ours = probabilities(&certain, &mut acting);
    assert_close(&ours, &[0.1, 0.1, 0.1, 0.7], 1e-9);
    let uniform = LinearThompson { pi_min: 0.25, ..certain };
    assert_close(&probabilities(&uniform, &mut acting), &[0.25; 4], 1e-12);
}

#[test]
fn clipped_probabilities_are_exact_and_cut_to_a_range() {
    let thompson = LinearThompson { noise_sd: 300.0, ..LinearThompson::default() };
    let clipped =
        LinearThompson { allocation: BanditAllocation::Clipped, pi_min: 0.1, ..thompson.clone() };
    let of_two = |parameters: &LinearThompson, steps: usize| {
        let mut posterior = Posterior::prior(parameters, Shape { inputs: WIDTH, actions: 2 });
        let mut stream = stream(4);
        for (features, reward) in data(steps, WIDTH, &mut stream) {
            let probabilities = vec![0.6, 0.4];
            let action = pick(&probabilities, stream.unit());
            let reward = reward * (0.5 + 0.1 * action.index() as f64);
            posterior.learn(&Decision { features, probabilities, action }, reward);
        }
        let mut acting = Acting::new(posterior).unwrap();
        let mut out = [f64::NAN; 2];
        let known = (&mut acting, &mut Vec::new());
        Sampler::new(parameters, 2, 9).probabilities(known, &FEATURES, 77, &mut out);
        out
    };
    // The integral over both actions, from little data to certainty.
    let shares: Vec<f64> = [5, 100, 400, 20_000].map(|steps| of_two(&thompson, steps)[1]).into();
    assert!(shares[..3].iter().all(|share| (0.1..0.9).contains(share)), "{shares:?}");
    assert!(shares[3] > 0.9, "{shares:?}");
    for (steps, share) in [5, 100, 400, 20_000].into_iter().zip(shares) {
        let share = share.clamp(0.1, 0.9);
        assert_close(&of_two(&clipped, steps), &[1.0 - share, share], 1e-9);
    }
    // With action centring, shares of draws have an error of 0.008.
    let centred = LinearThompson { action_centring: true, pi_min: 1e-9, ..thompson };
    let by_draws = LinearThompson { probability_draws: 20_000, ..centred.clone() };
    let exact = LinearThompson { allocation: BanditAllocation::Clipped, ..centred };
    assert_close(&of_two(&exact, 200), &of_two(&by_draws, 200), 0.015);
}

#[test]
fn equal_biases_change_nothing() {
    let with = |bias: [f64; 4]| LinearThompson {
        noise_sd: 200.0,
        prior_sd: 60.0,
        action_bias: bias.to_vec(),
        ..LinearThompson::default()
    };
    let mut acting = learned(&with([0.0; 4]), 40);
    let mut biased = |bias| probabilities(&with(bias), &mut acting);
    assert_close(&biased([-50.0; 4]), &biased([0.0; 4]), 1e-9);
    // If action 0 is practically impossible, an equal bias of all messages has no effect.
    assert_close(&biased([-1e6, -50.0, -50.0, -50.0]), &biased([-1e6, 0.0, 0.0, 0.0]), 1e-9);
    assert!(biased([0.0, -50.0, -50.0, -50.0])[0] > biased([0.0; 4])[0] + 0.1);
}

/// The posterior after steps with a baseline that no agent models: 5 sin 3s, plus 4 from the middle
/// of the steps on. The action probabilities vary with both. The effects of the messages in a state
/// (1, s) have coefficients (1, 0.5), (2, -1) and (0, 1.5).
fn confounded(parameters: &LinearThompson) -> Acting {
    const STEPS: usize = 60_000;
    let effects = [[0.0, 0.0], [1.0, 0.5], [2.0, -1.0], [0.0, 1.5]];
    let mut posterior = Posterior::prior(parameters, Shape::of_four(2));
    let mut stream = stream(5);
    for step in 0..STEPS {
        let s = 2.0 * stream.unit() - 1.0;
        let jump = if step >= STEPS / 2 { 4.0 } else { 0.0 };
        let baseline = 5.0 * (3.0 * s).sin() + jump;
        let preferred = [0.2, 0.1 + 0.06 * (baseline + 5.0), 0.15, 0.3 - 0.015 * baseline];
        let total: f64 = preferred.iter().sum();
        let probabilities = preferred.map(|p| 0.05 + 0.8 * p / total);
        let action = pick(&probabilities, stream.unit());
        let [intercept, slope] = effects[action.index()];
        let reward = baseline + intercept + slope * s + normal(&mut stream);
        let (features, probabilities) = (vec![1.0, s], probabilities.to_vec());
        posterior.learn(&Decision { features, probabilities, action }, reward);
    }
    Acting::new(posterior).unwrap()
}

#[test]
fn centred_effects_are_right_whatever_the_baseline_and_others_are_not() {
    let centred = LinearThompson {
        action_centring: true,
        pi_min: 0.05,
        prior_sd: 100.0,
        noise_sd: 3.0,
        ..LinearThompson::default()
    };
    let mut acting = confounded(&centred);
    let all = acting.factored()[0].mean().to_vec();
    let effects = &all[all.len() - 6..];
    for (ours, truth) in effects.iter().zip([1.0, 0.5, 2.0, -1.0, 0.0, 1.5]) {
        assert!((ours - truth).abs() < 0.15, "{effects:?}");
    }
    let separate = LinearThompson { action_centring: false, ..centred };
    let mut acting = confounded(&separate);
    let means: Vec<Vec<f64>> = acting.factored().iter().map(|one| one.mean().to_vec()).collect();
    let off = (means[1][0] - means[0][0] - 1.0).abs();
    assert!(off > 0.5, "without centring the effect of message 1 is off by {off} only");
}

#[test]
fn rounds_and_batches_are_declared_by_three_keys() {
    // Ten people in the trial, ten in round 1, then rounds of 20: rounds 1 to 3 start with the
    // trial.
    let parameters = LinearThompson {
        warm_up: 10,
        first_update: 50,
        update_interval: 20,
        ..LinearThompson::default()
    };
    let renewed = |parameters: &LinearThompson| -> Vec<u32> {
        (0..=140).filter(|finished| parameters.renews_after(*finished)).collect()
    };
    assert_eq!(renewed(&parameters), [10, 60, 80, 100, 120, 140]);
    let reset = LinearThompson { posterior: BanditPosterior::Reset, ..parameters.clone() };
    assert_eq!(renewed(&reset), [10]);
    let once = LinearThompson { update: BanditUpdate::Once, ..parameters.clone() };
    assert_eq!(renewed(&once), [10]);
    let every = LinearThompson { update_interval: 40, first_update: 0, warm_up: 0, ..parameters };
    assert_eq!(renewed(&every), [40, 80, 120]);
}

fn simulation(lanes: usize) -> PhysicalActivity {
    let scenario: Scenario = "C-H-D".parse().unwrap();
    PhysicalActivity::new(&StepCount::paper(0.4), &scenario, lanes)
}

#[test]
fn a_policy_of_stored_weights_acts_as_the_learner_does() {
    for (parameters, choice) in [
        (LinearThompson::default(), Actions::AsTrained),
        (LinearThompson::default(), Actions::Greedy),
        (
            LinearThompson {
                action_centring: true,
                pi_min: 0.05,
                draw: BanditDraw::Episode,
                posterior: BanditPosterior::Reset,
                warm_up: 3,
                ..LinearThompson::default()
            },
            Actions::AsTrained,
        ),
    ] {
        let mut learner = LinearThompsonLearner::new(&parameters, simulation(1), 3);
        learner.train(5).unwrap();
        let bytes = learner.weights().to_bytes();
        let weights = crate::agent::Weights::from_bytes(&bytes).unwrap();
        let interface = simulation(1).interface();
        let stored = trained_linear_thompson(&parameters, &interface, &weights, choice, 3).unwrap();
        let ours = decisions(&mut *learner.policy(choice));
        assert_eq!(ours, decisions_of(stored));
        let distinct: std::collections::HashSet<usize> = ours.iter().map(|one| one.0).collect();
        assert!(distinct.len() > 1, "{parameters:?}");
    }
}

fn decisions_of(mut policy: Box<dyn Actor<PhysicalActivity>>) -> Vec<(usize, u64)> {
    decisions(&mut *policy)
}

/// The actions of two episodes in three lanes, with the bits of their probabilities. The policy is
/// saved and restored mid-episode.
fn decisions(policy: &mut dyn Actor<PhysicalActivity>) -> Vec<(usize, u64)> {
    let mut environment = simulation(3);
    let mut streams = LaneStreams::Shared(Stream::new(1, Purpose::TestEnvironment));
    let mut choices = Stream::new(1, Purpose::TestActions);
    let (mut actions, mut probabilities) = ([Action::default(); 3], [[0.0; 4]; 3]);
    let mut rewards = [0.0; 3];
    let mut all = Vec::new();
    for _ in 0..2 {
        environment.reset(LaneSet::All, &mut streams);
        policy.reset(LaneSet::All);
        for step in 0..environment.parameters().horizon {
            policy.act(
                &environment,
                &mut choices,
                &mut actions,
                Some(probabilities.as_flattened_mut()),
            );
            environment.step(&actions, &mut rewards, &mut streams);
            policy.observe(&environment, Rewards::all(&rewards));
            let made = actions.iter().zip(&probabilities);
            all.extend(made.map(|(action, p)| (action.index(), p[action.index()].to_bits())));
            if step == 7 {
                let mut bytes = Vec::new();
                policy.save(&mut StateWriter::new(&mut bytes)).unwrap();
                policy.restore(&mut StateReader::new(&mut &bytes[..])).unwrap();
            }
        }
    }
    all
}

#[test]
fn a_frozen_posterior_stays_and_one_that_is_reset_learns_in_the_episode() {
    let stays = |posterior| {
        let parameters =
            LinearThompson { posterior, warm_up: 1, prior_sd: 100.0, ..LinearThompson::default() };
        let mut learner = LinearThompsonLearner::new(&parameters, simulation(1), 3);
        learner.train(2).unwrap();
        let mut policy = learner.policy(Actions::AsTrained);
        let mut environment = simulation(1);
        let mut streams = LaneStreams::Shared(Stream::new(1, Purpose::TestEnvironment));
        environment.reset(LaneSet::All, &mut streams);
        // State and random word stay the same, so only the learned reward can change the choice.
        let mut act = || {
            let (mut action, mut probability) = ([Action::default()], [[0.0; 4]]);
            let mut choices = Stream::new(1, Purpose::TestActions);
            policy.act(
                &environment,
                &mut choices,
                &mut action,
                Some(probability.as_flattened_mut()),
            );
            policy.observe(&environment, Rewards::all(&[-500.0]));
            (action[0], probability[0])
        };
        let first = act();
        (0..20).all(|_| act() == first)
    };
    assert!(stays(BanditPosterior::Carried));
    assert!(!stays(BanditPosterior::Reset));
}

#[test]
fn a_posterior_without_a_root_ends_the_training() {
    let parameters = LinearThompson { prior_sd: 1e6, noise_sd: 1e-6, ..LinearThompson::default() };
    let mut learner = LinearThompsonLearner::new(&parameters, simulation(1), 3);
    let refused = learner.train(50).unwrap_err();
    assert!(matches!(refused, LearnerError::Singular { steps: 1.. }), "{refused}");
}

#[test]
fn a_posterior_that_is_reset_keeps_its_last_root_in_the_test() {
    let parameters = LinearThompson {
        posterior: BanditPosterior::Reset,
        warm_up: 1,
        prior_sd: 1e6,
        noise_sd: 1e-6,
        ..LinearThompson::default()
    };
    // Training that continues fails within its first episodes.
    let mut learner = LinearThompsonLearner::new(&parameters, simulation(1), 3);
    assert!(matches!(learner.train(50), Err(LearnerError::Singular { .. })));
    let learner = LinearThompsonLearner::new(&parameters, simulation(1), 3);
    let mut policy = learner.policy(Actions::AsTrained);
    let mut environment = simulation(1);
    let mut streams = LaneStreams::Shared(Stream::new(1, Purpose::TestEnvironment));
    let mut choices = Stream::new(1, Purpose::TestActions);
    for episode in 0..20 {
        environment.reset(LaneSet::All, &mut streams);
        policy.reset(LaneSet::All);
        while environment.any_running() {
            let (mut action, mut probability) = ([Action::default()], [[0.0; 4]]);
            let mut reward = [0.0];
            policy.act(
                &environment,
                &mut choices,
                &mut action,
                Some(probability.as_flattened_mut()),
            );
            let taken = probability[0][action[0].index()];
            assert!(taken > 0.0 && taken <= 1.0, "episode {episode}");
            assert!((probability[0].iter().sum::<f64>() - 1.0).abs() < 1e-9, "episode {episode}");
            environment.step(&action, &mut reward, &mut streams);
            policy.observe(&environment, Rewards::all(&reward));
        }
    }
}
