//! The experience of a dueling DQN without memory: single transitions.

use crate::agent::dueling_dqn::{DuelingDqn, Experience, target, value_after};
use crate::agent::memory::OutOfMemory;
use crate::agent::replay::{Batch, Replay, Transition};
use crate::env::Observations;
use crate::rng::Stream;
use crate::state::resumable;

/// The latest transitions. Targets are computed once per period of the target network.
pub struct Transitions {
    pub(super) replay: Replay,
    positions: Vec<usize>,
    batch: Batch,
    /// Drawn positions whose target is unknown.
    unknown: Vec<usize>,
    next: Observations,
    values: Vec<f32>,
}

impl Transitions {
    /// Computes the unknown targets of the drawn transitions. The target network changes only once
    /// per period, so targets stay valid until the period ends.
    fn learn_targets(
        &mut self,
        parameters: &DuelingDqn,
        mut target_values: impl FnMut(&Observations, &mut Vec<f32>),
    ) -> Result<(), OutOfMemory> {
        let Transitions { replay, positions, unknown, next, values, .. } = self;
        unknown.clear();
        next.clear();
        for &position in positions.iter() {
            if replay.target(position).is_none() {
                unknown.push(position);
                replay.push_after(position, next);
            }
        }
        if unknown.is_empty() {
            return Ok(());
        }
        target_values(next, values);
        let DuelingDqn { gamma, terminal_target, .. } = *parameters;
        let actions = values.len() / unknown.len();
        for (&position, values) in unknown.iter().zip(values.chunks_exact(actions)) {
            let transition = replay.transition(position);
            let target =
                target(&transition, value_after(&transition, values), gamma, terminal_target);
            replay.set_target(position, target)?;
        }
        Ok(())
    }
}

impl Experience for Transitions {
    type Batch = Batch;
    type States = Observations;

    fn new(parameters: &DuelingDqn, none: &Observations) -> Self {
        let batch = Batch { observations: none.clone(), actions: Vec::new(), targets: Vec::new() };
        Transitions {
            replay: Replay::new(parameters.buffer as usize, none, parameters.terminal_target),
            positions: vec![0; parameters.batch as usize],
            batch,
            unknown: Vec::new(),
            next: none.clone(),
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
        self.replay.len()
    }

    fn fits(&self, count: usize) -> bool {
        self.replay.fits(count)
    }

    fn forget_targets(&mut self) {
        self.replay.forget_targets();
    }

    fn draw(
        &mut self,
        parameters: &DuelingDqn,
        stream: &mut Stream,
        target_values: impl FnMut(&Observations, &mut Vec<f32>),
    ) -> Result<&Batch, OutOfMemory> {
        self.replay.draw(stream, &mut self.positions);
        self.learn_targets(parameters, target_values)?;
        self.replay.gather(&self.positions, &mut self.batch);
        Ok(&self.batch)
    }
}

resumable!([] Transitions { parts replay });
