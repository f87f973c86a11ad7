//! The experience of a dueling DQN with a memory: whole episodes, and sequences of steps drawn from
//! them.
//!
//! **Source**: Hausknecht and Stone, "Deep recurrent Q-learning for partially observable MDPs",
//! 2015: "bootstrapped sequential updates" from whole episodes and the zero state, or "random
//! updates" from sequences. Kapturowski et al., "Recurrent experience replay in distributed
//! reinforcement learning", 2019 (R2D2): the burn-in, here from the zero state, because no states
//! are stored. Ni et al., "Recurrent model-free RL can be a strong baseline for many POMDPs", 2022:
//! all episodes are equally likely, whatever their length, and the loss is the mean over all steps
//! that count.

use std::collections::VecDeque;

use crate::agent::dueling_dqn::{DuelingDqn, Experience, target, value_after};
use crate::agent::memory::{self, OutOfMemory, reserve};
use crate::agent::replay::{Replay, Sampled, TerminalTarget, Transition};
use crate::env::{Action, EpisodeStatus, Observations};
use crate::rng::Stream;
use crate::state::resumable;

/// Name of the memory in messages.
const BATCH: &str = "a batch of episodes";

/// Sequences of steps, side by side. Row t * lanes + l of every array belongs to step t of sequence
/// l. Every sequence starts with an empty memory. The state after its last step follows, and then
/// padding with zeros.
#[derive(Clone, Debug)]
pub struct SequenceBatch {
    /// The number of sequences.
    pub lanes: usize,
    /// The states.
    pub observations: Observations,
    /// \[rows\]: the actions taken in these states.
    pub actions: Vec<Action>,
    /// \[rows\]: targets of the values of these actions.
    pub targets: Vec<f32>,
    /// \[rows\]: whether the row counts in the loss.
    pub learned: Vec<bool>,
    /// \[rows\]: whether the row is the first of its sequence.
    pub firsts: Vec<bool>,
    /// \[rows\]: whether the row is the first that counts, after burn-in rows that only warm up the
    /// memory. No gradient passes from it to the row before.
    pub cuts: Vec<bool>,
}

impl SequenceBatch {
    /// An empty batch for observations of this shape.
    pub fn new(mut observations: Observations) -> Self {
        observations.clear();
        SequenceBatch {
            lanes: 0,
            observations,
            actions: Vec::new(),
            targets: Vec::new(),
            learned: Vec::new(),
            firsts: Vec::new(),
            cuts: Vec::new(),
        }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.actions.len()
    }

    /// Number of rows that count.
    pub fn steps(&self) -> usize {
        self.learned.iter().filter(|learned| **learned).count()
    }

    fn clear(&mut self, lanes: usize) {
        self.lanes = lanes;
        self.observations.clear();
        self.actions.clear();
        self.targets.clear();
        self.learned.clear();
        self.firsts.clear();
        self.cuts.clear();
    }

    fn reserve(&mut self, rows: usize) -> Result<(), OutOfMemory> {
        let bytes = rows * self.observations.width() * size_of::<f32>();
        let refused = OutOfMemory { what: BATCH, bytes };
        memory::permit(bytes, BATCH)?;
        self.observations.try_reserve(rows).map_err(|_| refused)?;
        reserve(&mut self.actions, rows, BATCH)?;
        reserve(&mut self.targets, rows, BATCH)?;
        reserve(&mut self.learned, rows, BATCH)?;
        reserve(&mut self.firsts, rows, BATCH)?;
        reserve(&mut self.cuts, rows, BATCH)
    }
}

/// A stored episode: the position of its first transition, and its length.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Episode {
    start: usize,
    len: usize,
}

/// The part of an episode that a batch contains.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Sequence {
    /// Position of the first transition.
    start: usize,
    /// Number of burn-in transitions, which only warm up the memory.
    skipped: usize,
    /// Number of transitions, burn-in included.
    len: usize,
}

/// The latest whole episodes. When space runs out, the oldest episode is dropped.
#[derive(Clone, Debug)]
pub struct EpisodeReplay {
    replay: Replay,
    /// Stored episodes, oldest first.
    episodes: VecDeque<Episode>,
    /// Number of transitions of the running episode.
    running: usize,
    sampled: Sampled,
    /// Buffer for drawn indices.
    drawn: Vec<usize>,
    pub(super) sequences: Vec<Sequence>,
    zeros: Vec<f32>,
}

