//! Recorded trials from small files.

use std::sync::Arc;

use super::parameters::LOG;
use super::reading::LogFaults;
use super::*;
use crate::env::{Action, LaneSet, LaneStreams, Model, Scenario, Simulation, VectorEnvironment};
use crate::env::{Environment, contract};
use crate::key::{Content, Keyed, Value};
use crate::rng::{Purpose, Stream};

const HEADER: &str = "who,n,day,free,sent,p,after,mood\n";

fn parameters(rows: &str) -> LogParameters {
    let file = Content::read(&LOG, &format!("{HEADER}{rows}")).unwrap();
    let texts = ["who", "n", "sent", "p", "after"].map(|text| Value::Text(text.to_owned()));
    let required: Vec<Value> = [Value::Content(file)].into_iter().chain(texts).collect();
    LogParameters {
        available: "free".to_owned(),
        state: "mood = mood; twice = 2 * mood".to_owned(),
        ..LogParameters::with_required(&required)
    }
}

fn read(parameters: &LogParameters) -> Result<RecordedLog, LogFaults> {
    RecordedLog::read(&parameters.file, parameters)
}

/// The faults of a file, each with its line.
fn faults(parameters: &LogParameters) -> String {
    match read(parameters).unwrap_err() {
        LogFaults::File(faults) => faults.text("trial.csv"),
        LogFaults::Keys(faults) => {
            let said = faults.iter().map(|(key, fault)| format!("`{key}`: {}\n", fault.message()));
            said.collect()
        }
    }
}

/// Two people, the second of whom has a gap, an unavailable decision and one without an outcome.
const ROWS: &str =
    "b,0,3,1,1,0.5,2,1\nb,1,4,1,0,0.5,3,2\na,4,1,1,0,0.25,5,3\na,2,0,0,0,,4,\na,5,1,1,1,0.25,,3\n";

#[test]
fn decisions_are_those_of_the_file_by_person_and_order() {
    let log = read(&parameters(ROWS)).unwrap();
    let names: Vec<&str> = log.people.iter().map(|person| person.name.as_str()).collect();
    assert_eq!(names, ["b", "a"], "in the order of their first rows");
    let lengths: Vec<u32> = log.people.iter().map(|person| person.decisions).collect();
    assert_eq!(lengths, [2, 4]);
    assert_eq!(log.is_used, [true, true, true, false, true, false]);
    assert_eq!(log.is_available, [true, true, false, false, true, true]);
    assert_eq!(log.taken[..2], [1, 0]);
    assert_eq!(log.probabilities[..4], [0.5; 4]);
    // Without a message, action 0 is certain; the probability need not be there.
    assert_eq!(log.probabilities[4..6], [1.0, 0.0]);
    assert_eq!(log.probabilities[8..10], [0.75, 0.25]);
    assert_eq!(log.state[..4], [1.0, 2.0, 2.0, 4.0]);
    assert_eq!(log.lacking(0), Some((1, 5)));
    assert_eq!(
        log.notes,
        [
            "4 decisions of 2 people are used",
            "1 decisions have no outcome and are left out, the first in line 6",
            "1 decisions of 1 people, before or between others, are no rows of the file",
            "1 decisions have no `mood`, the first in line 5; estimates that read it leave them out",
            "1 decisions have no `twice`, the first in line 5; estimates that read it leave them out",
        ]
    );
}

#[test]
fn every_fault_of_a_file_is_said_at_once_with_its_line() {
    let rows = "a,0,0,1,2,0.5,1,1\na,1,0,0,1,0.5,1,1\na,2,0,1,1,1.5,1,1\na,3,0,maybe,1,0.5,1,1\n\
                a,4,0,1,1,0.5,1,1\na,4,0,1,1,0.5,1,1\n";
    // What is no number comes first, because the order of decisions depends on it.
    let said = faults(&parameters(rows));
    assert!(said.contains("line 5: column `free` has `maybe`, expected a number"), "{said}");
    let said = faults(&parameters(&rows.replace("maybe", "1")));
    assert!(said.contains("line 7: the same decision of person a as line 6"), "{said}");
    let said = faults(&parameters(&rows.replace("maybe", "3").replacen("a,4", "a,5", 1)));
    for expected in [
        "line 2: `action` is 2, expected a whole number from 0 to 1",
        "line 3: action 1 where `available` is 0",
        "line 4: `probability` is 1.5, expected a number from 0 to 1",
        "line 5: `available` is 3, expected 0 or 1",
        "5 faults in trial.csv",
    ] {
        assert!(said.contains(expected), "{expected}: {said}");
    }
    let certain = faults(&parameters("a,0,0,1,1,0,1,1\na,1,0,1,0,1,1,1\n"));
    assert!(certain.contains("line 2: action 1 was taken with the probability 0"), "{certain}");
    assert!(certain.contains("line 3: action 0 was taken with the probability 0"), "{certain}");
    let large = faults(&parameters("a,0,0,1,1,0.5,1e120,-2e110\n"));
    assert!(large.contains("line 2: `outcome` is 1e120, above 1e100 in size"), "{large}");
    assert!(large.contains("line 2: `mood` is -2e110"), "{large}");
    let empty = faults(&parameters("a,0,0,1,1,0.5,,1\n"));
    assert!(empty.contains("no decision has an action"), "{empty}");
}

