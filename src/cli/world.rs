//! `jitai simulate --model`: people of a model, with every variable of their days.

use std::io;

use crate::agent::{Actor, RulePolicy, Start};
use crate::cli::Error;
use crate::cli::output::{Format, OutputField, OutputRows};
use crate::cli::setting::name_and_value;
use crate::env::{Action, Environment, EpisodeStatus, LaneStreams, Simulated, VectorEnvironment};
use crate::job::Job;
use crate::key::quoted;
use crate::manifest;
use crate::plan;
use crate::rng::{Purpose, Stream};
use crate::train::{self, RollStreams, StepObserver};

/// A world and what is rolled in it.
pub(super) struct WorldArguments<'a> {
    /// The files of the model, its people and its rows.
    pub model: &'a str,
    pub people: Option<&'a str>,
    pub rows: Option<&'a str>,
    /// Values of parameters, as NAME=VALUE.
    pub settings: &'a [String],
    pub policy: WorldPolicy,
    pub persons: u32,
    pub seed: u64,
    pub format: Format,
}

/// Who acts.
#[derive(Clone, Copy)]
pub(super) enum WorldPolicy {
    /// A rule of this name.
    Rule(&'static str),
    /// Always this action.
    Fixed(Action),
}

/// Rolls the people and prints a row for each decision.
pub(super) fn run(arguments: &WorldArguments) -> Result<(), Error> {
    let job = job(arguments)?;
    let people = arguments.persons as usize;
    let actor: Box<dyn Actor> = match arguments.policy {
        WorldPolicy::Fixed(action) => {
            let count = job.task().interface().actions;
            if action.index() >= count {
                let says =
                    format!("--policy fixed:{}: the model has {count} actions", action.index());
                return Err(Error::Usage(says));
            }
            Box::new(RulePolicy::fixed(action))
        }
        WorldPolicy::Rule(_) => match job.agent.start(&job.task()) {
            Ok(Start::Actor(actor)) => actor,
            _ => unreachable!("a rule starts as an actor in any environment"),
        },
    };
    let mut actor = actor;
    let mut lanes = job.task().tested(people);
    let person = |person| Stream::of_person(arguments.seed, Purpose::Person, person);
    let mut streams = RollStreams {
        environment: LaneStreams::PerLane((0..arguments.persons).map(person).collect()),
        actions: Stream::new(arguments.seed, Purpose::TestActions),
    };
    let mut days =
        Days { environment: &job.environment, rows: vec![Vec::new(); people], shown: Vec::new() };
    lanes.begin_day(0);
    train::begin(&mut lanes, &mut *actor, &mut streams);
    train::roll(&mut lanes, &mut *actor, &mut streams, &mut days);
    if let Some(failure) = job.environment.failure() {
        return Err(Error::Usage(failure));
    }
    days.print(arguments.format)
}

/// The job of a rule in the world, read as a manifest is.
fn job(arguments: &WorldArguments) -> Result<Job, Error> {
    let rule = match arguments.policy {
        WorldPolicy::Rule(rule) => rule,
        WorldPolicy::Fixed(_) => "random",
    };
    let mut text = format!(
        "format = 1\nname = \"simulate\"\nscenarios = \"all\"\nseeds = 1\n[[agent]]\nname = \"rule\"\nalgorithm = \"rule\"\n\
         rule = {}\n[environment]\nfamily = \"declared\"\nmodel = {}\n",
        quoted(rule),
        quoted(arguments.model)
    );
    for (key, file) in [("people", arguments.people), ("replay", arguments.rows)] {
        if let Some(file) = file {
            text += &format!("{key} = {}\n", quoted(file));
        }
    }
    for setting in arguments.settings {
        let (name, value) = name_and_value(setting)?;
        let value: f64 = value.parse().map_err(|_| {
            Error::Usage(format!("--set {setting}: parameters of a model are numbers"))
        })?;
        let name = name.strip_prefix("parameters.").unwrap_or(name);
        text += &format!("parameters.{} = {value:?}\n", quoted(name));
    }
    let manifest = manifest::parse("options", text.as_bytes());
    let manifest =
        manifest.map_err(|faults| Error::Manifests(vec![faults.of_options(in_options)]))?;
    let job = plan::jobs(&manifest).next().expect("one rule and one seed make a job").job;
    let environment = job.environment.fresh().unwrap_or_else(|| job.environment.clone());
    Ok(Job { environment, ..job })
}

/// What is said of the keys of a manifest, of the options that give them.
fn in_options(says: &str) -> String {
    let words = [
        ("`model`", "`--model`"),
        ("`people`", "`--people`"),
        ("`replay`", "`--rows`"),
        ("people = \"people.csv\" in [environment]", "--people people.csv"),
        ("replay = \"rows.csv\" in [environment]", "--rows rows.csv"),
    ];
    words.iter().fold(says.to_owned(), |says, (key, option)| says.replace(key, option))
}

/// The decisions of every person.
struct Days<'e> {
    environment: &'e Environment,
    /// \[people\]: their decisions.
    rows: Vec<Vec<ShownDecision>>,
    /// The lanes of the present step.
    shown: Vec<usize>,
}

/// A decision.
#[derive(Clone)]
struct ShownDecision {
    step: u32,
    can_send: bool,
    action: Action,
    state: Vec<f64>,
    outcome: f64,
    reward: f64,
}

impl StepObserver<Simulated> for Days<'_> {
    fn chosen(&mut self, lanes: &Simulated, actions: &[Action], _: &[f64]) {
        self.shown.clear();
        for (lane, status) in lanes.statuses().iter().enumerate() {
            if *status != EpisodeStatus::Running {
                continue;
            }
            let mut state = Vec::new();
            lanes.record_state(lane, &mut state);
            self.shown.push(lane);
            self.rows[lane].push(ShownDecision {
                step: lanes.time(lane),
                can_send: lanes.can_send(lane),
                action: lanes.taken(lane, actions[lane]),
                state,
                outcome: 0.0,
                reward: 0.0,
            });
        }
    }

    fn paid(&mut self, lanes: &Simulated, rewards: &[f64]) {
        let outcomes = lanes.outcomes(rewards);
        for lane in &self.shown {
            if let Some(row) = self.rows[*lane].last_mut() {
                (row.outcome, row.reward) = (outcomes[*lane], rewards[*lane]);
                lanes.complete(*lane, rewards[*lane], &mut row.state, &mut 0.0);
            }
        }
    }

    fn stop_requested(&self) -> bool {
        self.environment.failure().is_some()
    }
}

impl Days<'_> {
    fn print(&self, format: Format) -> Result<(), Error> {
        let names = self.environment.state_names();
        let own = ["person", "step", "can_send", "action"].map(str::to_owned);
        // Variables can have these names.
        let paid = ["outcome", "reward"].map(|name| match names.iter().any(|one| one == name) {
            true => format!("roles.{name}"),
            false => name.to_owned(),
        });
        let columns: Vec<String> = own.into_iter().chain(names).chain(paid).collect();
        let mut out = OutputRows::new(format, &columns, io::stdout().lock())?;
        for (person, rows) in (1..).zip(&self.rows) {
            for row in rows {
                let whole = [person, i64::from(row.step), i64::from(row.can_send)];
                let whole = whole.into_iter().chain([row.action.index() as i64]);
                let numbers = row.state.iter().chain([&row.outcome, &row.reward]);
                let fields = whole
                    .map(OutputField::Integer)
                    .chain(numbers.map(|number| OutputField::Rounded(*number, 4)));
                out.row(&fields.collect::<Vec<_>>())?;
            }
        }
        Ok(out.finish()?)
    }
}
