//! A trial in progress: who is in the study on a day, and when the agent learns.

use crate::agent::{LearnerError, StudyAgent, StudyUpdate};
use crate::env::{
    Action, EpisodeStatus, LaneSet, LaneStreams, Reports, Simulated, VectorEnvironment,
};
use crate::job::{Calendar, Pooling, Stay, Trial, UpdateData};
use crate::rng::{Purpose, Stream};
use crate::state::resumable;

/// An update of the agent of everybody.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TracedUpdate {
    /// The step of the trial before which it comes.
    pub time: u32,
    /// The data of steps before this one count.
    pub before: u32,
    /// The people whose data count, \[people\].
    pub people: Vec<bool>,
}

/// The calendar of a trial with this seed, and the time of the trial.
#[derive(Debug)]
pub struct Study {
    trial: Trial,
    calendar: Calendar,
    /// The stay of every person, which dropout may have shortened.
    stays: Vec<Stay>,
    /// The first day without each person: the end of the stay, or the day after the last one of a person whose episode
    /// has ended before.
    left: Vec<u32>,
    /// The row of the people's file that each person is; `None` if people are drawn.
    rows: Option<Vec<u32>>,
    /// Whether the outcome of a decision does not reach the agent, \[people, decisions\]; empty if all do.
    missing: Vec<bool>,
    /// The number of steps so far.
    time: u32,
    /// The people of every agent, \[agents\]\[people of the agent\], and the agent of every person, \[people\].
    agents: Vec<Vec<usize>>,
    agent_of: Vec<usize>,
    /// The number of updates so far of every agent, \[agents\]; it numbers the policy in force.
    policies: Vec<u32>,
    /// Whether the agent of everybody has learned before the present step.
    is_updated: bool,
    /// Whether the outcome of each person's last decision reached the agent.
    reached: Vec<bool>,
    /// Buffers: lanes that begin an episode, and people whose data count.
    entering: Vec<bool>,
    counting: Vec<bool>,
    /// Buffer: the probabilities of a record.
    recorded: Vec<f64>,
}

impl Study {
    /// A trial before its first day.
    ///
    /// # Panics
    /// If the files of the trial do not suit it; a manifest checks them.
    pub fn new(trial: &Trial, seed: u64) -> Study {
        let calendar = trial.calendar().expect("the manifest has checked the calendar");
        let rows = trial.rows(seed).expect("the manifest has checked the rows");
        let people = calendar.stays.len();
        let realities = (0..).map(|person| Stream::of_person(seed, Purpose::Reality, person));
        let mut stays = calendar.stays.clone();
        let mut missing = Vec::new();
        for (stay, mut stream) in stays.iter_mut().zip(realities) {
            // One word per day and per decision, so that equal seeds have equal realities.
            let days = stay.start + 1..stay.end;
            let leaves = days.filter(|_| stream.unit() < trial.dropout);
            stay.end = leaves.collect::<Vec<_>>().first().copied().unwrap_or(stay.end);
            if trial.missing_outcomes > 0.0 {
                missing
                    .extend((0..trial.decisions()).map(|_| stream.unit() < trial.missing_outcomes));
            }
        }
        let agents = calendar.agents();
        let mut agent_of = vec![0; people];
        for (agent, people) in agents.iter().enumerate() {
            people.iter().for_each(|person| agent_of[*person] = agent);
        }
        Study {
            trial: trial.clone(),
            calendar,
            left: stays.iter().map(|stay| stay.end).collect(),
            stays,
            rows,
            missing,
            time: 0,
            policies: vec![0; agents.len()],
            agents,
            agent_of,
            is_updated: false,
            reached: vec![true; people],
            entering: vec![false; people],
            counting: vec![false; people],
            recorded: Vec::new(),
        }
    }

    /// The random streams of the people.
    pub fn streams(&self, seed: u64) -> LaneStreams {
        let of_person = |person| Stream::of_person(seed, Purpose::Person, person);
        LaneStreams::PerLane((0..self.stays.len() as u32).map(of_person).collect())
    }

    pub fn people(&self) -> usize {
        self.stays.len()
    }

