//! Reads the decisions of a recorded trial from its file.

use std::sync::{Arc, PoisonError};

use crate::env::declared::{
    Calendar, ColumnFormula, DataFaults, Header, RecordedRows, SKIPPED, WrittenColumn, header,
    reader, rows,
};
use crate::env::recorded::description::LogDescription;
use crate::env::recorded::log::{LogPerson, REACHED, RECORDED_PROBABILITY, RecordedLog};
use crate::env::recorded::parameters::{KnownLogs, LIST, LogParameters, NONE};
use crate::key::{Content, Keyed};
use crate::text::{Fault, Span, shortened};

/// How far from 1 the sum of the probabilities of several actions is by rounding.
const ROUNDING: f64 = 1e-9;
/// The largest number of an outcome or state, whose squares have sums.
const LARGEST: f64 = 1e100;
/// The last day of a calendar, as that of a trial.
const LAST_DAY: f64 = 100_000.0;
/// Names that decisions have beside those of their state.
const TAKEN: [&str; 9] = [
    "step",
    "reward",
    "gross_reward",
    "calendar_day",
    "policy",
    REACHED,
    RECORDED_PROBABILITY,
    "person",
    "all",
];

/// Why a file is no recorded trial.
#[derive(Debug)]
pub(super) enum LogFaults {
    /// These expressions, by their keys.
    Keys(Vec<(&'static str, Fault)>),
    /// The file.
    File(DataFaults),
}

impl From<DataFaults> for LogFaults {
    fn from(faults: DataFaults) -> LogFaults {
        LogFaults::File(faults)
    }
}

/// The expressions of the file's columns.
pub(super) struct LogColumns {
    pub person: usize,
    order: Vec<ColumnFormula>,
    action: ColumnFormula,
    probability: Vec<ColumnFormula>,
    available: ColumnFormula,
    reached: ColumnFormula,
    outcome: ColumnFormula,
    calendar_day: Option<ColumnFormula>,
    state: Vec<(String, ColumnFormula)>,
}

/// The parts of a list of expressions.
pub(super) fn parts(text: &str) -> Vec<&str> {
    let all = text.split(LIST.trim()).map(str::trim);
    all.filter(|part| !part.is_empty() && *part != NONE).collect()
}

/// Reads expressions of a file's columns, and collects faults by key.
struct KeyReader<'h> {
    header: &'h Header,
    faults: Vec<(&'static str, Fault)>,
}

impl KeyReader<'_> {
    /// The faults, or that of a file without names.
    fn into_faults(self) -> LogFaults {
        self.header.lacks_names().map_or(LogFaults::Keys(self.faults), LogFaults::File)
    }

    fn fault(&mut self, key: &'static str, fault: Fault) {
        self.faults.push((key, fault));
    }

    fn formula(&mut self, key: &'static str, text: &str) -> Option<ColumnFormula> {
        let written = WrittenColumn { text: text.to_owned(), span: Span { start: 0, end: 0 } };
        let found = self.header.formula(&written);
        found.map_err(|fault| self.fault(key, fault)).ok()
    }

    /// A list of 1 to `most` expressions.
    fn list(&mut self, key: &'static str, text: &str, most: usize) -> Vec<ColumnFormula> {
        let parts = parts(text);
        if parts.is_empty() || parts.len() > most {
            let says = format!("expected 1 to {most} columns, found {}", parts.len());
            self.fault(key, Fault::whole(says));
        }
        parts.into_iter().filter_map(|part| self.formula(key, part)).collect()
    }

    fn person(&mut self, text: &str) -> Option<usize> {
        match self.formula("person", text)? {
            ColumnFormula::Column(index) => Some(index),
            ColumnFormula::Expression(..) => {
                let says = "expected the name of a column, found an expression";
                self.fault("person", Fault::whole(says));
                None
            }
        }
    }

    fn state(&mut self, text: &str) -> Vec<(String, ColumnFormula)> {
        let mut state: Vec<(String, ColumnFormula)> = Vec::new();
        for part in parts(text) {
            let (name, text) = part.split_once('=').unwrap_or((part, part));
            let (name, text) = (name.trim(), text.trim());
            let formula = self.formula("state", text);
            if state.iter().any(|(known, _)| known == name) {
                self.fault("state", Fault::whole(format!("`{}` is listed twice", shortened(name))));
            } else if unusable(name) {
                self.fault("state", bad_name(name));
            } else if let Some(formula) = formula {
                state.push((name.to_owned(), formula));
            }
        }
        state
    }
}

impl LogColumns {
    pub fn new(of: &LogParameters, header: &Header) -> Result<LogColumns, LogFaults> {
        let mut reader = KeyReader { header, faults: Vec::new() };
        let person = reader.person(&of.person);
        let order = reader.list("order", &of.order, 2);
        let action = reader.formula("action", &of.action);
        let probability = reader.list("probability", &of.probability, 255);
        let outcome = reader.formula("outcome", &of.outcome);
        let available = reader.formula("available", &of.available);
        let reached = reader.formula("reached", &of.reached);
        let state = reader.state(&of.state);
        let calendar_day = match parts(&of.calendar_day).is_empty() {
            true => None,
            false => reader.formula("calendar_day", &of.calendar_day),
        };
        let found = (person, action, outcome, available, reached);
        let (Some(person), Some(action), Some(outcome), Some(available), Some(reached)) = found
        else {
            return Err(reader.into_faults());
        };
        if !reader.faults.is_empty() {
            return Err(reader.into_faults());
        }
        Ok(LogColumns {
            person,
            order,
            action,
            probability,
            available,
            reached,
            outcome,
            calendar_day,
            state,
        })
    }

