"""Writes python/dynocal/_members.py from the tables of the program: run it where a member is added or removed."""

from __future__ import annotations

from pathlib import Path

import dynocal


def main() -> None:
    """Writes the file beside this one's package."""
    lines = [
        '"""Names that a spec can hold, by family. Written by python/members.py from the tables of the program."""',
        "",
        "MEMBERS: dict[str, tuple[str, ...]] = {",
    ]
    for family in dynocal.members():
        lines.append(f'    "{family}": (')
        lines.extend(f'        "{name}",' for name in dynocal.members(family))
        lines.append("    ),")
    lines.append("}")
    path = Path(__file__).parent / "dynocal" / "_members.py"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(path)


if __name__ == "__main__":
    main()
