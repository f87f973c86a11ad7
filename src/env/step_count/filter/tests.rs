use statrs::distribution::{Continuous, Gamma, Normal};

use super::*;
use crate::env::vector::EpisodeStatus;
use crate::env::{ContextDraw, PhysicalActivity, VectorEnvironment, step_count::scenario::letters};
use crate::kernel::Isa;
use crate::rng::{Purpose, Stream};

/// Lanes of a scenario with a stream each, at the first step.
fn begun(e: &StepCount, scenario: &str, lanes: usize) -> (PhysicalActivity, LaneStreams) {
    let mut lanes = PhysicalActivity::new(e, &letters(scenario).unwrap(), lanes);
    let streams = (0..lanes.lanes() as u32)
        .map(|lane| Stream::of_person(5, Purpose::TestEnvironment, lane))
        .collect();
    let mut streams = LaneStreams::PerLane(streams);
    lanes.reset(LaneSet::All, &mut streams);
    (lanes, streams)
}

fn action(index: usize) -> Action {
    Action::from_index(index).unwrap()
}

/// Every sequence of contexts that an episode can have had, with its weight, last context and disengagement risk.
struct Sequences {
    e: StepCount,
    knows_steps: bool,
    knows_survival: bool,
    habituation: f64,
    all: Vec<(f64, usize, f64)>,
}

impl Sequences {
    /// Before the first step, whose feature gives context 0 this probability.
    fn new(e: &StepCount, scenario: &str, probability: f64) -> Sequences {
        let (q, d) = (e.context_probability, e.initial_disengagement);
        let all = match e.first_context {
            FirstContext::Fixed => vec![(1.0, 0, d)],
            FirstContext::Sampled => {
                let [zero, one] = feature(e, probability);
                vec![((1.0 - q) * zero, 0, d), (q * one, 1, d)]
            }
        };
        Sequences {
            knows_steps: scenario.contains('S'),
            knows_survival: scenario.contains('R'),
            habituation: e.initial_habituation,
            e: e.clone(),
            all,
        }
    }

    /// After a step with this action and these steps, whose next feature gives context 0 this probability.
    fn step(&mut self, action: usize, steps: f64, probability: f64) {
        let e = &self.e;
        let sends = action > 0;
        self.habituation = match sends {
            true => (self.habituation + e.epsilon_h).min(1.0),
            false => (1.0 - e.delta_h) * self.habituation,
        };
        let seen = feature(e, probability);
        let mut next = Vec::new();
        for (weight, context, risk) in &self.all {
            let is_wrong = action >= 2 && action - 2 != *context;
            let effect = match action {
                0 => 0.0,
                1 => e.rho_1,
                _ if is_wrong => e.rho_3,
                _ => e.rho_2,
            };
            let expected = e.mu[*context] + (1.0 - self.habituation) * effect;
            let likelihood = match e.step_noise {
                _ if !self.knows_steps => 1.0,
                StepNoise::None => f64::from(u8::from((expected - steps).abs() < 1e-9)),
                StepNoise::Gamma => {
                    let shape = (expected / e.sigma_s).powi(2);
                    Gamma::new(shape, expected / e.sigma_s.powi(2)).unwrap().pdf(steps)
                }
            };
            let risk = match (sends, is_wrong) {
                (false, _) => *risk,
                (true, false) => (1.0 - e.delta_d) * risk,
                (true, true) => (risk + e.epsilon_d).min(1.0),
            };
            if self.knows_survival && risk >= e.disengagement_threshold {
                continue;
            }
            for (then, seen) in seen.iter().enumerate() {
                let (r, q) = (e.context_persistence, e.context_probability);
                let anew = if then == 1 { q } else { 1.0 - q };
                let chain = r * f64::from(u8::from(then == *context)) + (1.0 - r) * anew;
                next.push((weight * likelihood * chain * seen, then, risk));
            }
        }
        let sum: f64 = next.iter().map(|(weight, ..)| weight).sum();
        next.iter_mut().for_each(|(weight, ..)| *weight /= sum);
        self.all = next;
    }

    fn mean(&self, of: impl Fn(usize, f64) -> f64) -> f64 {
        let sum: f64 = self.all.iter().map(|(weight, ..)| weight).sum();
        self.all.iter().map(|(weight, context, risk)| weight * of(*context, *risk)).sum::<f64>()
            / sum
    }

