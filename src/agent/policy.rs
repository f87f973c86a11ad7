//! Policies made from networks: the mapping from observations to actions.

use pulp::{Simd, WithSimd};

use crate::agent::Actions;
use crate::agent::actor::Actor;
use crate::env::{Action, LaneSet, Observations, VectorEnvironment};
use crate::kernel::{Isa, LINE, math};
use crate::rng::{Stream, unit_from_bits};
use crate::state::resumable;

/// A network with one output per action: its value or its logit.
pub trait ActionNetwork {
    /// Replaces `out` by the outputs for every observation, \[rows, actions\], row by row.
    fn evaluate(&mut self, observations: &Observations, out: &mut Vec<f32>);

    /// Size of the network's memory of an episode, in numbers; 0 by default.
    fn memory(&self) -> usize {
        0
    }

    /// Evaluates the next observations of episodes like [`ActionNetwork::evaluate`] and updates the
    /// memory of the episodes, \[rows, memory\], in place. The memory is zero at the first
    /// observation of an episode.
    fn recall(&mut self, observations: &Observations, memory: &mut [f32], out: &mut Vec<f32>) {
        debug_assert!(memory.is_empty());
        self.evaluate(observations, out);
    }
}

impl<N: ActionNetwork + ?Sized> ActionNetwork for Box<N> {
    fn evaluate(&mut self, observations: &Observations, out: &mut Vec<f32>) {
        (**self).evaluate(observations, out);
    }

    fn memory(&self) -> usize {
        (**self).memory()
    }

    fn recall(&mut self, observations: &Observations, memory: &mut [f32], out: &mut Vec<f32>) {
        (**self).recall(observations, memory, out);
    }
}

/// The outputs of a network's heads, and the choice of actions from them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Choice {
    /// The heads `value`, V, and `advantage`, A, give values V + A - mean A. The action with the
    /// highest value is taken; ties go to the lowest number. With this probability, a random action
    /// is taken instead.
    EpsilonGreedy {
        /// The exploration rate.
        epsilon: f64,
    },
    /// The head `logits` gives logits, and actions are drawn by their softmax.
    Softmax,
}

impl Choice {
    /// The probabilities of the actions, given outputs of the network.
    ///
    /// **Shapes**: `numbers` and the result are \[rows, actions\].
    pub fn probabilities(self, numbers: &[f32], actions: usize) -> Vec<f64> {
        let mut probabilities = vec![0.0; numbers.len()];
        match self {
            Choice::EpsilonGreedy { epsilon } => {
                let rows =
                    probabilities.chunks_exact_mut(actions).zip(numbers.chunks_exact(actions));
                rows.for_each(|(row, values)| {
                    epsilon_greedy_probabilities(epsilon, best(values), row)
                });
            }
            Choice::Softmax => {
                let mut preferences = numbers.to_vec();
                exponentials(Isa::chosen(), &mut preferences, actions);
                sampling_probabilities(&preferences, actions, &mut probabilities);
            }
        }
        probabilities
    }
}

impl Choice {
    /// Chooses an action for every row of outputs, as [`NetworkActor`] does. Samples replace the outputs by the
    /// preferences that they were drawn from.
    pub fn choose(self, outputs: &mut [f32], actions: &mut [Action], stream: &mut Stream) {
        match self {
            Choice::EpsilonGreedy { epsilon } => {
                let count = outputs.len() / actions.len().max(1);
                for (action, values) in actions.iter_mut().zip(outputs.chunks_exact(count.max(1))) {
                    *action = explore(epsilon, count, stream).unwrap_or_else(|| best(values));
                }
            }
            Choice::Softmax => sample(Isa::chosen(), outputs, actions, &mut Vec::new(), stream),
        }
    }
}

/// Acts by the outputs of a network.
pub struct NetworkActor<N> {
    network: N,
    choice: Choice,
    observations: Observations,
    /// Memory of the episodes, \[lanes, memory\].
    memory: Vec<f32>,
    outputs: Vec<f32>,
    explored: Vec<Option<Action>>,
    halves: Vec<u32>,
}

