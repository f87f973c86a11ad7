//! The looks of arms. An arm looks the same in every figure of a report.

use crate::job::{distinct, short_beside};
use crate::key::shortened;
use crate::report::symbols;
use std::collections::HashMap;

use super::INK;
use crate::analyse::declared::ArmId;
use crate::job::Scalar;
use crate::report::scene::{Color, Facets};

/// The colours of Okabe and Ito, which colour-blind readers can distinguish. Black and yellow are
/// left out: they are hard to separate from text and paper.
pub const COLORS: [Color; 6] = [
    Color(0, 114, 178),
    Color(213, 94, 0),
    Color(0, 158, 115),
    Color(204, 121, 167),
    Color(86, 180, 233),
    Color(230, 159, 0),
];

/// Scenarios of published papers with fixed colours, so that they look the same in every report.
const KNOWN: [(&str, Color); 6] = [
    ("P-H-D", COLORS[0]),
    ("L-H-D", COLORS[1]),
    ("P-T", COLORS[2]),
    ("L-T", COLORS[3]),
    ("C-H-D", Color(68, 68, 68)),
    ("C-T", COLORS[5]),
];

/// The colours of agents, if colours distinguish agents.
const OF_AGENTS: [Color; 8] = [
    COLORS[0],
    COLORS[1],
    COLORS[2],
    COLORS[3],
    COLORS[4],
    COLORS[5],
    Color(68, 68, 68),
    Color(150, 150, 150),
];

/// Dashes of the agents, in the manifest's order. None are dots, as the lines of optima are.
pub const DASHES: [Option<(f64, f64)>; 4] =
    [None, Some((5.0, 2.5)), Some((2.6, 1.6)), Some((10.0, 3.0))];

/// The look of an arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Colour, by scenario or by agent.
    pub color: Color,
    /// Dash by agent, or by scenario if colours are by agent.
    pub dash: Option<(f64, f64)>,
    /// Marker by agent, or by scenario if colours are by agent.
    pub marker: Marker,
}

/// The mark of an arm's points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Marker {
    /// A filled circle.
    Disc,
    /// A circle filled with white.
    Ring,
    /// A filled square.
    Square,
    /// A diamond filled with white.
    Diamond,
}

impl Marker {
    /// Whether it is an outline filled with white.
    pub(super) fn is_hollow(self) -> bool {
        match self {
            Marker::Ring | Marker::Diamond => true,
            Marker::Disc | Marker::Square => false,
        }
    }
}

/// The number of shades of a colour.
const SHADES: usize = 4;

const MARKERS: [Marker; 4] = [Marker::Disc, Marker::Ring, Marker::Square, Marker::Diamond];

/// The looks of a report's arms: colours by scenario, dashes and markers by agent. If there are
/// more agents than dashes, colours are by agent, dashes and markers by scenario.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Looks {
    agents: Vec<String>,
    scenarios: Vec<String>,
    /// The index of each arm apart from its scenario, and apart from its agent; empty if no arm has settings.
    of_agents: HashMap<Apart, usize>,
    of_scenarios: HashMap<Apart, usize>,
}

/// What distinguishes an arm besides its colour: its agent or scenario, and its settings.
type Apart = (String, Vec<(String, String)>);