    /// The probability of context 0; mean and deviation of the risk; and the probability that it is near the threshold.
    fn numbers(&self) -> [f64; 4] {
        let mean = self.mean(|_, risk| risk);
        let variance = self.mean(|_, risk| (risk - mean).powi(2));
        let near = |risk: f64| (risk + self.e.epsilon_d).min(1.0) >= self.e.disengagement_threshold;
        [
            self.mean(|context, _| f64::from(u8::from(context == 0))),
            mean,
            variance.sqrt(),
            self.mean(|_, risk| f64::from(u8::from(near(risk)))),
        ]
    }
}

/// The densities, in both contexts, of the feature from which context 0 is inferred with this probability.
fn feature(e: &StepCount, probability: f64) -> [f64; 2] {
    if e.sigma == 0.0 {
        return [probability, 1.0 - probability];
    }
    let odds = (1.0 - e.context_probability) / e.context_probability;
    let x = 0.5 + e.sigma * e.sigma * ((1.0 - probability) / probability * odds).ln();
    [0.0, 1.0].map(|mean| Normal::new(mean, e.sigma).unwrap().pdf(x))
}

/// Environments, and scenarios in which beliefs are exact.
fn exact() -> Vec<(StepCount, &'static str)> {
    let paper = StepCount::paper;
    let sampled = StepCount { first_context: FirstContext::Sampled, ..paper(0.6) };
    let persistent =
        StepCount { context_persistence: 0.7, context_probability: 0.3, ..sampled.clone() };
    let noisy_steps = StepCount {
        step_noise: StepNoise::Gamma,
        sigma_s: 30.0,
        rho_3: 90.0,
        mu: [30.0, 40.0],
        ..persistent.clone()
    };
    let other = StepCount {
        context_persistence: 0.4,
        delta_d: 0.3,
        epsilon_d: 0.25,
        disengagement_threshold: 0.7,
        mu: [3.0, 2.0],
        ..paper(1.0)
    };
    vec![
        (paper(0.6), "F-E-R"),
        (paper(0.0), "F-E-R"),
        (sampled.clone(), "F-E-R"),
        (sampled, "F-E-R-S"),
        (persistent.clone(), "F"),
        (persistent.clone(), "F-E-S"),
        (persistent.clone(), "F-E-R"),
        (persistent, "R-F-E-M-S"),
        (noisy_steps.clone(), "F-E-S"),
        (noisy_steps, "F-E-R-S"),
        (other.clone(), "F-E-R"),
        (other, "F-E-R-S"),
    ]
}

/// Six of the twelve messages are tailored, so that no more than 64 risks are possible.
#[test]
fn beliefs_are_those_of_all_sequences_of_contexts() {
    let mut choices = Stream::new(1, Purpose::Exploration);
    for (e, scenario) in exact() {
        let mut steps = 0;
        for episode in 0..12 {
            let (mut lane, mut streams) = begun(&e, scenario, 1);
            (0..episode).for_each(|_| lane.reset(LaneSet::All, &mut streams));
            let probability = lane.context(0).probability_of_zero;
            let mut sequences = Sequences::new(&e, scenario, probability);
            let mut tailored = 0;
            for _ in 0..12 {
                let mut chosen = choices.below(4) as usize;
                tailored += usize::from(chosen > 1);
                chosen = if tailored > 6 { chosen % 2 } else { chosen };
                lane.step(&[action(chosen)], &mut [0.0], &mut streams);
                if lane.statuses()[0] != EpisodeStatus::Running {
                    break;
                }
                let probability = lane.context(0).probability_of_zero;
                let walked = lane.previous_steps()[0];
                sequences.step(chosen, walked, probability);
                let beliefs = lane.filters().unwrap().beliefs();
                let ours =
                    [beliefs.zero[0], beliefs.risk[0][0], beliefs.risk[1][0], beliefs.near[0]];
                let shown = if scenario.contains('R') { 4 } else { 1 };
                for (ours, all) in ours.into_iter().zip(sequences.numbers()).take(shown) {
                    assert!((ours - all).abs() < 1e-7, "{scenario} {e:?}: {ours} {all}");
                }
                assert!((beliefs.habituation[0][0] - sequences.habituation).abs() < 1e-12);
                assert_eq!(beliefs.habituation[1][0], 0.0);
                steps += 1;
            }
        }
        assert!(steps > 60, "{scenario}: {steps}");
    }
}