    /// The decisions of each person's stay, were no episode to end before, \[people\].
    pub fn stay_lengths(&self) -> Vec<u32> {
        let days = self.stays.iter().map(|stay| stay.end - stay.start);
        days.map(|days| days * self.calendar.per_day).collect()
    }

    /// The day, and the number of days.
    pub fn days(&self) -> (u32, u32) {
        (self.time / self.calendar.per_day, self.calendar.days())
    }

    /// The number of steps so far.
    pub(super) fn time(&self) -> u32 {
        self.time
    }

    /// The numbers that stand behind the recorded state of a person's decision at this step of the person: the calendar
    /// day, the number of the policy in force, and where outcomes can be missing, whether that of the decision reaches the
    /// agent.
    pub(super) fn beside(&self, person: usize, step: u32) -> impl Iterator<Item = f64> {
        let (day, _) = self.days();
        let policy = self.policies[self.agent_of[person]];
        let reached = !self.is_missing(person, step);
        let reached = (!self.missing.is_empty()).then_some(u32::from(reached));
        [day, policy].into_iter().chain(reached).map(f64::from)
    }

    /// The names of the numbers that stand behind the recorded state; the last ones are those of [`Study::beside`].
    pub(super) fn names(&self) -> impl Iterator<Item = String> {
        self.trial.recorded_names()
    }

    /// Whether the outcome of a person's decision does not reach the agent.
    fn is_missing(&self, person: usize, step: u32) -> bool {
        let decisions = self.trial.decisions() as usize;
        self.missing.get(person * decisions + step as usize).copied().unwrap_or_default()
    }

    /// Whether people's phones report before each decision; `None` if they always do.
    pub fn reports(trial: &Trial, seed: u64) -> Option<Reports> {
        if trial.unreported == 0.0 {
            return None;
        }
        let decisions = trial.decisions() as usize;
        let of_person = |person| {
            let mut stream = Stream::of_person(seed, Purpose::Reports, person);
            (0..decisions).map(move |_| stream.unit() >= trial.unreported)
        };
        Some(Reports { decisions, reported: (0..trial.people).flat_map(of_person).collect() })
    }

    pub fn is_over(&self) -> bool {
        self.time >= self.calendar.days() * self.calendar.per_day
    }

    /// Makes the people of an environment those of the trial.
    pub fn assign(&self, environment: &mut Simulated) {
        if let Some(rows) = &self.rows {
            environment.assign(rows);
        }
    }

    /// Prepares a step: at the first of a day, people leave, the agent learns, and people enter.
    ///
    /// **Errors**: as [`StudyAgent::update`].
    pub fn begin_step(
        &mut self,
        environment: &mut Simulated,
        agent: &mut dyn StudyAgent,
        streams: &mut LaneStreams,
    ) -> Result<(), LearnerError> {
        self.is_updated = false;
        if !self.time.is_multiple_of(self.calendar.per_day) {
            return Ok(());
        }
        let (day, _) = self.days();
        environment.begin_day(day);
        for (person, (stay, left)) in self.stays.iter().zip(&mut self.left).enumerate() {
            let is_running = environment.statuses()[person] == EpisodeStatus::Running;
            if stay.end == day && is_running {
                environment.leave(person);
            }
            if stay.start < day && environment.is_over(person) {
                *left = day.min(*left);
            }
        }
        let before = self.policies[0];
        self.update(day, agent)?;
        self.is_updated = self.trial.pooling.is_of_everybody() && self.policies[0] > before;
        let entering = self.entering.iter_mut().zip(&self.stays);
        entering.for_each(|(enters, stay)| *enters = stay.start == day);
        if self.entering.contains(&true) {
            environment.reset(LaneSet::Masked(&self.entering), streams);
            agent.reset(LaneSet::Masked(&self.entering));
        }
        Ok(())
    }

    /// Lets the people go who stay to the last day.
    pub fn end(&self, environment: &mut Simulated) {
        for person in 0..self.people() {
            if environment.statuses()[person] == EpisodeStatus::Running {
                environment.leave(person);
            }
        }
    }

