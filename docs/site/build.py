"""The documentation site: lays the pages out, runs the tutorials, and calls Sphinx with warnings as errors.

    python docs/site/build.py OUT

needs the installed package, sphinx, myst-parser, furo, nbclient and ipykernel. Tutorials are the stories of python/examples with what they print; notebooks
are run; the keys of every spec come from the tables of the program; links between pages, and to files of the repository, are checked. A story
or notebook that fails, a link without an end, and a docstring that cannot be read fail the build.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import dynocal

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).resolve().parent
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)")

# Pages of docs/ by the part of the site that they are in.
PARTS = {
    "Start": ["python", "coming_from"],
    "How to": [
        "identify", "design", "sequential", "simulate", "optimise", "map", "calibrate", "bed", "testbed", "control", "labels", "fuelling",
        "many", "formats", "summary",
    ],
    "Background": ["theory", "virtual_engine", "architecture"],
}


def linked(text: str, page: Path, pages: set[str]) -> str:
    """Links to other pages stay; those to files of the repository become their names. What is not there is an error."""

    def one(found: re.Match[str]) -> str:
        image, words, target = found.groups()
        if target.startswith(("http://", "https://", "#", "mailto:")):
            return found[0]
        file = (page.parent / target.split("#")[0]).resolve()
        if not file.exists():
            raise SystemExit(f"{page.relative_to(ROOT)}: found a link to {target}, which is not there")
        if file.parent == ROOT / "docs" and file.suffix == ".md" and file.stem in pages:
            return found[0]
        name = f"`{file.relative_to(ROOT)}`"
        return name if words in (str(file.relative_to(ROOT)), target) or image else f"{words} ({name})"

    # Code is left as it is.
    parts = re.split(r"(```.*?```|`[^`\n]*`)", text, flags=re.DOTALL)
    return "".join(part if k % 2 else LINK.sub(one, part) for k, part in enumerate(parts))


def story(script: Path, work: Path) -> str:
    """A tutorial: the words of a script, its code, and what it prints now."""
    code = script.read_text(encoding="utf-8")
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, cwd=work)
    if done.returncode:
        raise SystemExit(f"{script.name}: {done.stderr}")
    words, body = re.fullmatch(r'"""(.*?)"""\n(.*)', code, flags=re.DOTALL).groups()
    title, _, rest = words.partition(":")
    said = f"{rest.strip()[:1].upper()}{rest.strip()[1:]}"
    return f"# {title}\n\n{said}\n\n```python\n{body.strip()}\n```\n\nprints\n\n```text\n{done.stdout.rstrip()}\n```\n"


def notebook(path: Path, work: Path, pictures: Path) -> str:
    """A notebook that has been run, as a page."""
    import base64

    import nbformat
    from nbclient import NotebookClient

    found = nbformat.read(path, as_version=4)
    NotebookClient(found, timeout=600, kernel_name="python3", resources={"metadata": {"path": str(work)}}).execute()
    out = []
    for k, cell in enumerate(found.cells):
        if cell.cell_type == "markdown":
            out.append(cell.source)
            continue
        out.append(f"```python\n{cell.source}\n```")
        for n, said in enumerate(cell.outputs):
            data = said.get("data", {})
            if "image/png" in data:
                name = f"{path.stem}-{k}-{n}.png"
                (pictures / name).write_bytes(base64.b64decode(data["image/png"]))
                out.append(f"![{path.stem}, picture {n + 1} of cell {k + 1}]({name})")
            elif "text/html" in data:
                out.append(f"```{{raw}} html\n{data['text/html']}\n```")
            else:
                text = said.get("text") or data.get("text/plain", "")
                out.append(f"```text\n{text.rstrip()}\n```")
    return "\n\n".join(out) + "\n"


def cell(value: object) -> str:
    return str(value).replace("|", "\\|").replace("\n", " ").replace("<", "&lt;")


def keys() -> dict[str, str]:
    """A page for each family of members, from the tables of the program."""
    pages = {}
    for family, what in dynocal.members().items():
        out = [f"# {family}", f"{cell(what)}"]
        for name, member in dynocal.members(family).items():
            out += [f"## {name}", cell(member["what"])]
            if member["params"]:
                rows = [
                    f"| `{p['name']}` | {cell(p.get('unit', ''))} | {cell(p.get('default', ''))} | {cell(p.get('what', ''))} |" for p in member["params"]
                ]
                out.append("\n".join(["| key | unit | default | what |", "|---|---|---|---|", *rows]))
        pages[family] = "\n\n".join(out) + "\n"
    return pages


def tree(title: str, pages: list[str]) -> str:
    return "\n".join([f"```{{toctree}}", ":maxdepth: 1", f":caption: {title}", "", *pages, "```", ""])


# Methods that scikit-learn puts into its estimators; their words are its own.
MADE_BY_OTHERS = "set_fit_request, set_score_request"
API = ["", "executors", "gym", "sklearn", "errors"]


def api() -> str:
    """Every public name; a module that needs a package which is not installed is left out by Sphinx with an error."""
    out = ["# API", "", "All names are those of `dynocal`; what it needs beyond NumPy is imported where it is used.", ""]
    for name in dynocal.__all__:
        thing = getattr(dynocal, name)
        if isinstance(thing, type):
            out.append(f"```{{eval-rst}}\n.. autoclass:: dynocal.{name}\n   :members:\n   :inherited-members: Exception\n```\n")
        elif callable(thing):
            out.append(f"```{{eval-rst}}\n.. autofunction:: dynocal.{name}\n```\n")
    for name in API[1:]:
        out.append(f"## dynocal.{name}\n\n```{{eval-rst}}\n.. automodule:: dynocal.{name}\n   :exclude-members: {MADE_BY_OTHERS}\n```\n")
    return "\n".join(out)


def lay_out(source: Path, work: Path) -> None:
    """All pages as Sphinx reads them."""
    pages = {name for part in PARTS.values() for name in part}
    (source / "docs").mkdir(parents=True)
    for name in sorted(pages):
        page = ROOT / "docs" / f"{name}.md"
        (source / "docs" / f"{name}.md").write_text(linked(page.read_text(encoding="utf-8"), page, pages), encoding="utf-8")
    missing = {p.stem for p in (ROOT / "docs").glob("*.md")} - pages
    if missing:
        raise SystemExit(f"docs: found pages that no part of the site has: {sorted(missing)}")
    (source / "tutorials").mkdir()
    stories = sorted((ROOT / "python" / "examples").glob("*.py"))
    for script in stories:
        (source / "tutorials" / f"{script.stem}.md").write_text(story(script, work), encoding="utf-8")
    (source / "notebooks").mkdir()
    notebooks = sorted((ROOT / "python" / "notebooks").glob("*.ipynb"))
    for path in notebooks:
        (source / "notebooks" / f"{path.stem}.md").write_text(notebook(path, work, source / "notebooks"), encoding="utf-8")
    (source / "keys").mkdir()
    for family, text in keys().items():
        (source / "keys" / f"{family}.md").write_text(text, encoding="utf-8")
    (source / "api.md").write_text(api(), encoding="utf-8")
    index = ["# dynocal", "", "Dynamic powertrain calibration: test design, identification, optimisation, dynamic maps.", ""]
    index.append(tree("Start", [f"docs/{n}" for n in PARTS["Start"]]))
    index.append(tree("Tutorials", [f"tutorials/{p.stem}" for p in stories]))
    index.append(tree("Notebooks", [f"notebooks/{p.stem}" for p in notebooks]))
    index.append(tree("How to", [f"docs/{n}" for n in PARTS["How to"]]))
    index.append(tree("Background", [f"docs/{n}" for n in PARTS["Background"]]))
    index.append(tree("Keys of every spec", [f"keys/{n}" for n in sorted(keys())]))
    index.append(tree("Reference", ["api"]))
    (source / "index.md").write_text("\n".join(index), encoding="utf-8")


def main() -> int:
    out = Path(sys.argv[1]).resolve()
    with tempfile.TemporaryDirectory() as folder:
        source, work = Path(folder) / "source", Path(folder) / "work"
        work.mkdir()
        source.mkdir()
        lay_out(source, work)
        shutil.copy(HERE / "conf.py", source / "conf.py")
        shutil.rmtree(out, ignore_errors=True)
        command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", str(source), str(out)]
        done = subprocess.run(command).returncode
    if done == 0:
        pages = sorted(out.rglob("*.html"))
        print(json.dumps({"pages": len(pages), "megabytes": round(sum(p.stat().st_size for p in out.rglob("*") if p.is_file()) / 1e6, 1)}))
    return done


if __name__ == "__main__":
    sys.exit(main())
