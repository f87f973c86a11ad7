//! Environments that are outside programs: programs that keep the contract, and programs that break it.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::time::{Duration, Instant};

use jitai::env::outside::{
    Description, EnvironmentProgram, EpisodePhase, Launch, OutsideEnvironment, try_program,
};
use jitai::env::{Action, EpisodeStatus, LaneSet, LaneStreams, VectorEnvironment};
use jitai::external::StopRequested;
use jitai::rng::{Purpose, Stream};
use serde_json::json;
use tempfile::TempDir;

use crate::support::assert_within;

/// A counter: the observation is the number of steps over 10, action 1 pays 1, and the sixth step ends the
/// episode. Faults replace lines of this program.
pub const COUNTER: &str = r#"
import json, random, sys, time
sets = {}
def say(**answer):
    print(json.dumps(answer), flush=True)
for line in sys.stdin:
    message = json.loads(line)
    kind = message["type"]
    if kind == "describe":
        features = [{"name": "count", "low": 0, "high": 1}, {"name": "chance", "unit": "m"}]
        say(type="description", protocol=1, features=features, actions=["wait", "pay"],
            nothing="wait", horizon=6, reward=[0, 1], state=["twice"])
    elif kind == "begin":
        lanes = sets[message["instance"]] = {}
    elif kind == "reset":
        lanes = sets[message["instance"]]
        for lane, seed in zip(message["lanes"], message["seeds"]):
            lanes[lane] = [0, random.Random(seed)]
        rows = [[lanes[lane][0] / 10, lanes[lane][1].random()] for lane in message["lanes"]]
        say(type="began", observations=rows, state=[[2 * lanes[lane][0]] for lane in message["lanes"]])
    elif kind == "step":
        lanes = sets[message["instance"]]
        for lane in message["lanes"]:
            lanes[lane][0] += 1
        rows = [[lanes[lane][0] / 10, lanes[lane][1].random()] for lane in message["lanes"]]
        rewards = message["actions"]
        ends = [lanes[lane][0] >= 6 for lane in message["lanes"]]
        say(type="stepped", observations=rows, rewards=rewards, truncated=ends,
            state=[[2 * lanes[lane][0]] for lane in message["lanes"]])
    elif kind == "end":
        break
"#;

/// A folder with a program.
struct Programmed(TempDir);

impl Programmed {
    fn with(program: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("program.py"), program).unwrap();
        Programmed(folder)
    }

    fn launch(&self) -> Launch {
        launch("program.py", self.0.path())
    }

    fn start(&self) -> EnvironmentProgram {
        EnvironmentProgram::start(&self.launch(), never()).unwrap()
    }
}

fn launch(program: &str, folder: &Path) -> Launch {
    let parameters = json!({"dose": 1.0, "fatigue": 0.2});
    Launch {
        command: vec!["python3".to_owned(), program.to_owned()],
        folder: folder.to_owned(),
        version: "1".to_owned(),
        parameters: parameters.as_object().unwrap().clone(),
    }
}

fn never() -> StopRequested {
    Arc::new(|| false)
}

fn streams(seeds: &[u64]) -> LaneStreams {
    let stream = |seed: &u64| Stream::new(*seed, Purpose::Environment);
    LaneStreams::PerLane(seeds.iter().map(stream).collect())
}

fn lanes_of(program: &EnvironmentProgram, lanes: usize) -> OutsideEnvironment {
    OutsideEnvironment::new(program, EpisodePhase::Train, &[0, 1], true, lanes)
}

fn rows(environment: &OutsideEnvironment) -> Vec<Vec<f32>> {
    let mut out = environment.observation_spec().observations();
    environment.observe(&mut out);
    (0..out.rows()).map(|row| out.row(row).to_vec()).collect()
}

fn shipped(name: &str) -> (Launch, PathBuf) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("experiments/external");
    (launch(name, &folder), folder)
}