/// An action that tailors to the likelier context, or one of the four at random every other time.
fn mixed(zero: f64, choices: &mut Stream) -> Action {
    let random = Action::uniform(choices.bits(), 4);
    let tailored = Action::tailored_to(u8::from(zero < 0.5));
    if choices.below(2) == 0 { random } else { tailored }
}

/// Calls `visit` with lanes that run, after every step of whole episodes with [`mixed`] actions.
fn play(
    e: &StepCount,
    scenario: &str,
    count: usize,
    mut visit: impl FnMut(usize, &PhysicalActivity, &Filters),
) {
    let (mut lanes, mut streams) = begun(e, scenario, count);
    let mut choices = Stream::new(3, Purpose::Exploration);
    let mut rewards = vec![0.0; count];
    while lanes.any_running() {
        let zero = lanes.filters().unwrap().beliefs().zero;
        let actions: Vec<Action> = zero.iter().map(|zero| mixed(*zero, &mut choices)).collect();
        lanes.step(&actions, &mut rewards, &mut streams);
        for lane in (0..count).filter(|lane| lanes.statuses()[*lane] == EpisodeStatus::Running) {
            visit(lane, &lanes, lanes.filters().unwrap());
        }
    }
}

/// Residuals whose mean is 0, summed by episode and by bin.
struct Residuals(Vec<[f64; 10]>);

impl Residuals {
    fn new(episodes: usize) -> Self {
        Residuals(vec![[0.0; 10]; episodes])
    }

    fn add(&mut self, episode: usize, bin: usize, residual: f64) {
        self.0[episode][bin.min(9)] += residual;
    }

    /// The largest sum of a bin in units of its standard deviation, where episodes are independent.
    fn largest(&self) -> f64 {
        let of = |bin: usize| {
            let sums = self.0.iter().map(|bins| bins[bin]);
            let deviation = sums.clone().map(|sum| sum * sum).sum::<f64>().sqrt();
            if deviation > 0.0 { (sums.sum::<f64>() / deviation).abs() } else { 0.0 }
        };
        (0..10).map(of).fold(0.0, f64::max)
    }
}

/// Environments with every kind of filter without noise, and numbers of episodes that make 10^5 steps together.
fn calibrated() -> Vec<(StepCount, &'static str, usize)> {
    let sampled = StepCount { first_context: FirstContext::Sampled, ..StepCount::paper(0.6) };
    let persistent =
        StepCount { context_persistence: 0.8, context_probability: 0.4, ..sampled.clone() };
    vec![
        (sampled.clone(), "F-E-R", 1600),
        (persistent.clone(), "F-E-R", 1600),
        (persistent.clone(), "F-E-R-S", 1600),
        (persistent, "F-S", 1600),
        (StepCount { sigma: 1.0, ..sampled }, "F-E-R", 1600),
    ]
}

/// Asserts that probabilities of context 0 and, where risks are shown, of a risk near the threshold are right to
/// `most` standard deviations. Returns the residuals of the means and variances of habituation and risk, and the
/// number of steps.
fn assert_come_true(e: &StepCount, scenario: &str, episodes: usize, most: f64) -> (Residuals, u32) {
    let [mut zeros, mut nears, mut means] = [(); 3].map(|()| Residuals::new(episodes));
    let mut steps = 0;
    play(e, scenario, episodes, |lane, lanes, filters| {
        let Beliefs { zero, near, habituation, risk } = filters.beliefs();
        let truth = lanes.disengagement()[lane];
        let is_zero = lanes.context(lane).context == 0;
        let is_near = is_near(&Dynamics::of(e), truth);
        let events = [(&mut zeros, zero[lane], is_zero), (&mut nears, near[lane], is_near)];
        for (residuals, probability, happens) in events {
            let bin = (probability * 10.0) as usize;
            residuals.add(lane, bin, f64::from(u8::from(happens)) - probability);
        }
        let pairs = [(habituation, lanes.habituation()[lane]), (risk, truth)];
        for (place, ([mean, deviation], truth)) in pairs.into_iter().enumerate() {
            means.add(lane, 2 * place, truth - mean[lane]);
            let square = (truth - mean[lane]).powi(2);
            means.add(lane, 2 * place + 1, square - deviation[lane].powi(2));
        }
        steps += 1;
    });
    let [zero, near] = [zeros, nears].map(|residuals| residuals.largest());
    assert!(zero < most, "{scenario} {e:?}: {zero}");
    assert!(near < most || !scenario.contains('R'), "{scenario} {e:?}: {near}");
    (means, steps)
}

