//! A trial, as one job holds it: who is in the study when, and when the algorithm learns.
//!
//! Days of the calendar are numbered from 0. People enter at the first decision of a day and have the same number of
//! decisions on each of their days. Updates come before the first decision of a day.

use std::sync::Arc;

use crate::key::{Content, ContentForm, KeyType, Kind, MOST_BYTES, Value, choices, keys, read_csv};

keys! {
    /// A trial: people who enter by a calendar, and an agent that learns from them at calendar times.
    pub struct Trial {
        /// people in the trial
        people: u32, in Kind::Integer { min: 1, max: MOST_PEOPLE };
        /// days of each person in the study
        days: u32, in Kind::Integer { min: 1, max: MOST_DAYS };
        /// decisions of a person per day; days times decisions_per_day is the length of an episode
        decisions_per_day: u32 = 1, in Kind::Integer { min: 1, max: 100 };
        /// start and end day of each person: the name of a CSV file, which replaces the keys entry_*
        entry: Content = Content::default(), in Kind::Content(&STAYS);
        /// days from one group of people that enters to the next; 0: everybody enters together
        entry_every_days: u32 = 0, in Kind::Integer { min: 0, max: MOST_DAYS };
        /// people in a group that enters
        entry_people: u32 = 1, in Kind::Integer { min: 1, max: MOST_PEOPLE };
        /// calendar day on which the first group enters
        entry_first_day: u32 = 0, in Kind::Integer { min: 0, max: MOST_DAYS };
        /// which row of the people's file each person is: the name of a CSV file; drawn without one
        people_file: Content = Content::default(), in Kind::Content(&ROWS);
        /// whose data an agent learns from: "full", one agent for everybody; "partial", one agent for everybody, in which
        /// people have coefficients of their own, for linear_thompson; "none", an agent per person, whose calendar begins
        /// on the person's first day; or a number, an agent per group of that many people, in the order of their entry
        pooling: Pooling = Pooling::Full, in Pooling::KIND;
        /// days from one update of the agent to the next; 0: no updates
        update_every_days: u32 = 1, in Kind::Integer { min: 0, max: MOST_DAYS };
        /// day of the first update; 0 for update_every_days
        update_first_day: u32 = 0, in Kind::Integer { min: 0, max: MOST_DAYS };
        /// the data of an update: of "all" people so far, or of people "in_study" on the day before
        update_data: UpdateData = UpdateData::All;
        /// days by which the data of an update lag behind
        update_lag_days: u32 = 0, in Kind::Integer { min: 0, max: MOST_DAYS };
        /// people who must have entered before the day of the first update; read with pooling = "full" and
        /// "partial"
        update_first_with_people: u32 = 1, in Kind::Integer { min: 1, max: MOST_PEOPLE };
        /// first and last day of an outage without updates, or its only day; empty for none
        outage: Vec<u32> = Vec::new(), in Kind::Counts { most: 2, max: MOST_DAYS as u32 };
        /// probability that a person leaves the study before a day; the first day is never left
        dropout: f64 = 0.0, in Kind::PROBABILITY;
        /// probability that the outcome of a decision does not reach the algorithm
        missing_outcomes: f64 = 0.0, in Kind::PROBABILITY;
        /// probability that a person's phone does not report before a decision, so that the algorithm sees the last
        /// reported observation; the first decision is always reported
        unreported: f64 = 0.0, in Kind::PROBABILITY;
    }
}

/// The most people of a trial.
const MOST_PEOPLE: u64 = 10_000;
/// The last day of calendars.
const MOST_DAYS: u64 = 100_000;

/// Whose data an agent learns from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pooling {
    /// Everybody's.
    Full,
    /// Everybody's, for coefficients that people have in common and for those of each person.
    Partial,
    /// Those of one person.
    None,
    /// Those of a group of this many people, at least 2.
    Groups(u32),
}

impl Pooling {
    /// The values of the key.
    const KIND: Kind = Kind::AnyOf(&[
        Kind::Choice(&["full", "partial", "none"]),
        Kind::Integer { min: 2, max: MOST_PEOPLE },
    ]);

    /// Whether there is one agent, which learns from everybody by the calendar of the trial.
    pub fn is_of_everybody(self) -> bool {
        match self {
            Pooling::Full | Pooling::Partial => true,
            Pooling::None | Pooling::Groups(_) => false,
        }
    }
}

