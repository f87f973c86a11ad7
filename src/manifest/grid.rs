//! The grid of one agent: its axes, its cells, and which cells are left out.
//!
//! In: a manifest and one of its agents. Out: the number of cells, and each cell as indices that determine
//! the typed parameters. Everything is computed from indices, so that a grid of millions is counted without
//! being built. It does not depend on jobs and their identity.

use std::borrow::Cow;
use std::collections::HashSet;
use std::sync::Arc;

use crate::agent::HORIZON;
use crate::env::{Environment, Scenario};
use crate::job::{Job, Trial};
use crate::key::{
    Assignment, Constraint, Key, Keyed, Parameter, PerSection, SectionName, Value, Violation,
};
use crate::manifest::declared::{DeclaredAgent, Exclusion, Manifest};
use crate::manifest::parameter::{Parameters, scenario_of, seed_of};
use crate::manifest::search::stage::{RaceCells, Stage};

/// The number of observations that an agent sees at a time.
const HISTORY: Parameter = Parameter::Agent("history");

/// The grid of one agent of a manifest.
#[derive(Debug)]
pub struct Grid<'m> {
    manifest: &'m Manifest,
    agent: &'m DeclaredAgent,
    axes: Vec<Axis>,
    exclusions: Vec<Vec<Mask>>,
    /// The axis of each key of a section; `None` for a key with one value.
    axes_of: PerSection<Vec<Option<usize>>>,
    /// `None` unless the manifest is a search.
    race: Option<RaceCells>,
}

/// Parameters that advance together, and how many values each has.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Axis {
    /// One parameter, or the parameters of a zip.
    pub parameters: Vec<Parameter>,
    /// The number of values.
    pub length: usize,
}

/// The positions on an axis that meet an exclusion's conditions on this axis.
#[derive(Debug)]
struct Mask {
    axis: usize,
    met: Vec<bool>,
}

/// A cell of a grid: one position on each axis.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cell(Vec<usize>);

impl<'m> Grid<'m> {
    /// The grid of the agent at this index of the manifest's list, with all cells that its race may come to.
    pub fn of(manifest: &'m Manifest, agent: usize) -> Grid<'m> {
        Grid::at(manifest, agent, None)
    }

    /// The grid of the agent at this index, with the cells that its race has come to; `None` for all that it may come
    /// to.
    pub fn at(manifest: &'m Manifest, agent: usize, stage: Option<Arc<Stage>>) -> Grid<'m> {
        let agent = &manifest.agents[agent];
        let axes = axes(manifest, agent);
        let axes_of_keys = |parameters: &Parameters| -> Vec<Option<usize>> {
            let section = parameters.section();
            let axis = |name| axis_of(&axes, section.parameter(name));
            section.keys().iter().map(|key| axis(key.name)).collect()
        };
        let masks = |exclusion| masks(manifest, agent, &axes, exclusion);
        Grid {
            axes_of: PerSection::of(|section| axes_of_keys(manifest.parameters(agent, section))),
            exclusions: manifest.exclusions.iter().filter_map(masks).collect(),
            race: race_cells(manifest, agent, (&axes, stage)),
            manifest,
            agent,
            axes,
        }
    }

    /// The number of cells that are not excluded.
    pub fn count(&self) -> u64 {
        let concerned = self.concerned(&[]);
        let free = self.axes.iter().zip(&concerned).filter(|(_, concerned)| !**concerned);
        let each: u64 = free.map(|(axis, _)| axis.length as u64).product();
        self.projected(&concerned).count() as u64 * each
    }

    /// The parameters of each axis, slowest first, with the length of the axis.
    pub fn factors(&self) -> impl Iterator<Item = (&[Parameter], usize)> {
        self.axes.iter().map(|axis| (axis.parameters.as_slice(), axis.length))
    }

    /// The first violation of a constraint by a cell that is not excluded, with the cell's values of the
    /// constraint's parameters.
    pub(super) fn violation(&self, constraint: &Constraint) -> Option<(Assignment<'m>, Violation)> {
        let family = self.manifest.family();
        let has_horizon = family.keys.iter().any(|key| Parameter::Environment(key.name) == HORIZON);
        if has_horizon || family.is_external() || !constraint.parameters.contains(&HORIZON) {
            let violation = |assignment: &Assignment<'m>| (constraint.violation)(assignment);
            return self.find(constraint.parameters, |_| true, violation);
        }
        // Where the horizon is no key, it is the longest episode of the environment.
        let of_environment = family.keys.iter().map(|key| Parameter::Environment(key.name));
        let others = of_environment.filter(|key| !constraint.parameters.contains(key));
        let parameters: Vec<Parameter> =
            constraint.parameters.iter().copied().chain(others).collect();
        let people: Vec<Value> = family.people.iter().filter_map(Key::default).collect();
        let violation = |assignment: &Assignment<'m>| {
            let of_environment = |one: &Parameter| matches!(one, Parameter::Environment(_));
            let values = assignment.values_of(of_environment);
            let longest = (family.read)(family, &values, &people)?.longest_episode();
            let mut with_horizon = assignment.clone();
            with_horizon.0.push((HORIZON, Cow::Owned(Value::Integer(longest.into()))));
            (constraint.violation)(&with_horizon)
        };
        self.find(&parameters, |_| true, violation)
    }

    /// The sizes above their limits in the first cell that has any and is not excluded, each with the keys
    /// that add to it.
    pub(super) fn too_large(&self) -> Vec<(Assignment<'m>, Violation)> {
        let (algorithm, family) = (self.agent.algorithm, self.manifest.family());
        let too_large = |assignment: &Assignment<'m>| {
            Some(algorithm.too_large(family, assignment)).filter(|sizes| !sizes.is_empty())
        };
        let varies = |parameter| algorithm.is_sized_by(family, parameter);
        let found = self.find(&algorithm.parameters(family), varies, too_large);
        let sizes = found.map_or_else(Vec::new, |(_, sizes)| sizes);
        sizes.into_iter().map(|(size, keys)| (keys, Violation::TooLarge(size))).collect()
    }

