//! The words of a companion of the streams of an environment's lanes.

use std::slice;

use crate::env::vector::{LaneSet, LaneStreams};
use crate::rng::{Companion, Stream};

/// For every lane, the words of a companion that belong to the next word of the lane's stream.
#[derive(Clone, Debug)]
pub(super) struct CompanionWords {
    companion: Companion,
    /// \[lanes, width of the companion\], row-major; empty if the companion is not used.
    words: Vec<u64>,
    /// The companion of every stream after the last draw from it; empty before the first draw.
    beside: Vec<Stream>,
}

impl CompanionWords {
    /// The words of `lanes` lanes, before the first draw.
    pub(super) fn new(companion: Companion, lanes: usize) -> Self {
        CompanionWords { companion, words: vec![0; lanes * companion.width()], beside: Vec::new() }
    }

    /// The words, \[lanes, width of the companion\], row-major.
    #[inline(always)]
    pub(super) fn words(&self) -> &[u64] {
        &self.words
    }

    /// The words, for other words in their place.
    #[inline(always)]
    pub(super) fn words_mut(&mut self) -> &mut [u64] {
        &mut self.words
    }

    /// Fills the entries of lanes with the words for the next words of the streams. From a shared stream, all of `lanes`
    /// consume words; with one stream per lane, the lanes marked in `drawn` do.
    ///
    /// **Shapes**: `drawn` is \[lanes\] or longer.
    pub(super) fn fill(&mut self, streams: &LaneStreams, lanes: LaneSet<'_>, drawn: &[bool]) {
        let CompanionWords { companion, words, beside } = self;
        let width = companion.width();
        let sources = match streams {
            LaneStreams::Shared(stream) => slice::from_ref(stream),
            LaneStreams::PerLane(streams) => streams,
        };
        if beside.len() != sources.len() {
            *beside = sources.iter().map(|stream| stream.companion(*companion)).collect();
        }
        match streams {
            LaneStreams::Shared(stream) => {
                stream.accompany(*companion, &mut beside[0]);
                if lanes == LaneSet::All {
                    return beside[0].fill(words);
                }
                let rows = words.chunks_exact_mut(width).enumerate();
                rows.filter(|(lane, _)| lanes.contains(*lane))
                    .for_each(|(_, row)| beside[0].fill(row));
            }
            LaneStreams::PerLane(streams) => {
                let rows = words.chunks_exact_mut(width).zip(beside).zip(streams).zip(drawn);
                for (((row, beside), stream), _) in rows.filter(|(_, drawn)| **drawn) {
                    stream.accompany(*companion, beside);
                    row.iter_mut().for_each(|word| *word = beside.bits());
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Purpose;

    const ALL: [Companion; 6] = [
        Companion::Belief,
        Companion::Context,
        Companion::Availability,
        Companion::StateNoise,
        Companion::StepNoise,
        Companion::ParameterNoise,
    ];

    /// The words for the next word of a stream, from a generator of their own.
    fn plain(stream: &Stream, companion: Companion) -> Vec<u64> {
        let mut words = vec![0; companion.width()];
        stream.companion(companion).fill(&mut words);
        words
    }

    #[test]
    fn words_beside_a_lane_are_those_of_the_streams_that_come() {
        for companion in ALL {
            let mut words = CompanionWords::new(companion, 3);
            let stream = |seed| Stream::new(seed, Purpose::TestEnvironment);
            let mut streams = LaneStreams::PerLane([1, 2, 3].map(stream).into());
            for turn in 0_usize..200 {
                let drawn = [true, turn % 3 > 0, turn % 50 > 0];
                let before = words.words().to_vec();
                words.fill(&streams, LaneSet::All, &drawn);
                let rows = words.words().chunks(companion.width());
                let rows = rows.zip(before.chunks(companion.width()));
                for (lane, (row, before)) in rows.enumerate() {
                    let stream = streams.of(lane);
                    match drawn[lane] {
                        true => assert_eq!(row, plain(stream, companion), "{companion:?} {turn}"),
                        false => assert_eq!(row, before, "{companion:?} {turn}"),
                    }
                    (0..turn % 5).for_each(|_| _ = stream.bits());
                }
                // A lane begins another stream, or an earlier position of its own.
                match turn % 31 {
                    7 => *streams.of(1) = stream(turn as u64),
                    20 => streams.of(2).go_to(turn as u64 / 2),
                    _ => {}
                }
            }
        }
    }

    #[test]
    fn lanes_of_a_shared_stream_consume_words_in_their_order() {
        let stream = Stream::new(4, Purpose::Environment);
        let mut words = CompanionWords::new(Companion::StateNoise, 3);
        let shared = LaneStreams::Shared(stream.clone());
        let mut expected = [0; 6];
        stream.companion(Companion::StateNoise).fill(&mut expected);
        words.fill(&shared, LaneSet::All, &[false; 3]);
        assert_eq!(words.words(), expected);
        words.fill(&shared, LaneSet::Masked(&[false, true, true]), &[false; 3]);
        assert_eq!(words.words(), [&expected[..2], &expected[..4]].concat());
    }
}