#[test]
fn a_missing_probability_leaves_a_decision_out_and_rounding_is_no_probability() {
    let log = read(&parameters("a,0,0,1,0,,1,1\na,1,0,1,0,0.5,1,1\n")).unwrap();
    assert_eq!(log.is_used, [false, true]);
    let left_out = "1 decisions have no probability and are left out, the first in line 2";
    assert!(log.notes.contains(&left_out.to_owned()), "{:?}", log.notes);
    // Probabilities of two actions that add to 1 leave nothing for action 0.
    let two = |rows| LogParameters { probability: "p; 0.9 - p".to_owned(), ..parameters(rows) };
    let log = read(&two("a,0,0,1,1,0.2,1,1\n")).unwrap();
    assert!((log.probabilities[0] - 0.1).abs() < 1e-15);
    let sums = |rows| LogParameters { probability: "p; mood".to_owned(), ..parameters(rows) };
    let log = read(&sums("a,0,0,1,1,0.7,1,0.29999999999999993\n")).unwrap();
    assert_eq!(log.probabilities, [0.0, 0.7, 0.29999999999999993]);
    assert!(log.notes[1].contains("have an action with the probability 0 or 1"), "{:?}", log.notes);
    let said = faults(&sums("a,0,0,1,0,0.7,1,0.29999999999999993\n"));
    assert!(said.contains("line 2: action 0 was taken with the probability 0"), "{said}");
}

#[test]
fn an_order_of_huge_numbers_is_a_fault_and_no_panic() {
    let two = |rows: &str| LogParameters {
        order: "n; day".to_owned(),
        decisions_per_day: 5,
        ..parameters(rows)
    };
    for huge in ["1e308", "9007199254740993", "-1e12"] {
        for of in [two as fn(&str) -> LogParameters, parameters] {
            let said = faults(&of(&format!("a,{huge},0,1,1,0.5,1,1\na,0,0,1,1,0.5,1,1\n")));
            let expected = "line 2: the order of the decision is";
            assert!(said.contains(expected) && said.contains("up to 1e9"), "{said}");
        }
    }
    let person = |who: usize| format!("{who},0,0,1,1,0.5,1,1\n{who},1000,0,1,1,0.5,1,1\n");
    let rows: String = (0..12_000).map(person).collect();
    let said = faults(&parameters(&rows));
    assert!(said.contains("24000 rows, and with the decisions that the file skips more"), "{said}");
}

#[test]
fn expressions_name_columns_and_states_names() {
    let wrong = LogParameters {
        outcome: "log(afer)".to_owned(),
        person: "who + 1".to_owned(),
        state: "step = mood; mood = mood; mood = p; a b = p".to_owned(),
        probability: "none".to_owned(),
        ..parameters(ROWS)
    };
    let said = faults(&wrong);
    for expected in [
        "`person`: expected the name of a column",
        "`outcome`: the data have no column `afer`",
        "`state`: `step` is the name of something else",
        "`state`: `mood` is listed twice",
        "`state`: `a b` cannot be a name",
        "`probability`: expected 1 to 255 columns, found 0",
    ] {
        assert!(said.contains(expected), "{expected}: {said}");
    }
}

#[test]
fn people_enter_by_the_calendar_and_their_days_agree_with_the_order() {
    let by_day = |rows: &str| LogParameters {
        calendar_day: "day".to_owned(),
        decisions_per_day: 2,
        ..parameters(rows)
    };
    let rows = "a,0,3,1,0,0.5,1,1\na,1,3,1,0,0.5,1,1\na,2,4,1,0,0.5,1,1\nb,0,0,1,0,0.5,1,1\n";
    let log = read(&by_day(rows)).unwrap();
    assert!(log.stays().eq([(3, 5), (0, 1)]));
    assert_eq!(log.horizon(), 4);
    let said = faults(&by_day(&rows.replace("a,2,4", "a,2,5")));
    assert!(said.contains("line 4: `calendar_day` is 5, and decision 2 of person a"), "{said}");
    // Rows that are left out have their days, too.
    let unused = "a,0,3,1,0,0.5,,1\na,1,4,1,0,0.5,,1\na,2,4,1,0,0.5,1,1\n";
    let said = faults(&by_day(unused));
    assert!(said.contains("line 3: `calendar_day` is 4, and decision 1 of person a"), "{said}");
}

