//! The messages of the protocol, one JSON object per line. `docs/external.md` describes them.

use serde::de::DeserializeOwned;
use serde::ser::SerializeSeq;
use serde::{Deserialize, Serialize, Serializer};

/// The version of the protocol.
pub const PROTOCOL: u32 = 1;

/// Maximum length of a line of an agent's standard output, in bytes; messages about thousands of lanes are
/// shorter.
pub const LONGEST_LINE: usize = 1 << 20;

/// Maximum number of characters of a line that an error message shows.
const SHOWN: usize = 120;

/// A message to a program.
#[derive(Debug, Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum ToProgram<'a> {
    /// Episodes of training have begun.
    Began {
        /// The lanes, in ascending order.
        lanes: &'a [usize],
        /// \[lanes, entries\]: the first observations.
        observations: SentRows<'a>,
        /// \[lanes\]: whether a message can be sent; absent if it always can.
        #[serde(skip_serializing_if = "Option::is_none")]
        available: Option<&'a [bool]>,
    },
    /// The result of a training step, which every running lane took.
    Stepped {
        /// \[lanes, entries\]: the observations after the step.
        observations: SentRows<'a>,
        /// \[lanes\]: 0 in lanes that had ended before the step.
        rewards: &'a [f64],
        /// \[lanes\]: whether the episode was terminated.
        terminated: &'a [bool],
        /// \[lanes\]: whether the episode has ended at the horizon.
        truncated: &'a [bool],
        /// \[lanes\]: whether a message can be sent; absent if it always can.
        #[serde(skip_serializing_if = "Option::is_none")]
        available: Option<&'a [bool]>,
    },
    /// Test episodes begin in this number of lanes. The message has no answer.
    Test {
        /// Number of lanes.
        lanes: usize,
    },
    /// The observations of running lanes of the test, or of the people in a trial; the answer is
    /// [`FromProgram::Choices`].
    Act {
        /// The calendar day of a trial.
        #[serde(skip_serializing_if = "Option::is_none")]
        day: Option<u32>,
        /// The decision of the day, from 0.
        #[serde(skip_serializing_if = "Option::is_none")]
        decision: Option<u32>,
        /// The running lanes, in ascending order.
        lanes: &'a [usize],
        /// \[lanes, entries\].
        observations: SentRows<'a>,
        /// \[lanes\]: whether a message can be sent; absent if it always can.
        #[serde(skip_serializing_if = "Option::is_none")]
        available: Option<&'a [bool]>,
    },
    /// The rewards of a step of a trial. The message has no answer.
    Rewards {
        /// The lanes of the step, in ascending order.
        lanes: &'a [usize],
        /// \[lanes\]: the actions that were taken: 0 where no message could be sent.
        actions: &'a [usize],
        /// \[lanes\]: null for outcomes that do not reach the agent.
        rewards: &'a [Option<f64>],
    },
    /// An agent of a trial is updated. The message has no answer.
    Update {
        /// The calendar day.
        day: u32,
        /// The people whose data count: the numbers of their lanes.
        people: &'a [usize],
        /// The data of days before this one count.
        before: u32,
        /// The person whose own agent is updated; null for an agent of everybody.
        agent: Option<usize>,
    },
    /// The job is done. The message has no answer.
    End {},
}

/// Rows of numbers, all or some of which are sent.
#[derive(Clone, Copy, Debug)]
pub struct SentRows<'a> {
    /// \[rows, width\].
    pub values: &'a [f32],
    /// Numbers per row.
    pub width: usize,
    /// The rows to send; `None` for all.
    pub only: Option<&'a [usize]>,
}

impl Serialize for SentRows<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let row = |row: usize| &self.values[row * self.width..(row + 1) * self.width];
        let rows = self.values.len() / self.width;
        let mut list = serializer.serialize_seq(Some(self.only.map_or(rows, <[usize]>::len)))?;
        match self.only {
            Some(only) => only.iter().try_for_each(|at| list.serialize_element(row(*at)))?,
            None => (0..rows).try_for_each(|at| list.serialize_element(row(at)))?,
        }
        list.end()
    }
}

/// A message from a program.
#[derive(Debug, PartialEq, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
pub enum FromProgram {
    /// The answer to the job.
    Ready {
        /// The version of the protocol that it speaks.
        protocol: u32,
        /// Number of lanes in which it trains.
        #[serde(default = "one")]
        lanes: usize,
        /// Whether it acts in trials.
        #[serde(default)]
        trials: bool,
    },
    /// Requests new training episodes.
    Reset(Reset),
    /// Requests a training step.
    Step(StepRequest),
    /// Reports episodes that the program simulated itself.
    Episodes(OwnEpisodes),
    /// Reports a training update.
    Update(Update),
    /// Training is over.
    Trained {},
    /// The answer to [`ToProgram::Act`].
    Choices(Choices),
}

/// A request for new episodes.
#[derive(Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reset {
    /// The lanes; if absent, all lanes that are not running.
    pub lanes: Option<Vec<usize>>,
}

/// A request for a step.
#[derive(Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StepRequest {
    /// \[lanes\]: an action for every lane; actions of ended lanes are ignored.
    pub actions: Vec<Option<i64>>,
    /// \[lanes\]: the probabilities with which the actions were chosen; 1 if absent.
    pub probabilities: Option<Vec<f64>>,
}

/// Training episodes that the program simulated itself.
#[derive(Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OwnEpisodes {
    /// Undiscounted returns.
    pub returns: Vec<f64>,
    /// Number of steps of each episode.
    pub lengths: Vec<u32>,
    /// Whether each episode was terminated.
    pub terminated: Vec<bool>,
}

/// A training update.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Update {
    /// The loss.
    pub loss: Option<f64>,
    /// The exploration rate from now on.
    pub epsilon: Option<f64>,
}

