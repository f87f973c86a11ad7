//! A test that every [`VectorEnvironment`] has to pass.
//!
//! In: a function that makes an environment. Out: nothing, or the first [`ContractViolation`] of the contract.
//! [`check`] plays episodes with random actions and compares walks that must agree bit for bit. The
//! module depends only on the trait.

use std::fmt;

use crate::env::observation::Observations;
use crate::env::vector::{Action, EpisodeStatus, LaneSet, LaneStreams, VectorEnvironment};
use crate::rng::{Purpose, Stream};
use crate::state::{StateReader, StateWriter};

/// A clause of the contract.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Clause {
    /// Lanes, statuses and observations have the requested and specified sizes, and there are 2 to 256
    /// actions.
    Shapes,
    /// All lanes of a new environment have ended, and a reset starts them.
    Reset,
    /// At least one episode ends in the walk. Otherwise the walk was too short to test the contract.
    SomeEpisodeEnds,
    /// Observations lie inside their specified bounds.
    ObservationBounds,
    /// Rewards lie inside their specified bounds.
    RewardBounds,
    /// A lane that has ended has reward 0, keeps its status and observation, and does not draw from its
    /// stream.
    EndedLanesAreInert,
    /// The same streams and actions give the same episodes.
    SameStreamSameEpisodes,
    /// With one stream per lane, a lane does not depend on its neighbours. A single lane behaves the same
    /// with a shared stream and with its own.
    LanesAreIndependent,
    /// A reset in the middle of an episode makes the lane like a new one and leaves its neighbours unchanged.
    ResetInMidEpisode,
    /// An environment that is saved and restored at any step continues identically.
    SaveAndRestore,
}

/// How an environment broke the contract.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("step {step}: {clause}: {detail}")]
pub struct ContractViolation {
    /// The clause.
    pub clause: Clause,
    /// The step of the walk, from 0.
    pub step: usize,
    /// A description of the violation.
    pub detail: String,
}

impl fmt::Display for Clause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Clause::Shapes => "sizes agree with the specifications",
            Clause::Reset => "lanes have ended until they are reset, and then run",
            Clause::SomeEpisodeEnds => "an episode ends within the walk",
            Clause::ObservationBounds => "observations lie inside their bounds",
            Clause::RewardBounds => "rewards lie inside their bounds",
            Clause::EndedLanesAreInert => "a lane that has ended is inert",
            Clause::SameStreamSameEpisodes => "the same stream gives the same episodes",
            Clause::LanesAreIndependent => "a lane does not depend on its neighbours",
            Clause::ResetInMidEpisode => "a lane that is reset in mid-episode is as new",
            Clause::SaveAndRestore => "a restored environment continues as the saved one",
        })
    }
}

/// Tests an environment. `make` returns a new environment with the given number of lanes. Every walk takes
/// `steps` steps, which should cover several episodes.
///
/// **Errors**: the first violation.
pub fn check<Env: VectorEnvironment>(
    make: impl Fn(usize) -> Env,
    steps: usize,
) -> Result<(), ContractViolation> {
    check_walks(&make, steps, true)?;
    check_restoring(&make, steps, Sharing::Shared)?;
    check_restoring(&make, steps, Sharing::PerLane)
}

/// Tests an environment like [`check`], except that it need not save and restore its state. Episodes longer than
/// the walk are permitted unless `must_end`.
///
/// **Errors**: the first violation.
pub fn check_walks<Env: VectorEnvironment>(
    make: impl Fn(usize) -> Env,
    steps: usize,
    must_end: bool,
) -> Result<(), ContractViolation> {
    for sharing in [Sharing::Shared, Sharing::PerLane] {
        check_steps(Walk::new(make(LANES), &SEEDS, sharing)?, steps, must_end)?;
        check_same_episodes(&make, steps, sharing)?;
    }
    check_independence(&make, steps)?;
    check_resets(&make, steps)
}

/// The number of lanes in most walks.
const LANES: usize = 3;
/// The seeds of the lanes' streams.
const SEEDS: [u64; LANES] = [11, 12, 13];
/// The number of steps that an ended lane waits for its reset, where waiting is tested.
const WAIT: usize = 3;

/// How lanes get their random numbers.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Sharing {
    Shared,
    PerLane,
}

/// An environment with the streams and actions of a walk.
struct Walk<Env> {
    environment: Env,
    streams: LaneStreams,
    /// The stream of random actions, per lane.
    choices: Vec<Stream>,
    actions: Vec<Action>,
    rewards: Vec<f64>,
    observations: Observations,
    count: u32,
}