    /// The first key of a cell that is not excluded that does not suit the environment.
    pub(super) fn unsuited(&self) -> Option<(Assignment<'m>, Violation)> {
        let (algorithm, family) = (self.agent.algorithm, self.manifest.family());
        if algorithm.suited().is_empty() {
            return None;
        }
        let unsuited = |assignment: &Assignment<'m>| algorithm.unsuited(family, assignment);
        let varies = |parameter| algorithm.is_suited_by(family, parameter);
        let (mut cell, found) = self.find(&algorithm.parameters(family), varies, unsuited)?;
        cell.0.retain(|(parameter, _)| *parameter == found.key);
        Some((cell, Violation::Contradiction(found.to_string())))
    }

    /// Why the trial of a cell that is not excluded does not suit itself, its seeds or its environment, with the key at
    /// fault.
    pub(super) fn trial_fault(&self) -> Option<(Parameter, String)> {
        let family = self.manifest.family();
        let of_environment = family.keys.iter().map(|key| Parameter::Environment(key.name));
        let of_trial = Trial::KEYS.iter().map(|key| Parameter::Trial(key.name));
        let parameters: Vec<Parameter> = of_environment.chain(of_trial).chain([HISTORY]).collect();
        let seeds: Vec<u64> = self.manifest.seeds().collect();
        let judge = |assignment: &Assignment<'m>| {
            let trial: Trial = assignment.keyed(|one| matches!(one, Parameter::Trial(_)))?;
            if trial.unreported > 0.0 && assignment.whole(HISTORY) > 1 {
                let says = format!(
                    "`unreported` = {} hides observations, and agent `{}` with `history` = {} would see them at the next \
                     report; write history = 1",
                    trial.unreported,
                    self.agent.name,
                    assignment.whole(HISTORY)
                );
                return Some((Parameter::Trial("unreported"), says));
            }
            let of_environment = |one: &Parameter| matches!(one, Parameter::Environment(_));
            let people: Vec<Value> = family.people.iter().filter_map(Key::default).collect();
            let environment =
                (family.read)(family, &assignment.values_of(of_environment), &people)?;
            trial_fault(&trial, &environment, &seeds)
        };
        self.find(&parameters, |_| true, judge).map(|(_, fault)| fault)
    }

    /// The first result of `judge` in a cell that is not excluded, with the cell's values of `parameters`.
    /// Parameters that do not vary have their first values.
    fn find<T>(
        &self,
        parameters: &[Parameter],
        varies: impl Fn(Parameter) -> bool,
        judge: impl Fn(&Assignment<'m>) -> Option<T>,
    ) -> Option<(Assignment<'m>, T)> {
        let varying = parameters.iter().filter(|name| varies(**name));
        let axes: HashSet<usize> = varying.filter_map(|name| axis_of(&self.axes, *name)).collect();
        let concerned = self.concerned(&axes.iter().copied().map(Some).collect::<Vec<_>>());
        // Cells that differ only on the axes of exclusions have the same values.
        let differ = concerned.iter().filter(|concerned| **concerned).count() == axes.len();
        let mut judged: HashSet<Vec<usize>> = HashSet::new();
        let positions = |cell: &Cell| axes.iter().map(|axis| cell.0[*axis]).collect();
        let cells = self.projected(&concerned);
        let mut cells = cells.filter(|cell| differ || judged.insert(positions(cell)));
        cells.find_map(|cell| {
            let valued = |name: &Parameter| {
                let values = self.manifest.values(self.agent, *name)?;
                Some((*name, Cow::Borrowed(values.get(self.position(&cell, *name))?)))
            };
            let assignment = Assignment(parameters.iter().filter_map(valued).collect());
            judge(&assignment).map(|found| (assignment, found))
        })
    }

    /// The environments of the cells that are not excluded, each once.
    pub(super) fn environments(&self) -> impl Iterator<Item = Environment> + use<'_, 'm> {
        let of_section = |section| self.axes_of[section].iter().copied();
        let of_people = of_section(SectionName::Population);
        let axes: Vec<_> = of_section(SectionName::Environment).chain(of_people).collect();
        let cells = self.projected(&self.concerned(&axes));
        cells.map(|cell| self.environment(&cell))
    }

    /// Whether the parameter has several values.
    pub(super) fn is_swept(&self, parameter: Parameter) -> bool {
        self.manifest.length(self.agent, parameter) > 1
    }

    /// Whether any cell meets every condition of the exclusion.
    pub(super) fn meets(&self, exclusion: &Exclusion) -> bool {
        let masks = masks(self.manifest, self.agent, &self.axes, exclusion);
        masks.is_some_and(|masks| masks.iter().all(|mask| mask.met.contains(&true)))
    }

    /// Whether each axis occurs in an exclusion or in `others`.
    fn concerned(&self, others: &[Option<usize>]) -> Vec<bool> {
        let mut concerned = vec![false; self.axes.len()];
        for mask in self.exclusions.iter().flatten() {
            concerned[mask.axis] = true;
        }
        for axis in others.iter().flatten() {
            concerned[*axis] = true;
        }
        for axis in self.race.iter().flat_map(RaceCells::divided) {
            concerned[axis] = true;
        }
        concerned
    }

    /// The cells that are not excluded, with the first position on every axis that is not concerned.
    fn projected(&self, concerned: &[bool]) -> impl Iterator<Item = Cell> + use<'_, 'm> {
        let length = |(axis, concerned): (&Axis, &bool)| if *concerned { axis.length } else { 1 };
        let lengths: Vec<usize> = self.axes.iter().zip(concerned).map(length).collect();
        let first = Cell(vec![0; lengths.len()]);
        let all = std::iter::successors(Some(first), move |cell| next(cell, &lengths));
        all.filter(|cell| !self.excludes(cell))
    }

    fn excludes(&self, cell: &Cell) -> bool {
        let met = |masks: &Vec<Mask>| masks.iter().all(|mask| mask.met[cell.0[mask.axis]]);
        self.exclusions.iter().any(met) || self.race.as_ref().is_some_and(|race| !race.has(&cell.0))
    }

    /// The first cell that is not excluded.
    pub fn first(&self) -> Option<Cell> {
        let first = Cell(vec![0; self.axes.len()]);
        if self.excludes(&first) { self.after(&first) } else { Some(first) }
    }

    /// The next cell that is not excluded, the last axis advancing fastest.
    pub fn after(&self, cell: &Cell) -> Option<Cell> {
        let lengths: Vec<usize> = self.axes.iter().map(|axis| axis.length).collect();
        let mut cells = std::iter::successors(next(cell, &lengths), |cell| next(cell, &lengths));
        cells.find(|cell| !self.excludes(cell))
    }

    /// Whether two cells have equal values for every key of this section.
    pub fn agree(&self, section: SectionName, one: &Cell, other: &Cell) -> bool {
        self.axes_of[section].iter().flatten().all(|axis| one.0[*axis] == other.0[*axis])
    }

    /// The cell's arm in the race of its agent, and its index among the seeds of the manifest; `None` unless the
    /// manifest is a search. An agent without draws has arm 0 alone.
    pub fn entrant(&self, cell: &Cell) -> Option<(usize, usize)> {
        let race = self.race.as_ref()?;
        Some((race.arms.map_or(0, |axis| cell.0[axis]), cell.0[race.seeds]))
    }

    /// The cell's scenario.
    pub fn scenario(&self, cell: &Cell) -> Scenario {
        scenario_of(&self.manifest.scenarios[self.position(cell, Parameter::SCENARIO)])
    }

    /// The cell's seed.
    pub fn seed(&self, cell: &Cell) -> u64 {
        seed_of(&self.manifest.seeds[self.position(cell, Parameter::SEED)])
    }

    fn position(&self, cell: &Cell, parameter: Parameter) -> usize {
        axis_of(&self.axes, parameter).map_or(0, |axis| cell.0[axis])
    }

    /// The cell's environment, with its participants.
    pub fn environment(&self, cell: &Cell) -> Environment {
        let values = self.chosen(SectionName::Environment, cell);
        let people = self.chosen(SectionName::Population, cell);
        let family = self.manifest.family();
        (family.read)(family, &values, &people).expect(TYPED)
    }

    /// The cell's values of the keys of a section.
    fn chosen(&self, section: SectionName, cell: &Cell) -> Vec<Value> {
        let axes = &self.axes_of[section];
        let parameters = self.manifest.parameters(self.agent, section);
        parameters.chosen(|key| axes[key].map_or(0, |axis| cell.0[axis]))
    }

    /// Sets a section of a job to the cell's values.
    pub fn set_section(&self, job: &mut Job, section: SectionName, cell: &Cell) {
        job.set_section(section, &|section| self.chosen(section, cell)).expect(TYPED);
    }

    /// The agent's name.
    pub(super) fn agent_name(&self) -> &'m str {
        &self.agent.name
    }

    /// The cell's job.
    pub fn job(&self, cell: &Cell) -> Job {
        let of = (self.manifest.family(), self.agent.algorithm);
        let alone = (self.scenario(cell), self.seed(cell));
        Job::of_values(of, alone, &|section| self.chosen(section, cell)).expect(TYPED)
    }
}