#[test]
fn the_shipped_environment_in_plain_python_passes_its_trial() {
    let (launch, _) = shipped("two_messages.py");
    let trial = try_program(&launch, never()).unwrap();
    assert!(trial.speeds.iter().all(|(_, speed)| *speed > 100.0), "{:?}", trial.speeds);
    let description = trial.description;
    assert_eq!(description.actions, ["nothing", "message"]);
    assert_eq!((description.nothing, description.horizon), (Some(0), 60));
    let features: Vec<&str> = description.features.iter().map(|one| &one.name[..]).collect();
    assert_eq!(features, ["receptivity", "burden", "day"]);
    assert_eq!((description.unit.as_deref(), description.highest_reward), (Some("minutes"), None));
    let json = serde_json::to_string(&description).unwrap();
    assert_eq!(serde_json::from_str::<Description>(&json).unwrap(), description);
}

#[test]
fn lanes_begin_and_end_one_by_one_and_sets_of_lanes_exist_together() {
    let folder = Programmed::with(COUNTER);
    let program = folder.start();
    let (mut train, mut test) = (lanes_of(&program, 2), lanes_of(&program, 3));
    let (mut first, mut second) = (streams(&[1, 2]), streams(&[3, 4, 5]));
    assert!(!train.any_running());
    train.reset(LaneSet::All, &mut first);
    test.reset(LaneSet::Masked(&[true, false, true]), &mut second);
    let actions = [Action::from_index(1).unwrap(); 3];
    let mut rewards = [9.0; 3];
    for _ in 0..3 {
        train.step(&actions[..2], &mut rewards[..2], &mut first);
    }
    train.reset(LaneSet::Masked(&[false, true]), &mut first);
    train.step(&actions[..2], &mut rewards[..2], &mut first);
    let counts = |of: &OutsideEnvironment| rows(of).iter().map(|row| row[0]).collect::<Vec<_>>();
    assert_eq!(counts(&train), [0.4, 0.1]);
    assert_eq!((train.state(0), train.state(1)), (&[8.0][..], &[2.0][..]));
    assert_eq!(counts(&test), [0.0, 0.0, 0.0]);
    for _ in 0..6 {
        test.step(&actions, &mut rewards, &mut second);
    }
    assert_eq!(rewards, [1.0, 0.0, 1.0]);
    assert_eq!(test.statuses(), [EpisodeStatus::Truncated; 3]);
    assert!(!test.any_running() && train.any_running());
    let before = rows(&test);
    test.step(&actions, &mut rewards, &mut second);
    assert_eq!((rewards, rows(&test)), ([0.0; 3], before));
    assert!(program.failure().is_none());
    program.finish();
}

#[test]
fn the_agent_sees_the_features_of_its_scenario_and_their_history() {
    let folder = Programmed::with(COUNTER);
    let program = folder.start();
    let shown = OutsideEnvironment::new(&program, EpisodePhase::Test, &[0], false, 1);
    let mut shown = shown.with_history(2);
    let names = |of: &OutsideEnvironment| {
        of.observation_spec().features.into_iter().map(|one| one.name).collect::<Vec<_>>()
    };
    assert_eq!(names(&shown), ["count-1", "count"]);
    let mut stream = streams(&[1]);
    shown.reset(LaneSet::All, &mut stream);
    shown.step(&[Action::default()], &mut [0.0], &mut stream);
    shown.step(&[Action::default()], &mut [0.0], &mut stream);
    assert_eq!(rows(&shown), [[0.1, 0.2]]);
    assert!(shown.state(0).is_empty());
    assert_eq!(names(&lanes_of(&program, 1)), ["count", "chance"]);
    assert_eq!(lanes_of(&program, 1).observation_spec().features[1].low, f32::NEG_INFINITY);
}

#[test]
fn numbers_may_be_written_in_base64() {
    let base64 = "
import array, base64
def text(values):
    return base64.b64encode(array.array('d', values).tobytes()).decode()
def say(**answer):
    for name in ('observations', 'state'):
        if name in answer and kind != 'describe':
            answer[name] = text(sum(answer[name], []))
    for name in ('rewards', 'truncated'):
        if name in answer:
            answer[name] = text(answer[name])
    print(json.dumps(answer), flush=True)
for line";
    let plain = Programmed::with(COUNTER);
    let packed = Programmed::with(&COUNTER.replace("\nfor line", base64));
    let walks = [&plain, &packed].map(|folder| {
        let program = folder.start();
        let mut lanes = lanes_of(&program, 2);
        let mut stream = streams(&[1, 2]);
        lanes.reset(LaneSet::All, &mut stream);
        let mut seen = Vec::new();
        let mut rewards = [0.0; 2];
        for step in 0..7 {
            let actions = [Action::from_index(step % 2).unwrap(), Action::default()];
            lanes.step(&actions, &mut rewards, &mut stream);
            seen.push((rows(&lanes), rewards, lanes.statuses().to_vec(), lanes.state(1).to_vec()));
        }
        assert!(program.failure().is_none());
        seen
    });
    assert_eq!(walks[0].len(), 7);
    assert_eq!(walks[0], walks[1]);
}

