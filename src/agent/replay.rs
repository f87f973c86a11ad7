//! The replay buffer, and draws from it.

use crate::env::{Action, Ending};
use crate::rng::Stream;

/// One step that the agent has taken, observations aside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transition {
    /// Action taken.
    pub action: Action,
    /// Reward received, in steps walked.
    pub reward: f32,
    /// Whether and how the episode ended with it.
    pub ending: Ending,
}

/// The latest transitions, the oldest overwritten once `capacity` is reached; it grows as it fills.
#[derive(Clone, Debug)]
pub struct Replay {
    capacity: usize,
    width: usize,
    next: usize,
    transitions: Vec<Transition>,
    observations: Vec<f32>,
    next_observations: Vec<f32>,
    /// The draw in which a transition was last chosen; 0 for none.
    chosen_in: Vec<u32>,
    draws: u32,
}

impl Replay {
    /// An empty buffer for observations of `width` entries.
    pub fn new(capacity: usize, width: usize) -> Self {
        Replay {
            capacity,
            width,
            next: 0,
            transitions: Vec::new(),
            observations: Vec::new(),
            next_observations: Vec::new(),
            chosen_in: Vec::new(),
            draws: 0,
        }
    }

    /// Stores a transition between two observations, each of `width` entries.
    pub fn push(&mut self, before: &[f32], transition: Transition, after: &[f32]) {
        if self.transitions.len() < self.capacity {
            self.transitions.push(transition);
            self.observations.extend_from_slice(before);
            self.next_observations.extend_from_slice(after);
            self.chosen_in.push(0);
        } else {
            let row = self.next * self.width..(self.next + 1) * self.width;
            self.transitions[self.next] = transition;
            self.observations[row.clone()].copy_from_slice(before);
            self.next_observations[row].copy_from_slice(after);
        }
        self.next = (self.next + 1) % self.capacity;
    }

    /// Transitions stored.
    pub fn len(&self) -> usize {
        self.transitions.len()
    }

    /// Whether nothing is stored.
    pub fn is_empty(&self) -> bool {
        self.transitions.is_empty()
    }

    /// The transition at a position.
    pub fn transition(&self, position: usize) -> Transition {
        self.transitions[position]
    }

    /// The observations before and after the transition at a position.
    pub fn observations(&self, position: usize) -> (&[f32], &[f32]) {
        let row = position * self.width..(position + 1) * self.width;
        (&self.observations[row.clone()], &self.next_observations[row])
    }

    /// Fills `positions` with different positions, every set of them equally likely, in time
    /// proportional to their number. There must be as many transitions stored.
    ///
    /// **Source**: Floyd's algorithm (Bentley and Floyd, "A sample of brilliance", 1987).
    pub fn draw(&mut self, stream: &mut Stream, positions: &mut [usize]) {
        let stored = self.transitions.len();
        assert!(positions.len() <= stored, "a draw without replacement needs enough transitions");
        if self.draws == u32::MAX {
            self.chosen_in.fill(0);
            self.draws = 0;
        }
        self.draws += 1;
        let first = stored - positions.len();
        for (position, last) in positions.iter_mut().zip(first..) {
            let drawn = stream.below(last as u32 + 1) as usize;
            *position = if self.chosen_in[drawn] == self.draws { last } else { drawn };
            self.chosen_in[*position] = self.draws;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Purpose;

    fn filled(capacity: usize, pushes: usize) -> Replay {
        let mut replay = Replay::new(capacity, 2);
        for i in 0..pushes {
            let transition =
                Transition { action: Action::NONE, reward: i as f32, ending: Ending::Running };
            replay.push(&[i as f32, 0.0], transition, &[i as f32 + 1.0, 0.5]);
        }
        replay
    }

    #[test]
    fn a_full_buffer_overwrites_its_oldest() {
        let replay = filled(3, 5);
        let rewards: Vec<f32> = (0..3).map(|i| replay.transition(i).reward).collect();
        assert_eq!(rewards, [3.0, 4.0, 2.0]);
        assert_eq!(replay.observations(1), (&[4.0, 0.0][..], &[5.0, 0.5][..]));
    }

    #[test]
    fn draws_are_without_replacement_and_every_pair_is_equally_likely() {
        let mut replay = filled(5, 5);
        let mut stream = Stream::new(2, Purpose::Replay);
        let mut counts = [[0u32; 5]; 5];
        for _ in 0..100_000 {
            let mut pair = [0; 2];
            replay.draw(&mut stream, &mut pair);
            pair.sort_unstable();
            counts[pair[0]][pair[1]] += 1;
        }
        let mut chi_squared = 0.0;
        for (low, row) in counts.iter().enumerate() {
            for (high, &count) in row.iter().enumerate() {
                if high > low {
                    chi_squared += (f64::from(count) - 10_000.0).powi(2) / 10_000.0;
                } else {
                    assert_eq!(count, 0, "{low} {high}");
                }
            }
        }
        // Nine degrees of freedom: 27.9 is the 99.9 % point.
        assert!(chi_squared < 27.9, "chi-squared {chi_squared} of {counts:?}");
    }

    #[test]
    fn a_draw_of_everything_is_everything() {
        let mut replay = filled(64, 64);
        let mut positions = [0; 64];
        replay.draw(&mut Stream::new(1, Purpose::Replay), &mut positions);
        positions.sort_unstable();
        assert!(positions.iter().enumerate().all(|(i, &p)| i == p));
    }
}
