"""Results as data frames."""

from __future__ import annotations

import shutil
import sqlite3
import subprocess

import jitai
import numpy as np
import pandas
import polars
import pytest
from conftest import MANIFEST, PEOPLE, PROGRAM

VIEWS = {
    "runs": "run_summary",
    "arms": "arm_summary",
    "metrics": "metric",
    "curves": "learning_curve",
    "episodes": "evaluation_episode",
    "action_choices": "action_choice",
    "decisions": "decision",
    "participants": "participant",
    "manifests": "manifest",
    "parameters": "parameter",
}


@pytest.mark.parametrize("method", VIEWS)
@pytest.mark.parametrize("frames", ["pandas", "polars"])
def test_a_frame_has_the_rows_of_its_view(store, method, frames):
    view = VIEWS[method]
    with jitai.open(store, frames=frames) as results:
        frame = getattr(results, method)()
        of_experiment = getattr(results, method)("small")
    if frames == "polars":
        assert isinstance(frame, polars.DataFrame)
        frame, of_experiment = (f.to_pandas() for f in (frame, of_experiment))
    with sqlite3.connect(f"file:{store}?mode=ro", uri=True) as connection:
        columns = [row[1] for row in connection.execute(f"PRAGMA table_info({view})")]
        rows = connection.execute(f"SELECT count(*) FROM {view}").fetchone()[0]
    assert list(frame.columns) == columns
    assert len(frame) == len(of_experiment) == rows > 0


@pytest.mark.parametrize("method", VIEWS)
@pytest.mark.parametrize("frames", ["pandas", "polars"])
def test_an_experiment_that_the_store_lacks_is_an_error(store, method, frames):
    with jitai.open(store, frames=frames) as results:
        with pytest.raises(ValueError, match=r"no experiment `smal` \(did you mean `small`\?\); it has small"):
            getattr(results, method)("smal")
        with pytest.raises(ValueError, match="no experiment `o'nobody`; it has small"):
            getattr(results, method)("o'nobody")
        with pytest.raises(TypeError, match="the name of an experiment, found 3"):
            getattr(results, method)(3)


@pytest.mark.parametrize("frames", ["pandas", "polars"])
def test_a_frame_without_values_has_the_types_of_one_with_values(store, plain, frames):
    # `used_until` and the failures are NULL in both.
    with jitai.open(store, frames=frames) as results, jitai.open(plain, frames=frames) as others:
        empty = []
        for method in VIEWS:
            full, bare = getattr(results, method)(), getattr(others, method)("plain")
            assert list(full.columns) == list(bare.columns)
            assert list(full.dtypes) == list(bare.dtypes), method
            empty += [method] if len(bare) == 0 else []
        assert empty == ["curves", "decisions", "participants"]
        both = results.query("SELECT * FROM metric"), others.query("SELECT * FROM metric WHERE false")
        assert list(both[0].dtypes) == list(both[1].dtypes)
    if frames == "polars":
        joined = results_of(plain, "polars").runs().join(
            results_of(plain, "polars").participants(), on="job_key", how="left"
        )
        assert joined["value"].dtype == polars.Float64 and joined["value"].null_count() == 1
        stacked = polars.concat([results_of(path, "polars").runs() for path in (store, plain)])
        assert stacked["failure_kind"].dtype == polars.String and len(stacked) == 17


def results_of(path, frames):
    return jitai.open(path, frames=frames)


def test_null_is_null_in_polars(store):
    results = results_of(store, "polars")
    sql = "SELECT 1.5 AS real, 7 AS whole, 'a' AS text, x'00' AS bytes UNION ALL SELECT NULL, NULL, NULL, NULL"
    frame = results.query(sql)
    assert frame.null_count().row(0) == (1, 1, 1, 1)
    assert frame["real"].mean() == 1.5 and frame["whole"].mean() == 7
    assert frame.dtypes == [polars.Float64, polars.Int64, polars.String, polars.Binary]
    large = results.query("SELECT 9007199254740993 AS a UNION ALL SELECT NULL")
    assert large["a"].to_list() == [9007199254740993, None]
    mixed = results.query("SELECT 1 AS a UNION ALL SELECT 'b' UNION ALL SELECT NULL UNION ALL SELECT x'00ff'")
    assert mixed["a"].to_list() == ["1", "b", None, "x'00ff'"]
    wide = results.parameters(wide=True)
    assert wide["agent.learning_rate"].null_count() == 4 and wide["agent.learning_rate"].mean() < 1


