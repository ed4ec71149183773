"""The package as a whole: types, examples in its words, names, import."""

from __future__ import annotations

import doctest
import importlib
import inspect
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest

import dynocal

PACKAGE = Path(dynocal.__file__).parent


def modules() -> list[str]:
    own = [m.name for m in pkgutil.iter_modules([str(PACKAGE)]) if m.name not in ("_dynocal", "__main__")]
    return ["dynocal", *(f"dynocal.{name}" for name in own)]


@pytest.mark.parametrize("name", modules())
def test_examples_in_the_words_run(name: str) -> None:
    try:
        module = importlib.import_module(name)
    except dynocal.errors.MissingPackageError as error:
        pytest.skip(str(error))
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    assert doctest.testmod(module, optionflags=flags).failed == 0
    # What is at the boundary is wrapped: doctest looks for functions of the module itself.
    runner, finder = doctest.DocTestRunner(optionflags=flags), doctest.DocTestFinder()
    for function in (inspect.unwrap(f) for f in vars(module).values() if inspect.isfunction(f)):
        if function.__module__ == module.__name__:
            for example in finder.find(function, globs=vars(module).copy()):
                runner.run(example)
    assert runner.failures == 0
    assert runner.tries > 0 or name != "dynocal"


def test_names_are_what_they_are() -> None:
    for name in dynocal.__all__:
        assert getattr(dynocal, name).__doc__, name
    assert (PACKAGE / "py.typed").is_file()


def test_every_member_of_the_tables_can_be_named() -> None:
    """What the program lists, this lists: the estimators take every structure and every estimator by its name."""
    from dynocal import _members

    families = dynocal.members()
    assert {"signals", "models", "estimators", "criteria", "plants", "formats"} <= set(families)
    found = {family: sorted(dynocal.members(family)) for family in families}
    assert found == {k: sorted(v) for k, v in _members.MEMBERS.items()}, "run python/members.py"


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True)


def test_stubs_are_what_is_there() -> None:
    pytest.importorskip("mypy")
    done = run("-m", "mypy.stubtest", "dynocal._dynocal")
    assert done.returncode == 0, done.stdout + done.stderr


def test_types(root) -> None:
    pytest.importorskip("mypy")
    scripts = [str(p) for p in sorted((root / "python" / "examples").glob("*.py"))]
    for what in (["-p", "dynocal"], scripts):
        done = run("-m", "mypy", "--strict", "--config-file", str(root / "pyproject.toml"), *what)
        assert done.returncode == 0, done.stdout + done.stderr


IMPORT = """
import sys, time
import numpy
start = time.perf_counter()
import dynocal
took = time.perf_counter() - start
heavy = {"pandas", "polars", "matplotlib", "scipy", "sklearn", "pyarrow", "gymnasium", "control", "distributed"} & set(sys.modules)
print(took, sorted(heavy))
"""


def test_import_asks_for_nothing_but_numpy() -> None:
    took, heavy = run("-c", IMPORT).stdout.split(" ", 1)
    assert heavy.strip() == "[]"
    print(f"import beyond NumPy: {float(took):.3f} s")


def test_no_handler_is_installed() -> None:
    text = "import signal; a = signal.getsignal(signal.SIGINT); import dynocal; dynocal.members(); print(signal.getsignal(signal.SIGINT) is a)"
    assert run("-c", text).stdout.strip() == "True"


def test_examples_run(root, tmp_path) -> None:
    for script in sorted((root / "python" / "examples").glob("*.py")):
        done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, cwd=tmp_path)
        assert done.returncode == 0, f"{script.name}: {done.stderr}"
        assert done.stdout.strip(), script.name


def test_modules_that_load_when_asked_for() -> None:
    assert dynocal.executors.Local(1) is not None
    with pytest.raises(AttributeError, match="no `nothing`"):
        dynocal.nothing