/// The observable state of a lane after a step, bit by bit.
#[derive(Clone, PartialEq, Eq)]
struct Seen {
    status: EpisodeStatus,
    reward: u64,
    features: Vec<u32>,
    moment: Option<u32>,
    /// Of a running lane.
    can_send: Option<bool>,
}

impl fmt::Debug for Seen {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let features: Vec<f32> = self.features.iter().map(|bits| f32::from_bits(*bits)).collect();
        write!(f, "{:?} {features:?} ", self.status)?;
        self.moment.map_or(Ok(()), |moment| write!(f, "at {moment} "))?;
        self.can_send.filter(|can| !can).map_or(Ok(()), |_| write!(f, "without a message "))?;
        write!(f, "with reward {:?}", f64::from_bits(self.reward))
    }
}

impl<Env: VectorEnvironment> Walk<Env> {
    /// A walk at the first step of every lane; lane i has seed i.
    fn new(environment: Env, seeds: &[u64], sharing: Sharing) -> Result<Self, ContractViolation> {
        let broken = |clause, detail| Err(ContractViolation { clause, step: 0, detail });
        let lanes = seeds.len();
        if environment.lanes() != lanes || environment.statuses().len() != lanes {
            let (has, statuses) = (environment.lanes(), environment.statuses().len());
            let detail = format!("{lanes} lanes asked for, {has} lanes, {statuses} statuses");
            return broken(Clause::Shapes, detail);
        }
        if environment.any_running() {
            return broken(Clause::Reset, "a lane runs before its first reset".to_owned());
        }
        let count = environment.action_spec().count;
        if !Action::COUNTS.contains(&count) {
            return broken(Clause::Shapes, format!("{count} actions are not 2 to 256"));
        }
        let streams = |purpose| seeds.iter().map(move |seed| Stream::new(*seed, purpose)).collect();
        let mut walk = Walk {
            streams: match sharing {
                Sharing::Shared => LaneStreams::Shared(Stream::new(seeds[0], Purpose::Environment)),
                Sharing::PerLane => LaneStreams::PerLane(streams(Purpose::Environment)),
            },
            choices: streams(Purpose::Exploration),
            actions: vec![Action::default(); lanes],
            rewards: vec![0.0; lanes],
            observations: environment.observation_spec().observations(),
            count: count as u32,
            environment,
        };
        walk.environment.reset(LaneSet::All, &mut walk.streams);
        if !walk.environment.statuses().iter().all(|s| *s == EpisodeStatus::Running) {
            return broken(Clause::Reset, "a lane does not run after its reset".to_owned());
        }
        Ok(walk)
    }

    /// Steps with random actions.
    fn step(&mut self) {
        for (lane, action) in self.actions.iter_mut().enumerate() {
            if self.environment.statuses()[lane] == EpisodeStatus::Running {
                let index = self.choices[lane].below(self.count) as usize;
                *action = Action::from_index(index).expect("at most 256 actions");
            }
        }
        self.environment.step(&self.actions, &mut self.rewards, &mut self.streams);
    }

    fn reset(&mut self, resets: impl Fn(usize, EpisodeStatus) -> bool) {
        let statuses = self.environment.statuses().iter().enumerate();
        let mask: Vec<bool> = statuses.map(|(lane, status)| resets(lane, *status)).collect();
        self.environment.reset(LaneSet::Masked(&mask), &mut self.streams);
    }

    fn reset_ended(&mut self) {
        self.reset(|_, status| status != EpisodeStatus::Running);
    }

    /// The observable state of every lane, with the rewards of the last step.
    fn seen(&mut self) -> Vec<Seen> {
        self.environment.observe(&mut self.observations);
        let (environment, observations) = (&self.environment, &self.observations);
        let seen = |(lane, status): (usize, &EpisodeStatus)| Seen {
            status: *status,
            reward: self.rewards[lane].to_bits(),
            features: observations.row(lane).iter().map(|feature| feature.to_bits()).collect(),
            moment: observations.moment(lane),
            can_send: (*status == EpisodeStatus::Running).then(|| environment.can_send(lane)),
        };
        self.environment.statuses().iter().enumerate().map(seen).collect()
    }

    /// The number of words drawn from the stream of a lane.
    fn drawn(&mut self, lane: usize) -> u64 {
        self.streams.of(lane).position()
    }