impl KeyType for Pooling {
    fn to_value(&self) -> Value {
        match self {
            Pooling::Full => Value::Choice("full"),
            Pooling::Partial => Value::Choice("partial"),
            Pooling::None => Value::Choice("none"),
            Pooling::Groups(people) => Value::Integer((*people).into()),
        }
    }

    fn from_value(value: &Value) -> Option<Self> {
        match value {
            Value::Choice("full") => Some(Pooling::Full),
            Value::Choice("partial") => Some(Pooling::Partial),
            Value::Choice("none") => Some(Pooling::None),
            Value::Integer(people) => u32::try_from(*people).ok().map(Pooling::Groups),
            _ => None,
        }
    }
}

choices! {
    /// Which people's data an update reads.
    pub enum UpdateData {
        /// All people so far.
        All = "all",
        /// People who were in the study on the day before.
        InStudy = "in_study",
    }
}

/// The form of a file of stays.
pub static STAYS: ContentForm = ContentForm {
    what: "a CSV file with the columns start_day and end_day",
    parse: |text| Ok(Arc::new(columns(text, &["start_day", "end_day"])?)),
    canonical: None,
    shipped: &[],
    help: Some("one row per person; for Oralytics, experiments/oralytics/people.py makes v4.csv"),
    most_bytes: MOST_BYTES,
};

/// The form of a file of rows.
pub static ROWS: ContentForm = ContentForm {
    what: "a CSV file with the columns person and row, and seed where seeds differ",
    parse: |text| {
        // Without seeds, the rows are those of every seed.
        let wanted = ["person", "row", "seed"];
        let has_seeds = columns(text, &wanted[2..]).is_ok();
        Ok(Arc::new(columns(text, if has_seeds { &wanted } else { &wanted[..2] })?))
    },
    canonical: None,
    shipped: &[],
    help: Some("for the published trials of Oralytics, experiments/oralytics/people.py makes it"),
    most_bytes: MOST_BYTES,
};

/// Whole numbers by row, in the order of the wanted columns.
struct Columns(Vec<Vec<u64>>);

/// Reads these columns of a CSV file; others are not read.
fn columns(text: &str, wanted: &[&str]) -> Result<Columns, String> {
    let begin = |names: &csv::StringRecord| {
        let index = |name: &&str| {
            let index = names.iter().position(|found| found == *name);
            index.ok_or_else(|| format!("column `{name}` is missing"))
        };
        let indices: Vec<usize> = wanted.iter().map(index).collect::<Result<_, _>>()?;
        Ok((indices, Vec::new()))
    };
    let push = |(indices, rows): &mut (Vec<usize>, Vec<Vec<u64>>), record: &csv::StringRecord| {
        let number = |(index, name): (&usize, &&str)| {
            let written = &record[*index];
            let number = written.parse().ok().filter(|number: &u64| *number <= i64::MAX as u64);
            number.ok_or_else(|| format!("`{name}`: expected a whole number, found {written}"))
        };
        rows.push(indices.iter().zip(wanted).map(number).collect::<Result<_, _>>()?);
        Ok(())
    };
    let (_, rows) = read_csv(text, begin, push)?;
    if rows.is_empty() { Err("expected at least one row".to_owned()) } else { Ok(Columns(rows)) }
}

/// The columns of a file; `None` without one.
///
/// **Errors**: the text of the file is unknown.
fn columns_in(content: &Content) -> Result<Option<Arc<Columns>>, String> {
    match content.parsed() {
        None if !content.is_none() => {
            Err("a job of a store knows the digest of the file alone; use its manifest".to_owned())
        }
        columns => Ok(columns),
    }
}

/// The days of a person in the study.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stay {
    /// The first day.
    pub start: u32,
    /// The day after the last.
    pub end: u32,
}

impl Stay {
    /// Whether the person is in the study on a day.
    pub fn contains(&self, day: u32) -> bool {
        (self.start..self.end).contains(&day)
    }
}

/// The calendar of a trial.
#[derive(Clone, Debug, PartialEq)]
pub struct Calendar {
    /// The stay of every person, in the order of people.
    pub stays: Vec<Stay>,
    /// Decisions per day.
    pub per_day: u32,
    trial: Trial,
}

