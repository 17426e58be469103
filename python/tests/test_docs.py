"""The examples of the docstrings and of docs/python.md are run."""

import doctest
import os

import esker
import esker._arguments
import esker._points
import esker._store
import esker.errors
import pytest
from conftest import ROOT

FLAGS = doctest.NORMALIZE_WHITESPACE | doctest.IGNORE_EXCEPTION_DETAIL


@pytest.fixture
def names(tmp_path):
    """What examples take as given."""
    files = esker.generate("site", 60_000, tmp_path, scans=3)
    path = str(tmp_path / "site.esker")
    esker.ingest(path, files)
    with esker.open(path) as store:
        yield {"esker": esker, "store": store, "path": path, "folder": str(tmp_path), "os": os}


@pytest.mark.parametrize("module, least", [(esker, 4), (esker._store, 30)], ids=lambda m: getattr(m, "__name__", ""))
def test_docstrings(names, module, least):
    result = doctest.testmod(module, extraglobs=names, optionflags=FLAGS)
    assert result.failed == 0 and result.attempted >= least


def test_the_page(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = doctest.testfile(str(ROOT / "docs" / "python.md"), module_relative=False, optionflags=FLAGS)
    assert result.failed == 0 and result.attempted >= 10


def test_everything_public_is_documented():
    for name in esker.__all__:
        thing = getattr(esker, name)
        assert thing.__doc__, name
        for member, value in vars(thing).items() if isinstance(thing, type) else ():
            if not member.startswith("_") and (callable(value) or isinstance(value, property)):
                assert value.__doc__, f"{name}.{member}"
