//! `jitai decide`: probabilities and actions of an exported bandit for a table of states, and what it learns from a log.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde_json::{Value as Json, json};

use crate::agent::{Actions, BanditPolicy, LinearThompson};
use crate::cli::{Error, Exit};
use crate::env::recorded::NumberTable;
use crate::env::{Action, FeatureSpec, Interface, ObservationSpec};
use crate::job::Job;
use crate::portable::digest;
use crate::rng::{Purpose, Stream};

/// Probabilities and actions of an exported bandit for a table of states; or, with --update, the bandit that has learned from
/// a log. In batch: no server, and no clinical device
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// The bandit: a policy.json of `jitai export --policy`
    #[arg(long, value_name = "FILE", value_hint = clap::ValueHint::FilePath)]
    policy: PathBuf,
    /// A CSV file with a column for each feature of the bandit, one row per decision; with --update, also `action` and
    /// `reward`, and with action centring the probabilities `probability_1` and so on
    #[arg(long, value_name = "FILE", value_hint = clap::ValueHint::FilePath)]
    data: PathBuf,
    /// Learn from the rows, and write the new policy to this file
    #[arg(long, value_name = "NEW", value_hint = clap::ValueHint::FilePath)]
    update: Option<PathBuf>,
    /// Seed of the stream that draws actions; by default that of the policy's job
    #[arg(long, value_name = "SEED", conflicts_with = "update")]
    seed: Option<u64>,
    /// Place in the stream at which the first action is drawn: the last one that was written, plus 1
    #[arg(long, value_name = "PLACE", default_value_t = 0, conflicts_with = "update")]
    place: u64,
}

/// A bandit of a file.
struct FileBandit {
    about: Json,
    names: Vec<String>,
    actions: usize,
    seed: u64,
    parameters: LinearThompson,
    policy: BanditPolicy,
    is_single: bool,
}

pub(super) fn run(arguments: &Arguments) -> Result<Exit, Error> {
    let mut bandit = FileBandit::read(&arguments.policy)?;
    let text = read(&arguments.data)?;
    match &arguments.update {
        Some(new) => bandit.update(arguments, &text, new),
        None => bandit.decide(arguments, &text),
    }
}

fn read(path: &Path) -> Result<String, Error> {
    let what = || format!("read `{}`", path.display());
    fs::read_to_string(path).map_err(|source| Error::Io { what: what(), source })
}

impl FileBandit {
    fn read(path: &Path) -> Result<FileBandit, Error> {
        let text = read(path)?;
        let refused =
            |says: String| Error::Usage(format!("--policy: `{}`: {says}", path.display()));
        let about: Json =
            serde_json::from_str(&text).map_err(|error| refused(error.to_string()))?;
        let job = Job::from_canonical(&about["job"].to_string()).map_err(|error| {
            refused(format!(
                "its `job` cannot be read ({error}); expected a file of `jitai export --policy`"
            ))
        })?;
        let parameters: Option<LinearThompson> = job.agent.parameters();
        let parameters = parameters.ok_or_else(|| {
            refused(format!(
                "its agent has the algorithm {}, and linear_thompson alone decides here",
                job.algorithm()
            ))
        })?;
        // The posterior of the file is what the job's agent had learned, whatever its own prior was.
        let of_prior = parameters.with_prior(&text).map_err(|says| refused(says.to_string()))?;
        let names = |list: &Json| -> Vec<String> {
            let name =
                |one: &Json| one["name"].as_str().or(one.as_str()).unwrap_or_default().to_owned();
            list.as_array().map(|list| list.iter().map(name).collect()).unwrap_or_default()
        };
        let (names, actions) =
            (names(&about["features"]), about["actions"].as_array().map_or(0, Vec::len));
        if about["posterior"]["one_hot"].as_u64() != Some(0) {
            return Err(refused(
                "its features have a one-hot of time, for which a row has no column".to_owned(),
            ));
        }
        let feature = |name: &String| FeatureSpec {
            name: name.clone(),
            low: f32::NEG_INFINITY,
            high: f32::INFINITY,
        };
        let observations =
            ObservationSpec { features: names.iter().map(feature).collect(), one_hot: 0 };
        let policy =
            BanditPolicy::of_prior(&of_prior, &Interface { observations, actions }, job.seed)
                .map_err(|error| refused(error.to_string()))?;
        let is_single = about["observation_bits"].as_u64() != Some(64);
        let seed = job.seed;
        Ok(FileBandit { about, names, actions, seed, parameters: of_prior, policy, is_single })
    }