def test_columns_of_a_query_have_their_declared_types(store):
    sql = "SELECT r.mean_return AS m, r.attempt, r.failure_kind, r.sigma FROM run_summary AS r"
    for frames in ("pandas", "polars"):
        with jitai.open(store, frames=frames) as results:
            some = results.query(sql)
            none = results.query(f"{sql} WHERE false")
            assert list(some.dtypes) == list(none.dtypes)
    assert none.dtypes == [polars.Float64, polars.Int64, polars.String, polars.Float64]


def test_a_dataset_has_the_episodes_of_the_test(store):
    with jitai.open(store) as results:
        runs = results.runs()
        key = runs[runs.agent == "tailored"].job_key.iloc[0]
        dataset = results.dataset(key[:10])
        decisions, episodes = results.decisions(), results.episodes()
    decisions, episodes = decisions[decisions.job_key == key], episodes[episodes.job_key == key]
    assert list(dataset) == ["observations", "actions", "rewards", "terminals", "timeouts"]
    state = ["context", "probability", "likely_context", "habituation", "disengagement"]
    assert (dataset["observations"] == decisions[state].to_numpy(np.float32)).all()
    assert (dataset["actions"] == decisions.action).all() and dataset["actions"].dtype == np.int64
    assert (dataset["rewards"] == decisions.reward.astype(np.float32)).all()
    ends = np.flatnonzero(dataset["terminals"] + dataset["timeouts"])
    assert np.diff(np.append(-1, ends)).tolist() == episodes.length.tolist()
    assert dataset["terminals"][ends].tolist() == episodes.terminated.tolist()
    assert not (dataset["terminals"] * dataset["timeouts"]).any() and 0 < dataset["terminals"].sum()
    assert (decisions.terminated + decisions.truncated).sum() == len(episodes)


def test_a_dataset_of_a_training_has_a_timeout_where_the_training_ended(tmp_path):
    declared = {
        "format": 1,
        "name": "trained",
        "scenarios": ["P-H-D"],
        "seeds": 1,
        "environment": {"sigma": 0.6, "horizon": 9},
        "evaluation": {"record_decisions": "all", "test_episodes": 3},
        "agent": [{"name": "ppo", "algorithm": "ppo", "episodes": 40, "lanes": 8, "layers": [8]}],
    }
    path = tmp_path / "trained.sqlite"
    jitai.run(declared, store=path, progress=False)
    with jitai.open(path) as results:
        dataset = results.dataset("", phase="train", observations=["probability", "habituation"])
        decisions = results.decisions()
        test = results.dataset("")
    training = decisions[decisions.phase == "train"]
    assert dataset["observations"].shape == (len(training), 2) and len(test["actions"]) < len(training)
    assert dataset["terminals"].sum() == training.terminated.sum()
    ended = dataset["terminals"] + dataset["timeouts"]
    assert ended.sum() == training.episode.nunique() and ended[-1] == 1


def costly(tmp_path, scenario="P-H-D", **sections):
    """The store of a job that records its test."""
    declared = {
        "format": 1,
        "name": "costly",
        "scenarios": [scenario],
        "seeds": 1,
        "evaluation": {"record_decisions": "test", "test_episodes": 20},
        "agent": [{"name": "random", "algorithm": "rule", "rule": "random"}],
        **sections,
    }
    path = tmp_path / "costly.sqlite"
    jitai.run(declared, store=path, progress=False)
    return jitai.open(path)


def test_rewards_of_a_dataset_are_less_the_cost_of_messages(tmp_path):
    paid = {"sigma": 0.4, "message_cost": 30, "epsilon_d": 0, "mu": [0, 0], "rho_1": 0, "rho_2": 0}
    with costly(tmp_path, environment=paid) as results:
        dataset, decisions = results.dataset(""), results.decisions()
    env = jitai.make(**paid)
    env.reset(seed=1)
    assert env.step(1)[1] == -30
    untailored = dataset["actions"] == 1
    assert set(dataset["rewards"][untailored].tolist()) == {-30.0}
    assert set(decisions.reward[untailored]) == {0.0}
    assert set(dataset["rewards"][dataset["actions"] == 0].tolist()) == {0.0}