impl Looks {
    /// The looks of these arms, in the order in which they first appear.
    pub fn of<'n>(names: impl IntoIterator<Item = &'n ArmId>) -> Looks {
        let names: Vec<&ArmId> = names.into_iter().collect();
        let mut looks = Looks {
            agents: distinct(names.iter().map(|name| name.agent.clone())),
            scenarios: distinct(names.iter().map(|name| name.scenario.clone())),
            ..Looks::default()
        };
        if names.iter().any(|name| !name.settings.is_empty()) {
            for name in names {
                let next = looks.of_agents.len();
                looks.of_agents.entry((name.agent.clone(), words(name))).or_insert(next);
                let next = looks.of_scenarios.len();
                looks.of_scenarios.entry((name.scenario.clone(), words(name))).or_insert(next);
            }
        }
        looks
    }

    /// The look of the optimum in an arm's environment.
    pub fn of_optimum(&self, name: &ArmId) -> Look {
        let scenario = index_of(&self.scenarios, &name.scenario);
        let color = match self.distinguishes_agents() {
            true => INK,
            false => self.look(name).color.towards(INK, 0.25),
        };
        // Dots further apart tell scenarios apart where colours do not.
        let gap = if self.distinguishes_agents() { 2.4 + 2.0 * (scenario % 4) as f64 } else { 2.4 };
        Look { color, dash: Some((1.0, gap)), marker: Marker::Ring }
    }

    /// The look of an arm.
    pub fn look(&self, name: &ArmId) -> Look {
        let agent = index_of(&self.agents, &name.agent);
        let scenario = index_of(&self.scenarios, &name.scenario);
        let (base, kind) = match self.distinguishes_agents() {
            true => (OF_AGENTS[agent % OF_AGENTS.len()], scenario),
            false => (self.color_of_scenario(&name.scenario), agent),
        };
        // Arms that differ in settings have colours of their own, if scenarios or agents need none; else dashes and
        // markers of their own, and shades when these are used up.
        let (indices, word) = match self.distinguishes_agents() {
            true => (&self.of_scenarios, &name.scenario),
            false => (&self.of_agents, &name.agent),
        };
        let at = indices.get(&(word.clone(), words(name))).copied().unwrap_or(kind);
        let colored = if self.distinguishes_agents() { &self.agents } else { &self.scenarios };
        let (base, kind, shade) = match colored.len() {
            _ if indices.is_empty() => (base, kind, 0.0),
            0 | 1 => {
                let first = COLORS.iter().position(|color| *color == base).unwrap_or(0);
                (COLORS[(first + at) % COLORS.len()], at / COLORS.len(), 0.0)
            }
            _ => (base, at, (at / DASHES.len() % SHADES) as f64 / SHADES as f64 * 0.6),
        };
        Look {
            color: base.towards(Color::WHITE, shade),
            dash: DASHES[kind % DASHES.len()],
            marker: MARKERS[kind % MARKERS.len()],
        }
    }

    /// The colour of a scenario: its fixed colour, or one that no scenario of the report has.
    fn color_of_scenario(&self, scenario: &str) -> Color {
        let fixed = |name: &str| KNOWN.iter().find(|known| known.0 == name).map(|known| known.1);
        if let Some(color) = fixed(scenario) {
            return color;
        }
        let taken: Vec<Color> = self.scenarios.iter().filter_map(|name| fixed(name)).collect();
        // Hardly any fixed colour is sky blue or orange, so these come first. Sky blue beside blue is the last
        // colour before the greys.
        let first = if taken.contains(&COLORS[0]) { 5 } else { 4 };
        let all = COLORS.iter().cycle().skip(first).take(COLORS.len()).chain(&OF_AGENTS[6..]);
        let free: Vec<&Color> = all.filter(|color| !taken.contains(color)).collect();
        let others = self.scenarios.iter().filter(|name| fixed(name).is_none());
        *free[others.take_while(|name| *name != scenario).count() % free.len()]
    }

    /// The colour of a value of a facet, if colours distinguish that facet.
    pub fn color_of(&self, facet: &str, value: &str) -> Option<Color> {
        let stands = if self.distinguishes_agents() { "agent" } else { "scenario" };
        let list = if self.distinguishes_agents() { &self.agents } else { &self.scenarios };
        let is_known = facet == stands && list.iter().any(|known| known == value);
        let (agent, scenario) = match facet {
            "agent" => (value.to_owned(), String::new()),
            _ => (String::new(), value.to_owned()),
        };
        is_known.then(|| self.look(&ArmId { agent, scenario, settings: Vec::new() }).color)
    }

    /// Whether colours distinguish agents, and dashes scenarios: true if there are more agents than dashes.
    fn distinguishes_agents(&self) -> bool {
        self.agents.len() > DASHES.len()
    }
}

fn index_of(list: &[String], word: &str) -> usize {
    list.iter().position(|known| known == word).unwrap_or(0)
}

fn words(name: &ArmId) -> Vec<(String, String)> {
    name.settings.iter().map(|(key, value)| (key.clone(), value.to_string())).collect()
}

/// The names and values that identify an arm, without empty ones.
pub fn facets(name: &ArmId) -> Facets {
    let words = [("agent", &name.agent), ("scenario", &name.scenario)];
    let words = words.into_iter().filter(|(_, word)| !word.is_empty());
    let words = words.map(|(key, word)| (key.to_owned(), word.clone()));
    let settings = name
        .settings
        .iter()
        .map(|(key, value)| (symbols::short(key), shortened(&value.to_string())));
    words.chain(settings).collect()
}

/// The full label of an arm: `dqn P-H-D σ=0.6`.
pub fn arm_label(name: &ArmId) -> String {
    joined([&name.agent, &name.scenario, &settings_label(&name.settings)])
}

/// The name of an arm in files: `dqn P-H-D horizon=50`.
pub fn arm_key(name: &ArmId) -> String {
    joined([&name.agent, &name.scenario, &settings_key(&name.settings)])
}

