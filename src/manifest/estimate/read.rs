//! Reads `[[estimate]]`, and checks each estimate against the rest of the manifest.

use std::collections::HashSet;
use std::sync::Arc;

use serde_json::{Value as Json, json};
use toml::de::DeTable;

use crate::job::{
    CONSTANT, EstimateDeclaration, Estimator, Job, Messages, REWARD, STEP, StandardErrors,
    Treatment,
};
use crate::key::{Kind, Value};
use crate::manifest::declared::Manifest;
use crate::manifest::draft::Draft;
use crate::manifest::estimate::declared::{DeclaredEstimate, EstimateDraft};
use crate::manifest::grid::Grid;
use crate::manifest::text::fault::{Fault, FaultList};
use crate::manifest::text::source::Span;
use crate::manifest::value::respelt::respelt;
use crate::manifest::value::schema::{list, value};
use crate::manifest::value::sweep::{Node, Reader, whole};

/// The keys of `[[estimate]]`.
const KEYS: [&str; 10] = [
    "name",
    "estimator",
    "outcome",
    "treatment",
    "control",
    "moderators",
    "numerator",
    "standard_errors",
    "truth",
    "agents",
];
/// The most features in a list.
const MOST_FEATURES: usize = 100;
/// The most numbers of all people that the estimates of a job may hold: 400 MB.
const MOST_NUMBERS: u64 = 50_000_000;
/// The probability of treatment in the numerator, by default.
const NUMERATOR: f64 = 0.5;

const OUTCOME: Kind = Kind::Text { most: 100 };
const ACTION: Kind = Kind::Integer { min: 1, max: 255 };

impl Reader<'_> {
    /// Reads `[[estimate]]`.
    pub fn estimates(&mut self, draft: &mut Draft, node: &Node) {
        let mut names = HashSet::new();
        for (span, written) in self.tables("estimate", node) {
            self.only_keys("an [[estimate]]", &KEYS, written);
            let before = self.faults.len();
            let estimate = self.estimate(span, &respelt(written, &KEYS));
            let name = &estimate.estimate.declaration.name;
            if !name.is_empty() && !names.insert(name.clone()) {
                let message = format!("another [[estimate]] is called `{name}`");
                let fault = Fault::at(estimate.span_of("name"), message);
                self.faults.add(fault.help("analyses and the view `estimate` name it"));
            }
            // An estimate with a fault is not checked further.
            if self.faults.len() == before {
                draft.estimates.push(estimate);
            }
        }
    }

    fn estimate(&mut self, span: Span, table: &DeTable) -> EstimateDraft {
        let spans = KEYS.into_iter().filter_map(|key| Some((key, table.get(key)?.span().into())));
        let name = match table.get("name") {
            Some(node) => self.name("name", node).value,
            None => {
                let fault = Fault::at(span, "missing key `name` in an [[estimate]]");
                self.faults
                    .add(fault.help("the view `estimate` shows it: write name = \"effect\""));
                String::new()
            }
        };
        let words = Estimator::WORDS;
        let estimator = table.get("estimator").and_then(|node| self.word("estimator", words, node));
        let mut one = |key: &str, kind: Kind| self.value(key, kind, table.get(key)?);
        let outcome = match one("outcome", OUTCOME) {
            Some(Value::Text(text)) => text,
            _ => REWARD.to_owned(),
        };
        let truth = one("truth", Kind::Flag) == Some(Value::Flag(true));
        let numerator = match one("numerator", Kind::PositiveReal { max: 1.0 }) {
            Some(Value::Real(share)) => share,
            _ => NUMERATOR,
        };
        if let Some(node) = table.get("numerator").filter(|_| numerator == 1.0) {
            self.expected("numerator", "a probability above 0 and below 1", node);
        }
        let words_of_errors = &StandardErrors::WORDS;
        let standard_errors = table
            .get("standard_errors")
            .and_then(|node| self.word("standard_errors", words_of_errors, node));
        let treatment = table.get("treatment").and_then(|node| self.treatment(node));
        let [control, moderators] = ["control", "moderators"].map(|key| self.features(key, table));
        let agents = table.get("agents").map(|node| {
            let items = self.items("agents", node);
            let read = |reader: &mut Self, item: &Node| {
                Some(reader.name("agents", item).value).filter(|name| !name.is_empty())
            };
            self.distinct("agents", items.into_iter(), read)
        });
        let declaration = Arc::new(EstimateDeclaration {
            control,
            less_costs: false,
            estimator: estimator.unwrap_or(words[0]).to_owned(),
            moderators,
            name,
            numerator,
            outcome,
            standard_errors: standard_errors.and_then(StandardErrors::named).unwrap_or_default(),
            treatment: treatment.unwrap_or(Treatment::Messages(Messages::Any)),
            truth,
        });
        let estimate = DeclaredEstimate { declaration, agents };
        EstimateDraft { estimate, span, spans: spans.collect() }
    }

    /// What is compared with action 0.
    fn treatment(&mut self, node: &Node) -> Option<Treatment> {
        let number = || whole(node).and_then(|number| u8::try_from(number).ok());
        let treatment = match node.get_ref().as_str() {
            Some(word) => Treatment::named(word),
            None => number().filter(|number| *number > 0).map(Treatment::Action),
        };
        if treatment.is_none() {
            let words = Treatment::WORDS.map(|word| format!("\"{word}\"")).join(" or ");
            let expected = format!("{words} or the number of an action above 0");
            self.expected("treatment", &expected, node);
        }
        treatment
    }

    /// A list of features, which may be empty.
    fn features(&mut self, key: &str, table: &DeTable) -> Vec<String> {
        let Some(node) = table.get(key) else { return Vec::new() };
        let Some(items) = node.get_ref().as_array() else {
            self.expected(key, "a list of features, as in [\"step\"]", node);
            return Vec::new();
        };
        if items.len() > MOST_FEATURES {
            let message =
                format!("`{key}`: at most {MOST_FEATURES} features, found {}", items.len());
            self.faults.add(Fault::at(node.span().into(), message));
            return Vec::new();
        }
        self.distinct(key, items.iter(), |reader, item| {
            let name = reader.name(key, item);
            if name.value == CONSTANT {
                let message = format!("`{key}`: the constant 1 is always included");
                reader.faults.add(Fault::at(item.span().into(), message).help("remove it"));
            }
            Some(name.value).filter(|name| !name.is_empty())
        })
    }
}

