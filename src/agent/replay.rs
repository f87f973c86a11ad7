//! The replay buffer, and random draws from it.

use std::collections::BTreeMap;

use crate::agent::{OutOfMemory, reserve, reserve_exact};
use crate::env::{Action, EpisodeStatus, Observations};
use crate::key::choices;
use crate::rng::Stream;
use crate::state::resumable;

/// One step of the agent, without observations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transition {
    /// Action taken.
    pub action: Action,
    /// Reward received, after scaling.
    pub reward: f32,
    /// Status of the episode after the step.
    pub status: EpisodeStatus,
    /// Whether the next action is action 0 for certain, because no message can be sent after the step.
    pub is_withheld: bool,
}

choices! {
    /// The regression target of a transition that ends its episode.
    pub enum TerminalTarget {
        /// 0 on any end, time-outs included: the last reward is dropped, as in the published code.
        Zero = "zero",
        /// The reward when the episode terminated; bootstrapped when it was
        /// truncated (horizon reached).
        Standard = "standard",
    }
}

/// A batch of transitions for an update; row i of every array belongs to transition i.
#[derive(Clone, Debug)]
pub struct Batch {
    /// The states.
    pub observations: Observations,
    /// \[rows\]: the actions taken in these states.
    pub actions: Vec<Action>,
    /// \[rows\]: targets of the values of these actions.
    pub targets: Vec<f32>,
}

/// The features and the moment of an observation.
type Closing = (Vec<f32>, Option<u32>);

/// The latest transitions; once `capacity` is reached, new ones overwrite the oldest.
///
/// The buffer grows as it fills. It stores only the state before a transition. The state after it
/// is the state before its successor, unless the episode ended. A transition takes 10 bytes, plus
/// 4 per feature, plus 2 for the moment if observations have a one-hot of time: 22 bytes in `P-H-D`.
/// With standard targets, a truncated transition takes about 150 bytes more.
#[derive(Clone, Debug)]
pub struct Replay {
    capacity: usize,
    /// Position of the next transition.
    next: usize,
    width: usize,
    one_hot: usize,
    features: Vec<f32>,
    moments: Vec<u16>,
    rewards: Vec<f32>,
    /// Whether the next action is withheld, status and action: one, two and eight bits.
    steps: Vec<u16>,
    /// Regression targets; NaN if unknown.
    targets: Vec<f32>,
    /// Positions whose target has been set since targets were last cleared.
    known: Vec<u32>,
    /// The state after the latest transition.
    latest: Observations,
    /// States after truncated transitions, by position; kept only if targets need them.
    closings: BTreeMap<usize, Closing>,
    terminal_target: TerminalTarget,
    sampled: Sampled,
}

impl Replay {
    /// An empty buffer for observations of this shape.
    pub fn new(
        capacity: usize,
        observations: &Observations,
        terminal_target: TerminalTarget,
    ) -> Self {
        Replay {
            capacity,
            next: 0,
            width: observations.width(),
            one_hot: observations.one_hot(),
            features: Vec::new(),
            moments: Vec::new(),
            rewards: Vec::new(),
            steps: Vec::new(),
            targets: Vec::new(),
            known: Vec::new(),
            latest: observations.clone(),
            closings: BTreeMap::new(),
            terminal_target,
            sampled: Sampled::default(),
        }
    }

    /// Stores a transition between two observations of one row each. `after` must equal `before` of
    /// the next transition, unless the episode ended.
    ///
    /// **Errors**: memory is short; the buffer cannot be used afterwards.
    pub fn push(
        &mut self,
        before: &Observations,
        transition: Transition,
        after: &Observations,
    ) -> Result<(), OutOfMemory> {
        let position = self.next;
        self.next = (position + 1) % self.capacity;
        put(&mut self.features, position * self.width, before.row(0))?;
        if let Some(moment) = before.moment(0) {
            let moment = u16::try_from(moment).expect("a horizon is at most 10,000");
            put(&mut self.moments, position, &[moment])?;
        }
        put(&mut self.rewards, position, &[transition.reward])?;
        put(&mut self.steps, position, &[pack(&transition)])?;
        put(&mut self.targets, position, &[f32::NAN])?;
        self.latest.clear();
        self.latest.push(after.row(0), after.moment(0));
        self.closings.remove(&position);
        if (transition.status, self.terminal_target)
            == (EpisodeStatus::Truncated, TerminalTarget::Standard)
        {
            self.closings.insert(position, (after.row(0).to_vec(), after.moment(0)));
        }
        Ok(())
    }

