//! Tests of the recurrent dueling DQN's learner and replay buffer: the batches that an engine
//! receives.

use super::*;
use crate::agent::learner::{Learner, SpanEnd};
use crate::env::{Action, PhysicalActivity, StepCount};
use crate::rng::{Purpose, Stream};
use crate::state::{Resumable, StateReader, StateWriter, resumable};

fn observation(number: f32) -> Observations {
    let mut observation = Observations::new(1, 0);
    observation.push(&[number], None);
    observation
}

/// Stores an episode whose states are `first`, `first + 1`, …
fn push(replay: &mut EpisodeReplay, first: u32, len: u32) {
    for step in 0..len {
        let status =
            if step + 1 == len { EpisodeStatus::Truncated } else { EpisodeStatus::Running };
        let number = (first + step) as f32;
        let action = Action::uniform(u64::from(step), 4);
        let transition = Transition { action, reward: 10.0 * number, status, is_withheld: false };
        replay.push(&observation(number), transition, &observation(number + 1.0)).unwrap();
    }
}

fn replay(capacity: usize) -> EpisodeReplay {
    EpisodeReplay::new(capacity, &Observations::new(1, 0), TerminalTarget::Standard)
}

/// The states of each sequence, including the state after its last step.
fn states(batch: &SequenceBatch) -> Vec<Vec<f32>> {
    let of_lane = |lane: usize| {
        let rows = (lane..batch.rows()).step_by(batch.lanes);
        rows.map(|row| batch.observations.row(row)[0]).collect()
    };
    (0..batch.lanes).map(of_lane).collect()
}

#[test]
fn a_batch_has_different_whole_episodes_with_the_state_behind_them() {
    let mut replay = replay(100);
    let mut batch = SequenceBatch::new(Observations::new(1, 0));
    let mut stream = Stream::new(1, Purpose::Replay);
    for (first, len) in [(10, 3), (20, 5), (30, 1)] {
        push(&mut replay, first, len);
    }
    replay.draw(3, [0, 0], &mut stream, &mut batch).unwrap();
    let mut drawn = states(&batch);
    drawn.sort_by(|a, b| a[0].total_cmp(&b[0]));
    assert_eq!(
        drawn,
        [
            [10.0, 11.0, 12.0, 13.0, 0.0, 0.0],
            [20.0, 21.0, 22.0, 23.0, 24.0, 25.0],
            [30.0, 31.0, 0.0, 0.0, 0.0, 0.0],
        ]
    );
    assert_eq!(batch.steps(), 9);
    assert!(batch.cuts.iter().all(|cut| !cut));
    for row in 0..batch.rows() {
        assert_eq!(batch.firsts[row], row < 3);
        let transition = replay.transition(row % 3, row / 3);
        assert_eq!(batch.learned[row], transition.is_some());
        if let Some(transition) = transition {
            assert_eq!(transition.reward, 10.0 * batch.observations.row(row)[0]);
            assert_eq!(transition.action, batch.actions[row]);
        }
    }
}

#[test]
fn episodes_are_equally_likely_whatever_their_lengths() {
    let mut replay = replay(100);
    let mut batch = SequenceBatch::new(Observations::new(1, 0));
    let mut stream = Stream::new(2, Purpose::Replay);
    for (first, len) in [(100, 40), (200, 1), (300, 9)] {
        push(&mut replay, first, len);
    }
    let mut counts = [0; 3];
    for _ in 0..3000 {
        replay.draw(1, [0, 0], &mut stream, &mut batch).unwrap();
        counts[batch.observations.row(0)[0] as usize / 100 - 1] += 1;
    }
    // 1000 expected, standard deviation 26.
    assert!(counts.iter().all(|count: &i32| (count - 1000).abs() < 104), "{counts:?}");
}