/// Reports estimates that the jobs of the manifest cannot have. `grids` are those of the agents.
pub(in crate::manifest) fn check(
    draft: &Draft,
    manifest: &Manifest,
    grids: &[Grid],
    faults: &mut FaultList,
) {
    for estimate in &draft.estimates {
        Checked { draft, manifest, grids, estimate }.check(faults);
    }
}

struct Checked<'m> {
    draft: &'m Draft,
    manifest: &'m Manifest,
    grids: &'m [Grid<'m>],
    estimate: &'m EstimateDraft,
}

impl Checked<'_> {
    fn check(&self, faults: &mut FaultList) {
        let agents = self.estimate.estimate.agents.iter().flatten();
        for name in agents.filter(|name| self.manifest.agents.iter().all(|one| one.name != **name))
        {
            if self.draft.unread_agents.is_empty() {
                let message = format!("`agents`: no agent is called `{name}`");
                let known = self.manifest.agents.iter().map(|agent| agent.name.as_str());
                let fault = Fault::at(self.estimate.span_of("agents"), message);
                let known: Vec<&str> = known.collect();
                let fault = fault.help(format!("the agents are {}", known.join(", ")));
                faults.add(fault.nearest(name, known));
            }
        }
        for grid in self.grids.iter().filter(|grid| self.is_estimated(grid)) {
            // The first cell stands for all: the names of states do not depend on values.
            let Some(job) = grid.first().map(|cell| grid.job(&cell)) else { continue };
            let before = faults.len();
            self.features(&job, faults);
            self.actions(&job, faults);
            self.size(&job, faults);
            if faults.len() > before {
                return;
            }
        }
        self.randomisation(faults);
        self.truth(faults);
        self.standard_errors(faults);
    }

    /// Reports standard errors that cannot account for the learning.
    fn standard_errors(&self, faults: &mut FaultList) {
        let declaration = &self.estimate.estimate.declaration;
        if declaration.standard_errors == StandardErrors::Nominal {
            return;
        }
        let reason = match declaration.is_of_reward() {
            false => Some("they are known for `outcome` = \"reward\" and \"gross_reward\" alone"),
            true => {
                let estimated = self.grids.iter().filter(|grid| self.is_estimated(grid));
                let mut jobs = estimated.filter_map(|grid| Some(grid.job(&grid.first()?)));
                let is_without = jobs.any(|job| job.trial.is_none());
                is_without.then_some("they are for an agent that learns in a [trial]")
            }
        };
        if let Some(reason) = reason {
            let message = format!("`standard_errors` = \"after_study\": {reason}");
            let fault = Fault::at(self.estimate.span_of("standard_errors"), message);
            faults.add(fault.help("write standard_errors = \"nominal\""));
        }
    }

    /// Reports a truth that cannot be simulated.
    fn truth(&self, faults: &mut FaultList) {
        let declaration = &self.estimate.estimate.declaration;
        let simulated = self.grids.iter().filter(|grid| self.is_estimated(grid));
        let jobs = simulated.filter_map(|grid| Some(grid.job(&grid.first()?)));
        let reason = match declaration.truth {
            true => jobs.into_iter().find_map(|job| match (&job.trial, job.is_outside()) {
                (None, _) => Some("it is simulated for the people of a [trial] alone"),
                (_, true) => Some("an outside program cannot return to an earlier decision"),
                (Some(_), false) => None,
            }),
            false => None,
        };
        if let Some(reason) = reason {
            let fault = Fault::at(self.estimate.span_of("truth"), format!("`truth`: {reason}"));
            faults.add(fault.help("remove `truth`, or declare another estimate with `agents`"));
        }
    }

    fn is_estimated(&self, grid: &Grid) -> bool {
        let agents = self.estimate.estimate.agents.as_ref();
        agents.is_none_or(|agents| agents.iter().any(|name| name == grid.agent_name()))
    }

    /// Reports features that are not in the recorded state.
    fn features(&self, job: &Job, faults: &mut FaultList) {
        // A program describes its state when it runs.
        if job.environment.family().is_external() {
            return;
        }
        let mut known = job.state_names();
        known.push(STEP.to_owned());
        let declaration = &self.estimate.estimate.declaration;
        let lists = [("control", &declaration.control), ("moderators", &declaration.moderators)];
        let features =
            lists.into_iter().flat_map(|(key, list)| list.iter().map(move |one| (key, one)));
        let outcome = Some(("outcome", &declaration.outcome));
        let outcome = outcome.filter(|_| !declaration.is_of_reward());
        for (key, name) in features.chain(outcome).filter(|(_, name)| !known.contains(name)) {
            let message = format!("`{key}`: the recorded state has no `{name}`");
            let known: Vec<&str> = known.iter().map(String::as_str).collect();
            let fault = Fault::at(self.estimate.span_of(key), message);
            faults.add(fault.help(format!("it has {}", known.join(", "))).nearest(name, known));
        }
    }

    /// Reports a treatment that the environment does not have.
    fn actions(&self, job: &Job, faults: &mut FaultList) {
        if job.environment.family().is_external() {
            return;
        }
        let actions = job.task().interface().actions;
        if let Treatment::Action(action) = self.estimate.estimate.declaration.treatment
            && usize::from(action) >= actions
        {
            let message = format!("`treatment`: the environment has no action {action}");
            let meanings = (1..).zip(job.environment.actions().into_iter().skip(1));
            let known = meanings.map(|(number, meaning)| format!("{number}: {meaning}"));
            let help = format!("its messages: {}", known.collect::<Vec<_>>().join(", "));
            faults.add(Fault::at(self.estimate.span_of("treatment"), message).help(help));
        }
    }

    /// Reports an estimate that holds too many numbers in memory.
    fn size(&self, job: &Job, faults: &mut FaultList) {
        let people = match &job.trial {
            Some(trial) => trial.people,
            None => job.evaluation.test_episodes,
        };
        let of_one = |declaration: &EstimateDeclaration| {
            let treatments = declaration.treatment.count(job.task().interface().actions);
            let columns =
                1 + declaration.control.len() + treatments * (1 + declaration.moderators.len());
            (columns * (columns + 5) / 2) as u64
        };
        let each = self.manifest.estimates.iter().map(|one| of_one(&one.declaration)).sum::<u64>();
        let numbers = u64::from(people).saturating_mul(each);
        if numbers > MOST_NUMBERS {
            let message = format!(
                "the estimates hold {numbers} numbers of {people} people in memory; the maximum is {MOST_NUMBERS}"
            );
            let help = "use fewer features, fewer people, or a smaller `test_episodes`";
            faults.add(Fault::at(self.estimate.span, message).help(help));
        }
    }

    /// Reports agents that never draw their actions.
    fn randomisation(&self, faults: &mut FaultList) {
        let never: Vec<&str> = self
            .grids
            .iter()
            .filter(|grid| self.is_estimated(grid))
            .filter(|grid| grid.first().is_some_and(|cell| grid.job(&cell).never_draws()))
            .map(Grid::agent_name)
            .collect();
        if never.is_empty() || self.draft.invalid_agents() {
            return;
        }
        let message = format!(
            "an effect cannot be estimated from decisions that are not randomised: {} {} no actions by chance",
            never.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", "),
            if never.len() == 1 { "draws" } else { "draw" }
        );
        let span = self.estimate.span_of("agents");
        let others = self.grids.iter().map(Grid::agent_name).filter(|name| !never.contains(name));
        let others: Vec<String> = others.map(|name| format!("\"{name}\"")).collect();
        faults.add(Fault::at(span, message).help(match others.is_empty() {
            true => "add an agent that draws its actions, such as the rule \"random\"".to_owned(),
            false => format!("write agents = [{}] in the [[estimate]]", others.join(", ")),
        }));
    }
}

