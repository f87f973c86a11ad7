use statrs::distribution::{Continuous, Gamma, Normal};

use super::*;
use crate::env::step_count::parameters::StateNoise;
use crate::env::vector::{Action, EpisodeStatus};
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
    /// The last entry is whether the episode still runs.
    all: Vec<(f64, usize, f64, bool)>,
}

impl Sequences {
    /// Before the first step, whose feature gives context 0 this probability.
    fn new(e: &StepCount, scenario: &str, probability: f64) -> Sequences {
        let (q, d) = (e.context_probability, e.initial_disengagement);
        let all = match e.first_context {
            FirstContext::Fixed => vec![(1.0, 0, d, true)],
            FirstContext::Sampled => {
                let [zero, one] = feature(e, probability);
                vec![((1.0 - q) * zero, 0, d, true), (q * one, 1, d, true)]
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
        for (weight, context, risk, runs) in &self.all {
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
            let runs = *runs && (!self.knows_survival || risk < e.disengagement_threshold);
            for (then, seen) in seen.iter().enumerate() {
                let (r, q) = (e.context_persistence, e.context_probability);
                let anew = if then == 1 { q } else { 1.0 - q };
                let chain = r * f64::from(u8::from(then == *context)) + (1.0 - r) * anew;
                next.push((weight * likelihood * chain * seen, then, risk, runs));
            }
        }
        let sum: f64 = next.iter().map(|(weight, ..)| weight).sum();
        next.iter_mut().for_each(|(weight, ..)| *weight /= sum);
        self.all = next;
    }

    /// The mean of a function of the risk, given that the episode runs.
    fn mean(&self, function: impl Fn(f64) -> f64) -> f64 {
        let running = || self.all.iter().filter(|(.., runs)| *runs);
        let sum: f64 = running().map(|(weight, ..)| weight).sum();
        running().map(|(weight, _, risk, _)| weight * function(*risk)).sum::<f64>() / sum
    }

    /// The probability of context 0; mean and deviation of the risk; and the probability that it is near the threshold.
    fn numbers(&self) -> [f64; 4] {
        let zeros = self.all.iter().filter(|(_, context, ..)| *context == 0);
        let mean = self.mean(|risk| risk);
        let variance = self.mean(|risk| (risk - mean).powi(2));
        let near = |risk: f64| (risk + self.e.epsilon_d).min(1.0) >= self.e.disengagement_threshold;
        [
            zeros.map(|(weight, ..)| weight).sum(),
            mean,
            variance.sqrt(),
            self.mean(|risk| f64::from(u8::from(near(risk)))),
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

/// Environments, and scenarios in which beliefs are exact while there is room for all risks.
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

/// Eight of the twelve messages are tailored, so that no more than 256 risks are possible.
#[test]
fn beliefs_are_those_of_all_sequences_of_contexts() {
    let mut choices = Stream::new(1, Purpose::Exploration);
    for (e, scenario) in exact() {
        let e = StepCount { belief_particles: 256, ..e };
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
                chosen = if tailored > 8 { chosen % 2 } else { chosen };
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

/// Calls `visit` with lanes that run, after every step of whole episodes with [`mixed`] actions, and with whether a
/// wrong message would end the episode in the next step.
fn play(
    e: &StepCount,
    scenario: &str,
    count: usize,
    mut visit: impl FnMut(usize, &PhysicalActivity, bool),
) {
    let (mut lanes, mut streams) = begun(e, scenario, count);
    let mut choices = Stream::new(3, Purpose::Exploration);
    let mut rewards = vec![0.0; count];
    while lanes.any_running() {
        let zero = lanes.filters().unwrap().beliefs().zero;
        let actions: Vec<Action> = zero.iter().map(|zero| mixed(*zero, &mut choices)).collect();
        lanes.step(&actions, &mut rewards, &mut streams);
        let (mut ahead, mut ahead_streams) = (lanes.clone(), streams.clone());
        let wrong = |lane| Action::tailored_to(1 - lanes.context(lane).context);
        let wrong: Vec<Action> = (0..count).map(wrong).collect();
        ahead.step(&wrong, &mut rewards, &mut ahead_streams);
        for lane in (0..count).filter(|lane| lanes.statuses()[*lane] == EpisodeStatus::Running) {
            visit(lane, &lanes, ahead.statuses()[lane] == EpisodeStatus::Terminated);
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
        let measure = |bin: usize| {
            let sums = self.0.iter().map(|bins| bins[bin]);
            let deviation = sums.clone().map(|sum| sum * sum).sum::<f64>().sqrt();
            if deviation > 0.0 { (sums.sum::<f64>() / deviation).abs() } else { 0.0 }
        };
        (0..10).map(measure).fold(0.0, f64::max)
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

/// Asserts that probabilities of context 0 and, where risks are shown, of an end by a wrong message are right to `most`
/// standard deviations. Returns the residuals of the means and variances of habituation and risk, and the
/// number of steps.
fn assert_come_true(e: &StepCount, scenario: &str, episodes: usize, most: f64) -> (Residuals, u32) {
    let [mut zeros, mut nears, mut means] = [(); 3].map(|()| Residuals::new(episodes));
    let mut steps = 0;
    play(e, scenario, episodes, |lane, lanes, would_end| {
        let Beliefs { zero, near, habituation, risk } = lanes.filters().unwrap().beliefs();
        let truth = lanes.disengagement()[lane];
        let is_zero = lanes.context(lane).context == 0;
        let events = [(&mut zeros, zero[lane], is_zero), (&mut nears, near[lane], would_end)];
        for (residuals, probability, happens) in events {
            let bin = (probability * 10.0) as usize;
            residuals.add(lane, bin, f64::from(u8::from(happens)) - probability);
        }
        let pairs = [(habituation, lanes.habituation()[lane]), (risk, truth)];
        for (index, ([mean, deviation], truth)) in pairs.into_iter().enumerate() {
            means.add(lane, 2 * index, truth - mean[lane]);
            let square = (truth - mean[lane]).powi(2);
            means.add(lane, 2 * index + 1, square - deviation[lane].powi(2));
        }
        steps += 1;
    });
    let [zero, near] = [zeros, nears].map(|residuals| residuals.largest());
    // The filtered probability leaves out that these episodes run.
    let leaves_out = scenario == "F-E-R" && e.context_persistence > 0.0;
    assert!(zero < most || leaves_out, "{scenario} {e:?}: {zero}");
    assert!(near < most || !scenario.contains('R'), "{scenario} {e:?}: {near}");
    (means, steps)
}

#[test]
fn filtered_probabilities_come_true_as_often_as_they_say() {
    let mut all = 0;
    for (e, scenario, episodes) in calibrated() {
        let (means, steps) = assert_come_true(&e, scenario, episodes, 4.0);
        assert!(means.largest() < 4.0 || !scenario.contains('R'), "{scenario} {e:?}");
        all += steps;
    }
    assert!(all > 100_000, "{all}");
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

/// Differences between the beliefs of 256 particles and of a hundred times as many, over whole episodes: the root mean
/// square of each number. docs/beliefs.md has those of many settings.
#[test]
fn few_particles_are_close_to_a_hundred_times_as_many() {
    let quiet = StepCount { epsilon_d: 0.15, context_persistence: 0.7, ..StepCount::paper(1.5) };
    for (e, scenario) in noisy().into_iter().chain([(quiet, "F-E-R")]) {
        let e = StepCount { belief_particles: 256, ..e };
        let many = StepCount { belief_particles: 25_600, ..e.clone() };
        let [(mut few, mut streams), (mut many, mut others)] =
            [&e, &many].map(|e| begun(e, scenario, 6));
        let (mut squares, mut steps) = ([0.0; 6], 0.0);
        let mut choices = Stream::new(8, Purpose::Exploration);
        for _ in 0..20 {
            let zero = few.filters().unwrap().beliefs().zero;
            let actions: Vec<Action> = zero.iter().map(|p| mixed(*p, &mut choices)).collect();
            few.step(&actions, &mut [0.0; 6], &mut streams);
            many.step(&actions, &mut [0.0; 6], &mut others);
            assert_eq!(few.disengagement(), many.disengagement());
            for lane in 0..6 {
                let [ours, theirs] = [&few, &many].map(|lanes| {
                    let Beliefs { zero, habituation: [h, hs], risk: [d, ds], near } =
                        lanes.filters().unwrap().beliefs();
                    [zero, h, hs, d, ds, near].map(|of| of[lane])
                });
                if few.statuses()[lane] == EpisodeStatus::Running {
                    steps += 1.0;
                    for (i, square) in squares.iter_mut().enumerate() {
                        *square += (ours[i] - theirs[i]).powi(2);
                    }
                }
            }
        }
        let errors = squares.map(|square: f64| (square / steps).sqrt());
        println!("{scenario} {steps} {errors:.4?}");
        assert!(steps > 30.0, "{scenario}: {steps}");
        let most = if e.has_noise_of_state() {
            [0.02, 0.02, 0.02, 0.02, 0.02, 0.05]
        } else {
            [0.0, 0.0, 0.0, 0.001, 0.001, 0.005]
        };
        assert!(
            errors.iter().zip(most).all(|(error, most)| *error <= most),
            "{scenario} {e:?}: {errors:?}"
        );
    }
}

/// Noise that halves the chance of an end at a risk of 0.6: a wrong message leads to 1, and noise to less in half of
/// all steps.
#[test]
fn the_noise_of_the_state_decides_whether_a_wrong_message_ends_the_episode() {
    let noise =
        StepCount { state_noise: StateNoise::Uniform, state_spread: 0.3, ..StepCount::paper(0.6) };
    for (risk, least, most) in [(0.6, 0.4, 0.6), (0.1, 0.0, 0.0)] {
        let e = StepCount { initial_disengagement: risk, ..noise.clone() };
        let (lane, _) = begun(&e, "F-E-R", 1);
        let near = lane.filters().unwrap().beliefs().near[0];
        assert!((least..=most).contains(&near), "{risk}: {near}");
    }
    let quiet = StepCount { initial_disengagement: 0.6, ..StepCount::paper(0.6) };
    assert_eq!(begun(&quiet, "F-E-R", 1).0.filters().unwrap().beliefs().near[0], 1.0);
}

/// Where beliefs are particles, they are exact but for their number.
#[test]
fn particles_come_true_as_often_as_they_say() {
    for (e, scenario) in noisy() {
        let (means, _) = assert_come_true(&e, scenario, 400, 4.5);
        assert!(means.largest() < 4.5, "{scenario} {e:?}: {}", means.largest());
    }
}

/// A disengagement that no action can have brought about, as with few particles.
#[test]
fn evidence_with_which_nothing_agrees_leaves_the_action_and_the_feature() {
    let quiet = StepCount { context_persistence: 0.8, ..StepCount::paper(0.6) };
    let noisy = StepCount { state_noise: StateNoise::Uniform, ..quiet.clone() };
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
            filters.update(0, &e, &evidence);
            of_action.update(0, &e, &Evidence { disengaged: None, ..evidence });
            assert_eq!(numbers(&filters), numbers(&of_action), "{:?} {message}", e.state_noise);
        }
        let [zero, habituation, _, risk, ..] = numbers(&filters);
        assert!(zero > 0.5 && habituation > 0.09 && risk > 0.1, "{:?}", numbers(&filters));
    }
}

/// Two lanes with room for few particles or for all, and with evidence that no particle agrees with.
#[test]
fn every_instruction_set_has_the_same_bits() {
    let quiet = StepCount { epsilon_d: 0.15, context_persistence: 0.7, ..StepCount::paper(1.5) };
    let few = StepCount { belief_particles: 24, ..quiet.clone() };
    let mut draws = Stream::new(4, Purpose::Exploration);
    for (e, scenario) in noisy().into_iter().chain([(quiet, "F-E-R"), (few, "F-E-R")]) {
        let mut filters = Filters::new(&e, &letters(scenario).unwrap(), 2).unwrap();
        (0..2).for_each(|lane| filters.begin(lane, &e, 0.5));
        let mut all: Vec<Filters> = Isa::available().iter().map(|_| filters.clone()).collect();
        for _ in 0..24 {
            let evidence = [(); 2].map(|()| Evidence {
                action: Action::uniform(draws.bits(), 4),
                steps: filters.shows().steps.then(|| 20.0 + 100.0 * draws.unit()),
                disengaged: Some(draws.below(8) == 0),
                probability: draws.unit(),
            });
            let words = [draws.bits(), draws.bits()];
            let bits = Isa::available().into_iter().zip(&mut all).map(|(isa, filters)| {
                filters.words.words_mut().copy_from_slice(&words);
                let (person, evidence) = (|_| &e, |lane: usize| evidence[lane]);
                isa.run(Update { filters: &mut *filters, ran: &[true; 2], person, evidence });
                let Beliefs { zero, habituation: [h, hs], risk: [d, ds], near } = filters.beliefs();
                [zero, h, hs, d, ds, near].map(|of| [of[0].to_bits(), of[1].to_bits()])
            });
            let bits: Vec<_> = bits.collect();
            assert!(bits.iter().all(|of| *of == bits[0]), "{scenario} {e:?}: {bits:?}");
        }
    }
}
