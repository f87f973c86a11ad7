//! The training episodes of a program in jitai's simulation.

use crate::agent::StepObserver;
use crate::env::{
    Action, EpisodeStatus, LaneSet, LaneStreams, Observations, Simulated, VectorEnvironment,
};
use crate::external::{Program, Reset, SentRows, StepRequest, ToProgram};
use crate::job::{Job, counted};
use crate::rng::{Purpose, Stream};

use super::broken::Broken;
use super::choice::{action, available, of_one, probability};
use super::record::TrainingRecord;

/// The lanes of a training.
pub(super) struct Lanes {
    simulation: Simulated,
    streams: LaneStreams,
    observations: Observations,
    actions: Vec<Action>,
    /// \[lanes, actions\].
    probabilities: Vec<f64>,
    rewards: Vec<f64>,
    /// The return and length of every lane's episode so far.
    episodes: Vec<(f64, u32)>,
}

impl Lanes {
    pub(super) fn new(job: &Job, lanes: usize) -> Lanes {
        let simulation = job.task().simulation(lanes);
        Lanes {
            streams: LaneStreams::Shared(Stream::new(job.seed, Purpose::Environment)),
            observations: simulation.observation_spec().observations(),
            actions: vec![Action::default(); lanes],
            probabilities: vec![0.0; lanes * simulation.action_spec().count],
            rewards: vec![0.0; lanes],
            episodes: vec![(0.0, 0); lanes],
            simulation,
        }
    }

    fn is_running(&self, lane: usize) -> bool {
        self.simulation.statuses()[lane] == EpisodeStatus::Running
    }

    /// Begins episodes and answers with their first observations.
    ///
    /// **Errors**: a description, if a lane cannot begin an episode, or if the budget has too few.
    pub(super) fn reset(
        &mut self,
        reset: &Reset,
        record: &mut TrainingRecord<'_>,
        program: &mut Program,
    ) -> Result<(), String> {
        let lanes = self.simulation.lanes();
        let mut begins = vec![false; lanes];
        match &reset.lanes {
            None => (0..lanes).for_each(|lane| begins[lane] = !self.is_running(lane)),
            Some(named) => {
                for lane in named {
                    if *lane >= lanes {
                        let last = lanes - 1;
                        return Err(format!("expected a lane from 0 to {last}, found {lane}"));
                    }
                    if self.is_running(*lane) {
                        return Err(format!(
                            "expected a lane whose episode has ended, found lane {lane} in mid-episode"
                        ));
                    }
                    if std::mem::replace(&mut begins[*lane], true) {
                        return Err(format!("expected every lane once, found lane {lane} twice"));
                    }
                }
            }
        }
        let begun: Vec<usize> = (0..lanes).filter(|lane| begins[*lane]).collect();
        if begun.is_empty() {
            return Err("expected at least one lane whose episode has ended, found none".to_owned());
        }
        record.begin(begun.len())?;
        self.simulation.reset(LaneSet::Masked(&begins), &mut self.streams);
        begun.iter().for_each(|lane| self.episodes[*lane] = (0.0, 0));
        let values = self.observed();
        let available: Option<Vec<bool>> = self.available(&begun);
        program.send(&ToProgram::Began {
            lanes: &begun,
            observations: self.rows(&values, Some(&begun)),
            available: available.as_deref(),
        });
        Ok(())
    }

    /// Takes a step and answers with its results.
    ///
    /// **Errors**: there is not enough memory; or a description, if the actions do not match the lanes.
    pub(super) fn step(
        &mut self,
        step: &StepRequest,
        record: &mut TrainingRecord<'_>,
        program: &mut Program,
    ) -> Result<Result<(), String>, Broken> {
        if let Err(fault) = self.read(step) {
            return Ok(Err(fault));
        }
        let ran: Vec<usize> =
            (0..self.simulation.lanes()).filter(|lane| self.is_running(*lane)).collect();
        if let Some(log) = &mut record.log {
            log.chosen(&self.simulation, &self.actions, &self.probabilities);
        }
        self.simulation.step(&self.actions, &mut self.rewards, &mut self.streams);
        if let Some(log) = &mut record.log {
            log.paid(&self.simulation, &self.rewards);
        }
        let walked = self.simulation.outcomes(&self.rewards);
        for lane in ran {
            let (total, length) = &mut self.episodes[lane];
            *total += walked[lane];
            *length += 1;
            let status = self.simulation.statuses()[lane];
            if status != EpisodeStatus::Running {
                record.end(*total, *length, status == EpisodeStatus::Terminated)?;
            }
        }
        let at = |status| self.simulation.statuses().iter().map(move |other| *other == status);
        let terminated: Vec<bool> = at(EpisodeStatus::Terminated).collect();
        // Before its first episode, a lane counts as ended although no episode was truncated in it.
        let has_run = self.episodes.iter().map(|(_, length)| *length > 0);
        let truncated: Vec<bool> =
            at(EpisodeStatus::Truncated).zip(has_run).map(|(cut, ran)| cut && ran).collect();
        let values = self.observed();
        let all: Vec<usize> = (0..self.simulation.lanes()).collect();
        let available = self.available(&all);
        program.send(&ToProgram::Stepped {
            observations: self.rows(&values, None),
            rewards: &self.rewards,
            terminated: &terminated,
            truncated: &truncated,
            available: available.as_deref(),
        });
        Ok(Ok(()))
    }

    /// Reads the actions of a step, and their probabilities.
    fn read(&mut self, step: &StepRequest) -> Result<(), String> {
        let lanes = self.simulation.lanes();
        if !self.simulation.any_running() {
            return Err("expected \"reset\" before \"step\": no episode is running".to_owned());
        }
        if step.actions.len() != lanes {
            let found = step.actions.len();
            return Err(format!(
                "expected {}, one for every lane, found {found}",
                counted(lanes, "action")
            ));
        }
        if let Some(given) = step.probabilities.as_ref().filter(|given| given.len() != lanes) {
            let found = given.len();
            let noun = if lanes == 1 { "probability" } else { "probabilities" };
            return Err(format!("expected {lanes} {noun}, found {found}"));
        }
        let count = self.probabilities.len() / lanes;
        for lane in 0..lanes {
            if !self.is_running(lane) {
                continue;
            }
            self.actions[lane] = action(step.actions[lane], count, lane)?;
            let with = step.probabilities.as_ref().map_or(1.0, |given| given[lane]);
            let row = &mut self.probabilities[lane * count..][..count];
            of_one(self.actions[lane], probability(with, lane)?, row);
        }
        Ok(())
    }

    /// \[lanes, entries\]: the observation of every lane.
    fn observed(&mut self) -> Vec<f32> {
        self.simulation.observe(&mut self.observations);
        self.observations.take_written_out()
    }

    fn rows<'v>(&self, values: &'v [f32], only: Option<&'v [usize]>) -> SentRows<'v> {
        SentRows { values, width: values.len() / self.simulation.lanes(), only }
    }

    fn available(&self, lanes: &[usize]) -> Option<Vec<bool>> {
        available(&self.simulation, lanes)
    }
}
