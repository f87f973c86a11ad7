//! Named random streams. Only this module makes generators.
//!
//! Every source of randomness in a job has its own stream, so that additional draws from one stream do not
//! shift another. A stream depends only on the job's seed and on its own name. Jobs with equal seeds
//! therefore get the same draws (common random numbers), which reduces the variance of comparisons. The
//! module converts bits to numbers itself rather than through a library, because job keys promise these
//! results.

use pulp::bytemuck;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The purpose of a stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum Purpose {
    /// Contexts and their features in training.
    Environment = 1,
    /// The agent's choice among actions in training.
    Exploration = 2,
    /// The choice of transitions for a batch.
    Replay = 3,
    /// Initial weights.
    InitialWeights = 4,
    /// Contexts and their features in the test.
    TestEnvironment = 5,
    /// The agent's choice among actions in the test.
    TestActions = 6,
    /// The choice of seeds for a resample of an analysis; no job draws from it.
    Bootstrap = 7,
    /// Contexts in the simulated episodes of an optimum; no job draws from it.
    Optimum = 8,
    /// The environment of a person in a trial.
    Person = 9,
    /// What does not happen as planned in a trial: dropout and missing outcomes.
    Reality = 10,
    /// Standard normal deviates from which a bandit computes the probabilities that it declares.
    ProbabilityDraws = 12,
    /// Whether the phone of a person in a trial reports before a decision.
    Reports = 14,
    /// Coefficients that a bandit draws for an episode; the seed is a word of the stream that chooses
    /// actions.
    EpisodeDraws = 13,
    /// The shift of the points at which a search draws settings; no job draws from it.
    Search = 16,
    /// The actions of a policy in the courses that show its true value, by person; nothing else depends on them.
    PolicyCourse = 18,
}

/// Streams that run alongside another stream: for each word of the stream, a fixed number of independent
/// words.
///
/// Draws from one companion do not affect the stream or other companions. The position in a companion follows
/// from the position in the stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum Companion {
    /// The next context, if contexts persist or have unequal probabilities.
    Context = 1,
    /// Whether a message can be sent.
    Availability = 2,
    /// Noise of the state.
    StateNoise = 3,
    /// Noise of the outcome.
    StepNoise = 4,
    /// Noise of the parameters of the state.
    ParameterNoise = 5,
    /// Particles that stand for the belief about the state. Number 6 is of the participants.
    Belief = 7,
}

/// The companion for participants. Its position does not follow from the position in the stream, because the
/// number of words that an episode takes depends on the agent, and the next participant must not.
const PARTICIPANTS: u64 = 6;

/// The number of words per participant.
pub const PARTICIPANT_WORDS: usize = 32;

impl Companion {
    /// The number of words for each word of the stream.
    pub const fn width(self) -> usize {
        match self {
            Companion::Context
            | Companion::Availability
            | Companion::StepNoise
            | Companion::Belief => 1,
            Companion::StateNoise => 2,
            Companion::ParameterNoise => 4,
        }
    }
}

/// What identifies a stream, besides the position in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Source {
    seed: [u8; 32],
    stream: u64,
}

/// A stream of random numbers (ChaCha with 8 rounds), which also counts the participants drawn from it.
#[derive(Clone, Debug)]
pub struct Stream {
    generator: ChaCha8Rng,
    source: Source,
    /// The calls of [`Stream::bits`] from the start. The generator knows it too, but not as fast.
    position: u64,
    participants: u64,
}

impl Stream {
    /// The stream of a seed for a purpose, at its start.
    pub fn new(seed: u64, purpose: Purpose) -> Self {
        let seed = ChaCha8Rng::seed_from_u64(seed).get_seed();
        Stream::at(Source { seed, stream: purpose as u64 }, 0)
    }

    /// The stream of a seed for a purpose and a person, numbered from 0, at its start.
    pub fn of_person(seed: u64, purpose: Purpose, person: u32) -> Self {
        let seed = ChaCha8Rng::seed_from_u64(seed).get_seed();
        // Above the numbers of companions.
        Stream::at(Source { seed, stream: purpose as u64 | u64::from(person) << 40 }, 0)
    }

    /// The stream of a source, after `position` calls of [`Stream::bits`] from the start.
    fn at(source: Source, position: u64) -> Self {
        let mut generator = ChaCha8Rng::from_seed(source.seed);
        generator.set_stream(source.stream);
        let mut stream = Stream { generator, source, position: 0, participants: 0 };
        if position > 0 {
            stream.go_to(position);
        }
        stream
    }

    /// The position in the stream, in calls of [`Stream::bits`] from the start.
    #[inline]
    pub fn position(&self) -> u64 {
        self.position
    }

    /// Moves to the position after `position` calls of [`Stream::bits`] from the start.
    pub fn go_to(&mut self, position: u64) {
        self.generator.set_word_pos(u128::from(position) * 2);
        self.position = position;
    }

    /// A companion, at the words that belong to the next word of this stream.
    pub fn companion(&self, companion: Companion) -> Stream {
        let position = self.position.wrapping_mul(companion.width() as u64);
        Stream::at(self.beside(companion as u64), position)
    }

