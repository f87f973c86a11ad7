"""Fits of a model to data frames."""

from __future__ import annotations

import subprocess

import jitai
import pandas
import polars
import pytest
from conftest import PROGRAM, ROOT

PILOT = ROOT / "experiments" / "heartsteps"
MODEL = PILOT / "trial_log.toml"
DATA = PILOT / "trial_log.csv"
BRUSHING = ROOT / "experiments" / "robas"


@pytest.fixture(scope="module")
def fitted():
    return jitai.fit(MODEL, pandas.read_csv(DATA), simulations=40, draws=2)


def test_a_fit_has_the_bytes_of_the_program(tmp_path, fitted):
    """Frames of both libraries, a path and the program give the same files."""
    of_path = jitai.fit(str(MODEL), DATA, simulations=40, draws=2)
    of_polars = jitai.fit(MODEL, polars.read_csv(DATA), simulations=40, draws=2)
    folder = tmp_path / "saved"
    environment = fitted.save(folder)
    arguments = ["fit", MODEL, "--data", DATA, "--out", tmp_path / "out", "--simulations", "40", "--draws", "2"]
    said = subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True, check=True)
    compared = 0
    for path in (tmp_path / "out").rglob("*"):
        name = path.relative_to(tmp_path / "out")
        # The page shows the paths of its own files.
        if path.is_file() and path.name != "index.html":
            assert (folder / name).read_bytes() == path.read_bytes(), name
            compared += 1
    assert compared > 15
    assert (folder / "index.html").is_file()
    for other in (of_path, of_polars):
        assert other.notes == fitted.notes and other.estimates == fitted.estimates
    assert said.stderr.splitlines() == [f"note: {note}" for note in fitted.notes]
    assert isinstance(of_polars.people, polars.DataFrame) and isinstance(of_path.people, pandas.DataFrame)
    assert of_polars.people["person"].to_list() == [str(person) for person in range(1, 38)]
    assert environment["people"] == str(folder / "people.csv")


def test_frames_have_the_numbers_of_the_files(fitted):
    people = fitted.people
    assert list(people.columns)[0] == "person" and len(people) == 37
    estimates = fitted.estimates["draws"][0]["fits"][0]["estimates"]
    for one in estimates:
        assert people[one["coefficient"]].iloc[0] == one["estimate"]
    assert len(fitted.draws) == 2 and list(fitted.draws[0].columns) == list(people.columns)
    assert not fitted.draws[0].equals(fitted.draws[1])
    checks = fitted.checks.set_index("number")
    assert abs(checks.pilot["mean"] - 3.1) < 0.1 and {"simulated", "error", "off"} <= set(checks.columns)
    effect = fitted.tables["effect"]
    assert abs(effect.effect[0] - 0.1312) < 0.02 and effect.error[0] > 0
    assert fitted.prior["action_centring"] is True and len(fitted.prior["effect_means"]) == 3
    assert [figure.name for figure in fitted.figures] == ["weeks", "people"]
    assert all("<svg" in figure.svg for figure in fitted.figures)
    assert fitted.is_fitted and "37 people, fitted" in repr(fitted) and "<svg" in fitted._repr_html_()


def test_the_people_and_the_prior_run_at_once(tmp_path, fitted, monkeypatch):
    monkeypatch.chdir(tmp_path)
    manifest = {
        "format": 1,
        "name": "next",
        "scenarios": "all",
        "seeds": 2,
        "environment": fitted.save(tmp_path / "fitted"),
        "trial": {"people": 20, "days": 42, "decisions_per_day": 5},
        "evaluation": {"on": "trial"},
        "agent": [
            {"name": "randomised", "algorithm": "rule", "rule": "random"},
            {"name": "informed", "algorithm": "linear_thompson", "pi_min": 0.2, **fitted.prior},
        ],
    }
    ended = jitai.run(manifest, store="next.sqlite", progress=False)
    assert ended.completed == 4 and ended.failed == 0


def test_imputed_effects_are_named():
    fitted = jitai.fit(BRUSHING / "zip.toml", BRUSHING / "robas_2_data.csv", simulations=20)
    assert "imputed, not estimated: e_b, e_p" in fitted.notes
    assert all("imputed, not estimated: e_b, e_p" in figure.caption for figure in fitted.figures)
    off = fitted.checks.set_index("number").off
    assert off["variance within people, without zeros"] > 2


def test_faults_say_where_they_are(tmp_path):
    frame = pandas.read_csv(DATA)
    frame["sent"] = frame.sent.astype(object)
    frame.loc[3, "sent"] = "often"
    with pytest.raises(ValueError, match="line 5: column `sent` has `often`"):
        jitai.fit(MODEL, frame)
    with pytest.raises(ValueError, match="no column `probability`|no column"):
        jitai.fit(MODEL, frame.drop(columns="probability"))
    faulty = tmp_path / "faulty.toml"
    faulty.write_text(MODEL.read_text().replace("person      =", "persn      ="))
    with pytest.raises(jitai.ManifestError, match="did you mean `person`") as raised:
        jitai.fit(faulty, DATA)
    assert any(fault["line"] and "persn" in fault["message"] for fault in raised.value.faults)
    with pytest.raises(ValueError, match="nobody has estimates"):
        jitai.fit(MODEL, pandas.read_csv(DATA).groupby("person").head(2))
    with pytest.raises(TypeError, match="expected a frame of pandas or polars"):
        jitai.fit(MODEL, [1, 2])
    with pytest.raises(ValueError, match="simulations: expected a whole number of at least 20"):
        jitai.fit(MODEL, DATA, simulations=1)
    with pytest.raises(FileNotFoundError):
        jitai.fit(MODEL, "nowhere.csv")


def test_progress_is_told_and_an_exception_ends_the_fit():
    told = []
    jitai.fit(MODEL, DATA, simulations=20, progress=lambda *event: told.append(event))
    assert told[-1] == ("pilots simulated", 20, 20) and ("fits done", 37, 37) in told

    def stop(what, done, of):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        jitai.fit(MODEL, DATA, simulations=100_000, progress=stop)
