//! `jitai export --data`: the decisions of a job as a recorded trial, with a manifest that reads them back.

use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::path::Path;

use crate::agent::{DecisionRule, LinearThompson, RuleParameters};
use crate::cli::{Error, Exit, folder, simulate};
use crate::env::recorded::{FAMILY, REACHED, RECORDED_PROBABILITY};
use crate::job::{Decision, Job, Trial};
use crate::key::{Key, Keyed, Value};
use crate::store::Reader;

/// The keys of `[trial]` that the file answers, or `[data]`.
const ANSWERED: [&str; 12] = [
    "people",
    "days",
    "decisions_per_day",
    "entry",
    "entry_every_days",
    "entry_people",
    "entry_first_day",
    "people_file",
    "dropout",
    "missing_outcomes",
    "unreported",
    "reached",
];

/// Names of the recorded state of a trial that are columns of their own, or follow from others.
const OWN: [&str; 4] = ["calendar_day", "policy", REACHED, RECORDED_PROBABILITY];

/// Writes `trial.csv` and `trial.toml`.
pub(super) fn write(reader: &Reader, key: &str, out: &Path) -> Result<Exit, Error> {
    let refused = |says: String| Error::Usage(format!("--data: {says}"));
    let stored = reader.weights(key).map_err(|error| simulate::refused_key("--data", error))?;
    let (key, job) = (stored.job_key.to_string(), stored.job);
    if let Some(says) = replayed(&job).or_else(|| unknown_rewards(&job)) {
        return Err(refused(format!("job {key}: {says}")));
    }
    let mut names = job.state_names().to_vec();
    if job.trial.as_ref().is_some_and(|trial| trial.missing_outcomes > 0.0) {
        names.push(REACHED.to_owned());
    }
    let columns = Columns::of(&job, &names);
    let mut text = columns.header();
    let mut person = 0;
    let count = reader.decisions_with(&job, &names, |decision| {
        if std::mem::replace(&mut person, decision.episode) != decision.episode && decision.step > 0
        {
            columns.first_row(decision, &mut text);
        }
        columns.row(decision, &mut text);
    })?;
    if count == 0 {
        let says =
            "stores no decisions; run it again with record_decisions = \"test\" in [evaluation]";
        return Err(refused(format!("job {key} {says}")));
    }
    folder::make(out)?;
    let files = [("trial.csv", text), ("trial.toml", columns.manifest(&job, &key))];
    for (name, text) in files {
        let path = out.join(name);
        folder::write(&path, text.as_bytes())?;
        writeln!(io::stderr(), "{}", path.display())?;
    }
    if let Some(note) = columns.note(&job) {
        writeln!(io::stderr(), "note: {note}")?;
    }
    Ok(Exit::Done)
}

/// Why the decisions of a job never happened.
fn replayed(job: &Job) -> Option<&'static str> {
    let rule = job.agent.parameters::<RuleParameters>();
    let repeats = rule.is_some_and(|rule| rule.rule == DecisionRule::Recorded);
    let is_replay = job.environment.family() == &FAMILY && !repeats;
    is_replay.then_some(
        "it replayed a trial, whose actions another agent chose; export the job of the agent with rule = \"recorded\"",
    )
}

/// Why the store does not have the rewards that the agent of a job learned from.
fn unknown_rewards(job: &Job) -> Option<&'static str> {
    let environment = &job.environment;
    let cost = environment.message_cost()?;
    let varies = environment.costs_vary() || environment.differing() > 0 && cost > 0.0;
    varies.then_some(
        "what its messages cost is not recorded, so that its agent's rewards are not known",
    )
}

/// The columns of a file: where each comes from.
struct Columns {
    actions: usize,
    /// Decisions of a person per day.
    per_day: u32,
    has_days: bool,
    /// The indices of the calendar day and of whether the outcome reached the agent, in the state.
    day: Option<usize>,
    reached: Option<usize>,
    /// The numbers of the recorded state: their names and indices.
    state: Vec<(String, usize)>,
    /// The features that the agent observed, if they are not numbers of the state with all their digits: names and indices.
    features: Vec<(String, usize)>,
    /// The names of what the agent observed, in its order; `None` if the state lacks some of it.
    shown: Option<Vec<String>>,
}