    /// Makes `beside` what [`Stream::companion`] returns, without work where it stands there already.
    #[inline]
    pub fn accompany(&self, companion: Companion, beside: &mut Stream) {
        let position = self.position.wrapping_mul(companion.width() as u64);
        let source = self.beside(companion as u64);
        if beside.source != source {
            *beside = Stream::at(source, position);
        } else if beside.position != position {
            beside.go_to(position);
        }
    }

    /// The source of the companion stream of this number.
    fn beside(&self, number: u64) -> Source {
        // Purposes are small numbers, so that no companion is the stream of a purpose.
        Source { seed: self.source.seed, stream: self.source.stream | number << 32 }
    }

    /// How many times [`Stream::next_participant`] has been called.
    pub fn participants(&self) -> u64 {
        self.participants
    }

    /// Moves to the participant after the first `participants`.
    pub fn go_to_participant(&mut self, participants: u64) {
        self.participants = participants;
    }

    /// The words of the next participant. They do not depend on other draws from this stream, and other draws
    /// do not depend on them.
    pub fn next_participant(&mut self) -> [u64; PARTICIPANT_WORDS] {
        let mut words = [0; PARTICIPANT_WORDS];
        let position = self.participants.wrapping_mul(PARTICIPANT_WORDS as u64);
        Stream::at(self.beside(PARTICIPANTS), position).fill(&mut words);
        self.participants += 1;
        words
    }

    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.position = self.position.wrapping_add(1);
        self.generator.next_u64()
    }

    /// Fills `words` with random bits, as one call of [`Stream::bits`] per word would.
    pub fn fill(&mut self, words: &mut [u64]) {
        self.position = self.position.wrapping_add(words.len() as u64);
        self.generator.fill_bytes(bytemuck::cast_slice_mut(words));
        words.iter_mut().for_each(|word| *word = u64::from_le(*word));
    }

    /// Fills `words` with the words that [`Stream::fill`] will give next, without consuming them.
    pub fn peek(&self, words: &mut [u64]) {
        self.clone().fill(words);
    }

    /// Fills `halves` with random bits: two per call of [`Stream::bits`], the lower half first.
    pub fn fill_halves(&mut self, halves: &mut [u32]) {
        self.position = self.position.wrapping_add(halves.len().div_ceil(2) as u64);
        self.generator.fill_bytes(bytemuck::cast_slice_mut(halves));
        halves.iter_mut().for_each(|half| *half = u32::from_le(*half));
        if halves.len() % 2 == 1 {
            self.generator.next_u32();
        }
    }

    /// A number in [0, 1), a multiple of 2^-53.
    pub fn unit(&mut self) -> f64 {
        unit_from_bits(self.bits())
    }

    /// A uniform integer below `bound`, which must be above 0.
    ///
    /// **Source**: Lemire, "Fast random integer generation in an interval", 2019.
    pub fn below(&mut self, bound: u32) -> u32 {
        let bound = u64::from(bound);
        loop {
            let product = (self.bits() >> 32) * bound;
            let remainder = product & 0xFFFF_FFFF;
            // Remainders below 2^32 mod bound belong to integers that would occur once too often. Most
            // remainders are at least the bound, and need no division.
            if remainder >= bound || remainder >= (1 << 32) % bound {
                return (product >> 32) as u32;
            }
        }
    }
}