impl EpisodeReplay {
    /// An empty buffer of at most `capacity` transitions, for observations of this shape.
    pub fn new(
        capacity: usize,
        observations: &Observations,
        terminal_target: TerminalTarget,
    ) -> Self {
        EpisodeReplay {
            replay: Replay::new(capacity, observations, terminal_target),
            episodes: VecDeque::new(),
            running: 0,
            sampled: Sampled::default(),
            drawn: Vec::new(),
            sequences: Vec::new(),
            zeros: vec![0.0; observations.width()],
        }
    }

    /// Number of whole episodes stored.
    pub fn episodes(&self) -> usize {
        self.episodes.len()
    }

    /// Stores the next transition of the running episode; see [`Replay::push`].
    ///
    /// **Errors**: memory is short; the buffer cannot be used afterwards.
    pub fn push(
        &mut self,
        before: &Observations,
        transition: Transition,
        after: &Observations,
    ) -> Result<(), OutOfMemory> {
        let position = self.replay.next_position();
        let is_full = self.replay.len() == self.replay.capacity();
        if is_full && self.episodes.front().is_some_and(|oldest| oldest.start == position) {
            self.episodes.pop_front();
        }
        self.replay.push(before, transition, after)?;
        self.running += 1;
        if transition.status != EpisodeStatus::Running {
            let (len, capacity) = (self.running, self.replay.capacity());
            self.running = 0;
            // An episode longer than the capacity has overwritten its own beginning.
            if len <= capacity {
                let start = (position + capacity + 1 - len) % capacity;
                self.episodes.try_reserve(1).map_err(|_| OutOfMemory {
                    what: "the replay buffer",
                    bytes: (self.episodes.len() + 1) * size_of::<Episode>(),
                })?;
                self.episodes.push_back(Episode { start, len });
            }
        }
        Ok(())
    }

    /// Replaces a batch by `lanes` sequences of different episodes; every set of episodes is
    /// equally likely. If `steps` is 0 or at least the length of the episode, the sequence is the
    /// whole episode. Otherwise it has `steps` steps from a random step on, preceded by up to
    /// `burn_in` steps that do not count. Targets are left at 0.
    ///
    /// **Errors**: memory is short.
    pub fn draw(
        &mut self,
        lanes: usize,
        [steps, burn_in]: [usize; 2],
        stream: &mut Stream,
        batch: &mut SequenceBatch,
    ) -> Result<(), OutOfMemory> {
        let EpisodeReplay { episodes, sampled, drawn, sequences, .. } = self;
        drawn.resize(lanes, 0);
        sampled.draw(episodes.len(), stream, drawn);
        sequences.clear();
        reserve(sequences, lanes, BATCH)?;
        let capacity = self.replay.capacity();
        sequences.extend(drawn.iter().map(|episode| {
            let Episode { start, len } = episodes[*episode];
            if steps == 0 || steps >= len {
                return Sequence { start, skipped: 0, len };
            }
            let first = stream.below((len - steps) as u32 + 1) as usize;
            let skipped = burn_in.min(first);
            Sequence { start: (start + first - skipped) % capacity, skipped, len: skipped + steps }
        }));
        self.gather(batch)
    }

    /// Writes the sequences to a batch.
    fn gather(&self, batch: &mut SequenceBatch) -> Result<(), OutOfMemory> {
        let lanes = self.sequences.len();
        let longest = self.sequences.iter().map(|sequence| sequence.len).max().unwrap_or(0);
        batch.clear(lanes);
        batch.reserve((longest + 1) * lanes)?;
        let moment = (batch.observations.one_hot() > 0).then_some(0);
        for step in 0..=longest {
            for sequence in &self.sequences {
                let taken = self.position(sequence, step);
                match (taken, step.checked_sub(1).and_then(|step| self.position(sequence, step))) {
                    (Some(position), _) => {
                        self.replay.push_before(position, &mut batch.observations)
                    }
                    (None, Some(last)) => self.replay.push_after(last, &mut batch.observations),
                    (None, None) => batch.observations.push(&self.zeros, moment),
                }
                let action = taken.map(|position| self.replay.transition(position).action);
                batch.actions.push(action.unwrap_or(Action::NONE));
                batch.learned.push(taken.is_some() && step >= sequence.skipped);
                batch.firsts.push(step == 0);
                batch.cuts.push(step > 0 && step == sequence.skipped);
                batch.targets.push(0.0);
            }
        }
        Ok(())
    }

