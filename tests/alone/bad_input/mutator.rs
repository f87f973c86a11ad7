//! Mutations of seeds, the same in every process.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

/// Maximum length of an input, in bytes.
const LONGEST: usize = 1 << 18;
/// Numbers that often reveal faults in programs.
const NUMBERS: [&[u8]; 12] = [
    b"0",
    b"-1",
    b"1",
    b"255",
    b"65536",
    b"4294967296",
    b"9223372036854775807",
    b"-0.0",
    b"1e308",
    b"1e-320",
    b"nan",
    b"99999999999999999999",
];

/// A generator of inputs from seeds and words.
pub struct Mutator<'a> {
    seeds: &'a [Vec<u8>],
    words: &'a [Vec<u8>],
    draws: ChaCha8Rng,
}

impl<'a> Mutator<'a> {
    pub fn new(seeds: &'a [Vec<u8>], words: &'a [Vec<u8>]) -> Self {
        Mutator { seeds, words, draws: ChaCha8Rng::seed_from_u64(11) }
    }

    /// A seed with one to eight changes.
    pub fn next(&mut self) -> Vec<u8> {
        let mut bytes = self.seed().to_vec();
        for _ in 0..=self.below(8) {
            self.change(&mut bytes);
        }
        bytes.truncate(LONGEST);
        bytes
    }

    /// A number below `end`, which must be positive.
    fn below(&mut self, end: usize) -> usize {
        (self.draws.next_u64() % end as u64) as usize
    }

    fn seed(&mut self) -> &'a [u8] {
        let place = self.below(self.seeds.len());
        &self.seeds[place]
    }

    /// A short range of bytes.
    fn stretch(&mut self, bytes: &[u8]) -> std::ops::Range<usize> {
        let start = self.below(bytes.len() + 1);
        let length = self.below(64);
        start..bytes.len().min(start + length)
    }

    fn change(&mut self, bytes: &mut Vec<u8>) {
        let stretch = self.stretch(bytes);
        let at = stretch.start;
        match self.below(8) {
            0 => bytes.truncate(at),
            1 => drop(bytes.drain(stretch)),
            2 => {
                let copied = bytes[stretch].to_vec();
                let times = 1 << self.below(8);
                bytes.splice(at..at, copied.repeat(times));
            }
            3 => {
                let other = self.seed();
                let taken = self.stretch(other);
                bytes.splice(stretch, other[taken].iter().copied());
            }
            4 | 5 => {
                let word = self.below(self.words.len());
                bytes.splice(at..at, self.words[word].iter().copied());
            }
            6 => {
                // Replaces the next number, if there is one; otherwise inserts.
                let digit = |byte: &u8| byte.is_ascii_digit();
                let start = bytes[at..].iter().position(digit).map_or(at, |skipped| at + skipped);
                let length = bytes[start..].iter().take_while(|byte| digit(byte)).count();
                let number = NUMBERS[self.below(NUMBERS.len())];
                bytes.splice(start..start + length, number.iter().copied());
            }
            _ => {
                let value = self.draws.next_u64() as u8;
                match bytes.get_mut(at) {
                    Some(byte) => *byte = value,
                    None => bytes.push(value),
                }
            }
        }
    }
}
