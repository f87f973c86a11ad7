//! Claims: a job has one run at a time, whichever process asks, is killed or comes back.

use std::collections::HashSet;
use std::thread;

use jitai::job::{Job, JobKey};
use jitai::job::{Outcome, Results};
use jitai::store::{
    self, Claimed, Finished, Isolation, JobState, Reader, RetryFailed, RunEnd, Store, StoreError,
};

use super::sample::{Sample, completed, dqn, failed, number, provenance, results, rule};

fn state(sample: &Sample, job: &Job) -> JobState {
    Reader::open(&sample.path).unwrap().job_states([&job.key()]).unwrap()[0]
}

#[test]
fn a_job_is_claimed_by_one_and_then_completed() {
    let job = dqn(0.4, 1);
    let mut sample = Sample::with(std::slice::from_ref(&job));
    assert_eq!(state(&sample, &job), JobState::Pending);

    let claim = sample.claim(&job);
    assert_eq!((claim.attempt, claim.job_key), (1, job.key()));
    assert_eq!(state(&sample, &job), JobState::Running);
    let mut other = Store::open(&sample.path).unwrap();
    let session = other.begin_session(&provenance()).unwrap();
    let again = other.claim(session, &job.key(), RetryFailed::Yes, Isolation::Shared).unwrap();
    assert_eq!(again, Claimed::HeldElsewhere);

    sample.store.finish(&claim, &completed(), 1.5).unwrap();
    assert_eq!(state(&sample, &job), JobState::Completed);
    let again = other.claim(session, &job.key(), RetryFailed::Yes, Isolation::Shared).unwrap();
    assert_eq!(again, Claimed::Completed);
}

#[test]
fn an_interrupted_job_is_claimed_again() {
    let job = dqn(0.4, 1);
    let mut sample = Sample::with(std::slice::from_ref(&job));
    sample.run(&job, &Outcome::Interrupted);
    assert_eq!(state(&sample, &job), JobState::Interrupted);
    assert_eq!(sample.claim(&job).attempt, 2);
}

#[test]
fn a_failed_job_is_claimed_again_when_asked_and_once_a_session() {
    let job = dqn(0.4, 1);
    let mut sample = Sample::with(std::slice::from_ref(&job));
    sample.run(&job, &failed());
    let session = sample.session;
    let mut claim =
        |session, retry| sample.store.claim(session, &job.key(), retry, Isolation::Shared).unwrap();
    assert_eq!(claim(session, RetryFailed::No), Claimed::Failed);
    assert_eq!(claim(session, RetryFailed::Yes), Claimed::Failed);

    sample.session = sample.store.begin_session(&provenance()).unwrap();
    let claim = sample.claim(&job);
    assert_eq!(claim.attempt, 2);
    sample.store.finish(&claim, &failed(), 1.5).unwrap();
    let again = sample
        .store
        .claim(sample.session, &job.key(), RetryFailed::Yes, Isolation::Shared)
        .unwrap();
    assert_eq!(again, Claimed::Failed);
}

#[test]
fn a_failure_outlasts_an_interrupted_retry() {
    let job = dqn(0.4, 1);
    let mut sample = Sample::with(std::slice::from_ref(&job));
    sample.run(&job, &failed());
    sample.session = sample.store.begin_session(&provenance()).unwrap();
    sample.run(&job, &Outcome::Interrupted);
    assert_eq!(state(&sample, &job), JobState::Failed);
    let again =
        sample.store.claim(sample.session, &job.key(), RetryFailed::No, Isolation::Shared).unwrap();
    assert_eq!(again, Claimed::Failed);
}

#[test]
fn a_job_of_no_experiment_cannot_be_claimed() {
    let mut sample = Sample::new();
    let error =
        sample.store.claim(sample.session, &dqn(0.4, 1).key(), RetryFailed::No, Isolation::Shared);
    assert!(matches!(error, Err(StoreError::UnknownJob { .. })), "{error:?}");
}

