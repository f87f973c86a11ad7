//! The steps of rolled or replayed episodes, as `simulate` prints them.

use std::io::{self, Write};

use crate::cli::output::{Format, OutputField, OutputRows};
use crate::env::{Action, ContextDraw, EpisodeStatus, PhysicalActivity, VectorEnvironment};

const COLUMNS: [&str; 15] = [
    "episode",
    "step",
    "context",
    "probability_0",
    "likely",
    "habituation",
    "disengagement",
    "available",
    "can_send",
    "chosen_action",
    "action",
    "action_probability",
    "reward",
    "ending",
    "return",
];

/// A step of one episode.
pub(super) struct ShownStep {
    /// Time of the step, from 0.
    pub(super) time: u32,
    /// The context with its inference.
    pub(super) draw: ContextDraw,
    /// Habituation before the step.
    pub(super) habituation: f64,
    /// Disengagement risk before the step.
    pub(super) disengagement: f64,
    /// Whether a message could be sent, apart from the budget of messages.
    pub(super) available: bool,
    /// Whether a message could be sent.
    pub(super) can_send: bool,
    /// The action chosen.
    pub(super) chosen: Action,
    /// The action taken.
    pub(super) action: Action,
    /// The probability with which the action was taken, 1 where no message could be sent; `None` if the action
    /// was forced.
    pub(super) probability: Option<f64>,
    /// The steps walked.
    pub(super) reward: f64,
    /// Status of the episode after the step.
    pub(super) status: EpisodeStatus,
}

impl ShownStep {
    /// The current step of the first lane with the chosen action; its reward is not known yet.
    pub(super) fn chosen(lanes: &PhysicalActivity, chosen: Action) -> Self {
        ShownStep {
            time: lanes.times()[0],
            draw: lanes.context(0),
            habituation: lanes.habituation()[0],
            disengagement: lanes.disengagement()[0],
            available: lanes.is_available(0),
            can_send: lanes.can_send(0),
            chosen,
            action: lanes.taken(0, chosen),
            probability: None,
            reward: 0.0,
            status: EpisodeStatus::Running,
        }
    }

    /// Records the steps walked in the first lane, and its status after the step.
    pub(super) fn pay(&mut self, lanes: &PhysicalActivity, reward: f64) {
        self.reward = reward;
        self.status = lanes.statuses()[0];
    }
}

/// The word for the status of an episode.
fn ending(status: EpisodeStatus) -> &'static str {
    match status {
        EpisodeStatus::Running => "running",
        EpisodeStatus::Terminated => "disengaged",
        EpisodeStatus::Truncated => "horizon",
    }
}

/// A writer of steps, one row per step.
pub(super) struct StepRows<W: Write>(OutputRows<W>);

impl<W: Write> StepRows<W> {
    pub(super) fn new(format: Format, out: W) -> io::Result<Self> {
        OutputRows::new(format, &COLUMNS.map(str::to_owned), out).map(StepRows)
    }

    /// Adds an episode; `number` counts from 1, as in the view `evaluation_episode`.
    pub(super) fn episode(&mut self, number: usize, steps: &[ShownStep]) -> io::Result<()> {
        let mut total = 0.0;
        for step in steps {
            total += step.reward;
            self.0.row(&[
                OutputField::Integer(number as i64),
                OutputField::Integer(i64::from(step.time)),
                OutputField::Integer(i64::from(step.draw.context)),
                OutputField::Rounded(step.draw.probability_of_zero, 4),
                OutputField::Integer(i64::from(step.draw.likely)),
                OutputField::Rounded(step.habituation, 4),
                OutputField::Rounded(step.disengagement, 4),
                OutputField::Integer(i64::from(step.available)),
                OutputField::Integer(i64::from(step.can_send)),
                OutputField::Integer(step.chosen.index() as i64),
                OutputField::Integer(step.action.index() as i64),
                step.probability.map_or(OutputField::Empty, |p| OutputField::Rounded(p, 4)),
                OutputField::Rounded(step.reward, 2),
                OutputField::text(ending(step.status)),
                OutputField::Rounded(total, 2),
            ])?;
        }
        Ok(())
    }

    pub(super) fn finish(self) -> io::Result<()> {
        self.0.finish()
    }
}
