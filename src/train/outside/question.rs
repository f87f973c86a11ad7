//! What a program is asked in a step, and its answer.

use crate::agent::{Actions, certain};
use crate::env::{Action, EpisodeStatus, Observations, Simulated, VectorEnvironment};
use crate::external::{
    Choices, FromProgram, Probabilities, Program, ProgramError, SentRows, ToProgram,
};
use crate::job::Job;

use super::broken::unexpected;
use super::choice::{action, available, of_one, probability};

/// Maximum distance of the sum of the actions' probabilities from 1.
const TOLERANCE: f64 = 1e-3;

/// What a program is asked in a step.
pub(super) struct Question {
    /// The running lanes.
    pub(super) running: Vec<usize>,
    observations: Observations,
}

impl Question {
    pub(super) fn new(job: &Job) -> Question {
        let observations = job.task().observations().observations();
        Question { running: Vec::new(), observations }
    }

    /// Finds the running lanes.
    pub(super) fn find(&mut self, simulation: &Simulated) {
        self.running.clear();
        let statuses = simulation.statuses().iter().enumerate();
        let is_running = |(_, status): &(usize, &EpisodeStatus)| **status == EpisodeStatus::Running;
        self.running.extend(statuses.filter(is_running).map(|(lane, _)| lane));
    }

    /// The answer of a program to the observations of the running lanes; `moment` is the day of a trial and the decision
    /// of the day.
    ///
    /// **Errors**: as [`Program::receive`], which `when` and `stop` are for.
    pub(super) fn ask(
        &mut self,
        simulation: &Simulated,
        program: &mut Program,
        moment: Option<[u32; 2]>,
        when: &str,
        stop: &dyn Fn() -> bool,
    ) -> Result<Choices, ProgramError> {
        simulation.observe(&mut self.observations);
        let values = self.observations.take_written_out();
        let available = available(simulation, &self.running);
        program.send(&ToProgram::Act {
            day: moment.map(|[day, _]| day),
            decision: moment.map(|[_, decision]| decision),
            lanes: &self.running,
            observations: SentRows {
                width: values.len() / simulation.lanes(),
                values: &values,
                only: Some(&self.running),
            },
            available: available.as_deref(),
        });
        const EXPECTED: &str = "\"choices\"";
        match program.receive(EXPECTED, when, stop)? {
            FromProgram::Choices(choices) => Ok(choices),
            other => Err(unexpected(program, &other, EXPECTED)),
        }
    }
}

/// The destination of the choices of a step.
pub(super) struct Chosen<'a> {
    pub(super) running: &'a [usize],
    pub(super) actions: &'a mut [Action],
    /// \[lanes, actions\].
    pub(super) probabilities: &'a mut [f64],
}

impl Chosen<'_> {
    /// Reads choices. If the probabilities of all actions are given, `unit` returns the number in [0, 1) that selects
    /// the action of a lane; it is called once per running lane.
    ///
    /// **Errors**: a description of the fault in the choices.
    pub(super) fn read(
        self,
        choices: &Choices,
        how: Actions,
        unit: &mut dyn FnMut(usize) -> f64,
    ) -> Result<(), String> {
        let (count, width) = (self.running.len(), self.probabilities.len() / self.actions.len());
        let sized = |what: &str, found: usize| match found == count {
            true => Ok(()),
            false => {
                Err(format!("expected {count} {what}, one for each lane of \"act\", found {found}"))
            }
        };
        match (&choices.actions, &choices.probabilities) {
            (Some(actions), probabilities) => {
                sized("actions", actions.len())?;
                let with = match probabilities {
                    None => None,
                    Some(Probabilities::OfActions(with)) => Some(with),
                    // An empty list could be either kind.
                    Some(Probabilities::OfAll(_)) => {
                        return Err(
                            "expected one probability for each of `actions`, found lists".into()
                        );
                    }
                };
                if let Some(with) = with {
                    sized("probabilities", with.len())?;
                }
                for (index, lane) in self.running.iter().enumerate() {
                    let row = &mut self.probabilities[*lane * width..][..width];
                    self.actions[*lane] = action(Some(actions[index]), width, *lane)?;
                    let with = probability(with.map_or(1.0, |with| with[index]), *lane)?;
                    of_one(self.actions[*lane], with, row);
                }
            }
            (None, Some(Probabilities::OfAll(rows))) => {
                sized("rows of probabilities", rows.len())?;
                for (given, lane) in rows.iter().zip(self.running) {
                    let row = &mut self.probabilities[*lane * width..][..width];
                    share(given, row, *lane)?;
                    let chosen = match how {
                        Actions::AsTrained => drawn(row, unit(*lane)),
                        Actions::Greedy => likeliest(row),
                    };
                    self.actions[*lane] = Action::from_index(chosen).expect("one of the actions");
                    match how {
                        Actions::AsTrained => {}
                        Actions::Greedy => certain(self.actions[*lane], row),
                    }
                }
            }
            (None, Some(Probabilities::OfActions(_)) | None) => {
                return Err(format!(
                    "expected `actions`, or `probabilities` with a list of {width} for each lane; \
                     found neither"
                ));
            }
        }
        Ok(())
    }
}

