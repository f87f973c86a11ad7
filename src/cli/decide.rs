//! `jitai decide`: probabilities and actions of an exported bandit for a table of states, and what it learns from a log.

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde_json::{Value as Json, json};

use crate::agent::{Actions, BanditPolicy, LinearThompson, certain};
use crate::cli::output::cause;
use crate::cli::{Error, Exit, folder};
use crate::env::recorded::{MayLack, NumberTable, records};
use crate::env::{Action, FeatureSpec, Interface, ObservationSpec};
use crate::job::Job;
use crate::key::digest;
use crate::rng::{Purpose, Stream};

/// Probabilities and actions of an exported bandit for a table of states; or, with --update, the bandit that has learned from
/// a log. In batch: no server, and no clinical device
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// The bandit: a policy.json of `jitai export --policy`
    #[arg(long, value_name = "FILE", value_hint = clap::ValueHint::FilePath)]
    policy: PathBuf,
    /// A CSV file with a column for each feature of the bandit, one row per decision, and perhaps `available`; with --update,
    /// also `action` and `reward`, with action centring the probabilities `probability_1` and so on, and perhaps `reached` and
    /// `place`
    #[arg(long, value_name = "FILE", value_hint = clap::ValueHint::FilePath)]
    data: PathBuf,
    /// Learn from the rows, and write the new policy to this file, which must not exist
    #[arg(long, value_name = "NEW", value_hint = clap::ValueHint::FilePath)]
    update: Option<PathBuf>,
    /// Seed of the stream that draws actions; by default that of the policy's job
    #[arg(long, value_name = "SEED", conflicts_with = "update")]
    seed: Option<u64>,
    /// Place in the stream at which the first action is drawn: by default the policy's, which an update moves; for a second
    /// table before the next update, the last place that was written, plus 1
    #[arg(long, value_name = "PLACE", conflicts_with = "update", value_parser = clap::value_parser!(u64).range(..=LARGEST_PLACE as u64))]
    place: Option<u64>,
}

/// The largest number of a table, whose squares have sums; and that of a feature in single precision.
const LARGEST: f64 = 1e100;
const LARGEST_SINGLE: f64 = 1e30;
/// The largest place of a log; larger numbers are not whole.
const LARGEST_PLACE: f64 = 9_007_199_254_740_992.0;
/// How far the probabilities of messages may add to more than 1.
const ROUNDING: f64 = 1e-9;
/// Columns that a table may have: whether an action was possible, and whether the outcome reached the agent.
const FLAGS: [&str; 2] = ["available", "reached"];
/// The last column of decisions.
const PLACE: &str = "place";
/// The columns of a log after those of the features; with action centring, the probabilities of the messages follow.
const LOG: [(&str, MayLack); 5] = [
    (FLAGS[0], MayLack::Column(1.0)),
    (FLAGS[1], MayLack::Column(1.0)),
    (PLACE, MayLack::Column(f64::NAN)),
    ("action", MayLack::Numbers),
    ("reward", MayLack::Numbers),
];