/// The JSON Schema of an estimate.
pub(in crate::manifest) fn schema() -> Json {
    let described = |mut schema: Json, text: &str| {
        schema["description"] = text.into();
        schema
    };
    let features = || {
        let mut schema = list(json!({ "type": "string", "minLength": 1 }));
        schema["minItems"] = json!(0);
        schema["maxItems"] = json!(MOST_FEATURES);
        schema["default"] = json!([]);
        schema
    };
    json!({
        "type": "object",
        "additionalProperties": false,
        "required": ["name"],
        "properties": {
            "name": { "$ref": "#/$defs/name" },
            "estimator": {
                "enum": Estimator::WORDS,
                "default": Estimator::WORDS[0],
                "description": "how the effect is estimated: weighted and centred least squares",
            },
            "outcome": described(
                json!({ "type": "string", "minLength": 1, "default": REWARD }),
                "\"reward\" of the step less the cost of the message, \"gross_reward\" before it, or a name of the recorded state: its value before the next decision",
            ),
            "treatment": described(
                json!({ "anyOf": [{ "enum": Treatment::WORDS }, value(ACTION)], "default": Treatment::WORDS[0] }),
                "what is compared with action 0: any message, each message, or the action of this number",
            ),
            "control": described(
                features(),
                "features of the model of the outcome without treatment, beside the constant 1",
            ),
            "moderators": described(
                features(),
                "features that the effect depends on, beside the constant 1",
            ),
            "numerator": {
                "type": "number",
                "exclusiveMinimum": 0,
                "exclusiveMaximum": 1,
                "default": NUMERATOR,
                "description": "probability of treatment in the numerator of the weights; several treatments share it equally",
            },
            "standard_errors": {
                "enum": StandardErrors::WORDS,
                "default": StandardErrors::default().word(),
                "description": "whether standard errors account for an agent that learned from everybody",
            },
            "truth": {
                "type": "boolean",
                "default": false,
                "description": "whether the true effect in each trial is simulated, too",
            },
            "agents": described(
                json!({ "anyOf": [{ "$ref": "#/$defs/name" }, list(json!({ "$ref": "#/$defs/name" }))] }),
                "agents whose jobs have the estimate; all by default",
            ),
        },
    })
}