fn world(parameters: &LogParameters, lanes: usize) -> RecordedWorld {
    let log = Arc::new(read(parameters).unwrap());
    RecordedWorld::new(log, [0].into(), lanes)
}

#[test]
fn steps_are_those_of_the_file_whatever_is_chosen() {
    let mut lanes = world(&parameters(ROWS), 2);
    let mut streams = LaneStreams::Shared(Stream::new(1, Purpose::TestEnvironment));
    lanes.reset(LaneSet::All, &mut streams);
    let mut seen = Vec::new();
    while lanes.any_running() {
        let mut rewards = [0.0; 2];
        let recorded = lanes.recorded(1).map(|(action, p)| (action.index(), p.to_vec()));
        let counted = [lanes.is_counted(0), lanes.is_counted(1)];
        lanes.step(&[Action::from_index(1).unwrap(); 2], &mut rewards, &mut streams);
        seen.push((recorded.unwrap(), counted, rewards, lanes.reached().contains(1)));
    }
    let certain = (0, vec![1.0, 0.0]);
    assert_eq!(seen[0], (certain.clone(), [true, true], [2.0, 4.0], true));
    assert_eq!(seen[1], (certain, [true, false], [3.0, 0.0], false), "a gap");
    assert_eq!(seen[2], ((0, vec![0.75, 0.25]), [true, true], [0.0, 5.0], true));
    assert_eq!(seen[3], ((1, vec![0.75, 0.25]), [true, false], [0.0, 0.0], false));
    // The next lanes are the next people.
    let mut next = lanes.with_lanes(0).with_lanes(2);
    next.reset(LaneSet::All, &mut streams);
    assert_eq!(next.recorded(0).unwrap().0.index(), 1);
}

#[test]
fn the_contract_is_kept() {
    // The contract compares lanes with each other, so that everybody has the same decisions.
    let rows = |who: usize| {
        format!("{who},0,0,1,1,0.5,2,1\n{who},1,0,1,0,0.5,3,2\n{who},2,0,0,0,0.5,4,3\n")
    };
    let all: String = (0..8).map(rows).collect();
    contract::check(|lanes| world(&parameters(&all), lanes), 20).unwrap();
}

#[test]
fn a_stored_trial_knows_its_states_and_no_names_unless_they_are_kept() {
    let of = |parameters: LogParameters| -> Environment {
        (FAMILY.read)(&FAMILY, &parameters.to_values(), &[]).unwrap()
    };
    let environment = of(parameters(ROWS));
    assert_eq!(environment.state_names(), ["mood", "twice", "recorded_probability"]);
    let text = environment.description().unwrap();
    assert!(!text.contains("identifiers"), "{text}");
    let interface = environment.interface(&Scenario::all());
    // A store has the digest of the file alone.
    let model: &RecordedModel = environment.model().unwrap();
    let mut values = model.values();
    values[0] = FAMILY.keys[0].kind.value(&serde_json::json!(&values[0])).unwrap();
    let stored = (FAMILY.read)(&FAMILY, &values, &[]).unwrap();
    assert!(stored.state_names().is_empty());
    assert_eq!(stored.described(&text).unwrap().interface(&Scenario::all()), interface);
    let kept = of(LogParameters { keep_identifiers: true, ..parameters(ROWS) });
    assert!(kept.description().unwrap().contains("\"identifiers\":[\"b\",\"a\"]"));
}

#[test]
fn actions_are_counted_beside_their_probabilities() {
    let log = read(&parameters(ROWS)).unwrap();
    let Randomisation { groupings, counts } = &Randomisation::of(&log);
    let by: Vec<&str> = groupings.iter().map(|one| one.by.as_str()).collect();
    assert_eq!(by, ["all", "person", "day of the trial", "the action before", "mood", "twice"]);
    // The decision without an outcome counts, and the one without availability does not.
    let all = &groupings[0].groups[0];
    assert_eq!((all.decisions, all.taken, all.expected), (4, 2, 0.5 + 0.5 + 0.25 + 0.25));
    assert_eq!(all.variance, 2.0 * 0.25 + 2.0 * 0.1875);
    assert_eq!(all.fourth_cumulant, 2.0 * 0.25 * -0.5 + 2.0 * 0.1875 * -0.125);
    let moods: Vec<(&str, u64)> =
        groupings[4].groups.iter().map(|one| (one.name.as_str(), one.taken)).collect();
    assert_eq!(moods, [("1", 1), ("2", 0), ("3", 1)]);
    let count = |what: &str| counts.iter().find(|(known, _)| known.starts_with(what)).unwrap().1;
    assert_eq!([count("different"), count("decisions without"), count("people who")], [2, 1, 1]);
}

