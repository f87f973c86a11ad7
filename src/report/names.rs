//! Displayed names in figures and tables: labels of agents, symbols of parameters.
//!
//! They are made where text is drawn. CSV files keep the names of keys.

use super::figure::arm_label;
use super::section::ReportedExperiment;
use crate::analyse::declared::{ArmId, implied};
use crate::env::{SYMBOLS, Symbol};
use crate::job::short_name;
use crate::manifest::PanelKey;
use crate::record::JobRecord;

/// The discount of learners, which papers write as a symbol.
const DISCOUNT: Symbol = Symbol { key: "gamma", symbol: "γ", quantity: Some("discount") };

/// The keys that papers write as symbols. Symbols that begin with another symbol come first.
fn symbols() -> impl Iterator<Item = Symbol> {
    SYMBOLS.iter().copied().chain([DISCOUNT])
}

/// The labels of an experiment's agents, and the keys that names of arms leave out.
#[derive(Clone, Debug, Default)]
pub struct Names {
    /// Names of agents with their labels.
    labels: Vec<(String, String)>,
    /// Dotted names of keys that other keys of the experiment determine, such as zipped keys.
    implied: Vec<String>,
}

impl Names {
    /// The names of an experiment.
    pub fn of(experiment: &ReportedExperiment) -> Names {
        let jobs: Vec<&JobRecord> = experiment.jobs.iter().collect();
        let panels = experiment.styles.iter().filter_map(|style| match style.panel? {
            PanelKey::Key(parameter) => Some(parameter.to_string()),
            PanelKey::Agent | PanelKey::Scenario => None,
        });
        let kept: Vec<String> = panels.collect();
        Names { labels: experiment.labels.clone(), implied: implied(&jobs, &kept) }
    }

    /// A dotted name with its last part as a symbol, if it has one.
    pub fn key(dotted: &str) -> String {
        let (section, key) = match dotted.rsplit_once('.') {
            Some((section, key)) => (Some(section), key),
            None => (None, dotted),
        };
        let symbol = symbols().find(|symbol| symbol.key == key);
        match (section, symbol) {
            (_, None) => dotted.to_owned(),
            (None, Some(Symbol { symbol, .. })) => symbol.to_owned(),
            (Some(section), Some(Symbol { symbol, .. })) => format!("{section}.{symbol}"),
        }
    }

    /// The last part of a dotted name, as a symbol if it has one.
    pub fn short(dotted: &str) -> String {
        short_name(&Names::key(dotted)).to_owned()
    }

    /// The name of a parameter's quantity, as axes have it.
    pub fn quantity(dotted: &str) -> String {
        let short = Names::short(dotted);
        match symbols().find(|one| one.symbol == short).and_then(|one| one.quantity) {
            Some(quantity) => format!("{quantity} {short}"),
            None => short.replace('_', " "),
        }
    }

    /// The label of an agent.
    pub fn agent(&self, name: &str) -> String {
        let label = self.labels.iter().find(|(known, _)| known == name);
        label.map_or(name, |(_, label)| label).to_owned()
    }

    /// Words such as `delta_d=0.1`, and names of agents if `has_agents`, as they are displayed.
    pub fn words(&self, text: &str, has_agents: bool) -> String {
        let word = |word: &str| match word.split_once('=') {
            Some((key, value)) => format!("{}={value}", Names::key(key)),
            None if has_agents => self.agent(word),
            None => word.to_owned(),
        };
        text.split(' ').map(word).collect::<Vec<_>>().join(" ")
    }

    /// What figures show of an arm: its agent's label, and its settings without implied ones.
    pub fn arm(&self, name: &ArmId) -> ArmId {
        let mut arm = ArmId { agent: self.agent(&name.agent), ..name.clone() };
        arm.settings.retain(|(key, _)| !self.implied.contains(key));
        arm
    }

    /// What figures show of these arms.
    pub fn arms<'n>(&self, names: impl IntoIterator<Item = &'n ArmId>) -> Vec<ArmId> {
        names.into_iter().map(|name| self.arm(name)).collect()
    }

    /// The label of an arm.
    pub fn label(&self, name: &ArmId) -> String {
        arm_label(&self.arm(name))
    }

    /// The subject of a map as it is displayed, without implied settings.
    pub fn subject(&self, subject: &str, has_agents: bool) -> String {
        let is_implied = |word: &&str| {
            let key = word.split_once('=').map(|(key, _)| key);
            key.is_some_and(|key| self.implied.iter().any(|one| short_name(one) == key))
        };
        let words = subject.split(' ').filter(|word| !is_implied(word));
        self.words(&words.collect::<Vec<_>>().join(" "), has_agents)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::Scalar;

    #[test]
    fn a_key_has_a_symbol_and_an_agent_its_label() {
        assert_eq!(Names::key("environment.delta_d"), "environment.δ_d");
        assert_eq!(Names::key("agent.learning_rate"), "agent.learning_rate");
        assert_eq!(Names::key("sigma"), "σ");
        let names = Names {
            labels: vec![("dqn".to_owned(), "Deep Q".to_owned())],
            implied: vec!["environment.kappa_h".to_owned()],
        };
        let arm = ArmId {
            agent: "dqn".to_owned(),
            scenario: "P-H-D".to_owned(),
            settings: vec![
                ("environment.kappa_h".to_owned(), Scalar::Real(10.0)),
                ("environment.rho_1".to_owned(), Scalar::Real(50.0)),
            ],
        };
        assert_eq!(names.label(&arm), "Deep Q P-H-D ρ_1=50");
        assert_eq!(names.words("dqn - ppo epsilon_d=0.2", true), "Deep Q - ppo ε_d=0.2");
        assert_eq!(names.words("dqn", false), "dqn");
    }
}
