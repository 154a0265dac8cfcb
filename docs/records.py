"""The measured numbers of the pages: records of the outputs of commands, in docs/records.

    python docs/records.py run NAME [COMMAND...]   run the command and store its output as a record
    python docs/records.py                         write all records into the pages
    python docs/records.py check                   print the faults of the pages, as the build does

Between `<!-- record: NAME -->` and `<!-- end -->` a page has the output in docs/records/NAME.md, with the
command, the day and the machine. The site marks records whose command has changed since the run.
"""

from __future__ import annotations

import ast
import hashlib
import io
import re
import subprocess
import sys
import tokenize
from datetime import date
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
KEPT = ROOT / "docs" / "records"
CHANGED = "\n**The command has changed since.**\n"
_BLOCK = re.compile(r"(<!-- record: ([\w-]+) -->\n).*?(<!-- end -->)", re.S)
_TABLE = re.compile(r"(?:^\|.*\n){2,}\n?(?=(\*Copied from `.+, \d{4}.*\*$|<!-- not measured -->)?)", re.M)
# A number with a unit in a sentence; a source of a paragraph's numbers, or the mark of chosen numbers.
_NUMBER = re.compile(r"\b(\d+(?:\.\d+)?) (?:%|mm|mN|deg(?:rees)?\b|rad|s\b|ms|us|MB|GB|N\b|times|of \d)")
_SOURCE = re.compile(r"`(?:tests/[\w/]+\.py|(?:python|pytest|make|ffsms-pin) [^`]+)`|<!-- given -->")
_APART = re.compile(r"^```[\s\S]*?^```|^\|.*|^ {4}.*|^\*Copied from .*|<!-- (?!given).*? -->", re.M)
_DECIMAL = re.compile(r"\d\.\d|\d of \d|\de-?\d")
_PLACEHOLDER = re.compile(r"@@.*@@|\bTODO\b|\bTBD\b|\bFIXME\b|\?\?\?")


class Record(NamedTuple):
    """The output of a command, with the day, the machine, and the hash of the command's code."""

    command: str
    day: str
    machine: str
    source: str
    output: str

    def text(self) -> str:
        """Return the text of the record's file."""
        head = zip(self._fields[:-1], self[:-1], strict=True)
        return "".join(f"{key}: {value}\n" for key, value in head) + f"\n{self.output}\n"

    def changed(self) -> bool:
        """Return whether the command's code has changed since the run."""
        return self.source != source_of(self.command)

    def block(self) -> str:
        """Return the record as Markdown for a page."""
        shown = self.output if "\n|" in f"\n{self.output}" else f"```\n{self.output}\n```"
        return f"\n{shown}\n\n*`{self.command}`, {self.day}, {self.machine}.*\n\n"


def read(name: str) -> Record:
    """Read the record of a name."""
    path = KEPT / f"{name}.md"
    if not path.is_file():
        raise SystemExit(f"no record {name!r}: python docs/records.py run {name} COMMAND makes it")
    head, _, output = path.read_text("utf-8").partition("\n\n")
    return Record(*(line.partition(": ")[2] for line in head.splitlines()), output.strip("\n"))