/// Why the values of a manifest convert to the structs of its sections.
const TYPED: &str = "a manifest's values are of the kinds of their keys";

fn axis_of(axes: &[Axis], parameter: Parameter) -> Option<usize> {
    axes.iter().position(|axis| axis.parameters.contains(&parameter))
}

/// The axes of an agent's race; `None` unless the manifest is a search.
fn race_cells(
    manifest: &Manifest,
    agent: &DeclaredAgent,
    (axes, stage): (&[Axis], Option<Arc<Stage>>),
) -> Option<RaceCells> {
    let raced = manifest.search.as_ref()?.race_seeds();
    let arms = agent.draws.first().and_then(|(parameter, _)| axis_of(axes, *parameter));
    Some(RaceCells { arms, seeds: axis_of(axes, Parameter::SEED)?, raced, stage })
}

/// The next cell, the last axis advancing fastest; `None` after the last.
fn next(cell: &Cell, lengths: &[usize]) -> Option<Cell> {
    let mut positions = cell.0.clone();
    for (position, length) in positions.iter_mut().zip(lengths).rev() {
        *position += 1;
        if *position < *length {
            return Some(Cell(positions));
        }
        *position = 0;
    }
    None
}

/// Whether a zip of these parameters applies to `agent`, which must sweep every agent key among them.
pub(super) fn zipped(manifest: &Manifest, agent: &DeclaredAgent, parameters: &[Parameter]) -> bool {
    let of_agents = parameters.iter().filter(|one| matches!(one, Parameter::Agent(_)));
    of_agents.copied().all(|parameter| manifest.length(agent, parameter) > 1)
}