    fn check_bounds(&mut self, step: usize, ran: &[bool]) -> Result<(), ContractViolation> {
        let broken = |clause, detail| Err(ContractViolation { clause, step, detail });
        self.environment.observe(&mut self.observations);
        let spec = self.environment.observation_spec();
        let observations = &self.observations;
        let shape = (observations.rows(), observations.width(), observations.one_hot());
        let moments = if spec.one_hot > 0 { ran.len() } else { 0 };
        if shape != (ran.len(), spec.features.len(), spec.one_hot)
            || observations.moments().len() != moments
        {
            let detail = format!("rows, features and one-hot of the observations are {shape:?}");
            return broken(Clause::Shapes, detail);
        }
        for (lane, ran) in ran.iter().enumerate() {
            for (feature, value) in spec.features.iter().zip(observations.row(lane)) {
                if !(feature.low..=feature.high).contains(value) {
                    let detail = format!("{} is {value} in lane {lane}", feature.name);
                    return broken(Clause::ObservationBounds, detail);
                }
            }
            if observations.moment(lane).is_some_and(|moment| moment as usize >= spec.one_hot) {
                let detail = format!("the moment of lane {lane} is outside the one-hot");
                return broken(Clause::ObservationBounds, detail);
            }
            let actions = self.environment.action_spec();
            let (reward, bounds) =
                (self.rewards[lane], actions.lowest_reward..=actions.highest_reward);
            if *ran && !bounds.contains(&reward) {
                let detail = format!("{reward} in lane {lane} is outside {bounds:?}");
                return broken(Clause::RewardBounds, detail);
            }
        }
        Ok(())
    }
}

/// Checks the bounds, and that ended lanes are inert.
fn check_steps<Env: VectorEnvironment>(
    mut walk: Walk<Env>,
    steps: usize,
    must_end: bool,
) -> Result<(), ContractViolation> {
    let per_lane = matches!(walk.streams, LaneStreams::PerLane(_));
    let mut waited = [0; LANES];
    let mut ends = 0;
    walk.check_bounds(0, &[false; LANES])?;
    for step in 0..steps {
        let before = walk.seen();
        let ran: Vec<bool> = before.iter().map(|s| s.status == EpisodeStatus::Running).collect();
        let drawn: Vec<u64> = (0..LANES).map(|lane| walk.drawn(lane)).collect();
        walk.step();
        walk.check_bounds(step, &ran)?;
        let after = walk.seen();
        for lane in (0..LANES).filter(|lane| !ran[*lane]) {
            let inert = Seen { reward: 0.0_f64.to_bits(), ..before[lane].clone() };
            if after[lane] != inert || (per_lane && walk.drawn(lane) != drawn[lane]) {
                let detail = format!("lane {lane} had ended as {inert:?}, now {:?}", after[lane]);
                return Err(ContractViolation { clause: Clause::EndedLanesAreInert, step, detail });
            }
            waited[lane] += 1;
        }
        ends +=
            (0..LANES).filter(|i| ran[*i] && after[*i].status != EpisodeStatus::Running).count();
        let waits = waited;
        walk.reset(|lane, _| waits[lane] == WAIT);
        waited.iter_mut().filter(|waited| **waited == WAIT).for_each(|waited| *waited = 0);
    }
    if must_end && ends == 0 {
        let detail = format!("none did in {steps} steps");
        return Err(ContractViolation { clause: Clause::SomeEpisodeEnds, step: steps, detail });
    }
    Ok(())
}

/// Fails unless lanes look the same.
fn require_equal(
    clause: Clause,
    step: usize,
    seen: &[Seen],
    expected: &[Seen],
) -> Result<(), ContractViolation> {
    if seen == expected {
        return Ok(());
    }
    let lane = seen.iter().zip(expected).position(|(seen, expected)| seen != expected);
    let detail = match lane {
        Some(lane) => {
            let number = if seen.len() == 1 { String::new() } else { format!(" {lane}") };
            format!("lane{number} is {:?}, expected {:?}", seen[lane], expected[lane])
        }
        None => format!("{} lanes, expected {}", seen.len(), expected.len()),
    };
    Err(ContractViolation { clause, step, detail })
}

fn check_same_episodes<Env: VectorEnvironment>(
    make: impl Fn(usize) -> Env,
    steps: usize,
    sharing: Sharing,
) -> Result<(), ContractViolation> {
    let mut one = Walk::new(make(LANES), &SEEDS, sharing)?;
    let mut other = Walk::new(make(LANES), &SEEDS, sharing)?;
    for step in 0..steps {
        require_equal(Clause::SameStreamSameEpisodes, step, &other.seen(), &one.seen())?;
        for walk in [&mut one, &mut other] {
            walk.step();
        }
        require_equal(Clause::SameStreamSameEpisodes, step, &other.seen(), &one.seen())?;
        for walk in [&mut one, &mut other] {
            walk.reset_ended();
        }
    }
    Ok(())
}