impl Trial {
    /// The number of decisions of a person.
    pub fn decisions(&self) -> u64 {
        u64::from(self.days) * u64::from(self.decisions_per_day)
    }

    /// The names of the numbers that stand behind the recorded state in a trial: whether the phone reported, the day
    /// of the calendar, and the number of the policy in force.
    pub fn state_names(&self) -> impl Iterator<Item = String> + use<> {
        let reported = (self.unreported > 0.0).then_some("reported");
        reported.into_iter().chain(["calendar_day", "policy"]).map(str::to_owned)
    }

    /// [`Trial::state_names`], and where outcomes can be missing, whether that of the decision reached the agent. The last
    /// one is not known before the decision, so that estimates do not read it.
    pub fn recorded_names(&self) -> impl Iterator<Item = String> + use<> {
        let reached = (self.missing_outcomes > 0.0).then(|| "reached".to_owned());
        self.state_names().chain(reached)
    }

    /// A key with a value under which nobody's best mean return is that of the environment, and its value.
    pub fn without_optimum(&self) -> Option<(&'static str, f64)> {
        let realities = [("dropout", self.dropout), ("unreported", self.unreported)];
        realities.into_iter().find(|(_, value)| *value > 0.0)
    }

    /// Why an agent never learns in the trial; `None` if it does, or is meant not to.
    pub fn never_learns(&self, calendar: &Calendar) -> Option<&'static str> {
        if self.update_every_days == 0 {
            return None;
        }
        let mut is_updated = false;
        for people in calendar.agents() {
            let stays = || people.iter().map(|person| &calendar.stays[*person]);
            let first = stays().map(|stay| stay.start).min().unwrap_or(0);
            let last = stays().map(|stay| stay.end).max().unwrap_or(0);
            let mut due =
                (first + 1..last).filter(|day| calendar.is_updated(&people, *day)).peekable();
            is_updated |= due.peek().is_some();
            if due.any(|day| day.saturating_sub(self.update_lag_days) > first) {
                return None;
            }
        }
        Some(match is_updated {
            true => "no update has data before the last person leaves",
            false => "no update comes before the last person leaves",
        })
    }

    /// The calendar.
    ///
    /// **Errors**: the file of stays does not have the people and days of the trial.
    pub fn calendar(&self) -> Result<Calendar, String> {
        let stays = match columns_in(&self.entry)? {
            Some(columns) => self.stays(&columns)?,
            None => {
                let last_group = (self.people - 1) / self.entry_people;
                let all = [
                    u64::from(self.entry_first_day),
                    u64::from(last_group) * u64::from(self.entry_every_days),
                    u64::from(self.days),
                ];
                let end: u64 = all.iter().sum();
                if end > MOST_DAYS {
                    return Err(format!(
                        "the last person leaves on day {end}; the last day is {MOST_DAYS}"
                    ));
                }
                let stay = |person: u32| {
                    let group = person / self.entry_people;
                    let start = self.entry_first_day + group * self.entry_every_days;
                    Stay { start, end: start + self.days }
                };
                (0..self.people).map(stay).collect()
            }
        };
        Ok(Calendar { stays, per_day: self.decisions_per_day, trial: self.clone() })
    }

    /// The stays of a file; the end day is the first day on which a person is no longer in the study.
    fn stays(&self, Columns(rows): &Columns) -> Result<Vec<Stay>, String> {
        let people = self.people as usize;
        if rows.len() != people {
            return Err(format!("it has {} rows, and people = {people}", rows.len()));
        }
        let stay = |(person, row): (usize, &Vec<u64>)| {
            let (start, end) = (row[0], row[1]);
            let is_stay = start < end && end - start <= u64::from(self.days) && end <= MOST_DAYS;
            let says = || {
                format!(
                    "person {person} has start_day {start} and end_day {end}; people are numbered from 0, and \
                     expected are 1 to {} days before day {MOST_DAYS}",
                    self.days
                )
            };
            is_stay.then_some(Stay { start: start as u32, end: end as u32 }).ok_or_else(says)
        };
        rows.iter().enumerate().map(stay).collect()
    }

    /// The row of the people's file that each person of a trial with this seed is; `None` if they are drawn.
    ///
    /// **Errors**: the file does not have a row for every person.
    pub fn rows(&self, seed: u64) -> Result<Option<Vec<u32>>, String> {
        let Some(file) = columns_in(&self.people_file)? else { return Ok(None) };
        let mut of_people = vec![None; self.people as usize];
        for row in file.0.iter().filter(|row| row.get(2).is_none_or(|of| *of == seed)) {
            let row_of_person =
                usize::try_from(row[0]).ok().and_then(|person| of_people.get_mut(person));
            let row_of_person = row_of_person.ok_or_else(|| {
                format!("seed {seed} has a person {}; people are numbered from 0", row[0])
            })?;
            if row_of_person.is_some() {
                return Err(format!("seed {seed} has two rows for person {}", row[0]));
            }
            // A row that no file has is reported as such.
            *row_of_person = Some(u32::try_from(row[1]).unwrap_or(u32::MAX));
        }
        let missing = of_people.iter().position(Option::is_none);
        match missing {
            Some(person) => Err(format!("seed {seed} has no row for person {person}")),
            None => Ok(Some(of_people.into_iter().flatten().collect())),
        }
    }
}