#[test]
fn two_processes_with_one_list_never_share_a_job() {
    let jobs: Vec<Job> = (1..=60).map(|seed| dqn(0.4, seed)).collect();
    let sample = Sample::with(&jobs);
    let work = || -> Vec<JobKey> {
        let mut store = Store::open(&sample.path).unwrap();
        let session = store.begin_session(&provenance()).unwrap();
        let mut done = Vec::new();
        for job in &jobs {
            match store.claim(session, &job.key(), RetryFailed::No, Isolation::Shared).unwrap() {
                Claimed::Claimed(claim) => {
                    store.finish(&claim, &completed(), 0.1).unwrap();
                    done.push(job.key());
                }
                Claimed::Completed | Claimed::HeldElsewhere => {}
                Claimed::Failed | Claimed::Suspect => panic!("nothing fails here"),
            }
        }
        done
    };
    let done: Vec<JobKey> = thread::scope(|scope| {
        let workers: Vec<_> = (0..3).map(|_| scope.spawn(work)).collect();
        workers.into_iter().flat_map(|worker| worker.join().unwrap()).collect()
    });
    assert_eq!(done.len(), jobs.len());
    assert_eq!(done.iter().collect::<HashSet<_>>().len(), jobs.len());
    assert_eq!(number(&sample.raw(), "SELECT count(*) FROM run WHERE status = 'completed'"), 60);
    assert_eq!(number(&sample.raw(), "SELECT count(*) FROM run"), 60);
}

#[cfg(target_os = "linux")]
#[test]
fn the_run_of_a_killed_process_is_taken_over_and_it_cannot_write_any_more() {
    let job = dqn(0.4, 1);
    let mut sample = Sample::with(std::slice::from_ref(&job));
    let lost = sample.claim(&job);
    sample.kill(sample.session);
    assert_eq!(state(&sample, &job), JobState::Interrupted);

    let mut other = Store::open(&sample.path).unwrap();
    let session = other.begin_session(&provenance()).unwrap();
    let Claimed::Claimed(claim) =
        other.claim(session, &job.key(), RetryFailed::No, Isolation::Shared).unwrap()
    else {
        panic!("the job of a dead process is free");
    };
    assert_eq!(claim.attempt, 2);
    for outcome in [completed(), failed(), Outcome::Interrupted] {
        let error = sample.store.finish(&lost, &outcome, 1.0).unwrap_err();
        assert!(matches!(error, StoreError::ClaimLost { key } if key == job.key()), "{error}");
    }
    let raw = sample.raw();
    assert_eq!(number(&raw, "SELECT count(*) FROM run_metric"), 0);
    assert_eq!(number(&raw, "SELECT count(*) FROM run WHERE status = 'running'"), 1);
    other.finish(&claim, &completed(), 1.0).unwrap();
    assert_eq!(number(&raw, "SELECT attempt FROM run WHERE status = 'completed'"), 2);
    assert!(other.finish(&claim, &completed(), 1.0).is_err(), "a run is finished once");
}

#[test]
fn runs_that_end_together_are_stored_but_for_those_that_were_lost() {
    let jobs: Vec<Job> = (1..=4).map(|seed| dqn(0.4, seed)).collect();
    let mut sample = Sample::with(&jobs);
    let claims: Vec<_> = jobs.iter().map(|job| sample.claim(job)).collect();
    let taken = format!(
        "UPDATE run SET status = 'interrupted', ended_at = '2026-01-31T12:00:00.000Z'
         WHERE job = (SELECT id FROM job WHERE key = '{}')",
        jobs[1].key()
    );
    sample.raw().execute_batch(&taken).unwrap();
    let outcomes = [completed(), completed(), failed(), Outcome::Interrupted];
    let ends: Vec<RunEnd> = claims
        .iter()
        .zip(&outcomes)
        .map(|(claim, outcome)| RunEnd { claim, outcome, wall_seconds: 1.0 })
        .collect();
    let finished = sample.store.finish_all(&ends).unwrap();
    use Finished::{ClaimLost, Stored};
    assert_eq!(finished, [Stored, ClaimLost, Stored, Stored]);
    use JobState::{Completed, Failed, Interrupted};
    let states: Vec<_> = jobs.iter().map(|job| state(&sample, job)).collect();
    assert_eq!(states, [Completed, Interrupted, Failed, Interrupted]);
    assert_eq!(number(&sample.raw(), "SELECT count(*) FROM trained_weights"), 1);
}

