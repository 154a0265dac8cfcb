"""Store the outputs of measuring commands as records in docs/records, and write them into the pages.

    python docs/records.py run NAME [COMMAND...]   run the command and store its output as a record
    python docs/records.py                         write all records into the pages
    python docs/records.py check                   print the faults of the pages, as the build does

A page shows the record docs/records/NAME.md between `<!-- record: NAME -->` and `<!-- end -->`, with the
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
# _NUMBER matches a number with a unit in a sentence. _SOURCE matches a command or a test as the source of a
# paragraph's numbers, or the mark of chosen numbers.
_NUMBER = re.compile(r"\b(\d+(?:\.\d+)?) (?:%|mm|mN|deg(?:rees)?\b|rad|s\b|ms|us|MB|GB|N\b|times|of \d)")
_SOURCE = re.compile(r"`(?:tests/[\w/]+\.py|(?:python|pytest|make|ffsms-pin) [^`]+)`|<!-- given -->")
_APART = re.compile(r"^```[\s\S]*?^```|^\|.*|^ {4}.*|^\*Copied from .*|<!-- (?!given).*? -->", re.M)
_DECIMAL = re.compile(r"\d\.\d|\d of \d|\de-?\d")
_PLACEHOLDER = re.compile(r"@@.*@@|\bTODO\b|\bTBD\b|\bFIXME\b|\?\?\?")


class Record(NamedTuple):
    """The output of a command, with the day, the machine, and a hash of the command's code (`source`)."""

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
    """Return the stored record `name`."""
    path = KEPT / f"{name}.md"
    if not path.is_file():
        raise SystemExit(f"no record {name!r}: python docs/records.py run {name} COMMAND makes it")
    head, _, output = path.read_text("utf-8").partition("\n\n")
    return Record(*(line.partition(": ")[2] for line in head.splitlines()), output.strip("\n"))


def run(name: str, command: str) -> None:
    """Run a command and store its output as a record; a failed command leaves the record unchanged."""
    sys.path.insert(0, str(ROOT / "benchmarks"))
    from machine import facts

    about = facts()
    done = subprocess.run(command, shell=True, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    machine = f"{about['processor']}, {about['cores']} cores, Python {about['python']}"
    record = Record(command, date.today().isoformat(), machine, source_of(command), done.stdout.strip("\n"))
    KEPT.mkdir(exist_ok=True)
    (KEPT / f"{name}.md").write_text(record.text(), "utf-8")


def source_of(command: str) -> str:
    """Return a hash of the code of a command: the files and packages in it, and the scripts they import."""
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
    """Return the text of a file; the text of Python has no docstrings, comments and empty lines."""
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
    """Return the files beside a script that the script imports."""
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
    """Return the text of a page with the stored records between its marks."""
    return _BLOCK.sub(lambda match: match[1] + read(match[2]).block() + match[3], text)


def marked(text: str) -> str:
    """Return the text of a page with a note at each record whose command has changed since the run."""
    return _BLOCK.sub(lambda match: match[0] + (CHANGED if read(match[2]).changed() else ""), text)


def faults(path: Path) -> list[str]:
    """Return a line for each fault of a page: a placeholder, an old record, or a number without a source."""
    text = path.read_text("utf-8")
    messages = [f"{match[0]!r} is a placeholder" for match in _PLACEHOLDER.finditer(text)]
    if with_records(text) != text:
        messages.append("shows old records; write the stored records into the pages: python docs/records.py")
    for table in _TABLE.finditer(_BLOCK.sub("", text)):
        head, _, *rows = table[0].splitlines()
        numbers = sum(bool(_DECIMAL.search(row)) for row in rows) * 2 > len(rows)
        if numbers and not table[1] and not head.startswith("| key |"):
            messages.append(
                f"the table {head[:60]!r} has numbers that are in no record (see docs/records.py)"
            )
    return [f"{path.relative_to(ROOT)}: {line}" for line in messages + unrecorded(text)]


def unrecorded(text: str) -> list[str]:
    """Return a message for each number of a sentence that is in no record of the page.

    A paragraph that names a test or a command as its source is not checked. A paragraph with the mark
    `<!-- given -->` is not checked, either, because its numbers were chosen or follow from other numbers.
    """
    shown = "".join(read(match[2]).output for match in _BLOCK.finditer(text))
    known = [float(number) for number in re.findall(r"\d+(?:\.\d+)?", shown)]
    messages = []
    for paragraph in re.split(r"\n\n|\n(?=[*-] |\d+\. )", _APART.sub("", _BLOCK.sub("", text))):
        for number in [] if _SOURCE.search(paragraph) else _NUMBER.findall(paragraph):
            rounding = 0.5 * 10.0 ** -len(number.partition(".")[2])
            if not any(abs(float(number) - value) <= rounding for value in known):
                messages.append(f"{number} is in no record of the page: {' '.join(paragraph.split())[:60]!r}")
    return messages


def main(arguments: list[str]) -> int:
    """Run the command line that the module's docstring describes; return the exit code."""
    if arguments[:1] == ["run"]:
        name = arguments[1]
        run(name, " ".join(arguments[2:]) or read(name).command)
    if arguments == ["check"]:
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
