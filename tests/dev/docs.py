#!/usr/bin/env python3
"""Checks the Markdown pages: docs.py [--write].

- README.md is at most 200 lines.
- Every relative link leads to a file, and its fragment to a heading there.
- A code block after `<!-- FILE -->` is FILE without its first comment: what a page shows is what is built.
- What stands between `<!-- figures -->` and `<!-- /figures -->` is what tests/bench/figures.py prints.
- `find_package(incise X.Y` asks for the version in CMakeLists.txt, and CHANGELOG.md has a section for that version.

--write brings code blocks, figures and find_package up to date instead of reporting them.
"""

import pathlib
import re
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]
README_LINES = 200
BLOCK = re.compile(r"(<!-- ([\w./~-]+\.\w+) -->\n```\w*\n)(.*?)(```\n)", re.DOTALL)
FIGURES = re.compile(r"(<!-- figures -->\n)(.*?)(<!-- /figures -->\n)", re.DOTALL)
PACKAGE = re.compile(r"(find_package\(incise )([\d.]+)")
CONSUMER = ROOT / "tests/install/consumer/CMakeLists.txt"
LINK = re.compile(r"\]\(([^)\s]+)\)")


def pages() -> list[pathlib.Path]:
    """The Markdown files of the project, as git knows them."""
    listed = subprocess.run(["git", "-C", str(ROOT), "ls-files", "--cached", "--others", "--exclude-standard", "*.md"],
                            capture_output=True, text=True, check=False)
    if listed.returncode == 0 and listed.stdout:
        return [path for path in (ROOT / line for line in listed.stdout.splitlines()) if path.is_file()]
    return [path for path in ROOT.rglob("*.md") if not {"build", "node_modules"} & set(path.relative_to(ROOT).parts)]


def shown(path: pathlib.Path) -> str:
    """The text of an example as a page shows it: without the line that says what the file is."""
    text = path.read_text()
    return re.sub(r'\A(//[^\n]*\n|"""[^\n]*"""\n)', "", text)


def anchors(text: str) -> set[str]:
    """GitHub's names for the headings."""
    found = set()
    outside = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    for title in re.findall(r"^#+ +(.*)$", outside, re.MULTILINE):
        name = re.sub(r"[^\w\- ]", "", title.strip().lower()).replace(" ", "-")
        found.add(name)
    return found


def version() -> str:
    """The version of the project: CMakeLists.txt is the one place that has it."""
    return re.search(r"^project\(incise VERSION ([\d.]+)", (ROOT / "CMakeLists.txt").read_text(), re.MULTILINE)[1]


def fill(text: str, figures: str) -> str:
    text = BLOCK.sub(lambda m: m[1] + shown(ROOT / m[2]) + m[4] if (ROOT / m[2]).is_file() else m[0], text)
    text = PACKAGE.sub(lambda m: m[1] + version().rpartition(".")[0], text)
    return FIGURES.sub(lambda m: m[1] + figures + m[3], text)


def faults_of(page: pathlib.Path, text: str) -> list[str]:
    name = page.relative_to(ROOT)
    faults = []
    for m in BLOCK.finditer(text):
        if not (ROOT / m[2]).is_file():
            faults.append(f"{name}: shows {m[2]}, which does not exist")
    for target in LINK.findall(re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, fragment = target.partition("#")
        other = (page.parent / path).resolve() if path else page
        if not other.exists():
            faults.append(f"{name}: the link {target} leads nowhere")
        elif fragment and other.suffix == ".md" and fragment not in anchors(other.read_text()):
            faults.append(f"{name}: {path or name} has no heading #{fragment}")
    return faults


def main() -> int:
    write = sys.argv[1:] == ["--write"]
    figures = subprocess.run([sys.executable, "-B", str(ROOT / "tests/bench/figures.py")], capture_output=True, text=True,
                             check=True).stdout
    faults = []
    for page in [*pages(), CONSUMER]:
        text = page.read_text()
        wanted = fill(text, figures)
        if wanted != text and write:
            page.write_text(wanted)
        elif wanted != text:
            faults.append(f"{page.relative_to(ROOT)}: code, figures or version are not up to date: run tests/dev/docs.py --write")
        faults += faults_of(page, wanted)
    lines = (ROOT / "README.md").read_text().count("\n")
    if lines > README_LINES:
        faults.append(f"README.md: {lines} lines; at most {README_LINES}: move details to the page of their subject")
    if f"\n## {version()}\n" not in (ROOT / "CHANGELOG.md").read_text():
        faults.append(f"CHANGELOG.md: no section for {version()}, the version in CMakeLists.txt: rename Unreleased to it")
    print("\n".join(faults), file=sys.stderr, end="\n" if faults else "")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
