"""``python -m jitai``: replaces this process with the program from the wheel."""

import importlib.metadata
import os
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path

NAME = "jitai.exe" if sys.platform == "win32" else "jitai"


def places() -> Iterator[Path]:
    """Where installers put the program: the most specific to this module first."""
    # `pip install --target` moves the folder of programs beside the package.
    yield Path(__file__).resolve().parent.parent / "bin" / NAME
    try:
        files = importlib.metadata.files("jitai") or []
    except importlib.metadata.PackageNotFoundError:
        files = []
    yield from (Path(str(file.locate())) for file in files if file.name == NAME)
    for scheme in (sysconfig.get_default_scheme(), sysconfig.get_preferred_scheme("user")):
        yield Path(sysconfig.get_path("scripts", scheme)) / NAME


def main() -> None:
    """Runs the program."""
    looked_at = list(dict.fromkeys(path.resolve() for path in places()))
    for program in looked_at:
        if program.is_file():
            os.execv(program, [str(program), *sys.argv[1:]])
    sys.exit(f"the program is not at {', '.join(map(str, looked_at))}; install the wheel anew")


main()