/// The number of cells on these axes, including excluded ones; saturates at `u128::MAX`.
pub(super) fn size(axes: &[Axis]) -> u128 {
    axes.iter().fold(1, |size, axis| size.saturating_mul(axis.length as u128))
}

/// The axes of an agent's grid, slowest first: scenario, swept keys in the order of the tables, seed. A zip, or the
/// keys that a search draws together, stand where their first parameter does.
pub(super) fn axes(manifest: &Manifest, agent: &DeclaredAgent) -> Vec<Axis> {
    let zips = manifest.zips.iter().map(|zip| &zip.parameters);
    let drawn: Vec<Parameter> = agent.draws.iter().map(|(parameter, _)| *parameter).collect();
    let zips = zips.filter(|zip| zipped(manifest, agent, zip));
    let zips: Vec<_> = zips.chain((!drawn.is_empty()).then_some(&drawn)).collect();
    let keys = manifest.swept_keys(agent);
    let order = std::iter::once(Parameter::SCENARIO).chain(keys);
    let mut axes: Vec<Axis> = Vec::new();
    for parameter in order.chain(std::iter::once(Parameter::SEED)) {
        if axis_of(&axes, parameter).is_none() {
            let zip = zips.iter().find(|zip| zip.contains(&parameter));
            let parameters = zip.map_or_else(|| vec![parameter], |zip| zip.to_vec());
            let length = manifest.length(agent, parameter);
            axes.push(Axis { parameters, length });
        }
    }
    axes
}

