//! The record of decisions: every step of the episodes of a training or of a test.

use std::io;

use crate::agent::{OutOfMemory, StepObserver, reserve};
use crate::env::{Action, EpisodeStatus, PhysicalActivity, VectorEnvironment};
use crate::record::{Decision, Phase};
use crate::state::{Resumable, StateError, StateReader, StateWriter};

/// Records the decisions of one phase of a job.
///
/// A lane that is at its first step begins the next episode, in lane order. This numbers the episodes
/// of lanes in lockstep as the learning curve and the test do.
#[derive(Debug)]
pub(super) struct DecisionLog {
    phase: Phase,
    /// In the order of their steps; [`DecisionLog::finish`] sorts them by episode.
    decisions: Vec<Decision>,
    /// Episodes that have begun.
    begun: u32,
    /// The episode of every lane, from 1.
    episodes: Vec<u32>,
    /// The lanes of the decisions that have not been paid yet, which are the last ones.
    acting: Vec<usize>,
    /// Memory that was short. Nothing is recorded from then on.
    refused: Option<OutOfMemory>,
}

impl DecisionLog {
    pub(super) fn new(phase: Phase) -> Self {
        DecisionLog {
            phase,
            decisions: Vec::new(),
            begun: 0,
            episodes: Vec::new(),
            acting: Vec::new(),
            refused: None,
        }
    }

    /// **Errors**: there was no memory for a decision.
    pub(super) fn check(&self) -> Result<(), OutOfMemory> {
        self.refused.map_or(Ok(()), Err)
    }

    /// The decisions by episode and step.
    pub(super) fn finish(mut self) -> Vec<Decision> {
        self.decisions.sort_unstable_by_key(|decision| (decision.episode, decision.step));
        self.decisions
    }

    /// The number of the episode in a lane that is at this step.
    fn episode(&mut self, lane: usize, step: u32) -> u32 {
        if step == 0 {
            self.begun += 1;
            self.episodes[lane] = self.begun;
        }
        self.episodes[lane]
    }
}

impl StepObserver<PhysicalActivity> for DecisionLog {
    fn chosen(&mut self, lanes: &PhysicalActivity, actions: &[Action], probabilities: &[f64]) {
        self.acting.clear();
        self.episodes.resize(lanes.lanes(), 0);
        match reserve(&mut self.decisions, lanes.lanes(), "the record of decisions") {
            Ok(()) if self.refused.is_none() => {}
            refused => return self.refused = self.refused.or(refused.err()),
        }
        for (lane, status) in lanes.statuses().iter().enumerate() {
            if *status != EpisodeStatus::Running {
                continue;
            }
            let step = lanes.times()[lane];
            let draw = lanes.context(lane);
            let shown = lanes.parameters().observed_probability;
            let zero = draw.probability_of_zero;
            // Without availability or budget every choice comes to no message.
            let taken = lanes.taken(lane, actions[lane]);
            let is_free = lanes.taken(lane, Action::UNTAILORED) == Action::UNTAILORED;
            let decision = Decision {
                phase: self.phase,
                episode: self.episode(lane, step),
                step,
                context: draw.context,
                probability: if shown == 0 { zero } else { 1.0 - zero },
                likely_context: draw.likely,
                habituation: lanes.habituation()[lane],
                disengagement: lanes.disengagement()[lane],
                available: lanes.is_available(lane),
                action: taken.index() as u8,
                action_probability: if is_free { probabilities[lane] } else { 1.0 },
                reward: 0.0,
            };
            self.decisions.push(decision);
            self.acting.push(lane);
        }
    }

    fn paid(&mut self, lanes: &PhysicalActivity, rewards: &[f64]) {
        let walked = lanes.outcomes(rewards);
        let first = self.decisions.len() - self.acting.len();
        for (decision, lane) in self.decisions[first..].iter_mut().zip(&self.acting) {
            decision.reward = walked[*lane];
        }
    }
}

/// Between two steps every decision has been paid.
impl Resumable for DecisionLog {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        out.one(self.begun)?;
        out.many(&self.episodes)?;
        out.each(self.decisions.iter(), |out, decision| {
            out.one(decision.episode)?;
            out.one(decision.step)?;
            out.one(decision.context)?;
            out.one(decision.probability)?;
            out.one(decision.likely_context)?;
            out.one(decision.habituation)?;
            out.one(decision.disengagement)?;
            out.one(u8::from(decision.available))?;
            out.one(decision.action)?;
            out.one(decision.action_probability)?;
            out.one(decision.reward)
        })
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        const WHAT: &str = "decisions";
        self.begun = from.one()?;
        self.episodes = from.many(usize::MAX, WHAT)?;
        self.decisions = from.each(usize::MAX, WHAT, |from| {
            Ok(Decision {
                phase: self.phase,
                episode: from.one()?,
                step: from.one()?,
                context: from.one()?,
                probability: from.one()?,
                likely_context: from.one()?,
                habituation: from.one()?,
                disengagement: from.one()?,
                available: from.one::<u8>()? != 0,
                action: from.one()?,
                action_probability: from.one()?,
                reward: from.one()?,
            })
        })?;
        Ok(())
    }
}
