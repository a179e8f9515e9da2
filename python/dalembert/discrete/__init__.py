"""Discrete mechanics on pairs of nodes."""

from .discrete import DifferenceMap, Discrete, NodeRun, Regularity, exact_velocity
