//! The results of a job are bit-identical, whichever process runs it and however often it is killed.

use std::thread;
use std::time::Duration;

use jitai::kernel::Isa;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

use crate::support::{Effort, Folder, assert_same_rows, manifest};

/// Number of kills that a sweep must survive.
const KILLS: u32 = 20;
/// How many kills have to meet a running job, at least.
const MET: u32 = 5;

/// The manifest in the beta version, with participants who differ, all limits on messages, and all
/// features of these limits in the scenario.
fn noisy(manifest: &str) -> String {
    let keys = "environment.state_noise = \"beta\"
environment.kappa_h = 10
environment.kappa_d = 10
environment.step_noise = \"gamma\"
environment.sigma_s = 10
environment.parameter_spread = 0.2
environment.context_persistence = 0.5
environment.availability = 0.8
environment.message_cost = 5
environment.message_budget = 20
population.epsilon_d = { uniform = [0.1, 0.7] }
population.availability = { values = [0.6, 1] }
environment.sigma";
    let noisy = manifest.replace("environment.sigma", keys);
    noisy.replace("\"P-H-D\"", "\"P-H-D-A-B-M-S\"")
}

/// Bandits that use an integral, draws, or one draw per episode, and a history.
const BANDITS: &str = "history = 3
[[agent]]
name = \"bandit\"
algorithm = \"linear_thompson\"
episodes = 30
history = 2
[[agent]]
name = \"centred\"
algorithm = \"linear_thompson\"
episodes = 30
action_centring = true
pi_min = 0.05
smoothing = 0.02
[[agent]]
name = \"drawn\"
algorithm = \"linear_thompson\"
episodes = 30
features = \"interactions\"
draw = \"episode\"
";

#[test]
fn three_workers_store_the_same_rows_as_one() {
    let text = manifest("sweep", "[0, 0.6]", "2", Effort::Short);
    for text in [noisy(&text), text] {
        let one = Folder::with(&text);
        one.jitai(["run", "sweep.toml", "--workers", "1"]).succeeded();
        let three = Folder::with(&text);
        three.jitai(["run", "sweep.toml", "--workers", "3"]).succeeded();
        assert_eq!(one.number("SELECT count(*) FROM run_summary WHERE status = 'completed'"), 8);
        assert_same_rows(&one.dump(), &three.dump());
    }
}

#[test]
fn every_instruction_set_stores_the_same_rows() {
    let text = manifest("sweep", "0.6", "1", Effort::Trivial);
    let one_hot =
        text.replace("environment.sigma", "environment.time_one_hot = true\nenvironment.sigma");
    let far = one_hot.replace(
        "layers = [32, 32]",
        "layers = [20]\nactivation = \"tanh\"\ntrunk = \"separate\"\nterminal_target = \"standard\"
target_period = 50\nbuffer = 200",
    );
    assert_ne!(far, one_hot);
    let bandits = format!("{one_hot}{BANDITS}");
    for text in [noisy(&text), text, far, bandits] {
        let fastest = Folder::completed(&text);
        for isa in Isa::available().into_iter().skip(1) {
            let forced = Folder::with(&text);
            let mut run = forced.command(["run", "sweep.toml"]);
            let run = run.env("JITAI_SIMD", isa.name()).output().unwrap();
            assert!(run.status.success(), "{run:?}");
            assert_same_rows(&fastest.dump(), &forced.dump());
        }
    }
}

#[test]
fn an_instruction_set_that_there_is_not_is_a_usage_error() {
    let folder = Folder::new();
    let run = folder.command(["schema"]).env("JITAI_SIMD", "abacus").output().unwrap();
    assert_eq!(run.status.code(), Some(2), "{run:?}");
    let said = String::from_utf8(run.stderr).unwrap();
    assert!(said.contains("JITAI_SIMD is `abacus`; expected one of"), "{said}");
}