    /// The position of a step of a sequence; `None` after its end.
    fn position(&self, sequence: &Sequence, step: usize) -> Option<usize> {
        (step < sequence.len).then(|| (sequence.start + step) % self.replay.capacity())
    }

    /// The transition of a step of a sequence in the last draw; `None` after its end.
    pub(super) fn transition(&self, lane: usize, step: usize) -> Option<Transition> {
        let position = self.position(&self.sequences[lane], step);
        position.map(|position| self.replay.transition(position))
    }
}

impl EpisodeReplay {
    /// Whether all stored actions are among the first `count`.
    pub(super) fn fits(&self, count: usize) -> bool {
        self.replay.fits(count)
    }
}

resumable!([] Episode { parts start, len });
resumable!([] EpisodeReplay { parts replay, episodes, running; check is_whole, "episodes" });

impl EpisodeReplay {
    /// Whether the episodes are stored and adjacent, up to the running one.
    fn is_whole(&self) -> bool {
        let (stored, capacity) = (self.replay.len(), self.replay.capacity());
        let is_stored =
            |episode: &Episode| episode.start < stored && (1..=stored).contains(&episode.len);
        let mut pairs = self.episodes.iter().zip(self.episodes.iter().skip(1));
        self.episodes.iter().all(is_stored)
            && pairs.all(|(one, next)| (one.start + one.len) % capacity == next.start)
            && self.episodes.back().is_none_or(|last| {
                (last.start + last.len + self.running) % capacity == self.replay.next_position()
            })
            && self.episodes.iter().map(|episode| episode.len).sum::<usize>() <= stored
    }
}

/// The latest episodes, and the sequences of a batch.
pub struct Episodes {
    replay: EpisodeReplay,
    batch: SequenceBatch,
    values: Vec<f32>,
}

impl Experience for Episodes {
    type Batch = SequenceBatch;
    type States = SequenceBatch;

    fn new(parameters: &DuelingDqn, none: &Observations) -> Self {
        let DuelingDqn { buffer, terminal_target, .. } = *parameters;
        Episodes {
            replay: EpisodeReplay::new(buffer as usize, none, terminal_target),
            batch: SequenceBatch::new(none.clone()),
            values: Vec::new(),
        }
    }

    fn push(
        &mut self,
        before: &Observations,
        transition: Transition,
        after: &Observations,
    ) -> Result<(), OutOfMemory> {
        self.replay.push(before, transition, after)
    }

    fn stored(&self) -> usize {
        self.replay.episodes()
    }

    fn fits(&self, count: usize) -> bool {
        self.replay.fits(count)
    }

    /// Targets are computed anew for every batch.
    fn forget_targets(&mut self) {}

    /// The target network computes its own states from the steps of the batch.
    fn draw(
        &mut self,
        parameters: &DuelingDqn,
        stream: &mut Stream,
        mut target_values: impl FnMut(&SequenceBatch, &mut Vec<f32>),
    ) -> Result<&SequenceBatch, OutOfMemory> {
        let Episodes { replay, batch, values } = self;
        let DuelingDqn { batch: count, sequence, burn_in, gamma, terminal_target, .. } =
            *parameters;
        let steps = [sequence, burn_in].map(|steps| steps as usize);
        replay.draw(count as usize, steps, stream, batch)?;
        target_values(batch, values);
        let (lanes, actions) = (batch.lanes, values.len() / batch.rows());
        for row in 0..batch.rows() {
            if !batch.learned[row] {
                continue;
            }
            let Some(transition) = replay.transition(row % lanes, row / lanes) else { continue };
            let next = (row + lanes) * actions;
            let values = &values[next..next + actions];
            batch.targets[row] =
                target(&transition, value_after(&transition, values), gamma, terminal_target);
        }
        Ok(batch)
    }
}

resumable!([] Episodes { parts replay });
