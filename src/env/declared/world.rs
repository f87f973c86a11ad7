//! The simulation of a model: one person per lane.

use std::io;
use std::ops::Range;
use std::sync::{Arc, OnceLock};

use crate::env::declared::columns::{FewLanes, Inputs, LaneColumns, OutOfRange};
use crate::env::declared::model::{
    Clock, Definition, ModelFile, Moment, PeopleDraw, Referent, ReplayOrder, RoleFeature,
};
use crate::env::declared::program::{LaneProgram, stream};
use crate::env::declared::rows::Numbers;
use crate::env::history::History;
use crate::env::observation::{FeatureSpec, ObservationSpec, Observations};
use crate::env::simulation::{Simulated, Simulation, StateColumn};
use crate::env::variates::Expansion;
use crate::env::vector::{
    Action, ActionSpec, EpisodeStatus, LaneSet, LaneStreams, VectorEnvironment,
};
use crate::rng::open_unit_from_bits;
use crate::state::{Resumable, StateError, StateReader, StateWriter};

/// What a world is made of, which all of its copies share.
#[derive(Debug)]
pub(super) struct WorldParts {
    pub model: Arc<ModelFile>,
    pub program: Arc<LaneProgram>,
    /// The values of the model's parameters.
    pub parameters: Vec<f64>,
    pub people: Option<Arc<Numbers>>,
    /// The index of each needed column of the people.
    pub columns: Vec<usize>,
    pub replay: Option<Arc<Numbers>>,
    /// The index of each column of the rows.
    pub replayed: Vec<usize>,
    /// The rows of each person, \[people\]; empty without rows.
    pub rows: Vec<Range<usize>>,
    /// The features that are shown, by their index.
    pub shown: Vec<usize>,
    /// Why the simulation cannot go on.
    pub failure: Arc<OnceLock<String>>,
}

impl WorldParts {
    /// The number of people; 0 if people do not differ by a file.
    fn people(&self) -> usize {
        self.people.as_ref().map_or(self.rows.len(), |people| people.rows())
    }
}

/// People of a model; entry i of every array belongs to lane i.
///
/// A step draws one word per running lane. The stream of a variable is made from this word and the name of the variable,
/// so that its draws depend on the decision alone.
#[derive(Clone, Debug)]
pub struct World {
    parts: Arc<WorldParts>,
    history: Option<History>,
    columns: LaneColumns,
    /// Steps of all lanes so far.
    clock: u64,
    times: Vec<u32>,
    /// Rows in the file of people.
    people: Vec<u32>,
    /// The rows of the people in the lanes; empty if people are drawn.
    assigned: Vec<u32>,
    /// The number of episodes that began.
    episodes: Vec<u32>,
    /// The day of the trial on which the person entered; NaN outside of a trial.
    entered: Vec<f64>,
    /// The day of the trial.
    today: f64,
    /// The words of the draws of the person, and of the present decision.
    person_words: Vec<u64>,
    words: Vec<u64>,
    /// The rows that are replayed.
    rows: Vec<u32>,
    statuses: Vec<EpisodeStatus>,
    /// \[lanes, features\].
    seen: Vec<f64>,
    /// The outcomes of the last step.
    outcomes: Vec<f64>,
    is_available: Vec<bool>,
    /// Buffers, and the lanes that are computed alone.
    few: (FewBuffers, Vec<usize>),
    drawn: Vec<bool>,
    checked: Vec<bool>,
    renewed: Vec<bool>,
}

