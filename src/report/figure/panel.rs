//! Panels: groups of arms that a figure draws together.

use crate::report::symbols;

use super::look::{Looks, labels, settings_label};
use crate::analyse::declared::ArmId;
use crate::analyse::grouped;
use crate::job::distinct;
use crate::manifest::PanelKey;
use crate::report::escape::file_stem;

/// Maximum number of arms that a figure without a declared panel draws together.
pub const MOST_ARMS: usize = 6;

/// A panel of a figure.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Panel {
    /// The values that distinguish it, which all of its arms share; empty if the figure has no panels.
    pub heading: String,
    /// The positions of its arms.
    pub members: Vec<usize>,
}

/// The panels of a figure and the keys that distinguish them.
#[derive(Clone, Debug, PartialEq)]
pub struct Panels {
    /// The panels, in the order of the arms; at least one.
    pub panels: Vec<Panel>,
    /// The keys that panels are split by because there are many arms.
    pub added: Vec<String>,
    /// The arms without the settings that distinguish panels.
    pub arms: Vec<ArmId>,
    /// The label of every arm within its panel.
    pub labels: Vec<String>,
}

/// A key that can distinguish panels.
#[derive(Clone, Debug, PartialEq, Eq)]
enum By {
    Agent,
    Scenario,
    Key(String),
}

impl By {
    fn name(&self) -> String {
        match self {
            By::Agent => "agent".to_owned(),
            By::Scenario => "scenario".to_owned(),
            By::Key(name) => name.clone(),
        }
    }

    /// The value of an arm; empty if it lacks the key.
    fn value(&self, name: &ArmId) -> String {
        match self {
            By::Agent => name.agent.clone(),
            By::Scenario => name.scenario.clone(),
            By::Key(key) => {
                let found = name.settings.iter().find(|(known, _)| known == key);
                found.map_or_else(String::new, |setting| {
                    settings_label(std::slice::from_ref(setting))
                })
            }
        }
    }

    /// Removes from an arm's name the value that distinguishes its panel.
    fn without(&self, name: &mut ArmId) {
        match self {
            By::Agent => name.agent = String::new(),
            By::Scenario => name.scenario = String::new(),
            By::Key(key) => name.settings.retain(|(known, _)| known != key),
        }
    }
}

impl Panels {
    /// The panels of these arms, as they are displayed. A declared key alone determines the panels.
    /// Otherwise the panels of `usual` are split along further keys, as long as a panel has more
    /// than [`MOST_ARMS`] arms.
    pub fn of(arms: &[&ArmId], declared: Option<PanelKey>, usual: Option<PanelKey>) -> Panels {
        let mut by: Vec<By> = declared.or(usual).map(by).into_iter().collect();
        let (mut panels, mut added) = (self::panels(arms, &by), Vec::new());
        while declared.is_none() && panels.iter().any(|panel| panel.members.len() > MOST_ARMS) {
            let Some(next) = next_key(arms, &by) else { break };
            added.push(next.name());
            by.push(next);
            panels = self::panels(arms, &by);
        }
        // Without a heading, the panel's files would have the name of the figure of all panels.
        if panels.len() > 1 {
            for panel in panels.iter_mut().filter(|panel| panel.heading.is_empty()) {
                let names = by.iter().map(By::name).collect::<Vec<_>>().join(", ");
                panel.heading = format!("without {}", symbols::short(&names));
            }
        }
        let mut rest: Vec<ArmId> = arms.iter().map(|name| (*name).clone()).collect();
        let keys = || by.iter().filter(|by| matches!(by, By::Key(_)));
        let mut alike = rest.clone();
        alike.iter_mut().for_each(|name| keys().for_each(|by| by.without(name)));
        rest.iter_mut().for_each(|name| by.iter().for_each(|by| by.without(name)));
        let mut labels = match declared {
            // The labels would be equal, so they are written in full.
            Some(_) if rest.windows(2).all(|pair| pair[0] == pair[1]) => {
                rest.iter().map(super::arm_label).collect()
            }
            _ => labels(&rest.iter().collect::<Vec<_>>()),
        };
        for (label, name) in labels.iter_mut().zip(arms) {
            if label.is_empty() {
                *label = super::arm_label(name);
            }
        }
        Panels { panels, added, arms: alike, labels }
    }

    /// All arms in one panel without a heading.
    pub fn whole(arms: &[&ArmId]) -> Panels {
        let members = (0..arms.len()).collect();
        let panel = Panel { heading: String::new(), members };
        let labels = arms.iter().map(|name| super::arm_label(name)).collect();
        let arms = arms.iter().map(|name| (*name).clone()).collect();
        Panels { panels: vec![panel], added: Vec::new(), arms, labels }
    }

    /// The looks of its arms: those of the report, unless arms that differ in the panels' settings alone are to look
    /// the same in every panel.
    pub fn looks(&self, of_report: &Looks, names: &[&ArmId]) -> Looks {
        match names.iter().zip(&self.arms).all(|(name, arm)| *name == arm) {
            true => of_report.clone(),
            false => Looks::of(&self.arms),
        }
    }

    /// The stems of the panels' files, which begin with `stem`.
    pub fn stems(&self, stem: &str) -> Vec<String> {
        let of_panel = |panel: &Panel| match panel.heading.as_str() {
            "" => stem.to_owned(),
            heading => format!("{stem}-{}", file_stem(heading)),
        };
        self.panels.iter().map(of_panel).collect()
    }

    /// Whether all arms are in one panel.
    pub fn is_one(&self) -> bool {
        self.panels.len() == 1
    }
}

fn by(key: PanelKey) -> By {
    match key {
        PanelKey::Agent => By::Agent,
        PanelKey::Scenario => By::Scenario,
        PanelKey::Key(parameter) => By::Key(parameter.to_string()),
    }
}

