"""The examples in the docstrings, of every module."""

import doctest
import importlib
import pkgutil

import pytest

import dalembert

# Running __main__ would run the command, and what builds the extension is not installed.
MODULES = sorted(
    {
        module.name.removeprefix("dalembert.")
        for module in pkgutil.walk_packages(dalembert.__path__, "dalembert.")
        if not module.name.endswith("__main__")
    }
    - {"_core", "_ffi_build"}
)


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("name", ["", *MODULES])
def test_examples(name):
    for other in MODULES:  # a module that comes with its first use would disturb the search
        importlib.import_module(f"dalembert.{other}")
    module = importlib.import_module(f"dalembert.{name}".rstrip("."))
    assert doctest.testmod(module).failed == 0


@pytest.mark.parametrize("name", sorted(set(dalembert.__all__) - {"systems"}))
def test_what_is_called_has_an_example(name):
    member = getattr(dalembert, name)
    if callable(member) and not isinstance(member, type):
        assert doctest.DocTestFinder(recurse=False).find(member)[0].examples
