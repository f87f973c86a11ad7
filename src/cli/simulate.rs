//! `jitai simulate`: rolls a policy and prints every step, or replays recorded trajectories.

// These documentation comments are texts of `--help`, not HTML.
#![allow(rustdoc::invalid_html_tags)]

use std::io;
use std::path::PathBuf;
use std::str::FromStr;

use crate::agent::{
    self, Actions, Actor, DecisionRule, DecisionRuleError, RuleParameters, RulePolicy, Start, Task,
    Unavailable,
};
use crate::cli::output::{Format, OutputField, OutputRows};
use crate::cli::setting::adjusted;
use crate::cli::steps::{ShownStep, StepRows};
use crate::cli::world::{WorldArguments, WorldPolicy};
use crate::cli::{Error, Exit, StoreArgument, replay, world};
use crate::env::{
    self, Action, Environment, EpisodeStatus, Observer, PhysicalActivity, Scenario, Simulated,
    StepCount, StepCountModel, VectorEnvironment,
};
use crate::job::NoWeights;
use crate::portable::{PortableError, weights_of};
use crate::store::{Reader, StoreError};
use crate::train::{self, RollStreams, StepObserver};

/// Roll a rule or a trained policy through the simulation and print every step
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// The policy: never (sends nothing), untailored, tailored (to the likelier context),
    /// threshold:<p> (p from 0.5 to 1; tailored if the likelier context has at least probability p,
    /// else nothing), random, optimal (maximises the mean return), fixed:<action 0-3>, or
    /// run:<job key> (the agent of a completed job; a prefix of the key is enough) [default: tailored;
    /// with --model, random]
    #[arg(long, value_name = "POLICY")]
    policy: Option<PolicyArgument>,
    /// A model file, whose people are rolled instead of the paper's simulation: every variable of every
    /// decision. The policy is random, never or fixed:<action>, --episodes the number of people, and --set
    /// changes parameters of the model
    #[arg(long, value_name = "FILE", conflicts_with_all = ["scenario", "summary", "greedy"])]
    model: Option<String>,
    /// The file of people of the model
    #[arg(long, value_name = "FILE", requires = "model")]
    people: Option<String>,
    /// The file of rows that the model replays
    #[arg(long, value_name = "FILE", requires = "model")]
    rows: Option<String>,
    /// The scenario that a rule observes [default: P-H-D]
    #[arg(long, value_name = "SCENARIO", value_parser = env::letters)]
    scenario: Option<Scenario>,
    /// An environment parameter, as in a manifest's [environment], such as sigma=0.4; repeatable. A
    /// trained policy rejects parameters that change its observations
    #[arg(long = "set", value_name = "NAME=VALUE")]
    settings: Vec<String>,
    /// Number of episodes. Returns of run:<job key> differ slightly from the stored test, because
    /// the draws are consumed in another order
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    episodes: u32,
    /// Seed of the random streams
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Let a trained policy always take its best action, without exploration; not for rules
    #[arg(long)]
    greedy: bool,
    /// Print one line about all episodes instead of every step
    #[arg(long)]
    summary: bool,
    /// Replay the contexts and actions of a file and compare the results with the recorded values;
    /// exit code 1 if a value differs
    #[arg(long, value_name = "FILE", conflicts_with_all = ["policy", "scenario", "settings", "episodes", "seed", "summary", "greedy", "model"])]
    replay: Option<PathBuf>,
    /// Output format
    #[arg(long, value_enum, default_value = "table")]
    format: Format,
    #[command(flatten)]
    store: StoreArgument,
}

const GREEDY_RULE: &str = "--greedy applies to trained policies only, and this policy is a rule";

/// The argument of `--policy`.
#[derive(Clone, Debug, PartialEq)]
enum PolicyArgument {
    Rule(RuleParameters),
    Fixed(Action),
    Run(String),
}