/// The arms grouped by their values of the keys.
fn panels(arms: &[&ArmId], by: &[By]) -> Vec<Panel> {
    let heading = |name: &&ArmId| {
        let values = by.iter().map(|by| by.value(name)).filter(|value| !value.is_empty());
        values.collect::<Vec<_>>().join(", ")
    };
    let panel = |(heading, members)| Panel { heading, members };
    grouped(arms.iter().map(heading).zip(0..)).into_iter().map(panel).collect()
}

/// The key by which panels are split next: the one with the fewest values, among those that leave no
/// panel with more than [`MOST_ARMS`] arms, if there are any. Ties go to agents before scenarios before
/// other keys.
fn next_key(arms: &[&ArmId], taken: &[By]) -> Option<By> {
    let settings = arms.iter().flat_map(|arm| &arm.settings);
    let settings = settings.map(|(name, _)| By::Key(name.clone()));
    let keys = distinct([By::Agent, By::Scenario].into_iter().chain(settings));
    let counted = keys.into_iter().filter(|key| !taken.contains(key)).map(|key| {
        let mut values: Vec<String> = arms.iter().map(|arm| key.value(arm)).collect();
        values.sort_unstable();
        values.dedup();
        (values.len(), key)
    });
    let swept = counted.filter(|(count, _)| *count > 1);
    let is_too_full = |key: &By| {
        let panels = panels(arms, &[taken, std::slice::from_ref(key)].concat());
        panels.iter().any(|panel| panel.members.len() > MOST_ARMS)
    };
    swept.min_by_key(|(count, key)| (is_too_full(key), *count)).map(|(_, key)| key)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::Scalar;
    use crate::key::Parameter;

    fn arms(agents: &[&str], scenarios: &[&str], decays: &[f64]) -> Vec<ArmId> {
        let mut arms = Vec::new();
        for agent in agents {
            for scenario in scenarios {
                for decay in decays {
                    let settings = vec![("environment.delta_d".to_owned(), Scalar::Real(*decay))];
                    let (agent, scenario) = ((*agent).to_owned(), (*scenario).to_owned());
                    arms.push(ArmId { agent, scenario, settings });
                }
            }
        }
        arms
    }

    fn displayed(
        arms: &[ArmId],
        declared: Option<PanelKey>,
    ) -> (Vec<String>, Vec<usize>, Vec<String>) {
        let names: Vec<&ArmId> = arms.iter().collect();
        let Panels { panels, labels, .. } = Panels::of(&names, declared, None);
        let headings = panels.iter().map(|panel| panel.heading.clone()).collect();
        (headings, panels.iter().map(|panel| panel.members.len()).collect(), labels)
    }

    #[test]
    fn six_arms_share_a_panel_and_seven_do_not() {
        let six = arms(&["dqn", "ppo"], &["P"], &[1.0, 2.0, 3.0]);
        assert_eq!(displayed(&six, None).1, [6]);
        let seven = arms(&["dqn"], &["P"], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
        assert_eq!(displayed(&seven, None).1, [1; 7]);
        assert_eq!(displayed(&seven, None).0[0], "δ_d=1");
        assert_eq!(displayed(&seven, None).2[0], "dqn P");
    }

    #[test]
    fn more_arms_are_split_along_the_key_with_the_fewest_values() {
        let twelve = arms(&["a", "b", "c"], &["P", "L"], &[1.0, 2.0]);
        let (headings, counts, labels) = displayed(&twelve, None);
        assert_eq!((headings, counts), (vec!["P".to_owned(), "L".to_owned()], vec![6, 6]));
        assert_eq!(labels[..3], ["a δ_d=1", "a δ_d=2", "a δ_d=1"]);
        // Two scenarios would leave nine arms in a panel; three agents leave six.
        let many = arms(&["a", "b", "c"], &["P", "L"], &[1.0, 2.0, 3.0]);
        assert_eq!(displayed(&many, None).0, ["a", "b", "c"]);
        assert_eq!(displayed(&many, None).1, [6; 3]);
        // If no key is enough, panels are split until none has more than six arms.
        let more = arms(&["a", "b", "c"], &["P", "L", "C"], &[1.0, 2.0, 3.0]);
        assert_eq!(displayed(&more, None).1, [3; 9]);
        assert_eq!(displayed(&more, None).0[1], "a, L");
    }

    #[test]
    fn a_declared_key_is_the_only_one() {
        let many = arms(&["a", "b", "c", "d"], &["P", "L"], &[1.0, 2.0]);
        let decay = PanelKey::Key(Parameter::Environment("delta_d"));
        let (headings, counts, labels) = displayed(&many, Some(decay));
        assert_eq!((headings, counts), (vec!["δ_d=1".into(), "δ_d=2".into()], vec![8, 8]));
        assert_eq!(labels[0], "a P");
        assert_eq!(displayed(&many, Some(PanelKey::Agent)).1, [4; 4]);
    }

    #[test]
    fn an_arm_looks_the_same_in_every_panel() {
        let all = arms(&["a", "b"], &["P-H-D"], &[0.1, 0.2]);
        let names: Vec<&ArmId> = all.iter().collect();
        let report = Looks::of(&all);
        let decay = PanelKey::Key(Parameter::Environment("delta_d"));
        let panels = Panels::of(&names, Some(decay), None);
        let looks = panels.looks(&report, &names);
        let seen: Vec<_> = panels.arms.iter().map(|arm| looks.look(arm)).collect();
        // In the order of agents and decays.
        assert!(seen[0] == seen[1] && seen[2] == seen[3] && seen[0] != seen[2], "{seen:?}");
        let whole = Panels::of(&names, None, None);
        assert_eq!(whole.looks(&report, &names), report);
    }
}
