"""The code in the pages runs, in the order of the page."""

from __future__ import annotations

import re

import pytest

PAGES = ["python", "many", "coming_from"]


@pytest.mark.parametrize("name", PAGES)
def test_code_of_the_page_runs(name: str, root, tmp_path, monkeypatch) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (root / "docs" / f"{name}.md").read_text(encoding="utf-8"), flags=re.DOTALL)
    assert blocks, f"docs/{name}.md has no code"
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "page"}
    for block in blocks:
        exec(compile(block, f"docs/{name}.md", "exec"), names)


def test_every_notebook_is_without_outputs(root) -> None:
    """Outputs are made where the site is built: what is stored would be old some day."""
    import json

    notebooks = sorted((root / "python" / "notebooks").glob("*.ipynb"))
    assert len(notebooks) >= 5
    for path in notebooks:
        for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
            assert cell.get("outputs", []) == [] and cell.get("execution_count") is None, path.name