impl World {
    pub(super) fn new(parts: Arc<WorldParts>, history: usize, lanes: usize) -> World {
        let columns = LaneColumns::new(Arc::clone(&parts.program), lanes);
        let features = parts.shown.len();
        let mut world = World {
            history: None,
            columns,
            clock: 0,
            times: vec![0; lanes],
            people: vec![0; lanes],
            assigned: Vec::new(),
            episodes: vec![0; lanes],
            entered: vec![f64::NAN; lanes],
            today: f64::NAN,
            person_words: vec![0; lanes],
            words: vec![0; lanes],
            rows: vec![0; lanes],
            statuses: vec![EpisodeStatus::Truncated; lanes],
            seen: vec![0.0; lanes * features],
            outcomes: vec![0.0; lanes],
            is_available: vec![true; lanes],
            few: (FewBuffers(None), Vec::new()),
            drawn: vec![false; lanes],
            checked: vec![false; lanes],
            renewed: vec![false; lanes],
            parts,
        };
        world.columns.all[world.parts.program.values[1]].fill(f64::NAN);
        world.history = History::new(history, lanes, &world.spec());
        world
    }

    #[cfg(test)]
    pub(super) fn parts(&self) -> &Arc<WorldParts> {
        &self.parts
    }

    /// The present number of a quantity in a lane.
    #[cfg(test)]
    pub(super) fn quantity(&self, index: usize, lane: usize) -> f64 {
        self.column(index)[lane]
    }

    /// The index of the quantity of this name.
    #[cfg(test)]
    pub(super) fn named(&self, name: &str) -> usize {
        let mut all = self.model().quantities.iter();
        all.position(|quantity| quantity.name == name).expect("a quantity of the model")
    }

    /// Whether each lane is running.
    pub(super) fn running(&self) -> impl Iterator<Item = bool> {
        self.statuses.iter().map(|status| *status == EpisodeStatus::Running)
    }

    fn model(&self) -> &ModelFile {
        &self.parts.model
    }

    fn spec(&self) -> ObservationSpec {
        spec(&self.parts.model, &self.parts.shown)
    }

    fn column(&self, quantity: usize) -> &[f64] {
        &self.columns.all[self.parts.program.values[quantity]]
    }

    /// Chooses the person of a lane that begins an episode.
    fn choose_person(&mut self, lane: usize, word: u64) {
        let people = self.parts.people();
        let row = match (self.assigned.get(lane), self.parts.model.people) {
            _ if people == 0 => 0,
            (Some(row), _) => *row as usize,
            (None, PeopleDraw::Each) => {
                (lane + self.episodes[lane] as usize * self.times.len()) % people
            }
            (None, PeopleDraw::WithReplacement) => {
                ((open_unit_from_bits(word) * people as f64) as usize).min(people - 1)
            }
        };
        self.people[lane] = row as u32;
        let columns = self.parts.program.people.iter().zip(&self.parts.columns);
        if let Some(people) = &self.parts.people {
            for (to, from) in columns {
                self.columns.all[*to][lane] = people.number(row, *from);
            }
        }
    }

    /// Computes a stage in these lanes, or in those of `self.few` if there are any, and checks it in those that are marked.
    fn compute(&mut self, span: Range<usize>, stage: Moment) {
        let parts = Arc::clone(&self.parts);
        let words = if stage == Moment::Person { &self.person_words } else { &self.words };
        let inputs = Inputs {
            span,
            clock: self.clock,
            times: &self.times,
            words,
            drawn: &self.drawn,
            checked: &self.checked,
            replay: parts.replay.as_deref().map(|rows| (rows, &self.rows[..])),
            replayed: &parts.replayed,
        };
        let broken = match &mut self.few {
            (FewBuffers(few), lanes) if !lanes.is_empty() => {
                let program = Arc::clone(&parts.program);
                let few = few.get_or_insert_with(|| Box::new(FewLanes::new(program)));
                self.columns.compute_few(few, lanes, stage, &inputs)
            }
            _ => self.columns.compute(stage, &inputs),
        };
        if let Some(broken) = broken
            && self.parts.failure.get().is_none()
        {
            let says = self.explained(broken);
            // Another copy may have been first.
            let _ = self.parts.failure.set(says);
        }
    }