#[cfg(target_os = "linux")]
#[test]
fn dead_sessions_are_released_and_living_ones_are_not() {
    let jobs = [dqn(0.4, 1), dqn(0.4, 2)];
    let mut sample = Sample::with(&jobs);
    sample.claim(&jobs[0]);
    let dead = sample.session;
    sample.session = sample.store.begin_session(&provenance()).unwrap();
    sample.claim(&jobs[1]);
    let session = sample.store.begin_session(&provenance()).unwrap();
    assert_eq!(sample.store.release_dead_sessions(session).unwrap(), 0);

    sample.kill(dead);
    // The age of the last heartbeat is irrelevant, because the process may be stopped.
    let old = "UPDATE session SET heartbeat_at = '2026-01-31T12:00:00.000Z'";
    sample.raw().execute(old, []).unwrap();
    assert_eq!(sample.store.release_dead_sessions(session).unwrap(), 1);
    assert_eq!(state(&sample, &jobs[0]), JobState::Interrupted);
    assert_eq!(state(&sample, &jobs[1]), JobState::Running);
}

#[test]
fn ending_a_session_interrupts_what_it_holds() {
    let job = dqn(0.4, 1);
    let mut sample = Sample::with(std::slice::from_ref(&job));
    sample.claim(&job);
    sample.store.end_session(sample.session).unwrap();
    assert_eq!(state(&sample, &job), JobState::Interrupted);
    assert_eq!(number(&sample.raw(), "SELECT ended_at IS NOT NULL FROM session"), 1);
}

#[test]
fn a_run_without_weights_is_stored_and_the_caller_judges_it() {
    let jobs = [rule(0.4, 1), dqn(0.4, 1)];
    let mut sample = Sample::with(&jobs);
    let without = Outcome::Completed(Results { weights: None, curve: Vec::new(), ..results() });
    jobs.iter().for_each(|job| sample.run(job, &without));
    let found = Reader::open(&sample.path).unwrap().weights(&jobs[0].key().to_string()).unwrap();
    assert_eq!((&found.job, found.safetensors), (&jobs[0], None));
    let check_weights =
        |job: &Job, weights: Option<&[u8]>| match (job.agent.algorithm().learns(), weights) {
            (false, None) => Ok(()),
            (_, weights) => Err(format!("{weights:?} of a trained agent")),
        };
    let findings = store::examine(&sample.path, &check_weights).unwrap().findings;
    let about_weights: Vec<_> =
        findings.iter().filter(|finding| finding.what.contains("weights")).collect();
    let [finding] = about_weights.as_slice() else { panic!("{findings:?}") };
    assert_eq!(finding.job_key, Some(jobs[1].key().to_string()));
    assert_eq!(finding.what, "its weights do not load: None of a trained agent");
}

#[test]
fn results_are_stored_whole_or_not_at_all() {
    let job = dqn(0.4, 1);
    let mut sample = Sample::with(std::slice::from_ref(&job));
    let claim = sample.claim(&job);
    let mut faulty = results();
    faulty.episodes[1].total_reward = f64::INFINITY;
    let without_episodes = Results { episodes: Vec::new(), ..results() };
    for results in [faulty, without_episodes] {
        let outcome = Outcome::Completed(results);
        let error = sample.store.finish(&claim, &outcome, 1.0).unwrap_err().to_string();
        assert!(error.contains("failed to store the end of a run"), "{error}");
    }
    let raw = sample.raw();
    assert_eq!(number(&raw, "SELECT count(*) FROM run_metric"), 0);
    assert_eq!(number(&raw, "SELECT count(*) FROM test_episode"), 0);
    assert_eq!(state(&sample, &job), JobState::Running);
    sample.store.finish(&claim, &completed(), 1.0).unwrap();
}