#[test]
fn each_of_several_messages_is_counted() {
    let rows = "a,0,0,1,2,0.4,1,1\na,1,0,1,1,0.4,1,1\na,2,0,1,2,0.4,1,1\n";
    let parameters = LogParameters { probability: format!("p{LIST}0.5 * p"), ..parameters(rows) };
    let Randomisation { groupings, .. } = Randomisation::of(&read(&parameters).unwrap());
    let by = |by: &str| -> Vec<(Option<usize>, Vec<u64>)> {
        let own = groupings.iter().filter(|one| one.by == by);
        own.map(|one| (one.action, one.groups.iter().map(|group| group.taken).collect())).collect()
    };
    assert_eq!(by("all"), [(None, vec![3]), (Some(1), vec![1]), (Some(2), vec![2])]);
    let by_day = [(None, vec![1; 3]), (Some(1), vec![0, 1, 0]), (Some(2), vec![1, 0, 1])];
    assert_eq!(by("day of the trial"), by_day);
    assert_eq!(by("person"), [], "there is one");
    let of_two = &groupings[2].groups[0];
    assert!((of_two.expected - 0.6).abs() < 1e-12 && (of_two.variance - 0.48).abs() < 1e-12);
    assert!((of_two.fourth_cumulant - 0.48 * 0.04).abs() < 1e-12);
}

#[test]
fn jobs_know_numbered_people_and_the_columns_that_are_read() {
    let of = |parameters: LogParameters| {
        let environment = (FAMILY.read)(&FAMILY, &parameters.to_values(), &[]).unwrap();
        let model: &RecordedModel = environment.model().unwrap();
        model.numbered().unwrap()
    };
    let quoted = ROWS.replace("b,", "\"B., Ann\",");
    let numbered = of(parameters(&quoted));
    let rows: Vec<&str> = numbered.text().unwrap().lines().collect();
    assert_eq!(
        rows[..4],
        ["who,n,free,sent,p,after,mood", "1,0,1,1,0.5,2,1", "1,1,1,0,0.5,3,2", "2,4,1,0,0.25,5,3"]
    );
    // Other names for the same people are the same trial, and so is the numbered text.
    assert_eq!(numbered, of(parameters(ROWS)));
    let again = Content::read(&LOG, numbered.text().unwrap()).unwrap();
    assert_eq!(numbered, again);
    assert_eq!(numbered, of(LogParameters { file: again, ..parameters(ROWS) }));
    let kept = of(LogParameters { keep_identifiers: true, ..parameters(&quoted) });
    assert!(kept.text().unwrap().contains("\n\"B., Ann\",0,"));
    // Who is a number that an expression reads is no name.
    let read = ROWS.replace("b,", "7,").replace("a,", "3,");
    let state = "mood = mood; twice = 2 * who".to_owned();
    let own = of(LogParameters { state, ..parameters(&read) });
    assert!(own.text().unwrap().contains("\n3,4,"));
}

#[test]
fn strict_alternation_is_no_chance() {
    // Shares agree with probabilities of 0.5 everywhere but after each action.
    let rows: String = (0..8).map(|n| format!("a,{n},{n},1,{},0.5,1,1\n", n % 2)).collect();
    let Randomisation { groupings, .. } = Randomisation::of(&read(&parameters(&rows)).unwrap());
    let before = groupings.iter().find(|one| one.by == "the action before").unwrap();
    let counts: Vec<(&str, u64, u64)> =
        before.groups.iter().map(|one| (one.name.as_str(), one.decisions, one.taken)).collect();
    assert_eq!(counts, [("0", 4, 4), ("1", 3, 0)]);
}

#[test]
fn who_enters_late_begins_with_the_first_row() {
    let person = |name: &str, first: u32| -> String {
        (first..first + 3).map(|n| format!("{name},{n},{n},1,1,0.5,1,1\n")).collect()
    };
    let lengths = |rows: String| -> Vec<u32> {
        read(&parameters(&rows)).unwrap().people.iter().map(|one| one.decisions).collect()
    };
    // Counting from 1: b lacks two decisions, and c entered later.
    assert_eq!(
        lengths(
            person("a", 1) + &person("d", 1) + &person("e", 1) + &person("b", 3) + &person("c", 40)
        ),
        [3, 3, 3, 5, 3]
    );
    // Where few begin with the smallest number, nobody's numbers say anything of others.
    assert_eq!(lengths(person("a", 1) + &person("b", 3)), [3, 3]);
}