#[test]
fn a_full_buffer_drops_the_oldest_episode_whole() {
    let mut replay = replay(10);
    push(&mut replay, 10, 4);
    push(&mut replay, 20, 4);
    assert_eq!(replay.episodes(), 2);
    // Two slots are free, so the third step overwrites the first episode.
    push(&mut replay, 30, 3);
    assert_eq!(replay.episodes(), 2);
    push(&mut replay, 40, 5);
    assert_eq!(replay.episodes(), 2);
    let mut batch = SequenceBatch::new(Observations::new(1, 0));
    replay.draw(2, [0, 0], &mut Stream::new(1, Purpose::Replay), &mut batch).unwrap();
    let mut drawn = states(&batch);
    drawn.sort_by(|a, b| a[0].total_cmp(&b[0]));
    assert_eq!(drawn, [[30.0, 31.0, 32.0, 33.0, 0.0, 0.0], [40.0, 41.0, 42.0, 43.0, 44.0, 45.0]]);
    // An episode that has overwritten its own beginning is not stored.
    push(&mut replay, 50, 11);
    assert_eq!(replay.episodes(), 0);
}

#[test]
fn a_sequence_stands_anywhere_in_an_episode_behind_its_burn_in() {
    let mut replay = replay(10);
    push(&mut replay, 90, 7);
    // The episode wraps around the end of the buffer.
    push(&mut replay, 0, 8);
    let mut batch = SequenceBatch::new(Observations::new(1, 0));
    let mut stream = Stream::new(3, Purpose::Replay);
    let mut begins = [0; 6];
    for _ in 0..3000 {
        replay.draw(1, [3, 2], &mut stream, &mut batch).unwrap();
        assert_eq!(batch.steps(), 3);
        let first = batch.learned.iter().position(|learned| *learned).unwrap();
        let number = batch.observations.row(first)[0];
        begins[number as usize] += 1;
        assert_eq!(first, 2.min(number as usize));
        let behind = batch.observations.row(first + 3)[0];
        assert_eq!((behind, batch.rows()), (number + 3.0, first + 4));
        let cuts = batch.cuts.iter().enumerate().filter(|(_, cut)| **cut);
        let expected: &[usize] = if first > 0 { &[first] } else { &[] };
        assert_eq!(cuts.map(|(row, _)| row).collect::<Vec<_>>(), expected);
    }
    // 500 expected, standard deviation 20.
    assert!(begins.iter().all(|count: &i32| (count - 500).abs() < 82), "{begins:?}");
    // An episode that is shorter than a sequence is taken whole.
    replay.draw(1, [8, 2], &mut stream, &mut batch).unwrap();
    assert_eq!((batch.steps(), batch.observations.row(0)[0]), (8, 0.0));
}

#[test]
fn a_buffer_is_restored_as_it_was() {
    let mut full = replay(10);
    for (first, len) in [(10, 4), (20, 4), (30, 5)] {
        push(&mut full, first, len);
    }
    let running = Transition {
        action: Action::NONE,
        reward: 1.0,
        status: EpisodeStatus::Running,
        is_withheld: false,
    };
    full.push(&observation(7.0), running, &observation(8.0)).unwrap();
    let mut bytes = Vec::new();
    full.save(&mut StateWriter::new(&mut bytes)).unwrap();
    let mut restored = replay(10);
    let mut from = &bytes[..];
    restored.restore(&mut StateReader::new(&mut from)).unwrap();
    assert!(from.is_empty());
    assert_eq!((restored.episodes(), full.episodes()), (2, 2));
    let drawn = [full, restored].map(|mut replay| {
        let ended = Transition { status: EpisodeStatus::Terminated, ..running };
        replay.push(&observation(8.0), ended, &observation(9.0)).unwrap();
        let mut batch = SequenceBatch::new(Observations::new(1, 0));
        replay.draw(2, [0, 0], &mut Stream::new(1, Purpose::Replay), &mut batch).unwrap();
        states(&batch)
    });
    assert_eq!(drawn[0], drawn[1]);
    assert!(drawn[0].iter().any(|states| states.starts_with(&[7.0, 8.0, 9.0])));
}

