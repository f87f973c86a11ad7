//! Reads `[search]`, and gives the drawn keys of agents their values.
//!
//! In: the table, and the draws of agents. Out: for each agent with draws, lists of equal length, which are one
//! axis of its grid: the arms of the race. The seeds of the manifest are those of the race, then the fresh ones.

use std::collections::HashSet;

use crate::key::{Parameter, Value};
use crate::manifest::draft::{AgentDraft, Draft};
use crate::manifest::search::declared::Search;
use crate::manifest::search::draw::Draw;
use crate::manifest::search::points::points;
use crate::manifest::table::{Fields, TableReader, names};
use crate::manifest::value::sweep::{Node, Reader};
use crate::text::{Fault, Located, Span};

/// The points that are tried per setting, until the draws count as exhausted: choices and whole numbers repeat.
const TRIES: usize = 50;

impl Reader<'_> {
    /// Reads `[search]`; `None` if it is faulty.
    pub fn search(&mut self, node: &Node) -> Option<Search> {
        let written = self.table("search", node)?;
        let (title, span) = ("[search]", node.span().into());
        let table = self.known_keys(title, &names(&Search::keys()), written);
        let before = self.faults.len();
        let mut table =
            TableReader { reader: self, title, name: "", span, table: &table, needs: Vec::new() };
        let search = Search::read(&mut table);
        search.filter(|_| self.faults.len() == before)
    }

    /// Gives the drawn keys of every agent their values and the manifest its seeds, and reports what a search cannot
    /// have. `seeds` is the position of the key `seeds` of the document.
    pub fn drawn(&mut self, draft: &mut Draft, seeds: Option<Span>) {
        let is_of_search = draft.search.is_some() || draft.invalid_search;
        if !is_of_search {
            let draws = draft.agents.iter().flat_map(|agent| agent.settings.draws.values());
            for draw in draws {
                let fault = Fault::at(
                    draw.span,
                    "a draw needs a [search], which says how many values are drawn",
                );
                self.faults
                    .add(fault.help(
                        "write [search] with samples = 32, rungs = [2, 4, 8] and keep = 0.5",
                    ));
            }
            return;
        }
        if let Some(span) = seeds {
            let fault = Fault::at(
                span,
                "`seeds` does not stand beside [search], whose `rungs` and `fresh` give the seeds",
            );
            self.faults.add(fault.help("remove `seeds`"));
        }
        let Some(search) = draft.search.clone() else {
            // The seeds are declared, in a table that could not be read.
            draft
                .seeds
                .get_or_insert(Located { value: Vec::new(), span: Span { start: 0, end: 0 } });
            return;
        };
        self.shape(draft, &search);
        self.cells_of_race(draft);
        for agent in &mut draft.agents {
            // Agents without draws have none to set.
            let _ = self.draw_settings(agent, &search.value);
        }
        draft.seeds = Some(Located { value: search.value.seeds(), span: search.span });
    }

    /// Reports lists that do not go with a search.
    fn shape(&mut self, draft: &Draft, search: &Located<Search>) {
        // A draw that could not be read leaves its key without values.
        let has_all = |agent: &AgentDraft| {
            let mut given = agent.settings.given.values();
            agent.settings.draws.is_empty() && given.all(|values| !values.value.is_empty())
        };
        if draft.agents.iter().all(has_all) && !draft.invalid_agents() {
            let fault = Fault::at(search.span, "[search]: no agent draws a value");
            self.faults.add(
                fault.help("write learning_rate = { log_uniform = [1e-5, 1e-2] } in an [[agent]]"),
            );
        }
        for agent in &draft.agents {
            let swept = agent.settings.given.values().find(|values| values.value.len() > 1);
            let Some(swept) = swept else { continue };
            let (says, help) = match agent.settings.draws.is_empty() {
                true => (
                    "an agent without draws is what winners are compared with, and has one value per key",
                    "choose one value, or write { choices = […] }",
                ),
                false => (
                    "an agent with draws draws every key that varies",
                    "write { choices = […] } with these values",
                ),
            };
            let message = format!("agent `{}`: {says}", agent.name.value);
            self.faults.add(Fault::at(swept.span, message).help(help));
        }
    }

    /// Reports zips and exclusions of what a race decides, and removes them, so that no rule of the grid reports them
    /// again.
    fn cells_of_race(&mut self, draft: &mut Draft) {
        let drawn: HashSet<Parameter> = draft.agents.iter().flat_map(drawn_parameters).collect();
        let is_raced =
            |parameter: &Parameter| *parameter == Parameter::SEED || drawn.contains(parameter);
        let mut raced: Vec<(Span, Parameter)> = Vec::new();
        if let Some(zips) = &mut draft.zips {
            zips.retain(|zip| {
                let found = zip.value.iter().copied().find(is_raced);
                raced.extend(found.map(|parameter| (zip.span, parameter)));
                found.is_none()
            });
        }
        draft.exclusions.retain(|exclusion| {
            let conditions = exclusion.value.iter().map(|one| (one.span, one.value.parameter));
            let before = raced.len();
            raced.extend(conditions.filter(|(_, parameter)| is_raced(parameter)));
            raced.len() == before
        });
        draft.invalid_cells |= !raced.is_empty();
        for (span, parameter) in raced {
            let message = format!(
                "the race decides which arms have which seeds, and `{parameter}` is part of it"
            );
            let help =
                "zips and exclusions of a [search] name scenarios, agents and keys without draws";
            self.faults.add(Fault::at(span, message).help(help));
        }
    }

    /// Gives the drawn keys of an agent their values, at distinct points. Points that repeat earlier settings are
    /// left out, so that the first settings do not depend on the number of samples.
    fn draw_settings(&mut self, agent: &mut AgentDraft, search: &Search) -> Option<()> {
        let draws: Vec<(usize, Located<Draw>)> =
            agent.settings.draws.iter().map(|(index, draw)| (*index, draw.clone())).collect();
        let first = draws.first()?;
        let is_left = draws.len() as u64 * search.samples as u64 <= self.values_left;
        if !is_left {
            let message = "[search] draws more values than a manifest may have";
            self.faults.add(Fault::at(first.1.span, message).help("draw fewer `samples`"));
            return None;
        }
        self.values_left -= draws.len() as u64 * search.samples as u64;
        let mut known = HashSet::new();
        let all = points(search.seed, draws.len()).take(TRIES * search.samples);
        let settings = all.map(|point| -> Vec<Value> {
            draws.iter().zip(point).map(|((_, draw), u)| draw.value.at(u)).collect()
        });
        let distinct = settings.filter(|setting| known.insert(setting.clone()));
        let settings: Vec<Vec<Value>> = distinct.take(search.samples).collect();
        if settings.len() < search.samples {
            let message = format!(
                "agent `{}`: its draws have about {} different settings, fewer than {} `samples`",
                agent.name.value,
                settings.len(),
                search.samples
            );
            self.faults.add(
                Fault::at(first.1.span, message).help("draw fewer samples, or from more values"),
            );
            return None;
        }
        for (column, (index, draw)) in draws.iter().enumerate() {
            let value = settings.iter().map(|setting| setting[column].clone()).collect();
            agent.settings.given.insert(*index, Located { value, span: draw.span });
        }
        Some(())
    }
}