/// The number in [0, 1) given by the upper 53 bits.
pub fn unit_from_bits(bits: u64) -> f64 {
    (bits >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}

/// The number in (0, 1) given by the upper 52 bits: halfway between multiples of 2^-52.
pub fn open_unit_from_bits(bits: u64) -> f64 {
    ((bits >> 12) as f64 + 0.5) * (1.0 / (1u64 << 52) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_keep_their_values_for_ever() {
        let first = |seed, purpose| Stream::new(seed, purpose).bits();
        assert_eq!(first(1, Purpose::Environment), STREAM_1_ENVIRONMENT);
        assert_eq!(first(1, Purpose::TestActions), STREAM_1_TEST_ACTIONS);
        assert_eq!(first(u64::MAX, Purpose::Replay), STREAM_MAX_REPLAY);
    }

    // The output of `rand_chacha` 0.10.0 when these streams were introduced.
    const STREAM_1_ENVIRONMENT: u64 = 15715005604373573095;
    const STREAM_1_TEST_ACTIONS: u64 = 9345421689931614251;
    const STATE_NOISE_1_ENVIRONMENT: u64 = 6440870257630952131;
    const PARTICIPANT_1_TEST_ENVIRONMENT: u64 = 360533505403389386;
    const STREAM_MAX_REPLAY: u64 = 10223169959992702069;

    #[test]
    fn a_stream_resumes_from_every_position() {
        let mut stream = Stream::new(3, Purpose::Exploration);
        for position in 0..300 {
            assert_eq!(stream.position(), position);
            let mut other = Stream::new(3, Purpose::Exploration);
            other.go_to(position);
            assert_eq!(other.position(), position);
            let mut undisturbed = stream.clone();
            assert!((0..100).all(|_| other.bits() == undisturbed.bits()), "{position}");
            stream.bits();
        }
        stream.go_to(u64::MAX);
        assert_eq!(stream.position(), u64::MAX);
    }

    #[test]
    fn companions_stand_beside_the_words_of_their_stream() {
        let all = [
            Companion::Context,
            Companion::Availability,
            Companion::StateNoise,
            Companion::StepNoise,
            Companion::ParameterNoise,
            Companion::Belief,
        ];
        let mut firsts = vec![STREAM_1_ENVIRONMENT];
        for companion in all {
            let mut stream = Stream::new(1, Purpose::Environment);
            let mut together = stream.companion(companion);
            for _ in 0..100 {
                let mut beside = stream.companion(companion);
                (0..companion.width()).for_each(|_| assert_eq!(beside.bits(), together.bits()));
                stream.bits();
            }
            firsts.push(Stream::new(1, Purpose::Environment).companion(companion).bits());
            firsts.push(Stream::new(1, Purpose::TestEnvironment).companion(companion).bits());
        }
        let distinct: std::collections::HashSet<u64> = firsts.iter().copied().collect();
        assert_eq!(distinct.len(), firsts.len());
        assert_eq!(firsts[5], STATE_NOISE_1_ENVIRONMENT);
    }

    #[test]
    fn participants_are_the_same_whatever_else_is_drawn() {
        let stream = || Stream::new(1, Purpose::TestEnvironment);
        let mut undisturbed = stream();
        let all: Vec<_> = (0..100).map(|_| undisturbed.next_participant()).collect();
        assert_eq!((undisturbed.position(), undisturbed.participants()), (0, 100));
        assert_eq!(undisturbed.bits(), stream().bits());
        let mut busy = stream();
        for (i, words) in (0u64..).zip(&all) {
            (0..i % 7).for_each(|_| _ = busy.bits());
            assert_eq!(busy.next_participant(), *words);
            let mut other = stream();
            other.go_to_participant(i);
            assert_eq!(other.next_participant(), *words);
        }
        let distinct: std::collections::HashSet<u64> = all.iter().flatten().copied().collect();
        assert_eq!(distinct.len(), all.len() * PARTICIPANT_WORDS);
        assert_ne!(Stream::new(1, Purpose::Environment).next_participant(), all[0]);
        assert_eq!(all[0][0], PARTICIPANT_1_TEST_ENVIRONMENT);
    }

    #[test]
    fn whole_numbers_below_a_bound_are_equally_likely() {
        let mut stream = Stream::new(7, Purpose::Replay);
        let mut counts = [0u32; 6];
        for _ in 0..60_000 {
            counts[stream.below(6) as usize] += 1;
        }
        // Five degrees of freedom: 20.5 is the 99.9 % point of chi-squared.
        let chi_squared: f64 =
            counts.iter().map(|&n| (f64::from(n) - 10_000.0).powi(2) / 10_000.0).sum();
        assert!(chi_squared < 20.5, "chi-squared {chi_squared} of {counts:?}");
    }

    #[test]
    fn many_words_at_once_are_those_that_come_one_by_one() {
        for start in 0..70 {
            for count in 0..150 {
                let mut stream = Stream::new(9, Purpose::Environment);
                stream.go_to(start);
                let mut one_by_one = stream.clone();
                let expected: Vec<u64> = (0..count).map(|_| one_by_one.bits()).collect();
                let mut words = vec![0; expected.len()];
                stream.peek(&mut words);
                assert_eq!((stream.position(), &words), (start, &expected));
                let mut halves = vec![0; 2 * expected.len()];
                stream.clone().fill_halves(&mut halves);
                let of_halves = halves
                    .as_chunks()
                    .0
                    .iter()
                    .map(|[low, high]| u64::from(*low) | (u64::from(*high) << 32));
                assert!(of_halves.eq(expected.iter().copied()));
                words.fill(0);
                stream.fill(&mut words);
                assert_eq!((stream.position(), &words), (start + count, &expected));
                assert_eq!(stream.generator.get_word_pos() / 2, u128::from(start + count));
                assert_eq!(stream.bits(), one_by_one.bits());
            }
        }
    }

    #[test]
    fn halves_are_those_of_the_words() {
        let (mut words, mut halves) = ([0; 2], [0; 3]);
        Stream::new(4, Purpose::Exploration).fill(&mut words);
        let mut stream = Stream::new(4, Purpose::Exploration);
        stream.fill_halves(&mut halves);
        assert_eq!(u64::from(halves[0]) | (u64::from(halves[1]) << 32), words[0]);
        assert_eq!(halves[2], words[1] as u32);
        assert_eq!(stream.position(), 2);
        let mut twice = Stream::new(4, Purpose::Exploration);
        twice.fill(&mut words);
        assert_eq!(stream.bits(), twice.bits());
    }

    #[test]
    fn unit_numbers_fill_the_interval_from_zero_to_below_one() {
        assert_eq!(unit_from_bits(0), 0.0);
        assert_eq!(unit_from_bits(u64::MAX), 1.0 - f64::EPSILON / 2.0);
    }
}
