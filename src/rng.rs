//! Named random streams: the only place that makes generators.
//!
//! Every source of chance in a job has a stream of its own, so that drawing more from one moves
//! nothing in another. A stream depends on the job's seed and its own name alone; jobs with equal
//! seeds meet the same draws (common random numbers), which narrows comparisons between them.
//! The conversions from bits to numbers are written here and not taken from a library, because
//! their results are part of what a job's key promises.

use pulp::bytemuck;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// What a stream is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum Purpose {
    /// Contexts and their features in training.
    Environment = 1,
    /// The agent's choice among actions in training.
    Exploration = 2,
    /// Which transitions a batch is made of.
    Replay = 3,
    /// Weights before training.
    InitialWeights = 4,
    /// Contexts and their features in the test.
    TestEnvironment = 5,
    /// The agent's choice among actions in the test.
    TestActions = 6,
    /// Which seeds a resample of an analysis is made of; no job draws from it.
    Bootstrap = 7,
    /// Contexts in which an optimum is tried; no job draws from it.
    Optimum = 8,
}

/// Words beside those of a stream: for each word of it, a fixed number that is independent of it.
///
/// What is drawn from one companion moves nothing in the stream or in another companion, and the place
/// in a companion follows from the place in the stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u64)]
pub enum Companion {
    /// The next context, where contexts persist or are not equally likely.
    Context = 1,
    /// Whether a message can be sent.
    Availability = 2,
    /// Noise of habituation and disengagement risk.
    StateNoise = 3,
    /// Noise of the steps walked.
    StepNoise = 4,
    /// Noise of the parameters of habituation and disengagement risk.
    ParameterNoise = 5,
}

impl Companion {
    /// Words for each word of the stream.
    pub const fn width(self) -> usize {
        match self {
            Companion::Context | Companion::Availability | Companion::StepNoise => 1,
            Companion::StateNoise => 2,
            Companion::ParameterNoise => 4,
        }
    }
}

/// A stream of random numbers (ChaCha with 8 rounds).
#[derive(Clone, Debug)]
pub struct Stream(ChaCha8Rng);

impl Stream {
    /// The stream of a seed for a purpose, at its start.
    pub fn new(seed: u64, purpose: Purpose) -> Self {
        let mut generator = ChaCha8Rng::seed_from_u64(seed);
        generator.set_stream(purpose as u64);
        Stream(generator)
    }

    /// How many times [`Stream::bits`] has been called.
    pub fn position(&self) -> u64 {
        (self.0.get_word_pos() / 2) as u64
    }

    /// Goes to where `position` calls of [`Stream::bits`] lead from the start.
    pub fn go_to(&mut self, position: u64) {
        self.0.set_word_pos(u128::from(position) * 2);
    }

    /// A companion at the words that belong to the next word of this stream.
    pub fn companion(&self, companion: Companion) -> Stream {
        let mut generator = ChaCha8Rng::from_seed(self.0.get_seed());
        // Purposes are small numbers, so that no companion is the stream of a purpose.
        generator.set_stream(self.0.get_stream() | (companion as u64) << 32);
        let mut stream = Stream(generator);
        stream.go_to(self.position().wrapping_mul(companion.width() as u64));
        stream
    }

    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// Fills `words` with random bits, as so many calls of [`Stream::bits`] would.
    pub fn fill(&mut self, words: &mut [u64]) {
        self.0.fill_bytes(bytemuck::cast_slice_mut(words));
        words.iter_mut().for_each(|word| *word = u64::from_le(*word));
    }

    /// Fills `words` with what [`Stream::fill`] will give next.
    pub fn peek(&self, words: &mut [u64]) {
        self.clone().fill(words);
    }

    /// Fills `halves` with random bits, two for each call of [`Stream::bits`], the lower one first.
    pub fn fill_halves(&mut self, halves: &mut [u32]) {
        self.0.fill_bytes(bytemuck::cast_slice_mut(halves));
        halves.iter_mut().for_each(|half| *half = u32::from_le(*half));
        if halves.len() % 2 == 1 {
            self.0.next_u32();
        }
    }

    /// A number in [0, 1), a multiple of 2^-53.
    pub fn unit(&mut self) -> f64 {
        unit_from_bits(self.bits())
    }

    /// A whole number below `bound`, which is above 0; every one equally likely.
    ///
    /// **Source**: Lemire, "Fast random integer generation in an interval", 2019.
    pub fn below(&mut self, bound: u32) -> u32 {
        let bound = u64::from(bound);
        loop {
            let product = (self.bits() >> 32) * bound;
            let remainder = product & 0xFFFF_FFFF;
            // Remainders below 2^32 mod bound belong to numbers that would come once too often.
            if remainder >= (1 << 32) % bound {
                return (product >> 32) as u32;
            }
        }
    }
}

/// The number in [0, 1) that the upper 53 of these bits stand for.
pub fn unit_from_bits(bits: u64) -> f64 {
    (bits >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
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

    // What `rand_chacha` 0.10.0 gave when these streams were first used.
    const STREAM_1_ENVIRONMENT: u64 = 15715005604373573095;
    const STREAM_1_TEST_ACTIONS: u64 = 9345421689931614251;
    const STATE_NOISE_1_ENVIRONMENT: u64 = 6440870257630952131;
    const STREAM_MAX_REPLAY: u64 = 10223169959992702069;

    #[test]
    fn a_stream_goes_on_from_every_position() {
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