/// The exclusion as masks, one per axis; `None` if none of the agent's cells can meet it.
///
/// [`crate::job::Condition::is_met_by`] evaluates the same conditions on a job, and compares lists of values for each
/// job. Here, each value of an axis is compared once, so that a grid of millions is counted from masks.
fn masks(
    manifest: &Manifest,
    agent: &DeclaredAgent,
    axes: &[Axis],
    exclusion: &Exclusion,
) -> Option<Vec<Mask>> {
    let mut masks: Vec<Mask> = Vec::new();
    for condition in &exclusion.conditions {
        let parameter = condition.parameter;
        let met = members(manifest.values(agent, parameter)?, &condition.values);
        let Some(axis) = axis_of(axes, parameter) else {
            // A parameter that is not swept has one value: it meets the condition in every cell or in none.
            if met == [true] { continue } else { return None }
        };
        match masks.iter_mut().find(|mask| mask.axis == axis) {
            Some(mask) => mask.met.iter_mut().zip(met).for_each(|(both, met)| *both &= met),
            None => masks.push(Mask { axis, met }),
        }
    }
    Some(masks)
}

/// Why a trial does not suit itself, these seeds or an environment, with the key at fault.
fn trial_fault(
    trial: &Trial,
    environment: &Environment,
    seeds: &[u64],
) -> Option<(Parameter, String)> {
    let fault = |key, says| Some((Parameter::Trial(key), says));
    let by_keys = [trial.entry_every_days, trial.entry_first_day, trial.entry_people - 1];
    if !trial.entry.is_none() && by_keys.iter().any(|key| *key > 0) {
        let says =
            "`entry` names the day of every person, and keys `entry_*` are not read beside it";
        return fault("entry", says.to_owned());
    }
    let calendar = match trial.calendar() {
        Ok(calendar) => calendar,
        Err(says) => return fault("entry", format!("`entry`: {says}")),
    };
    if trial.update_first_with_people > trial.people {
        let (first, people) = (trial.update_first_with_people, trial.people);
        let says = format!(
            "`update_first_with_people` = {first} is never reached with `people` = {people}, so that the agent never \
             learns"
        );
        return fault("update_first_with_people", says);
    }
    if let Some(says) = trial.never_learns(&calendar) {
        let says = format!("`update_every_days` = {}: {says}", trial.update_every_days);
        return fault(
            "update_every_days",
            says + ", so that the agent never learns; 0 is for no updates",
        );
    }
    let longest = u64::from(environment.longest_episode());
    // The length of an episode in a program or a faulty model is not known.
    let is_known =
        environment.family().with_parameters.is_none() || environment.description().is_some();
    if let Some(per_day) =
        environment.decisions_per_day().filter(|own| *own != trial.decisions_per_day)
    {
        let says = format!(
            "`decisions_per_day` = {}: the model has {per_day} decisions a day",
            trial.decisions_per_day
        );
        return fault("decisions_per_day", says);
    }
    if is_known && trial.decisions() != longest {
        let (days, per_day) = (trial.days, trial.decisions_per_day);
        let says = format!(
            "`days` = {days} with `decisions_per_day` = {per_day} are {} decisions of a person; an episode of the \
             environment has {longest}: change `days`, or the key of [environment] that sets the length of an episode",
            trial.decisions()
        );
        return fault("days", says);
    }
    let says = people_fault(trial, environment, seeds)?;
    fault("people_file", format!("`people_file`: {says}"))
}

/// Why the rows of a trial's people do not suit these seeds or an environment.
fn people_fault(trial: &Trial, environment: &Environment, seeds: &[u64]) -> Option<String> {
    for seed in seeds {
        let rows = match trial.rows(*seed) {
            Ok(None) => return None,
            Ok(Some(rows)) => rows,
            Err(says) => return Some(says),
        };
        let Some(people) = environment.people_to_draw() else {
            return Some("the environment draws its people from no file".to_owned());
        };
        if let Some(row) = rows.iter().find(|row| **row as usize >= people) {
            let last = people - 1;
            return Some(format!(
                "seed {seed} has row {row}; the file of people has rows 0 to {last}"
            ));
        }
    }
    None
}

fn members(values: &[Value], list: &[Value]) -> Vec<bool> {
    let list: HashSet<&Value> = list.iter().collect();
    values.iter().map(|value| list.contains(value)).collect()
}