#[test]
fn filtered_probabilities_come_true_as_often_as_they_say() {
    let all = calibrated().into_iter();
    let steps: u32 =
        all.map(|(e, scenario, episodes)| assert_come_true(&e, scenario, episodes, 4.0).1).sum();
    assert!(steps > 100_000, "{steps}");
}

/// The share of a distribution below the cell of a value, with a random share of the cell, is uniform if the value has
/// this distribution.
#[test]
fn the_true_risk_is_a_draw_from_its_belief() {
    for (e, scenario, episodes) in calibrated() {
        if !scenario.contains('R') {
            continue;
        }
        let mut parts = Stream::new(4, Purpose::TestActions);
        let mut bins = Residuals::new(episodes);
        let mut means = Residuals::new(episodes);
        play(&e, scenario, episodes, |lane, lanes, filters| {
            let truth = lanes.disengagement()[lane];
            // Cells as wide as those of merged atoms.
            let cell =
                |risk: f64| ((risk - e.disengagement_threshold + e.epsilon_d) * 61.0).floor();
            let share = |of: &dyn Fn(f64) -> bool| {
                let atoms = filters.mixtures[lane].atoms();
                atoms.filter(|(risk, _)| of(cell(*risk))).map(|(_, weight)| weight).sum::<f64>()
            };
            let at = share(&|other| other == cell(truth));
            let below = share(&|other| other < cell(truth));
            let position = below + at * parts.unit();
            let place = ((position * 10.0) as usize).min(9);
            (0..10).for_each(|bin| {
                bins.add(lane, bin, f64::from(u8::from(bin == place)) - 0.1);
            });
            let [mean, deviation] = filters.beliefs().risk.map(|all| all[lane]);
            means.add(lane, 0, truth - mean);
            means.add(lane, 1, (truth - mean).powi(2) - deviation.powi(2));
        });
        assert!(bins.largest() < 4.0, "{scenario} {}: {}", e.sigma, bins.largest());
        assert!(means.largest() < 4.0, "{scenario} {}: {}", e.sigma, means.largest());
    }
}

/// Both lanes show the same at every step, while their contexts, and therefore their risks, differ.
#[test]
fn equal_observations_give_equal_beliefs_whatever_is_true() {
    for persistence in [0.0, 0.7] {
        let e = StepCount { context_persistence: persistence, ..StepCount::paper(0.6) };
        let (mut lanes, _) = begun(&e, "P-F-E-R-M", 2);
        let mut draws = Stream::new(6, Purpose::Exploration);
        let mut largest: f64 = 0.0;
        for episode in 0..40 {
            lanes.reset(
                LaneSet::All,
                &mut LaneStreams::Shared(Stream::new(episode, Purpose::Environment)),
            );
            while lanes.statuses() == [EpisodeStatus::Running; 2] {
                let mut seen = lanes.observation_spec().observations();
                lanes.observe(&mut seen);
                assert_eq!(seen.row(0), seen.row(1));
                let risks = lanes.disengagement();
                largest = largest.max((risks[0] - risks[1]).abs());
                let actions = [Action::uniform(draws.bits(), 4); 2];
                lanes.apply_actions(&actions, &mut [0.0; 2]);
                let probability = draws.unit();
                let context = draws.below(2) as u8;
                lanes.set_context(0, ContextDraw::new(context, probability));
                lanes.set_context(1, ContextDraw::new(1 - context, probability));
                lanes.update_beliefs(&actions);
            }
        }
        assert!(largest > 0.3, "{largest}");
    }
}

/// The setting with the most atoms: messages that are tailored at nearly every step, with much noise.
fn crowded() -> StepCount {
    StepCount {
        first_context: FirstContext::Sampled,
        context_persistence: 0.5,
        ..StepCount::paper(1.0)
    }
}

/// Calls `visit` with the feature and the evidence of each of `count` steps in [`crowded`] after which the episode runs,
/// and whether it has begun before the step, at a risk of 0.1.
fn crowded_steps(count: u32, mut visit: impl FnMut(bool, &Seen, &Evidence)) {
    let e = crowded();
    let dynamics = Dynamics::of(&e);
    let mut draws = Stream::new(7, Purpose::TestEnvironment);
    let mut steps = 0;
    while steps < count {
        let (mut context, mut risk) = (u8::from(draws.unit() < 0.5), 0.1);
        for step in 0..50 {
            let choice = if draws.below(8) == 0 { draws.below(2) } else { 2 + draws.below(2) };
            let action = action(choice as usize);
            risk = dynamics.apply(context, action, 0.0, risk).disengagement;
            if risk >= e.disengagement_threshold {
                break;
            }
            context = if draws.unit() < 0.5 { context } else { u8::from(draws.unit() < 0.5) };
            let mut stream = draws.clone();
            let deviate = crate::env::variates::deviate(
                crate::env::variates::squared_radius(stream.bits()),
                draws.bits(),
            );
            let probability = crate::env::probability_of_zero(context, deviate, e.sigma, 1.0);
            let evidence = Evidence { action, steps: None, disengaged: Some(false), probability };
            visit(step == 0, &Seen::new(&e, probability), &evidence);
            steps += 1;
        }
    }
}

