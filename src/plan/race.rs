//! The race of a search: which arms have left, which jobs come next, and which setting has won.
//!
//! In: a manifest with a `[search]`, and the results of jobs. Out: the [`Races`] of its agents, and the manifest at the
//! stage that its races have come to, whose jobs are the ones that are wanted so far. Both follow from the manifest
//! and the results alone, so that a race that was killed, divided or moved to another machine has the same end.
//!
//! An arm is a drawn setting. The arms of a rung have the same seeds. In several scenarios or environments, the value
//! of an arm for a seed is its mean over them. Where every job of a rung has ended, arms leave: all but the best share,
//! or those with evidence against them. The last arm, or the best one after the last rung, has won; it gets the fresh
//! seeds, which no arm has raced with.

use std::collections::{HashMap, HashSet};
use std::fmt;
use std::sync::Arc;

use super::expand::of_agent;
use super::rung::{Entrant, Rung, kept, mean_score};
use super::staged::Staged;
use crate::job::{JobKey, MetricName, Score, counted};
use crate::key::{Parameter, Value, printable};
use crate::manifest::{Grid, Leaving, Manifest, Search, Stage};

/// The races of a manifest.
#[derive(Clone, Debug, PartialEq)]
pub struct Races {
    /// One for each agent with draws, in the order of the manifest.
    pub races: Vec<Race>,
    /// The agents without draws, which winners are compared with.
    pub references: Vec<Reference>,
}

/// An agent without draws, on the fresh seeds.
#[derive(Clone, Debug, PartialEq)]
pub struct Reference {
    /// The agent's name.
    pub agent: String,
    /// Its value for each fresh seed.
    pub fresh: Vec<Score>,
}

/// The race of the arms of one agent.
#[derive(Clone, Debug, PartialEq)]
pub struct Race {
    /// The agent's name.
    pub agent: String,
    /// For each arm, its drawn values by parameter.
    pub settings: Vec<Vec<(Parameter, Value)>>,
    /// The rungs that the race has come to.
    pub rungs: Vec<Rung>,
    /// Where it stands.
    pub outcome: RaceOutcome,
    /// The agent's index in the manifest.
    index: usize,
    stage: Arc<Stage>,
}

/// Where a race stands.
#[derive(Clone, Debug, PartialEq)]
pub enum RaceOutcome {
    /// Jobs of the last rung have not ended.
    Running,
    /// An arm has won.
    Won {
        /// The arm.
        arm: usize,
        /// Its value for each fresh seed.
        fresh: Vec<Score>,
    },
    /// No arm is left, because every arm has a job that failed or that has no finite value.
    Lost,
}

/// The smallest and largest number of jobs that races can need, if no job fails.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RaceJobs {
    /// The smallest number.
    pub least: u64,
    /// The largest number.
    pub most: u64,
}

/// What a race has cost, and what the grid of its settings would cost: every setting with all seeds of the race. Work
/// is in multiply-adds, as for shards.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cost {
    /// The jobs of the race.
    pub jobs: u64,
    /// Their work.
    pub work: u128,
    /// The jobs of the grid.
    pub grid_jobs: u64,
    /// Their work.
    pub grid_work: u128,
}

impl Races {
    /// The races of a manifest, which have come as far as its jobs have ended; `scores` returns the results of jobs,
    /// in order. `None` if the manifest has no search.
    ///
    /// **Errors**: those of `scores`.
    pub fn of<E>(
        manifest: &Manifest,
        mut scores: impl FnMut(&[JobKey], MetricName) -> Result<Vec<Score>, E>,
    ) -> Result<Option<Races>, E> {
        let Some(search) = &manifest.search else { return Ok(None) };
        let mut races = Races { races: Vec::new(), references: Vec::new() };
        for (index, agent) in manifest.agents.iter().enumerate() {
            if Grid::of(manifest, index).count() == 0 {
                continue;
            }
            let mut course = Course { manifest, search, index, scores: &mut scores };
            if agent.draws.is_empty() {
                let fresh = course.fresh(0, None)?;
                races.references.push(Reference { agent: agent.name.clone(), fresh });
            } else {
                races.races.push(course.run()?);
            }
        }
        Ok(Some(races))
    }