impl<N: ActionNetwork> NetworkActor<N> {
    /// An actor that chooses as in training, or takes the action with the highest output.
    /// `observations` must have the shape for which the network was made.
    pub fn new(network: N, choice: Choice, actions: Actions, observations: Observations) -> Self {
        let choice = match actions {
            Actions::AsTrained => choice,
            Actions::Greedy => Choice::EpsilonGreedy { epsilon: 0.0 },
        };
        let (memory, outputs, explored, halves) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        NetworkActor { network, choice, observations, memory, outputs, explored, halves }
    }

    /// Chooses among `count` actions at a rate of exploration, given the outputs.
    fn explore(
        &mut self,
        (epsilon, count): (f64, usize),
        stream: &mut Stream,
        actions: &mut [Action],
        probabilities: Option<&mut [f64]>,
    ) {
        self.explored.clear();
        self.explored.extend(actions.iter().map(|_| explore(epsilon, count, stream)));
        let rows = || self.outputs.chunks_exact(count);
        for ((action, explored), values) in actions.iter_mut().zip(&self.explored).zip(rows()) {
            *action = explored.unwrap_or_else(|| best(values));
        }
        if let Some(probabilities) = probabilities {
            for (probabilities, values) in probabilities.chunks_exact_mut(count).zip(rows()) {
                epsilon_greedy_probabilities(epsilon, best(values), probabilities);
            }
        }
    }
}

impl<N: ActionNetwork + Send, Env: VectorEnvironment> Actor<Env> for NetworkActor<N> {
    fn reset(&mut self, lanes: LaneSet<'_>) {
        forget(&mut self.memory, self.network.memory(), lanes);
    }

    fn act(
        &mut self,
        environment: &Env,
        stream: &mut Stream,
        actions: &mut [Action],
        probabilities: Option<&mut [f64]>,
    ) {
        let count = environment.action_spec().count;
        environment.observe(&mut self.observations);
        self.memory.resize(actions.len() * self.network.memory(), 0.0);
        self.network.recall(&self.observations, &mut self.memory, &mut self.outputs);
        match self.choice {
            Choice::EpsilonGreedy { epsilon } => {
                self.explore((epsilon, count), stream, actions, probabilities);
            }
            Choice::Softmax => {
                sample(Isa::chosen(), &mut self.outputs, actions, &mut self.halves, stream);
                if let Some(probabilities) = probabilities {
                    // [`sample`] has replaced the logits by the preferences that it sampled from.
                    sampling_probabilities(&self.outputs, count, probabilities);
                }
            }
        }
    }
}

// The learner saves the weights.
resumable!([N: ActionNetwork] NetworkActor<N> { grown memory; check fits, "memory" });

impl<N: ActionNetwork> NetworkActor<N> {
    /// Whether the memory is of whole episodes.
    fn fits(&self) -> bool {
        self.memory.len().is_multiple_of(self.network.memory())
    }
}

/// A random action of `count` with probability `epsilon`, otherwise `None`. One word decides both.
///
/// If `count` is a power of two, its lowest bits, which `epsilon` does not read, are the action. Otherwise the word,
/// which is uniform below the bound that `epsilon` sets, is scaled to the actions: their probabilities differ by at
/// most 2^-64 / `epsilon`.
pub(super) fn explore(epsilon: f64, count: usize, stream: &mut Stream) -> Option<Action> {
    if epsilon == 0.0 {
        return None;
    }
    let word = stream.bits();
    let explores = unit_from_bits(word) < epsilon;
    explores.then(|| {
        if count.is_power_of_two() {
            return Action::uniform(word, count);
        }
        // `unit_from_bits` reads the upper 53 bits, so the word explores below this bound.
        let bound = u128::from((epsilon * (1u64 << 53) as f64).ceil() as u64) << 11;
        let index = u128::from(word) * count as u128 / bound;
        Action::from_index(index as usize).expect("an environment has at most 256 actions")
    })
}

/// Writes the probabilities of the actions at exploration rate `epsilon`.
pub(super) fn epsilon_greedy_probabilities(epsilon: f64, best: Action, probabilities: &mut [f64]) {
    let any = epsilon / probabilities.len() as f64;
    probabilities.fill(any);
    probabilities[best.index()] = 1.0 - epsilon + any;
}

