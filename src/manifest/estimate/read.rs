//! Reads `[[estimate]]`, and checks each estimate against the rest of the manifest.

use std::collections::HashSet;

use crate::env::recorded;
use crate::job::{EstimateDeclaration, Estimator, Job, Pooling, STEP, StandardErrors, Treatment};
use crate::key::{Constraint, KeyType, Parameter, Violation};
use crate::manifest::declared::Manifest;
use crate::manifest::draft::Draft;
use crate::manifest::estimate::declared::{DeclaredEstimate, EstimateDraft};
use crate::manifest::estimate::keys::keys;
use crate::manifest::grid::Grid;
use crate::manifest::table::{Fields, TableReader, names};
use crate::manifest::value::sweep::{Node, Reader};
use crate::text::{Fault, FaultList};

/// The most numbers of all people that the estimates of a job may hold: 400 MB.
const MOST_NUMBERS: u64 = 50_000_000;

/// The numbers of a decision that is kept to the end, besides those of its row.
const OF_DECISION: u64 = 24;

/// The most groups of people from whose others the models of a value are fitted.
const GROUPS: u64 = 20;

/// Agents whose people share some of what they learn.
const SHARED: Constraint = Constraint {
    parameters: &[POOLING],
    violation: |assignment| match Pooling::from_value(assignment.value(POOLING)?)? {
        Pooling::Partial | Pooling::Groups(_) => {
            Some(Violation::Contradiction("people share a part of what they learn".to_owned()))
        }
        Pooling::Full | Pooling::None => None,
    },
};
const POOLING: Parameter = Parameter::Trial("pooling");