/// Before every step, saves the environment and restores it into another one.
fn check_restoring<Env: VectorEnvironment>(
    make: impl Fn(usize) -> Env,
    steps: usize,
    sharing: Sharing,
) -> Result<(), ContractViolation> {
    let clause = Clause::SaveAndRestore;
    let mut undisturbed = Walk::new(make(LANES), &SEEDS, sharing)?;
    let mut restored = Walk::new(make(LANES), &SEEDS, sharing)?;
    for step in 0..steps {
        let broken = |detail: String| ContractViolation { clause, step, detail };
        let save = |environment: &Env| {
            let mut bytes = Vec::new();
            let saved = environment.save(&mut StateWriter::new(&mut bytes));
            saved.map(|()| bytes).map_err(|error| broken(format!("it is not saved: {error}")))
        };
        let saved = save(&restored.environment)?;
        let mut environment = make(LANES);
        let mut left = &saved[..];
        environment
            .restore(&mut StateReader::new(&mut left))
            .map_err(|error| broken(format!("it is not restored: {error}")))?;
        if !left.is_empty() || save(&environment)? != saved {
            return Err(broken("it restores other bytes than it saved".to_owned()));
        }
        restored.environment = environment;
        require_equal(clause, step, &restored.seen(), &undisturbed.seen())?;
        restored.step();
        undisturbed.step();
        require_equal(clause, step, &restored.seen(), &undisturbed.seen())?;
        restored.reset_ended();
        undisturbed.reset_ended();
    }
    Ok(())
}

/// Compares a lane between two others with the same lane alone, with both kinds of streams.
fn check_independence<Env: VectorEnvironment>(
    make: impl Fn(usize) -> Env,
    steps: usize,
) -> Result<(), ContractViolation> {
    const BETWEEN: usize = 1;
    let clause = Clause::LanesAreIndependent;
    let mut among = Walk::new(make(LANES), &SEEDS, Sharing::PerLane)?;
    let mut alone = Walk::new(make(1), &[SEEDS[BETWEEN]], Sharing::PerLane)?;
    let mut sharing = Walk::new(make(1), &[SEEDS[BETWEEN]], Sharing::Shared)?;
    for step in 0..steps {
        let expected = alone.seen();
        require_equal(clause, step, &among.seen()[BETWEEN..=BETWEEN], &expected)?;
        require_equal(clause, step, &sharing.seen(), &expected)?;
        alone.step();
        sharing.step();
        among.step();
        let expected = alone.seen();
        require_equal(clause, step, &among.seen()[BETWEEN..=BETWEEN], &expected)?;
        require_equal(clause, step, &sharing.seen(), &expected)?;
        alone.reset_ended();
        sharing.reset_ended();
        // The neighbours are reset at some steps, whether or not they have ended.
        among.reset(|lane, status| match lane {
            BETWEEN => status != EpisodeStatus::Running,
            _ => step % (3 + 2 * lane) == 0,
        });
    }
    Ok(())
}

/// Resets one lane after the other in the middle of an episode. Compares each with a new environment of one
/// lane until the next reset.
fn check_resets<Env: VectorEnvironment>(
    make: impl Fn(usize) -> Env,
    steps: usize,
) -> Result<(), ContractViolation> {
    const EVERY: usize = 4;
    let clause = Clause::ResetInMidEpisode;
    let mut walk = Walk::new(make(LANES), &SEEDS, Sharing::PerLane)?;
    let mut compared: Option<(usize, Walk<Env>)> = None;
    for step in 0..steps {
        if step % EVERY == EVERY - 1 {
            let lane = step / EVERY % LANES;
            let before = walk.seen();
            let mut new = Walk::new(make(1), &[0], Sharing::PerLane)?;
            new.streams = LaneStreams::PerLane(vec![walk.streams.of(lane).clone()]);
            new.choices = vec![walk.choices[lane].clone()];
            new.rewards[0] = walk.rewards[lane];
            // Makes another new environment, because `Walk::new` has reset the first one with another stream.
            new.environment = make(1);
            new.environment.reset(LaneSet::All, &mut new.streams);
            walk.reset(|other, _| other == lane);
            let after = walk.seen();
            for other in (0..LANES).filter(|other| *other != lane) {
                let (after, before) = (&after[other..=other], &before[other..=other]);
                require_equal(clause, step, after, before)?;
            }
            compared = Some((lane, new));
        }
        if let Some((lane, new)) = &mut compared {
            require_equal(clause, step, &walk.seen()[*lane..=*lane], &new.seen())?;
        }
        walk.step();
        if let Some((lane, new)) = &mut compared {
            new.step();
            require_equal(clause, step, &walk.seen()[*lane..=*lane], &new.seen())?;
            new.reset_ended();
        }
        walk.reset_ended();
    }
    Ok(())
}