    /// Maximum number of stored transitions.
    pub fn capacity(&self) -> usize {
        self.capacity
    }

    /// The position at which the next transition is stored.
    pub fn next_position(&self) -> usize {
        self.next
    }

    /// Number of stored transitions.
    pub fn len(&self) -> usize {
        self.steps.len()
    }

    /// Whether all stored actions are among the first `count`.
    pub(super) fn fits(&self, count: usize) -> bool {
        self.steps.iter().all(|step| unpack(*step, 0.0).action.index() < count)
    }

    /// Whether no transition is stored.
    pub fn is_empty(&self) -> bool {
        self.steps.is_empty()
    }

    /// The transition at a position.
    pub fn transition(&self, position: usize) -> Transition {
        unpack(self.steps[position], self.rewards[position])
    }

    /// Appends the state before the transition at a position to `out`.
    pub fn push_before(&self, position: usize, out: &mut Observations) {
        let features = &self.features[position * self.width..(position + 1) * self.width];
        let moment = (self.one_hot > 0).then(|| u32::from(self.moments[position]));
        out.push(features, moment);
    }

    /// Appends the state after the transition at a position to `out`. If the episode ended there,
    /// it is the final state if targets need it, and otherwise an arbitrary state.
    pub fn push_after(&self, position: usize, out: &mut Observations) {
        let successor = (position + 1) % self.capacity;
        match self.closings.get(&position) {
            Some((features, moment)) => out.push(features, *moment),
            None if successor == self.next => out.push(self.latest.row(0), self.latest.moment(0)),
            None => self.push_before(successor, out),
        }
    }

    /// The regression target of the transition at a position; `None` if unknown.
    pub fn target(&self, position: usize) -> Option<f32> {
        Some(self.targets[position]).filter(|target| !target.is_nan())
    }

    /// Stores the regression target of the transition at a position.
    ///
    /// **Errors**: memory is short.
    pub fn set_target(&mut self, position: usize, target: f32) -> Result<(), OutOfMemory> {
        reserve(&mut self.known, 1, "the replay buffer")?;
        self.targets[position] = target;
        self.known.push(position as u32);
        Ok(())
    }

    /// Clears all regression targets.
    pub fn forget_targets(&mut self) {
        for position in self.known.drain(..) {
            self.targets[position as usize] = f32::NAN;
        }
    }

    /// Replaces a batch by the transitions at these positions with their targets; unknown targets
    /// are NaN.
    pub fn gather(&self, positions: &[usize], batch: &mut Batch) {
        batch.observations.clear();
        batch.actions.clear();
        batch.targets.clear();
        for &position in positions {
            self.push_before(position, &mut batch.observations);
            batch.actions.push(self.transition(position).action);
            batch.targets.push(self.targets[position]);
        }
    }

    /// Fills `positions` with distinct positions; every set of positions is equally likely. Takes
    /// time proportional to their number. At least this number of transitions must be stored.
    pub fn draw(&mut self, stream: &mut Stream, positions: &mut [usize]) {
        self.sampled.draw(self.steps.len(), stream, positions);
    }
}

resumable!([] Replay {
    parts next;
    grown features, moments, rewards, steps, targets;
    parts latest, closings;
    check is_whole, "transitions";
    then find_known
});

impl Replay {
    /// Whether the arrays are of the same transitions, up to the next position.
    fn is_whole(&self) -> bool {
        let stored = self.steps.len();
        let moments = if self.one_hot > 0 { stored } else { 0 };
        let lengths = [self.features.len(), self.moments.len(), self.rewards.len()];
        let closing = |(position, (features, moment)): (&usize, &Closing)| {
            *position < stored
                && features.len() == self.width
                && moment.is_some() == (self.one_hot > 0)
                && moment.is_none_or(|moment| (moment as usize) < self.one_hot)
        };
        stored <= self.capacity
            && lengths == [stored * self.width, moments, stored]
            && self.targets.len() == stored
            && self.latest.rows() == stored.min(1)
            && self.closings.iter().all(closing)
            // Until the buffer is full, the next transition is appended.
            && if stored < self.capacity { self.next == stored } else { self.next < stored }
    }

