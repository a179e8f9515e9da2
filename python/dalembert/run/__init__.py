"""Schemes, runs, and their results."""

from .events import Event
from .export import to_pandas, to_xarray
from .integration import integrate, resume
from .reference import Reference, reference
from .scheme import Scheme, schemes
from .solution import Solution, States, Statistics
from .stepper import Stepper
from .storage import load, save
from .variations import Variations, variations

# What turns a solution into something else, as its methods.
Solution.save = save
Solution.to_pandas = to_pandas
Solution.to_xarray = to_xarray