/// An update of a mixture, for any instruction set.
struct MixtureStep<'a>(&'a mut Mixture, &'a Seen, &'a Evidence, &'a mut Successors);

impl WithSimd for MixtureStep<'_> {
    type Output = Moments;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Moments {
        let MixtureStep(mixture, seen, evidence, room) = self;
        let dynamics = Dynamics::of(&crowded());
        mixture.update(simd, &dynamics, seen, [1.0; 2], evidence, room).unwrap()
    }
}

/// The errors that merged atoms make, over 20,000 steps.
#[test]
fn merged_atoms_are_close_to_a_hundred_times_as_many() {
    let isa = Isa::chosen();
    let mut room = Successors::new(100 * ATOMS);
    let mut both = [ATOMS, 100 * ATOMS].map(Mixture::new);
    let (mut sums, mut most, mut steps, mut fullest) = ([0.0; 4], [0.0_f64; 4], 0, 0);
    crowded_steps(20_000, |begins, seen, evidence| {
        if begins {
            both.iter_mut().for_each(|mixture| mixture.begin(0.1, 0.5));
        }
        let [few, many] =
            both.each_mut().map(|mixture| isa.run(MixtureStep(mixture, seen, evidence, &mut room)));
        fullest = fullest.max(both[1].atoms().count());
        let pairs = [
            (few.zero, many.zero),
            (few.risk[0], many.risk[0]),
            (few.risk[1], many.risk[1]),
            (few.near, many.near),
        ];
        for (i, (few, many)) in pairs.into_iter().enumerate() {
            sums[i] += (few - many).abs();
            most[i] = most[i].max((few - many).abs());
        }
        steps += 1;
    });
    let means = sums.map(|sum| sum / f64::from(steps));
    println!("{steps} {fullest} {means:?} {most:?}");
    assert!(steps >= 20_000 && fullest > 10 * ATOMS);
    // docs/beliefs.md has the numbers.
    assert!(means.iter().all(|error| *error < 1e-4), "{means:?}");
    assert!(most.iter().all(|error| *error < 0.06), "{most:?}");
}

/// Also of widths that this processor has not.
#[test]
fn mixtures_have_the_same_bits_at_every_width_of_registers() {
    let mut room = Successors::new(ATOMS);
    let mut all = [ATOMS; 4].map(Mixture::new);
    let mut fullest = 0;
    crowded_steps(5_000, |begins, seen, evidence| {
        let moments: Vec<Moments> = all
            .iter_mut()
            .zip([1, 2, 4, 8])
            .map(|(mixture, width)| {
                if begins {
                    mixture.begin(0.1, 0.5);
                }
                let step = MixtureStep(mixture, seen, evidence, &mut room);
                match width {
                    1 => pulp::Scalar.vectorize(step),
                    2 => pulp::Scalar128b.vectorize(step),
                    4 => pulp::Scalar256b.vectorize(step),
                    _ => pulp::Scalar512b.vectorize(step),
                }
            })
            .collect();
        assert!(moments.iter().all(|other| *other == moments[0]), "{moments:?}");
        fullest = fullest.max(all[0].atoms().count());
    });
    assert!(fullest > ATOMS / 2);
}

/// Environments whose beliefs are particles.
fn noisy() -> Vec<(StepCount, &'static str)> {
    let sampled = StepCount { first_context: FirstContext::Sampled, ..StepCount::paper(0.6) };
    let uniform =
        StepCount { state_noise: StateNoise::Uniform, state_spread: 0.2, ..sampled.clone() };
    let beta = StepCount {
        state_noise: StateNoise::Beta,
        kappa_h: 20.0,
        kappa_d: 20.0,
        context_persistence: 0.6,
        ..sampled
    };
    let gamma = StepCount { step_noise: StepNoise::Gamma, sigma_s: 20.0, ..beta.clone() };
    let spread = StepCount { parameter_spread: 0.5, ..uniform.clone() };
    vec![(uniform, "F-E-R"), (beta, "F-E-R"), (gamma, "F-E-R-S"), (spread, "F-E-R")]
}