    fn formulas(&self) -> Vec<&ColumnFormula> {
        let one = [&self.action, &self.available, &self.reached, &self.outcome];
        let lists = self.order.iter().chain(&self.probability).chain(&self.calendar_day);
        let state = self.state.iter().map(|(_, formula)| formula);
        one.into_iter().chain(lists).chain(state).collect()
    }

    /// The formulas whose numbers may be missing.
    fn measured(&self) -> Vec<&ColumnFormula> {
        let state = self.state.iter().map(|(_, formula)| formula);
        [&self.action, &self.outcome].into_iter().chain(&self.probability).chain(state).collect()
    }

    /// The columns of the file that are read as numbers.
    pub fn used(&self) -> Vec<usize> {
        self.formulas().into_iter().flat_map(ColumnFormula::columns).collect()
    }
}

fn unusable(name: &str) -> bool {
    let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_';
    name.is_empty() || name.len() > 64 || !name.chars().all(is_word) || TAKEN.contains(&name)
}

fn bad_name(name: &str) -> Fault {
    let says = match TAKEN.contains(&name) {
        true => format!("`{name}` is the name of something else that every decision has"),
        false => format!(
            "`{}` cannot be a name: expected letters, digits and underscores",
            shortened(name)
        ),
    };
    Fault::whole(says).help("give it another name, as in { before = \"steps before\" }")
}

impl RecordedLog {
    /// The trial in a file.
    ///
    /// **Errors**: every fault of the expressions, or else every fault of the file.
    pub(super) fn read(content: &Content, of: &LogParameters) -> Result<RecordedLog, LogFaults> {
        let mut reader = reader(content.text().unwrap_or_default().as_bytes());
        let header = header(&mut reader)?;
        let columns = LogColumns::new(of, &header)?;
        let table = rows(&mut reader, header, columns.person, &columns.used(), &|| false)?;
        let calendar = Calendar::new(&table, &columns.order, of.decisions_per_day)?;
        let mut log = Building::new(of, &columns, &table, calendar);
        log.fill();
        let Building { log, faults, .. } = log;
        if faults.is_empty() { Ok(log) } else { Err(faults.into()) }
    }
}

/// The numbers of decisions that are left out, by reason.
#[derive(Default)]
struct LeftOut {
    without_action: FirstLine,
    without_probability: FirstLine,
    without_outcome: FirstLine,
    unreached: FirstLine,
    certain: FirstLine,
}

/// A number of decisions, and the line of the first.
type FirstLine = (u64, u32);

fn count((count, first): &mut FirstLine, line: u32) {
    *first = if *count == 0 { line } else { *first };
    *count += 1;
}

/// A log while it is filled.
struct Building<'a> {
    columns: &'a LogColumns,
    table: &'a RecordedRows,
    calendar: Calendar,
    log: RecordedLog,
    left_out: LeftOut,
    /// What to write if probabilities are percentages; empty if they are not.
    percentages: String,
    /// \[people\]: whether a row with a day of the calendar was read.
    has_day: Vec<bool>,
    faults: DataFaults,
}

