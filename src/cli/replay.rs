//! `jitai simulate --replay`: forces recorded contexts and actions, prints the resulting steps, and
//! lists where they differ from the recording.

use std::fmt::Display;
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;

use serde::Deserialize;

use crate::cli::output::{Format, counted};
use crate::cli::setting::preset;
use crate::cli::steps::{ShownStep, StepRows};
use crate::cli::{Error, Exit};
use crate::env::{
    Action, ContextDraw, EpisodeStatus, Feature, ForcedNoise, LaneSet, LaneStreams,
    PhysicalActivity, Scenario, StateNoise, StepCount, StepNoise, VectorEnvironment,
};
use crate::key::Keyed;
use crate::rng::{Purpose, Stream};

/// Maximum size of a file of trajectories, in bytes.
const MOST_BYTES: u64 = 100_000_000;
/// Maximum number of differences listed.
const DIFFERENCES_SHOWN: usize = 10;
/// Tolerance for the rounding of recorded numbers: absolute up to 1, relative above 1.
const TOLERANCE: f64 = 1e-9;

/// The expected content of a file, for messages.
const EXPECTED: &str = "expected JSON like {\"cases\": [{\"sigma\": 0.6, \"parameters\": {}, \
    \"horizon\": 50, \"steps\": [{\"context\": 0, \"p0\": 0.7, \"action\": 1}]}]}";

/// A file of trajectories.
#[derive(Deserialize)]
pub(super) struct TrajectoryFile {
    cases: Vec<Case>,
}

/// One episode.
#[derive(Deserialize)]
struct Case {
    /// The preset that `parameters` override; if absent, the paper's environment.
    extends: Option<String>,
    sigma: f64,
    parameters: serde_json::Map<String, serde_json::Value>,
    horizon: u32,
    steps: Vec<Recorded>,
    /// The recorded state after the last step.
    #[serde(rename = "final")]
    last: Option<State>,
    /// Whether the recorded episode ended in disengagement.
    disengaged: Option<bool>,
}

/// One step: the forced values, and the values that the recording expects.
#[derive(Deserialize)]
struct Recorded {
    context: u8,
    p0: f64,
    action: usize,
    /// Whether a message could be sent, 0 or 1; if absent, 1.
    available: Option<u8>,
    #[serde(alias = "inferred")]
    likely: Option<u8>,
    habituation: Option<f64>,
    disengagement: Option<f64>,
    reward: Option<f64>,
}

#[derive(Deserialize)]
struct State {
    habituation: Option<f64>,
    disengagement: Option<f64>,
}

pub(super) fn run(path: &Path, format: Format) -> Result<Exit, Error> {
    let fault = |what| Error::Usage(format!("{}: {what}", path.display()));
    let file = parse(&read(path)?).map_err(fault)?;
    let mut rows = StepRows::new(format, io::stdout().lock())?;
    let differences = file.replay(&mut rows)?.map_err(fault)?;
    rows.finish()?;
    differences.report(file.cases.len())?;
    Ok(if differences.count == 0 { Exit::Done } else { Exit::Differs })
}

fn read(path: &Path) -> Result<Vec<u8>, Error> {
    // A missing file is a usage error, as for manifests.
    let wrong_file = |error: io::Error| {
        let path = path.display();
        Error::Usage(format!("cannot read trajectories from `{path}`: {error}"))
    };
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(wrong_file)?;
    file.take(MOST_BYTES + 1).read_to_end(&mut bytes).map_err(wrong_file)?;
    Ok(bytes)
}

/// Parses a file of trajectories.
pub(super) fn parse(bytes: &[u8]) -> Result<TrajectoryFile, String> {
    if bytes.len() as u64 > MOST_BYTES {
        return Err(format!("the file is larger than {MOST_BYTES} bytes; split its episodes"));
    }
    serde_json::from_slice(bytes).map_err(|error| format!("{error}; {EXPECTED}"))
}

impl TrajectoryFile {
    /// Replays every episode into `rows` and returns the differences.
    ///
    /// **Errors**: an episode that cannot be replayed; the output cannot be written.
    pub(super) fn replay<W: Write>(
        &self,
        rows: &mut StepRows<W>,
    ) -> io::Result<Result<Differences, String>> {
        let mut differences = Differences::default();
        for (number, case) in (1..).zip(&self.cases) {
            let (steps, lane) = match replay(case) {
                Ok(replayed) => replayed,
                Err(what) => return Ok(Err(format!("episode {number}, {what}"))),
            };
            rows.episode(number, &steps)?;
            differences.look(number, case, &steps, &lane);
        }
        Ok(Ok(differences))
    }
}

fn environment(case: &Case) -> Result<StepCount, String> {
    let mut settings = case.parameters.clone();
    settings.entry("horizon").or_insert_with(|| case.horizon.into());
    let extended = match &case.extends {
        Some(name) => preset(name, case.sigma)?,
        None => StepCount::paper(case.sigma),
    };
    extended.with_settings(&settings).map_err(|error| format!("parameters: {error}"))
}