/// Choices in a step of the test: actions, or the probabilities of all actions, from which jitai draws.
#[derive(Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Choices {
    /// \[lanes\].
    pub actions: Option<Vec<i64>>,
    /// With `actions`, \[lanes\]: the probability of each action. Without, \[lanes, actions\].
    pub probabilities: Option<Probabilities>,
}

/// Probabilities of the actions taken, or of all actions.
#[derive(Debug, PartialEq, Deserialize)]
#[serde(untagged)]
pub enum Probabilities {
    /// \[lanes\].
    OfActions(Vec<f64>),
    /// \[lanes, actions\].
    OfAll(Vec<Vec<f64>>),
}

fn one() -> usize {
    1
}

impl FromProgram {
    /// The value of `type`.
    pub fn word(&self) -> &'static str {
        match self {
            FromProgram::Ready { .. } => "ready",
            FromProgram::Reset(_) => "reset",
            FromProgram::Step(_) => "step",
            FromProgram::Episodes(_) => "episodes",
            FromProgram::Update(_) => "update",
            FromProgram::Trained {} => "trained",
            FromProgram::Choices(_) => "choices",
        }
    }
}

impl Message for FromProgram {}

/// A message that a program writes as a line.
pub trait Message: DeserializeOwned {
    /// Parses the message of a line; the error names the fault and the `expected` message.
    fn read(line: &[u8], expected: &str) -> Result<Self, String> {
        if let Ok(message) = serde_json::from_slice(line) {
            return Ok(message);
        }
        let stdout = "standard output is reserved for messages; write to standard error instead";
        let shown = || shown(line);
        // Some writers of JSON permit numbers that JSON lacks.
        let has = |word: &str| line.windows(word.len()).any(|part| part == word.as_bytes());
        let is_meant =
            line.trim_ascii_start().starts_with(b"{\"") && (has("NaN") || has("Infinity"));
        let stdout = match is_meant {
            true => "JSON has no NaN and no infinity",
            false => stdout,
        };
        let json: serde_json::Value = serde_json::from_slice(line).map_err(|error| {
            format!("expected {expected}, found the line {} ({error}); {stdout}", shown())
        })?;
        if !json.is_object() {
            return Err(format!("expected {expected}, found the line {}; {stdout}", shown()));
        }
        serde_json::from_value(json)
            .map_err(|error| format!("expected {expected}, found {} ({error})", shown()))
    }
}

/// The beginning of a line, without control characters.
pub(super) fn shown(line: &[u8]) -> String {
    let text = String::from_utf8_lossy(line);
    let plain = |c: char| if c.is_control() { '\u{fffd}' } else { c };
    let mut short: String = text.chars().take(SHOWN).map(plain).collect();
    if short.len() < text.len() {
        short.push('…');
    }
    format!("`{short}`")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(line: &str) -> Result<FromProgram, String> {
        FromProgram::read(line.as_bytes(), "\"ready\"")
    }

    #[test]
    fn messages_are_read_with_their_defaults() {
        let ready = FromProgram::Ready { protocol: 1, lanes: 1, trials: false };
        assert_eq!(read(r#"{"type":"ready","protocol":1}"#).unwrap(), ready);
        assert_eq!(read(r#"{"type":"reset"}"#).unwrap(), FromProgram::Reset(Reset::default()));
        let step = StepRequest { actions: vec![Some(3), None], probabilities: None };
        assert_eq!(read(r#"{"type":"step","actions":[3,null]}"#).unwrap(), FromProgram::Step(step));
        assert_eq!(read(r#"{"type":"trained"}"#).unwrap(), FromProgram::Trained {});
        let all = Choices {
            actions: None,
            probabilities: Some(Probabilities::OfAll(vec![vec![0.25; 4]])),
        };
        let line = r#"{"type":"choices","probabilities":[[0.25,0.25,0.25,0.25]]}"#;
        assert_eq!(read(line).unwrap(), FromProgram::Choices(all));
    }

    #[test]
    fn faults_say_what_was_found_and_expected() {
        for (line, expected) in [
            ("hello", "expected \"ready\", found the line `hello`"),
            ("7", "found the line `7`; standard output is reserved for messages"),
            (r#"{"type":"reddy"}"#, "unknown variant `reddy`, expected one of `ready`"),
            (r#"{"type":"ready"}"#, "missing field `protocol`"),
            (r#"{"type":"step","actions":"up"}"#, "invalid type: string \"up\""),
            (r#"{"type":"reset","lane":[1]}"#, "unknown field `lane`"),
            (r#"{"type":"update","loss":NaN}"#, "JSON has no NaN and no infinity"),
            ("{'loss': 1}", "standard output is reserved for messages"),
        ] {
            let fault = read(line).unwrap_err();
            assert!(fault.contains(expected), "{line}: {fault}");
        }
        let long = read(&"x".repeat(10_000)).unwrap_err();
        assert!(long.len() < 500 && long.contains("x…`"), "{long}");
        assert!(FromProgram::read(b"\xff\x00", "x").unwrap_err().contains('\u{fffd}'));
    }

    #[test]
    fn messages_are_written_on_one_line() {
        let rows = SentRows { values: &[0.5, 1.0, 0.1, 2.0], width: 2, only: Some(&[1]) };
        let act = ToProgram::Act {
            day: None,
            decision: None,
            lanes: &[1],
            observations: rows,
            available: None,
        };
        let written = serde_json::to_string(&act).unwrap();
        assert_eq!(written, r#"{"type":"act","lanes":[1],"observations":[[0.1,2.0]]}"#);
        assert_eq!(serde_json::to_string(&ToProgram::End {}).unwrap(), r#"{"type":"end"}"#);
    }
}