def test_people_of_a_dataset_have_costs_of_their_own(tmp_path):
    people = {"message_cost": {"uniform": [0, 30]}}
    with costly(tmp_path, environment={"sigma": 0.4}, population=people) as results:
        dataset, decisions = results.dataset(""), results.decisions()
        cost = results.query("SELECT episode, value FROM participant WHERE name = 'message_cost'")
    cost = cost.set_index("episode").value
    assert cost.nunique() == 20
    paid = decisions.reward - decisions.episode.map(cost) * (decisions.action > 0)
    assert (dataset["rewards"] == paid.to_numpy().astype(np.float32)).all()


@pytest.mark.parametrize("normalised", [0, 1])
def test_prompts_of_oralytics_cost_what_the_net_return_says(tmp_path, normalised):
    people = str(PEOPLE / "synthetic_v4.csv")
    costs = {"normalised_cost": normalised, "cost_of_good_brushing": 30.0, "cost_of_frequent_prompts": 7.0}
    environment = {"family": "declared", "model": "oralytics_v4", "people": people, "parameters": costs}
    with costly(tmp_path, ["dosage"], environment=environment) as results:
        dataset, decisions = results.dataset(""), results.decisions()
        net = results.query("SELECT value FROM metric WHERE name = 'mean_net_return'").value[0]
    assert dataset["rewards"].sum(dtype=float) / 20 == pytest.approx(net)
    assert decisions.reward.sum() / 20 > net or normalised


def test_a_dataset_says_what_is_missing(store, plain):
    with jitai.open(store) as results:
        key = results.runs().job_key.iloc[0]
        for error, message, keywords in [
            (KeyError, "no completed job with a key that begins with 'xyz'", {"key": "xyz"}),
            (KeyError, "several completed jobs", {"key": ""}),
            (TypeError, "key: expected the beginning of a job key, found 7", {"key": 7}),
            (ValueError, "phase: expected test or train", {"key": key, "phase": "both"}),
            (ValueError, 'recorded with record_decisions = "all"', {"key": key, "phase": "train"}),
            (ValueError, "the recorded state has context, .* found H", {"key": key, "observations": "H"}),
        ]:
            with pytest.raises(error, match=message):
                results.dataset(**keywords)
    with jitai.open(plain) as results, pytest.raises(ValueError, match='record_decisions = "test"'):
        results.dataset("")


@pytest.mark.parametrize("frames", ["pandas", "polars"])
def test_columns_with_the_same_name_are_refused(store, frames):
    join = "SELECT * FROM run_summary JOIN metric AS a USING (job_key) JOIN metric AS b USING (job_key)"
    with jitai.open(store, frames=frames) as results:
        for sql, name in [("SELECT 1 AS value, 2 AS other, 3 AS Value", "Value"), (join, "name")]:
            with pytest.raises(ValueError, match=f"several columns are called `{name}`; name each"):
                results.query(sql)
        frame = results.query("SELECT 1 AS value, 2 AS value_2")
        assert list(frame.columns) == ["value", "value_2"]


@pytest.mark.parametrize("frames", ["pandas", "polars"])
def test_queries_take_parameters(store, frames):
    with jitai.open(store, frames=frames) as results:
        by_place = results.query("SELECT ? AS whole, ? AS real, ? AS text", [7, np.float64(0.1), "it's"])
        assert list(by_place.columns) == ["whole", "real", "text"]
        assert [by_place[name][0] for name in by_place.columns] == [7, 0.1, "it's"]
        sql = "SELECT seed, mean_return FROM run_summary WHERE seed = :seed AND agent = :agent"
        by_name = results.query(sql, {"agent": "dqn", "seed": np.int64(2)})
        plain = results.query(sql.replace(":seed", "2").replace(":agent", "'dqn'"))
        assert by_name.equals(plain) and list(by_name.dtypes) == list(plain.dtypes) and len(plain) > 0
        none = results.query(sql, {"agent": None, "seed": True})
        assert len(none) == 0 and list(none.dtypes) == list(plain.dtypes)
        for error, message, sql, parameters in [
            (ValueError, "has 1 parameter, found 0 values", "SELECT ?", []),
            (ValueError, "has 0 parameters, found 1 value", "SELECT 1", [1]),
            (ValueError, "no parameter :b", "SELECT :a", {"b": 1}),
            (TypeError, "numbers, texts, bytes or None, found list", "SELECT ?", [[1]]),
            (TypeError, "a list or a dict, found 'x'", "SELECT ?", "x"),
        ]:
            with pytest.raises(error, match=message):
                results.query(sql, parameters)


