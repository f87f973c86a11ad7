"""Runs the questions of the documents in DuckDB on exported Parquet files, as docs/browse.md describes.

Arguments: the numbers of the questions, with commas; a file of JSON with their SQL by number; the store, beside
which the folder `results` has its export; and a folder for the answers, one CSV file per question.
"""

import csv
import json
import sys
from pathlib import Path

import duckdb

numbers, queries, store, answers = sys.argv[1:]
Path(answers).mkdir(exist_ok=True)
for path in sorted((Path(store).parent / "results").glob("*.parquet")):
    duckdb.sql(f"CREATE VIEW {path.stem} AS SELECT * FROM '{path}'")
sql = json.loads(Path(queries).read_text())
for number in numbers.split(","):
    answer = duckdb.sql(sql[number])
    with open(Path(answers) / f"{number}.csv", "w", newline="") as file:
        # `None` becomes an empty field.
        csv.writer(file).writerows([answer.columns, *answer.fetchall()])
