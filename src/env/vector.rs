//! The contract of vectorised environments: many episodes, one per lane, stepped together.
//!
//! Learners, rollouts and actors are generic over [`VectorEnvironment`]; the simulation of the paper is one
//! implementation. [`crate::env::contract`] tests any implementation.

use std::ops::RangeInclusive;

use crate::env::observation::{FeatureSpec, ObservationSpec, Observations};
use crate::env::scenario::Scenario;
use crate::rng::Stream;
use crate::state::{Resumable, StateError, StateReader, StateWriter, resumable};

/// An action, by its number among the actions of an environment; 0 by default.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(transparent)]
pub struct Action(pub(super) u8);

impl Action {
    /// The numbers of actions that environments can have.
    pub const COUNTS: RangeInclusive<usize> = 2..=256;

    /// The action of this number; `None` above 255.
    pub fn from_index(index: usize) -> Option<Action> {
        u8::try_from(index).ok().map(Action)
    }

    /// The action that a random word chooses among the first `count`, in [`Action::COUNTS`], each equally likely.
    ///
    /// A power of two reads the lowest bits of the word. Any other number multiplies and shifts the whole word, so
    /// that probabilities differ by at most 2^-64.
    pub fn uniform(word: u64, count: usize) -> Action {
        if count.is_power_of_two() {
            return Action((word & (count as u64 - 1)) as u8);
        }
        Action(((u128::from(word) * count as u128) >> 64) as u8)
    }

    /// The number of the action, from 0.
    pub fn index(self) -> usize {
        usize::from(self.0)
    }
}

resumable!([] Action { parts 0 });

/// Whether an episode is running, and how it ended if not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum EpisodeStatus {
    /// The episode continues.
    Running,
    /// The episode reached a terminal state, after which the value is 0.
    Terminated,
    /// The episode was cut off, for example at a horizon; the state still has a value.
    Truncated,
}

impl EpisodeStatus {
    /// The number of the status in saved states, 0 to 2.
    pub fn number(self) -> u8 {
        self as u8
    }

    /// The status of this number; `None` above 2.
    pub fn from_number(number: u8) -> Option<EpisodeStatus> {
        match number {
            0 => Some(EpisodeStatus::Running),
            1 => Some(EpisodeStatus::Terminated),
            2 => Some(EpisodeStatus::Truncated),
            _ => None,
        }
    }
}

impl Resumable for EpisodeStatus {
    fn save(&self, out: &mut StateWriter<'_>) -> std::io::Result<()> {
        out.one(*self as u8)
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        *self = EpisodeStatus::from_number(from.one()?).ok_or(StateError::Misfit("statuses"))?;
        Ok(())
    }
}

/// A set of lanes of an environment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LaneSet<'a> {
    /// Every lane.
    All,
    /// The lanes where the mask, \[lanes\], is true.
    Masked(&'a [bool]),
}

impl LaneSet<'_> {
    /// Whether the set contains a lane.
    #[inline]
    pub fn contains(self, lane: usize) -> bool {
        match self {
            LaneSet::All => true,
            LaneSet::Masked(mask) => mask[lane],
        }
    }
}

/// The random streams of an environment's lanes.
///
/// With one stream per lane, a lane depends only on its own stream and actions. With a shared stream, lanes
/// consume words in lane order, so an additional draw in one lane shifts the draws of later lanes. An
/// environment may then also draw for lanes that have ended. While it runs, a single lane draws the same
/// words from a shared stream as from its own.
#[derive(Clone, Debug)]
// Only a few values exist, and every step draws from the shared stream, so it is not boxed.
#[allow(clippy::large_enum_variant)]
pub enum LaneStreams {
    /// One stream for all lanes.
    Shared(Stream),
    /// One stream per lane.
    PerLane(Vec<Stream>),
}

impl LaneStreams {
    /// The stream that a lane draws from.
    #[inline]
    pub fn of(&mut self, lane: usize) -> &mut Stream {
        match self {
            LaneStreams::Shared(stream) => stream,
            LaneStreams::PerLane(streams) => &mut streams[lane],
        }
    }

    /// Fills the lanes' entries in `words`, \[lanes\], with the next words of the streams. From a shared
    /// stream, all of `lanes` consume words; with one stream per lane, the lanes marked in `drawn` do.
    pub(super) fn fill(&mut self, lanes: LaneSet<'_>, drawn: &[bool], words: &mut [u64]) {
        let entries = words.iter_mut().enumerate();
        match self {
            LaneStreams::Shared(stream) if lanes == LaneSet::All => stream.fill(words),
            LaneStreams::Shared(stream) => {
                let takers = entries.filter(|(lane, _)| lanes.contains(*lane));
                takers.for_each(|(_, word)| *word = stream.bits());
            }
            LaneStreams::PerLane(streams) => {
                let takers = entries.filter(|(lane, _)| drawn[*lane]);
                takers.for_each(|(lane, word)| *word = streams[lane].bits());
            }
        }
    }
}