/// Resets the memory of lanes that begin an episode, `width` numbers per lane.
pub(super) fn forget(memory: &mut Vec<f32>, width: usize, lanes: LaneSet<'_>) {
    match lanes {
        LaneSet::All => memory.clear(),
        LaneSet::Masked(mask) => {
            memory.resize(mask.len() * width, 0.0);
            let each = memory.chunks_exact_mut(width.max(1)).zip(mask);
            each.filter(|(_, begins)| **begins).for_each(|(memory, _)| memory.fill(0.0));
        }
    }
}

/// The action with the highest value; ties go to the lowest number.
pub(super) fn best(values: &[f32]) -> Action {
    let mut best = 0;
    for (index, value) in values.iter().enumerate() {
        if *value > values[best] {
            best = index;
        }
    }
    Action::from_index(best).expect("one value an action")
}

/// Samples an action for every row of logits by their softmax. The logits are replaced in place by
/// their exponentials relative to the highest logit of the row. Takes half a word of the stream per
/// row; `halves` is a buffer.
pub(super) fn sample(
    isa: Isa,
    logits: &mut [f32],
    actions: &mut [Action],
    halves: &mut Vec<u32>,
    stream: &mut Stream,
) {
    if actions.is_empty() {
        return;
    }
    halves.resize(actions.len(), 0);
    stream.fill_halves(halves);
    exponentials(isa, logits, logits.len() / actions.len());
    isa.run(Pick { weights: logits, halves, actions });
}

/// Writes the probabilities from which [`sample`] chose among `count` actions, given the exponentials
/// that it wrote.
///
/// **Shapes**: `preferences` and `probabilities` are \[rows, actions\].
pub(super) fn sampling_probabilities(preferences: &[f32], count: usize, probabilities: &mut [f64]) {
    let rows = probabilities.chunks_exact_mut(count).zip(preferences.chunks_exact(count));
    for (probabilities, row) in rows {
        let total: f64 = row.iter().copied().map(f64::from).sum();
        let each = probabilities.iter_mut().zip(row);
        each.for_each(|(probability, preference)| *probability = f64::from(*preference) / total);
    }
}

/// Replaces every logit in place by exp(logit - highest of its row); rows have `count` logits.
pub(super) fn exponentials(isa: Isa, logits: &mut [f32], count: usize) {
    isa.run(Exponentials { logits, count });
}

/// Number of `f32`s in the widest register.
const REGISTER: usize = LINE / size_of::<f32>();

/// Logits, \[rows, count\].
struct Exponentials<'a> {
    logits: &'a mut [f32],
    count: usize,
}

impl WithSimd for Exponentials<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Exponentials { logits, count } = self;
        if count == 4 {
            logits.as_chunks_mut().0.iter_mut().for_each(relative_of_four);
        } else {
            logits.chunks_exact_mut(count).for_each(relative);
        }
        if logits.len() < REGISTER {
            // Pads to a full register; the loop would process a partial register one number at a
            // time.
            let mut register = [0.0; REGISTER];
            register[..logits.len()].copy_from_slice(logits);
            exponential_each(&mut register);
            logits.copy_from_slice(&register[..logits.len()]);
        } else {
            exponential_each(logits);
        }
    }
}

#[inline(always)]
fn exponential_each(numbers: &mut [f32]) {
    numbers.iter_mut().for_each(|x| *x = math::exp_f32(*x));
}

/// The second half of [`sample`]: `weights` is \[rows, actions\], the other arrays are \[rows\].
struct Pick<'a> {
    weights: &'a [f32],
    halves: &'a [u32],
    actions: &'a mut [Action],
}

impl WithSimd for Pick<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Pick { weights, halves, actions } = self;
        let count = weights.len() / actions.len();
        // The number is in [0, 1), a multiple of 2^-32.
        let units = halves.iter().map(|half| f64::from(*half) * (1.0 / 4_294_967_296.0));
        let given = actions.iter_mut().zip(units);
        if count == 4 {
            // Rows of a known width keep their weights in registers.
            let rows = weights.as_chunks::<4>().0.iter();
            given.zip(rows).for_each(|((action, unit), row)| *action = pick(row, unit));
        } else {
            let rows = weights.chunks_exact(count);
            given.zip(rows).for_each(|((action, unit), row)| *action = pick(row, unit));
        }
    }
}

/// Subtracts the highest logit from all logits.
#[inline(always)]
fn relative(logits: &mut [f32]) {
    let highest = logits.iter().copied().reduce(|a, b| if b > a { b } else { a });
    logits.iter_mut().for_each(|logit| *logit -= highest.unwrap_or(0.0));
}