    /// Whether all jobs that the races will ever want have ended.
    pub fn have_ended(&self) -> bool {
        let is_open = |reference: &Reference| reference.fresh.contains(&Score::Open);
        self.races.iter().all(Race::has_ended) && !self.references.iter().any(is_open)
    }

    /// The manifest at the stage of its races.
    pub fn stage<'m>(&self, manifest: &'m Manifest) -> Staged<'m> {
        let races = self.races.iter();
        races.fold(Staged::whole(manifest), |all, race| all.with(race.index, race.stage.clone()))
    }
}

/// Manifests at the stage that their races have come to; `scores` returns the results of jobs, in order.
///
/// **Errors**: those of `scores`.
pub fn at_stage<E>(
    manifests: &[Manifest],
    mut scores: impl FnMut(&[JobKey], MetricName) -> Result<Vec<Score>, E>,
) -> Result<Vec<Staged<'_>>, E> {
    let staged = |manifest| {
        let races = Races::of(manifest, &mut scores)?;
        Ok(races.map_or_else(|| Staged::whole(manifest), |races| races.stage(manifest)))
    };
    manifests.iter().map(staged).collect()
}

/// The jobs that the races of a manifest can need; `None` if it has no search.
pub fn race_jobs(manifest: &Manifest) -> Option<RaceJobs> {
    let search = manifest.search.as_ref()?;
    let mut jobs = RaceJobs::default();
    for (index, agent) in manifest.agents.iter().enumerate() {
        let count = Grid::of(manifest, index).count();
        if agent.draws.is_empty() {
            jobs = RaceJobs { least: jobs.least + count, most: jobs.most + count };
            continue;
        }
        let seeds = search.race_seeds() + search.fresh_count();
        // The scenarios and environments of an arm.
        let each = count / (seeds * search.samples) as u64;
        let [least, most] = seeds_of_arms(search);
        let fresh = search.fresh_count() as u64;
        jobs.least += each * (least + fresh);
        jobs.most += each * (most + fresh);
    }
    Some(jobs)
}

/// The number of jobs in words.
impl fmt::Display for RaceJobs {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.least == self.most {
            true => f.write_str(&counted(self.most, "job")),
            false => write!(f, "at least {} and at most {} jobs", self.least, self.most),
        }
    }
}

/// The races of a manifest and their jobs, in words; `None` if it has no search.
pub fn race_line(manifest: &Manifest) -> Option<String> {
    let (search, jobs) = (manifest.search.as_ref()?, race_jobs(manifest)?);
    let raced = manifest.agents.iter().enumerate();
    let raced = raced
        .filter(|(index, agent)| !agent.draws.is_empty() && Grid::of(manifest, *index).count() > 0);
    let names: Vec<String> = raced.map(|(_, agent)| printable(&agent.name)).collect();
    let (samples, last) = (search.samples, counted(search.race_seeds(), "seed"));
    Some(format!(
        "a race of {samples} settings of {} over up to {last}, and {}: {jobs}",
        names.join(" and of "),
        counted(search.fresh_count(), "fresh seed"),
    ))
}

/// The smallest and the largest sum over arms of the numbers of their seeds in the race.
fn seeds_of_arms(search: &Search) -> [u64; 2] {
    let (all, last) = (search.samples as u64, search.race_seeds() as u64);
    match search.leaving {
        Leaving::Share(keep) => {
            let (mut arms, mut before, mut sum) = (search.samples, 0, 0);
            for seeds in &search.rungs {
                sum += (arms * (seeds - before)) as u64;
                (arms, before) = (kept(keep, arms), *seeds);
                if arms == 1 {
                    break;
                }
            }
            [sum; 2]
        }
        // All arms but one leave after the first rung, or none before the last.
        Leaving::Evidence(_) => [all * search.rungs[0] as u64, all * last],
    }
}

/// The course of one agent's race.
struct Course<'a, S> {
    manifest: &'a Manifest,
    search: &'a Search,
    index: usize,
    scores: &'a mut S,
}