impl FromStr for PolicyArgument {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let fixed = text.strip_prefix("fixed:").and_then(|index| index.parse().ok());
        if let Some(action) = fixed.and_then(Action::option) {
            return Ok(PolicyArgument::Fixed(action));
        }
        match text.split_once(':') {
            Some(("run", key)) => Ok(PolicyArgument::Run(key.to_owned())),
            _ => agent::read_rule(text).map(PolicyArgument::Rule).map_err(|error| match error {
                DecisionRuleError::Threshold(_) => error.to_string(),
                DecisionRuleError::Unknown(_) => {
                    format!("{error}, fixed:<action 0-3>, run:<job key>")
                }
            }),
        }
    }
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    if let Some(path) = &arguments.replay {
        return replay::run(path, arguments.format);
    }
    if let Some(model) = &arguments.model {
        return world(model, arguments);
    }
    let tailored = PolicyArgument::Rule(RuleParameters::new(DecisionRule::Tailored));
    let mut rolled = match arguments.policy.as_ref().unwrap_or(&tailored) {
        PolicyArgument::Rule(_) | PolicyArgument::Fixed(_) if arguments.greedy => {
            return Err(Error::Usage(GREEDY_RULE.to_owned()));
        }
        PolicyArgument::Rule(rule) => {
            let environment = adjusted(StepCount::paper(0.6), &arguments.settings)?;
            let scenario = scenario(arguments);
            let policy = RulePolicy::new(rule, &environment, &scenario);
            let policy = policy.map_err(|error| Error::Usage(error.to_string()))?;
            Rolled::new(&of_rule(&environment.into(), &scenario), Box::new(policy), arguments)
        }
        PolicyArgument::Fixed(action) => {
            let environment = adjusted(StepCount::paper(0.6), &arguments.settings)?;
            let policy = Box::new(RulePolicy::fixed(*action));
            Rolled::new(&of_rule(&environment.into(), &scenario(arguments)), policy, arguments)
        }
        PolicyArgument::Run(_) if arguments.scenario.is_some() => {
            return Err(Error::Usage(
                "--scenario applies to rules only; a trained policy observes the scenario of its job"
                    .to_owned(),
            ));
        }
        PolicyArgument::Run(key) => of_run(key, arguments)?,
    };
    if arguments.summary {
        summarise(&mut rolled, arguments)?;
    } else {
        print_steps(&mut rolled, arguments)?;
    }
    Ok(Exit::Done)
}

/// Rolls people of a model.
fn world(model: &str, arguments: &Arguments) -> Result<Exit, Error> {
    let policy = match &arguments.policy {
        None => WorldPolicy::Rule("random"),
        Some(PolicyArgument::Fixed(action)) => WorldPolicy::Fixed(*action),
        Some(PolicyArgument::Rule(rule)) if rule.rule == DecisionRule::Random => {
            WorldPolicy::Rule("random")
        }
        Some(PolicyArgument::Rule(rule)) if rule.rule == DecisionRule::Never => {
            WorldPolicy::Rule("never")
        }
        Some(_) => {
            let says = "--policy: with --model, the policy is random, never or fixed:<action>";
            return Err(Error::Usage(says.to_owned()));
        }
    };
    world::run(&WorldArguments {
        model,
        people: arguments.people.as_deref(),
        rows: arguments.rows.as_deref(),
        settings: &arguments.settings,
        policy,
        persons: arguments.episodes,
        seed: arguments.seed,
        format: arguments.format,
    })?;
    Ok(Exit::Done)
}

/// The scenario of a rule.
fn scenario(arguments: &Arguments) -> Scenario {
    let usual = || "P-H-D".parse().expect("its letters are features");
    arguments.scenario.clone().unwrap_or_else(usual)
}

/// The task of a rule, without history.
fn of_rule<'t>(environment: &'t Environment, scenario: &'t Scenario) -> Task<'t> {
    Task { environment, scenario, seed: 0, history: 1 }
}

/// The agent of a completed run, in the environment of its job with the settings applied.
fn of_run(key: &str, arguments: &Arguments) -> Result<Rolled, Error> {
    let stored = Reader::open(&arguments.store.store)?.weights(key);
    let stored = stored.map_err(|error| refused_key("--policy run", error))?;
    let job = &stored.job;
    let Some(StepCountModel { parameters, population }) = job.task().step_count().cloned() else {
        return Err(Error::Usage(format!(
            "job {key} has an environment of the family {}, and `jitai simulate` shows those of step_count; \
             `evaluation.record_decisions` records the steps of any family",
            job.environment.family().name
        )));
    };
    for setting in &arguments.settings {
        let set = adjusted(parameters.clone(), std::slice::from_ref(setting))?;
        let observer = |environment| Observer::new(environment, &job.scenario);
        if !observer(&set).shows_the_same_as(&observer(&parameters)) {
            return Err(Error::Usage(format!(
                "--set {setting}: this would change the observations on which the policy of job \
                 {key} was trained; leave this parameter unset"
            )));
        }
    }
    let environment = (adjusted(parameters, &arguments.settings)?, population).into();
    let task = Task { environment: &environment, ..job.task() };
    let weights = match weights_of(&stored) {
        Ok(weights) => weights,
        // A rule starts without weights.
        Err(PortableError::NoWeights { reason: reason @ NoWeights::Algorithm(_), .. }) => {
            return match job.agent.start(&task) {
                Ok(Start::Actor(_)) if arguments.greedy => {
                    Err(Error::Usage(GREEDY_RULE.to_owned()))
                }
                Ok(Start::Actor(rule)) => Ok(Rolled::new(&task, rule, arguments)),
                Ok(Start::Learner(_)) => Err(Error::Usage(format!("job {key}: {reason}"))),
                Err(error) => Err(Error::Usage(error.to_string())),
            };
        }
        Err(error) => return Err(Error::Usage(error.to_string())),
    };
    let actions = if arguments.greedy { Actions::Greedy } else { Actions::AsTrained };
    let policy = job.agent.trained(&task, &weights, actions).map_err(|error| {
        Error::Usage(format!("the policy of job {key} cannot be used: {error}"))
    })?;
    let unavailable = job.agent.unavailable();
    Ok(Rolled { unavailable, ..Rolled::new(&task, policy, arguments) })
}