impl Resumable for LaneStreams {
    fn save(&self, out: &mut StateWriter<'_>) -> std::io::Result<()> {
        match self {
            LaneStreams::Shared(stream) => stream.save(out),
            LaneStreams::PerLane(streams) => streams.iter().try_for_each(|stream| stream.save(out)),
        }
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        match self {
            LaneStreams::Shared(stream) => stream.restore(from),
            LaneStreams::PerLane(streams) => {
                streams.iter_mut().try_for_each(|stream| stream.restore(from))
            }
        }
    }
}

/// The actions of an environment and the bounds of its rewards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ActionSpec {
    /// The number of discrete actions, in [`Action::COUNTS`].
    pub count: usize,
    /// The smallest reward of a step.
    pub lowest_reward: f64,
    /// The largest reward of a step.
    pub highest_reward: f64,
}

/// What an agent sees and chooses among.
#[derive(Clone, Debug, PartialEq)]
pub struct Interface {
    /// The specification of observations.
    pub observations: ObservationSpec,
    /// The number of actions.
    pub actions: usize,
}

impl Interface {
    /// The interface of an environment that has not described itself: features without names and bounds, as many as a
    /// scenario names, or else `features`.
    pub(super) fn unknown(scenario: &Scenario, actions: usize, features: usize) -> Interface {
        let (low, high) = (f32::NEG_INFINITY, f32::INFINITY);
        let feature = FeatureSpec { name: String::new(), low, high };
        let features = vec![feature; scenario.names().map_or(features, Iterator::count)];
        Interface { observations: ObservationSpec { features, one_hot: 0 }, actions }
    }
}

/// Many episodes of a simulation, one per lane.
///
/// - Lanes have separate clocks: any lane can be reset while the others continue.
/// - All lanes of a new environment have ended; [`VectorEnvironment::reset`] starts them.
/// - An ended lane is inert until it is reset: its rewards are 0, and its status and observation stay the
///   same. With per-lane streams it draws nothing.
/// - All randomness comes from the streams that are passed in. They are not part of the environment's saved
///   state; their owner saves them.
pub trait VectorEnvironment: Resumable {
    /// The number of lanes.
    fn lanes(&self) -> usize {
        self.statuses().len()
    }

    /// The actions and the bounds of rewards.
    fn action_spec(&self) -> ActionSpec;

    /// The specification of observations.
    fn observation_spec(&self) -> ObservationSpec;

    /// What an agent sees and chooses among.
    fn interface(&self) -> Interface {
        Interface { observations: self.observation_spec(), actions: self.action_spec().count }
    }

    /// Hears the probabilities of the actions of the next step, \[lanes, actions\], row by row; NaN where they are unknown.
    /// Does nothing by default.
    fn expect(&mut self, probabilities: &[f64]) {
        let _ = probabilities;
    }

    /// Starts a new episode in these lanes and leaves the other lanes unchanged. Draws for these lanes only,
    /// in lane order.
    fn reset(&mut self, lanes: LaneSet<'_>, streams: &mut LaneStreams);

    /// Takes one step in every running lane.
    ///
    /// **Shapes**: `actions` and `rewards` are \[lanes\]. The actions of ended lanes are not read.
    fn step(&mut self, actions: &[Action], rewards: &mut [f64], streams: &mut LaneStreams);

    /// The status of every lane, \[lanes\].
    fn statuses(&self) -> &[EpisodeStatus];

    /// Replaces the rows of `out` by the current observation of every lane. The rows of `out` have the width
    /// of the observation specification.
    fn observe(&self, out: &mut Observations);

    /// The amounts that a step adds to the returns, \[lanes\]. The default is `rewards`, the rewards of the
    /// last step. Implementations differ where agents learn from another reward.
    fn outcomes<'a>(&'a self, rewards: &'a [f64]) -> &'a [f64] {
        rewards
    }

    /// Whether a message can be sent in a lane's next step. Where it cannot, the step takes action 0, whatever
    /// is chosen. True by default.
    fn can_send(&self, lane: usize) -> bool {
        let _ = lane;
        true
    }

    /// Whether any lane is running.
    fn any_running(&self) -> bool {
        self.statuses().contains(&EpisodeStatus::Running)
    }
}
