//! The messages of the protocol for environments, one JSON object per line. `docs/outside-environments.md`
//! describes them.

use std::fmt;

use data_encoding::BASE64;
use serde::de::{self, Deserializer, SeqAccess, Visitor};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value as Json};

use super::message::Message;

/// The version of the protocol.
pub const ENVIRONMENT_PROTOCOL: u32 = 1;

/// Maximum length of a line of an environment's standard output, in bytes.
pub const LONGEST_ENVIRONMENT_LINE: usize = 1 << 26;

/// A message to the program of an environment.
#[derive(Debug, Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum ToEnvironment<'a> {
    /// The first message; the answer is [`Declared`].
    Describe {
        /// The version of the protocol.
        protocol: u32,
        /// The release of jitai.
        jitai: &'a str,
        /// The version that the manifest states.
        version: &'a str,
        /// The parameters of the environment, as in the manifest.
        parameters: &'a Map<String, Json>,
    },
    /// Another set of lanes is needed. The message has no answer.
    Begin {
        /// The number of the set in later messages.
        instance: u64,
        /// Number of lanes; all have ended until they are reset.
        lanes: usize,
        /// The purpose of the episodes: `train`, `test` or `check`.
        phase: &'a str,
        /// Whether the answers must have the state.
        state: bool,
    },
    /// Episodes begin in these lanes; the answer is [`Observed`] without rewards.
    Reset {
        /// The set of lanes.
        instance: u64,
        /// The lanes, in ascending order.
        lanes: &'a [usize],
        /// \[lanes\]: the seed of each episode, below 2^53.
        seeds: &'a [u64],
    },
    /// The running lanes take a step; the answer is [`Observed`] with rewards.
    Step {
        /// The set of lanes.
        instance: u64,
        /// The running lanes, in ascending order.
        lanes: &'a [usize],
        /// \[lanes\]: the numbers of the actions.
        actions: &'a [u8],
    },
    /// A set of lanes is no longer needed. The message has no answer.
    Close {
        /// The set of lanes.
        instance: u64,
    },
    /// The job is done. The message has no answer.
    End {},
}

/// The answer to [`ToEnvironment::Describe`].
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Declared {
    /// The type of the message.
    #[serde(rename = "type")]
    pub message: DescriptionMessage,
    /// The version of the protocol that the program speaks.
    pub protocol: u32,
    /// The features of an observation, in their order.
    pub features: Vec<DeclaredFeature>,
    /// The names of the actions.
    pub actions: Vec<String>,
    /// The name of the action that does nothing.
    pub nothing: Option<String>,
    /// Maximum number of steps of an episode.
    pub horizon: u64,
    /// The smallest and the largest reward of a step; null is unbounded.
    pub reward: Option<[Option<f64>; 2]>,
    /// The unit of rewards and returns.
    pub unit: Option<String>,
    /// The names of the numbers that the state consists of.
    #[serde(default)]
    pub state: Vec<String>,
    /// Whether there are steps in which only the action that does nothing is possible.
    #[serde(default)]
    pub availability: bool,
    /// Whether the parameters may differ between the participants of a job.
    #[serde(default)]
    pub participants: bool,
}

/// A feature of an observation.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeclaredFeature {
    /// Its name.
    pub name: String,
    /// Its smallest value; unbounded if absent.
    pub low: Option<f64>,
    /// Its largest value; unbounded if absent.
    pub high: Option<f64>,
    /// Its unit.
    pub unit: Option<String>,
    /// What it is.
    pub meaning: Option<String>,
}

/// The answer to [`ToEnvironment::Reset`] or [`ToEnvironment::Step`]; all lists are \[lanes of the message\].
#[derive(Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Observed {
    /// The type of the message.
    #[serde(rename = "type")]
    pub message: Observation,
    /// \[lanes, features\].
    pub observations: SentNumbers,
    /// The rewards; absent after a reset.
    pub rewards: Option<SentNumbers>,
    /// Whether the episode ended in a terminal state; in no lane if absent.
    pub terminated: Option<SentNumbers>,
    /// Whether the episode was cut off; in no lane if absent.
    pub truncated: Option<SentNumbers>,
    /// Whether every action is possible in the next step; in all lanes if absent.
    pub available: Option<SentNumbers>,
    /// \[lanes, numbers of the state\].
    pub state: Option<SentNumbers>,
}

/// The type of [`Declared`].
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DescriptionMessage {
    /// `"type": "description"`.
    Description,
}

/// The type of [`Observed`].
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Observation {
    /// `"type": "began"`, after a reset.
    Began,
    /// `"type": "stepped"`, after a step.
    Stepped,
}

impl Message for Declared {}
impl Message for Observed {}

/// A list of numbers or of truth values, or a list of rows; written as JSON, or as a text: the base64 of the
/// same values as little-endian 64-bit floating-point numbers.
#[derive(Debug, Default, PartialEq)]
pub struct SentNumbers {
    /// The values, row after row.
    pub values: Vec<f64>,
    /// Number of values per row, if the message has rows.
    pub width: Option<usize>,
}

impl<'de> Deserialize<'de> for SentNumbers {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(NumbersVisitor)
    }
}

struct NumbersVisitor;

impl<'de> Visitor<'de> for NumbersVisitor {
    type Value = SentNumbers;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of numbers, or a text in base64")
    }

    fn visit_str<E: de::Error>(self, text: &str) -> Result<SentNumbers, E> {
        let bytes = BASE64.decode(text.as_bytes()).map_err(E::custom)?;
        let (numbers, rest) = bytes.as_chunks();
        if !rest.is_empty() {
            let found = bytes.len();
            return Err(E::custom(format!("expected 8 bytes per number, found {found} bytes")));
        }
        let values = numbers.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect();
        Ok(SentNumbers { values, width: None })
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<SentNumbers, A::Error> {
        let mut values = Vec::new();
        let mut first = None;
        while let Some(element) = list.next_element_seed(Element(&mut values))? {
            if *first.get_or_insert(element) != element {
                return Err(de::Error::custom("expected rows of equal length"));
            }
        }
        Ok(SentNumbers { values, width: first.flatten() })
    }
}

/// Appends an element of a list to the values: a number, a truth value, or a row of these. Returns the length
/// of a row.
struct Element<'a>(&'a mut Vec<f64>);

impl<'de> de::DeserializeSeed<'de> for Element<'_> {
    type Value = Option<usize>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Element<'_> {
    type Value = Option<usize>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number")
    }

    fn visit_f64<E: de::Error>(self, number: f64) -> Result<Self::Value, E> {
        self.0.push(number);
        Ok(None)
    }

    fn visit_i64<E: de::Error>(self, number: i64) -> Result<Self::Value, E> {
        self.visit_f64(number as f64)
    }

    fn visit_u64<E: de::Error>(self, number: u64) -> Result<Self::Value, E> {
        self.visit_f64(number as f64)
    }

    fn visit_bool<E: de::Error>(self, truth: bool) -> Result<Self::Value, E> {
        self.visit_f64(f64::from(u8::from(truth)))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut row: A) -> Result<Self::Value, A::Error> {
        let before = self.0.len();
        while let Some(number) = row.next_element::<f64>()? {
            self.0.push(number);
        }
        Ok(Some(self.0.len() - before))
    }
}