    /// Lists the positions with known targets.
    fn find_known(&mut self) {
        let known = (0..).zip(&self.targets).filter(|(_, target)| !target.is_nan());
        self.known = known.map(|(position, _)| position).collect();
    }
}

/// Writes at a position or at the end. Capacity grows by an eighth, so that little memory is
/// unused.
fn put<T: Copy>(values: &mut Vec<T>, at: usize, new: &[T]) -> Result<(), OutOfMemory> {
    if at < values.len() {
        values[at..at + new.len()].copy_from_slice(new);
        return Ok(());
    }
    if values.len() + new.len() > values.capacity() {
        let more = (values.len() / 8).max(1024 * new.len());
        reserve_exact(values, more, "the replay buffer")?;
    }
    values.extend_from_slice(new);
    Ok(())
}

fn pack(transition: &Transition) -> u16 {
    let Transition { action, status, is_withheld, .. } = transition;
    u16::from(*is_withheld) | u16::from(status.number()) << 1 | (action.index() as u16) << 3
}

fn unpack(step: u16, reward: f32) -> Transition {
    let number = (step >> 1 & 3) as u8;
    // A status above 2 can only come from a damaged state.
    let status = EpisodeStatus::from_number(number).unwrap_or(EpisodeStatus::Truncated);
    let action = Action::from_index(usize::from(step >> 3 & 255)).expect("eight bits");
    Transition { action, reward, status, is_withheld: step & 1 != 0 }
}

/// The positions of a draw: a hash table with linear probing and at least four slots per position.
#[derive(Clone, Debug, Default)]
pub(super) struct Sampled(Vec<u32>);

impl Sampled {
    /// Marks a free slot; buffers are smaller than this number.
    const FREE: u32 = u32::MAX;

    /// Fills `positions` with distinct numbers below `stored`; every set of numbers is equally
    /// likely.
    ///
    /// **Source**: Floyd's algorithm (Bentley and Floyd, "A sample of brilliance", 1987).
    pub(super) fn draw(&mut self, stored: usize, stream: &mut Stream, positions: &mut [usize]) {
        assert!(positions.len() <= stored, "a draw without replacement needs enough to draw from");
        self.clear(positions.len());
        let first = stored - positions.len();
        for (position, last) in positions.iter_mut().zip(first..) {
            let drawn = stream.below(last as u32 + 1);
            *position = if self.insert(drawn) {
                drawn as usize
            } else {
                self.insert(last as u32);
                last
            };
        }
    }

    /// Empties the table and makes room for `count` positions.
    fn clear(&mut self, count: usize) {
        self.0.clear();
        self.0.resize((4 * count).next_power_of_two(), Sampled::FREE);
    }

