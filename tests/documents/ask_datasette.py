"""Runs every question of the documents in Datasette, as docs/browse.md describes, and watches a sweep.

Arguments: the program, a manifest to run beside it, a line `query=experiment` per question, the store, and a
folder for the answers, one CSV file per question.
"""

import csv
import json
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.parse
import urllib.request
from pathlib import Path

program, manifest, questions, store, answers = sys.argv[1:]
Path(answers).mkdir(exist_ok=True)
with socket.socket() as free:
    free.bind(("127.0.0.1", 0))
    port = free.getsockname()[1]
ROOT = f"http://127.0.0.1:{port}/jitai"
# The command of docs/browse.md, on a free port, with a row limit that admits every answer.
COMMAND = ["serve", store, "--metadata", "docs/datasette.yaml", "--port", str(port)]
SETTINGS = {"sql_time_limit_ms": "20000", "max_returned_rows": "1000000"}


def ask(query: str, **parameters: str) -> dict:
    parameters["_shape"] = "arrays"
    with urllib.request.urlopen(f"{ROOT}/{query}.json?{urllib.parse.urlencode(parameters)}") as answer:
        return json.load(answer)


def completed() -> int:
    """The number of completed jobs of the watched experiment, according to Datasette."""
    sql = "SELECT count(*) FROM run_summary WHERE experiment = 'watched' AND status = 'completed'"
    with urllib.request.urlopen(f"{ROOT}.json?{urllib.parse.urlencode({'sql': sql, '_shape': 'arrays'})}") as answer:
        return json.load(answer)["rows"][0][0]


options = [word for setting in SETTINGS.items() for word in ("--setting", *setting)]
server = subprocess.Popen([sys.executable, "-m", "datasette", *COMMAND, *options], stdout=subprocess.DEVNULL)
try:
    deadline = time.monotonic() + 60
    while True:
        try:
            page = urllib.request.urlopen(ROOT).read().decode()
            break
        except urllib.error.URLError:
            assert server.poll() is None and time.monotonic() < deadline, "datasette does not answer"
            time.sleep(0.1)
    assert "1. What did each arm reach, over its seeds?" in page, page
    for line in questions.splitlines():
        query, experiment = line.split("=")
        answer = ask(query, experiment=experiment)
        assert not answer["truncated"] and answer.get("error") is None, (query, answer.get("error"))
        with open(Path(answers) / f"{int(query[1:3])}.csv", "w", newline="") as file:
            # `None` becomes an empty field.
            csv.writer(file).writerows([answer["columns"], *answer["rows"]])
    sweep = subprocess.Popen([program, "run", manifest, "--store", store, "--quiet"], stdout=subprocess.DEVNULL)
    seen = {completed()}
    while sweep.poll() is None:
        seen.add(completed())
    assert sweep.returncode == 0, sweep.returncode
    seen.add(completed())
    assert 0 in seen and max(seen) == 80 and len(seen) > 3, seen
finally:
    server.terminate()
    server.wait()