    /// The update of the agent of everybody that the present step began with; `None` without one.
    pub(super) fn last_update(&self) -> Option<TracedUpdate> {
        let (day, _) = self.days();
        self.is_updated.then(|| TracedUpdate {
            time: self.time,
            before: self.data_before(day),
            people: self.counting.clone(),
        })
    }

    /// The step of the trial before which the data of an update on this day end.
    fn data_before(&self, day: u32) -> u32 {
        day.saturating_sub(self.trial.update_lag_days) * self.calendar.per_day
    }

    /// Updates the agents that are due on a day.
    fn update(&mut self, day: u32, agent: &mut dyn StudyAgent) -> Result<(), LearnerError> {
        let before = self.data_before(day);
        for number in 0..self.agents.len() {
            if !self.calendar.is_updated(&self.agents[number], day) {
                continue;
            }
            self.counting.fill(false);
            for person in &self.agents[number] {
                let has_entered = self.stays[*person].start < day;
                self.counting[*person] = match self.trial.update_data {
                    UpdateData::All => has_entered,
                    // A person's own agent never forgets.
                    UpdateData::InStudy if self.trial.pooling == Pooling::None => has_entered,
                    UpdateData::InStudy => has_entered && day <= self.left[*person],
                };
            }
            let own = (!self.trial.pooling.is_of_everybody()).then_some(number);
            agent.update(&StudyUpdate { people: &self.counting, before, agent: own })?;
            self.policies[number] += 1;
        }
        Ok(())
    }

    /// Replaces the choices of people in a trial that happened by the recorded ones, \[people\], from which the agent then
    /// learns. `probabilities` are those of the agent, \[people, actions\].
    pub(super) fn replay(
        &mut self,
        environment: &Simulated,
        agent: &mut dyn StudyAgent,
        actions: &mut [Action],
        probabilities: &[f64],
    ) {
        if environment.recorded(0).is_none() {
            return;
        }
        self.recorded.clear();
        self.recorded.extend_from_slice(probabilities);
        let rows = self.recorded.chunks_exact_mut(probabilities.len() / actions.len());
        for (person, (action, row)) in actions.iter_mut().zip(rows).enumerate() {
            if let Some((taken, chances)) = environment.recorded(person) {
                *action = taken;
                row.copy_from_slice(chances);
            }
        }
        agent.replay(actions, &self.recorded);
    }

    /// Ends a step, after which people have these numbers of steps, \[people\].
    pub fn end_step(&mut self, times: &[u32]) {
        self.end_step_among(times, LaneSet::All);
    }

    /// [`Study::end_step`], where the outcomes of the step can reach the agent in these lanes.
    pub(super) fn end_step_among(&mut self, times: &[u32], reached: LaneSet<'_>) {
        self.time += 1;
        if self.missing.is_empty() && reached == LaneSet::All {
            return;
        }
        for (person, time) in times.iter().enumerate() {
            let is_missing = *time > 0 && self.is_missing(person, time - 1);
            self.reached[person] = reached.contains(person) && !is_missing;
        }
    }

    /// The people whose last outcome reached the agent.
    pub fn reached(&self) -> LaneSet<'_> {
        LaneSet::Masked(&self.reached)
    }
}

