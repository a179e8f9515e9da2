"""Schemes, runs, and what they return."""

from .events import Event
from .integration import Reference, integrate, reference
from .scheme import Scheme, schemes
from .solution import Solution, States, Statistics
from .stepper import Stepper