def test_conflicts_and_the_order_of_manifests_are_frames(store, tmp_path):
    path = tmp_path / "changed.sqlite"
    shutil.copy(store, path)
    with sqlite3.connect(path) as connection:
        # Another clock, and the results of another machine.
        connection.execute("UPDATE experiment SET updated_at = '2999-01-01T00:00:00.000Z'")
        connection.execute(
            "INSERT INTO recorded_conflict (job, results_sha256, found_at, source, host, processor,"
            " code_version, git_revision) SELECT min(id), zeroblob(32), '2026-01-31T12:00:00.000Z',"
            " 'theirs.sqlite', 'other', 'any', '0', '0' FROM job"
        )
    manifest = tmp_path / "small.toml"
    manifest.write_text(MANIFEST.replace("seeds = 2", "seeds = 3"))
    run = [str(PROGRAM), "run", str(manifest), "--store", str(path), "--quiet"]
    subprocess.run(run, check=True, capture_output=True)
    link = tmp_path / "link.sqlite"
    link.symlink_to("changed.sqlite")
    with jitai.open(link) as results:
        conflicts = results.conflicts("small")
        assert list(conflicts.host) == ["other"] and list(conflicts.results_sha256) == ["00" * 32]
        assert isinstance(conflicts.found_at.dtype, pandas.DatetimeTZDtype)
        manifests = results.manifests()
        assert list(manifests.number) == [1, 2]
        assert ["seeds = 3" in text for text in manifests.manifest] == [False, True]
        assert results.runs().host.notna().all()


def test_the_spread_of_one_episode_is_missing(tmp_path):
    manifest = tmp_path / "one.toml"
    manifest.write_text(MANIFEST.replace("test_episodes = 20", "test_episodes = 1"))
    path = tmp_path / "one.sqlite"
    run = [str(PROGRAM), "run", str(manifest), "--store", str(path), "--quiet"]
    subprocess.run(run, check=True, capture_output=True)
    with jitai.open(path) as results:
        assert results.runs().sd_return.isna().all() and results.arms().sd_return.isna().all()
        metrics = results.metrics()
        assert metrics[metrics.name == "sd_return"].value.isna().all()
        assert metrics[metrics.name != "sd_return"].value.notna().all()


def test_a_store_shows_its_experiments(plain):
    results = jitai.open(plain)
    assert repr(results) == f"<jitai.Store '{plain}': experiments plain>"
    results.close()
    assert repr(results) == f"<jitai.Store '{plain}', closed>"


def test_a_store_with_two_names_is_refused(store, tmp_path):
    path = tmp_path / "one.sqlite"
    shutil.copy(store, path)
    path.with_name("two.sqlite").hardlink_to(path)
    with pytest.raises(OSError, match="has 2 names"):
        jitai.open(path)


def test_columns_have_types(store):
    with jitai.open(store) as results:
        runs = results.runs()
        assert (runs.status == "completed").all() and len(runs) == 16
        assert runs.mean_return.dtype == np.float64 and runs.seed.dtype == np.int64
        assert isinstance(runs.started_at.dtype, pandas.DatetimeTZDtype)
        assert (runs.ended_at >= runs.started_at).all()
        # A rule has no learning curve.
        assert runs.failure_kind.isna().all()
        curves = results.curves()
        assert set(curves.metric) >= {"mean_return", "epsilon"}
        decisions = results.decisions()
        assert set(decisions.phase) == {"test"} and decisions.habituation.dtype == np.float64
        participants = results.participants()
        assert set(participants.name) == {"epsilon_d"} and participants.value.between(0.2, 0.6).all()
        manifests = results.manifests()
        assert manifests.manifest[0] == MANIFEST and manifests.used_until.isna().all()
        assert isinstance(manifests.used_from.dtype, pandas.DatetimeTZDtype)


