//! Policies made from networks: the mapping from observations to actions.

use std::io;

use pulp::{Simd, WithSimd};

use crate::agent::Actions;
use crate::agent::actor::Actor;
use crate::env::{Action, ActionProbabilities, LaneSet, Observations, VectorEnvironment};
use crate::kernel::{Isa, LINE, math};
use crate::rng::{Stream, unit_from_bits};
use crate::state::{Resumable, StateError, StateReader, StateWriter};

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
    pub fn probabilities(self, numbers: &[f32]) -> Vec<f64> {
        match self {
            Choice::EpsilonGreedy { epsilon } => {
                let row = |values| epsilon_greedy_probabilities(epsilon, best(values));
                numbers.chunks_exact(Action::COUNT).flat_map(row).collect()
            }
            Choice::Softmax => {
                let mut preferences = numbers.to_vec();
                exponentials(Isa::chosen(), &mut preferences);
                let row = |preferences: &[f32]| -> [f64; Action::COUNT] {
                    let total: f64 = preferences.iter().copied().map(f64::from).sum();
                    std::array::from_fn(|index| f64::from(preferences[index]) / total)
                };
                preferences.chunks_exact(Action::COUNT).flat_map(row).collect()
            }
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

    /// Chooses at a rate of exploration, given the outputs.
    fn explore(
        &mut self,
        epsilon: f64,
        stream: &mut Stream,
        actions: &mut [Action],
        probabilities: Option<&mut [ActionProbabilities]>,
    ) {
        self.explored.clear();
        self.explored.extend(actions.iter().map(|_| explore(epsilon, stream)));
        let rows = || self.outputs.chunks_exact(Action::COUNT);
        for ((action, explored), values) in actions.iter_mut().zip(&self.explored).zip(rows()) {
            *action = explored.unwrap_or_else(|| best(values));
        }
        if let Some(probabilities) = probabilities {
            for (probabilities, values) in probabilities.iter_mut().zip(rows()) {
                *probabilities = epsilon_greedy_probabilities(epsilon, best(values));
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
        probabilities: Option<&mut [ActionProbabilities]>,
    ) {
        environment.observe(&mut self.observations);
        self.memory.resize(actions.len() * self.network.memory(), 0.0);
        self.network.recall(&self.observations, &mut self.memory, &mut self.outputs);
        match self.choice {
            Choice::EpsilonGreedy { epsilon } => {
                self.explore(epsilon, stream, actions, probabilities);
            }
            Choice::Softmax => {
                sample(Isa::chosen(), &mut self.outputs, actions, &mut self.halves, stream);
                if let Some(probabilities) = probabilities {
                    // [`sample`] has replaced the logits by the preferences that it sampled from.
                    sampling_probabilities(&self.outputs, probabilities);
                }
            }
        }
    }
}

/// Saves the memory of the episodes, if the network has one; the learner saves the weights.
impl<N: ActionNetwork> Resumable for NetworkActor<N> {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        if self.network.memory() > 0 { out.many(&self.memory) } else { Ok(()) }
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        const WHAT: &str = "memory";
        let width = self.network.memory();
        if width == 0 {
            return Ok(());
        }
        self.memory = from.many(usize::MAX, WHAT)?;
        if self.memory.len().is_multiple_of(width) { Ok(()) } else { Err(StateError::Misfit(WHAT)) }
    }
}

/// A random action with probability `epsilon`, otherwise `None`. One draw decides both, by
/// different bits.
pub(super) fn explore(epsilon: f64, stream: &mut Stream) -> Option<Action> {
    if epsilon == 0.0 {
        return None;
    }
    let bits = stream.bits();
    (unit_from_bits(bits) < epsilon).then(|| Action::from_low_bits(bits))
}

/// The probabilities of the actions at exploration rate `epsilon`.
pub(super) fn epsilon_greedy_probabilities(epsilon: f64, best: Action) -> ActionProbabilities {
    let any = epsilon / Action::COUNT as f64;
    let mut probabilities = [any; Action::COUNT];
    probabilities[best.index()] = 1.0 - epsilon + any;
    probabilities
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
    halves.resize(actions.len(), 0);
    stream.fill_halves(halves);
    exponentials(isa, logits);
    let weights = logits.as_chunks().0;
    assert_eq!(weights.len(), actions.len(), "logits for every action");
    isa.run(Pick { weights, halves, actions });
}

/// The probabilities from which [`sample`] chose actions, given the exponentials that it wrote.
///
/// **Shapes**: `preferences` is \[rows, actions\], `probabilities` is \[rows\].
pub(super) fn sampling_probabilities(
    preferences: &[f32],
    probabilities: &mut [ActionProbabilities],
) {
    let rows = preferences.as_chunks::<{ Action::COUNT }>().0;
    for (probabilities, row) in probabilities.iter_mut().zip(rows) {
        let total: f64 = row.iter().copied().map(f64::from).sum();
        *probabilities = row.map(|preference| f64::from(preference) / total);
    }
}

/// Replaces every logit in place by exp(logit - highest of its row).
pub(super) fn exponentials(isa: Isa, logits: &mut [f32]) {
    isa.run(Exponentials(logits.as_chunks_mut().0));
}

/// Number of `f32`s in the widest register.
const REGISTER: usize = LINE / size_of::<f32>();

/// Logits, \[rows\].
struct Exponentials<'a>(&'a mut [[f32; Action::COUNT]]);

impl WithSimd for Exponentials<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.0.iter_mut().for_each(relative);
        let logits = self.0.as_flattened_mut();
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

/// The second half of [`sample`]; every array is \[rows\].
struct Pick<'a> {
    weights: &'a [[f32; Action::COUNT]],
    halves: &'a [u32],
    actions: &'a mut [Action],
}

