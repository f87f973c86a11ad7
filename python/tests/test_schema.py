"""The JSON Schema accepts the manifests that the program accepts."""

from __future__ import annotations

import json
import re

import pytest
from conftest import ROOT

jsonschema = pytest.importorskip("jsonschema")
tomllib = pytest.importorskip("tomllib")

SCHEMA = json.loads((ROOT / "docs" / "manifest.schema.json").read_text())


def is_manifest(text: str) -> bool:
    """Whether a TOML text is a manifest: other files have roles, as models, or no format."""
    return "format = 1" in text and "[roles]" not in text


FILES = [path for path in sorted((ROOT / "experiments").rglob("*.toml")) if is_manifest(path.read_text())]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCKS = [
    pytest.param(block, id=f"{page.name}-{place}")
    for page in PAGES
    for place, block in enumerate(re.findall(r"```toml\n(.*?)```", page.read_text(), re.DOTALL))
    if is_manifest(block)
]


def faults(text: str) -> list[str]:
    validator = jsonschema.Draft202012Validator(SCHEMA)
    return [error.message[:300] for error in validator.iter_errors(tomllib.loads(text))]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_shipped_manifest_is_valid(path):
    assert faults(path.read_text()) == []


@pytest.mark.parametrize("text", BLOCKS)
def test_a_manifest_of_the_documents_is_valid(text):
    assert faults(text) == []


def test_there_are_manifests_and_the_schema_refuses_a_wrong_one():
    assert len(FILES) > 20 and len(BLOCKS) > 1
    assert faults(re.sub(r"(?m)^format = 1", "format = 7", FILES[0].read_text()))