    /// Computes what is known before the choice, in these lanes; the observations of those marked as renewed are renewed.
    fn prepare(&mut self, span: Range<usize>, renewed: &[bool]) {
        let per_day = self.model().decisions_per_day;
        self.columns.set_clocks(span.clone(), &self.times, &self.entered, per_day);
        self.choose_rows();
        self.compute(span.clone(), Moment::Before);
        let parts = Arc::clone(&self.parts);
        let features = parts.shown.len();
        for (slot, index) in parts.shown.iter().enumerate() {
            let source = parts.model.roles.features[*index].source;
            if let Referent::Quantity(quantity) = source {
                let values = &self.columns.all[parts.program.values[quantity]][span.clone()];
                let seen = self.seen[span.start * features..].chunks_exact_mut(features);
                for ((seen, value), renewed) in seen.zip(values).zip(&renewed[span.clone()]) {
                    // Behind the last decision, rows may have ended.
                    seen[slot] = if *renewed & value.is_finite() { *value } else { seen[slot] };
                }
                continue;
            }
            for lane in span.clone().filter(|lane| renewed[*lane]) {
                let value = self.value(source, lane);
                self.check_feature(*index, lane, value);
                if value.is_finite() {
                    self.seen[lane * features + slot] = value;
                }
            }
        }
        if let Some(available) = parts.model.roles.available {
            let values = &self.columns.all[parts.program.values[available]][span.clone()];
            for (is_available, value) in self.is_available[span].iter_mut().zip(values) {
                *is_available = *value != 0.0;
            }
        }
    }

    /// Fails where a column or clock that is shown is missing or out of its bounds; what the program computes is checked
    /// there.
    fn check_feature(&self, index: usize, lane: usize, value: f64) {
        let feature = &self.parts.model.roles.features[index];
        let is_inside = value >= feature.low.max(f64::MIN) && value <= feature.high.min(f64::MAX);
        if is_inside || !self.checked[lane] {
            return;
        }
        let (person, time) = (lane + 1, self.times[lane]);
        let says = format!(
            "model: feature `{}` is {} for person {person} at decision {time}",
            feature.name,
            shown(value)
        );
        let _ = self.parts.failure.set(says);
    }

    /// The value of a name in a lane at the present decision.
    fn value(&self, target: Referent, lane: usize) -> f64 {
        let program = &self.parts.program;
        match target {
            Referent::One => 1.0,
            Referent::ModelParameter(index) => self.parts.parameters[index],
            Referent::Column(index) => self.columns.all[program.people[index]][lane],
            Referent::Quantity(index) => self.column(index)[lane],
            Referent::Clock(clock) => {
                let (time, per_day) = (self.times[lane], self.model().decisions_per_day);
                match clock {
                    Clock::Step => f64::from(time),
                    Clock::Day => f64::from(time / per_day),
                    Clock::Slot => f64::from(time % per_day),
                    Clock::CalendarDay => self.entered[lane] + f64::from(time / per_day),
                }
            }
        }
    }

    /// Chooses the rows that are replayed at the present decision.
    fn choose_rows(&mut self) {
        let parts = Arc::clone(&self.parts);
        let Some(order) = parts.model.replay else { return };
        let stream = stream("[replay]");
        for (lane, row) in self.rows.iter_mut().enumerate() {
            let Some(own) = parts.rows.get(self.people[lane] as usize) else { continue };
            let time = self.times[lane] as usize;
            *row = match order {
                ReplayOrder::Own if time < own.len() => (own.start + time) as u32,
                // No row has this number.
                ReplayOrder::Own => u32::MAX,
                ReplayOrder::Cyclic => (own.start + time % own.len()) as u32,
                ReplayOrder::Random => {
                    let share = Expansion(self.words[lane] ^ stream).open_unit();
                    let index = ((share * own.len() as f64) as usize).min(own.len() - 1);
                    (own.start + index) as u32
                }
            };
        }
    }

