"""Prints the licences of everything that is compiled into the program and the Python module.

Crates with the same text share it. The file that this makes is in every download, as the licences require.
"""

import json
import re
import subprocess
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
OURS = {"jitai", "jitai-python"}
#: Names of files with a licence.
NAMES = re.compile(r"(licen[cs]e|copying|notice|unlicense|copyright)", re.IGNORECASE)


def output(*command: str) -> str:
    return subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout


def compiled() -> list[dict]:
    """The packages that are linked on this platform, with its features: no macros and no tools of builds and tests."""
    tree = ["cargo", "tree", "--locked", "--edges", "normal,no-proc-macro", "--prefix", "none", "--format", "{p}"]
    lines = output(*tree, "--package", "jitai", "--package", "jitai-python").splitlines()
    linked = {tuple(line.split()[:2]) for line in lines if line}
    described = json.loads(output("cargo", "metadata", "--format-version", "1", "--locked"))
    packages = [one for one in described["packages"] if (one["name"], f"v{one['version']}") in linked]
    assert len(packages) == len(linked), "cargo metadata lacks a package of cargo tree"
    others = [package for package in packages if package["name"] not in OURS]
    return sorted(others, key=lambda package: (package["name"], package["version"]))


def texts(package: dict) -> list[str]:
    """The texts of the licences in the sources of a package."""
    folder = Path(package["manifest_path"]).parent
    files = [path for path in sorted(folder.iterdir()) if path.is_file() and NAMES.match(path.name)]
    return [path.read_text(encoding="utf-8", errors="replace").strip() for path in files]


def main() -> None:
    # Texts that differ in their line breaks alone are one text.
    whole: dict[str, str] = {}
    crates_of: dict[str, list[str]] = defaultdict(list)
    without = []
    packages = compiled()
    for package in packages:
        name = f"{package['name']} {package['version']} ({package['license']})"
        found = texts(package)
        if not found:
            without.append(name)
        for text in found:
            words = " ".join(text.split())
            whole.setdefault(words, text)
            crates_of[words].append(name)
    print("jitai contains the following packages; their licences follow.\n")
    for package in packages:
        print(f"  {package['name']} {package['version']}: {package['license']}")
    print("\nSQLite, inside libsqlite3-sys, is in the public domain. The font Inter is under the licence at the end.")
    if without:
        print("\nThese packages declare a licence without its text, which is among the texts below:\n")
        print("\n".join(f"  {name}" for name in without))
    for words, crates in sorted(crates_of.items(), key=lambda one: one[1]):
        show(", ".join(crates), whole[words])
    show("the font Inter", (ROOT / "src/report/fonts/LICENSE-OFL").read_text().strip())


def show(of: str, text: str) -> None:
    print(f"\n{'=' * 100}\n{of}\n\n{text}")


if __name__ == "__main__":
    main()