resumable!([] TracedUpdate { parts time, before, people });
resumable!([] Study { parts time; fixed policies, left });

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::agent::{Agent, DecisionRule, LinearThompson, RuleParameters, Weights};
    use crate::env::StepCount;
    use crate::job::{EvaluatedOn, Evaluation, Job, RecordedDecisions, Results, STAYS};
    use crate::key::{Content, Keyed, Value};
    use crate::train::once_more::trace;
    use crate::train::training::{Stage, Training};

    fn trial(people: u32, days: u32) -> Trial {
        Trial::with_required(&[Value::Integer(people.into()), Value::Integer(days.into())])
    }

    /// The results of a trial. Habituation begins at 0 and grows by 1/8 with every message, so that untailored messages
    /// have the rewards 56, 48, 40, ….
    fn played(agent: Agent, trial: &Trial, seed: u64) -> Results {
        let job = job(agent, trial, seed);
        let mut training = Training::new(job.runnable().unwrap()).unwrap();
        while training.stage() != Stage::Over {
            training.advance(&|| false).unwrap();
        }
        training.results().unwrap()
    }

    fn job(agent: Agent, trial: &Trial, seed: u64) -> Job {
        let environment = StepCount {
            horizon: trial.decisions() as u32,
            initial_habituation: 0.0,
            delta_h: 0.0,
            epsilon_h: 0.125,
            epsilon_d: 0.0,
            rho_1: 64.0,
            rho_2: 256.0,
            mu: [0.0, 0.0],
            ..StepCount::paper(0.0)
        };
        Job {
            environment: environment.into(),
            scenario: "C".parse().unwrap(),
            agent,
            evaluation: Evaluation {
                test_episodes: 0,
                on: EvaluatedOn::Trial,
                record_decisions: RecordedDecisions::Test,
                ..Evaluation::default()
            },
            trial: Some(trial.clone()),
            seed,
        }
    }

    fn bandit() -> Agent {
        Agent::of(&LinearThompson { noise_sd: 256.0, prior_sd: 128.0, ..LinearThompson::default() })
    }

    /// Asserts that the bandit's posterior has the data of all recorded decisions but the hidden ones, by person from 1
    /// and step from 0. All sums are exact: features are 1 and the context, and the standard deviations are powers of 2.
    #[track_caller]
    fn assert_learned(results: &Results, hidden: &[(u32, u32)]) {
        let [prior, weight] = [0.5_f64.powi(14), 0.5_f64.powi(16)];
        let (mut precision, mut information) = ([[prior, 0.0, 0.0, prior]; 4], [[0.0; 2]; 4]);
        for decision in &results.decisions {
            if !hidden.contains(&(decision.episode, decision.step)) {
                let (action, context) = (usize::from(decision.action), decision.state[0]);
                let products = [1.0, context, context, context * context];
                let sums = precision[action].iter_mut().zip(products);
                sums.for_each(|(sum, product)| *sum += weight * product);
                information[action][0] += weight * decision.reward;
                information[action][1] += weight * context * decision.reward;
            }
        }
        let weights = Weights::from_bytes(results.weights.as_ref().unwrap()).unwrap();
        assert_eq!(weights.doubles["precision"].values, precision.as_flattened());
        assert_eq!(weights.doubles["information"].values, information.as_flattened());
    }

    #[test]
    fn the_posterior_of_a_trial_has_all_data_whatever_the_updates() {
        let early = Trial { decisions_per_day: 2, entry_every_days: 2, ..trial(3, 3) };
        let never = Trial { update_every_days: 0, ..early.clone() };
        let late = Trial { update_lag_days: 3, ..early.clone() };
        let forgetful = Trial { update_data: UpdateData::InStudy, ..early.clone() };
        for trial in [early, never, late, forgetful] {
            let results = played(bandit(), &trial, 1);
            assert_eq!(results.decisions.len(), 18);
            assert_learned(&results, &[]);
        }
    }

    #[test]
    fn a_trial_of_a_store_that_names_a_file_says_so() {
        let entry = Content::read(&STAYS, "start_day,end_day\n0,3\n1,3\n").unwrap();
        let job =
            Job { trial: Some(Trial { entry, ..trial(2, 3) }), ..job(bandit(), &trial(2, 3), 1) };
        assert!(job.runnable().is_ok());
        let stored = Job::from_canonical(&job.canonical()).unwrap();
        let says = "the job knows only the digest of its file `trial.entry`, as jobs of a store do; take the job from \
                    its manifest";
        assert_eq!(stored.runnable().unwrap_err().to_string(), says);
        assert_eq!(trace(&stored, &|| false).unwrap_err().to_string(), says);
    }

    #[test]
    fn a_return_is_the_sum_to_the_day_of_leaving() {
        let trial =
            Trial { decisions_per_day: 2, entry_every_days: 1, dropout: 0.4, ..trial(3, 3) };
        // The first person leaves after a day, the second stays, and the third leaves after two days.
        let is_so =
            |seed: &u64| Study::new(&trial, *seed).stays.iter().map(|stay| stay.end).eq([1, 4, 4]);
        let seed = (0..).find(is_so).unwrap();
        let untailored = Agent::of(&RuleParameters::new(DecisionRule::Untailored));
        let results = played(untailored, &trial, seed);
        let returns = results.episodes.iter().map(|episode| (episode.length, episode.total_reward));
        // 56 + 48, then 40 + 32, then 24 + 16.
        assert!(returns.eq([(2, 104.0), (6, 216.0), (4, 176.0)]));
    }

    #[test]
    fn a_hidden_outcome_counts_for_the_person_and_not_for_the_bandit() {
        let trial = Trial { missing_outcomes: 0.4, ..trial(2, 3) };
        let hidden = [false, true, false, true, false, false];
        let seed = (0..).find(|seed| Study::new(&trial, *seed).missing == hidden).unwrap();
        let results = played(bandit(), &trial, seed);
        assert_eq!(results.decisions.len(), 6);
        assert_learned(&results, &[(1, 1), (2, 0)]);
        let all: f64 = results.decisions.iter().map(|decision| decision.reward).sum();
        let returns = results.episodes.iter().map(|episode| episode.total_reward);
        assert_eq!((returns.sum::<f64>(), results.episodes[1].length), (all, 3));
    }

    #[test]
    fn the_last_posterior_acts_in_an_outage() {
        let trial = Trial { decisions_per_day: 4, outage: vec![2, 3], ..trial(4, 5) };
        let results = played(bandit(), &trial, 1);
        // By day and context, which is the whole state that the bandit sees.
        let mut probabilities = BTreeMap::new();
        for decision in &results.decisions {
            let [context, .., day, policy] = decision.state[..] else { unreachable!() };
            assert_eq!(policy, [0.0, 1.0, 1.0, 1.0, 2.0][day as usize]);
            let row = &decision.probabilities;
            let known = probabilities.entry((day as u8, context as u8)).or_insert(row);
            assert_eq!(*known, row);
        }
        for context in [0, 1] {
            let [before, first, second, after] =
                [1, 2, 3, 4].map(|day| probabilities[&(day, context)]);
            assert!(first == before && second == before && after != before, "{probabilities:?}");
        }
    }

    #[test]
    fn people_drop_out_at_the_hazard_of_a_day() {
        let study = Study::new(&Trial { dropout: 0.1, ..trial(10_000, 50) }, 3);
        let stayed = |day: u32| study.stays.iter().filter(|stay| stay.contains(day)).count() as f64;
        for day in [0, 1, 5, 20] {
            let expected = 10_000.0 * 0.9_f64.powi(day as i32);
            assert!(
                (stayed(day) - expected).abs() < 4.0 * expected.sqrt(),
                "{day}: {}",
                stayed(day)
            );
        }
        assert_eq!(Study::new(&trial(9, 50), 3).stays, [Stay { start: 0, end: 50 }; 9]);
    }

    #[test]
    fn phones_do_not_report_at_their_rate() {
        let unreported = Trial { unreported: 0.25, missing_outcomes: 0.5, ..trial(1000, 8) };
        let reports = Study::reports(&unreported, 3).unwrap();
        let silent = reports.reported.iter().filter(|reported| !**reported).count();
        assert_eq!((reports.decisions, reports.reported.len()), (8, 8000));
        assert!((silent as f64 - 2000.0).abs() < 4.0 * 1500f64.sqrt(), "{silent}");
        // Other realities have other words.
        let without = Trial { unreported: 0.0, ..unreported.clone() };
        assert_eq!(Study::new(&without, 3).missing, Study::new(&unreported, 3).missing);
        let alone = Trial { missing_outcomes: 0.0, ..unreported };
        assert_eq!(Study::reports(&alone, 3), Some(reports));
        assert_eq!(Study::reports(&without, 3), None);
    }

    #[test]
    fn missing_outcomes_are_hidden_at_their_rate() {
        let mut study = Study::new(&Trial { missing_outcomes: 0.25, ..trial(1000, 8) }, 3);
        let mut hidden = 0;
        for step in 1..=8 {
            study.end_step(&[step; 1000]);
            hidden += (0..1000).filter(|person| !study.reached().contains(*person)).count();
        }
        assert!((hidden as f64 - 2000.0).abs() < 4.0 * 1500f64.sqrt(), "{hidden}");
    }
}
