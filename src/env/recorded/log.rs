//! The decisions of a recorded trial, person by person.

/// The name of the probability of the recorded action, the last number of the recorded state.
pub const RECORDED_PROBABILITY: &str = "recorded_probability";

/// The name of whether the outcome reached the agent of the trial, which stands before it where some did not.
pub const REACHED: &str = "reached";

/// The decisions of a trial that happened.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedLog {
    /// The names of the state.
    pub names: Vec<String>,
    /// The number of actions.
    pub actions: usize,
    /// Decisions of a person per day.
    pub per_day: u32,
    /// The people, in the order of their first rows.
    pub people: Vec<LogPerson>,
    /// \[decisions, state\]; NaN for an empty cell.
    pub(super) state: Vec<f64>,
    /// \[decisions\].
    pub(super) outcomes: Vec<f64>,
    pub(super) taken: Vec<u8>,
    /// \[decisions, actions\].
    pub(super) probabilities: Vec<f64>,
    /// \[decisions\]: whether the file has the decision with its action, probability and outcome; whether an action other
    /// than 0 was possible; and whether the outcome reached the agent of the trial.
    pub(super) is_used: Vec<bool>,
    pub(super) is_available: Vec<bool>,
    pub(super) is_reached: Vec<bool>,
    /// By number of the state: how many decisions lack it, and the line of the first.
    pub(super) lacking: Vec<(u64, u32)>,
    /// What was found in the file that is no fault, one sentence each without its full stop.
    pub notes: Vec<String>,
    /// \[decisions\]: whether an action was possible, and it and its probability are known.
    pub(super) is_drawn: Vec<bool>,
}

/// A person of a recorded trial.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogPerson {
    /// The name in the file.
    pub name: String,
    /// The index of the first decision, and the number of decisions, those that the file skips included.
    pub first: usize,
    /// See `first`.
    pub decisions: u32,
    /// The day of the calendar on which the person entered; 0 without a calendar.
    pub start_day: u32,
}

impl RecordedLog {
    /// The number of decisions of a person who stays to the end, in whole days.
    pub fn horizon(&self) -> u32 {
        let most = self.people.iter().map(|person| person.decisions).max().unwrap_or(1);
        most.div_ceil(self.per_day) * self.per_day
    }

    /// The days of each person in the study, \[people\]: the first day, and the day after the last.
    pub fn stays(&self) -> impl Iterator<Item = (u32, u32)> {
        self.people.iter().map(|person| {
            (person.start_day, person.start_day + person.decisions.div_ceil(self.per_day))
        })
    }

    /// Whether some decisions admit no action but 0.
    pub fn can_withhold(&self) -> bool {
        self.is_used.iter().zip(&self.is_available).any(|(used, available)| *used && !available)
    }

    /// Whether some outcomes did not reach the agent of the trial.
    pub fn can_miss(&self) -> bool {
        self.is_used.iter().zip(&self.is_reached).any(|(used, reached)| *used && !reached)
    }

    /// What lacks the number of the state at this index: decisions, and the line of the first. `None` for nothing.
    pub fn lacking(&self, index: usize) -> Option<(u64, u32)> {
        self.lacking.get(index).copied().filter(|(count, _)| *count > 0)
    }
}