/// [`relative`] by pairs.
#[inline(always)]
fn relative_of_four(logits: &mut [f32; 4]) {
    let [a, b, c, d] = *logits;
    let (a, c) = (if b > a { b } else { a }, if d > c { d } else { c });
    let highest = if c > a { c } else { a };
    logits.iter_mut().for_each(|logit| *logit -= highest);
}

/// The action at which the cumulative weights exceed `unit`, in [0, 1), times their sum.
#[inline(always)]
fn pick(weights: &[f32], unit: f64) -> Action {
    let threshold = unit * weights.iter().copied().map(f64::from).sum::<f64>();
    let mut sum = 0.0;
    // Branch-free, because a branch on a random number is unpredictable.
    let passed = weights[..weights.len() - 1].iter().map(|weight| {
        sum += f64::from(*weight);
        u8::from(sum <= threshold)
    });
    Action::from_index(passed.map(usize::from).sum()).expect("one weight per action")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::{LaneStreams, PhysicalActivity, StepCount};
    use crate::rng::Purpose;

    /// A network with the same outputs for every observation.
    struct Same([f32; 4]);

    impl ActionNetwork for Same {
        fn evaluate(&mut self, observations: &Observations, out: &mut Vec<f32>) {
            *out = self.0.repeat(observations.rows());
        }
    }

    /// Actions in 4000 lanes with their probabilities. Asserts that the actions are the same if no
    /// probabilities are requested.
    fn acted(actor: &mut dyn Actor<PhysicalActivity>) -> Vec<(usize, [f64; 4])> {
        let mut lanes = PhysicalActivity::new(&StepCount::paper(0.6), &"P".parse().unwrap(), 4000);
        let stream = |purpose| Stream::new(6, purpose);
        lanes.reset(LaneSet::All, &mut LaneStreams::Shared(stream(Purpose::Environment)));
        let (mut actions, mut again) = ([Action::NONE; 4000], [Action::UNTAILORED; 4000]);
        let mut probabilities = [[f64::NAN; 4]; 4000];
        let mut choices = stream(Purpose::Exploration);
        actor.act(&lanes, &mut choices.clone(), &mut again, None);
        actor.act(&lanes, &mut choices, &mut actions, Some(probabilities.as_flattened_mut()));
        assert_eq!(actions, again);
        actions.iter().map(|action| action.index()).zip(probabilities).collect()
    }

    fn assert_probabilities(actor: &mut dyn Actor<PhysicalActivity>, expected: [f64; 4]) {
        let acted = acted(actor);
        for (index, expected) in expected.into_iter().enumerate() {
            assert!(acted.iter().all(|(_, p)| (p[index] - expected).abs() < 1e-6), "{index}");
            let of = acted.iter().filter(|(action, _)| *action == index);
            // Four standard deviations of a binomial count of 4000.
            let deviation = (4000.0 * expected * (1.0 - expected)).sqrt();
            let off = (of.count() as f64 - 4000.0 * expected).abs();
            assert!(off <= 4.0 * deviation, "{index}: off by {off}");
        }
    }

    #[test]
    fn actors_give_the_probabilities_with_which_they_choose() {
        let observations = || Observations::new(1, 0);
        let logits = || Same([1.0f32, 2.0, 3.0, 4.0].map(f32::ln));
        let values = || Same([0.0, 5.0, 1.0, 2.0]);
        let exploring = Choice::EpsilonGreedy { epsilon: 0.2 };
        for (network, choice, actions, expected) in [
            (logits(), Choice::Softmax, Actions::AsTrained, [0.1, 0.2, 0.3, 0.4]),
            (logits(), Choice::Softmax, Actions::Greedy, [0.0, 0.0, 0.0, 1.0]),
            (values(), exploring, Actions::AsTrained, [0.05, 0.85, 0.05, 0.05]),
            (values(), exploring, Actions::Greedy, [0.0, 1.0, 0.0, 0.0]),
        ] {
            let mut actor = NetworkActor::new(network, choice, actions, observations());
            assert_probabilities(&mut actor, expected);
        }
    }

    #[test]
    fn probabilities_are_those_by_hand() {
        let greedy = Choice::EpsilonGreedy { epsilon: 0.2 };
        let drawn = greedy.probabilities(&[1.0, 3.0, 3.0, 0.0], 4);
        let expected = [0.05, 0.85, 0.05, 0.05];
        assert!(drawn.iter().zip(expected).all(|(p, e)| (p - e).abs() < 1e-12), "{drawn:?}");
        let logits = [1.0f32, 2.0, 3.0, 4.0].map(f32::ln);
        let drawn = Choice::Softmax.probabilities(&logits, 4);
        let expected = [0.1, 0.2, 0.3, 0.4];
        assert!(drawn.iter().zip(expected).all(|(p, e)| (p - e).abs() < 1e-6), "{drawn:?}");
    }

    #[test]
    fn softmax_samples_have_the_probabilities_by_hand() {
        // Logits ln 1, ln 2, ln 3, ln 4: probabilities 0.1, 0.2, 0.3, 0.4.
        let mut weights: Vec<f32> = [1.0f32, 2.0, 3.0, 4.0].iter().map(|v| v.ln() + 50.0).collect();
        exponentials(Isa::chosen(), &mut weights, 4);
        for (unit, index) in [(0.0, 0), (0.099, 0), (0.101, 1), (0.31, 2), (0.59, 2), (0.61, 3)] {
            assert_eq!(pick(&weights, unit).index(), index, "{unit}");
        }
        let mut certain = [-1e30, 0.0, -1e30, -1e30];
        exponentials(Isa::chosen(), &mut certain, 4);
        assert_eq!(pick(&certain, 0.999).index(), 1);
        assert_eq!(pick(&[1.0; 4], 1.0).index(), 3);
    }

    #[test]
    fn the_best_action_is_the_lowest_numbered_of_equals() {
        assert_eq!(best(&[1.0, 3.0, 3.0, 2.0]).index(), 1);
        assert_eq!(best(&[-1.0; 4]).index(), 0);
    }

    #[test]
    fn exploration_happens_at_its_rate_and_is_uniform_for_any_number_of_actions() {
        let mut stream = Stream::new(8, Purpose::Exploration);
        const DRAWS: u32 = 200_000;
        for (epsilon, count) in [(0.2, 4), (0.2, 2), (0.2, 3), (0.013, 7), (1.0, 7), (0.5, 256)] {
            let mut counts = vec![0u32; count];
            for _ in 0..DRAWS {
                if let Some(action) = explore(epsilon, count, &mut stream) {
                    counts[action.index()] += 1;
                }
            }
            let expected = epsilon / count as f64;
            // Four and a half standard deviations of a binomial count: one in 150,000.
            let most = 4.5 * (f64::from(DRAWS) * expected * (1.0 - expected)).sqrt();
            for times in &counts {
                let off = f64::from(*times) - f64::from(DRAWS) * expected;
                assert!(off.abs() < most, "{epsilon} {count}: {counts:?}");
            }
        }
        assert_eq!(explore(0.0, 4, &mut stream), None);
        assert!(explore(1.0, 4, &mut stream).is_some());
    }

    #[test]
    fn four_actions_are_the_lowest_bits_of_the_word_that_explores() {
        let mut stream = Stream::new(8, Purpose::Exploration);
        for _ in 0..100 {
            let word = stream.clone().bits();
            assert_eq!(explore(1.0, 4, &mut stream).unwrap().index(), (word & 3) as usize);
        }
    }

    #[test]
    fn softmax_of_seven_actions_by_hand() {
        // Logits ln 1 … ln 7, of sum 28.
        let mut weights: Vec<f32> = (1..8u8).map(|v| f32::from(v).ln() - 9.0).collect();
        exponentials(Isa::chosen(), &mut weights, 7);
        let mut probabilities = [0.0; 7];
        sampling_probabilities(&weights, 7, &mut probabilities);
        for (number, probability) in (1..8u8).zip(probabilities) {
            assert!((probability - f64::from(number) / 28.0).abs() < 1e-6, "{probabilities:?}");
        }
        for (unit, index) in [(0.0, 0), (0.034, 0), (0.037, 1), (0.74, 5), (0.76, 6), (0.999, 6)] {
            assert_eq!(pick(&weights, unit).index(), index, "{unit}");
        }
    }
}