    /// What went wrong in a lane, with the numbers that led there.
    fn explained(&self, OutOfRange { check, lane, value }: OutOfRange) -> String {
        let model = self.model();
        let quantity = &model.quantities[check.quantity];
        let name = match check.parameter {
            None => format!("`{}`", quantity.name),
            Some(index) => {
                let parameter = match &quantity.definition {
                    Definition::DrawInstruction(distribution, _) => {
                        let keys = distribution.form().keys;
                        keys[index.min(keys.len() - 1)]
                    }
                    _ => "what is given",
                };
                format!("{parameter} of `{}`", quantity.name)
            }
        };
        let formulas = ModelFile::formulas(&quantity.definition);
        let formulas = check.parameter.map_or(formulas, |index| &formulas[index..=index]);
        let mut known = Vec::<String>::new();
        for formula in formulas {
            for (name, target) in formula.expression.names.iter().zip(&formula.targets) {
                let index = match target {
                    Referent::Quantity(index) => Some(*index),
                    _ => None,
                };
                if index.is_some_and(|index| !self.parts.program.needed[index]) {
                    continue;
                }
                let (text, value) = match (name.back, target) {
                    (0, target) => (name.text.clone(), self.value(*target, lane)),
                    (back, Referent::Quantity(index)) => {
                        let Some(past) = self.past(*index, back, lane) else { continue };
                        (format!("{}[-{back}]", name.text), past)
                    }
                    _ => continue,
                };
                let shown = format!("{text} = {}", shown(value));
                if !known.contains(&shown) {
                    known.push(shown);
                }
            }
        }
        if let Definition::Linear(terms) = &quantity.definition {
            for (name, coefficient) in terms.iter().map(|term| (&term.name, term.coefficient)) {
                known.push(format!("{name} = {}", shown(self.value(coefficient, lane))));
            }
        }
        // Behind what is missing, a field of the people's file can be.
        for column in self.empty_columns(check.quantity, lane) {
            let shown = format!("{column} = missing");
            let is_empty = format!("column {column} of the people is empty");
            match known.iter_mut().find(|known| **known == shown) {
                Some(known) => *known = is_empty,
                None => known.push(is_empty),
            }
        }
        let (least, most) = check.range;
        let is = match value {
            value if value.is_nan() => "is missing".to_owned(),
            value if value.is_infinite() => "is infinite".to_owned(),
            value => {
                let expected = crate::env::declared::numbers::range_in_words(least, most);
                // A quantity has no range of its own: a feature has.
                let whose = if check.parameter.is_none() { ", its bounds in [roles]" } else { "" };
                format!("is {value}, expected {expected}{whose}")
            }
        };
        let person = match &self.parts.people {
            Some(people) => {
                let row = self.people[lane] as usize;
                let (number, name) = ((row + 1).to_string(), people.person(row));
                let named = if name == number { String::new() } else { format!(", {name}") };
                format!("person {} (row {number} of the people{named})", lane + 1)
            }
            None => format!("person {}", lane + 1),
        };
        let time = self.times[lane];
        let because =
            if known.is_empty() { String::new() } else { format!("; {}", known.join(", ")) };
        format!("model: {name} {is} for {person} at decision {time}{because}")
    }

    /// The columns of the people's file whose fields are empty and that a quantity is computed from at the present decision.
    fn empty_columns(&self, quantity: usize, lane: usize) -> Vec<&str> {
        let (mut open, mut seen, mut empty) = (vec![quantity], vec![quantity], Vec::new());
        while let Some(index) = open.pop() {
            for (referent, back) in self.model().quantities[index].definition.referents() {
                if back > 0 || !self.value(referent, lane).is_nan() {
                    continue;
                }
                match referent {
                    Referent::Column(column) => empty.push(&*self.model().columns[column].name),
                    Referent::Quantity(other) if !seen.contains(&other) => {
                        seen.push(other);
                        open.push(other);
                    }
                    _ => {}
                }
            }
        }
        empty
    }

    /// The value of a quantity some decisions ago; `None` if nothing reads it.
    fn past(&self, quantity: usize, back: u32, lane: usize) -> Option<f64> {
        let program = &self.parts.program;
        let value = program.values[quantity];
        let ring = program.rings.iter().find(|(_, of)| *of == value).map(|(ring, _)| *ring);
        let column = ring?.column(self.clock, u64::from(back).min(ring?.depth as u64));
        Some(if self.times[lane] >= back { self.columns.all[column][lane] } else { f64::NAN })
    }

