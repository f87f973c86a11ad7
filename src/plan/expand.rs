//! The jobs of one agent, cell by cell of its grid.

use std::sync::Arc;

use crate::job::{Job, PlannedJob};
use crate::key::{PerSection, SectionName};
use crate::manifest::{Cell, Grid, Manifest, Stage};

/// The jobs of the agent at this index of the manifest's list, up to a stage of its race, in the order of the cells of
/// its grid.
pub(super) fn of_agent(
    manifest: &Manifest,
    agent: usize,
    stage: Option<Arc<Stage>>,
) -> impl Iterator<Item = PlannedJob> + use<'_> {
    let grid = Grid::at(manifest, agent, stage);
    let name = Arc::from(manifest.agents[agent].name.as_str());
    AgentJobs { next: grid.first(), typed: None, grid, name }
}

/// The remaining jobs of one agent.
struct AgentJobs<'m> {
    grid: Grid<'m>,
    name: Arc<str>,
    next: Option<Cell>,
    typed: Option<Typed>,
}

/// The job of a cell with the texts of its sections, kept because neighbouring cells share most of them.
struct Typed {
    cell: Cell,
    job: Job,
    texts: PerSection<String>,
}

impl Typed {
    fn of(grid: &Grid, cell: &Cell) -> Typed {
        let job = grid.job(cell);
        Typed { texts: PerSection::of(|section| job.text_of(section)), job, cell: cell.clone() }
    }

    /// Moves to another cell, and keeps the sections that both cells share.
    fn move_to(&mut self, grid: &Grid, cell: &Cell) {
        for section in SectionName::ALL {
            if !grid.agree(section, &self.cell, cell) {
                grid.set_section(&mut self.job, section, cell);
                self.texts[section] = self.job.text_of(section);
            }
        }
        self.job.scenario = grid.scenario(cell);
        self.job.seed = grid.seed(cell);
        self.cell.clone_from(cell);
    }
}

impl Iterator for AgentJobs<'_> {
    type Item = PlannedJob;

    fn next(&mut self) -> Option<PlannedJob> {
        let cell = self.next.take()?;
        self.next = self.grid.after(&cell);
        let typed = self.typed.get_or_insert_with(|| Typed::of(&self.grid, &cell));
        typed.move_to(&self.grid, &cell);
        let (job, form) = (typed.job.clone(), typed.job.form_of(&typed.texts));
        Some(PlannedJob { agent: self.name.clone(), job, form })
    }
}

#[cfg(test)]
mod tests {
    use crate::agent::{Agent, DuelingDqn, Reinforce, Trunk};
    use crate::env::StepCount;
    use crate::job::{Job, JobKey, PlannedJob};
    use crate::key::Keyed;
    use crate::manifest::{Manifest, parse};
    use crate::plan::{count, expand, jobs};

    fn manifest(text: &str) -> Manifest {
        parse("test", text.as_bytes()).unwrap()
    }

    fn keys(text: &str) -> Vec<JobKey> {
        let mut keys: Vec<JobKey> =
            jobs(&manifest(text)).map(|planned| planned.job.key()).collect();
        keys.sort();
        keys
    }

    fn with(top: &str, environment: &str, rest: &str) -> String {
        format!(
            "format = 1\nname = \"t\"\n{top}\n[environment]\n{environment}\n[[agent]]\nname = \"a\"\n\
             algorithm = \"reinforce\"\n{rest}"
        )
    }

    fn column<T>(text: &str, value: impl Fn(&Job) -> T) -> Vec<T> {
        let jobs = expand(&manifest(text));
        assert_eq!(jobs.len() as u64, count(&manifest(text)));
        jobs.iter().map(|planned| value(&planned.job)).collect()
    }