/// A bandit of a file.
struct FileBandit {
    about: Json,
    /// The digest of the file.
    sha256: String,
    spec: ObservationSpec,
    actions: usize,
    seed: u64,
    /// Where the next decisions begin.
    place: u64,
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
        let about: Json = serde_json::from_str(&text).map_err(|error| {
            refused(format!("this is no policy.json of `jitai export --policy` ({error})"))
        })?;
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
        let names = names(&about["features"]);
        // The prior has checked it: the actions, or their number.
        let actions = match &about["actions"] {
            Json::Array(actions) => actions.len(),
            number => number.as_u64().map_or(0, |number| number as usize),
        };
        if about["posterior"]["one_hot"].as_u64().is_some_and(|times| times > 0) {
            return Err(refused(
                "its features have a one-hot of time, for which a row has no column".to_owned(),
            ));
        }
        let place = match about.get(PLACE) {
            None => Some(0),
            Some(place) => place.as_u64().filter(|place| *place <= LARGEST_PLACE as u64),
        };
        let place = place.ok_or_else(|| {
            refused(format!("its `place` is {}, expected a whole number from 0", about[PLACE]))
        })?;
        if about.get("updated").is_some_and(|updated| !updated.is_array()) {
            return Err(refused("its `updated` is no list of logs".to_owned()));
        }
        let is_own = |name: &String| {
            ["row", "action", "reward", PLACE].contains(&name.as_str())
                || FLAGS.contains(&name.as_str())
                || name
                    .strip_prefix("probability_")
                    .is_some_and(|rest| rest.parse::<usize>().is_ok())
        };
        if let Some(name) = names.iter().find(|name| is_own(name)) {
            return Err(refused(format!(
                "its feature `{name}` has the name of a column that decisions or logs have; give it another name in the environment"
            )));
        }
        let feature = |(index, name)| {
            // An infinite bound is null.
            let bound =
                |key: &str| about["features"][index][key].as_f64().map(|bound| bound as f32);
            let (low, high) = (bound("low"), bound("high"));
            let (low, high) = (low.unwrap_or(f32::NEG_INFINITY), high.unwrap_or(f32::INFINITY));
            FeatureSpec { name, low, high }
        };
        let features = names.into_iter().enumerate().map(feature).collect();
        let spec = ObservationSpec { features, one_hot: 0 };
        let observations = spec.clone();
        let policy =
            BanditPolicy::of_prior(&of_prior, &Interface { observations, actions }, job.seed)
                .map_err(|error| refused(error.to_string()))?;
        let is_single = about["observation_bits"].as_u64() != Some(64);
        let seed = job.seed;
        let sha256 = digest(text.as_bytes());
        let parameters = of_prior;
        Ok(FileBandit { about, sha256, spec, actions, seed, place, parameters, policy, is_single })
    }

    /// The numbers of the features and of these columns, with notes about features outside of their ranges, which a policy
    /// accepts as a replay does.
    fn table(
        &self,
        path: &Path,
        text: &str,
        more: &[(&str, MayLack)],
    ) -> Result<NumberTable, Error> {
        let features = self.spec.features.iter().map(|one| (one.name.as_str(), MayLack::Nothing));
        let columns: Vec<(&str, MayLack)> = features.chain(more.iter().copied()).collect();
        let table = NumberTable::read(text, &columns)
            .map_err(|faults| Error::Usage(faults.text(&path.display().to_string())))?;
        for flag in FLAGS.iter().filter(|flag| more.iter().any(|(name, _)| name == *flag)) {
            let is_like = |name: &&String| name.to_lowercase().starts_with(&flag[..5]);
            let is_there = table.names.iter().any(|name| name == flag);
            if let Some(name) = table.names.iter().find(is_like).filter(|_| !is_there) {
                let says = format!("column `{name}` is not read; a column `{flag}` would be");
                writeln!(io::stderr(), "note: {}: {says}", path.display())?;
            }
        }
        for (index, ((name, _), column)) in columns.iter().zip(&table.columns).enumerate() {
            let numbers = || column.iter().zip(&table.lines);
            let feature = self.spec.features.get(index);
            let is_single = self.is_single && feature.is_some();
            let largest = if is_single { LARGEST_SINGLE } else { LARGEST };
            if let Some((number, line)) = numbers().find(|(number, _)| number.abs() > largest) {
                let says = format!("`{name}` is {number:e}, above {largest:e} in size");
                return Err(fault(path, *line, &says));
            }
            if let Some(FeatureSpec { low, high, .. }) = feature {
                let is_outside = |number: f64| !(*low..=*high).contains(&(number as f32));
                let mut outside = numbers().filter(|(number, _)| is_outside(**number));
                if let Some((number, line)) = outside.next() {
                    let says =
                        format!("`{name}` is {number}, outside of its range {low} to {high}");
                    let says = fault(path, *line, &says);
                    writeln!(
                        io::stderr(),
                        "note: {says}; rows like this: {}",
                        outside.count() + 1
                    )?;
                }
                continue;
            }
            let most = match *name {
                PLACE => LARGEST_PLACE,
                name if FLAGS.contains(&name) => 1.0,
                _ => continue,
            };
            let is_whole = |number: f64| number.fract() == 0.0 && (0.0..=most).contains(&number);
            let is_bad = |number: f64| !number.is_nan() && !is_whole(number);
            if let Some((number, line)) = numbers().find(|(number, _)| is_bad(**number)) {
                let says =
                    format!("`{name}` is {number}, expected a whole number from 0 to {most}");
                return Err(fault(path, *line, &says));
            }
        }
        Ok(table)
    }

    /// The observation of a row, in the precision that the agent had.
    fn observation(&self, table: &NumberTable, row: usize) -> Vec<f64> {
        let columns = &table.columns[..self.spec.features.len()];
        let mut seen: Vec<f64> = columns.iter().map(|column| column[row]).collect();
        if self.is_single {
            seen.iter_mut().for_each(|number| *number = f64::from(*number as f32));
        }
        seen
    }

    fn decide(&mut self, arguments: &Arguments, text: &str) -> Result<Exit, Error> {
        let table = self.table(&arguments.data, text, &LOG[..1])?;
        let mut stream = Stream::new(arguments.seed.unwrap_or(self.seed), Purpose::Deployed);
        stream.go_to(arguments.place.unwrap_or(self.place));
        let chances: Vec<String> =
            (0..self.actions).map(|action| format!("probability_{action}")).collect();
        let own = format!("row,{},action,{PLACE}", chances.join(","));
        let own: Vec<&str> = own.split(',').collect();
        // The table has been read, so that every record can be.
        let fields = records(text).map_err(cause)?;
        let kept = (0..table.names.len()).filter(|index| !own.contains(&&*table.names[*index]));
        let kept: Vec<usize> = kept.collect();
        let mut out = csv::Writer::from_writer(io::stdout().lock());
        let names = kept.iter().map(|index| &*table.names[*index]);
        out.write_record(names.chain(own)).map_err(cause)?;
        for (row, fields) in fields.iter().enumerate() {
            // A place for every row, so that a row's chance does not depend on who is available.
            let (place, word) = (stream.position(), stream.bits());
            let seen = self.observation(&table, row);
            let (mut action, all) = self.policy.choose(Actions::AsTrained, (&seen, None), word);
            let mut all = all.to_vec();
            if table.columns[self.spec.features.len()][row] == 0.0 {
                action = Action::NONE;
                certain(action, &mut all);
            }
            let all = all.iter().map(f64::to_string);
            let numbers = [(row + 1).to_string()].into_iter().chain(all);
            let numbers = numbers.chain([action.index().to_string(), place.to_string()]);
            let kept = kept.iter().map(|index| fields[*index].to_owned());
            out.write_record(kept.chain(numbers)).map_err(cause)?;
        }
        out.flush()?;
        Ok(Exit::Done)
    }

    fn update(&mut self, arguments: &Arguments, text: &str, new: &Path) -> Result<Exit, Error> {
        let path = &arguments.data;
        if new.symlink_metadata().is_ok() {
            let says = format!("--update: `{}` already exists; name a new file", new.display());
            return Err(Error::Usage(says));
        }
        let log = digest(text.as_bytes());
        let mut updated = self.about["updated"].as_array().cloned().unwrap_or_default();
        if updated.iter().any(|one| one["log_sha256"] == json!(log)) {
            let says = format!(
                "--data: `{}`: this log is already in the policy; use the earlier policy, or a log of later decisions",
                path.display()
            );
            return Err(Error::Usage(says));
        }
        let table = self.log(path, text)?;
        let decisions = self.learn(path, &table)?;
        if decisions > 0 {
            self.renew_posterior()?;
        }
        // A log without rows leaves the policy as it is.
        if !table.lines.is_empty() {
            updated.push(json!({
                "decisions": decisions,
                "log_sha256": log,
                "policy_sha256": self.sha256,
            }));
            self.about["updated"] = Json::Array(updated);
            self.about[PLACE] = json!(self.place_after(&table));
        }
        folder::write(new, format!("{:#}\n", self.about).as_bytes())?;
        writeln!(io::stderr(), "{}", new.display())?;
        Ok(Exit::Done)
    }

    /// The numbers of a log.
    fn log(&self, path: &Path, text: &str) -> Result<NumberTable, Error> {
        let messages = if self.parameters.action_centring { 1..self.actions } else { 0..0 };
        let chances: Vec<String> = messages.map(|action| format!("probability_{action}")).collect();
        let chances = chances.iter().map(|name| (name.as_str(), MayLack::Numbers));
        self.table(path, text, &LOG.into_iter().chain(chances).collect::<Vec<_>>())
    }

    /// Where the decisions after a log begin: never before those of the policy.
    fn place_after(&self, table: &NumberTable) -> u64 {
        let places = table.columns[self.spec.features.len() + 2].iter();
        let places = places.filter(|place| !place.is_nan());
        let after = places.map(|place| *place as u64 + 1).max();
        let by_rows = || self.place.saturating_add(table.lines.len() as u64);
        after.unwrap_or_else(by_rows).max(self.place)
    }

    /// Learns from the rows of a log that count, and returns their number.
    fn learn(&mut self, path: &Path, table: &NumberTable) -> Result<usize, Error> {
        let mut left_out: BTreeMap<&str, usize> = BTreeMap::new();
        for (row, line) in table.lines.iter().enumerate() {
            let why = self.teach(table, row).map_err(|says| fault(path, *line, &says))?;
            why.into_iter().for_each(|why| *left_out.entry(why).or_default() += 1);
        }
        let places = table.columns[self.spec.features.len() + 2].iter();
        let earlier = places.filter(|place| **place < self.place as f64).count();
        if earlier > 0 {
            let (path, place) = (path.display(), self.place);
            writeln!(
                io::stderr(),
                "note: {path}: rows with a place before {place}, where the policy's next decisions begin: {earlier}; a log must \
                 not have rows that the policy has learned from"
            )?;
        }
        let rows = table.lines.len();
        let learned = rows - left_out.values().sum::<usize>();
        if learned < rows || rows == 0 {
            let whys: Vec<String> =
                left_out.iter().map(|(why, count)| format!("; {count} {why}")).collect();
            let (path, whys) = (path.display(), whys.concat());
            writeln!(
                io::stderr(),
                "note: {path}: {learned} of {rows} rows teach the policy{whys}"
            )?;
        }
        Ok(learned)
    }

    /// Learns from a row of a log, or returns why it teaches nothing, as a replay of a recorded trial does.
    ///
    /// **Errors**: the row is no decision.
    fn teach(&mut self, table: &NumberTable, row: usize) -> Result<Option<&'static str>, String> {
        let first = self.spec.features.len();
        let number = |column: usize| table.columns[first + column][row];
        let [is_available, is_reached] = [0, 1].map(|flag| number(flag) == 1.0);
        let (action, reward) = (number(3), number(4));
        if is_available && action.is_nan() {
            return Ok(Some("without `action`"));
        }
        let action = if action.is_nan() { 0.0 } else { action };
        let taken = Action::from_index(action as usize)
            .filter(|taken| taken.index() < self.actions && action.fract() == 0.0 && action >= 0.0);
        let most = self.actions - 1;
        let taken = taken.ok_or_else(|| {
            format!("`action` is {action}, expected a whole number from 0 to {most}")
        })?;
        if !is_available {
            return match taken.index() {
                0 => Ok(Some("with `available` 0")),
                _ => Err(format!("action {action} where `available` is 0")),
            };
        }
        let messages: Vec<f64> = (LOG.len()..table.columns.len() - first).map(number).collect();
        if messages.iter().any(|chance| chance.is_nan()) {
            return Ok(Some("without a probability"));
        }
        let mut chances = match self.parameters.action_centring {
            true => chances(&messages, taken)?,
            false => vec![1.0],
        };
        chances.resize(self.actions, 0.0);
        if reward.is_nan() {
            return Ok(Some("without `reward`"));
        }
        if !is_reached {
            return Ok(Some("with `reached` 0"));
        }
        let seen = self.observation(table, row);
        self.policy.learn((&seen, None), (taken, &chances), reward);
        Ok(None)
    }

    /// Writes what was learned into the content of the file.
    fn renew_posterior(&mut self) -> Result<(), Error> {
        let weights = self.policy.weights();
        let values = |name: &str| weights.doubles.get(name).map_or(&[][..], |of| &of.values);
        let width = weights.doubles.get("mean").map_or(1, |mean| mean.shape[1]);
        let rows = |name: &str| values(name).chunks_exact(width).collect::<Vec<_>>();
        let mut numbers = values("mean").iter().chain(values("precision"));
        if !numbers.all(|number| number.is_finite()) {
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
            // A file has one of both.
            posterior.remove("covariance");
        }
        Ok(())
    }
}

fn fault(path: &Path, line: u32, says: &str) -> Error {
    Error::Usage(format!("{}: line {line}: {says}", path.display()))
}

/// The probabilities of all actions from those of the messages.
///
/// **Errors**: why they are no probabilities with which the action was taken.
fn chances(messages: &[f64], taken: Action) -> Result<Vec<f64>, String> {
    let is_probability = |number: &f64| (0.0..=1.0).contains(number);
    if let Some(index) = messages.iter().position(|number| !is_probability(number)) {
        let (action, number) = (index + 1, messages[index]);
        return Err(format!("`probability_{action}` is {number}, expected a number from 0 to 1"));
    }
    let rest = 1.0 - messages.iter().sum::<f64>();
    if rest < -ROUNDING {
        return Err(format!("the probabilities of the messages add to {}, above 1", 1.0 - rest));
    }
    // The first is a difference, whose rounding is no chance.
    let first = if rest <= ROUNDING { 0.0 } else { rest };
    let all: Vec<f64> = [first].into_iter().chain(messages.iter().copied()).collect();
    match all[taken.index()] {
        0.0 => Err(format!("action {} was taken with the probability 0", taken.index())),
        _ => Ok(all),
    }
}