def run(name: str, command: str) -> None:
    """Run a command and store its output as a record; if the command fails, store nothing."""
    sys.path.insert(0, str(ROOT / "benchmarks"))
    from machine import facts

    found = facts()
    done = subprocess.run(command, shell=True, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    machine = f"{found['processor']}, {found['cores']} cores, Python {found['python']}"
    record = Record(command, date.today().isoformat(), machine, source_of(command), done.stdout.strip("\n"))
    KEPT.mkdir(exist_ok=True)
    (KEPT / f"{name}.md").write_text(record.text(), "utf-8")


def source_of(command: str) -> str:
    """Return a hash of the files and packages that a command names, and of the scripts that these import."""
    seen: set[Path] = set()
    todo = [path for word in command.split() if (path := ROOT / word).is_file()]
    modules = [word.replace(".", "/") for word in command.split()]  # for python -m
    for package in (root / module for module in modules for root in (ROOT, ROOT / "tests")):
        todo += sorted(package.rglob("*.py")) if (package / "__main__.py").is_file() else []
    while todo:
        path = todo.pop()
        if path not in seen:
            seen.add(path)
            todo += _imported(path) if path.suffix == ".py" else []
    text = "".join(_code(path) for path in sorted(seen))
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def _code(path: Path) -> str:
    """Return the text of a file; for Python without docstrings, comments and empty lines."""
    text = path.read_text("utf-8")
    if path.suffix != ".py":
        return text
    lines = text.splitlines()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            row, column = token.start
            lines[row - 1] = lines[row - 1][:column]
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            lines[node.lineno - 1 : node.end_lineno] = [""] * (node.end_lineno - node.lineno + 1)
    return "".join(f"{line.rstrip()}\n" for line in lines if line.strip())


def _imported(path: Path) -> list[Path]:
    """Return the files in the folder of a script that the script imports."""
    names: list[str] = []
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names.append(node.module or "")
    return [file for name in names if (file := path.with_name(f"{name}.py")).is_file()]


def pages() -> list[Path]:
    """Return the paths of the README and of the site's hand-written pages."""
    made = {"paper-map.md", "agreement.md"}
    return [ROOT / "README.md", *(p for p in sorted((ROOT / "docs").glob("*.md")) if p.name not in made)]


def with_records(text: str) -> str:
    """Return the text of a page with its records replaced by the stored ones."""
    return _BLOCK.sub(lambda found: found[1] + read(found[2]).block() + found[3], text)


def marked(text: str) -> str:
    """Return the text of a page with marks on records whose command has changed since the run."""
    return _BLOCK.sub(lambda found: found[0] + (CHANGED if read(found[2]).changed() else ""), text)


def faults(path: Path) -> list[str]:
    """Return the faults of the numbers of a page, one line each."""
    text = path.read_text("utf-8")
    found = [f"{word[0]!r} is a placeholder" for word in _PLACEHOLDER.finditer(text)]
    if with_records(text) != text:
        found.append("does not show its records as they are kept: python docs/records.py")
    for table in _TABLE.finditer(_BLOCK.sub("", text)):
        head, _, *rows = table[0].splitlines()
        numbers = sum(bool(_DECIMAL.search(row)) for row in rows) * 2 > len(rows)
        if numbers and not table[1] and not head.startswith("| key |"):
            found.append(f"the table {head[:60]!r} has numbers of no record (see docs/records.py)")
    return [f"{path.relative_to(ROOT)}: {line}" for line in found + unsaid(text)]


def unsaid(text: str) -> list[str]:
    """Return messages about numbers in sentences that are in no record, if the paragraph has no source.

    `<!-- given -->` marks a paragraph whose numbers were chosen, or follow from others.
    """
    shown = "".join(read(found[2]).output for found in _BLOCK.finditer(text))
    known = [float(one) for one in re.findall(r"\d+(?:\.\d+)?", shown)]
    found = []
    for paragraph in re.split(r"\n\n|\n(?=[*-] |\d+\. )", _APART.sub("", _BLOCK.sub("", text))):
        for number in [] if _SOURCE.search(paragraph) else _NUMBER.findall(paragraph):
            rounding = 0.5 * 10.0 ** -len(number.partition(".")[2])
            if not any(abs(float(number) - value) <= rounding for value in known):
                found.append(f"{number} is in no record of the page: {' '.join(paragraph.split())[:60]!r}")
    return found


def main(words: list[str]) -> int:
    """Run the command line that the module's docstring describes; return the exit code."""
    if words[:1] == ["run"]:
        name = words[1]
        run(name, " ".join(words[2:]) or read(name).command)
    if words == ["check"]:
        wrong = [line for path in pages() for line in faults(path)]
        sys.stderr.writelines(f"{line}\n" for line in wrong)
        return bool(wrong)
    for path in pages():
        text = path.read_text("utf-8")
        if (new := with_records(text)) != text:
            path.write_text(new, "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