/// Writes the probabilities of a row, normalised to sum to 1.
fn share(given: &[f64], row: &mut [f64], lane: usize) -> Result<(), String> {
    let sum: f64 = given.iter().sum();
    let fits = given.iter().all(|share| *share >= 0.0) && (sum - 1.0).abs() <= TOLERANCE;
    if !fits || given.len() != row.len() {
        let count = row.len();
        return Err(format!(
            "expected {count} probabilities that sum to 1 for lane {lane}, found {given:?}"
        ));
    }
    row.iter_mut().zip(given).for_each(|(own, share)| *own = share / sum);
    Ok(())
}

/// The action that a number in [0, 1) selects.
fn drawn(shares: &[f64], unit: f64) -> usize {
    let mut below = 0.0;
    let found = shares.iter().position(|share| {
        below += share;
        unit < below
    });
    // Rounding can leave the sum below the number, which then selects the last action with a positive
    // probability.
    let last = shares.iter().rposition(|share| *share > 0.0).unwrap_or_default();
    found.unwrap_or(last)
}

/// The action with the highest probability; ties go to the first.
fn likeliest(shares: &[f64]) -> usize {
    let best = |best: usize, one: usize| if shares[one] > shares[best] { one } else { best };
    (0..shares.len()).fold(0, best)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::{Purpose, Stream};

    fn read(choices: Choices, how: Actions) -> Result<(Vec<usize>, Vec<f64>), String> {
        let mut actions = [Action::default(); 3];
        let mut probabilities = [1.0, 0.0, 0.0, 0.0].repeat(3);
        let chosen =
            Chosen { running: &[0, 2], actions: &mut actions, probabilities: &mut probabilities };
        let mut stream = Stream::new(1, Purpose::TestActions);
        chosen.read(&choices, how, &mut |_| stream.unit())?;
        let with = actions.iter().zip(probabilities.chunks(4)).map(|(action, p)| p[action.index()]);
        Ok((actions.iter().map(|action| action.index()).collect(), with.collect()))
    }

    #[test]
    fn choices_go_to_the_running_lanes() {
        let with = Some(Probabilities::OfActions(vec![0.5, 0.25]));
        let choices = Choices { actions: Some(vec![3, 1]), probabilities: with };
        let read_as = read(choices, Actions::Greedy).unwrap();
        assert_eq!(read_as, (vec![3, 0, 1], vec![0.5, 1.0, 0.25]));
        let rows = vec![vec![0.0, 0.6, 0.4, 0.0], vec![0.25; 4]];
        let all =
            || Choices { actions: None, probabilities: Some(Probabilities::OfAll(rows.clone())) };
        assert_eq!(read(all(), Actions::Greedy).unwrap(), (vec![1, 0, 0], vec![1.0; 3]));
        let (actions, probabilities) = read(all(), Actions::AsTrained).unwrap();
        assert!(actions[0] == 1 || actions[0] == 2);
        assert_eq!(probabilities[0], rows[0][actions[0]]);
        assert_eq!(probabilities[2], 0.25);
    }

    #[test]
    fn draws_follow_the_shares() {
        let shares = [0.1, 0.0, 0.6, 0.3];
        for (unit, expected) in [(0.0, 0), (0.099, 0), (0.1, 2), (0.69, 2), (0.71, 3), (0.999, 3)] {
            assert_eq!(drawn(&shares, unit), expected, "{unit}");
        }
        assert_eq!(drawn(&[0.5, 0.49, 0.0, 0.0], 0.999), 1);
        assert_eq!(likeliest(&[0.1, 0.4, 0.4, 0.1]), 1);
    }

    #[test]
    fn faulty_choices_are_described() {
        let fault = |actions: &[i64], with: Option<Probabilities>| {
            let actions = (!actions.is_empty()).then(|| actions.to_vec());
            read(Choices { actions, probabilities: with }, Actions::AsTrained).unwrap_err()
        };
        let all = |rows: Vec<Vec<f64>>| Some(Probabilities::OfAll(rows));
        for (fault, expected) in [
            (fault(&[1], None), "expected 2 actions, one for each lane of \"act\", found 1"),
            (fault(&[1, 4], None), "expected an action from 0 to 3 for lane 2, found 4"),
            (fault(&[-1, 0], None), "expected an action from 0 to 3 for lane 0, found -1"),
            (fault(&[], None), "found neither"),
            (
                fault(&[], all(vec![vec![0.5; 4]; 2])),
                "sum to 1 for lane 0, found [0.5, 0.5, 0.5, 0.5]",
            ),
            (fault(&[], all(vec![vec![1.0]; 2])), "expected 4 probabilities"),
            (fault(&[], all(vec![vec![1.5, -0.5, 0.0, 0.0]; 2])), "sum to 1 for lane 0"),
            (
                fault(&[1, 1], Some(Probabilities::OfActions(vec![0.0, 1.0]))),
                "expected a probability above 0 and at most 1 for lane 0, found 0",
            ),
        ] {
            assert!(fault.contains(expected), "{fault}");
        }
    }
}