    /// The numbers of these columns.
    fn table(&self, path: &Path, text: &str, more: &[String]) -> Result<NumberTable, Error> {
        let names = [&self.names, more].concat();
        NumberTable::read(text, &names)
            .map_err(|faults| Error::Usage(faults.text(&path.display().to_string())))
    }

    /// The observation of a row, in the precision that the agent had.
    fn observation(&self, table: &NumberTable, row: usize) -> Vec<f64> {
        let mut seen = table.row(row, self.names.len());
        if self.is_single {
            seen.iter_mut().for_each(|number| *number = f64::from(*number as f32));
        }
        seen
    }

    fn decide(&mut self, arguments: &Arguments, text: &str) -> Result<Exit, Error> {
        let table = self.table(&arguments.data, text, &[])?;
        let mut stream = Stream::new(arguments.seed.unwrap_or(self.seed), Purpose::Deployed);
        stream.go_to(arguments.place);
        let mut out = io::stdout().lock();
        let chances: Vec<String> =
            (0..self.actions).map(|action| format!("probability_{action}")).collect();
        writeln!(out, "row,{},action,place", chances.join(","))?;
        for row in 0..table.lines.len() {
            let place = stream.position();
            let seen = self.observation(&table, row);
            let (action, all) =
                self.policy.choose(Actions::AsTrained, (&seen, None), stream.bits());
            let all: Vec<String> = all.iter().map(f64::to_string).collect();
            writeln!(out, "{},{},{},{place}", row + 1, all.join(","), action.index())?;
        }
        Ok(Exit::Done)
    }

    fn update(&mut self, arguments: &Arguments, text: &str, new: &Path) -> Result<Exit, Error> {
        let mut more = vec!["action".to_owned(), "reward".to_owned()];
        if self.parameters.action_centring {
            more.extend((1..self.actions).map(|action| format!("probability_{action}")));
        }
        let table = self.table(&arguments.data, text, &more)?;
        let first = self.names.len();
        for row in 0..table.lines.len() {
            let number = |column: usize| table.columns[first + column][row];
            let (action, reward) = (number(0), number(1));
            let taken = Action::from_index(action as usize).filter(|taken| {
                taken.index() < self.actions && action.fract() == 0.0 && action >= 0.0
            });
            let Some(taken) = taken else {
                let says = format!(
                    "{}: line {}: `action` is {action}, expected a whole number from 0 to {}",
                    arguments.data.display(),
                    table.lines[row],
                    self.actions - 1
                );
                return Err(Error::Usage(says));
            };
            let others: Vec<f64> = (2..more.len()).map(number).collect();
            let mut chances = vec![1.0 - others.iter().sum::<f64>()];
            chances.extend(others);
            chances.resize(self.actions, 0.0);
            let seen = self.observation(&table, row);
            self.policy.learn((&seen, None), (taken, &chances), reward);
        }
        let earlier = digest(self.about.to_string().as_bytes());
        let weights = self.policy.weights();
        let values = |name: &str| weights.doubles.get(name).map_or(&[][..], |of| &of.values);
        let width = weights.doubles.get("mean").map_or(1, |mean| mean.shape[1]);
        let rows = |name: &str| values(name).chunks_exact(width).collect::<Vec<_>>();
        if !values("mean").iter().all(|number| number.is_finite()) {
            return Err(Error::Usage(
                "--update: the log gives no posterior: its numbers are too large".to_owned(),
            ));
        }
        self.about["posterior"]["mean"] = json!(rows("mean"));
        self.about["posterior"]["precision"] =
            json!(rows("precision").chunks_exact(width).collect::<Vec<_>>());
        if let Some(posterior) = self.about["posterior"].as_object_mut() {
            // What was known of a person of whom nothing is known is now what is known of the person of the log.
            posterior.remove("person_sd");
            posterior.remove("person_mean");
        }
        self.about["updated"] = json!({
            "decisions": table.lines.len(),
            "log_sha256": digest(text.as_bytes()),
            "policy_sha256": earlier,
        });
        let partial = new.with_extension("partial");
        let failure = |source| Error::Io { what: format!("write `{}`", new.display()), source };
        fs::write(&partial, format!("{:#}\n", self.about))
            .and_then(|()| fs::rename(&partial, new))
            .map_err(failure)?;
        writeln!(io::stderr(), "{}", new.display())?;
        Ok(Exit::Done)
    }
}
