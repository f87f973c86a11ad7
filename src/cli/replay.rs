//! `jitai simulate --replay`: forces recorded contexts and actions, prints what follows from them.

use std::fs::File;
use std::io::{self, Read, Write};
use std::path::Path;

use serde::Deserialize;

use crate::cli::output::{Cell, Format, Rows};
use crate::cli::{Error, Exit};
use crate::env::{Action, Ending, Episodes, Signal};
use crate::manifest::Environment;
use crate::rng::{Purpose, Stream};

/// Most bytes of a file of trajectories.
const MOST_BYTES: u64 = 100_000_000;

/// A file of trajectories.
#[derive(Deserialize)]
struct Trajectories {
    cases: Vec<Case>,
}

/// One episode.
#[derive(Deserialize)]
struct Case {
    sigma: f64,
    parameters: serde_json::Map<String, serde_json::Value>,
    horizon: u32,
    steps: Vec<Step>,
    /// Whether the recorded episode ended in disengagement.
    disengaged: Option<bool>,
}

/// One step: what is forced, and what the recording says should follow.
#[derive(Deserialize)]
struct Step {
    context: u8,
    p0: f64,
    action: usize,
    habituation: Option<f64>,
    disengagement: Option<f64>,
    reward: Option<f64>,
}

const COLUMNS: [&str; 10] = [
    "case",
    "step",
    "context",
    "p0",
    "inferred",
    "habituation",
    "disengagement",
    "action",
    "reward",
    "ending",
];

pub(super) fn run(path: &Path, format: Format) -> Result<Exit, Error> {
    let file = read(path)?;
    let columns = COLUMNS.map(str::to_owned);
    let mut rows = Rows::new(format, &columns, io::stdout().lock())?;
    let mut difference = Difference::default();
    for (number, case) in file.cases.iter().enumerate() {
        replay(number, case, &mut rows, &mut difference).map_err(|fault| match fault {
            Fault::Case(what) => Error::Usage(format!("{}: case {number}: {what}", path.display())),
            Fault::Output(error) => error.into(),
        })?;
    }
    rows.finish()?;
    let Difference { steps, largest, endings } = difference;
    writeln!(
        io::stderr(),
        "{} cases, {steps} steps; largest difference from recorded habituation, disengagement \
         and reward: {largest:.1e}; endings that differ: {endings}",
        file.cases.len()
    )?;
    Ok(Exit::Done)
}

fn read(path: &Path) -> Result<Trajectories, Error> {
    let io_error =
        |source| Error::Io { what: format!("read trajectories `{}`", path.display()), source };
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(io_error)?;
    file.take(MOST_BYTES + 1).read_to_end(&mut bytes).map_err(io_error)?;
    if bytes.len() as u64 > MOST_BYTES {
        return Err(Error::Usage(format!("{}: more than {MOST_BYTES} bytes", path.display())));
    }
    serde_json::from_slice(&bytes)
        .map_err(|error| Error::Usage(format!("{}: {error}", path.display())))
}

/// How far the simulation is from the recording.
#[derive(Default)]
struct Difference {
    steps: usize,
    largest: f64,
    endings: usize,
}

impl Difference {
    fn add(&mut self, ours: f64, recorded: Option<f64>) {
        if let Some(recorded) = recorded {
            self.largest = self.largest.max((ours - recorded).abs());
        }
    }
}

enum Fault {
    /// The case cannot be replayed.
    Case(String),
    /// The rows cannot be written.
    Output(io::Error),
}

impl From<io::Error> for Fault {
    fn from(error: io::Error) -> Self {
        Fault::Output(error)
    }
}

fn environment(case: &Case) -> Result<Environment, Fault> {
    let mut all = serde_json::json!(Environment::paper(case.sigma));
    all["horizon"] = case.horizon.into();
    for (name, value) in &case.parameters {
        all[name] = value.clone();
    }
    serde_json::from_value(all).map_err(|error| Fault::Case(format!("parameters: {error}")))
}

fn replay<W: Write>(
    number: usize,
    case: &Case,
    rows: &mut Rows<W>,
    difference: &mut Difference,
) -> Result<(), Fault> {
    let environment = environment(case)?;
    // Every context is forced, so nothing of this stream is seen.
    let mut episodes =
        Episodes::start(&environment, 1, &mut Stream::new(0, Purpose::TestEnvironment));
    for (t, step) in case.steps.iter().enumerate() {
        if !episodes.any_running() {
            return Err(Fault::Case(format!("step {t} comes after the end of the episode")));
        }
        let action = Action::from_index(step.action).ok_or_else(|| {
            Fault::Case(format!("step {t}: action {} is not 0 to 3", step.action))
        })?;
        if step.context > 1 || !(0.0..=1.0).contains(&step.p0) {
            let message = format!("step {t}: the context is 0 or 1, and p0 from 0 to 1");
            return Err(Fault::Case(message));
        }
        let signal = Signal::new(step.context, step.p0);
        episodes.show(0, signal);
        let (habituation, disengagement) = (episodes.habituation()[0], episodes.disengagement()[0]);
        let mut reward = [0.0];
        episodes.respond(&[action], &mut reward);
        difference.steps += 1;
        difference.add(habituation, step.habituation);
        difference.add(disengagement, step.disengagement);
        difference.add(reward[0], step.reward);
        rows.row(&[
            Cell::Integer(number as i64),
            Cell::Integer(t as i64),
            Cell::Integer(i64::from(signal.context)),
            Cell::Real(signal.probability_of_zero),
            Cell::Integer(i64::from(signal.likely)),
            Cell::Real(habituation),
            Cell::Real(disengagement),
            Cell::Integer(action.index() as i64),
            Cell::Real(reward[0]),
            Cell::text(episodes.endings()[0].name()),
        ])?;
    }
    let disengaged = episodes.endings()[0] == Ending::Terminated;
    difference.endings += usize::from(case.disengaged.is_some_and(|theirs| theirs != disengaged));
    Ok(())
}