impl WithSimd for Pick<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let given = self.weights.iter().zip(self.halves);
        for (action, (weights, half)) in self.actions.iter_mut().zip(given) {
            // The number is in [0, 1), a multiple of 2^-32.
            *action = pick(weights, f64::from(*half) * (1.0 / 4_294_967_296.0));
        }
    }
}

/// Subtracts the highest logit from all logits.
#[inline(always)]
fn relative(logits: &mut [f32; Action::COUNT]) {
    let [a, b, c, d] = *logits;
    let (a, c) = (if b > a { b } else { a }, if d > c { d } else { c });
    let highest = if c > a { c } else { a };
    logits.iter_mut().for_each(|logit| *logit -= highest);
}

/// The action at which the cumulative weights exceed `unit`, in [0, 1), times their sum.
#[inline(always)]
fn pick(weights: &[f32; Action::COUNT], unit: f64) -> Action {
    let [a, b, c, d] = weights.map(f64::from);
    let (ab, abc) = (a + b, a + b + c);
    let threshold = unit * (abc + d);
    // Branch-free, because a branch on a random number is unpredictable.
    let passed = u8::from(a <= threshold) + u8::from(ab <= threshold) + u8::from(abc <= threshold);
    Action::from_low_bits(passed.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::{LaneStreams, PhysicalActivity, StepCount};
    use crate::rng::Purpose;

    /// A network with the same outputs for every observation.
    struct Same([f32; Action::COUNT]);

    impl ActionNetwork for Same {
        fn evaluate(&mut self, observations: &Observations, out: &mut Vec<f32>) {
            *out = self.0.repeat(observations.rows());
        }
    }

    /// Actions in 4000 lanes with their probabilities. Asserts that the actions are the same if no
    /// probabilities are requested.
    fn acted(actor: &mut dyn Actor) -> Vec<(usize, ActionProbabilities)> {
        let mut lanes = PhysicalActivity::new(&StepCount::paper(0.6), &"P".parse().unwrap(), 4000);
        let stream = |purpose| Stream::new(6, purpose);
        lanes.reset(LaneSet::All, &mut LaneStreams::Shared(stream(Purpose::Environment)));
        let (mut actions, mut again) = ([Action::NONE; 4000], [Action::UNTAILORED; 4000]);
        let mut probabilities = [[f64::NAN; Action::COUNT]; 4000];
        let mut choices = stream(Purpose::Exploration);
        actor.act(&lanes, &mut choices.clone(), &mut again, None);
        actor.act(&lanes, &mut choices, &mut actions, Some(&mut probabilities));
        assert_eq!(actions, again);
        actions.iter().map(|action| action.index()).zip(probabilities).collect()
    }

    fn assert_probabilities(actor: &mut dyn Actor, expected: [f64; Action::COUNT]) {
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
        let drawn = greedy.probabilities(&[1.0, 3.0, 3.0, 0.0]);
        let expected = [0.05, 0.85, 0.05, 0.05];
        assert!(drawn.iter().zip(expected).all(|(p, e)| (p - e).abs() < 1e-12), "{drawn:?}");
        let logits = [1.0f32, 2.0, 3.0, 4.0].map(f32::ln);
        let drawn = Choice::Softmax.probabilities(&logits);
        let expected = [0.1, 0.2, 0.3, 0.4];
        assert!(drawn.iter().zip(expected).all(|(p, e)| (p - e).abs() < 1e-6), "{drawn:?}");
    }

    #[test]
    fn softmax_samples_have_the_probabilities_by_hand() {
        // Logits ln 1, ln 2, ln 3, ln 4: probabilities 0.1, 0.2, 0.3, 0.4.
        let mut weights: Vec<f32> = [1.0f32, 2.0, 3.0, 4.0].iter().map(|v| v.ln() + 50.0).collect();
        exponentials(Isa::chosen(), &mut weights);
        for (unit, index) in [(0.0, 0), (0.099, 0), (0.101, 1), (0.31, 2), (0.59, 2), (0.61, 3)] {
            assert_eq!(pick(weights.as_array().unwrap(), unit).index(), index, "{unit}");
        }
        let mut certain = [-1e30, 0.0, -1e30, -1e30];
        exponentials(Isa::chosen(), &mut certain);
        assert_eq!(pick(&certain, 0.999).index(), 1);
        assert_eq!(pick(&[1.0; 4], 1.0).index(), 3);
    }

    #[test]
    fn the_best_action_is_the_lowest_numbered_of_equals() {
        assert_eq!(best(&[1.0, 3.0, 3.0, 2.0]).index(), 1);
        assert_eq!(best(&[-1.0; 4]).index(), 0);
    }

    #[test]
    fn exploration_happens_at_its_rate_and_spreads_evenly() {
        let mut stream = Stream::new(8, Purpose::Exploration);
        let mut counts = [0u32; 4];
        for _ in 0..200_000 {
            if let Some(action) = explore(0.2, &mut stream) {
                counts[action.index()] += 1;
            }
        }
        for count in counts {
            // 10,000 expected, standard deviation 97.
            assert!((f64::from(count) - 10_000.0).abs() < 400.0, "{counts:?}");
        }
        assert_eq!(explore(0.0, &mut stream), None);
        assert!(explore(1.0, &mut stream).is_some());
    }
}