    fn observe_now(&self, out: &mut Observations) {
        out.clear();
        out.features.extend(self.seen.iter().map(|value| *value as f32));
    }
}

/// Buffers for few lanes, made when they are first needed. Copies of a world have none.
#[derive(Debug)]
struct FewBuffers(Option<Box<FewLanes>>);

impl Clone for FewBuffers {
    fn clone(&self) -> FewBuffers {
        FewBuffers(None)
    }
}

/// If one lane among this many begins, those that begin are computed alone.
const SPARSE: usize = 4;

/// Lanes are computed by this many, which a vectorised loop takes at a time.
const TOGETHER: usize = 16;

/// The least range with every lane that is marked, in multiples of [`TOGETHER`].
fn span(marked: &[bool]) -> Range<usize> {
    let Some(first) = marked.iter().position(|marked| *marked) else { return 0..0 };
    let behind = marked.iter().rposition(|marked| *marked).map_or(first, |last| last + 1);
    first / TOGETHER * TOGETHER..behind.next_multiple_of(TOGETHER).min(marked.len())
}

/// A number for messages.
fn shown(value: f64) -> String {
    if value.is_nan() { "missing".to_owned() } else { format!("{value}") }
}

/// What observations show: the features at these indices.
pub(super) fn spec(model: &ModelFile, shown: &[usize]) -> ObservationSpec {
    let feature = |index: &usize| {
        let RoleFeature { name, low, high, .. } = &model.roles.features[*index];
        FeatureSpec { name: name.clone(), low: *low as f32, high: *high as f32 }
    };
    ObservationSpec { features: shown.iter().map(feature).collect(), one_hot: 0 }
}

impl VectorEnvironment for World {
    fn action_spec(&self) -> ActionSpec {
        ActionSpec {
            count: self.model().actions.len(),
            lowest_reward: f64::NEG_INFINITY,
            highest_reward: f64::INFINITY,
        }
    }

    fn observation_spec(&self) -> ObservationSpec {
        self.spec().stacked(self.history.as_ref().map_or(1, History::length))
    }

    fn reset(&mut self, lanes: LaneSet<'_>, streams: &mut LaneStreams) {
        if let Some(history) = &mut self.history {
            history.reset(lanes);
        }
        let begun: Vec<bool> = (0..self.times.len()).map(|lane| lanes.contains(lane)).collect();
        for (lane, _) in begun.iter().enumerate().filter(|(_, begins)| **begins) {
            let stream = streams.of(lane);
            let [word, own, ..] = stream.next_participant();
            self.person_words[lane] = own;
            self.words[lane] = stream.bits();
            self.times[lane] = 0;
            self.statuses[lane] = EpisodeStatus::Running;
            self.entered[lane] = self.today;
            self.outcomes[lane] = 0.0;
            self.columns.forget(lane);
            self.choose_person(lane, word);
            self.episodes[lane] += 1;
        }
        // Others between them may be computed again, from the same words: their numbers do not change.
        for (drawn, status) in self.drawn.iter_mut().zip(&self.statuses) {
            *drawn = *status == EpisodeStatus::Running;
        }
        self.checked.copy_from_slice(&begun);
        let span = span(&begun);
        let count = begun.iter().filter(|begins| **begins).count();
        if count * SPARSE <= span.len() {
            self.few.1.extend((0..begun.len()).filter(|lane| begun[*lane]));
        }
        self.compute(span.clone(), Moment::Person);
        self.prepare(span, &begun);
        self.few.1.clear();
    }

