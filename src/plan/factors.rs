//! The jobs of a manifest as a product of factors: agents, scenarios, swept keys, seeds.

use std::fmt;

use super::staged::count;
use crate::job::counted;
use crate::key::Parameter;
use crate::key::printable;
use crate::manifest::{Grid, Manifest};

/// Agents whose grids have the same factors, and the number of their jobs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Factors {
    /// Names of the agents, in the order of the manifest.
    pub agents: Vec<String>,
    /// The factors of each agent, as a name and a number of values: scenarios, swept keys, seeds.
    /// Keys of a zip are one factor.
    pub each: Vec<(String, usize)>,
    /// The number of jobs of each agent.
    pub jobs: u64,
    /// The number of cells of each agent that the manifest excludes.
    pub excluded: u64,
}

impl Factors {
    /// The factors of a manifest's agents; agents with the same factors are grouped.
    pub fn of(manifest: &Manifest) -> Vec<Factors> {
        let mut all: Vec<Factors> = Vec::new();
        for (index, agent) in manifest.agents.iter().enumerate() {
            let grid = Grid::of(manifest, index);
            let named = |(parameters, length): (&[Parameter], usize)| (name(parameters), length);
            let each: Vec<(String, usize)> = grid.factors().map(named).collect();
            let cells: u64 = each.iter().map(|(_, length)| *length as u64).product();
            let jobs = grid.count();
            let excluded = cells.saturating_sub(jobs);
            let alike = |known: &&mut Factors| known.each == each && known.jobs == jobs;
            match all.iter_mut().find(alike) {
                Some(known) => known.agents.push(agent.name.clone()),
                None => {
                    let agents = vec![agent.name.clone()];
                    all.push(Factors { agents, each, jobs, excluded });
                }
            }
        }
        all
    }

    /// The number of a manifest's jobs as a product, or in all and as a product for each group of agents.
    pub fn lines(manifest: &Manifest) -> Vec<String> {
        match Factors::of(manifest).as_slice() {
            [all] => vec![all.to_string()],
            groups => {
                let total = counted(count(manifest), "job");
                let each = groups.iter().map(|some| format!("{}: {some}", some.names()));
                std::iter::once(total).chain(each).collect()
            }
        }
    }

    /// The agents' names as readable text.
    pub fn names(&self) -> String {
        self.agents.iter().map(|name| printable(name)).collect::<Vec<_>>().join(", ")
    }
}

/// `scenario`, `seed`, or the names of keys, such as `gamma` or `gamma+batch`.
fn name(parameters: &[Parameter]) -> String {
    let one = |parameter: &Parameter| parameter.key();
    parameters.iter().map(one).collect::<Vec<_>>().join("+")
}

/// Writes `2 agents × 3 scenarios × 2 gamma × 5 seeds = 60 jobs`.
impl fmt::Display for Factors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let plural = |count: u64| if count == 1 { "" } else { "s" };
        let agents = self.agents.len() as u64;
        write!(f, "{agents} agent{}", plural(agents))?;
        for (name, values) in &self.each {
            let is_noun = matches!(name.as_str(), "scenario" | "seed");
            let ending = if is_noun { plural(*values as u64) } else { "" };
            write!(f, " × {values} {name}{ending}")?;
        }
        if self.excluded > 0 {
            write!(f, " − {} excluded", self.excluded * agents)?;
        }
        let jobs = self.jobs * agents;
        write!(f, " = {jobs} job{}", plural(jobs))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest;
    use crate::plan;

    #[test]
    fn factors_multiply_to_the_jobs() {
        let text = "format = 1\nname = \"t\"\nscenarios = [\"P-H-D\", \"P-T\", \"C-T\"]\nseeds = 5\n\
                    zip = [[\"environment.delta_d\", \"environment.delta_h\"]]\n\
                    exclude = [{ scenario = \"C-T\", environment.sigma = 0.6 }]\n\
                    [environment]\nsigma = [0.4, 0.6]\ndelta_d = [0.1, 0.2]\ndelta_h = [0.1, 0.3]\n\
                    [[agent]]\nname = \"a\"\nalgorithm = \"reinforce\"\n\
                    [[agent]]\nname = \"b\"\nalgorithm = \"dueling_dqn\"\n\
                    [[agent]]\nname = \"c\"\nalgorithm = \"dueling_dqn\"\nbatch = [16, 32, 64]\n";
        let manifest = manifest::parse("t", text.as_bytes()).unwrap();
        let factors = Factors::of(&manifest);
        let lines: Vec<String> =
            factors.iter().map(|factors| format!("{}: {factors}", factors.names())).collect();
        assert_eq!(
            lines,
            [
                "a, b: 2 agents × 3 scenarios × 2 sigma × 2 delta_d+delta_h × 5 seeds − 20 excluded = 100 jobs",
                "c: 1 agent × 3 scenarios × 2 sigma × 2 delta_d+delta_h × 3 batch × 5 seeds − 30 excluded = 150 jobs",
            ]
        );
        let jobs: u64 =
            factors.iter().map(|factors| factors.jobs * factors.agents.len() as u64).sum();
        assert_eq!(jobs, plan::count(&manifest));
    }
}
