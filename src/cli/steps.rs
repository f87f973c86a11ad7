//! The steps of episodes as `simulate` prints them, whether they were rolled or replayed.

use std::io::{self, Write};

use crate::cli::output::{Cell, Format, Rows};
use crate::env::{Action, Ending, Episodes, Signal};

const COLUMNS: [&str; 12] = [
    "episode",
    "step",
    "context",
    "probability_0",
    "likely",
    "habituation",
    "disengagement",
    "action",
    "action_probability",
    "reward",
    "ending",
    "return",
];

/// A step of one episode.
pub(super) struct Step {
    /// Its time, from 0.
    pub(super) time: u32,
    /// The context with its inference.
    pub(super) signal: Signal,
    /// Habituation before the step.
    pub(super) habituation: f64,
    /// Disengagement risk before the step.
    pub(super) disengagement: f64,
    /// What was chosen.
    pub(super) action: Action,
    /// The probability with which it was chosen; `None` where it was forced.
    pub(super) probability: Option<f64>,
    /// What was paid for it, in steps walked.
    pub(super) reward: f64,
    /// Whether and how the episode ended with it.
    pub(super) ending: Ending,
}

impl Step {
    /// The step that the first lane is at, with the action chosen in it; nothing is paid yet.
    pub(super) fn chosen(episodes: &Episodes, action: Action) -> Self {
        Step {
            time: episodes.time(),
            signal: episodes.signal(0),
            habituation: episodes.habituation()[0],
            disengagement: episodes.disengagement()[0],
            action,
            probability: None,
            reward: 0.0,
            ending: Ending::Running,
        }
    }

    /// Adds what the first lane was paid, and how it stands after the step.
    pub(super) fn pay(&mut self, episodes: &Episodes, reward: f64) {
        self.reward = reward;
        self.ending = episodes.endings()[0];
    }
}

/// A writer of steps, a row a step.
pub(super) struct StepRows<W: Write>(Rows<W>);

impl<W: Write> StepRows<W> {
    pub(super) fn new(format: Format, out: W) -> io::Result<Self> {
        Rows::new(format, &COLUMNS.map(str::to_owned), out).map(StepRows)
    }

    /// Adds an episode; `number` counts from 1, as in the view `evaluation_episode`.
    pub(super) fn episode(&mut self, number: usize, steps: &[Step]) -> io::Result<()> {
        let mut total = 0.0;
        for step in steps {
            total += step.reward;
            self.0.row(&[
                Cell::Integer(number as i64),
                Cell::Integer(i64::from(step.time)),
                Cell::Integer(i64::from(step.signal.context)),
                Cell::Rounded(step.signal.probability_of_zero, 4),
                Cell::Integer(i64::from(step.signal.likely)),
                Cell::Rounded(step.habituation, 4),
                Cell::Rounded(step.disengagement, 4),
                Cell::Integer(step.action.index() as i64),
                step.probability.map_or(Cell::Empty, |p| Cell::Rounded(p, 4)),
                Cell::Rounded(step.reward, 2),
                Cell::text(step.ending.name()),
                Cell::Rounded(total, 2),
            ])?;
        }
        Ok(())
    }

    pub(super) fn finish(self) -> io::Result<()> {
        self.0.finish()
    }
}