    /// Inserts a position; returns whether it was new.
    fn insert(&mut self, position: u32) -> bool {
        // Fibonacci hashing: the upper bits of the product with the golden ratio spread
        // neighbouring positions.
        let bits = self.0.len().trailing_zeros();
        let mut slot = (position.wrapping_mul(0x9E37_79B9) >> (32 - bits)) as usize;
        loop {
            slot &= self.0.len() - 1;
            match self.0[slot] {
                Sampled::FREE => {
                    self.0[slot] = position;
                    return true;
                }
                taken if taken == position => return false,
                _ => slot += 1,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Purpose;

    /// An observation of one row.
    fn one(value: f32) -> Observations {
        let mut observations = Observations::new(2, 3);
        observations.push(&[value, value + 0.5], Some(value as u32 % 3));
        observations
    }

    /// A buffer after `pushes` transitions. Transition i leads from state i to state i + 1. Every
    /// third transition ends an episode at the horizon, in state i + 100.
    fn filled(capacity: usize, pushes: usize, terminal_target: TerminalTarget) -> Replay {
        let mut replay = Replay::new(capacity, &Observations::new(2, 3), terminal_target);
        for i in 0..pushes {
            let (status, after) = if i % 3 == 2 {
                (EpisodeStatus::Truncated, i as f32 + 100.0)
            } else {
                (EpisodeStatus::Running, i as f32 + 1.0)
            };
            let action = Action::from_index(i % 4).unwrap();
            let is_withheld = i % 5 == 0;
            let transition = Transition { action, reward: i as f32, status, is_withheld };
            replay.push(&one(i as f32), transition, &one(after)).unwrap();
        }
        replay
    }

    #[test]
    fn a_full_buffer_overwrites_its_oldest() {
        let replay = filled(3, 5, TerminalTarget::Zero);
        let rewards: Vec<f32> = (0..3).map(|i| replay.transition(i).reward).collect();
        assert_eq!(rewards, [3.0, 4.0, 2.0]);
        assert_eq!(replay.transition(2).status, EpisodeStatus::Truncated);
        assert_eq!(replay.transition(0).action.index(), 3);
        let withheld = [0, 1, 2].map(|position| replay.transition(position).is_withheld);
        assert_eq!(withheld, [false, false, false]);
        assert!(filled(3, 6, TerminalTarget::Zero).transition(2).is_withheld);
    }

    #[test]
    fn states_before_and_after_are_those_of_the_transition() {
        for capacity in [4, 7, 20] {
            let replay = filled(capacity, 14, TerminalTarget::Standard);
            for position in 0..replay.len() {
                let mut states = Observations::new(2, 3);
                replay.push_before(position, &mut states);
                replay.push_after(position, &mut states);
                let before = replay.transition(position).reward;
                let after = match replay.transition(position).status {
                    EpisodeStatus::Truncated => before + 100.0,
                    _ => before + 1.0,
                };
                assert_eq!(states.row(0), [before, before + 0.5]);
                assert_eq!(states.row(1), [after, after + 0.5]);
                assert_eq!(states.moments(), [before as u32 % 3, after as u32 % 3]);
            }
        }
    }

    #[test]
    fn targets_are_known_until_forgotten_or_overwritten() {
        let mut replay = filled(4, 4, TerminalTarget::Zero);
        assert_eq!(replay.target(1), None);
        (0..4).for_each(|position| replay.set_target(position, position as f32).unwrap());
        replay.push(&one(9.0), replay.transition(0), &one(10.0)).unwrap();
        assert_eq!(replay.target(0), None);
        assert_eq!(replay.target(1), Some(1.0));
        replay.forget_targets();
        assert_eq!(replay.target(1), None);
    }

    #[test]
    fn a_transition_takes_at_most_24_bytes() {
        let mut replay = Replay::new(100_000, &Observations::new(3, 50), TerminalTarget::Zero);
        let mut state = Observations::new(3, 50);
        state.push(&[0.0; 3], Some(1));
        let transition = Transition {
            action: Action::NONE,
            reward: 0.0,
            status: EpisodeStatus::Running,
            is_withheld: false,
        };
        (0..100_000).for_each(|_| replay.push(&state, transition, &state).unwrap());
        let Replay { features, moments, rewards, steps, targets, .. } = &replay;
        let stored = 4 * features.len() + 2 * moments.len() + 4 * rewards.len() + 2 * steps.len();
        assert!(stored + 4 * targets.len() <= 24 * replay.len());
        assert!(features.capacity() <= features.len() * 9 / 8);
    }

    #[test]
    fn draws_are_without_replacement_and_every_pair_is_equally_likely() {
        let mut replay = filled(5, 5, TerminalTarget::Zero);
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
        // The 99.9 % quantile of chi-squared with nine degrees of freedom is 27.9.
        assert!(chi_squared < 27.9, "chi-squared {chi_squared} of {counts:?}");
    }

    #[test]
    fn a_draw_of_everything_is_everything() {
        let mut replay = filled(64, 64, TerminalTarget::Zero);
        let mut positions = [0; 64];
        replay.draw(&mut Stream::new(1, Purpose::Replay), &mut positions);
        positions.sort_unstable();
        assert!(positions.iter().enumerate().all(|(i, &p)| i == p));
    }
}