impl<E, S: FnMut(&[JobKey], MetricName) -> Result<Vec<Score>, E>> Course<'_, S> {
    /// Runs the race as far as its jobs have ended.
    fn run(&mut self) -> Result<Race, E> {
        let arms = self.search.samples;
        let mut stage = Stage { seeds: vec![0; arms], winner: None };
        let (mut rungs, mut outcome) = (Vec::new(), RaceOutcome::Running);
        let mut entrants: Vec<usize> = (0..arms).collect();
        for (at, seeds) in self.search.rungs.iter().enumerate() {
            entrants.iter().for_each(|arm| stage.seeds[*arm] = *seeds);
            let table = self.scores(Some(Arc::new(stage.clone())))?;
            let is_last = at + 1 == self.search.rungs.len();
            let rung = Rung::of(self.search, &entrants, *seeds, is_last, &table);
            entrants = rung.going_on().collect();
            entrants.sort_unstable();
            let (is_open, winner) = (rung.open > 0, rung.winner());
            rungs.push(rung);
            match winner {
                _ if is_open => break,
                Some(arm) => {
                    stage.winner = Some(arm);
                    outcome = RaceOutcome::Won { arm, fresh: Vec::new() };
                    break;
                }
                None if entrants.is_empty() => outcome = RaceOutcome::Lost,
                None => continue,
            }
            break;
        }
        let stage = Arc::new(stage);
        if let RaceOutcome::Won { arm, fresh } = &mut outcome {
            *fresh = self.fresh(*arm, Some(stage.clone()))?;
        }
        let agent = &self.manifest.agents[self.index];
        let drawn = |arm: usize| {
            let value = |parameter: Parameter| {
                agent.parameters.get(parameter.key()).and_then(|values| values.get(arm)).cloned()
            };
            let values = agent.draws.iter().filter_map(|(one, _)| Some((*one, value(*one)?)));
            values.collect()
        };
        let settings = (0..arms).map(drawn).collect();
        Ok(Race { agent: agent.name.clone(), settings, rungs, outcome, index: self.index, stage })
    }

    /// The value of an arm for each fresh seed, at a stage.
    fn fresh(&mut self, arm: usize, stage: Option<Arc<Stage>>) -> Result<Vec<Score>, E> {
        let table = self.scores(stage)?;
        let first = self.search.race_seeds();
        let seeds = first..first + self.search.fresh_count();
        Ok(seeds.map(|seed| table.get(&(arm, seed)).copied().unwrap_or(Score::Open)).collect())
    }

    /// The value of every arm for every seed at a stage, by arm and index of the seed: the mean over scenarios and
    /// environments, once all of their jobs have ended.
    fn scores(&mut self, stage: Option<Arc<Stage>>) -> Result<HashMap<(usize, usize), Score>, E> {
        let grid = Grid::at(self.manifest, self.index, stage.clone());
        let cells = std::iter::successors(grid.first(), |cell| grid.after(cell));
        let entrants = cells.filter_map(|cell| grid.entrant(&cell));
        let keys: Vec<JobKey> =
            of_agent(self.manifest, self.index, stage).map(|planned| planned.form.key()).collect();
        let scores = (self.scores)(&keys, self.search.metric)?;
        let mut all: HashMap<(usize, usize), Vec<Score>> = HashMap::new();
        for (entrant, score) in entrants.zip(scores) {
            all.entry(entrant).or_default().push(score);
        }
        Ok(all.into_iter().map(|(entrant, scores)| (entrant, mean_score(&scores))).collect())
    }
}

impl Race {
    /// The jobs and the work of the race up to now, and of the grid of its settings. `manifest` is the manifest of the
    /// race.
    pub fn cost(&self, manifest: &Manifest) -> Cost {
        let raced = manifest.search.as_ref().map_or(0, Search::race_seeds);
        let sum = |stage: Option<Arc<Stage>>| {
            let grid = Grid::at(manifest, self.index, stage.clone());
            let cells = std::iter::successors(grid.first(), |cell| grid.after(cell));
            let is_raced =
                cells.map(|cell| grid.entrant(&cell).is_some_and(|(_, seed)| seed < raced));
            let jobs = of_agent(manifest, self.index, stage).zip(is_raced);
            jobs.filter(|(_, is_raced)| *is_raced).fold((0, 0), |(jobs, work), (planned, _)| {
                (jobs + 1, work + u128::from(planned.job.work()))
            })
        };
        let (jobs, work) = sum(Some(self.stage.clone()));
        let (grid_jobs, grid_work) = sum(None);
        Cost { jobs, work, grid_jobs, grid_work }
    }