impl<'a> Building<'a> {
    fn new(
        of: &LogParameters,
        columns: &'a LogColumns,
        table: &'a RecordedRows,
        calendar: Calendar,
    ) -> Building<'a> {
        let (decisions, actions) = (calendar.rows.len(), columns.probability.len() + 1);
        let people = calendar.people.iter().map(|person| LogPerson {
            name: person.name.clone(),
            first: person.decisions.start,
            decisions: person.decisions.len() as u32,
            start_day: 0,
        });
        let log = RecordedLog {
            names: columns.state.iter().map(|(name, _)| name.clone()).collect(),
            actions,
            per_day: of.decisions_per_day,
            people: people.collect(),
            state: Vec::with_capacity(decisions * columns.state.len()),
            outcomes: vec![0.0; decisions],
            taken: vec![0; decisions],
            probabilities: vec![0.0; decisions * actions],
            is_used: vec![false; decisions],
            is_available: vec![false; decisions],
            is_reached: vec![false; decisions],
            lacking: vec![(0, 0); columns.state.len()],
            notes: Vec::new(),
            is_drawn: vec![false; decisions],
        };
        let (left_out, faults) = Default::default();
        let has_day = vec![false; log.people.len()];
        let chances = (0..table.lines.len())
            .flat_map(|row| columns.probability.iter().map(move |one| one.value(table, row, 0)));
        let written = parts(&of.probability);
        let percentages = table.header.percentages(written.first().unwrap_or(&""), chances);
        Building { columns, table, calendar, log, left_out, percentages, has_day, faults }
    }

    fn fill(&mut self) {
        for person in 0..self.log.people.len() {
            let LogPerson { first, decisions, .. } = self.log.people[person];
            for decision in first..first + decisions as usize {
                let row = self.calendar.rows[decision];
                if row == SKIPPED {
                    // What was last known; no agent chooses here.
                    let width = self.log.names.len();
                    let last = self.log.state.len() - if decision > first { width } else { 0 };
                    match decision > first {
                        true => self.log.state.extend_from_within(last..),
                        false => self.log.state.resize(last + width, 0.0),
                    }
                    self.log.probabilities[decision * self.log.actions] = 1.0;
                } else {
                    self.decision(decision, row as usize, decision - first);
                    self.day(person, row as usize, decision - first);
                }
            }
        }
        if self.faults.is_empty() && !self.log.is_used.contains(&true) {
            self.faults.add("no decision has an action, its probability and an outcome");
        }
        self.note();
    }

    /// The place of a row in the file, for messages.
    fn line(&self, row: usize) -> String {
        format!("line {}", self.table.lines[row])
    }

    fn decision(&mut self, decision: usize, row: usize, step: usize) {
        let columns = self.columns;
        let value = |formula: &ColumnFormula| formula.value(self.table, row, step);
        let (available, reached) = (value(&columns.available), value(&columns.reached));
        let (action, outcome) = (value(&columns.action), value(&columns.outcome));
        let chances: Vec<f64> = columns.probability.iter().map(value).collect();
        let state: Vec<f64> = columns.state.iter().map(|(_, formula)| value(formula)).collect();
        let line = self.table.lines[row];
        let lacking = self.log.lacking.iter_mut().zip(&state);
        lacking.filter(|(_, number)| number.is_nan()).for_each(|(one, _)| count(one, line));
        let named = columns.state.iter().map(|(name, _)| name.as_str()).zip(state.iter().copied());
        for (name, number) in named.chain([("outcome", outcome)]) {
            if number.abs() > LARGEST {
                let line = self.line(row);
                self.faults
                    .add(format!("{line}: `{name}` is {number:e}, above {LARGEST:e} in size"));
            }
        }
        self.log.state.extend(state);
        for (name, flag) in [("available", available), ("reached", reached)] {
            if flag != 0.0 && flag != 1.0 {
                let (line, found) = (self.line(row), found(flag));
                self.faults.add(format!("{line}: `{name}` is {found}, expected 0 or 1"));
            }
        }
        let is_available = available == 1.0;
        self.log.is_available[decision] = is_available;
        self.log.is_reached[decision] = reached == 1.0;
        self.log.outcomes[decision] = outcome;
        let action = if !is_available && action.is_nan() { 0.0 } else { action };
        let is_action = self.action(decision, row, (action, is_available));
        let own = self.log.probabilities.chunks_exact_mut(self.log.actions).nth(decision);
        let own = own.expect("a row of probabilities for each decision");
        if !is_available {
            own[0] = 1.0;
        } else {
            own[0] = remainder(&chances);
            own[1..].copy_from_slice(&chances);
            self.chances(decision, row, &chances, is_action);
        }
        let left_out = &mut self.left_out;
        let is_known = chances.iter().all(|p| !p.is_nan()) || !is_available;
        self.log.is_drawn[decision] = is_available && is_action && is_known;
        match (is_action, is_known, outcome.is_nan()) {
            (false, ..) => count(&mut left_out.without_action, line),
            (true, false, _) => count(&mut left_out.without_probability, line),
            (true, true, true) => count(&mut left_out.without_outcome, line),
            (true, true, false) => {
                self.log.is_used[decision] = true;
                if reached == 0.0 {
                    count(&mut left_out.unreached, line);
                }
                let actions = self.log.actions;
                let own = &self.log.probabilities[decision * actions..(decision + 1) * actions];
                let is_certain = is_available && own.iter().any(|p| *p == 0.0 || *p == 1.0);
                if is_certain {
                    count(&mut left_out.certain, line);
                }
            }
        }
    }

    /// Reads an action; false if it is missing.
    fn action(&mut self, decision: usize, row: usize, (action, is_available): (f64, bool)) -> bool {
        if action.is_nan() {
            return false;
        }
        let last = self.log.actions - 1;
        if action.fract() != 0.0 || action < 0.0 || action > last as f64 {
            let line = self.line(row);
            self.faults.add(format!(
                "{line}: `action` is {action}, expected a whole number from 0 to {last}"
            ));
            return true;
        }
        if !is_available && action > 0.0 {
            let line = self.line(row);
            self.faults.add(format!("{line}: action {action} where `available` is 0"));
        }
        self.log.taken[decision] = action as u8;
        true
    }

    /// Checks the probabilities of an available decision.
    fn chances(&mut self, decision: usize, row: usize, chances: &[f64], is_action: bool) {
        let line = self.line(row);
        let is_broken = |p: &&f64| !(p.is_nan() || (0.0..=1.0).contains(*p));
        for p in chances.iter().filter(is_broken) {
            let help = &self.percentages;
            self.faults
                .add(format!("{line}: `probability` is {p}, expected a number from 0 to 1{help}"));
        }
        if chances.iter().any(|p| is_broken(&p)) {
            return;
        }
        let sum: f64 = chances.iter().sum();
        if chances.len() > 1 && sum > 1.0 + ROUNDING {
            self.faults.add(format!("{line}: the probabilities add to {sum}, which is above 1"));
        }
        let action = usize::from(self.log.taken[decision]);
        let own = self.log.probabilities[decision * self.log.actions + action];
        if is_action && own == 0.0 {
            self.faults.add(format!("{line}: action {action} was taken with the probability 0"));
        }
    }

    /// Checks the day of the calendar of a decision, and keeps that on which its person entered.
    fn day(&mut self, person: usize, row: usize, step: usize) {
        let Some(formula) = &self.columns.calendar_day else { return };
        let day = formula.value(self.table, row, step);
        let within = (step as u32 / self.log.per_day) as f64;
        let line = self.line(row);
        if day.fract() != 0.0 || !(0.0..=LAST_DAY).contains(&day) || day < within {
            let found = found(day);
            self.faults.add(format!(
                "{line}: `calendar_day` is {found}, expected a whole number from 0 to {LAST_DAY}, and for decision \
                 {step} of a person at least {within}"
            ));
            return;
        }
        let entered = (day - within) as u32;
        let own = &mut self.log.people[person];
        if !std::mem::replace(&mut self.has_day[person], true) {
            own.start_day = entered;
        } else if own.start_day != entered {
            let (name, start) = (shortened(&own.name), own.start_day);
            self.faults.add(format!(
                "{line}: `calendar_day` is {day}, and decision {step} of person {name}, who entered on day {start}, is on \
                 day {}: `order` must count every decision of a day, with `decisions_per_day`",
                f64::from(start) + within
            ));
        }
    }

    fn note(&mut self) {
        let (skipped, people) = self.calendar.skipped();
        let LeftOut { without_action, without_probability, without_outcome, unreached, certain } =
            self.left_out;
        let used = self.log.is_used.iter().filter(|used| **used).count();
        let notes = &mut self.log.notes;
        notes.push(format!("{used} decisions of {} people are used", self.log.people.len()));
        let counted = [
            (without_action, "have no action and are left out"),
            (without_probability, "have no probability and are left out"),
            (without_outcome, "have no outcome and are left out"),
            (unreached, "have an outcome that did not reach the agent of the trial"),
            (
                certain,
                "have an action with the probability 0 or 1 and say nothing about its effect",
            ),
        ];
        for ((count, line), says) in counted.into_iter().filter(|((count, _), _)| *count > 0) {
            notes.push(format!("{count} decisions {says}, the first in line {line}"));
        }
        if skipped > 0 {
            notes.push(format!(
                "{skipped} decisions of {people} people, before or between others, are no rows of the file"
            ));
        }
        for (name, (count, line)) in
            self.log.names.iter().zip(&self.log.lacking).filter(|(_, (count, _))| *count > 0)
        {
            notes.push(format!(
                "{count} decisions have no `{name}`, the first in line {line}; estimates that read it leave them out"
            ));
        }
        notes.extend(self.table.codes(&self.columns.measured(), |_| true));
    }
}