impl Columns {
    fn of(job: &Job, names: &[String]) -> Columns {
        let index = |wanted: &str| names.iter().position(|name| name == wanted);
        // What follows the action is no state before it.
        let known = job.state_names();
        let state = names.iter().enumerate();
        let state =
            state.filter(|(index, name)| !OWN.contains(&name.as_str()) && !known.is_late(*index));
        let task = job.task();
        let seen = job.environment.recorded_features(&job.scenario);
        let specs = task.interface().observations.features;
        let is_whole = seen.len() == specs.len()
            && seen
                .iter()
                .all(|index| index.is_some_and(|index| !job.state_names().is_late(index)))
            && job.agent.history() == 1;
        let features = match job.environment.has_exact_features() || !is_whole {
            true => Vec::new(),
            false => {
                specs.iter().map(|spec| spec.name.clone()).zip(seen.into_iter().flatten()).collect()
            }
        };
        let per_day = job.trial.as_ref().map(|trial| trial.decisions_per_day);
        Columns {
            actions: task.interface().actions,
            per_day: per_day.or(job.environment.decisions_per_day()).unwrap_or(1),
            has_days: job.trial.is_some(),
            day: index("calendar_day").filter(|_| job.trial.is_some()),
            reached: index(REACHED),
            state: state.map(|(index, name)| (name.clone(), index)).collect(),
            features,
            shown: is_whole.then(|| specs.into_iter().map(|spec| spec.name).collect()),
        }
    }

    fn header(&self) -> String {
        let mut names = vec!["person".to_owned(), "decision".to_owned()];
        names.extend(self.has_days.then(|| "calendar_day".to_owned()));
        names.extend(["available", "action"].map(str::to_owned));
        names.extend((1..self.actions).map(|action| format!("probability_{action}")));
        names.push("outcome".to_owned());
        names.extend(self.reached.map(|_| REACHED.to_owned()));
        names.extend(self.state.iter().map(|(name, _)| format!("state_{name}")));
        names.extend(self.features.iter().map(|(name, _)| format!("feature_{name}")));
        names.join(",") + "\n"
    }

    fn row(&self, decision: &Decision, out: &mut String) {
        let number = |number: f64| if number.is_nan() { String::new() } else { number.to_string() };
        let mut fields = vec![decision.episode.to_string(), decision.step.to_string()];
        fields.extend(self.day.map(|index| number(decision.state[index])));
        fields.push(u8::from(decision.can_send).to_string());
        fields.push(decision.action.to_string());
        fields.extend(decision.probabilities[1..].iter().copied().map(number));
        fields.push(number(decision.reward - decision.cost));
        fields.extend(self.reached.map(|index| number(decision.state[index])));
        fields.extend(self.state.iter().map(|(_, index)| number(decision.state[*index])));
        // As agents read it.
        let single = |index: usize| f64::from(decision.state[index] as f32);
        fields.extend(self.features.iter().map(|(_, index)| number(single(*index))));
        out.push_str(&fields.join(","));
        out.push('\n');
    }

    /// The row of a person's first decision, which the store does not have: without it, the person's days would begin with
    /// the first row.
    fn first_row(&self, decision: &Decision, out: &mut String) {
        let day = |index: usize| decision.state[index] - f64::from(decision.step / self.per_day);
        let mut fields = vec![decision.episode.to_string(), "0".to_owned()];
        fields.extend(self.day.map(|index| day(index).to_string()));
        // Not available, without action, probabilities and outcome.
        fields.push("0".to_owned());
        fields.extend(vec![String::new(); self.actions + 1]);
        fields.extend(self.reached.map(|_| "1".to_owned()));
        fields.extend(vec![String::new(); self.state.len() + self.features.len()]);
        out.push_str(&fields.join(","));
        out.push('\n');
    }