#[test]
fn particles_are_close_to_a_hundred_times_as_many() {
    for (e, scenario) in noisy() {
        let mut many = Particles::new(100 * PARTICLES);
        let mut draws = Draws::new(&e, 100 * PARTICLES);
        let mut choices = Stream::new(8, Purpose::Exploration);
        let (mut squares, mut steps) = ([0.0; 6], 0);
        for episode in 0..6 {
            let (mut lane, mut streams) = begun(&e, scenario, 1);
            (0..episode).for_each(|_| lane.reset(LaneSet::All, &mut streams));
            many.begin(0.1, 0.1, lane.context(0).probability_of_zero);
            for _ in 0..20 {
                let zero = lane.filters().unwrap().beliefs().zero[0];
                let action = mixed(zero, &mut choices);
                lane.step(&[action], &mut [0.0], &mut streams);
                if lane.statuses()[0] != EpisodeStatus::Running {
                    break;
                }
                let probability = lane.context(0).probability_of_zero;
                let walked = scenario.contains('S').then(|| lane.previous_steps()[0]);
                let evidence =
                    Evidence { action, steps: walked, disengaged: Some(false), probability };
                draws.expand(choices.bits());
                let seen = Seen::new(&e, probability);
                let Some(theirs) = many.update(&e, &seen, &evidence, &mut draws) else { break };
                let ours = lane.filters().unwrap().beliefs();
                let pairs = [
                    (ours.zero[0], theirs.zero),
                    (ours.habituation[0][0], theirs.habituation[0]),
                    (ours.habituation[1][0], theirs.habituation[1]),
                    (ours.risk[0][0], theirs.risk[0]),
                    (ours.risk[1][0], theirs.risk[1]),
                    (ours.near[0], theirs.near),
                ];
                for (square, (ours, theirs)) in squares.iter_mut().zip(pairs) {
                    *square += (ours - theirs).powi(2);
                }
                steps += 1;
            }
        }
        let errors = squares.map(|square| (square / f64::from(steps)).sqrt());
        println!("{scenario} {steps} {errors:?}");
        assert!(steps > 30, "{scenario}: {steps}");
        assert!(errors.iter().all(|error| *error < 0.05), "{scenario} {e:?}: {errors:?}");
    }
}

/// Where beliefs are particles, they are exact but for their number.
#[test]
fn particles_come_true_as_often_as_they_say() {
    for (e, scenario) in noisy() {
        let (means, _) = assert_come_true(&e, scenario, 400, 4.5);
        assert!(means.largest() < 4.5, "{scenario} {e:?}: {}", means.largest());
    }
}

/// A disengagement that no action can have brought about, as after merging or with few particles.
#[test]
fn evidence_with_which_nothing_agrees_leaves_the_action_and_the_feature() {
    let quiet = StepCount { context_persistence: 0.8, ..StepCount::paper(0.6) };
    let noisy = StepCount { state_noise: StateNoise::Uniform, ..quiet.clone() };
    let simd = pulp::Scalar::new();
    for e in [quiet, noisy] {
        let scenario = letters("F-E-R").unwrap();
        let mut filters = Filters::new(&e, &scenario, 1).unwrap();
        filters.begin(0, &e, 1.0);
        filters.words.words_mut().fill(7);
        let mut of_action = filters.clone();
        let numbers = |filters: &Filters| {
            let Beliefs { zero, habituation, risk, near } = filters.beliefs();
            [zero, habituation[0], habituation[1], risk[0], risk[1], near].map(|of| of[0])
        };
        for (message, probability) in [(2, 0.3), (3, 0.9)] {
            let disengaged = Some(true);
            let evidence =
                Evidence { action: action(message), steps: None, disengaged, probability };
            filters.update(simd, 0, &e, &evidence);
            of_action.update(simd, 0, &e, &Evidence { disengaged: None, ..evidence });
            assert_eq!(numbers(&filters), numbers(&of_action), "{:?} {message}", e.state_noise);
        }
        let [zero, habituation, _, risk, ..] = numbers(&filters);
        assert!(zero > 0.5 && habituation > 0.09 && risk > 0.1, "{:?}", numbers(&filters));
    }
}