/// The probability of action 0 beside those of the others; NaN if one is missing.
fn remainder(chances: &[f64]) -> f64 {
    let rest = 1.0 - chances.iter().sum::<f64>();
    match chances.len() > 1 && rest.abs() <= ROUNDING {
        true => 0.0,
        // Negative numbers are faults.
        false if rest < 0.0 => 0.0,
        false => rest,
    }
}

fn found(number: f64) -> String {
    if number.is_nan() { "missing".to_owned() } else { number.to_string() }
}

/// A trial that was read, with its description.
#[derive(Clone, Debug)]
pub(super) struct KnownLog {
    pub log: Arc<RecordedLog>,
    pub description: Arc<LogDescription>,
}

pub(super) type ReadLog = Result<KnownLog, LogFaults>;

/// The trial that these keys declare, which is read once; `None` if the text of the file is not known.
pub(super) fn known(parameters: &LogParameters) -> Option<Arc<ReadLog>> {
    let file: Arc<KnownLogs> = parameters.file.parsed()?;
    let mut all = file.0.lock().unwrap_or_else(PoisonError::into_inner);
    let values = parameters.to_values();
    // The file is the same, also where it is known by the columns that are read: a manifest reads them in one way.
    if let Some((_, read)) = all.iter().find(|(known, _)| known[1..] == values[1..]) {
        return Arc::clone(read).downcast().ok();
    }
    let read = RecordedLog::read(&parameters.file, parameters).map(|log| KnownLog {
        description: Arc::new(LogDescription::of(parameters, &log)),
        log: Arc::new(log),
    });
    let read: Arc<ReadLog> = Arc::new(read);
    all.push((values, read.clone()));
    Some(read)
}