/// An engine whose memory is one number, the steps of the episode so far. Its target values are a
/// formula of state and memory, and it checks every batch that it receives.
struct Counting {
    parameters: DuelingDqn,
    renewals: u32,
    updates: u32,
    /// Number of steps taken in the running episode.
    acted: u32,
}

struct Nothing;

impl ActionNetwork for Nothing {
    fn evaluate(&mut self, _: &Observations, _: &mut Vec<f32>) {
        unreachable!("nobody tests it");
    }
}

impl DuelingDqnEngine for Counting {
    type Network = Nothing;
    type Experience = Episodes;

    fn memory(&self) -> usize {
        1
    }

    fn values(&mut self, observations: &Observations, memory: &mut [f32], out: &mut Vec<f32>) {
        assert_eq!((observations.rows(), memory.len()), (1, 1));
        self.acted = if memory[0] == 0.0 { 0 } else { self.acted };
        assert_eq!(memory[0], self.acted as f32, "the memory of the episode alone");
        self.acted += 1;
        memory[0] += 1.0;
        // Without messages nobody disengages.
        *out = vec![1.0, 0.0, 0.0, 0.0];
    }

    fn target_values(&mut self, batch: &SequenceBatch, out: &mut Vec<f32>) {
        // The second action is best; its value encodes the step.
        let rows = 0..batch.rows();
        *out = rows.flat_map(|row| [0.0, 1.0 + (row / batch.lanes) as f32, 0.0, 0.0]).collect();
    }

    fn renew_target(&mut self) {
        assert_eq!(self.updates % self.parameters.target_period, 0);
        self.renewals += 1;
    }

    fn update(&mut self, batch: &SequenceBatch) -> f32 {
        assert_eq!(self.renewals, self.updates / self.parameters.target_period + 1);
        self.updates += 1;
        assert_eq!(batch.lanes, self.parameters.batch as usize);
        for row in (0..batch.rows()).filter(|row| batch.learned[*row]) {
            let step = row / batch.lanes;
            if step == 3 {
                assert_eq!(batch.targets[row], 0.0);
                continue;
            }
            let reward = batch.targets[row] - 0.5 * (2.0 + step as f32);
            assert!((0.0..=1.0).contains(&reward), "{reward} at {step}");
        }
        assert_eq!(batch.steps(), 4 * batch.lanes);
        1.0
    }

    fn network(&self) -> Nothing {
        Nothing
    }

    fn weights(&self) -> Weights {
        Weights::default()
    }
}

resumable!([] Counting {});

#[test]
fn the_recurrent_dqn_learns_from_the_episodes_that_it_played() {
    let parameters = DuelingDqn {
        recurrent: Recurrent::Gru,
        batch: 3,
        buffer: 20,
        target_period: 5,
        gamma: 0.5,
        reward_scale: 200.0,
        update_interval: 2,
        epsilon_start: 0.0,
        epsilon_floor: 0.0,
        terminal_target: TerminalTarget::Zero,
        ..DuelingDqn::default()
    };
    let environment = StepCount { horizon: 4, ..StepCount::paper(0.6) };
    let environment = PhysicalActivity::new(&environment, &"P".parse().unwrap(), 1);
    let engine = Counting { parameters: parameters.clone(), renewals: 0, updates: 0, acted: 0 };
    let mut learner = DuelingDqnLearner::new(engine, &parameters, environment, 1);
    let mut finished = Vec::new();
    for _ in 0..40 {
        assert_eq!(learner.advance(&mut finished, None, &|| false).unwrap(), SpanEnd::Whole);
    }
    let updates: Vec<u32> = finished.iter().map(|episode| episode.updates).collect();
    // The third episode is stored with its last step; after that, two of four steps are followed by
    // an update.
    assert_eq!(updates[..4], [0, 0, 1, 2]);
    assert!(updates[4..].iter().all(|updates| *updates == 2));
    assert!(finished.iter().all(|episode| episode.length == 4));
}