def test_wide_parameters_have_a_column_each(store):
    with jitai.open(store) as results:
        wide = results.parameters(wide=True)
        tall = results.parameters()
        runs = results.runs()
    assert len(wide) == 16 and wide.job_key.is_unique
    assert set(wide.columns) == {"job_key", *tall.name}
    assert (
        wide["environment.sigma"].dtype == np.float64 and (wide["environment.sigma"] == 0.6).all()
    )
    assert wide["environment.horizon"].dtype == np.int64
    assert set(wide["agent.trunk"].dropna()) == {"shared", "separate"}
    # Only two of three agents have a learning rate.
    assert wide["agent.learning_rate"].isna().sum() == 4
    both = runs.merge(wide, on="job_key", suffixes=("", "_parameter"))
    assert (both.seed == both.seed_parameter).all()
    polars_wide = jitai.open(store, frames="polars").parameters(wide=True)
    assert polars_wide["environment.horizon"].dtype == polars.Int64
    assert polars_wide.shape == wide.shape


def test_queries_answer_what_sql_asks(store):
    with jitai.open(store) as results:
        frame = results.query(
            "SELECT 1 AS whole, 1.5 AS real, NULL AS absent, 'a' AS text, x'00ff' AS bytes "
            "UNION ALL SELECT 2, NULL, NULL, NULL, NULL"
        )
        assert frame.whole.tolist() == [1, 2] and frame.real.isna().tolist() == [False, True]
        assert frame.bytes[0] == b"\x00\xff" and frame.absent.isna().all()
        mixed = results.query("SELECT 1 AS a UNION ALL SELECT 2.5 UNION ALL SELECT NULL")
        assert mixed.a.dtype == np.float64
        large = results.query("SELECT 9007199254740993 AS a UNION ALL SELECT NULL")
        assert large.a[0] == 9007199254740993
        for wrong, message in [
            ("DELETE FROM run", "may only read"),
            ("SELECT * FROM nowhere", "no such table"),
            ("SELECT", "syntax|incomplete"),
            ("", "empty"),
            ("SELECT 1; SELECT 2", "one statement"),
            ("SELECT '\0'", "."),
        ]:
            with pytest.raises(ValueError, match=message):
                results.query(wrong)


def test_what_is_no_store_is_refused(tmp_path, store):
    with pytest.raises(FileNotFoundError, match="no store at"):
        jitai.open(tmp_path / "none.sqlite")
    text = tmp_path / "text.sqlite"
    text.write_text("no store\n" * 100)
    (tmp_path / "empty.sqlite").touch()
    for path in (text, tmp_path / "empty.sqlite"):
        with pytest.raises(ValueError):
            jitai.open(path)
    with pytest.raises(ValueError, match="pandas or polars"):
        jitai.open(store, frames="numpy")
    results = jitai.open(store)
    results.close()
    results.close()
    for use in (results.runs, lambda: results.query("SELECT 1")):
        with pytest.raises(ValueError, match="closed"):
            use()


def test_results_are_read_while_a_sweep_runs(tmp_path):
    manifest, path = tmp_path / "long.toml", tmp_path / "long.sqlite"
    manifest.write_text(MANIFEST.replace("seeds = 2", "seeds = 40"))
    sweep = subprocess.Popen(
        [PROGRAM, "run", manifest, "--store", path, "--quiet"], stderr=subprocess.PIPE
    )
    counts = []
    try:
        while sweep.poll() is None:
            if path.exists() and path.stat().st_size:
                try:
                    with jitai.open(path) as results:
                        runs = results.runs()
                        counts.append(int((runs.status == "completed").sum()))
                except (ValueError, FileNotFoundError):
                    # The program is still creating the tables.
                    assert not counts
    finally:
        sweep.wait()
    assert sweep.returncode == 0, sweep.stderr.read()
    sweep.stderr.close()
    with jitai.open(path) as results:
        assert (results.runs().status == "completed").sum() == 320
    assert counts == sorted(counts) and len(set(counts)) > 2


def test_a_store_that_nobody_may_write_to_is_read(tmp_path, store):
    copy = tmp_path / "copy.sqlite"
    shutil.copy(store, copy)
    copy.chmod(0o444)
    before = copy.read_bytes()
    with jitai.open(copy) as results:
        assert len(results.runs()) == 16
    assert copy.read_bytes() == before