    /// The seeds of an arm so far, in the race.
    pub fn seeds(&self, arm: usize) -> usize {
        self.stage.seeds[arm]
    }

    /// Every arm in its last rung, with the number of the rung from 0: those of the last rung first, each rung with its
    /// best arms first.
    pub fn arms(&self) -> Vec<(usize, &Rung, &Entrant)> {
        let mut known = HashSet::new();
        let rungs = self.rungs.iter().enumerate().rev();
        let arms =
            rungs.flat_map(|(at, rung)| rung.entrants.iter().map(move |one| (at, rung, one)));
        arms.filter(|(_, _, entrant)| known.insert(entrant.arm)).collect()
    }

    /// An arm in each of its rungs, with the number of the rung from 0.
    pub fn course(&self, arm: usize) -> Vec<(usize, &Entrant)> {
        let rungs = self.rungs.iter().enumerate();
        let entrants = rungs.flat_map(|(at, rung)| rung.entrants.iter().map(move |one| (at, one)));
        entrants.filter(|(_, entrant)| entrant.arm == arm).collect()
    }

    /// The number of arms in the race: those of its last rung, or the winner.
    pub fn arms_left(&self) -> usize {
        match self.outcome {
            RaceOutcome::Running => self.rungs.last().map_or(0, |rung| rung.entrants.len()),
            RaceOutcome::Won { .. } => 1,
            RaceOutcome::Lost => 0,
        }
    }

    /// The fresh seeds of the winner whose jobs have not ended.
    pub fn open_fresh_seeds(&self) -> usize {
        match &self.outcome {
            RaceOutcome::Won { fresh, .. } => {
                fresh.iter().filter(|score| **score == Score::Open).count()
            }
            RaceOutcome::Running | RaceOutcome::Lost => 0,
        }
    }

    /// Where the race stands and what comes next, in words.
    pub fn state(&self, search: &Search) -> String {
        match &self.outcome {
            RaceOutcome::Running => {
                let (at, of) = (self.rungs.len(), search.rungs.len());
                let open = self.rungs.last().map_or(0, |rung| rung.open);
                let arms = counted(self.arms_left(), "arm");
                let next = self.next(search);
                format!("rung {at} of {of}: {open} of {arms} open; next, {next}")
            }
            RaceOutcome::Won { arm, .. } => {
                let left = match self.open_fresh_seeds() {
                    0 => String::new(),
                    open => format!("; {} open", counted(open, "fresh seed")),
                };
                format!("arm {} of {} has won{left}", arm + 1, self.settings.len())
            }
            RaceOutcome::Lost => format!(
                "no arm is left: every arm has a job that failed or has no finite {}; \
                 --retry-failed runs failed jobs again",
                search.metric
            ),
        }
    }

    /// What follows the present rung, in words.
    fn next(&self, search: &Search) -> String {
        let seeds = search.rungs.get(self.rungs.len()).map(|seeds| counted(*seeds, "seed"));
        match (seeds, search.leaving) {
            (Some(seeds), Leaving::Evidence(_)) => {
                format!("arms shown to be worse leave, and the others go on to {seeds}")
            }
            (Some(seeds), Leaving::Share(keep)) if kept(keep, self.arms_left()) > 1 => {
                format!("the best {} go on to {seeds}", kept(keep, self.arms_left()))
            }
            (Some(_), Leaving::Share(_)) | (None, _) => {
                format!("the best gets {}", counted(search.fresh_count(), "fresh seed"))
            }
        }
    }

    /// Whether all of its jobs have ended.
    pub fn has_ended(&self) -> bool {
        match self.outcome {
            RaceOutcome::Running => false,
            RaceOutcome::Won { .. } => self.open_fresh_seeds() == 0,
            RaceOutcome::Lost => true,
        }
    }
}
