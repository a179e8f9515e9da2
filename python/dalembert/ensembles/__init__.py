"""Ensembles: many runs of a system, in threads, other processes, or on clusters."""

from .design import Design, grid, sample
from .api import ensemble, open_ensemble
from .result import Ensemble
from .store import StoreError