/// The parameters that an agent draws.
fn drawn_parameters(agent: &AgentDraft) -> Vec<Parameter> {
    let section = agent.settings.section;
    let name = |index: &usize| section.parameter(section.keys()[*index].name);
    agent.settings.draws.keys().map(name).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::manifest::parse;
    use crate::manifest::{Leaving, Manifest};

    fn text(samples: usize, search: &str, draws: &str) -> String {
        format!(
            "format = 1\nname = \"t\"\nscenarios = [\"P-H-D\"]\nenvironment.sigma = 0.6\n[search]\nsamples = {samples}\n\
             {search}\n[[agent]]\nname = \"a\"\nalgorithm = \"dueling_dqn\"\n{draws}\n"
        )
    }

    const HALF: &str = "rungs = [1, 2]\nkeep = 0.5";
    const DRAWS: &str = "learning_rate = { log_uniform = [1e-5, 1e-2] }\nlayers = { choices = [[32], [64, 64]] }\n\
                         batch = { integers = [8, 64] }\ngamma = { uniform = [0.9, 0.999] }";

    fn manifest(samples: usize, draws: &str) -> Manifest {
        parse("t", text(samples, HALF, draws).as_bytes()).unwrap()
    }

    fn drawn(manifest: &Manifest, key: &str) -> Vec<Value> {
        manifest.agents[0].parameters.get(key).unwrap().to_vec()
    }

    #[test]
    fn more_samples_keep_the_earlier_ones() {
        let [few, many] = [8, 20].map(|samples| manifest(samples, DRAWS));
        for key in ["learning_rate", "layers", "batch", "gamma"] {
            assert_eq!(drawn(&few, key), drawn(&many, key)[..8], "{key}");
        }
        // Where draws repeat, too: 6 of the 8 pairs.
        let choices = "layers = { choices = [[32], [64]] }\nbatch = { integers = [8, 11] }";
        let [few, many] = [6, 8].map(|samples| manifest(samples, choices));
        assert_eq!(drawn(&few, "batch"), drawn(&many, "batch")[..6]);
        let pairs: HashSet<(Value, Value)> =
            drawn(&many, "layers").into_iter().zip(drawn(&many, "batch")).collect();
        assert_eq!(pairs.len(), 8);
    }

    #[test]
    fn a_resolved_search_declares_the_same_arms() {
        let written = manifest(8, DRAWS);
        let resolved = parse("resolved", written.resolved().as_bytes()).unwrap();
        assert_eq!(resolved.search, written.search);
        assert_eq!(resolved.agents, written.agents);
        assert!(resolved.seeds().eq(1..=12));
    }

    #[test]
    fn a_preset_s_seeds_and_values_give_way_to_a_search() {
        let text = "format = 1\nname = \"t\"\nextends = \"paper\"\nscenarios = [\"P-H-D\"]\nenvironment.sigma = 0.6\n\
                    [search]\nsamples = 4\nrungs = [2]\nlevel = 0.05\nfresh = [11, 12]\n\
                    [[agent]]\nname = \"dqn\"\nlearning_rate = { log_uniform = [1e-4, 1e-3] }\n";
        let manifest = parse("t", text.as_bytes()).unwrap();
        assert!(manifest.seeds().eq([1, 2, 11, 12]));
        assert_eq!(drawn(&manifest, "learning_rate").len(), 4);
        assert_eq!(manifest.search.map(|search| search.leaving), Some(Leaving::Evidence(0.05)));
    }

    #[test]
    fn seeds_have_their_rungs_and_fresh_seeds_come_last() {
        let manifest =
            parse("t", text(2, "rungs = [2, 5]\nkeep = 0.5\nfresh = 3", DRAWS).as_bytes());
        let search = manifest.unwrap().search.unwrap();
        let rungs: Vec<usize> = (1..=8).map(|seed| search.rung_of(seed)).collect();
        assert_eq!(rungs, [0, 0, 1, 1, 1, 2, 2, 2]);
    }
}
