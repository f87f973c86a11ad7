"""``python -m jitai``: replaces this process with the program from the wheel."""

import os
import sys
import sysconfig
from pathlib import Path


def main() -> None:
    """Runs the program."""
    name = "jitai.exe" if sys.platform == "win32" else "jitai"
    program = Path(sysconfig.get_path("scripts")) / name
    if not program.is_file():
        sys.exit(f"the program is not at {program}; install the wheel anew")
    os.execv(program, [str(program), *sys.argv[1:]])


main()