fn joined(parts: [&str; 3]) -> String {
    parts.into_iter().filter(|part| !part.is_empty()).collect::<Vec<_>>().join(" ")
}

/// Settings on one line: `learning_rate=0.001 σ=0.6`.
pub fn settings_label(settings: &[(String, Scalar)]) -> String {
    let word = |(key, value): &(String, Scalar)| {
        let short = symbols::key(short_beside(key, settings.iter().map(|(other, _)| other)));
        format!("{short}={value}")
    };
    shortened(&settings.iter().map(word).collect::<Vec<_>>().join(" "))
}

/// Settings on one line with the names of keys: `learning_rate=0.001 horizon=50`.
pub fn settings_key(settings: &[(String, Scalar)]) -> String {
    let word = |(key, value): &(String, Scalar)| {
        format!("{}={value}", short_beside(key, settings.iter().map(|(other, _)| other)))
    };
    settings.iter().map(word).collect::<Vec<_>>().join(" ")
}

/// The labels of arms that are shown together, without the parts that all of them share.
pub fn labels(names: &[&ArmId]) -> Vec<String> {
    let same = |word: fn(&ArmId) -> &String| {
        names.len() > 1 && names.windows(2).all(|pair| word(pair[0]) == word(pair[1]))
    };
    let (same_agent, same_scenario) = (same(|name| &name.agent), same(|name| &name.scenario));
    let label = |name: &&ArmId| {
        let mut name = (*name).clone();
        if same_agent {
            name.agent = String::new();
        }
        if same_scenario {
            name.scenario = String::new();
        }
        let label = arm_label(&name);
        if label.is_empty() { arm_label(names[0]) } else { label }
    };
    names.iter().map(label).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arm(agent: &str, scenario: &str, rate: f64) -> ArmId {
        let settings = vec![("agent.rate".to_owned(), Scalar::Real(rate))];
        ArmId { agent: agent.into(), scenario: scenario.into(), settings }
    }

    /// Whether all arms look differently, also without markers, as on learning curves.
    fn are_distinct(arms: &[ArmId]) -> bool {
        let looks = Looks::of(arms);
        let seen: Vec<_> =
            arms.iter().map(|arm| looks.look(arm)).map(|l| (l.color, l.dash)).collect();
        (0..seen.len()).all(|at| !seen[..at].contains(&seen[at]))
    }

    #[test]
    fn arms_that_differ_in_agent_scenario_or_settings_look_differently() {
        let arms = |agents: &[&str], scenarios: &[&str], rates: u32| -> Vec<ArmId> {
            let mut all = Vec::new();
            for agent in agents {
                for scenario in scenarios {
                    all.extend((0..rates).map(|rate| arm(agent, scenario, f64::from(rate))));
                }
            }
            all
        };
        assert!(are_distinct(&arms(&["a", "b"], &["P-H-D"], 8)));
        assert!(are_distinct(&arms(&["a", "b"], &["P-H-D", "L-H-D"], 6)));
        assert!(are_distinct(&arms(&["a", "b", "c", "d", "e"], &["P-H-D", "L-H-D"], 4)));
    }

    #[test]
    fn keys_of_the_population_are_not_those_of_the_environment() {
        let both = ["environment.delta_d", "population.delta_d"];
        let settings = both.map(|key| (key.to_owned(), Scalar::Real(0.5)));
        assert_eq!(settings_label(&settings), "δ_d=0.5 population.δ_d=0.5");
        assert_eq!(settings_key(&settings), "delta_d=0.5 population.delta_d=0.5");
    }

    #[test]
    fn scenarios_without_a_fixed_colour_have_one_that_no_other_has() {
        let names = ["P-T", "F-E-R", "F-E-R-M-S", "P-H-D", "P-M-S", "M-S"];
        let arms = names.map(|scenario| arm("a", scenario, 0.0));
        let looks = Looks::of(&arms);
        let colors: Vec<Color> = names.iter().map(|name| looks.color_of_scenario(name)).collect();
        let is_new = |at: usize| !colors[..at].contains(&colors[at]);
        assert!((0..names.len()).all(is_new), "{colors:?}");
    }

    #[test]
    fn the_optima_of_scenarios_look_differently_where_colours_are_of_agents() {
        let names = ["a", "b", "c", "d", "e"].map(|agent| arm(agent, "P-H-D", 0.0));
        let other = arm("a", "L-H-D", 0.0);
        let looks = Looks::of(names.iter().chain([&other]));
        assert_ne!(looks.of_optimum(&names[0]), looks.of_optimum(&other));
        assert!(DASHES.iter().all(|dash| *dash != looks.of_optimum(&other).dash));
    }
}
