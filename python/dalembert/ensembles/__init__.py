"""Ensembles: many runs of a system, on threads, on other processes, on clusters."""

from .design import Design, grid, sample
from .making import ensemble, open_ensemble
from .result import Ensemble
from .store import StoreError
