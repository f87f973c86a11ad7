"""Builds the wheel: the module, built by maturin, and the program.

A wheel from maturin has either a module or programs. This backend first builds the program, from the same
library and into the same folder, and adds it to the wheel's scripts, so that it starts, stops and exits as
it does without Python.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import maturin
from maturin import (
    get_requires_for_build_editable,
    get_requires_for_build_sdist,
    get_requires_for_build_wheel,
)

__all__ = [
    "build_editable",
    "build_sdist",
    "build_wheel",
    "get_requires_for_build_editable",
    "get_requires_for_build_sdist",
    "get_requires_for_build_wheel",
    "prepare_metadata_for_build_editable",
    "prepare_metadata_for_build_wheel",
]

HERE = Path(__file__).resolve().parent.parent
#: The folder of the workspace, which an sdist has beside this one's files.
IS_SDIST = (HERE / "src" / "main.rs").exists()
ROOT = HERE if IS_SDIST else HERE.parent
SCRIPTS = HERE / "jitai.data" / "scripts"
#: The version of the C library that a compatibility promises, as a suffix of a target.
GLIBC = {"manylinux2014": ".2.17", "manylinux_2_28": ".2.28"}


def add_program(config_settings: Mapping[str, Any] | None) -> None:
    """Builds the program as maturin will build the module, and copies it to maturin's folder of scripts."""
    parser = argparse.ArgumentParser(allow_abbrev=False)
    parser.add_argument("--profile", default="release")
    parser.add_argument("--target")
    parser.add_argument("--locked", action="store_true")
    # How releases run with older C libraries than that of the machine that builds them.
    parser.add_argument("--zig", action="store_true")
    parser.add_argument("--compatibility")
    chosen, _ = parser.parse_known_args(maturin.get_maturin_pep517_args(config_settings))
    cargo = os.environ.get("CARGO", "cargo")
    build = [cargo, "zigbuild" if chosen.zig else "build", "--bin", "jitai", "--profile", chosen.profile]
    build += ["--locked"] if chosen.locked else []
    # In a clone, python/unify gives program and module the same features, so that Burn is compiled once.
    build += ["--package", "jitai", "--package", "jitai-python"] if IS_SDIST else []
    if chosen.target:
        glibc = GLIBC[chosen.compatibility] if chosen.zig else ""
        build += ["--target", chosen.target + glibc]
    subprocess.run([*build, "--message-format", "short"], cwd=ROOT, check=True)
    metadata = [cargo, "metadata", "--format-version", "1", "--no-deps"]
    described = subprocess.run(metadata, cwd=ROOT, check=True, capture_output=True)
    folder = Path(json.loads(described.stdout)["target_directory"]) / (chosen.target or "")
    # The folders of these profiles have other names.
    folder /= {"dev": "debug", "test": "debug", "bench": "release"}.get(chosen.profile, chosen.profile)
    is_for_windows = "windows" in chosen.target if chosen.target else sys.platform == "win32"
    program = "jitai.exe" if is_for_windows else "jitai"
    SCRIPTS.mkdir(parents=True, exist_ok=True)
    shutil.copy(folder / program, SCRIPTS / program)


def build_wheel(wheel_directory, config_settings=None, metadata_directory=None):
    add_program(config_settings)
    return maturin.build_wheel(wheel_directory, config_settings, metadata_directory)


def build_editable(wheel_directory, config_settings=None, metadata_directory=None):
    add_program(config_settings)
    return maturin.build_editable(wheel_directory, config_settings, metadata_directory)


def build_sdist(sdist_directory, config_settings=None):
    # maturin requires the folder, even if it is empty.
    SCRIPTS.mkdir(parents=True, exist_ok=True)
    return maturin.build_sdist(sdist_directory, config_settings)


def prepare_metadata_for_build_wheel(metadata_directory, config_settings=None):
    SCRIPTS.mkdir(parents=True, exist_ok=True)
    return maturin.prepare_metadata_for_build_wheel(metadata_directory, config_settings)


def prepare_metadata_for_build_editable(metadata_directory, config_settings=None):
    SCRIPTS.mkdir(parents=True, exist_ok=True)
    return maturin.prepare_metadata_for_build_editable(metadata_directory, config_settings)