    #[test]
    fn jobs_come_agent_by_agent_then_scenario_then_keys_then_seed() {
        let text = with(
            "scenarios = [\"P-T\", \"C\"]\nseeds = [7, 5]",
            "horizon = [10, 20]\nsigma = [1, 0]",
            "[[agent]]\nname = \"b\"\nalgorithm = \"dueling_dqn\"\n",
        );
        let rows: Vec<String> = jobs(&manifest(&text))
            .map(|PlannedJob { agent, job, .. }| {
                let StepCount { sigma, horizon, .. } = job.task().model().parameters;
                format!("{agent} {} {sigma} {horizon} {}", job.scenario, job.seed)
            })
            .collect();
        assert_eq!(rows.len(), 32);
        let first =
            ["a P-T 1 10 7", "a P-T 1 10 5", "a P-T 1 20 7", "a P-T 1 20 5", "a P-T 0 10 7"];
        assert_eq!(rows[..5], first);
        assert_eq!((rows[8].as_str(), rows[16].as_str()), ("a C 1 10 7", "b P-T 1 10 7"));
    }

    #[test]
    fn zipped_parameters_advance_together() {
        let text = with(
            "scenarios = [\"P-T\"]\nseeds = [1, 2]\nzip = [[\"environment.delta_d\", \"agent.gamma\"]]",
            "sigma = 0\ndelta_d = [0.1, 0.2, 0.3]",
            "gamma = [0.7, 0.8, 0.9]",
        );
        let gamma = |job: &Job| job.agent.parameters::<Reinforce>().unwrap().gamma;
        let pairs =
            column(&text, |job| (job.task().model().parameters.delta_d, gamma(job), job.seed));
        let expected = [
            (0.1, 0.7, 1),
            (0.1, 0.7, 2),
            (0.2, 0.8, 1),
            (0.2, 0.8, 2),
            (0.3, 0.9, 1),
            (0.3, 0.9, 2),
        ];
        assert_eq!(pairs, expected);
    }

    #[test]
    fn scenarios_and_seeds_can_be_zipped() {
        let text = with(
            "scenarios = [\"P-T\", \"L-T\"]\nseeds = [4, 9]\nzip = [[\"scenario\", \"seed\"]]",
            "sigma = 0",
            "",
        );
        let pairs = column(&text, |job| format!("{} {}", job.scenario, job.seed));
        assert_eq!(pairs, ["P-T 4", "L-T 9"]);
    }

    #[test]
    fn a_zip_of_agent_keys_leaves_agents_alone_that_do_not_sweep_all_of_them() {
        let text = with(
            "scenarios = [\"P-T\"]\nseeds = 1\nzip = [[\"agent.gamma\", \"agent.learning_rate\"]]",
            "sigma = 0",
            "gamma = [0.8, 0.9]\nlearning_rate = [1e-3, 1e-4]\n[[agent]]\nname = \"b\"\n\
             algorithm = \"reinforce\"\ngamma = [0.8, 0.9]",
        );
        let agents: Vec<_> =
            jobs(&manifest(&text)).map(|planned| planned.agent.to_string()).collect();
        assert_eq!(agents, ["a", "a", "b", "b"]);
    }

    #[test]
    fn a_cell_is_left_out_when_it_meets_every_condition_of_an_exclusion() {
        let text = with(
            "scenarios = [\"P-T\", \"L-T\"]\nseeds = 2",
            "sigma = [0, 1, 2]",
            "[[exclude]]\nscenario = \"P-T\"\nenvironment.sigma = [0, 2]\n\
             [[exclude]]\nseed = 2\nscenario = \"L-T\"\nagent.name = \"a\"\nagent.gamma = 0.99",
        );
        let left = column(&text, |job| {
            format!("{} {} {}", job.scenario, job.task().model().parameters.sigma, job.seed)
        });
        assert_eq!(left, ["P-T 1 1", "P-T 1 2", "L-T 0 1", "L-T 1 1", "L-T 2 1"]);
    }

    #[test]
    fn a_rule_between_keys_holds_for_the_cells_that_are_left() {
        let text = with(
            "scenarios = [\"P-T\"]\nseeds = 1",
            "sigma = 0",
            "episodes = [100, 90]\ntrajectories_per_update = [10, 30]\n\
             [[exclude]]\nagent.episodes = 100\nagent.trajectories_per_update = 30",
        );
        assert_eq!(column(&text, |job| job.agent.episodes()), [100, 90, 90]);
    }

