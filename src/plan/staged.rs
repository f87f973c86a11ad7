//! A manifest at the stage that its races have come to, and its jobs.

use std::ops::Deref;
use std::ptr;
use std::sync::Arc;

use super::expand::of_agent;
use crate::job::PlannedJob;
use crate::manifest::{Grid, Manifest, Stage};

/// A manifest at the stage that its races have come to: the jobs of a search that are wanted so far. A manifest without
/// a search has one stage.
#[derive(Clone, Debug)]
pub struct Staged<'m> {
    manifest: &'m Manifest,
    /// By agent; `None` for all jobs that its race may come to, and without a race.
    stages: Vec<Option<Arc<Stage>>>,
}

impl<'m> Staged<'m> {
    /// A manifest with all jobs that its races may come to.
    pub fn whole(manifest: &'m Manifest) -> Staged<'m> {
        Staged { manifest, stages: vec![None; manifest.agents.len()] }
    }

    /// The manifest with the race of the agent at this index at a stage.
    pub(super) fn with(mut self, agent: usize, stage: Arc<Stage>) -> Staged<'m> {
        self.stages[agent] = Some(stage);
        self
    }

    /// The manifest.
    pub fn manifest(&self) -> &'m Manifest {
        self.manifest
    }

    /// The number of jobs, without expanding them.
    pub fn count(&self) -> u64 {
        let stages = self.stages.iter().enumerate();
        stages.map(|(agent, stage)| Grid::at(self.manifest, agent, stage.clone()).count()).sum()
    }

    /// The jobs, one at a time, in the order of [`jobs`].
    pub fn jobs(&self) -> impl Iterator<Item = PlannedJob> + use<'m> {
        let manifest = self.manifest;
        let stages = self.stages.clone().into_iter().enumerate();
        stages.flat_map(move |(agent, stage)| of_agent(manifest, agent, stage))
    }
}

impl Deref for Staged<'_> {
    type Target = Manifest;

    fn deref(&self) -> &Manifest {
        self.manifest
    }
}

/// The same manifest at the same stage.
impl PartialEq for Staged<'_> {
    fn eq(&self, other: &Self) -> bool {
        ptr::eq(self.manifest, other.manifest) && self.stages == other.stages
    }
}

/// The number of jobs that [`jobs`] yields, without expanding them.
pub fn count(manifest: &Manifest) -> u64 {
    Staged::whole(manifest).count()
}

/// The jobs of a manifest, one at a time; of a search, all that its races may come to.
///
/// Agents come in the order of the manifest. The jobs of an agent are ordered by scenario; then by swept keys
/// of environment, agent and evaluation, in the order of their tables; then by seed. Seeds advance fastest.
/// Parameters of a zip advance together, at the position of the first one. Two agents with equal content give
/// equal jobs, each with its own agent's name.
pub fn jobs(manifest: &Manifest) -> impl Iterator<Item = PlannedJob> + use<'_> {
    Staged::whole(manifest).jobs()
}

/// All of a manifest's jobs, in the order of [`jobs`].
pub fn expand(manifest: &Manifest) -> Vec<PlannedJob> {
    jobs(manifest).collect()
}
