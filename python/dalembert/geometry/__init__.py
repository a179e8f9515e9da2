"""Mechanics on D, charts of D, and checks of a system at a state."""

from .chart import Chart, cutoff
from .examination import Check, Difference, examine
from .mechanics import (
    acceleration,
    consistent,
    energy,
    field,
    gram,
    initial,
    initial_state,
    metric,
    most_in_a_call,
    multipliers,
    perturbed,
    power,
    project,
    projection,
    relative_residual,
    residual,
    states,
    trajectory,
)
