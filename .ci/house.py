"""How large each package is, beside its budget; fails where one is above it.

Budgets (`.ci/budgets.toml`) only go down: `python .ci/house.py --tighten` lowers them to what stands. Lines
are those of files as `ruff format` and `clang-format` leave them, blank lines and docstrings included.
"""

from __future__ import annotations

import ast
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
BUDGETS = ROOT / ".ci" / "budgets.toml"
SUFFIXES = (".py", ".pyi", ".cpp", ".hpp")
HEAD = """\
# What `make lint` allows each package: lines, files, and numeric constants of modules. These numbers only go
# down (`python .ci/house.py --tighten`). A feature that needs room finds it by making something simpler.
"""


class Size(NamedTuple):
    """Of one package."""

    lines: int
    files: int
    constants: int


def main() -> int:
    """Print the table; the exit status is 1 where a budget is broken."""
    budgets = {name: Size(**one) for name, one in tomllib.loads(BUDGETS.read_text()).items()}
    found = sizes(list(budgets))
    if "--tighten" in sys.argv:
        budgets = {name: Size(*map(min, zip(found[name], one, strict=True))) for name, one in budgets.items()}
        tables = (
            f'["{name}"]\n' + "".join(f"{k} = {v}\n" for k, v in one._asdict().items())
            for name, one in budgets.items()
        )
        BUDGETS.write_text(HEAD + "\n" + "\n".join(tables))
    print(f"{'package':<24}{'lines':>8}{'of':>8}{'files':>8}{'of':>6}{'constants':>11}{'of':>5}")
    broken = []
    for name, most in budgets.items():
        now = found[name]
        print(f"{name:<24}{now[0]:>8}{most[0]:>8}{now[1]:>8}{most[1]:>6}{now[2]:>11}{most[2]:>5}")
        broken += [
            f"{name}: {value} {what}, the budget is {limit}"
            for what, value, limit in zip(Size._fields, now, most, strict=True)
            if value > limit
        ]
    for line in broken:
        print(line, file=sys.stderr)
    return 1 if broken else 0


def sizes(names: list[str]) -> dict[str, Size]:
    """Sizes of packages; a file counts in the longest name that is its folder or a parent of it."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.splitlines()
    found = dict.fromkeys(names, Size(0, 0, 0))
    for file in listed:
        path = ROOT / file
        owners = [name for name in names if name == "all" or file.startswith(f"{name}/")]
        if not owners or path.suffix not in SUFFIXES or path.is_symlink() or not path.is_file():
            continue
        if not file.startswith(("ffsms_pin/", "opt/", "urdf/")):
            continue
        text = path.read_text()
        own = Size(len(text.splitlines()), 1, constants(text) if path.suffix == ".py" else 0)
        # The whole is of Python; what is compiled has a budget of its own.
        for name in {max(owners, key=len), "all" if path.suffix == ".py" else ""} & set(names):
            found[name] = Size(*map(sum, zip(found[name], own, strict=True)))
    return found


def constants(text: str) -> int:
    """Names in capitals that a module gives, at its top level, to what has a number in it."""
    count = 0
    for node in ast.parse(text).body:
        if not isinstance(node, (ast.Assign, ast.AnnAssign)) or node.value is None:
            continue
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        names = [one.id for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)]
        leaves = [one.value for one in ast.walk(node.value) if isinstance(one, ast.Constant)]
        if any(type(value) in (int, float) for value in leaves):
            count += sum(name.isupper() for name in names)
    return count


if __name__ == "__main__":
    sys.exit(main())