impl Calendar {
    /// The number of days until everybody has left.
    pub fn days(&self) -> u32 {
        self.stays.iter().map(|stay| stay.end).max().unwrap_or(0)
    }

    /// The people of every agent, \[agents\]\[people of the agent\].
    pub fn agents(&self) -> Vec<Vec<usize>> {
        let mut people: Vec<usize> = (0..self.stays.len()).collect();
        let size = match self.trial.pooling {
            Pooling::Full | Pooling::Partial => people.len(),
            Pooling::None => 1,
            Pooling::Groups(size) => {
                people.sort_by_key(|person| self.stays[*person].start);
                size as usize
            }
        };
        people.chunks(size.max(1)).map(<[usize]>::to_vec).collect()
    }

    /// Whether the agent of these people is updated before the first decision of a day: by the calendar of the trial if the
    /// agent is of everybody, else by a calendar that begins with the first of the people.
    pub fn is_updated(&self, people: &[usize], day: u32) -> bool {
        if self.is_outage(day) {
            return false;
        }
        let Trial { update_every_days: every, update_first_day, .. } = self.trial;
        let first = if update_first_day == 0 { every } else { update_first_day };
        let is_due = |day: u32| every > 0 && day >= first && (day - first).is_multiple_of(every);
        let stays = || people.iter().map(|person| &self.stays[*person]);
        if self.trial.pooling.is_of_everybody() {
            let entered = || stays().filter(|stay| stay.start < day).count();
            return is_due(day) && entered() >= self.trial.update_first_with_people as usize;
        }
        let start = stays().map(|stay| stay.start).min().unwrap_or(0);
        stays().any(|stay| stay.contains(day)) && is_due(day - start)
    }

