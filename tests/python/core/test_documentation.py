"""Docstrings with shared sections name every parameter, in the order of the signature."""

import inspect
import re

import dalembert as dal
import pytest
from dalembert.core.documentation import Shared


class Documented(Shared):
    """Entries that the functions share.

    Parameters
    ----------
    q, v : array_like
    v : array_like, optional
        Default 0.

    Raises
    ------
    ValueError
        For an argument.
    TypeError
        For a type.
    """


def members():
    """Yield the public functions and methods that document their parameters."""
    for name in dal.__all__:
        one = getattr(dal, name)
        several = inspect.getmembers(one, inspect.isfunction) if isinstance(one, type) else []
        for key, member in [*several, ("", one)]:
            documented = "Parameters\n" in (inspect.getdoc(member) or "")
            if inspect.isfunction(member) and documented and not key.startswith("_"):
                yield f"{name}.{key}".rstrip("."), member


def test_shared_sections_come_before_and_after_own_ones():
    @Documented("ValueError, TypeError", "float")
    def function(q, v, h=1.0, *, keep):
        """Return it.

        Parameters
        ----------
        keep : bool
            Whether: it stays.
        h : float, optional

        Raises
        ------
        KeyError
            Never.

        Examples
        --------
        >>> 1
        1
        """

    assert function.__doc__ == inspect.cleandoc(
        """Return it.

        Parameters
        ----------
        q, v : array_like
        h : float, optional
        keep : bool
            Whether: it stays.

        Returns
        -------
        float

        Raises
        ------
        ValueError
            For an argument.
        TypeError
            For a type.
        KeyError
            Never.

        Examples
        --------
        >>> 1
        1
        """
    )


def test_a_parameter_with_a_default_has_an_entry_of_its_own():
    @Documented("ValueError")
    def function(q, v=None):
        """Return it."""

    assert "q : array_like\nv : array_like, optional\n    Default 0.\n" in function.__doc__


@pytest.mark.parametrize("name, member", [pytest.param(*one, id=one[0]) for one in members()])
def test_every_parameter_is_documented(name, member):
    entries = re.findall(r"^\*{0,2}\w+(?:, \*{0,2}\w+)*(?= :|$)", inspect.getdoc(member), re.M)
    named = {x.strip("*") for entry in entries for x in entry.split(", ")}
    parameters = list(inspect.signature(member).parameters)
    assert set(parameters["." in name :]) <= named  # that of a method begins with the object