    fn step(&mut self, actions: &[Action], rewards: &mut [f64], streams: &mut LaneStreams) {
        let lanes = self.times.len();
        assert_eq!(
            (actions.len(), rewards.len()),
            (lanes, lanes),
            "one action and reward per lane"
        );
        if let Some(mut history) = self.history.take() {
            history.remember(&self.statuses, |out| self.observe_now(out));
            self.history = Some(history);
        }
        for (lane, status) in self.statuses.iter().enumerate() {
            self.drawn[lane] = *status == EpisodeStatus::Running;
        }
        self.checked.copy_from_slice(&self.drawn);
        streams.fill(LaneSet::All, &self.drawn, &mut self.words);
        // People of a trial enter one after the other, and leave so.
        let span = span(&self.drawn);
        let parts = Arc::clone(&self.parts);
        // The first two quantities are the action and its probability.
        let taken = &mut self.columns.all[parts.program.values[0]];
        for ((taken, action), available) in taken.iter_mut().zip(actions).zip(&self.is_available) {
            *taken = if *available { action.index() as f64 } else { 0.0 };
        }
        let sent = &mut self.columns.all[parts.program.values[1]];
        for (sent, available) in sent.iter_mut().zip(&self.is_available) {
            *sent = if *available { *sent } else { 0.0 };
        }
        self.compute(span.clone(), Moment::After);
        let roles = &parts.model.roles;
        let value = |quantity: usize| parts.program.values[quantity];
        for (numbers, role) in [(&mut self.outcomes[..], roles.outcome), (rewards, roles.reward)] {
            numbers.fill(0.0);
            let computed = &self.columns.all[value(role)][span.clone()];
            let lanes = numbers[span.clone()].iter_mut().zip(computed);
            for ((number, computed), drawn) in lanes.zip(&self.drawn[span.clone()]) {
                // A number that is not finite ends the job.
                *number = if *drawn & computed.is_finite() { *computed } else { 0.0 };
            }
        }
        let ends = roles.ends.map(value);
        self.columns.remember(span.clone(), self.clock, &self.drawn);
        // Probabilities are of one step.
        self.columns.all[parts.program.values[1]].fill(f64::NAN);
        self.clock += 1;
        let horizon = parts.model.horizon();
        let lanes = self.times.iter_mut().zip(&mut self.statuses).zip(&self.drawn);
        for ((time, status), drawn) in lanes {
            *time += u32::from(*drawn);
            let is_last = *drawn & (*time >= horizon);
            *status = if is_last { EpisodeStatus::Truncated } else { *status };
        }
        if let Some(ends) = ends {
            let lanes = self.statuses.iter_mut().zip(&self.columns.all[ends]).zip(&self.drawn);
            for ((status, ends), drawn) in lanes {
                let is_end = *drawn & (*ends != 0.0);
                *status = if is_end { EpisodeStatus::Terminated } else { *status };
            }
        }
        // Behind the last decision nothing is checked.
        for (checked, status) in self.checked.iter_mut().zip(&self.statuses) {
            *checked = *status == EpisodeStatus::Running;
        }
        let renewed = std::mem::take(&mut self.renewed);
        let mut renewed = renewed;
        renewed.clone_from(&self.drawn);
        self.prepare(span, &renewed);
        self.renewed = renewed;
    }

    fn expect(&mut self, probabilities: &[f64]) {
        let actions = self.model().actions.len();
        let column = self.parts.program.values[1];
        let rows = probabilities.chunks_exact(actions);
        for (sent, row) in self.columns.all[column].iter_mut().zip(rows) {
            *sent = 1.0 - row[0];
        }
    }

    fn statuses(&self) -> &[EpisodeStatus] {
        &self.statuses
    }

    fn observe(&self, out: &mut Observations) {
        self.observe_now(out);
        if let Some(history) = &self.history {
            history.stack(&mut out.features);
        }
    }

    fn outcomes<'a>(&'a self, _: &'a [f64]) -> &'a [f64] {
        &self.outcomes
    }

    fn can_send(&self, lane: usize) -> bool {
        self.is_available[lane]
    }
}

impl Simulation for World {
    fn with_lanes(&self, lanes: usize) -> Simulated {
        let history = self.history.as_ref().map_or(1, History::length);
        Box::new(World::new(Arc::clone(&self.parts), history, lanes))
    }

