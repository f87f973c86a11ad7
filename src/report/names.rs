//! Displayed names in figures and tables: labels of agents, symbols of parameters.
//!
//! They are made where text is drawn. CSV files keep the names of keys and whole digests of files.

use super::figure::arm_label;
use super::symbols;
use crate::analyse::declared::{ArmId, implied};
use crate::job::{Scalar, short_name};
use crate::key::shortened;
use crate::manifest::{FigureKeys, PanelKey};
use crate::record::JobRecord;

/// The labels of an experiment's agents, and the keys that names of arms leave out.
#[derive(Clone, Debug, Default)]
pub struct Names {
    /// Names of agents with their labels.
    labels: Vec<(String, String)>,
    /// Digests of files with their names.
    files: Vec<(String, String)>,
    /// Dotted names of keys that other keys of the experiment determine, such as zipped keys.
    implied: Vec<String>,
}

impl Names {
    /// The names of an experiment with these jobs, styles of figures, labels of agents and names of files.
    pub fn of(
        jobs: &[JobRecord],
        styles: &[FigureKeys],
        labels: &[(String, String)],
        files: &[(String, String)],
    ) -> Names {
        let jobs: Vec<&JobRecord> = jobs.iter().collect();
        let panels = styles.iter().filter_map(|style| match style.panel? {
            PanelKey::Key(parameter) => Some(parameter.to_string()),
            PanelKey::Agent | PanelKey::Scenario => None,
        });
        let kept: Vec<String> = panels.collect();
        Names { labels: labels.to_vec(), files: files.to_vec(), implied: implied(&jobs, &kept) }
    }

    /// The label of an agent.
    pub fn agent(&self, name: &str) -> String {
        let label = self.labels.iter().find(|(known, _)| known == name);
        label.map_or(name, |(_, label)| label).to_owned()
    }

    /// Words such as `delta_d=0.1`, and names of agents if `has_agents`, as they are displayed.
    pub fn words(&self, text: &str, has_agents: bool) -> String {
        let word = |word: &str| match word.split_once('=') {
            Some((key, value)) => format!("{}={value}", symbols::key(key)),
            None if has_agents => self.agent(word),
            None => word.to_owned(),
        };
        self.with_files(&text.split(' ').map(word).collect::<Vec<_>>().join(" "))
    }

    /// A text with the names of files, and of other contents the beginnings of their digests.
    fn with_files(&self, text: &str) -> String {
        let named = |text: String, (content, file): &(String, String)| text.replace(content, file);
        shortened(&self.files.iter().fold(text.to_owned(), named))
    }

    /// What figures show of an arm: its agent's label, and its settings without implied ones, with the names of files.
    pub fn arm(&self, name: &ArmId) -> ArmId {
        let mut arm = ArmId { agent: self.agent(&name.agent), ..name.clone() };
        arm.settings.retain(|(key, _)| !self.implied.contains(key));
        for (_, value) in &mut arm.settings {
            if let Scalar::Text(text) = value {
                *text = self.with_files(text);
            }
        }
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
            key.is_some_and(|key| {
                self.implied.iter().any(|one| one == key || short_name(one) == key)
            })
        };
        let words = subject.split(' ').filter(|word| !is_implied(word));
        self.words(&words.collect::<Vec<_>>().join(" "), has_agents)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_has_a_symbol_and_an_agent_its_label() {
        assert_eq!(symbols::key("environment.delta_d"), "environment.δ_d");
        assert_eq!(symbols::key("agent.learning_rate"), "agent.learning_rate");
        assert_eq!(symbols::key("sigma"), "σ");
        let names = Names {
            labels: vec![("dqn".to_owned(), "Deep Q".to_owned())],
            implied: vec!["environment.kappa_h".to_owned()],
            ..Names::default()
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
        // The subject of a map, which its sentences name.
        let subject = format!("P-H-D people=sha256:{} kappa_h=10", "0123456789abcdef".repeat(4));
        assert_eq!(names.subject(&subject, false), "P-H-D people=sha256:01234567");
    }
}
