"""List the constants of the correctors and the pixel model: place, name, value, kind, reason.

    python studies/constants.py

The comment of each number with a name at the top of a module begins with its kind:

- prior: what a likelihood expects, with the source of its width;
- tolerance: ranks, iterations, step sizes, which change the precision of a result;
- warning: a limit from which on a result has a warning;
- branch: a limit from which on something else is computed.
"""

import ast
import csv
from pathlib import Path

KINDS = ("prior", "tolerance", "warning", "branch")
COLUMNS = ("module", "name", "value", "kind", "reason")
PACKAGE = Path(__file__).parents[1] / "scope_models"
FOLDERS = [PACKAGE / name for name in ("correctors", "pixelmodel", "regression")]


def constants(*folders):
    """Return a dictionary for each number with a name in folders, by default the package's."""
    found = []
    for path in sorted(path for folder in folders or FOLDERS for path in folder.glob("*.py")):
        text = path.read_text(encoding="utf-8")
        lines, comment, end = text.splitlines(), "", 0
        for node in (node for node in ast.parse(text).body if isinstance(node, ast.Assign)):
            first = node.lineno - 1
            while first and lines[first - 1].startswith("#:"):
                first -= 1
            if first < node.lineno - 1:
                comment = " ".join(line[2:].strip() for line in lines[first : node.lineno - 1])
            elif first > end:  # not right below another one, which shares its comment
                comment = ""
            end = node.end_lineno
            kind, _, reason = comment.partition(": ")
            kind = kind.lower() if kind.lower() in KINDS else ""
            for name, value in named(node):
                row = path.stem, name, ast.unparse(value), kind, reason if kind else comment
                found.append(dict(zip(COLUMNS, row, strict=True)))
    return found


def named(node):
    """Yield names and values of an assignment whose values are or hold numbers."""
    names = getattr(node.targets[0], "elts", node.targets)
    pairs = len(names) > 1 and isinstance(node.value, ast.Tuple)
    values = node.value.elts if pairs else [node.value] * len(names)
    for name, value in zip(names, values, strict=True):
        parts = (part.value for part in ast.walk(value) if isinstance(part, ast.Constant))
        if any(type(part) in {int, float} for part in parts):
            yield name.id, value


def write(path):
    """Write the table of the page on PLD as CSV."""
    with Path(path).open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(constants())


def main():
    rows = constants()
    for row in rows:
        print("{module:17}{name:24}{value:32.30}{kind:11}{reason}".format(**row))
    print(len(rows), "constants")


if __name__ == "__main__":
    main()