    fn copied(&self) -> io::Result<Simulated> {
        Ok(Box::new(self.clone()))
    }

    fn times(&self) -> &[u32] {
        &self.times
    }

    fn exact_features(&self, lane: usize, observations: &Observations, out: &mut Vec<f64>) {
        out.clear();
        let features = self.parts.shown.len();
        // Earlier observations are kept in the precision of observations.
        if self.history.is_some() {
            let earlier = observations.width() - features;
            out.extend(observations.row(lane)[..earlier].iter().copied().map(f64::from));
        }
        out.extend_from_slice(&self.seen[lane * features..(lane + 1) * features]);
    }

    fn exact_features_read_observations(&self) -> bool {
        self.history.is_some()
    }

    fn assign(&mut self, rows: &[u32]) {
        self.assigned = rows.to_vec();
    }

    fn costs_follow(&self) -> bool {
        true
    }

    fn failure(&self) -> Option<&str> {
        self.parts.failure.get().map(String::as_str)
    }

    fn begin_day(&mut self, day: u32) {
        self.today = f64::from(day);
    }

    fn leave(&mut self, lane: usize) {
        self.statuses[lane] = EpisodeStatus::Truncated;
    }

    fn complete(&self, lane: usize, reward: f64, state: &mut [f64], cost: &mut f64) {
        let recorded = self.model().roles.state.iter().zip(state);
        for (quantity, number) in recorded {
            if self.model().quantities[*quantity].stage == Moment::After {
                *number = self.column(*quantity)[lane];
            }
        }
        if self.model().roles.reward != self.model().roles.outcome {
            *cost = self.outcomes[lane] - reward;
        }
    }

    fn show_state<'s>(&'s self, show: &mut dyn FnMut(&'s str, StateColumn<'s>)) {
        for quantity in &self.parts.model.roles.state {
            let name = &self.parts.model.quantities[*quantity].name;
            show(name, StateColumn::Reals(self.column(*quantity)));
        }
    }
}

impl Resumable for World {
    fn save(&self, out: &mut StateWriter<'_>) -> io::Result<()> {
        out.one(self.clock)?;
        out.many(&self.times)?;
        out.many(&self.people)?;
        out.many(&self.episodes)?;
        out.many(&self.entered)?;
        out.one(self.today)?;
        out.many(&self.person_words)?;
        out.many(&self.words)?;
        out.many(&self.seen)?;
        out.many(&self.outcomes)?;
        for column in &self.columns.all {
            out.many(column)?;
        }
        for (status, is_available) in self.statuses.iter().zip(&self.is_available) {
            status.save(out)?;
            is_available.save(out)?;
        }
        self.history.iter().try_for_each(|history| history.save(out))
    }

    fn restore(&mut self, from: &mut StateReader<'_>) -> Result<(), StateError> {
        self.clock = from.one()?;
        from.fill(&mut self.times, "times")?;
        from.fill(&mut self.people, "people")?;
        from.fill(&mut self.episodes, "episodes")?;
        from.fill(&mut self.entered, "entered")?;
        self.today = from.one()?;
        from.fill(&mut self.person_words, "person_words")?;
        from.fill(&mut self.words, "words")?;
        from.fill(&mut self.seen, "seen")?;
        from.fill(&mut self.outcomes, "outcomes")?;
        for column in &mut self.columns.all {
            from.fill(column, "columns")?;
        }
        for (status, is_available) in self.statuses.iter_mut().zip(&mut self.is_available) {
            status.restore(from)?;
            is_available.restore(from)?;
        }
        self.history.iter_mut().try_for_each(|history| history.restore(from))?;
        let people = self.parts.people().max(1);
        let fits = self.people.iter().all(|row| (*row as usize) < people)
            && self.times.iter().all(|time| *time <= self.parts.model.horizon());
        self.choose_rows();
        if fits { Ok(()) } else { Err(StateError::Misfit("people")) }
    }
}