impl Reader<'_> {
    /// Reads `[[estimate]]`.
    pub fn estimates(&mut self, draft: &mut Draft, node: &Node) {
        let title = "an [[estimate]]";
        let says = (
            "[[estimate]]",
            "the view `estimate` shows it: write name = \"effect\"",
            Some("analyses and the view `estimate` name it"),
        );
        let (keys, mut known) = (names(&keys()), HashSet::new());
        for (span, written) in self.tables("estimate", node) {
            let table = self.known_keys(title, &keys, written);
            let before = self.faults.len();
            let name = self.name_among(says, span, &table, &mut known).value;
            let mut table = TableReader {
                reader: self,
                title,
                name: &name,
                span,
                table: &table,
                needs: Vec::new(),
            };
            let estimate = DeclaredEstimate::read(&mut table);
            let spans = table.spans(&keys);
            // An estimate with a fault is not checked further.
            if let Some(estimate) = estimate.filter(|_| self.faults.len() == before) {
                draft.estimates.push(EstimateDraft { estimate, span, spans });
            }
        }
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
        self.keys(faults);
        for grid in self.grids.iter().filter(|grid| self.is_estimated(grid)) {
            // The first cell stands for all: the names of states do not depend on values.
            let Some(job) = grid.first().map(|cell| grid.job(&cell)) else { continue };
            let before = faults.len();
            self.features(&job, faults);
            self.actions(&job, faults);
            self.policy(&job, faults);
            self.size(&job, faults);
            if faults.len() > before {
                return;
            }
        }
        self.randomisation(faults);
        self.truth(faults);
        self.standard_errors(faults);
    }

    /// Reports keys that the estimator does not use, and a value without a policy.
    fn keys(&self, faults: &mut FaultList) {
        let declaration = &self.estimate.estimate.declaration;
        let estimator = declaration.estimator;
        for (key, span) in self.estimate.spans.iter().filter(|(key, _)| !estimator.uses(key)) {
            let message =
                format!("`{key}`: `estimator` = \"{}\" does not use it", estimator.word());
            faults.add(Fault::at(*span, message).help("remove it"));
        }
        if estimator == Estimator::Value && declaration.policy.is_none() {
            let message = "missing key `policy` in an [[estimate]] with `estimator` = \"value\"";
            let help = "write the probability of a message, as in policy = 0.6";
            faults.add(Fault::at(self.estimate.span, message.to_owned()).help(help));
        }
    }

    /// Reports a policy with other actions than the environment has.
    fn policy(&self, job: &Job, faults: &mut FaultList) {
        let declaration = &self.estimate.estimate.declaration;
        let policies = declaration.policies().filter(|_| !job.environment.family().is_external());
        for (key, policy) in policies {
            let Err(why) = policy.probabilities(job.task().interface().actions, 0.5) else {
                continue;
            };
            let fault = Fault::at(self.estimate.span_of(key), format!("`{key}` {why}"));
            let actions = (0..).zip(job.environment.actions());
            let actions = actions.map(|(number, meaning)| format!("{number}: {meaning}"));
            let actions = actions.collect::<Vec<_>>().join(", ");
            faults.add(fault.help(format!("its actions: {actions}")));
        }
    }

    /// Reports standard errors that cannot account for the learning.
    fn standard_errors(&self, faults: &mut FaultList) {
        let declaration = &self.estimate.estimate.declaration;
        if declaration.standard_errors == StandardErrors::Nominal {
            return;
        }
        let reason = match declaration.is_of_reward() {
            _ if self.manifest.family() == &recorded::FAMILY => {
                Some("the algorithm that drew the recorded actions is not known")
            }
            false => Some("they are known for `outcome` = \"reward\" and \"gross_reward\" alone"),
            true => {
                let estimated = || self.grids.iter().filter(|grid| self.is_estimated(grid));
                let mut jobs = estimated().filter_map(|grid| Some(grid.job(&grid.first()?)));
                let is_without = jobs.any(|job| job.trial.is_none());
                let is_shared = estimated().any(|grid| grid.violation(&SHARED).is_some());
                match (is_without, is_shared) {
                    (true, _) => Some("they are for an agent that learns in a [trial]"),
                    (_, true) => Some("they are supported for `pooling` = \"full\" and \"none\""),
                    (false, false) => None,
                }
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
                _ if job.environment.family() == &recorded::FAMILY => {
                    Some("a trial that happened has no other decisions than those of its file")
                }
                (Some(_), false) => None,
            }),
            false => None,
        };
        let of_agent = (declaration.is_of_agent() && declaration.truth)
            .then_some("the value of the agent's own policy is the mean outcome of its trial");
        let reason = reason.or(of_agent);
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
        let names = job.state_names();
        // What follows the action of a recorded trial is the probability of it alone.
        let is_recorded = job.environment.family() == &recorded::FAMILY;
        let is_known = |index: &usize| !(is_recorded && names.is_late(*index));
        let mut known: Vec<String> =
            (0..names.len()).filter(is_known).map(|index| names[index].clone()).collect();
        known.push(STEP.to_owned());
        let declaration = &self.estimate.estimate.declaration;
        let lists = [("control", &declaration.control), ("moderators", &declaration.moderators)];
        let features =
            lists.into_iter().flat_map(|(key, list)| list.iter().map(move |one| (key, one)));
        let named = declaration.policies();
        let named: Vec<(&str, String)> =
            named.filter_map(|(key, one)| Some((key, one.feature()?.to_owned()))).collect();
        let features = features.chain(named.iter().map(|(key, name)| (*key, name)));
        let late = |name: &String| {
            names.iter().position(|known| known == name).is_some_and(|index| names.is_late(index))
        };
        for (key, name) in features.clone().filter(|(_, name)| late(name)) {
            let says = format!("`{key}`: `{name}` follows the action, and can be an outcome alone");
            let help = match is_recorded {
                true => {
                    "declare the probability itself in `state`, such as { p = \"probability\" }"
                        .to_owned()
                }
                false => format!(
                    "use its last value: a variable of the model, as in \"default({name}[-1], 0)\""
                ),
            };
            faults.add(Fault::at(self.estimate.span_of(key), says).help(help));
        }
        let outcome = Some(("outcome", &declaration.outcome));
        let outcome = outcome.filter(|_| !declaration.is_of_reward());
        let is_unknown =
            |key: &str, name: &String| !known.contains(name) && (key == "outcome" || !late(name));
        for (key, name) in features.chain(outcome).filter(|(key, name)| is_unknown(key, name)) {
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
        let (people, decisions) = match &job.trial {
            Some(trial) => (trial.people, trial.decisions()),
            None => (job.evaluation.test_episodes, u64::from(job.environment.longest_episode())),
        };
        let actions = job.task().interface().actions;
        let of_one = |declaration: &EstimateDeclaration| {
            let treatments = declaration.treatment.count(actions);
            let (controls, terms) =
                (1 + declaration.control.len(), 1 + declaration.moderators.len());
            let columns = (controls + treatments * terms) as u64;
            let sums = columns * (columns + 5) / 2;
            let each_step = (controls + actions * terms) as u64 * u64::from(declaration.steps);
            match declaration.estimator {
                Estimator::Wcls => sums,
                Estimator::Emee => sums + decisions * (columns + OF_DECISION),
                Estimator::Value => {
                    let own = each_step + decisions * ((controls + terms) as u64 + OF_DECISION);
                    own * declaration.policies().count() as u64
                }
            }
        };
        let each = self.manifest.estimates.iter().map(|one| of_one(&one.declaration)).sum::<u64>();
        let declared = self.manifest.estimates.iter().map(|one| &*one.declaration);
        let models = declared.map(|one| of_models(one, actions, people)).sum::<u64>();
        let numbers = u64::from(people).saturating_mul(each).saturating_add(models);
        if numbers > MOST_NUMBERS {
            let message = format!(
                "the estimates hold {numbers} numbers of {people} people in memory; the maximum is {MOST_NUMBERS}"
            );
            let help = match job.environment.family() == &recorded::FAMILY {
                true => {
                    "use fewer features or fewer `steps`, or declare the estimates in several manifests, which share the job"
                }
                false => {
                    "use fewer features, fewer people, fewer `steps`, or a smaller `test_episodes`"
                }
            };
            faults.add(Fault::at(self.estimate.span, message).help(help));
        }
    }

    /// Reports agents that never draw their actions.
    fn randomisation(&self, faults: &mut FaultList) {
        // The actions of a recorded trial were drawn, whatever the policy whose value is estimated.
        let is_value = self.estimate.estimate.declaration.estimator == Estimator::Value;
        let is_drawn = |job: &Job| is_value && job.environment.family() == &recorded::FAMILY;
        let is_never = |job: Job| job.never_draws() && !is_drawn(&job);
        let never: Vec<&str> = self
            .grids
            .iter()
            .filter(|grid| self.is_estimated(grid))
            .filter(|grid| grid.first().is_some_and(|cell| is_never(grid.job(&cell))))
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

/// The numbers of the models of a value, with this number of actions and people: for a course's last decision and for all
/// earlier ones, products of the regressors with each other, with the outcome and with those of the next decision; and a
/// model per decision.
fn of_models(declaration: &EstimateDeclaration, actions: usize, people: u32) -> u64 {
    let (controls, terms) = (1 + declaration.control.len(), 1 + declaration.moderators.len());
    let columns = (controls + actions.saturating_sub(1) * terms) as u64;
    let sums = 2 * (columns * (columns + 1) / 2 + columns + columns * columns);
    match declaration.estimator {
        Estimator::Wcls | Estimator::Emee => 0,
        Estimator::Value => {
            u64::from(people).min(GROUPS) * (sums + u64::from(declaration.steps) * columns)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::parse;

    #[test]
    fn the_models_of_a_value_count() {
        let text = r#"
format = 1
name = "t"
scenarios = ["C-H-D"]
seeds = 2
environment.sigma = 0.4
evaluation.on = "trial"
trial = { people = 30, days = 50 }
[[agent]]
name = "random"
algorithm = "rule"
rule = "random"
[[estimate]]
name = "value"
estimator = "value"
policy = 0.5
steps = 3
control = ["habituation", "disengagement"]
moderators = ["habituation"]
"#;
        let manifest = parse("t", text.as_bytes()).unwrap();
        let of = &manifest.estimates[0].declaration;
        // 3 + 3 x 2 columns: 2 x (45 + 9 + 81), and 3 x 9, of each of 20 groups.
        assert_eq!(of_models(of, 4, 30), 20 * (270 + 27));
        assert_eq!(of_models(of, 4, 5), 5 * (270 + 27));
        // 200 actions of six terms are too many, however few people there are.
        let many = EstimateDeclaration {
            moderators: vec!["habituation".to_owned(); 5],
            ..EstimateDeclaration::clone(of)
        };
        assert!(of_models(&many, 200, 20) > MOST_NUMBERS);
        let wcls = EstimateDeclaration { estimator: Estimator::Wcls, ..many };
        assert_eq!(of_models(&wcls, 200, 20), 0);
    }
}