    #[test]
    fn order_comments_names_and_prose_make_no_other_jobs() {
        let one = "format = 1\nname = \"one\"\nquestion = \"?\"\nscenarios = [\"P-T\", \"L-T\"]\n\
                   seeds = 2\n[environment]\nsigma = [0.4, 0.6]\ndelta_d = 0.2\n\
                   [[agent]]\nname = \"x\"\nalgorithm = \"dueling_dqn\"\nbatch = 32\n\
                   [[agent]]\nname = \"y\"\nalgorithm = \"reinforce\"\n";
        let other = "agent = [{ algorithm = \"reinforce\", name = \"z\", gamma = 0.99 }, \
                     { batch = 0x20, name = \"w\", algorithm = \"dueling_dqn\" }]\n\
                     environment.delta_d = 2e-1 # as text\n\
                     environment.sigma = { from = 0.4, to = 0.6, count = 2 }\n\
                     seeds = [2, 1]\nscenarios = [\"L-T\", \"P-T\"]\nname = \"<script>\"\nformat = 1\n";
        assert_eq!(keys(one), keys(other));
    }

    #[test]
    fn every_planned_job_has_its_own_canonical_form() {
        let text = with(
            "scenarios = [\"P-T\", \"C\"]\nseeds = 2",
            "sigma = [0, 1]",
            "gamma = [0.5, 0.9]\n[[agent]]\nname = \"b\"\nalgorithm = \"dueling_dqn\"\n\
             [evaluation]\ntest_actions = [\"greedy\", \"as_trained\"]",
        );
        for planned in jobs(&manifest(&text)) {
            assert_eq!(planned.form, planned.job.form());
        }
    }

    #[test]
    fn a_manifest_overrides_its_preset_key_by_key() {
        let text = "format = 1\nname = \"t\"\nextends = \"paper_text\"\nscenarios = [\"P-T\"]\n\
                    seeds = [9]\n[environment]\nsigma = 1\ntime_indicator = \"lagged\"\n\
                    [[agent]]\nname = \"dqn\"\nbatch = 16\n[[agent]]\nname = \"own\"\n\
                    algorithm = \"dueling_dqn\"";
        let jobs = expand(&manifest(text));
        let names: Vec<&str> = jobs.iter().map(|planned| &*planned.agent).collect();
        assert_eq!(names, ["dqn", "reinforce", "own"]);
        let environment = jobs[0].job.task().model().parameters.to_json();
        assert_eq!(environment["first_context"], "sampled");
        assert_eq!(environment["time_indicator"], "lagged");
        let agent: DuelingDqn = jobs[0].job.agent.parameters().unwrap();
        assert_eq!((agent.batch, agent.trunk), (16, Trunk::Separate));
        assert_eq!(jobs[1].job.agent.episodes(), 750_000);
        assert_eq!(jobs[2].job.agent, Agent::of(&DuelingDqn::default()));
        assert_eq!(jobs[0].job.seed, 9);
    }

    #[test]
    fn agents_of_equal_content_share_their_jobs() {
        let text = with(
            "scenarios = [\"P-T\"]\nseeds = 1",
            "sigma = 0",
            "[[agent]]\nname = \"b\"\nalgorithm = \"reinforce\"\nlayers = [128]",
        );
        let [one, other] = keys(&text)[..] else { panic!("two agents, two jobs") };
        assert_eq!(one, other);
    }

    #[test]
    fn a_million_jobs_are_expanded_one_at_a_time() {
        let text = with(
            "scenarios = [\"P-T\"]\nseeds = 1000",
            "sigma = { from = 0.001, to = 1.0, step = 0.001 }",
            "[[exclude]]\nseed = 1\nenvironment.sigma = 0.5",
        );
        let manifest = manifest(&text);
        assert_eq!(count(&manifest), 999_999);
        assert_eq!(jobs(&manifest).nth(200_000).map(|planned| planned.job.seed), Some(1));
    }
}