    /// Whether there is an outage on a calendar day.
    fn is_outage(&self, day: u32) -> bool {
        match self.trial.outage[..] {
            [first, last] => (first..=last).contains(&day),
            [only] => only == day,
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::key::Keyed;

    fn trial(people: u32) -> Trial {
        use crate::key::Value;
        Trial::with_required(&[Value::Integer(people.into()), Value::Integer(70)])
    }

    #[test]
    fn groups_enter_one_after_another() {
        let trial =
            Trial { entry_every_days: 14, entry_people: 5, entry_first_day: 7, ..trial(12) };
        let calendar = trial.calendar().unwrap();
        assert_eq!(calendar.stays[4], Stay { start: 7, end: 77 });
        assert_eq!(calendar.stays[5], Stay { start: 21, end: 91 });
        assert_eq!(calendar.stays[11], Stay { start: 35, end: 105 });
        assert_eq!(calendar.days(), 105);
        assert!(calendar.stays[4].contains(76) && !calendar.stays[4].contains(77));
    }

    #[test]
    fn groups_of_people_share_an_agent_in_the_order_of_their_entry() {
        let entry = Content::read(&STAYS, "start_day,end_day\n5,10\n0,10\n0,4\n").unwrap();
        let agents = |pooling| {
            let trial = Trial { pooling, entry: entry.clone(), ..trial(3) };
            trial.calendar().unwrap().agents()
        };
        assert_eq!(agents(Pooling::Groups(2)), [vec![1, 2], vec![0]]);
        assert_eq!(agents(Pooling::None), [[0], [1], [2]]);
        assert_eq!(agents(Pooling::Partial), [[0, 1, 2]]);
        assert_eq!(agents(Pooling::Groups(9)), [[1, 2, 0]]);
    }

    #[test]
    fn updates_come_when_they_are_due() {
        let weekly = Trial { update_every_days: 7, update_first_with_people: 3, ..trial(9) };
        let calendar = weekly.calendar().unwrap();
        let updated = |people: &[usize]| -> Vec<u32> {
            (0..30).filter(|day| calendar.is_updated(people, *day)).collect()
        };
        let (three, two) = (updated(&[0, 1, 2]), updated(&[0, 1]));
        assert_eq!((three, two), (vec![7, 14, 21, 28], Vec::new()));
        let sundays = Trial { update_every_days: 7, update_first_day: 10, ..trial(9) };
        let calendar = sundays.calendar().unwrap();
        assert!((0..30).filter(|day| calendar.is_updated(&[0], *day)).eq([10, 17, 24]));
        let never = Trial { update_every_days: 0, ..trial(9) }.calendar().unwrap();
        assert!(!(0..30).any(|day| never.is_updated(&[0], day)));
        // The calendar of a group begins with its first person, and an outage is of the trial.
        let entry = Content::read(&STAYS, "start_day,end_day\n5,15\n9,19\n0,9\n").unwrap();
        let pooling = Pooling::Groups(2);
        let grouped = Trial { update_every_days: 4, pooling, entry, outage: vec![12], ..trial(3) };
        let grouped = grouped.calendar().unwrap();
        let of_group = |people: &[usize]| -> Vec<u32> {
            (0..30).filter(|day| grouped.is_updated(people, *day)).collect()
        };
        assert_eq!(grouped.agents(), [vec![2, 0], vec![1]]);
        assert_eq!((of_group(&[2, 0]), of_group(&[1])), (vec![4, 8], vec![13, 17]));
        let out = Trial { outage: vec![3, 5], ..trial(9) }.calendar().unwrap();
        assert!((0..9).filter(|day| out.is_outage(*day)).eq([3, 4, 5]));
        let out = Trial { outage: vec![3], ..trial(9) }.calendar().unwrap();
        assert!((0..9).filter(|day| out.is_outage(*day)).eq([3]));
        let endless = Trial { entry_every_days: 90_000, ..trial(3) };
        let says = "the last person leaves on day 180070; the last day is 100000";
        assert_eq!(endless.calendar(), Err(says.to_owned()));
    }

    #[test]
    fn files_give_stays_and_rows() {
        let entry = Content::read(&STAYS, "start_day,end_day\n0,70\n3,10\n").unwrap();
        let from_file = Trial { entry, ..trial(2) };
        assert_eq!(from_file.calendar().unwrap().stays[1], Stay { start: 3, end: 10 });
        assert!(Trial { people: 3, ..from_file }.calendar().unwrap_err().contains("2 rows"));
        let people_file = Content::read(&ROWS, "seed,person,row\n1,0,7\n1,1,4\n2,1,0\n").unwrap();
        let drawn = Trial { people_file, ..trial(2) };
        assert_eq!(drawn.rows(1), Ok(Some(vec![7, 4])));
        assert_eq!(drawn.rows(2), Err("seed 2 has no row for person 0".to_owned()));
        let people_file = Content::read(&ROWS, "person,row\n0,7\n0,4\n").unwrap();
        let twice = Trial { people_file, ..trial(2) }.rows(1);
        assert_eq!(twice, Err("seed 1 has two rows for person 0".to_owned()));
        let people_file = Content::read(&ROWS, "person,row\n1,3\n0,9\n").unwrap();
        assert_eq!(Trial { people_file, ..trial(2) }.rows(5), Ok(Some(vec![9, 3])));
        assert_eq!(trial(2).rows(1), Ok(None));
        let fault = |text| Content::read(&ROWS, text).unwrap_err().to_string();
        assert_eq!(fault("seed,person\n"), "column `row` is missing");
        assert_eq!(
            fault("seed,person,row\n1,0,x\n"),
            "line 2: `row`: expected a whole number, found x"
        );
    }
}