/// The failure of the counter with these replacements, in a walk of two lanes.
#[track_caller]
fn failure(replacements: &[(&str, &str)]) -> String {
    let mut program = COUNTER.to_owned();
    for (from, to) in replacements {
        assert!(program.contains(from), "{from}");
        program = program.replace(from, to);
    }
    let folder = Programmed::with(&program);
    let started = match EnvironmentProgram::start(&folder.launch(), never()) {
        Ok(program) => program,
        Err(error) => return error.to_string(),
    };
    let mut lanes = lanes_of(&started, 2);
    let mut stream = streams(&[1, 2]);
    let mut rewards = [7.0; 2];
    for _ in 0..8 {
        lanes.reset(LaneSet::All, &mut stream);
        for _ in 0..8 {
            lanes.step(&[Action::default(); 2], &mut rewards, &mut stream);
        }
    }
    let error = started.failure().expect("a failure");
    assert_eq!(rewards, [0.0; 2]);
    assert!(!lanes.any_running());
    error.to_string()
}

#[test]
fn every_fault_of_a_description_is_named() {
    let features = |features: &str| {
        let from = r#"[{"name": "count", "low": 0, "high": 1}, {"name": "chance", "unit": "m"}]"#;
        failure(&[(from, features)])
    };
    for (fault, expected) in [
        (features("[]"), "`features`: expected 1 to 1000 entries, found 0"),
        (
            features("[{'name': 'a b'}]"),
            "expected names of 1 to 64 letters, digits and underscores",
        ),
        (features("[{'name': 'a'}, {'name': 'a'}]"), "`features`: the name `a` occurs twice"),
        (features("[{'name': 'a', 'low': 1, 'high': 1}]"), "expected `low` below `high` for `a`"),
        (features("[{'name': 'a', 'low': -1e300}]"), "a bound of `a` is too large"),
        (features("[{'name': 'a', 'lo': 1}]"), "unknown field `lo`"),
        (failure(&[(r#"["wait", "pay"]"#, r#"["wait"]"#)]), "`actions`: expected 2 to 256 entries"),
        (failure(&[(r#"nothing="wait""#, r#"nothing="x""#)]), "expected the name of an action"),
        (failure(&[("horizon=6", "horizon=0")]), "`horizon`: expected a number of steps from 1"),
        (
            failure(&[("reward=[0, 1]", "reward=[1, 0]")]),
            "the smallest reward is above the largest",
        ),
        (failure(&[("protocol=1", "protocol=2")]), "expected protocol 1, found 2"),
        (failure(&[("horizon=6, ", "")]), "missing field `horizon`"),
        (failure(&[("type=\"description\"", "type=\"ready\"")]), "unknown variant `ready`"),
        (
            failure(&[
                ("state=[\"twice\"])", "state=[], availability=True)"),
                ("nothing=\"wait\", ", ""),
            ]),
            "`availability` needs `nothing`, the name of the first action",
        ),
        (
            failure(&[("nothing=\"wait\"", "nothing=\"pay\"")]),
            "`nothing`: expected the first action, `wait`, found `pay`",
        ),
    ] {
        assert!(fault.contains(expected), "{expected}\n{fault}");
        assert!(fault.contains("`python3 program.py`"), "{fault}");
    }
}

#[test]
fn every_fault_in_an_episode_is_named() {
    let stepped = r#"say(type="stepped","#;
    for (replacements, expected) in [
        ([("rewards=rewards", "rewards=[]")], "expected 2 numbers as `rewards`"),
        (
            [("rewards=rewards", "rewards=[2, 0]")],
            "expected a reward from 0 to 1 in lane 0, found 2",
        ),
        ([("rewards=rewards, ", "")], "expected `rewards`, found none"),
        ([("rewards=rewards", "reward=rewards")], "unknown field `reward`"),
        ([("rewards=rewards", "rewards=[None, None]")], "expected a number"),
        ([("rewards=rewards", "rewards=[float('nan'), 0]")], "JSON has no NaN and no infinity"),
        (
            [("lanes[lane][0] / 10", "lanes[lane][0] / 4")],
            "expected `count` from 0 to 1 in lane 0, found 1.25 (observations lie inside their bounds) \
             in step 5 of phase \"train\"",
        ),
        ([("lanes[lane][1].random()]", "1e300]")], "expected `chance` from -inf to inf in lane 0"),
        (
            [("lanes[lane][1].random()]", "16777217]")],
            "expected `chance` in lane 0 as a number that 32 bits hold, found 16777217: whole numbers above 16,777,216 \
             are rounded",
        ),
        ([("observations=rows, rew", "observations=rows[:1], rew")], "found 1 rows of 2"),
        (
            [("observations=rows, rew", "observations=[[0.1], [0.1]], rew")],
            "expected 2 rows of 2 numbers as `observations`, one for each lane of the message, found 2 \
             rows of 1",
        ),
        (
            [("observations=rows, rew", "observations=[[0.1, 0.2], [0.1]], rew")],
            "expected rows of equal length",
        ),
        ([("observations=rows, rew", "observations='AAA', rew")], "expected stepped"),
        ([("truncated=ends", "truncated=[True]")], "expected 2 numbers as `truncated`"),
        (
            [("truncated=ends", "truncated=[0.5, 0]")],
            "expected true or false as `truncated`, found 0.5",
        ),
        ([(">= 6", ">= 7")], "expected the episode of lane 0 to end within the horizon, 6 steps"),
        ([("type=\"began\",", "type=\"began\", truncated=[True, True],")], "after its reset"),
        ([("type=\"began\"", "type=\"stepped\"")], "expected began, found stepped"),
        ([(stepped, "say(available=[True, True], type='stepped',")], "only with \"availability\""),
        ([("state=[[2 * lanes[lane][0]] for lane in message[\"lanes\"]])", "x=1)")], "field `x`"),
        ([(stepped, "sys.exit('out of ideas')\n        say(type='stepped',")], "out of ideas"),
        (
            [(stepped, "raise ValueError('no data')\n        say(type='stepped',")],
            "exited with code 1 in step 1 of phase \"train\", where \"stepped\" was expected",
        ),
        ([(stepped, "print('Hello')\n        say(type='stepped',")], "found the line `Hello`"),
    ] {
        let fault = failure(&replacements);
        let expected = expected.replace("expected stepped", "expected \"stepped\"");
        assert!(fault.contains(&expected), "{expected}\n{fault}");
    }
}

#[test]
fn a_broken_clause_of_the_contract_is_named_by_the_trial() {
    for (from, to, expected) in [
        ("", "", ""),
        ("random.Random(seed)]", "random.Random()]", "the same stream gives the same episodes"),
        (
            "lanes[lane] = [0, random.Random(seed)]",
            "lanes[lane] = [0, random.Random(seed + len(message['lanes']))]",
            "a lane does not depend on its neighbours",
        ),
        (
            "lanes[lane] = [0, random.Random(seed)]",
            "lanes[lane] = [0, lanes[lane][1] if lane in lanes else random.Random(seed)]",
            "a lane that is reset in mid-episode is as new",
        ),
        (">= 6", ">= 7", "to end within the horizon"),
        ("/ 10", "/ 4", "observations lie inside their bounds"),
    ] {
        let folder = Programmed::with(&COUNTER.replace(from, to));
        let tried = try_program(&folder.launch(), never());
        match expected {
            "" => drop(tried.unwrap()),
            expected => {
                let error = tried.unwrap_err().to_string();
                assert!(error.contains(expected), "{expected}\n{error}");
                assert!(error.contains("`python3 program.py`"), "{error}");
            }
        }
    }
}

#[test]
fn availability_leaves_only_the_action_that_does_nothing() {
    let program = COUNTER.replace("state=[\"twice\"])", "availability=True)").replace(
        "state=[[2 * lanes[lane][0]] for lane in message[\"lanes\"]]",
        "available=[lane == 1 for lane in message[\"lanes\"]]",
    );
    let folder = Programmed::with(&program);
    let program = folder.start();
    let mut lanes = lanes_of(&program, 2);
    let mut stream = streams(&[1, 2]);
    lanes.reset(LaneSet::All, &mut stream);
    assert_eq!([0, 1].map(|lane| lanes.can_send(lane)), [false, true]);
    let mut rewards = [0.0; 2];
    lanes.step(&[Action::from_index(1).unwrap(); 2], &mut rewards, &mut stream);
    assert_eq!(rewards, [0.0, 1.0]);
    assert!(program.failure().is_none());
}

#[test]
fn a_wait_for_a_silent_program_ends_with_a_stop() {
    let folder = Programmed::with(&COUNTER.replace(
        "        say(type=\"stepped\"",
        "        time.sleep(1000)\n        say(type=\"stepped\"",
    ));
    let stops = Arc::new(AtomicBool::new(false));
    let asked = Arc::clone(&stops);
    let stop: StopRequested = Arc::new(move || asked.load(Ordering::Relaxed));
    let program = EnvironmentProgram::start(&folder.launch(), stop).unwrap();
    let mut lanes = lanes_of(&program, 1);
    let mut stream = streams(&[1]);
    lanes.reset(LaneSet::All, &mut stream);
    let begun = Instant::now();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            std::thread::sleep(Duration::from_millis(100));
            stops.store(true, Ordering::Relaxed);
        });
        lanes.step(&[Action::default()], &mut [0.0], &mut stream);
    });
    assert_eq!(program.failure().unwrap().to_string(), "stopped");
    program.stop();
    assert_within(Duration::from_secs(2), begun);
}

#[test]
fn every_learner_ends_soon_after_a_failure() {
    use jitai::algorithm::{
        DuelingDqn, Learner, LinearThompson, Ppo, Reinforce, dueling_dqn_learner,
        linear_thompson_learner, ppo_learner, reinforce_learner,
    };
    type Made = Box<dyn Learner<OutsideEnvironment>>;
    let four = COUNTER
        .replace(r#"["wait", "pay"]"#, r#"["wait", "pay", "b", "c"]"#)
        .replace("message[\"actions\"]", "[0.5 for _ in message[\"actions\"]]");
    // The program ends at the third reset, or at its tenth step.
    for (number, from) in [
        (3, "        lanes = sets[message[\"instance\"]]\n        for lane, seed"),
        (10, "        rewards = "),
    ] {
        let text = four
            .replace(
                from,
                &format!(
                    "        calls += 1\n        if calls >= {number}: sys.exit('enough')\n{from}"
                ),
            )
            .replace("sets = {}", "sets, calls = {}, 0");
        let ppo = Ppo { lanes: 2, steps: 8, minibatches: 2, episodes: 1000, ..Ppo::default() };
        type Maker = Box<dyn Fn(OutsideEnvironment) -> Made>;
        let makers: [(usize, Maker); 4] = [
            (1, Box::new(|env| dueling_dqn_learner(&DuelingDqn::default(), env, 1).unwrap())),
            (1, Box::new(|env| reinforce_learner(&Reinforce::default(), env, 1).unwrap())),
            (
                1,
                Box::new(|env| {
                    linear_thompson_learner(&LinearThompson::default(), env, 1).unwrap()
                }),
            ),
            (2, Box::new(move |env| ppo_learner(&ppo, env, 1).unwrap())),
        ];
        for (lanes, make) in makers {
            let folder = Programmed::with(&text);
            let program = folder.start();
            let mut learner = make(lanes_of(&program, lanes));
            let calls = AtomicU32::new(0);
            let pause = || program.failure().is_some();
            while program.failure().is_none() {
                assert!(calls.fetch_add(1, Ordering::Relaxed) < 100);
                let mut finished = Vec::new();
                let advanced = learner.advance(&mut finished, None, &pause);
                assert!(advanced.is_ok() || program.failure().is_some());
            }
            let error = program.failure().unwrap().to_string();
            assert!(error.contains("standard error ends with: enough"), "{error}");
        }
    }
}