#[test]
fn a_job_alone_stores_the_same_rows_as_in_a_sweep() {
    let sweep = Folder::completed(&manifest("sweep", "[0.4, 0.6]", "2", Effort::Trivial));
    let alone = Folder::completed(&manifest("sweep", "0.6", "[2]", Effort::Trivial));
    let rows = alone.dump();
    assert!(rows.len() > 100, "{}", rows.len());
    let sweep = sweep.dump();
    for row in rows {
        assert!(sweep.binary_search(&row).is_ok(), "not in the sweep: {row}");
    }
}

#[test]
fn a_sweep_killed_in_its_trainings_stores_the_rows_of_an_undisturbed_one() {
    killed_sweep_stores_the_same_rows(str::to_owned, Effort::Short, Duration::from_millis(150));
}

#[test]
fn a_noisy_sweep_killed_in_its_trainings_stores_the_rows_of_an_undisturbed_one() {
    killed_sweep_stores_the_same_rows(noisy, Effort::Short, Duration::from_millis(150));
}

#[test]
fn a_sweep_killed_while_it_opens_and_writes_stores_the_rows_of_an_undisturbed_one() {
    killed_sweep_stores_the_same_rows(str::to_owned, Effort::Trivial, Duration::from_millis(25));
}

/// Kills a sweep repeatedly, each time at a random moment at most `within` after its start, and then
/// lets it end.
fn killed_sweep_stores_the_same_rows(
    changed: fn(&str) -> String,
    effort: Effort,
    mut within: Duration,
) {
    let killed = Folder::new();
    let mut moments = ChaCha8Rng::seed_from_u64(2);
    let (mut kills, mut seeds, mut added) = (0, 4, 4);
    let mut met = 0;
    let sweep = |seeds: i64| {
        let recorded = "evaluation.record_decisions = \"all\"\nevaluation.test_episodes";
        let text = changed(&manifest("sweep", "0.6", &seeds.to_string(), effort));
        // All decisions of the training are rows.
        text.replace("evaluation.test_episodes", recorded)
            .replace("episodes = 6000", "episodes = 1500")
    };
    killed.write("sweep.toml", sweep(seeds));
    while kills < KILLS || met < MET {
        let moment = within.mul_f64(f64::from(moments.next_u32()) / f64::from(u32::MAX));
        match run_or_kill(&killed, moment) {
            Fate::Killed => {
                kills += 1;
                met += u32::from(killed.is_running_a_job());
                // On a slow machine, the time grows until jobs have started.
                within = if kills < KILLS { within } else { within.mul_f64(1.5) };
                assert!(kills < 2 * KILLS, "{met} jobs have begun {within:?} after a start");
            }
            // On a fast machine, the sweep grows, until it lasts longer than the time in which it is killed.
            Fate::Completed => {
                added *= 2;
                seeds += added;
                killed.write("sweep.toml", sweep(seeds));
            }
        }
    }
    killed.jitai(["run", "sweep.toml"]).succeeded();
    let jobs = 2 * seeds;
    killed.jitai(["run", "sweep.toml"]).succeeded().says("nothing to run");
    let runs = |what: &str, status: &str| {
        killed.number(&format!("SELECT {what} FROM run WHERE status = '{status}'"))
    };
    assert_eq!(runs("count(*)", "completed"), jobs);
    assert_eq!(runs("count(DISTINCT job)", "completed"), jobs);
    assert_eq!((runs("count(*)", "running"), runs("count(*)", "failed")), (0, 0));
    assert!(runs("count(*)", "interrupted") > 0);

    assert_same_rows(&killed.dump(), &Folder::completed(&sweep(seeds)).dump());
}

enum Fate {
    Completed,
    Killed,
}

/// Runs the sweep and kills it at a moment after its start, unless it has already ended.
fn run_or_kill(folder: &Folder, moment: Duration) -> Fate {
    let mut run = folder.start(["run", "sweep.toml", "--workers", "2", "--quiet"]);
    thread::sleep(moment);
    if run.has_ended() {
        run.wait().succeeded();
        return Fate::Completed;
    }
    run.kill();
    Fate::Killed
}