/// Replays an episode; returns its steps and the lane after the last step.
fn replay(case: &Case) -> Result<(Vec<ShownStep>, PhysicalActivity), String> {
    let environment = environment(case)?;
    // The lane is not observed, and every context is set, so the random stream has no effect.
    let mut lane = PhysicalActivity::new(&environment, &Scenario::of(Feature::Context), 1);
    let stream = Stream::new(0, Purpose::TestEnvironment);
    lane.reset(LaneSet::All, &mut LaneStreams::Shared(stream));
    let mut all = Vec::with_capacity(case.steps.len());
    for (t, recorded) in case.steps.iter().enumerate() {
        let action = Action::option(recorded.action);
        let refused =
            || format!("step {t}: expected an action from 0 to 3, found {}", recorded.action);
        all.push(action.ok_or_else(refused)?);
    }
    let mut steps = Vec::with_capacity(case.steps.len());
    for (t, recorded) in case.steps.iter().enumerate() {
        if !lane.any_running() {
            return Err(format!("step {t} comes after the end of the episode"));
        }
        if recorded.context > 1 || !(0.0..=1.0).contains(&recorded.p0) {
            return Err(format!("step {t}: expected `context` 0 or 1, and `p0` from 0 to 1"));
        }
        if recorded.available.is_some_and(|available| available > 1) {
            return Err(format!("step {t}: expected `available` 0 or 1"));
        }
        lane.set_context(0, ContextDraw::new(recorded.context, recorded.p0));
        lane.set_available(0, recorded.available != Some(0));
        let mut step = ShownStep::chosen(&lane, all[t]);
        // The plain step does not know that a message was unavailable.
        let (actions, mut reward) = ([lane.taken(0, all[t])], [0.0]);
        match forced(&environment, case, t)? {
            Some(noise) => lane.force_step(&noise, &actions, &mut reward),
            None => lane.apply_actions(&actions, &mut reward),
        }
        step.pay(&lane, lane.outcomes(&reward)[0]);
        steps.push(step);
    }
    Ok((steps, lane))
}

/// The recorded outcomes to force in a step; `None` for an environment without noise.
fn forced(environment: &StepCount, case: &Case, t: usize) -> Result<Option<ForcedNoise>, String> {
    let is_noisy =
        environment.state_noise != StateNoise::None || environment.parameter_spread > 0.0;
    let has_noisy_steps = environment.step_noise != StepNoise::None;
    if !is_noisy && !has_noisy_steps {
        return Ok(None);
    }
    let next = match case.steps.get(t + 1) {
        Some(next) => (next.habituation, next.disengagement),
        None => {
            case.last.as_ref().map_or((None, None), |last| (last.habituation, last.disengagement))
        }
    };
    let inside = |x: &f64| (0.0..=1.0).contains(x);
    let state = match next {
        _ if !is_noisy => None,
        (Some(h), Some(d)) if inside(&h) && inside(&d) => Some([h, d]),
        _ => {
            return Err(format!(
                "step {t}: with state noise, `habituation` and `disengagement` from 0 to 1 are \
                 required in the next step, or in `final` after the last"
            ));
        }
    };
    let steps = case.steps[t].reward.filter(|_| has_noisy_steps);
    if has_noisy_steps && !steps.is_some_and(f64::is_finite) {
        return Err(format!(
            "step {t}: with noise of the steps walked, a finite `reward` is required"
        ));
    }
    Ok(Some(ForcedNoise { state, steps }))
}

/// The differences between simulation and recording.
#[derive(Default)]
pub(super) struct Differences {
    steps: usize,
    /// The largest absolute difference of a number.
    largest: f64,
    /// Number of recorded values that differ.
    pub(super) count: usize,
    /// Descriptions of the first differences.
    first: Vec<String>,
}

impl Differences {
    /// Compares an episode with its recorded values.
    fn look(&mut self, number: usize, case: &Case, steps: &[ShownStep], lane: &PhysicalActivity) {
        self.steps += steps.len();
        for (step, recorded) in steps.iter().zip(&case.steps) {
            let place = format!("episode {number}, step {}", step.time);
            self.word(&place, "likely", step.draw.likely, recorded.likely);
            self.number(&place, "habituation", step.habituation, recorded.habituation);
            self.number(&place, "disengagement", step.disengagement, recorded.disengagement);
            self.number(&place, "reward", step.reward, recorded.reward);
        }
        let place = format!("episode {number}, after its last step");
        if let Some(last) = &case.last {
            self.number(&place, "habituation", lane.habituation()[0], last.habituation);
            let disengagement = lane.disengagement()[0];
            self.number(&place, "disengagement", disengagement, last.disengagement);
        }
        let disengaged = lane.statuses()[0] == EpisodeStatus::Terminated;
        self.word(&place, "disengaged", disengaged, case.disengaged);
    }

    fn number(&mut self, place: &str, name: &str, ours: f64, recorded: Option<f64>) {
        let Some(recorded) = recorded else { return };
        let difference = (ours - recorded).abs();
        self.largest = self.largest.max(difference);
        if difference > TOLERANCE * recorded.abs().max(1.0) {
            self.add(format!("{place}: {name} is {ours}, recorded {recorded}"));
        }
    }

    fn word<T: Display + PartialEq>(
        &mut self,
        place: &str,
        name: &str,
        ours: T,
        recorded: Option<T>,
    ) {
        if let Some(recorded) = recorded.filter(|recorded| *recorded != ours) {
            self.add(format!("{place}: {name} is {ours}, recorded {recorded}"));
        }
    }

    fn add(&mut self, line: String) {
        self.count += 1;
        if self.first.len() < DIFFERENCES_SHOWN {
            self.first.push(line);
        }
    }

    fn report(&self, episodes: usize) -> io::Result<()> {
        let mut err = io::stderr();
        for line in &self.first {
            writeln!(err, "{line}")?;
        }
        if self.count > self.first.len() {
            writeln!(err, "and {} more", self.count - self.first.len())?;
        }
        writeln!(
            err,
            "{}, {}; {} {}; largest numerical difference: {:.1e}",
            counted(episodes, "episode"),
            counted(self.steps, "step"),
            counted(self.count, "recorded value"),
            if self.count == 1 { "differs" } else { "differ" },
            self.largest
        )
    }
}