/// Converts errors about the key into usage errors, and keeps errors of the store.
pub(super) fn refused_key(option: &str, error: StoreError) -> Error {
    match error {
        StoreError::NotAKey { .. }
        | StoreError::NoSuchJob { .. }
        | StoreError::NotCompleted { .. }
        | StoreError::AmbiguousKey { .. } => Error::Usage(format!("{option}: {error}")),
        other => other.into(),
    }
}

/// Episodes rolled one after the other, with named random streams.
struct Rolled {
    lane: Simulated,
    actor: Box<dyn Actor>,
    unavailable: Unavailable,
    streams: RollStreams,
}

impl Rolled {
    fn new(task: &Task, actor: Box<dyn Actor>, arguments: &Arguments) -> Self {
        // The lane has the participants of the test, not of the training.
        let lane = task.tested(1);
        let streams = RollStreams::of_test(arguments.seed);
        Rolled { lane, actor, unavailable: Unavailable::Chosen, streams }
    }

    /// Rolls the next episode and returns its steps.
    fn episode(&mut self) -> Vec<ShownStep> {
        let Rolled { lane, actor, unavailable, streams } = self;
        let mut steps = Steps { steps: Vec::new(), unavailable: *unavailable };
        train::begin(lane, &mut **actor, streams);
        train::roll(lane, &mut **actor, streams, &mut steps);
        steps.steps
    }
}

/// The lane, whose family has been checked.
fn simulation(lane: &Simulated) -> &PhysicalActivity {
    lane.downcast().expect("a simulation of step_count")
}

/// Collects the steps of an episode.
struct Steps {
    steps: Vec<ShownStep>,
    unavailable: Unavailable,
}

impl StepObserver<Simulated> for Steps {
    fn chosen(&mut self, lanes: &Simulated, actions: &[Action], probabilities: &[f64]) {
        let mut probabilities = probabilities.to_vec();
        let chosen = self.unavailable.choice(lanes, 0, actions[0], &mut probabilities);
        let step = ShownStep::chosen(simulation(lanes), chosen);
        let taken = if step.can_send { probabilities[chosen.index()] } else { 1.0 };
        self.steps.push(ShownStep { probability: Some(taken), ..step });
    }

    fn paid(&mut self, lanes: &Simulated, rewards: &[f64]) {
        let lanes = simulation(lanes);
        if let Some(step) = self.steps.last_mut() {
            step.pay(lanes, VectorEnvironment::outcomes(lanes, rewards)[0]);
        }
    }
}

fn print_steps(rolled: &mut Rolled, arguments: &Arguments) -> Result<(), Error> {
    let mut rows = StepRows::new(arguments.format, io::stdout().lock())?;
    for number in 1..=arguments.episodes as usize {
        rows.episode(number, &rolled.episode())?;
    }
    Ok(rows.finish()?)
}

fn summarise(rolled: &mut Rolled, arguments: &Arguments) -> Result<(), Error> {
    let mut returns = Vec::new();
    let (mut steps, mut messages, mut disengaged) = (0usize, 0usize, 0usize);
    for _ in 0..arguments.episodes {
        // The step after the horizon that pays nothing is no part of the episode.
        let horizon = simulation(&rolled.lane).parameters().horizon;
        let mut episode = rolled.episode();
        episode.retain(|step| step.time < horizon);
        returns.push(episode.iter().map(|step| step.reward).sum::<f64>());
        steps += episode.len();
        messages += episode.iter().filter(|step| step.action != Action::NONE).count();
        disengaged +=
            usize::from(episode.last().is_some_and(|s| s.status == EpisodeStatus::Terminated));
    }
    let n = returns.len() as f64;
    let (mean, sd) = crate::analyse::mean_and_sd(&returns);
    let cost = simulation(&rolled.lane).parameters().message_cost;
    let columns = [
        "episodes",
        "mean_return",
        "sd_return",
        "mean_length",
        "disengagement_rate",
        "message_rate",
    ];
    let net = (cost > 0.0).then_some("mean_net_return");
    let columns: Vec<String> = columns.into_iter().chain(net).map(str::to_owned).collect();
    let mut rows = OutputRows::new(arguments.format, &columns, io::stdout().lock())?;
    let net = net.map(|_| OutputField::Rounded(mean - cost * messages as f64 / n, 1));
    let fields = [
        OutputField::Integer(returns.len() as i64),
        OutputField::Rounded(mean, 1),
        sd.map_or(OutputField::Empty, |sd| OutputField::Rounded(sd, 1)),
        OutputField::Rounded(steps as f64 / n, 2),
        OutputField::Rounded(disengaged as f64 / n, 3),
        OutputField::Rounded(messages as f64 / steps as f64, 3),
    ];
    rows.row(&fields.into_iter().chain(net).collect::<Vec<_>>())?;
    Ok(rows.finish()?)
}