    fn manifest(&self, job: &Job, key: &str) -> String {
        let probabilities: Vec<String> =
            (1..self.actions).map(|action| format!("\"probability_{action}\"")).collect();
        let state = self.state.iter().map(|(name, _)| format!("{name} = \"state_{name}\""));
        let features = self.features.iter().map(|(name, _)| format!("{name} = \"feature_{name}\""));
        let state: Vec<String> = state.chain(features).collect();
        let mut text = format!(
            "# The decisions of job {key} as a recorded trial. `jitai run` reads them back, and replays its agent.\n\
             format = 1\nname = \"recorded {}\"\nscenarios = \"{}\"\nseeds = [{}]\n\n[data]\nfile = \"trial.csv\"\n\
             person = \"person\"\norder = \"decision\"\naction = \"action\"\nprobability = [{}]\noutcome = \"outcome\"\n\
             available = \"available\"\n",
            &key[..8],
            self.shown.as_ref().map_or_else(|| "all".to_owned(), |names| names.join("-")),
            job.seed,
            probabilities.join(", ")
        );
        if self.reached.is_some() {
            text += "reached = \"reached\"\n";
        }
        if !state.is_empty() {
            let _ = writeln!(text, "state = {{ {} }}", state.join(", "));
        }
        if job.trial.is_some() {
            text += "calendar_day = \"calendar_day\"\n";
        }
        let unit = Value::Text(job.environment.return_unit().to_owned());
        let data = [
            ("decisions_per_day", Some(Value::Integer(self.per_day.into()))),
            ("unit", Some(unit)),
        ];
        for (name, value) in data {
            let key = FAMILY.keys.iter().find(|key| key.name == name);
            if let Some((key, value)) = key.zip(value) {
                write_key(&mut text, key, &value);
            }
        }
        if self.replays(job) {
            text += "\n[trial]\n";
            let trial =
                job.trial.iter().flat_map(|trial| Trial::KEYS.iter().zip(trial.to_values()));
            for (key, value) in trial.filter(|(key, _)| !ANSWERED.contains(&key.name)) {
                write_key(&mut text, key, &value);
            }
            text += "\n[[agent]]\nname = \"replayed\"\nalgorithm = \"linear_thompson\"\n";
            for (key, value) in job.agent.algorithm().keys().iter().zip(job.agent.values()) {
                write_key(&mut text, key, value);
            }
            text += "\n[[analysis]]\nname = \"replay\"\nkind = \"replay\"\nwhere = { agent.name = \"replayed\" }\n";
        }
        text
    }

    /// Whether the manifest replays the agent of the job.
    fn replays(&self, job: &Job) -> bool {
        job.trial.is_some()
            && self.shown.is_some()
            && job.agent.parameters::<LinearThompson>().is_some()
    }

    /// What the files lack.
    fn note(&self, job: &Job) -> Option<String> {
        job.agent.parameters::<LinearThompson>()?;
        if job.trial.is_none() {
            return Some("the job has no trial, so that its agent is not replayed".to_owned());
        }
        if self.shown.is_none() {
            let scenario = &job.scenario;
            return Some(format!(
                "the recorded state lacks what the scenario {scenario} shows, so that the agent is not replayed"
            ));
        }
        let of_file = |value: &&Value| matches!(value, Value::Content(of) if !of.is_none());
        let files = job.agent.values().iter().filter(of_file).count();
        (files > 0).then(|| {
            "trial.toml names a file by its digest, which the store has alone: write the name of the file".to_owned()
        })
    }
}

/// Writes a key that is not at its default.
fn write_key(text: &mut String, key: &Key, value: &Value) {
    if key.default().as_ref() == Some(value) {
        return;
    }
    let _ = match value {
        Value::Content(_) => writeln!(text, "# The file with this digest.\n{} = {value}", key.name),
        value => writeln!(text, "{} = {value}", key.name),
    };
}
