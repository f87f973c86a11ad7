//! The stage of a race, and the cells of a grid that it has come to.

use std::sync::Arc;

/// The arms of an agent and their seeds at one stage of its race.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stage {
    /// For each arm, the number of its seeds so far.
    pub seeds: Vec<usize>,
    /// The arm that has won and is tested on the fresh seeds.
    pub winner: Option<usize>,
}

/// The cells of an agent that its race has come to, or may come to.
#[derive(Debug)]
pub(in crate::manifest) struct RaceCells {
    /// The axis of the arms; `None` for an agent without draws, which has the fresh seeds alone.
    pub arms: Option<usize>,
    /// The axis of the seeds: first the seeds of the race, then the fresh ones.
    pub seeds: usize,
    /// The number of seeds of the race.
    pub raced: usize,
    /// `None` for all cells that the race may come to.
    pub stage: Option<Arc<Stage>>,
}

impl RaceCells {
    /// The axes on which the race leaves out cells: none before it has a stage, and the seeds without draws.
    pub fn divided(&self) -> impl Iterator<Item = usize> {
        let seeds = (self.stage.is_some() || self.arms.is_none()).then_some(self.seeds);
        self.arms.filter(|_| self.stage.is_some()).into_iter().chain(seeds)
    }

    /// Whether the cell with these positions on the axes belongs to the race.
    pub fn has(&self, cell: &[usize]) -> bool {
        let seed = cell[self.seeds];
        match (self.arms.map(|axis| cell[axis]), self.stage.as_deref()) {
            (None, _) => seed >= self.raced,
            (Some(_), None) => true,
            (Some(arm), Some(stage)) if seed >= self.raced => stage.winner == Some(arm),
            (Some(arm), Some(stage)) => stage.seeds.get(arm).is_some_and(|seeds| seed < *seeds),
        }
    }
}
